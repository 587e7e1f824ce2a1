//! A graph's wired network emulated by the kernel: hosts in namespaces, every node a bridge, every link a virtual
//! Ethernet pair between two bridges with a NetEm at each end. A hop takes several steps in the kernel instead of one
//! in the fabric. It serves for comparison, and for users who trust only the kernel.
//!
//! Bridges and links have a namespace of their own, where no firewall of the machine reaches them. NetEm is never on
//! a sender's own interface, where a drop would be reported to the sender as an error.

use std::{collections::HashMap, fs, net::Ipv4Addr, os::fd::AsFd};

use cotorra_fabric::{Fabric, FabricError, Reservation};
use cotorra_graph::{
    Conditions, Direction, HardwareGraph, HostAddress, Jitter, Lateness, Link, LinkCounters, LinkId, Loss,
    NodeId, Probability, Probed, Probing, Rate, Tested, ThroughputTest,
};
use cotorra_netem::{ConditionsError, Counters, Kernel, Netem, Share, Sharing};
use parking_lot::Mutex;

use crate::{
    error::{Action, Error},
    hosts::{self, Addresses, Watched},
    link_probes::{LinkProbes, Measured},
    namespace::Namespace,
    neighbours::Neighbours,
    netlink::{self, Netlink},
    sys,
    watch::Watch,
};

