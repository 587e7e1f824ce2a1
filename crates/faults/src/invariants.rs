//! Checkers of a testbed's promises under faults. They take the events and the core's state after each step, and know
//! nothing of simulations.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_engine::InstanceId;
use cotorra_fabric::Balance;
use cotorra_graph::{
    AccessPoint, Decision, Direction, Event, HardwareGraph, Instruction, LinkId, NodeId, PluginId, Program,
    ServiceId, Stamped, Testbed, Timestamp, VnfEvent, VnfId, VnfState,
};
use cotorra_network_control::vim::{Managed, Stage};
use cotorra_robot_middleware::{COMMAND_TIMEOUT, MAX_ANGULAR_SPEED, MAX_SPEED, SimulatedRobot};

/// A promise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Invariant {
    /// After a crash, the history has what it acknowledged, and nothing else.
    Kept,
    /// A robot without fresh commands stops within its command timeout and its braking time.
    Stops,
    /// No robot goes on faster than its speed limit.
    Slow,
    /// One instance of a VNF at most serves on a node, and every instance that runs is managed.
    Served,
    /// A VNF without an instance is restarted.
    Restarted,
    /// No node carries more than it has, and no link has more reserved than it carries.
    Fits,
    /// Packets neither vanish nor come from nowhere.
    Conserved,
    /// Every instruction ends in exactly one decision.
    Decided,
    /// The core does not panic.
    Stands,
}

impl Invariant {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Kept,
        Self::Stops,
        Self::Slow,
        Self::Served,
        Self::Restarted,
        Self::Fits,
        Self::Conserved,
        Self::Decided,
        Self::Stands,
    ];

    /// Returns the promise in words.
    pub const fn promise(self) -> &'static str {
        match self {
            Self::Kept => "nothing acknowledged is lost",
            Self::Stops => "a robot without fresh commands stops within its timeout",
            Self::Slow => "a robot keeps its speed limit",
            Self::Served => "a VNF is served by one instance at most on a node",
            Self::Restarted => "a VNF that nothing serves is started again",
            Self::Fits => "resources are never over-committed",
            Self::Conserved => "packets are conserved",
            Self::Decided => "every instruction ends in exactly one decision",
            Self::Stands => "the core does not panic",
        }
    }
}

/// A broken promise, and the state that breaks it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Broken(pub(super) Invariant, pub(super) String);

/// Number of checks of an invariant, and of those that could have failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Checked {
    /// All checks.
    pub checks: u64,
    /// Checks of a state in which the promise could have been broken.
    pub exercised: u64,
}

impl Checked {
    pub(crate) fn note(&mut self, exercised: bool) {
        self.checks += 1;
        self.exercised += u64::from(exercised);
    }
}

/// The state of the core after a step.
pub(crate) struct View<'a> {
    pub(crate) now: Timestamp,
    pub(crate) graph: &'a HardwareGraph,
    pub(crate) managed: Vec<Managed<'a>>,
    /// Instances that really run.
    pub(crate) running: Vec<InstanceId>,
    pub(crate) packets: Balance,
    /// Directions of links with reservations: the reserved and the available rate, bit/s.
    pub(crate) reserved: Vec<(LinkId, Direction, [f64; 2])>,
}

/// The base's deceleration, m/s² and rad/s².
const BRAKES: (f64, f64) = (0.6, 4.2);
/// Highest noise that wheels and gyro add to a velocity, m/s and rad/s.
const NOISE: (f64, f64) = (0.03, 0.05);

/// [`Invariant::Stops`].
pub(crate) struct Stops {
    /// Services whose answers are commands.
    navigating: BTreeSet<ServiceId>,
    /// Time of each robot's last fresh command.
    commanded: BTreeMap<NodeId, Timestamp>,
}

impl Stops {
    pub(crate) fn new(testbed: &Testbed) -> Self {
        let navigating = testbed.services.iter().filter(|service| service.navigates());
        Self {
            navigating: navigating.map(|service| service.id.clone()).collect(),
            commanded: BTreeMap::new(),
        }
    }

