//! The agent's end: reconciles what runs with what is wanted.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use cotorra_engine::{EngineEvent, InstanceId, Outcome};
use cotorra_graph::{LinkId, Timestamp};
use cotorra_wifi::{Event, InterfaceName};

use crate::{
    action::Action,
    link::{LinkState, WantedLink},
    message::{Beat, Echo, Instance, InstanceState, LEASE, Report, Wanted, WantedInstance, short},
    robot::{RobotState, WantedRobot},
    run::Run,
    wifi::{AgentWifi, RadioState, RequestError},
};

/// Reports in each lease, so that some can be lost.
const REPORTS_A_LEASE: u32 = 4;
/// Shortest and longest lease that a core can set.
const LEASES: [Duration; 2] = [Duration::from_millis(200), Duration::from_hours(1)];
/// Time for which Wi-Fi interfaces stay with a silent core, unless its lease is longer. A robot may hear the core over its own
/// radio only, and be on the way to an access point.
pub const RADIOS_KEPT: Duration = Duration::from_secs(15);

/// Time since the core was last heard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Silence {
    /// Not for longer than the lease.
    Short,
    /// For longer than the lease: the core is taken for lost.
    Long,
    /// For longer than Wi-Fi interfaces stay with it.
    Longest,
}

/// A wanted instance.
#[derive(Debug)]
struct Running {
    state: InstanceState,
    keep: bool,
}

impl Running {
    fn has_ended(&self) -> bool {
        matches!(self.state, InstanceState::Died(_) | InstanceState::Failed(_))
    }
}

/// Reconciles what runs on a machine with what the core wants.
///
/// Give it each message, each event of the engine, and the time; then do what [`Self::poll`] returns until there is nothing
/// more, and call it again at [`Self::next_deadline`] at the latest.
#[derive(Debug)]
pub struct Agent {
    boot: u64,
    wanted: Option<Wanted>,
    instances: BTreeMap<Instance, Running>,
    /// Number of instances that were stopped and have not ended yet.
    stopping: usize,
    /// The newest run that was heard of.
    run: Option<Run>,
    /// Time of the last sign of life of the core.
    heard: Timestamp,
    silence: Silence,
    /// Whether this process heard the core.
    has_heard: bool,
    /// The links that are to have their conditions, and what became of them.
    emulated: BTreeMap<LinkId, WantedLink>,
    links: BTreeMap<LinkId, LinkState>,
    wifi: AgentWifi,
    /// State of the wanted robot.
    robot: Option<RobotState>,
    /// The last beat and the time of its arrival.
    beat: Option<(Beat, Timestamp)>,
    next_report: Timestamp,
    actions: VecDeque<Action>,
}

impl Agent {
    /// Starts at `now`, with the wanted state that was saved last. `boot` must differ from that of earlier processes.
    /// Instances that go on without the core are started again; others wait for the core.
    pub fn new(now: Timestamp, boot: u64, saved: Option<Wanted>) -> Self {
        let mut agent = Self {
            boot,
            run: saved.as_ref().map(|wanted| wanted.run),
            wanted: None,
            instances: BTreeMap::new(),
            stopping: 0,
            heard: now,
            silence: Silence::Short,
            has_heard: false,
            emulated: BTreeMap::new(),
            links: BTreeMap::new(),
            wifi: saved.as_ref().map(|saved| AgentWifi::after_a_restart(&saved.wifi)).unwrap_or_default(),
            robot: None,
            beat: None,
            next_report: now,
            actions: VecDeque::new(),
        };
        if let Some(saved) = saved {
            for (id, instance) in &saved.instances {
                agent.start(*id, instance);
                if !instance.keep {
                    agent.end(*id, "its agent was restarted");
                }
            }
            agent.wanted = Some(saved);
        }
        agent
    }

    /// Returns the number of this process.
    pub fn boot(&self) -> u64 {
        self.boot
    }

    /// Returns the newest run that was heard of.
    pub fn run(&self) -> Option<Run> {
        self.run
    }

    /// Whether the core has been silent for longer than the lease.
    pub fn is_alone(&self) -> bool {
        self.silence >= Silence::Long
    }

    /// Returns the wanted state.
    pub fn wanted(&self) -> Option<&Wanted> {
        self.wanted.as_ref()
    }

    /// Returns the robot to drive now. Its ports stay closed while the core is away, and also those of a run that is over.
    pub fn robot(&self) -> Option<(Run, &WantedRobot)> {
        let wanted =
            self.wanted.as_ref().filter(|wanted| !self.is_alone() && Some(wanted.run) == self.run)?;
        Some((wanted.run, wanted.robot.as_ref()?))
    }

    /// Returns what interfaces shall do now, unless the core has been silent for longer than this. Without the core, and after
    /// their run, they are as their owner left them. A new process waits for the core: the run may have ended meanwhile.
    fn wanted_of_interfaces(&self, longest: Silence) -> Option<&Wanted> {
        let is_there = self.has_heard && self.silence <= longest;
        self.wanted.as_ref().filter(|wanted| is_there && Some(wanted.run) == self.run)
    }

