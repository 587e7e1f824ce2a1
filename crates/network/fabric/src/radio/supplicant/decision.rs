//! Whether a radio unit that a scan found is better enough to change to it: the rules of wpa_supplicant 2.11
//! (`wpa_supplicant_need_to_roam_within_ess` in `wpa_supplicant/events.c`, `wpas_get_est_tpt` in `wpa_supplicant/scan.c`).
//!
//! All radio units of a network are in one band, of one standard and one width. The rules for other bands do not matter
//! here.

use cotorra_graph::{ChannelWidth, WifiStandard};

/// A signal-to-noise ratio above which a station looks for nothing better, dB.
const GREAT_SNR: i32 = 25;
/// A difference of estimated throughputs that decides alone, kbit/s.
const CLEAR_KBPS: i32 = 5000;

/// Signal-to-noise ratios, dB, and the rates that 802.11a/g has below them, Mbit/s.
const OFDM_BELOW: [(i32, i32); 18] = [
    (1, 1),
    (4, 2),
    (5, 6),
    (6, 9),
    (7, 12),
    (8, 14),
    (9, 16),
    (10, 18),
    (11, 24),
    (12, 27),
    (13, 30),
    (14, 33),
    (15, 36),
    (16, 39),
    (17, 42),
    (18, 45),
    (19, 48),
    (20, 51),
];
/// Rate of 802.11a/g above all of them, kbit/s.
const OFDM_KBPS: i32 = 54_000;

/// Signal-to-noise ratios, dB, from which a 20 MHz channel has the rates by MCS. A doubled width needs 3 dB more.
const FROM: [i32; 12] = [2, 5, 9, 11, 15, 18, 20, 25, 29, 31, 34, 36];
/// Rates of 20, 40 and 80 MHz, kbit/s. 802.11n has the first eight.
const VHT_KBPS: [&[i32]; 3] = [
    &[6500, 13_000, 19_500, 26_000, 39_000, 52_000, 58_500, 65_000, 78_000],
    &[13_500, 27_000, 40_500, 54_000, 81_000, 108_000, 121_500, 135_000, 162_000, 180_000],
    &[29_300, 58_500, 87_800, 117_000, 175_500, 234_000, 263_300, 292_500, 351_000, 390_000],
];
const HT_MODES: usize = 8;
const HE_KBPS: [&[i32]; 3] = [
    &[8600, 17_200, 25_800, 34_400, 51_600, 68_800, 77_400, 86_000, 103_200, 114_700, 129_000, 143_400],
    &[17_200, 34_400, 51_600, 68_800, 103_200, 137_600, 154_900, 172_100, 206_500, 229_400, 258_100, 286_800],
    &[
        36_000, 72_100, 108_100, 144_100, 216_200, 288_200, 324_300, 360_300, 432_400, 480_400, 540_400,
        600_500,
    ],
];

/// Facts for the decision, beside the two signals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules {
    pub(super) standard: WifiStandard,
    pub(super) width: ChannelWidth,
    /// Noise floor, dBm.
    pub(super) noise: i32,
    /// Threshold of the background scans, dBm.
    pub(super) threshold: f64,
}

impl Rules {
    /// Whether a station changes from the radio unit with the level `current` to the one with the level `other`, dBm.
    pub(super) fn roams(&self, current: i32, other: i32) -> bool {
        let [now, then] = [current, other].map(|level| self.throughput_kbps(level));
        if then > now + CLEAR_KBPS {
            return true;
        }
        let keeps = (current > other && 5 * then < 6 * now)
            || now > then + CLEAR_KBPS
            || current - self.noise > GREAT_SNR;
        !keeps && other - current >= self.margin(current, other)
    }

    /// Returns by how much another radio unit must be stronger, dB.
    fn margin(&self, current: i32, other: i32) -> i32 {
        let by_level = match current {
            ..-85 => 1,
            -85..-80 => 2,
            -80..-75 => 3,
            -75..-70 => 4,
            -70.. => 5,
        };
        let [now, then] = [current, other].map(|level| self.throughput_kbps(level));
        let by_throughput = match () {
            () if 2 * now > 3 * then => 10,
            () if 5 * now > 6 * then => 5,
            () if 10 * now > 11 * then => 2,
            () if now > then => 1,
            () if 2 * then > 3 * now => -10,
            () if 5 * then > 6 * now => -5,
            () if 10 * then > 11 * now => -2,
            () if then > now => -1,
            () => 0,
        };
        let crosses = f64::from(current) <= self.threshold && f64::from(other) > self.threshold;
        by_level + by_throughput - if crosses { 2 } else { 0 }
    }

