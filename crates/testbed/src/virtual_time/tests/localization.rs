//! Localization by VNFs: its errors, and its service times.

use std::{collections::BTreeSet, path::Path};

use cotorra_graph::{
    ConditionChange, Event, Instruction, LinkId, Loss, Nodes, PoseSource, Probability, ServiceTime,
};

use crate::virtual_time::*;

/// Time after which a scan is unanswered.
const PATIENCE: Duration = Duration::from_secs(3);

fn corridor() -> Arc<Testbed> {
    changed(|text| text)
}

/// Returns the corridor with a changed text.
fn changed(change: impl FnOnce(String) -> String) -> Arc<Testbed> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let text = change(std::fs::read_to_string(&file).unwrap());
    let parsed = cotorra_testbed_file::parse("corridor.yaml", &text, file.parent().unwrap());
    Arc::new(parsed.unwrap_or_else(|wrong| panic!("{wrong}")))
}

fn instruct(simulation: &mut Simulation, instruction: Instruction) {
    simulation.instruct(Given::new("test".parse().unwrap(), instruction)).unwrap();
}

/// Changes the links between the robot's first two radio units and the edge.
fn condition(simulation: &mut Simulation, change: &ConditionChange) {
    for link in ["R1-edge", "R3-edge"] {
        let (link, change) = (LinkId::new(link).unwrap(), change.clone());
        instruct(simulation, Instruction::Condition { link, direction: None, change });
    }
}

fn lose(share: f64) -> ConditionChange {
    let loss = Some(Loss::Independent { rate: Probability::new(share).unwrap() });
    ConditionChange { loss, ..ConditionChange::default() }
}

fn place(simulation: &mut Simulation, node: &str) {
    let node = Nodes::from(node.parse::<NodeId>().unwrap());
    instruct(simulation, Instruction::Place { vnf: "localization".parse().unwrap(), node });
}

/// Simulates a minute, and calls `each` after each step with the number of the second if that is new. Returns localization's
/// samples with the times of their events. Checks that each scan has one, unless it is under way at the end, and that the
/// parts of answered ones add up.
fn samples(
    testbed: Arc<Testbed>,
    mut each: impl FnMut(&mut Simulation, u64),
) -> Vec<(Timestamp, ServiceTime)> {
    let mut simulation = Simulation::new(testbed, 1).unwrap();
    let (mut samples, mut seconds) = (Vec::new(), 0);
    while simulation.step().as_secs_f64() < 60.0 {
        while let Some(Stamped { at, event }) = simulation.poll_event() {
            if let Event::ServiceTime(sample) = event
                && sample.service.as_str() == "localization"
            {
                samples.push((at, sample));
            }
        }
        let second = simulation.now().as_secs_f64() as u64;
        if second > seconds {
            seconds = second;
            each(&mut simulation, second);
        }
    }
    let end = simulation.now();
    let numbers: BTreeSet<_> = samples.iter().map(|(_, sample)| sample.sequence).collect();
    assert_eq!(numbers.len(), samples.len(), "none has two");
    let next = (0..).find(|number| !numbers.contains(number)).unwrap();
    for (_, later) in samples.iter().filter(|(_, sample)| sample.sequence > next) {
        assert!(later.emitted + PATIENCE > end, "scan {next} has no sample, but {} has", later.sequence);
    }
    for (at, sample) in &samples {
        match (sample.took, &sample.parts) {
            (Some(took), Some(parts)) => {
                assert_eq!((sample.emitted + took, parts.total()), (*at, took));
                assert_eq!(parts.links.len(), 4, "air and wire, there and back: {parts:?}");
                assert!(parts.unknown < took / 100, "{parts:?}");
            }
            (None, None) => assert_eq!(sample.emitted + PATIENCE, *at),
            _ => panic!("{sample:?}"),
        }
    }
    samples
}