    pub(crate) fn event(&mut self, stamped: &Stamped, checked: &mut Checked) -> Result<(), Broken> {
        match &stamped.event {
            Event::ServiceTime(sample)
                if sample.took.is_some() && self.navigating.contains(&sample.service) =>
            {
                self.commanded.insert(sample.robot.clone(), stamped.at);
            }
            Event::Decision(Decision {
                instruction: Instruction::Move { robot, .. }, refused: None, ..
            }) => {
                self.commanded.insert(robot.clone(), stamped.at);
            }
            Event::Robot(context) => {
                let robot = &context.robot;
                let commanded = self.commanded.get(robot);
                // The base reports its last step, and brakes from the next one on.
                let follows = COMMAND_TIMEOUT + 2 * SimulatedRobot::STEP;
                let braked = match commanded {
                    Some(at) if stamped.at.since(*at) <= follows => {
                        checked.note(false);
                        return Ok(());
                    }
                    Some(at) => (stamped.at.since(*at) - follows).as_secs_f64(),
                    None => f64::INFINITY,
                };
                checked.note(commanded.is_some());
                let velocity = context.sensors.velocity;
                // The gyro reports noise while a wheel turns, also after the robot stopped turning, and none at rest.
                let may_move = braked < (MAX_SPEED / BRAKES.0).max(MAX_ANGULAR_SPEED / BRAKES.1);
                let within = |speed: f64, most: f64, brakes: f64, noise: f64| {
                    let allowed = (most - brakes * braked).max(0.0);
                    speed.abs() <= if may_move { allowed + noise } else { 0.0 }
                };
                let stops = within(velocity.linear, MAX_SPEED, BRAKES.0, NOISE.0)
                    && within(velocity.angular, MAX_ANGULAR_SPEED, BRAKES.1, NOISE.1);
                if !stops {
                    let last = commanded.map_or("never".to_owned(), |at| format!("at {at}"));
                    return Err(Broken(
                        Invariant::Stops,
                        format!(
                            "{robot} does {:.3} m/s and {:.3} rad/s; its last command came {last}, and is good for {} s",
                            velocity.linear,
                            velocity.angular,
                            COMMAND_TIMEOUT.as_secs_f64()
                        ),
                    ));
                }
            }
            _ => {}
        }
        Ok(())
    }
}

/// [`Invariant::Slow`].
#[derive(Default)]
pub(crate) struct Slow {
    /// Each robot's limit, m/s, and the time since which it applies.
    limits: BTreeMap<NodeId, (f64, Timestamp)>,
}

impl Slow {
    pub(crate) fn event(&mut self, stamped: &Stamped, checked: &mut Checked) -> Result<(), Broken> {
        let Event::Robot(context) = &stamped.event else { return Ok(()) };
        let Some(limit) = context.speed_limit_mps else {
            self.limits.remove(&context.robot);
            return Ok(());
        };
        let kept = self.limits.entry(context.robot.clone()).or_insert((limit, stamped.at));
        if kept.0 != limit {
            *kept = (limit, stamped.at);
        }
        // The robot follows its previous command until then, and brakes afterwards.
        let follows = COMMAND_TIMEOUT + 2 * SimulatedRobot::STEP;
        let braked = stamped.at.since(kept.1).saturating_sub(follows).as_secs_f64();
        let allowed = limit.max(MAX_SPEED - BRAKES.0 * braked) + NOISE.0;
        checked.note(allowed < MAX_SPEED);
        let speed = context.sensors.velocity.linear;
        if speed.abs() <= allowed {
            return Ok(());
        }
        let (robot, since) = (&context.robot, kept.1);
        let what = format!("{robot} does {speed:.3} m/s, and is limited to {limit:.3} m/s since {since}");
        Err(Broken(Invariant::Slow, what))
    }
}

