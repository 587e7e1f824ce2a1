use cotorra_graph::{ContextKind, DecidesIn, Event, Instruction, InstructionLimit, PluginDistance};
use cotorra_graph_testing as base;
use proptest::prelude::*;

use super::*;

fn id() -> PluginId {
    "away".parse().unwrap()
}

fn at(ms: u64) -> Timestamp {
    Timestamp::ZERO + Duration::from_millis(ms)
}

fn travel(way: Way, decides_in: u64) -> Travel {
    Travel::in_virtual_time(&[spec(way, DecidesIn::fixed(Duration::from_millis(decides_in)))])
}

fn spec(way: Way, decides_in: Option<DecidesIn>) -> PluginSpec {
    PluginSpec {
        id: id(),
        program: PluginProgram::Bundled("probing".to_owned()),
        domain: None,
        optional: false,
        instructions_per_second: InstructionLimit::default(),
        distance: PluginDistance { way, decides_in },
        env: Vec::new(),
        settings: Default::default(),
    }
}

fn delayed(control_delay: u64, decides_in: u64) -> Travel {
    travel(Way::Delay { control_delay: Duration::from_millis(control_delay) }, decides_in)
}

/// κ of a robot, sampled at that time.
fn context(robot: &str, ms: u64) -> Arc<Stamped> {
    let pose = cotorra_graph::Pose::planar(0.0, 0.0, 0.0, [0.0; 9], cotorra_graph::PoseSource::Simulator);
    Arc::new(Stamped { at: at(ms), event: Event::Robot(base::robot_context(robot, pose)) })
}

fn scan(robot: &str) -> Given {
    Given::new(id(), Instruction::Scan { robot: robot.parse().unwrap() })
}

#[test]
fn contexts_and_instructions_take_the_delay_and_the_decision_its_time() {
    let mut travel = delayed(100, 30);
    assert!(travel.send_context(at(0), &id(), context("r", 0)).is_none());
    assert_eq!(travel.next_deadline(), Some(at(100)));
    assert!(travel.next_context(at(99), &id()).is_none());
    assert!(travel.next_context(at(100), &id()).is_some());
    assert_eq!(travel.send_instruction(at(100), scan("r")), Sent::UnderWay);
    assert_eq!(travel.next_deadline(), Some(at(230)));
    assert!(travel.next_instruction(at(229)).is_none());
    let (given, staleness) = travel.next_instruction(at(230)).unwrap();
    assert_eq!(given, scan("r"));
    let [Staleness { kind, contexts, youngest, oldest, .. }] = &staleness[..] else {
        panic!("{staleness:?}")
    };
    assert_eq!((*kind, *contexts), (ContextKind::Robot, 1));
    assert_eq!((*youngest, *oldest), (Duration::from_millis(230), Duration::from_millis(230)));
}

#[test]
fn contexts_wait_while_the_plugin_decides() {
    let mut travel = delayed(0, 50);
    travel.send_context(at(0), &id(), context("r", 0));
    travel.next_context(at(0), &id()).unwrap();
    travel.send_instruction(at(0), scan("r"));
    travel.send_context(at(10), &id(), context("r", 10));
    assert!(travel.next_context(at(49), &id()).is_none());
    assert_eq!(travel.next_context(at(50), &id()), Some(context("r", 10)));
}

#[test]
fn a_measured_decision_takes_its_cpu_time_times_the_factor() {
    let factor = CpuFactor::new(2.5).unwrap();
    let spec = spec(Way::None, Some(DecidesIn::Cpu { factor }));
    let mut travel = Travel::in_virtual_time(std::slice::from_ref(&spec));
    for (begins, used, ends) in [(0, 40, 100), (200, 4, 210)] {
        travel.decide_in(&id(), Duration::from_millis(used));
        assert_eq!(travel.send_instruction(at(begins), scan("r")), Sent::UnderWay);
        assert_eq!((travel.free_at(&id()), travel.next_deadline()), (at(ends), Some(at(ends))));
        assert!(travel.next_instruction(at(ends)).is_some());
    }
    // Others decide in the time of their file, and in real time nobody is charged.
    let mut fixed = delayed(0, 7);
    fixed.decide_in(&id(), Duration::from_millis(40));
    fixed.send_instruction(at(0), scan("r"));
    assert_eq!(fixed.next_deadline(), Some(at(7)));
    assert!(!Travel::in_real_time(&[spec]).is_away(&id()));
}

