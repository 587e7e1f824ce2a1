//! What an agent says of its robot, and what the core commands: no bytes panic either end. What is decoded can be encoded and
//! decoded again, and the core keeps possible readings only.
#![no_main]

use cotorra_agent_protocol::{AgentClock, RemoteRobot, RobotCommand, RobotReading, RobotTurn};
use cotorra_graph::{Timestamp, Velocity};
use cotorra_turtlebot::Body;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let now = Timestamp::from_nanos(1 << 40);
    if let Ok(command) = RobotCommand::decode(bytes) {
        RobotCommand::decode(&command.encode()).expect("it was a command");
    }
    if let Ok(reading) = RobotReading::decode(bytes) {
        let again = RobotReading::decode(&reading.encode()).expect("it was a reading");
        let mut robot = RemoteRobot::new(reading.session.run);
        robot.follow(reading.session.boot, AgentClock::default());
        robot.receive(now, again);
        let _ = robot.drive(now, Velocity::planar(0.1, 0.0));
        let readings = robot.read(now);
        assert!(readings.are_possible() && readings.basic.is_none_or(|(at, _)| at <= now));
        assert!(robot.poll_command().is_some());
    }
    if let Ok(turn) = RobotTurn::decode(bytes) {
        assert_eq!(RobotTurn::decode(&turn.encode()).expect("it was a turn"), turn);
    }
});
