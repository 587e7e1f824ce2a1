//! VNFs that run in containers, and nodes that are containers: when they serve, and how long their answers take.

use std::path::Path;

use cotorra_graph::{Image, Kpis, Nodes, ServiceTime, Vnf, VnfEvent, VnfId, VnfState};
use cotorra_graph_testing as base;

use crate::virtual_time::*;

const START: Duration = Duration::from_millis(500);
const PROCESSING: Duration = Duration::from_millis(6);

/// The corridor without plug-ins.
fn corridor() -> Testbed {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let mut testbed = cotorra_testbed_file::load(file).unwrap();
    testbed.plugins.clear();
    testbed
}

fn image(start: Duration, processing: Duration) -> Option<Box<Image>> {
    Some(Box::new(Image { reference: "robot:1".to_owned(), start, processing, ..Image::default() }))
}

/// The corridor with navigation in containers.
fn in_containers(start: Duration, processing: Duration) -> Testbed {
    let mut testbed = corridor();
    let mut vnfs = testbed.services.iter_mut().flat_map(|service| &mut service.vnfs);
    vnfs.find(|vnf| vnf.program == Program::Navigation).unwrap().image = image(start, processing);
    testbed
}

/// A VNF of others that runs in containers on the edge.
fn others(name: &str, program: Program) -> Vnf {
    let node: NodeId = "edge".parse().unwrap();
    Vnf {
        id: name.parse().unwrap(),
        program,
        cpus: 0.1,
        memory_bytes: 1_000_000,
        pinned_to: Some(node.clone()),
        node: node.into(),
        image: image(START, Duration::ZERO),
        ..base::vnf("vnf", "server")
    }
}

fn ms(millis: u64) -> Timestamp {
    Timestamp::ZERO + Duration::from_millis(millis)
}

/// Runs up to this time, and returns the events.
fn run(simulation: &mut Simulation, until: Timestamp) -> Vec<Stamped> {
    let mut events = Vec::new();
    simulation.set_alarm(Some(until));
    while simulation.now() < until {
        simulation.step();
        events.extend(std::iter::from_fn(|| simulation.poll_event()));
    }
    simulation.set_alarm(None);
    events
}

/// Returns the states of a VNF's instances, with their nodes and times.
fn lives(events: &[Stamped], name: &str) -> Vec<(VnfState, NodeId, Timestamp)> {
    let life = |stamped: &Stamped| match &stamped.event {
        Event::Vnf(VnfEvent { vnf, node, state, .. }) if vnf.as_str() == name => {
            Some((*state, node.clone(), stamped.at))
        }
        _ => None,
    };
    events.iter().filter_map(life).collect()
}

/// Returns the samples of navigation.
fn samples(events: &[Stamped]) -> Vec<&ServiceTime> {
    let samples = events.iter().filter_map(|stamped| match &stamped.event {
        Event::ServiceTime(sample) => Some(sample),
        _ => None,
    });
    samples.filter(|sample| sample.service.as_str() == "navigation").collect()
}

fn place(simulation: &mut Simulation, vnf: &str, node: &str) {
    let node = Nodes::from(node.parse::<NodeId>().unwrap());
    let place = Instruction::Place { vnf: vnf.parse().unwrap(), node };
    simulation.instruct(Given::new("test".parse().unwrap(), place)).unwrap();
}

#[test]
fn a_container_serves_once_its_start_is_over() {
    let mut simulation = Simulation::new(Arc::new(in_containers(START, PROCESSING)), 1).unwrap();
    let events = run(&mut simulation, ms(2000));
    let cloud: NodeId = "cloud".parse().unwrap();
    assert_eq!(lives(&events, "navigation"), [(VnfState::Started, cloud.clone(), ms(500))]);
    // The walk waits for it.
    assert!(samples(&events).first().unwrap().emitted >= ms(500));
    simulation.serving().kill(&"navigation".parse().unwrap());
    let events = run(&mut simulation, ms(4000));
    let lives = lives(&events, "navigation");
    let [(VnfState::Died, _, died), (VnfState::Started, _, started)] = lives[..] else {
        panic!("{lives:?}");
    };
    // The delay of the first restart is 100 ms.
    assert_eq!(started, died + Duration::from_millis(600));
}

#[test]
fn answers_of_a_container_come_later_by_its_processing() {
    let medians = [Duration::ZERO, PROCESSING].map(|processing| {
        let mut simulation = Simulation::new(Arc::new(in_containers(START, processing)), 1).unwrap();
        let events = run(&mut simulation, ms(20_000));
        let mut took: Vec<_> = samples(&events).into_iter().filter_map(|sample| sample.took).collect();
        took.sort_unstable();
        assert!(took.len() > 100);
        took[took.len() / 2]
    });
    let later = medians[1] - medians[0];
    assert!(later.abs_diff(PROCESSING) < Duration::from_millis(1), "{later:?}");
}

