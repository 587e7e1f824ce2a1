//! Declared sensors of a robot: when each is due, and its readings.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    ComponentId, LargeData, NodeId, Robot, Sensor, SensorId, SensorKind, SensorReading, Timestamp,
};

use cotorra_numbers::Draws;

use crate::{
    beat::beat,
    driver::RobotDriver,
    large::{Captured, SensedData},
};

/// Sensors of a robot. Each is read at whole intervals by a clock of its own, whose phase and drift are of the seed; missed
/// readings are skipped.
#[derive(Debug, Default)]
pub(crate) struct Sensing(Vec<Sensed>);

#[derive(Debug)]
struct Sensed {
    sensor: Sensor,
    components: Vec<ComponentId>,
    next: Timestamp,
    /// Its interval by its clock.
    period: Duration,
    /// Report since the last reading of a vector, with its time.
    reported: Option<(Timestamp, Vec<f64>)>,
    /// Number of readings of large data, and time of measurement of the last.
    captured: (u64, Option<Timestamp>),
}

/// A reading, with its large data if it has any.
pub(crate) type Read = (SensorReading, Option<SensedData>);

enum Measured {
    Values(Timestamp, Vec<f64>),
    Large(Captured),
}

/// The reason for which a report is rejected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReportError {
    /// The robot has no such sensor.
    #[error("it has no sensor `{0}`")]
    UnknownSensor(SensorId),
    /// The sensor takes no reports.
    #[error("its sensor `{0}` is no vector: nobody reports what it measures")]
    NotAVector(SensorId),
    /// The number of values does not match.
    #[error("its sensor `{sensor}` has {expected} numbers, and here are {found}")]
    Size {
        /// The sensor.
        sensor: SensorId,
        /// Number of the sensor's values.
        expected: usize,
        /// Number of reported values.
        found: usize,
    },
    /// A value is NaN or infinite.
    #[error("not all values for its sensor `{0}` are finite numbers")]
    NotFinite(SensorId),
}

impl Sensing {
    pub fn new(id: &NodeId, robot: &Robot, seed: u64) -> Self {
        let sensed = |sensor: &Sensor| {
            let draws = Draws::new(seed, &format!("{id}/{}/clock", sensor.id));
            let (next, drifting) = beat(&robot.clock, sensor.interval, draws);
            // A lidar's turns are its clock: a reading at another rate would now and then find none, or two.
            let is_lidar = matches!(sensor.kind, SensorKind::Lidar { .. });
            Sensed {
                components: sensor.kind.components().into_iter().map(|(name, _)| name).collect(),
                sensor: sensor.clone(),
                next,
                period: if is_lidar { sensor.interval } else { drifting },
                reported: None,
                captured: (0, None),
            }
        };
        Self(robot.sensors.iter().map(sensed).collect())
    }

    /// Returns the time of the next reading.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.0.iter().map(|sensed| sensed.next).min()
    }

    /// Reads the sensors that are due, in order.
    pub fn read(&mut self, now: Timestamp, driver: &mut dyn RobotDriver) -> Vec<Read> {
        let due = self.0.iter_mut().filter(|sensed| sensed.next <= now);
        due.filter_map(|sensed| {
            let period = sensed.period.as_nanos() as u64;
            let periods = now.since(sensed.next).as_nanos() as u64 / period + 1;
            sensed.next = sensed.next + Duration::from_nanos(periods * period);
            let read = sensed.measure(now, driver)?;
            let (robot, sensor) = (driver.robot().clone(), sensed.sensor.id.clone());
            match read {
                Measured::Values(measured, values) => {
                    let values = sensed.components.iter().cloned().zip(values);
                    // Unknown values are left out.
                    let values: BTreeMap<_, _> = values.filter(|(_, value)| value.is_finite()).collect();
                    let reading = SensorReading { robot, sensor, measured, values, data: None };
                    (!reading.values.is_empty()).then_some((reading, None))
                }
                Measured::Large(Captured { measured, format, width, height, content }) => {
                    let (sequence, bytes) = (sensed.captured.0, content.size());
                    sensed.captured = (sequence + 1, Some(measured));
                    let data = LargeData { sequence, format, width, height, bytes };
                    let large = SensedData {
                        robot: robot.clone(),
                        sensor: sensor.clone(),
                        measured,
                        at: now,
                        data,
                        content,
                    };
                    let (values, data) = (BTreeMap::new(), Some(data));
                    Some((SensorReading { robot, sensor, measured, values, data }, Some(large)))
                }
            }
        })
        .collect()
    }

    /// Takes a reported measurement of a vector for its next reading.
    pub fn report(&mut self, now: Timestamp, sensor: &SensorId, values: &[f64]) -> Result<(), ReportError> {
        let sensed = self.0.iter_mut().find(|sensed| sensed.sensor.id == *sensor);
        let sensed = sensed.ok_or_else(|| ReportError::UnknownSensor(sensor.clone()))?;
        let (expected, found) = (sensed.components.len(), values.len());
        if !matches!(sensed.sensor.kind, SensorKind::Vector { .. }) {
            Err(ReportError::NotAVector(sensor.clone()))
        } else if expected != found {
            Err(ReportError::Size { sensor: sensor.clone(), expected, found })
        } else if !values.iter().all(|x| x.is_finite()) {
            Err(ReportError::NotFinite(sensor.clone()))
        } else {
            sensed.reported = Some((now, values.to_vec()));
            Ok(())
        }
    }
}

