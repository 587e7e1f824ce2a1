//! Containers to create, as the engines' interface describes them.

use std::{collections::BTreeMap, path::Path};

use serde::Serialize;

/// A container to create.
#[derive(Debug, Clone, Default, Serialize)]
#[serde(rename_all = "PascalCase")]
pub(crate) struct Container {
    pub(crate) image: String,
    /// Words of its command; `None` for those of the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) cmd: Option<Vec<String>>,
    /// Words before the command's; `None` for those of the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) entrypoint: Option<Vec<String>>,
    /// Variables, as `NAME=VALUE`.
    pub(crate) env: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) hostname: Option<String>,
    pub(crate) labels: BTreeMap<String, String>,
    pub(crate) host_config: HostConfig,
}

/// Rights of a container on its machine.
#[derive(Debug, Clone, Default, Serialize)]
#[serde(rename_all = "PascalCase")]
pub(crate) struct HostConfig {
    pub(crate) network_mode: String,
    pub(crate) mounts: Vec<Mount>,
    pub(crate) cap_drop: Vec<String>,
    pub(crate) cap_add: Vec<String>,
    #[serde(flatten)]
    pub(crate) limits: Option<Limits>,
}

/// Limits of a VNF's container, and what it is given.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "PascalCase")]
pub(crate) struct Limits {
    /// CPU time per second, ns.
    pub(crate) nano_cpus: i64,
    /// Bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) memory: Option<i64>,
    /// Bytes of memory and swap together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) memory_swap: Option<i64>,
    pub(crate) pids_limit: i64,
    /// Whether an init process of the engine comes first; `None` if the engine decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) init: Option<bool>,
    pub(crate) devices: Vec<Device>,
    pub(crate) security_opt: Vec<String>,
    pub(crate) ulimits: Vec<Ulimit>,
    pub(crate) log_config: LogConfig,
}

/// A file or folder of the machine in a container.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "PascalCase")]
pub(crate) struct Mount {
    pub(crate) r#type: &'static str,
    pub(crate) source: String,
    pub(crate) target: String,
    pub(crate) read_only: bool,
}

impl Mount {
    /// Returns the mount of a file or folder.
    pub(crate) fn bind(source: &Path, target: &Path, read_only: bool) -> Self {
        let [source, target] = [source, target].map(|path| path.to_string_lossy().into_owned());
        Self { r#type: "bind", source, target, read_only }
    }
}

/// A device of the machine in a container.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "PascalCase")]
pub(crate) struct Device {
    pub(crate) path_on_host: String,
    pub(crate) path_in_container: String,
    pub(crate) cgroup_permissions: &'static str,
}

/// A limit of each process.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "PascalCase")]
pub(crate) struct Ulimit {
    pub(crate) name: &'static str,
    pub(crate) soft: u64,
    pub(crate) hard: u64,
}

/// Place where an engine keeps the output.
#[derive(Debug, Clone, Serialize)]
#[serde(rename_all = "PascalCase")]
pub(crate) struct LogConfig {
    pub(crate) r#type: &'static str,
}
