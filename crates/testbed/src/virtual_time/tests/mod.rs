mod added;
mod altered;
mod camera;
mod computing;
mod congestion;
mod container;
mod corridor_fleet;
mod corruption;
mod distance;
mod energy;
mod federation;
mod inference;
mod large_data;
mod localization;
mod migrations;
mod replica;
mod reservations;
mod sensor;
mod traffic;

use std::path::Path;

use cotorra_graph::{
    Cell, ConditionChange, Event, GoalEvent, GoalState, Instruction, InstructionLimit, LinkId, Loss, Nodes,
    OccupancyGrid, PoseSource, Position, Probability, Program, RobotContext, ServiceTime, Velocity,
};
use cotorra_plugin::{Actions, Plugin, client::ClientError};

use super::*;
use crate::{
    Finished, Options,
    clock::wall_clock,
    report::{End, Losses, Place, Report, Summary},
};

fn corridor() -> Arc<Testbed> {
    loaded("corridor.yaml")
}

fn loaded(name: &str) -> Arc<Testbed> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds").join(name);
    Arc::new(cotorra_testbed_file::load(file).unwrap())
}

/// Whether a sample is of navigation.
fn is_of_navigation(sample: &ServiceTime) -> bool {
    sample.service.as_str() == "navigation"
}

/// Returns the events of the first seconds.
fn events_of(testbed: &Arc<Testbed>, seed: u64, seconds: f64) -> Vec<Stamped> {
    let mut simulation = Simulation::new(Arc::clone(testbed), seed).unwrap();
    let mut events = Vec::new();
    while simulation.step().as_secs_f64() < seconds && !simulation.is_finished() {
        events.extend(std::iter::from_fn(|| simulation.poll_event()));
    }
    events
}

#[test]
fn the_whole_walk_has_the_published_regions_and_medians() {
    let testbed = corridor();
    let events = events_of(&testbed, 1, 500.0);
    let mut report = Report::new(&testbed, 1);
    for event in &events {
        report.absorb(event);
    }
    let end = events.last().unwrap().at;
    assert!((405.0..450.0).contains(&end.as_secs_f64()), "the walk took {end}");
    let summary = report.summary(end, "test", Losses::default());
    let regions: Vec<_> = summary
        .regions
        .iter()
        .filter(|region| region.samples > 20)
        .map(|region| (region.attachment.as_ref().unwrap().to_string(), region.service_time_p50_ms.unwrap()))
        .collect();
    let names: Vec<_> = regions.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["R1", "R3", "R2", "R4", "R5", "R4", "R2", "R3", "R1"]);
    // The published state of the art, ms. In real time, this machine's emulation adds some 0.1 ms.
    for (region, published) in
        regions.iter().zip([11.80, 11.80, 20.35, 20.35, 28.91, 20.32, 20.32, 11.46, 11.46])
    {
        assert!((region.1 - published).abs() <= 0.65, "{region:?} against {published}");
    }
    // Each probe, every 20 to 25 s, causes a spike of 40 to 180 ms, and nothing else does.
    let probes = events.iter().filter(|e| matches!(e.event, Event::Scanned { .. })).count();
    assert!((16..=21).contains(&probes), "{probes} probes");
    let spikes: Vec<_> = report
        .samples()
        .iter()
        .filter(|sample| is_of_navigation(sample) && sample.took.is_some_and(|took| took.as_millis() >= 40))
        .collect();
    let apart = |s: &[ServiceTime]| s[1].emitted.since(s[0].emitted).as_secs() >= 10;
    assert_eq!(1 + spikes.windows(2).filter(|s| apart(s)).count(), probes);
    assert!(spikes.iter().all(|s| s.took.unwrap().as_millis() <= 180));
    assert_eq!(summary.unanswered, 0);
    assert_eq!(summary.pose_source, Some(PoseSource::Localization));
}

#[test]
fn real_wifi_keeps_the_median_and_adds_a_tail_outside_scans() {
    let [plain, real] = ["corridor.yaml", "corridor-wifi.yaml"].map(|name| {
        let events = events_of(&loaded(name), 1, 60.0);
        let scans: Vec<_> = events.iter().filter(|e| matches!(e.event, Event::Scanned { .. })).collect();
        let is_near_scan = |sample: &ServiceTime| {
            scans.iter().any(|scan| {
                sample.emitted.since(scan.at).max(scan.at.since(sample.emitted)).as_millis() < 500
            })
        };
        let mut took: Vec<_> = events
            .iter()
            .filter_map(|event| match &event.event {
                Event::ServiceTime(sample) if is_of_navigation(sample) && !is_near_scan(sample) => {
                    sample.took
                }
                _ => None,
            })
            .map(|took| took.as_secs_f64() * 1e3)
            .collect();
        took.sort_by(f64::total_cmp);
        [0.5, 0.99].map(|share| took[(share * took.len() as f64) as usize])
    });
    assert!((real[0] - plain[0]).abs() < 0.65, "{real:?} and {plain:?}");
    assert!(plain[1] - plain[0] < 1.0, "{plain:?}");
    assert!(real[1] - real[0] > 3.0, "{real:?}");
}

