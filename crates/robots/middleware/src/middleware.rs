//! The Robot Middleware itself: all robots by name.
//!
//! It builds κ at its interval, sends position packets and scans, takes answers, passes instructions to drivers, and
//! reports events.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    net::SocketAddrV4,
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    AnswersRejected, Attachment, Event, GoalState, Node, NodeId, NodeKind, OccupancyGrid, Position, Program,
    RobotContext, RobotFault, RobotModel, SensorData, SensorId, Service, ServiceTime, Stamped, Testbed,
    Timestamp, Velocity,
};
use cotorra_localization::{believed, planar, trajectory::Errors};
use cotorra_numbers::Draws;
use cotorra_plugin::wire::{NavigationPacket, PosePacket};

use crate::{
    answer_error::AnswerError,
    beat::beat,
    driver::{CommandError, RobotDriver, slowed},
    exchange::Route,
    large::SensedData,
    lidar::Scan,
    localization::LocalizationEndpoint,
    nonce::Nonces,
    request::{Datagram, Servers},
    sensing::{ReportError, Sensing},
    service::ServiceEndpoint,
    simulated::{SimulatedRobot, SimulationError},
    world::World,
};

/// Largest coordinate of a goal, metres.
const FARTHEST: f64 = 1e6;
/// Shortest interval between two reports of rejected answers.
const REJECTIONS: Duration = Duration::from_secs(1);

/// The reason for which an instruction to a robot is rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MoveError {
    /// The testbed has no such robot.
    #[error("there is no robot `{0}`")]
    UnknownRobot(NodeId),
    /// The walk has no such waypoint.
    #[error("the walk of robot `{robot}` has no waypoint {waypoint}")]
    UnknownWaypoint {
        /// The robot.
        robot: NodeId,
        /// The waypoint.
        waypoint: u32,
    },
    /// The robot is halted.
    #[error("robot `{0}` is halted: let it go first")]
    Halted(NodeId),
    /// No navigation VNF serves the robot.
    #[error("no navigation VNF serves robot `{0}`, and nobody else takes goals")]
    NoNavigation(NodeId),
    /// The robot cannot reach the goal.
    #[error("robot `{robot}` cannot go to {goal}: {reason}")]
    Goal {
        /// The robot.
        robot: NodeId,
        /// The goal.
        goal: Position,
        /// The cause.
        reason: String,
    },
    /// The speed limit, m/s, is negative or not finite.
    #[error("a speed limit is a number of m/s from 0 on, and {0} is none")]
    NotALimit(f64),
    /// The report does not fit the sensor.
    #[error("robot `{robot}`: {reason}")]
    Report {
        /// The robot.
        robot: NodeId,
        /// The cause.
        reason: ReportError,
    },
    /// The driver rejects the command.
    #[error("robot `{robot}`: {reason}")]
    Command {
        /// The robot.
        robot: NodeId,
        /// The cause.
        reason: CommandError,
    },
}

/// A turn of a robot's lidar, for taps of scans.
#[derive(Debug, Clone, PartialEq)]
pub struct SensedScan {
    /// The robot.
    pub robot: NodeId,
    /// Time at which it was read, after its completion.
    pub at: Timestamp,
    /// The scan.
    pub scan: Scan,
}

/// A robot that is not at the end of its walk.
#[derive(Debug, Clone, PartialEq)]
pub struct Walker {
    pub robot: NodeId,
    /// Index of the next waypoint.
    pub waypoint: u32,
    /// Its true pose, if it is known.
    pub position: Position,
    /// Radio unit that it is attached to.
    pub radio_unit: Option<NodeId>,
    /// Whether somebody halted it, or sent it to a goal where it is.
    pub is_held: bool,
}

/// The Robot Middleware.
///
/// The time in calls never falls. After any call, poll [`Self::poll_event`] and [`Self::poll_transmit`], and call
/// [`Self::advance`] at [`Self::next_deadline`].
pub struct RobotMiddleware {
    robots: BTreeMap<NodeId, Managed>,
    map: Option<OccupancyGrid>,
    world: Arc<World>,
    context_interval: Duration,
    next_context: Timestamp,
    nonces: Nonces,
    /// The latest time so far. Robots move up to it when they are read.
    now: Timestamp,
    /// Deadline of each robot that has one.
    due: BTreeSet<(Timestamp, NodeId)>,
    events: VecDeque<Stamped>,
    /// Places of the samples among the events that were given up last, and the nonces of their packets.
    given_up: Vec<(usize, u64)>,
    /// Datagrams to send at once.
    outbox: VecDeque<Datagram>,
    /// Scans to poll; `None` without a tap.
    scans: Option<VecDeque<SensedScan>>,
    /// Large data to poll.
    data: VecDeque<SensedData>,
}

