//! The plug-in host as a state machine. It decides which instructions are admitted, which plug-in is cut off and why, and
//! which one time waits for. It has no clock, thread or socket. Shells for real time, virtual time and replays call
//! plug-ins and end them.

use std::{
    collections::{BTreeMap, BTreeSet},
    process::ExitStatus,
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    DomainId, Event, Instruction, InstructionLimit, NodeId, PluginId, PluginSpec, Staleness, Stamped,
    Timestamp, VnfId,
};
use cotorra_network_control::{InstructionError, vim::MOST_ADDED};
use cotorra_plugin::Actions;

use super::travel::{Datagram, INSTRUCTIONS, Sent, Travel};
use crate::{
    events::follower::{Follower, PluginMessage},
    given::Given,
};

/// VNFs that a plug-in may add per second. Each starts programs.
const VNFS_PER_SECOND: f64 = 10.0;
/// VNFs that a plug-in may add at once.
const VNFS_AT_ONCE: f64 = 64.0;
/// VNFs that all plug-ins and domains may have added together at a time, each an equal share. The rest of what can be added is
/// the operator's.
const VNFS_OF_OTHERS: usize = MOST_ADDED / 4 * 3;
/// Time for which a removed VNF still counts, in seconds: its instances may still stop.
const STOPS_WITHIN_S: f64 = 10.0;
/// Bytes of texts and lists that each instruction a second may have on average.
const BYTES_PER_INSTRUCTION: f64 = 64.0;
/// Bytes of texts and lists that a plug-in may give at once.
const BYTES_AT_ONCE: f64 = 1024.0 * 1024.0;

/// Reason for which a plug-in is cut off.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Fault {
    #[error("panicked: {0}")]
    Panicked(String),
    #[error("did not return from a call within {} s", .0.as_secs_f64())]
    Hung(Duration),
    #[error(
        "was not done with mark {mark} within {} s: virtual time stands still until `POST /api/v1/marks/{mark}` says that it is",
        .patience.as_secs_f64()
    )]
    Undone { mark: u64, patience: Duration },
    #[error("followed no `/api/v1/events` within {} s, with the secret in its `COTORRA_TOKEN`", .0.as_secs_f64())]
    Absent(Duration),
    #[error("it gave more than {0} instructions in a second, its `instructions_per_second`")]
    Flooded(InstructionLimit),
    #[error("its program ended: {0}")]
    Ended(ExitStatus),
    #[error("its program is lost: {0}")]
    Lost(std::io::Error),
}

/// Reason for which an instruction is not applied.
#[derive(Debug, thiserror::Error)]
enum NotTriedError {
    #[error("this plug-in was cut off")]
    CutOff,
    #[error("{0}")]
    Fault(Fault),
    #[error("no more than {0} instructions a second are taken")]
    TooMany(InstructionLimit),
    #[error(
        "its texts and lists are too much: no more than {BYTES_AT_ONCE} bytes at once, and {0} a second, are taken"
    )]
    TooManyBytes(f64),
    #[error("no more than {VNFS_AT_ONCE} VNFs at once, and {VNFS_PER_SECOND} a second, are added")]
    TooManyVnfs,
    #[error("{INSTRUCTIONS} instructions of this plug-in are under way, and no more are taken")]
    TooManyUnderWay,
    #[error("the most VNFs that this caller may have added at a time are {0}: remove one")]
    NoVnfLeft(usize),
}

/// The object of plug-ins' instructions: a testbed, or a recorded run, which rejects them all.
pub(crate) trait Controlled {
    /// Applies an instruction, and publishes the decision.
    fn instruct(&mut self, now: Timestamp, given: Given) -> Result<(), InstructionError>;

    /// Stops the robots that a plug-in moved, and publishes the reason for which the plug-in is cut off.
    fn cut_off(&mut self, now: Timestamp, plugin: PluginId, fault: &Fault, robots: &[NodeId]);

    /// Publishes an event about plug-ins.
    fn publish(&mut self, event: Stamped);
}

/// Instructions that a plug-in has left; a token bucket.
#[derive(Debug)]
struct Budget {
    left: f64,
    at: Timestamp,
}

impl Budget {
    /// Takes an amount, of so much a second and at most so much at once.
    fn take(&mut self, now: Timestamp, amount: f64, per_second: f64, at_once: f64) -> bool {
        let earned = now.since(self.at).as_secs_f64() * per_second;
        self.at = self.at.max(now);
        self.left = (self.left + earned).min(at_once);
        let allowed = self.left >= amount;
        if allowed {
            self.left -= amount;
        }
        allowed
    }
}

/// A VNF that was added.
struct Added {
    whose: PluginId,
    vnf: VnfId,
    /// Time of its removal.
    removed: Option<Timestamp>,
}

/// A plug-in that follows the API's events, and that time waits for.
struct Program {
    id: PluginId,
    streams: Vec<Stream>,
    /// Whether time waits for it from the beginning. Time waits for another program only while it follows.
    is_expected: bool,
}

