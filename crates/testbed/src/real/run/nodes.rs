//! The third phase of a run: robots are driven, and VNFs can be started.

use std::{
    collections::BTreeMap,
    io,
    net::{TcpListener, UdpSocket},
    sync::Arc,
};

use cotorra_datapath::Datapath;
use cotorra_engine::{CgroupError, Cgroups, Engine, ProcessEngine};
use cotorra_graph::{Node, NodeId, Program, Testbed, Vnf};
use cotorra_network_control::Network as _;
use cotorra_robot_middleware::{Nonces, SimulatedRobot};

use super::{
    containers::Containers, engines::Engines, launcher::NodeLauncher, network::NetworkUp, prepared::Prepared,
};
use crate::{
    api::Applications,
    border::{Border, Places, Tunnels},
    core::{Core, images, script::Script},
    error::{RunError, system},
    real::{
        confined::Confined,
        control_sockets::ControlSockets,
        network::RealNetwork,
        robots::{AtAgents, Masters, Robots},
    },
    wifi::Wifi,
};

/// A run whose robots and VNFs are controlled by a core, which does not run yet. Fields are dropped in order: the latest
/// made first.
pub(super) struct NodesUp {
    pub(super) core: Core<RealNetwork, Engines>,
    pub(super) masters: Masters,
    /// Sockets for images, apart from the other sockets: images that wait to be sent hold up nothing else.
    pub(super) image_sockets: BTreeMap<NodeId, UdpSocket>,
    /// A socket in each robot.
    pub(super) sockets: BTreeMap<NodeId, UdpSocket>,
    /// Sockets between the core and plug-ins on nodes.
    pub(super) control: ControlSockets,
    /// The Wi-Fi programs at agents, if there are any.
    pub(super) radios: Option<Wifi>,
    /// Access of applications to the platform, and its port on its node.
    pub(super) applications: Applications,
    pub(super) platform: Option<TcpListener>,
}

impl NodesUp {
    /// Opens the robots' sockets, connects to robots, and makes the core.
    pub(super) fn start(
        prepared: &Prepared,
        network: &mut NetworkUp,
        mut real_network: RealNetwork,
        script: Script,
        confined: Confined,
    ) -> Result<Self, RunError> {
        let (testbed, datapath) = (&prepared.testbed, &network.datapath);
        // First, because other sockets may be given any free port.
        let control = ControlSockets::open(testbed, datapath)?;
        let sockets = open_sockets(testbed, datapath, testbed.graph.robots().map(|(node, _)| &node.id))?;
        let image_sockets = open_sockets(testbed, datapath, images::senders(testbed))?;
        let applications = Applications::new(testbed);
        let platform = open_platform(&applications, datapath)?;
        let launcher = NodeLauncher::new(
            Arc::clone(testbed),
            Arc::clone(datapath),
            prepared.folder.testbed(),
            prepared.seed,
            confined,
            network.messages.clone(),
            applications.clone(),
        );
        let cgroups = Cgroups::new().inspect_err(|error| warn_of_limits(testbed, error)).ok();
        let cgroups = cgroups.map(|groups| groups.with_shared_cpus(shared_cpus(testbed)));
        let local = ProcessEngine::new(Arc::new(launcher), prepared.folder.vnf_logs(), cgroups);
        let addresses = prepared.engines.clone();
        let containers = Containers::new(
            testbed,
            addresses,
            datapath,
            &prepared.folder,
            &network.messages,
            applications.clone(),
        );
        let containers = containers.map_err(system("write the files of containers"))?;
        let (agents, at_agents, radios) = match prepared.agents(&network.now, &network.messages)? {
            Some(mut agents) => {
                let radios = super::wifi::start_at_agents(testbed, network, &mut agents, &mut real_network)?;
                let contexts = real_network.with(|fabric, now| fabric.link_contexts(now));
                let contexts =
                    contexts.map_err(io::Error::other).map_err(system("read the links' conditions"))?;
                real_network.set_agents(agents.links(&contexts));
                let robots = agents.robots();
                (Some(Box::new(agents) as Box<dyn Engine + Send>), robots, radios)
            }
            None => (None, AtAgents::new(), None),
        };
        let engine = Engines::new(&testbed.graph, local, containers, agents);
        let now = Arc::clone(&network.now);
        let mut robots = Robots::new(Arc::clone(testbed), Arc::clone(datapath), now, at_agents);
        let places = Places::default();
        let border = testbed.border.as_ref();
        let mut core = Core::new(
            Arc::clone(testbed),
            prepared.seed,
            Nonces::unpredictable(),
            real_network,
            engine,
            script,
            |node: &Node, robot: SimulatedRobot| {
                if border.is_some_and(|border| border.visitors.contains(&node.id)) {
                    return Ok(Box::new(places.driver(&node.id, node.position.unwrap_or_default())));
                }
                robots.drive(node, robot)
            },
        )?;
        if let (Some(border), Some(departures)) = (border, network.departures.take()) {
            let tunnels = Tunnels::start(testbed, border, datapath, departures, &network.messages)?;
            core.open_border(Border::new(Arc::clone(testbed), border.clone(), tunnels, places));
        }
        let masters = robots.masters();
        Ok(Self { core, masters, image_sockets, sockets, control, radios, applications, platform })
    }
}

