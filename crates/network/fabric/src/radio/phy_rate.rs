//! Rates of frames that somebody else chooses: a kernel's rate control, for radios whose frames only cross this air. They
//! include what the model's own stations never use: DSSS, channels of 40 MHz or more, several streams and the short guard
//! interval. Clauses and tables are those of IEEE 802.11-2020.

use std::time::Duration;

use super::phy::{Constellation, MCS, Mode, OFDM, erfc, ln_bit_success};

/// A PHY rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PhyRate(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    /// Clauses 15 and 16.
    Dsss { rate: Dsss, short_preamble: bool },
    /// Clauses 17 and 18: index among the eight rates.
    Ofdm(u8),
    /// Clause 19.
    Ht(Mimo),
    /// Clause 21.
    Vht(Mimo),
}

/// Rates of clauses 15 and 16.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Dsss {
    /// 1 Mbit/s, DBPSK.
    One,
    /// 2 Mbit/s, DQPSK.
    Two,
    /// 5.5 Mbit/s, CCK.
    FiveAndAHalf,
    /// 11 Mbit/s, CCK.
    Eleven,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Mimo {
    /// MCS of each stream, 0 to 9.
    mcs: u8,
    streams: u8,
    width: ChannelWidth,
    short_guard: bool,
}

/// Width of a transmission.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ChannelWidth {
    /// 20 MHz.
    Mhz20,
    /// 40 MHz.
    Mhz40,
    /// 80 MHz.
    Mhz80,
    /// 160 MHz.
    Mhz160,
}

/// Bandwidth of the noise floor, Hz.
const NOISE_BANDWIDTH: f64 = 20e6;
/// Chips per second (15.4.4.6).
const CHIP_RATE: f64 = 11e6;
/// Long preamble and header of DSSS (16.2.2.2), and the short ones (16.2.2.3).
const LONG_PREAMBLE_US: u64 = 192;
const SHORT_PREAMBLE_US: u64 = 96;
/// L-STF, L-LTF and L-SIG, which begin every OFDM frame.
const LEGACY_PREAMBLE_US: u64 = 20;
/// Duration of a data symbol, with the long and with the short guard interval, ns.
const SYMBOL_NS: u64 = 4000;
const SHORT_SYMBOL_NS: u64 = 3600;
/// Service field and tail of the convolutional code, bits. Each further encoder of fast rates adds a tail, which is left
/// out.
const SERVICE_AND_TAIL: u64 = 16 + 6;
/// Silence at the end of an OFDM frame at 2.4 GHz (18.3.2.4).
const EXTENSION_US: u64 = 6;
/// SIFS at 2.4 GHz and above (table 16-2, table 17-21).
const SIFS_US: [u64; 2] = [10, 16];
/// First frequency above the 2.4 GHz band, MHz.
const ABOVE_2_4_GHZ: u16 = 3000;

/// RTS, CTS and acknowledgement with their check sequences, bytes (9.3.1.2 to 9.3.1.4).
const RTS_BYTES: u64 = 20;
const CTS_BYTES: u64 = 14;
const ACK_BYTES: u64 = 14;
/// Length of a compressed block acknowledgement (9.3.1.8.2).
const BLOCK_ACK_BYTES: u64 = 32;
/// Length of the longest A-MPDU of HT.
const LONGEST_AMPDU: u64 = 65_535;

/// Squared distances between the first codeword of CCK and all others, in units of a chip's energy, each with the number of
/// codewords at that distance. A test counts them.
const CCK_11: &[(f64, f64)] =
    &[(8.0, 24.0), (12.0, 16.0), (16.0, 174.0), (20.0, 16.0), (24.0, 24.0), (32.0, 1.0)];
const CCK_5_5: &[(f64, f64)] = &[(16.0, 14.0), (32.0, 1.0)];

impl ChannelWidth {
    /// Returns the data subcarriers (tables 19-6 and 21-5).
    const fn data_subcarriers(self) -> u32 {
        match self {
            Self::Mhz20 => 52,
            Self::Mhz40 => 108,
            Self::Mhz80 => 234,
            Self::Mhz160 => 468,
        }
    }

