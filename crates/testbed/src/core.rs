//! A testbed's core as a state machine without a clock or a socket: the three blocks, and what passes between them.
//! In real time a thread drives it; in virtual time anything can.

use std::{
    collections::{BTreeMap, VecDeque},
    net::SocketAddrV4,
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    Decision, Direction, Event, Instruction, LinkId, Node, NodeId, PluginId, Program, SensorId, Stamped,
    Testbed, Timestamp,
};
use cotorra_localization::trajectory::Errors;
use cotorra_network_control::{
    InstructionError, Network, NetworkControl, NetworkGone,
    vim::{Engine, Managed},
};
use cotorra_plugin::wire::Answer;
use cotorra_robot_middleware::{
    Datagram, Nonces, RobotDriver, RobotMiddleware, SensedData, SensedScan, Servers, SimulatedRobot,
};

use crate::{
    answerers::Answerer,
    domain::Domains,
    images::{self, Image},
    plugins::host::{Controlled, Fault},
    robots::RobotError,
    script::{Change, Script},
};

/// Who asks for what is scripted.
const SCHEDULE: &str = "schedule";

/// Where nobody listens (RFC 863).
const DISCARD: u16 = 9;

/// How often κ is collected.
const CONTEXT: Duration = Duration::from_millis(100);
/// How often ι, d and λ are.
const OBSERVATION: Duration = Duration::from_secs(1);

/// Where a port of a node is reached; `None` for a node without addresses.
fn address(testbed: &Testbed, node: &NodeId, port: u16) -> Option<SocketAddrV4> {
    testbed.graph.address(node).map(|address| SocketAddrV4::new(address.ipv4, port))
}

/// A testbed's core.
pub(crate) struct Core<N, E> {
    testbed: Arc<Testbed>,
    domains: Domains,
    middleware: RobotMiddleware,
    control: NetworkControl<N, E>,
    /// The navigation VNF of each robot.
    navigators: BTreeMap<NodeId, Answerer>,
    /// The localization VNF of each robot that has one.
    localizers: BTreeMap<NodeId, Answerer>,
    /// The VNFs to which images of cameras go.
    receivers: BTreeMap<(NodeId, SensorId), Answerer>,
    /// Large data that nobody has polled.
    data: VecDeque<SensedData>,
    /// Images that are to be sent.
    images: VecDeque<Image>,
    events: VecDeque<Stamped>,
    script: Script,
    next_context: Timestamp,
    next_observation: Timestamp,
    /// An attachment changed, and mappings with it.
    remaps: bool,
    /// Whether instances of VNFs may have changed since robots were given their servers.
    stale_servers: bool,
    /// Robots stand until everything that they need serves.
    begun: bool,
}

impl<N: Network, E: Engine> Core<N, E> {
    /// The core with the robots that `drive` makes.
    ///
    /// # Errors
    /// When a robot cannot be driven.
    pub(crate) fn new(
        testbed: Arc<Testbed>,
        seed: u64,
        nonces: Nonces,
        network: N,
        engine: E,
        script: Script,
        drive: impl FnMut(&Node, SimulatedRobot) -> Result<Box<dyn RobotDriver>, RobotError>,
    ) -> Result<Self, RobotError> {
        let of_robots = |program: Program| {
            let of_service = |service: &cotorra_graph::Service| {
                Some((service.robot.clone(), Answerer::of(&testbed, service, &program)?))
            };
            testbed.services.iter().filter_map(of_service).collect()
        };
        Ok(Self {
            middleware: RobotMiddleware::driven(&testbed, seed, CONTEXT, nonces, drive)?,
            control: NetworkControl::new(&testbed, network, engine),
            navigators: of_robots(Program::Navigation),
            localizers: of_robots(Program::Localization),
            receivers: images::receivers(&testbed),
            data: VecDeque::new(),
            images: VecDeque::new(),
            domains: Domains::new(&testbed),
            testbed,
            events: VecDeque::new(),
            script,
            next_context: Timestamp::ZERO,
            next_observation: Timestamp::ZERO,
            remaps: false,
            stale_servers: true,
            begun: false,
        })
    }

    /// Starts the VNFs.
    pub(crate) fn start(&mut self, now: Timestamp) {
        let events = self.control.start(now);
        self.tell(now, events);
    }

    /// Does what is due.
    pub(crate) fn advance(&mut self, now: Timestamp) -> Result<(), NetworkGone> {
        let events = self.control.poll(now)?;
        self.stale_servers |= !events.is_empty();
        self.tell(now, events);
        if std::mem::take(&mut self.remaps) {
            let events = self.control.remap()?;
            self.tell(now, events);
        }
        while let Some(change) = self.script.poll(now) {
            self.change(now, change);
        }
        self.begun |= self.control.all_ready();
        if self.begun {
            if now >= self.next_context {
                self.next_context = now + CONTEXT;
                self.locate(now)?;
            }
            if std::mem::take(&mut self.stale_servers) {
                self.set_servers();
            }
            self.middleware.advance(now);
            self.take_data();
        }
        if now >= self.next_observation {
            self.next_observation = now + OBSERVATION;
            let events = self.control.observe()?;
            self.tell(now, events);
        }
        Ok(())
    }