#[test]
fn a_quadrotor_flies_its_walk_and_hears_radio_units_according_to_height() {
    let testbed = loaded("hall.yaml");
    let uav = testbed.graph.robots().next().unwrap().0.id.clone();
    let walk = testbed.walk(&uav).unwrap().clone();
    let events = events_of(&testbed, 1, 200.0);
    assert!(events.last().unwrap().at.as_secs_f64() < 100.0, "the walk ends");
    let contexts: Vec<_> = events
        .iter()
        .filter_map(|stamped| match &stamped.event {
            Event::Robot(context) => Some(context),
            _ => None,
        })
        .collect();
    let place = |context: &RobotContext| context.sensors.pose.position();
    for waypoint in &walk.waypoints {
        let nearest = contexts.iter().map(|context| place(context).distance(*waypoint));
        assert!(nearest.fold(f64::INFINITY, f64::min) < 0.4, "never at {waypoint}");
    }
    assert!(contexts.iter().any(|context| context.sensors.pose.pitch.abs() > 0.1), "it never tilts");
    assert!(contexts.iter().any(|context| context.sensors.velocity.vertical > 1.0), "it never climbs");
    let heard_at = |waypoint: Position, unit: &str| {
        let near = contexts.iter().filter(|context| place(context).distance(waypoint) < 0.5);
        let attachment =
            near.flat_map(|context| &context.attachments).find(|a| a.radio_unit.as_str() == unit);
        attachment.unwrap().signal.unwrap().0
    };
    // Above the same spot of the floor, 10.9 m and 16.4 m from the lower one, 9.2 m and 2.8 m from the upper one.
    let [low, high] = [walk.waypoints[2], walk.waypoints[3]];
    assert!(heard_at(high, "high") > heard_at(low, "high") + 10.0);
    let attached: Vec<_> = contexts.iter().filter_map(|context| context.attached_to()).collect();
    assert!(attached.first().is_some_and(|unit| unit.as_str() == "low"));
    assert!(attached.iter().any(|unit| unit.as_str() == "high"));
}

#[test]
fn the_same_seed_gives_the_same_events_and_another_seed_others() {
    let testbed = corridor();
    let first = events_of(&testbed, 7, 60.0);
    assert_eq!(first, events_of(&testbed, 7, 60.0));
    assert_ne!(first, events_of(&testbed, 8, 60.0));
}

/// Gives each instruction at its time, s, and returns all events until `seconds`.
fn instructed(testbed: Arc<Testbed>, instructions: &[(f64, Instruction)], seconds: f64) -> Vec<Stamped> {
    let mut simulation = Simulation::new(testbed, 1).unwrap();
    let (mut left, mut events) = (instructions.iter().peekable(), Vec::new());
    while simulation.now().as_secs_f64() < seconds {
        let next = left.peek().map_or(seconds, |(at, _)| *at);
        simulation.set_alarm(Some(Timestamp::from_secs_f64(next)));
        let now = simulation.step().as_secs_f64();
        while let Some((_, instruction)) = left.next_if(|(at, _)| *at <= now) {
            simulation.instruct(Given::new("test".parse().unwrap(), instruction.clone())).unwrap();
        }
        events.extend(std::iter::from_fn(|| simulation.poll_event()));
    }
    events
}

/// Returns a robot's contexts with their times.
fn contexts(events: &[Stamped]) -> impl Iterator<Item = (f64, &RobotContext)> {
    events.iter().filter_map(|stamped| match &stamped.event {
        Event::Robot(context) => Some((stamped.at.as_secs_f64(), context)),
        _ => None,
    })
}

/// On the ground and in the air, without navigation's knowledge.
#[test]
fn a_robot_obeys_its_speed_limit_until_it_is_lifted() {
    for (file, limit, brakes_for) in [("corridor.yaml", 0.1, 1.5), ("hall.yaml", 0.4, 3.0)] {
        let testbed = loaded(file);
        let robot = testbed.graph.robots().next().unwrap().0.id.clone();
        let limited = |speed_limit_mps| Instruction::LimitSpeed { robot: robot.clone(), speed_limit_mps };
        let (from, to) = (10.0, 30.0);
        let events = instructed(testbed, &[(from, limited(Some(limit))), (to, limited(None))], 50.0);
        let fastest = |begin: f64, end: f64| {
            let within = contexts(&events).filter(|(at, _)| (begin..end).contains(at));
            let speeds = within.map(|(_, context)| context.sensors.velocity);
            speeds.map(|v| v.linear.hypot(v.vertical)).fold(0.0, f64::max)
        };
        let slow = fastest(from + brakes_for, to);
        assert!((0.8 * limit..1.1 * limit).contains(&slow), "{file}: {slow} m/s");
        assert!(fastest(0.0, from) > 2.0 * limit && fastest(to, 50.0) > 2.0 * limit, "{file}");
        for (at, context) in contexts(&events) {
            // κ at the very moment may precede or follow the instruction.
            let expected = (from + 0.1..to - 0.1).contains(&at).then_some(limit);
            if expected.is_some() || !(from - 0.1..to + 0.1).contains(&at) {
                assert_eq!(context.speed_limit_mps, expected, "{file}: at {at}");
            }
        }
    }
}

