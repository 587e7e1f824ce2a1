//! The fabric itself: takes frames from hosts, forwards them over links, switches and radio units, and hands them out
//! where and when they are due.

mod elsewhere;
mod lending;
mod link_ends;
mod observers;
mod paths;
mod sources;
mod taps;

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    AccessPoint, Attachment, ConditionChange, Conditions, Direction, HardwareGraph, HostAddress, Lateness,
    LinkContext, LinkId, LostCause, Node, NodeId, NodeKind, Position, Probing, RadioContext, Stamped,
    ThroughputTest, Timestamp,
};
use cotorra_numbers::Draws;

use crate::{
    balance::Balance,
    error::GraphError,
    flows::Flows,
    following::Following,
    frame::Frame,
    lateness::Histogram,
    link_tests::{LinkTests, ProbeTarget},
    pipe::{Packet, Pipe, Purpose},
    pool::Pool,
    port::PortId,
    port_security::{ForgedFrames, Identity},
    radio::{Airtime, Arrival, Path, Radio},
    routes::{Path as Pinned, Routes, Target, Vertex},
    settings::{FabricError, Settings},
    tap::Tap,
    timers::Timers,
    trace::DirectedLink,
};

pub use elsewhere::Departure;
pub use paths::{PinnedPath, Reservation};
pub use sources::ForgedSources;

/// Frames that the fabric could not forward.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Drops {
    /// Frames with an impossible offload (see [`crate::Malformed`]).
    pub malformed: u64,
    /// Frames to their own sender, or without a path to their destination.
    pub unroutable: u64,
}

/// Most addresses that are learnt. Frames to further ones go to all hosts.
const MOST_LEARNT: usize = 65_536;

/// The emulated network between hosts. See the [crate's documentation](crate) for how to drive it.
#[derive(Debug)]
pub struct Fabric {
    /// Latest time of any call.
    now: Timestamp,
    /// Those of hosts, then those of gateways.
    ports: Vec<Port>,
    hosts: usize,
    /// Vertices by name; they are nodes in the graph's order.
    vertices: HashMap<NodeId, usize>,
    port_of_vertex: Vec<Option<PortId>>,
    routes: Routes,
    /// Pinned paths by a frame's source and destination.
    pinned: HashMap<[PortId; 2], Arc<Pinned>>,
    links: Vec<LinkId>,
    link_by_name: HashMap<LinkId, usize>,
    /// Pipes by edge of the routes: forward and backward of each link in turn.
    pipes: Vec<Pipe>,
    timers: Timers,
    link_tests: LinkTests,
    radio: Radio,
    radio_deadline: Option<Timestamp>,
    arrivals: Vec<Arrival>,
    /// Addresses that hosts use besides their own.
    learnt: HashMap<[u8; 6], PortId>,
    /// Packets that have reached a vertex and leave it at once.
    pending: Vec<(usize, Frame, Target)>,
    /// Frames to hand out, with their due times.
    outbox: VecDeque<(Timestamp, PortId, Frame)>,
    /// Packets for other cores.
    departures: VecDeque<Departure>,
    pool: Pool,
    lateness: Histogram,
    drops: Drops,
    /// Packets of hosts that were sent, delivered and stranded.
    balance: Balance,
    /// `None` if no round trip is measured.
    observers: Option<Box<Observers>>,
    taps: Vec<Tap>,
}

/// Those who measure round trips.
#[derive(Debug, Default)]
struct Observers {
    flows: Flows,
    following: Following,
}

#[derive(Debug)]
struct Port {
    node: NodeId,
    vertex: usize,
    reach: Reach,
    sources: Sources,
}

/// A node's way into the wired network.
#[derive(Debug, Clone, Copy)]
enum Reach {
    /// It is on the wired network.
    Wire,
    /// It is on the wired network, with an antenna that another radio than the fabric's has. Robots can be behind it.
    LentUnit,
    Robot {
        by: ByAir,
        /// Vertex at which frames to the robot leave for the core that it is with.
        border: Option<usize>,
    },
}

/// A robot's way to a radio unit.
#[derive(Debug, Clone, Copy)]
enum ByAir {
    /// By the fabric's radio, over the radio unit that it is attached to.
    Attached,
    /// By another radio, which has its antenna.
    Lent {
        /// The radio unit's port at which it is reached.
        behind: Option<PortId>,
    },
}

