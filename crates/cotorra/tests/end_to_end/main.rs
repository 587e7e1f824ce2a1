//! The real program, from outside: what it prints, what it leaves, and what it does not leave.

mod api;
mod camera;
#[cfg(feature = "ethereum")]
mod chain;
mod clients;
mod command_line;
mod confinement;
mod disk;
mod documents;
mod experiment;
mod fields;
mod flows;
mod going_on;
mod harness;
mod history;
mod history_server;
mod interruption;
mod kill_cycles;
mod link;
mod localize;
mod map;
#[allow(clippy::unwrap_used, reason = "what fails here fails the test")]
#[path = "../../../measurements/src/testing/mariadb.rs"]
mod mariadb;
mod netem;
mod netem_links;
mod one_robot;
mod plugin;
#[path = "../../../robots/ros1/tests/interop/process.rs"]
#[allow(dead_code, reason = "what the tests of the nodes themselves use of it")]
#[allow(clippy::unwrap_used, reason = "what fails here fails the test")]
mod process;
mod recording;
mod replicas;
mod ros1;
mod ros2;
mod ros_flows;
mod ros_sensors;
mod run;
mod sensors;
mod stamp;
mod steer;
mod sweep;
mod wais;