/// A stream that a program follows.
struct Stream {
    follower: Follower,
    queued: Vec<Arc<Stamped>>,
    /// The last mark sent, until the program has returned it.
    open_mark: Option<u64>,
    wake_at: Option<Timestamp>,
    /// Whether a mark is due even without events: the stream is new, or its wake-up time has come.
    is_due: bool,
}

impl Program {
    /// Whether time waits for it: it does not follow yet, has unsent events, or has not returned a mark.
    fn is_waited_for(&self) -> bool {
        let waits = |s: &Stream| s.is_due || s.open_mark.is_some() || !s.queued.is_empty();
        (self.streams.is_empty() && self.is_expected) || self.streams.iter().any(waits)
    }

    /// Queues an event for the streams that see it.
    fn queue(&mut self, event: &Arc<Stamped>) {
        for stream in &mut self.streams {
            stream.queued.extend(stream.follower.sees(event));
        }
    }

    /// Sends each stream without an open mark its events and a new mark.
    fn flush(&mut self, now: Timestamp, marks: &mut u64) {
        self.streams.retain_mut(|stream| {
            if stream.open_mark.is_some() || (stream.queued.is_empty() && !stream.is_due) {
                return true;
            }
            *marks += 1;
            (stream.open_mark, stream.is_due) = (Some(*marks), false);
            let follower = &stream.follower;
            stream.queued.drain(..).all(|event| follower.send(PluginMessage::Event(event)))
                && follower.send(PluginMessage::Mark { number: *marks, now })
        });
    }
}

/// The plug-ins of a run.
pub(crate) struct PluginHost {
    members: BTreeSet<PluginId>,
    cut: BTreeSet<PluginId>,
    /// Limits of plug-ins in the testbed file. All other callers have the default.
    limits: BTreeMap<PluginId, InstructionLimit>,
    budgets: BTreeMap<PluginId, Budget>,
    /// The name of each domain, and plug-ins that are bound to it, with the domain's name. Callers of the API under these names
    /// have the domain's budget, if they are no members.
    domains: BTreeMap<PluginId, PluginId>,
    /// Budget that all other callers of the API share, so that another name is no new budget.
    others: Option<Budget>,
    /// VNFs that each caller with a budget may add, and all others together.
    additions: BTreeMap<Option<PluginId>, Budget>,
    /// VNFs that callers with a budget have added, and when they removed them.
    added: Vec<Added>,
    /// Bytes of texts and lists that each caller with a budget may give, and all others together.
    bytes: BTreeMap<Option<PluginId>, Budget>,
    movers: BTreeMap<NodeId, PluginId>,
    /// In the order in which they are sent events.
    programs: Vec<Program>,
    travel: Travel,
    marks: u64,
    /// Longest silence of a plug-in before it is cut off.
    patience: Duration,
}

impl PluginHost {
    /// Creates a host of these plug-ins.
    pub(crate) fn new(members: impl IntoIterator<Item = PluginId>, patience: Duration) -> Self {
        Self {
            members: members.into_iter().collect(),
            cut: BTreeSet::new(),
            limits: BTreeMap::new(),
            budgets: BTreeMap::new(),
            domains: BTreeMap::new(),
            others: None,
            additions: BTreeMap::new(),
            added: Vec::new(),
            bytes: BTreeMap::new(),
            movers: BTreeMap::new(),
            programs: Vec::new(),
            travel: Travel::default(),
            marks: 0,
            patience,
        }
    }

    /// Limits these plug-ins as the testbed file says.
    pub(crate) fn with_limits(mut self, plugins: &[PluginSpec]) -> Self {
        self.limits = plugins.iter().map(|spec| (spec.id.clone(), spec.instructions_per_second)).collect();
        let bound = |spec: &PluginSpec| {
            let domain = PluginId::new(spec.domain.as_ref()?.as_str()).ok()?;
            Some((spec.id.clone(), domain))
        };
        self.domains.extend(plugins.iter().filter_map(bound));
        self
    }

    /// Lets contexts and instructions travel.
    pub(crate) fn with_travel(self, travel: Travel) -> Self {
        Self { travel, ..self }
    }

    /// Gives callers on behalf of these domains a budget each.
    pub(crate) fn with_domains(mut self, domains: &[DomainId]) -> Self {
        let names = domains.iter().filter_map(|domain| PluginId::new(domain.as_str()).ok());
        self.domains.extend(names.map(|name| (name.clone(), name)));
        self
    }

    /// Adds a plug-in.
    pub(crate) fn add(&mut self, plugin: PluginId) {
        self.members.insert(plugin);
    }

    /// Returns the longest silence of a plug-in before it is cut off.
    pub(crate) fn patience(&self) -> Duration {
        self.patience
    }

