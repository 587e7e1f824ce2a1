//! The Location API of ETSI GS MEC 013 v3.1.1: zones, access points and users of the testbed in the standard's terms, for
//! MEC applications that use it already. docs/reference/location.md has the mapping.
//!
//! [`Location`] is a state machine: surveys and requests go in with the time, answers and notifications come out.
//! [`http`] has its resources.
#![forbid(unsafe_code)]

pub mod http;
mod location;
mod notification;
pub mod requests;
mod survey;
pub mod types;
mod view;

pub use location::Location;
pub use survey::{Site, Survey};
pub use view::{DistanceQuery, End, UserQuery};
