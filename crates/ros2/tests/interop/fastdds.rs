//! The node against Fast DDS.

use cotorra_ros2::{
    Command, Qos,
    messages::{Header, LaserScan, MapMetaData, OccupancyGrid, Time, Twist, Vector3},
};

use crate::peer::{Meeting, PATIENCE, publishing_until_printed, scan};

#[test]
fn fast_dds_reads_scans_however_they_are_published() {
    for (ours, theirs) in [(Qos::SENSORS, "sensors"), (Qos::COMMANDS, "commands"), (Qos::COMMANDS, "sensors")]
    {
        let meeting = Meeting::new();
        let Some(peer) = meeting.fast_dds("print", "LaserScan", "scan", theirs) else { return };
        let node = meeting.node("robot");
        let scans = node.publish::<LaserScan>("scan", ours).unwrap();
        publishing_until_printed(|| scans.publish(&scan()), &peer, "3 9 laser 0 0 0.5 0 0 0 12 1.5 inf 2.25");
        assert_eq!(scans.subscribers(), 1);
    }
}

#[test]
fn fast_dds_is_read_however_it_publishes() {
    for (ours, theirs) in [(Qos::SENSORS, "sensors"), (Qos::COMMANDS, "commands"), (Qos::SENSORS, "commands")]
    {
        let meeting = Meeting::new();
        let node = meeting.node("robot");
        let scans = node.subscribe::<LaserScan>("scan", ours).unwrap();
        let Some(peer) = meeting.fast_dds("publish", "LaserScan", "scan", theirs) else { return };
        let scan = scans.recv_timeout(PATIENCE).unwrap();
        assert_eq!(scan.header.stamp, Time { sec: 5, nanosec: 7 });
        assert_eq!((scan.header.frame_id.as_str(), scan.range_max), ("from fast dds", 12.0));
        assert_eq!(scan.ranges, [1.5, 1.75, 2.25]);
        assert_eq!((scans.publishers(), scans.malformed()), (1, 0));
        drop(peer);
    }
}

#[test]
fn latched_maps_reach_who_comes_later() {
    let meeting = Meeting::new();
    let node = meeting.node("maps");
    let maps = node.publish::<OccupancyGrid>("map", Qos::LATCHED).unwrap();
    let info = MapMetaData { resolution: 0.05, width: 500, height: 400, ..MapMetaData::default() };
    let data = (0..200_000).map(|cell| (cell % 101) as i8 - 1).collect();
    maps.publish(&OccupancyGrid { info, data, ..OccupancyGrid::default() });
    // Larger than a datagram: in fragments.
    let Some(peer) = meeting.fast_dds("print", "OccupancyGrid", "map", "latched") else { return };
    peer.prints("500 400 0 0 0 0 0 0 1 -1 0 1 2 3 4");

    let Some(peer) = meeting.fast_dds("latch", "OccupancyGrid", "their_map", "latched") else { return };
    let maps = node.subscribe::<OccupancyGrid>("their_map", Qos::LATCHED).unwrap();
    let map = maps.recv_timeout(PATIENCE).unwrap();
    assert_eq!((map.info.width, map.data), (2, vec![-1, 100]));
    drop(peer);
}

#[test]
fn commands_go_both_ways_as_either_type() {
    for (kind, printed) in [("Twist", "0.75 0 0 0 0 0"), ("TwistStamped", "0 0 base 0.75 0 0 0 0 0")] {
        let meeting = Meeting::new();
        let node = meeting.node("driver");
        let commands = node.publish::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
        let Some(peer) = meeting.fast_dds("print", kind, "cmd_vel", "commands") else { return };
        let header = Header { frame_id: "base".to_owned(), ..Header::default() };
        let linear = Vector3 { x: 0.75, ..Vector3::default() };
        let command = Command { header, twist: Twist { linear, ..Twist::default() } };
        publishing_until_printed(|| commands.publish(&command), &peer, printed);
        drop(peer);

        let commands = node.subscribe::<Command>("their_cmd_vel", Qos::COMMANDS).unwrap();
        let Some(peer) = meeting.fast_dds("publish", kind, "their_cmd_vel", "commands") else { return };
        let command = commands.recv_timeout(PATIENCE).unwrap();
        assert_eq!((command.twist.linear.x, command.twist.angular.z), (0.25, -0.5));
        drop(peer);
    }
}
