//! Sources of traffic: UDP at a rate or as it was recorded, and TCP with a congestion control.

use std::{sync::Arc, time::Duration};

use cotorra_numbers::{Distribution, Draws};
use serde::{Deserialize, Serialize};

use crate::{
    hardware::Direction,
    id::{LinkId, NodeId, TrafficId},
    units::BitRate,
};

/// A source of traffic that needs no program.
#[derive(Debug, Clone, PartialEq)]
pub struct TrafficSource {
    /// Its name. Its random streams come from it.
    pub id: TrafficId,
    /// The host that sends, or the node at which it enters its link.
    pub from: NodeId,
    /// The host that receives, or the node at which it leaves its link.
    pub to: NodeId,
    /// The link that it crosses, whatever is at its ends; `None` if it goes from host to host.
    pub over: Option<OverLink>,
    /// When it begins, from the run's start.
    pub start: Duration,
    /// When it sends no new data any more; `None` for never.
    pub stop: Option<Duration>,
    /// What it sends.
    pub load: Load,
}

/// A link that a source's traffic crosses from end to end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OverLink {
    /// The wired link.
    pub link: LinkId,
    /// The direction of its data. Acknowledgements go the other way.
    pub direction: Direction,
}

/// What a source of traffic sends.
#[derive(Debug, Clone, PartialEq)]
pub enum Load {
    /// Datagrams.
    Udp {
        /// Their rate.
        rate: UdpRate,
        /// Payload of each.
        size: DatagramSize,
        /// Times between them, unless the source is saturated.
        arrivals: Arrivals,
    },
    /// Datagrams at recorded times.
    Replay(Replay),
    /// Connections.
    Tcp {
        /// Algorithm that says how much may be under way.
        congestion_control: CongestionControl,
        /// What they carry.
        sends: Sends,
    },
}

impl Load {
    /// Fewest bytes of a datagram's payload: its number and the time at which it was sent.
    pub const LEAST: u16 = 16;
    /// Most bytes of a datagram's payload: a packet of 1500 bytes.
    pub const MOST: u16 = 1472;
    /// Bytes of the headers of a datagram: Ethernet, IPv4 and UDP.
    pub const HEADERS: u16 = 42;
}

/// Rate of a source of datagrams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UdpRate {
    /// The source's first link always has a packet to send.
    Saturated,
    /// Mean rate of payloads.
    Rate(BitRate),
}

/// Payloads of datagrams, bytes, from [`Load::LEAST`] to [`Load::MOST`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DatagramSize {
    /// All are alike.
    Constant(u16),
    /// Each is drawn. Values beyond the bounds become the bounds.
    Random(Distribution),
}

impl DatagramSize {
    /// Returns the mean, bytes.
    pub fn mean(&self) -> f64 {
        match self {
            Self::Constant(size) => f64::from(*size),
            Self::Random(distribution) => {
                // A size of `n` or more is any value from half a byte below.
                let beyond = |n: u16| 1.0 - distribution.cdf(f64::from(n) - 0.5);
                f64::from(Load::LEAST) + (Load::LEAST + 1..=Load::MOST).map(beyond).sum::<f64>()
            }
        }
    }

    /// Draws a size.
    pub fn sample(&self, draws: &mut Draws) -> u16 {
        match self {
            Self::Constant(size) => *size,
            Self::Random(distribution) => {
                let size = distribution.sample(draws).round();
                size.clamp(Load::LEAST.into(), Load::MOST.into()) as u16
            }
        }
    }
}

/// Times between the datagrams of a source.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Arrivals {
    /// Such that the rate is constant.
    #[default]
    Constant,
    /// Random, independent of each other: a Poisson process.
    Poisson,
    /// Constant during some periods, and none during others.
    OnOff(OnOff),
}

/// Periods with and without datagrams, in turns, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnOff {
    /// Periods with datagrams. Their mean is above 0.
    pub on: Distribution,
    /// Periods without.
    pub off: Distribution,
}

impl OnOff {
    /// Returns the share of the time in periods with datagrams.
    pub fn share_on(&self) -> f64 {
        self.on.mean() / (self.on.mean() + self.off.mean())
    }
}

/// Recorded datagrams.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    /// The datagrams, in the order of their times. There is one at least.
    pub datagrams: Arc<[RecordedDatagram]>,
    /// Time after which they come again, at least that of the last; `None` if they come once.
    pub period: Option<Duration>,
}

impl Replay {
    /// Most datagrams of a recording.
    pub const MOST: usize = 1_000_000;
}

/// A datagram of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordedDatagram {
    /// Time from the begin.
    pub at: Duration,
    /// Bytes of its payload, from [`Load::LEAST`] to [`Load::MOST`].
    pub size: u16,
}

/// What connections carry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sends {
    /// One connection sends so many bytes in all; `None` without an end.
    Stream(Option<u64>),
    /// Each transfer has a connection of its own.
    Transfers(Transfers),
}

/// Transfers of data over connections of their own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transfers {
    /// Bytes of each. At least one byte is sent.
    pub size: Distribution,
    /// When they begin.
    pub begin: Begin,
}

/// Times at which transfers begin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Begin {
    /// Each so long after the one before has arrived, seconds.
    AfterPause(Distribution),
    /// Each so long after the one before began, seconds, with a mean above 0. A transfer is refused while the given number
    /// is open.
    Every(Distribution, u16),
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
