use cotorra_graph::{NodeId, PoseSource};
use cotorra_plugin::{
    convert::{from_pose, to_twist},
    wire::Headway,
};

use super::*;
use crate::{
    COMMAND_TIMEOUT,
    fixtures::{SERVER, id, walk},
};

fn endpoint(seed: u64) -> ServiceEndpoint {
    let walk = walk("robot1", &[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]);
    ServiceEndpoint::new(
        ServiceId::new("navigation").unwrap(),
        &walk,
        COMMAND_TIMEOUT,
        &RobotClock { drift_ppm: 0.0, ..RobotClock::default() },
        seed,
    )
}

fn route() -> Route {
    Route { attachment: Some(id("R1")), servers: vec![(id("cloud"), Some(SERVER))] }
}

fn pose() -> Pose {
    Pose::planar(1.0, 2.0, 0.5, [0.0; 9], PoseSource::Simulator)
}

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Emits the next packet when it is due.
fn emit(endpoint: &mut ServiceEndpoint) -> PositionPacket {
    emit_at(endpoint, endpoint.beat.next()).unwrap()
}

fn emit_at(endpoint: &mut ServiceEndpoint, now: Timestamp) -> Option<PositionPacket> {
    let mut nonces = Nonces::seeded(endpoint.beat.next().as_nanos());
    endpoint.emit(now, &pose(), route(), &mut nonces).map(|sent| sent.packet)
}

fn answer(position: &PositionPacket, waypoint: u32) -> NavigationPacket {
    NavigationPacket::answering(position, waypoint, to_twist(Velocity::planar(0.3, 0.1)))
}

#[test]
fn packets_start_at_a_phase_of_the_seed_and_follow_the_interval() {
    let phases: Vec<Timestamp> = (0..50).map(|seed| endpoint(seed).next_deadline().unwrap()).collect();
    assert!(phases.iter().all(|phase| *phase < Timestamp::ZERO + ms(200)));
    assert!(phases.iter().any(|phase| *phase > Timestamp::ZERO + ms(150)));
    assert_eq!(phases[0], endpoint(0).next_deadline().unwrap());

    let mut endpoint = endpoint(1);
    let first = emit(&mut endpoint);
    let second = emit(&mut endpoint);
    assert_eq!((first.sequence, second.sequence), (0, 1));
    assert_eq!(second.emitted.since(first.emitted), ms(200));
    assert!(emit_at(&mut endpoint, second.emitted + ms(199)).is_none());
}

#[test]
fn packet_has_robot_waypoint_and_pose() {
    let packet = emit(&mut endpoint(1));
    assert_eq!((packet.robot.as_str(), packet.waypoint), ("robot1", 0));
    assert_eq!(from_pose(&packet.pose, PoseSource::Simulator), pose());
}

#[test]
fn answers_from_before_a_change_of_goal_are_measured_but_not_followed() {
    let mut endpoint = endpoint(1);
    let goal = Some(Position::new(1.0, 1.0));
    let walks = emit(&mut endpoint);
    let set: Vec<_> = endpoint.set_goal(walks.emitted, goal).collect();
    assert_eq!((set.len(), set[0].state), (1, GoalState::Set));
    let receive = |endpoint: &mut ServiceEndpoint, packet: &PositionPacket, headway: Option<Headway>| {
        let answer = NavigationPacket { headway, ..answer(packet, 1) };
        endpoint.receive(packet.emitted + ms(20), SERVER, &answer)
    };
    let done = receive(&mut endpoint, &walks, None).unwrap();
    assert_eq!((done.velocity, done.service_time.took), (None, Some(ms(20))));
    assert_eq!(endpoint.waypoint(), 0);

    let asked = emit(&mut endpoint);
    assert_eq!((walks.goal, asked.goal), (None, goal));
    // An answer that ignores the goal would follow the walk.
    assert_eq!(receive(&mut endpoint, &asked, None), Err(AnswerError::Invalid));
    let another = Some(Position::new(2.0, 1.0));
    let told: Vec<_> = endpoint.set_goal(asked.emitted, another).map(|goal| goal.state).collect();
    assert_eq!(told, [GoalState::Replaced, GoalState::Set]);
    let done = receive(&mut endpoint, &asked, Some(Headway::Arrived)).unwrap();
    assert_eq!((done.velocity, done.goal), (None, None), "it is not at the new one");

    let asked = emit(&mut endpoint);
    let done = receive(&mut endpoint, &asked, Some(Headway::Left(1.0))).unwrap();
    assert_eq!(done.velocity, Some(Velocity::planar(0.3, 0.1)));
    assert_eq!(endpoint.waypoint(), 0, "the walk waits where it was left");
    let asked = emit(&mut endpoint);
    assert_eq!(
        endpoint.set_goal(asked.emitted, None).map(|goal| goal.state).next(),
        Some(GoalState::Canceled)
    );
    assert_eq!(receive(&mut endpoint, &asked, Some(Headway::Left(1.0))).unwrap().velocity, None);
    let walks = emit(&mut endpoint);
    assert_eq!(receive(&mut endpoint, &walks, Some(Headway::Arrived)), Err(AnswerError::Invalid));
    assert!(receive(&mut endpoint, &walks, None).unwrap().velocity.is_some());
    assert_eq!(endpoint.waypoint(), 1);
}

