//! A testbed's core: the robot middleware, the network and the plug-ins' instructions, connected to each other.
//!
//! It is a state machine without a clock or sockets. A thread drives it in real time, and a simulation in virtual time.

mod answerers;
pub(crate) mod images;
pub(crate) mod message;
mod policies;
mod progress;
pub(crate) mod script;
mod trips;

use std::{
    collections::{BTreeMap, VecDeque},
    net::SocketAddrV4,
    sync::Arc,
    time::Duration,
};

use cotorra_engine::{Engine, InstanceWaits};
use cotorra_graph::{
    Direction, Event, Instruction, LinkId, Node, NodeId, PluginId, Program, RobotContext, SensorId, Stamped,
    Testbed, Timestamp, VnfEvent, VnfId, VnfState,
};
use cotorra_ledger::tunnel::TunnelId;
use cotorra_localization::trajectory::Errors;
use cotorra_network_control::{
    InstructionError, Network, NetworkControl, NetworkGone,
    vim::{Managed, Stage},
};
use cotorra_plugin::wire::Answer;
use cotorra_robot_middleware::{
    Datagram, Nonces, RobotDriver, RobotMiddleware, SensedData, SensedScan, Servers, SimulatedRobot,
};
use cotorra_testbed_file::SCHEDULE;

pub(crate) use self::policies::Observation;
use self::{
    answerers::Answerer,
    images::Image,
    policies::Policies,
    progress::Progress,
    script::{Change, Script},
    trips::Trips,
};
use crate::{
    border::{self, Border},
    computed::ComputedSoFar,
    domain::Domains,
    followed::PolicyFollowed,
    given::Given,
    plugins::host::{Controlled, Fault},
    real::robots::RobotError,
};

/// The discard port, at which no program listens (RFC 863).
const DISCARD: u16 = 9;

/// Interval of ι, d and λ.
const OBSERVATION: Duration = Duration::from_secs(1);

/// Returns the socket of a node's port; `None` for a node without an address.
fn address(testbed: &Testbed, node: &NodeId, port: u16) -> Option<SocketAddrV4> {
    testbed.graph.ipv4(node).map(|address| SocketAddrV4::new(address, port))
}

pub(crate) struct Core<N, E> {
    testbed: Arc<Testbed>,
    domains: Domains,
    middleware: RobotMiddleware,
    control: NetworkControl<N, E>,
    /// Meeting point with other cores, in real time only.
    border: Option<Border>,
    /// Navigation VNF of each robot.
    navigators: BTreeMap<NodeId, Answerer>,
    /// Localization VNF of each robot that has one.
    localizers: BTreeMap<NodeId, Answerer>,
    /// Round trips of position packets and scans.
    trips: Trips,
    /// VNF that each camera's images go to.
    receivers: BTreeMap<(NodeId, SensorId), Answerer>,
    /// Large data to poll.
    data: VecDeque<SensedData>,
    /// Images to send.
    images: VecDeque<Image>,
    /// Robots that follow models.
    policies: Policies,
    /// Observations to send.
    observations: VecDeque<Observation>,
    events: VecDeque<Stamped>,
    script: Script,
    next_context: Timestamp,
    next_observation: Timestamp,
    /// Whether an attachment has changed, so that mappings are to be updated.
    remaps: bool,
    /// Whether instances of VNFs may have changed since robots were given their servers.
    stale_servers: bool,
    /// Whether all VNFs have served. Robots stand still until then.
    begun: bool,
    /// Whether a VNF could not start, or ended by itself, before all have served.
    has_failed_start: bool,
    progress: Progress,
}

