//! Driver of a robot in ROS: a [`RosRobot`], a link to it, and the thread that runs both. ROS 1 and ROS 2 are two kinds of
//! link.

use std::{sync::Arc, thread, time::Duration};

use cotorra_graph::{NodeId, RobotFault, Sensor, SensorData, SensorKind, Timestamp, Velocity};
use parking_lot::{Condvar, Mutex};

use crate::{
    driver::{CommandError, RobotDriver},
    large::Captured,
    lidar::Scan,
    ros_robot::{RosRobot, STOPS},
};

/// Longest interval between two reads of the link.
const LISTEN: Duration = Duration::from_millis(20);
/// Interval between attempts to connect.
pub(crate) const AGAIN: Duration = Duration::from_secs(1);
/// Interval between the stop commands at the end.
const BETWEEN_STOPS: Duration = Duration::from_millis(20);

/// A connection to a robot over ROS. Its calls never block.
pub trait RosLink: Send + 'static {
    /// Passes all messages since the last call to `robot`.
    fn hear(&mut self, now: Timestamp, robot: &mut RosRobot);

    /// Sends a velocity to the robot.
    fn say(&mut self, velocity: Velocity);
}

/// Returns the time since the run began.
pub type Clock = Arc<dyn Fn() -> Timestamp + Send + Sync>;

/// Drives a robot over a link.
///
/// Its thread retries until it is connected, reads messages and repeats velocities. It stops the robot when the command
/// timeout passes without a velocity, or when the driver is dropped.
pub struct RosDriver<L: RosLink> {
    id: NodeId,
    shared: Arc<Shared<L>>,
    /// State as of the last advance or command.
    seen: Seen,
    thread: Option<thread::JoinHandle<()>>,
}

struct Seen {
    sensors: SensorData,
    scan: Option<Scan>,
    health: Vec<RobotFault>,
}

struct Shared<L> {
    state: Mutex<State<L>>,
    changed: Condvar,
}

struct State<L> {
    robot: RosRobot,
    link: Option<L>,
    /// The latest time of any thread: time never falls.
    now: Timestamp,
    ended: bool,
}

impl<L: RosLink> State<L> {
    /// Reads the link, and sends the velocities that are due.
    fn go_on(&mut self, now: Timestamp) {
        self.now = self.now.max(now);
        if let Some(link) = &mut self.link {
            link.hear(self.now, &mut self.robot);
        }
        self.robot.advance(self.now);
        while let Some(velocity) = self.robot.poll_velocity(self.now) {
            if let Some(link) = &mut self.link {
                link.say(velocity);
            }
        }
    }
}

impl<L: RosLink> RosDriver<L> {
    /// Drives the robot over the link that `connect` makes. A new thread calls it, in the network namespace of the calling
    /// thread. A failure is logged and retried; the robot is absent until it succeeds.
    ///
    /// # Errors
    /// [`std::io::Error`] if the thread cannot be started.
    pub fn start<E: std::fmt::Display>(
        robot: RosRobot,
        clock: Clock,
        connect: impl FnMut() -> Result<L, E> + Send + 'static,
    ) -> std::io::Result<Self> {
        let seen = Seen { sensors: robot.sensors(), scan: None, health: robot.health().to_vec() };
        let id = robot.id().clone();
        let state = State { robot, link: None, now: Timestamp::ZERO, ended: false };
        let shared = Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new() });
        let its = Arc::clone(&shared);
        let name = format!("ros-{id}");
        let thread = thread::Builder::new().name(name).spawn(move || run(&its, &clock, connect))?;
        Ok(Self { id, shared, seen, thread: Some(thread) })
    }

    fn look(&mut self, state: &State<L>) {
        self.seen.sensors = state.robot.sensors();
        state.robot.health().clone_into(&mut self.seen.health);
        if self.seen.scan.as_ref().map(|scan| scan.at) != state.robot.scan().map(|scan| scan.at) {
            self.seen.scan = state.robot.scan().cloned();
        }
    }
}

