//! The node against ROS's tools and nodes.

use std::{env, fs, time::Duration};

use cotorra_ros1::{
    CallError, MasterServer, Node, NodeConfig, NodeError, PublishOptions, RecvError, SubscribeOptions, Value,
    messages::{
        Bool, Clock, EmptyRequest, EmptyResponse, EmptyService, Header, LaserScan, OccupancyGrid, Odometry,
        SetBool, SetBoolRequest, SetBoolResponse, Text, Time, Twist,
    },
};
use cotorra_testing::{
    process::{PATIENCE, contains, until},
    ros1::Ros,
};

fn scan(seq: u32) -> LaserScan {
    LaserScan {
        header: Header { seq, stamp: Time { sec: 5, nanosec: 7 }, frame_id: "laser".to_owned() },
        angle_increment: 0.5,
        range_max: 12.0,
        ranges: vec![1.5, f32::INFINITY, 2.25],
        ..LaserScan::default()
    }
}

/// Publishes repeatedly until the condition holds.
fn publishing_until(mut publish: impl FnMut(), what: &str, mut condition: impl FnMut() -> bool) {
    until(what, || {
        publish();
        condition()
    });
}

#[test]
fn topics_are_listed_with_their_types_and_connections() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/r1");
    let scans = node.publish::<LaserScan>("scan", PublishOptions::default()).unwrap();
    let _commands = node.subscribe::<Twist>("cmd_vel", SubscribeOptions::default()).unwrap();
    assert_eq!(scans.topic(), "/r1/scan");

    let listed = ros.run("rostopic", &["list", "-v"]);
    contains(
        &listed,
        &[
            "* /r1/scan [sensor_msgs/LaserScan] 1 publisher",
            "* /r1/cmd_vel [geometry_msgs/Twist] 1 subscriber",
        ],
    );
    contains(
        &ros.run("rostopic", &["info", "/r1/scan"]),
        &["Type: sensor_msgs/LaserScan", "/r1/robot (http://127.0.0.1:"],
    );

    let echo = ros.spawn("rostopic", &["echo", "/r1/scan"]);
    until("the echo subscribes", || scans.subscribers() == 1);
    let info = ros.run("rosnode", &["info", "/r1/robot"]);
    contains(
        &info,
        &[
            "* /r1/scan [sensor_msgs/LaserScan]",
            "* /r1/cmd_vel [unknown type]",
            "direction: outbound",
            "transport: TCPROS",
        ],
    );
    contains(&ros.run("rosnode", &["ping", "-c", "1", "/r1/robot"]), &["reply from http://127.0.0.1:"]);
    drop(echo);
    until("the echo is gone", || scans.subscribers() == 0);
}

#[test]
fn messages_are_printed_and_their_rate_is_measured() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let scans = node.publish::<LaserScan>("scan", PublishOptions::default()).unwrap();
    let echo = ros.spawn("rostopic", &["echo", "-n", "1", "/scan"]);
    publishing_until(|| scans.publish(&scan(3)), "a scan is printed", || echo.output().contains("---"));
    contains(
        &echo.output(),
        &["secs: 5", "nsecs:         7", "frame_id: \"laser\"", "ranges: [1.5, inf, 2.25]"],
    );
    let hz = ros.spawn("rostopic", &["hz", "/scan"]);
    publishing_until(
        || scans.publish(&scan(3)),
        "a rate is printed",
        || hz.output().contains("average rate"),
    );
}

#[test]
fn messages_of_the_tools_are_received() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let commands = node.subscribe::<Twist>("cmd_vel", SubscribeOptions::default()).unwrap();
    let drive = "{linear: {x: 0.25}, angular: {z: -0.5}}";
    let publisher = ros.spawn("rostopic", &["pub", "-r", "50", "/cmd_vel", "geometry_msgs/Twist", drive]);
    let command = commands.recv_timeout(PATIENCE).unwrap();
    assert_eq!((command.linear.x, command.angular.z), (0.25, -0.5));
    assert_eq!(commands.publishers(), 1);
    drop(publisher);
    until("the publisher is gone", || commands.publishers() == 0);
    // Another publisher, at another address.
    let _publisher =
        ros.spawn("rostopic", &["pub", "-r", "50", "/cmd_vel", "geometry_msgs/Twist", "{linear: {x: 1.0}}"]);
    until("the new one is heard", || commands.try_recv().is_some_and(|command| command.linear.x == 1.0));
}

