//! Instances run as the core wants them in the end, whatever is lost, doubled, delayed or killed.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_agent_protocol::{
    Action, Agent, Beat, Controller, ControllerEvent, InstanceState, LEASE, Report, Run, Transmit, Wanted,
    WantedInstance,
};
use cotorra_engine::{EngineEvent, InstanceId, Outcome};
use cotorra_graph::{AgentId, Timestamp, Vnf};
use cotorra_graph_testing as base;
use proptest::prelude::*;

use crate::rig::{Carrier, Message, STEP, settling, tell};

fn name() -> AgentId {
    AgentId::new("edge1").unwrap()
}

fn instance(keep: bool) -> WantedInstance {
    let node = cotorra_graph::NodeId::new("edge").unwrap();
    let vnf = Vnf { memory_bytes: 1 << 20, node: node.clone().into(), ..base::vnf("navigation", "server") };
    WantedInstance { vnf, replica: 0, node, environment: BTreeMap::new(), keep }
}

/// The machine of an agent: its disk, its engine, and the agent's process if it lives.
struct Machine {
    saved: Option<Wanted>,
    boots: u64,
    agent: Option<Agent>,
    /// The run whose instances run.
    run: Run,
    /// Running instances by their numbers, and whether they were reported.
    running: BTreeMap<InstanceId, (WantedInstance, bool)>,
}

struct World {
    now: Timestamp,
    runs: u64,
    controller: Controller,
    machine: Machine,
    network: Carrier,
    /// Outcomes of each instance of this run.
    outcomes: BTreeMap<u64, Vec<Outcome>>,
    wanted: BTreeSet<u64>,
    next: u64,
}

impl World {
    fn new(network: Carrier) -> Self {
        let mut world = Self {
            now: Timestamp::ZERO,
            runs: 0,
            controller: Controller::new(Run(0), LEASE, Vec::new(), []),
            machine: Machine { saved: None, boots: 0, agent: None, run: Run(0), running: BTreeMap::new() },
            network,
            outcomes: BTreeMap::new(),
            wanted: BTreeSet::new(),
            next: 0,
        };
        world.restart_core();
        world.restart_agent();
        world
    }

    /// Kills the core, and starts the next run.
    fn restart_core(&mut self) {
        self.runs += 1;
        self.controller = Controller::new(Run(self.runs), LEASE, Vec::new(), [name()]);
        self.outcomes.clear();
        self.wanted.clear();
        // Numbers are unique in a run only.
        self.next = 0;
    }

    /// Kills the agent with what it runs, and starts it again.
    fn restart_agent(&mut self) {
        let Machine { saved, boots, agent, run, running } = &mut self.machine;
        *boots += 1;
        running.clear();
        *run = saved.as_ref().map_or(Run(0), |saved| saved.run);
        *agent = Some(Agent::new(self.now, *boots, saved.clone()));
    }

    fn start(&mut self, keep: bool) -> u64 {
        self.next += 1;
        self.wanted.insert(self.next);
        self.controller.start(&name(), InstanceId(self.next), instance(keep)).unwrap();
        self.next
    }

    fn stop(&mut self, id: u64) {
        self.wanted.remove(&id);
        self.controller.stop(InstanceId(id));
    }

    fn step(&mut self) {
        self.now = self.now + STEP;
        let now = self.now;
        for message in self.network.arrived(now) {
            match message {
                Message::ToAgent(transmit) => {
                    if let Some(agent) = &mut self.machine.agent {
                        tell(agent, now, transmit);
                    }
                }
                Message::ToCore(report) => self.controller.receive(now, &name(), report),
            }
        }
        self.controller.advance(now);
        while let Some(event) = self.controller.poll_event() {
            if let ControllerEvent::Instance(EngineEvent { instance, outcome }) = event {
                if !matches!(outcome, Outcome::Ready) {
                    self.wanted.remove(&instance.0);
                }
                self.outcomes.entry(instance.0).or_default().push(outcome);
            }
        }
        while let Some(transmit) = self.controller.poll_transmit(now) {
            self.network.send(now, Message::ToAgent(transmit));
        }
        self.run_agent();
    }