#[test]
fn missed_packets_are_skipped() {
    let mut endpoint = endpoint(1);
    let due = endpoint.next_deadline().unwrap();
    let late = emit_at(&mut endpoint, due + ms(450)).unwrap();
    assert_eq!(late.emitted, due + ms(450));
    assert!(emit_at(&mut endpoint, due + ms(599)).is_none());
    assert_eq!(emit_at(&mut endpoint, due + ms(600)).unwrap().sequence, 1);
}

#[test]
fn packets_that_were_due_and_not_emitted_are_samples_without_an_answer() {
    let mut endpoint = endpoint(1);
    let first = emit(&mut endpoint);
    let now = first.emitted + ms(3050);
    let (missed, uncounted) = endpoint.miss(now, &route());
    let after = emit_at(&mut endpoint, now).unwrap();
    let due: Vec<_> = missed.iter().map(|sample| sample.emitted.since(first.emitted)).collect();
    assert_eq!(due, (1..15).map(|n| ms(200 * n)).collect::<Vec<_>>());
    assert_eq!(missed.iter().map(|sample| sample.sequence).collect::<Vec<_>>(), (1..15).collect::<Vec<_>>());
    assert!(missed.iter().all(|sample| sample.took.is_none() && sample.server == id("cloud")));
    assert_eq!((after.sequence, after.emitted, uncounted), (15, now, 0));
    assert_eq!(endpoint.beat.next(), first.emitted + ms(3200), "it keeps its pace");
}

#[test]
fn packets_that_nobody_waits_for_are_not_missed() {
    let mut endpoint = endpoint(1);
    let due = endpoint.next_deadline().unwrap();
    let missed = |endpoint: &mut ServiceEndpoint, now| endpoint.miss(now, &route()).0.len();
    assert_eq!(missed(&mut endpoint, due + ms(5000)), 0, "the first one is only late");
    emit_at(&mut endpoint, due + ms(5000)).unwrap();
    // A packet that is emitted on time, or late by less than an interval, leaves nothing out.
    let next = endpoint.beat.next();
    assert_eq!((missed(&mut endpoint, next), missed(&mut endpoint, next + ms(199))), (0, 0));
    // The robot had a fault.
    endpoint.skip(next + ms(10_000));
    assert_eq!(missed(&mut endpoint, next + ms(20_000)), 0);
    let packet = emit_at(&mut endpoint, next + ms(20_000)).unwrap();
    // It had walked, and goes on.
    endpoint.reach(3);
    endpoint.reach(1);
    assert_eq!(missed(&mut endpoint, packet.emitted + ms(10_000)), 0);
}

#[test]
fn missed_packets_are_bounded() {
    let mut endpoint = endpoint(1);
    let first = emit(&mut endpoint);
    let (missed, uncounted) = endpoint.miss(first.emitted + ms(200) * 20_001, &route());
    assert_eq!((missed.len(), uncounted), (ServiceEndpoint::MOST_MISSED, 10_000));
    assert!(emit_at(&mut endpoint, first.emitted + ms(200) * 20_001).is_some());
}

#[test]
fn answer_is_measured_on_its_packets_route_and_followed() {
    let mut endpoint = endpoint(1);
    let packet = emit(&mut endpoint);
    let answer = endpoint.receive(packet.emitted + ms(11), SERVER, &answer(&packet, 2)).unwrap();
    let measured = answer.service_time;
    assert_eq!((measured.sequence, measured.emitted, measured.took), (0, packet.emitted, Some(ms(11))));
    assert_eq!((measured.attachment, measured.server), (Some(id("R1")), NodeId::new("cloud").unwrap()));
    assert_eq!(answer.velocity, Some(Velocity::planar(0.3, 0.1)));
    assert_eq!(endpoint.waypoint(), 2);
    assert!(endpoint.expire(packet.emitted + ms(5000)).is_none());
}