impl<N: Network, E: Engine> Core<N, E> {
    /// Creates the core with the robots that `drive` makes.
    ///
    /// # Errors
    /// [`RobotError`] if a robot cannot be driven.
    pub(crate) fn new(
        testbed: Arc<Testbed>,
        seed: u64,
        nonces: Nonces,
        network: N,
        engine: E,
        script: Script,
        drive: impl FnMut(&Node, SimulatedRobot) -> Result<Box<dyn RobotDriver>, RobotError>,
    ) -> Result<Self, RobotError> {
        let of_robots = |program: Program| -> BTreeMap<NodeId, Answerer> {
            let of_service = |service: &cotorra_graph::Service| {
                Some((service.robot.clone(), Answerer::of(&testbed, service, &program)?))
            };
            // A robot uses its first service of a kind.
            testbed.services.iter().rev().filter_map(of_service).collect()
        };
        let (navigators, localizers) = (of_robots(Program::Navigation), of_robots(Program::Localization));
        let ports = navigators.iter().chain(&localizers).map(|(robot, of)| (robot.clone(), of.port));
        Ok(Self {
            trips: Trips::follow(&network, ports),
            middleware: RobotMiddleware::driven(&testbed, seed, RobotContext::INTERVAL, nonces, drive)?,
            control: NetworkControl::new(&testbed, network, engine),
            border: None,
            navigators,
            localizers,
            receivers: images::receivers(&testbed),
            data: VecDeque::new(),
            images: VecDeque::new(),
            policies: Policies::default(),
            observations: VecDeque::new(),
            domains: Domains::new(&testbed),
            testbed,
            events: VecDeque::new(),
            script,
            next_context: Timestamp::ZERO,
            next_observation: Timestamp::ZERO,
            remaps: false,
            stale_servers: true,
            begun: false,
            has_failed_start: false,
            progress: Progress::default(),
        })
    }

    /// Lets robots visit other cores, and those of others this one.
    pub(crate) fn open_border(&mut self, border: Border) {
        self.border = Some(border);
    }

    /// Starts the VNFs.
    pub(crate) fn start(&mut self, now: Timestamp) {
        let events = self.control.start(now);
        self.report(now, events);
    }

    /// Does everything that is due.
    pub(crate) fn advance(&mut self, now: Timestamp) -> Result<(), NetworkGone> {
        let events = self.control.poll(now)?;
        self.stale_servers |= !events.is_empty();
        let is_failure = |event: &Event| {
            matches!(event, Event::Vnf(VnfEvent { state: VnfState::Died | VnfState::Failed, .. }))
        };
        self.has_failed_start |= !self.begun && events.iter().any(is_failure);
        self.report(now, events);
        if std::mem::take(&mut self.remaps) {
            let events = self.control.remap()?;
            self.report(now, events);
        }
        while let Some(change) = self.script.poll(now) {
            self.change(now, change);
        }
        if !self.begun && self.control.all_ready() {
            self.begun = true;
            self.policies = Policies::new(&self.testbed, now);
            self.progress.excuse(now);
        }
        if self.begun {
            if now >= self.next_context {
                self.next_context = now + RobotContext::INTERVAL;
                self.locate(now)?;
            }
            if std::mem::take(&mut self.stale_servers) {
                self.set_servers();
            }
            self.middleware.advance(now);
            for (nonce, sample) in self.middleware.given_up() {
                self.trips.explain(nonce, sample);
            }
            self.take_data();
            self.follow(now);
        }
        if now >= self.next_observation {
            self.next_observation = now + OBSERVATION;
            self.note_progress(now);
            let events = self.control.observe()?;
            self.report(now, events);
        }
        Ok(())
    }

    /// Lets robots follow models, and queues their observations.
    fn follow(&mut self, now: Timestamp) {
        let Self { policies, control, middleware, testbed, .. } = self;
        let asked = |of: &Answerer| of.asked(control);
        let radio_unit = |robot: &NodeId| middleware.radio_unit(robot).cloned();
        self.observations.extend(policies.advance(now, testbed, asked, radio_unit));
        self.events.extend(policies.samples());
    }

    /// Notes where robots on walks are.
    fn note_progress(&mut self, now: Timestamp) {
        let walks = self.testbed.walks.iter();
        let walkers = walks.filter_map(|walk| self.middleware.walker(&walk.robot)).collect();
        self.progress.note(now, walkers);
        if self.script.next_deadline().is_some() {
            // The next change may be what robots wait for.
            self.progress.excuse(now);
        }
    }

    /// Applies a scripted change.
    fn change(&mut self, now: Timestamp, change: Change) {
        let plugin = PluginId::new(SCHEDULE).expect("it is a name");
        let (instruction, reason) = (change.instruction(), Some(change.reason));
        // The decision reports a rejection.
        let _ = self.instruct(now, Given { plugin, instruction, reason });
    }

