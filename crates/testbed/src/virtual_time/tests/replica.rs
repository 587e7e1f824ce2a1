//! VNFs with several instances: where requests go, who answers, and what changes as instances come and go.

use std::path::Path;

use cotorra_graph::{
    AnswersRejected, ConditionChange, Event, Instruction, LinkId, Loss, Nodes, Probability, ServiceTime,
};

use crate::virtual_time::*;

/// Interval between position packets.
const INTERVAL: Duration = Duration::from_millis(50);

/// The corridor without plug-ins, with navigation on these nodes.
fn corridor(nodes: &str, requests: &str) -> Arc<Testbed> {
    changed(nodes, requests, |text| text)
}

fn changed(nodes: &str, requests: &str, change: impl FnOnce(String) -> String) -> Arc<Testbed> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let text = std::fs::read_to_string(&file).unwrap();
    let (text, _) = text.split_once("\nplugins:").unwrap();
    let text = text.replace("navigation, node: cloud", &format!("navigation, node: [{nodes}]"));
    let text = text.replace("  navigation:\n", &format!("  navigation:\n    requests: {requests}\n"));
    let text = change(text);
    let parsed = cotorra_testbed_file::parse("corridor.yaml", &text, file.parent().unwrap());
    Arc::new(parsed.unwrap_or_else(|wrong| panic!("{wrong}")))
}

fn navigation() -> cotorra_graph::VnfId {
    "navigation".parse().unwrap()
}

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

fn instruct(simulation: &mut Simulation, instruction: Instruction) {
    simulation.instruct(Given::new("test".parse().unwrap(), instruction)).unwrap();
}

fn place(simulation: &mut Simulation, nodes: &[&str]) {
    let nodes = Nodes::new(nodes.iter().map(|name| node(name)).collect()).unwrap();
    instruct(simulation, Instruction::Place { vnf: navigation(), node: nodes });
}

/// Makes both directions of a link lose this share of packets.
fn lose(simulation: &mut Simulation, link: &str, share: f64) {
    let loss = Some(Loss::Independent { rate: Probability::new(share).unwrap() });
    let change = ConditionChange { loss, ..ConditionChange::default() };
    instruct(
        simulation,
        Instruction::Condition { link: LinkId::new(link).unwrap(), direction: None, change },
    );
}

/// The outputs of a run: service times of navigation, and the number of answers that the robot rejected.
#[derive(Default)]
struct Outcome {
    samples: Vec<ServiceTime>,
    rejected: Option<AnswersRejected>,
}

impl Outcome {
    fn poll(&mut self, simulation: &mut Simulation) {
        while let Some(stamped) = simulation.poll_event() {
            match stamped.event {
                Event::ServiceTime(sample) if sample.service.as_str() == "navigation" => {
                    self.samples.push(sample);
                }
                Event::AnswersRejected(counts) => self.rejected = Some(counts),
                _ => {}
            }
        }
    }

    /// Returns the number of samples not answered within the target of 15 ms.
    fn late(&self) -> usize {
        let late = |sample: &&ServiceTime| sample.took.is_none_or(|took| took > Duration::from_millis(15));
        self.samples.iter().filter(late).count()
    }

    fn median(&self) -> Duration {
        let mut took: Vec<_> = self.samples.iter().filter_map(|sample| sample.took).collect();
        took.sort_unstable();
        took[took.len() / 2]
    }

    /// Returns the answering nodes in order, without repetitions.
    fn servers(&self) -> Vec<&str> {
        let mut servers: Vec<_> = self.samples.iter().map(|sample| sample.server.as_str()).collect();
        servers.dedup();
        servers
    }
}

/// Simulates 40 s in which the links between the robot and the edge lose packets.
fn lossy(nodes: &str, requests: &str, share: f64) -> Outcome {
    let mut simulation = Simulation::new(corridor(nodes, requests), 1).unwrap();
    let mut outcome = Outcome::default();
    simulation.step();
    ["R1-edge", "R3-edge"].iter().for_each(|link| lose(&mut simulation, link, share));
    while simulation.step().as_secs_f64() < 40.0 {
        outcome.poll(&mut simulation);
    }
    outcome
}

#[test]
fn with_all_every_instance_is_asked_and_the_first_answer_counts() {
    let [edge, fog] = ["edge", "fog"].map(|node| lossy(node, "one", 0.0));
    let one = lossy("edge, fog", "one", 0.1);
    let all = lossy("edge, fog", "all", 0.1);
    assert!(all.samples.len() > 700, "{} samples", all.samples.len());
    assert_eq!(one.servers(), ["edge"]);
    // 19 % of the packets or answers over the edge are lost.
    assert!(one.late() > one.samples.len() / 10, "{} late", one.late());
    assert!(all.late() <= 2, "{} late", all.late());
    let by_fog = all.samples.iter().filter(|sample| sample.server == "fog").count();
    assert!(by_fog > all.samples.len() * 9 / 10, "fog is faster, though the edge is preferred: {by_fog}");
    // The best of both, except for the second copy's airtime.
    let best = edge.median().min(fog.median());
    assert!(all.median() < best + Duration::from_millis(1), "{:?} beside {best:?}", all.median());
    // Each sample counts once, and a later answer counts neither as forged nor as repeated.
    assert!(all.samples.iter().zip(0..).all(|(sample, number)| sample.sequence == number));
    let rejected = all.rejected.unwrap();
    assert!(rejected.redundant > 500, "{rejected:?}");
    assert_eq!(AnswersRejected { redundant: 0, ..rejected }, AnswersRejected::none(node("robot")));
    assert_eq!(one.rejected, None);
}

