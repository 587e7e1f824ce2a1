#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod extension;
mod link;
mod measurement;
mod one_way;
mod packet;
mod reflector;
mod sender;
mod session;
mod utc;

pub use link::Link;
pub use measurement::{Answer, Delays, LinkEstimate, Measurement, OneWay};
pub use packet::{BASE_LENGTH, Malformed, PORT};
pub use reflector::{Reflection, Reflector};
pub use sender::{Clock, Sender, receive};
pub use session::{Session, SessionConfig};
pub use utc::{ErrorEstimate, Utc};