/// [`Invariant::Served`].
pub(crate) fn served(view: &View<'_>, checked: &mut Checked) -> Result<(), Broken> {
    let broken = |what: String| Err(Broken(Invariant::Served, what));
    let mut known = Vec::new();
    let mut several = false;
    let mut replicas = BTreeSet::new();
    for Managed { vnf, node, instances, .. } in &view.managed {
        if !replicas.insert((&vnf.id, *node)) {
            let node = node.map_or("no node", NodeId::as_str);
            return broken(format!("two replicas of {} are on {node}", vnf.id));
        }
        let count = |stage: Stage| instances.iter().filter(|(.., at)| *at == stage).count();
        let (serving, starting) = (count(Stage::Serving), count(Stage::Starting));
        several |= instances.len() > 1;
        if serving > 1 || starting > 1 {
            return broken(format!(
                "{} has {serving} instances that serve and {starting} that start",
                vnf.id
            ));
        }
        for (id, node, stage) in instances {
            if let Stage::Draining(until) = stage
                && *until < view.now
            {
                return broken(format!("an instance of {} on {node} was to stop at {until}", vnf.id));
            }
            if vnf.program != Program::RobotDriver {
                known.push(*id);
            }
        }
    }
    checked.note(several);
    if let Some(orphan) = view.running.iter().find(|id| !known.contains(id)) {
        return broken(format!("instance {} runs, but nobody manages it, nor ever stops it", orphan.0));
    }
    if let Some(ghost) = known.iter().find(|id| !view.running.contains(id)) {
        return broken(format!("instance {} is managed, but does not run", ghost.0));
    }
    Ok(())
}

/// [`Invariant::Restarted`].
pub(crate) fn restarted(view: &View<'_>, checked: &mut Checked) -> Result<(), Broken> {
    let mut exercised = false;
    for Managed { vnf, node, instances, restart_at } in &view.managed {
        // A removed VNF is not started again.
        let Some(node) = node else { continue };
        let lives = instances.iter().any(|(.., stage)| matches!(stage, Stage::Serving | Stage::Starting));
        exercised |= !instances.iter().any(|(.., stage)| *stage == Stage::Serving);
        if !lives && restart_at.is_none() {
            let what = format!("nothing serves {} on {node}, and it is not started again", vnf.id);
            return Err(Broken(Invariant::Restarted, what));
        }
    }
    checked.note(exercised);
    Ok(())
}

/// [`Invariant::Fits`].
pub(crate) struct Fits {
    /// Virtual access points, their radio units, and whether they are deployed.
    access_points: Vec<(VnfId, NodeId, bool)>,
}

/// CPUs and bytes of a vAP.
const ACCESS_POINT: (f64, u64) = (0.5, 128_000_000);

impl Fits {
    pub(crate) fn new(graph: &HardwareGraph) -> Self {
        let unit =
            |(node, _): (&cotorra_graph::Node, _)| (AccessPoint::vnf(&node.id), node.id.clone(), false);
        Self { access_points: graph.radio_units().map(unit).collect() }
    }

    pub(crate) fn event(&mut self, stamped: &Stamped) {
        let Event::Vnf(VnfEvent { vnf, state, .. }) = &stamped.event else { return };
        if let Some((.., deployed)) = self.access_points.iter_mut().find(|(id, ..)| id == vnf) {
            *deployed = *state == VnfState::Started;
        }
    }