    /// Takes the state of each link of the last [`Action::Emulate`].
    pub fn set_link_states(&mut self, now: Timestamp, states: BTreeMap<LinkId, LinkState>) {
        let cut = |state| match state {
            LinkState::Failed(reason) => LinkState::Failed(short(&reason)),
            LinkState::Applied => LinkState::Applied,
        };
        let states = states.into_iter().map(|(link, state)| (link, cut(state))).collect();
        if self.links != states {
            self.links = states;
            self.next_report = now;
        }
    }

    /// Takes the state of each Wi-Fi interface that is wanted, or is being put back.
    pub fn set_radio_states(&mut self, now: Timestamp, states: BTreeMap<InterfaceName, RadioState>) {
        if self.wifi.set_states(states) {
            self.next_report = now;
        }
    }

    /// Takes whether the program of a Wi-Fi interface took a request, or the reason why not.
    pub fn answered(&mut self, now: Timestamp, request: u64, answer: Result<(), RequestError>) {
        self.wifi.answered(request, answer);
        self.next_report = now;
    }

    /// Takes an event of the program of a Wi-Fi interface.
    pub fn happened(&mut self, now: Timestamp, interface: InterfaceName, event: Event) {
        if self.run.is_some() {
            self.wifi.happened(now, interface, event);
            self.next_report = now;
        }
    }

    /// Takes the number of instances that were stopped and have not ended yet.
    pub fn set_stopping(&mut self, now: Timestamp, stopping: usize) {
        if std::mem::replace(&mut self.stopping, stopping) != stopping {
            self.next_report = now;
        }
    }

    /// Takes the state of the robot to drive; `None` if there is none.
    pub fn set_robot_state(&mut self, now: Timestamp, state: Option<RobotState>) {
        let state = state.map(|state| match state {
            RobotState::Failed(reason) => RobotState::Failed(short(&reason)),
            RobotState::Driven => state,
        });
        if self.robot != state {
            self.robot = state;
            self.next_report = now;
        }
    }

    /// Takes what the core wants. Ignores what is older than what it wanted before.
    pub fn want(&mut self, now: Timestamp, wanted: Wanted) {
        if !self.hear(now, wanted.run) {
            return;
        }
        if let Some(before) = &self.wanted {
            if (before.run, before.generation) >= (wanted.run, wanted.generation) {
                return;
            }
            if before.run != wanted.run {
                let all: Vec<_> = self.instances.keys().copied().collect();
                all.into_iter().for_each(|id| self.forget(id));
                self.wifi.forget();
                self.actions.extend(self.wifi.poll(None));
                if !std::mem::take(&mut self.emulated).is_empty() {
                    self.actions.push_back(Action::Emulate(BTreeMap::new()));
                }
            }
        }
        let gone: Vec<_> =
            self.instances.keys().filter(|id| !wanted.instances.contains_key(id)).copied().collect();
        gone.into_iter().for_each(|id| self.forget(id));
        self.actions.push_back(Action::Save(Box::new(wanted.clone())));
        for (id, instance) in &wanted.instances {
            if !self.instances.contains_key(id) {
                self.start(*id, instance);
            }
        }
        self.wifi.want(&wanted.wifi);
        self.wanted = Some(wanted);
        self.next_report = now;
    }

    /// Takes a sign of life of the core.
    pub fn beat(&mut self, now: Timestamp, beat: Beat) {
        if self.hear(now, beat.run) {
            self.beat = Some((beat, now));
            if let Some(last) = beat.last_event.filter(|last| last.boot == self.boot) {
                self.wifi.acknowledge(last.number);
            }
            // A core that has started anew waits for a report.
            if self.wanted.as_ref().is_none_or(|wanted| wanted.generation != beat.generation) {
                self.next_report = now;
            }
        }
    }

    /// Takes an event of the engine of a run. Ignores that of an instance that is not wanted any more.
    pub fn outcome(&mut self, now: Timestamp, run: Run, event: EngineEvent) {
        if self.wanted.as_ref().is_none_or(|wanted| wanted.run != run) {
            return;
        }
        let running = self.instances.get_mut(&event.instance.0).filter(|its| !its.has_ended());
        let Some(running) = running else { return };
        running.state = match event.outcome {
            Outcome::Ready => InstanceState::Ready,
            Outcome::Died(reason) => InstanceState::Died(short(&reason)),
            Outcome::Failed(reason) => InstanceState::Failed(short(&reason)),
        };
        self.next_report = now;
    }

    /// Reports the instances that are not started yet as failed, because the wanted state could not be saved.
    pub fn cannot_save(&mut self, now: Timestamp, reason: &str) {
        let starts = |action: &Action| match action {
            Action::Start(id, _) => Some(*id),
            _ => None,
        };
        let failed: Vec<_> = self.actions.iter().filter_map(starts).collect();
        self.actions.retain(|action| starts(action).is_none());
        let Some(run) = self.wanted.as_ref().map(|wanted| wanted.run) else { return };
        for instance in failed {
            self.outcome(now, run, EngineEvent { instance, outcome: Outcome::Failed(reason.to_owned()) });
        }
    }

