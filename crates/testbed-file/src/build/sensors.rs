//! Sensors that a robot declares.

use std::{collections::BTreeMap, f64::consts::PI, time::Duration};

use cotorra_graph::{
    Camera, DataFormat, Driver, RobotModel, Sensor, SensorId, SensorKind, SensorMessage, SensorTopic,
};

use crate::{
    records::{CameraRecord, RobotRecord, SensorRecord},
    yaml::{Frequency, Sink, Span, decode::Spanned},
};

/// Readings a second, at least and at most.
const RATES: (f64, f64) = (0.001, 1000.0);
/// The simulation moves a robot so often in a second: between its steps there is nothing to be read.
const SIMULATED: f64 = 50.0;
/// Pixels of the widest and of the highest image.
const LARGEST_IMAGE: u16 = 2048;
/// Fields of view, radians.
const NARROWEST: f64 = 1.0 / 180.0 * PI;
const WIDEST: f64 = 150.0 / 180.0 * PI;
/// The usual one.
const FIELD_OF_VIEW: f64 = 60.0 / 180.0 * PI;
/// Characters of the longest unit.
const LONGEST_UNIT: usize = 16;

/// The sensors of a robot. One whose driver cannot be has it reported elsewhere.
pub(super) fn sensors(robot: &RobotRecord, driver: Option<&Driver>, sink: &mut Sink) -> Vec<Sensor> {
    let is_simulated = driver.is_none_or(|driver| matches!(driver, Driver::Simulated { .. }));
    let is_kobuki = matches!(driver, Some(Driver::Kobuki(_)));
    let has_lidar = !matches!(driver, Some(Driver::Kobuki(its)) if its.lidar.is_none());
    let mut batteries = 0;
    let records = &robot.sensors.0;
    let build = |(id, record): &(Spanned<SensorId>, SensorRecord)| {
        let span = &id.span;
        if let Some(topic) = topic(record).filter(|_| is_simulated || is_kobuki) {
            let whose = if is_simulated { "a simulated robot's" } else { "a Kobuki's" };
            sink.error(&topic.span, format!("{whose} sensors have no topics"))
                .help("leave out `topic`: it is for a robot that speaks ROS");
        }
        let (rate, kind) = match record {
            SensorRecord::Odometry(its) => (&its.rate, SensorKind::Odometry),
            SensorRecord::Battery(its) => {
                batteries += 1;
                let charge = its.charge.as_ref();
                if !is_simulated {
                    simulated_only(charge.map(|charge| &charge.span), "charge", sink);
                } else if robot.model != RobotModel::Turtlebot2 {
                    sink.error(span, "no battery is simulated but a TurtleBot 2's")
                        .help("remove it, or declare a `kind: vector` that a plug-in reports");
                } else if batteries > 1 {
                    sink.error(span, "a robot has one battery").help("remove one of them");
                } else if robot.power.as_ref().is_some_and(|power| power.battery.is_some()) {
                    sink.error(
                        span,
                        "this sensor reads a TurtleBot 2's battery, and `power` declares another",
                    )
                    .help("leave out this sensor, or the `battery` of `power`");
                }
                let charge = is_simulated.then(|| charge.map_or(1.0, |charge| charge.value.get()));
                (&its.rate, SensorKind::Battery { charge })
            }
            SensorRecord::Imu(its) => (&its.rate, SensorKind::Imu),
            SensorRecord::Lidar(_) if !has_lidar => {
                sink.error(span, "this robot has no lidar").help("remove it, or `lidar: none` of its driver");
                return None;
            }
            SensorRecord::Camera(_) if is_kobuki => {
                sink.error(span, "a Kobuki has no camera").help("remove it, or drive the robot over ROS");
                return None;
            }
            SensorRecord::Lidar(its) => (&its.rate, SensorKind::Lidar { keep_bytes: its.keep.0 }),
            SensorRecord::Camera(its) if is_simulated => (&its.rate, SensorKind::Camera(camera(its, sink))),
            SensorRecord::Camera(its) => {
                simulated_only(its.width.as_ref().map(|said| &said.span), "width", sink);
                simulated_only(its.height.as_ref().map(|said| &said.span), "height", sink);
                simulated_only(its.format.as_ref().map(|said| &said.span), "format", sink);
                simulated_only(its.field_of_view.as_ref().map(|said| &said.span), "field_of_view", sink);
                if let Some(to) = &its.to {
                    sink.error(&to.span, "only a simulated camera's images cross the emulated network")
                        .help("leave out `to`: read its images over the API");
                }
                (&its.rate, SensorKind::Images { keep_bytes: its.keep.0 })
            }
            SensorRecord::Vector(its) => {
                if !(1..=SensorKind::LARGEST).contains(&its.size.value) {
                    sink.error(&its.size.span, format!("a vector of {} numbers", its.size.value))
                        .help(format!("write 1 to {}", SensorKind::LARGEST));
                }
                if its.unit.value.chars().count() > LONGEST_UNIT {
                    sink.error(&its.unit.span, "this unit is too long")
                        .help(format!("use {LONGEST_UNIT} characters at most"));
                }
                (&its.rate, SensorKind::Vector { size: its.size.value, unit: its.unit.value.clone() })
            }
        };
        let is_moved = !matches!(kind, SensorKind::Vector { .. });
        let most = if is_simulated && is_moved { SIMULATED } else { RATES.1 };
        let interval = interval(rate.value, most, &rate.span, sink)?;
        Some(Sensor { id: id.value.clone(), interval, kind })
    };
    records.iter().filter_map(build).collect()
}