    pub(crate) fn state(&self, view: &View<'_>, checked: &mut Checked) -> Result<(), Broken> {
        let mut taken = Vec::new();
        let mut take = |node, cpus, memory, vnf| taken.push((node, cpus, memory, vnf));
        let takes_room = |its: &&Managed<'_>| !matches!(its.vnf.program, Program::Host(_));
        for Managed { vnf, node, instances, .. } in view.managed.iter().filter(takes_room) {
            let Some(node) = *node else { continue };
            take(node, vnf.cpus, vnf.memory_bytes, &vnf.id);
            let moves = instances.iter().filter(|(_, to, stage)| *stage == Stage::Starting && *to != node);
            moves.for_each(|(_, to, _)| take(to, vnf.cpus, vnf.memory_bytes, &vnf.id));
        }
        let deployed = self.access_points.iter().filter(|(.., deployed)| *deployed);
        deployed.for_each(|(vnf, unit, _)| take(unit, ACCESS_POINT.0, ACCESS_POINT.1, vnf));
        let mut several = false;
        for node in &view.graph.nodes {
            let Some(has) = node.capacity() else { continue };
            let here = || taken.iter().filter(|(on, ..)| **on == node.id);
            several |= here().count() > 1;
            let cpus: f64 = here().map(|(_, cpus, ..)| *cpus).sum();
            let memory: u64 = here().map(|(_, _, memory, _)| *memory).sum();
            if cpus > has.cpus + 1e-6 || memory > has.memory_bytes {
                let vnfs: Vec<_> = here().map(|(.., vnf)| vnf.as_str()).collect();
                let what = format!(
                    "{} has {} CPUs and {} MB, and carries {cpus:.3} CPUs and {} MB: {}",
                    node.id,
                    has.cpus,
                    has.memory_bytes / 1_000_000,
                    memory / 1_000_000,
                    vnfs.join(", ")
                );
                return Err(Broken(Invariant::Fits, what));
            }
        }
        for (link, direction, [reserved, carries]) in &view.reserved {
            several |= *reserved > 0.0;
            if reserved > carries {
                let what =
                    format!("{link} carries {carries} bit/s {direction:?}, and {reserved} are reserved");
                return Err(Broken(Invariant::Fits, what));
            }
        }
        checked.note(several);
        Ok(())
    }
}

/// [`Invariant::Conserved`].
pub(crate) fn conserved(view: &View<'_>, checked: &mut Checked) -> Result<(), Broken> {
    let packets = view.packets;
    checked.note(packets.under_way + packets.lost + packets.overflowed + packets.duplicated > 0);
    if packets.is_even() {
        return Ok(());
    }
    Err(Broken(Invariant::Conserved, format!("sent and duplicated are not what became of them: {packets:?}")))
}

/// [`Invariant::Decided`]. The reason of an instruction is its number, counted from 0 for each sender.
#[derive(Default)]
pub(crate) struct Decided {
    /// The instruction without a decision so far, and the rejection that was returned for it.
    undecided: Option<(PluginId, usize, Option<String>)>,
    /// Number of decisions for each sender.
    decided: Vec<(PluginId, usize)>,
    cut_off: Vec<PluginId>,
}

impl Decided {
    /// Records an instruction and its returned rejection, if any.
    pub(crate) fn given(&mut self, who: &PluginId, number: usize, refused: Option<String>) {
        self.undecided = Some((who.clone(), number, refused));
    }