    /// Passes the robots' positions to the network, and φ from there to the middleware.
    fn locate(&mut self, now: Timestamp) -> Result<(), NetworkGone> {
        let places: Vec<_> =
            self.middleware.positions().map(|(robot, place)| (robot.clone(), place)).collect();
        for change in self.script.moved(&places) {
            self.change(now, change);
        }
        let robots: Vec<_> = places.iter().map(|(robot, _)| robot.clone()).collect();
        let attachments = self.control.locate(places.clone())?;
        if let Some(border) = &mut self.border {
            let events = border.tick(now, &places, &mut self.control);
            self.report(now, events);
        }
        for (robot, mut attachments) in robots.iter().zip(attachments) {
            if let Some(border) = &self.border {
                border.complete(now, robot, &mut attachments);
            }
            self.middleware.set_attachments(robot, attachments);
        }
        self.find_nearest()
    }

    /// Sorts instances by their distance from each robot, for services that ask the nearest.
    fn find_nearest(&mut self) -> Result<(), NetworkGone> {
        let Self { navigators, localizers, policies, control, .. } = self;
        let answerers = navigators.iter_mut().chain(localizers).chain(policies.answerers());
        let answerers: Vec<_> = answerers.filter(|(_, of)| of.is_by_distance()).collect();
        if answerers.is_empty() {
            return Ok(());
        }
        let wanted = answerers.iter().map(|(robot, of)| ((*robot).clone(), of.vnf.clone())).collect();
        let nearest = control.by_distance(wanted)?;
        answerers.into_iter().zip(nearest).for_each(|((_, of), nearest)| of.nearest = nearest);
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
            // Without a VNF the robot sends to itself, and gets no answer.
            let itself = || vec![(robot.clone(), address(&testbed, robot, DISCARD))];
            let servers = Servers {
                navigation: self.navigators.get(robot).map_or_else(itself, servers),
                localization: self.localizers.get(robot).map_or_else(itself, servers),
            };
            self.middleware.set_servers(robot, servers);
        }
    }

    /// Returns the time at which [`Core::advance`] has something to do.
    pub(crate) fn next_deadline(&self) -> Timestamp {
        let by_itself = self.control.next_deadline().into_iter().chain(self.script.next_deadline());
        let control = by_itself.fold(self.next_observation, Timestamp::min);
        if !self.begun {
            return control;
        }
        let robots = [self.next_context, self.middleware.next_deadline()];
        robots.into_iter().chain(self.policies.deadline()).fold(control, Timestamp::min)
    }

    /// Returns the next datagram that a robot sends at `now`.
    pub(crate) fn poll_transmit(&mut self, now: Timestamp) -> Option<Datagram> {
        if self.begun { self.middleware.poll_transmit(now) } else { None }
    }

    /// Takes large data of sensors, and queues its images that go to VNFs.
    fn take_data(&mut self) {
        while let Some(sensed) = self.middleware.poll_data() {
            let receiver = self.receivers.get(&(sensed.robot.clone(), sensed.sensor.clone()));
            let node = receiver.and_then(|of| of.asked(&self.control).into_iter().next().zip(Some(of.port)));
            let to = node.and_then(|(node, port)| address(&self.testbed, &node, port));
            self.images.extend(to.map(|to| Image { to, sensed: sensed.clone() }));
            self.data.push_back(sensed);
        }
    }

    /// Returns the next image that a robot sends to a VNF. Poll datagrams of the same moment first.
    pub(crate) fn poll_image(&mut self) -> Option<Image> {
        self.images.pop_front()
    }

    /// Returns the next observation that a robot sends to a model, in virtual time only.
    pub(crate) fn poll_observation(&mut self) -> Option<Observation> {
        self.observations.pop_front()
    }

    /// Takes a datagram of a model that came from a node to a robot.
    pub(crate) fn receive_chunk(&mut self, now: Timestamp, robot: &NodeId, from: &NodeId, bytes: &[u8]) {
        self.policies.receive(now, robot, from, bytes);
        self.events.extend(self.policies.samples());
    }

    /// Returns what robots followed of models so far.
    pub(crate) fn followed(&self, now: Timestamp) -> Vec<PolicyFollowed> {
        self.policies.followed(now)
    }

    /// Returns every replica of every VNF with its instances, by the VNF's name.
    pub(crate) fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        self.control.managed()
    }

    /// Returns the rate that mappings reserve of each direction of a link, bit/s.
    pub(crate) fn reserved(&self) -> impl Iterator<Item = (&LinkId, Direction, f64)> {
        self.control.reserved()
    }

    /// Receives a datagram at a robot.
    pub(crate) fn receive(&mut self, at: Timestamp, robot: &NodeId, from: SocketAddrV4, bytes: &[u8]) {
        let (nonce, sample) = match Answer::decode(bytes) {
            Ok(Answer::Navigation(packet)) => {
                (packet.nonce, self.middleware.receive(at, robot, from, &packet))
            }
            Ok(Answer::Pose(packet)) => (packet.nonce, self.middleware.localized(at, robot, from, &packet)),
            Err(error) => {
                tracing::debug!("robot {robot} received a datagram that is not an answer: {error}");
                return self.middleware.reject(robot);
            }
        };
        if let Some(sample) = sample {
            self.trips.split(nonce, sample);
        }
    }

    /// Returns the errors of localization, of each robot that a VNF localizes and whose true pose is known.
    pub(crate) fn localization_errors(&self) -> impl Iterator<Item = (&NodeId, &Errors)> {
        self.middleware.localization_errors()
    }

    /// Takes an event of the network.
    pub(crate) fn observe(&mut self, event: Stamped) {
        if let Event::Handover(_) | Event::Detached { .. } | Event::Scanned { .. } = event.event {
            // φ or signals have changed: the next κ is to have them.
            self.next_context = Timestamp::ZERO;
            self.remaps = true;
        }
        if let Some(border) = &mut self.border {
            border.observe(&event.event);
        }
        self.events.push_back(event);
    }

    /// Takes what another core told.
    pub(crate) fn hear(&mut self, now: Timestamp, tunnel: TunnelId) {
        let Some(border) = &mut self.border else { return };
        for event in border.hear(now, tunnel, &mut self.control) {
            self.observe(Stamped { at: now, event });
        }
    }

    /// Whether every walk is done; false without walks.
    pub(crate) fn is_finished(&self) -> bool {
        self.middleware.finished()
    }

    /// Whether no robot has made progress on its walk for 60 s; false without walks.
    pub(crate) fn is_stuck(&self, now: Timestamp) -> bool {
        let starting = !self.begun && !self.has_failed_start;
        !self.testbed.walks.is_empty() && self.progress.is_over(now, starting)
    }

    /// Describes where robots stand that do not walk on, and what they wait for.
    pub(crate) fn stand(&self) -> String {
        let waypoints = |robot: &NodeId| self.testbed.walk(robot).map_or(0, |walk| walk.waypoints.len());
        let stand = self.progress.describe(waypoints);
        let serves =
            |replica: &Managed<'_>| replica.instances.iter().any(|(.., stage)| *stage == Stage::Serving);
        let mut absent = self.control.managed().filter(|replica| !self.begun && !serves(replica));
        match absent.next() {
            None => stand,
            Some(Managed { vnf, .. }) => {
                format!("the robots wait for the VNF `{}`, which does not serve: {stand}", vnf.id)
            }
        }
    }

    /// Returns the next event, oldest first.
    pub(crate) fn poll_event(&mut self) -> Option<Stamped> {
        self.events.pop_front().or_else(|| self.middleware.poll_event())
    }

    /// Keeps scans from now on for [`Self::poll_scan`].
    pub(crate) fn tap_scans(&mut self) {
        self.middleware.tap_scans();
    }

    /// Returns the next completed scan, oldest first.
    pub(crate) fn poll_scan(&mut self) -> Option<SensedScan> {
        self.middleware.poll_scan()
    }

    /// Returns the next large data of sensors, oldest first. Like events, it is kept until it is polled.
    pub(crate) fn poll_data(&mut self) -> Option<SensedData> {
        self.data.pop_front()
    }

    /// Returns the final notices of services' flows.
    pub(crate) fn flow_remarks(&self, at: Timestamp) -> Vec<Stamped> {
        let remarks = self.control.flow_remarks().unwrap_or_default();
        remarks.into_iter().map(|event| Stamped { at, event }).collect()
    }

    /// Returns for how long instances of VNFs have waited for a processor so far, as far as the engine knows.
    pub(crate) fn processor_waits(&self) -> Vec<InstanceWaits> {
        self.control.processor_waits()
    }

    /// Returns what VNFs with demands have computed so far, as far as the engine knows.
    pub(crate) fn computed(&self) -> ComputedSoFar {
        ComputedSoFar::measured(&self.testbed, self.control.computed())
    }

    /// Reports the state of the network once more, and stops all VNFs.
    pub(crate) fn shut_down(&mut self, now: Timestamp) {
        self.middleware.finish(now);
        let remarks = self.flow_remarks(now);
        self.events.extend(remarks);
        if let Ok(events) = self.control.observe() {
            self.report(now, events);
        }
        self.control.shut_down();
    }

    fn report(&mut self, at: Timestamp, events: Vec<Event>) {
        self.events.extend(events.into_iter().map(|event| Stamped { at, event }));
    }
}