#[test]
fn localization_in_a_container_answers_later_too() {
    let medians = [None, image(START, PROCESSING)].map(|image| {
        let mut testbed = corridor();
        let mut vnfs = testbed.services.iter_mut().flat_map(|service| &mut service.vnfs);
        vnfs.find(|vnf| vnf.program == Program::Localization).unwrap().image = image;
        let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
        let events = run(&mut simulation, ms(20_000));
        let took = events.iter().filter_map(|stamped| match &stamped.event {
            Event::ServiceTime(sample) if sample.service.as_str() == "localization" => sample.took,
            _ => None,
        });
        let mut took: Vec<_> = took.collect();
        took.sort_unstable();
        took[took.len() / 2]
    });
    let later = medians[1] - medians[0];
    assert!(later.abs_diff(PROCESSING) < Duration::from_millis(2), "{later:?}");
}

#[test]
fn the_old_container_serves_until_the_new_one_is_ready() {
    let mut simulation = Simulation::new(Arc::new(in_containers(START, PROCESSING)), 1).unwrap();
    let mut events = run(&mut simulation, ms(3000));
    place(&mut simulation, "navigation", "edge");
    events.extend(run(&mut simulation, ms(6000)));
    let [cloud, edge] = ["cloud", "edge"].map(|name| name.parse::<NodeId>().unwrap());
    assert_eq!(
        lives(&events, "navigation"),
        [
            (VnfState::Started, cloud.clone(), ms(500)),
            (VnfState::Started, edge.clone(), ms(3500)),
            // Packets may be under way to the old one for a second.
            (VnfState::Stopped, cloud.clone(), ms(4500)),
        ]
    );
    let samples = samples(&events);
    assert!(samples.len() > 90, "{}", samples.len());
    for (sample, number) in samples.iter().zip(0..) {
        assert_eq!(sample.sequence, number);
        assert!(sample.took.is_some(), "no answer to {sample:?}");
        let server = if sample.emitted < ms(3500) { &cloud } else { &edge };
        assert_eq!(sample.server, *server, "{sample:?}");
    }
}

#[test]
fn a_move_that_is_cancelled_during_the_start_leaves_the_old_container() {
    let mut simulation = Simulation::new(Arc::new(in_containers(START, PROCESSING)), 1).unwrap();
    let mut events = run(&mut simulation, ms(3000));
    place(&mut simulation, "navigation", "edge");
    events.extend(run(&mut simulation, ms(3400)));
    assert_eq!(simulation.serving().running().len(), 3);
    place(&mut simulation, "navigation", "cloud");
    assert_eq!(simulation.serving().running().len(), 2);
    events.extend(run(&mut simulation, ms(5000)));
    assert_eq!(lives(&events, "navigation").len(), 1);
    assert!(samples(&events).iter().all(|sample| sample.took.is_some() && sample.server == "cloud"));
}

#[test]
fn held_starts_end_no_earlier_than_the_start_of_the_image() {
    let mut simulation = Simulation::new(Arc::new(in_containers(START, PROCESSING)), 1).unwrap();
    simulation.serving().hold_starts(true);
    assert_eq!(lives(&run(&mut simulation, ms(200)), "navigation"), []);
    simulation.serving().hold_starts(false);
    let started =
        |events: &[Stamped]| lives(events, "navigation").iter().map(|(.., at)| *at).collect::<Vec<_>>();
    assert_eq!(started(&run(&mut simulation, ms(1000))), [ms(500)]);
    simulation.serving().hold_starts(true);
    place(&mut simulation, "navigation", "edge");
    assert_eq!(started(&run(&mut simulation, ms(3000))), []);
    simulation.serving().hold_starts(false);
    assert_eq!(started(&run(&mut simulation, ms(3100))).len(), 1);
}

#[test]
fn containers_of_others_become_ready_and_a_notice_names_them() {
    let mut testbed = corridor();
    let mut service = testbed.services[0].clone();
    service.id = "detection".parse().unwrap();
    service.vnfs = vec![others("detector", Program::Command(Vec::new()))];
    service.virtual_links.clear();
    service.kpis = Kpis { flow: None, ..service.kpis };
    testbed.services.push(service);
    testbed.containers.hosts.push(others("edge", Program::Host(Vec::new())));
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    let events = run(&mut simulation, ms(2000));
    let edge: NodeId = "edge".parse().unwrap();
    for name in ["detector", "edge"] {
        assert_eq!(lives(&events, name), [(VnfState::Started, edge.clone(), ms(500))]);
    }
    let notices: Vec<_> = events
        .iter()
        .filter_map(|stamped| match &stamped.event {
            Event::Notice { message } if message.contains("does not run") => Some(message.as_str()),
            _ => None,
        })
        .collect();
    let why = "does not run: in virtual time no program of others does";
    assert_eq!(notices, [format!("VNF detector {why}"), format!("The container of node edge {why}")]);
    let managed: Vec<VnfId> = simulation.managed().map(|managed| managed.vnf.id.clone()).collect();
    assert!(managed.iter().any(|vnf| vnf.as_str() == "edge"), "{managed:?}");
    assert!(!samples(&events).is_empty());
}

#[test]
fn the_same_seed_gives_the_same_events_with_containers() {
    let events = || {
        let mut simulation = Simulation::new(Arc::new(in_containers(START, PROCESSING)), 7).unwrap();
        let mut events = run(&mut simulation, ms(3000));
        place(&mut simulation, "navigation", "edge");
        events.extend(run(&mut simulation, ms(6000)));
        events
    };
    assert_eq!(events(), events());
}