#[test]
fn a_packet_without_any_answer_is_unanswered_once() {
    let mut simulation = Simulation::new(corridor("edge, fog", "all"), 1).unwrap();
    let mut outcome = Outcome::default();
    let mut cut = false;
    while simulation.step().as_secs_f64() < 6.0 {
        outcome.poll(&mut simulation);
        if !cut && simulation.now().as_secs_f64() > 3.0 {
            cut = true;
            ["R1-edge", "R1-fog"].iter().for_each(|link| lose(&mut simulation, link, 1.0));
        }
    }
    assert!(outcome.samples.iter().zip(0..).all(|(sample, number)| sample.sequence == number));
    let unanswered: Vec<_> = outcome.samples.iter().filter(|sample| sample.took.is_none()).collect();
    assert!(unanswered.len() > 40, "{}", unanswered.len());
    assert!(unanswered.iter().all(|sample| sample.emitted.as_secs_f64() > 2.9 && sample.server == "edge"));
}

#[test]
fn after_the_first_instance_dies_the_next_packet_goes_to_another() {
    let mut simulation = Simulation::new(corridor("edge, fog", "one"), 1).unwrap();
    let mut outcome = Outcome::default();
    // It is restarted after 0.1 s, 0.2 s, …, and killed again as soon as it serves.
    let mut killed = 0;
    while simulation.step().as_secs_f64() < 20.0 {
        outcome.poll(&mut simulation);
        // Two instances of navigation, and one of localization.
        let serves = simulation.serving().running().len() == 3;
        if simulation.now().as_secs_f64() > 5.0 && killed < 6 && serves {
            killed += 1;
            simulation.serving().kill_on(&navigation(), &node("edge"));
        }
    }
    assert_eq!(killed, 6);
    // Each kill may lose the one packet that is under way.
    let answered: Vec<_> = outcome.samples.iter().filter(|sample| sample.took.is_some()).collect();
    let gaps = answered.windows(2).map(|pair| pair[1].emitted.since(pair[0].emitted));
    assert!(gaps.max().unwrap() <= 2 * INTERVAL);
    assert!(
        outcome.samples.len() - answered.len() <= killed,
        "{} of them",
        outcome.samples.len() - answered.len()
    );
    let by_fog = outcome.samples.iter().filter(|sample| sample.server == "fog").count();
    // 6.3 s in all.
    assert!((110..140).contains(&by_fog), "{by_fog}");
    assert_eq!((outcome.servers()[0], *outcome.servers().last().unwrap()), ("edge", "edge"));

    // A single instance leaves the robot waiting for its restart.
    let mut alone = Simulation::new(corridor("edge", "one"), 1).unwrap();
    let (mut outcome, mut killed) = (Outcome::default(), false);
    while alone.step().as_secs_f64() < 8.0 {
        outcome.poll(&mut alone);
        if !std::mem::replace(&mut killed, alone.now().as_secs_f64() > 5.0) && killed {
            alone.serving().hold_starts(true);
            alone.serving().kill_on(&navigation(), &node("edge"));
        }
    }
    assert!(outcome.samples.iter().any(|sample| sample.took.is_none()));
}

