use std::{collections::VecDeque, net::SocketAddrV4, sync::Arc, time::Duration};

use cotorra_graph::{Node, NodeId, PoseSource, Testbed, Timestamp, Velocity};
use cotorra_graph_testing as base;
use cotorra_plugin::wire::{PosePacket, ScanPacket};

use super::*;
use crate::{
    answer_error::AnswerError,
    driver::RobotDriver,
    exchange::Route,
    fixtures::{SERVER, id, robot, room, walk},
    nonce::Nonces,
    request::Request,
    simulated::SimulatedRobot,
    world::World,
};
use cotorra_vnfs::{LocalizationVnf, PacketError};

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

/// A testbed with a robot in a room, without navigation.
fn testbed() -> Testbed {
    let graph = base::graph(vec![robot("robot1", None)], Vec::new());
    Testbed { map: Some(room(6.0, 4.0)), ..base::testbed(graph) }
}

fn vnf() -> LocalizationVnf {
    LocalizationVnf::new(&testbed(), &id("robot1"), 1).unwrap()
}

fn route() -> Route {
    Route { attachment: Some(id("R1")), servers: vec![(id("edge"), Some(SERVER))] }
}

/// Sends the scan that is due at this time.
fn emit(endpoint: &mut LocalizationEndpoint, ms: u64, quiet: bool) -> Option<ScanPacket> {
    endpoint.emit(at(ms), quiet, route(), &mut Nonces::seeded(ms)).map(|sent| sent.packet)
}

/// A robot that drives in a circle and is observed every 100 ms, as by the middleware.
struct Drive {
    robot: SimulatedRobot,
    endpoint: LocalizationEndpoint,
    ms: u64,
}

impl Drive {
    fn new(seed: u64) -> Self {
        let node: Node = robot("robot1", None);
        let world = Arc::new(World::new(&room(6.0, 4.0)));
        let walk = walk("robot1", &[(3.0, 1.0), (5.0, 1.0)]);
        let robot = SimulatedRobot::new(&node, Some(&walk), world, seed).unwrap();
        let sensors = robot.sensors();
        let service = "localization".parse().unwrap();
        let model = RobotModel::Turtlebot2;
        let endpoint =
            LocalizationEndpoint::new(service, id("robot1"), model, &sensors.pose, &sensors.odometry);
        Self { robot, endpoint, ms: 0 }
    }

    /// Drives on to the next observation, and returns the scan that is sent then.
    fn observe(&mut self) -> Option<ScanPacket> {
        self.observe_and_send(route()).map(|sent| sent.packet)
    }

    fn observe_and_send(&mut self, route: Route) -> Option<Request<ScanPacket>> {
        let circle = Velocity::planar(0.3, 0.3);
        self.robot.command(at(self.ms), circle).unwrap();
        self.ms += 100;
        self.robot.advance(at(self.ms));
        self.endpoint.observe(at(self.ms), &self.robot.sensors().odometry, self.robot.scan());
        self.endpoint.emit(at(self.ms), true, route, &mut Nonces::seeded(self.ms))
    }

    fn believed(&self) -> Pose {
        self.endpoint.pose(&self.robot.sensors().odometry)
    }

    fn error(&self) -> f64 {
        planar(&self.believed()).distance(planar(&self.robot.pose()))
    }

    fn spread(&self) -> f64 {
        let covariance = self.believed().covariance;
        (covariance[0] + covariance[4]).sqrt()
    }
}

/// Returns an instance's answer to a scan, encoded and decoded.
fn answered(vnf: &mut LocalizationVnf, packet: &ScanPacket) -> PosePacket {
    let (mut bytes, mut answer) = (Vec::new(), Vec::new());
    packet.encode(&mut bytes);
    vnf.answer(&bytes, &mut answer).unwrap();
    PosePacket::decode(&answer).unwrap()
}

#[test]
fn scan_is_sent_when_the_robot_has_moved_and_its_answer_is_used() {
    let (mut drive, mut vnf) = (Drive::new(1), vnf());
    let mut emitted = Vec::new();
    for _ in 0..600 {
        if let Some(packet) = drive.observe() {
            emitted.push(packet.emitted);
            let answer = answered(&mut vnf, &packet);
            drive.endpoint.receive(at(drive.ms), SERVER, &answer).unwrap();
        }
        assert_eq!(drive.believed().source, PoseSource::Localization);
        assert!(drive.error() < 0.15, "{} m off after {} ms", drive.error(), drive.ms);
        assert!(drive.spread() < 0.2 || emitted.len() < 3, "{} m", drive.spread());
    }
    // 0.25 m or 0.2 rad, whichever comes first: every 0.7 s at 0.3 rad/s.
    assert!((80..90).contains(&emitted.len()), "{}", emitted.len());
}