/// Senders that frames from a port may name.
#[derive(Debug)]
enum Sources {
    /// All: gateways and real servers decide by themselves which frames pass.
    Any,
    /// The host.
    Own {
        identity: Identity,
        /// Whether frames with other sources are delivered all the same.
        others_pass: bool,
        /// Frames with other sources, so far.
        forged: ForgedFrames,
    },
}

impl Port {
    fn is_robot(&self) -> bool {
        matches!(self.reach, Reach::Robot { .. })
    }

    /// Returns the vertex at which frames to a robot leave for the core that it is with.
    fn border(&self) -> Option<usize> {
        if let Reach::Robot { border, .. } = self.reach { border } else { None }
    }

    fn set_border(&mut self, vertex: Option<usize>) {
        if let Reach::Robot { border, .. } = &mut self.reach {
            *border = vertex;
        }
    }

    /// Returns the radio unit's port at which a robot is reached whose antenna is lent.
    fn behind(&self) -> Option<PortId> {
        if let Reach::Robot { by: ByAir::Lent { behind }, .. } = self.reach { behind } else { None }
    }

    fn set_behind(&mut self, port: Option<PortId>) {
        if let Reach::Robot { by: ByAir::Lent { behind }, .. } = &mut self.reach {
            *behind = port;
        }
    }

    fn lend_antenna(&mut self) {
        match &mut self.reach {
            Reach::Wire | Reach::LentUnit => self.reach = Reach::LentUnit,
            Reach::Robot { by, .. } => *by = ByAir::Lent { behind: None },
        }
    }

    /// Returns what a host names as its sender; `None` for gateways and real servers.
    fn identity(&self) -> Option<Identity> {
        if let Sources::Own { identity, .. } = self.sources { Some(identity) } else { None }
    }
}

/// The next hop of a packet from a vertex.
#[derive(Debug, Clone, Copy)]
enum Hop {
    Edge(usize),
    /// Over the air, down to the station.
    Air,
    /// Out of the radio unit's port, to a station of another radio.
    Out,
    /// Over the border, to the core that the robot is with.
    Border,
}

impl Fabric {
    /// Creates an idle fabric at time zero. The same graph and seed, driven the same way, give the same bytes.
    ///
    /// # Errors
    /// [`GraphError`] for a graph that breaks the rules of testbed files.
    pub fn new(graph: &HardwareGraph, seed: u64) -> Result<Self, GraphError> {
        let hosts = graph.hosts().count();
        if hosts > HostAddress::MAX_HOSTS {
            return Err(GraphError::TooManyHosts(hosts));
        }
        let mut vertices = HashMap::new();
        for (i, node) in graph.nodes.iter().enumerate() {
            if vertices.insert(node.id.clone(), i).is_some() {
                return Err(GraphError::Duplicate(node.id.to_string()));
            }
        }
        let vertex = |node: &Node| Vertex { forwards: node.forwards(), has_port: node.has_port() };
        let mut routes = Routes::new(graph.nodes.iter().map(vertex).collect());
        let mut link_by_name = HashMap::new();
        let mut pipes = Vec::new();
        for (i, link) in graph.links.iter().enumerate() {
            if link_by_name.insert(link.id.clone(), i).is_some() {
                return Err(GraphError::Duplicate(link.id.to_string()));
            }
            let end = |node: &NodeId| {
                let unknown = || GraphError::UnknownEnd { link: link.id.clone(), node: node.clone() };
                let vertex = vertices.get(node).copied().ok_or_else(unknown)?;
                match graph.nodes[vertex].kind {
                    NodeKind::Robot(_) => {
                        Err(GraphError::WiredRobot { link: link.id.clone(), robot: node.clone() })
                    }
                    _ => Ok(vertex),
                }
            };
            let [a, b] = [end(&link.ends[0])?, end(&link.ends[1])?];
            let [forward, backward] = link.scales;
            for (from, to, conditions, scale, direction) in
                [(a, b, &link.forward, forward, "forward"), (b, a, &link.backward, backward, "backward")]
            {
                let settings = Settings::new(conditions.clone(), scale, link.medium())
                    .map_err(|error| GraphError::Conditions { link: link.id.to_string(), error })?;
                routes.connect(from, to, settings.effective().delay);
                let rng = |part: &str| Draws::new(seed, &format!("{part} {} {direction}", link.id));
                let link = DirectedLink::Wire(pipes.len());
                pipes.push(Pipe::new(link, settings, rng("link"), rng("queue")));
            }
        }
        let emulated = |place: usize, node: &Node| place < hosts && node.real_server().is_none();
        let port = |(place, node): (usize, &Node)| Port {
            node: node.id.clone(),
            vertex: vertices[&node.id],
            reach: match node.kind {
                NodeKind::Robot(_) => Reach::Robot { by: ByAir::Attached, border: None },
                _ => Reach::Wire,
            },
            sources: if emulated(place, node) {
                let identity = Identity::of(HostAddress::of(place));
                Sources::Own { identity, others_pass: false, forged: ForgedFrames::default() }
            } else {
                Sources::Any
            },
        };
        let ports: Vec<Port> = graph.ports().enumerate().map(port).collect();
        let mut port_of_vertex = vec![None; graph.nodes.len()];
        for (i, port) in ports.iter().enumerate() {
            port_of_vertex[port.vertex] = Some(PortId(i));
        }
        let radio = Radio::new(graph, seed)?;
        Ok(Self {
            now: Timestamp::ZERO,
            ports,
            hosts,
            vertices,
            port_of_vertex,
            routes,
            pinned: HashMap::new(),
            links: graph.links.iter().map(|l| l.id.clone()).collect(),
            link_by_name,
            timers: Timers::new(pipes.len()),
            link_tests: LinkTests::new(pipes.len()),
            pipes,
            radio_deadline: radio.deadline(),
            radio,
            arrivals: Vec::new(),
            learnt: HashMap::new(),
            pending: Vec::new(),
            outbox: VecDeque::new(),
            departures: VecDeque::new(),
            pool: Pool::default(),
            lateness: Histogram::default(),
            drops: Drops::default(),
            balance: Balance::default(),
            observers: None,
            taps: Vec::new(),
        })
    }