    pub(crate) fn set_patience(&mut self, patience: Duration) {
        self.patience = patience;
    }

    /// Whether a plug-in was cut off; its shell has to end it.
    pub(crate) fn is_cut_off(&self, plugin: &PluginId) -> bool {
        self.cut.contains(plugin)
    }

    /// Applies an instruction given at `now`, if it is admitted. A plug-in that gives too many is cut off. The instruction of a
    /// plug-in that is away sets off, and is applied when it has arrived.
    pub(crate) fn instruct(
        &mut self,
        now: Timestamp,
        given: Given,
        controlled: &mut impl Controlled,
    ) -> Result<(), InstructionError> {
        if self.travel.is_away(&given.plugin) {
            // What is under way stays in memory.
            measure(&given)?;
        }
        match self.travel.send_instruction(now, given) {
            Sent::Arrived(given) => self.apply(now, *given, Vec::new(), controlled),
            Sent::UnderWay => Ok(()),
            Sent::Rejected => Err(InstructionError(NotTriedError::TooManyUnderWay.to_string())),
        }
    }

    /// Applies instructions of plug-ins that have arrived at the core.
    pub(crate) fn apply_arrived(&mut self, now: Timestamp, controlled: &mut impl Controlled) {
        while let Some((given, staleness)) = self.travel.next_instruction(now) {
            // A rejection is part of the published decision.
            let _ = self.apply(now, given, staleness, controlled);
        }
    }

    fn apply(
        &mut self,
        now: Timestamp,
        given: Given,
        staleness: Vec<Staleness>,
        controlled: &mut impl Controlled,
    ) -> Result<(), InstructionError> {
        let Given { plugin, instruction, .. } = &given;
        if let Err(refusal) = self.admit(now, plugin) {
            let refused = InstructionError(refusal.to_string());
            if let NotTriedError::Fault(fault) = refusal {
                self.cut_off(now, plugin, &fault, controlled);
            }
            return Err(refused);
        }
        self.admit_bytes(now, plugin, measure(&given)?)
            .map_err(|error| InstructionError(error.to_string()))?;
        if matches!(instruction, Instruction::AddVnf { .. }) {
            self.admit_vnf(now, plugin).map_err(|error| InstructionError(error.to_string()))?;
        }
        let moved = match instruction {
            Instruction::Move { robot, .. } if self.movers.get(robot) != Some(plugin) => {
                Some((robot.clone(), plugin.clone()))
            }
            _ => None,
        };
        let whose = self.whose(plugin);
        let vnf = match instruction {
            Instruction::AddVnf { vnf } => Some((vnf.id.clone(), true)),
            Instruction::RemoveVnf { vnf } => Some((vnf.clone(), false)),
            _ => None,
        };
        let done = controlled.instruct(now, given);
        let events = staleness.into_iter().map(Event::Staleness);
        events.for_each(|event| controlled.publish(Stamped { at: now, event }));
        done?;
        match (vnf, whose) {
            (Some((vnf, true)), Some(whose)) => self.added.push(Added { whose, vnf, removed: None }),
            (Some((vnf, false)), _) => {
                let of_vnf =
                    self.added.iter_mut().filter(|added| added.vnf == vnf && added.removed.is_none());
                of_vnf.for_each(|added| added.removed = Some(now));
            }
            _ => {}
        }
        self.movers.extend(moved);
        Ok(())
    }

    /// Applies the outcome of a plug-in's call that returned at `now`, until the plug-in is cut off.
    pub(crate) fn returned(
        &mut self,
        now: Timestamp,
        plugin: &PluginId,
        outcome: Result<Actions, Fault>,
        controlled: &mut impl Controlled,
    ) {
        let mut actions = match outcome {
            Ok(actions) => actions,
            Err(fault) => return self.cut_off(now, plugin, &fault, controlled),
        };
        for (instruction, reason) in actions.drain() {
            if self.is_cut_off(plugin) {
                return;
            }
            // A rejection is part of the published decision.
            let _ = self.instruct(now, Given { plugin: plugin.clone(), instruction, reason }, controlled);
        }
    }

    /// Cuts a plug-in off. Only its first fault counts.
    pub(crate) fn cut_off(
        &mut self,
        now: Timestamp,
        plugin: &PluginId,
        fault: &Fault,
        controlled: &mut impl Controlled,
    ) {
        if !self.cut.insert(plugin.clone()) {
            return;
        }
        self.programs.retain(|program| program.id != *plugin);
        self.travel.forget(plugin);
        let robots: Vec<_> =
            self.movers.iter().filter(|(_, by)| *by == plugin).map(|(robot, _)| robot.clone()).collect();
        self.movers.retain(|_, by| by != plugin);
        controlled.cut_off(now, plugin.clone(), fault, &robots);
    }

