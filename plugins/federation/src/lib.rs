//! The orchestrator of one administrative domain, with its ledger client. When a robot is about to leave the domain's
//! coverage, it asks other domains for a virtual access point. It also offers its own radio units to others.
//!
//! [`Federation`] is the plug-in, one per domain. `cotorra_ledger` negotiates services; `cotorra_plugin`'s
//! coverage predicts when one is needed. With the setting `trigger: brain`, the robot's brain does, and says so. The published system is the COTORRA letter's second validation (arXiv 2101.07676).
#![forbid(unsafe_code)]

mod context;
mod error;
#[cfg(feature = "ethereum")]
mod ethereum;
mod hosting;
mod journey;
mod ledgers;
mod network;
mod orchestrator;
mod settings;
mod steps;

pub use cotorra_ledger::Account;
pub use error::LedgerError;
pub use ledgers::Ledgers;
pub use network::{Access, Network, PASSWORD};
pub use orchestrator::{Federation, FederationError};
pub use settings::{Behaviour, Joining, LedgerChoice, Settings};
pub use steps::Step;
