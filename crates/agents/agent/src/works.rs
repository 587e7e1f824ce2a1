//! Runs VNFs of one run: its files, and the engines.

use std::{fs, path::PathBuf, sync::Arc};

use cotorra_agent_protocol::{Run, WantedInstance};
use cotorra_engine::{Cgroups, Engine, EngineEvent, InstanceId, ProcessEngine};

use crate::{
    environments::Environments, error::at, files::VNF_LOGS, images::Images, launcher::MachineLauncher,
    options::Options, wake::Wake,
};

/// Runs VNFs of one run. Dropping it ends them.
pub(crate) struct Works {
    run: Run,
    environments: Arc<Environments>,
    processes: ProcessEngine<MachineLauncher>,
    images: Images,
    /// Instances that wait for the run's files; `None` once the files are there.
    waiting: Option<Vec<(InstanceId, Box<WantedInstance>)>>,
}

/// Instances that could not be started, with the reasons.
pub(crate) type Failures = Vec<(InstanceId, String)>;

impl Works {
    /// Makes ready to run VNFs in a run's folder, whose files [`Self::complete`] reports.
    pub(crate) fn new(run: Run, options: &Options, folder: PathBuf, wake: Wake) -> Self {
        let logs = folder.join(VNF_LOGS);
        if let Err(error) = fs::create_dir_all(&logs).map_err(at("create", &logs)) {
            tracing::error!("{error}");
        }
        let environments = Arc::<Environments>::default();
        let images = Images::new(options, folder.clone(), Arc::clone(&environments), Arc::clone(&wake));
        let launcher = MachineLauncher::new(options, folder, Arc::clone(&environments), wake);
        let cgroups = Cgroups::new().inspect_err(|e| tracing::info!("VNFs run without limits: {e}")).ok();
        let processes = ProcessEngine::new(Arc::new(launcher), logs, cgroups);
        Self { run, environments, processes, images, waiting: Some(Vec::new()) }
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
        self.environments.set(&vnf.id, replica, environment);
        tracing::info!("starting `{}`", vnf.id);
        if vnf.image.is_none() {
            return self.processes.start(id, &vnf, replica, &node);
        }
        self.images.start(id, &vnf, replica, &node)
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
        self.processes.stop(id);
        self.images.stop(id);
    }

    /// Returns the number of stopped instances that have not ended yet.
    pub(crate) fn stopping(&self) -> usize {
        self.processes.stopping() + self.images.stopping()
    }

    pub(crate) fn poll(&mut self) -> Option<EngineEvent> {
        self.processes.poll().or_else(|| self.images.poll())
    }

    pub(crate) fn shut_down(&mut self) {
        self.processes.shut_down();
        self.images.shut_down();
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::collections::BTreeMap;

    use cotorra_graph::{Image, NodeId, Program, Vnf, VnfId};

    use super::*;

    pub(crate) fn vnf(id: &str, command: &str) -> Vnf {
        Vnf {
            id: VnfId::new(id).unwrap(),
            program: Program::Command(command.split_whitespace().map(str::to_owned).collect()),
            cpus: 1.0,
            memory_bytes: 1 << 20,
            pinned_to: None,
            node: NodeId::new("edge").unwrap().into(),
            env: Vec::new(),
            rights: Default::default(),
            keep: false,
            image: None,
            cpu_limit: None,
            start: Default::default(),
            computing: None,
            state: None,
        }
    }

    fn wanted(vnf: Vnf) -> Box<WantedInstance> {
        let node = vnf.node.first().clone();
        Box::new(WantedInstance { vnf, replica: 0, node, environment: BTreeMap::new(), keep: false })
    }

    fn instance(command: &str) -> Box<WantedInstance> {
        wanted(vnf("navigation", command))
    }

    fn works() -> (tempfile::TempDir, Works) {
        let folder = tempfile::tempdir().unwrap();
        let options = Options {
            credentials: PathBuf::new(),
            state: folder.path().to_owned(),
            user: None,
            allow_trusted: false,
            images: None,
            confirmed: Default::default(),
            wifi: Default::default(),
        };
        let works = Works::new(Run(1), &options, folder.path().join("runs/1"), Arc::new(|| {}));
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

    #[test]
    fn images_need_the_permission_of_the_machines_owner() {
        let (_folder, mut works) = works();
        works.complete(&Ok(()));
        let image = Image { reference: "ros:jazzy".to_owned(), ..Image::default() };
        let vnf = Vnf { image: Some(Box::new(image)), ..vnf("planner", "plan") };
        let rejected = works.start(InstanceId(1), wanted(vnf)).unwrap_err();
        assert!(rejected.contains("--images podman"), "{rejected}");
    }
}
