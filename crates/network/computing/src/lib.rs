//! The CPUs and the accelerators of a server as state machines: requests of VNFs arrive, and finish once they had so much time
//! of a CPU, or with the batch in which an accelerator serves them.
//!
//! [`Server`] is a state machine without a clock. It has CPUs of a speed. A request uses at most one CPU, and an instance of a
//! VNF at most its limit. Instances that want more together than the server has share its CPUs max-min fairly. Within an
//! instance, requests wait for one of its workers in the order of their arrival, or share its CPUs evenly. [`Demands`] draws
//! the demands of an instance's requests. [`Migration`] moves an instance with its state to another server.
//!
//! [`Accelerator`] is a state machine, too. A model on it takes waiting requests as a batch, whose time depends on its size. One
//! batch is served at a time.
//!
//! All work of CPUs is counted in whole numbers, so that the same arrivals give the same times on every machine. A request
//! finishes at the first nanosecond at which its work is done.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod accelerator;
mod demands;
mod instance;
mod migration;
mod server;
mod share;

pub use self::{
    accelerator::{Accelerator, BatchLoad, Inferred},
    demands::Demands,
    instance::{Limits, Load},
    migration::{Migration, MigrationFigures},
    server::{Finished, Key, Refused, Server},
};
