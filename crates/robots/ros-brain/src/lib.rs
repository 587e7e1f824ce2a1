//! The bundled brain as a node of ROS 1 or ROS 2: the poses of one robot in, velocities along its walk out.
//!
//! [`serve`] is the program, which an engine starts as a VNF with the variables of `cotorra_vnfs`. The robot's topics,
//! and where they are, are those of the testbed file. It does not stop the robot when it ends: a robot stops by itself when
//! commands stay away.
#![forbid(unsafe_code)]

mod error;
mod follow;
mod ros1;
mod ros2;

use std::{convert::Infallible, thread, time::Duration};

use cotorra_brain::Pilot;
use cotorra_engine::READY;
use cotorra_graph::{NodeId, Ros, Testbed};
use cotorra_plugin::vnf;
use cotorra_vnfs::Assignment;

pub use error::RosBrainError;
use follow::{Topics, follow};

/// Pause between attempts to connect.
const AGAIN: Duration = Duration::from_millis(500);

/// Navigates the robot named by `COTORRA_ROBOT` over ROS until the process ends. Calls `hasten` before threads are started
/// that answer: navigation works for microseconds, and must not wait for other work of the machine.
///
/// # Errors
/// [`RosBrainError`]; never returns otherwise.
pub fn serve(hasten: impl FnOnce()) -> Result<Infallible, RosBrainError> {
    let Assignment { testbed, robot, .. } = cotorra_vnfs::assignment()?;
    let pilot = Pilot::new(&testbed, &robot)?;
    let ros = of_robot(&testbed, &robot).ok_or_else(|| RosBrainError::NotInRos(robot.clone()))?;
    hasten();
    match ros {
        Ros::Ros1(ros1) => run(pilot, &robot, || ros1::connect(&testbed, &robot, &ros1)),
        Ros::Ros2(ros2) => run(pilot, &robot, || ros2::connect(&robot, &ros2)),
    }
}

fn of_robot(testbed: &Testbed, robot: &NodeId) -> Option<Ros> {
    let mut robots = testbed.graph.robots();
    robots.find(|(node, _)| node.id == *robot).and_then(|(_, found)| found.driver.ros())
}

/// Connects, reports that the VNF is ready, and follows the walk until the node is shut down.
fn run<T: Topics>(
    mut pilot: Pilot,
    robot: &NodeId,
    connect: impl Fn() -> Result<T, RosBrainError>,
) -> Result<Infallible, RosBrainError> {
    let topics = patiently(connect);
    println!("{READY}");
    vnf::log(format_args!("navigating `{robot}` over ROS"));
    follow(&mut pilot, &topics);
    Err(RosBrainError::ShutDown)
}

/// Connects as soon as that is possible: a robot that is not attached yet cannot reach its master.
#[allow(
    clippy::disallowed_methods,
    reason = "the shell of a program, which has nothing else to do until it is connected"
)]
fn patiently<T>(connect: impl Fn() -> Result<T, RosBrainError>) -> T {
    let mut logged = false;
    loop {
        match connect() {
            Ok(topics) => return topics,
            Err(error) if !logged => {
                logged = true;
                vnf::log(format_args!("{error}; trying again"));
            }
            Err(_) => {}
        }
        thread::sleep(AGAIN);
    }
}
