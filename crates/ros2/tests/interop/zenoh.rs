//! The node against Zenoh, as ROS 2's `rmw_zenoh` speaks it.

use std::{net::TcpListener, process};

use cotorra_ros2::{
    Command, Middleware, Node, NodeConfig, NodeError, Publisher, Qos, RecvError,
    messages::{Header, LaserScan, MapMetaData, OccupancyGrid, Text, Time, Twist, TwistStamped, Vector3},
};

use crate::peer::{PATIENCE, Process, contains, publishing_until_printed, python, scan, until};

const DOMAIN: u16 = 7;

/// A router, by which nodes find each other.
struct Router {
    port: u16,
    process: Option<Process>,
}

impl Router {
    /// A port for a router that is not there yet.
    fn none_yet() -> Self {
        // Below the ports that the kernel hands out, and another for each process of the tests.
        let first = 10_000 + u16::try_from(process::id() % 20_000).unwrap();
        let port = (first..).find(|port| TcpListener::bind(("127.0.0.1", *port)).is_ok()).unwrap();
        Self { port, process: None }
    }

    /// `None`, and a message, where Zenoh's wheel is not installed.
    fn start() -> Option<Self> {
        let mut router = Self::none_yet();
        router.come()?;
        Some(router)
    }

    fn come(&mut self) -> Option<()> {
        self.process = Some(self.run(&["router"])?);
        Some(())
    }

    fn run(&self, arguments: &[&str]) -> Option<Process> {
        let mut command = process::Command::new(python("zenoh, rosbags", "Zenoh")?);
        command.args(["-u", "-c", include_str!("zenoh.py"), &self.port.to_string()]).args(arguments);
        Some(Process::start(&mut command))
    }

