#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod address;
mod agreements;
mod error;
mod exchange;
mod header;
mod medium;
mod message;
mod phys;
mod radios;
mod rate;
mod socket;

pub use address::MacAddress;
pub use cotorra_netlink::DecodeError;
pub use error::Error;
pub use exchange::Exchange;
pub use header::{FrameType, Header};
pub use medium::{Medium, Outgoing, TryCounts};
pub use message::{Alias, DELIVERABLE, Delivery, Frame, MOST_RATES, Message, Radio, Rates, Status, Tries};
pub use phys::Phys;
pub use radios::Radios;
pub use rate::{legacy_index, phy_rate, wants_rts};
pub use socket::{Incoming, MediumSocket};

/// Decodes any bytes as the kernel's messages, and as frames. For fuzzing.
#[doc(hidden)]
pub fn read_anything(bytes: &[u8]) {
    _ = (socket::Answer::decode(bytes, 30), phys::device(bytes), Header::parse(bytes));
    if let Ok(Some(message)) = Message::decode(bytes) {
        assert_eq!(Message::decode(&message.encode()), Ok(Some(message)), "a message survives its encoding");
    }
}
