//! Contexts and instructions on their way between the core and plug-ins that are away from it. A state machine without a
//! clock or a socket. Messages take a fixed time, or are [`Datagrams`] for a network that the caller has.
//!
//! A plug-in decides on one context at a time. While it decides, further ones wait.

mod datagrams;
mod known;

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    CpuFactor, DecidesIn, PluginId, PluginProgram, PluginSpec, Staleness, Stamped, Timestamp, Way,
};

pub(crate) use self::datagrams::Datagram;
use self::{
    datagrams::{Datagrams, Heard},
    known::{Ages, Known},
};
use crate::given::Given;

/// Both ports of datagrams between the core and plug-ins on nodes.
pub(crate) const CONTROL_PORT: u16 = 40_002;

/// Contexts that wait for a plug-in. One that is further behind misses the oldest.
const QUEUE: usize = 4096;
/// Instructions of a plug-in under way. Further ones are rejected.
pub(crate) const INSTRUCTIONS: usize = 4096;

/// The plug-ins that are away from the core, or take time to decide.
#[derive(Default)]
pub(crate) struct Travel {
    away: BTreeMap<PluginId, Away>,
    /// Number of contexts that plug-ins missed because they were too far behind.
    missed: u64,
}

/// The fate of an instruction that a plug-in gives.
#[derive(Debug, PartialEq)]
pub(crate) enum Sent {
    /// The plug-in is beside the core: the instruction is there.
    Arrived(Box<Given>),
    UnderWay,
    /// Too many are under way.
    Rejected,
}

/// An instruction, and the contexts on which it was decided.
struct Decided {
    given: Given,
    ages: Ages,
}

struct Away {
    is_program: bool,
    way: Carrier,
    /// Time of a decision; of a measured one, of that which it makes now.
    decides_in: Duration,
    /// Factor of measured times.
    measured: Option<CpuFactor>,
    /// End of its current decision.
    free_at: Timestamp,
    /// Contexts with their times of arrival, in order.
    contexts: VecDeque<(Timestamp, Arc<Stamped>)>,
    /// The context that it handles now, in process in real time.
    in_hand: Option<Arc<Stamped>>,
    known: Known,
    /// Instructions with the end of their decision, in order.
    decided: VecDeque<(Timestamp, Decided)>,
    /// Instructions with their times of arrival, in order.
    instructions: VecDeque<(Timestamp, Decided)>,
}

enum Carrier {
    Delay(Duration),
    Network(Box<Datagrams<Decided>>),
}

impl Travel {
    /// Creates the state of plug-ins in virtual time.
    pub(crate) fn in_virtual_time(plugins: &[PluginSpec]) -> Self {
        let away = plugins.iter().filter(|spec| !spec.distance.is_none()).map(Away::of).collect();
        Self { away, missed: 0 }
    }

    /// Creates the state of plug-ins in real time, where decisions take the time that plug-ins take.
    pub(crate) fn in_real_time(plugins: &[PluginSpec]) -> Self {
        let far = plugins.iter().filter(|spec| spec.distance.way != Way::None).map(Away::of);
        let at_once = |(id, away)| (id, Away { decides_in: Duration::ZERO, measured: None, ..away });
        Self { away: far.map(at_once).collect(), missed: 0 }
    }

    /// Whether a plug-in is away.
    pub(crate) fn is_away(&self, plugin: &PluginId) -> bool {
        self.away.contains_key(plugin)
    }

    /// Sends a context to a plug-in. Returns it if the plug-in is not away.
    pub(crate) fn send_context(
        &mut self,
        now: Timestamp,
        plugin: &PluginId,
        event: Arc<Stamped>,
    ) -> Option<Arc<Stamped>> {
        let Some(away) = self.away.get_mut(plugin) else { return Some(event) };
        match &mut away.way {
            Carrier::Delay(delay) => away.contexts.push_back((now + *delay, event)),
            Carrier::Network(datagrams) => datagrams.send_context(event),
        }
        None
    }

