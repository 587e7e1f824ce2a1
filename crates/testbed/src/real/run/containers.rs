//! Containers of a run: VNFs with an image run in containers of podman or Docker, in the network namespaces of their nodes.

use std::{
    collections::{BTreeMap, BTreeSet, btree_map::Entry},
    fs, io,
    path::{Path, PathBuf},
    sync::{Arc, mpsc::Sender},
};

use cotorra_containers::{
    Address, ContainerEngine, GuardSettings, Network, NoEngine, Settings, Surroundings,
};
use cotorra_datapath::{Datapath, HostsFile};
use cotorra_engine::{Engine, EngineEvent, InstanceId};
use cotorra_graph::{EngineKind, ListenPort, NodeId, Testbed, Transport, Vnf, VnfId};
use cotorra_plugin::wire;

use super::launcher::robots_by_vnf;
use crate::{api::Applications, core::message::Message, error::RunError, folder::whole, report::RunFolder};

/// The engines that a testbed needs, by their kind.
pub(crate) type Addresses = BTreeMap<EngineKind, Address>;

/// Returns the VNFs with an image that start on this machine, with their nodes. Agents of real servers have engines of their own.
fn images_here(testbed: &Testbed) -> impl Iterator<Item = (&Vnf, &NodeId)> {
    let is_here = |id: &NodeId| testbed.graph.node(id).is_none_or(|node| node.real_server().is_none());
    let images = testbed.vnfs().filter(|vnf| vnf.image.is_some());
    let starts = images.flat_map(|vnf| vnf.node.all().iter().map(move |node| (vnf, node)));
    starts.filter(move |(_, node)| is_here(node))
}

/// Finds the engines of a testbed on this machine, before a run has a folder: those of nodes where containers start, and those
/// to which they can move.
///
/// # Errors
/// [`RunError::NoEngine`] if this machine has no engine for a node where a container starts.
pub(crate) fn find_engines(testbed: &Testbed) -> Result<Addresses, RunError> {
    let mut addresses = Addresses::new();
    for (vnf, node) in images_here(testbed) {
        if let Entry::Vacant(place) = addresses.entry(testbed.containers.engine(node)) {
            let cannot = |source| RunError::NoEngine { vnf: vnf.id.clone(), node: node.clone(), source };
            let address = Address::find(*place.key()).map_err(cannot)?;
            place.insert(address);
        }
    }
    let here = testbed.graph.hosts().filter(|node| node.real_server().is_none());
    let others: BTreeSet<_> = here.map(|node| testbed.containers.engine(&node.id)).collect();
    let others = others.into_iter().filter_map(|kind| Some((kind, Address::find(kind).ok()?)));
    let missing: Vec<_> = others.filter(|(kind, _)| !addresses.contains_key(kind)).collect();
    addresses.extend(missing);
    Ok(addresses)
}

/// The engines of containers of one run. Each starts with its first instance.
pub(crate) struct Containers {
    testbed: Arc<Testbed>,
    addresses: Addresses,
    nodes: Arc<Nodes>,
    folder: RunFolder,
    engines: BTreeMap<EngineKind, ContainerEngine>,
}

impl Containers {
    /// Prepares to run containers, and writes the file with the names of nodes.
    pub(crate) fn new(
        testbed: &Arc<Testbed>,
        addresses: Addresses,
        datapath: &Arc<Datapath>,
        folder: &RunFolder,
        messages: &Sender<Message>,
        applications: Applications,
    ) -> io::Result<Self> {
        // One mount for each file or folder beside the testbed file.
        let files = whole::files(folder.path())?;
        let beside: BTreeSet<_> = files.iter().filter_map(|file| file.iter().next()).collect();
        let files = beside
            .into_iter()
            .map(|name| (folder.path().join(name), Path::new(cotorra_vnfs::FILES).join(name)));
        let files = files.collect();
        let hosts = folder.logs().join("hosts");
        fs::write(&hosts, HostsFile::text(&testbed.graph))?;
        let nodes = Nodes {
            testbed: Arc::clone(testbed),
            datapath: Arc::clone(datapath),
            robots: robots_by_vnf(testbed),
            hosts,
            files,
            messages: messages.clone(),
            applications,
        };
        let (testbed, nodes) = (Arc::clone(testbed), Arc::new(nodes));
        Ok(Self { testbed, addresses, nodes, folder: folder.clone(), engines: BTreeMap::new() })
    }

