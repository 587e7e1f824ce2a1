//! Tries out an engine: starts a container with the limits of a VNF, as a run would, and waits for its end.

use std::{io, process::Stdio, time::Duration};

use cotorra_graph::{EngineKind, Image, NodeId, Program, Rights, Vnf};

use crate::{
    address::Address,
    daemon::Daemon,
    daemon_error::DaemonError,
    holder::{Holders, PROGRAM, REFERENCE},
    instance::ended,
    leftovers::{Marker, connect, service_folder},
    service::Service,
    spec::Spec,
};

/// Longest time of the whole trial, but for the removal of what it made.
const LONGEST: Duration = Duration::from_secs(30);
/// Exit status of a holder that has no namespace to enter.
const ALONE: i64 = 1;

/// Why a trial has not shown that an engine runs containers.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TrialError {
    /// The engine, or its runtime, failed.
    #[error("{0}")]
    Failed(String),
    /// There can be no trial on this machine.
    #[error("there is no program to try it out with on {}", std::env::consts::ARCH)]
    NoProgram,
}

impl From<DaemonError> for TrialError {
    fn from(error: DaemonError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl From<io::Error> for TrialError {
    fn from(error: io::Error) -> Self {
        Self::Failed(error.to_string())
    }
}

/// Starts a container of a tiny image that is made for it, and removes both. Takes at most two minutes if the engine hangs.
///
/// # Errors
/// [`TrialError`] with the words of the engine or of its runtime.
pub fn try_out(kind: EngineKind, address: &Address) -> Result<(), TrialError> {
    if !Holders::has_program() {
        return Err(TrialError::NoProgram);
    }
    let marker = Marker::create(kind, address)?;
    let name = format!("cotorra-{}-trial", marker.run());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let tried = runtime.block_on(async {
        // It ends with this block.
        let _service = match address {
            Address::Socket(_) => None,
            Address::Service => Some(Service::start(&service_folder(marker.path()), Stdio::null)?),
        };
        let daemon = connect(address, &marker).await?;
        let had_image = daemon.has_image(REFERENCE).await?;
        let tried = tokio::time::timeout(LONGEST, run(&daemon, &name, marker.run())).await;
        let removed = daemon.remove(&name).await;
        if !had_image {
            // A trial that failed may not have made it.
            let _ = daemon.remove_image(REFERENCE).await;
        }
        let late = || TrialError::Failed(format!("a container did not end within {} s", LONGEST.as_secs()));
        Ok((tried.map_err(|_| late()).flatten(), removed))
    });
    match &tried {
        // `clean` finds it by the record.
        Ok((_, Err(error))) => {
            tracing::warn!("a container may be left, which `cotorra clean` removes: {error}")
        }
        _ => marker.remove(),
    }
    tried.and_then(|(tried, _)| tried)
}

/// Runs a container until it ends.
async fn run(daemon: &Daemon, name: &str, run: &str) -> Result<(), TrialError> {
    let node = NodeId::new("trial").expect("it is a name");
    let image = Image { reference: REFERENCE.to_owned(), ..Image::default() };
    let vnf = Vnf {
        id: "trial".parse().expect("it is a name"),
        program: Program::Command(vec![format!("/{PROGRAM}")]),
        cpus: 0.1,
        memory_bytes: 64 << 20,
        pinned_to: None,
        node: node.clone().into(),
        env: Vec::new(),
        rights: Rights::default(),
        keep: false,
        image: Some(Box::new(image)),
        cpu_limit: None,
        start: Duration::ZERO,
        computing: None,
        state: None,
    };
    let container = Spec {
        vnf: &vnf,
        replica: 0,
        node: &node,
        network: "none".to_owned(),
        hostname: None,
        environment: Vec::new(),
        files: Vec::new(),
        folder: std::path::Path::new("/"),
        run,
    };
    let container = container.container().map_err(TrialError::Failed)?;
    Holders::default().make_image(daemon).await?;
    daemon.create(name, container).await?;
    daemon.start(name).await?;
    let state = ended(daemon, name).await;
    match state.exit_code {
        ALONE => Ok(()),
        _ => Err(TrialError::Failed(format!("a container {}", state.end(vnf.memory_bytes)))),
    }
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;
    use tokio::task::LocalSet;

    use super::*;
    use crate::daemon::tests::{Answer, at_once, serve, version};

    /// Returns the outcome of a container whose engine answers so to its start, and to questions about its state.
    async fn outcome(start: Answer, state: &'static str) -> Result<(), TrialError> {
        let test = async {
            let folder = TempDir::new().unwrap();
            let socket = serve(&folder, move |request| {
                version(request).unwrap_or_else(|| match request {
                    _ if request.contains("/containers/create") => {
                        at_once("201 Created", r#"{"Id":"1","Warnings":[]}"#)
                    }
                    _ if request.contains("/start") => start.clone(),
                    _ => at_once("200 OK", state),
                })
            });
            run(&Daemon::connect(&socket).await.unwrap(), "trial", "podman-1").await
        };
        LocalSet::new().run_until(test).await
    }

    #[tokio::test(start_paused = true)]
    async fn only_a_container_that_ran_to_its_end_shows_that_an_engine_works() {
        let started = || at_once("204 No Content", "");
        assert_eq!(outcome(started(), r#"{"State":{"Running":false,"ExitCode":1}}"#).await, Ok(()));
        let other = outcome(started(), r#"{"State":{"Running":false,"ExitCode":127}}"#).await;
        assert_eq!(other, Err(TrialError::Failed("a container exited with status 127".to_owned())));
        let reason = "crun: invalid file system type on '/sys/fs/cgroup': OCI runtime error";
        let refused = at_once("500 Internal Server Error", &format!(r#"{{"message":"{reason}"}}"#));
        assert_eq!(outcome(refused, "{}").await, Err(TrialError::Failed(reason.to_owned())));
    }
}