#[test]
fn the_staleness_is_that_of_the_contexts_at_the_decision() {
    let mut travel = delayed(10, 0);
    for (robot, sampled) in [("r", 0), ("s", 5), ("r", 7)] {
        travel.send_context(at(sampled), &id(), context(robot, sampled));
    }
    while travel.next_context(at(20), &id()).is_some() {}
    travel.send_instruction(at(20), scan("r"));
    // It arrives too late to be part of the decision.
    travel.send_context(at(19), &id(), context("s", 19));
    travel.next_context(at(29), &id()).unwrap();
    let (_, staleness) = travel.next_instruction(at(30)).unwrap();
    let [its] = &staleness[..] else { panic!("{staleness:?}") };
    assert_eq!((its.contexts, its.youngest, its.oldest), (2, at(23).since(at(0)), at(25).since(at(0))));
}

#[test]
fn a_plugin_beside_the_core_gets_its_contexts_back_at_once() {
    let mut travel = travel(Way::None, 0);
    assert!(travel.send_context(at(0), &id(), context("r", 0)).is_some());
    assert_eq!(travel.send_instruction(at(0), scan("r")), Sent::Arrived(scan("r").into()));
    assert_eq!(travel.next_deadline(), None);
}

#[test]
fn a_plugin_that_is_far_behind_misses_the_oldest() {
    let mut travel = delayed(0, 10_000);
    travel.send_instruction(at(0), scan("r"));
    for ms in 0..QUEUE as u64 + 10 {
        travel.send_context(at(ms), &id(), context("r", ms));
    }
    assert!(travel.next_context(at(9999), &id()).is_none());
    assert_eq!(travel.next_context(at(10_000), &id()).unwrap().at, at(10));
    assert_eq!(travel.missed(), 10);
}

#[test]
fn what_is_on_its_way_ends_with_the_plugin() {
    let mut travel = delayed(10, 0);
    travel.send_context(at(0), &id(), context("r", 0));
    travel.send_instruction(at(0), scan("r"));
    travel.forget(&id());
    assert_eq!(travel.next_deadline(), None);
    assert!(travel.next_instruction(at(100)).is_none());
}

fn between_nodes() -> Travel {
    travel(Way::Nodes { core: "edge".parse().unwrap(), plugin: "cloud".parse().unwrap() }, 0)
}

fn datagrams(travel: &mut Travel, now: Timestamp) -> Vec<Datagram> {
    std::iter::from_fn(|| travel.poll_transmit(now)).collect()
}

#[test]
fn a_message_has_the_bytes_of_its_json_between_the_nodes() {
    let mut travel = between_nodes();
    let context = context("r", 0);
    travel.send_context(at(0), &id(), Arc::clone(&context));
    let sent = datagrams(&mut travel, at(0));
    let json = serde_json::to_vec(&*context).unwrap();
    let payload: Vec<u8> = sent.iter().flat_map(|datagram| &datagram.payload[15..]).copied().collect();
    assert_eq!(payload, json);
    assert!(sent.iter().all(|datagram| datagram.from == "edge" && datagram.to == "cloud"));
    assert!(travel.next_context(at(1), &id()).is_none());
    sent.iter().for_each(|datagram| travel.receive(at(1), datagram));
    assert_eq!(travel.next_context(at(1), &id()), Some(context));
}

#[test]
fn a_lost_context_is_not_seen_and_later_ones_are() {
    let mut travel = between_nodes();
    for ms in 0..3 {
        travel.send_context(at(ms), &id(), context("r", ms));
        let sent = datagrams(&mut travel, at(ms));
        if ms != 1 {
            sent.iter().for_each(|datagram| travel.receive(at(ms), datagram));
        }
    }
    let seen: Vec<_> = std::iter::from_fn(|| travel.next_context(at(9), &id())).map(|seen| seen.at).collect();
    assert_eq!(seen, [at(0), at(2)]);
    assert_eq!(travel.next_deadline(), None);
}