/// The plug-in sees no answers, only ι(R).
#[test]
fn pace_shortens_blind_driving_for_a_longer_walk() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/aisle.yaml");
    let walked = |paced: bool| {
        let setting = format!("plugins.pace.enabled={paced}").parse().unwrap();
        let testbed = cotorra_testbed_file::load_with(&file, &[setting]).unwrap();
        let testbed = Arc::new(testbed);
        let events = events_of(&testbed, 2, 400.0);
        let mut report = Report::new(&testbed, 2);
        events.iter().for_each(|event| report.absorb(event));
        let limits = events.iter().filter(|stamped| match &stamped.event {
            Event::Decision(decision) => decision.instruction.name() == "limit_speed",
            _ => false,
        });
        let summary = report.summary(events.last().unwrap().at, "test", Losses::default());
        (limits.count(), summary)
    };
    let [(none, fast), (limits, slow)] = [walked(false), walked(true)];
    assert_eq!(none, 0);
    // Four passes between two radio units, plus some from shadowing.
    assert!((8..60).contains(&limits), "{limits} limits");
    let [fast_drive, slow_drive] = [&fast, &slow].map(|summary| &summary.driving[0]);
    for driven in [fast_drive, slow_drive] {
        assert!((280.0..290.0).contains(&driven.driven_m), "{driven:?}");
    }
    assert!(slow_drive.blind_m < 0.6 * fast_drive.blind_m, "{slow_drive:?} beside {fast_drive:?}");
    assert!(
        slow_drive.longest_blind_m < 0.5 * fast_drive.longest_blind_m,
        "{slow_drive:?} beside {fast_drive:?}"
    );
    assert!((1.3..2.5).contains(&(slow.duration_ms / fast.duration_ms)), "{} ms", slow.duration_ms);
}

fn goal_events(events: &[Stamped]) -> Vec<(f64, &GoalEvent)> {
    let goal = |stamped: &'_ Stamped| matches!(stamped.event, Event::Goal(_));
    let of = events.iter().filter(|stamped| goal(stamped)).map(|stamped| match &stamped.event {
        Event::Goal(goal) => (stamped.at.as_secs_f64(), goal),
        _ => unreachable!(),
    });
    of.collect()
}

/// Returns the nodes of a list with commas.
fn on(nodes: &str) -> Nodes {
    Nodes::new(nodes.split(',').map(|node| node.parse().unwrap()).collect()).unwrap()
}

fn navigate_to(robot: &str, goal: Option<Position>) -> Instruction {
    Instruction::NavigateTo { robot: robot.parse().unwrap(), goal }
}

/// The robot leaves its walk, and another instance takes over on the way.
#[test]
fn a_robot_reaches_its_goal_waits_and_continues_its_walk() {
    let goal = Position::new(25.4, -27.6);
    let place = Instruction::Place { vnf: "navigation".parse().unwrap(), node: on("edge") };
    let (left, moved, back) = (15.0, 18.0, 45.0);
    let instructions =
        [(left, navigate_to("robot", Some(goal))), (moved, place), (back, navigate_to("robot", None))];
    let events = instructed(corridor(), &instructions, 80.0);
    let goals = goal_events(&events);
    let states: Vec<_> = goals.iter().map(|(_, goal)| goal.state).collect();
    let progress = states.len() - 2;
    assert_eq!((states[0], states[progress + 1]), (GoalState::Set, GoalState::Reached), "{goals:?}");
    assert!(states[1..=progress].iter().all(|state| *state == GoalState::Progress), "{goals:?}");
    assert!((8..25).contains(&progress), "{progress} s of progress");
    for pair in goals[1..=progress].windows(2) {
        assert!((1.0..1.1).contains(&(pair[1].0 - pair[0].0)), "{pair:?}");
        // It rolls on until it has turned round.
        let turned = pair[0].0 > left + 5.0;
        assert!(!turned || pair[1].1.remaining_m < pair[0].1.remaining_m, "{pair:?}");
    }
    let reached = goals[progress + 1].0;
    assert!(goals.iter().all(|(_, goals)| goals.goal == goal) && reached < back - 5.0, "{reached}");
    let mut waypoint = None;
    for (at, context) in contexts(&events) {
        let off = context.sensors.pose.position().distance(goal);
        if (reached + 1.0..back).contains(&at) {
            assert!(off < 0.2 && context.sensors.velocity == Velocity::default(), "{off} m off at {at}");
        }
        if (left + 0.1..back).contains(&at) {
            assert_eq!(*waypoint.get_or_insert(context.waypoint), context.waypoint, "at {at}");
        }
    }
    let last = contexts(&events).last().unwrap().1;
    assert!(last.waypoint > waypoint.unwrap(), "it goes on with its walk");
    let answered = |stamped: &Stamped| match &stamped.event {
        Event::ServiceTime(sample) if is_of_navigation(sample) => {
            Some((sample.took.is_some(), sample.server.to_string()))
        }
        _ => None,
    };
    let mut servers: Vec<_> = events.iter().filter_map(answered).collect();
    servers.dedup();
    assert_eq!(servers, [(true, "cloud".to_owned()), (true, "edge".to_owned())]);
}

#[test]
fn a_quadrotor_accepts_goals_above_the_floor() {
    let goal = Position::new(8.0, 2.5).at_height(5.0);
    let events = instructed(loaded("hall.yaml"), &[(5.0, navigate_to("uav", Some(goal)))], 40.0);
    let goals = goal_events(&events);
    let (reached, last) = goals.last().unwrap();
    assert_eq!((last.state, last.goal), (GoalState::Reached, goal));
    let (_, there) = contexts(&events).find(|(at, _)| at > reached).unwrap();
    assert!(there.sensors.pose.position().distance(goal) < 0.3, "{:?}", there.sensors.pose);
}

