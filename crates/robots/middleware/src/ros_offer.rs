//! A simulated robot that is offered to ROS programs. A thread moves it and publishes its sensors, as a real robot would.

use std::{sync::Arc, thread, time::Duration};

use cotorra_graph::{NodeId, Pose, Sensor, SensorData, Timestamp, Velocity};
use parking_lot::{Condvar, Mutex};

use crate::{
    driver::{CommandError, RobotDriver, slowed},
    large::Captured,
    lidar::Scan,
    ros_driver::{AGAIN, Clock},
    simulated::SimulatedRobot,
};

/// Topic of simulation time, for ROS programs with `use_sim_time`.
pub(crate) const CLOCK: &str = "/clock";

/// Time base of the stamps in an offered robot's messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OfferedTime {
    /// The time of day, since 1970.
    Day {
        /// Start of the run.
        epoch: Timestamp,
    },
    /// The testbed's time since the run began, which is published on `/clock`.
    Testbed,
}

impl OfferedTime {
    /// Returns the stamp for a time of the run.
    pub fn stamp(self, at: Timestamp) -> Timestamp {
        match self {
            Self::Day { epoch } => at + epoch.since(Timestamp::ZERO),
            Self::Testbed => at,
        }
    }
}

/// A connection that offers a robot over ROS. Its calls never block.
pub trait RosOffer: Send + 'static {
    /// Returns the next velocity that ROS programs requested, oldest first.
    fn asked(&mut self) -> Option<Velocity>;

    /// Publishes the robot's sensors at a time, and each new turn of its lidar.
    fn tell(&mut self, at: Timestamp, sensors: &SensorData, scan: Option<&Scan>);
}

/// A simulated robot that is offered to ROS programs. The last velocity of any sender moves it.
pub struct OfferedRobot {
    id: NodeId,
    shared: Arc<Shared>,
    scan: Option<Scan>,
    thread: Option<thread::JoinHandle<()>>,
}

struct Shared {
    state: Mutex<State>,
    ended: Condvar,
}

struct State {
    robot: SimulatedRobot,
    /// The latest time of any thread: time never falls.
    now: Timestamp,
    /// Speed limit for ROS programs, m/s.
    limit: Option<f64>,
    ended: bool,
}

impl State {
    /// Applies a velocity of a ROS program, within the limit.
    fn command(&mut self, velocity: Velocity) {
        let velocity = self.limit.map_or(velocity, |limit| slowed(velocity, limit));
        if let Err(error) = self.robot.command(self.now, velocity) {
            tracing::debug!("robot {}: {error}", self.robot.robot());
        }
    }
}

impl OfferedRobot {
    /// Offers a robot over the connection that `connect` makes. A new thread calls it, in the network namespace of the
    /// calling thread. A failure is logged and retried.
    ///
    /// # Errors
    /// [`std::io::Error`] if the thread cannot be started.
    pub fn start<O: RosOffer, E: std::fmt::Display>(
        robot: SimulatedRobot,
        clock: Clock,
        mut connect: impl FnMut() -> Result<O, E> + Send + 'static,
    ) -> std::io::Result<Self> {
        let id = robot.robot().clone();
        let state = State { robot, now: Timestamp::ZERO, limit: None, ended: false };
        let shared = Arc::new(Shared { state: Mutex::new(state), ended: Condvar::new() });
        let its = Arc::clone(&shared);
        let run = move || {
            let mut told = false;
            loop {
                match connect() {
                    Ok(offer) => return serve(&its, &clock, offer),
                    // Logged once: further attempts fail in the same way.
                    Err(error) if !told => {
                        told = true;
                        tracing::warn!("robot {}: {error}; trying again", its.state.lock().robot.robot());
                    }
                    Err(_) => {}
                }
                let mut state = its.state.lock();
                its.ended.wait_while_for(&mut state, |state| !state.ended, AGAIN);
                if state.ended {
                    return;
                }
            }
        };
        let thread = thread::Builder::new().name(format!("ros-{id}")).spawn(run)?;
        Ok(Self { id, shared, scan: None, thread: Some(thread) })
    }

