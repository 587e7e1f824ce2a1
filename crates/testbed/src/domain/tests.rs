use std::path::Path;

use cotorra_graph::{
    Attachment, ConditionChange, Dbm, LinkTime, LostCause, Pose, PoseSource, ServiceTime, TimeParts,
    Timestamp, Velocity, Vnf,
};
use cotorra_graph_testing as base;

use super::*;

const TESTBED: &str = "
name: two-domains
domains: [one, two]
wireless: { lab: {} }
nodes:
  r1: { kind: robot }
  r2: { kind: robot, domain: two }
  A: { kind: radio_unit, position: [0, 1], channel: 1 }
  B: { kind: radio_unit, domain: two, position: [9, 1], channel: 6 }
  s1: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
  s2: { kind: server, domain: two, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [A, s1] }
  - { ends: [B, s2] }
  - { ends: [A, B] }
services:
  n1:
    robot: r1
    kpis: { service_time: 15 ms }
    vnfs: { d1: { program: robot_driver, pinned_to: r1 }, nav1: { program: navigation, node: s1 } }
  n2:
    robot: r2
    kpis: { service_time: 15 ms }
    vnfs: { d2: { program: robot_driver, pinned_to: r2 }, nav2: { program: navigation, node: s2 } }
walks:
  r1: { waypoints: [[0, 0], [5, 0]] }
  r2: { waypoints: [[9, 0], [5, 0]] }
plugins:
  - { bundled: okpi, domain: one }
  - { bundled: probing, domain: two }
";

fn testbed() -> Testbed {
    cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e:?}"))
}

fn views() -> [Arc<DomainView>; 2] {
    let domains = Domains::new(&testbed());
    ["one", "two"].map(|name| Arc::clone(domains.view(&name.parse().unwrap()).unwrap()))
}

fn id<T: std::str::FromStr<Err: std::fmt::Debug>>(name: &str) -> T {
    name.parse().unwrap()
}

fn stamped(event: Event) -> Stamped {
    Stamped { at: Timestamp::ZERO, event }
}

/// Returns an event as each of the two domains sees it.
fn seen_by_domains(event: Event) -> [Option<Event>; 2] {
    let stamped = stamped(event);
    views().map(|view| view.event(&stamped).map(|seen| seen.into_owned().event))
}

#[test]
fn a_domain_sees_its_own_part_of_the_testbed() {
    let [one, _] = views();
    let names: Vec<_> = one.testbed().graph.nodes.iter().map(|node| node.id.to_string()).collect();
    assert_eq!(names, ["r1", "A", "s1"]);
    let links: Vec<_> = one.testbed().graph.links.iter().map(|link| link.id.to_string()).collect();
    assert_eq!(links, ["A-s1"], "a link to another domain is not its own");
    let plugins: Vec<_> = one.testbed().plugins.iter().map(|plugin| plugin.id.to_string()).collect();
    assert_eq!((one.testbed().services.len(), plugins), (1, vec!["okpi".to_owned()]));
}

fn machine(node: &str) -> cotorra_graph::MachineContext {
    cotorra_graph::MachineContext { node: id(node), ..base::machine_context("machine") }
}

#[test]
fn events_of_other_domains_are_not_seen() {
    let sample =
        ServiceTime { service: id("n1"), robot: id("r1"), ..base::service_time("s1", Timestamp::ZERO, None) };
    for event in [
        Event::ServiceTime(sample),
        Event::Scanned { robot: id("r1") },
        Event::SuggestionAnswered { robot: id("r1"), radio_unit: id("B"), status: 0 },
        Event::FederationRequested { robot: id("r1") },
        Event::WalkFinished { robot: id("r1") },
        Event::Goal(cotorra_graph::GoalEvent {
            robot: id("r1"),
            goal: Default::default(),
            state: cotorra_graph::GoalState::Set,
            remaining_m: None,
            reason: None,
        }),
        Event::Sensor(cotorra_graph::SensorReading {
            robot: id("r1"),
            sensor: id("imu"),
            measured: Timestamp::ZERO,
            values: Default::default(),
            data: None,
        }),
        Event::Machine(machine("s1")),
        Event::Placement(cotorra_graph::Placement { vnf: id("nav1"), node: id::<NodeId>("s1").into() }),
        Event::PluginFault { plugin: id("okpi"), reason: String::new() },
        Event::Detached { robot: id("r1"), from: id("A") },
        decision("api", Instruction::Scan { robot: id("r1") }),
        decision("okpi", Instruction::Note { process: "p".into(), step: "s".into(), ago: None }),
    ] {
        assert_eq!(seen_by_domains(event.clone()), [Some(event), None]);
    }
    let message = String::from("r2 stands still");
    assert_eq!(seen_by_domains(Event::Notice { message }), [None, None], "whose it is cannot be known");
}

