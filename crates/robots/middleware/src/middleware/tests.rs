use std::collections::BTreeMap;

use cotorra_graph::{
    BitRate, Pose, PoseSource, RobotClock, Service, ServiceId, ServiceTime, VirtualLink, Vnf, VnfId,
};
use cotorra_graph_testing as base;

use cotorra_plugin::{
    convert::{from_pose, to_pose, to_twist},
    wire::{Headway, PositionPacket, ScanPacket},
};

use super::*;
use crate::fixtures::{SERVER, id, robot, room, walk};

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn at(millis: u64) -> Timestamp {
    Timestamp::ZERO + ms(millis)
}

fn testbed() -> Testbed {
    let vnf = |name: &str, program| Vnf {
        id: VnfId::new(name).unwrap(),
        program,
        memory_bytes: 1 << 20,
        ..base::vnf("vnf", "robot1")
    };
    let vnfs = vec![vnf("driver", Program::RobotDriver), vnf("brain", Program::Navigation)];
    let virtual_links = vec![VirtualLink {
        from: base::id("driver"),
        to: base::id("brain"),
        rate: BitRate::from_bits_per_second(6_000_000).unwrap(),
    }];
    let nodes = vec![robot("robot1", None), robot("idle", Some(Position::new(1.0, 3.0)))];
    Testbed {
        services: vec![Service { virtual_links, ..base::service("robot1", vnfs) }],
        map: Some(room(6.0, 4.0)),
        walks: vec![walk("robot1", &[(1.0, 1.0), (3.0, 1.0), (5.0, 1.0)])],
        ..base::testbed(base::graph(nodes, Vec::new()))
    }
}

fn middleware() -> RobotMiddleware {
    simulated(&testbed(), 1)
}

/// Simulated robots that are attached and have servers.
fn simulated(testbed: &Testbed, seed: u64) -> RobotMiddleware {
    let mut middleware = RobotMiddleware::simulated(testbed, seed, ms(100)).unwrap();
    connect(&mut middleware);
    middleware
}

fn connect(middleware: &mut RobotMiddleware) {
    for robot in [id("robot1"), id("idle")] {
        let attachment = Attachment { radio_unit: id("R1"), attached: true, signal: None, age: None };
        middleware.set_attachments(&robot, vec![attachment]);
        let servers = vec![(id("cloud"), Some(SERVER))];
        let servers = Servers { navigation: servers.clone(), localization: servers };
        middleware.set_servers(&robot, servers);
    }
}

fn events(middleware: &mut RobotMiddleware) -> Vec<Stamped> {
    std::iter::from_fn(|| middleware.poll_event()).collect()
}

fn position(middleware: &mut RobotMiddleware, now: Timestamp) -> Option<PositionPacket> {
    middleware.poll_transmit(now).map(|datagram| PositionPacket::decode(&datagram.bytes).unwrap())
}

/// Runs in virtual time against a brain that drives straight on and answers after `delay`.
fn run(until: Timestamp, delay: Duration, seed: u64) -> (RobotMiddleware, Vec<Stamped>) {
    let mut middleware = simulated(&testbed(), seed);
    let mut answers = VecDeque::new();
    let mut told = Vec::new();
    loop {
        let arrival = answers.front().map_or(Timestamp::MAX, |(arrival, _)| *arrival);
        let now = middleware.next_deadline().min(arrival);
        if now > until || middleware.finished() {
            return (middleware, told);
        }
        middleware.advance(now);
        while let Some(packet) = position(&mut middleware, now) {
            let pose = from_pose(&packet.pose, PoseSource::Simulator);
            let waypoint = if pose.x > 4.9 {
                3
            } else if pose.x > 2.9 {
                2
            } else {
                1
            };
            let velocity = Velocity::planar(0.3, 0.0);
            answers
                .push_back((now + delay, NavigationPacket::answering(&packet, waypoint, to_twist(velocity))));
        }
        while let Some((_, answer)) = answers.pop_front_if(|(arrival, _)| *arrival <= now) {
            middleware.receive(now, &id("robot1"), SERVER, &answer);
        }
        told.extend(events(&mut middleware));
    }
}