    fn run_agent(&mut self) {
        let now = self.now;
        let Some(mut agent) = self.machine.agent.take() else { return };
        agent.advance(now);
        let mut reports = Vec::new();
        while let Some(action) = agent.poll(now) {
            match action {
                Action::Save(wanted) => {
                    self.machine.run = wanted.run;
                    self.machine.saved = Some(*wanted);
                }
                Action::Start(id, wanted) => {
                    let twice = self.machine.running.insert(id, (*wanted, false));
                    assert!(twice.is_none(), "started twice: {id:?}");
                }
                Action::Stop(id) => {
                    self.machine.running.remove(&id).expect("only running instances are stopped");
                }
                Action::Report(report) => reports.push(report),
                action @ (Action::Emulate(_) | Action::UseRadios(_) | Action::Request(..)) => {
                    panic!("nobody wants {action:?}")
                }
            }
        }
        for (id, (_, is_told)) in &mut self.machine.running {
            if !std::mem::replace(is_told, true) {
                let ready = EngineEvent { instance: *id, outcome: Outcome::Ready };
                agent.outcome(now, self.machine.run, ready);
            }
        }
        self.machine.agent = Some(agent);
        reports.into_iter().for_each(|report| self.network.send(now, Message::ToCore(report)));
    }

    fn steps(&mut self, count: u32) {
        (0..count).for_each(|_| self.step());
    }

    /// Steps until a lease and what is under way have passed, several times over.
    fn settle(&mut self) {
        self.steps(settling());
    }

    /// Checks that instances have the outcomes that an engine promises.
    fn check_outcomes(&self) {
        for (id, outcomes) in &self.outcomes {
            let is_right = matches!(
                outcomes[..],
                [Outcome::Ready]
                    | [Outcome::Ready, Outcome::Died(_)]
                    | [Outcome::Failed(_) | Outcome::Died(_)]
            );
            assert!(is_right, "instance {id}: {outcomes:?}");
        }
    }
}

#[derive(Debug, Clone)]
enum Step {
    Start { keep: bool },
    Stop(u8),
    Die(u8),
    RestartAgent,
    RestartCore,
    Cut,
    Heal,
    Wait(u8),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => any::<bool>().prop_map(|keep| Step::Start { keep }),
        2 => any::<u8>().prop_map(Step::Stop),
        1 => any::<u8>().prop_map(Step::Die),
        1 => Just(Step::RestartAgent),
        1 => Just(Step::RestartCore),
        1 => Just(Step::Cut),
        1 => Just(Step::Heal),
        6 => any::<u8>().prop_map(Step::Wait),
    ]
}

proptest! {
    /// After any faults and kills, exactly what is wanted runs, once the network has healed.
    #[test]
    fn what_runs_is_what_is_wanted_in_the_end(
        steps in prop::collection::vec(step(), 1..60),
        faults in prop::collection::vec(any::<u8>(), 1..200),
    ) {
        let mut world = World::new(Carrier::with(faults));
        for step in steps {
            match step {
                Step::Start { keep } => {
                    world.start(keep);
                }
                Step::Stop(which) => {
                    let id = world.wanted.iter().nth(usize::from(which) % world.wanted.len().max(1)).copied();
                    id.into_iter().for_each(|id| world.stop(id));
                }
                Step::Die(which) => {
                    let machine = &mut world.machine;
                    let count = machine.running.len().max(1);
                    let id = machine.running.keys().nth(usize::from(which) % count).copied();
                    if let (Some(id), Some(agent)) = (id, machine.agent.as_mut()) {
                        machine.running.remove(&id);
                        let died = EngineEvent { instance: id, outcome: Outcome::Died("x".into()) };
                        agent.outcome(world.now, machine.run, died);
                    }
                }
                Step::RestartAgent => world.restart_agent(),
                Step::RestartCore => world.restart_core(),
                Step::Cut => world.network.is_cut = true,
                Step::Heal => world.network.is_cut = false,
                Step::Wait(steps) => world.steps(steps.into()),
            }
            world.check_outcomes();
        }
        world.network.heal();
        world.settle();
        world.check_outcomes();
        prop_assert!(world.controller.is_settled());
        prop_assert_eq!(world.machine.running.len(), world.wanted.len());
        // All that is still wanted has been reported as ready.
        for id in &world.wanted {
            prop_assert_eq!(world.outcomes.get(id).map(Vec::as_slice), Some(&[Outcome::Ready][..]));
        }
    }
}