#[test]
fn the_time_on_links_of_others_is_unknown_to_a_domain() {
    let ms = std::time::Duration::from_millis;
    let on = |link: &str| LinkTime {
        link: id(link),
        direction: cotorra_graph::Direction::Forward,
        back: false,
        queueing: ms(1),
        retries: ms(0),
        crossing: ms(4),
    };
    let parts = TimeParts { unknown: ms(1), links: vec![on("A-s1"), on("B-s2")], ..TimeParts::default() };
    let took = Some(parts.total());
    let sample = |parts| {
        Event::ServiceTime(ServiceTime {
            service: id("n1"),
            robot: id("r1"),
            parts: Some(Box::new(parts)),
            ..base::service_time("s1", Timestamp::ZERO, took)
        })
    };
    let own = TimeParts { unknown: ms(6), links: vec![on("A-s1")], ..TimeParts::default() };
    assert_eq!(seen_by_domains(sample(parts)), [Some(sample(own)), None]);
}

#[test]
fn what_links_of_others_lost_is_unknown_to_a_domain() {
    let lost = |link: Option<&str>| {
        let at = |link| LostAt { link: Some(id(link)), back: true, cause: LostCause::Loss };
        Event::ServiceTime(ServiceTime {
            service: id("n1"),
            robot: id("r1"),
            lost_at: link.map(at).map(Box::new),
            ..base::service_time("s1", Timestamp::ZERO, None)
        })
    };
    assert_eq!(seen_by_domains(lost(Some("A-s1"))), [Some(lost(Some("A-s1"))), None]);
    assert_eq!(seen_by_domains(lost(Some("B-s2"))), [Some(lost(None)), None]);
}

#[test]
fn a_domain_sees_the_instances_of_anothers_vnf_on_its_nodes() {
    let placement = |nodes: &[&str]| {
        let node = Nodes::new(nodes.iter().map(|name| id(name)).collect()).unwrap();
        Event::Placement(Placement { vnf: id("nav1"), node })
    };
    let both = placement(&["s2", "s1"]);
    assert_eq!(seen_by_domains(both.clone()), [Some(both), Some(placement(&["s2"]))]);
}

fn decision(plugin: &str, instruction: Instruction) -> Event {
    Event::Decision(Decision { plugin: id(plugin), instruction, reason: None, refused: None })
}

#[test]
fn a_robots_context_has_the_other_domains_radio_units_that_it_hears() {
    let pose = Pose::planar(0.0, 0.0, 0.0, [0.0; 9], PoseSource::Simulator);
    let attachment = |radio_unit: &str, attached, signal: Option<f64>| Attachment {
        radio_unit: id(radio_unit),
        attached,
        signal: signal.map(Dbm),
        age: None,
    };
    let context = |attachments| RobotContext { attachments, ..base::robot_context("r1", pose) };
    let [one, two] = seen_by_domains(Event::Robot(context(vec![
        attachment("A", true, Some(-50.0)),
        attachment("B", false, None),
    ])));
    assert_eq!((one, two), (Some(Event::Robot(context(vec![attachment("A", true, Some(-50.0))]))), None));
    let both = context(vec![attachment("A", false, None), attachment("B", true, Some(-60.0))]);
    assert_eq!(seen_by_domains(Event::Robot(both.clone()))[0], Some(Event::Robot(both)));
}

#[test]
fn a_visiting_robot_arrives_and_departs() {
    let handover = |from: Option<&str>, to: &str| {
        Event::Handover(Handover {
            robot: id("r1"),
            from: from.map(id),
            to: id(to),
            fast: true,
            gap: std::time::Duration::ZERO,
        })
    };
    assert_eq!(
        seen_by_domains(handover(Some("A"), "B")),
        [Some(handover(Some("A"), "B")), Some(handover(None, "B"))],
        "where it came from is its domain's business"
    );
    let left = Event::Detached { robot: id("r1"), from: id("B") };
    assert_eq!(seen_by_domains(handover(Some("B"), "A")), [Some(handover(Some("B"), "A")), Some(left)]);
}

