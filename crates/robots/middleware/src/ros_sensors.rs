//! Topics of a ROS robot's declared sensors. A link takes the newest message of each. Images are decoded on threads of
//! their own, because they are large.

use std::{fmt, io, sync::Arc, thread};

use cotorra_graph::{SensorId, Timestamp};
use cotorra_ros_messages::{BatteryState, Imu};
use parking_lot::Mutex;

use crate::{
    heard::Source,
    picture::{NoPicture, Picture},
    ros_robot::RosRobot,
};

/// Length of a sensor's queue: only the newest message is read.
pub(crate) const NEWEST: usize = 1;

/// The topics of a robot's sensors.
#[derive(Default)]
pub(crate) struct SensorTopics(Vec<Topic>);

/// Passes new messages of a topic to a robot.
type Topic = Box<dyn FnMut(Timestamp, &mut RosRobot) + Send>;

impl fmt::Debug for SensorTopics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("SensorTopics").field(&self.0.len()).finish()
    }
}

impl SensorTopics {
    /// Passes the sensors' messages since the last call to the robot, without waiting.
    pub fn hear(&mut self, now: Timestamp, robot: &mut RosRobot) {
        self.0.iter_mut().for_each(|topic| topic(now, robot));
    }

    /// Subscribes to a topic with numbers.
    pub fn numbers<S: Source + Send + 'static>(
        &mut self,
        sensor: &SensorId,
        source: S,
        read: fn(S::Message) -> Vec<f64>,
    ) {
        let sensor = sensor.clone();
        self.0.push(Box::new(move |now, robot| {
            if let Some(message) = source.next() {
                robot.sensed(now, &sensor, read(message));
            }
        }));
    }

    /// Subscribes to a topic with images, until the link's node ends.
    ///
    /// # Errors
    /// [`io::Error`] if the thread cannot be started.
    pub fn images<S: Source + Send + 'static>(
        &mut self,
        sensor: &SensorId,
        source: S,
        read: fn(S::Message) -> Result<Picture, NoPicture>,
    ) -> io::Result<()> {
        let newest = Arc::new(Mutex::new(None));
        let (sensor, its) = (sensor.clone(), Arc::clone(&newest));
        let run = move || {
            while let Some(message) = source.wait() {
                let picture = read(message);
                // The image before is freed after the lock is released.
                let _before = its.lock().replace(picture);
            }
        };
        thread::Builder::new().name(format!("images-{sensor}")).spawn(run)?;
        self.0.push(Box::new(move |now, robot| {
            let picture = newest.lock().take();
            match picture {
                Some(Ok(picture)) => robot.pictured(now, &sensor, picture),
                Some(Err(reason)) => robot.refuse(&sensor, &reason.to_string()),
                None => {}
            }
        }));
        Ok(())
    }
}

/// Returns the components of an IMU's reading; NaN where it has no estimate.
pub(crate) fn imu(message: &Imu) -> Vec<f64> {
    let known = |covariance: &[f64; 9], value| if covariance[0] == -1.0 { f64::NAN } else { value };
    let (turns, moves) = (&message.angular_velocity, &message.linear_acceleration);
    let turns = [turns.x, turns.y, turns.z].map(|value| known(&message.angular_velocity_covariance, value));
    let moves =
        [moves.x, moves.y, moves.z].map(|value| known(&message.linear_acceleration_covariance, value));
    [turns, moves].concat()
}

/// Returns the components of a battery's reading; NaN where they are not measured or the charge is not within 0 to 1.
pub(crate) fn battery(message: &BatteryState) -> Vec<f64> {
    let share = f64::from(message.percentage);
    vec![if (0.0..=1.0).contains(&share) { share } else { f64::NAN }, message.voltage.into()]
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use cotorra_graph::{DataFormat, Position, RobotModel};
    use cotorra_ros_messages::{Odometry, Vector3};

    use super::*;
    use crate::fixtures::id;

    #[test]
    fn unknown_values_are_nan() {
        let message = Imu {
            angular_velocity: Vector3 { x: 1.0, y: 2.0, z: 3.0 },
            linear_acceleration: Vector3 { x: 4.0, y: 5.0, z: 6.0 },
            ..Imu::default()
        };
        assert_eq!(imu(&message), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let mut unknown = message;
        unknown.linear_acceleration_covariance[0] = -1.0;
        assert!(imu(&unknown)[3..].iter().all(|value| value.is_nan()));
        let state = |percentage| battery(&BatteryState { percentage, voltage: 16.5, ..Default::default() });
        assert_eq!(state(0.75), [0.75, 16.5]);
        for no_share in [f32::NAN, 75.0, -0.5] {
            assert!(state(no_share)[0].is_nan() && state(no_share)[1] == 16.5);
        }
    }

    /// A source of the images in a channel.
    struct ChannelSource(mpsc::Receiver<Result<Picture, NoPicture>>);

    impl Source for ChannelSource {
        type Message = Result<Picture, NoPicture>;

        fn next(&self) -> Option<Self::Message> {
            self.0.try_recv().ok()
        }
        fn wait(&self) -> Option<Self::Message> {
            self.0.recv().ok()
        }
        fn dropped(&self) -> u64 {
            0
        }
        fn malformed(&self) -> u64 {
            0
        }
    }

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn newest_image_is_read_and_unreadable_ones_are_reported_once() {
        let mut robot = RosRobot::new(id("tb"), RobotModel::Turtlebot2, Position::new(0.0, 0.0), 0.0, None);
        let mut odometry = Odometry::default();
        odometry.pose.pose.orientation.w = 1.0;
        robot.odometry(at(100), &odometry);
        let (sender, receiver) = mpsc::sync_channel(0);
        let camera = SensorId::new("camera").unwrap();
        let mut topics = SensorTopics::default();
        topics.images(&camera, ChannelSource(receiver), |told| told).unwrap();
        // Once an image is received, the one before it is stored. Sending the last one twice makes sure that it is stored.
        let tell = |told: &[Result<Picture, NoPicture>]| {
            told.iter().chain(told.last()).for_each(|told| sender.send(told.clone()).unwrap());
        };
        let picture =
            |byte| Ok(Picture { format: DataFormat::Mono8, width: 1, height: 1, bytes: [byte].into() });
        tell(&[picture(1), picture(2)]);
        topics.hear(at(100), &mut robot);
        let read = robot.take_image(&camera).unwrap();
        assert_eq!((read.measured, &*read.content.bytes()), (at(100), &[2][..]));
        assert_eq!((read.format, read.width, read.height), (DataFormat::Mono8, 1, 1));
        assert_eq!((robot.take_image(&camera), robot.poll_notice()), (None, None));

        for notices in [1, 0] {
            tell(&[Err(NoPicture::Encoding("yuv".to_owned()))]);
            topics.hear(at(200), &mut robot);
            let told = std::iter::from_fn(|| robot.poll_notice()).collect::<Vec<_>>();
            assert_eq!(told.len(), notices, "{told:?}");
            let said = "robot tb, sensor camera: its pixels are `yuv`, where";
            assert!(told.iter().all(|notice| notice.starts_with(said)), "{told:?}");
        }
    }
}
