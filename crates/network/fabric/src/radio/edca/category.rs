//! Access categories: their parameters, and the one that a packet asks for.

use std::time::Duration;

use super::backoff::Parameters;

/// An access category (IEEE 802.11-2020, 10.2.3.2), from the most urgent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Category {
    /// AC_VO.
    Voice,
    /// AC_VI.
    Video,
    /// AC_BE.
    BestEffort,
    /// AC_BK.
    Background,
}

pub(super) const CATEGORIES: [Category; 4] =
    [Category::Voice, Category::Video, Category::BestEffort, Category::Background];

impl Category {
    /// Returns the category of an Ethernet frame by its DSCP (RFC 8325, figure 1, for the user priority; IEEE 802.11-2020,
    /// table 10-1, for the category). Frames without IP are best effort.
    pub(crate) fn of(frame: &[u8]) -> Self {
        let dscp = match (frame.get(12..14), frame.get(14), frame.get(15)) {
            (Some([0x08, 0x00]), _, Some(tos)) => tos >> 2,
            (Some([0x86, 0xdd]), Some(first), Some(second)) => (first << 4 | second >> 4) >> 2,
            _ => 0,
        };
        match dscp {
            // VA, EF, CS6 and CS7.
            44 | 46 | 48 | 56 => Self::Voice,
            // CS3, AF3x, CS4, AF4x and CS5.
            24 | 26 | 28 | 30 | 32 | 34 | 36 | 38 | 40 => Self::Video,
            // LE (RFC 8622) and CS1.
            1 | 8 => Self::Background,
            _ => Self::BestEffort,
        }
    }

    /// Returns what stations use unless their access point says otherwise (IEEE 802.11-2020, table 9-155).
    pub(super) fn of_station(self) -> Parameters {
        match self {
            Self::Voice => Parameters { aifsn: 2, cw_min: 3, cw_max: 7, txop: Duration::from_micros(1504) },
            Self::Video => Parameters { aifsn: 2, cw_min: 7, cw_max: 15, txop: Duration::from_micros(3008) },
            Self::BestEffort => Parameters { aifsn: 3, cw_min: 15, cw_max: 1023, txop: Duration::ZERO },
            Self::Background => Parameters { aifsn: 7, cw_min: 15, cw_max: 1023, txop: Duration::ZERO },
        }
    }

    /// Returns what access points use (hostapd's defaults for `tx_queue_data0` to `tx_queue_data3`).
    pub(super) fn of_access_point(self) -> Parameters {
        match self {
            Self::Voice | Self::Video => Parameters { aifsn: 1, ..self.of_station() },
            Self::BestEffort => Parameters { cw_max: 63, ..self.of_station() },
            Self::Background => self.of_station(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ipv4(dscp: u8) -> Vec<u8> {
        [&[0; 12][..], &[0x08, 0x00, 0x45, dscp << 2]].concat()
    }

    fn ipv6(dscp: u8) -> Vec<u8> {
        [&[0; 12][..], &[0x86, 0xdd, 0x60 | dscp >> 2, dscp << 6]].concat()
    }

    #[test]
    fn packets_ask_for_a_category_by_their_dscp() {
        use Category::{Background, BestEffort, Video, Voice};
        let table = [
            (0, BestEffort),
            (8, Background),
            (1, Background),
            (16, BestEffort),
            (34, Video),
            (40, Video),
            (46, Voice),
        ];
        for (dscp, category) in table {
            assert_eq!(Category::of(&ipv4(dscp)), category, "IPv4, {dscp}");
            assert_eq!(Category::of(&ipv6(dscp)), category, "IPv6, {dscp}");
        }
        let arp = [&[0xff; 12][..], &[0x08, 0x06, 0, 1]].concat();
        assert_eq!(Category::of(&arp), BestEffort);
        assert_eq!(Category::of(&[]), BestEffort);
    }
}