/// Runs the driver's thread.
fn run<L: RosLink, E: std::fmt::Display>(
    shared: &Shared<L>,
    clock: &Clock,
    mut connect: impl FnMut() -> Result<L, E>,
) {
    let mut told = false;
    loop {
        if shared.state.lock().ended {
            return;
        }
        match connect() {
            Ok(link) => {
                shared.state.lock().link = Some(link);
                break;
            }
            // Logged once: further attempts fail in the same way.
            Err(error) if !told => {
                told = true;
                tracing::warn!("robot {}: {error}; trying again", shared.state.lock().robot.id());
            }
            Err(_) => {}
        }
        shared.changed.wait_while_for(&mut shared.state.lock(), |state| !state.ended, AGAIN);
    }
    let mut state = shared.state.lock();
    while !state.ended {
        state.go_on(clock());
        let now = state.now;
        let wait = state.robot.next_deadline(now).map_or(LISTEN, |at| at.since(now).min(LISTEN));
        shared.changed.wait_for(&mut state, wait.max(Duration::from_millis(1)));
    }
    let Some(mut link) = state.link.take() else { return };
    drop(state);
    // Leave the robot standing for its next driver. Messages may be lost, so that several are sent.
    for _ in 0..STOPS {
        link.say(Velocity::default());
        shared.changed.wait_for(&mut shared.state.lock(), BETWEEN_STOPS);
    }
}

impl<L: RosLink> RobotDriver for RosDriver<L> {
    fn robot(&self) -> &NodeId {
        &self.id
    }

    fn command_timeout(&self) -> Duration {
        RosRobot::COMMAND_TIMEOUT
    }

    fn advance(&mut self, now: Timestamp) {
        let shared = Arc::clone(&self.shared);
        let mut state = shared.state.lock();
        state.go_on(now);
        self.look(&state);
    }

    fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError> {
        let shared = Arc::clone(&self.shared);
        let mut state = shared.state.lock();
        state.now = state.now.max(now);
        let at = state.now;
        let done = state.robot.command(at, velocity);
        state.go_on(at);
        self.look(&state);
        done
    }

    fn stop(&mut self, now: Timestamp) {
        let mut state = self.shared.state.lock();
        state.now = state.now.max(now);
        let at = state.now;
        state.robot.stop(at);
        state.go_on(at);
    }

    fn sensors(&self) -> SensorData {
        self.seen.sensors.clone()
    }

    fn scan(&self) -> Option<&Scan> {
        self.seen.scan.as_ref()
    }

    fn sense(&mut self, _now: Timestamp, sensor: &Sensor) -> Option<(Timestamp, Vec<f64>)> {
        let mut state = self.shared.state.lock();
        let (measured, values) = state.robot.take_reading(&sensor.id)?;
        let (expected, found) = (sensor.kind.components().len(), values.len());
        if found != expected {
            state.robot.refuse(&sensor.id, &format!("it has {expected} numbers, and its topic {found}"));
            return None;
        }
        Some((measured, values))
    }

    fn capture(&mut self, sensor: &Sensor, read: Option<Timestamp>) -> Option<Captured> {
        match sensor.kind {
            SensorKind::Images { .. } => self.shared.state.lock().robot.take_image(&sensor.id),
            SensorKind::Lidar { .. } => self.scan().filter(|scan| read != Some(scan.at)).map(Captured::from),
            _ => None,
        }
    }

    fn poll_notice(&mut self) -> Option<String> {
        self.shared.state.lock().robot.poll_notice()
    }

    fn health(&self) -> &[RobotFault] {
        &self.seen.health
    }
}

impl<L: RosLink> Drop for RosDriver<L> {
    fn drop(&mut self) {
        self.shared.state.lock().ended = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic ends the thread, too.
            let _ = thread.join();
        }
    }
}
