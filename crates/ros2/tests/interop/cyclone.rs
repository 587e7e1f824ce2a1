//! The node against Cyclone DDS.

use std::time::Duration;

use cotorra_ros2::{
    Command, Qos,
    messages::{
        Clock, Header, LaserScan, MapMetaData, OccupancyGrid, Text, Time, Twist, TwistStamped, Vector3,
    },
};

use crate::peer::{Meeting, PATIENCE, contains, publishing_until_printed, scan, until};

/// Long enough for most messages.
const SOON: Duration = Duration::from_millis(50);

#[test]
fn cyclone_reads_scans_however_they_are_published() {
    // Reliable publishers are heard by who wants no more than best effort.
    for (ours, theirs) in [(Qos::SENSORS, "sensors"), (Qos::COMMANDS, "commands"), (Qos::COMMANDS, "sensors")]
    {
        let meeting = Meeting::new();
        let Some(peer) = meeting.cyclone("print", "LaserScan", "scan", theirs) else { return };
        let node = meeting.node("robot");
        let scans = node.publish::<LaserScan>("scan", ours).unwrap();
        publishing_until_printed(|| scans.publish(&scan()), &peer, "ranges=[1.5, inf, 2.25]");
        contains(&peer.output(), &["stamp=Time(sec=3, nanosec=9)", "frame_id='laser'", "range_max=12.0"]);
        assert_eq!(scans.subscribers(), 1);
    }
}

#[test]
fn cyclone_is_read_however_it_publishes() {
    for (ours, theirs) in [(Qos::SENSORS, "sensors"), (Qos::COMMANDS, "commands"), (Qos::SENSORS, "commands")]
    {
        let meeting = Meeting::new();
        let node = meeting.node("robot");
        let scans = node.subscribe::<LaserScan>("scan", ours).unwrap();
        let Some(peer) = meeting.cyclone("publish", "LaserScan", "scan", theirs) else { return };
        let scan = scans.recv_timeout(PATIENCE).unwrap();
        assert_eq!(scan.header.stamp, Time { sec: 5, nanosec: 7 });
        assert_eq!((scan.header.frame_id.as_str(), scan.range_max), ("from cyclone", 12.0));
        assert_eq!(scan.ranges, [1.5, f32::INFINITY, 2.25]);
        assert_eq!((scans.publishers(), scans.malformed()), (1, 0));
        drop(peer);
    }
}

#[test]
fn who_asks_for_more_than_is_offered_is_not_connected() {
    let meeting = Meeting::new();
    let Some(peer) = meeting.cyclone("publish", "LaserScan", "scan", "sensors") else { return };
    let node = meeting.node("robot");
    let reliable = node.subscribe::<LaserScan>("scan", Qos::COMMANDS).unwrap();
    let any = node.subscribe::<LaserScan>("scan", Qos::SENSORS).unwrap();
    any.recv_timeout(PATIENCE).unwrap();
    assert_eq!((reliable.publishers(), any.publishers()), (0, 1));
    drop(peer);
}

#[test]
fn latched_maps_reach_who_comes_later() {
    let meeting = Meeting::new();
    let node = meeting.node("maps");
    let maps = node.publish::<OccupancyGrid>("map", Qos::LATCHED).unwrap();
    let info = MapMetaData { resolution: 0.05, width: 200, height: 100, ..MapMetaData::default() };
    let data = (0..20_000).map(|cell| (cell % 101) as i8 - 1).collect();
    maps.publish(&OccupancyGrid { info, data, ..OccupancyGrid::default() });
    let Some(peer) = meeting.cyclone("print", "OccupancyGrid", "map", "latched") else { return };
    peer.prints("width=200, height=100");
    peer.prints("-1, 0, 1, 2, 3, 4");

    let Some(peer) = meeting.cyclone("latch", "OccupancyGrid", "their_map", "latched") else { return };
    let maps = node.subscribe::<OccupancyGrid>("their_map", Qos::LATCHED).unwrap();
    let map = maps.recv_timeout(PATIENCE).unwrap();
    assert_eq!((map.info.width, map.data), (2, vec![-1, 100]));
    drop(peer);
}

#[test]
fn commands_go_both_ways_as_either_type() {
    for (kind, printed) in [("Twist", "Twist(linear=Vector3(x=0.75"), ("TwistStamped", "frame_id='base'")] {
        let meeting = Meeting::new();
        let node = meeting.node("driver");
        let commands = node.publish::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
        let Some(peer) = meeting.cyclone("print", kind, "cmd_vel", "commands") else { return };
        let header = Header { frame_id: "base".to_owned(), ..Header::default() };
        let linear = Vector3 { x: 0.75, ..Vector3::default() };
        let command = Command { header, twist: Twist { linear, ..Twist::default() } };
        publishing_until_printed(|| commands.publish(&command), &peer, printed);
        contains(&peer.output(), &["Vector3(x=0.75"]);
        drop(peer);

        let commands = node.subscribe::<Command>("their_cmd_vel", Qos::COMMANDS).unwrap();
        let Some(peer) = meeting.cyclone("publish", kind, "their_cmd_vel", "commands") else { return };
        let command = commands.recv_timeout(PATIENCE).unwrap();
        assert_eq!((command.twist.linear.x, command.twist.angular.z), (0.25, -0.5));
        assert_eq!(commands.malformed(), 0);
        drop(peer);
    }
}