#[test]
fn a_goal_behind_a_wall_fails_with_the_reason_and_the_robot_stops() {
    let mut testbed = Testbed::clone(&corridor());
    let map = testbed.map.as_ref().unwrap();
    // Across the whole corridor, ahead of the robot.
    let wall = map.index(Position::new(0.0, -22.0)).unwrap().1;
    let cells = (0..map.height()).flat_map(|row| (0..map.width()).map(move |column| (column, row)));
    let cell = |(column, row)| if row == wall { Cell::Occupied } else { map.cell(column, row) };
    let cells = cells.map(cell).collect();
    testbed.map = OccupancyGrid::new(map.width(), map.height(), map.resolution(), map.origin(), cells);
    let goal = Position::new(26.4, -18.7);
    let events = instructed(Arc::new(testbed), &[(5.0, navigate_to("robot", Some(goal)))], 12.0);
    let goals = goal_events(&events);
    let states: Vec<_> = goals.iter().map(|(_, goal)| goal.state).collect();
    assert_eq!(states, [GoalState::Set, GoalState::Failed]);
    let reason = goals[1].1.reason.as_deref().unwrap();
    assert!(reason.starts_with("no way leads from ") && reason.ends_with("to (26.4, -18.7)"), "{reason}");
    assert!(goals[1].0 < 5.2, "at {}", goals[1].0);
    let speed = |context: &RobotContext| context.sensors.velocity.linear;
    assert!(contexts(&events).any(|(at, context)| at < 5.0 && speed(context) > 0.2));
    assert!(contexts(&events).all(|(at, context)| at < 6.5 || speed(context) == 0.0));
}

#[test]
fn goals_are_rejected_without_a_serving_navigation_vnf() {
    let refused = |testbed: Arc<Testbed>, robot: &str| {
        let mut simulation = Simulation::new(testbed, 1).unwrap();
        simulation.step();
        let instruction = navigate_to(robot, Some(Position::new(25.5, -25.0)));
        simulation.instruct(Given::new("test".parse().unwrap(), instruction)).unwrap_err().to_string()
    };
    assert_eq!(refused(corridor(), "R1"), "there is no robot `R1`");
    let mut testbed = Testbed::clone(&corridor());
    for service in &mut testbed.services {
        service.vnfs.retain(|vnf| vnf.program != Program::Navigation);
        service.virtual_links.clear();
    }
    let reason = refused(Arc::new(testbed), "robot");
    assert_eq!(reason, "no navigation VNF serves robot `robot`, and nobody else takes goals");
}

/// Navigation whose answers are 3 s old would drive the robot by outdated positions.
#[test]
fn a_robot_with_only_stale_answers_stops_within_its_command_timeout() {
    let mut simulation = Simulation::new(corridor(), 1).unwrap();
    let delay = ConditionChange { delay_ms: Some(1500.0), ..ConditionChange::default() };
    let mut last_heard = None;
    while simulation.step().as_secs_f64() < 20.0 {
        if simulation.now().as_secs_f64() >= 5.0 && last_heard.is_none() {
            last_heard = Some(simulation.now());
            let link = LinkId::new("R1-cloud").unwrap();
            let change = Instruction::Condition { link, direction: None, change: delay.clone() };
            simulation.instruct(Given::new("test".parse().unwrap(), change)).unwrap();
        }
        while let Some(stamped) = simulation.poll_event() {
            // 0.6 s for a TurtleBot 2, and as long again for braking.
            let stale = last_heard.is_some_and(|heard| stamped.at.since(heard) > Duration::from_millis(1200));
            if let Event::Robot(context) = &stamped.event
                && stale
            {
                assert_eq!(context.sensors.velocity, Velocity::default(), "at {}", stamped.at);
            }
        }
    }
    assert!(last_heard.is_some());
}

#[test]
fn a_moving_vnf_leaves_no_position_packet_unanswered() {
    let testbed = corridor();
    let mut simulation = Simulation::new(Arc::clone(&testbed), 1).unwrap();
    let mut servers = Vec::new();
    let mut moved = false;
    while simulation.step().as_secs_f64() < 10.0 {
        while let Some(event) = simulation.poll_event() {
            if let Event::ServiceTime(sample) = event.event
                && is_of_navigation(&sample)
            {
                assert!(sample.took.is_some(), "sample {} got no answer", sample.sequence);
                servers.push(sample.server.to_string());
            }
        }
        if !moved && simulation.now().as_secs_f64() > 5.0 {
            moved = true;
            let place = Instruction::Place { vnf: "navigation".parse().unwrap(), node: on("edge") };
            simulation.instruct(Given::new("test".parse().unwrap(), place)).unwrap();
        }
    }
    servers.dedup();
    assert_eq!(servers, ["cloud", "edge"]);
}

/// Returns the corridor with a further service: a flow of the robot's traffic with this VNF.
fn with_a_flow_to(vnf: &str, timeout: &str) -> Arc<Testbed> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let port = cotorra_plugin::wire::port(&corridor(), &vnf.parse().unwrap()).unwrap();
    // An answer has the nonce of its packet.
    let flow = format!("protocol: udp, port: {port}, id: {{ offset: 24, length: 8 }}, timeout: {timeout}");
    let service = format!(
        "\nservices:\n  flow:\n    robot: robot\n    kpis: {{ service_time: 15 ms, flow: {{ {flow} }} }}\n    vnfs: {{}}\n"
    );
    let text = std::fs::read_to_string(&file).unwrap().replace("\nservices:\n", &service);
    let testbed = cotorra_testbed_file::parse("corridor.yaml", &text, file.parent().unwrap()).unwrap();
    Arc::new(testbed)
}

