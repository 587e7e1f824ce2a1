//! Carries the [protocol](cotorra_agent_protocol) between the core and its agents over Zenoh, with mutual TLS.
//!
//! The core's [`Router`] listens; an agent's [`Dialer`] connects to it, and again whenever the connection was lost. Scouting is
//! off. All keys of an agent begin with `cotorra/<run>/agent/<agent>/`, and the router's access control lets an agent use no
//! others. It knows agents by the common names of their certificates.
#![forbid(unsafe_code)]

mod config;
mod diagnosis;
mod dialer;
mod error;
mod keys;
mod router;

pub use config::{Credentials, Granted};
pub use diagnosis::diagnose;
pub use dialer::{Dialer, Fetcher, FromCore, RobotSender};
pub use error::TransportError;
pub use router::{FromAgent, Receiver, Router};