    /// Returns the port of a host or a gateway; `None` for a switch or an unknown name.
    pub fn port(&self, host: &NodeId) -> Option<PortId> {
        self.port_of_vertex[*self.vertices.get(host)?]
    }

    /// Returns the host or gateway at a port.
    pub fn host(&self, port: PortId) -> Option<&NodeId> {
        self.ports.get(port.0).map(|p| &p.node)
    }

    /// Sends a frame from a port. Call [`Self::poll`] after the last frame of a batch. A frame that does not name the host at
    /// the port as its sender is dropped, and in [`Self::forged_sources`] only.
    pub fn push(&mut self, now: Timestamp, port: PortId, mut frame: Frame) {
        let now = self.advance(now);
        if frame.check().is_err() {
            self.drops.malformed += 1;
            return self.pool.put(frame.into_bytes());
        }
        if port.0 >= self.ports.len() {
            if let Some(edge) = self.edge_from(port) {
                return self.push_at_end(now, edge, frame);
            }
            self.drops.unroutable += 1;
            return self.pool.put(frame.into_bytes());
        }
        let Port { vertex, reach, .. } = self.ports[port.0];
        let sender = if let Reach::LentUnit = reach { self.sender(port, &frame) } else { port };
        if !self.admits(port, sender, &frame) {
            return self.pool.put(frame.into_bytes());
        }
        self.balance.sent += u64::from(frame.wire_packets());
        if sender != port {
            self.ports[sender.0].set_behind(Some(port));
        }
        self.learn(sender, &frame);
        if self.observers.is_some() {
            self.observe_entry(now, sender, &mut frame);
        }
        let Some(target) = self.target(sender, vertex, &frame) else { return self.drop_unroutable(frame) };
        match reach {
            Reach::Robot { border: Some(_), .. } => {
                return self.depart_frame(port, Direction::Forward, frame);
            }
            Reach::Robot { border: None, .. } => {
                return self.on_air(frame, |radio, frame| radio.push_up(now, port, frame));
            }
            Reach::LentUnit if self.is_back(port, &target) => return self.drop_unroutable(frame),
            Reach::LentUnit | Reach::Wire => {}
        }
        self.leave(now, vertex, frame, target);
        self.settle(now);
    }

    /// Sends the frames of a source that makes one after the other, into buffers of the fabric. `next` returns a frame's port,
    /// or `None` once there is none for now.
    pub fn push_all(
        &mut self,
        now: Timestamp,
        mut next: impl FnMut(&mut Self, &mut Vec<u8>) -> Option<PortId>,
    ) {
        loop {
            let mut buffer = self.buffer(0);
            let Some(port) = next(self, &mut buffer) else { return self.pool.put(buffer) };
            self.push(now, port, Frame::new(buffer));
        }
    }