    /// Whether a plug-in may add a VNF now.
    fn admit_vnf(&mut self, now: Timestamp, plugin: &PluginId) -> Result<(), NotTriedError> {
        let whose = self.whose(plugin);
        self.added.retain(|added| {
            added.removed.is_none_or(|removed| now.since(removed).as_secs_f64() < STOPS_WITHIN_S)
        });
        if let Some(whose) = &whose {
            let share = self.vnf_share();
            if self.added.iter().filter(|added| added.whose == *whose).count() >= share {
                return Err(NotTriedError::NoVnfLeft(share));
            }
        }
        let budget = self.additions.entry(whose).or_insert(Budget { left: VNFS_AT_ONCE, at: now });
        let is_admitted = budget.take(now, 1.0, VNFS_PER_SECOND, VNFS_AT_ONCE);
        if is_admitted { Ok(()) } else { Err(NotTriedError::TooManyVnfs) }
    }

    /// Returns how many VNFs each plug-in and each domain may have added at a time.
    fn vnf_share(&self) -> usize {
        let domains: BTreeSet<_> =
            self.domains.values().filter(|domain| !self.members.contains(*domain)).collect();
        (VNFS_OF_OTHERS / (self.members.len() + domains.len()).max(1)).max(1)
    }

    /// Returns the owner of a budget; `None` for all callers without one of their own.
    fn whose(&self, plugin: &PluginId) -> Option<PluginId> {
        if self.members.contains(plugin) { Some(plugin.clone()) } else { self.domains.get(plugin).cloned() }
    }

    /// Returns the instructions that a plug-in may give in a second.
    fn limit(&self, plugin: &PluginId) -> InstructionLimit {
        let is_plugin = self.members.contains(plugin);
        self.limits.get(plugin).copied().filter(|_| is_plugin).unwrap_or_default()
    }

    /// Whether a plug-in may give an instruction with so many bytes now. They stay in memory until all readers of events have
    /// them, and in the history.
    fn admit_bytes(&mut self, now: Timestamp, plugin: &PluginId, bytes: usize) -> Result<(), NotTriedError> {
        let (whose, per_second) =
            (self.whose(plugin), f64::from(self.limit(plugin).get()) * BYTES_PER_INSTRUCTION);
        let budget = self.bytes.entry(whose).or_insert(Budget { left: BYTES_AT_ONCE, at: now });
        let is_admitted = budget.take(now, bytes as f64, per_second, BYTES_AT_ONCE);
        if is_admitted { Ok(()) } else { Err(NotTriedError::TooManyBytes(per_second)) }
    }

    fn admit(&mut self, now: Timestamp, plugin: &PluginId) -> Result<(), NotTriedError> {
        if self.is_cut_off(plugin) {
            return Err(NotTriedError::CutOff);
        }
        let (is_plugin, limit) = (self.members.contains(plugin), self.limit(plugin));
        let per_second = f64::from(limit.get());
        let full = || Budget { left: per_second, at: now };
        let budget = match self.whose(plugin) {
            Some(whose) => self.budgets.entry(whose).or_insert_with(full),
            None => self.others.get_or_insert_with(full),
        };
        if budget.take(now, 1.0, per_second, per_second) {
            return Ok(());
        }
        // A caller of the API that is no plug-in may come back later.
        Err(if is_plugin {
            NotTriedError::Fault(Fault::Flooded(limit))
        } else {
            NotTriedError::TooMany(limit)
        })
    }
}

/// Returns the bytes of texts and lists of an instruction and its reason, or rejects those that are beyond a bound.
fn measure(Given { instruction, reason, .. }: &Given) -> Result<usize, InstructionError> {
    let bytes = instruction.measure().map_err(|error| InstructionError(error.to_string()))?;
    let of_reason = reason.as_ref().map_or(0, String::len);
    if of_reason > Instruction::LONGEST_REASON {
        let longest = Instruction::LONGEST_REASON;
        return Err(InstructionError(format!("its reason has {of_reason} bytes, more than {longest}")));
    }
    Ok(bytes + of_reason)
}

/// What is on its way between the core and plug-ins that are away from it.
impl PluginHost {
    /// Whether a plug-in is away from the core.
    pub(crate) fn is_away(&self, plugin: &PluginId) -> bool {
        self.travel.is_away(plugin)
    }

    /// Sends a context to a plug-in in process. Returns it if the plug-in is beside the core.
    pub(crate) fn send_context(
        &mut self,
        now: Timestamp,
        plugin: &PluginId,
        event: Arc<Stamped>,
    ) -> Option<Arc<Stamped>> {
        self.travel.send_context(now, plugin, event)
    }

    /// Returns the next context that has arrived at a plug-in in process that is free to decide.
    pub(crate) fn next_context(&mut self, now: Timestamp, plugin: &PluginId) -> Option<Arc<Stamped>> {
        self.travel.next_context(now, plugin)
    }

    /// Sets the CPU time that a program has used for the decision that it makes now, if that is measured.
    pub(crate) fn decide_in(&mut self, plugin: &PluginId, used: Duration) {
        self.travel.decide_in(plugin, used);
    }