#[test]
fn duplicate_answer_changes_nothing() {
    let mut endpoint = endpoint(1);
    let packet = emit(&mut endpoint);
    endpoint.receive(packet.emitted + ms(11), SERVER, &answer(&packet, 2)).unwrap();
    let again = endpoint.receive(packet.emitted + ms(12), SERVER, &answer(&packet, 1));
    assert_eq!(again, Err(AnswerError::Repeated));
    assert_eq!(endpoint.waypoint(), 2);
}

#[test]
fn overtaken_answer_is_measured_but_not_followed() {
    let mut endpoint = endpoint(1);
    let (first, second) = (emit(&mut endpoint), emit(&mut endpoint));
    endpoint.receive(second.emitted + ms(10), SERVER, &answer(&second, 2)).unwrap();
    let stale = endpoint.receive(second.emitted + ms(20), SERVER, &answer(&first, 1)).unwrap();
    assert_eq!(stale.service_time.took, Some(ms(220)));
    assert_eq!(stale.velocity, None);
    assert_eq!(endpoint.waypoint(), 2);
}

#[test]
fn packet_without_an_answer_in_time_is_given_up() {
    let mut endpoint = endpoint(1);
    let packet = emit(&mut endpoint);
    assert!(endpoint.expire(packet.emitted + ms(599)).is_none());
    let missing = endpoint.expire(packet.emitted + ms(600)).unwrap();
    assert_eq!((missing.sequence, missing.took), (0, None));
    assert!(endpoint.expire(packet.emitted + ms(600)).is_none());
    // A late answer is not followed.
    let late = endpoint.receive(packet.emitted + ms(700), SERVER, &answer(&packet, 1));
    assert_eq!(late, Err(AnswerError::Late));
    assert_eq!(endpoint.waypoint(), 0);
}

#[test]
fn answer_at_the_timeout_is_late_before_and_after_expiry() {
    let mut endpoint = endpoint(1);
    let packet = emit(&mut endpoint);
    let late = endpoint.receive(packet.emitted + ms(600), SERVER, &answer(&packet, 1));
    assert_eq!(late, Err(AnswerError::Late));
    assert_eq!(endpoint.expire(packet.emitted + ms(600)).unwrap().took, None);
}

#[test]
fn deadlines_are_those_of_packets_and_answers() {
    let mut endpoint = endpoint(1);
    let packet = emit(&mut endpoint);
    assert_eq!(endpoint.next_deadline(), Some(packet.emitted + ms(200)));
    emit(&mut endpoint);
    emit(&mut endpoint);
    assert_eq!(endpoint.next_deadline(), Some(packet.emitted + ms(600)));
}

#[test]
fn answers_with_wrong_sequence_nonce_time_or_sender_are_rejected() {
    let mut endpoint = endpoint(1);
    let packet = emit(&mut endpoint);
    let right = answer(&packet, 1);
    let elsewhere = SocketAddrV4::new(*SERVER.ip(), SERVER.port() + 1);
    for (from, wrong, rejection) in [
        (SERVER, NavigationPacket { sequence: 9, ..right.clone() }, AnswerError::Unknown),
        (SERVER, NavigationPacket { nonce: packet.nonce ^ 1, ..right.clone() }, AnswerError::Forged),
        (SERVER, NavigationPacket { emitted: packet.emitted + ms(1), ..right.clone() }, AnswerError::Forged),
        (elsewhere, right.clone(), AnswerError::Forged),
    ] {
        assert_eq!(endpoint.receive(packet.emitted + ms(4), from, &wrong), Err(rejection));
        assert_eq!(endpoint.waypoint(), 0);
    }
    assert!(endpoint.receive(packet.emitted + ms(5), SERVER, &right).unwrap().velocity.is_some());
}

/// The attack of a node that cannot see the robot's packets.
#[test]
fn sweep_of_sequence_numbers_moves_nothing() {
    let mut endpoint = endpoint(1);
    let packets: Vec<_> = (0..40).map(|_| emit(&mut endpoint)).collect();
    let now = packets[39].emitted + ms(5);
    while endpoint.expire(now).is_some() {}
    for sequence in 0..10_000 {
        let forged = NavigationPacket { sequence, nonce: 0, ..answer(&packets[39], 1) };
        let rejection = endpoint.receive(now, SERVER, &forged).unwrap_err();
        let expected = if sequence < 40 { AnswerError::Forged } else { AnswerError::Unknown };
        assert_eq!(rejection, expected);
    }
    assert!(endpoint.receive(now, SERVER, &answer(&packets[39], 1)).unwrap().velocity.is_some());
}