    /// Hands out every frame that is due, and returns the next deadline; `None` until another frame is pushed or
    /// something changes.
    ///
    /// A late poll changes nothing inside: frames move on as of their due times.
    pub fn poll(&mut self, now: Timestamp, deliver: &mut dyn FnMut(PortId, Frame)) -> Option<Timestamp> {
        let now = self.advance(now);
        while let Some((due, port, mut frame)) = self.outbox.pop_front() {
            self.lateness.record(now.since(due));
            self.balance.delivered += u64::from(frame.wire_packets());
            let Some(behind) = self.ports.get(port.0).map(Port::behind) else {
                deliver(port, frame);
                continue;
            };
            if self.observers.is_some() {
                self.observe_delivery(now, due, port, &mut frame);
            }
            deliver(behind.unwrap_or(port), frame);
        }
        if self.observers.is_some() {
            self.observe_drops();
            self.expire_requests(now);
        }
        let wired = self.timers.next().map(|(deadline, _)| deadline);
        let flows = self.observers.as_ref().and_then(|observers| observers.flows.deadline());
        let reports = self.radio.report_deadline();
        let air = self.radio.alarm();
        [wired, air, self.link_tests.deadline(), flows, reports].into_iter().flatten().min()
    }

    /// Returns the next event: [`cotorra_graph::Event::Handover`], `Detached` and `Scanned` of attachments, oldest first,
    /// then service times of flows.
    pub fn next_event(&mut self) -> Option<Stamped> {
        self.radio.next_event().or_else(|| self.observers.as_mut()?.flows.next_event())
    }

    /// Changes the conditions of a link, in one direction or both. Packets in flight stay in flight and in order. A lower
    /// delay brings them forward; a higher one leaves them. A new rate applies to the rest of the frame that is being sent.
    /// A shorter queue keeps its packets, and so does one with another discipline, which begins anew.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown link or impossible conditions. Nothing has changed then.
    pub fn change(
        &mut self,
        now: Timestamp,
        link: &LinkId,
        direction: Option<Direction>,
        change: &ConditionChange,
    ) -> Result<(), FabricError> {
        let now = self.advance(now);
        let Some(&index) = self.link_by_name.get(link) else {
            let changed = self.radio.change(now, link, direction, change);
            self.radio_deadline = self.radio.deadline();
            return changed;
        };
        let edges = match direction {
            None => 2 * index..2 * index + 2,
            Some(direction) => edge(index, direction)..edge(index, direction) + 1,
        };
        let changed = |edge: usize| self.pipes[edge].settings().changed(change).map(|s| (edge, s));
        for (edge, settings) in edges.map(changed).collect::<Result<Vec<_>, _>>()? {
            self.routes.set_delay(edge, settings.effective().delay);
            self.pipes[edge].change(now, settings, &mut self.pool);
            self.timers.set(edge, self.pipes[edge].deadline());
        }
        self.link_tests.change(index, effective(&self.pipes, index));
        Ok(())
    }

    /// Probes every wired link and each robot's present link from now on, in both directions (STAMP, RFC 8762). The probes
    /// are packets that cross links as others do, and are in no counter.
    pub fn probe_links(&mut self, now: Timestamp, settings: Probing) {
        let now = self.advance(now);
        let wires = (0..self.links.len()).map(|link| effective(&self.pipes, link));
        let radio = &self.radio;
        let stations = (0..radio.stations()).map(|robot| move |bytes: usize| radio.turns(robot, bytes));
        self.link_tests.probe(settings, now, wires, stations);
    }

    /// Starts a throughput test of one direction of a wired link. Its packets cross the link as others do, and are in no
    /// counter. The result is in the link's context a second after the last packet was sent.
    ///
    /// # Errors
    /// [`FabricError`] for a link that is not wired, a test beyond the bounds, or one too soon after another.
    pub fn test_throughput(
        &mut self,
        now: Timestamp,
        link: &LinkId,
        direction: Direction,
        test: ThroughputTest,
    ) -> Result<(), FabricError> {
        let now = self.advance(now);
        let Some(&index) = self.link_by_name.get(link) else {
            return Err(match self.radio.has_link(link) {
                true => FabricError::NotOnWireless("throughput test"),
                false => FabricError::UnknownLink(link.clone()),
            });
        };
        let edge = edge(index, direction);
        let rate = &self.pipes[edge].settings().effective().rate;
        self.link_tests.begin_test(now, (edge, link), test, rate)
    }

