//! Common parts of the service APIs of ETSI MEC (ETSI GS MEC 009): queries with filters and selectors of attributes,
//! problem details, and notifications to subscribers.
//!
//! A service keeps an [`Outbox`] for each subscription, and decides what goes into it. A [`Delivery`] sends the
//! notifications of services, each of which is a [`Notifier`]. [`Outbox`], [`Callback`] and [`Query`] have neither a clock
//! nor a socket.
#![forbid(unsafe_code)]

mod attributes;
mod callback;
mod delivery;
mod filter;
mod limiter;
mod outbox;
mod problem;
mod query;
mod request;
mod selector;
#[cfg(test)]
mod testing;
mod time;

pub use attributes::{Attribute, Kind};
pub use callback::{Allowed, Callback, CallbackError};
pub use delivery::{Delivery, Dispatch, Notifier, Task, deliver, post, resolve};
pub use filter::{Filter, FilterError};
pub use limiter::{Limiter, TooOften};
pub use outbox::{Outbox, Outcome};
pub use problem::{Problem, ProblemDetails};
pub use query::{Query, QueryError};
pub use request::{Parameters, authority};
pub use selector::SelectorError;
pub use time::{Epoch, TimeStamp};
