//! Runs a [`Fabric`](cotorra_fabric::Fabric) on the wall clock with real packets.
//!
//! Each host is a network namespace, with a TAP or a packet socket with offloads as its port. Programs run in hosts,
//! and nothing is left behind however the process ends. Needs Linux 5.11 or later. This is the only crate with unsafe
//! code.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let graph: cotorra_graph::HardwareGraph = unimplemented!();
//! # let robot: cotorra_graph::NodeId = unimplemented!();
//! cotorra_datapath::enter_user_namespace_if_needed()?;
//! let fabric = cotorra_fabric::Fabric::new(&graph, 1)?;
//! let datapath = cotorra_datapath::Datapath::start(&graph, fabric, Default::default())?;
//! let socket = datapath.namespace(&robot)?.udp_socket("0.0.0.0:7711")?;
//! # Ok(())
//! # }
//! ```

mod allowance;
mod awake;
mod capability;
mod clock;
mod confine;
mod cpu_time;
mod datapath;
mod engine;
mod error;
mod gateway;
mod hosts;
mod init;
mod kernel_network;
mod link_probes;
mod listener;
mod namespace;
mod neighbours;
mod netlink;
mod port;
mod presence;
mod privilege;
mod process;
mod punctual;
mod seccomp;
mod shared;
mod stamped_socket;
mod sys;
mod vnet;
mod watch;
pub mod wifi;

pub use allowance::Allowance;
pub use capability::{Capability, CapabilityState, probe, probe_confinement, simulated_radios};
pub use clock::Clock;
pub use confine::Confinement;
pub use cpu_time::cpu_time_of;
pub use datapath::{Datapath, Options};
pub use engine::{DepartureSink, EventSink, Handle, SharedSources};
pub use error::Error;
pub use gateway::{GatewayTraffic, check_gateways, error::GatewayError, gate::Passed};
pub use hosts::PortKind;
pub use kernel_network::{KernelNetwork, KernelNetworkError, Observed, ReservedHop};
pub use listener::Listening;
pub use namespace::{Namespace, wait_until_removed};
pub use presence::{Absence, PortWaits};
pub use privilege::{Privilege, enter_user_namespace_if_needed, hide_memory};
pub use process::{Child, HostsFile, SpawnOptions, open_process, raise_open_files, spawn_outside};
pub use punctual::{BusyPoll, be_punctual, be_timely};
pub use stamped_socket::StampedSocket;
