//! The WLAN Access Information Service of ETSI GS MEC 028 v2.3.1: the testbed's radio state in the standard's terms,
//! for MEC applications that use it already. docs/reference/wais.md has the mapping.
//!
//! [`Wais`] is a state machine: surveys and requests go in with the time, answers and notifications come out.
//! [`http`] owns sockets and waits.
#![forbid(unsafe_code)]

mod attributes;
mod coding;
pub mod http;
mod measurement;
mod notification;
pub mod requests;
mod subscribed;
mod survey;
#[cfg(test)]
mod testing;
pub mod types;
mod view;
mod wais;

pub use notification::Notification;
pub use survey::{Scope, Site, Survey};
pub use view::{Answer, Kind};
pub use wais::Wais;