    /// Returns how many channels of 20 MHz it has.
    const fn channels(self) -> u32 {
        match self {
            Self::Mhz20 => 1,
            Self::Mhz40 => 2,
            Self::Mhz80 => 4,
            Self::Mhz160 => 8,
        }
    }
}

impl PhyRate {
    /// Returns a rate of 802.11, 802.11a, b or g by its speed in units of 100 kbit/s: 10, 20, 55, 110, and 60 to 540. `None`
    /// for another speed.
    pub fn legacy(hundreds_of_kbps: u16, short_preamble: bool) -> Option<Self> {
        const OFDM: [u16; 8] = [60, 90, 120, 180, 240, 360, 480, 540];
        let rate = match hundreds_of_kbps {
            10 => Dsss::One,
            20 => Dsss::Two,
            55 => Dsss::FiveAndAHalf,
            110 => Dsss::Eleven,
            other => return OFDM.iter().position(|rate| *rate == other).map(|at| Self(Kind::Ofdm(at as u8))),
        };
        // 1 Mbit/s has the long preamble only (16.2.2.3).
        let short_preamble = short_preamble && rate != Dsss::One;
        Some(Self(Kind::Dsss { rate, short_preamble }))
    }

    /// Returns a rate of 802.11n by its MCS, 0 to 31, i.e. one to four streams. `None` for other MCS and widths.
    pub fn ht(mcs: u8, width: ChannelWidth, short_guard: bool) -> Option<Self> {
        let valid = mcs < 32 && width <= ChannelWidth::Mhz40;
        let mimo = Mimo { mcs: mcs % 8, streams: mcs / 8 + 1, width, short_guard };
        valid.then_some(Self(Kind::Ht(mimo)))
    }

    /// Returns a rate of 802.11ac by its MCS, 0 to 9, and its streams, 1 to 8. `None` for others, and for those without a
    /// whole number of bits in a symbol, which the standard leaves out (21.5).
    pub fn vht(mcs: u8, streams: u8, width: ChannelWidth, short_guard: bool) -> Option<Self> {
        let mimo = Mimo { mcs, streams, width, short_guard };
        let valid = mcs < 10 && (1..=8).contains(&streams);
        (valid && mimo.has_whole_bits()).then_some(Self(Kind::Vht(mimo)))
    }

    /// Returns the rate, bits per second.
    pub fn bits_per_second(self) -> u64 {
        match self.0 {
            Kind::Dsss { rate, .. } => rate.bits_per_second(),
            Kind::Ofdm(at) => u64::from(OFDM[usize::from(at)].bits_per_symbol()) * 250_000,
            Kind::Ht(mimo) | Kind::Vht(mimo) => {
                u64::from(mimo.bits_per_symbol()) * 1_000_000_000 / mimo.symbol_ns()
            }
        }
    }

    /// Returns the airtime of a PSDU of so many bytes (TXTIME: 16.3.4, 17.4.3, 18.5.3.2, 19.4.3, 21.4.3).
    pub(super) fn airtime(self, frequency_mhz: u16, psdu_bytes: u64) -> Duration {
        let symbols =
            |bits_per_symbol: u32| (SERVICE_AND_TAIL + 8 * psdu_bytes).div_ceil(u64::from(bits_per_symbol));
        let us = match self.0 {
            Kind::Dsss { rate, short_preamble } => {
                let preamble = if short_preamble { SHORT_PREAMBLE_US } else { LONG_PREAMBLE_US };
                return Duration::from_micros(
                    preamble + (8_000_000 * psdu_bytes).div_ceil(rate.bits_per_second()),
                );
            }
            Kind::Ofdm(at) => {
                let symbols = symbols(OFDM[usize::from(at)].bits_per_symbol());
                LEGACY_PREAMBLE_US + symbols * SYMBOL_NS / 1000
            }
            // HT-SIG, HT-STF and HT-LTFs follow the legacy preamble.
            Kind::Ht(mimo) => LEGACY_PREAMBLE_US + 8 + 4 + mimo.training_us() + mimo.data_us(symbols),
            // VHT-SIG-A, VHT-STF, VHT-LTFs and VHT-SIG-B.
            Kind::Vht(mimo) => LEGACY_PREAMBLE_US + 8 + 4 + mimo.training_us() + 4 + mimo.data_us(symbols),
        };
        Duration::from_micros(us + extension_us(frequency_mhz))
    }

