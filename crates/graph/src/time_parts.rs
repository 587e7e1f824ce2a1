//! Parts of a service time: the time in hosts, and the time on each link of the way to the VNF and back.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{hardware::Direction, id::LinkId, units::millis};

/// The parts of one service time. They add up to it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TimeParts {
    /// Time in the sender's host, until the packet that the VNF needed last entered the network.
    #[serde(rename = "sender_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub sender: Duration,
    /// Time in the VNF and its host, until the packet that the sender needed last entered the network.
    #[serde(rename = "vnf_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub vnf: Duration,
    /// Time in the receiver's host, which is the sender's.
    #[serde(rename = "receiver_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub receiver: Duration,
    /// Time that no stamp covers, such as the emulator's lateness.
    #[serde(rename = "unknown_time_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub unknown: Duration,
    /// Links in the order of the way: to the VNF, then back.
    pub links: Vec<LinkTime>,
}

/// The time that a packet spent on one link.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LinkTime {
    /// The link.
    pub link: LinkId,
    /// Direction of the crossing.
    pub direction: Direction,
    /// Whether the packet was on its way back.
    pub back: bool,
    /// Time in the queue, or until the channel was free.
    #[serde(rename = "queueing_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub queueing: Duration,
    /// Airtime of all attempts but the first.
    #[serde(rename = "retries_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub retries: Duration,
    /// Time on the air or on the wire: transmission and delay.
    #[serde(rename = "crossing_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub crossing: Duration,
}

impl LinkTime {
    /// Returns the whole time on the link.
    pub fn total(&self) -> Duration {
        self.queueing + self.retries + self.crossing
    }
}

impl TimeParts {
    /// Returns the sum of all parts, which is the service time.
    pub fn total(&self) -> Duration {
        let links: Duration = self.links.iter().map(LinkTime::total).sum();
        self.sender + self.vnf + self.receiver + self.unknown + links
    }

    /// Counts the time on other links than these as unknown.
    pub fn hide_links(&mut self, mut is_seen: impl FnMut(&LinkId) -> bool) {
        let mut hidden = Duration::ZERO;
        self.links.retain(|on| {
            let stays = is_seen(&on.link);
            hidden += if stays { Duration::ZERO } else { on.total() };
            stays
        });
        self.unknown += hidden;
    }
}