/// The service's name is that of its VNF. The fabric measures the flow without knowing the robot's middleware.
#[test]
fn a_flow_on_the_port_of_a_service_has_the_times_of_that_service() {
    // A TurtleBot 2 waits 0.6 s for navigation's answers, and 3 s for poses.
    for (name, timeout, least, least_lost) in
        [("navigation", "600 ms", 400, 10), ("localization", "3 s", 80, 4)]
    {
        let mut simulation = Simulation::new(with_a_flow_to(name, timeout), 1).unwrap();
        let loss = Loss::Independent { rate: Probability::new(0.08).unwrap() };
        let change = ConditionChange { loss: Some(loss), ..ConditionChange::default() };
        let mut samples: HashMap<String, Vec<_>> = HashMap::new();
        let mut is_lossy = false;
        while simulation.step().as_secs_f64() < 100.0 {
            if !std::mem::replace(&mut is_lossy, true) {
                for link in ["R1-cloud", "R3-cloud", "R1-edge", "R3-edge"] {
                    let (link, change) = (LinkId::new(link).unwrap(), change.clone());
                    let change = Instruction::Condition { link, direction: None, change };
                    simulation.instruct(Given::new("test".parse().unwrap(), change)).unwrap();
                }
            }
            while let Some(Stamped { at, event }) = simulation.poll_event() {
                if let Event::ServiceTime(sample) = event {
                    let ServiceTime { sequence, emitted, took, attachment, server, parts, .. } = sample;
                    assert_eq!(parts.as_ref().map(|parts| parts.total()), took);
                    let its = samples.entry(sample.service.to_string()).or_default();
                    its.push((at, sequence, emitted, took, attachment, server, parts));
                }
            }
        }
        let its = &samples[name];
        assert!(its.len() > least, "{} samples of {name}", its.len());
        let lost = its.iter().filter(|(.., took, _, _, _)| took.is_none()).count();
        assert!(lost > least_lost, "{lost} of {name} are lost");
        assert_eq!(&samples["flow"], its, "{name}");
    }
}

#[test]
fn every_position_packet_is_answered_whenever_a_vnf_moves() {
    let testbed = corridor();
    let mut simulation = Simulation::new(Arc::clone(&testbed), 1).unwrap();
    // To and fro, each time at another moment between two position packets, which are 50 ms apart.
    let mut moves =
        (0..100_u16).map(|i| (Timestamp::from_secs_f64(1.0 + 0.1525 * f64::from(i)), i % 2)).peekable();
    let (mut node, mut switched, mut samples) = ("cloud".to_owned(), Vec::new(), 0);
    while moves.peek().is_some() || simulation.now().as_secs_f64() < 18.0 {
        simulation.set_alarm(moves.peek().map(|(at, _)| *at));
        let now = simulation.step();
        while let Some(Stamped { at, event }) = simulation.poll_event() {
            match event {
                Event::Placement(placement) if placement.vnf.as_str() == "navigation" => {
                    node = placement.node.to_string();
                    switched.push((at, node.clone()));
                }
                Event::ServiceTime(sample) if is_of_navigation(&sample) => {
                    assert!(sample.took.is_some(), "sample {} got no answer", sample.sequence);
                    // Packets go to the VNF's placement at their emission.
                    let placed = switched.iter().rev().find(|(at, _)| *at <= sample.emitted);
                    assert_eq!(placed.unwrap().1, sample.server.as_str());
                    samples += 1;
                }
                _ => {}
            }
        }
        if let Some((_, place)) = moves.next_if(|(at, _)| *at <= now) {
            let node = on(["edge", "cloud"][usize::from(place)]);
            let place = Instruction::Place { vnf: "navigation".parse().unwrap(), node };
            simulation.instruct(Given::new("test".parse().unwrap(), place)).unwrap();
        }
    }
    assert_eq!((node.as_str(), switched.len()), ("cloud", 101));
    assert!(samples > 330, "{samples} samples");
}

#[test]
fn a_plugin_that_panics_is_cut_off_and_the_robot_walks_on() {
    struct Bomb;
    impl Plugin for Bomb {
        fn handle(&mut self, _now: Timestamp, _event: &Event, _actions: &mut Actions) {
            panic!("by design");
        }
    }
    let testbed = corridor();
    let simulation = Simulation::new(Arc::clone(&testbed), 1).unwrap();
    let mut simulation = simulation.with_plugin("bomb".parse().unwrap(), Box::new(Bomb), &testbed);
    let (mut faults, mut answered) = (Vec::new(), 0);
    while simulation.step().as_secs_f64() < 3.0 {
        while let Some(event) = simulation.poll_event() {
            match event.event {
                Event::PluginFault { plugin, reason } => faults.push(format!("{plugin}: {reason}")),
                Event::ServiceTime(sample) => answered += u32::from(sample.took.is_some()),
                _ => {}
            }
        }
    }
    assert_eq!(faults, ["bomb: panicked: by design"]);
    assert!(answered > 40, "{answered} answers");
}

#[test]
fn two_runs_with_one_seed_leave_the_same_bytes() {
    let out = tempfile::tempdir().unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let text = std::fs::read_to_string(file).unwrap();
    let run = || {
        let options = Options {
            seed: Some(3),
            until: Some(Duration::from_secs(40)),
            folder: Place::In(out.path().to_owned()),
            ..Options::default()
        };
        simulate(Testbed::clone(&corridor()), &text, &options, |_| true).unwrap()
    };
    let (first, second) = (run(), run());
    assert_eq!(first.summary, second.summary);
    assert!(first.summary.fidelity.valid && first.summary.samples > 700, "{:?}", first.summary);
    for name in ["summary.json", "service_time.csv", "service_time.svg", "testbed.yaml", "history.sqlite"] {
        let read = |run: &Finished| std::fs::read(run.folder.join(name)).unwrap();
        let (a, b) = (read(&first), read(&second));
        let differs = a.iter().zip(&b).position(|(a, b)| a != b);
        assert!(a == b, "{name} differs from byte {differs:?} on");
    }
}

