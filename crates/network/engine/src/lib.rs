//! Engines that run VNFs: the interface [`Engine`], processes with limits, and an engine in memory for virtual time.
//!
//! Network Control decides what runs where. An engine starts and stops instances, and reports what became of them.
#![forbid(unsafe_code)]

mod backoff;
mod cgroup;
mod computed;
#[cfg(feature = "contract")]
pub mod contract;
mod engine;
mod environment;
mod memory;
mod process;
mod processor_waits;
mod tally;

pub use backoff::Backoff;
pub use cgroup::{CgroupError, Cgroups};
pub use computed::{NoRequestLine, RequestLine, Requests, VnfComputed};
pub use engine::{Engine, EngineEvent, InstanceId, Outcome};
pub use environment::{Variable, program_of, program_of_others};
pub use memory::InMemoryEngine;
pub use process::{Launcher, Process, ProcessEngine, READY, START, replica_name};
pub use processor_waits::{InstanceWaits, ProcessorWaits};