struct Managed {
    driver: Box<dyn RobotDriver>,
    /// φ as the network reported it last.
    attachments: Vec<Attachment>,
    servers: Servers,
    service: Option<ServiceEndpoint>,
    /// The robot's model, if a navigation VNF answers its position packets.
    navigated: Option<RobotModel>,
    localization: Option<Localized>,
    /// The robot's entry in [`RobotMiddleware::due`].
    due: Option<Timestamp>,
    /// Whether the last command was beyond the robot's limits. That is reported once, not with each packet.
    flagged: bool,
    /// Faults as reported last.
    health: Vec<RobotFault>,
    /// Start of the last scan passed to a tap.
    tapped_scan: Option<Timestamp>,
    /// Whether the robot stands still regardless of its navigation.
    halted: bool,
    /// Speed limit, m/s.
    speed_limit: Option<f64>,
    rejected: RejectedAnswers,
    /// Declared sensors.
    sensing: Sensing,
    /// Whether the last answer that counts requested a federation.
    needs_federation: bool,
}

/// Numbers of answers that a robot rejected, and their last report.
struct RejectedAnswers {
    counts: AnswersRejected,
    /// Time and content of the last report.
    reported: (Timestamp, AnswersRejected),
}

impl RejectedAnswers {
    fn none(robot: &NodeId) -> Self {
        let counts = AnswersRejected::none(robot.clone());
        Self { reported: (Timestamp::ZERO, counts.clone()), counts }
    }

    /// Returns the numbers if they are to be reported now.
    fn report(&mut self, now: Timestamp) -> Option<AnswersRejected> {
        let (at, reported) = &self.reported;
        if *reported == self.counts || now.since(*at) < REJECTIONS {
            return None;
        }
        self.reported = (now, self.counts.clone());
        Some(self.counts.clone())
    }
}

/// Localization of a robot by a VNF.
struct Localized {
    endpoint: LocalizationEndpoint,
    /// When it takes odometry and scan next, at the interval of κ: at its clock's phase, so that robots send no scans in step.
    next: Timestamp,
    /// Errors each time κ was built, where the truth is known.
    errors: Errors,
}

impl RobotMiddleware {
    /// Creates the middleware without robots. It builds κ every `context_interval` from the beginning of the run.
    ///
    /// # Panics
    /// If the interval is zero.
    pub fn new(context_interval: Duration, nonces: Nonces) -> Self {
        assert!(!context_interval.is_zero(), "contexts need an interval above zero");
        Self {
            robots: BTreeMap::new(),
            map: None,
            world: Arc::new(World::open()),
            context_interval,
            next_context: Timestamp::ZERO,
            nonces,
            now: Timestamp::ZERO,
            due: BTreeSet::new(),
            events: VecDeque::new(),
            given_up: Vec::new(),
            outbox: VecDeque::new(),
            scans: None,
            data: VecDeque::new(),
        }
    }

    /// Creates the middleware with all robots of a testbed, simulated.
    ///
    /// # Errors
    /// [`SimulationError`] if a robot has no place to start from.
    ///
    /// # Panics
    /// If the interval is zero.
    pub fn simulated(
        testbed: &Testbed,
        seed: u64,
        context_interval: Duration,
    ) -> Result<Self, SimulationError> {
        let nonces = Nonces::seeded(seed);
        Self::driven(testbed, seed, context_interval, nonces, |_, simulated| Ok(Box::new(simulated)))
    }

    /// Creates the middleware with all robots of a testbed. `drive` makes the driver of each; it may use the given
    /// simulated robot, which stands at the start.
    ///
    /// A robot has a navigation service if it has a walk and one of its services runs a robot driver
    /// ([`Program::RobotDriver`]). A VNF localizes it if one of its services has one ([`Program::Localization`]); else its
    /// pose is the driver's.
    ///
    /// # Errors
    /// The error of `drive`, or [`SimulationError`] if a robot has no place to start from.
    ///
    /// # Panics
    /// If the interval is zero.
    pub fn driven<E: From<SimulationError>>(
        testbed: &Testbed,
        seed: u64,
        context_interval: Duration,
        nonces: Nonces,
        mut drive: impl FnMut(&Node, SimulatedRobot) -> Result<Box<dyn RobotDriver>, E>,
    ) -> Result<Self, E> {
        let mut middleware = Self::new(context_interval, nonces);
        let world = Arc::new(testbed.map.as_ref().map_or_else(World::open, World::new));
        (middleware.map, middleware.world) = (testbed.map.clone(), Arc::clone(&world));
        for (node, robot) in testbed.graph.robots() {
            let walk = testbed.walk(&node.id);
            let driver = drive(node, SimulatedRobot::new(node, walk, Arc::clone(&world), seed)?)?;
            let of_robot = || testbed.services.iter().filter(|service| service.robot == node.id);
            let runs = |service: &Service, program| service.vnfs.iter().any(|vnf| vnf.program == program);
            let navigated = of_robot().find(|service| service.navigates());
            let endpoint = walk.zip(navigated).map(|(walk, service)| {
                ServiceEndpoint::new(service.id.clone(), walk, driver.command_timeout(), &robot.clock, seed)
            });
            let navigated = endpoint.is_some() && of_robot().any(|s| runs(s, Program::Navigation));
            middleware.add(driver, endpoint);
            if let Some(managed) = middleware.robots.get_mut(&node.id).filter(|_| navigated) {
                managed.navigated = Some(robot.model);
            }
            if let Some(managed) = middleware.robots.get_mut(&node.id) {
                managed.sensing = Sensing::new(&node.id, robot, seed);
            }
            middleware.note_due(&node.id);
            if let Some(service) = of_robot().find(|service| service.localizes()) {
                middleware.localize(node, service, seed);
            }
        }
        Ok(middleware)
    }

