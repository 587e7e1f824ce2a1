#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod answers;
mod attributes;
mod family;
mod message;
pub mod nl80211;
pub mod rtnetlink;
mod socket;

pub use answers::{Answers, State};
pub use attributes::{
    DecodeError, NESTED, Writer, attributes, parse_i8, parse_i32, parse_mac, parse_u16, parse_u32, parse_u64,
    text,
};
pub use family::{Family, answer, decode_family};
pub use message::{ACK, CREATE, DUMP, ERROR, EXCLUSIVE, Message, REPLACE, REQUEST, message, messages};
pub use netlink_sys::protocols::{NETLINK_GENERIC, NETLINK_ROUTE};
pub use socket::{Netlink, bind_alone};