/// Returns the corridor with its radio units out of reach.
fn out_of_reach() -> Testbed {
    let mut testbed = Testbed::clone(&corridor());
    for node in &mut testbed.graph.nodes {
        if let cotorra_graph::NodeKind::RadioUnit(_) = node.kind {
            node.position = node.position.map(|at| Position { x: at.x + 100_000.0, ..at });
        }
    }
    testbed
}

#[test]
fn a_walk_on_which_no_robot_makes_progress_ends_with_the_robots_names() {
    let out = tempfile::tempdir().unwrap();
    let run = |testbed: Testbed, until| {
        let options = Options { until, folder: Place::In(out.path().to_owned()), ..Options::default() };
        simulate(testbed, "", &options, |_| true).unwrap()
    };
    let stuck = run(out_of_reach(), None);
    let Summary { ended, duration_ms, no_progress, .. } = &stuck.summary;
    assert_eq!((*ended, stuck.summary.is_stuck()), ("no robot made progress for 60 s", true));
    assert!((60_000.0..63_000.0).contains(duration_ms), "{duration_ms}");
    let stand = no_progress.as_ref().unwrap();
    assert!(stand.starts_with("robot is at (25.5, -27.8), on its way to waypoint"), "{stand}");
    assert!(stand.ends_with("attached to no radio unit"), "{stand}");
    // The history says it, too.
    let history = cotorra_measurements::History::open(stuck.folder.join("history.sqlite")).unwrap();
    let last = history.all_events(stuck.run, &[]).unwrap().pop().unwrap();
    assert!(matches!(last.event, Event::Notice { message } if message.contains(stand)));
    // A run that says how long it is goes on, and the same run without files ends at the same time.
    let longer = run(out_of_reach(), Some(Duration::from_secs(90)));
    assert_eq!((longer.summary.ended, longer.summary.no_progress), (End::Until.as_str(), None));
    let altered = Altered::default();
    let folder = &out.path().join("unrecorded");
    let unrecorded = Unrecorded { seed: 1, until: None, altered: &altered, folder, text: "" };
    let ended = simulate_unrecorded(Arc::new(out_of_reach()), &unrecorded, |_| {}, || true).unwrap().unwrap();
    // Localization errors are in runs with files only.
    let localization = stuck.summary.localization.clone();
    assert_eq!(Summary { localization, ..ended.summary }, stuck.summary);
}

#[test]
fn a_walk_of_a_robot_that_nothing_navigates_ends() {
    let mut testbed = Testbed::clone(&corridor());
    (testbed.services, testbed.plugins) = (Vec::new(), Vec::new());
    let out = tempfile::tempdir().unwrap();
    let options = Options { folder: Place::In(out.path().to_owned()), ..Options::default() };
    assert!(simulate(testbed, "", &options, |_| true).unwrap().summary.is_stuck());
}

#[test]
fn robots_are_given_60_s_after_the_last_change_of_the_schedule() {
    let mut testbed = out_of_reach();
    testbed.script.schedule = vec![cotorra_graph::Scheduled {
        when: cotorra_graph::When::At(Duration::from_secs(100)),
        links: vec!["lan-cloud".parse().unwrap()],
        direction: None,
        set: ConditionChange { delay_ms: Some(50.0), ..Default::default() },
    }];
    let out = tempfile::tempdir().unwrap();
    let options = Options { folder: Place::In(out.path().to_owned()), ..Options::default() };
    let summary = simulate(testbed, "", &options, |_| true).unwrap().summary;
    assert!(summary.is_stuck() && (158_000.0..163_000.0).contains(&summary.duration_ms), "{summary:?}");
}

#[test]
fn endless_virtual_time_is_rejected() {
    let mut testbed = Testbed::clone(&corridor());
    testbed.walks.clear();
    assert!(matches!(simulate(testbed, "", &Options::default(), |_| true), Err(RunError::Endless)));
}

#[test]
fn okpi_keeps_the_target_with_the_published_placements() {
    let mut testbed = Testbed::clone(&corridor());
    testbed.plugins[0].program = PluginProgram::Bundled("okpi".to_owned());
    testbed.plugins[0].settings.clear();
    let testbed = Arc::new(testbed);
    let mut report = Report::new(&testbed, 1);
    for event in events_of(&testbed, 1, 500.0) {
        report.absorb(&event);
    }
    let regions = report.regions();
    let mut decided: Vec<_> = regions
        .iter()
        .filter(|region| region.service.as_str() == "navigation" && region.samples > 20)
        .map(|region| (region.attachment.as_ref().unwrap().as_str(), region.server.as_str()))
        .filter(|(attachment, _)| *attachment != "R4")
        .collect();
    decided.dedup();
    // The way out and back, as published. R4 beside R2 has the same server.
    let out = [("R1", "cloud"), ("R3", "cloud"), ("R2", "edge"), ("R5", "fog")];
    let back = [("R2", "edge"), ("R3", "cloud"), ("R1", "cloud")];
    assert_eq!(decided, [&out[..], &back[..]].concat());
    let took: Vec<_> = report.samples().iter().filter(is_of_navigation).map(|sample| sample.took).collect();
    let over = took.iter().filter(|took| took.is_none_or(|took| took.as_millis() >= 15)).count();
    assert!(over * 200 < took.len(), "{over} of {} over the target", took.len());
}