#[test]
fn walk_ends_once_and_packets_end_with_it() {
    let mut endpoint = endpoint(1);
    let packet = emit(&mut endpoint);
    let beyond = endpoint.receive(packet.emitted + ms(5), SERVER, &answer(&packet, 4)).unwrap();
    assert_eq!(beyond.velocity, None);
    let packet = emit(&mut endpoint);
    assert!(endpoint.receive(packet.emitted + ms(5), SERVER, &answer(&packet, 3)).unwrap().finished);
    assert!(endpoint.finished());
    assert_eq!(endpoint.next_deadline(), None);
    assert!(emit_at(&mut endpoint, packet.emitted + ms(5000)).is_none());
    let again = endpoint.receive(packet.emitted + ms(6), SERVER, &answer(&packet, 3));
    assert_eq!(again, Err(AnswerError::Repeated));
}

/// The socket of another server.
const OTHER: SocketAddrV4 = SocketAddrV4::new(std::net::Ipv4Addr::new(10, 0, 0, 99), 7711);

/// Emits a packet to two instances, and returns it as each receives it.
fn emit_to_both(endpoint: &mut ServiceEndpoint) -> [PositionPacket; 2] {
    let servers = vec![(id("cloud"), Some(SERVER)), (id("edge"), Some(OTHER))];
    let route = Route { attachment: Some(id("R1")), servers };
    let mut nonces = Nonces::seeded(endpoint.beat.next().as_nanos());
    let Request { packet, copies } =
        endpoint.emit(endpoint.beat.next(), &pose(), route, &mut nonces).unwrap();
    assert_eq!([copies[0].0, copies[1].0], [SERVER, OTHER]);
    [copies[0].1, copies[1].1].map(|nonce| PositionPacket { nonce, ..packet.clone() })
}

#[test]
fn first_answer_of_several_counts_and_the_others_are_redundant() {
    let mut endpoint = endpoint(1);
    let [first, second] = emit_to_both(&mut endpoint);
    assert_ne!(first.nonce, second.nonce, "nobody answers for another");
    let [by_first, by_second] = [&first, &second].map(|packet| answer(packet, 1));
    let at = |millis| first.emitted + ms(millis);
    // A nonce is valid for one instance only.
    assert_eq!(endpoint.receive(at(5), SERVER, &by_second), Err(AnswerError::Forged));
    assert_eq!(endpoint.receive(at(5), OTHER, &by_first), Err(AnswerError::Forged));
    let taken = endpoint.receive(at(7), OTHER, &by_second).unwrap();
    assert_eq!((taken.service_time.took, taken.service_time.server), (Some(ms(7)), id("edge")));
    assert!(taken.velocity.is_some() && endpoint.is_quiet());
    assert_eq!(endpoint.receive(at(8), OTHER, &by_second), Err(AnswerError::Repeated));
    assert_eq!(endpoint.receive(at(8), OTHER, &by_first), Err(AnswerError::Repeated), "from elsewhere");
    assert_eq!(endpoint.receive(at(9), SERVER, &by_first), Err(AnswerError::Redundant));
    assert_eq!(endpoint.receive(at(9), SERVER, &by_first), Err(AnswerError::Repeated));
    let invented = NavigationPacket { nonce: !first.nonce, ..by_first };
    assert_eq!(endpoint.receive(at(9), SERVER, &invented), Err(AnswerError::Forged));
}

#[test]
fn packet_without_any_answer_of_several_is_given_up_once() {
    let mut endpoint = endpoint(1);
    let [first, second] = emit_to_both(&mut endpoint);
    let given_up = endpoint.expire(first.emitted + COMMAND_TIMEOUT).unwrap();
    assert_eq!((given_up.took, given_up.server), (None, id("cloud")), "the one that is preferred");
    assert_eq!(endpoint.expire(first.emitted + COMMAND_TIMEOUT), None);
    for (packet, from) in [(first, SERVER), (second, OTHER)] {
        let late = packet.emitted + COMMAND_TIMEOUT;
        assert_eq!(endpoint.receive(late, from, &answer(&packet, 1)), Err(AnswerError::Late));
    }
}