    /// Returns the next context that has arrived at a plug-in that is free. The plug-in knows it from now on.
    pub(crate) fn next_context(&mut self, now: Timestamp, plugin: &PluginId) -> Option<Arc<Stamped>> {
        let away = self.away.get_mut(plugin)?;
        let event = away.next_context(now, &mut self.missed)?;
        away.known.add(&event);
        Some(event)
    }

    /// Returns the next context that has arrived at a plug-in in process, in real time. It gets no other, and does not know this
    /// one, until it has [handled](Self::handled) it.
    pub(crate) fn hand_over(&mut self, now: Timestamp, plugin: &PluginId) -> Option<Arc<Stamped>> {
        let away = self.away.get_mut(plugin)?;
        let event = away.next_context(now, &mut self.missed)?;
        away.in_hand = Some(Arc::clone(&event));
        Some(event)
    }

    /// Notes that a plug-in has handled the context that was handed over, before instructions that it gave because of it.
    pub(crate) fn handled(&mut self, plugin: &PluginId) {
        let Some(away) = self.away.get_mut(plugin) else { return };
        if let Some(event) = away.in_hand.take() {
            away.known.add(&event);
        }
    }

    /// Returns the next context that has arrived at a program that is free.
    pub(crate) fn next_context_of_programs(&mut self, now: Timestamp) -> Option<(PluginId, Arc<Stamped>)> {
        let Self { away, missed } = self;
        let mut programs = away.iter_mut().filter(|(_, away)| away.is_program);
        programs.find_map(|(id, away)| {
            let event = away.next_context(now, missed)?;
            away.known.add(&event);
            Some((id.clone(), event))
        })
    }

    /// Sets the CPU time that a program has used for the decision that it makes now, if that is measured.
    pub(crate) fn decide_in(&mut self, plugin: &PluginId, used: Duration) {
        if let Some(away) = self.away.get_mut(plugin)
            && let Some(factor) = away.measured
        {
            away.decides_in = factor.of(used);
        }
    }

    /// Returns the number of contexts that plug-ins missed because they were too far behind.
    pub(crate) fn missed(&self) -> u64 {
        self.missed
    }

    /// Sends an instruction of a plug-in to the core, after the time of its decision.
    pub(crate) fn send_instruction(&mut self, now: Timestamp, given: Given) -> Sent {
        let Some(away) = self.away.get_mut(&given.plugin) else { return Sent::Arrived(given.into()) };
        if away.instructions_under_way() >= INSTRUCTIONS {
            return Sent::Rejected;
        }
        let departs = now + away.decides_in;
        away.free_at = away.free_at.max(departs);
        let decided = Decided { given, ages: away.known.ages() };
        match &away.way {
            Carrier::Delay(delay) => away.instructions.push_back((departs + *delay, decided)),
            Carrier::Network(_) => away.decided.push_back((departs, decided)),
        }
        Sent::UnderWay
    }

    /// Returns the next instruction that has arrived at the core, and how old the contexts are that it was decided on.
    pub(crate) fn next_instruction(&mut self, now: Timestamp) -> Option<(Given, Vec<Staleness>)> {
        let arrived = self.away.values_mut().find_map(|away| pop_due(&mut away.instructions, now));
        arrived.map(|Decided { given, ages }| {
            let staleness = ages.at(now, &given.plugin);
            (given, staleness)
        })
    }

    /// Returns when a plug-in is free to decide.
    pub(crate) fn free_at(&self, plugin: &PluginId) -> Timestamp {
        self.away.get(plugin).map_or(Timestamp::ZERO, |away| away.free_at)
    }

    /// Returns the next datagram to send.
    pub(crate) fn poll_transmit(&mut self, now: Timestamp) -> Option<Datagram> {
        self.away.values_mut().zip(0..).find_map(|(away, number)| {
            let Carrier::Network(datagrams) = &mut away.way else { return None };
            while let Some(decided) = pop_due(&mut away.decided, now) {
                let json = decided.given.json();
                datagrams.send_instruction(now, decided, json);
            }
            datagrams.poll_transmit(now, number)
        })
    }