fn service_times(told: &[Stamped]) -> Vec<&ServiceTime> {
    told.iter().filter_map(|s| if let Event::ServiceTime(t) = &s.event { Some(t) } else { None }).collect()
}

#[test]
fn walk_ends_and_every_answer_is_measured() {
    let (middleware, told) = run(at(60_000), ms(11), 1);
    assert!(middleware.finished());
    let end = told.last().unwrap();
    assert_eq!(end.event, Event::WalkFinished { robot: id("robot1") });
    // 3.9 m at 0.3 m/s, plus the ramp.
    assert!((13.0..14.5).contains(&end.at.as_secs_f64()), "{}", end.at);
    let times = service_times(&told);
    assert!((64..=72).contains(&times.len()), "{}", times.len());
    assert!(times.iter().all(|t| t.took == Some(ms(11)) && t.server == id("cloud")));
    assert!(times.iter().enumerate().all(|(i, t)| t.sequence as usize == i));
    assert!(!told.iter().any(|s| matches!(s.event, Event::Notice { .. })));
}

#[test]
fn same_seed_gives_the_same_events() {
    assert_eq!(run(at(5000), ms(11), 1).1, run(at(5000), ms(11), 1).1);
    assert_ne!(run(at(5000), ms(11), 1).1, run(at(5000), ms(11), 2).1);
}

#[test]
fn late_answers_count_as_missing() {
    let (_, told) = run(at(5000), ms(700), 1);
    let times = service_times(&told);
    assert!(times.len() >= 20);
    assert!(times.iter().all(|t| t.took.is_none()));
}

#[test]
fn answers_older_than_the_command_timeout_are_counted_and_ignored() {
    let (mut middleware, told) = run(at(15_000), ms(3000), 1);
    let pose = middleware.sensors(&id("robot1")).unwrap().pose;
    assert_eq!((pose.x, pose.y), (1.0, 1.0), "it stands where it began");
    let counts = told.iter().filter_map(|stamped| match &stamped.event {
        Event::AnswersRejected(counts) => Some((stamped.at, counts.clone())),
        _ => None,
    });
    let counts: Vec<_> = counts.collect();
    assert!(counts.windows(2).all(|pair| pair[1].0.since(pair[0].0) >= ms(1000)), "{counts:?}");
    let (_, last) = counts.last().unwrap();
    assert!(last.late > 50, "{last:?}");
    assert_eq!(AnswersRejected { late: 0, ..last.clone() }, AnswersRejected::none(id("robot1")));
}

#[test]
fn rejected_datagrams_are_counted_by_reason() {
    let mut middleware = middleware();
    let robot = id("robot1");
    middleware.advance(at(900));
    let packet = position(&mut middleware, at(900)).unwrap();
    let answer = NavigationPacket::answering(&packet, 1, to_twist(Velocity::planar(0.3, 0.0)));
    middleware.receive(at(901), &robot, SERVER, &NavigationPacket { nonce: !packet.nonce, ..answer.clone() });
    middleware.receive(at(902), &robot, SERVER, &answer);
    middleware.receive(at(903), &robot, SERVER, &answer);
    middleware.receive(at(904), &robot, SERVER, &NavigationPacket { sequence: 99, ..answer.clone() });
    middleware.reject(&robot);
    let pose = PosePacket {
        sequence: 0,
        emitted: at(0),
        nonce: 0,
        pose: from_pose(&packet.pose, PoseSource::Localization),
    };
    middleware.localized(at(905), &robot, SERVER, &pose);
    middleware.advance(at(1000));
    let counts = events(&mut middleware).into_iter().find_map(|stamped| match stamped.event {
        Event::AnswersRejected(counts) => Some(counts),
        _ => None,
    });
    let expected =
        AnswersRejected { robot, late: 0, forged: 1, repeated: 1, redundant: 0, unknown: 2, invalid: 1 };
    assert_eq!(counts, Some(expected));
}