#[test]
fn a_domain_changes_its_own_nodes_and_no_others() {
    let access_point = AccessPoint { ssid: "lab".into(), mobility_domain: 1, key: None, core: None };
    let of = |n: &str, radio_unit: &str, link: &str| {
        let robot = || id::<NodeId>(&format!("r{n}"));
        let deployed = access_point.clone();
        [
            Instruction::Move { robot: robot(), velocity: Velocity::default(), waypoint: 0 },
            Instruction::LimitSpeed { robot: robot(), speed_limit_mps: Some(0.1) },
            Instruction::NavigateTo { robot: robot(), goal: None },
            Instruction::Report { robot: robot(), sensor: id("gripper"), values: Vec::new() },
            Instruction::Scan { robot: robot() },
            Instruction::Halt { robot: robot() },
            Instruction::Go { robot: robot() },
            Instruction::Attach { robot: robot(), radio_unit: id("B") },
            Instruction::Suggest { robot: robot(), radio_unit: id("B") },
            Instruction::Provision { robot: robot(), radio_unit: id("B"), access_point: deployed.clone() },
            Instruction::Deploy { radio_unit: id(radio_unit), access_point: deployed },
            Instruction::Remove { radio_unit: id(radio_unit) },
            Instruction::Place { vnf: id(&format!("nav{n}")), node: id::<NodeId>(&format!("s{n}")).into() },
            Instruction::Map {
                from: robot(),
                to: id(&format!("s{n}")),
                links: vec![id(link)],
                reservation: None,
            },
            Instruction::Condition { link: id(link), direction: None, change: ConditionChange::default() },
        ]
    };
    let [one, two] = views();
    for (own, other) in of("1", "A", "A-s1").into_iter().zip(of("2", "B", "B-s2")) {
        assert_eq!((one.check(&own, |_| None), two.check(&other, |_| None)), (Ok(()), Ok(())));
        for (view, instruction) in [(&one, other), (&two, own)] {
            let refused = view.check(&instruction, |_| None).unwrap_err().to_string();
            assert!(refused.contains(&format!("is not of the domain `{}`", view.domain())), "{refused}");
        }
    }
    // Added VNFs belong to the domain of their nodes.
    let on = |nodes: &[&str]| Nodes::new(nodes.iter().map(|name| id(name)).collect()).unwrap();
    let add = |nodes| {
        let vnf = testbed().services[0].vnfs[1].clone();
        Instruction::AddVnf { vnf: Box::new(Vnf { node: on(nodes), ..vnf }) }
    };
    let none = |_: &VnfId| None;
    assert_eq!((one.check(&add(&["s1"]), none), two.check(&add(&["s2"]), none)), (Ok(()), Ok(())));
    one.check(&add(&["s1", "s2"]), none).unwrap_err();
    let place = Instruction::Place { vnf: id("new"), node: on(&["s1"]) };
    for instruction in [Instruction::RemoveVnf { vnf: id("new") }, place] {
        let check = |view: &DomainView, nodes: &'static [&str]| {
            view.check(&instruction, |_| Some(on(nodes).all().to_vec())).is_ok()
        };
        assert!(check(&one, &["s1"]) && !check(&two, &["s1"]) && !check(&one, &["s1", "s2"]));
        assert!(one.check(&instruction, none).is_err(), "it is not there");
    }
    // Between two domains, and to a node of the other domain.
    for instruction in [
        Instruction::Condition { link: id("A-B"), direction: None, change: ConditionChange::default() },
        Instruction::Condition { link: id("r1~B"), direction: None, change: ConditionChange::default() },
        Instruction::Place { vnf: id("nav1"), node: id::<NodeId>("s2").into() },
        Instruction::Place { vnf: id("nav1"), node: Nodes::new(vec![id("s1"), id("s2")]).unwrap() },
        Instruction::Map { from: id("r1"), to: id("s2"), links: Vec::new(), reservation: None },
        Instruction::Map {
            from: id("r1"),
            to: id("s1"),
            links: vec![id("r1~A"), id("A-B")],
            reservation: None,
        },
    ] {
        one.check(&instruction, |_| None).unwrap_err();
    }
    assert!(one.sees_link(&id("A-B")) && one.sees_link(&id("r1~B")) && !one.sees_link(&id("B-s2")));
}

#[test]
fn a_domain_sees_its_own_part_of_a_state_and_its_own_figures() {
    fn at_zero<T>(value: T) -> Sample<T> {
        Sample { at: Timestamp::ZERO, value }
    }
    let placement = |nodes: &[&str]| {
        let node = Nodes::new(nodes.iter().map(|name| id(name)).collect()).unwrap();
        at_zero(Placement { vnf: id("nav1"), node })
    };
    let state = GraphState {
        at: Timestamp::ZERO,
        robots: Vec::new(),
        radio_units: Vec::new(),
        links: Vec::new(),
        placements: vec![placement(&["s1", "s2"])],
        virtual_links: Vec::new(),
        sensors: Vec::new(),
        machines: ["s1", "s2"].map(machine).map(at_zero).to_vec(),
    };
    let [one, two] = views().map(|view| view.state(state.clone()));
    assert_eq!(
        (&one.placements[..], &two.placements[..]),
        (&state.placements[..], &[placement(&["s2"])][..])
    );
    assert_eq!((&one.machines[..], &two.machines[..]), (&state.machines[..1], &state.machines[1..]));

    for (figure, seen) in [
        ("service_time:n1", [true, false]),
        ("service_time::r1", [true, false]),
        ("service_time", [false, false]),
        ("delay:A-s1:backward", [true, false]),
        ("delay:A-B", [true, true]),
        ("x:r2", [false, true]),
        ("signal:r1:B", [true, false]),
        ("cpu:s2", [false, true]),
        ("handover_gap", [false, false]),
        ("time_part:A-s1", [false, false]),
    ] {
        let figure: Figure = figure.parse().unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(views().map(|view| view.sees_figure(&figure)), seen, "{figure}");
    }
}
