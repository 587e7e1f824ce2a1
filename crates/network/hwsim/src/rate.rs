//! Rates by hwsim's indices, flags and bands.

use cotorra_fabric::{ChannelWidth, PhyRate};

use crate::message::Tries;

/// `MAC80211_HWSIM_TX_RC_*`.
mod flag {
    pub(super) const USE_RTS_CTS: u16 = 1 << 0;
    pub(super) const USE_SHORT_PREAMBLE: u16 = 1 << 2;
    pub(super) const MCS: u16 = 1 << 3;
    pub(super) const WIDTH_40: u16 = 1 << 5;
    pub(super) const SHORT_GI: u16 = 1 << 7;
    pub(super) const VHT_MCS: u16 = 1 << 8;
    pub(super) const WIDTH_80: u16 = 1 << 9;
    pub(super) const WIDTH_160: u16 = 1 << 10;
}

/// Legacy rates of hwsim's radios, in units of 100 kbit/s. At 5 GHz they begin with the fifth.
const LEGACY: [u16; 12] = [10, 20, 55, 110, 60, 90, 120, 180, 240, 360, 480, 540];
const DSSS: usize = 4;
/// First frequency above the 2.4 GHz band, MHz.
const ABOVE_2_4_GHZ: u16 = 3000;

/// Returns the legacy rates of a channel's band.
fn legacy(frequency_mhz: u16) -> &'static [u16] {
    if frequency_mhz > ABOVE_2_4_GHZ { &LEGACY[DSSS..] } else { &LEGACY }
}

/// Returns the rate that an index means on a channel; `None` if hwsim has none of the kind.
pub fn phy_rate(tries: Tries, frequency_mhz: u16) -> Option<PhyRate> {
    let Tries { index, flags, .. } = tries;
    let has = |flag: u16| flags & flag != 0;
    let width = match () {
        () if has(flag::WIDTH_160) => ChannelWidth::Mhz160,
        () if has(flag::WIDTH_80) => ChannelWidth::Mhz80,
        () if has(flag::WIDTH_40) => ChannelWidth::Mhz40,
        () => ChannelWidth::Mhz20,
    };
    if has(flag::VHT_MCS) {
        return PhyRate::vht(index & 15, (index >> 4) + 1, width, has(flag::SHORT_GI));
    }
    if has(flag::MCS) {
        return PhyRate::ht(index, width, has(flag::SHORT_GI));
    }
    let rate = legacy(frequency_mhz).get(usize::from(index))?;
    PhyRate::legacy(*rate, has(flag::USE_SHORT_PREAMBLE))
}

/// Whether RTS and CTS come before a frame.
pub fn wants_rts(tries: Tries) -> bool {
    tries.flags & flag::USE_RTS_CTS != 0
}

/// Returns the index of the fastest legacy rate of a channel's band that is not faster than a rate, or of the slowest. The
/// kernel can be told no others of a frame that it receives.
pub fn legacy_index(rate: PhyRate, frequency_mhz: u16) -> u32 {
    let speed = |rate: &u16| u64::from(*rate) * 100_000;
    let rates = legacy(frequency_mhz).iter().enumerate();
    let slower = rates.filter(|(_, known)| speed(known) <= rate.bits_per_second());
    slower.max_by_key(|(_, known)| speed(known)).map_or(0, |(index, _)| index as u32)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const CHANNEL_1: u16 = 2412;
    const CHANNEL_36: u16 = 5180;

    fn mbps(index: u8, flags: u16, frequency_mhz: u16) -> Option<f64> {
        let rate = phy_rate(Tries { index, count: 1, flags }, frequency_mhz)?;
        Some(rate.bits_per_second() as f64 / 1e6)
    }

    #[test]
    fn legacy_indices_count_from_the_bands_slowest_rate() {
        let at_2_4: Vec<_> = (0..13).map_while(|index| mbps(index, 0, CHANNEL_1)).collect();
        assert_eq!(at_2_4, [1.0, 2.0, 5.5, 11.0, 6.0, 9.0, 12.0, 18.0, 24.0, 36.0, 48.0, 54.0]);
        let at_5: Vec<_> = (0..13).map_while(|index| mbps(index, 0, CHANNEL_36)).collect();
        assert_eq!(at_5, at_2_4[4..]);
    }

    #[test]
    fn flags_say_what_an_index_means() {
        assert_eq!(mbps(7, flag::MCS, CHANNEL_1), Some(65.0));
        assert_eq!(mbps(15, flag::MCS | flag::WIDTH_40 | flag::SHORT_GI, CHANNEL_36), Some(300.0));
        // Two streams of MCS 7.
        assert_eq!(mbps(0x17, flag::VHT_MCS | flag::WIDTH_80, CHANNEL_36), Some(585.0));
        assert_eq!(mbps(0x79, flag::VHT_MCS | flag::WIDTH_160, CHANNEL_36), Some(6240.0));
        assert_eq!(mbps(0x0f, flag::VHT_MCS, CHANNEL_36), None);
        assert!(wants_rts(Tries { index: 0, count: 1, flags: flag::USE_RTS_CTS | flag::MCS }));
    }

    #[test]
    fn received_rates_are_the_next_slower_legacy_ones() {
        let index =
            |index, flags, mhz| legacy_index(phy_rate(Tries { index, count: 1, flags }, mhz).unwrap(), mhz);
        for own in 0..12 {
            assert_eq!(index(own, 0, CHANNEL_1), u32::from(own));
        }
        assert_eq!(index(0, flag::MCS, CHANNEL_1), 4, "6 Mbit/s for 6.5");
        assert_eq!(index(7, flag::MCS, CHANNEL_36), 7, "54 Mbit/s for 65");
        assert_eq!(legacy_index(PhyRate::legacy(10, false).unwrap(), CHANNEL_36), 0);
    }

    proptest! {
        #[test]
        fn every_rate_has_a_legacy_index_of_its_band(index in 0..128_u8, flags: u16, at_5: bool) {
            let mhz = if at_5 { CHANNEL_36 } else { CHANNEL_1 };
            if let Some(rate) = phy_rate(Tries { index, count: 1, flags }, mhz) {
                prop_assert!((legacy_index(rate, mhz) as usize) < legacy(mhz).len());
            }
        }
    }
}
