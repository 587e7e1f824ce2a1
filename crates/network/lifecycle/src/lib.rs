//! The life cycle of applications in the terms of two published interfaces: the FDUs and networks of Eclipse fog05 v0.2, and
//! ETSI GS MEC 010-2 v2.1.1. docs/use/lifecycle.md has the mapping.
//!
//! [`Applications`] is a state machine without a socket or a clock. It says which instruction to give, and is told the outcome.
//! VNFs of services are in it beside the VNFs that are added, and are moved, started and stopped by the instruction `place`. [`fog05`] and [`mec`] read requests and write documents. [`Subscriptions`] hold notifications for those who
//! subscribed to changes.
#![forbid(unsafe_code)]

mod application;
mod applications;
mod descriptor;
mod error;
pub mod fog05;
pub mod mec;
mod network;
mod networks;
mod operation;
mod placed;
mod subscriptions;

pub use application::{Application, Output, Seen, Stage};
pub use applications::Applications;
pub use descriptor::{Descriptor, DescriptorError, LONGEST_DESCRIPTOR, variables};
pub use error::LifecycleError;
pub use network::{Network, NetworkDescriptor};
pub use subscriptions::{Recipient, Subscription, SubscriptionType, Subscriptions};