    pub(crate) fn event(&mut self, stamped: &Stamped, checked: &mut Checked) -> Result<(), Broken> {
        let broken = |what: String| Err(Broken(Invariant::Decided, what));
        match &stamped.event {
            Event::PluginFault { plugin, .. } => self.cut_off.push(plugin.clone()),
            Event::Decision(Decision { plugin, instruction, reason, refused }) => {
                checked.note(true);
                let name = instruction.name();
                if self.cut_off.contains(plugin) {
                    return broken(format!("{plugin} was cut off, but `{name}` was decided for it"));
                }
                // Bundled plug-ins give other reasons.
                let Some(number) = reason.as_ref().filter(|_| is_ours(plugin)) else { return Ok(()) };
                let expected = self.decided_for(plugin);
                if *number != expected.to_string() {
                    return broken(format!(
                        "`{name}` of {plugin}, number {number}, was decided in place of {expected}"
                    ));
                }
                match self.decided.iter_mut().find(|(who, _)| who == plugin) {
                    Some((_, count)) => *count += 1,
                    None => self.decided.push((plugin.clone(), 1)),
                }
                if let Some((who, number, told)) = self.undecided.take_if(|(who, ..)| who == plugin)
                    && (number != expected || told != *refused)
                {
                    return broken(format!(
                        "`{name}` of {who}, number {number}: the decision has {refused:?}, the sender received {told:?}"
                    ));
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn decided_for(&self, plugin: &PluginId) -> usize {
        self.decided.iter().find(|(who, _)| who == plugin).map_or(0, |(_, count)| *count)
    }

    /// Checks that every instruction was decided.
    pub(crate) fn settled(&self) -> Result<(), Broken> {
        match &self.undecided {
            Some((who, number, _)) => {
                Err(Broken(Invariant::Decided, format!("number {number} of {who} was never decided")))
            }
            None => Ok(()),
        }
    }

    /// Checks, at the end, that a plug-in's instructions were decided up to the host's bound.
    pub(crate) fn all_of(&self, who: &PluginId, given: usize) -> Result<(), Broken> {
        let decided = self.decided_for(who);
        // The bound in docs/use/plugins.md.
        let expected = given.min(1000);
        let enough = if given > expected { decided >= expected } else { decided == expected };
        if enough {
            return Ok(());
        }
        Err(Broken(Invariant::Decided, format!("of {given} instructions of {who}, {decided} were decided")))
    }
}

/// Sender of the plan's own instructions.
pub(crate) const OURS: &str = "fault-test";
/// Prefix of the names of plug-ins that misbehave.
pub(crate) const SABOTEUR: &str = "saboteur-";

fn is_ours(plugin: &PluginId) -> bool {
    plugin.as_str() == OURS || plugin.as_str().starts_with(SABOTEUR)
}

/// [`Invariant::Kept`]: compares a history after a crash with what it acknowledged, in the order of recording.
pub(crate) fn kept(acknowledged: &[Stamped], found: &[Stamped], checked: &mut Checked) -> Result<(), Broken> {
    checked.note(!acknowledged.is_empty());
    // A history is ordered by time, and simultaneous events by their recording.
    let mut expected: Vec<&Stamped> = Vec::with_capacity(acknowledged.len());
    for stamped in acknowledged {
        let earlier = expected.iter().rev().take_while(|other| other.at > stamped.at).count();
        expected.insert(expected.len() - earlier, stamped);
    }
    let first = expected.iter().zip(found).position(|(a, b)| **a != *b);
    let what = match first {
        Some(place) => {
            format!("event {place} of the history is {:?} in place of {:?}", found[place], expected[place])
        }
        None if expected.len() != found.len() => {
            format!("the history acknowledged {} events and has {}", expected.len(), found.len())
        }
        None => return Ok(()),
    };
    Err(Broken(Invariant::Kept, what))
}

/// All checkers.
pub(crate) struct Watch {
    stops: Stops,
    slow: Slow,
    fits: Fits,
    pub(crate) decided: Decided,
    pub(crate) checked: [Checked; Invariant::ALL.len()],
}

impl Watch {
    pub(crate) fn new(testbed: &Testbed) -> Self {
        Self {
            stops: Stops::new(testbed),
            slow: Slow::default(),
            fits: Fits::new(&testbed.graph),
            decided: Decided::default(),
            checked: Default::default(),
        }
    }

    pub(crate) fn event(&mut self, stamped: &Stamped) -> Result<(), Broken> {
        self.stops.event(stamped, &mut self.checked[Invariant::Stops as usize])?;
        self.slow.event(stamped, &mut self.checked[Invariant::Slow as usize])?;
        self.fits.event(stamped);
        self.decided.event(stamped, &mut self.checked[Invariant::Decided as usize])
    }

    pub(crate) fn state(&mut self, view: &View<'_>) -> Result<(), Broken> {
        served(view, &mut self.checked[Invariant::Served as usize])?;
        restarted(view, &mut self.checked[Invariant::Restarted as usize])?;
        self.fits.state(view, &mut self.checked[Invariant::Fits as usize])?;
        conserved(view, &mut self.checked[Invariant::Conserved as usize])?;
        self.decided.settled()
    }
}
