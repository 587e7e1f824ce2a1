//! The plug-ins of a testbed: makes, starts and calls them so that none can harm the testbed. One that panics, hangs,
//! floods or dies is cut off and reported, and the testbed goes on.
//!
//! [`host::PluginHost`] decides; it is the same in real time, in virtual time and in a replay. [`running`] calls plug-ins
//! in real time. Where time waits for plug-ins, [`lockstep`] calls those in process and [`external`] serves programs.
//! [`travel`] has what is on its way between the core and plug-ins that are away from it.

mod bundled;
mod error;
pub(crate) mod external;
pub(crate) mod host;
pub(crate) mod lockstep;
mod panic;
mod process;
mod programs;
pub(crate) mod running;
mod travel;

pub(crate) use bundled::{Bundled, reads_history, rehearse};
pub use error::PluginError;
pub use panic::panic_text;
pub use programs::inexact;
pub(crate) use programs::{check_programs, programs};
pub(crate) use travel::{CONTROL_PORT, Datagram, Travel};

#[cfg(test)]
mod tests;