    fn at<R>(&self, now: Timestamp, act: impl FnOnce(&mut SimulatedRobot, Timestamp) -> R) -> R {
        let mut state = self.shared.state.lock();
        state.now = state.now.max(now);
        let now = state.now;
        act(&mut state.robot, now)
    }
}

/// Runs the robot's thread.
fn serve(shared: &Shared, clock: &Clock, mut offer: impl RosOffer) {
    let mut told = None;
    let mut state = shared.state.lock();
    while !state.ended {
        state.now = state.now.max(clock());
        let now = state.now;
        while let Some(velocity) = offer.asked() {
            state.command(velocity);
        }
        state.robot.advance(now);
        let fresh = state.robot.scan().filter(|scan| told != Some(scan.at)).cloned();
        told = fresh.as_ref().map(|scan| scan.at).or(told);
        let sensors = state.robot.sensors();
        drop(state);
        offer.tell(now, &sensors, fresh.as_ref());
        let next = now + SimulatedRobot::STEP;
        let wait = next.since(clock()).max(Duration::from_millis(1));
        state = shared.state.lock();
        shared.ended.wait_for(&mut state, wait);
    }
}

impl RobotDriver for OfferedRobot {
    fn robot(&self) -> &NodeId {
        &self.id
    }

    fn command_timeout(&self) -> Duration {
        self.shared.state.lock().robot.command_timeout()
    }

    fn advance(&mut self, now: Timestamp) {
        let known = self.scan.as_ref().map(|scan| scan.at);
        let scan = self.at(now, |robot, now| {
            robot.advance(now);
            robot.scan().filter(|scan| known != Some(scan.at)).cloned()
        });
        self.scan = scan.or(self.scan.take());
    }

    fn command(&mut self, now: Timestamp, velocity: Velocity) -> Result<Velocity, CommandError> {
        self.at(now, |robot, now| robot.command(now, velocity))
    }

    fn stop(&mut self, now: Timestamp) {
        self.at(now, |robot, now| robot.stop(now));
    }

    fn limit_others(&mut self, limit: Option<f64>) {
        self.shared.state.lock().limit = limit;
    }

    fn sensors(&self) -> SensorData {
        self.shared.state.lock().robot.sensors()
    }

    fn scan(&self) -> Option<&Scan> {
        self.scan.as_ref()
    }

    fn sense(&mut self, now: Timestamp, sensor: &Sensor) -> Option<(Timestamp, Vec<f64>)> {
        self.shared.state.lock().robot.sense(now, sensor)
    }

    fn capture(&mut self, sensor: &Sensor, read: Option<Timestamp>) -> Option<Captured> {
        self.shared.state.lock().robot.capture(sensor, read)
    }

    fn truth(&self) -> Option<Pose> {
        self.shared.state.lock().robot.truth()
    }
}

impl Drop for OfferedRobot {
    fn drop(&mut self) {
        self.shared.state.lock().ended = true;
        self.shared.ended.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic ends the thread, too.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{fixtures, world::World};

    #[test]
    fn ros_programs_drive_it_within_the_limit() {
        let world = Arc::new(World::new(&fixtures::room(20.0, 4.0)));
        let node = fixtures::robot("robot", None);
        let walk = fixtures::walk("robot", &[(1.0, 1.0), (9.0, 1.0)]);
        let robot = SimulatedRobot::new(&node, Some(&walk), world, 1).unwrap();
        let mut state = State { robot, now: Timestamp::ZERO, limit: None, ended: false };
        let mut speed_under = |limit| {
            state.limit = limit;
            // Commands are valid for 600 ms.
            for _ in 0..100 {
                state.command(Velocity::planar(0.3, 0.0));
                state.now = state.now + SimulatedRobot::STEP;
                state.robot.advance(state.now);
            }
            state.robot.sensors().velocity.linear
        };
        assert!((speed_under(None) - 0.3).abs() < 0.01);
        assert!((speed_under(Some(0.1)) - 0.1).abs() < 0.01);
        assert!(speed_under(Some(0.0)).abs() < 0.01);
        assert!((speed_under(None) - 0.3).abs() < 0.01);
    }
}
