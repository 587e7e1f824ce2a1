//! Sources of traffic in virtual time: UDP at a rate, and TCP with a congestion control.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{
    id::{NodeId, TrafficId},
    units::BitRate,
};

/// A source of traffic that needs no program. It exists in virtual time only.
#[derive(Debug, Clone, PartialEq)]
pub struct TrafficSource {
    /// Its name. Its random stream comes from it.
    pub id: TrafficId,
    /// The host that sends.
    pub from: NodeId,
    /// The host that receives.
    pub to: NodeId,
    /// When it begins, from the run's start.
    pub start: Duration,
    /// When it sends no new data any more; `None` for never.
    pub stop: Option<Duration>,
    /// What it sends.
    pub load: Load,
}

/// What a source of traffic sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Load {
    /// Datagrams.
    Udp {
        /// Their rate.
        rate: UdpRate,
        /// Payload of each, bytes; from [`Self::LEAST`] to [`Self::MOST`].
        size: u16,
        /// Times between them, unless the source is saturated.
        arrivals: Arrivals,
    },
    /// One connection.
    Tcp {
        /// Algorithm that says how much may be under way.
        congestion_control: CongestionControl,
        /// Bytes to send in all; `None` without an end.
        bytes: Option<u64>,
    },
}

impl Load {
    /// Fewest bytes of a datagram's payload: its number and the time at which it was sent.
    pub const LEAST: u16 = 16;
    /// Most bytes of a datagram's payload: a packet of 1500 bytes.
    pub const MOST: u16 = 1472;
}

/// Rate of a source of datagrams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UdpRate {
    /// The source's first link always has a packet to send.
    Saturated,
    /// Rate of payloads.
    Rate(BitRate),
}

/// Times between the datagrams of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Arrivals {
    /// Always the same.
    #[default]
    Constant,
    /// Random, independent of each other: a Poisson process.
    Poisson,
}

/// Congestion control of a TCP connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CongestionControl {
    /// RFC 5681.
    Reno,
    /// RFC 9438, Linux's default.
    #[default]
    Cubic,
    /// BBR, version 1 (draft-cardwell-iccrg-bbr-congestion-control-00).
    Bbr,
}
