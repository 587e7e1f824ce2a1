//! An engine that runs VNFs in containers of podman or Docker, over the HTTP interface that both serve at a Unix socket.
//!
//! A container joins the network namespace of its node and no other network. [`ContainerEngine`] is the way in; its events are
//! the way out. [`Address`] finds the engine of this machine. A process that runs [`guard()`] outlives a killed one, and
//! [`clean`] finds what even the guard left.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod address;
mod container;
mod daemon;
mod daemon_error;
mod engine;
mod guard;
mod holder;
mod http;
mod instance;
mod leftovers;
mod ready;
mod registries;
mod service;
mod spec;
mod trial;

pub use address::{Address, NoEngine};
pub use engine::{ContainerEngine, Settings, Surroundings};
pub use guard::{GuardSettings, guard};
pub use leftovers::{Cleaned, clean, leftovers};
pub use spec::Network;
pub use trial::{TrialError, try_out};