    /// Returns d, λ, conditions and counters of every link: wired ones in the graph's order, forward before backward, then
    /// wireless ones in use.
    pub fn link_contexts(&mut self, now: Timestamp) -> Vec<LinkContext> {
        let now = self.advance(now);
        let wired = self.links.iter().enumerate().flat_map(|(i, link)| {
            let probed = self.link_tests.probed(now, ProbeTarget::Wire(i));
            [Direction::Forward, Direction::Backward].map(|direction| {
                let edge = edge(i, direction);
                LinkContext {
                    probed: probed.map(|both| both[direction as usize]),
                    tested: self.link_tests.tested(now, edge),
                    ..self.pipes[edge].context(now, link.clone(), direction)
                }
            })
        });
        let mut contexts: Vec<_> = wired.collect();
        let on_air = |robot, unit| self.link_tests.probed(now, ProbeTarget::Air(robot, unit));
        contexts.extend(self.radio.link_contexts(now, on_air));
        contexts
    }

    /// Returns the scaled conditions of a wired link, forward and backward; `None` for an unknown link.
    pub fn effective(&self, link: &LinkId) -> Option<[&Conditions; 2]> {
        Some(effective(&self.pipes, *self.link_by_name.get(link)?))
    }

    /// Returns ι(R) of every radio unit.
    pub fn radio_contexts(&self, now: Timestamp) -> Vec<RadioContext> {
        self.radio.contexts(now)
    }

    /// Returns the time that each robot's radio spent on frames so far.
    pub fn airtimes(&self) -> BTreeMap<NodeId, Airtime> {
        self.radio.airtimes()
    }

    /// Returns φ(r,R) of a robot for every radio unit of its network; empty for an unknown robot.
    pub fn attachments(&self, now: Timestamp, robot: &NodeId) -> Vec<Attachment> {
        self.radio.attachments(now, robot)
    }

    /// Returns the radio unit that a robot is attached to.
    pub fn attached_to(&self, robot: &NodeId) -> Option<&NodeId> {
        let unit = self.radio.attached_to(self.port(robot)?)?;
        self.host(unit)
    }

    /// Moves a robot.
    ///
    /// # Errors
    /// [`FabricError::UnknownRobot`].
    pub fn move_robot(&mut self, now: Timestamp, robot: &NodeId, place: Position) -> Result<(), FabricError> {
        let now = self.advance(now);
        let done = self.radio.move_robot(now, robot, place);
        self.radio_deadline = self.radio.deadline();
        done
    }

    /// Makes a robot's radio leave its channel and scan all others. The event `Scanned` reports its return.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot or a busy radio.
    pub fn scan(&mut self, now: Timestamp, robot: &NodeId) -> Result<(), FabricError> {
        let now = self.advance(now);
        let done = self.radio.scan(now, robot);
        self.radio_deadline = self.radio.deadline();
        done
    }

    /// Hands a robot over to a radio unit. The event `Handover` reports the end. Does nothing if the robot is attached
    /// there.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot or radio unit, or one that the robot cannot attach to.
    pub fn attach(&mut self, now: Timestamp, robot: &NodeId, radio_unit: &NodeId) -> Result<(), FabricError> {
        let now = self.advance(now);
        let done = self.radio.attach(now, robot, radio_unit);
        self.radio_deadline = self.radio.deadline();
        if done.is_ok() {
            self.leave_border(robot);
        }
        done
    }