    /// Lets the VNF of a service localize a robot, which stands at its driver's pose.
    fn localize(&mut self, node: &Node, service: &Service, seed: u64) {
        if let (NodeKind::Robot(robot), Some(managed)) = (&node.kind, self.robots.get_mut(&node.id)) {
            let SensorData { pose, odometry, .. } = managed.driver.sensors();
            let (service, id) = (service.id.clone(), node.id.clone());
            // A scan's turns are its clock.
            let draws = Draws::new(seed, &format!("{id}/localization/clock"));
            let (next, _) = beat(&robot.clock, self.context_interval, draws);
            let endpoint = LocalizationEndpoint::new(service, id, robot.model, &pose, &odometry);
            managed.localization = Some(Localized { endpoint, next, errors: Errors::default() });
        }
        self.note_due(&node.id);
    }

    /// Adds a robot, and replaces one with the same name.
    pub(crate) fn add(&mut self, driver: Box<dyn RobotDriver>, service: Option<ServiceEndpoint>) {
        let robot = driver.robot().clone();
        let (health, tapped_scan) = (Vec::new(), None);
        let (navigated, localization, due) = (None, None, None);
        let (flagged, halted, speed_limit) = (false, false, None);
        let rejected = RejectedAnswers::none(&robot);
        // Until servers are known, no server answers.
        let nobody = || vec![(robot.clone(), None)];
        let servers = Servers { navigation: nobody(), localization: nobody() };
        let managed = Managed {
            driver,
            attachments: Vec::new(),
            servers,
            service,
            navigated,
            localization,
            due,
            flagged,
            health,
            tapped_scan,
            halted,
            speed_limit,
            rejected,
            sensing: Sensing::default(),
            needs_federation: false,
        };
        let before = self.robots.insert(robot.clone(), managed);
        if let Some(at) = before.and_then(|before| before.due) {
            self.due.remove(&(at, robot.clone()));
        }
        self.note_due(&robot);
    }

    /// Updates a robot's entry in `due` after its deadline may have changed.
    fn note_due(&mut self, robot: &NodeId) {
        let Some(managed) = self.robots.get_mut(robot) else { return };
        let service = managed.service.as_ref().and_then(ServiceEndpoint::next_deadline);
        let next = service
            .into_iter()
            .chain(managed.localization_deadline())
            .chain(managed.sensing.next_deadline())
            .min();
        let before = std::mem::replace(&mut managed.due, next);
        if before != next {
            before.map(|at| self.due.remove(&(at, robot.clone())));
            self.due.extend(next.map(|at| (at, robot.clone())));
        }
    }

    /// Returns the robots with something due, by name.
    fn due_by(&self, now: Timestamp) -> Vec<NodeId> {
        let mut due: Vec<_> =
            self.due.iter().take_while(|(at, _)| *at <= now).map(|(_, robot)| robot.clone()).collect();
        due.sort_unstable();
        due
    }

    /// Returns the present σ of a robot.
    pub fn sensors(&mut self, robot: &NodeId) -> Option<SensorData> {
        let managed = self.robots.get_mut(robot)?;
        managed.driver.advance(self.now);
        Some(managed.sensors())
    }

    /// The robots' true poses now, as far as they are known.
    pub fn positions(&mut self) -> impl Iterator<Item = (&NodeId, Position)> {
        let now = self.now;
        self.robots.iter_mut().map(move |(robot, managed)| {
            managed.driver.advance(now);
            let pose = managed.driver.truth().unwrap_or_else(|| managed.sensors().pose);
            (robot, pose.position())
        })
    }

    /// Returns the errors of localization each time κ was built, of each robot that a VNF localizes and whose true pose is
    /// known.
    pub fn localization_errors(&self) -> impl Iterator<Item = (&NodeId, &Errors)> {
        let localized =
            self.robots.iter().filter_map(|(robot, managed)| Some((robot, managed.localization.as_ref()?)));
        localized
            .map(|(robot, localized)| (robot, &localized.errors))
            .filter(|(_, errors)| !errors.is_empty())
    }

