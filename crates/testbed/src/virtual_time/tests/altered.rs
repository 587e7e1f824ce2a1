use std::path::Path;

use cotorra_graph::{Nodes, ServiceTime, millis};

use crate::virtual_time::*;

const SEED: u64 = 3;

/// Runs the corridor for 100 s. Returns all events, and whether a fork was made.
fn events(altered: &Altered) -> (Vec<Stamped>, Option<Result<(), InstructionError>>) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let testbed = Arc::new(cotorra_testbed_file::load(file).unwrap());
    let mut events = Vec::new();
    let until = Some(Duration::from_secs(100));
    // No plug-in is a program, so that there is no folder.
    let run = Unrecorded { seed: SEED, until, altered, folder: Path::new(""), text: "" };
    let ended = simulate_unrecorded(testbed, &run, |event| events.push(event.clone()), || true).unwrap();
    (events, ended.unwrap().forked)
}

fn samples(events: &[Stamped]) -> Vec<ServiceTime> {
    let sample = |stamped: &Stamped| match &stamped.event {
        Event::ServiceTime(sample) => Some(sample.clone()),
        _ => None,
    };
    events.iter().filter_map(sample).collect()
}

/// Returns the first decision about an attachment or placement.
fn first_decision(events: &[Stamped]) -> (Timestamp, Instruction) {
    let decisions = events.iter().filter_map(|stamped| match &stamped.event {
        Event::Decision(decision) if decision.refused.is_none() => Some((stamped.at, &decision.instruction)),
        _ => None,
    });
    let mut attached = decisions.filter(|(_, instruction)| matches!(instruction, Instruction::Attach { .. }));
    attached
        .next()
        .map(|(at, instruction)| (at, instruction.clone()))
        .expect("the robot changes its radio unit")
}

fn fork(at: Timestamp, chosen: Instruction, instead: Option<Instruction>, hold: Timestamp) -> Altered {
    Altered { fork: Some(Fork { index: 0, at, chosen, instead, hold }), ..Altered::default() }
}

#[test]
fn a_slow_node_answers_later_by_exactly_that_time() {
    let slow = Duration::from_millis(2);
    let altered = Altered { slow: [("cloud".parse().unwrap(), slow)].into(), ..Altered::default() };
    let ([as_is, slower], until) =
        ([Altered::default(), altered].map(|altered| events(&altered).0), Timestamp::from_secs_f64(15.0));
    let early = |events| -> Vec<_> {
        let of_navigation =
            samples(events).into_iter().filter(|sample| sample.service.as_str() == "navigation");
        of_navigation
            .filter(|sample| sample.emitted < until)
            .map(|sample| millis::of(sample.took.unwrap()))
            .collect()
    };
    let median = |mut took: Vec<f64>| {
        took.sort_by(f64::total_cmp);
        took[took.len() / 2]
    };
    let [before, after] = [&as_is, &slower].map(|events| median(early(events)));
    assert!((after - before - 2.0).abs() < 0.01, "{before} {after}");
}

#[test]
fn a_fork_to_the_same_choice_changes_no_service_time() {
    let (as_is, none) = events(&Altered::default());
    assert!(none.is_none());
    let (at, chosen) = first_decision(&as_is);
    let (forked, outcome) = events(&fork(at, chosen.clone(), Some(chosen), at));
    assert_eq!(outcome, Some(Ok(())));
    assert_eq!(samples(&as_is), samples(&forked));
}

#[test]
fn a_fork_repeats_the_run_up_to_its_decision_and_holds_the_alternative() {
    let (as_is, _) = events(&Altered::default());
    let (at, chosen) = first_decision(&as_is);
    let never = Timestamp::from_nanos(u64::MAX);
    let (forked, outcome) = events(&fork(at, chosen.clone(), None, never));
    assert_eq!(outcome, Some(Ok(())));
    let before = |events: &[Stamped]| events.iter().take_while(|e| e.at < at).cloned().collect::<Vec<_>>();
    assert!(before(&as_is).len() > 1000 && before(&as_is) == before(&forked));
    let handovers =
        |events: &[Stamped]| events.iter().filter(|e| matches!(e.event, Event::Handover(_))).count();
    assert!(handovers(&as_is) > 0 && handovers(&forked) == 0);
    let rejected = forked.iter().filter(|stamped| match &stamped.event {
        Event::Decision(decision) => decision.refused.as_deref() == Some("a fork tries an alternative"),
        _ => false,
    });
    assert!(rejected.count() > 1, "the plug-in asks again");
}

#[test]
fn a_rejected_alternative_is_reported_and_a_decision_that_never_comes_too() {
    let (as_is, _) = events(&Altered::default());
    let (at, chosen) = first_decision(&as_is);
    let vnf = "nothing".parse().unwrap();
    let unknown = Instruction::Place { vnf, node: Nodes::from("edge".parse::<NodeId>().unwrap()) };
    let (_, outcome) = events(&fork(at, chosen.clone(), Some(unknown), at));
    assert!(outcome.unwrap().unwrap_err().to_string().contains("nothing"));
    let (later, _) = events(&fork(at + Duration::from_nanos(1), chosen, None, at));
    assert_eq!(samples(&as_is), samples(&later));
}
