//! Instances run as the core wants them in the end, whatever is lost, doubled, delayed or killed.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_agent_protocol::{
    Action, Agent, Beat, Controller, ControllerEvent, InstanceState, LEASE, Report, Run, Transmit, Wanted,
    WantedInstance,
};
use cotorra_engine::{EngineEvent, InstanceId, Outcome};
use cotorra_graph::{AgentId, Timestamp, Vnf};
use cotorra_graph_testing as base;
use proptest::prelude::*;

use crate::rig::{Carrier, Fault, Machine, World, fault, nothing};

fn instance(keep: bool) -> WantedInstance {
    let node = cotorra_graph::NodeId::new("edge").unwrap();
    let vnf = Vnf { memory_bytes: 1 << 20, node: node.clone().into(), ..base::vnf("navigation", "server") };
    WantedInstance { vnf, replica: 0, node, environment: BTreeMap::new(), keep }
}

/// The machine of an agent that runs instances.
#[derive(Default)]
struct Server {
    /// Running instances by their numbers, and whether they were reported. They end with the agent's process.
    running: BTreeMap<InstanceId, (WantedInstance, bool)>,
    /// Outcomes of each instance of this run.
    outcomes: BTreeMap<u64, Vec<Outcome>>,
    wanted: BTreeSet<u64>,
    next: u64,
}

impl Machine for Server {
    const AGENT: &str = "edge1";

    fn restart_core(&mut self) {
        // Numbers are unique in a run only.
        (self.outcomes, self.wanted, self.next) = Default::default();
    }

    fn restart_agent(&mut self) {
        self.running.clear();
    }

    fn learn(&mut self, _: Run, event: ControllerEvent) {
        if let ControllerEvent::Instance(EngineEvent { instance, outcome }) = event {
            if !matches!(outcome, Outcome::Ready) {
                self.wanted.remove(&instance.0);
            }
            self.outcomes.entry(instance.0).or_default().push(outcome);
        }
    }

    fn act(&mut self, _: Timestamp, _: &mut Agent, action: Action) {
        match action {
            Action::Start(id, wanted) => {
                let twice = self.running.insert(id, (*wanted, false));
                assert!(twice.is_none(), "started twice: {id:?}");
            }
            Action::Stop(id) => {
                self.running.remove(&id).expect("only running instances are stopped");
            }
            action => panic!("nobody wants {action:?}"),
        }
    }

    fn after(&mut self, now: Timestamp, agent: &mut Agent, run: Run, _: Duration) {
        for (id, (_, is_told)) in &mut self.running {
            if !std::mem::replace(is_told, true) {
                let ready = EngineEvent { instance: *id, outcome: Outcome::Ready };
                agent.outcome(now, run, ready);
            }
        }
    }
}

impl World<Server> {
    fn start(&mut self, keep: bool) -> u64 {
        self.machine.next += 1;
        let id = self.machine.next;
        self.machine.wanted.insert(id);
        self.controller.start(&Self::name(), InstanceId(id), instance(keep)).unwrap();
        id
    }

    fn stop(&mut self, id: u64) {
        self.machine.wanted.remove(&id);
        self.controller.stop(InstanceId(id));
    }