    /// Does what is due.
    pub fn advance(&mut self, now: Timestamp) {
        let before = self.silence;
        self.silence = match now.since(self.heard) {
            silence if silence >= self.radios_kept() => Silence::Longest,
            silence if silence >= self.lease() => Silence::Long,
            _ => Silence::Short,
        };
        if before >= Silence::Long || !self.is_alone() {
            return;
        }
        let reason = format!("its core was away for longer than {:?}", self.lease());
        let ends: Vec<_> = self.instances.iter().filter(|(_, its)| !its.keep).map(|(id, _)| *id).collect();
        ends.into_iter().for_each(|id| self.end(id, &reason));
        self.wifi.refuse(&reason);
    }

    /// Returns the next action.
    pub fn poll(&mut self, now: Timestamp) -> Option<Action> {
        if let Some(action) = self.actions.pop_front() {
            return Some(action);
        }
        let links = self.wanted_of_interfaces(Silence::Short).map(|wanted| &wanted.links);
        if links.map_or(!self.emulated.is_empty(), |links| *links != self.emulated) {
            let links = links.cloned().unwrap_or_default();
            self.emulated.clone_from(&links);
            return Some(Action::Emulate(links));
        }
        let wifi = self.wanted_of_interfaces(Silence::Long).map(|wanted| wanted.wifi.clone());
        if let Some(action) = self.wifi.poll(wifi.as_ref()) {
            return Some(action);
        }
        let run = self.run.filter(|_| now >= self.next_report)?;
        self.next_report = now + self.lease() / REPORTS_A_LEASE;
        let wanted = self.wanted.as_ref().filter(|wanted| wanted.run == run);
        let beat = self.beat.take().filter(|(beat, _)| beat.run == run);
        let echo = beat.map(|(beat, received)| Echo {
            sent_ns: beat.sent_ns,
            received_ns: received.as_nanos(),
            replied_ns: now.as_nanos(),
        });
        let instances = self.instances.iter().filter(|_| wanted.is_some());
        Some(Action::Report(Report {
            boot: self.boot,
            run,
            generation: wanted.map_or(0, |wanted| wanted.generation),
            echo,
            instances: instances.map(|(id, its)| (*id, its.state.clone())).collect(),
            stopping: self.stopping,
            robot: self.robot.clone().filter(|_| wanted.is_some()),
            links: self.links.clone(),
            wifi: self.wifi.report(wanted.is_some()),
        }))
    }

    /// Returns the time at which [`Self::advance`] or [`Self::poll`] has something to do.
    pub fn next_deadline(&self) -> Timestamp {
        let silence = match self.silence {
            Silence::Short => self.heard + self.lease(),
            Silence::Long => self.heard + self.radios_kept(),
            Silence::Longest => Timestamp::MAX,
        };
        let report = if self.run.is_some() { self.next_report } else { Timestamp::MAX };
        silence.min(report)
    }

    fn radios_kept(&self) -> Duration {
        self.lease().max(RADIOS_KEPT)
    }

    fn lease(&self) -> Duration {
        let asked = self.wanted.as_ref().map(|wanted| Duration::from_millis(wanted.lease_ms.into()));
        asked.unwrap_or(LEASE).clamp(LEASES[0], LEASES[1])
    }

    /// Notes a sign of life of a run. Returns false if that run is over.
    fn hear(&mut self, now: Timestamp, run: Run) -> bool {
        if self.run.is_some_and(|newest| run < newest) {
            return false;
        }
        self.run = Some(run);
        (self.heard, self.silence, self.has_heard) = (now, Silence::Short, true);
        true
    }

    fn start(&mut self, id: Instance, instance: &WantedInstance) {
        self.instances.insert(id, Running { state: InstanceState::Starting, keep: instance.keep });
        self.actions.push_back(Action::Start(InstanceId(id), Box::new(instance.clone())));
    }

    /// Ends an instance that is still wanted.
    fn end(&mut self, id: Instance, reason: &str) {
        if let Some(running) = self.instances.get_mut(&id).filter(|its| !its.has_ended()) {
            running.state = InstanceState::Died(reason.to_owned());
            self.cancel(InstanceId(id));
        }
    }

    /// Ends an instance that is not wanted any more.
    fn forget(&mut self, id: Instance) {
        if self.instances.remove(&id).is_some_and(|its| !its.has_ended()) {
            self.cancel(InstanceId(id));
        }
    }

    /// Stops an instance, or leaves out its start if that was not done yet.
    fn cancel(&mut self, id: InstanceId) {
        let starts = |action: &Action| matches!(action, Action::Start(its, _) if *its == id);
        match self.actions.iter().position(starts) {
            Some(place) => drop(self.actions.remove(place)),
            None => self.actions.push_back(Action::Stop(id)),
        }
    }
}