#[test]
fn nearest_follows_the_robot_and_the_conditions_of_links() {
    // Fog is nearest at R1, R3 and R5, edge at R2 and R4, and the cloud nowhere.
    let roams = |text: String| text.replace("roaming: instructed", "roaming: signal");
    let testbed = changed("cloud, edge, fog", "nearest", roams);
    let mut simulation = Simulation::new(testbed, 1).unwrap();
    let mut outcome = Outcome::default();
    while simulation.step().as_secs_f64() < 200.0 {
        outcome.poll(&mut simulation);
    }
    let mut visited: Vec<_> = outcome
        .samples
        .iter()
        .filter_map(|sample| Some((sample.attachment.as_ref()?.as_str(), sample.server.as_str())))
        .collect();
    let all = visited.len();
    let nearest = |(unit, server): &(&str, &str)| match *unit {
        "R1" | "R3" | "R5" | "R6" => *server == "fog",
        _ => *server == "edge",
    };
    let kept = visited.iter().filter(|pair| nearest(pair)).count();
    assert!(kept + 10 >= all, "{kept} of {all}");
    visited.dedup();
    assert!(visited.len() >= 5, "{visited:?}");

    // One link becomes slow, then another is cut: requests go elsewhere within two collections of κ.
    let mut simulation = Simulation::new(corridor("cloud, edge, fog", "nearest"), 1).unwrap();
    let (mut outcome, mut changes) = (Outcome::default(), 0);
    while simulation.step().as_secs_f64() < 9.0 {
        outcome.poll(&mut simulation);
        if changes == 0 && simulation.now().as_secs_f64() > 3.0 {
            changes = 1;
            let change = ConditionChange { delay_ms: Some(3.0), ..ConditionChange::default() };
            let link = LinkId::new("R1-fog").unwrap();
            instruct(&mut simulation, Instruction::Condition { link, direction: None, change });
        }
        if changes == 1 && simulation.now().as_secs_f64() > 6.0 {
            changes = 2;
            lose(&mut simulation, "R1-edge", 1.0);
        }
    }
    let at = |seconds: f64| {
        let emitted = |sample: &&ServiceTime| sample.emitted.as_secs_f64() > seconds;
        outcome.samples.iter().find(emitted).unwrap().server.as_str()
    };
    assert_eq!([at(2.5), at(3.2), at(6.2)], ["fog", "edge", "fog"]);
    let lost = outcome.samples.iter().filter(|sample| sample.took.is_none()).count();
    assert!(lost <= 3, "{lost}");
}

#[test]
fn every_position_packet_is_answered_while_instances_come_and_go() {
    for requests in ["one", "nearest", "all"] {
        let mut simulation = Simulation::new(corridor("cloud", requests), 1).unwrap();
        let all: [&[&str]; 6] = [
            &["edge", "fog"],
            &["fog"],
            &["cloud", "edge", "fog"],
            &["edge", "cloud"],
            &["fog", "edge"],
            &["cloud"],
        ];
        let mut moves = (0..96_u16)
            .map(|i| (Timestamp::from_secs_f64(1.0 + 0.1525 * f64::from(i)), all[usize::from(i % 6)]));
        let mut next = moves.next();
        let mut outcome = Outcome::default();
        while next.is_some() || simulation.now().as_secs_f64() < 18.0 {
            simulation.set_alarm(next.map(|(at, _)| at));
            let now = simulation.step();
            outcome.poll(&mut simulation);
            if let Some((_, nodes)) = next.filter(|(at, _)| *at <= now) {
                place(&mut simulation, nodes);
                next = moves.next();
            }
        }
        assert!(outcome.samples.len() > 330, "{} samples", outcome.samples.len());
        let unanswered = outcome.samples.iter().filter(|sample| sample.took.is_none()).count();
        assert_eq!(unanswered, 0, "{requests}");
        assert!(outcome.servers().len() > 20, "{requests}: {:?}", outcome.servers());
        assert_eq!(simulation.serving().running().len(), 2, "navigation and localization, once each");
    }
}

#[test]
fn localization_by_several_instances_never_loses_the_robot() {
    let localized = |text: String| {
        text.replace("localization, node: edge", "localization, node: [edge, fog]")
            .replace("  localization:\n", "  localization:\n    requests: all\n")
    };
    let mut simulation = Simulation::new(changed("cloud", "one", localized), 1).unwrap();
    let mut outcome = Outcome::default();
    let mut killed = false;
    while simulation.step().as_secs_f64() < 60.0 {
        outcome.poll(&mut simulation);
        if !killed && simulation.now().as_secs_f64() > 20.0 {
            killed = true;
            simulation.serving().kill_on(&"localization".parse().unwrap(), &node("edge"));
        }
    }
    let (_, errors) = simulation.localization_errors().next().unwrap();
    assert!(errors.len() > 550);
    assert!(errors.position_rmse() < 0.1 && errors.farthest() < 0.3, "{errors}");
    let rejected = outcome.rejected.unwrap();
    assert!(rejected.redundant > 30, "{rejected:?}");
    assert_eq!(AnswersRejected { redundant: 0, ..rejected }, AnswersRejected::none(node("robot")));
}

#[test]
fn virtual_links_are_reported_between_each_pair_of_instances() {
    let mut simulation = Simulation::new(corridor("edge, fog", "all"), 1).unwrap();
    let mut last = None;
    let mut note = |simulation: &mut Simulation, until: f64| {
        while simulation.step().as_secs_f64() < until {
            while let Some(stamped) = simulation.poll_event() {
                if let Event::VirtualLink(mapping) = stamped.event
                    && mapping.to == navigation()
                {
                    last = Some(mapping);
                }
            }
        }
        let mapping = last.clone().unwrap();
        let others: Vec<_> = mapping.others.iter().map(|other| other.to.to_string()).collect();
        (mapping.links.last().unwrap().to_string(), others)
    };
    assert_eq!(note(&mut simulation, 3.0), ("R1-edge".to_owned(), vec!["fog".to_owned()]));
    place(&mut simulation, &["fog"]);
    assert_eq!(note(&mut simulation, 6.0), ("R1-fog".to_owned(), vec![]));
}