    /// Handles a datagram that has arrived at its node.
    pub(crate) fn receive(&mut self, now: Timestamp, datagram: &Datagram) {
        let number = datagrams::number(&datagram.payload).map(usize::from);
        let Some(away) = number.and_then(|number| self.away.values_mut().nth(number)) else { return };
        let Carrier::Network(datagrams) = &mut away.way else { return };
        match datagrams.receive(datagram) {
            Heard::Context(event) => away.contexts.push_back((now, event)),
            Heard::Instructions(several) => {
                away.instructions.extend(several.into_iter().map(|decided| (now, decided)));
            }
            Heard::Nothing => {}
        }
    }

    /// Returns when something arrives or departs next. Times in the past are due now.
    pub(crate) fn next_deadline(&self) -> Option<Timestamp> {
        self.away.values().filter_map(Away::next_deadline).min()
    }

    /// Returns when a context arrives next at a program that is free.
    pub(crate) fn next_context_at_programs(&self) -> Option<Timestamp> {
        self.away.values().filter(|away| away.is_program).filter_map(Away::next_arrival).min()
    }

    /// Forgets what is on its way from and to a plug-in.
    pub(crate) fn forget(&mut self, plugin: &PluginId) {
        // Its place among the others stays, because datagrams have its number.
        if let Some(away) = self.away.get_mut(plugin) {
            *away = Away { way: Carrier::Delay(Duration::ZERO), ..Away::nowhere(away.is_program) };
        }
    }
}

impl Away {
    fn of(spec: &PluginSpec) -> (PluginId, Self) {
        let way = match &spec.distance.way {
            Way::None => Carrier::Delay(Duration::ZERO),
            Way::Delay { control_delay } => Carrier::Delay(*control_delay),
            Way::Nodes { core, plugin } => Carrier::Network(Box::new(Datagrams::new(core, plugin))),
        };
        let is_program = matches!(spec.program, PluginProgram::Command(_));
        let (decides_in, measured) = match spec.distance.decides_in {
            None => (Duration::ZERO, None),
            Some(DecidesIn::Fixed { time }) => (time, None),
            Some(DecidesIn::Cpu { factor }) => (Duration::ZERO, Some(factor)),
        };
        let away = Self { way, decides_in, measured, ..Self::nowhere(is_program) };
        (spec.id.clone(), away)
    }

    fn nowhere(is_program: bool) -> Self {
        Self {
            is_program,
            way: Carrier::Delay(Duration::ZERO),
            decides_in: Duration::ZERO,
            measured: None,
            free_at: Timestamp::ZERO,
            contexts: VecDeque::new(),
            in_hand: None,
            known: Known::default(),
            decided: VecDeque::new(),
            instructions: VecDeque::new(),
        }
    }

    fn next_context(&mut self, now: Timestamp, missed: &mut u64) -> Option<Arc<Stamped>> {
        let waiting = self.contexts.partition_point(|(at, _)| *at <= now);
        *missed += self.contexts.drain(..waiting.saturating_sub(QUEUE)).count() as u64;
        if self.free_at > now || self.in_hand.is_some() {
            return None;
        }
        pop_due(&mut self.contexts, now)
    }

    fn next_arrival(&self) -> Option<Timestamp> {
        let next = self.contexts.front().filter(|_| self.in_hand.is_none());
        next.map(|(at, _)| (*at).max(self.free_at))
    }

    fn instructions_under_way(&self) -> usize {
        let carried = match &self.way {
            Carrier::Delay(_) => 0,
            Carrier::Network(datagrams) => datagrams.instructions_under_way(),
        };
        self.decided.len() + self.instructions.len() + carried
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        let first = |queue: &VecDeque<(Timestamp, Decided)>| queue.front().map(|(at, _)| *at);
        let datagrams = match &self.way {
            Carrier::Delay(_) => None,
            Carrier::Network(datagrams) => datagrams.next_deadline(),
        };
        let instructions = [first(&self.decided), first(&self.instructions)].into_iter().flatten();
        self.next_arrival().into_iter().chain(instructions).chain(datagrams).min()
    }
}

/// Removes and returns the first entry of a queue if it is due.
fn pop_due<T>(queue: &mut VecDeque<(Timestamp, T)>, now: Timestamp) -> Option<T> {
    queue.pop_front_if(|(at, _)| *at <= now).map(|(_, due)| due)
}

#[cfg(test)]
mod tests;
