//! What runs VNFs of one run: its files, and the engine.

use std::{fs, path::PathBuf, sync::Arc};

use cotorra_agent_protocol::{Run, WantedInstance};
use cotorra_engine::{Cgroups, Engine, EngineEvent, InstanceId, ProcessEngine};

use crate::{error::at, launcher::MachineLauncher, options::Options};

/// Wakes the agent's loop.
pub(crate) type Wake = Box<dyn Fn() + Send + Sync>;

/// Runs VNFs of one run. Dropping it ends them.
pub(crate) struct Works {
    run: Run,
    launcher: Arc<MachineLauncher<Wake>>,
    engine: ProcessEngine<MachineLauncher<Wake>>,
    /// Instances that wait for the run's files; `None` once the files are there.
    waiting: Option<Vec<(InstanceId, Box<WantedInstance>)>>,
}

/// Instances that could not be started, with the reasons.
pub(crate) type Failures = Vec<(InstanceId, String)>;

impl Works {
    /// Makes ready to run VNFs in a run's folder, whose files [`Self::complete`] reports.
    pub(crate) fn new(run: Run, options: &Options, folder: PathBuf, wake: Wake) -> Self {
        let logs = folder.join("logs");
        if let Err(error) = fs::create_dir_all(&logs).map_err(at("create", &logs)) {
            tracing::error!("{error}");
        }
        let launcher = Arc::new(MachineLauncher::new(options.clone(), folder, wake));
        let cgroups = Cgroups::new().inspect_err(|e| tracing::info!("VNFs run without limits: {e}")).ok();
        let engine = ProcessEngine::new(Arc::clone(&launcher), logs, cgroups);
        Self { run, launcher, engine, waiting: Some(Vec::new()) }
    }

    pub(crate) fn run(&self) -> Run {
        self.run
    }

    /// Starts an instance, as soon as the files are there.
    ///
    /// # Errors
    /// Why it cannot be started.
    pub(crate) fn start(&mut self, id: InstanceId, instance: Box<WantedInstance>) -> Result<(), String> {
        if let Some(waiting) = &mut self.waiting {
            waiting.push((id, instance));
            return Ok(());
        }
        let WantedInstance { vnf, replica, node, environment, .. } = *instance;
        self.launcher.set_environment(&vnf, replica, environment);
        tracing::info!("starting `{}`", vnf.id);
        self.engine.start(id, &vnf, replica, &node)
    }

    /// Starts what waited for the files, if they are there.
    pub(crate) fn complete(&mut self, files: &Result<(), String>) -> Failures {
        let waiting = self.waiting.take().unwrap_or_default();
        let start = |(id, instance)| {
            let started = match files {
                Ok(()) => self.start(id, instance),
                Err(reason) => Err(format!("its files cannot be fetched: {reason}")),
            };
            started.err().map(|reason| (id, reason))
        };
        waiting.into_iter().filter_map(start).collect()
    }

    pub(crate) fn stop(&mut self, id: InstanceId) {
        if let Some(waiting) = &mut self.waiting {
            waiting.retain(|(waiting, _)| *waiting != id);
        }
        self.engine.stop(id);
    }

    pub(crate) fn poll(&mut self) -> Option<EngineEvent> {
        self.engine.poll()
    }

    pub(crate) fn shut_down(&mut self) {
        self.engine.shut_down();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use cotorra_graph::{NodeId, Program, Vnf, VnfId};

    use super::*;

    fn instance(command: &str) -> Box<WantedInstance> {
        let node = NodeId::new("edge").unwrap();
        let vnf = Vnf {
            id: VnfId::new("navigation").unwrap(),
            program: Program::Command(command.split_whitespace().map(str::to_owned).collect()),
            cpus: 1.0,
            memory_bytes: 1 << 20,
            pinned_to: None,
            node: node.clone().into(),
            env: Vec::new(),
            rights: Default::default(),
            keep: false,
            image: None,
        };
        Box::new(WantedInstance { vnf, replica: 0, node, environment: BTreeMap::new(), keep: false })
    }

    fn works() -> (tempfile::TempDir, Works) {
        let folder = tempfile::tempdir().unwrap();
        let options = Options {
            credentials: PathBuf::new(),
            state: folder.path().to_owned(),
            user: None,
            allow_trusted: false,
            confirmed: Default::default(),
        };
        let works = Works::new(Run(1), &options, folder.path().join("runs/1"), Box::new(|| {}));
        (folder, works)
    }

    #[test]
    fn every_instance_that_waits_for_files_fails_without_them() {
        let (_folder, mut works) = works();
        for id in 1..=3 {
            works.start(InstanceId(id), instance("true")).unwrap();
        }
        works.stop(InstanceId(2));
        let failures = works.complete(&Err("the disk is full".to_owned()));
        let reason = "its files cannot be fetched: the disk is full".to_owned();
        assert_eq!(failures, [(InstanceId(1), reason.clone()), (InstanceId(3), reason)]);
    }

    #[test]
    fn instances_that_wait_for_files_are_tried_when_they_are_there() {
        let (_folder, mut works) = works();
        // Rejected, without a process.
        works.start(InstanceId(1), instance("")).unwrap();
        let failures = works.complete(&Ok(()));
        assert_eq!(failures, [(InstanceId(1), "its command is empty".to_owned())]);
        assert_eq!(works.start(InstanceId(2), instance("")), Err("its command is empty".to_owned()));
    }
}