    /// Returns the driver of a robot, for data that only it has, such as its last scan.
    pub fn driver(&mut self, robot: &NodeId) -> Option<&dyn RobotDriver> {
        let managed = self.robots.get_mut(robot)?;
        managed.driver.advance(self.now);
        Some(&*managed.driver)
    }

    /// Whether every walk is at its end and no robot has a goal; false without walks.
    pub fn finished(&self) -> bool {
        let mut services = self.robots.values().filter_map(|managed| managed.service.as_ref()).peekable();
        services.peek().is_some() && services.all(ServiceEndpoint::is_idle)
    }

    /// Returns a robot with a walk, unless that is at its end and there is no goal.
    pub fn walker(&mut self, robot: &NodeId) -> Option<Walker> {
        let managed = self.robots.get_mut(robot)?;
        let service = managed.service.as_ref();
        if service.is_some_and(ServiceEndpoint::is_idle) {
            return None;
        }
        let waypoint = service.map_or(0, ServiceEndpoint::waypoint);
        let is_held = managed.halted || service.is_some_and(ServiceEndpoint::is_at_goal);
        let radio_unit = managed.radio_unit().cloned();
        managed.driver.advance(self.now);
        let pose = managed.driver.truth().unwrap_or_else(|| managed.sensors().pose);
        Some(Walker { robot: robot.clone(), waypoint, position: pose.position(), radio_unit, is_held })
    }

    /// Returns the next deadline: of κ, a position packet, an answer, a scan or a sensor.
    pub fn next_deadline(&self) -> Timestamp {
        self.due.first().map_or(self.next_context, |(at, _)| self.next_context.min(*at))
    }

    /// Returns the radio unit that a robot is attached to.
    pub fn radio_unit(&self, robot: &NodeId) -> Option<&NodeId> {
        self.robots.get(robot)?.radio_unit()
    }

    /// Sets φ of a robot.
    pub fn set_attachments(&mut self, robot: &NodeId, attachments: Vec<Attachment>) {
        if let Some(managed) = self.robots.get_mut(robot) {
            managed.attachments = attachments;
        }
    }

    /// Sets the servers that a robot's next packets go to.
    pub fn set_servers(&mut self, robot: &NodeId, servers: Servers) {
        if let Some(managed) = self.robots.get_mut(robot) {
            managed.servers = servers;
        }
    }

    /// Moves robots up to `now`, gives up packets without an answer, and builds κ when it is due.
    pub fn advance(&mut self, now: Timestamp) {
        self.now = self.now.max(now);
        self.given_up.clear();
        let context_due = self.next_context <= now;
        let due = self.due_by(now);
        let all = context_due.then(|| self.robots.keys().cloned().collect());
        for robot in all.as_ref().unwrap_or(&due) {
            let Some(managed) = self.robots.get_mut(robot) else { continue };
            while let Some((missing, nonce)) = managed.expire(now) {
                self.given_up.extend(nonce.map(|nonce| (self.events.len(), nonce)));
                self.events.push_back(Stamped { at: now, event: Event::ServiceTime(missing) });
            }
            managed.read_sensors(now, &mut self.events, &mut self.data);
            managed.observe(now, self.context_interval);
            if context_due {
                managed.driver.advance(now);
                managed.report_health(now, &mut self.events);
                let localization_error_m = managed.measure_error();
                let context = RobotContext {
                    robot: robot.clone(),
                    attachments: managed.attachments.clone(),
                    sensors: managed.sensors(),
                    waypoint: managed.service.as_ref().map_or(0, ServiceEndpoint::waypoint),
                    health: managed.health.clone(),
                    speed_limit_mps: managed.speed_limit,
                    localization_error_m,
                };
                self.events.push_back(Stamped { at: now, event: Event::Robot(context) });
                let rejected = managed.rejected.report(now).map(Event::AnswersRejected);
                self.events.extend(rejected.map(|event| Stamped { at: now, event }));
                if let Some(scans) = &mut self.scans {
                    scans.extend(managed.fresh_scan(now));
                }
            }
        }
        all.unwrap_or(due).iter().for_each(|robot| self.note_due(robot));
        while self.next_context <= now {
            self.next_context = self.next_context + self.context_interval;
        }
    }

    /// Returns the next datagram to send at `now`; `None` when none is due. Its packet carries the time `now`: send it at
    /// once.
    ///
    /// Position packets come first. A scan waits for a moment without a position packet of its robot under way, up to a
    /// limit. It is ten times as long and would delay the packet on the air.
    pub fn poll_transmit(&mut self, now: Timestamp) -> Option<Datagram> {
        if self.outbox.is_empty() {
            let due = self.due_by(now);
            due.iter().for_each(|robot| self.emit_position(now, robot));
            due.iter().for_each(|robot| self.emit_scan(now, robot));
        }
        self.outbox.pop_front()
    }