/// A network, or a link's conditions, that the kernel cannot emulate. The fabric can.
#[derive(Debug, thiserror::Error)]
pub enum KernelNetworkError {
    /// A node is reached by radio, which NetEm does not emulate.
    #[error("`{0}` is reached by radio, which NetEm does not emulate: let the fabric emulate")]
    Radio(NodeId),
    /// A gateway or a real server joins real machines, which only the fabric does.
    #[error(
        "`{0}` is a gateway or a real server, which the kernel's bridges do not join: let the fabric emulate"
    )]
    RealPort(NodeId),
    /// The links form a circle, in which bridges would forward packets for ever.
    #[error("the link `{0}` closes a circle: the kernel's bridges need a tree; let the fabric emulate")]
    Circle(LinkId),
    /// The kernel lacks modules.
    #[error("this kernel lacks {}", .0.join(", "))]
    Lacks(Vec<&'static str>),
    /// NetEm cannot emulate a link's conditions.
    #[error("link `{link}`: {reason}")]
    Setting { link: LinkId, reason: ConditionsError },
    /// A NetEm request failed.
    #[error(transparent)]
    Netem(#[from] cotorra_netem::Error),
    /// Another action failed.
    #[error(transparent)]
    Datapath(#[from] Error),
}

/// A graph's wired network in the kernel. Held by descriptors alone, as all namespaces here: it ends with the
/// process.
pub struct KernelNetwork {
    hosts: Vec<Namespace>,
    places: HashMap<NodeId, usize>,
    links: Vec<LinkId>,
    wires: Mutex<Wires>,
    probes: LinkProbes,
    _watch: Watch,
    _wiring: Namespace,
}

/// A reservation on one direction of a link, for the frames from one host to another.
#[derive(Debug, Clone, PartialEq)]
pub struct ReservedHop {
    /// The link.
    pub link: LinkId,
    /// The direction in which the frames cross it.
    pub direction: Direction,
    /// The host that sends them.
    pub from: NodeId,
    /// The host that receives them.
    pub to: NodeId,
    /// The rate that is kept for them.
    pub reservation: Reservation,
}

/// The disciplines at both ends of each link.
struct Wires {
    /// Socket in the namespace of all bridges and links, which it keeps alive.
    kernel: Kernel,
    ends: Vec<[End; 2]>,
}

/// The discipline at the end of a link where a direction leaves.
struct End {
    sharing: Sharing,
    /// Counters of disciplines that were deleted.
    gone: Counters,
}

/// Observations of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observed {
    /// Traffic so far, without measurement packets. NetEm counts packets lost at random and at a full queue as one:
    /// lost. It does not count duplicated or corrupted packets.
    pub counters: LinkCounters,
    /// Result of probes; `None` without probes or before the first result.
    pub probed: Option<Probed>,
    /// Result of the last throughput test.
    pub tested: Option<Tested>,
}

/// First interface index of the wiring: a bridge for each node, a port for each host, two ends for each link.
const FIRST: u32 = 100;

/// Returns the name of the interface at which a direction of a link leaves.
fn end(link: usize, direction: Direction) -> String {
    match direction {
        Direction::Forward => format!("l{link}a"),
        Direction::Backward => format!("l{link}b"),
    }
}

impl KernelNetwork {
    /// Brings the network up. Links get the effective conditions that the fabric has for them, and are probed if
    /// requested.
    ///
    /// # Errors
    /// [`KernelNetworkError`] if the kernel cannot emulate the graph.
    ///
    /// # Panics
    /// If the fabric lacks a link.
    pub fn start(
        graph: &HardwareGraph,
        fabric: &Fabric,
        probing: Option<Probing>,
    ) -> Result<Self, KernelNetworkError> {
        if let Some((robot, _)) = graph.robots().next() {
            return Err(KernelNetworkError::Radio(robot.id.clone()));
        }
        if let Some(port) = graph.real_ports().next() {
            return Err(KernelNetworkError::RealPort(port.node.id.clone()));
        }
        let nodes: HashMap<_, _> = graph.nodes.iter().enumerate().map(|(i, node)| (&node.id, i)).collect();
        check_tree(graph, &nodes)?;
        let effective = |link: &Link| fabric.effective(&link.id).expect("a fabric of this graph");
        let settings = graph.links.iter().map(|link| {
            let [forward, backward] = effective(link);
            Ok([netem_of(&link.id, forward)?, netem_of(&link.id, backward)?])
        });
        let settings = settings.collect::<Result<Vec<_>, KernelNetworkError>>()?;
        let lacks = Namespace::new()?.run(|| Kernel::open()?.lacks())?;
        if !lacks.is_empty() {
            return Err(KernelNetworkError::Lacks(lacks));
        }

        let wiring = Namespace::new()?;
        let bridge = |node: usize| FIRST + node as u32;
        let first_end = FIRST + graph.nodes.len() as u32;
        wiring
            .run(|| {
                // Bridges need no addresses, and without them send no packets of their own.
                for of in ["all", "default"] {
                    let _ = fs::write(format!("/proc/sys/net/ipv6/conf/{of}/disable_ipv6"), "1");
                }
                let mut requests = Vec::new();
                for node in 0..graph.nodes.len() {
                    requests.push(netlink::bridge(&format!("b{node}"), bridge(node)));
                    requests.push(netlink::up(bridge(node)));
                }
                for (place, link) in graph.links.iter().enumerate() {
                    let [a, b] = [0, 1].map(|end| first_end + place as u32 * 2 + end);
                    let names = [Direction::Forward, Direction::Backward].map(|d| end(place, d));
                    requests.push(netlink::veth_here([(&names[0], a), (&names[1], b)]));
                    for (end, node) in [a, b].into_iter().zip(&link.ends) {
                        requests.push(netlink::up_in_bridge(end, bridge(nodes[node])));
                    }
                }
                Netlink::open()?.execute(requests)
            })
            .action("wire bridges and links")?;

        let mut hosts = Vec::new();
        let mut places = HashMap::new();
        let first_port = first_end + graph.links.len() as u32 * 2;
        // Bridges learn where a host is when it answers whoever asks for it. Until then they flood.
        let neighbours = Neighbours::unknown(graph.hosts().count());
        neighbours.warn();
        for (place, node) in graph.hosts().enumerate() {
            let port = first_port + place as u32;
            hosts.push(attach_host(place, port, bridge(nodes[&node.id]), &wiring, &neighbours)?);
            places.insert(node.id.clone(), place);
        }
        let watched = hosts.iter().enumerate();
        let watched = watched.map(|(place, host)| Watched::new(host, Addresses::AtPort, place));
        let watch = Watch::start(watched.collect::<Result<_, _>>()?, neighbours)?;
        let mut wires = Wires { kernel: wiring.run(Kernel::open)?, ends: Vec::new() };
        for (link, both) in settings.into_iter().enumerate() {
            if both.iter().any(|(_, needs_packets)| *needs_packets) {
                segment(&hosts)?;
            }
            wires.set_up(link, both.map(|(netem, _)| netem))?;
        }
        let ends = graph.links.iter().map(effective).zip((first_end..).step_by(2));
        let ends = ends.map(|([forward, backward], a)| [(a, forward.clone()), (a + 1, backward.clone())]);
        let ends = ends.collect();
        let probes = wiring.run(|| LinkProbes::start(ends, probing)).action("measure links")?;
        let links = graph.links.iter().map(|link| link.id.clone()).collect();
        Ok(Self { hosts, places, links, wires: Mutex::new(wires), probes, _watch: watch, _wiring: wiring })
    }

    /// Returns the namespace of a host.
    ///
    /// # Errors
    /// [`Error::NoSuchHost`].
    pub fn namespace(&self, host: &NodeId) -> Result<&Namespace, Error> {
        let place = self.places.get(host).ok_or_else(|| Error::NoSuchHost(host.clone()))?;
        Ok(&self.hosts[*place])
    }

    /// Changes the conditions of one direction of a link in place. They apply when this returns.
    ///
    /// # Errors
    /// [`KernelNetworkError`]; then nothing has changed.
    ///
    /// # Panics
    /// If the graph has no such link.
    pub fn set(
        &self,
        link: &LinkId,
        direction: Direction,
        conditions: &Conditions,
    ) -> Result<(), KernelNetworkError> {
        let place = self.links.iter().position(|l| l == link).expect("the graph's own link");
        let (netem, needs_packets) = netem_of(link, conditions)?;
        if needs_packets {
            segment(&self.hosts)?;
        }
        let mut wires = self.wires.lock();
        let after = wires.ends[place][direction as usize].sharing.with_netem(netem);
        wires.change(place, direction, after)?;
        self.probes.change(place, direction, conditions);
        Ok(())
    }

    /// Replaces all reservations. Each direction of a link that has some is shared by HTB, with a class for the frames of each
    /// and one for all other frames. When a direction gets its first or loses its last one, the packets that wait there are
    /// lost.
    ///
    /// # Errors
    /// [`KernelNetworkError`]; then the reservations of the directions before the failed one have changed.
    pub fn reserve(&self, reserved: &[ReservedHop]) -> Result<(), KernelNetworkError> {
        if !reserved.is_empty() {
            segment(&self.hosts)?;
        }
        let mac = |host: &NodeId| self.places.get(host).map(|place| HostAddress::of(*place).mac);
        let mut wires = self.wires.lock();
        for (place, link) in self.links.iter().enumerate() {
            for direction in [Direction::Forward, Direction::Backward] {
                let here = |hop: &&ReservedHop| hop.link == *link && hop.direction == direction;
                let share = |hop: &ReservedHop| {
                    let Reservation { rate, is_limited } = hop.reservation;
                    Some(Share { from: mac(&hop.from)?, to: mac(&hop.to)?, rate, is_limited })
                };
                let shares: Vec<_> = reserved.iter().filter(here).filter_map(share).collect();
                let after = wires.ends[place][direction as usize].sharing.with_shares(&shares);
                wires.change(place, direction, after)?;
            }
        }
        Ok(())
    }

    /// Starts a throughput test of one direction of a link. [`Self::observe`] has the result a second after its last
    /// packet was sent.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown link, an unbounded test, or one too soon after another.
    pub fn test_throughput(
        &self,
        link: &LinkId,
        direction: Direction,
        test: ThroughputTest,
    ) -> Result<(), FabricError> {
        let place = self.links.iter().position(|l| l == link);
        let place = place.ok_or_else(|| FabricError::UnknownLink(link.clone()))?;
        self.probes.test_throughput((place, link), direction, test)
    }

    /// Returns the observations of each direction of each link.
    ///
    /// # Errors
    /// [`KernelNetworkError::Netem`].
    pub fn observe(&self) -> Result<HashMap<(LinkId, Direction), Observed>, KernelNetworkError> {
        let wires = self.wires.lock();
        let devices = wires.kernel.devices()?;
        let counted: HashMap<_, _> =
            devices.iter().map(|device| (device.interface().name.as_str(), device.leaving())).collect();
        let mut observed = HashMap::new();
        for (place, (link, measured)) in self.links.iter().zip(self.probes.measured()).enumerate() {
            for (direction, Measured { probed, tested }) in
                [Direction::Forward, Direction::Backward].into_iter().zip(measured)
            {
                let Some(counters) = counted.get(end(place, direction).as_str()) else { continue };
                let counters = *counters + wires.ends[place][direction as usize].gone;
                let counters = self.probes.other_traffic(place, direction, LinkCounters::from(counters));
                observed.insert((link.clone(), direction), Observed { counters, probed, tested });
            }
        }
        Ok(observed)
    }

    /// Returns by how much probes were later than requested, over links without jitter and reordering. A probe's wait
    /// behind other packets counts. The kernel reports nothing about the lateness of other packets.
    pub fn lateness(&self) -> Lateness {
        self.probes.lateness()
    }
}

impl Wires {
    /// Gives the next link its conditions.
    fn set_up(&mut self, link: usize, both: [Netem; 2]) -> Result<(), cotorra_netem::Error> {
        let ends = both.map(|netem| End { sharing: Sharing::new(netem), gone: Counters::default() });
        for (direction, of) in [Direction::Forward, Direction::Backward].into_iter().zip(&ends) {
            let device = self.kernel.device(&end(link, direction))?;
            self.kernel.apply(&of.sharing.set_up(device.interface()))?;
        }
        self.ends.push(ends);
        Ok(())
    }

    /// Changes the conditions and shares at an end of a link.
    fn change(
        &mut self,
        link: usize,
        direction: Direction,
        after: Sharing,
    ) -> Result<(), cotorra_netem::Error> {
        let (name, at) = (end(link, direction), &mut self.ends[link][direction as usize]);
        if at.sharing == after {
            return Ok(());
        }
        let device = self.kernel.device(&name)?;
        let plan = at.sharing.change_to(&after, device.interface());
        self.kernel.apply(&plan)?;
        at.sharing = after;
        if plan.loses_packets() {
            let (before, now) = (device.leaving(), self.kernel.device(&name)?.leaving());
            at.gone = at.gone + before.since(now);
        }
        Ok(())
    }
}

/// Makes hosts send packets one by one. NetEm would lose, delay or serialise a super-packet as a whole.
fn segment(hosts: &[Namespace]) -> Result<(), Error> {
    for host in hosts {
        let socket = host.udp_socket((Ipv4Addr::UNSPECIFIED, 0)).action("open a socket in a namespace")?;
        sys::restrict_offloads(socket.as_fd(), c"eth0", &["tx-checksum-ip-generic", "tx-scatter-gather"])
            .action("restrict the offloads of a virtual Ethernet pair")?;
    }
    Ok(())
}

/// Converts conditions, and returns whether they need packets one by one, as in the fabric.
fn netem_of(link: &LinkId, conditions: &Conditions) -> Result<(Netem, bool), KernelNetworkError> {
    const COARSE: u64 = 1_000_000_000;
    let netem = Netem::try_from(conditions)
        .map_err(|reason| KernelNetworkError::Setting { link: link.clone(), reason })?;
    let Conditions { loss, jitter, duplication, corruption, reordering, rate, .. } = conditions;
    let random = [duplication, corruption, reordering].into_iter().any(|p| *p != Probability::ZERO);
    let slow = matches!(rate, Rate::Fixed { bits_per_second } if bits_per_second.bits_per_second() < COARSE);
    Ok((
        netem,
        slow || random || *loss != Loss::None || jitter.is_some_and(|j: Jitter| !j.deviation.is_zero()),
    ))
}

/// Rejects links that close a circle.
fn check_tree(graph: &HardwareGraph, nodes: &HashMap<&NodeId, usize>) -> Result<(), KernelNetworkError> {
    let mut group: Vec<_> = (0..graph.nodes.len()).collect();
    for link in &graph.links {
        let [a, b] = link.ends.each_ref().map(|end| group[nodes[end]]);
        if a == b {
            return Err(KernelNetworkError::Circle(link.id.clone()));
        }
        group.iter_mut().filter(|g| **g == b).for_each(|g| *g = a);
    }
    Ok(())
}

/// Makes a host with an `eth0` whose other end is a port of its bridge.
fn attach_host(
    place: usize,
    port: u32,
    bridge: u32,
    wiring: &Namespace,
    neighbours: &Neighbours,
) -> Result<Namespace, Error> {
    let host = Namespace::new()?;
    host.run(|| {
        Netlink::open()?.execute(vec![netlink::veth("eth0", &format!("h{place}"), port, wiring.as_fd())])
    })
    .action("make a virtual Ethernet pair")?;
    wiring
        .run(|| Netlink::open()?.execute(vec![netlink::up_in_bridge(port, bridge)]))
        .action("set a port up")?;
    host.run(|| {
        let netlink = Netlink::open().action("open a netlink socket")?;
        hosts::configure(&netlink, hosts::PORT, place, neighbours)
    })?;
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
