//! End-to-end tests of the real program: its output, its files, and that it leaves nothing behind.

#[cfg(feature = "agents")]
mod agent_enrolment;
#[cfg(feature = "agents")]
mod agents;
mod api;
mod approval;
#[cfg(feature = "containers")]
mod bench_image;
mod calibrate;
mod camera;
mod capture;
#[cfg(feature = "ethereum")]
mod chain;
mod clients;
mod command_line;
mod confinement;
#[cfg(feature = "containers")]
mod containers;
mod coverage;
mod dashboard;
mod disk;
mod documents;
mod edit;
mod fields;
mod figures;
mod flows;
mod gateway;
mod going_on;
mod harness;
mod history;
mod history_server;
#[cfg(all(feature = "agents", feature = "containers"))]
mod images_at_agent;
mod interruption;
mod kill_cycles;
mod lifecycle;
mod link;
mod localize;
mod map;
mod margin;
mod netem;
#[cfg(feature = "agents")]
mod netem_at_agents;
mod netem_links;
mod new;
mod one_robot;
mod outcome;
mod plugin;
mod port_security;
mod real_servers;
mod recording;
mod replicas;
mod reproduce;
#[cfg(feature = "agents")]
mod robot_at_agent;
mod robots;
mod ros1;
mod ros2;
mod ros_flows;
mod ros_sensors;
mod run;
mod same_figures;
mod sensors;
mod shards;
mod stamp;
mod steer;
mod sweep;
mod terminal;
mod time_parts;
mod turtlebot;
#[cfg(feature = "ethereum")]
mod two_cores;
mod verdicts;
mod wais;
mod whole;
