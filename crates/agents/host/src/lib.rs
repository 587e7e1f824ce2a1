#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod bounds;
mod ethtool;
mod host;
mod interfaces;
mod link;
mod nl80211;
mod proc;
#[cfg(test)]
mod properties;
#[cfg(test)]
mod testing;
mod wifi;

pub use cotorra_graph::{MachineContext, NodeId, Timestamp};
pub use host::{Host, Part, Reading, Unavailable};

/// Decodes any bytes as each of the kernel's texts and messages. For fuzzing.
#[doc(hidden)]
pub fn read_anything(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    _ = (proc::CpuTimes::parse(&text), proc::load_average(&text), proc::memory(&text));
    _ = (link::decode(bytes), ethtool::decode(bytes), cotorra_netlink::decode_family(bytes));
    _ = (nl80211::interface(bytes), nl80211::station(bytes), nl80211::survey(bytes));
    let mut answers = cotorra_netlink::Answers::new(1);
    _ = answers.take(bytes, &|body| nl80211::station(body));
}