    /// Returns the time before the first data symbol.
    pub(super) fn preamble(self) -> Duration {
        Duration::from_micros(match self.0 {
            Kind::Dsss { short_preamble: true, .. } => SHORT_PREAMBLE_US,
            Kind::Dsss { .. } => LONG_PREAMBLE_US,
            Kind::Ofdm(_) => LEGACY_PREAMBLE_US,
            Kind::Ht(mimo) => LEGACY_PREAMBLE_US + 8 + 4 + mimo.training_us(),
            Kind::Vht(mimo) => LEGACY_PREAMBLE_US + 8 + 4 + mimo.training_us() + 4,
        })
    }

    /// Returns the probability that a header is lost at a signal-to-noise ratio in 20 MHz: six bytes of DSSS (16.2.2.2), 24 bits of
    /// L-SIG, and 48 of HT-SIG or VHT-SIG-A (19.3.9, 21.3.8).
    pub(super) fn header_error_rate(self, snr_db: f64) -> f64 {
        let slowest = match self.0 {
            Kind::Dsss { short_preamble, .. } => Self(Kind::Dsss { rate: Dsss::One, short_preamble }),
            _ => Self(Kind::Ofdm(0)),
        };
        slowest.error_rate(
            snr_db,
            match self.0 {
                Kind::Dsss { .. } => 6,
                Kind::Ofdm(_) => 3,
                Kind::Ht(_) | Kind::Vht(_) => 9,
            },
        )
    }

    /// Returns the airtime of an acknowledgement of a frame.
    pub(super) fn ack_airtime(self, frequency_mhz: u16) -> Duration {
        self.answer().airtime(frequency_mhz, ACK_BYTES)
    }

    /// Returns the airtime of a block acknowledgement of frames at this rate.
    pub(super) fn block_ack_airtime(self, frequency_mhz: u16) -> Duration {
        self.answer().airtime(frequency_mhz, BLOCK_ACK_BYTES)
    }

    /// Returns the most bytes of an A-MPDU at this rate, that of HT (9.4.2.55.3); `None` for rates without
    /// A-MPDUs.
    pub(super) fn most_aggregated(self) -> Option<u64> {
        match self.0 {
            Kind::Dsss { .. } | Kind::Ofdm(_) => None,
            Kind::Ht(_) | Kind::Vht(_) => Some(LONGEST_AMPDU),
        }
    }

    /// Returns the airtimes of RTS and CTS before a frame. They go at the rate of its acknowledgement.
    pub(super) fn rts_cts_airtimes(self, frequency_mhz: u16) -> [Duration; 2] {
        [RTS_BYTES, CTS_BYTES].map(|bytes| self.answer().airtime(frequency_mhz, bytes))
    }

    /// Returns the probability that a PSDU is lost at a signal-to-noise ratio in 20 MHz.
    ///
    /// A wider channel has more noise, and streams share the sender's power; the receiver separates them ideally, with as
    /// many antennas.
    pub fn error_rate(self, snr_db: f64, psdu_bytes: u64) -> f64 {
        let bits = (8 * psdu_bytes) as f64;
        let ln = match self.0 {
            Kind::Dsss { rate, .. } => (-rate.bit_error(10f64.powf(snr_db / 10.0))).ln_1p(),
            Kind::Ofdm(at) => ln_bit_success(&OFDM[usize::from(at)], snr_db),
            Kind::Ht(mimo) | Kind::Vht(mimo) => {
                let shares = f64::from(mimo.width.channels() * u32::from(mimo.streams));
                ln_bit_success(&mimo.mode(), snr_db - 10.0 * shares.log10())
            }
        };
        -(bits * ln).exp_m1()
    }

    /// Returns the probability that an RTS before a frame is lost.
    pub(super) fn rts_error_rate(self, snr_db: f64) -> f64 {
        self.answer().error_rate(snr_db, RTS_BYTES)
    }