#[test]
fn robot_stops_when_answers_stop() {
    let mut middleware = middleware();
    let packet = loop {
        let now = middleware.next_deadline();
        middleware.advance(now);
        if let Some(packet) = position(&mut middleware, now) {
            break packet;
        }
    };
    let answer = NavigationPacket::answering(&packet, 1, to_twist(Velocity::planar(0.3, 0.0)));
    let received = packet.emitted + ms(10);
    middleware.receive(received, &id("robot1"), SERVER, &answer);
    middleware.advance(received + ms(590));
    assert!(middleware.sensors(&id("robot1")).unwrap().velocity.linear > 0.25);
    middleware.advance(received + ms(1200));
    let stopped = middleware.sensors(&id("robot1")).unwrap();
    assert_eq!(stopped.velocity, Velocity::default());
    middleware.advance(received + ms(9000));
    assert_eq!(middleware.sensors(&id("robot1")).unwrap().pose, stopped.pose);
}

#[test]
fn contexts_come_at_their_interval_with_the_attachments() {
    let mut middleware = middleware();
    let mut contexts = Vec::new();
    for now in (0..=1000).step_by(10) {
        middleware.advance(at(now));
        contexts.extend(events(&mut middleware).into_iter().filter_map(|s| match s.event {
            Event::Robot(context) => Some((s.at, context)),
            _ => None,
        }));
    }
    let times: Vec<Timestamp> =
        contexts.iter().filter(|(_, c)| c.robot == "robot1").map(|(at, _)| *at).collect();
    assert_eq!(times, (0..=10).map(|i| at(100 * i)).collect::<Vec<_>>());
    assert_eq!(contexts.len(), 22, "the robot that has no walk is told of as well");
    let (_, context) = &contexts[1];
    assert_eq!(context.attached_to(), Some(&id("R1")));
    assert_eq!(context.sensors.pose.source, PoseSource::Simulator);
    assert_eq!(middleware.next_deadline(), middleware.next_deadline().min(at(1100)));
}

#[test]
fn a_middleware_that_nobody_ran_reports_the_packets_that_its_robots_missed() {
    let samples = |middleware: &mut RobotMiddleware| -> Vec<ServiceTime> {
        let sample = |stamped: Stamped| match stamped.event {
            Event::ServiceTime(sample) => Some(sample),
            _ => None,
        };
        events(middleware).into_iter().filter_map(sample).collect()
    };
    let mut middleware = middleware();
    middleware.advance(at(200));
    let first = position(&mut middleware, at(200)).unwrap();
    middleware.advance(at(3200));
    let second = position(&mut middleware, at(3200)).unwrap();
    // The first is given up, and those between are missed.
    let missed = samples(&mut middleware);
    assert_eq!(missed.len() as u32, second.sequence - first.sequence);
    assert!(missed.len() >= 14 && missed.iter().all(|sample| sample.took.is_none()), "{missed:?}");
    assert_eq!(missed[1].attachment, Some(id("R1")));
    // The run ends while it is not run.
    middleware.finish(at(5200));
    assert!(samples(&mut middleware).len() >= 8);
}

#[test]
fn missed_contexts_are_skipped() {
    let mut middleware = middleware();
    middleware.advance(at(1050));
    let contexts = events(&mut middleware).into_iter().filter(|s| matches!(s.event, Event::Robot(_))).count();
    assert_eq!(contexts, 2);
    middleware.advance(at(1099));
    assert!(!events(&mut middleware).iter().any(|s| matches!(s.event, Event::Robot(_))));
}