/// The topic that a sensor names.
fn topic(record: &SensorRecord) -> Option<&Spanned<String>> {
    match record {
        SensorRecord::Odometry(_) | SensorRecord::Lidar(_) => None,
        SensorRecord::Battery(its) => its.topic.as_ref(),
        SensorRecord::Imu(its) => its.topic.as_ref(),
        SensorRecord::Camera(its) => its.topic.as_ref(),
        SensorRecord::Vector(its) => its.topic.as_ref(),
    }
}

/// The topics of the sensors of a robot in ROS that have one: the usual are those of TurtleBot 3 and 4. `name` reads a
/// name, or reports that it is none.
pub(super) fn topics(
    robot: &RobotRecord,
    mut name: impl FnMut(&Spanned<String>) -> Option<String>,
) -> BTreeMap<SensorId, SensorTopic> {
    let topic = |(id, record): &(Spanned<SensorId>, SensorRecord)| {
        let said = topic(record);
        let usual = match record {
            SensorRecord::Battery(_) => Some("battery_state"),
            SensorRecord::Imu(_) => Some("imu"),
            SensorRecord::Camera(_) => Some("camera/image_raw"),
            SensorRecord::Odometry(_) | SensorRecord::Lidar(_) | SensorRecord::Vector(_) => None,
        };
        let name = said.map_or_else(|| usual.map(str::to_owned), &mut name)?;
        let message = match record {
            SensorRecord::Battery(_) => SensorMessage::BatteryState,
            SensorRecord::Camera(_) if name.ends_with("/compressed") => SensorMessage::CompressedImage,
            SensorRecord::Camera(_) => SensorMessage::Image,
            SensorRecord::Vector(_) => SensorMessage::Float64MultiArray,
            SensorRecord::Imu(_) | SensorRecord::Odometry(_) | SensorRecord::Lidar(_) => SensorMessage::Imu,
        };
        Some((id.value.clone(), SensorTopic { name, message }))
    };
    robot.sensors.0.iter().filter_map(topic).collect()
}

/// Reports what only a simulated robot has.
fn simulated_only(said: Option<&Span>, key: &str, sink: &mut Sink) {
    if let Some(span) = said {
        sink.error(span, "only a simulated robot has this")
            .help(format!("leave out `{key}`: the robot's messages say what there is"));
    }
}

/// A camera, as it is declared. What cannot be, the sink then knows.
fn camera(record: &CameraRecord, sink: &mut Sink) -> Camera {
    for pixels in [&record.width, &record.height].into_iter().flatten() {
        if !(1..=LARGEST_IMAGE).contains(&pixels.value) {
            sink.error(&pixels.span, format!("an image of {} pixels", pixels.value))
                .help(format!("write 1 to {LARGEST_IMAGE}"));
        }
    }
    let field_of_view = record.field_of_view.as_ref().map_or(FIELD_OF_VIEW, |said| said.value.0);
    if let Some(said) = &record.field_of_view
        && !(NARROWEST..=WIDEST).contains(&field_of_view)
    {
        let (least, most) = (NARROWEST.to_degrees().round(), WIDEST.to_degrees().round());
        sink.error(&said.span, "no camera has this field of view")
            .help(format!("write {least} deg to {most} deg"));
    }
    Camera {
        width: record.width.as_ref().map_or(320, |said| said.value),
        height: record.height.as_ref().map_or(240, |said| said.value),
        format: record.format.as_ref().map_or(DataFormat::Mono8, |said| said.value),
        field_of_view,
        to: record.to.as_ref().map(|to| to.value.clone()),
        keep_bytes: record.keep.0,
    }
}

/// Returns the time between readings. Reports a rate that cannot be.
fn interval(Frequency(rate): Frequency, most: f64, span: &Span, sink: &mut Sink) -> Option<Duration> {
    if (RATES.0..=most).contains(&rate) {
        return Some(Duration::from_nanos((1e9 / rate).round() as u64));
    }
    sink.error(span, format!("this sensor cannot be read {rate} times a second"))
        .help(format!("write a rate from {} Hz to {most} Hz", RATES.0));
    None
}