/// A world without faults in which these instances run.
fn running(keep: &[bool]) -> (World, Vec<u64>) {
    let mut world = World::new(Carrier::sound());
    let ids = keep.iter().map(|keep| world.start(*keep)).collect();
    world.settle();
    assert_eq!(world.machine.running.len(), keep.len());
    (world, ids)
}

#[test]
fn an_agent_without_its_core_stops_what_shall_not_go_on() {
    let (mut world, _) = running(&[true, false]);
    world.network.is_cut = true;
    world.steps(140);
    assert_eq!(world.machine.running.len(), 2, "before the lease");
    world.settle();
    let kept: Vec<_> = world.machine.running.values().map(|(wanted, _)| wanted.keep).collect();
    assert_eq!(kept, [true]);
    assert!(world.machine.agent.as_ref().unwrap().is_alone());
}

#[test]
fn a_core_counts_instances_of_a_lost_agent_as_dead_unless_they_go_on() {
    let (mut world, ids) = running(&[true, false]);
    world.network.is_cut = true;
    world.settle();
    assert_eq!(world.outcomes[&ids[0]], [Outcome::Ready]);
    assert!(matches!(world.outcomes[&ids[1]][..], [Outcome::Ready, Outcome::Died(_)]));
    world.network.is_cut = false;
    world.settle();
    assert_eq!(world.outcomes[&ids[0]], [Outcome::Ready], "it went on");
    assert_eq!(world.machine.running.len(), 1);
}

#[test]
fn a_restarted_agent_goes_on_with_what_it_saved_while_the_core_is_away() {
    let (mut world, _) = running(&[true, false]);
    world.network.is_cut = true;
    world.restart_agent();
    world.settle();
    assert_eq!(world.machine.running.len(), 1);
}

#[test]
fn instances_of_a_restarted_agent_are_reported_as_dead() {
    let (mut world, ids) = running(&[true, false]);
    world.restart_agent();
    world.settle();
    for id in ids {
        assert!(matches!(world.outcomes[&id][..], [Outcome::Ready, Outcome::Died(_)]));
    }
    assert!(world.machine.running.is_empty());
}

#[test]
fn instances_of_a_wanted_state_that_cannot_be_saved_fail() {
    let mut agent = Agent::new(Timestamp::ZERO, 1, None);
    let instances = (1..=2).map(|id| (id, instance(true))).collect();
    let wanted = Wanted {
        run: Run(1),
        generation: 1,
        lease_ms: 2000,
        files: Vec::new(),
        instances,
        robot: None,
        links: BTreeMap::new(),
        wifi: Default::default(),
    };
    agent.want(Timestamp::ZERO, wanted);
    assert!(matches!(agent.poll(Timestamp::ZERO), Some(Action::Save(_))));
    agent.cannot_save(Timestamp::ZERO, "the disk is full");
    let Some(Action::Report(report)) = agent.poll(Timestamp::ZERO) else { panic!("it starts something") };
    let failed = InstanceState::Failed("the disk is full".to_owned());
    assert_eq!(report.instances, BTreeMap::from([(1, failed.clone()), (2, failed)]));
}

