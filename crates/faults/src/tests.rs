use std::{path::Path, time::Duration};

use cotorra_engine::InstanceId;
use cotorra_fabric::Balance;
use cotorra_graph::{
    Decision, Direction, Event, Instruction, NodeId, PluginId, Pose, PoseSource, RobotContext, SensorData,
    ServiceTime, Stamped, Testbed, Velocity, Vnf, VnfEvent, VnfState,
};
use cotorra_graph_testing as base;
use cotorra_network_control::vim::{Managed, Stage};

use super::{
    invariants::{Broken, Decided, Fits, OURS, Slow, Stops, View, Watch, conserved, kept, restarted, served},
    plan::Plan,
    *,
};

fn at(seconds: f64) -> Timestamp {
    Timestamp::from_secs_f64(seconds)
}

fn stamped(seconds: f64, event: Event) -> Stamped {
    Stamped { at: at(seconds), event }
}

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

/// Two servers and a radio unit; each server has room for one of the two VNFs.
fn lab() -> Testbed {
    let text = "
name: lab
wireless: { lab: {} }
nodes:
  robot: { kind: robot }
  unit: { kind: radio_unit, position: [0, 0], channel: 1 }
  one: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
  two: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [unit, [one, two]] }
services:
  navigation:
    robot: robot
    kpis: { service_time: 500 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      brain: { program: navigation, node: one }
    virtual_links: [{ from: driver, to: brain, rate: 0.1 Mbit/s }]
walks:
  robot: { waypoints: [[0, 0], [1, 0]] }
";
    cotorra_testbed_file::parse("lab.yaml", text, Path::new("")).unwrap_or_else(|e| panic!("{e}"))
}

fn brain(testbed: &Testbed) -> &Vnf {
    testbed.services[0].vnfs.iter().find(|vnf| vnf.id.as_str() == "brain").unwrap()
}