#[test]
fn instructions_move_a_robot_or_give_a_reason() {
    let mut middleware = middleware();
    let drive = |linear| Velocity::planar(linear, 0.0);
    middleware.instruct(at(0), &id("idle"), drive(0.2), 0).unwrap();
    middleware.advance(at(600));
    assert!(middleware.sensors(&id("idle")).unwrap().pose.x > 1.05);
    middleware.stop(at(600), &id("idle"));
    middleware.advance(at(1200));
    assert_eq!(middleware.sensors(&id("idle")).unwrap().velocity, Velocity::default());

    let refused = |result: Result<(), MoveError>| result.unwrap_err().to_string();
    assert_eq!(
        refused(middleware.instruct(at(0), &id("nobody"), drive(0.2), 0)),
        "there is no robot `nobody`"
    );
    assert_eq!(
        refused(middleware.instruct(at(0), &id("robot1"), drive(0.2), 4)),
        "the walk of robot `robot1` has no waypoint 4"
    );
    assert!(
        refused(middleware.instruct(at(0), &id("robot1"), drive(f64::NAN), 2)).contains("no finite number")
    );
}

#[test]
fn rejected_instruction_keeps_the_waypoint() {
    let mut middleware = middleware();
    middleware.instruct(at(0), &id("robot1"), Velocity::default(), 1).unwrap();
    let wrong = Velocity::planar(f64::NAN, 0.0);
    assert!(middleware.instruct(at(0), &id("robot1"), wrong, 2).is_err());
    middleware.advance(at(0));
    let told = events(&mut middleware);
    assert!(
        told.iter().any(|s| matches!(&s.event, Event::Robot(c) if c.robot == "robot1" && c.waypoint == 1))
    );
}

#[test]
fn instruction_to_the_end_of_the_walk_ends_it_once() {
    let mut middleware = middleware();
    for _ in 0..2 {
        middleware.instruct(at(0), &id("robot1"), Velocity::planar(0.3, 0.0), 3).unwrap();
    }
    let ends =
        events(&mut middleware).iter().filter(|s| matches!(s.event, Event::WalkFinished { .. })).count();
    assert_eq!(ends, 1);
    assert!(middleware.finished());
}

#[test]
fn commands_beyond_the_limits_are_reported_once() {
    let mut middleware = middleware();
    let mut told = |linear| {
        let _ = middleware.instruct(at(0), &id("idle"), Velocity::planar(linear, 0.0), 0);
        events(&mut middleware).len()
    };
    assert_eq!(told(0.5), 0);
    assert_eq!(told(5.0), 1);
    assert_eq!(told(6.0), 0);
    assert_eq!(told(0.5), 0);
    assert_eq!(told(f64::INFINITY), 1);
}

#[test]
fn positions_are_those_of_the_robots() {
    let mut middleware = middleware();
    let positions: Vec<_> = middleware.positions().map(|(robot, p)| (robot.as_str(), p)).collect();
    assert_eq!(positions, [("idle", Position::new(1.0, 3.0)), ("robot1", Position::new(1.0, 1.0))]);
    assert!(!middleware.finished());
    assert!(middleware.driver(&id("robot1")).is_some());
}

#[test]
fn tap_gets_each_scan_once_and_nothing_is_kept_without_one() {
    let mut untapped = middleware();
    untapped.advance(at(1000));
    assert_eq!(untapped.poll_scan(), None);

    let mut tapped = middleware();
    tapped.tap_scans();
    let mut told = Vec::new();
    for moment in 0..=20 {
        // Twice as often as the lidar turns.
        tapped.advance(at(50 * moment));
        told.extend(std::iter::from_fn(|| tapped.poll_scan()));
    }
    let of = |robot: &str| {
        told.iter().filter(|scan| scan.robot == robot).map(|s| (s.at, s.scan.at)).collect::<Vec<_>>()
    };
    // The first ray of a turn is cast after the first step of its five.
    let expected: Vec<_> = (1..=10).map(|turn| (at(100 * turn), at(100 * turn - 80))).collect();
    assert_eq!(of("robot1"), expected);
    assert_eq!(of("idle"), expected);
}