#[test]
fn without_answers_odometry_goes_on_with_growing_covariance() {
    let mut drive = Drive::new(1);
    let (mut headings, mut sent, start) = (Vec::new(), 0, drive.spread());
    for _ in 0..600 {
        sent += usize::from(drive.observe().is_some());
        headings.push(drive.believed().covariance[8]);
    }
    assert!(headings.windows(2).all(|pair| pair[0] <= pair[1]), "it never knows more of its heading");
    // 18 m, in circles.
    assert!(drive.spread() > 1.5 * start && drive.spread() < 2.0, "{}", drive.spread());
    assert!(drive.error() < 3.0 * drive.spread());
    assert!(sent > 80, "it goes on asking");
    assert!(drive.endpoint.trail.len() < 10, "{} marks", drive.endpoint.trail.len());
}

#[test]
fn standing_robot_asks_again_until_it_is_answered() {
    let mut drive = Drive::new(1);
    let mut look = |ms: u64| {
        drive.robot.advance(at(ms));
        drive.endpoint.observe(at(ms), &drive.robot.sensors().odometry, drive.robot.scan());
        emit(&mut drive.endpoint, ms, true)
    };
    let sent: Vec<_> = (0..=35).filter_map(|i| look(100 * i)).collect();
    assert_eq!(sent.iter().map(|packet| packet.emitted).collect::<Vec<_>>(), [100, 1100, 2100, 3100].map(at));
    // An answer to any of them is enough.
    let answer = answered(&mut vnf(), &sent[3]);
    drive.endpoint.receive(at(3500), SERVER, &answer).unwrap();
    let more = (36..80).filter_map(|i| {
        drive.robot.advance(at(100 * i));
        drive.endpoint.observe(at(100 * i), &drive.robot.sensors().odometry, drive.robot.scan());
        emit(&mut drive.endpoint, 100 * i, true)
    });
    assert_eq!(more.count(), 0);
}

#[test]
fn late_answer_counts_as_of_its_scan() {
    let (mut drive, mut vnf) = (Drive::new(1), vnf());
    let mut under_way: VecDeque<PosePacket> = VecDeque::new();
    let mut longest = 0;
    for _ in 0..600 {
        if let Some(packet) = drive.observe() {
            under_way.push_back(answered(&mut vnf, &packet));
        }
        longest = longest.max(drive.endpoint.trail.len());
        // Each answer takes 2 s, so that three scans are under way.
        while let Some(answer) =
            under_way.pop_front_if(|p| drive.ms >= p.emitted.as_nanos() / 1_000_000 + 2000)
        {
            drive.endpoint.receive(at(drive.ms), SERVER, &answer).unwrap();
        }
        assert!(drive.error() < 0.2, "{} m off after {} ms", drive.error(), drive.ms);
    }
    assert!(longest >= 3);
}

#[test]
fn overtaken_answer_is_measured_but_not_used() {
    let (mut drive, mut vnf) = (Drive::new(1), vnf());
    let mut next = || std::iter::repeat_with(|| drive.observe()).flatten().next().unwrap();
    let [first, second] = [next(), next()];
    let answers = [&first, &second].map(|packet| answered(&mut vnf, packet));
    let now = drive.ms + 30;
    let latest = drive.endpoint.receive(at(now), SERVER, &answers[1]).unwrap();
    assert_eq!((latest.sequence, latest.took), (1, Some(at(now).since(second.emitted))));
    let believed = drive.believed();
    let overtaken = drive.endpoint.receive(at(now + 5), SERVER, &answers[0]).unwrap();
    assert_eq!((overtaken.sequence, overtaken.took), (0, Some(at(now + 5).since(first.emitted))));
    assert_eq!(drive.believed(), believed);
    assert_eq!(drive.endpoint.expire(at(now + 10_000)), None, "each was measured");
}

