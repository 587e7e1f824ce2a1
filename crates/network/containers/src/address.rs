//! Finds the engines of this machine.

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
};

use cotorra_graph::EngineKind;

/// Docker's socket if `DOCKER_HOST` names no other.
const DOCKER: &str = "/var/run/docker.sock";

/// Address of an engine's interface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// At a socket that somebody serves.
    Socket(PathBuf),
    /// At a socket that the program `podman` serves once it is started for this process.
    Service,
}

/// An engine that this machine does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoEngine {
    /// podman is not installed.
    #[error(
        "podman is not installed: install the package `podman`, set CONTAINER_HOST=unix://SOCKET to use one that runs \
         elsewhere, or write `engine: docker` into the testbed file"
    )]
    Podman,
    /// Docker does not serve its socket.
    #[error(
        "Docker does not run: there is no socket {}. Start its daemon, set DOCKER_HOST=unix://SOCKET, or write `engine: podman` \
         into the testbed file", .0.display()
    )]
    Docker(PathBuf),
    /// A variable of the environment has no socket of this machine.
    #[error("{variable}={value} is no socket of this machine: write unix:///PATH")]
    NotASocket {
        /// Name of the variable.
        variable: &'static str,
        /// Its value.
        value: String,
    },
    /// The node runs no images.
    #[error("the node runs no images: its engine is `process`")]
    Process,
}

impl Address {
    /// Finds an engine, in this order: what `CONTAINER_HOST` or `DOCKER_HOST` names, and then the program `podman`, or Docker's
    /// usual socket.
    ///
    /// # Errors
    /// [`NoEngine`] with what to do about it.
    pub fn find(kind: EngineKind) -> Result<Self, NoEngine> {
        let (variable, otherwise): (_, fn() -> Result<Self, NoEngine>) = match kind {
            EngineKind::Process => return Err(NoEngine::Process),
            EngineKind::Podman => ("CONTAINER_HOST", podman),
            EngineKind::Docker => ("DOCKER_HOST", docker),
        };
        match env::var(variable) {
            Ok(value) if !value.is_empty() => match value.strip_prefix("unix://") {
                Some(path) if path.starts_with('/') => Ok(Self::Socket(path.into())),
                _ => Err(NoEngine::NotASocket { variable, value }),
            },
            _ => otherwise(),
        }
    }
}

fn podman() -> Result<Address, NoEngine> {
    let has = |path: &OsStr| env::split_paths(path).any(|folder| folder.join("podman").is_file());
    env::var_os("PATH").is_some_and(|path| has(&path)).then_some(Address::Service).ok_or(NoEngine::Podman)
}

fn docker() -> Result<Address, NoEngine> {
    let socket = Path::new(DOCKER);
    if socket.exists() { Ok(Address::Socket(socket.into())) } else { Err(NoEngine::Docker(socket.into())) }
}