    /// Checks that instances have the outcomes that an engine promises.
    fn check_outcomes(&self) {
        for (id, outcomes) in &self.machine.outcomes {
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
    Fault(Fault),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => any::<bool>().prop_map(|keep| Step::Start { keep }),
        2 => any::<u8>().prop_map(Step::Stop),
        1 => any::<u8>().prop_map(Step::Die),
        12 => fault().prop_map(Step::Fault),
    ]
}

proptest! {
    /// After any faults and kills, exactly what is wanted runs, once the network has healed.
    #[test]
    fn what_runs_is_what_is_wanted_in_the_end(
        steps in prop::collection::vec(step(), 1..60),
        faults in prop::collection::vec(any::<u8>(), 1..200),
    ) {
        let mut world = World::<Server>::new(Carrier::with(faults));
        for step in steps {
            match step {
                Step::Start { keep } => {
                    world.start(keep);
                }
                Step::Stop(which) => {
                    let wanted = &world.machine.wanted;
                    let id = wanted.iter().nth(usize::from(which) % wanted.len().max(1)).copied();
                    id.into_iter().for_each(|id| world.stop(id));
                }
                Step::Die(which) => {
                    let running = &mut world.machine.running;
                    let count = running.len().max(1);
                    let id = running.keys().nth(usize::from(which) % count).copied();
                    if let (Some(id), Some(agent), Some(saved)) = (id, &mut world.agent, &world.saved) {
                        running.remove(&id);
                        let died = EngineEvent { instance: id, outcome: Outcome::Died("x".into()) };
                        agent.outcome(world.now, saved.run, died);
                    }
                }
                Step::Fault(fault) => world.suffer(fault),
            }
            world.check_outcomes();
        }
        world.recover();
        world.check_outcomes();
        prop_assert_eq!(world.machine.running.len(), world.machine.wanted.len());
        // All that is still wanted has been reported as ready.
        for id in &world.machine.wanted {
            prop_assert_eq!(world.machine.outcomes.get(id).map(Vec::as_slice), Some(&[Outcome::Ready][..]));
        }
    }
}

/// A world without faults in which these instances run.
fn running(keep: &[bool]) -> (World<Server>, Vec<u64>) {
    let mut world = World::<Server>::new(Carrier::sound());
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
    assert!(world.agent().is_alone());
}

#[test]
fn a_core_counts_instances_of_a_lost_agent_as_dead_unless_they_go_on() {
    let (mut world, ids) = running(&[true, false]);
    world.network.is_cut = true;
    world.settle();
    assert_eq!(world.machine.outcomes[&ids[0]], [Outcome::Ready]);
    assert!(matches!(world.machine.outcomes[&ids[1]][..], [Outcome::Ready, Outcome::Died(_)]));
    world.network.is_cut = false;
    world.settle();
    assert_eq!(world.machine.outcomes[&ids[0]], [Outcome::Ready], "it went on");
    assert_eq!(world.machine.running.len(), 1);
}

#[test]
fn a_restarted_agent_goes_on_with_what_it_saved_while_the_core_is_away() {
    let (mut world, _) = running(&[true, false]);
    world.network.is_cut = true;
    world.start_agent();
    world.settle();
    assert_eq!(world.machine.running.len(), 1);
}

#[test]
fn instances_of_a_restarted_agent_are_reported_as_dead() {
    let (mut world, ids) = running(&[true, false]);
    world.start_agent();
    world.settle();
    for id in ids {
        assert!(matches!(world.machine.outcomes[&id][..], [Outcome::Ready, Outcome::Died(_)]));
    }
    assert!(world.machine.running.is_empty());
}

#[test]
fn instances_of_a_wanted_state_that_cannot_be_saved_fail() {
    let mut agent = Agent::new(Timestamp::ZERO, 1, None);
    let instances = (1..=2).map(|id| (id, instance(true))).collect();
    agent.want(Timestamp::ZERO, Wanted { instances, ..nothing() });
    assert!(matches!(agent.poll(Timestamp::ZERO), Some(Action::Save(_))));
    agent.cannot_save(Timestamp::ZERO, "the disk is full");
    let Some(Action::Report(report)) = agent.poll(Timestamp::ZERO) else { panic!("it starts something") };
    let failed = InstanceState::Failed("the disk is full".to_owned());
    assert_eq!(report.instances, BTreeMap::from([(1, failed.clone()), (2, failed)]));
}

#[test]
fn the_next_run_ends_what_the_last_one_left() {
    let (mut world, _) = running(&[true, true]);
    world.start_core();
    world.settle();
    assert!(world.machine.running.is_empty());
}

#[test]
fn messages_of_an_earlier_run_are_ignored() {
    let (mut world, _) = running(&[true]);
    let old = world.saved.clone().unwrap();
    world.start_core();
    world.start(true);
    world.settle();
    let late = Wanted { generation: old.generation + 100, instances: BTreeMap::new(), ..old };
    let now = world.now;
    world.agent().want(now, late);
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
    let boot = world.boots;
    world.controller.connection(world.now, &World::<Server>::name(), boot - 1, false);
    assert!(world.controller.is_present(&World::<Server>::name()), "an earlier process");
    world.controller.connection(world.now, &World::<Server>::name(), boot, false);
    assert!(!world.controller.is_present(&World::<Server>::name()));
    world.settle();
    assert!(matches!(world.machine.outcomes[&ids[0]][..], [Outcome::Ready, Outcome::Died(_)]));
}

#[test]
fn an_unknown_agent_is_refused_and_its_reports_are_ignored() {
    let mut controller = Controller::new(Run(1), LEASE, Vec::new(), [World::<Server>::name()]);
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
    let (now, run) = (world.now, world.saved.as_ref().unwrap().run);
    let agent = world.agent();
    let died = || EngineEvent { instance: InstanceId(ids[0]), outcome: Outcome::Died("x".to_owned()) };
    agent.outcome(now, Run(run.0 - 1), died());
    world.settle();
    assert_eq!(world.machine.outcomes[&ids[0]], [Outcome::Ready]);
    let now = world.now;
    world.agent().outcome(now, run, died());
    world.settle();
    assert!(matches!(world.machine.outcomes[&ids[0]][..], [Outcome::Ready, Outcome::Died(_)]));
}

#[test]
fn an_agent_is_settled_once_what_it_stopped_has_ended() {
    let (mut world, ids) = running(&[true]);
    world.stop(ids[0]);
    let now = world.now;
    world.agent().set_stopping(now, 1);
    world.settle();
    assert!(world.machine.running.is_empty() && !world.controller.is_settled());
    let now = world.now;
    world.agent().set_stopping(now, 0);
    world.settle();
    assert!(world.controller.is_settled());
}
