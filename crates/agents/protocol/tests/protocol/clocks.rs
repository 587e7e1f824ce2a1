//! Readings of machines have the core's time, whatever the two clocks and the ways between them are.

use std::{collections::BTreeMap, time::Duration};

use cotorra_agent_protocol::{Action, Agent, Beat, Controller, LEASE, Report, Run, Transmit, Wanted};
use cotorra_graph::{AgentId, Timestamp};
use proptest::prelude::*;

const STEP: u64 = 1_000_000;
const STEPS_A_SECOND: u64 = 1000;
/// Length of a random world.
const STEPS: u64 = 12 * STEPS_A_SECOND;
/// A moment of the core's clock, so that the agent's can be behind.
const BEGAN: u64 = 5_000_000_000_000;

/// A message under way.
enum Message {
    Wanted(Box<Wanted>),
    Beat(Beat),
    Report(Report),
    Reading(Reading),
}

/// A reading of the agent's machine, without its contents.
struct Reading {
    run: Run,
    boot: u64,
    /// Time on the agent's clock, and that on the core's.
    read_ns: u64,
    truth_ns: u64,
}

/// A process that is started anew, with another clock.
#[derive(Debug, Clone, Copy)]
enum Restart {
    Core,
    /// With its clock ahead of the earlier one by so much.
    Agent(i64),
}

/// Clocks and ways of a world.
#[derive(Debug, Clone)]
struct Conditions {
    /// The agent's clock less the core's at the beginning.
    offset_ns: i64,
    /// By how much the agent's clock is faster, µs a second: for a second each, in this order.
    drifts: Vec<i64>,
    /// Longest time to the agent, and back.
    there: u64,
    back: u64,
    /// Parts of these times that messages take, in this order, in 1/255; 0 is lost.
    faults: Vec<u8>,
    /// At these steps.
    restarts: BTreeMap<u64, Restart>,
}

impl Conditions {
    fn steady(offset_ns: i64, there: u64, back: u64) -> Self {
        Self { offset_ns, drifts: vec![0], there, back, faults: vec![255], restarts: BTreeMap::new() }
    }
}

fn conditions() -> impl Strategy<Value = Conditions> {
    let way = || prop_oneof![0..2_000_000_u64, 0..500_000_000_u64];
    let offset = || -1_000_000_000_000_i64..1_000_000_000_000;
    let restart = prop_oneof![Just(Restart::Core), offset().prop_map(Restart::Agent)];
    let parts = (
        offset(),
        prop::collection::vec(prop_oneof![Just(-500_i64), Just(500), -500..=500_i64], 1..6),
        way(),
        way(),
        prop::collection::vec(any::<u8>(), 1..60),
        prop::collection::btree_map(0..STEPS, restart, 0..4),
    );
    parts.prop_map(|(offset_ns, drifts, there, back, faults, restarts)| Conditions {
        offset_ns,
        drifts,
        there,
        back,
        faults,
        restarts,
    })
}

struct World {
    conditions: Conditions,
    step: u64,
    /// The core's clock, and the agent's.
    core_ns: u64,
    agent_ns: u64,
    controller: Controller,
    agent: Agent,
    run: Run,
    under_way: Vec<(u64, Message)>,
    sent: usize,
    /// By how much each reading's time was wrong, and the error that it stated.
    readings: Vec<(u64, u64)>,
    untimed: u32,
}

impl World {
    fn new(conditions: Conditions) -> Self {
        let agent_ns = BEGAN.checked_add_signed(conditions.offset_ns).unwrap();
        Self {
            conditions,
            step: 0,
            core_ns: BEGAN,
            agent_ns,
            controller: Controller::new(Run(1), LEASE, Vec::new(), [name()]),
            agent: Agent::new(Timestamp::from_nanos(agent_ns), 1, None),
            run: Run(1),
            under_way: Vec::new(),
            sent: 0,
            readings: Vec::new(),
            untimed: 0,
        }
    }

    fn restart(&mut self, restart: Restart) {
        match restart {
            Restart::Agent(ahead_ns) => {
                self.agent_ns = self.agent_ns.checked_add_signed(ahead_ns).unwrap();
                let (now, boot) = (Timestamp::from_nanos(self.agent_ns), self.agent.boot() + 1);
                self.agent = Agent::new(now, boot, self.agent.wanted().cloned());
            }
            // The clock of a run begins with it.
            Restart::Core => {
                (self.run, self.core_ns) = (Run(self.run.0 + 1), 0);
                self.controller = Controller::new(self.run, LEASE, Vec::new(), [name()]);
            }
        }
    }

    fn send(&mut self, message: Message) {
        let Conditions { there, back, faults, .. } = &self.conditions;
        let part = faults[self.sent % faults.len()];
        self.sent += 1;
        let longest = match message {
            Message::Wanted(_) | Message::Beat(_) => *there,
            Message::Report(_) | Message::Reading(_) => *back,
        };
        if part > 0 {
            let takes = longest / 255 * u64::from(part);
            self.under_way.push((self.step + takes.div_ceil(STEP), message));
        }
    }

    fn take(&mut self, message: Message) {
        let [now, agents] = [self.core_ns, self.agent_ns].map(Timestamp::from_nanos);
        match message {
            Message::Wanted(wanted) => self.agent.want(agents, *wanted),
            Message::Beat(beat) => self.agent.beat(agents, beat),
            Message::Report(report) => self.controller.receive(now, &name(), report),
            // The core of another run does not receive it.
            Message::Reading(Reading { run, .. }) if run != self.run => {}
            Message::Reading(Reading { boot, read_ns, truth_ns, .. }) => {
                match self.controller.core_time(&name(), boot, read_ns) {
                    Some(time) => {
                        let wrong = time.measured.as_nanos().abs_diff(truth_ns);
                        self.readings.push((wrong, time.error.as_nanos().try_into().unwrap()));
                    }
                    None => self.untimed += 1,
                }
            }
        }
    }