    /// Returns the engine of a node.
    fn engine(&mut self, node: &NodeId) -> Result<&mut ContainerEngine, String> {
        match self.engines.entry(self.testbed.containers.engine(node)) {
            Entry::Occupied(engine) => Ok(engine.into_mut()),
            Entry::Vacant(place) => {
                let kind = *place.key();
                let address = match self.addresses.get(&kind) {
                    Some(address) => address.clone(),
                    None => Address::find(kind).map_err(|e: NoEngine| e.to_string())?,
                };
                let settings = Settings {
                    kind,
                    address,
                    folder: self.testbed.folder.clone(),
                    logs: self.folder.vnf_logs(),
                    guard: Some(guard(&self.folder)),
                };
                let nodes: Arc<dyn Surroundings> = Arc::<Nodes>::clone(&self.nodes);
                let engine = ContainerEngine::new(settings, nodes);
                Ok(place.insert(engine.map_err(|e| format!("cannot watch containers: {e}"))?))
            }
        }
    }
}

/// Returns the settings of a guard: this program, even if its file was replaced on the disk since.
fn guard(folder: &RunFolder) -> GuardSettings {
    GuardSettings {
        command: ["/proc/self/exe", "guard"].map(str::to_owned).to_vec(),
        log: folder.logs().join("containers.log"),
    }
}

impl Engine for Containers {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        self.engine(node)?.start(instance, vnf, replica, node)
    }

    fn stop(&mut self, instance: InstanceId) {
        self.engines.values_mut().for_each(|engine| engine.stop(instance));
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.engines.values_mut().find_map(Engine::poll)
    }

    fn shut_down(&mut self) {
        self.engines.values_mut().for_each(Engine::shut_down);
    }
}

/// The emulated nodes around containers.
struct Nodes {
    testbed: Arc<Testbed>,
    datapath: Arc<Datapath>,
    robots: BTreeMap<VnfId, NodeId>,
    /// File with the names of nodes.
    hosts: PathBuf,
    /// The testbed file and what it names, with their paths in containers.
    files: Vec<(PathBuf, PathBuf)>,
    messages: Sender<Message>,
    applications: Applications,
}

impl Surroundings for Nodes {
    fn network(&self, node: &NodeId) -> Result<Network, String> {
        let namespace = self.datapath.namespace(node).map_err(|e| e.to_string())?;
        Ok(Network::Namespace(namespace.path()))
    }

    fn environment(&self, vnf: &Vnf, _replica: u32, node: &NodeId) -> Vec<(String, String)> {
        let robot = self.robots.get(&vnf.id).map(|robot| (cotorra_vnfs::ROBOT, robot.to_string()));
        let port = wire::port(&self.testbed, &vnf.id).map(|port| (cotorra_vnfs::PORT, port.to_string()));
        let testbed = vnf.program.serves_robots().then(|| {
            let path = Path::new(cotorra_vnfs::FILES).join(RunFolder::TESTBED);
            (cotorra_vnfs::TESTBED, path.to_string_lossy().into_owned())
        });
        let platform = self.applications.environment(&vnf.id, node).unwrap_or_else(|error| {
            tracing::warn!("`{}` has no token for ETSI MEC's services: {error}", vnf.id);
            Vec::new()
        });
        let ours = [robot, port, testbed].into_iter().flatten().chain(platform);
        let ros = self.testbed.graph.ros1_environment(node).into_iter();
        ros.map(|(name, value)| (name.to_string(), value))
            .chain(ours.map(|(name, value)| (name.to_owned(), value)))
            .collect()
    }

    fn ports(&self, vnf: &Vnf) -> Vec<ListenPort> {
        let port = wire::port(&self.testbed, &vnf.id).filter(|_| vnf.program.serves_robots());
        port.map(|port| ListenPort { port, transport: Transport::Udp }).into_iter().collect()
    }

    fn files(&self, vnf: &Vnf) -> Vec<(PathBuf, PathBuf)> {
        let hosts = (self.hosts.clone(), PathBuf::from("/etc/hosts"));
        let files = self.files.iter().filter(|_| vnf.program.serves_robots()).cloned();
        std::iter::once(hosts).chain(files).collect()
    }

    fn wake(&self) {
        // The core's thread may have ended.
        let _ = self.messages.send(Message::Wake);
    }
}