    /// Returns the next context that has arrived at a plug-in in process, in real time, if it has handled those before.
    pub(crate) fn hand_over(&mut self, now: Timestamp, plugin: &PluginId) -> Option<Arc<Stamped>> {
        self.travel.hand_over(now, plugin)
    }

    /// Notes that a plug-in has handled the context that was handed over.
    pub(crate) fn handled(&mut self, plugin: &PluginId) {
        self.travel.handled(plugin);
    }

    /// Returns the number of contexts that plug-ins missed because they were too far behind.
    pub(crate) fn missed(&self) -> u64 {
        self.travel.missed()
    }

    /// Returns when a plug-in is free to decide.
    pub(crate) fn free_at(&self, plugin: &PluginId) -> Timestamp {
        self.travel.free_at(plugin)
    }

    /// Returns the next datagram between the core and a plug-in.
    pub(crate) fn poll_transmit(&mut self, now: Timestamp) -> Option<Datagram> {
        self.travel.poll_transmit(now)
    }

    /// Handles a datagram that has arrived at its node.
    pub(crate) fn receive(&mut self, now: Timestamp, datagram: &Datagram) {
        self.travel.receive(now, datagram);
    }

    /// Returns when something arrives or departs next. Times in the past are due now.
    pub(crate) fn next_travel(&self) -> Option<Timestamp> {
        self.travel.next_deadline()
    }
}

/// The protocol of streams and marks, by which time waits for programs.
impl PluginHost {
    /// Makes time wait for this program from the beginning.
    pub(crate) fn expect(&mut self, plugin: PluginId) {
        self.members.insert(plugin.clone());
        self.programs.push(Program { id: plugin, streams: Vec::new(), is_expected: true });
    }

    /// Adds a program's stream, and sends it a mark at once.
    pub(crate) fn follow(&mut self, now: Timestamp, follower: Follower) {
        if self.is_cut_off(&follower.plugin) {
            return;
        }
        let id = follower.plugin.clone();
        let stream = Stream { follower, queued: Vec::new(), open_mark: None, wake_at: None, is_due: true };
        let place = self.programs.iter().position(|program| program.id == id).unwrap_or_else(|| {
            self.members.insert(id.clone());
            self.programs.push(Program { id, streams: Vec::new(), is_expected: false });
            self.programs.len() - 1
        });
        let program = &mut self.programs[place];
        program.streams.push(stream);
        program.flush(now, &mut self.marks);
    }

    /// Takes a mark back from a program. Returns whether the program had been sent that mark.
    pub(crate) fn done(&mut self, plugin: &PluginId, mark: u64, wake_at: Option<Timestamp>) -> bool {
        let own = self.programs.iter_mut().filter(|program| program.id == *plugin);
        let stream =
            own.flat_map(|program| &mut program.streams).find(|stream| stream.open_mark == Some(mark));
        stream.map(|stream| (stream.open_mark, stream.wake_at) = (None, wake_at)).is_some()
    }

    /// Queues an event for the programs, or sends it to those that are away. They get it with their next mark.
    pub(crate) fn publish(&mut self, now: Timestamp, event: &Arc<Stamped>) {
        for program in &mut self.programs {
            if !self.travel.is_away(&program.id) {
                program.queue(event);
            } else if program.streams.iter().any(|stream| stream.follower.sees(event).is_some()) {
                self.travel.send_context(now, &program.id, Arc::clone(event));
            }
        }
    }

    /// Makes a mark due for programs at which events have arrived, or whose wake-up time has come.
    pub(crate) fn wake(&mut self, now: Timestamp) {
        while let Some((plugin, event)) = self.travel.next_context_of_programs(now) {
            let program = self.programs.iter_mut().find(|program| program.id == plugin);
            program.into_iter().for_each(|program| program.queue(&event));
        }
        for program in &mut self.programs {
            let has_come = |at: &mut Timestamp| *at <= now;
            if self.travel.free_at(&program.id) <= now {
                program.streams.iter_mut().for_each(|s| s.is_due |= s.wake_at.take_if(has_come).is_some());
            }
        }
    }

    /// Returns the next wake-up time of a program.
    pub(crate) fn next_wake(&self) -> Option<Timestamp> {
        let wakes = self.programs.iter().flat_map(|program| {
            let free_at = self.travel.free_at(&program.id);
            program.streams.iter().filter_map(move |stream| Some(stream.wake_at?.max(free_at)))
        });
        wakes.chain(self.travel.next_context_at_programs()).min()
    }

    /// Returns the first program that time waits for.
    pub(crate) fn next_awaited(&self) -> Option<PluginId> {
        self.programs.iter().find(|program| program.is_waited_for()).map(|program| program.id.clone())
    }