    /// Changes a link as the script says.
    fn change(&mut self, now: Timestamp, change: Change) {
        let schedule = PluginId::new(SCHEDULE).expect("it is a name");
        // A refusal is told with the decision.
        let _ = self.instruct(now, schedule, change.instruction(), Some(change.reason));
    }

    /// Tells the network where the robots are, and learns φ from it.
    fn locate(&mut self, now: Timestamp) -> Result<(), NetworkGone> {
        let places: Vec<_> =
            self.middleware.positions().map(|(robot, place)| (robot.clone(), place)).collect();
        for change in self.script.moved(&places) {
            self.change(now, change);
        }
        let robots: Vec<_> = places.iter().map(|(robot, _)| robot.clone()).collect();
        let attachments = self.control.locate(places)?;
        for (robot, attachments) in robots.iter().zip(attachments) {
            self.middleware.set_attachments(robot, attachments);
        }
        self.find_nearest()
    }

    /// Learns from the network which instances are near to robots, where that matters.
    fn find_nearest(&mut self) -> Result<(), NetworkGone> {
        let answerers =
            || self.navigators.iter().chain(&self.localizers).filter(|(_, of)| of.is_by_distance());
        let wanted: Vec<_> = answerers().map(|(robot, of)| (robot.clone(), of.vnf.clone())).collect();
        if wanted.is_empty() {
            return Ok(());
        }
        let nearest = self.control.by_distance(wanted)?;
        let answerers = self.navigators.values_mut().chain(self.localizers.values_mut());
        answerers
            .filter(|of| of.is_by_distance())
            .zip(nearest)
            .for_each(|(of, nearest)| of.nearest = nearest);
        self.stale_servers = true;
        Ok(())
    }

    /// Gives each robot the servers that its next packets go to.
    fn set_servers(&mut self) {
        let testbed = Arc::clone(&self.testbed);
        for (Node { id: robot, .. }, _) in testbed.graph.robots() {
            let servers = |of: &Answerer| -> Vec<_> {
                let socket = |node: NodeId| {
                    let address = address(&testbed, &node, of.port);
                    (node, address)
                };
                of.asked(&self.control).into_iter().map(socket).collect()
            };
            // Without a navigation VNF the robot talks to itself, and nobody answers.
            let itself = || vec![(robot.clone(), address(&testbed, robot, DISCARD))];
            let localization = self.localizers.get(robot).map(servers).unwrap_or_default();
            let servers = Servers {
                navigation: self.navigators.get(robot).map_or_else(itself, servers),
                localization: localization.into_iter().filter_map(|(_, address)| address).collect(),
            };
            self.middleware.set_servers(robot, servers);
        }
    }

    /// When [`Core::advance`] has something to do.
    pub(crate) fn next_deadline(&self) -> Timestamp {
        let by_itself = self.control.next_deadline().into_iter().chain(self.script.next_deadline());
        let control = by_itself.fold(self.next_observation, Timestamp::min);
        if self.begun { control.min(self.next_context).min(self.middleware.next_deadline()) } else { control }
    }

    /// The next datagram that a robot emits; its emission is `now`.
    pub(crate) fn poll_transmit(&mut self, now: Timestamp) -> Option<Datagram> {
        if self.begun { self.middleware.poll_transmit(now) } else { None }
    }

    /// Takes what sensors measured, and the images among it that go to VNFs.
    fn take_data(&mut self) {
        while let Some(sensed) = self.middleware.poll_data() {
            let receiver = self.receivers.get(&(sensed.robot.clone(), sensed.sensor.clone()));
            let node = receiver.and_then(|of| of.asked(&self.control).into_iter().next().zip(Some(of.port)));
            let to = node.and_then(|(node, port)| address(&self.testbed, &node, port));
            self.images.extend(to.map(|to| Image { to, sensed: sensed.clone() }));
            self.data.push_back(sensed);
        }
    }

    /// The next image that a robot sends to a VNF; after the datagrams of the same moment.
    pub(crate) fn poll_image(&mut self) -> Option<Image> {
        self.images.pop_front()
    }

