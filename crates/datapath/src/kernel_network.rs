//! The wired network of a graph as the kernel itself emulates it: hosts in namespaces, every node a bridge, every link a
//! virtual Ethernet pair between two bridges, with a NetEm at each end. A packet takes several steps a hop through the
//! kernel, in place of one through the fabric; it is there to compare with, and for who trusts nothing else.
//!
//! Bridges and links are in a namespace of their own, where no firewall of the machine reaches them. NetEm is never on a
//! sender's own interface, where a drop would come back to it as an error.

use std::{
    collections::HashMap,
    fs,
    net::Ipv4Addr,
    os::fd::AsFd,
    sync::{Mutex, MutexGuard, PoisonError},
};

use cotorra_graph::{
    Conditions, Direction, HardwareGraph, HostAddress, Jitter, LinkId, Loss, NodeId, Probability, Rate,
};
use cotorra_netem::{Counters, Device, Kernel, Netem, NotByNetem, Rule};

use crate::{
    error::{Action, Error},
    hosts,
    namespace::Namespace,
    netlink::{self, Netlink},
    sys,
};

/// Why the kernel cannot emulate a network, or not do to a link what was asked. The fabric can.
#[derive(Debug, thiserror::Error)]
pub enum NoKernelNetwork {
    /// NetEm knows no radio.
    #[error("`{0}` is reached by radio, which NetEm does not know: no airtime, no attachment, no handover")]
    Radio(NodeId),
    /// Bridges would send packets in circles.
    #[error("the link `{0}` closes a circle, and bridges need a tree")]
    Circle(LinkId),
    /// The kernel lacks modules.
    #[error("this kernel has no {}", .0.join(", no "))]
    Lacks(Vec<&'static str>),
    /// A setting.
    #[error("link `{link}`: {reason}")]
    Setting {
        /// The link.
        link: LinkId,
        /// What NetEm cannot do.
        reason: NotByNetem,
    },
    /// NetEm's part of the kernel refused.
    #[error(transparent)]
    Netem(#[from] cotorra_netem::Error),
    /// Another part did.
    #[error(transparent)]
    Datapath(#[from] Error),
}

/// A graph's wired network in the kernel. Held by descriptors alone, as all namespaces here: it goes with the process.
pub struct KernelNetwork {
    hosts: Vec<Namespace>,
    places: HashMap<NodeId, usize>,
    links: Vec<LinkId>,
    /// In the namespace of all bridges and links, which it holds.
    kernel: Mutex<Kernel>,
    _wiring: Namespace,
}

/// Interfaces of the wiring have indices from here: a bridge for each node, a port for each host, two ends for each link.
const FIRST: u32 = 100;

/// The interface at which a direction of a link leaves.
fn end(link: usize, direction: Direction) -> String {
    match direction {
        Direction::Forward => format!("l{link}a"),
        Direction::Backward => format!("l{link}b"),
    }
}

impl KernelNetwork {
    /// Brings it up, with the links' conditions.
    ///
    /// # Errors
    /// [`NoKernelNetwork`], with what stands against it.
    pub fn start(graph: &HardwareGraph) -> Result<Self, NoKernelNetwork> {
        if let Some((robot, _)) = graph.robots().next() {
            return Err(NoKernelNetwork::Radio(robot.id.clone()));
        }
        let nodes: HashMap<_, _> = graph.nodes.iter().enumerate().map(|(i, node)| (&node.id, i)).collect();
        check_tree(graph, &nodes)?;
        let settings = graph.links.iter().map(|link| {
            let of = |conditions| netem_of(&link.id, conditions);
            Ok([of(&link.forward)?, of(&link.backward)?])
        });
        let settings = settings.collect::<Result<Vec<_>, NoKernelNetwork>>()?;
        let lacks = Namespace::new()?.run(|| Kernel::open()?.lacks())?;
        if !lacks.is_empty() {
            return Err(NoKernelNetwork::Lacks(lacks));
        }

        let wiring = Namespace::new()?;
        let bridge = |node: usize| FIRST + node as u32;
        let first_end = FIRST + graph.nodes.len() as u32;
        wiring
            .run(|| {
                // No bridge is to have an address, and so to speak.
                for of in ["all", "default"] {
                    let _ = fs::write(format!("/proc/sys/net/ipv6/conf/{of}/disable_ipv6"), "1");
                }
                let mut requests = Vec::new();
                for node in 0..graph.nodes.len() {
                    requests.push(netlink::bridge(&format!("b{node}"), bridge(node)));
                    requests.push(netlink::up(bridge(node), vec![]));
                }
                for (place, link) in graph.links.iter().enumerate() {
                    let [a, b] = [0, 1].map(|end| first_end + place as u32 * 2 + end);
                    let names = [Direction::Forward, Direction::Backward].map(|d| end(place, d));
                    requests.push(netlink::veth_here([(&names[0], a), (&names[1], b)]));
                    for (end, node) in [a, b].into_iter().zip(&link.ends) {
                        requests.push(netlink::up(end, vec![netlink::in_bridge(bridge(nodes[node]))]));
                    }
                }
                // A message must fit the socket's buffer.
                let netlink = Netlink::open()?;
                requests.chunks(64).try_for_each(|some| netlink.execute(some.to_vec()))
            })
            .action("wire bridges and links")?;

        let mut hosts = Vec::new();
        let mut places = HashMap::new();
        let first_port = first_end + graph.links.len() as u32 * 2;
        for (place, node) in graph.hosts().enumerate() {
            let port = first_port + place as u32;
            hosts.push(attach_host(place, port, bridge(nodes[&node.id]), &wiring)?);
            places.insert(node.id.clone(), place);
        }
        let network = Self {
            hosts,
            places,
            links: graph.links.iter().map(|link| link.id.clone()).collect(),
            kernel: Mutex::new(wiring.run(Kernel::open)?),
            _wiring: wiring,
        };
        for (link, [forward, backward]) in settings.into_iter().enumerate() {
            network.set_netem(link, Direction::Forward, forward)?;
            network.set_netem(link, Direction::Backward, backward)?;
        }
        Ok(network)
    }

    /// The namespace of a host.
    ///
    /// # Errors
    /// [`Error::NoSuchHost`].
    pub fn namespace(&self, host: &NodeId) -> Result<&Namespace, Error> {
        let place = self.places.get(host).ok_or_else(|| Error::NoSuchHost(host.clone()))?;
        Ok(&self.hosts[*place])
    }

    /// Gives one direction of a link other conditions, in place; it does so when this returns.
    ///
    /// # Errors
    /// [`NoKernelNetwork`]; then nothing has changed.
    ///
    /// # Panics
    /// If the graph has no link of that name.
    pub fn set(
        &self,
        link: &LinkId,
        direction: Direction,
        conditions: &Conditions,
    ) -> Result<(), NoKernelNetwork> {
        let place = self.links.iter().position(|l| l == link).expect("the graph's own link");
        self.set_netem(place, direction, netem_of(link, conditions)?)
    }

    fn set_netem(
        &self,
        link: usize,
        direction: Direction,
        (netem, packets): (Netem, bool),
    ) -> Result<(), NoKernelNetwork> {
        if packets {
            self.segment()?;
        }
        let kernel = self.kernel();
        let device = kernel.device(&end(link, direction))?;
        let plan = device.set(&Rule { netem, ..Rule::default() }, false);
        Ok(kernel.apply(&plan.expect("nobody else is in the wiring's namespace"))?)
    }

    /// What each direction of each link did so far.
    ///
    /// # Errors
    /// [`NoKernelNetwork::Netem`].
    pub fn counters(&self) -> Result<HashMap<(LinkId, Direction), Counters>, NoKernelNetwork> {
        let directions = |(place, link): (usize, &LinkId)| {
            let link = link.clone();
            [Direction::Forward, Direction::Backward].map(|d| (end(place, d), (link.clone(), d)))
        };
        let mut names: HashMap<_, _> = self.links.iter().enumerate().flat_map(directions).collect();
        let devices = self.kernel().devices()?;
        let of = |device: Device| {
            let direction = names.remove(&device.interface().name)?;
            Some((direction, device.rules().next()?.1))
        };
        Ok(devices.into_iter().filter_map(of).collect())
    }

    fn kernel(&self) -> MutexGuard<'_, Kernel> {
        self.kernel.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets hosts send packets one by one: NetEm would lose, delay or serialise a super-packet as a whole.
    fn segment(&self) -> Result<(), Error> {
        for host in &self.hosts {
            let socket =
                host.udp_socket((Ipv4Addr::UNSPECIFIED, 0)).action("open a socket in a namespace")?;
            sys::restrict_offloads(socket.as_fd(), c"eth0", &["tx-checksum-ip-generic", "tx-scatter-gather"])
                .action("restrict the offloads of a virtual Ethernet pair")?;
        }
        Ok(())
    }
}

/// The settings, and whether they need packets one by one, as in the fabric.
fn netem_of(link: &LinkId, conditions: &Conditions) -> Result<(Netem, bool), NoKernelNetwork> {
    const COARSE: u64 = 1_000_000_000;
    let netem = Netem::try_from(conditions)
        .map_err(|reason| NoKernelNetwork::Setting { link: link.clone(), reason })?;
    let Conditions { loss, jitter, duplication, corruption, reordering, rate, .. } = conditions;
    let random = [duplication, corruption, reordering].into_iter().any(|p| *p != Probability::ZERO);
    let slow = matches!(rate, Rate::Fixed { bits_per_second } if bits_per_second.bits_per_second() < COARSE);
    Ok((
        netem,
        slow || random || *loss != Loss::None || jitter.is_some_and(|j: Jitter| !j.deviation.is_zero()),
    ))
}

/// No link may lead back to where others lead already.
fn check_tree(graph: &HardwareGraph, nodes: &HashMap<&NodeId, usize>) -> Result<(), NoKernelNetwork> {
    let mut group: Vec<_> = (0..graph.nodes.len()).collect();
    for link in &graph.links {
        let [a, b] = link.ends.each_ref().map(|end| group[nodes[end]]);
        if a == b {
            return Err(NoKernelNetwork::Circle(link.id.clone()));
        }
        group.iter_mut().filter(|g| **g == b).for_each(|g| *g = a);
    }
    Ok(())
}

/// A host with `eth0`, whose other end is a port of its bridge.
fn attach_host(place: usize, port: u32, bridge: u32, wiring: &Namespace) -> Result<Namespace, Error> {
    let host = Namespace::new()?;
    host.run(|| {
        Netlink::open()?.execute(vec![netlink::veth("eth0", &format!("h{place}"), port, wiring.as_fd())])
    })
    .action("make a virtual Ethernet pair")?;
    wiring
        .run(|| Netlink::open()?.execute(vec![netlink::up(port, vec![netlink::in_bridge(bridge)])]))
        .action("set a port up")?;
    host.run(|| hosts::configure(&Netlink::open().action("open a netlink socket")?, place))?;
    debug_assert!(place < HostAddress::MAX_HOSTS);
    Ok(host)
}

impl std::fmt::Debug for KernelNetwork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("KernelNetwork")
            .field("hosts", &self.hosts.len())
            .field("links", &self.links.len())
            .finish()
    }
}