    /// Sends a program its events.
    pub(crate) fn flush(&mut self, now: Timestamp, plugin: &PluginId) {
        let program = self.programs.iter_mut().find(|program| program.id == *plugin);
        program.into_iter().for_each(|program| program.flush(now, &mut self.marks));
    }

    /// Whether a program has not returned its mark yet, or does not follow yet.
    pub(crate) fn is_busy(&self, plugin: &PluginId) -> bool {
        let program = self.programs.iter().find(|program| program.id == *plugin);
        program.is_some_and(|program| match &program.streams[..] {
            [] => program.is_expected,
            streams => streams.iter().any(|stream| stream.open_mark.is_some()),
        })
    }

    /// Returns the fault of a program that was silent for longer than the host's patience.
    pub(crate) fn silence(&self, plugin: &PluginId) -> Fault {
        let mut streams = self.programs.iter().filter(|p| p.id == *plugin).flat_map(|p| &p.streams);
        let patience = self.patience;
        match streams.find_map(|stream| stream.open_mark) {
            Some(mark) => Fault::Undone { mark, patience },
            None => Fault::Absent(patience),
        }
    }

    /// Removes streams without a reader.
    pub(crate) fn forget_gone(&mut self) {
        for program in &mut self.programs {
            program.streams.retain(|stream| !stream.follower.is_gone());
        }
        self.programs.retain(|program| program.is_expected || !program.streams.is_empty());
    }