    /// Queues a robot's position packet if it is due and no datagram waits.
    fn emit_position(&mut self, now: Timestamp, robot: &NodeId) {
        let Some(managed) = self.robots.get_mut(robot).filter(|_| self.outbox.is_empty()) else { return };
        if !managed.service.as_ref().is_some_and(|service| service.is_due(now)) {
            return;
        }
        managed.driver.advance(now);
        let (pose, route) = (managed.sensors().pose, managed.route(&managed.servers.navigation));
        managed.miss(now, &route, &mut self.events);
        let Some(service) = &mut managed.service else { return };
        // The place of a robot with a fault is unknown, and it would not follow the answer.
        if !managed.driver.health().is_empty() {
            service.skip(now);
        } else if let Some(request) = service.emit(now, &pose, route, &mut self.nonces) {
            self.outbox.extend(request.datagrams(robot, |packet, nonce, bytes| {
                packet.nonce = nonce;
                packet.encode(bytes);
            }));
        }
        self.note_due(robot);
    }

    /// Ends the run: reports the position packets that were due and not sent.
    pub fn finish(&mut self, now: Timestamp) {
        for managed in self.robots.values_mut() {
            let route = managed.route(&managed.servers.navigation);
            managed.miss(now, &route, &mut self.events);
        }
    }

    /// Queues a robot's scan if it is due and no datagram waits.
    fn emit_scan(&mut self, now: Timestamp, robot: &NodeId) {
        let Some(managed) = self.robots.get_mut(robot).filter(|_| self.outbox.is_empty()) else { return };
        let (quiet, route) = (managed.is_quiet(), managed.route(&managed.servers.localization));
        let Some(Localized { endpoint, .. }) = &mut managed.localization else { return };
        if let Some(request) = endpoint.emit(now, quiet, route, &mut self.nonces) {
            self.outbox.extend(request.datagrams(robot, |packet, nonce, bytes| {
                packet.nonce = nonce;
                packet.encode(bytes);
            }));
            self.note_due(robot);
        }
    }

    /// Returns the samples that the last [`Self::advance`] gave up, which are still to be reported, with the first nonces of
    /// their packets. Call it before [`Self::poll_event`].
    pub fn given_up(&mut self) -> impl Iterator<Item = (u64, &mut ServiceTime)> {
        let mut given_up = self.given_up.iter().peekable();
        self.events.iter_mut().enumerate().filter_map(move |(place, stamped)| {
            let (_, nonce) = given_up.next_if(|(its, _)| *its == place)?;
            match &mut stamped.event {
                Event::ServiceTime(sample) => Some((*nonce, sample)),
                _ => None,
            }
        })
    }

    /// Receives an answer of a localization VNF. The robot's pose is the answer's, moved on by odometry since the answered
    /// scan. Returns the service time, which is still to be reported, unless the answer is rejected.
    pub fn localized(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        from: SocketAddrV4,
        packet: &PosePacket,
    ) -> Option<&mut ServiceTime> {
        let managed = self.robots.get_mut(robot)?;
        let measured = match &mut managed.localization {
            None => Err(AnswerError::Unknown),
            Some(Localized { endpoint, .. }) => endpoint.receive(now, from, packet),
        };
        match measured {
            Ok(sample) => {
                self.note_due(robot);
                self.events.push_back(Stamped { at: now, event: Event::ServiceTime(sample) });
                self.sample(self.events.len() - 1)
            }
            Err(rejection) => {
                managed.reject(rejection);
                None
            }
        }
    }

    /// Counts a datagram that is not a valid answer.
    pub fn reject(&mut self, robot: &NodeId) {
        if let Some(managed) = self.robots.get_mut(robot) {
            managed.reject(AnswerError::Invalid);
        }
    }

    /// Receives a navigation packet. The robot follows it unless it is rejected, overtaken or beyond the robot's limits.
    /// Results are reported as events. Returns the service time, which is still to be reported, unless it is rejected.
    pub fn receive(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        from: SocketAddrV4,
        packet: &NavigationPacket,
    ) -> Option<&mut ServiceTime> {
        let managed = self.robots.get_mut(robot)?;
        let answer = match &mut managed.service {
            None => Err(AnswerError::Unknown),
            Some(service) => service.receive(now, from, packet),
        };
        let answer = match answer {
            Ok(answer) => answer,
            Err(rejection) => {
                managed.reject(rejection);
                return None;
            }
        };
        let place = self.events.len();
        self.events.push_back(Stamped { at: now, event: Event::ServiceTime(answer.service_time) });
        if let Some(velocity) = answer.velocity.filter(|_| !managed.halted) {
            // A rejected command becomes a notice; the sender of a datagram cannot be told.
            let _ = managed.command(now, velocity, &mut self.events);
        }
        if answer.finished {
            managed.finish(now, &mut self.events);
        }
        if let Some(needed) = answer.needs_federation {
            let before = std::mem::replace(&mut managed.needs_federation, needed);
            if needed && !before {
                let event = Event::FederationRequested { robot: robot.clone() };
                self.events.push_back(Stamped { at: now, event });
            }
        }
        if let Some(goal) = answer.goal {
            if matches!(goal.state, GoalState::Reached | GoalState::Failed) {
                managed.driver.stop(now);
            }
            self.events.push_back(Stamped { at: now, event: Event::Goal(goal) });
        }
        self.note_due(robot);
        self.sample(place)
    }