#[test]
fn the_next_run_ends_what_the_last_one_left() {
    let (mut world, _) = running(&[true, true]);
    world.restart_core();
    world.settle();
    assert!(world.machine.running.is_empty());
}

#[test]
fn messages_of_an_earlier_run_are_ignored() {
    let (mut world, _) = running(&[true]);
    let old = world.machine.saved.clone().unwrap();
    world.restart_core();
    world.start(true);
    world.settle();
    let agent = world.machine.agent.as_mut().unwrap();
    let late = Wanted { generation: old.generation + 100, instances: BTreeMap::new(), ..old };
    agent.want(world.now, late);
    world.settle();
    assert_eq!(world.machine.running.len(), 1);
}

#[test]
fn a_change_is_sent_at_once() {
    let (mut world, _) = running(&[]);
    for _ in 0..3 {
        world.start(false);
        let sent = world.controller.poll_transmit(world.now);
        assert!(matches!(sent, Some(Transmit::Wanted(..))), "{sent:?}");
    }
}

#[test]
fn only_the_connection_of_the_current_process_counts() {
    let (mut world, ids) = running(&[false]);
    let boot = world.machine.boots;
    world.controller.connection(world.now, &name(), boot - 1, false);
    assert!(world.controller.is_present(&name()), "an earlier process");
    world.controller.connection(world.now, &name(), boot, false);
    assert!(!world.controller.is_present(&name()));
    world.settle();
    assert!(matches!(world.outcomes[&ids[0]][..], [Outcome::Ready, Outcome::Died(_)]));
}

#[test]
fn an_unknown_agent_is_refused_and_its_reports_are_ignored() {
    let mut controller = Controller::new(Run(1), LEASE, Vec::new(), [name()]);
    let other = AgentId::new("other").unwrap();
    assert!(controller.start(&other, InstanceId(1), instance(false)).unwrap_err().contains("`other`"));
    let report = Report {
        boot: 1,
        run: Run(1),
        generation: 9,
        echo: None,
        instances: BTreeMap::new(),
        stopping: 0,
        robot: None,
        links: BTreeMap::new(),
        wifi: Default::default(),
    };
    controller.receive(Timestamp::ZERO, &other, report);
    assert_eq!(controller.poll_event(), None);
}

proptest! {
    #[test]
    fn any_bytes_are_decoded_or_rejected(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = (Wanted::decode(&bytes), Beat::decode(&bytes), Report::decode(&bytes));
    }
}

#[test]
fn messages_that_are_too_long_are_rejected() {
    let error = Beat::decode(&[b' '; 257]).unwrap_err().to_string();
    assert!(error.contains("257 bytes, of at most 256"), "{error}");
}

#[test]
fn events_of_an_earlier_run_are_ignored() {
    let (mut world, ids) = running(&[true]);
    let (now, run) = (world.now, world.machine.run);
    let agent = world.machine.agent.as_mut().unwrap();
    let died = || EngineEvent { instance: InstanceId(ids[0]), outcome: Outcome::Died("x".to_owned()) };
    agent.outcome(now, Run(run.0 - 1), died());
    world.settle();
    assert_eq!(world.outcomes[&ids[0]], [Outcome::Ready]);
    world.machine.agent.as_mut().unwrap().outcome(world.now, run, died());
    world.settle();
    assert!(matches!(world.outcomes[&ids[0]][..], [Outcome::Ready, Outcome::Died(_)]));
}

#[test]
fn an_agent_is_settled_once_what_it_stopped_has_ended() {
    let (mut world, ids) = running(&[true]);
    world.stop(ids[0]);
    world.machine.agent.as_mut().unwrap().set_stopping(world.now, 1);
    world.settle();
    assert!(world.machine.running.is_empty() && !world.controller.is_settled());
    world.machine.agent.as_mut().unwrap().set_stopping(world.now, 0);
    world.settle();
    assert!(world.controller.is_settled());
}
