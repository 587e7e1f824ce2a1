#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod answers;
mod attributes;
mod family;
mod message;
mod socket;

pub use answers::{Answers, State};
pub use attributes::{
    DecodeError, NESTED, Writer, attributes, parse_i8, parse_i32, parse_mac, parse_u8, parse_u16, parse_u32,
    parse_u64, text,
};
pub use family::{Family, answer, decode_family};
pub use message::{ACK, DUMP, Message, REQUEST, message, messages};
pub use socket::{Netlink, bind_alone};