#[test]
fn scan_without_an_answer_in_time_is_unanswered_once() {
    let (mut drive, mut vnf) = (Drive::new(1), vnf());
    let packet = std::iter::repeat_with(|| drive.observe()).flatten().next().unwrap();
    let sent = drive.ms;
    let deadline = at(sent + 3000);
    assert_eq!(drive.endpoint.next_deadline(true), Some(deadline));
    assert_eq!(drive.endpoint.expire(at(sent + 2999)), None);
    let missing = drive.endpoint.expire(deadline).unwrap();
    assert_eq!((missing.sequence, missing.emitted, missing.took), (0, at(sent), None));
    assert_eq!((missing.service.as_str(), missing.server.as_str()), ("localization", "edge"));
    assert_eq!(missing.attachment, Some(id("R1")));
    assert_eq!(drive.endpoint.expire(deadline), None);
    let late = drive.endpoint.receive(deadline, SERVER, &answered(&mut vnf, &packet));
    assert_eq!(late, Err(AnswerError::Late));
}

#[test]
fn instances_take_over_from_each_other() {
    let (mut drive, mut instances) = (Drive::new(1), [vnf(), vnf()]);
    for look in 0..900 {
        // Each serves for 10 s. The instances do not communicate.
        let serving = usize::from(look / 100 % 2 == 1);
        if let Some(packet) = drive.observe() {
            let answer = answered(&mut instances[serving], &packet);
            drive.endpoint.receive(at(drive.ms), SERVER, &answer).unwrap();
        }
        assert!(drive.error() < 0.15, "{} m off after {} ms", drive.error(), drive.ms);
    }
}

#[test]
fn rejected_answers_change_nothing() {
    let (mut drive, mut vnf) = (Drive::new(1), vnf());
    let packet = loop {
        if let Some(packet) = drive.observe() {
            break packet;
        }
    };
    let answer = answered(&mut vnf, &packet);
    let before = drive.believed();
    let mut impossible = answer.pose;
    impossible.covariance[4] = -1.0;
    let (now, elsewhere) = (at(drive.ms), SocketAddrV4::new(*SERVER.ip(), 9));
    for (now, from, wrong, rejection) in [
        (now, SERVER, PosePacket { sequence: packet.sequence + 1, ..answer }, AnswerError::Unknown),
        (now, SERVER, PosePacket { emitted: at(7), ..answer }, AnswerError::Forged),
        (now, SERVER, PosePacket { nonce: 8, ..answer }, AnswerError::Forged),
        (now, elsewhere, answer.clone(), AnswerError::Forged),
        (now, SERVER, PosePacket { pose: impossible, ..answer }, AnswerError::Invalid),
        (at(drive.ms + 3001), SERVER, answer.clone(), AnswerError::Late),
    ] {
        assert_eq!(drive.endpoint.receive(now, from, &wrong), Err(rejection));
        assert_eq!(drive.believed(), before);
    }
    drive.endpoint.receive(now, SERVER, &answer).unwrap();
    let after = drive.believed();
    assert_ne!(after, before);
    // A second answer is rejected.
    for again in [PosePacket { pose: impossible, ..answer.clone() }, answer] {
        assert_eq!(drive.endpoint.receive(now, SERVER, &again), Err(AnswerError::Repeated));
        assert_eq!(drive.believed(), after);
    }
}

#[test]
fn scan_waits_for_a_quiet_moment_up_to_a_limit() {
    let mut drive = Drive::new(1);
    let emitted = loop {
        drive.ms += 100;
        drive.robot.advance(at(drive.ms));
        drive.endpoint.observe(at(drive.ms), &drive.robot.sensors().odometry, drive.robot.scan());
        if drive.endpoint.next_deadline(true).is_some() {
            break drive.ms;
        }
    };
    let endpoint = &mut drive.endpoint;
    assert_eq!(endpoint.next_deadline(false), Some(at(emitted + 100)));
    assert_eq!(emit(endpoint, emitted + 99, false), None);
    let packet = emit(&mut endpoint.clone(), emitted + 30, true).unwrap();
    assert_eq!(packet.emitted, at(emitted + 30));
    assert!(emit(endpoint, emitted + 100, false).is_some());
    // Only the scan's patience is left.
    assert_eq!(endpoint.next_deadline(true), Some(at(emitted + 3100)));
}

