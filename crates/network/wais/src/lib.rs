//! The WLAN Access Information Service of ETSI GS MEC 028 v2.3.1: the testbed's radio state in the standard's terms,
//! for MEC applications that use it already. docs/wais.md has the mapping.
//!
//! [`Wais`] is a state machine: surveys and requests go in with the time, answers and notifications come out.
//! [`http`] owns sockets and waits.
#![forbid(unsafe_code)]

mod attributes;
mod callback;
mod coding;
mod conditional;
mod filter;
pub mod http;
mod limiter;
mod measurement;
mod notification;
mod outbox;
pub mod requests;
mod selector;
mod survey;
#[cfg(test)]
mod testing;
pub mod types;
mod view;
mod wais;

pub use callback::{Allowed, Callback, CallbackError};
pub use filter::{Filter, FilterError};
pub use notification::Notification;
pub use outbox::Outcome;
pub use selector::SelectorError;
pub use survey::{Scope, Site, Survey};
pub use view::{Answer, Kind, Query, QueryError};
pub use wais::{Dispatch, RequestError, Resource, Target, Wais};
