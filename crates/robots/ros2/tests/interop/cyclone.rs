//! The node against Cyclone DDS.

use std::time::Duration;

use cotorra_ros2::{
    Command, Node, Qos,
    messages::{Clock, LaserScan, Text, Time, Twist, TwistStamped, Vector3},
};
use cotorra_testing::{
    process::{PATIENCE, Process, until},
    ros2::{Meeting, publishing_until_printed},
};

use crate::both_ways::{Place, both_ways};

/// Time in which most messages arrive.
const SOON: Duration = Duration::from_millis(50);

struct Cyclone(Meeting);

impl Place for Cyclone {
    const FRAME: &'static str = "from cyclone";
    const SCAN: &'static [&'static str] =
        &["ranges=[1.5, inf, 2.25]", "stamp=Time(sec=3, nanosec=9)", "frame_id='laser'", "range_max=12.0"];
    const MAP: &'static [&'static str] = &["width=500, height=400", "-1, 0, 1, 2, 3, 4"];
    const COMMANDS: [&'static str; 2] = ["Twist(linear=Vector3(x=0.75", "frame_id='base'"];

    fn node(&self, name: &str) -> Node {
        self.0.node(name)
    }

    fn peer(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process> {
        self.0.cyclone(action, kind, topic, qos)
    }
}

both_ways!(|| Some(Cyclone(Meeting::new())));

#[test]
fn subscriber_that_requests_more_than_offered_is_not_connected() {
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
fn messages_of_another_type_are_rejected() {
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

/// A subscriber of another type receives and acknowledges nothing. It must not stop the others.
#[test]
fn subscribers_of_another_type_do_not_block_others() {
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
fn clock_messages_are_those_of_ros() {
    let meeting = Meeting::new();
    let node = meeting.node("clock");
    let clocks = node.publish::<Clock>("clock", Qos::COMMANDS).unwrap();
    let Some(peer) = meeting.cyclone("print", "Clock", "clock", "commands") else { return };
    let clock = Clock { clock: Time { sec: 12, nanosec: 34 } };
    publishing_until_printed(|| clocks.publish(&clock), &peer, "Clock(clock=Time(sec=12, nanosec=34))");
}

#[test]
fn last_messages_arrive_before_a_node_ends() {
    let meeting = Meeting::new();
    let Some(peer) = meeting.cyclone("print", "Text", "words", "commands") else { return };
    let node = meeting.node("speaker");
    let words = node.publish::<Text>("words", Qos::COMMANDS).unwrap();
    let say = |word: &str| words.publish(&Text { data: word.to_owned() });
    publishing_until_printed(|| say("hello"), &peer, "hello");
    // More than may be unacknowledged at once: the last ones are still queued when the node ends.
    (0..200).for_each(|_| say("well"));
    say("bye");
    drop(node);
    peer.prints("bye");
}

#[test]
fn nodes_announce_their_name_and_endpoints() {
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