/// Returns the two-paths testbed, with or without its plug-in.
fn two_paths(with_okpi: bool) -> Testbed {
    let text = include_str!("../../../../../testbeds/two-paths.yaml");
    let text = text.replace("enabled: false", &format!("enabled: {with_okpi}"));
    cotorra_testbed_file::parse("two-paths.yaml", &text, Path::new("")).unwrap()
}

/// Sorted service times since a time, and the packets from the robot that the first link of each path carried since then.
struct Window {
    took: Vec<Duration>,
    narrow: u64,
    wide: u64,
}

/// Applies instructions, and simulates ten seconds.
fn ten_seconds(simulation: &mut Simulation, instructions: &[Instruction]) -> Window {
    for instruction in instructions {
        simulation.instruct(Given::new("test".parse().unwrap(), instruction.clone())).unwrap();
    }
    let began = simulation.now();
    let carried = |simulation: &Simulation, link: &str| {
        let contexts = simulation.network.fabric().link_contexts(simulation.now());
        contexts.into_iter().find(|context| context.link == *link).unwrap().counters.packets
    };
    let before = ["unit-narrow", "unit-wide"].map(|link| carried(simulation, link));
    let mut took = Vec::new();
    while simulation.step() < began + Duration::from_secs(10) {
        while let Some(stamped) = simulation.poll_event() {
            // Earlier packets are still under way under the previous conditions.
            if let Event::ServiceTime(sample) = stamped.event
                && sample.emitted > began
            {
                took.push(sample.took.unwrap_or(Duration::MAX));
            }
        }
    }
    took.sort_unstable();
    let [narrow, wide] = ["unit-narrow", "unit-wide"].map(|link| carried(simulation, link));
    Window { took, narrow: narrow - before[0], wide: wide - before[1] }
}

#[test]
fn a_mapped_path_keeps_the_target_that_the_shortest_misses() {
    let testbed = Arc::new(two_paths(false));
    let target = testbed.services[0].kpis.service_time;
    let map = |from: &str, to: &str, links: &[&str]| Instruction::Map {
        from: from.parse().unwrap(),
        to: to.parse().unwrap(),
        links: links.iter().map(|link| link.parse().unwrap()).collect(),
        reservation: None,
    };
    let there = map("robot", "edge", &["robot~unit", "unit-wide", "edge-wide"]);
    let back = map("edge", "robot", &["edge-wide", "unit-wide", "robot~unit"]);
    let lose = |share| Instruction::Condition {
        link: "edge-wide".parse().unwrap(),
        direction: None,
        change: ConditionChange {
            loss: Some(cotorra_graph::Loss::Independent {
                rate: cotorra_graph::Probability::new(share).unwrap(),
            }),
            ..ConditionChange::default()
        },
    };
    let mut simulation = Simulation::new(Arc::clone(&testbed), 1).unwrap();
    let misses = |window: Window| {
        assert!(window.took.len() > 20 && window.took[0] > target, "{:?}", window.took);
        assert!(window.narrow > 20 && window.wide == 0, "{} and {}", window.narrow, window.wide);
    };
    let keeps = |window: Window| {
        let most = window.took.last().unwrap();
        assert!(window.took.len() > 20 && *most < target / 2, "{:?}", window.took);
        assert!(window.narrow == 0 && window.wide > 20, "{} and {}", window.narrow, window.wide);
    };
    misses(ten_seconds(&mut simulation, &[]));
    // One direction alone is not enough.
    let half = ten_seconds(&mut simulation, std::slice::from_ref(&there));
    assert!(half.took[0] > target && half.narrow == 0 && half.wide > 20);
    keeps(ten_seconds(&mut simulation, std::slice::from_ref(&back)));
    misses(ten_seconds(&mut simulation, &[lose(1.0)]));
    keeps(ten_seconds(&mut simulation, &[lose(0.0)]));
    let unmap = [map("robot", "edge", &[]), map("edge", "robot", &[])];
    misses(ten_seconds(&mut simulation, &unmap));

    let narrow = map("robot", "edge", &["robot~unit", "unit-narrow", "narrow-edge"]);
    let refused = simulation.instruct(Given::new("test".parse().unwrap(), narrow)).unwrap_err();
    assert!(refused.0.contains("`unit-narrow` has 0.01 Mbit/s left"), "{refused}");
}

#[test]
fn okpi_maps_its_chosen_path() {
    let testbed = two_paths(true);
    let target = testbed.services[0].kpis.service_time;
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    ten_seconds(&mut simulation, &[]);
    let Window { took, narrow, .. } = ten_seconds(&mut simulation, &[]);
    assert!(took.len() > 20 && *took.last().unwrap() < target / 2 && narrow == 0, "{took:?}");
}

/// Simulates the first seconds with the plug-in `probing` replaced by a program.
fn run_with_program(command: &[&str], settings: serde_json::Value, patience: Duration) -> (Finished, String) {
    let out = tempfile::tempdir().unwrap();
    let mut testbed = Testbed::clone(&corridor());
    testbed.plugins[0].program = PluginProgram::Command(command.iter().map(ToString::to_string).collect());
    testbed.plugins[0].settings = serde_json::from_value(settings).unwrap();
    testbed.plugins[0].instructions_per_second = InstructionLimit::new(500).unwrap();
    let options = Options {
        seed: Some(1),
        until: Some(Duration::from_secs(60)),
        folder: Place::In(out.path().to_owned()),
        ..Options::default()
    };
    let (altered, observe) = (&Altered::default(), &mut |_: &Stamped| {});
    let conduct = run::Conduct { patience, wall: wall_clock(), altered, observe, watched: None };
    let (finished, _) = run::simulate_with(Arc::new(testbed), "", &options, conduct, |_| true).unwrap();
    let samples = std::fs::read_to_string(finished.folder.join("service_time.csv")).unwrap();
    (finished, samples)
}