    fn step(&mut self) {
        self.step += 1;
        let drifts = &self.conditions.drifts;
        let drift = drifts[(self.step / STEPS_A_SECOND) as usize % drifts.len()];
        self.core_ns += STEP;
        self.agent_ns = (self.agent_ns + STEP).checked_add_signed(drift * STEP as i64 / 1_000_000).unwrap();
        if let Some(restart) = self.conditions.restarts.get(&self.step) {
            self.restart(*restart);
        }
        let (due, later) = self.under_way.drain(..).partition(|(at, _)| *at <= self.step);
        self.under_way = later;
        let due: Vec<(u64, Message)> = due;
        due.into_iter().for_each(|(_, message)| self.take(message));
        let [now, agents] = [self.core_ns, self.agent_ns].map(Timestamp::from_nanos);
        self.controller.advance(now);
        while let Some(transmit) = self.controller.poll_transmit(now) {
            self.send(match transmit {
                Transmit::Wanted(_, wanted) => Message::Wanted(wanted),
                Transmit::Beat(_, beat) => Message::Beat(beat),
            });
        }
        self.agent.advance(agents);
        while let Some(action) = self.agent.poll(agents) {
            if let Action::Report(report) = action {
                self.send(Message::Report(report));
            }
        }
        if self.step.is_multiple_of(100)
            && let Some(run) = self.agent.run()
        {
            let (boot, read_ns, truth_ns) = (self.agent.boot(), self.agent_ns, self.core_ns);
            self.send(Message::Reading(Reading { run, boot, read_ns, truth_ns }));
        }
    }

    fn run(&mut self, time: Duration) {
        (0..time.as_nanos() as u64 / STEP).for_each(|_| self.step());
    }
}

fn name() -> AgentId {
    AgentId::new("edge1").unwrap()
}

proptest! {
    #[test]
    fn a_reading_was_made_within_the_stated_error(conditions in conditions()) {
        let mut world = World::new(conditions);
        (0..STEPS).for_each(|_| world.step());
        for (wrong, error) in &world.readings {
            prop_assert!(wrong <= error, "{wrong} ns wrong, {error} ns stated");
        }
    }
}

#[test]
fn a_slower_way_back_counts_as_half_of_the_difference_at_most() {
    let mut world = World::new(Conditions::steady(-7_000_000_000, 5_000_000, 45_000_000));
    world.run(Duration::from_secs(4));
    let (wrong, error) = *world.readings.last().unwrap();
    // The ways differ by 40 ms, and take 50 ms. Each message waits for a step of 1 ms at most.
    assert!((19_000_000..=21_000_000).contains(&wrong), "{wrong}");
    assert!((25_000_000..=27_000_000).contains(&error), "{error}");
}

#[test]
fn readings_of_a_new_process_have_no_time_before_it_answered_a_beat() {
    let mut world = World::new(Conditions::steady(3_000_000_000, 0, 50_000_000));
    // It is restarted between two beats.
    world.run(Duration::from_millis(2650));
    let before = world.untimed;
    assert!(world.readings.len() > 20, "{} readings", world.readings.len());
    world.restart(Restart::Agent(3_600_000_000_000));
    world.run(Duration::from_secs(3));
    assert!(world.untimed > before, "the first came before an answer");
    assert!(world.readings.iter().all(|(wrong, error)| wrong <= error));
    assert!(world.readings.len() > 40, "{} readings", world.readings.len());
}

#[test]
fn the_clock_of_a_machine_that_slept_is_measured_anew() {
    let mut world = World::new(Conditions::steady(0, 1_000_000, 1_000_000));
    world.run(Duration::from_secs(3));
    let before = world.readings.len();
    world.conditions.faults = vec![0];
    world.run(LEASE + Duration::from_millis(100));
    // Its clock stands for an hour.
    world.core_ns += 3_600_000_000_000;
    world.conditions.faults = vec![255];
    world.run(Duration::from_secs(3));
    assert!(world.readings.len() > before + 20, "{} readings", world.readings.len());
    assert!(world.readings.iter().all(|(wrong, error)| wrong <= error), "{:?}", world.readings);
}

#[test]
fn an_answer_to_a_beat_of_an_earlier_run_counts_for_none() {
    // The agent is on its way to answer the first core, when the second one sends what it wants.
    let start = Timestamp::from_nanos;
    let mut agent = Agent::new(Timestamp::ZERO, 1, None);
    agent.beat(start(1), Beat { run: Run(1), generation: 1, sent_ns: 5, last_event: None });
    let mut second = Controller::new(Run(2), LEASE, Vec::new(), [name()]);
    let Some(Transmit::Wanted(_, wanted)) = second.poll_transmit(Timestamp::ZERO) else {
        panic!("it wants nothing")
    };
    agent.want(start(2), *wanted);
    let mut reports = 0;
    while let Some(action) = agent.poll(start(3)) {
        if let Action::Report(report) = action {
            reports += 1;
            second.receive(start(1_000_000_000), &name(), report);
        }
    }
    assert_eq!((reports, second.core_time(&name(), 1, 3)), (1, None));
}