    /// Returns the rate of control frames that precede or answer a frame: of DSSS its own, and otherwise the highest of 6, 12
    /// and 24 Mbit/s that the modulation allows (10.6.6.5).
    fn answer(self) -> Self {
        let constellation = match self.0 {
            Kind::Dsss { .. } => return self,
            Kind::Ofdm(at) => OFDM[usize::from(at)].constellation(),
            Kind::Ht(mimo) | Kind::Vht(mimo) => MCS[usize::from(mimo.mcs)].0,
        };
        Self(Kind::Ofdm(match constellation {
            Constellation::Bpsk => 0,
            Constellation::Qpsk => 2,
            Constellation::Qam16 | Constellation::Qam64 | Constellation::Qam256 | Constellation::Qam1024 => 4,
        }))
    }
}

/// Returns SIFS on a channel.
pub(super) fn sifs(frequency_mhz: u16) -> Duration {
    Duration::from_micros(SIFS_US[usize::from(frequency_mhz > ABOVE_2_4_GHZ)])
}

fn extension_us(frequency_mhz: u16) -> u64 {
    if frequency_mhz > ABOVE_2_4_GHZ { 0 } else { EXTENSION_US }
}

impl Dsss {
    const fn bits_per_second(self) -> u64 {
        match self {
            Self::One => 1_000_000,
            Self::Two => 2_000_000,
            Self::FiveAndAHalf => 5_500_000,
            Self::Eleven => 11_000_000,
        }
    }

    /// Returns the probability that a bit is wrong, at a ratio of signal and noise in 20 MHz.
    ///
    /// DBPSK: ½·exp(-E_b/N_0) (Proakis, Digital Communications, 5.2-69). DQPSK: its approximation for large ratios (Ferrari
    /// and Corazza, Tight bounds and accurate approximations for DQPSK transmission bit error rate, Electronics Letters
    /// 40(20), 2004), which ns-3 uses, too. CCK: the union bound over all codewords, received coherently; half of the bits
    /// of a wrong codeword are wrong.
    fn bit_error(self, snr: f64) -> f64 {
        let per_bit = snr * NOISE_BANDWIDTH / self.bits_per_second() as f64;
        let error = match self {
            Self::One => 0.5 * (-per_bit).exp(),
            Self::Two => {
                let root = std::f64::consts::SQRT_2;
                (root + 1.0) / (8.0 * std::f64::consts::PI * root).sqrt() / per_bit.sqrt()
                    * (-(2.0 - root) * per_bit).exp()
            }
            Self::FiveAndAHalf => wrong_bits(CCK_5_5, snr),
            Self::Eleven => wrong_bits(CCK_11, snr),
        };
        error.min(0.5)
    }
}

fn wrong_bits(distances: &[(f64, f64)], snr: f64) -> f64 {
    let per_chip = snr * NOISE_BANDWIDTH / CHIP_RATE;
    let wrong: f64 =
        distances.iter().map(|(squared, words)| 0.5 * words * erfc((squared * per_chip / 4.0).sqrt())).sum();
    0.5 * wrong
}

impl Mimo {
    /// Returns the coded bits in a symbol, and the numerator and denominator of the code's rate.
    fn coded(self) -> (u32, u32, u32) {
        let (constellation, coding) = MCS[usize::from(self.mcs)];
        let (k, n) = coding.rate();
        (constellation.bits() * self.width.data_subcarriers() * u32::from(self.streams), k, n)
    }

    fn has_whole_bits(self) -> bool {
        let (bits, k, n) = self.coded();
        (bits * k).is_multiple_of(n)
    }

    /// Returns the data bits in a symbol; N_DBPS.
    fn bits_per_symbol(self) -> u32 {
        let (bits, k, n) = self.coded();
        bits * k / n
    }

    fn mode(self) -> Mode {
        let (constellation, coding) = MCS[usize::from(self.mcs)];
        Mode::new(self.bits_per_symbol(), constellation, coding)
    }

    const fn symbol_ns(self) -> u64 {
        if self.short_guard { SHORT_SYMBOL_NS } else { SYMBOL_NS }
    }

    /// Returns the time of the long training fields (19.3.9.4.6, 21.3.8.3.5), µs.
    fn training_us(self) -> u64 {
        4 * u64::from(match self.streams {
            3 => 4,
            5 => 6,
            7 => 8,
            streams => streams,
        })
    }