/// Returns the number of unanswered samples.
fn unanswered(samples: &[(Timestamp, ServiceTime)]) -> usize {
    samples.iter().filter(|(_, sample)| sample.took.is_none()).count()
}

#[test]
fn each_scan_has_a_service_time_that_its_parts_add_up_to() {
    let samples = samples(corridor(), |_, _| {});
    assert!(samples.len() > 50 && unanswered(&samples) == 0, "{} samples", samples.len());
    for (_, sample) in &samples {
        assert_eq!((sample.robot.as_str(), sample.server.as_str()), ("robot", "edge"));
        assert!(["R1", "R3"].map(Some).contains(&sample.attachment.as_ref().map(NodeId::as_str)));
        // 1 ms over the air and 2 ms over the wire, there and back.
        assert!(sample.took > Some(Duration::from_millis(6)), "{sample:?}");
    }
}

#[test]
fn each_scan_has_one_service_time_wherever_localization_moves() {
    let mut nodes = ["fog", "cloud", "edge"].into_iter().cycle();
    let samples = samples(corridor(), |simulation, _| place(simulation, nodes.next().unwrap()));
    assert!(samples.len() > 50 && unanswered(&samples) == 0, "{} samples", samples.len());
    let servers: BTreeSet<_> = samples.iter().map(|(_, sample)| sample.server.as_str()).collect();
    assert_eq!(servers, ["cloud", "edge", "fog"].into());
}

#[test]
fn each_scan_has_one_service_time_of_the_first_instance_that_answers() {
    let all = |text: String| {
        text.replace("localization, node: edge", "localization, node: [edge, fog]")
            .replace("  localization:\n", "  localization:\n    requests: all\n")
    };
    let samples = samples(changed(all), |simulation, second| {
        if second == 10 {
            condition(simulation, &lose(1.0));
        }
    });
    assert!(samples.len() > 50 && unanswered(&samples) == 0, "{} samples", samples.len());
    let first = samples.iter().filter(|(_, sample)| sample.emitted.as_secs_f64() > 10.0);
    assert!(first.clone().count() > 40 && first.clone().all(|(_, sample)| sample.server == "fog"));
}

#[test]
fn scans_without_an_answer_in_time_are_unanswered() {
    let lost = samples(corridor(), |simulation, second| {
        if second == 1 {
            condition(simulation, &lose(0.2));
        }
    });
    // 36 % of the scans or their answers are lost.
    assert!((10..40).contains(&unanswered(&lost)), "{} of {}", unanswered(&lost), lost.len());

    // Three scans are under way at a time. Then all answers are late.
    let slow = |delay_ms| ConditionChange { delay_ms: Some(delay_ms), ..ConditionChange::default() };
    let late = samples(corridor(), |simulation, second| match second {
        5 => condition(simulation, &slow(1000.0)),
        30 => condition(simulation, &slow(1600.0)),
        _ => {}
    });
    let between = |from: f64, to: f64| {
        let its = late.iter().filter(move |(_, sample)| (from..to).contains(&sample.emitted.as_secs_f64()));
        its.map(|(_, sample)| sample.took).collect::<Vec<_>>()
    };
    let [slow, slower] = [between(6.0, 28.0), between(31.0, 60.0)];
    assert!(slow.len() > 10 && slow.iter().all(|took| *took > Some(Duration::from_secs(2))), "{slow:?}");
    assert!(slower.len() > 10 && slower.iter().all(Option::is_none), "{slower:?}");
}