    /// A peer: see `zenoh.py`.
    fn peer(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Process {
        self.run(&[action, &DOMAIN.to_string(), kind, topic, qos]).unwrap()
    }

    /// A node of this crate.
    fn node(&self, name: &str) -> Node {
        let router = format!("tcp/127.0.0.1:{}", self.port);
        let middleware = Middleware::Zenoh { router };
        let namespace = "/tb2".to_owned();
        Node::new(NodeConfig { domain: DOMAIN, namespace, middleware, ..NodeConfig::new(name) }).unwrap()
    }
}

const SCAN: &str = "sensor_msgs/msg/LaserScan";

#[test]
fn scans_go_both_ways() {
    let Some(router) = Router::start() else { return };
    for (ours, theirs) in [(Qos::SENSORS, "sensors"), (Qos::COMMANDS, "commands")] {
        let node = router.node("robot");
        let scans = node.publish::<LaserScan>("scan", ours).unwrap();
        let peer = router.peer("print", SCAN, "/tb2/scan", theirs);
        publishing_until_printed(|| scans.publish(&scan()), &peer, "ranges=array([1.5 ,  inf, 2.25]");
        contains(&peer.output(), &["sec=3, nanosec=9", "frame_id='laser'", "range_max=12.0"]);
        let line = peer.output().lines().nth(1).unwrap().to_owned();
        let (number, rest) = line.split_once(' ').unwrap();
        assert!(number.parse::<u32>().unwrap() >= 1, "{line}");
        assert!(rest.starts_with("True 16 "), "its time, and by whom: {line}");
        until("the peer is known", || scans.subscribers() == 1);

        let scans = node.subscribe::<LaserScan>("their_scan", ours).unwrap();
        let peer = router.peer("publish", SCAN, "/tb2/their_scan", theirs);
        let scan = scans.recv_timeout(PATIENCE).unwrap();
        assert_eq!(scan.header.stamp, Time { sec: 5, nanosec: 7 });
        assert_eq!((scan.header.frame_id.as_str(), scan.range_max), ("from zenoh", 12.0));
        assert_eq!(scan.ranges, [1.5, f32::INFINITY, 2.25]);
        until("the peer is known", || scans.publishers() == 1);
        assert_eq!(scans.malformed(), 0);
        drop(peer);
        until("the peer is gone", || scans.publishers() == 0);
    }
}

#[test]
fn commands_go_both_ways_as_either_type() {
    let Some(router) = Router::start() else { return };
    for (kind, printed) in [("Twist", "Vector3(x=0.75"), ("TwistStamped", "frame_id='base'")] {
        let kind = format!("geometry_msgs/msg/{kind}");
        let node = router.node("driver");
        let commands = node.publish::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
        let peer = router.peer("print", &kind, "/tb2/cmd_vel", "commands");
        let header = Header { frame_id: "base".to_owned(), ..Header::default() };
        let linear = Vector3 { x: 0.75, ..Vector3::default() };
        let command = Command { header, twist: Twist { linear, ..Twist::default() } };
        publishing_until_printed(|| commands.publish(&command), &peer, printed);
        contains(&peer.output(), &["x=0.75"]);
        assert_eq!(node.peers("cmd_vel").unwrap().subscribed, [kind.clone()].into());
        drop(peer);

        let commands = node.subscribe::<Command>("their_cmd_vel", Qos::COMMANDS).unwrap();
        let peer = router.peer("publish", &kind, "/tb2/their_cmd_vel", "commands");
        let command = commands.recv_timeout(PATIENCE).unwrap();
        assert_eq!((command.twist.linear.x, command.twist.angular.z), (0.25, -0.5));
        assert_eq!(commands.malformed(), 0);
        drop(peer);
    }
}

#[test]
fn latched_maps_reach_who_comes_later() {
    let Some(router) = Router::start() else { return };
    let node = router.node("maps");
    let maps = node.publish::<OccupancyGrid>("map", Qos::LATCHED).unwrap();
    // Larger than what goes at once.
    let info = MapMetaData { resolution: 0.05, width: 500, height: 400, ..MapMetaData::default() };
    let data = (0..200_000).map(|cell| (cell % 101) as i8 - 1).collect();
    maps.publish(&OccupancyGrid { info, data, ..OccupancyGrid::default() });
    let peer = router.peer("print", "nav_msgs/msg/OccupancyGrid", "/tb2/map", "latched");
    peer.prints("width=500, height=400");
    contains(&peer.output(), &["array([-1,  0,  1, ..., "]);

    let peer = router.peer("latch", "nav_msgs/msg/OccupancyGrid", "/tb2/their_map", "latched");
    let maps = node.subscribe::<OccupancyGrid>("their_map", Qos::LATCHED).unwrap();
    let map = maps.recv_timeout(PATIENCE).unwrap();
    assert_eq!((map.info.width, map.data), (2, vec![-1, 100]));
    drop(peer);
}

#[test]
fn nodes_and_what_they_have_are_told_and_taken_back() {
    let Some(router) = Router::start() else { return };
    let graph = router.peer("graph", "", "", "");
    let node = router.node("robot");
    let scans = node.publish::<LaserScan>("scan", Qos::SENSORS).unwrap();
    let commands = node.subscribe::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
    graph.prints("/0/0/NN/%/%tb2/robot\n");
    // The hash is that of `rosbags`, by which the peer of the other tests finds the topic.
    let hash = "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828";
    let scan =
        format!("/MP/%/%tb2/robot/%tb2%scan/sensor_msgs::msg::dds_::LaserScan_/{hash}/2:2:1,5:,:,:,,\n");
    graph.prints(&scan);
    for kind in ["Twist", "TwistStamped"] {
        graph.prints(&format!("/MS/%/%tb2/robot/%tb2%cmd_vel/geometry_msgs::msg::dds_::{kind}_/"));
    }
    let gone = |part: &str| {
        until(&format!("{part} is taken back"), || {
            graph.output().lines().any(|line| line.starts_with('-') && line.contains(part))
        });
    };
    drop(scans);
    gone("/MP/");
    node.shut_down();
    assert!(node.is_shut_down());
    gone("/MS/");
    gone("/NN/");
    assert_eq!(commands.recv_timeout(PATIENCE), Err(RecvError::ShutDown));
    assert!(matches!(node.publish::<Text>("words", Qos::COMMANDS), Err(NodeError::ShutDown)));
}

#[test]
fn a_router_that_comes_later_or_again_brings_nodes_together() {
    let mut router = Router::none_yet();
    let (one, other) = (router.node("one"), router.node("other"));
    let words: Publisher<Text> = one.publish("words", Qos::COMMANDS).unwrap();
    let heard = other.subscribe::<Text>("words", Qos::COMMANDS).unwrap();
    for word in ["hello", "again"] {
        if router.come().is_none() {
            return;
        }
        let word = Text { data: word.to_owned() };
        until("it arrives", || {
            words.publish(&word);
            heard.try_recv().is_some_and(|heard| heard == word)
        });
        router.process = None;
    }
    // Of another type: nothing comes.
    let other = other.subscribe::<TwistStamped>("words", Qos::COMMANDS).unwrap();
    assert_eq!((other.try_recv(), other.malformed()), (None, 0));
}
