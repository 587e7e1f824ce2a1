//! The control protocol of hostapd and wpa_supplicant, without sockets: requests, their answers, and events.
//!
//! A request and its answer are one datagram each. Events come unasked to sockets that have attached themselves, each with its
//! level in angle brackets. hostap's `doc/ctrl_iface.doxygen` and `src/common/wpa_ctrl.h` describe the protocol.

mod answer;
mod event;
pub mod hostapd;
mod neighbour;
mod request;
pub mod wpa_supplicant;

pub use answer::AnswerError;
pub use event::{DisabledReason, Event, Message};
pub use request::{Request, attach, detach, ping, terminate};