    /// Returns the throughput that wpa_supplicant expects at a level.
    fn throughput_kbps(&self, level: i32) -> i32 {
        let snr = level - self.noise;
        let ofdm = OFDM_BELOW.iter().find(|(below, _)| snr < *below);
        let ofdm = ofdm.map_or(OFDM_KBPS, |(_, mbps)| mbps * 1000);
        // A station also has the rates of narrower channels, and knows those of one stream alone.
        let widths = self.width.mhz().ilog2() as usize - 3;
        let fastest = |kbps: [&[i32]; 3], modes: usize| {
            let by_width = kbps.iter().zip(0..).take(widths);
            let at_width = |(kbps, doublings): (&&[i32], i32)| {
                interpolate(&kbps[..modes.min(kbps.len())], snr, 3 * doublings)
            };
            by_width.map(at_width).fold(ofdm, i32::max)
        };
        match self.standard {
            WifiStandard::A | WifiStandard::G => ofdm,
            WifiStandard::N => fastest(VHT_KBPS, HT_MODES),
            WifiStandard::Ac => fastest(VHT_KBPS, FROM.len()),
            WifiStandard::Ax => fastest(HE_KBPS, FROM.len()),
        }
    }
}

/// Returns the rate at a signal-to-noise ratio, between those of a table, which begins with nothing at 0 dB. Its ratios are
/// `more_db` above those of 20 MHz.
fn interpolate(kbps: &[i32], snr: i32, more_db: i32) -> i32 {
    let from = |i: usize| if i == 0 { (0, 0) } else { (FROM[i - 1] + more_db, kbps[i - 1]) };
    match (0..=kbps.len()).rev().find(|i| snr >= from(*i).0) {
        None => 0,
        Some(last) if last == kbps.len() => from(last).1,
        Some(i) => {
            let [(snr0, rate0), (snr1, rate1)] = [from(i), from(i + 1)];
            rate0 + (snr - snr0) * (rate1 - rate0) / (snr1 - snr0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn rules(standard: WifiStandard, noise: i32) -> Rules {
        Rules { standard, width: ChannelWidth::Mhz20, noise, threshold: -65.0 }
    }

    #[test]
    fn throughput_grows_with_the_signal_to_noise_ratio() {
        let kbps = |standard, snr| rules(standard, -95).throughput_kbps(snr - 95);
        use WifiStandard::{A, Ac, Ax, G, N};
        let at = [-3, 0, 3, 7, 10, 14, 20, 23, 27, 40];
        assert_eq!(at.map(|snr| kbps(G, snr)), at.map(|snr| kbps(A, snr)));
        let ofdm = [1000, 1000, 2000, 14_000, 24_000, 36_000, 54_000, 54_000, 54_000, 54_000];
        assert_eq!(at.map(|snr| kbps(G, snr)), ofdm);
        // 8666 = 6500 + 6500 / 3. At 10 dB the rate of 802.11g is above the 22,750 of 802.11n.
        let ht = [1000, 1000, 8666, 16_250, 24_000, 36_000, 58_500, 62_400, 65_000, 65_000];
        assert_eq!(at.map(|snr| kbps(N, snr)), ht);
        let vht = [1000, 1000, 8666, 16_250, 24_000, 36_000, 58_500, 62_400, 71_500, 78_000];
        assert_eq!(at.map(|snr| kbps(Ac, snr)), vht);
        // 8600 + 8600 / 3, and so on.
        let he = [1000, 1000, 11_466, 21_500, 30_100, 47_300, 77_400, 82_560, 94_600, 143_400];
        assert_eq!(at.map(|snr| kbps(Ax, snr)), he);
        for standard in [G, N, Ac, Ax] {
            assert!((-10..50).all(|snr| kbps(standard, snr) <= kbps(standard, snr + 1)));
        }
    }

    #[test]
    fn wide_channels_are_faster_where_the_signal_is_strong() {
        use ChannelWidth::{Mhz20, Mhz40, Mhz80};
        let kbps = |width, snr| {
            [WifiStandard::N, WifiStandard::Ac, WifiStandard::Ax]
                .map(|standard| Rules { width, ..rules(standard, -95) }.throughput_kbps(snr - 95))
        };
        assert_eq!(kbps(Mhz20, 60), [65_000, 78_000, 143_400]);
        assert_eq!(kbps(Mhz40, 60), [135_000, 180_000, 286_800]);
        assert_eq!(kbps(Mhz80, 60)[1..], [390_000, 600_500]);
        // At 5 dB, 40 MHz have 13,500 and 20 MHz 13,000 kbit/s; at 8 dB, 80 MHz have 29,300 and 40 MHz 27,000.
        assert_eq!(kbps(Mhz40, 5)[0], 13_500);
        assert_eq!(kbps(Mhz80, 8)[1], 29_300);
    }

    /// Returns the ranges of levels at which the same step up makes a station roam: first and last level, dBm, and the least
    /// step, dB. Only a great signal keeps a station from every step.
    fn steps(standard: WifiStandard, noise: i32) -> Vec<(i32, i32, Option<i32>)> {
        let rules = rules(standard, noise);
        let mut steps: Vec<(i32, i32, Option<i32>)> = Vec::new();
        for level in -92..-60 {
            let step = (-10..40).find(|step| rules.roams(level, level + step));
            match steps.last_mut() {
                Some((_, last, same)) if *same == step => *last = level,
                _ => steps.push((level, level, step)),
            }
        }
        steps
    }

    #[test]
    fn the_least_step_up_follows_the_decision_table() {
        use WifiStandard::{Ac, G, N};
        let g = [(-92, -81, Some(1)), (-80, -76, Some(2)), (-75, -71, Some(4)), (-70, -70, Some(5))];
        assert_eq!(steps(G, -95), [&g[..], &[(-69, -61, None)]].concat());
        let n = [(-92, -80, Some(1)), (-79, -76, Some(2)), (-75, -71, Some(3)), (-70, -70, Some(5))];
        assert_eq!(steps(N, -95), [&n[..], &[(-69, -61, None)]].concat());
        // 802.11ac has a higher rate for signals that are great already.
        let ac = [&n[..3], &[(-70, -68, Some(2)), (-67, -61, None)]].concat();
        assert_eq!(steps(Ac, -95), ac);
        // Without noise, throughputs are equal, and the margin is that of the level.
        assert_eq!(steps(G, -110), [(-92, -86, Some(1)), (-85, -85, Some(2)), (-84, -61, None)]);
    }

    #[test]
    fn the_margin_adds_level_throughput_and_threshold() {
        let g = rules(WifiStandard::G, -110);
        // Equal throughputs: the level alone.
        let levels = [-90, -86, -85, -81, -80, -76, -75, -71, -70, -66];
        assert_eq!(levels.map(|level| g.margin(level, level)), [1, 1, 2, 2, 3, 3, 4, 4, 5, 5]);
        assert_eq!(g.margin(-66, -64), 3, "the other is above the threshold");
        assert_eq!(g.margin(-64, -60), 5, "both are above it");
        // 802.11g at -95 dBm of noise. Throughputs of 16 and 18, 24 and 30, 12 and 24, 51 and 54 Mbit/s, and back.
        let g = rules(WifiStandard::G, -95);
        assert_eq!([g.margin(-87, -86), g.margin(-86, -87)], [1 - 2, 1 + 2]);
        assert_eq!([g.margin(-85, -83), g.margin(-83, -85)], [2 - 5, 2 + 5]);
        assert_eq!([g.margin(-89, -85), g.margin(-85, -89)], [1 - 10, 2 + 10]);
        assert_eq!([g.margin(-76, -75), g.margin(-75, -76)], [3 - 1, 4 + 1]);
    }

    #[test]
    fn a_clearly_higher_throughput_decides_alone() {
        // 58,500 and 39,000 kbit/s, at equal margins of level.
        let n = rules(WifiStandard::N, -95);
        assert!(n.roams(-80, -75) && !n.roams(-75, -80));
        // Even from a signal that is great: 802.11ac goes on to 78,000 kbit/s.
        let ac = rules(WifiStandard::Ac, -95);
        assert!(ac.roams(-69, -66) && !n.roams(-69, -60));
    }

    #[test]
    fn two_levels_never_swap_back_and_forth() {
        for standard in [WifiStandard::G, WifiStandard::N, WifiStandard::Ac] {
            let rules = rules(standard, -95);
            for (a, b) in (-100..-20).flat_map(|a| (-100..-20).map(move |b| (a, b))) {
                assert!(!(rules.roams(a, b) && rules.roams(b, a)), "{standard:?}: {a} and {b} dBm");
            }
        }
    }
}