impl<N: Network, E: Engine> Controlled for Core<N, E> {
    fn instruct(&mut self, now: Timestamp, given: Given) -> Result<(), InstructionError> {
        let added = |vnf: &VnfId| Some(self.control.nodes_of_added(vnf)?.cloned().collect());
        let Given { plugin, instruction, .. } = &given;
        let own = self.domains.of_plugin(plugin).map_or(Ok(()), |view| view.check(instruction, added));
        let done = match instruction {
            _ if own.is_err() => {
                own.map(|()| Vec::new()).map_err(|reason| InstructionError(reason.to_string()))
            }
            Instruction::Move { robot, velocity, waypoint } => {
                let moved = self.middleware.instruct(now, robot, *velocity, *waypoint);
                moved.map(|()| Vec::new()).map_err(|error| InstructionError(error.to_string()))
            }
            Instruction::LimitSpeed { robot, speed_limit_mps } => {
                let done = self.middleware.limit_speed(now, robot, *speed_limit_mps);
                done.map(|()| Vec::new()).map_err(|error| InstructionError(error.to_string()))
            }
            Instruction::NavigateTo { robot, goal } => {
                let done = self.middleware.navigate_to(now, robot, *goal);
                done.map(|()| Vec::new()).map_err(|error| InstructionError(error.to_string()))
            }
            Instruction::Report { robot, sensor, values } => {
                let done = self.middleware.report(now, robot, sensor, values);
                done.map(|()| Vec::new()).map_err(|error| InstructionError(error.to_string()))
            }
            Instruction::Halt { robot } | Instruction::Go { robot } => {
                let halted = matches!(instruction, Instruction::Halt { .. });
                let done = self.middleware.halt(now, robot, halted);
                done.map(|()| Vec::new()).map_err(|error| InstructionError(error.to_string()))
            }
            _ => {
                self.stale_servers = true;
                border::instruct(self.border.as_mut(), now, instruction, &mut self.control)
            }
        };
        if done.is_ok() && matches!(instruction, Instruction::Deploy { .. } | Instruction::Provision { .. }) {
            // Robots may wait for an access point.
            self.progress.excuse(now);
        }
        let refused = done.as_ref().err().map(ToString::to_string);
        let given = Given { instruction: instruction.public(), ..given };
        self.report(now, vec![given.decided(refused)]);
        self.report(now, done?);
        Ok(())
    }

    fn cut_off(&mut self, now: Timestamp, plugin: PluginId, fault: &Fault, robots: &[NodeId]) {
        for robot in robots {
            self.middleware.stop(now, robot);
        }
        self.report(now, vec![Event::PluginFault { plugin, reason: fault.to_string() }]);
    }

    fn publish(&mut self, event: Stamped) {
        self.observe(event);
    }
}

#[cfg(test)]
mod tests;
