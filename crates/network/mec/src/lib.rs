//! Common parts of the service APIs of ETSI MEC (ETSI GS MEC 009): queries with filters and selectors of attributes,
//! problem details, and notifications to subscribers.
//!
//! A [`Machine`] is the state machine of a service. It holds [`Subscriptions`], and composes their notifications. A
//! [`Service`] serves it over HTTP and WebSockets. A [`Delivery`] sends the notifications of services, each of which is a
//! [`Notifier`]. [`Subscriptions`], [`Outbox`], [`Callback`] and [`Query`] have neither a clock nor a socket.
#![forbid(unsafe_code)]

mod answer;
mod attributes;
mod callback;
mod conditional;
#[cfg(any(test, feature = "conformance"))]
pub mod conformance;
mod delivery;
mod extract;
mod filter;
mod geodesy;
mod limiter;
mod outbox;
mod problem;
mod query;
mod request;
mod router;
mod scope;
mod selector;
mod service;
mod sockets;
mod subscribing;
mod subscription_routes;
mod subscriptions;
#[cfg(test)]
mod testing;
mod time;
mod websocket;

pub use answer::{changed, created, json, shown, tagged};
pub use attributes::{Attribute, Kind};
pub use callback::{Allowed, Callback, CallbackError};
pub use delivery::{Delivery, Dispatch, Notifier, Task, deliver, post, resolve};
pub use extract::{Base, Id, Json, if_match};
pub use filter::{Filter, FilterError};
pub use geodesy::{to_earth, to_map, to_north};
pub use limiter::{Limiter, TooOften};
pub use outbox::{Outbox, Outcome};
pub use problem::{ChangeProblems, Problem, ProblemDetails, RequestProblems};
pub use query::{Query, QueryError};
pub use request::{Parameters, authority, origin};
pub use router::router;
pub use scope::Scope;
pub use selector::SelectorError;
pub use service::{Machine, Service, Testbed};
pub use subscribing::{
    InvalidRequest, LinkType, MOST, Notifying, RequestError, Resource, SelfLink, WebsockNotifConfig, read,
};
pub use subscriptions::{Subscribed, Subscriptions, Target, check_unchanged, etag};
pub use time::{Epoch, TimeStamp};