#[test]
fn halted_robot_stands_still_until_it_is_released() {
    let mut middleware = middleware();
    let robot = id("robot1");
    let forward = Velocity::planar(0.3, 0.0);
    middleware.advance(at(0));
    middleware.instruct(at(0), &robot, forward, 1).unwrap();
    middleware.advance(at(500));
    let walked = middleware.sensors(&robot).unwrap().pose.x;
    assert!(walked > 1.05, "{walked}");
    middleware.halt(at(500), &robot, true).unwrap();
    assert_eq!(middleware.instruct(at(600), &robot, forward, 1), Err(MoveError::Halted(robot.clone())));
    let packet = position(&mut middleware, at(600)).unwrap();
    middleware.receive(at(600), &robot, SERVER, &NavigationPacket::answering(&packet, 1, to_twist(forward)));
    let samples = events(&mut middleware);
    let measured =
        |stamped: &Stamped| matches!(&stamped.event, Event::ServiceTime(time) if time.took.is_some());
    assert!(samples.iter().any(measured), "its service is measured all the same");
    middleware.advance(at(2_000));
    let stopped = middleware.sensors(&robot).unwrap();
    assert!(stopped.velocity.linear == 0.0 && stopped.pose.x < walked + 0.2, "{stopped:?}");
    middleware.halt(at(2_000), &robot, false).unwrap();
    middleware.instruct(at(2_000), &robot, forward, 1).unwrap();
    middleware.advance(at(2_500));
    assert!(middleware.sensors(&robot).unwrap().pose.x > stopped.pose.x + 0.05);
    assert_eq!(middleware.halt(at(2_500), &id("nobody"), true), Err(MoveError::UnknownRobot(id("nobody"))));
}

/// Returns the goal events: state and x of the goal.
fn goals(middleware: &mut RobotMiddleware) -> Vec<(GoalState, f64)> {
    let told = events(middleware).into_iter().filter_map(|stamped| match stamped.event {
        Event::Goal(goal) => Some((goal.state, goal.goal.x)),
        _ => None,
    });
    told.collect()
}

#[test]
fn goal_is_reported_until_it_ends_and_then_the_robot_stands() {
    let mut middleware = middleware();
    let robot = id("robot1");
    let (near, far) = (Position::new(2.0, 1.0), Position::new(4.0, 1.0));
    let mut now = 0;
    let mut answered = |middleware: &mut RobotMiddleware, headway: Option<Headway>| {
        now += 200;
        middleware.advance(at(now));
        let packet = position(middleware, at(now)).unwrap();
        let walks = NavigationPacket::answering(&packet, 1, to_twist(Velocity::planar(0.3, 0.0)));
        middleware.receive(at(now), &robot, SERVER, &NavigationPacket { headway, ..walks });
        packet.goal
    };
    use GoalState::{Canceled, Failed, Progress, Reached, Replaced, Set};
    assert_eq!(answered(&mut middleware, None), None);
    middleware.navigate_to(at(200), &id("robot1"), Some(near)).unwrap();
    middleware.navigate_to(at(200), &id("robot1"), Some(far)).unwrap();
    assert_eq!(goals(&mut middleware), [(Set, 2.0), (Replaced, 2.0), (Set, 4.0)]);
    for _ in 0..12 {
        assert_eq!(answered(&mut middleware, Some(Headway::Left(3.0))), Some(far));
    }
    assert_eq!(goals(&mut middleware), [(Progress, 4.0); 2], "once a second");
    for _ in 0..8 {
        assert_eq!(answered(&mut middleware, Some(Headway::Arrived)), Some(far));
    }
    assert_eq!(goals(&mut middleware), [(Reached, 4.0)]);
    assert_eq!(middleware.sensors(&id("robot1")).unwrap().velocity, Velocity::default());
    // It stands, whatever answers say, until its goal changes.
    for _ in 0..3 {
        answered(&mut middleware, Some(Headway::Left(1.0)));
    }
    assert_eq!(middleware.sensors(&id("robot1")).unwrap().velocity, Velocity::default());
    middleware.navigate_to(at(5000), &id("robot1"), Some(near)).unwrap();
    let why = Headway::Blocked("a wall is there".to_owned());
    answered(&mut middleware, Some(why.clone()));
    answered(&mut middleware, Some(why));
    assert_eq!(goals(&mut middleware), [(Set, 2.0), (Failed, 2.0)]);
    middleware.navigate_to(at(5400), &id("robot1"), None).unwrap();
    assert_eq!(goals(&mut middleware), [], "it ended before");
    middleware.navigate_to(at(5400), &id("robot1"), Some(near)).unwrap();
    middleware.navigate_to(at(5400), &id("robot1"), None).unwrap();
    assert_eq!(goals(&mut middleware), [(Set, 2.0), (Canceled, 2.0)]);
    assert_eq!(answered(&mut middleware, None), None);
    answered(&mut middleware, None);
    middleware.advance(at(now));
    assert!(middleware.sensors(&id("robot1")).unwrap().velocity.linear > 0.05, "it walks again");
}