    /// Returns the service time that is the event at this place of the queue.
    fn sample(&mut self, place: usize) -> Option<&mut ServiceTime> {
        match self.events.get_mut(place) {
            Some(Stamped { event: Event::ServiceTime(sample), .. }) => Some(sample),
            _ => None,
        }
    }

    /// Moves a robot ([`cotorra_graph::Instruction::Move`]).
    ///
    /// # Errors
    /// [`MoveError`]; the robot goes on as before.
    pub fn instruct(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        velocity: Velocity,
        waypoint: u32,
    ) -> Result<(), MoveError> {
        let managed = self.robots.get_mut(robot).ok_or_else(|| MoveError::UnknownRobot(robot.clone()))?;
        if managed.service.as_ref().is_some_and(|service| !service.has_waypoint(waypoint)) {
            return Err(MoveError::UnknownWaypoint { robot: robot.clone(), waypoint });
        }
        if managed.halted {
            return Err(MoveError::Halted(robot.clone()));
        }
        managed
            .command(now, velocity, &mut self.events)
            .map_err(|reason| MoveError::Command { robot: robot.clone(), reason })?;
        if managed.service.as_mut().is_some_and(|service| service.reach(waypoint)) {
            managed.finish(now, &mut self.events);
        }
        self.note_due(robot);
        Ok(())
    }

    /// Halts a robot regardless of its navigation, or lets it follow that again.
    ///
    /// # Errors
    /// [`MoveError::UnknownRobot`].
    pub fn halt(&mut self, now: Timestamp, robot: &NodeId, halted: bool) -> Result<(), MoveError> {
        let managed = self.robots.get_mut(robot).ok_or_else(|| MoveError::UnknownRobot(robot.clone()))?;
        managed.halted = halted;
        managed.limit_others();
        if halted {
            managed.driver.stop(now);
        }
        Ok(())
    }

    /// Sets a goal in place of a robot's walk, or cancels it ([`cotorra_graph::Instruction::NavigateTo`]).
    ///
    /// # Errors
    /// [`MoveError`]; the robot goes on as before.
    pub fn navigate_to(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        goal: Option<Position>,
    ) -> Result<(), MoveError> {
        let managed = self.robots.get_mut(robot).ok_or_else(|| MoveError::UnknownRobot(robot.clone()))?;
        let Some((service, model)) = managed.service.as_mut().zip(managed.navigated) else {
            return Err(MoveError::NoNavigation(robot.clone()));
        };
        if let Some(goal) = goal {
            unreachable(goal, model, self.map.as_ref(), &self.world)
                .map_or(Ok(()), |reason| Err(MoveError::Goal { robot: robot.clone(), goal, reason }))?;
        }
        let events = service.set_goal(now, goal).map(|goal| Stamped { at: now, event: Event::Goal(goal) });
        self.events.extend(events);
        self.note_due(robot);
        Ok(())
    }

    /// Limits a robot's speed, m/s, or removes its limit ([`cotorra_graph::Instruction::LimitSpeed`]).
    ///
    /// # Errors
    /// [`MoveError::UnknownRobot`] and [`MoveError::NotALimit`]; the limit stays as it was.
    pub fn limit_speed(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        limit: Option<f64>,
    ) -> Result<(), MoveError> {
        let managed = self.robots.get_mut(robot).ok_or_else(|| MoveError::UnknownRobot(robot.clone()))?;
        if let Some(limit) = limit.filter(|limit| !(limit.is_finite() && *limit >= 0.0)) {
            return Err(MoveError::NotALimit(limit));
        }
        managed.speed_limit = limit;
        managed.limit_others();
        if limit == Some(0.0) {
            managed.driver.stop(now);
        }
        Ok(())
    }

    /// Takes a reported measurement of a robot's sensor ([`cotorra_graph::Instruction::Report`]).
    ///
    /// # Errors
    /// [`MoveError::UnknownRobot`] and [`MoveError::Report`].
    pub fn report(
        &mut self,
        now: Timestamp,
        robot: &NodeId,
        sensor: &SensorId,
        values: &[f64],
    ) -> Result<(), MoveError> {
        let managed = self.robots.get_mut(robot).ok_or_else(|| MoveError::UnknownRobot(robot.clone()))?;
        let done = managed.sensing.report(now, sensor, values);
        done.map_err(|reason| MoveError::Report { robot: robot.clone(), reason })
    }