    /// Returns the time of the data symbols in whole symbols of 4 µs.
    fn data_us(self, symbols: impl Fn(u32) -> u64) -> u64 {
        (symbols(self.bits_per_symbol()) * self.symbol_ns()).div_ceil(SYMBOL_NS) * SYMBOL_NS / 1000
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHANNEL_1: u16 = 2412;
    const CHANNEL_36: u16 = 5180;

    fn legacy(rate: u16) -> PhyRate {
        PhyRate::legacy(rate, false).unwrap()
    }

    fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn rates_are_those_of_the_standard_tables() {
        use ChannelWidth::{Mhz20, Mhz40, Mhz80, Mhz160};
        let mbps = |rate: Option<PhyRate>| rate.unwrap().bits_per_second() as f64 / 1e6;
        for rate in [10, 20, 55, 110, 60, 90, 120, 180, 240, 360, 480, 540] {
            assert_eq!(mbps(PhyRate::legacy(rate, true)), f64::from(rate) / 10.0);
        }
        // Tables 19-27 to 19-34.
        assert_eq!(mbps(PhyRate::ht(7, Mhz20, false)), 65.0);
        assert!((mbps(PhyRate::ht(7, Mhz20, true)) - 72.2).abs() < 0.1);
        assert_eq!(mbps(PhyRate::ht(15, Mhz40, true)), 300.0);
        // Tables 21-29 to 21-60.
        assert_eq!(mbps(PhyRate::vht(9, 1, Mhz80, true)), 433.333_333);
        assert_eq!(mbps(PhyRate::vht(8, 8, Mhz160, false)), 5616.0);
        assert_eq!(PhyRate::legacy(100, false), None);
        assert_eq!(PhyRate::ht(32, Mhz20, false), None);
        assert_eq!(PhyRate::ht(7, Mhz80, false), None);
        assert_eq!(PhyRate::vht(9, 1, Mhz20, false), None, "346 ⅔ bits in a symbol");
        assert_eq!(PhyRate::vht(10, 1, Mhz20, false), None);
        assert_eq!(PhyRate::vht(7, 9, Mhz20, false), None);
    }

    #[test]
    fn airtimes_are_those_of_the_standard() {
        // A beacon of 100 bytes at 1 Mbit/s; the same with a short preamble is no shorter at this rate.
        assert_eq!(legacy(10).airtime(CHANNEL_1, 100), us(192 + 800));
        assert_eq!(PhyRate::legacy(10, true).unwrap().airtime(CHANNEL_1, 100), us(192 + 800));
        assert_eq!(PhyRate::legacy(110, true).unwrap().airtime(CHANNEL_1, 1100), us(96 + 800));
        // 22 + 800 bits in symbols of 24, with the signal extension at 2.4 GHz.
        assert_eq!(legacy(60).airtime(CHANNEL_1, 100), us(20 + 35 * 4 + 6));
        assert_eq!(legacy(60).airtime(CHANNEL_36, 100), us(20 + 35 * 4));
        // 22 + 8000 bits in symbols of 260: 31 of 4 µs, or of 3.6 µs and filled up to 28 of 4 µs.
        let ht = |short| PhyRate::ht(7, ChannelWidth::Mhz20, short).unwrap();
        assert_eq!(ht(false).airtime(CHANNEL_36, 1000), us(36 + 31 * 4));
        assert_eq!(ht(true).airtime(CHANNEL_36, 1000), us(36 + 28 * 4));
        // Acknowledgements of 14 bytes at 24, 6 and 1 Mbit/s.
        assert_eq!(legacy(540).ack_airtime(CHANNEL_36), us(20 + 2 * 4));
        assert_eq!(legacy(60).ack_airtime(CHANNEL_36), us(20 + 6 * 4));
        assert_eq!(legacy(10).ack_airtime(CHANNEL_1), us(192 + 112));
    }

    #[test]
    fn codewords_of_cck_have_these_distances() {
        // φ1 to φ4, in quarter turns; each chip is a sum of some, and two chips are turned by half (16.3.6.7).
        let codeword = |phases: [u32; 4]| {
            let [a, b, c, d] = phases;
            [a + b + c + d, a + c + d, a + b + d, a + d + 2, a + b + c, a + c, a + b + 2, a]
        };
        let squared = |phases: [u32; 4], from: [u32; 4]| -> f64 {
            let turned = codeword(phases).into_iter().zip(codeword(from)).map(|(x, y)| (x + 4 - y % 4) % 4);
            // |e^(jθ) - 1|² is 0, 2, 4 and 2.
            turned.map(|quarters| [0.0, 2.0, 4.0, 2.0][quarters as usize]).sum()
        };
        let count = |words: Vec<[u32; 4]>, from: [u32; 4], table: &[(f64, f64)]| {
            let others: Vec<_> = words.into_iter().filter(|word| *word != from).collect();
            for (distance, number) in table {
                let found = others.iter().filter(|word| squared(**word, from) == *distance).count();
                assert_eq!(found as f64, *number, "at {distance}");
            }
            assert_eq!(table.iter().map(|(_, number)| *number).sum::<f64>(), others.len() as f64);
        };
        let quarters = 0..4;
        let all =
            quarters.clone().flat_map(|a| (0..64).map(move |rest| [a, rest % 4, rest / 4 % 4, rest / 16]));
        count(all.collect(), [0; 4], CCK_11);
        // At 5.5 Mbit/s, φ2 is π/2 or 3π/2, φ3 is 0, and φ4 is 0 or π.
        let few = quarters.flat_map(|a| [[a, 1, 0, 0], [a, 3, 0, 0], [a, 1, 0, 2], [a, 3, 0, 2]]);
        count(few.collect(), [0, 1, 0, 0], CCK_5_5);
    }

    #[test]
    fn slower_rates_reach_further() {
        // The signal-to-noise ratio at which a tenth of the frames is lost.
        let reach = |rate: PhyRate| {
            (-150..500)
                .map(|tenths| f64::from(tenths) / 10.0)
                .find(|snr| rate.error_rate(*snr, 1000) < 0.1)
                .unwrap()
        };
        // CCK at 5.5 Mbit/s, which is received coherently, reaches as far as DQPSK, which is not.
        let ladder = [10, 20, 55, 110].map(|rate| reach(legacy(rate)));
        assert!(ladder[0] < ladder[1].min(ladder[2]) && ladder[2] < ladder[3], "{ladder:?}");
        assert!((-4.0..-2.0).contains(&ladder[0]), "{ladder:?}");
        let ladder = [60, 120, 240, 480, 540].map(|rate| reach(legacy(rate)));
        assert!(ladder.is_sorted(), "{ladder:?}");
        let ht = |mcs, width| reach(PhyRate::ht(mcs, width, false).unwrap());
        assert!((ht(7, ChannelWidth::Mhz40) - ht(7, ChannelWidth::Mhz20) - 3.0).abs() < 0.11);
        assert!((ht(15, ChannelWidth::Mhz20) - ht(7, ChannelWidth::Mhz20) - 3.0).abs() < 0.11);
    }

    #[test]
    fn the_models_own_modes_have_the_same_errors_and_airtimes() {
        use crate::radio::phy::{Phy, Reception};
        use cotorra_graph::WifiStandard;
        let phy = Phy::usual(WifiStandard::N);
        for mcs in 0..8 {
            let rate = PhyRate::ht(mcs, ChannelWidth::Mhz20, false).unwrap();
            // Header, QoS control, LLC and check sequence in place of the Ethernet header.
            let psdu = 1000 + 24 + 2 + 4 + 8 + 16 - 14;
            for snr_db in [0.0, 10.0, 20.0, 30.0] {
                let own = Reception::new(phy, snr_db).error_rate(usize::from(mcs), 1000);
                assert!((rate.error_rate(snr_db, psdu) - own).abs() < 1e-12);
            }
            assert_eq!(rate.airtime(CHANNEL_1, psdu), phy.data_airtime(usize::from(mcs), 1000));
            assert_eq!(rate.ack_airtime(CHANNEL_1), phy.ack_airtime(usize::from(mcs)));
        }
    }
}