/// Returns localization's nodes and errors over the first minute, in which it moves to each of these nodes in turn.
fn localized_on(testbed: Arc<Testbed>, nodes: &[&str]) -> (Vec<String>, Errors) {
    let mut simulation = Simulation::new(testbed, 1).unwrap();
    let mut moves = nodes.iter().enumerate();
    let mut next = 10.0;
    let mut served = Vec::new();
    while simulation.step().as_secs_f64() < 60.0 {
        while let Some(event) = simulation.poll_event() {
            match event.event {
                Event::Placement(placement) if placement.vnf.as_str() == "localization" => {
                    served.push(placement.node.to_string());
                }
                Event::Robot(context) => {
                    assert_eq!(context.sensors.pose.source, PoseSource::Localization);
                    assert!(context.sensors.pose.covariance[0] < 0.1, "{:?}", context.sensors.pose);
                }
                _ => {}
            }
        }
        if simulation.now().as_secs_f64() > next
            && let Some((_, node)) = moves.next()
        {
            next += 10.0;
            place(&mut simulation, node);
        }
    }
    let (_, errors) = simulation.localization_errors().next().unwrap();
    (served, errors.clone())
}

#[test]
fn localization_moves_between_nodes_and_never_loses_the_robot() {
    let (stayed, there) = localized_on(corridor(), &[]);
    let (served, errors) = localized_on(corridor(), &["fog", "robot", "cloud", "edge"]);
    assert_eq!(stayed, ["edge"]);
    assert_eq!(served, ["edge", "fog", "robot", "cloud", "edge"]);
    for errors in [there, errors] {
        assert!(errors.len() > 550);
        assert!(errors.position_rmse() < 0.1 && errors.farthest() < 0.3, "{errors}");
        assert!((0.3..6.0).contains(&errors.mean_nees()), "{errors}");
    }
}

#[test]
fn a_localization_that_takes_its_state_along_goes_on_as_if_it_had_not_moved() {
    let errors = |state: &str, nodes: &[&str]| {
        // The fog is as far as the edge.
        let testbed = changed(|text| {
            text.replace("fog], delay: 1.5 ms, rate: 6 Mbit/s", "fog], delay: 2 ms, rate: 8 Mbit/s")
                .replace("localization, node: edge,", &format!("localization, node: edge, {state}"))
        });
        let (served, errors) = localized_on(testbed, nodes);
        assert_eq!(served.len(), 1 + nodes.len());
        errors.position_rmse()
    };
    let stayed = errors("", &[]);
    assert_eq!(errors("state: { size: 1 kB },", &["fog", "edge"]), stayed);
    assert_ne!(errors("", &["fog", "edge"]), stayed, "another instance knows less");
}

#[test]
fn an_unlocalized_robot_becomes_less_certain_and_is_found_again() {
    let mut testbed = Testbed::clone(&corridor());
    // Nothing crosses this link until it is repaired.
    let cut = |loss| Instruction::Condition {
        link: "R1-edge".parse().unwrap(),
        direction: None,
        change: lose(loss),
    };
    testbed.plugins.clear();
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    let spread = |pose: &cotorra_graph::Pose| (pose.covariance[0] + pose.covariance[4]).sqrt();
    let mut spreads = Vec::new();
    let mut conditions = [(5.0, 1.0), (25.0, 0.0)].into_iter().peekable();
    while simulation.step().as_secs_f64() < 32.0 {
        while let Some(Stamped { at, event }) = simulation.poll_event() {
            if let Event::Robot(context) = event {
                spreads.push((at.as_secs_f64(), spread(&context.sensors.pose)));
            }
        }
        let now = simulation.now().as_secs_f64();
        if let Some((_, loss)) = conditions.next_if(|(at, _)| *at <= now) {
            instruct(&mut simulation, cut(loss));
        }
    }
    let at = |time: f64| spreads.iter().find(|(at, _)| *at >= time).unwrap().1;
    assert!(at(24.9) > 2.0 * at(4.9), "{} m after {} m", at(24.9), at(4.9));
    assert!(at(28.0) < 1.5 * at(4.9), "{} m after {} m", at(28.0), at(24.9));
    let (_, errors) = simulation.localization_errors().next().unwrap();
    assert!(errors.farthest() < 0.5 && errors.mean_nees() < 9.0, "{errors}");
}
