//! The node against itself.

use cotorra_ros2::{
    Command, NodeError, Qos, RecvError,
    messages::{Clock, Text, Time, Twist, TwistStamped, Vector3},
};
use cotorra_testing::{
    process::{PATIENCE, until},
    ros2::Meeting,
};

fn text(data: &str) -> Text {
    Text { data: data.to_owned() }
}

fn forward(x: f64) -> Twist {
    Twist { linear: Vector3 { x, ..Vector3::default() }, ..Twist::default() }
}

#[test]
fn reliable_messages_arrive_in_order() {
    let meeting = Meeting::new();
    let (one, other) = (meeting.node("one"), meeting.node("other"));
    let words = one.publish::<Text>("words", Qos { depth: 500, ..Qos::COMMANDS }).unwrap();
    let heard = other.subscribe::<Text>("words", Qos { depth: 500, ..Qos::COMMANDS }).unwrap();
    until("they are connected", || words.subscribers() == 1 && heard.publishers() == 1);
    for number in 0..500 {
        words.publish(&text(&number.to_string()));
    }
    for number in 0..500 {
        assert_eq!(heard.recv_timeout(PATIENCE).unwrap(), text(&number.to_string()));
    }
    assert_eq!((words.dropped(), heard.dropped(), heard.malformed()), (0, 0, 0));
}

#[test]
fn oldest_messages_are_dropped() {
    let meeting = Meeting::new();
    let (one, other) = (meeting.node("one"), meeting.node("other"));
    let words = one.publish::<Text>("words", Qos::COMMANDS).unwrap();
    let heard = other.subscribe::<Text>("words", Qos { depth: 2, ..Qos::COMMANDS }).unwrap();
    until("they are connected", || words.subscribers() == 1 && heard.publishers() == 1);
    for word in ["a", "b", "c", "d"] {
        words.publish(&text(word));
    }
    until("all arrive", || heard.dropped() == 2);
    assert_eq!((heard.try_recv(), heard.try_recv()), (Some(text("c")), Some(text("d"))));
}

#[test]
fn latched_messages_reach_later_subscribers() {
    let meeting = Meeting::new();
    let (one, other) = (meeting.node("one"), meeting.node("other"));
    let clocks = one.publish::<Clock>("/clock", Qos::LATCHED).unwrap();
    for sec in 1..=3 {
        clocks.publish(&Clock { clock: Time { sec, nanosec: 0 } });
    }
    let heard = other.subscribe::<Clock>("/clock", Qos::LATCHED).unwrap();
    // RustDDS may send earlier messages, too; the last one arrives last.
    until("the last one arrives", || heard.recv_timeout(PATIENCE).unwrap().clock.sec == 3);
    assert_eq!(heard.try_recv(), None);
}

#[test]
fn commands_are_published_as_the_type_of_subscribers() {
    let meeting = Meeting::new();
    let (driver, robot) = (meeting.node("driver"), meeting.node("robot"));
    let commands = driver.publish::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
    let old = robot.subscribe::<Twist>("cmd_vel", Qos::COMMANDS).unwrap();
    let command = Command { twist: forward(0.5), ..Command::default() };
    let mut got = None;
    until("a command arrives", || {
        commands.publish(&command);
        got = old.try_recv();
        got.is_some()
    });
    assert_eq!(got, Some(forward(0.5)));
    drop(old);
    until("it is gone", || driver.peers("cmd_vel").unwrap().subscribed.is_empty());
    let new = robot.subscribe::<TwistStamped>("cmd_vel", Qos::COMMANDS).unwrap();
    let mut got = None;
    until("a stamped command arrives", || {
        commands.publish(&command);
        got = new.try_recv();
        got.is_some()
    });
    assert_eq!(got.unwrap().twist, forward(0.5));
}

#[test]
fn commands_of_either_type_are_received() {
    let meeting = Meeting::new();
    let (robot, old, new) = (meeting.node("robot"), meeting.node("old"), meeting.node("new"));
    let commands = robot.subscribe::<Command>("cmd_vel", Qos::COMMANDS).unwrap();
    let twists = old.publish::<Twist>("cmd_vel", Qos::COMMANDS).unwrap();
    let stamped = new.publish::<TwistStamped>("cmd_vel", Qos::COMMANDS).unwrap();
    until("all are connected", || commands.publishers() == 2);
    until("all are connected", || twists.subscribers() == 1 && stamped.subscribers() == 1);
    twists.publish(&forward(0.25));
    assert_eq!(commands.recv_timeout(PATIENCE).unwrap().twist, forward(0.25));
    stamped.publish(&TwistStamped { twist: forward(0.75), ..TwistStamped::default() });
    assert_eq!(commands.recv_timeout(PATIENCE).unwrap().twist, forward(0.75));
    assert_eq!((commands.try_recv(), commands.malformed()), (None, 0));
}

#[test]
fn peers_notice_at_once_that_a_node_leaves() {
    let meeting = Meeting::new();
    let (one, other) = (meeting.node("one"), meeting.node("other"));
    let words = one.publish::<Text>("words", Qos::COMMANDS).unwrap();
    let heard = other.subscribe::<Text>("words", Qos::COMMANDS).unwrap();
    until("they are connected", || words.subscribers() == 1 && heard.publishers() == 1);
    one.shut_down();
    assert!(one.is_shut_down());
    until("it is gone", || heard.publishers() == 0);
    words.publish(&text("to nobody"));
    other.shut_down();
    assert_eq!(heard.recv_timeout(PATIENCE), Err(RecvError::ShutDown));
    assert!(matches!(other.publish::<Text>("words", Qos::COMMANDS), Err(NodeError::ShutDown)));
}