const PATIENT: Duration = Duration::from_secs(600);

/// Returns the command that runs [`the_program_of_other_tests`].
fn this_program() -> String {
    std::env::current_exe().unwrap().to_str().unwrap().to_owned()
}

const AS_PROGRAM: [&str; 2] = ["--exact", "virtual_time::tests::the_program_of_other_tests"];

/// The program that other tests start as a plug-in. It does nothing by itself.
#[test]
fn the_program_of_other_tests() {
    if std::env::var_os("COTORRA_API").is_none() {
        return;
    }
    let settings = cotorra_plugin::client::settings().unwrap();
    if settings.contains_key("hang") {
        let mut events = cotorra_plugin::client::Client::from_env().unwrap().events(&["robot"]).unwrap();
        events.next().unwrap().unwrap();
        loop {
            std::thread::park();
        }
    }
    if settings.contains_key("flood") {
        let client = cotorra_plugin::client::Client::from_env().unwrap();
        let mut events = client.events(&["robot"]).unwrap();
        events.next().unwrap().unwrap();
        let scan = Instruction::Scan { robot: "robot".parse().unwrap() };
        while !matches!(client.instruct(&scan, None), Err(ClientError::Refused(why)) if why.contains("more than 500"))
        {
        }
        return;
    }
    let mut probing = cotorra_probing::Probing::from_settings(&settings, 1).unwrap();
    cotorra_plugin::client::run(&mut probing).unwrap();
}

#[test]
fn a_plugin_acts_the_same_in_process_and_as_a_program() {
    let testbed = corridor();
    let mut report = Report::new(&testbed, 1);
    for event in events_of(&testbed, 1, 60.0) {
        report.absorb(&event);
    }
    let [exact, name] = AS_PROGRAM;
    let run = || run_with_program(&[&this_program(), exact, name], serde_json::json!({}), PATIENT);
    let ((first, samples), (second, again)) = (run(), run());
    assert_eq!(first.summary.plugin_faults, [""; 0]);
    assert!(!first.summary.handovers.is_empty());
    let took = |report: &Report| report.samples().iter().map(|s| (s.sequence, s.took)).collect::<Vec<_>>();
    let (apart, within) = (took(&first.report), took(&report));
    let both = apart.len().min(within.len());
    assert!(both > 1100);
    assert_eq!(apart[..both], within[..both]);
    assert_eq!(samples, again);
    assert_eq!(first.summary, second.summary);
}

#[test]
fn a_program_that_hangs_or_ends_is_cut_off_and_the_run_goes_on() {
    let impatient = Duration::from_millis(300);
    let [exact, name] = AS_PROGRAM;
    let hung = [&*this_program(), exact, name];
    for (command, patience, complaint) in [
        (&["false"][..], PATIENT, "its program ended"),
        (&["sleep", "1000"], impatient, "followed no `/api/v1/events`"),
        (&hung, impatient * 10, "was not done with mark"),
    ] {
        let (finished, _) = run_with_program(command, serde_json::json!({ "hang": true }), patience);
        let faults = &finished.summary.plugin_faults;
        assert!(matches!(&faults[..], [fault] if fault.contains(complaint)), "{command:?}: {faults:?}");
        let void: Vec<_> = finished.summary.void.reasons().collect();
        assert!(matches!(&void[..], [reason] if reason.contains(complaint)), "{command:?}: {void:?}");
        assert!(finished.summary.samples > 1100);
    }
}

#[test]
fn a_program_that_floods_is_cut_off_after_the_same_instructions_each_time() {
    let [exact, name] = AS_PROGRAM;
    let flood = || {
        let command = [&*this_program(), exact, name];
        run_with_program(&command, serde_json::json!({ "flood": true }), PATIENT).0.summary
    };
    let summary = flood();
    let reason = "it gave more than 500 instructions in a second, its `instructions_per_second`";
    assert!(matches!(&summary.plugin_faults[..], [fault] if fault.ends_with(reason)), "{summary:?}");
    assert_eq!(summary, flood());
}

#[test]
fn a_run_that_waits_for_a_program_can_be_stopped() {
    let mut testbed = Testbed::clone(&corridor());
    testbed.plugins[0].program = PluginProgram::Command(vec!["sleep".to_owned(), "1000".to_owned()]);
    let out = tempfile::tempdir().unwrap();
    let folder = Place::In(out.path().to_owned());
    let options = Options { folder, ..Options::default() };
    assert!(simulate(testbed.clone(), "", &options, |_| false).unwrap().was_stopped());
    let bare = Simulation::new(Arc::new(testbed), 1);
    assert!(matches!(bare, Err(RunError::Plugin(PluginError::NeedsRun(_)))));
}

#[test]
fn real_wifi_software_is_rejected_with_the_way_to_its_model() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor-wifi.yaml");
    let with = |settings: &[&str]| {
        let settings: Vec<_> = settings.iter().map(|setting| setting.parse().unwrap()).collect();
        let testbed = cotorra_testbed_file::load_with(&file, &settings).unwrap();
        Simulation::new(Arc::new(testbed), 1).map(drop)
    };
    let real = "wireless.corridor.wifi=hwsim";
    let rejected = with(&[real]).unwrap_err().to_string();
    let model = rejected.split('`').find_map(|word| word.strip_prefix("--set ")).unwrap();
    assert_eq!(model, "wireless.corridor.wifi=model");
    with(&[real, model]).unwrap();
}