#[test]
fn unreachable_goals_are_rejected_with_the_reason() {
    let mut middleware = middleware();
    let mut refused = |robot: &str, goal: Position| {
        middleware.navigate_to(at(0), &id(robot), Some(goal)).unwrap_err().to_string()
    };
    let there = Position::new(2.0, 2.0);
    assert_eq!(refused("nobody", there), "there is no robot `nobody`");
    assert_eq!(refused("idle", there), "no navigation VNF serves robot `idle`, and nobody else takes goals");
    let cannot = |goal: Position| format!("robot `robot1` cannot go to {goal}: ");
    for (goal, reason) in [
        (Position::new(2.0, -0.02), "it is in a wall"),
        (Position::new(20.0, 2.0), "it is off the map"),
        (Position::new(2.0, 0.1), "it is 0.10 m from an obstacle, too near for the robot"),
        (there.at_height(1.0), "no TurtleBot 2 leaves the floor"),
        (there.at_height(-1.0), "it is below the floor"),
        (Position::new(f64::NAN, 0.0), "it is no place within 1000000 m"),
        (Position::new(1e7, 0.0), "it is no place within 1000000 m"),
    ] {
        assert_eq!(refused("robot1", goal), cannot(goal) + reason);
    }
    assert_eq!(goals(&mut middleware), []);
}

#[test]
fn robot_with_a_goal_has_not_finished() {
    let mut middleware = middleware();
    let robot = id("robot1");
    middleware.instruct(at(0), &robot, Velocity::default(), 3).unwrap();
    assert!(middleware.finished());
    middleware.navigate_to(at(1000), &robot, Some(Position::new(2.0, 1.0))).unwrap();
    assert!(!middleware.finished());
    middleware.advance(at(1200));
    let packet = position(&mut middleware, at(1200)).unwrap();
    assert_eq!((packet.waypoint, packet.goal), (3, Some(Position::new(2.0, 1.0))));
    middleware.navigate_to(at(1300), &robot, None).unwrap();
    assert!(middleware.finished());
    middleware.advance(at(1600));
    assert_eq!(position(&mut middleware, at(1600)), None);
}

/// A driver that passes on its commands.
struct Probe(NodeId, std::sync::mpsc::Sender<Velocity>);