    /// Stops a robot, if it exists.
    pub fn stop(&mut self, now: Timestamp, robot: &NodeId) {
        if let Some(managed) = self.robots.get_mut(robot) {
            managed.driver.stop(now);
        }
    }

    /// Returns the next event, oldest first.
    pub fn poll_event(&mut self) -> Option<Stamped> {
        self.events.pop_front()
    }

    /// Keeps each scan from now on for [`Self::poll_scan`]. Scans are not events, because they are many times as large as
    /// all events together.
    pub fn tap_scans(&mut self) {
        self.scans.get_or_insert_default();
    }

    /// Returns the next large data of sensors, oldest first. Like events, it is kept until it is polled.
    pub fn poll_data(&mut self) -> Option<SensedData> {
        self.data.pop_front()
    }

    /// Returns the next scan completed since [`Self::tap_scans`], oldest first. Scans are read when κ is built.
    pub fn poll_scan(&mut self) -> Option<SensedScan> {
        self.scans.as_mut()?.pop_front()
    }
}

impl Managed {
    /// Applies the robot's limit to programs that drive it beside the testbed.
    fn limit_others(&mut self) {
        let limit = if self.halted { Some(0.0) } else { self.speed_limit };
        self.driver.limit_others(limit);
    }

    fn reject(&mut self, rejection: AnswerError) {
        rejection.count(&mut self.rejected.counts);
    }

    /// Returns the driver's σ with the pose of localization.
    fn sensors(&self) -> SensorData {
        let sensed = self.driver.sensors();
        match &self.localization {
            Some(Localized { endpoint, .. }) => {
                SensorData { pose: endpoint.pose(&sensed.odometry), ..sensed }
            }
            None => sensed,
        }
    }

    /// Returns the radio unit that it is attached to.
    fn radio_unit(&self) -> Option<&NodeId> {
        let attached = self.attachments.iter().find(|attachment| attachment.attached);
        attached.map(|attachment| &attachment.radio_unit)
    }

    /// Returns the route of a request to these servers.
    fn route(&self, servers: &[(NodeId, Option<SocketAddrV4>)]) -> Route {
        Route { attachment: self.radio_unit().cloned(), servers: servers.to_vec() }
    }

    /// Reports the position packets that were due before now and not sent, because this middleware was not run.
    fn miss(&mut self, now: Timestamp, route: &Route, events: &mut VecDeque<Stamped>) {
        let is_well = self.driver.health().is_empty();
        let Some(service) = self.service.as_mut().filter(|_| is_well) else { return };
        let (missed, uncounted) = service.miss(now, route);
        events
            .extend(missed.into_iter().map(|missed| Stamped { at: now, event: Event::ServiceTime(missed) }));
        if uncounted > 0 {
            let message = format!(
                "robot {} did not send {uncounted} more position packets that were due, which are not among its samples",
                self.driver.robot()
            );
            events.push_back(Stamped { at: now, event: Event::Notice { message } });
        }
    }

    /// Gives up the oldest packet of a service without an answer in time; `None` if there is none. Returns its nonce, too.
    fn expire(&mut self, now: Timestamp) -> Option<(ServiceTime, Option<u64>)> {
        if let Some(service) = &mut self.service
            && let Some(missing) = service.expire(now)
        {
            let nonce = service.nonce_of(&missing);
            return Some((missing, nonce));
        }
        let endpoint = &mut self.localization.as_mut()?.endpoint;
        let missing = endpoint.expire(now)?;
        let nonce = endpoint.nonce_of(&missing);
        Some((missing, nonce))
    }

    fn is_quiet(&self) -> bool {
        self.service.as_ref().is_none_or(ServiceEndpoint::is_quiet)
    }

    fn localization_deadline(&self) -> Option<Timestamp> {
        let Localized { endpoint, next, .. } = self.localization.as_ref()?;
        Some(endpoint.next_deadline(self.is_quiet()).map_or(*next, |at| at.min(*next)))
    }

    /// Feeds odometry and scan to localization when it is due.
    fn observe(&mut self, now: Timestamp, interval: Duration) {
        let Some(Localized { endpoint, next, .. }) = self.localization.as_mut().filter(|its| its.next <= now)
        else {
            return;
        };
        while *next <= now {
            *next = *next + interval;
        }
        self.driver.advance(now);
        let odometry = self.driver.sensors().odometry;
        // Data of a robot with a fault is not trusted.
        let scan = self.driver.scan().filter(|_| self.driver.health().is_empty());
        endpoint.observe(now, &odometry, scan);
    }

