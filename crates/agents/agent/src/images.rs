//! VNFs with an image: they run in containers of this machine, in its own network.

use std::{
    fs, io,
    path::{Component, Path, PathBuf},
    sync::Arc,
};

use cotorra_containers::{Address, ContainerEngine, GuardSettings, Network, Settings, Surroundings};
use cotorra_engine::{Engine, EngineEvent, InstanceId};
use cotorra_graph::{Granted, Image, ListenPort, NodeId, Rights, Transport, Vnf};

use crate::{
    environments::Environments,
    files::{LOGS, TESTBED, VNF_LOGS},
    launcher::SELF,
    options::{ImageEngine, Options},
    wake::Wake,
};

/// Subcommand of the guard of containers.
const GUARD: &str = "guard-containers";

/// Runs VNFs of one run in containers. Dropping it ends them.
pub(crate) struct Images {
    options: Options,
    folder: PathBuf,
    environments: Arc<Environments>,
    wake: Wake,
    /// `None` until the first instance.
    engine: Option<ContainerEngine>,
}

impl Images {
    /// Makes ready to run containers in a run's folder.
    pub(crate) fn new(
        options: &Options,
        folder: PathBuf,
        environments: Arc<Environments>,
        wake: Wake,
    ) -> Self {
        Self { options: options.clone(), folder, environments, wake, engine: None }
    }

    /// Begins to start an instance.
    ///
    /// # Errors
    /// Why it cannot be started.
    pub(crate) fn start(
        &mut self,
        id: InstanceId,
        vnf: &Vnf,
        replica: u32,
        node: &NodeId,
    ) -> Result<(), String> {
        let kind = self.options.images.ok_or(
            "the agent runs no images; start it with `--images podman` or `--images docker` if its machine may run them",
        )?;
        if let Some(what) = vnf.image.as_deref().and_then(|image| of_the_machine(image, &vnf.rights))
            && !self.options.allow_trusted
        {
            return Err(format!("the agent gives containers no {what}; start it with `--allow-trusted`"));
        }
        if self.engine.is_none() {
            self.engine = Some(self.engine(kind)?);
        }
        let engine = self.engine.as_mut().ok_or("there is no engine")?;
        engine.start(id, vnf, replica, node)
    }

    fn engine(&self, kind: ImageEngine) -> Result<ContainerEngine, String> {
        let settings = Settings {
            kind: kind.into(),
            address: Address::find(kind.into()).map_err(|error| error.to_string())?,
            folder: self.folder.clone(),
            logs: self.folder.join(VNF_LOGS),
            guard: Some(GuardSettings {
                command: [SELF, GUARD].map(str::to_owned).to_vec(),
                log: self.folder.join(LOGS).join("containers.log"),
            }),
        };
        let machine = Machine {
            folder: self.folder.clone(),
            environments: Arc::clone(&self.environments),
            wake: Arc::clone(&self.wake),
        };
        let engine = ContainerEngine::new(settings, Arc::new(machine));
        engine.map_err(|e| format!("cannot watch containers: {e}"))
    }

    pub(crate) fn stop(&mut self, id: InstanceId) {
        self.engine.iter_mut().for_each(|engine| engine.stop(id));
    }

    /// Returns the number of stopped instances that have not ended yet.
    pub(crate) fn stopping(&self) -> usize {
        self.engine.as_ref().map_or(0, ContainerEngine::stopping)
    }

    pub(crate) fn poll(&mut self) -> Option<EngineEvent> {
        self.engine.as_mut()?.poll()
    }

    pub(crate) fn shut_down(&mut self) {
        self.engine.iter_mut().for_each(Engine::shut_down);
    }
}

/// Returns what a container would have of the machine, if its owner must permit that: devices, capabilities, and volumes that
/// are not files of the run.
fn of_the_machine(image: &Image, rights: &Rights) -> Option<&'static str> {
    let is_of_run = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_)));
    // A link that a container writes could lead out of the run's folder.
    let is_harmless = |volume: &cotorra_graph::Volume| !volume.writable && is_of_run(&volume.source);
    match rights {
        _ if !image.devices.is_empty() => Some("devices"),
        _ if !image.volumes.iter().all(is_harmless) => Some("volumes but files of the run, to be read"),
        Rights::Confined(Granted { capabilities, .. }) if !capabilities.is_empty() => Some("capabilities"),
        _ => None,
    }
}

/// Removes containers that killed agents and their guards left.
pub(crate) fn clean() {
    let cleaned = cotorra_containers::clean();
    for (run, containers) in &cleaned.runs {
        tracing::info!("removed {containers} containers that {run} left");
    }
    cleaned.kept.iter().for_each(|kept| tracing::warn!("{kept}"));
}