impl RobotDriver for Probe {
    fn robot(&self) -> &NodeId {
        &self.0
    }
    fn command_timeout(&self) -> Duration {
        ms(600)
    }
    fn advance(&mut self, _now: Timestamp) {}
    fn command(&mut self, _now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError> {
        self.1.send(velocity).unwrap();
        Ok(velocity)
    }
    fn stop(&mut self, _now: Timestamp) {
        self.1.send(Velocity::default()).unwrap();
    }
    fn sensors(&self) -> SensorData {
        let pose = Pose::planar(0.0, 0.0, 0.0, [0.0; 9], PoseSource::Odometry);
        let velocity = Velocity::default();
        SensorData { pose, odometry: pose, velocity, bumper: false, nearest_obstacle_m: None }
    }
    fn scan(&self) -> Option<&Scan> {
        None
    }
}

#[test]
fn speed_limit_slows_instructions_and_answers_on_the_same_curve() {
    let (commands, received) = std::sync::mpsc::channel();
    let robot = id("robot1");
    let service = ServiceEndpoint::new(
        ServiceId::new("navigation").unwrap(),
        &walk("robot1", &[(1.0, 1.0), (3.0, 1.0)]),
        ms(600),
        &RobotClock::default(),
        1,
    );
    let mut middleware = RobotMiddleware::new(ms(100), Nonces::seeded(1));
    middleware.add(Box::new(Probe(robot.clone(), commands)), Some(service));
    connect(&mut middleware);
    let wanted = Velocity { linear: 0.3, vertical: 0.4, angular: 1.0 };
    let mut now = 0;
    let mut follows = |middleware: &mut RobotMiddleware| {
        now += 200;
        middleware.instruct(at(now), &robot, wanted, 1).unwrap();
        let packet = position(middleware, at(now)).unwrap();
        middleware.receive(
            at(now),
            &robot,
            SERVER,
            &NavigationPacket::answering(&packet, 1, to_twist(wanted)),
        );
        [received.try_recv().unwrap(), received.try_recv().unwrap()]
    };
    assert_eq!(follows(&mut middleware), [wanted; 2]);
    middleware.limit_speed(at(0), &robot, Some(0.25)).unwrap();
    assert_eq!(follows(&mut middleware), [wanted.scaled(0.5); 2]);
    middleware.limit_speed(at(0), &robot, Some(0.5)).unwrap();
    assert_eq!(follows(&mut middleware), [wanted; 2], "it is as fast");
    for wrong in [-0.1, f64::NAN, f64::INFINITY] {
        let refused = middleware.limit_speed(at(0), &robot, Some(wrong));
        assert!(matches!(refused, Err(MoveError::NotALimit(_))), "{refused:?}");
    }
    assert_eq!(follows(&mut middleware), [wanted; 2]);
    middleware.limit_speed(at(0), &robot, None).unwrap();
    assert_eq!(follows(&mut middleware), [wanted; 2]);
    assert!(!events(&mut middleware).iter().any(|s| matches!(s.event, Event::Notice { .. })));
    let unknown = middleware.limit_speed(at(0), &id("nobody"), None);
    assert_eq!(unknown, Err(MoveError::UnknownRobot(id("nobody"))));
}

#[test]
fn speed_limit_of_0_stops_a_robot_at_once_and_keeps_it_from_turning() {
    let mut middleware = middleware();
    let robot = id("robot1");
    let limits = |middleware: &mut RobotMiddleware| -> Vec<_> {
        let contexts = events(middleware).into_iter().filter_map(|stamped| match stamped.event {
            Event::Robot(context) if context.robot == robot => Some(context.speed_limit_mps),
            _ => None,
        });
        contexts.collect()
    };
    middleware.advance(at(0));
    middleware.instruct(at(0), &robot, Velocity::planar(0.3, 0.0), 1).unwrap();
    middleware.advance(at(400));
    assert_eq!(limits(&mut middleware), [None; 2]);
    middleware.limit_speed(at(400), &robot, Some(0.0)).unwrap();
    middleware.advance(at(500));
    let slower = middleware.sensors(&robot).unwrap().velocity.linear;
    assert!(slower < 0.17, "{slower}");
    middleware.instruct(at(1500), &robot, Velocity::planar(0.0, 1.0), 1).unwrap();
    middleware.advance(at(2000));
    assert_eq!(middleware.sensors(&robot).unwrap().velocity, Velocity::default());
    assert_eq!(limits(&mut middleware), [Some(0.0); 2]);
}

#[test]
fn localized_robot_reports_its_estimate_and_the_radio_uses_its_true_position() {
    let mut testbed = testbed();
    let localization = Service {
        id: ServiceId::new("localization").unwrap(),
        vnfs: testbed.services[0]
            .vnfs
            .iter()
            .cloned()
            .map(|mut vnf| {
                if vnf.program == Program::Navigation {
                    vnf.program = Program::Localization;
                }
                vnf
            })
            .collect(),
        ..testbed.services[0].clone()
    };
    // The order of services does not matter.
    testbed.services.insert(0, localization);
    let mut middleware = simulated(&testbed, 1);
    let (mut scans, mut measured, mut farthest) = (Vec::new(), Vec::new(), 0.0_f64);
    for now in (0..8000).step_by(50) {
        middleware.advance(at(now));
        while let Some(datagram) = middleware.poll_transmit(at(now)) {
            let Ok(position) = PositionPacket::decode(&datagram.bytes) else {
                scans.push(ScanPacket::decode(&datagram.bytes).unwrap());
                continue;
            };
            assert_eq!(position.pose, to_pose(&middleware.sensors(&id("robot1")).unwrap().pose));
            let velocity = Velocity::planar(0.3, 0.1);
            let answer = NavigationPacket::answering(&position, 1, to_twist(velocity));
            assert_eq!(middleware.poll_transmit(at(now)), None, "a position packet is under way");
            middleware.receive(at(now), &id("robot1"), SERVER, &answer);
        }
        let told = events(&mut middleware);
        measured.extend(service_times(&told).into_iter().cloned());
        for stamped in &told {
            let Event::Robot(context) = &stamped.event else { continue };
            if context.robot == id("robot1") {
                let truth = middleware.driver(&context.robot).unwrap().truth().unwrap();
                let pose = context.sensors.pose;
                let distance = (pose.x - truth.x).hypot(pose.y - truth.y);
                let error = context.localization_error_m.unwrap();
                assert!((error - distance).abs() < 1e-9, "{error} instead of {distance}");
                farthest = farthest.max(error);
            } else {
                assert_eq!(context.localization_error_m, None, "no VNF localizes it");
            }
        }
    }
    assert!(farthest > 0.0);
    let (unanswered, answered): (Vec<_>, Vec<_>) = measured.iter().partition(|time| time.took.is_none());
    assert!(answered.len() > 30 && answered.iter().all(|time| time.service.as_str() == "navigation"));
    // Scans get no answers. Those of the last three seconds are under way.
    let given_up: Vec<_> = scans.iter().filter(|scan| scan.emitted <= at(4950)).collect();
    assert!(unanswered.iter().all(|time| time.service.as_str() == "localization"));
    let emitted: Vec<_> = unanswered.iter().map(|time| (time.sequence, time.emitted)).collect();
    assert_eq!(emitted, given_up.iter().map(|scan| (scan.sequence, scan.emitted)).collect::<Vec<_>>());
    assert!((8..12).contains(&scans.len()), "{} scans", scans.len());
    let believed = middleware.sensors(&id("robot1")).unwrap().pose;
    let truth = middleware.driver(&id("robot1")).unwrap().truth().unwrap();
    assert_eq!((believed.source, truth.source), (PoseSource::Localization, PoseSource::Simulator));
    assert_ne!(believed.position(), truth.position());
    let positions: BTreeMap<_, _> = middleware.positions().collect();
    assert_eq!(positions[&id("robot1")], truth.position());
    // No VNF localizes the other robot.
    assert_eq!(middleware.sensors(&id("idle")).unwrap().pose.source, PoseSource::Simulator);
    let errors: Vec<_> =
        middleware.localization_errors().map(|(robot, errors)| (robot.clone(), errors.len())).collect();
    assert_eq!(errors, [(id("robot1"), 80)]);
    assert_eq!(middleware.localization_errors().next().unwrap().1.farthest(), farthest);
}
