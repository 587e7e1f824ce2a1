//! Tests with every other implementation, both ways: scans, commands and maps.

use cotorra_ros2::{
    Command, Node, Qos,
    messages::{Header, LaserScan, MapMetaData, OccupancyGrid, Time, Twist, Vector3},
};
use cotorra_testing::{
    process::{PATIENCE, Process, contains, until},
    ros2::{publishing_until_printed, scan},
};

/// A network of nodes and programs of another implementation.
pub trait Place {
    /// Frame of the messages that the other publishes.
    const FRAME: &'static str;
    /// Output of the other for [`scan`].
    const SCAN: &'static [&'static str];
    /// Output of the other for a map of 500 x 400 cells.
    const MAP: &'static [&'static str];
    /// Output of the other for a command of 0.75 m/s, as `Twist` and as `TwistStamped` in the frame `base`.
    const COMMANDS: [&'static str; 2];

    /// Starts a node of this crate.
    fn node(&self, name: &str) -> Node;

    /// Starts a program of the other. Returns `None`, and prints a message, if it is not installed.
    fn peer(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process>;
}

/// Subscribers with best effort receive from reliable publishers.
const READ: [(Qos, &str); 3] =
    [(Qos::SENSORS, "sensors"), (Qos::COMMANDS, "commands"), (Qos::COMMANDS, "sensors")];
const HEARD: [(Qos, &str); 3] =
    [(Qos::SENSORS, "sensors"), (Qos::COMMANDS, "commands"), (Qos::SENSORS, "commands")];

pub fn our_scans_are_read_with_any_quality_of_service<P: Place>(place: impl Fn() -> Option<P>) {
    for (ours, theirs) in READ {
        let Some(place) = place() else { return };
        let Some(peer) = place.peer("print", "LaserScan", "scan", theirs) else { return };
        let node = place.node("robot");
        let scans = node.publish::<LaserScan>("scan", ours).unwrap();
        publishing_until_printed(|| scans.publish(&scan()), &peer, P::SCAN[0]);
        contains(&peer.output(), P::SCAN);
        until("the peer is known", || scans.subscribers() == 1);
    }
}

pub fn their_scans_are_read_with_any_quality_of_service<P: Place>(place: impl Fn() -> Option<P>) {
    for (ours, theirs) in HEARD {
        let Some(place) = place() else { return };
        let node = place.node("robot");
        let scans = node.subscribe::<LaserScan>("scan", ours).unwrap();
        let Some(peer) = place.peer("publish", "LaserScan", "scan", theirs) else { return };
        let scan = scans.recv_timeout(PATIENCE).unwrap();
        assert_eq!(scan.header.stamp, Time { sec: 5, nanosec: 7 });
        assert_eq!((scan.header.frame_id.as_str(), scan.range_max), (P::FRAME, 12.0));
        assert_eq!((scan.ranges[0], scan.ranges[2]), (1.5, 2.25));
        until("the peer is known", || scans.publishers() == 1);
        assert_eq!(scans.malformed(), 0);
        drop(peer);
    }
}

pub fn latched_maps_reach_later_subscribers<P: Place>(place: &P) {
    let node = place.node("maps");
    let maps = node.publish::<OccupancyGrid>("map", Qos::LATCHED).unwrap();
    // Larger than a datagram, so in fragments.
    let info = MapMetaData { resolution: 0.05, width: 500, height: 400, ..MapMetaData::default() };
    let data = (0..200_000).map(|cell| (cell % 101) as i8 - 1).collect();
    maps.publish(&OccupancyGrid { info, data, ..OccupancyGrid::default() });
    let Some(peer) = place.peer("print", "OccupancyGrid", "map", "latched") else { return };
    P::MAP.iter().for_each(|part| peer.prints(part));

    let Some(peer) = place.peer("latch", "OccupancyGrid", "their_map", "latched") else { return };
    let maps = node.subscribe::<OccupancyGrid>("their_map", Qos::LATCHED).unwrap();
    let map = maps.recv_timeout(PATIENCE).unwrap();
    assert_eq!((map.info.width, map.data), (2, vec![-1, 100]));
    drop(peer);
}

pub fn commands_of_either_type_go_both_ways<P: Place>(place: impl Fn() -> Option<P>) {
    for (kind, printed) in ["Twist", "TwistStamped"].into_iter().zip(P::COMMANDS) {
        let Some(place) = place() else { return };
        let node = place.node("driver");
        let commands = node.publish::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
        let Some(peer) = place.peer("print", kind, "cmd_vel", "commands") else { return };
        let header = Header { frame_id: "base".to_owned(), ..Header::default() };
        let linear = Vector3 { x: 0.75, ..Vector3::default() };
        let command = Command { header, twist: Twist { linear, ..Twist::default() } };
        publishing_until_printed(|| commands.publish(&command), &peer, printed);
        contains(&peer.output(), &["0.75"]);
        let subscribed = node.peers("cmd_vel").unwrap().subscribed;
        assert_eq!(subscribed, [format!("geometry_msgs/msg/{kind}")].into());
        drop(peer);

        let commands = node.subscribe::<Command>("their_cmd_vel", Qos::COMMANDS).unwrap();
        let Some(peer) = place.peer("publish", kind, "their_cmd_vel", "commands") else { return };
        let command = commands.recv_timeout(PATIENCE).unwrap();
        assert_eq!((command.twist.linear.x, command.twist.angular.z), (0.25, -0.5));
        assert_eq!(commands.malformed(), 0);
        drop(peer);
    }
}

/// Declares the tests for the network that `$place` starts.
macro_rules! both_ways {
    ($place:expr) => {
        #[test]
        fn our_scans_are_read_with_any_quality_of_service() {
            crate::both_ways::our_scans_are_read_with_any_quality_of_service($place);
        }

        #[test]
        fn their_scans_are_read_with_any_quality_of_service() {
            crate::both_ways::their_scans_are_read_with_any_quality_of_service($place);
        }

        #[test]
        fn latched_maps_reach_later_subscribers() {
            let Some(place) = $place() else { return };
            crate::both_ways::latched_maps_reach_later_subscribers(&place);
        }

        #[test]
        fn commands_of_either_type_go_both_ways() {
            crate::both_ways::commands_of_either_type_go_both_ways($place);
        }
    };
}
pub(crate) use both_ways;
