//! The node against Zenoh, as ROS 2's `rmw_zenoh` uses it.

use std::{net::TcpListener, process};

use cotorra_ros2::{
    Command, Middleware, Node, NodeConfig, NodeError, Publisher, Qos, RecvError,
    messages::{LaserScan, Text, TwistStamped},
};
use cotorra_testing::{
    process::{PATIENCE, Process, until},
    python,
    ros2::start,
};

use crate::both_ways::{Place, both_ways};

const DOMAIN: u16 = 7;

/// A router, through which nodes discover each other.
struct Router {
    port: u16,
    process: Option<Process>,
}

impl Router {
    /// Reserves a port for a router that starts later.
    fn none_yet() -> Self {
        // Below the ephemeral ports of the kernel, and another for each test process.
        let first = 10_000 + u16::try_from(process::id() % 20_000).unwrap();
        let port = (first..).find(|port| TcpListener::bind(("127.0.0.1", *port)).is_ok()).unwrap();
        Self { port, process: None }
    }

    /// Returns `None`, and prints a message, if Zenoh's wheel is not installed.
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
        Some(start(&mut command))
    }
}

impl Place for Router {
    const FRAME: &'static str = "from zenoh";
    // With the attachment: time and publisher.
    const SCAN: &'static [&'static str] = &[
        "ranges=array([1.5 ,  inf, 2.25]",
        " True 16 ",
        "sec=3, nanosec=9",
        "frame_id='laser'",
        "range_max=12.0",
    ];
    const MAP: &'static [&'static str] = &["width=500, height=400", "array([-1,  0,  1, ..., "];
    const COMMANDS: [&'static str; 2] = ["Vector3(x=0.75", "frame_id='base'"];

    fn node(&self, name: &str) -> Node {
        let router = format!("tcp/127.0.0.1:{}", self.port);
        let middleware = Middleware::Zenoh { router };
        let namespace = "/tb2".to_owned();
        Node::new(NodeConfig { domain: DOMAIN, namespace, middleware, ..NodeConfig::new(name) }).unwrap()
    }

    fn peer(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process> {
        self.run(&[action, &DOMAIN.to_string(), kind, &format!("/tb2/{topic}"), qos])
    }
}

both_ways!(Router::start);

#[test]
fn nodes_announce_and_withdraw_their_endpoints() {
    let Some(router) = Router::start() else { return };
    let graph = router.run(&["graph", &DOMAIN.to_string()]).unwrap();
    let node = router.node("robot");
    let scans = node.publish::<LaserScan>("scan", Qos::SENSORS).unwrap();
    let commands = node.subscribe::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
    graph.prints("/0/0/NN/%/%tb2/robot\n");
    // The hash is that of `rosbags`. The peer of the other tests finds the topic by it.
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
fn nodes_meet_through_a_router_that_starts_late_or_again() {
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
    // Another type: no message arrives.
    let other = other.subscribe::<TwistStamped>("words", Qos::COMMANDS).unwrap();
    assert_eq!((other.try_recv(), other.malformed()), (None, 0));
}
