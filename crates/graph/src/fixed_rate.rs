//! Rates that stations send data at without a rate control.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::units::BitRate;

/// A rate of data frames that stations never change. [`WifiStandard::fixed_rates`](crate::WifiStandard::fixed_rates) has those
/// of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FixedRate {
    /// A rate of 802.11a or g, bit/s.
    #[serde(rename = "rate_bps")]
    BitsPerSecond(BitRate),
    /// An MCS. Those of 802.11n include the number of streams, eight for each. Those of 802.11ac and ax go with all streams of
    /// the network.
    Mcs(u8),
}

impl fmt::Display for FixedRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BitsPerSecond(rate) => rate.fmt(f),
            Self::Mcs(mcs) => write!(f, "MCS {mcs}"),
        }
    }
}