#[test]
fn latched_messages_reach_later_subscribers() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let latch = PublishOptions { latch: true, ..PublishOptions::default() };
    let maps = node.publish::<OccupancyGrid>("map", latch).unwrap();
    let mut map = OccupancyGrid::default();
    (map.info.width, map.info.height, map.data) = (2, 1, vec![-1, 100]);
    maps.publish(&map);
    contains(&ros.run("rostopic", &["echo", "-n", "1", "/map"]), &["width: 2", "data: [-1, 100]"]);
    // Latched messages of ROS reach our subscribers, too.
    let _latched = ros.spawn("rostopic", &["pub", "-l", "/words", "std_msgs/String", "data: later"]);
    let words = node.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
    assert_eq!(words.recv_timeout(PATIENCE).unwrap().data, "later");
}

#[test]
fn bags_are_recorded_and_played() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let scans = node.publish::<LaserScan>("scan", PublishOptions::default()).unwrap();
    let odometry = node.publish::<Odometry>("odom", PublishOptions::default()).unwrap();
    let bag = ros.directory().join("run.bag");
    let bag = bag.to_str().unwrap();
    // Small chunks, so that the file grows as it records.
    let record = ros.spawn("rosbag", &["record", "--chunksize", "1", "-O", bag, "/scan", "/odom"]);
    until("the recorder subscribes", || scans.subscribers() == 1 && odometry.subscribers() == 1);
    let publish = || {
        scans.publish(&scan(1));
        odometry.publish(&Odometry::default());
    };
    let recorded = || fs::metadata(format!("{bag}.active")).is_ok_and(|bag| bag.len() > 30_000);
    publishing_until(publish, "the recording grows", recorded);
    record.interrupt();
    contains(
        &ros.run("rosbag", &["info", bag]),
        &["sensor_msgs/LaserScan [90c7ef2dc6895d81024acba2ac42f369]", "nav_msgs/Odometry"],
    );
    drop((scans, odometry));

    let scans = node.subscribe::<LaserScan>("scan", SubscribeOptions { queue: 100 }).unwrap();
    let _play = ros.spawn("rosbag", &["play", "-l", "--delay", "1", bag]);
    let played = scans.recv_timeout(PATIENCE).unwrap();
    assert_eq!(LaserScan { header: Header { seq: 0, ..played.header.clone() }, ..played }, scan(0));
}

#[test]
fn services_are_called_from_both_sides() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let on = move |request: SetBoolRequest| match request.data {
        true => Ok(SetBoolResponse { success: true, message: "on".to_owned() }),
        false => Err("it cannot be switched off".to_owned()),
    };
    let server = node.service::<SetBool>("power", on).unwrap();
    assert!(matches!(node.service::<SetBool>("power", on), Err(NodeError::Taken(name)) if name == "/power"));
    contains(&ros.run("rosservice", &["list"]), &["/power"]);
    contains(
        &ros.run("rosservice", &["info", "/power"]),
        &["Node: /robot", "Type: std_srvs/SetBool", "Args: data"],
    );
    contains(&ros.run("rosservice", &["call", "/power", "true"]), &["success: True", "message: \"on\""]);
    let failed = ros.try_run("rosservice", &["call", "/power", "false"]).unwrap_err();
    contains(&failed, &["it cannot be switched off"]);

    let switched = node.call::<SetBool>("power", &SetBoolRequest { data: true }, PATIENCE).unwrap();
    assert_eq!(switched.message, "on");
    let failed = node.call::<SetBool>("power", &SetBoolRequest { data: false }, PATIENCE);
    assert!(matches!(failed, Err(CallError::Failed(reason)) if reason == "it cannot be switched off"));
    let other = node.call::<EmptyService>("power", &EmptyRequest {}, PATIENCE);
    assert!(matches!(other, Err(CallError::Refused(_))), "{other:?}");
    drop(server);
    until("the service is gone", || !ros.run("rosservice", &["list"]).contains("/power"));
    let none = node.call::<SetBool>("power", &SetBoolRequest { data: true }, PATIENCE);
    assert!(matches!(none, Err(CallError::Master(_))), "{none:?}");

    let _talker = ros.python("talker.py", TALKER);
    until("rospy's service is there", || node.master().lookup_service("/negate").is_ok());
    let negated = node.call::<SetBool>("negate", &SetBoolRequest { data: false }, PATIENCE).unwrap();
    assert_eq!(negated, SetBoolResponse { success: true, message: "negated".to_owned() });
    let failed = node.call::<SetBool>("negate", &SetBoolRequest { data: true }, PATIENCE);
    assert!(matches!(failed, Err(CallError::Failed(_))), "{failed:?}");
}

/// A rospy node. It offers a service that raises on true, and calls a service of ours over one connection.
const TALKER: &str = r#"
import rospy
from std_srvs.srv import Empty, SetBool, SetBoolResponse
from std_msgs.msg import Bool