impl Sensed {
    /// Reads the sensor; `None` if there is no new measurement.
    fn measure(&mut self, now: Timestamp, driver: &mut dyn RobotDriver) -> Option<Measured> {
        let numbers = |(at, values)| Measured::Values(at, values);
        if let Some(reported) = self.reported.take() {
            return Some(numbers(reported));
        }
        // Data of a robot with a fault is not trusted.
        if !driver.health().is_empty() {
            return None;
        }
        match self.sensor.kind {
            SensorKind::Odometry => {
                let sensed = driver.sensors();
                let (pose, velocity) = (sensed.odometry, sensed.velocity);
                let pose = [pose.x, pose.y, pose.z, pose.heading];
                let velocity = [velocity.linear, velocity.vertical, velocity.angular];
                Some(numbers((now, [&pose[..], &velocity].concat())))
            }
            SensorKind::Battery { .. } | SensorKind::Imu | SensorKind::Vector { .. } => {
                driver.sense(now, &self.sensor).map(numbers)
            }
            SensorKind::Lidar { .. } | SensorKind::Camera(_) | SensorKind::Images { .. } => {
                driver.capture(&self.sensor, self.captured.1).map(Measured::Large)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{DataFormat, Phase, Pose, PoseSource, RobotClock, RobotFault, SensorData, Velocity};

    use super::*;
    use crate::{driver::CommandError, fixtures::id, lidar::Scan};

    /// A standing robot with these faults and this scan.
    struct Standing(NodeId, Vec<RobotFault>, Option<Scan>);

    /// Voltage of the battery, whose charge is unknown.
    const VOLTAGE: f64 = 16.5;

    impl RobotDriver for Standing {
        fn robot(&self) -> &NodeId {
            &self.0
        }
        fn command_timeout(&self) -> Duration {
            Duration::from_millis(600)
        }
        fn advance(&mut self, _now: Timestamp) {}
        fn command(&mut self, _now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError> {
            Ok(velocity)
        }
        fn stop(&mut self, _now: Timestamp) {}
        fn sensors(&self) -> SensorData {
            let pose = Pose::planar(1.0, 2.0, 0.5, [0.0; 9], PoseSource::Odometry);
            let velocity = Velocity::planar(0.3, 0.1);
            SensorData { pose, odometry: pose, velocity, bumper: false, nearest_obstacle_m: None }
        }
        fn scan(&self) -> Option<&Scan> {
            self.2.as_ref()
        }
        fn health(&self) -> &[RobotFault] {
            &self.1
        }
        fn sense(&mut self, now: Timestamp, sensor: &Sensor) -> Option<(Timestamp, Vec<f64>)> {
            match sensor.id.as_str() {
                "pack" => Some((now, vec![f64::NAN, VOLTAGE])),
                "unknown" => Some((now, vec![f64::NAN; 2])),
                "fingers" => Some((Timestamp::from_nanos(3), vec![5.0])),
                _ => None,
            }
        }
    }

    fn sensor(name: &str, ms: u64, kind: SensorKind) -> Sensor {
        Sensor { id: SensorId::new(name).unwrap(), interval: Duration::from_millis(ms), kind }
    }

    /// Sensors of a robot whose clock is aligned and right.
    fn sensing(sensors: &[Sensor]) -> Sensing {
        Sensing::new(&id("robot1"), &robot(sensors, RobotClock { phase: Phase::Aligned, drift_ppm: 0.0 }), 1)
    }

    fn robot(sensors: &[Sensor], clock: RobotClock) -> Robot {
        Robot { sensors: sensors.to_vec(), clock, ..cotorra_graph_testing::robot("lab") }
    }

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn names(readings: &[Read]) -> Vec<&str> {
        readings.iter().map(|(reading, _)| reading.sensor.as_str()).collect()
    }

    #[test]
    fn sensors_are_read_at_multiples_of_their_interval_without_catching_up() {
        let sensors = [sensor("a", 20, SensorKind::Odometry), sensor("b", 50, SensorKind::Odometry)];
        let (mut sensing, mut driver) = (sensing(&sensors), Standing(id("robot1"), Vec::new(), None));
        assert_eq!(sensing.next_deadline(), Some(at(0)));
        let first = sensing.read(at(0), &mut driver);
        assert_eq!(names(&first), ["a", "b"]);
        let values: Vec<_> = first[0].0.values.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let told = [("angular", 0.1), ("heading", 0.5), ("linear", 0.3), ("vertical", 0.0)];
        assert_eq!(values, [&told[..], &[("x", 1.0), ("y", 2.0), ("z", 0.0)]].concat());
        assert_eq!((sensing.next_deadline(), sensing.read(at(19), &mut driver)), (Some(at(20)), Vec::new()));
        // A late reading does not delay the next.
        assert_eq!(names(&sensing.read(at(75), &mut driver)), ["a", "b"]);
        assert_eq!(sensing.next_deadline(), Some(at(80)));
        assert_eq!(names(&sensing.read(at(80), &mut driver)), ["a"]);
        assert_eq!(names(&sensing.read(at(100), &mut driver)), ["a", "b"]);
    }

    /// Times of the readings of each sensor, ns, within ten seconds.
    fn times(
        robot_name: &str,
        sensors: &[Sensor],
        clock: RobotClock,
        seed: u64,
    ) -> BTreeMap<String, Vec<u64>> {
        let mut sensing = Sensing::new(&id(robot_name), &robot(sensors, clock), seed);
        let (mut driver, mut times) =
            (Standing(id(robot_name), Vec::new(), None), BTreeMap::<_, Vec<_>>::new());
        while let Some(now) = sensing.next_deadline().filter(|now| *now < at(10_000)) {
            for name in names(&sensing.read(now, &mut driver)) {
                times.entry(name.to_owned()).or_default().push(now.as_nanos());
            }
        }
        times
    }

    #[test]
    fn each_sensor_of_each_robot_has_a_phase_and_a_drift_of_its_own() {
        let sensors = [sensor("a", 100, SensorKind::Odometry), sensor("b", 100, SensorKind::Odometry)];
        let clock = RobotClock { drift_ppm: 1000.0, ..RobotClock::default() };
        let (mut phases, mut periods) = (Vec::new(), Vec::new());
        for seed in 0..200 {
            for robot in ["robot1", "robot2"] {
                for (name, times) in times(robot, &sensors, clock, seed) {
                    let steps: Vec<_> = times.windows(2).map(|two| two[1] - two[0]).collect();
                    assert!(steps.iter().all(|step| *step == steps[0]), "{name}: no reading is skipped");
                    phases.push(times[0] as f64 / 1e8);
                    periods.push((steps[0] as f64 / 1e8 - 1.0) * 1e3);
                }
            }
        }
        // Both are uniform: phases within the interval, drifts within the bound (Kolmogorov and Smirnov, 1 %).
        let drifts = periods.iter().map(|drift| (drift + 1.0) / 2.0).collect();
        for mut uniform in [phases.clone(), drifts] {
            uniform.sort_by(f64::total_cmp);
            let count = uniform.len() as f64;
            let off =
                |(i, x): (usize, &f64)| (x - i as f64 / count).abs().max((x - (i + 1) as f64 / count).abs());
            let distance = uniform.iter().enumerate().map(off).fold(0.0, f64::max);
            assert!(distance < 1.628 / count.sqrt(), "{distance}");
        }
        phases.sort_by(f64::total_cmp);
        assert!(phases.windows(2).all(|two| two[0] < two[1]), "no two are in step");
    }

    #[test]
    fn another_sensor_changes_no_other() {
        let sensors = ["a", "b", "c"].map(|name| sensor(name, 20, SensorKind::Odometry));
        let clock = RobotClock::default();
        let (few, all) = (times("robot1", &sensors[1..2], clock, 1), times("robot1", &sensors, clock, 1));
        assert_eq!(few["b"], all["b"]);
        let drift = (few["b"][400] - few["b"][0]) as f64 / 8e9 - 1.0;
        assert!(drift != 0.0 && drift.abs() <= 156e-6, "{drift}");
    }

    #[test]
    fn robot_with_a_fault_is_not_read_but_reports_are_taken() {
        let vector = SensorKind::Vector { size: 1, unit: String::new() };
        let sensors = [
            sensor("wheels", 20, SensorKind::Odometry),
            sensor("imu", 20, SensorKind::Imu),
            sensor("v", 20, vector),
        ];
        let (mut sensing, mut driver) =
            (sensing(&sensors), Standing(id("robot1"), vec![RobotFault::Silent], None));
        sensing.report(at(1), &sensors[2].id, &[7.0]).unwrap();
        assert_eq!(names(&sensing.read(at(20), &mut driver)), ["v"]);
        driver.1.clear();
        assert_eq!(
            names(&sensing.read(at(40), &mut driver)),
            ["wheels"],
            "it has no IMU, and reported nothing"
        );
    }

    #[test]
    fn unknown_values_are_left_out_and_reports_win_over_the_robot() {
        let battery = SensorKind::Battery { charge: None };
        let vector = SensorKind::Vector { size: 1, unit: String::new() };
        let sensors = [
            sensor("pack", 20, battery.clone()),
            sensor("unknown", 20, battery),
            sensor("fingers", 20, vector),
        ];
        let (mut sensing, mut driver) = (sensing(&sensors), Standing(id("robot1"), Vec::new(), None));
        let mut read = |ms, sensing: &mut Sensing| -> Vec<_> {
            let read = sensing.read(at(ms), &mut driver).into_iter();
            let values = |reading: &SensorReading| {
                reading.values.iter().map(|(name, value)| (name.to_string(), *value)).collect::<Vec<_>>()
            };
            read.map(|(reading, _)| (reading.measured, values(&reading))).collect()
        };
        let told = |at, name: &str, value| (at, vec![(name.to_owned(), value)]);
        let pack = told(at(0), "voltage_v", VOLTAGE);
        assert_eq!(read(0, &mut sensing), [pack, told(Timestamp::from_nanos(3), "0", 5.0)]);
        sensing.report(at(11), &sensors[2].id, &[7.0]).unwrap();
        assert_eq!(read(20, &mut sensing)[1], told(at(11), "0", 7.0));
    }

    #[test]
    fn lidar_is_read_once_per_turn_and_readings_are_numbered() {
        let lidar = SensorKind::Lidar { keep_bytes: 1 };
        let sensors = [sensor("front", 100, lidar.clone()), sensor("slow", 300, lidar)];
        let (mut sensing, mut driver) = (sensing(&sensors), Standing(id("robot1"), Vec::new(), None));
        let mut read = |ms, scanned: Option<u64>, health: &[RobotFault]| -> Vec<(String, u64, Timestamp)> {
            if let Some(ms) = scanned {
                let turn = Duration::from_millis(100);
                driver.2 = Some(Scan {
                    at: at(ms),
                    first_angle: 0.0,
                    angle_step: 0.1,
                    ray_interval: turn / 2,
                    turn,
                    range_min: 0.1,
                    range_max: 9.0,
                    ranges: vec![1.0, 2.0],
                });
            }
            driver.1 = health.to_vec();
            let read = sensing.read(at(ms), &mut driver);
            let large = |(reading, large): Read| {
                let (data, large) = (reading.data.unwrap(), large.unwrap());
                assert!(reading.values.is_empty());
                assert_eq!((large.data, large.at, large.measured), (data, at(ms), reading.measured));
                assert_eq!((&large.robot, &large.sensor), (&reading.robot, &reading.sensor));
                assert_eq!((data.format, data.width, data.height), (DataFormat::Scan, 2, 1));
                assert_eq!(data.bytes, large.content.bytes().len() as u64);
                (reading.sensor.to_string(), data.sequence, reading.measured)
            };
            read.into_iter().map(large).collect()
        };
        let told = |name: &str, sequence, ms| (name.to_owned(), sequence, at(ms));
        assert_eq!(read(0, None, &[]), [], "no turn is complete");
        assert_eq!(read(100, Some(20), &[]), [told("front", 0, 20)]);
        assert_eq!(read(200, None, &[]), [], "there is nothing new");
        assert_eq!(read(300, Some(220), &[RobotFault::Silent]), [], "it is not well");
        assert_eq!(read(400, None, &[]), [told("front", 1, 220)]);
        assert_eq!(read(600, Some(520), &[]), [told("front", 2, 520), told("slow", 0, 520)]);
    }
}