#[test]
fn datagrams_that_others_send_change_nothing() {
    let mut travel = between_nodes();
    travel.send_context(at(0), &id(), context("r", 0));
    travel.send_instruction(at(0), scan("r"));
    let sent = datagrams(&mut travel, at(0));
    for datagram in &sent {
        let Datagram { from, to, payload } = datagram.clone();
        for (from, to) in [(to.clone(), from), ("robot".parse().unwrap(), to)] {
            travel.receive(at(1), &Datagram { from, to, payload: payload.clone() });
        }
    }
    assert!(travel.next_context(at(1), &id()).is_none() && travel.next_instruction(at(1)).is_none());
    sent.iter().for_each(|datagram| travel.receive(at(2), datagram));
    assert!(travel.next_context(at(2), &id()).is_some() && travel.next_instruction(at(2)).is_some());
    // The acknowledgement counts only from the core.
    let [acknowledgement] = &datagrams(&mut travel, at(2))[..] else { panic!("one instruction arrived") };
    let (from, to) = (acknowledgement.to.clone(), acknowledgement.from.clone());
    travel.receive(at(3), &Datagram { from, to, payload: acknowledgement.payload.clone() });
    assert!(travel.next_deadline().is_some());
    travel.receive(at(3), acknowledgement);
    assert_eq!(travel.next_deadline(), None);
}

#[test]
fn contexts_are_handed_over_one_at_a_time_and_known_once_handled() {
    let mut travel = delayed(10, 0);
    travel.send_context(at(0), &id(), context("r", 0));
    travel.send_context(at(5), &id(), context("r", 5));
    assert_eq!(travel.hand_over(at(20), &id()), Some(context("r", 0)));
    assert_eq!((travel.hand_over(at(20), &id()), travel.next_deadline()), (None, None));
    // It was given by a timer, before the plug-in has handled any context.
    travel.send_instruction(at(20), scan("r"));
    assert_eq!(travel.next_instruction(at(30)), Some((scan("r"), Vec::new())));
    travel.handled(&id());
    travel.send_instruction(at(40), scan("r"));
    let (_, staleness) = travel.next_instruction(at(50)).unwrap();
    assert_eq!(staleness[0].youngest, Duration::from_millis(50));
    assert_eq!(travel.hand_over(at(50), &id()), Some(context("r", 5)));
}

#[test]
fn instructions_under_way_are_bounded() {
    let dead = Way::Nodes { core: "edge".parse().unwrap(), plugin: "cloud".parse().unwrap() };
    for mut travel in [travel(dead, 0), delayed(1000, 0)] {
        for _ in 0..INSTRUCTIONS {
            assert_eq!(travel.send_instruction(at(0), scan("r")), Sent::UnderWay);
            // Nothing arrives.
            let _ = datagrams(&mut travel, at(0));
        }
        assert_eq!(travel.send_instruction(at(0), scan("r")), Sent::Rejected);
    }
}

proptest! {
    /// Whatever the network loses, duplicates and reorders, each instruction arrives once, in order.
    #[test]
    fn instructions_arrive_once_and_in_order(
        fates in proptest::collection::vec((0..4_u8, any::<bool>()), 0..200), count in 1..8_u32,
    ) {
        let mut travel = between_nodes();
        let long = "x".repeat(1000);
        let given = |n: u32| Given { reason: Some(format!("{n} {long}{long}")), ..scan("r") };
        (0..count).for_each(|n| assert_eq!(travel.send_instruction(at(0), given(n)), Sent::UnderWay));
        let (mut fates, mut arrived, mut held) = (fates.into_iter(), Vec::new(), None);
        let mut now = at(0);
        while let Some(deadline) = travel.next_deadline() {
            now = now.max(deadline);
            while let Some(datagram) = travel.poll_transmit(now) {
                // After a while, the network is perfect.
                match fates.next() {
                    Some((0, _)) => continue,
                    Some((1, _)) => travel.receive(now, &datagram),
                    Some((2, _)) => {
                        held = Some(datagram);
                        continue;
                    }
                    _ => {}
                }
                travel.receive(now, &datagram);
                held.take().into_iter().for_each(|late: Datagram| travel.receive(now, &late));
            }
            arrived.extend(std::iter::from_fn(|| travel.next_instruction(now)).map(|(given, _)| given));
        }
        prop_assert_eq!(arrived, (0..count).map(given).collect::<Vec<_>>());
    }

    #[test]
    fn nothing_that_arrives_does_harm(payload in proptest::collection::vec(any::<u8>(), 0..40)) {
        let mut travel = between_nodes();
        travel.send_instruction(at(0), scan("r"));
        for (from, to) in [("edge", "cloud"), ("cloud", "edge")] {
            let (from, to) = (from.parse().unwrap(), to.parse().unwrap());
            travel.receive(at(0), &Datagram { from, to, payload: payload.clone() });
        }
        let _ = datagrams(&mut travel, at(0));
    }
}