    /// Switches on a vAP on a radio unit.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown radio unit, one that serves already, or one made for another network.
    pub fn switch_on(
        &mut self,
        now: Timestamp,
        radio_unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<(), FabricError> {
        let now = self.advance(now);
        let done = self.radio.switch_on(now, radio_unit, access_point);
        self.radio_deadline = self.radio.deadline();
        done
    }

    /// Checks whether [`Self::switch_on`] would succeed now.
    ///
    /// # Errors
    /// Those of [`Self::switch_on`].
    pub fn check_switch_on(
        &self,
        radio_unit: &NodeId,
        access_point: &AccessPoint,
    ) -> Result<(), FabricError> {
        self.radio.check_switch_on(radio_unit, access_point)
    }

    /// Switches off a radio unit. Its stations lose it.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown radio unit, or one that is off.
    pub fn switch_off(&mut self, now: Timestamp, radio_unit: &NodeId) -> Result<(), FabricError> {
        let now = self.advance(now);
        let done = self.radio.switch_off(now, radio_unit);
        self.radio_deadline = self.radio.deadline();
        if done.is_ok() {
            self.forget_behind(radio_unit);
        }
        done
    }

    /// Gives a robot the credentials of another domain's vAP.
    ///
    /// # Errors
    /// [`FabricError`] for an unknown robot or radio unit.
    pub fn provision(
        &mut self,
        robot: &NodeId,
        radio_unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<(), FabricError> {
        self.radio.provision(robot, radio_unit, access_point)
    }

    /// Returns how late frames were handed out.
    pub fn lateness(&self) -> Lateness {
        self.lateness.summary()
    }

    /// Returns the frames that the fabric could not forward.
    pub fn drops(&self) -> Drops {
        self.drops
    }

    /// Returns the number of packets on wired links, counted as they are on the wire.
    pub fn in_flight(&self) -> u64 {
        self.pipes.iter().map(Pipe::in_flight).sum()
    }

    /// Returns the outcome of all packets that hosts sent.
    pub fn balance(&self) -> Balance {
        let mut balance = self.balance;
        self.pipes.iter().for_each(|pipe| balance += pipe.balance());
        balance += self.radio.balance();
        balance.under_way +=
            self.outbox.iter().map(|(.., frame)| u64::from(frame.wire_packets())).sum::<u64>();
        balance
    }

    /// Returns an empty buffer for a frame of `length` bytes, a recycled one if possible.
    pub fn buffer(&mut self, length: usize) -> Vec<u8> {
        self.pool.take(length)
    }

    /// Takes back the buffer of a delivered frame.
    pub fn recycle(&mut self, frame: Frame) {
        self.pool.put(frame.into_bytes());
    }

    /// Does everything due by `now`, in the order of due times.
    fn advance(&mut self, now: Timestamp) -> Timestamp {
        self.now = self.now.max(now);
        let now = self.now;
        loop {
            let wired = self.timers.next().filter(|(at, _)| *at <= now);
            let air = self.radio_deadline.filter(|at| *at <= now);
            let test = self.link_tests.deadline().filter(|at| *at <= now);
            match (wired, air, test) {
                (wired, air, Some(at))
                    if wired.is_none_or(|(wired, _)| at < wired) && air.is_none_or(|air| at < air) =>
                {
                    self.send_tests(at);
                }
                (Some((at, edge)), air, _) if air.is_none_or(|air| at < air) => self.poll_pipe(at, edge),
                (_, Some(at), _) => self.poll_radio(at),
                (..) => return now,
            }
        }
    }

    /// Sends the probe and the packet of a throughput test that are due.
    fn send_tests(&mut self, at: Timestamp) {
        let linked = |robot| self.radio.linked(robot);
        if let Some((target, frame)) = self.link_tests.poll_probe(at, linked, |length| self.pool.take(length))
        {
            self.send_probe(at, target, Direction::Forward, frame);
        }
        if let Some((edge, frame)) = self.link_tests.poll_test(at, |length| self.pool.take(length)) {
            self.cross(at, edge, Packet::new(frame, Purpose::ThroughputTest, at));
        }
        self.settle(at);
    }

    /// Sends a probe, or its answer.
    fn send_probe(&mut self, now: Timestamp, target: ProbeTarget, direction: Direction, frame: Frame) {
        match target {
            ProbeTarget::Wire(link) => {
                self.cross(now, edge(link, direction), Packet::new(frame, Purpose::Probe, now));
            }
            ProbeTarget::Air(robot, unit) => {
                self.radio.probe(now, Path { robot, unit, direction }, frame);
                self.radio_deadline = self.radio.deadline();
            }
        }
    }

    /// Handles a probe or its answer at the other end of the link.
    fn receive_probe(&mut self, now: Timestamp, target: ProbeTarget, direction: Direction, frame: Frame) {
        if let Some(answer) = self.link_tests.probe_crossed(now, (target, direction), frame) {
            self.send_probe(now, target, Direction::Backward, answer);
        }
    }

    /// Handles a packet that has crossed an edge. Probes turn back or end here; others move on.
    fn crossed(&mut self, now: Timestamp, edge: usize, mut packet: Packet) {
        if let Some(trace) = packet.frame.trace() {
            trace.crossed(DirectedLink::Wire(edge), [packet.entered, packet.began, now], Duration::ZERO);
        }
        if !self.taps.is_empty() && packet.counts() {
            self.show_wired(edge, [packet.entered, now], &packet.frame);
        }
        match packet.purpose {
            Purpose::Target(target) => self.pending.push((self.routes.end(edge), packet.frame, target)),
            Purpose::FromEndToEnd => self.deliver_at_end(now, edge, packet.frame),
            Purpose::ThroughputTest => {
                self.link_tests.test_crossed(now, edge);
                self.pool.put(packet.frame.into_bytes());
            }
            Purpose::Probe => {
                let direction = if edge.is_multiple_of(2) { Direction::Forward } else { Direction::Backward };
                self.receive_probe(now, ProbeTarget::Wire(edge / 2), direction, packet.frame);
            }
        }
    }

    fn poll_pipe(&mut self, at: Timestamp, edge: usize) {
        while let Some(packet) = self.pipes[edge].poll(at, &mut self.pool) {
            self.crossed(at, edge, packet);
            self.settle(at);
        }
        self.timers.set(edge, self.pipes[edge].deadline());
    }

    fn poll_radio(&mut self, at: Timestamp) {
        let mut arrivals = std::mem::take(&mut self.arrivals);
        self.radio_deadline = self.radio.poll(at, &mut self.pool, &mut arrivals);
        for arrival in arrivals.drain(..) {
            if !self.taps.is_empty() && !arrival.is_probe {
                self.show_air(&arrival);
            }
            let Arrival { due, from, at, frame, path: Path { robot, unit, direction }, is_probe, .. } =
                arrival;
            if is_probe {
                self.receive_probe(due, ProbeTarget::Air(robot, unit), direction, frame);
                continue;
            }
            let vertex = self.ports[at.0].vertex;
            if !self.routes.vertex(vertex).forwards {
                self.outbox.push_back((due, at, frame));
                continue;
            }
            match self.target(from, vertex, &frame) {
                Some(target) => self.pending.push((vertex, frame, target)),
                None => self.drop_unroutable(frame),
            }
            self.settle(due);
        }
        self.arrivals = arrivals;
    }

    /// Forwards all packets that move on at once.
    fn settle(&mut self, now: Timestamp) {
        while let Some((vertex, mut frame, target)) = self.pending.pop() {
            let here = self.port_of_vertex[vertex];
            match &target {
                Target::Port { port, .. } if here == Some(*port) => {
                    self.outbox.push_back((now, *port, frame));
                    continue;
                }
                Target::Port { port, .. } if self.ports[port.0].border() == Some(vertex) => {
                    self.depart_frame(*port, Direction::Backward, frame);
                    continue;
                }
                Target::Port { .. } => {}
                Target::All { source, .. } => {
                    self.depart_copies(vertex, *source, &frame);
                    if let Some(port) = here.filter(|port| port != source) {
                        let copy = frame.copy(&mut self.pool);
                        self.outbox.push_back((now, port, copy));
                    }
                }
            }
            if self.routes.vertex(vertex).forwards {
                self.leave(now, vertex, frame, target);
            } else {
                frame.end(None, LostCause::NoRoute);
                self.pool.discard(frame);
            }
        }
    }

    /// Forwards a packet from a vertex.
    fn leave(&mut self, now: Timestamp, vertex: usize, frame: Frame, target: Target) {
        let to = |frame, target| Packet::new(frame, Purpose::Target(target), now);
        match &target {
            Target::Port { port, along } => {
                let pinned = along.as_ref().and_then(|path| self.routes.along(path, vertex));
                if let Some(edge) = pinned {
                    return self.cross(now, edge, to(frame, target));
                }
                // The pinned path ends here. The robot may be elsewhere by now, and the way there may cross the path again.
                let port = *port;
                match self.hop(vertex, port) {
                    Some(Hop::Edge(edge)) => {
                        self.cross(now, edge, to(frame, Target::Port { port, along: None }));
                    }
                    Some(Hop::Air) => {
                        let unit = self.port_of_vertex[vertex].expect("only a radio unit has stations");
                        self.on_air(frame, |radio, frame| radio.push_down(now, unit, port, frame));
                    }
                    Some(Hop::Out) => self.outbox.push_back((now, port, frame)),
                    Some(Hop::Border) => self.depart_frame(port, Direction::Backward, frame),
                    None => self.drop_unroutable(frame),
                }
            }
            Target::All { tree, source } => {
                for edge in tree.branches(vertex) {
                    let copy = frame.copy(&mut self.pool);
                    self.cross(now, edge, to(copy, target.clone()));
                }
                match self.port_of_vertex[vertex] {
                    Some(unit) if self.routes.vertex(vertex).forwards => {
                        let source = *source;
                        self.on_air(frame, |radio, frame| radio.push_group(now, unit, source, frame));
                    }
                    _ => self.pool.put(frame.into_bytes()),
                }
            }
        }
    }

    fn cross(&mut self, now: Timestamp, edge: usize, packet: Packet) {
        match self.pipes[edge].push(now, packet, &mut self.pool) {
            Some(packet) => self.crossed(now, edge, packet),
            None => self.timers.set(edge, self.pipes[edge].deadline()),
        }
    }

    /// Gives a frame to the radio. Cuts super-packets, because the air carries single packets.
    fn on_air(&mut self, frame: Frame, mut push: impl FnMut(&mut Radio, Frame)) {
        frame
            .segment_with(&mut self.pool, |packet| push(&mut self.radio, packet))
            .expect("a frame's offload is checked where it enters the fabric");
        self.radio_deadline = self.radio.deadline();
    }

    /// Returns the next hop from a vertex towards a host.
    fn hop(&mut self, vertex: usize, to: PortId) -> Option<Hop> {
        let Port { vertex: own, reach, .. } = self.ports[to.0];
        let (end, last) = match reach {
            Reach::Wire | Reach::LentUnit => (own, None),
            Reach::Robot { border: Some(border), .. } => (border, Some(Hop::Border)),
            Reach::Robot { by: ByAir::Lent { behind }, border: None } => {
                (self.ports[behind?.0].vertex, Some(Hop::Out))
            }
            Reach::Robot { by: ByAir::Attached, border: None } => {
                (self.ports[self.radio.attached_to(to)?.0].vertex, Some(Hop::Air))
            }
        };
        match last {
            Some(last) if end == vertex => Some(last),
            _ => self.routes.step(vertex, end).map(Hop::Edge),
        }
    }

    /// Returns the target of a frame that enters the wired network at a vertex; `None` if its sender is its destination.
    fn target(&mut self, source: PortId, vertex: usize, frame: &Frame) -> Option<Target> {
        let to_all = |fabric: &mut Self| Target::All { tree: fabric.routes.tree(vertex), source };
        let destination = frame.destination()?;
        if destination[0] & GROUP != 0 {
            return Some(to_all(self));
        }
        match self.owner(destination) {
            Some(port) => (port != source)
                .then(|| Target::Port { port, along: self.pinned(source, port, vertex).cloned() }),
            None => Some(to_all(self)),
        }
    }

    /// Returns the host that uses an address.
    fn owner(&self, address: [u8; 6]) -> Option<PortId> {
        self.assigned(address).or_else(|| self.learnt.get(&address).copied())
    }

    /// Returns the host that an address was assigned to.
    fn assigned(&self, address: [u8; 6]) -> Option<PortId> {
        HostAddress::place_of(address).filter(|place| *place < self.hosts).map(PortId)
    }

    /// Records that an address is behind a port besides the host's own, as those of containers, of macvlan interfaces and
    /// of real machines are.
    fn learn(&mut self, port: PortId, frame: &Frame) {
        let Some(source) = frame.source() else { return };
        if source[0] & GROUP != 0 || self.assigned(source).is_some() {
            return;
        }
        if self.learnt.len() < MOST_LEARNT || self.learnt.contains_key(&source) {
            self.learnt.insert(source, port);
        }
    }

    fn drop_unroutable(&mut self, mut frame: Frame) {
        self.drops.unroutable += 1;
        self.balance.stranded += u64::from(frame.wire_packets());
        frame.end(None, LostCause::NoRoute);
        self.pool.discard(frame);
    }
}

/// The I/G bit in an address's first byte, which marks a group address (IEEE 802).
const GROUP: u8 = 0x01;

/// Returns the scaled conditions of both directions of a link.
fn effective(pipes: &[Pipe], link: usize) -> [&Conditions; 2] {
    [Direction::Forward, Direction::Backward]
        .map(|direction| pipes[edge(link, direction)].settings().effective())
}

/// Returns the edge of a link's direction.
fn edge(link: usize, direction: Direction) -> usize {
    2 * link + direction as usize
}