    /// Returns every replica of every VNF with its instances, by the VNF's name.
    pub(crate) fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        self.control.managed()
    }

    /// What mappings reserve of each direction of a link, bit/s.
    pub(crate) fn reserved(&self) -> impl Iterator<Item = (&LinkId, Direction, f64)> {
        self.control.reserved()
    }

    /// A datagram arrived at a robot from this address.
    pub(crate) fn receive(&mut self, at: Timestamp, robot: &NodeId, from: SocketAddrV4, bytes: &[u8]) {
        match Answer::decode(bytes) {
            Ok(Answer::Navigation(packet)) => self.middleware.receive(at, robot, from, &packet),
            Ok(Answer::Pose(packet)) => self.middleware.localized(at, robot, from, &packet),
            Err(error) => {
                tracing::debug!("{robot} received something else: {error}");
                self.middleware.reject(robot);
            }
        }
    }

    /// How far off localization was, of each robot that a VNF localizes and whose place is known.
    pub(crate) fn localization_errors(&self) -> impl Iterator<Item = (&NodeId, &Errors)> {
        self.middleware.localization_errors()
    }

    /// Something happened in the network.
    pub(crate) fn observe(&mut self, event: Stamped) {
        if let Event::Handover(_) | Event::Detached { .. } | Event::Scanned { .. } = event.event {
            // φ changed, or signals are fresh: learnt now, so that the next κ has them.
            self.next_context = Timestamp::ZERO;
            self.remaps = true;
        }
        self.events.push_back(event);
    }

    /// Whether every walk is done; never where there is none.
    pub(crate) fn is_finished(&self) -> bool {
        self.middleware.finished()
    }

    /// What happened, oldest first.
    pub(crate) fn poll_event(&mut self) -> Option<Stamped> {
        self.events.pop_front().or_else(|| self.middleware.poll_event())
    }

    /// From now on scans are to be polled; for whoever records or watches.
    pub(crate) fn tap_scans(&mut self) {
        self.middleware.tap_scans();
    }

    /// A scan that was completed, oldest first.
    pub(crate) fn poll_scan(&mut self) -> Option<SensedScan> {
        self.middleware.poll_scan()
    }

    /// Large data that a sensor measured, oldest first. It is kept until it is taken, as events are.
    pub(crate) fn poll_data(&mut self) -> Option<SensedData> {
        self.data.pop_front()
    }

    /// What is to be told of services' flows at the end.
    pub(crate) fn flow_remarks(&self, at: Timestamp) -> Vec<Stamped> {
        let remarks = self.control.flow_remarks().unwrap_or_default();
        remarks.into_iter().map(|event| Stamped { at, event }).collect()
    }

    /// The end: what the network knows is told once more, and VNFs are stopped.
    pub(crate) fn shut_down(&mut self, now: Timestamp) {
        let remarks = self.flow_remarks(now);
        self.events.extend(remarks);
        if let Ok(events) = self.control.observe() {
            self.tell(now, events);
        }
        self.control.shut_down();
    }

    fn tell(&mut self, at: Timestamp, events: Vec<Event>) {
        self.events.extend(events.into_iter().map(|event| Stamped { at, event }));
    }
}

impl<N: Network, E: Engine> Controlled for Core<N, E> {
    fn instruct(
        &mut self,
        now: Timestamp,
        plugin: PluginId,
        instruction: Instruction,
        reason: Option<String>,
    ) -> Result<(), InstructionError> {
        let own = self.domains.of_plugin(&plugin).map_or(Ok(()), |view| view.check(&instruction));
        let done = match &instruction {
            _ if own.is_err() => {
                own.map(|()| Vec::new()).map_err(|reason| InstructionError(reason.to_string()))
            }
            Instruction::Move { robot, velocity, waypoint } => {
                let moved = self.middleware.instruct(now, robot, *velocity, *waypoint);
                moved.map(|()| Vec::new()).map_err(|refused| InstructionError(refused.to_string()))
            }
            Instruction::LimitSpeed { robot, speed_limit_mps } => {
                let done = self.middleware.limit_speed(now, robot, *speed_limit_mps);
                done.map(|()| Vec::new()).map_err(|refused| InstructionError(refused.to_string()))
            }
            Instruction::NavigateTo { robot, goal } => {
                let done = self.middleware.navigate_to(now, robot, *goal);
                done.map(|()| Vec::new()).map_err(|refused| InstructionError(refused.to_string()))
            }
            Instruction::Report { robot, sensor, values } => {
                let done = self.middleware.report(now, robot, sensor, values);
                done.map(|()| Vec::new()).map_err(|refused| InstructionError(refused.to_string()))
            }
            Instruction::Halt { robot } | Instruction::Go { robot } => {
                let halted = matches!(instruction, Instruction::Halt { .. });
                let done = self.middleware.halt(now, robot, halted);
                done.map(|()| Vec::new()).map_err(|refused| InstructionError(refused.to_string()))
            }
            _ => {
                self.stale_servers = true;
                self.control.instruct(now, &instruction)
            }
        };
        let refused = done.as_ref().err().map(ToString::to_string);
        let instruction = instruction.public();
        let decision = Event::Decision(Decision { plugin, instruction, reason, refused });
        self.tell(now, vec![decision]);
        self.tell(now, done?);
        Ok(())
    }

    fn cut_off(&mut self, now: Timestamp, plugin: PluginId, fault: &Fault, robots: &[NodeId]) {
        for robot in robots {
            self.middleware.stop(now, robot);
        }
        self.tell(now, vec![Event::PluginFault { plugin, reason: fault.to_string() }]);
    }
}
