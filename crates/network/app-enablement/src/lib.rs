//! Application enablement of ETSI MEC: what an application on a node asks of its platform. docs/reference/mec.md has the
//! mapping.
//!
//! Three state machines serve the applications of a domain, which are its VNFs. [`Registry`] has the services that
//! applications can use (ETSI GS MEC 011, `mec_service_mgmt`). [`Support`] accompanies an application from its start to its
//! end (ETSI GS MEC 011, `mec_app_support`). [`Mobility`] announces that an application moves (ETSI GS MEC 021). None of them
//! has a clock or a socket. [`http`] has their resources.
#![forbid(unsafe_code)]

mod applications;
pub mod http;
mod links;
mod mobility;
mod registry;
mod subscription;
mod support;
#[cfg(test)]
mod testing;

pub use applications::{Applications, Site};
pub use mobility::{Mobility, MobilitySubscription};
pub use registry::{AvailabilitySubscription, Provided, Registry, ServiceInfo};
pub use support::{Support, TerminationSubscription};