/// The brain with these instances.
fn managed<'a>(vnf: &'a Vnf, instances: &[(u64, &'a NodeId, Stage)]) -> Managed<'a> {
    let instances = instances.iter().map(|(id, node, stage)| (InstanceId(*id), *node, *stage)).collect();
    Managed { vnf, node: Some(vnf.node.first()), instances, restart_at: None }
}

/// A core's state with these VNFs, all of whose instances run.
fn view<'a>(testbed: &'a Testbed, managed: Vec<Managed<'a>>) -> View<'a> {
    let running = managed.iter().flat_map(|managed| managed.instances.iter().map(|(id, ..)| *id)).collect();
    View {
        now: at(5.0),
        graph: &testbed.graph,
        managed,
        running,
        packets: Balance::default(),
        reserved: Vec::new(),
    }
}

fn found<T>(result: Result<T, Broken>) -> Option<String> {
    result.err().map(|Broken(_, what)| what)
}

#[test]
fn a_seed_repeats_to_the_last_event_and_another_gives_another_run() {
    let run = |seed| run::run(seed).unwrap();
    for seed in 1..4 {
        let (first, again) = (run(seed), run(seed));
        assert_eq!((&first.generated, &first.plan), (&again.generated, &again.plan));
        assert!(first.events == again.events, "seed {seed}");
        assert_eq!(first.broken, again.broken);
    }
    assert_ne!(run(1).generated, run(2).generated);
    assert_ne!(run(1).events, run(2).events);
}

/// Each seed gives a testbed that passes a user's checks, and all kinds of faults are drawn.
#[test]
fn every_testbed_is_valid_and_every_kind_of_fault_is_planned() {
    let mut kinds = std::collections::BTreeSet::new();
    let mut federated = 0;
    let mut sizes = std::collections::BTreeSet::new();
    for seed in 0..300 {
        let generated = generator::testbed(seed);
        // The map is only checked in a run, which has its folder.
        let text = generated.text.replace(&format!("map: {}\n", generator::MAP_YAML), "");
        if text.contains("program: localization") {
            continue;
        }
        let testbed = cotorra_testbed_file::parse("generated.yaml", &text, Path::new(""))
            .unwrap_or_else(|e| panic!("seed {seed}: {e}\n{text}"));
        federated += usize::from(testbed.graph.domains.len() > 1);
        sizes.insert((testbed.graph.robots().count(), testbed.graph.radio_units().count()));
        let plan = Plan::new(seed, &testbed);
        assert!(plan.faults.is_sorted_by_key(|(at, _)| *at));
        assert!(plan.faults.iter().all(|(at, _)| *at < plan.until + Duration::from_secs(5)));
        kinds.extend(plan.faults.iter().map(|(_, fault)| fault.kind()));
    }
    for size in (1..=4).flat_map(|robots| (1..=4).map(move |units| (robots, units))) {
        assert!(sizes.contains(&size), "{size:?} is not among {sizes:?}");
    }
    assert!((20..80).contains(&federated), "{federated} of 300 have several domains");
    assert_eq!(kinds.len(), 24, "{kinds:?}");
}

/// The results are the same for any number of threads.
#[test]
fn results_do_not_depend_on_the_number_of_jobs() {
    let test = |jobs| {
        let jobs = NonZero::new(jobs).unwrap();
        FaultTest { first_seed: 20, runs: 6, jobs, keep: None }.run(&mut |_| true).unwrap()
    };
    let (one, three) = (test(1), test(3));
    assert_eq!(one, three);
    assert_eq!(one.runs, 6);
}

#[test]
fn a_kept_run_has_its_testbed_plan_and_history() {
    let folder = tempfile::tempdir().unwrap();
    let outcome = run::run(5).unwrap();
    let kept = outcome.keep(5, folder.path()).unwrap();
    let text = std::fs::read_to_string(kept.join("testbed.yaml")).unwrap();
    cotorra_testbed_file::load(kept.join("testbed.yaml")).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(text, outcome.generated.text);
    let plan = std::fs::read_to_string(kept.join("plan.txt")).unwrap();
    assert_eq!(plan.lines().count(), outcome.plan.faults.len() + 1);
    let history = cotorra_measurements::History::open(kept.join("history.sqlite")).unwrap();
    assert_eq!(history.runs(None, 9).unwrap().len(), 1);
}

fn context(linear: f64, angular: f64) -> Event {
    let pose = Pose::planar(0.0, 0.0, 0.0, [0.0; 9], PoseSource::Simulator);
    let sensors = SensorData { velocity: Velocity::planar(linear, angular), ..base::sensors(pose) };
    Event::Robot(RobotContext { sensors, ..base::robot_context("robot", pose) })
}

fn sample(took: Option<Duration>) -> Event {
    Event::ServiceTime(ServiceTime { sequence: 1, ..base::service_time("one", at(1.0), took) })
}

#[test]
fn a_robot_that_moves_without_fresh_commands_is_found() {
    let testbed = lab();
    let moved = |commands: Event, seconds: f64, linear: f64, angular: f64| {
        let (mut stops, mut checked) = (Stops::new(&testbed), Checked::default());
        stops.event(&stamped(1.0, commands), &mut checked).unwrap();
        let found_violation = found(stops.event(&stamped(seconds, context(linear, angular)), &mut checked));
        (found_violation.is_some(), checked.exercised)
    };
    let answered = || sample(Some(Duration::from_millis(20)));
    // Within the timeout it may follow its command, and the check counts as not exercised.
    assert_eq!(moved(answered(), 1.6, 0.7, 3.0), (false, 0));
    // Then it brakes from 0.7 m/s with 0.6 m/s², and from 3.14 rad/s with 4.2 rad/s².
    assert_eq!(moved(answered(), 2.0, 0.5, 0.0), (false, 1));
    assert_eq!(moved(answered(), 2.0, 0.6, 0.0), (true, 1));
    assert_eq!(moved(answered(), 2.0, 0.0, 1.6), (false, 1));
    assert_eq!(moved(answered(), 2.0, 0.0, 2.0), (true, 1));
    // While it rolls its gyro is noisy; at rest it is not.
    assert_eq!(moved(answered(), 2.5, 0.15, 0.004), (false, 1));
    assert_eq!(moved(answered(), 3.0, 0.001, 0.0), (true, 1));
    assert_eq!(moved(answered(), 3.0, 0.0, 0.004), (true, 1));
    assert_eq!(moved(answered(), 3.0, 0.0, 0.0), (false, 1));
    // An unanswered packet is no command, and neither is a rejected instruction.
    assert!(moved(sample(None), 1.1, 0.1, 0.0).0);
    // Neither is an answer of another service.
    let Event::ServiceTime(answer) = answered() else { panic!("it is one") };
    let pose = ServiceTime { service: "localization".parse().unwrap(), ..answer };
    assert!(moved(Event::ServiceTime(pose), 1.1, 0.1, 0.0).0);
    let order = |refused: Option<&str>| {
        let instruction =
            Instruction::Move { robot: node("robot"), velocity: Velocity::default(), waypoint: 0 };
        let plugin = PluginId::new("plugin").unwrap();
        let refused = refused.map(str::to_owned);
        Event::Decision(Decision { plugin, instruction, reason: None, refused })
    };
    assert!(!moved(order(None), 1.5, 0.3, 0.0).0);
    assert!(moved(order(Some("it is halted")), 1.5, 0.3, 0.0).0);
}

#[test]
fn a_robot_above_its_speed_limit_is_found() {
    let limited = |limit: Option<f64>, speeds: &[(f64, f64)]| {
        let (mut slow, mut checked) = (Slow::default(), Checked::default());
        let found_violation = speeds.iter().find_map(|(seconds, speed)| {
            let Event::Robot(context) = context(*speed, 0.0) else { return None };
            let event = Event::Robot(RobotContext { speed_limit_mps: limit, ..context });
            found(slow.event(&stamped(*seconds, event), &mut checked))
        });
        (found_violation.is_some(), checked.exercised > 0)
    };
    // It may follow its command from before the limit, and brakes then.
    assert_eq!(limited(Some(0.2), &[(1.0, 0.7), (1.6, 0.7), (2.0, 0.5), (3.0, 0.2)]), (false, true));
    assert_eq!(limited(Some(0.2), &[(1.0, 0.7), (2.0, 0.6)]), (true, true));
    assert_eq!(limited(Some(0.2), &[(1.0, 0.7), (3.0, 0.3)]), (true, true));
    assert_eq!(limited(Some(0.0), &[(1.0, 0.7), (9.0, -0.1)]), (true, true));
    assert_eq!(limited(None, &[(1.0, 0.7), (9.0, 0.7)]), (false, false));
}

#[test]
fn a_vnf_served_by_two_instances_is_found() {
    let testbed = lab();
    let (vnf, one, two) = (brain(&testbed), node("one"), node("two"));
    let mut checked = Checked::default();
    let mut check = |managed: Vec<Managed<'_>>| found(served(&view(&testbed, managed), &mut checked));
    let usual = [(1, &one, Stage::Serving), (2, &two, Stage::Starting), (3, &two, Stage::Draining(at(5.5)))];
    assert_eq!(check(vec![managed(vnf, &usual)]), None);
    let two_serve = [(1, &one, Stage::Serving), (2, &two, Stage::Serving)];
    assert_eq!(
        check(vec![managed(vnf, &two_serve)]).unwrap(),
        "brain has 2 instances that serve and 0 that start"
    );
    let overdue = [(1, &one, Stage::Serving), (2, &two, Stage::Draining(at(4.9)))];
    assert_eq!(
        check(vec![managed(vnf, &overdue)]).unwrap(),
        "an instance of brain on two was to stop at 4.900 s"
    );
    // Each replica has a node of its own.
    let another = |place| {
        let serves = [(9, place, Stage::Serving)];
        vec![managed(vnf, &usual), Managed { node: Some(place), ..managed(vnf, &serves) }]
    };
    assert_eq!(check(another(&two)), None);
    assert_eq!(check(another(&one)).unwrap(), "two replicas of brain are on one");
    assert_eq!((checked.checks, checked.exercised), (2, 2));
}

#[test]
fn a_removed_vnf_takes_no_room_and_is_not_started_again() {
    let testbed = lab();
    let (vnf, one) = (brain(&testbed), node("one"));
    let mut checked = Checked::default();
    let draining = [(1, &one, Stage::Draining(at(5.5)))];
    let removed = || vec![Managed { node: None, ..managed(vnf, &draining) }];
    assert_eq!(found(served(&view(&testbed, removed()), &mut checked)), None);
    assert_eq!(found(restarted(&view(&testbed, removed()), &mut checked)), None);
    let large = Vnf { cpus: 1000.0, ..vnf.clone() };
    let removed = vec![Managed { node: None, ..managed(&large, &draining) }];
    assert_eq!(found(Fits::new(&testbed.graph).state(&view(&testbed, removed), &mut checked)), None);
}

#[test]
fn an_unmanaged_or_missing_instance_is_found() {
    let testbed = lab();
    let one = node("one");
    let check = |running: &[u64]| {
        let mut view = view(&testbed, vec![managed(brain(&testbed), &[(7, &one, Stage::Serving)])]);
        view.running = running.iter().map(|id| InstanceId(*id)).collect();
        found(served(&view, &mut Checked::default()))
    };
    assert_eq!(check(&[7]), None);
    assert_eq!(check(&[6, 7]).unwrap(), "instance 6 runs, but nobody manages it, nor ever stops it");
    assert_eq!(check(&[]).unwrap(), "instance 7 is managed, but does not run");
}

#[test]
fn a_vnf_left_dead_is_found() {
    let testbed = lab();
    let two = node("two");
    let mut checked = Checked::default();
    let mut check = |managed| found(restarted(&view(&testbed, vec![managed]), &mut checked));
    let dead = || managed(brain(&testbed), &[]);
    assert_eq!(check(Managed { restart_at: Some(at(6.0)), ..dead() }), None);
    assert_eq!(check(managed(brain(&testbed), &[(1, &two, Stage::Starting)])), None);
    let left = "nothing serves brain on one, and it is not started again";
    assert_eq!(check(dead()).unwrap(), left);
    let last = [(1, &two, Stage::Draining(at(5.5)))];
    assert_eq!(check(managed(brain(&testbed), &last)).unwrap(), left);
    assert_eq!((checked.checks, checked.exercised), (2, 2));
}

#[test]
fn an_overloaded_node_is_found() {
    let testbed = lab();
    let vnf = brain(&testbed);
    let other = Vnf { id: "other".parse().unwrap(), node: node("two").into(), ..vnf.clone() };
    let (one, two) = (node("one"), node("two"));
    let mut fits = Fits::new(&testbed.graph);
    let mut checked = Checked::default();
    let mut check =
        |fits: &Fits, all: Vec<Managed<'_>>| found(fits.state(&view(&testbed, all), &mut checked));
    let apart = || vec![managed(vnf, &[(1, &one, Stage::Serving)]), managed(&other, &[])];
    assert_eq!(check(&fits, apart()), None);
    // A VNF is about to serve on the node of the other one.
    let moves = [(1, &one, Stage::Serving), (2, &two, Stage::Starting)];
    assert_eq!(
        check(&fits, vec![managed(vnf, &moves), managed(&other, &[])]).unwrap(),
        "two has 1 CPUs and 1000 MB, and carries 2.000 CPUs and 512 MB: brain, other"
    );
    // A virtual access point also uses its node while it is deployed.
    let at_unit = Vnf { node: node("unit").into(), ..vnf.clone() };
    let access_point = |state| {
        let (vnf, node) = ("vAP-unit".parse().unwrap(), node("unit"));
        stamped(1.0, Event::Vnf(VnfEvent { vnf, node, state, detail: None }))
    };
    assert_eq!(check(&fits, vec![managed(&at_unit, &[])]), None);
    fits.event(&access_point(VnfState::Started));
    assert!(check(&fits, vec![managed(&at_unit, &[])]).unwrap().ends_with("brain, vAP-unit"));
    fits.event(&access_point(VnfState::Stopped));
    assert_eq!(check(&fits, vec![managed(&at_unit, &[])]), None);
}

#[test]
fn an_overreserved_link_is_found() {
    let testbed = lab();
    let mut checked = Checked::default();
    let mut check = |reserved| {
        let reserved = vec![("one-unit".parse().unwrap(), Direction::Forward, [reserved, 4.0])];
        let view = View { reserved, ..view(&testbed, Vec::new()) };
        found(Fits::new(&testbed.graph).state(&view, &mut checked))
    };
    assert_eq!((check(4.0), check(0.0)), (None, None));
    assert!(check(4.5).unwrap().contains("carries 4 bit/s Forward, and 4.5 are reserved"));
    assert_eq!((checked.checks, checked.exercised), (2, 1));
}

#[test]
fn a_lost_or_invented_packet_is_found() {
    let testbed = lab();
    let even =
        Balance { sent: 9, duplicated: 1, delivered: 4, lost: 2, overflowed: 1, stranded: 1, under_way: 2 };
    let mut checked = Checked::default();
    let mut check = |packets| found(conserved(&View { packets, ..view(&testbed, Vec::new()) }, &mut checked));
    assert_eq!(check(even), None);
    assert!(check(Balance { delivered: 3, ..even }).is_some());
    assert!(check(Balance { delivered: 5, ..even }).is_some());
    assert!(check(Balance { lost: 1, ..even }).is_some());
    assert_eq!((checked.checks, checked.exercised), (4, 4));
}

#[test]
fn an_instruction_without_a_decision_or_with_two_is_found() {
    let us = PluginId::new(OURS).unwrap();
    let decision = |plugin: &PluginId, number: &str, refused: Option<&str>| {
        let instruction = Instruction::Scan { robot: node("robot") };
        let (reason, refused) = (Some(number.to_owned()), refused.map(str::to_owned));
        stamped(1.0, Event::Decision(Decision { plugin: plugin.clone(), instruction, reason, refused }))
    };
    let mut checked = Checked::default();
    let mut decided = Decided::default();
    let mut check_event = |decided: &mut Decided, event: &Stamped| found(decided.event(event, &mut checked));
    decided.given(&us, 0, None);
    assert_eq!(found(decided.settled()).unwrap(), "number 0 of fault-test was never decided");
    assert_eq!(check_event(&mut decided, &decision(&us, "0", None)), None);
    assert_eq!(found(decided.settled()), None);
    assert_eq!(
        check_event(&mut decided, &decision(&us, "0", None)).unwrap(),
        "`scan` of fault-test, number 0, was decided in place of 1"
    );
    decided.given(&us, 1, None);
    assert!(check_event(&mut decided, &decision(&us, "1", Some("it is busy"))).unwrap().contains("number 1"));
    // A plug-in that was cut off gets no further decisions; another one gets a decision for each instruction.
    let saboteur = PluginId::new("saboteur-1").unwrap();
    assert_eq!(check_event(&mut decided, &decision(&saboteur, "0", None)), None);
    assert_eq!(found(decided.all_of(&saboteur, 1)), None);
    assert_eq!(
        found(decided.all_of(&saboteur, 2)).unwrap(),
        "of 2 instructions of saboteur-1, 1 were decided"
    );
    let fault = Event::PluginFault { plugin: saboteur.clone(), reason: "by design".to_owned() };
    assert_eq!(check_event(&mut decided, &stamped(1.0, fault)), None);
    assert_eq!(
        check_event(&mut decided, &decision(&saboteur, "1", None)).unwrap(),
        "saboteur-1 was cut off, but `scan` was decided for it"
    );
}

#[test]
fn a_lost_acknowledged_event_is_found() {
    let notice = |seconds, message: &str| stamped(seconds, Event::Notice { message: message.to_owned() });
    let (a, b, c) = (notice(2.0, "a"), notice(1.0, "b"), notice(3.0, "c"));
    let acknowledged = [a.clone(), b.clone()];
    let mut checked = Checked::default();
    let mut check = |found_: &[Stamped]| found(kept(&acknowledged, found_, &mut checked));
    assert_eq!(check(&[b.clone(), a.clone()]), None, "a history is in the order of time");
    assert_eq!(check(std::slice::from_ref(&b)).unwrap(), "the history acknowledged 2 events and has 1");
    assert_eq!(
        check(&[b.clone(), a.clone(), c.clone()]).unwrap(),
        "the history acknowledged 2 events and has 3"
    );
    assert!(check(&[b, c]).unwrap().starts_with("event 1 of the history is"));
    assert_eq!((checked.checks, checked.exercised), (4, 4));
    found(kept(&[], &[a], &mut Checked::default())).unwrap();
}

/// Checking all invariants at once gives the result of each.
#[test]
fn the_watch_runs_every_checker() {
    let testbed = lab();
    let one = node("one");
    let good = || view(&testbed, vec![managed(brain(&testbed), &[(1, &one, Stage::Serving)])]);
    let broken =
        |view: View<'_>| Watch::new(&testbed).state(&view).err().map(|Broken(invariant, _)| invariant);
    assert_eq!(broken(good()), None);
    assert_eq!(broken(View { running: Vec::new(), ..good() }), Some(Invariant::Served));
    assert_eq!(broken(view(&testbed, vec![managed(brain(&testbed), &[])])), Some(Invariant::Restarted));
    let big = Vnf { cpus: 9.0, ..brain(&testbed).clone() };
    assert_eq!(
        broken(view(&testbed, vec![managed(&big, &[(1, &one, Stage::Serving)])])),
        Some(Invariant::Fits)
    );
    let packets = Balance { sent: 1, ..Balance::default() };
    assert_eq!(broken(View { packets, ..good() }), Some(Invariant::Conserved));
    let mut watch = Watch::new(&testbed);
    watch.decided.given(&PluginId::new(OURS).unwrap(), 0, None);
    assert_eq!(watch.state(&good()).err().map(|Broken(i, _)| i), Some(Invariant::Decided));
    let moving = watch.event(&stamped(1.0, context(0.1, 0.0)));
    assert_eq!(moving.err().map(|Broken(i, _)| i), Some(Invariant::Stops));
    let fast = |seconds: f64| {
        let Event::Robot(context) = context(0.5, 0.0) else { panic!("it is one") };
        stamped(seconds, Event::Robot(RobotContext { speed_limit_mps: Some(0.1), ..context }))
    };
    let mut watch = Watch::new(&testbed);
    for second in [1.0, 2.0, 3.0] {
        watch.event(&stamped(second, sample(Some(Duration::from_millis(20))))).unwrap();
        let found_violation = watch.event(&fast(second + 0.1)).err().map(|Broken(i, _)| i);
        assert_eq!(found_violation, (second > 2.0).then_some(Invariant::Slow));
    }
}

/// Every kind of fault happens, and every promise is exercised. scripts/test does many more runs.
#[test]
fn no_fault_breaks_a_promise() {
    let runs = 30;
    let jobs = std::thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
    let tested = FaultTest { first_seed: 100_001, runs, jobs, keep: None }.run(&mut |_| true).unwrap();
    assert_eq!((tested.runs, &tested.violations[..]), (runs, &[][..]));
    for invariant in Invariant::ALL.into_iter().filter(|invariant| *invariant != Invariant::Stands) {
        let Checked { checks, exercised } = tested.checked[invariant as usize];
        assert!(exercised > 0, "{invariant:?} was checked {checks} times, and never exercised");
    }
    assert_eq!(tested.faults.len(), 24, "{:?}", tested.faults);
}

/// Faults leave the ledger working.
#[test]
fn a_robot_is_handed_over_although_the_ledger_is_reorganised() {
    let outcome = run::run(354).unwrap();
    assert_eq!(outcome.injected["ledger reorganised"], 3);
    let is_used = |stamped: &Stamped| match &stamped.event {
        Event::Decision(Decision { instruction: Instruction::Note { step, .. }, .. }) => step == "in use",
        _ => false,
    };
    assert!(outcome.events.iter().any(is_used));
}