/// Waits for the end of the agent, and removes its containers. It ends after the agent, also if a service manager signals both.
///
/// # Errors
/// The error of the system or of the engine.
pub(crate) fn guard(record: &Path) -> io::Result<()> {
    ctrlc::set_handler(|| ()).map_err(io::Error::other)?;
    cotorra_containers::guard(record)
}

/// This machine around containers.
struct Machine {
    /// Folder of the run.
    folder: PathBuf,
    environments: Arc<Environments>,
    wake: Wake,
}

impl Surroundings for Machine {
    fn network(&self, _node: &NodeId) -> Result<Network, String> {
        Ok(Network::Machine)
    }

    fn environment(&self, vnf: &Vnf, replica: u32, _node: &NodeId) -> Vec<(String, String)> {
        let testbed = vnf.program.serves_robots().then(|| {
            let path = Path::new(cotorra_vnfs::FILES).join(TESTBED);
            (cotorra_vnfs::TESTBED.to_owned(), path.to_string_lossy().into_owned())
        });
        self.environments.of(&vnf.id, replica).into_iter().chain(testbed).collect()
    }

    fn ports(&self, vnf: &Vnf) -> Vec<ListenPort> {
        let port = self.environments.shared(&vnf.id, cotorra_vnfs::PORT);
        let port = port.filter(|_| vnf.program.serves_robots()).and_then(|port| port.parse().ok());
        port.map(|port| ListenPort { port, transport: Transport::Udp }).into_iter().collect()
    }

    fn files(&self, vnf: &Vnf) -> Vec<(PathBuf, PathBuf)> {
        if !vnf.program.serves_robots() {
            return Vec::new();
        }
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let files = entries.map(|entry| entry.file_name()).filter(|name| name != LOGS);
        files.map(|name| (self.folder.join(&name), Path::new(cotorra_vnfs::FILES).join(name))).collect()
    }

    fn wake(&self) {
        (self.wake)();
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{LinuxCapability, Volume};

    use super::*;

    fn volume(source: &str, writable: bool) -> Image {
        let volume = Volume { source: source.into(), target: "/data".into(), writable };
        Image { volumes: vec![volume], ..Image::default() }
    }

    #[test]
    fn what_is_of_the_machine_needs_the_permission_of_its_owner() {
        let none = Rights::default();
        assert_eq!(of_the_machine(&Image::default(), &none), None);
        assert_eq!(of_the_machine(&volume("maps/a.png", false), &none), None);
        for image in [volume("maps", true), volume("/etc", false), volume("../x", false)] {
            assert!(of_the_machine(&image, &none).is_some_and(|what| what.starts_with("volumes")));
        }
        let device = Image { devices: vec!["/dev/null".into()], ..Image::default() };
        assert_eq!(of_the_machine(&device, &none), Some("devices"));
        let granted = Granted { capabilities: vec![LinuxCapability::NetRaw], readable: Vec::new() };
        assert_eq!(of_the_machine(&Image::default(), &Rights::Confined(granted)), Some("capabilities"));
    }

    #[test]
    fn a_bundled_vnf_finds_the_runs_files_and_its_port_but_no_logs() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(TESTBED), "").unwrap();
        fs::create_dir(folder.path().join(LOGS)).unwrap();
        let environments = Arc::new(Environments::default());
        let machine = Machine {
            folder: folder.path().to_owned(),
            environments: Arc::clone(&environments),
            wake: Arc::new(|| ()),
        };
        let mut vnf = crate::works::tests::vnf("navigation", "");
        environments.set(&vnf.id, 1, [("COTORRA_PORT".to_owned(), "5000".to_owned())].into());
        let port = ("COTORRA_PORT".to_owned(), "5000".to_owned());
        let node = NodeId::new("edge").unwrap();
        assert_eq!(machine.environment(&vnf, 1, &node), vec![port.clone()]);
        assert_eq!((machine.ports(&vnf), machine.files(&vnf)), (vec![], vec![]), "a command of others");
        vnf.program = cotorra_graph::Program::Navigation;
        let testbed = ("COTORRA_TESTBED".to_owned(), "/run/cotorra/testbed.yaml".to_owned());
        assert_eq!(machine.environment(&vnf, 1, &node), [port, testbed]);
        assert_eq!(machine.ports(&vnf), [ListenPort { port: 5000, transport: Transport::Udp }]);
        assert_eq!(machine.files(&vnf), [(folder.path().join(TESTBED), "/run/cotorra/testbed.yaml".into())]);
    }
}
