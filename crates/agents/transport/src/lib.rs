//! Carries the [protocol](cotorra_agent_protocol) between the core and its agents: [frames](frame) over mutual TLS 1.3 over TCP.
//!
//! The core's [`Router`] listens; an agent's [`Dialer`] connects to it, and again whenever the connection was lost. Each end
//! knows the other by the common name of its certificate, and trusts no authority but the testbed's own. An end that hears
//! nothing for a [lease](cotorra_agent_protocol::LEASE) closes the connection.
//!
//! Messages that do not fit into the bounded queues of a slow connection are dropped: the protocol sends again what matters.
#![forbid(unsafe_code)]

mod connection;
mod diagnosis;
mod dialer;
mod error;
pub mod frame;
mod outbox;
mod refusals;
mod router;
mod tls;
mod transfers;

pub use diagnosis::diagnose;
pub use dialer::{Dialer, Fetcher, FromCore, RobotSender};
pub use error::TransportError;
pub use router::{FromAgent, Granted, Receiver, Router};
pub use tls::Credentials;