def negate(request):
    if request.data:
        raise ValueError("no")
    return SetBoolResponse(True, "negated")

rospy.init_node("talker")
service = rospy.Service("negate", SetBool, negate)
done = rospy.Publisher("done", Bool, queue_size=1, latch=True)
rospy.wait_for_service("reset")
reset = rospy.ServiceProxy("reset", Empty, persistent=True)
for _ in range(3):
    reset()
done.publish(True)
rospy.spin()
"#;

#[test]
fn rospy_calls_repeatedly_over_one_connection() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let (calls, counted) = std::sync::mpsc::channel();
    let count =
        move |EmptyRequest {}| calls.send(()).map(|()| EmptyResponse {}).map_err(|error| error.to_string());
    let _server = node.service::<EmptyService>("reset", count).unwrap();
    let done = node.subscribe::<Bool>("done", SubscribeOptions::default()).unwrap();
    let _talker = ros.python("talker.py", TALKER);
    assert!(done.recv_timeout(PATIENCE).unwrap().data);
    assert_eq!(counted.try_iter().count(), 3);
}

#[test]
fn parameters_are_shared() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node_with("robot", "/r1", &["_rate:=10", "speed:=/shared/speed"]);
    assert_eq!(ros.run("rosparam", &["get", "/r1/robot/rate"]).trim(), "10");
    assert_eq!(node.param("speed").unwrap(), None);
    let watch = node.watch_param("/shared").unwrap();
    assert_eq!(watch.value(), None);
    ros.run("rosparam", &["set", "/shared/speed", "0.5"]);
    assert_eq!(node.param("speed").unwrap(), Some(Value::Double(0.5)));
    let speed = |speed: f64| Some(Value::Struct([("speed".to_owned(), Value::Double(speed))].into()));
    assert_eq!(watch.changed(PATIENCE).unwrap(), speed(0.5));
    node.set_param("speed", 0.75).unwrap();
    assert_eq!(watch.changed(PATIENCE).unwrap(), speed(0.75));
    assert_eq!(watch.changed(Duration::ZERO), Err(RecvError::Timeout));

    node.set_param("~names", vec!["a & b", "<c>", "ä"]).unwrap();
    contains(&ros.run("rosparam", &["get", "/r1/robot/names"]), &["a & b", "<c>"]);
    let master = node.master();
    assert!(master.has_param("/shared/speed").unwrap());
    assert_eq!(master.search_param("rate").unwrap().as_deref(), Some("/r1/robot/rate"));
    assert!(master.param_names().unwrap().contains(&"/shared/speed".to_owned()));
    master.delete_param("/shared/speed").unwrap();
    assert_eq!(ros.run("rosparam", &["list", "/shared"]).trim(), "");
    assert!(master.delete_param("/shared/speed").is_err());
}

#[test]
fn a_node_unregisters_when_it_ends() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let scans = node.publish::<LaserScan>("scan", PublishOptions::default()).unwrap();
    let commands = node.subscribe::<Twist>("cmd_vel", SubscribeOptions::default()).unwrap();
    let extra = node.publish::<Clock>("clock", PublishOptions::default()).unwrap();
    drop(extra);
    until("a dropped publisher is gone", || !ros.run("rostopic", &["list"]).contains("/clock"));
    let again = node.publish::<Clock>("clock", PublishOptions::default()).unwrap();
    contains(&ros.run("rostopic", &["list"]), &["/clock", "/scan", "/cmd_vel"]);
    drop(node);
    let listed = ros.run("rosnode", &["list"]);
    assert!(!listed.contains("/robot"), "{listed}");
    assert_eq!(commands.recv_timeout(PATIENCE), Err(RecvError::ShutDown));
    scans.publish(&scan(0));
    drop((scans, again));
}

/// Not a test, but the program of the next one: prints received messages until Ctrl-C.
#[test]
#[ignore = "a program that another test runs"]
fn listener() {
    let node = Node::new(NodeConfig::from_env("listener").unwrap()).unwrap();
    let words = node.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
    let ended = node.clone();
    ctrlc::set_handler(move || ended.shut_down()).unwrap();
    while let Some(word) = words.recv() {
        println!("{}", word.data);
    }
}

#[test]
fn ctrl_c_ends_a_program_that_handles_it() {
    let Some(ros) = Ros::start() else { return };
    let this = env::current_exe().unwrap();
    let echo = ros.spawn(this.to_str().unwrap(), &["--exact", "tools::listener", "--ignored", "--nocapture"]);
    let node = ros.node("robot", "/");
    let words = node.publish::<Text>("words", PublishOptions::default()).unwrap();
    until("the program subscribes", || words.subscribers() == 1);
    words.publish(&Text { data: "hello".to_owned() });
    until("it prints", || echo.output().contains("hello"));
    echo.interrupt();
    let listed = ros.run("rosnode", &["list"]);
    assert!(!listed.contains("/listener"), "{listed}");
}