/// Opens a socket in each of these robots.
fn open_sockets<'a>(
    testbed: &Testbed,
    datapath: &Datapath,
    robots: impl IntoIterator<Item = &'a NodeId>,
) -> Result<BTreeMap<NodeId, UdpSocket>, RunError> {
    let open = |id: &NodeId| {
        let address = testbed.graph.address(id).expect("a robot is a host");
        let namespace = datapath.namespace(id)?;
        namespace.udp_socket((address.ipv4, 0)).map_err(system(format!("open the socket of `{id}`")))
    };
    robots.into_iter().map(|robot| Ok((robot.clone(), open(robot)?))).collect()
}

/// Opens the port where applications reach the platform, in the node on which it stands.
fn open_platform(applications: &Applications, datapath: &Datapath) -> Result<Option<TcpListener>, RunError> {
    let Some((node, address)) = applications.listen_at() else { return Ok(None) };
    let namespace = datapath.namespace(node)?;
    let listener = namespace.run(|| TcpListener::bind(address));
    listener.map(Some).map_err(system(format!("open the port of ETSI MEC's services on `{node}`")))
}

/// Returns the CPUs of the emulated nodes, which their VNFs share if any has a demand.
fn shared_cpus(testbed: &Testbed) -> BTreeMap<NodeId, f64> {
    if testbed.vnfs().all(|vnf| vnf.computing.is_none()) {
        return BTreeMap::new();
    }
    let emulated = testbed.graph.nodes.iter().filter(|node| node.real_server().is_none());
    let cpus = |node: &Node| Some((node.id.clone(), node.capacity()?.cpus)).filter(|(_, cpus)| *cpus > 0.0);
    emulated.filter_map(cpus).collect()
}

/// Says what limits VNFs without control groups, if there are any that these would limit.
fn warn_of_limits(testbed: &Testbed, error: &CgroupError) {
    let is_command = |vnf: &Vnf| matches!(vnf.program, Program::Command(_)) && vnf.image.is_none();
    if testbed.vnfs().any(|vnf| vnf.computing.is_some()) {
        tracing::warn!(
            "VNFs with a demand have no limit of CPUs, and those on one server use more CPUs together than it has: {error}"
        );
    }
    if testbed.vnfs().any(is_command) {
        tracing::warn!(
            "VNFs have no limit of CPUs, and `memory` limits the private data of each of their processes only, not shared \
             memory: {error}. Control groups limit both, as root or with `systemd-run --user --scope \
             --property=Delegate=yes cotorra run …`"
        );
    } else {
        tracing::info!("VNFs run without limits: {error}");
    }
}