    /// Returns the number of streams.
    pub(crate) fn followers(&self) -> usize {
        self.programs.iter().map(|program| program.streams.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Program, Vnf};
    use cotorra_graph_testing as base;

    use super::*;
    use crate::events::follower::EventFilter;

    /// Applies every instruction, and records faults.
    #[derive(Default)]
    struct Obedient {
        done: usize,
        faults: Vec<(String, Vec<NodeId>)>,
    }

    impl Controlled for Obedient {
        fn instruct(&mut self, _now: Timestamp, _given: Given) -> Result<(), InstructionError> {
            self.done += 1;
            Ok(())
        }

        fn cut_off(&mut self, _now: Timestamp, plugin: PluginId, fault: &Fault, robots: &[NodeId]) {
            self.faults.push((format!("{plugin}: {fault}"), robots.to_vec()));
        }

        fn publish(&mut self, _event: Stamped) {}
    }

    fn move_robot() -> Instruction {
        Instruction::Move { robot: "robot".parse().unwrap(), velocity: Default::default(), waypoint: 0 }
    }

    #[test]
    fn a_flood_is_rejected_and_names_the_robots_it_moved() {
        let (flooding, somebody): (PluginId, PluginId) =
            ("flooding".parse().unwrap(), "somebody".parse().unwrap());
        let mut host = PluginHost::new([flooding.clone()], Duration::from_secs(1));
        let mut testbed = Obedient::default();
        let now = Timestamp::from_secs_f64(1.0);
        let mut ask = |now, who: &PluginId, testbed: &mut Obedient| {
            host.instruct(now, Given::new(who.clone(), move_robot()), testbed).map_err(|refused| refused.0)
        };
        for _ in 0..1000 {
            ask(now, &flooding, &mut testbed).unwrap();
        }
        let flooded = Fault::Flooded(InstructionLimit::default()).to_string();
        assert_eq!(ask(now, &flooding, &mut testbed), Err(flooded.clone()));
        let robot: NodeId = "robot".parse().unwrap();
        assert_eq!(testbed.faults, [(format!("flooding: {flooded}"), vec![robot])]);
        let later = now + Duration::from_secs(1);
        assert_eq!(ask(later, &flooding, &mut testbed), Err("this plug-in was cut off".to_owned()));
        // A caller that is no plug-in is rejected, and may come back later.
        for _ in 0..1000 {
            ask(now, &somebody, &mut testbed).unwrap();
        }
        assert!(ask(now, &somebody, &mut testbed).unwrap_err().starts_with("no more than 1000"));
        assert_eq!(ask(later, &somebody, &mut testbed), Ok(()));
        assert_eq!((testbed.done, testbed.faults.len()), (2001, 1));
        assert!(host.is_cut_off(&flooding) && !host.is_cut_off(&somebody));
    }

    #[test]
    fn each_plugin_has_its_own_limit() {
        let spec = |id: &str, per_second| PluginSpec {
            id: id.parse().unwrap(),
            program: cotorra_graph::PluginProgram::Bundled("probing".to_owned()),
            domain: None,
            optional: false,
            instructions_per_second: InstructionLimit::new(per_second).unwrap(),
            distance: Default::default(),
            env: Vec::new(),
            settings: Default::default(),
        };
        let specs = [spec("few", 10), spec("many", 3000)];
        let members = specs.iter().map(|spec| spec.id.clone());
        let mut host = PluginHost::new(members, Duration::from_secs(1)).with_limits(&specs);
        let mut testbed = Obedient::default();
        let now = Timestamp::from_secs_f64(1.0);
        let mut done = |who: &PluginId| {
            let ask =
                |_: &i32| host.instruct(now, Given::new(who.clone(), move_robot()), &mut testbed).is_ok();
            (0..5000).filter(ask).count()
        };
        let [few, many] = specs.each_ref().map(|spec| done(&spec.id));
        assert_eq!((few, many), (10, 3000));
        let [(few, _), (many, _)] = &testbed.faults[..] else { panic!("{:?}", testbed.faults) };
        assert!(few.starts_with("few: it gave more than 10 instructions in a second"), "{few}");
        assert!(many.starts_with("many: it gave more than 3000 instructions in a second"), "{many}");
    }

    #[test]
    fn a_callers_texts_and_lists_are_bounded_in_bytes() {
        let domain: DomainId = "one".parse().unwrap();
        let mut host =
            PluginHost::new([], Duration::from_secs(1)).with_domains(std::slice::from_ref(&domain));
        let link = |n: usize| format!("{n:03}{}", "l".repeat(120)).parse().unwrap();
        let (from, to) = ("a".parse().unwrap(), "b".parse().unwrap());
        let links = (0..Instruction::MOST_LINKS).map(link).collect();
        let longest = Instruction::Map { from, to, links, reservation: None };
        let (bytes, seconds) = (longest.measure().unwrap(), 60);
        let mut testbed = Obedient::default();
        for second in 0..seconds {
            for _ in 0..1000 {
                let now = Timestamp::from_secs_f64(f64::from(second));
                let _ = host.instruct(now, Given::new("one".parse().unwrap(), longest.clone()), &mut testbed);
            }
        }
        let most = BYTES_AT_ONCE + f64::from(seconds) * 1000.0 * BYTES_PER_INSTRUCTION;
        let given = testbed.done * bytes;
        assert!(given as f64 <= most && given as f64 > 0.9 * most, "{given} of {most} bytes");
        // Another caller has its own share, and one beyond a bound is rejected at once.
        let now = Timestamp::from_secs_f64(f64::from(seconds - 1));
        let mut give = |instruction, reason| {
            host.instruct(now, Given { plugin: "api".parse().unwrap(), instruction, reason }, &mut testbed)
        };
        give(longest.clone(), None).unwrap();
        let Instruction::Map { from, to, mut links, reservation } = longest else { unreachable!() };
        links.push(link(0));
        let refused = give(Instruction::Map { from, to, links, reservation }, None).unwrap_err();
        assert_eq!(refused.0, "its `links` has 257 items: at most 256 are taken");
    }

    #[test]
    fn an_overlong_reason_is_rejected_with_its_instruction() {
        let plugin: PluginId = "plugin".parse().unwrap();
        let mut host = PluginHost::new([plugin.clone()], Duration::from_secs(1));
        let mut testbed = Obedient::default();
        let mut ask = |bytes: usize, testbed: &mut Obedient| {
            let reason = Some("x".repeat(bytes));
            let given = Given { plugin: plugin.clone(), instruction: move_robot(), reason };
            host.instruct(Timestamp::ZERO, given, testbed)
        };
        assert_eq!(ask(Instruction::LONGEST_REASON, &mut testbed), Ok(()));
        let refused = ask(Instruction::LONGEST_REASON + 1, &mut testbed).unwrap_err();
        assert_eq!(refused.0, "its reason has 1025 bytes, more than 1024");
        assert_eq!((testbed.done, testbed.faults.len()), (1, 0));
    }

    #[test]
    fn a_mark_is_taken_back_only_from_its_receiver() {
        let (own, other): (PluginId, PluginId) = ("own".parse().unwrap(), "other".parse().unwrap());
        let mut host = PluginHost::new([], Duration::from_secs(1));
        host.expect(own.clone());
        let (follower, mut stream) = Follower::new(own.clone(), EventFilter::default());
        host.follow(Timestamp::ZERO, follower);
        let Ok(PluginMessage::Mark { number, .. }) = stream.try_recv() else { panic!("no mark") };
        assert!(!host.done(&other, number, None) && host.is_busy(&own));
        assert!(host.done(&own, number, None) && !host.is_busy(&own));
    }

    #[test]
    fn another_name_shares_the_same_budget() {
        let name = |text: String| PluginId::new(&text).unwrap();
        let domain: DomainId = "lab".parse().unwrap();
        let mut host =
            PluginHost::new([name("member".into())], Duration::from_secs(1)).with_domains(&[domain]);
        let mut testbed = Obedient::default();
        let now = Timestamp::from_secs_f64(1.0);
        let mut ask =
            |who: String| host.instruct(now, Given::new(name(who), move_robot()), &mut testbed).is_ok();
        let done = (0..3000).filter(|i| ask(format!("invented-{i}"))).count();
        assert_eq!(done, 1000);
        assert!(ask("member".into()) && ask("lab".into()), "these have their own");
        assert!(host.budgets.len() == 2, "invented names have no budget of their own");
    }

    #[test]
    fn the_rate_of_added_vnfs_is_bounded_for_each_plugin() {
        let [plugin, other]: [PluginId; 2] = ["plugin", "other"].map(|name| name.parse().unwrap());
        let mut host = PluginHost::new([plugin.clone(), other.clone()], Duration::from_secs(1));
        let mut testbed = Obedient::default();
        let vnf = Vnf {
            program: Program::Command(vec!["serve".to_owned()]),
            memory_bytes: 1,
            node: "edge".parse::<NodeId>().unwrap().into(),
            ..base::vnf("new", "server")
        };
        let mut add = |seconds: f64, plugin: &PluginId| {
            let now = Timestamp::from_secs_f64(seconds);
            let instruction = Instruction::AddVnf { vnf: Box::new(vnf.clone()) };
            host.instruct(now, Given::new(plugin.clone(), instruction), &mut testbed)
        };
        assert_eq!((0..200).filter(|_| add(1.0, &plugin).is_ok()).count(), 64);
        assert_eq!(
            add(1.0, &plugin).unwrap_err().0,
            "no more than 64 VNFs at once, and 10 a second, are added"
        );
        assert_eq!(add(1.0, &other), Ok(()), "each has its own");
        assert_eq!((0..200).filter(|_| add(1.5, &plugin).is_ok()).count(), 5);
        assert!(testbed.faults.is_empty(), "it is not cut off");
    }

    #[test]
    fn domains_and_plugins_leave_vnfs_to_the_operator() {
        let name = |text: &str| text.parse::<PluginId>().unwrap();
        let domains: [DomainId; 2] = ["one", "two"].map(|name| name.parse().unwrap());
        let mut host = PluginHost::new([name("member")], Duration::from_secs(1)).with_domains(&domains);
        let mut testbed = Obedient::default();
        let vnf = serde_json::json!({
            "id": "v", "program": { "command": ["serve"] }, "cpus": 1.0, "memory_bytes": 1, "node": "edge"
        });
        let vnf = |number: usize| Vnf {
            id: format!("v{number}").parse().unwrap(),
            ..serde_json::from_value(vnf.clone()).unwrap()
        };
        let mut seconds = 0.0;
        let mut give = |who: &str, instruction: Instruction, pause: f64| {
            seconds += pause;
            host.instruct(Timestamp::from_secs_f64(seconds), Given::new(name(who), instruction), &mut testbed)
        };
        let add = |number| Instruction::AddVnf { vnf: Box::new(vnf(number)) };
        let mut others = 0;
        for (place, who) in ["one", "two", "member"].into_iter().enumerate() {
            let added = (0..300).filter(|number| give(who, add(1000 * place + number), 0.2).is_ok()).count();
            assert_eq!(added, VNFS_OF_OTHERS / 3, "{who}");
            others += added;
        }
        assert!(others + 64 <= MOST_ADDED, "64 are the operator's");
        assert_eq!((0..64).filter(|number| give("api", add(5000 + number), 0.2).is_ok()).count(), 64);
        // A removed VNF may still stop for a while.
        let remove = Instruction::RemoveVnf { vnf: vnf(0).id };
        give("one", remove, 0.2).unwrap();
        assert_eq!(
            give("one", add(7000), 1.0).unwrap_err().0,
            "the most VNFs that this caller may have added at a time are 64: remove one"
        );
        give("one", add(7000), STOPS_WITHIN_S).unwrap();
    }

    #[test]
    fn plugins_of_a_domain_share_its_budget() {
        let name = |text: &str| text.parse::<PluginId>().unwrap();
        let mut host = PluginHost::new([], Duration::from_secs(1)).with_domains(&["one".parse().unwrap()]);
        host.domains.insert(name("elsewhere"), name("one"));
        let mut testbed = Obedient::default();
        let now = Timestamp::from_secs_f64(1.0);
        let mut ask =
            |who: &str| host.instruct(now, Given::new(name(who), move_robot()), &mut testbed).is_ok();
        assert_eq!((0..3000).filter(|n| ask(if n % 2 == 0 { "one" } else { "elsewhere" })).count(), 1000);
        assert!(ask("api"), "the operator has its own");
    }

    #[test]
    fn only_the_first_fault_of_a_plugin_counts() {
        let plugin: PluginId = "plugin".parse().unwrap();
        let mut host = PluginHost::new([plugin.clone()], Duration::from_secs(1));
        let mut testbed = Obedient::default();
        host.cut_off(Timestamp::ZERO, &plugin, &Fault::Panicked("once".to_owned()), &mut testbed);
        host.cut_off(Timestamp::ZERO, &plugin, &Fault::Hung(Duration::from_secs(2)), &mut testbed);
        assert_eq!(testbed.faults, [("plugin: panicked: once".to_owned(), Vec::new())]);
    }
}
