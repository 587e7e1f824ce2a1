//! Both ends of the protocol, with a network between them.
#![allow(clippy::unwrap_used, reason = "a failure here fails the test")]

mod clocks;
mod instances;
mod links;
mod rig;
mod wifi;
