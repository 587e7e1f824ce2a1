//! A running fabric: a namespace with a real interface for each host, and the thread that carries packets between
//! them.

use std::{
    collections::{BTreeSet, HashMap},
    process::Command,
    sync::Arc,
    thread::{self, JoinHandle},
};

use cotorra_fabric::Fabric;
use cotorra_graph::{HardwareGraph, Node, NodeId, NodeKind, RadioKind};

use crate::{
    awake::Awake,
    clock::Clock,
    engine::{DepartureSink, Engine, EventSink, Handle, SharedSources, Sinks},
    error::{Action, Error},
    gateway::{self, GatewayTraffic, Opened},
    hosts::{self, Addresses, Host, PortKind, Watched},
    kernel_network::KernelNetwork,
    namespace::Namespace,
    neighbours::{self, Neighbours},
    port::Port,
    process::{Child, HostsFile, SpawnOptions},
    punctual::BusyPoll,
    shared::Shared,
    sys,
    watch::Watch,
    wifi::{self, Air},
};

/// Settings of a datapath.
#[derive(Default)]
pub struct Options {
    pub port: PortKind,
    /// Spinning policy.
    pub busy_poll: BusyPoll,
    /// Lets idle cores sleep. This saves power, but packets then wait for cores to wake.
    pub let_cores_sleep: bool,
    /// Receiver of the fabric's events.
    pub events: Option<EventSink>,
    /// Receiver of packets of robots that are with other cores.
    pub departures: Option<DepartureSink>,
    /// Sources of traffic at ports of the fabric.
    pub traffic: Option<SharedSources>,
    /// Interfaces that gateways and real servers may use even if they carry the default route.
    pub allowed_interfaces: Vec<String>,
    /// A network in which the kernel carries the packets between its own hosts. The fabric then only keeps the
    /// counters and conditions.
    pub kernel: Option<KernelNetwork>,
}

/// A fabric that carries real packets between hosts in network namespaces. Dropping it stops everything except
/// programs started by [`Self::spawn`], which the caller must drop first.
pub struct Datapath {
    /// Namespaces of emulated hosts.
    hosts: Vec<Namespace>,
    gateways: Vec<Opened>,
    kernel: Option<Arc<KernelNetwork>>,
    /// Indices of their namespaces.
    places: HashMap<NodeId, usize>,
    hosts_file: Option<HostsFile>,
    kind: PortKind,
    clock: Clock,
    handle: Handle,
    thread: Option<JoinHandle<std::io::Result<Fabric>>>,
    /// Number at the start.
    neighbour_overflows: Option<u64>,
    _watch: Watch,
    _awake: Option<Awake>,
}

impl Datapath {
    /// Brings the graph's hosts up and starts the fabric, which must be made from the same graph. The run's clock
    /// starts now. Robots and radio units of networks with real Wi-Fi software have their [radios](wifi) then.
    ///
    /// # Errors
    /// [`Error::Kernel`] with the rejected action, [`Error::Gateway`], [`Error::Wifi`].
    pub fn start(graph: &HardwareGraph, mut fabric: Fabric, options: Options) -> Result<Self, Error> {
        sys::raise_open_files();
        let neighbour_overflows = neighbours::overflows();
        let kind = hosts::resolve(options.port);
        let kernel = options.kernel.map(Arc::new);
        let mut air = if kernel.is_none() { Air::register(graph)? } else { None };
        let (gateways, mut real_ports) = gateway::open(graph, &options.allowed_interfaces)?;
        let emulated = graph.hosts().enumerate().filter(|(_, node)| node.real_server().is_none());
        let emulated: Vec<_> = emulated.filter(|_| kernel.is_none()).collect();
        let radios: BTreeSet<_> = graph.nodes_with(RadioKind::Hwsim).map(|node| &node.id).collect();
        let addresses = |node: &Node| {
            if radios.contains(&node.id) { wifi::addresses(node) } else { Addresses::AtPort }
        };
        let addressed: Vec<_> = emulated.iter().map(|(place, node)| (*place, addresses(node))).collect();
        let neighbours = Neighbours::of(graph, gateway::machines(graph));
        let (hosts, ports): (Vec<_>, Vec<_>) = hosts::bring_up(&addressed, kind, &neighbours)?
            .into_iter()
            .map(|Host { namespace, port }| match kind {
                PortKind::PacketSocket => (namespace, Port::of_packet_socket(port)),
                _ => (namespace, Port::of_tap(port)),
            })
            .unzip();
        if let Some(air) = &mut air {
            let (robots, units): (Vec<_>, Vec<_>) = emulated
                .iter()
                .zip(&hosts)
                .filter(|((_, node), _)| radios.contains(&node.id))
                .partition(|((_, node), _)| matches!(node.kind, NodeKind::Robot(_)));
            // Robots first: there is no radio unit then that they would lose.
            for ((place, node), host) in robots.into_iter().chain(units) {
                air.equip(&mut fabric, (*place, node), host, &neighbours)?;
            }
        }
        if kernel.is_none() {
            neighbours.warn();
        }
        let watched = addressed.iter().zip(&hosts);
        let watched = watched.map(|((place, addresses), host)| Watched::new(host, *addresses, *place));
        let watch = Watch::start(watched.collect::<Result<_, _>>()?, neighbours)?;
        let places = emulated.iter().map(|(_, node)| node.id.clone()).zip(0..).collect();
        let mut ports = ports.into_iter();
        let port = |node: &Node| real_ports.remove(&node.id).or_else(|| ports.next());
        let ports = graph.ports().filter_map(port).collect();
        let hosts_file = HostsFile::of(graph)
            .inspect_err(|e| tracing::warn!("programs in nodes cannot use the names of other nodes: {e}"))
            .ok();
        let shared = Arc::new(Shared::new().action("make an eventfd")?);
        let clock = Clock::start();
        let Options { events, departures, traffic, .. } = options;
        let sinks = Sinks { events, departures, traffic };
        let engine = Engine::new(fabric, clock, ports, Arc::clone(&shared), options.busy_poll, sinks, air)
            .action("wait for the ports with epoll")?;
        let thread = thread::Builder::new()
            .name("fabric".into())
            .spawn(|| engine.run())
            .action("start the fabric's thread")?;
        let awake = (!options.let_cores_sleep).then(Awake::keep);
        let (handle, thread) = (Handle(shared), Some(thread));
        Ok(Self {
            hosts,
            gateways,
            kernel,
            places,
            hosts_file,
            kind,
            clock,
            handle,
            thread,
            neighbour_overflows,
            _watch: watch,
            _awake: awake,
        })
    }

    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// Returns a handle to run closures on the fabric's thread.
    pub fn handle(&self) -> Handle {
        self.handle.clone()
    }

