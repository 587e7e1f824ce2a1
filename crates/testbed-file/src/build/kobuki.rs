//! A TurtleBot 2 at serial ports.

use std::path::PathBuf;

use cotorra_graph::{Driver, Kobuki, Position, RobotModel, Rplidar};

use crate::{
    records::{KobukiRecord, LidarWord, RobotRecord, RplidarRecord},
    yaml::{
        Sink,
        decode::{Either, Spanned},
    },
};

/// The usual ports, which udev rules name.
const KOBUKI: &str = "/dev/kobuki";
const RPLIDAR: &str = "/dev/rplidar";
/// Speeds of the A2's models, bits per second.
const BAUDS: [u32; 2] = [115_200, 256_000];
/// Drive of the motor, usually and at most (`rplidar_sdk`).
const USUAL_PWM: u16 = 660;
const MOST_PWM: u16 = 1023;
/// Distance of a lidar from the middle of its robot at most, metres. The robot's radius is 0.18 m.
const FARTHEST: f64 = 0.5;

/// Builds the driver of a robot with these settings, or with the usual ones.
pub(super) fn driver(robot: &RobotRecord, record: Option<&KobukiRecord>, sink: &mut Sink) -> Option<Driver> {
    let span = &robot.driver.span;
    if let Some(offer) = &robot.offer {
        sink.error(&offer.span, "a real robot is not offered to ROS")
            .help("leave out `offer`: only a simulated robot can be offered");
    }
    if robot.model != RobotModel::Turtlebot2 {
        sink.error(span, "a Kobuki is the base of a TurtleBot 2").help("leave out `model`");
    }
    let usual = KobukiRecord::default();
    let record = record.unwrap_or(&usual);
    let port = path(record.port.as_ref(), KOBUKI, sink);
    let usual = RplidarRecord::default();
    let lidar = match &record.lidar {
        Some(Either::Short(LidarWord::None)) => None,
        Some(Either::Long(lidar)) => Some(rplidar(lidar, sink)?),
        None => Some(rplidar(&usual, sink)?),
    };
    let agent = robot.agent.as_ref().map(|agent| agent.value.clone());
    Some(Driver::Kobuki(Box::new(Kobuki { port: port?, lidar, agent })))
}

fn rplidar(record: &RplidarRecord, sink: &mut Sink) -> Option<Rplidar> {
    let baud = record.baud.as_ref().map_or(BAUDS[0], |baud| baud.value);
    let motor_pwm = record.motor_pwm.as_ref().map_or(USUAL_PWM, |pwm| pwm.value);
    let position = record.position.as_ref().map_or_else(Position::default, |position| position.value);
    if let Some(given) = record.baud.as_ref().filter(|given| !BAUDS.contains(&given.value)) {
        sink.error(&given.span, format!("no RPLIDAR A2 has {} bits per second", given.value))
            .help("write 115200 for an A2M8, or 256000 for an A2M7 or A2M12");
    }
    if let Some(given) = record.motor_pwm.as_ref().filter(|given| !(1..=MOST_PWM).contains(&given.value)) {
        sink.error(&given.span, format!("{} drives no motor of an RPLIDAR A2", given.value))
            .help(format!("write 1 to {MOST_PWM}; {USUAL_PWM} are about ten turns a second"));
    }
    if let Some(given) = record.position.as_ref().filter(|_| position.x.hypot(position.y) > FARTHEST) {
        sink.error(&given.span, format!("this lidar is more than {FARTHEST} m from the middle of its robot"))
            .help(
                "write its position in metres from the middle between the wheels: forward, and to the left",
            );
    }
    let heading = record.heading.map_or(0.0, |heading| heading.0);
    Some(Rplidar { port: path(record.port.as_ref(), RPLIDAR, sink)?, baud, motor_pwm, position, heading })
}

/// Returns the path of a device file. Relative ones would change with the folder.
fn path(given: Option<&Spanned<String>>, usual: &str, sink: &mut Sink) -> Option<PathBuf> {
    let Some(given) = given else { return Some(usual.into()) };
    let is_absolute = given.value.starts_with('/');
    if !is_absolute {
        sink.error(&given.span, format!("`{}` is not the path of a device file", given.value))
            .help(format!("write one from the root on, such as `{usual}`"));
    }
    is_absolute.then(|| given.value.clone().into())
}