    /// Compares the pose of localization with the truth. Returns the distance of the two, if a VNF localizes the robot and the
    /// truth is known.
    fn measure_error(&mut self) -> Option<f64> {
        let Localized { endpoint, errors, .. } = self.localization.as_mut()?;
        let odometry = self.driver.sensors().odometry;
        let (believed, truth) = (believed(&endpoint.pose(&odometry)), planar(&self.driver.truth()?));
        errors.push(&believed, truth);
        Some(believed.pose.distance(truth))
    }

    /// Commands the driver within the robot's speed limit. Reports once when commands begin to exceed the robot's limits.
    fn command(
        &mut self,
        now: Timestamp,
        velocity: Velocity,
        events: &mut VecDeque<Stamped>,
    ) -> Result<(), CommandError> {
        let velocity = self.speed_limit.map_or(velocity, |limit| slowed(velocity, limit));
        let done = self.driver.command(now, velocity);
        let flag = match &done {
            Ok(done) if *done == velocity => None,
            Ok(done) => Some(format!(
                "was asked for {} m/s and {} rad/s, over its limits, and does {:.3} m/s and {:.3} rad/s",
                velocity.linear, velocity.angular, done.linear, done.angular
            )),
            Err(refused) => Some(format!("refused a command: {refused}")),
        };
        // Faults have their own notice.
        let flag = flag.filter(|_| !matches!(done, Err(CommandError::Unwell(_))));
        let was_flagged = std::mem::replace(&mut self.flagged, flag.is_some());
        if let Some(flag) = flag.filter(|_| !was_flagged) {
            let message = format!("robot {} {flag}", self.driver.robot());
            events.push_back(Stamped { at: now, event: Event::Notice { message } });
        }
        done.map(|_| ())
    }

    /// Reports changes of the robot's faults.
    fn report_health(&mut self, now: Timestamp, events: &mut VecDeque<Stamped>) {
        let health = self.driver.health();
        if health == self.health {
            return;
        }
        let robot = self.driver.robot();
        let message = match health {
            [] => format!("robot {robot} is well"),
            faults => {
                let faults: Vec<_> = faults.iter().map(ToString::to_string).collect();
                format!("robot {robot} stands still: {}", faults.join(", "))
            }
        };
        self.health = health.to_vec();
        events.push_back(Stamped { at: now, event: Event::Notice { message } });
    }

    /// Reads the sensors that are due.
    fn read_sensors(
        &mut self,
        now: Timestamp,
        events: &mut VecDeque<Stamped>,
        data: &mut VecDeque<SensedData>,
    ) {
        if self.sensing.next_deadline().is_some_and(|next| next <= now) {
            self.driver.advance(now);
            for (reading, large) in self.sensing.read(now, &mut *self.driver) {
                events.push_back(Stamped { at: now, event: Event::Sensor(reading) });
                data.extend(large);
            }
            while let Some(message) = self.driver.poll_notice() {
                events.push_back(Stamped { at: now, event: Event::Notice { message } });
            }
        }
    }

    /// Returns the last scan, if it was not returned before.
    fn fresh_scan(&mut self, now: Timestamp) -> Option<SensedScan> {
        let scan = self.driver.scan().filter(|scan| self.tapped_scan != Some(scan.at))?;
        self.tapped_scan = Some(scan.at);
        Some(SensedScan { robot: self.driver.robot().clone(), at: now, scan: scan.clone() })
    }

    /// Ends the walk: stops the robot regardless of the last command.
    fn finish(&mut self, now: Timestamp, events: &mut VecDeque<Stamped>) {
        self.driver.stop(now);
        let robot = self.driver.robot().clone();
        events.push_back(Stamped { at: now, event: Event::WalkFinished { robot } });
    }
}

/// Returns the reason for which a robot of this model can never be at a place, as far as the map shows without planning.
fn unreachable(
    goal: Position,
    model: RobotModel,
    map: Option<&OccupancyGrid>,
    world: &World,
) -> Option<String> {
    let within = |metres: f64| metres.abs() <= FARTHEST;
    if !(within(goal.x) && within(goal.y) && within(goal.z)) {
        return Some(format!("it is no place within {FARTHEST} m"));
    }
    if goal.z < 0.0 || (goal.z > 0.0 && !model.flies()) {
        let name = model.name();
        return Some(if goal.z < 0.0 {
            "it is below the floor".into()
        } else {
            format!("no {name} leaves the floor")
        });
    }
    if let Some(lies) = map.and_then(|map| map.not_free(goal)) {
        return Some(format!("it is {lies}"));
    }
    let clear = world.distance(goal, model.radius());
    (clear < model.radius()).then(|| format!("it is {clear:.2} m from an obstacle, too near for the robot"))
}

#[cfg(test)]
mod tests;