#[test]
fn instance_answers_its_own_robot_in_order() {
    let (mut drive, mut vnf) = (Drive::new(1), vnf());
    let mut sent = Vec::new();
    while sent.len() < 2 {
        sent.extend(drive.observe());
    }
    let (mut bytes, mut answer) = (Vec::new(), Vec::new());
    assert!(matches!(vnf.answer(b"hello", &mut answer), Err(PacketError::Malformed(_))));
    let stranger = ScanPacket { robot: NodeId::new("robot2").unwrap(), ..sent[0].clone() };
    stranger.encode(&mut bytes);
    assert!(
        matches!(vnf.answer(&bytes, &mut answer), Err(PacketError::Stranger(robot)) if robot == "robot2")
    );
    let first = answered(&mut vnf, &sent[1]);
    assert_eq!(answered(&mut vnf, &sent[1]), first, "a packet that came twice");
    sent[0].encode(&mut bytes);
    assert!(matches!(vnf.answer(&bytes, &mut answer), Err(PacketError::Overtaken(0))));
}

#[test]
fn missing_robot_and_missing_map_are_errors() {
    let unknown = LocalizationVnf::new(&testbed(), &id("robot2"), 1).unwrap_err();
    assert_eq!(unknown.to_string(), "there is no robot `robot2`");
    let nowhere = Testbed { map: None, ..testbed() };
    let unknown = LocalizationVnf::new(&nowhere, &id("robot1"), 1).unwrap_err();
    assert_eq!(unknown.to_string(), "testbed `test` has no map");
}

#[test]
fn blind_scans_and_invalid_odometry_get_no_answer() {
    let (mut drive, mut vnf) = (Drive::new(1), vnf());
    let sent = loop {
        if let Some(packet) = drive.observe() {
            break packet;
        }
    };
    let (mut bytes, mut answer) = (Vec::new(), Vec::new());
    let mut told = |packet: &ScanPacket| {
        packet.encode(&mut bytes);
        vnf.answer(&bytes, &mut answer).unwrap_err().to_string()
    };
    let blind = ScanPacket { ranges: vec![0; sent.ranges.len()], ..sent.clone() };
    assert_eq!(told(&blind), "scan 0 has no beam that hit anything in reach");
    let nowhere = ScanPacket { odometry: [1e300, 0.0, 0.0], ..sent.clone() };
    assert!(told(&nowhere).ends_with("is not a valid pose: it is not finite, or beyond 1e7 m"));
    // The next valid scan is answered all the same.
    answered(&mut vnf, &sent);
}

#[test]
fn map_without_walls_or_free_space_is_an_error() {
    let map = |cell| {
        let cells = vec![cell; 100];
        cotorra_graph::OccupancyGrid::new(10, 10, 0.5, cotorra_graph::Position::default(), cells)
    };
    let told = |cell| {
        let testbed = Testbed { map: map(cell), ..testbed() };
        LocalizationVnf::new(&testbed, &id("robot1"), 1).unwrap_err().to_string()
    };
    let begin = "testbed `test` cannot localize `robot1`: the map has no ";
    assert_eq!(told(cotorra_graph::Cell::Free), format!("{begin}wall to locate a robot by"));
    let solid = told(cotorra_graph::Cell::Occupied);
    assert_eq!(solid, format!("{begin}free cell for a robot to stand on"));
}

#[test]
fn first_answer_of_several_instances_counts_and_the_other_is_redundant() {
    const OTHER: SocketAddrV4 = SocketAddrV4::new(std::net::Ipv4Addr::new(10, 0, 0, 99), 7712);
    let both =
        || Route { attachment: None, servers: vec![(id("edge"), Some(SERVER)), (id("fog"), Some(OTHER))] };
    let mut drive = Drive::new(1);
    let sent = std::iter::repeat_with(|| drive.observe_and_send(both())).flatten().next().unwrap();
    let now = at(drive.ms);
    let Request { packet, copies } = sent;
    let [by_first, by_second] =
        [copies[0].1, copies[1].1].map(|nonce| answered(&mut vnf(), &ScanPacket { nonce, ..packet.clone() }));
    assert_eq!(drive.endpoint.receive(now, SERVER, &by_second), Err(AnswerError::Forged));
    let sample = drive.endpoint.receive(now, OTHER, &by_second).unwrap();
    assert_eq!((sample.server.as_str(), sample.took), ("fog", Some(Duration::ZERO)));
    let believed = drive.believed();
    assert_eq!(drive.endpoint.receive(now, SERVER, &by_first), Err(AnswerError::Redundant));
    assert_eq!(drive.endpoint.receive(now, SERVER, &by_first), Err(AnswerError::Repeated));
    assert_eq!(drive.believed(), believed);
}