    /// Returns the kind of port in use, never [`PortKind::Auto`].
    pub fn port_kind(&self) -> PortKind {
        self.kind
    }

    /// Returns the namespace of a host.
    ///
    /// # Errors
    /// [`Error::NoSuchHost`].
    pub fn namespace(&self, host: &NodeId) -> Result<&Namespace, Error> {
        if let Some(kernel) = &self.kernel {
            return kernel.namespace(host);
        }
        let place = self.places.get(host).ok_or_else(|| Error::NoSuchHost(host.clone()))?;
        Ok(&self.hosts[*place])
    }

    /// Returns the kernel's network, if the kernel carries the packets.
    pub fn kernel(&self) -> Option<Arc<KernelNetwork>> {
        self.kernel.clone()
    }

    /// Starts a program in a host. It can use the names of all other hosts; see [`Namespace::spawn`].
    ///
    /// # Errors
    /// [`Error::NoSuchHost`], [`Error::Spawn`].
    pub fn spawn(&self, host: &NodeId, command: Command, options: SpawnOptions<'_>) -> Result<Child, Error> {
        let hosts = options.hosts.or(self.hosts_file.as_ref());
        let hostname = options.hostname.or(Some(host.as_str()));
        self.namespace(host)?.spawn(command, SpawnOptions { hosts, hostname, ..options })
    }

    /// Returns the number of frames that hosts' ports dropped since the run began, because an interface was down or its
    /// queue full.
    pub fn dropped_frames(&self) -> u64 {
        self.handle.0.dropped()
    }

    /// Returns the number of packets since the run began, of this machine, that the kernel dropped because its tables of
    /// neighbours were full. In a container, which does not show it, returns 0.
    pub fn neighbour_overflows(&self) -> u64 {
        let since = |start| Some(neighbours::overflows()?.saturating_sub(start));
        self.neighbour_overflows.and_then(since).unwrap_or(0)
    }

    /// Returns the traffic of each gateway and real server since the run began.
    pub fn gateways(&self) -> Vec<GatewayTraffic> {
        self.gateways.iter().map(Opened::traffic).collect()
    }

    /// Stops the datapath and returns the fabric with its final figures.
    ///
    /// # Errors
    /// [`Error::Stopped`] if its thread had ended before, [`Error::Kernel`] if the kernel ended it.
    pub fn stop(mut self) -> Result<Fabric, Error> {
        self.end().ok_or(Error::Stopped)?.action("wait for packets")
    }

    fn end(&mut self) -> Option<std::io::Result<Fabric>> {
        self.handle.0.stop();
        self.thread.take()?.join().ok()
    }
}

impl Drop for Datapath {
    fn drop(&mut self) {
        self.end();
    }
}

impl std::fmt::Debug for Datapath {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Datapath").field("hosts", &self.hosts.len()).field("kind", &self.kind).finish()
    }
}