#[test]
fn rosnode_kill_or_a_second_node_of_its_name_ends_a_node() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let _scans = node.publish::<LaserScan>("scan", PublishOptions::default()).unwrap();
    ros.run("rosnode", &["kill", "/robot"]);
    until("the node ends", || node.is_shut_down());
    assert!(matches!(node.publish::<Twist>("cmd_vel", PublishOptions::default()), Err(NodeError::ShutDown)));
    let first = ros.node("twin", "/");
    let _first = first.publish::<Text>("words", PublishOptions::default()).unwrap();
    let second = ros.node("twin", "/");
    let _second = second.publish::<Text>("words", PublishOptions::default()).unwrap();
    until("the first ends", || first.is_shut_down());
    assert!(!second.is_shut_down());
    contains(&ros.run("rosnode", &["list"]), &["/twin"]);
}

#[test]
fn nodes_register_again_with_a_restarted_master() {
    let Some(mut ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let scans = node.publish::<LaserScan>("scan", PublishOptions::default()).unwrap();
    let commands = node.subscribe::<Twist>("cmd_vel", SubscribeOptions::default()).unwrap();
    let _server = node.service::<EmptyService>("reset", |_| Ok(EmptyResponse {})).unwrap();
    ros.restart();
    until("the node is back", || {
        let state = node.master().system_state().unwrap_or_default();
        let has = |entries: &[(String, Vec<String>)], name| entries.iter().any(|(entry, _)| entry == name);
        has(&state.publishers, "/scan")
            && has(&state.subscribers, "/cmd_vel")
            && has(&state.services, "/reset")
    });
    let echo = ros.spawn("rostopic", &["echo", "-n", "1", "/scan"]);
    publishing_until(|| scans.publish(&scan(1)), "a scan is printed", || echo.output().contains("---"));
    let _drive = ros.spawn("rostopic", &["pub", "-r", "50", "/cmd_vel", "geometry_msgs/Twist", "{}"]);
    assert_eq!(commands.recv_timeout(PATIENCE), Ok(Twist::default()));
}

#[test]
fn another_type_is_rejected_with_its_reason() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let words = node.publish::<Text>("words", PublishOptions::default()).unwrap();
    let stranger = ros.node("stranger", "/");
    let flags = stranger.subscribe::<Bool>("words", SubscribeOptions::default()).unwrap();
    let heard = stranger.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
    publishing_until(
        || words.publish(&Text { data: "x".to_owned() }),
        "the right one hears",
        || heard.try_recv().is_some(),
    );
    assert_eq!((flags.publishers(), flags.try_recv()), (0, None));
}

#[test]
fn tools_accept_our_master() {
    let master = MasterServer::start("127.0.0.1", 0).unwrap();
    let Some(ros) = Ros::with_master(master.endpoint().port) else { return };
    let node = ros.node("robot", "/r1");
    let scans = node.publish::<LaserScan>("scan", PublishOptions::default()).unwrap();
    let words = node.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
    contains(
        &ros.run("rostopic", &["list", "-v"]),
        &["* /r1/scan [sensor_msgs/LaserScan] 1 publisher", "* /r1/words [std_msgs/String] 1 subscriber"],
    );
    let echo = ros.spawn("rostopic", &["echo", "-n", "1", "/r1/scan"]);
    publishing_until(|| scans.publish(&scan(3)), "a scan is printed", || echo.output().contains("---"));
    let _publisher =
        ros.spawn("rostopic", &["pub", "-r", "50", "/r1/words", "std_msgs/String", "data: hello"]);
    assert_eq!(words.recv_timeout(PATIENCE).unwrap().data, "hello");
    ros.run("rosparam", &["set", "/r1/speed", "0.5"]);
    assert_eq!(ros.run("rosparam", &["get", "/r1/speed"]).trim(), "0.5");
    contains(&ros.run("rosparam", &["list"]), &["/r1/speed"]);
    contains(&ros.run("rosnode", &["info", "/r1/robot"]), &["* /r1/scan [sensor_msgs/LaserScan]"]);
}

#[test]
fn absent_master_is_an_error() {
    let config = NodeConfig { master: "http://127.0.0.1:1".parse().unwrap(), ..NodeConfig::new("lonely") };
    let node = Node::new(config).unwrap();
    assert!(matches!(node.publish::<Text>("words", PublishOptions::default()), Err(NodeError::Master(_))));
    assert!(node.param("x").is_err());
}
