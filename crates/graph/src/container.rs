//! Container images, and the engines that run them.

use std::{path::PathBuf, time::Duration};

use serde::{Deserialize, Serialize};

use crate::units::millis;

/// An image whose containers run a VNF.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Image {
    /// Its reference, such as `ros:jazzy` or `docker.io/library/ros@sha256:…`.
    pub reference: String,
    /// When the engine pulls it from its registry.
    #[serde(default)]
    pub pull: Pull,
    /// Files and folders of the machine that a container sees.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub volumes: Vec<Volume>,
    /// Devices of the machine that a container may use, such as `/dev/ttyUSB0`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(value_type = Vec<String>)]
    pub devices: Vec<PathBuf>,
    /// Ports at which it serves. An instance is ready once it listens at all of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ports: Vec<ListenPort>,
    /// Whether the engine's init process is the first one of a container. It passes signals on, and reaps processes.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub init: bool,
    /// Time from its start until it serves, in virtual time.
    #[serde(rename = "start_ms", with = "millis", default)]
    #[schema(value_type = f64)]
    pub start: Duration,
    /// Time from a request to its answer, in virtual time.
    #[serde(rename = "processing_ms", with = "millis", default)]
    #[schema(value_type = f64)]
    pub processing: Duration,
}

/// When an engine pulls an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pull {
    /// If the engine does not have it.
    #[default]
    Missing,
    /// Before each start.
    Always,
    /// Never: the engine must have it.
    Never,
}

/// A file or folder of the machine that a container sees.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Volume {
    /// Its path on the machine, from the testbed file's folder.
    #[schema(value_type = String)]
    pub source: PathBuf,
    /// Its absolute path in the container.
    #[schema(value_type = String)]
    pub target: PathBuf,
    /// Whether the container may write there.
    #[serde(default)]
    pub writable: bool,
}

/// A port at which a container serves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ListenPort {
    /// Its number, above 0.
    pub port: u16,
    /// Its transport protocol.
    pub transport: Transport,
}

impl std::fmt::Display for ListenPort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let transport = match self.transport {
            Transport::Tcp => "tcp",
            Transport::Udp => "udp",
        };
        write!(f, "{}/{transport}", self.port)
    }
}

/// A transport protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Transport {
    /// TCP.
    Tcp,
    /// UDP.
    Udp,
}

/// The engine that runs images on a node.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum EngineKind {
    /// None: the node runs programs of this machine only.
    Process,
    /// podman.
    #[default]
    Podman,
    /// Docker.
    Docker,
}

impl EngineKind {
    /// Returns its name, as in a testbed file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Process => "process",
            Self::Podman => "podman",
            Self::Docker => "docker",
        }
    }
}