#[test]
fn messages_of_another_type_are_not_taken() {
    let meeting = Meeting::new();
    let Some(peer) = meeting.cyclone("publish", "TwistStamped", "cmd_vel", "commands") else { return };
    let node = meeting.node("robot");
    let twists = node.subscribe::<Twist>("cmd_vel", Qos::COMMANDS).unwrap();
    let stamped = node.subscribe::<TwistStamped>("cmd_vel", Qos::COMMANDS).unwrap();
    for _ in 0..3 {
        assert_eq!(stamped.recv_timeout(PATIENCE).unwrap().twist.linear.x, 0.25);
    }
    assert_eq!((twists.try_recv(), twists.malformed(), twists.publishers()), (None, 0, 0));
    assert_eq!(
        node.peers("cmd_vel").unwrap().published,
        ["geometry_msgs/msg/TwistStamped".to_owned()].into()
    );
    drop(peer);
}

/// A subscriber of another type gets nothing and acknowledges nothing, and is not to stop those who do.
#[test]
fn subscribers_of_another_type_hold_nothing_up() {
    let meeting = Meeting::new();
    let Some(peer) = meeting.cyclone("print", "TwistStamped", "cmd_vel", "commands") else { return };
    let (driver, robot) = (meeting.node("driver"), meeting.node("robot"));
    let commands = driver.publish::<Twist>("cmd_vel", Qos::COMMANDS).unwrap();
    let twists = robot.subscribe::<Twist>("cmd_vel", Qos::COMMANDS).unwrap();
    until("all are discovered", || driver.peers("cmd_vel").unwrap().subscribed.len() == 2);
    until("one is connected", || twists.publishers() == 1 && commands.subscribers() == 1);
    for number in 0..500 {
        let linear = Vector3 { x: f64::from(number), ..Vector3::default() };
        let twist = Twist { linear, ..Twist::default() };
        until("it arrives", || {
            commands.publish(&twist);
            twists.recv_timeout(SOON).is_ok_and(|received| received == twist)
        });
    }
    drop(peer);
}

#[test]
fn the_clock_is_ros_s() {
    let meeting = Meeting::new();
    let node = meeting.node("clock");
    let clocks = node.publish::<Clock>("clock", Qos::COMMANDS).unwrap();
    let Some(peer) = meeting.cyclone("print", "Clock", "clock", "commands") else { return };
    let clock = Clock { clock: Time { sec: 12, nanosec: 34 } };
    publishing_until_printed(|| clocks.publish(&clock), &peer, "Clock(clock=Time(sec=12, nanosec=34))");
}

#[test]
fn last_words_are_heard() {
    let meeting = Meeting::new();
    let Some(peer) = meeting.cyclone("print", "Text", "words", "commands") else { return };
    let node = meeting.node("speaker");
    let words = node.publish::<Text>("words", Qos::COMMANDS).unwrap();
    let say = |word: &str| words.publish(&Text { data: word.to_owned() });
    publishing_until_printed(|| say("hello"), &peer, "hello");
    say("bye");
    drop(node);
    peer.prints("bye");
}

#[test]
fn nodes_are_told_by_name_with_what_they_have() {
    let meeting = Meeting::new();
    let Some(peer) = meeting.cyclone("print", "ParticipantEntitiesInfo", "ros_discovery_info", "latched")
    else {
        return;
    };
    let node = meeting.node("robot");
    let named = format!("node_namespace='{}', node_name='robot'", meeting.namespace());
    let has = |readers: usize, writers: usize| {
        let counted = |line: &str| {
            let (readers, writers) = line.split_once("writer_gid_seq=")?;
            let (_, readers) = readers.split_once("reader_gid_seq=")?;
            Some((readers.matches("Gid(").count(), writers.matches("Gid(").count()))
        };
        let last = |line: &str| line.contains(&named) && counted(line) == Some((readers, writers));
        until(&format!("{readers} subscribers and {writers} publishers are told"), || {
            peer.output().lines().rev().find(|line| line.contains(&named)).is_some_and(last)
        });
    };
    has(0, 0);
    let scans = node.publish::<LaserScan>("scan", Qos::SENSORS).unwrap();
    let _commands = node.subscribe::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
    has(2, 1);
    drop(scans);
    has(2, 0);
}
