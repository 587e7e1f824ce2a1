//! Two-way measurement of delay, jitter and loss by STAMP, the Simple Two-Way Active Measurement Protocol (RFC 8762,
//! with the session identifier and the extensions' framing of RFC 8972), unauthenticated mode.
//!
//! A [`Session`] sends test packets and measures by the replies; a [`Reflector`] answers them. Neither has a clock nor
//! a socket: the time is an argument, packets are bytes. Both work with other implementations, also with those of
//! TWAMP Light (RFC 8762, section 4.6). A [`Link`] is both sides in one hand. A [`Sender`] is a session with a socket and a
//! [`Clock`] of this machine's.
//!
//! ```
//! use std::time::Duration;
//! use cotorra_stamp::{Reflector, Session, SessionConfig, Utc};
//!
//! let ms = |ms| Utc::UNIX_EPOCH + Duration::from_millis(ms);
//! let mut session = Session::new(SessionConfig::default(), ms(0));
//! let mut reflector = Reflector::default();
//!
//! let probe = session.poll(ms(0)).expect("the first is due at once");
//! // Three milliseconds there, one of rest, four back.
//! let reply = reflector.reflect("192.0.2.1:5000", &probe, ms(3), None)?.sent_at(ms(4));
//! session.receive(&reply, ms(8))?;
//!
//! let measured = session.measurement(ms(8)).expect("one reply");
//! assert_eq!(measured.round_trip.expect("it was answered").mean, Duration::from_millis(7));
//! # Ok::<(), cotorra_stamp::Malformed>(())
//! ```
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod apart;
mod extension;
mod link;
mod measurement;
mod packet;
mod reflector;
mod sender;
mod session;
mod utc;

pub use link::Link;
pub use measurement::{Delays, LinkEstimate, Measurement, OneWay};
pub use packet::{BASE_LENGTH, Malformed, PORT};
pub use reflector::{Reflection, Reflector};
pub use sender::{Clock, Sender, receive};
pub use session::{Session, SessionConfig};
pub use utc::{ErrorEstimate, Utc};
