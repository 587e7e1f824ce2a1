//! The physical layer. Turns a signal-to-noise ratio into packet errors, these into the rate with the highest goodput, and
//! a rate into airtime. Clauses and tables are those of IEEE 802.11-2020; clause 27 is that of IEEE 802.11ax-2021.

use std::{sync::LazyLock, time::Duration};

use cotorra_graph::{
    Band, BitRate, ChannelWidth, Dbm, FixedRate, GuardInterval, WifiStandard, WirelessNetwork,
};

/// Modulation of each subcarrier.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Constellation {
    Bpsk,
    Qpsk,
    Qam16,
    Qam64,
    Qam256,
    Qam1024,
}

/// Rate of the convolutional code with constraint length 7, punctured from (133, 171).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Coding {
    Half,
    TwoThirds,
    ThreeQuarters,
    FiveSixths,
}

/// A rate of 802.11a/g, or an MCS of 802.11n/ac/ax with its streams.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mode {
    /// Data bits in one symbol; N_DBPS.
    bits_per_symbol: u32,
    constellation: Constellation,
    coding: Coding,
    symbol_ns: u32,
    /// Time before the first data symbol.
    preamble_ns: u64,
    /// Encoders, each with a tail of its own; N_ES.
    encoders: u32,
    /// Signal-to-noise ratio of each stream above that of one antenna, dB.
    gain_db: f64,
}

impl Mode {
    pub(super) const fn new(bits_per_symbol: u32, constellation: Constellation, coding: Coding) -> Self {
        Self {
            bits_per_symbol,
            constellation,
            coding,
            symbol_ns: SYMBOL_NS,
            preamble_ns: LEGACY_PREAMBLE_US * 1000,
            encoders: 1,
            gain_db: 0.0,
        }
    }

    /// Returns an MCS; `None` if a symbol of 802.11ac has no whole number of bits, which that standard leaves out (21.5).
    fn mcs(layer: &Layer, mcs: usize, streams: u8) -> Option<Self> {
        let (constellation, coding) = MCS[mcs];
        let coded = constellation.bits() * layer.data_subcarriers() * u32::from(streams);
        let (k, n) = coding.rate();
        if layer.standard == WifiStandard::Ac && !(coded * k).is_multiple_of(n) {
            return None;
        }
        let bits_per_symbol = coded * k / n;
        Some(Self {
            symbol_ns: layer.symbol_ns(),
            preamble_ns: layer.preamble_ns(streams),
            encoders: layer.encoders(bits_per_symbol),
            gain_db: 10.0 * (f64::from(layer.streams) / f64::from(streams)).log10(),
            ..Self::new(bits_per_symbol, constellation, coding)
        })
    }

    fn bits_per_second(&self) -> u64 {
        u64::from(self.bits_per_symbol) * 1_000_000_000 / u64::from(self.symbol_ns)
    }

    /// Returns the bits of a PSDU with its service field and tails.
    fn data_bits(&self, psdu_bytes: u64) -> u64 {
        u64::from(SERVICE + TAIL * self.encoders) + 8 * psdu_bytes
    }

    /// Returns the time of the preamble and the data symbols. Short guard intervals fill up to whole symbols of 4 µs (19.4.3,
    /// 21.4.3).
    fn psdu_ns(&self, psdu_bytes: u64) -> u64 {
        let symbols = self.data_bits(psdu_bytes).div_ceil(u64::from(self.bits_per_symbol));
        let ns = symbols * u64::from(self.symbol_ns);
        let fills = self.symbol_ns < SYMBOL_NS;
        self.preamble_ns + if fills { ns.next_multiple_of(u64::from(SYMBOL_NS)) } else { ns }
    }

    /// Returns the PHY rate, Mbit/s.
    pub(super) fn mbps(&self) -> f64 {
        f64::from(self.bits_per_symbol) * 1000.0 / f64::from(self.symbol_ns)
    }

    pub(super) fn constellation(&self) -> Constellation {
        self.constellation
    }

    /// Returns the data bits in one symbol.
    pub(super) fn bits_per_symbol(&self) -> u32 {
        self.bits_per_symbol
    }

    /// Returns the duration of a symbol, ns.
    pub(super) fn symbol_ns(&self) -> u32 {
        self.symbol_ns
    }
}

impl Constellation {
    /// Returns the coded bits of a subcarrier.
    pub(super) const fn bits(self) -> u32 {
        match self {
            Self::Bpsk => 1,
            Self::Qpsk => 2,
            Self::Qam16 => 4,
            Self::Qam64 => 6,
            Self::Qam256 => 8,
            Self::Qam1024 => 10,
        }
    }
}

impl Coding {
    /// Returns the numerator and the denominator of the rate.
    pub(super) const fn rate(self) -> (u32, u32) {
        match self {
            Self::Half => (1, 2),
            Self::TwoThirds => (2, 3),
            Self::ThreeQuarters => (3, 4),
            Self::FiveSixths => (5, 6),
        }
    }
}

/// Most modes of a network: two streams of 802.11ax.
const MAX_MODES: usize = 24;

/// Duration of a data symbol of 802.11a, g, n and ac with the long guard interval.
const SYMBOL_NS: u32 = 4000;
/// Symbol of 802.11n and ac, and of 802.11ax, without the guard interval (tables 19-6 and 21-5; 27-12).
const HT_SYMBOL_NS: u32 = 3200;
const HE_SYMBOL_NS: u32 = 12_800;
/// Service field, and tail of the convolutional code, bits.
const SERVICE: u32 = 16;
const TAIL: u32 = 6;
/// Rate above which 802.11ac has a second encoder, bits per second (tables 21-30 to 21-61).
const ONE_ENCODER: u64 = 600_000_000;
/// L-STF, L-LTF and L-SIG, which begin every OFDM frame.
const LEGACY_PREAMBLE_US: u64 = 20;
/// An acknowledgement's MPDU, bytes (9.3.1.4).
const ACK_BYTES: u32 = 14;
/// RTS and CTS, bytes (9.3.1.2, 9.3.1.3).
const RTS_BYTES: u32 = 20;
const CTS_BYTES: u32 = 14;
/// A compressed block acknowledgement of 64 frames, and one of 256, bytes (9.3.1.8.2).
const BLOCK_ACK_BYTES: u32 = 32;
const LONG_BLOCK_ACK_BYTES: u32 = 56;
/// Bytes that an Ethernet frame gains on the air: a data frame's MAC header (24) and FCS (4), LLC and SNAP (8) and CCMP
/// (16), less the Ethernet header (14) (9.3.2.1, 12.5.3).
const MAC_OVERHEAD: u32 = 24 + 4 + 8 + 16 - 14;
/// Bytes of QoS control, which HT and VHT stations send (9.2.4.5).
const QOS_CONTROL: u32 = 2;
/// Bytes of the delimiter of the A-MPDU that every VHT frame is (9.7.1).
const AMPDU_DELIMITER: u32 = 4;

/// Slot time of all modelled layers; in 802.11g the short one (17.4.4, 18.5.4, 19.4.4, 21.4.4).
const SLOT_US: u64 = 9;
/// The same as a duration.
pub(super) const SLOT: Duration = Duration::from_micros(SLOT_US);
/// Smallest contention window (same clauses).
const CW_MIN: u32 = 15;
/// Largest contention window (same clauses).
const CW_MAX: u32 = 1023;
/// Default of dot11ShortRetryLimit (10.3.4.4).
pub(super) const ATTEMPTS: u32 = 7;

/// Length of a full Ethernet frame, for figures that are not about one frame.
pub(super) const REFERENCE_BYTES: usize = 1514;

/// The modes and timing of a standard.
#[derive(Debug)]
pub(super) struct Phy {
    /// Modes of each number of streams from the slowest to the fastest, those of one stream first.
    modes: Vec<Mode>,
    /// Numbers of streams.
    streams: usize,
    /// Names of the last modes, as testbeds fix them. Those of 802.11ac and ax are the modes with all streams.
    fixed_rates: Vec<FixedRate>,
    sifs_us: u64,
    /// Silence at the end of an OFDM frame at 2.4 GHz (18.3.2.4).
    extension_us: u64,
    overhead_bytes: u32,
    /// Longest A-MPDU, bytes (9.4.2.55.3, 9.4.2.157.2); `None` without aggregation.
    longest_aggregate: Option<u64>,
    /// Frames of an A-MPDU, at most: those of a block acknowledgement agreement (9.4.1.13; 802.11ax: 26.4.2).
    aggregated_frames: usize,
    /// Bits of the headers: L-SIG, and HT-SIG, VHT-SIG-A or HE-SIG-A.
    header_bits: f64,
}

/// Modulation and coding by MCS (tables 19-27, 21-30, 27-55).
pub(super) const MCS: [(Constellation, Coding); 12] = [
    (Constellation::Bpsk, Coding::Half),
    (Constellation::Qpsk, Coding::Half),
    (Constellation::Qpsk, Coding::ThreeQuarters),
    (Constellation::Qam16, Coding::Half),
    (Constellation::Qam16, Coding::ThreeQuarters),
    (Constellation::Qam64, Coding::TwoThirds),
    (Constellation::Qam64, Coding::ThreeQuarters),
    (Constellation::Qam64, Coding::FiveSixths),
    (Constellation::Qam256, Coding::ThreeQuarters),
    (Constellation::Qam256, Coding::FiveSixths),
    (Constellation::Qam1024, Coding::ThreeQuarters),
    (Constellation::Qam1024, Coding::FiveSixths),
];

/// 802.11a and g (17.3.2.2, Table 17-4).
pub(super) const OFDM: &[Mode] = &[
    Mode::new(24, Constellation::Bpsk, Coding::Half),
    Mode::new(36, Constellation::Bpsk, Coding::ThreeQuarters),
    Mode::new(48, Constellation::Qpsk, Coding::Half),
    Mode::new(72, Constellation::Qpsk, Coding::ThreeQuarters),
    Mode::new(96, Constellation::Qam16, Coding::Half),
    Mode::new(144, Constellation::Qam16, Coding::ThreeQuarters),
    Mode::new(192, Constellation::Qam64, Coding::TwoThirds),
    Mode::new(216, Constellation::Qam64, Coding::ThreeQuarters),
];

/// What decides a network's physical layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layer {
    standard: WifiStandard,
    band: Band,
    width: ChannelWidth,
    streams: u8,
    guard_interval: GuardInterval,
}

impl Layer {
    /// Returns all of them. Those of 802.11a and g have one width, stream and guard interval.
    fn all() -> impl Iterator<Item = Self> {
        use ChannelWidth::{Mhz20, Mhz40, Mhz80};
        use GuardInterval::{Ns400, Ns800, Ns1600, Ns3200};
        use WifiStandard::{A, Ac, Ax, G, N};
        let bands = [Band::Ghz2, Band::Ghz5];
        let standards = [G, A, N, Ac, Ax].into_iter();
        let in_bands = standards.flat_map(move |standard| bands.map(|band| (standard, band)));
        let wide =
            in_bands.flat_map(|(standard, band)| [Mhz20, Mhz40, Mhz80].map(|width| (standard, band, width)));
        let spatial =
            wide.flat_map(|(standard, band, width)| [1, 2].map(|streams| (standard, band, width, streams)));
        spatial.flat_map(|(standard, band, width, streams)| {
            [Ns400, Ns800, Ns1600, Ns3200].map(|guard_interval| Self {
                standard,
                band,
                width,
                streams,
                guard_interval,
            })
        })
    }

    /// Returns the data subcarriers (tables 19-6, 21-5 and 27-15).
    const fn data_subcarriers(&self) -> u32 {
        match (self.standard, self.width) {
            (WifiStandard::Ax, ChannelWidth::Mhz20) => 234,
            (WifiStandard::Ax, ChannelWidth::Mhz40) => 468,
            (WifiStandard::Ax, ChannelWidth::Mhz80) => 980,
            (_, ChannelWidth::Mhz20) => 52,
            (_, ChannelWidth::Mhz40) => 108,
            (_, ChannelWidth::Mhz80) => 234,
        }
    }

    fn symbol_ns(&self) -> u32 {
        let symbol = if self.standard == WifiStandard::Ax { HE_SYMBOL_NS } else { HT_SYMBOL_NS };
        symbol + u32::from(self.guard_interval.ns())
    }

    /// Returns the time before the first data symbol.
    fn preamble_ns(&self, streams: u8) -> u64 {
        let after_legacy_us = match self.standard {
            WifiStandard::A | WifiStandard::G => 0,
            // HT-SIG, HT-STF and HT-LTFs.
            WifiStandard::N => 8 + 4 + 4 * u64::from(streams),
            // VHT-SIG-A, VHT-STF, VHT-LTFs and VHT-SIG-B.
            WifiStandard::Ac => 8 + 4 + 4 * u64::from(streams) + 4,
            // RL-SIG, HE-SIG-A, HE-STF and HE-LTFs of an HE SU PPDU (27.3.11). The latter are of 6.4 µs with their guard
            // interval, and of 12.8 µs with the longest one, as in the combinations that all stations have (27.3.4).
            WifiStandard::Ax => {
                let symbol_ns = if self.guard_interval == GuardInterval::Ns3200 { 12_800 } else { 6400 };
                let training_ns = symbol_ns + u64::from(self.guard_interval.ns());
                return (LEGACY_PREAMBLE_US + 4 + 8 + 4) * 1000 + training_ns * u64::from(streams);
            }
        };
        (LEGACY_PREAMBLE_US + after_legacy_us) * 1000
    }

    /// Returns N_ES, which does not depend on the guard interval. 802.11ax has one tail here, although its fast rates use a
    /// code without.
    fn encoders(&self, bits_per_symbol: u32) -> u32 {
        let short = u64::from(HT_SYMBOL_NS + u32::from(GuardInterval::Ns400.ns()));
        let fastest = u64::from(bits_per_symbol) * 1_000_000_000 / short;
        if self.standard == WifiStandard::Ac && fastest > ONE_ENCODER { 2 } else { 1 }
    }

    fn phy(&self) -> Phy {
        let at_2_ghz = self.band == Band::Ghz2;
        let mcs = |count: usize| -> Vec<Mode> {
            (1..=self.streams)
                .flat_map(|streams| (0..count).filter_map(move |mcs| Mode::mcs(self, mcs, streams)))
                .collect()
        };
        let (modes, header_bits) = match self.standard {
            WifiStandard::A | WifiStandard::G => (OFDM.to_vec(), 24.0),
            WifiStandard::N => (mcs(8), 24.0 + 48.0),
            WifiStandard::Ac => (mcs(10), 24.0 + 48.0),
            WifiStandard::Ax => (mcs(12), 24.0 + 52.0),
        };
        let (sifs_us, extension_us) = if at_2_ghz { (10, 6) } else { (16, 0) };
        let (overhead_bytes, longest_aggregate) = match self.standard {
            WifiStandard::A | WifiStandard::G => (MAC_OVERHEAD, None),
            WifiStandard::N => (MAC_OVERHEAD + QOS_CONTROL, Some(65_535)),
            WifiStandard::Ac => (MAC_OVERHEAD + QOS_CONTROL + AMPDU_DELIMITER, Some(1_048_575)),
            // With the exponents of HT and VHT extended (9.4.2.248).
            WifiStandard::Ax => {
                let longest = if at_2_ghz { 524_287 } else { 6_500_631 };
                (MAC_OVERHEAD + QOS_CONTROL + AMPDU_DELIMITER, Some(longest))
            }
        };
        let streams = if self.standard.aggregates() { usize::from(self.streams) } else { 1 };
        // Linux asks for as many with 802.11ax (`ieee80211_send_addba_with_timeout` in net/mac80211/agg-tx.c).
        let aggregated_frames = if self.standard == WifiStandard::Ax { 256 } else { 64 };
        Phy {
            modes,
            streams,
            fixed_rates: self.standard.fixed_rates(self.width, self.streams),
            sifs_us,
            extension_us,
            overhead_bytes,
            longest_aggregate,
            aggregated_frames,
            header_bits,
        }
    }
}

impl Phy {
    /// Returns the physical layer of a network with radio units in a band.
    pub(super) fn of(network: &WirelessNetwork, band: Band) -> &'static Self {
        let WirelessNetwork { standard, width, streams, guard_interval, .. } = *network;
        Self::of_layer(Layer { standard, band, width, streams: streams.clamp(1, 2), guard_interval })
    }

    fn of_layer(layer: Layer) -> &'static Self {
        static ALL: LazyLock<Vec<(Layer, Phy)>> =
            LazyLock::new(|| Layer::all().map(|layer| (layer, layer.phy())).collect());
        let found = ALL.iter().find(|(its, _)| *its == layer);
        &found.expect("the table has all layers").1
    }

    /// Returns the physical layer of a standard with one stream in 20 MHz.
    #[cfg(test)]
    pub(super) fn usual(standard: WifiStandard) -> &'static Self {
        Self::of_layer(Layer {
            standard,
            band: standard.band(1),
            width: ChannelWidth::default(),
            streams: 1,
            guard_interval: GuardInterval::default(),
        })
    }

    /// Returns the modes of one stream from the slowest to the fastest, then those of two.
    pub(super) fn modes(&self) -> &[Mode] {
        &self.modes
    }

    /// Returns the numbers of streams, each of which has as many modes.
    pub(super) fn streams(&self) -> usize {
        self.streams
    }

    /// Returns the mode of a fixed rate; `None` if this layer does not have it.
    pub(super) fn mode_of(&self, rate: FixedRate) -> Option<usize> {
        let place = self.fixed_rates.iter().position(|its| *its == rate)?;
        Some(self.modes.len() - self.fixed_rates.len() + place)
    }

    /// Whether frames may be aggregated.
    pub(super) fn aggregates(&self) -> bool {
        self.longest_aggregate.is_some()
    }

    /// Returns the fastest PHY rate, which limits the medium.
    pub(super) fn top_rate(&self) -> BitRate {
        let bits_per_second = self.modes[self.modes.len() - 1].bits_per_second();
        BitRate::from_bits_per_second(bits_per_second).expect("every mode carries bits")
    }

    /// Returns the frames of an A-MPDU, at most.
    pub(super) fn aggregated_frames(&self) -> usize {
        self.aggregated_frames
    }

    fn psdu_bytes(&self, frame_bytes: usize) -> u32 {
        frame_bytes as u32 + self.overhead_bytes
    }

    /// Returns the TXTIME of a frame (17.4.3, 18.5.3.2, 19.4.3, 21.4.3, 27.4.3), ns.
    fn frame_ns(&self, mode: &Mode, frame_bytes: usize) -> u64 {
        mode.psdu_ns(u64::from(self.psdu_bytes(frame_bytes))) + 1000 * self.extension_us
    }

    /// Returns the airtime of a frame's data, without what goes before and after.
    pub(super) fn data_airtime(&self, mode: usize, frame_bytes: usize) -> Duration {
        Duration::from_nanos(self.frame_ns(&self.modes[mode], frame_bytes))
    }

    /// Returns the airtime of an A-MPDU whose subframes have so many bytes together.
    pub(super) fn aggregate_airtime(&self, mode: usize, psdu_bytes: u64) -> Duration {
        Duration::from_nanos(self.modes[mode].psdu_ns(psdu_bytes) + 1000 * self.extension_us)
    }

    /// Returns the bytes of a frame in an A-MPDU: its delimiter, itself, and the padding to a multiple of four (9.7.1).
    pub(super) fn subframe_bytes(&self, frame_bytes: usize) -> u64 {
        let bytes = frame_bytes as u64 + u64::from(AMPDU_DELIMITER + MAC_OVERHEAD + QOS_CONTROL);
        bytes.next_multiple_of(4)
    }

    /// Returns the most bytes of an A-MPDU that takes no longer than `limit`; `None` without aggregation.
    pub(super) fn aggregate_within(&self, mode: usize, limit: Duration) -> Option<u64> {
        let mode = &self.modes[mode];
        let around = mode.preamble_ns + 1000 * self.extension_us;
        let ns = (limit.as_nanos() as u64).saturating_sub(around);
        // The last symbols of a short guard interval fill up to 4 µs.
        let ns = if mode.symbol_ns < SYMBOL_NS { ns - ns % u64::from(SYMBOL_NS) } else { ns };
        let bits = ns / u64::from(mode.symbol_ns) * u64::from(mode.bits_per_symbol);
        Some((bits.saturating_sub(mode.data_bits(0)) / 8).min(self.longest_aggregate?))
    }

    pub(super) fn sifs(&self) -> Duration {
        Duration::from_micros(self.sifs_us)
    }

    /// Returns the time before the first data symbol of one stream.
    pub(super) fn preamble(&self) -> Duration {
        Duration::from_nanos(self.modes[0].preamble_ns)
    }

    /// Returns the airtime of an acknowledgement of a frame.
    pub(super) fn ack_airtime(&self, mode: usize) -> Duration {
        Duration::from_micros(self.answer_us(&self.modes[mode], ACK_BYTES))
    }

    /// Returns the airtime of a block acknowledgement of an A-MPDU.
    pub(super) fn block_ack_airtime(&self, mode: usize) -> Duration {
        let bytes = if self.aggregated_frames > 64 { LONG_BLOCK_ACK_BYTES } else { BLOCK_ACK_BYTES };
        Duration::from_micros(self.answer_us(&self.modes[mode], bytes))
    }

    /// Returns the airtimes of RTS and CTS, at the lowest basic rate.
    pub(super) fn rts_cts_airtimes(&self) -> [Duration; 2] {
        [RTS_BYTES, CTS_BYTES].map(|bytes| Duration::from_micros(self.answer_us(&self.modes[0], bytes)))
    }

    /// Returns the TXTIME of an acknowledgement, µs.
    fn ack_us(&self, mode: &Mode) -> u64 {
        self.answer_us(mode, ACK_BYTES)
    }

    /// Returns the TXTIME of a control frame that precedes or answers data, µs. Its rate is 6, 12 or 24 Mbit/s: the highest mandatory rate that the
    /// data's modulation allows (10.6.6.5).
    fn answer_us(&self, mode: &Mode, bytes: u32) -> u64 {
        let bits_per_symbol: u32 = match mode.constellation {
            Constellation::Bpsk => 24,
            Constellation::Qpsk => 48,
            Constellation::Qam16 | Constellation::Qam64 | Constellation::Qam256 | Constellation::Qam1024 => {
                96
            }
        };
        let bits = SERVICE + TAIL + 8 * bytes;
        let data_us = u64::from(SYMBOL_NS / 1000 * bits.div_ceil(bits_per_symbol));
        LEGACY_PREAMBLE_US + data_us + self.extension_us
    }

    /// Returns DIFS, µs: SIFS and two slots (10.3.7).
    fn difs_us(&self) -> u64 {
        self.sifs_us + 2 * SLOT_US
    }

    /// Returns DIFS: the idle time after which a sender may send at once (10.3.4.2).
    pub(super) fn difs(&self) -> Duration {
        Duration::from_micros(self.difs_us())
    }

    /// Returns the time of an attempt without backoff, ns: DIFS, frame, SIFS and acknowledgement. A failed attempt takes as
    /// long, because the sender waits for SIFS, a slot and the start of an acknowledgement.
    pub(super) fn attempt_ns(&self, mode: &Mode, frame_bytes: usize) -> u64 {
        self.frame_ns(mode, frame_bytes) + 1000 * (self.difs_us() + self.sifs_us + self.ack_us(mode))
    }

    /// Returns the time of an attempt by which modes are compared, µs. Symbols of 802.11ax count by their parts: they are so
    /// long that a frame takes one of them in several modes, and frames of an aggregate share them.
    fn compared_us(&self, mode: &Mode, frame_bytes: usize) -> f64 {
        let us = self.attempt_ns(mode, frame_bytes) as f64 / 1000.0;
        if mode.symbol_ns <= SYMBOL_NS {
            return us;
        }
        let bits = mode.data_bits(u64::from(self.psdu_bytes(frame_bytes)));
        let symbols = bits as f64 / f64::from(mode.bits_per_symbol);
        us - (symbols.ceil() - symbols) * f64::from(mode.symbol_ns) / 1000.0
    }

    /// Returns the airtime of a group-addressed frame: DIFS, backoff and the frame at the lowest basic rate. It is not
    /// acknowledged.
    pub(super) fn group_airtime(&self, frame_bytes: usize, contended: bool, random: f64) -> Duration {
        let backoff = if contended { SLOT_US * (random * f64::from(CW_MIN + 1)) as u64 } else { 0 };
        Duration::from_micros(self.difs_us() + backoff)
            + Duration::from_nanos(self.frame_ns(&self.modes[0], frame_bytes))
    }

    /// Returns the lowest signal-to-noise ratio that a receiver can decode, dB. There, one in ten PSDUs of 1000 bytes at
    /// the slowest rate is lost, by the standard's definition of sensitivity (17.3.10.2).
    fn sensitivity_db(&self) -> f64 {
        let (mut deaf, mut hears) = (-20.0, 30.0);
        while hears - deaf > 1e-6 {
            let snr = 0.5 * (deaf + hears);
            let slowest = &self.modes[0];
            let lost = -(8000.0 * ln_bit_success(slowest, snr + slowest.gain_db)).exp_m1();
            if lost > 0.1 { deaf = snr } else { hears = snr }
        }
        hears
    }
}

/// Returns the weakest signal that receivers of a network can decode, at its slowest rate.
pub fn sensitivity(network: &WirelessNetwork) -> Dbm {
    // It is the same in both bands.
    Dbm(network.noise().0 + Phy::of(network, Band::Ghz5).sensitivity_db())
}

/// Error rates of one receiver at one signal-to-noise ratio.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reception {
    phy: &'static Phy,
    /// Natural logarithm of the probability that a bit is correct, by mode.
    ln_bit_success: [f64; MAX_MODES],
}

impl Reception {
    /// Creates it from the signal-to-noise ratio of one antenna over the width of the channel.
    ///
    /// Stations have as many antennas as streams. The streams share the sender's power, and the receiver adds the signals
    /// of all its antennas: one stream gains from each antenna, and as many streams as antennas gain nothing. ns-3 has
    /// the same ratios (`InterferenceHelper::CalculateSnr`).
    pub(super) fn new(phy: &'static Phy, snr_db: f64) -> Self {
        let mut ln = [f64::NEG_INFINITY; MAX_MODES];
        for (ln, mode) in ln.iter_mut().zip(&phy.modes) {
            *ln = ln_bit_success(mode, snr_db + mode.gain_db);
        }
        Self { phy, ln_bit_success: ln }
    }

    /// Returns the probability that one attempt loses a frame.
    pub(super) fn error_rate(&self, mode: usize, frame_bytes: usize) -> f64 {
        let bits = 8.0 * f64::from(self.phy.psdu_bytes(frame_bytes));
        -(bits * self.ln_bit_success[mode]).exp_m1()
    }

    /// Returns the mode with the highest expected goodput for a frame of this length (ideal rate selection).
    pub(super) fn best(&self, frame_bytes: usize) -> usize {
        let mean_backoff_us = SLOT_US as f64 * f64::from(CW_MIN) / 2.0;
        let mut best = (0, 0.0);
        for (i, mode) in self.phy.modes.iter().enumerate().rev() {
            let ceiling = 1.0 / (self.phy.compared_us(mode, frame_bytes) + mean_backoff_us);
            // It cannot win, even without errors.
            if best.1 >= ceiling {
                continue;
            }
            let goodput = ceiling * (1.0 - self.error_rate(i, frame_bytes));
            if goodput > best.1 {
                best = (i, goodput);
            }
        }
        best.0
    }

    /// Returns the PHY rate for full frames, Mbit/s.
    pub(super) fn mbps(&self) -> f64 {
        self.mbps_of(self.best(REFERENCE_BYTES))
    }

    /// Returns the PHY rate of a mode, Mbit/s.
    pub(super) fn mbps_of(&self, mode: usize) -> f64 {
        self.phy.modes[mode].mbps()
    }

    /// Returns the probability that the header of a frame is lost: 24 bits of L-SIG, and 48 of HT-SIG or
    /// VHT-SIG-A (19.3.9, 21.3.8) or 52 of HE-SIG-A (27.3.11.7).
    pub(super) fn header_error_rate(&self) -> f64 {
        -(self.phy.header_bits * self.ln_bit_success[0]).exp_m1()
    }

    /// Returns the probability that an RTS is lost. It goes at the lowest basic rate.
    pub(super) fn rts_error_rate(&self) -> f64 {
        let bits = 8.0 * f64::from(RTS_BYTES);
        -(bits * self.ln_bit_success[0]).exp_m1()
    }

    /// Sends a frame and waits for its acknowledgement, up to seven times with a doubling contention window (10.3.3,
    /// 10.3.4). A sender that finds the channel idle sends at once; one that had to wait (`contended`) backs off first.
    /// `random` gives uniform numbers in 0..1.
    pub(super) fn exchange(
        &self,
        frame_bytes: usize,
        contended: bool,
        mut random: impl FnMut() -> f64,
    ) -> Exchange {
        let best = self.best(frame_bytes);
        let attempt_ns = self.phy.attempt_ns(&self.phy.modes[best], frame_bytes);
        let error_rate = self.error_rate(best, frame_bytes);
        let mut window = CW_MIN;
        let backoff_ns = |window: u32, u: f64| 1000 * SLOT_US * (u * f64::from(window + 1)) as u64;
        let first = attempt_ns + if contended { backoff_ns(window, random()) } else { 0 };
        let mut retries = 0;
        let mut received = random() >= error_rate;
        for _ in 1..ATTEMPTS {
            if received {
                break;
            }
            window = (2 * window + 1).min(CW_MAX);
            retries += attempt_ns + backoff_ns(window, random());
            received = random() >= error_rate;
        }
        Exchange { first: Duration::from_nanos(first), retries: Duration::from_nanos(retries), received }
    }

    /// Returns the probability that a group-addressed frame is lost. It is sent once, at the lowest basic rate (10.6.5).
    pub(super) fn group_error_rate(&self, frame_bytes: usize) -> f64 {
        self.error_rate(0, frame_bytes)
    }
}

/// The outcome of sending a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Exchange {
    /// Time of the first attempt, backoff included.
    pub(super) first: Duration,
    /// Time of all further attempts.
    pub(super) retries: Duration,
    /// Whether the receiver got the frame.
    pub(super) received: bool,
}

/// Returns the natural logarithm of the probability that a decoded bit is correct.
///
/// On the channel, this is the bit error probability of Gray-coded M-QAM in white Gaussian noise. E_s/N_0 is the
/// signal-to-noise ratio in 20 MHz (Proakis, Digital Communications, 5.2). Behind the decoder, it is the union bound with
/// hard decisions: P ≤ 1/(2k) Σ c_d D^d, D = √(4p(1-p)), over the first terms of the code's bit weight spectrum (Frenger,
/// Orten and Ottosson, Convolutional codes with optimum distance spectrum, IEEE Communications Letters 3(11), 1999). Pei
/// and Henderson validated this model against a testbed (Validation of OFDM error rate model in ns-3, 2010).
pub(super) fn ln_bit_success(mode: &Mode, snr_db: f64) -> f64 {
    let snr = 10f64.powf(snr_db / 10.0);
    let p = match mode.constellation {
        Constellation::Bpsk => 0.5 * erfc(snr.sqrt()),
        Constellation::Qpsk => 0.5 * erfc((snr / 2.0).sqrt()),
        Constellation::Qam16 => 3.0 / 8.0 * erfc((snr / 10.0).sqrt()),
        Constellation::Qam64 => 7.0 / 24.0 * erfc((snr / 42.0).sqrt()),
        Constellation::Qam256 => 15.0 / 64.0 * erfc((snr / 170.0).sqrt()),
        Constellation::Qam1024 => 31.0 / 160.0 * erfc((snr / 682.0).sqrt()),
    };
    let d = (4.0 * p * (1.0 - p)).sqrt();
    // Input bits k of the punctured code, free distance, step between distances, and weights c_d.
    let (k, free_distance, step, weights): (f64, i32, i32, &[f64]) = match mode.coding {
        Coding::Half => (1.0, 10, 2, &[36.0, 211.0, 1404.0, 11633.0, 77433.0, 502_690.0, 3_322_763.0]),
        Coding::TwoThirds => (2.0, 6, 1, &[3.0, 70.0, 285.0, 1276.0, 6160.0, 27128.0, 117_019.0]),
        Coding::ThreeQuarters => {
            (3.0, 5, 1, &[42.0, 201.0, 1492.0, 10469.0, 62935.0, 379_644.0, 2_253_373.0])
        }
        Coding::FiveSixths => {
            (5.0, 4, 1, &[92.0, 528.0, 8694.0, 79453.0, 792_114.0, 7_375_573.0, 67_884_974.0])
        }
    };
    let series = weights.iter().rev().fold(0.0, |sum, c| sum * d.powi(step) + c);
    let bit_error = series * d.powi(free_distance) / (2.0 * k);
    (-bit_error.min(0.5)).ln_1p()
}

/// Returns the complementary error function for `x` ≥ 0: a series below 2 (Abramowitz and Stegun, 7.1.6), a continued
/// fraction above (7.1.14).
pub(super) fn erfc(x: f64) -> f64 {
    let gauss = (-x * x).exp() / std::f64::consts::PI.sqrt();
    if x < 2.0 {
        let (mut term, mut sum) = (x, x);
        for n in 1..30 {
            term *= 2.0 * x * x / f64::from(2 * n + 1);
            sum += term;
        }
        1.0 - 2.0 * gauss * sum
    } else {
        gauss / (1..30).rev().fold(x, |tail, n| x + 0.5 * f64::from(n) / tail)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reception(standard: WifiStandard, snr_db: f64) -> Reception {
        Reception::new(Phy::usual(standard), snr_db)
    }

    #[test]
    fn erfc_matches_its_tables() {
        // Abramowitz and Stegun, tables 7.1 and 7.3.
        let table = [
            (0.0, 1.0),
            (0.5, 0.479_500_122),
            (1.0, 0.157_299_207),
            (1.9999, 0.004_679_802),
            (3.0, 2.209_05e-5),
        ];
        for (x, expected) in table {
            assert!((erfc(x) / expected - 1.0).abs() < 1e-5, "erfc({x}) = {}", erfc(x));
        }
        assert!((erfc(1.999_999_9) / erfc(2.0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn rates_match_the_standards() {
        let rates = |standard| Phy::usual(standard).modes.iter().map(Mode::mbps).collect::<Vec<_>>();
        let ofdm = [6.0, 9.0, 12.0, 18.0, 24.0, 36.0, 48.0, 54.0];
        let ht = [6.5, 13.0, 19.5, 26.0, 39.0, 52.0, 58.5, 65.0];
        assert_eq!(rates(WifiStandard::A), ofdm);
        assert_eq!(rates(WifiStandard::G), ofdm);
        assert_eq!(rates(WifiStandard::N), ht);
        assert_eq!(rates(WifiStandard::Ac), [&ht[..], &[78.0]].concat());
        assert_eq!(Phy::usual(WifiStandard::Ac).top_rate().mbps(), 78.0);
    }

    #[test]
    fn fixed_rates_are_modes_of_their_layers() {
        for layer in Layer::all() {
            let phy = Phy::of_layer(layer);
            let has_streams = layer.standard.aggregates();
            let streams = if has_streams { usize::from(layer.streams) } else { 1 };
            let rates = layer.standard.fixed_rates(layer.width, layer.streams);
            let modes: Vec<_> = rates.iter().map(|rate| phy.mode_of(*rate).unwrap()).collect();
            let first =
                if layer.standard == WifiStandard::N { 0 } else { phy.modes.len() / streams * (streams - 1) };
            assert_eq!(modes, (first..phy.modes.len()).collect::<Vec<_>>(), "{layer:?}");
            for (rate, mode) in rates.iter().zip(modes) {
                let Mode { constellation, coding, .. } = phy.modes[mode];
                match rate {
                    FixedRate::BitsPerSecond(rate) => {
                        assert_eq!(phy.modes[mode].bits_per_second(), rate.bits_per_second());
                    }
                    FixedRate::Mcs(mcs) => {
                        let mcs = usize::from(*mcs);
                        let mcs = if layer.standard == WifiStandard::N { mcs % 8 } else { mcs };
                        assert_eq!((constellation, coding), MCS[mcs]);
                    }
                }
            }
            let slow = FixedRate::BitsPerSecond(BitRate::from_mbps(6.5).unwrap());
            assert_eq!([slow, FixedRate::Mcs(16)].map(|rate| phy.mode_of(rate)), [None; 2]);
        }
    }

    #[test]
    fn airtimes_match_the_standards() {
        // A PSDU of 1500 bytes at 54 Mbit/s: 20 µs and 56 symbols; at 6 Mbit/s: 20 µs and 501 symbols.
        let payload = 1500 - MAC_OVERHEAD as usize;
        let phys = [WifiStandard::A, WifiStandard::G, WifiStandard::N, WifiStandard::Ac].map(Phy::usual);
        let [a, g, n, ac] = phys;
        assert_eq!(a.frame_ns(&OFDM[7], payload), 1000 * (20 + 4 * 56));
        assert_eq!(a.frame_ns(&OFDM[0], payload), 1000 * (20 + 4 * 501));
        assert_eq!(g.frame_ns(&OFDM[7], payload), 1000 * (20 + 4 * 56 + 6));
        assert_eq!([0, 2, 7].map(|i| a.ack_us(&OFDM[i])), [44, 32, 28]);
        assert_eq!(phys.map(Phy::difs_us), [34, 28, 28, 34]);
        // DIFS, frame, SIFS and acknowledgement of a full Ethernet frame, slowest and fastest.
        let attempts = |phy: &Phy| {
            [&phy.modes[0], &phy.modes[phy.modes.len() - 1]]
                .map(|m| phy.attempt_ns(m, REFERENCE_BYTES) / 1000)
        };
        assert_eq!(attempts(a), [2190, 330]);
        assert_eq!(attempts(g), [2190, 330]);
        assert_eq!(attempts(n), [2046, 306]);
        assert_eq!(attempts(ac), [2058, 282]);
    }

    #[test]
    fn packet_errors_match_the_golden_table() {
        // Mode of 802.11ac, SNR (dB), share of 1000-byte frames lost.
        let golden = [
            (0, 3.0, 0.8652),
            (0, 4.0, 0.0616),
            (0, 5.0, 0.0013),
            (1, 6.0, 0.8744),
            (1, 7.0, 0.0639),
            (2, 9.0, 0.7084),
            (2, 10.0, 0.0451),
            (3, 13.0, 0.3068),
            (3, 14.0, 0.0137),
            (4, 16.0, 0.3885),
            (4, 17.0, 0.0202),
            (5, 21.0, 0.1976),
            (5, 22.0, 0.0086),
            (6, 22.0, 0.3695),
            (6, 23.0, 0.0221),
            (7, 23.0, 0.5250),
            (7, 24.0, 0.0370),
            (8, 28.0, 0.2561),
            (8, 29.0, 0.0155),
        ];
        for (mode, snr_db, expected) in golden {
            let lost = reception(WifiStandard::Ac, snr_db).error_rate(mode, 1000);
            assert!((lost - expected).abs() < 1e-3, "MCS {mode} at {snr_db} dB: {lost:.4}, not {expected}");
        }
    }

    #[test]
    fn packet_errors_are_those_that_ns_3_publishes() {
        // Mode of 802.11a, SNR (dB), share of PSDUs of 2000 bytes that arrive: the spot tests of NistErrorRateModel in ns-3's
        // wifi-error-rate-models-test.cc.
        let published = [
            (0, 3.0, 0.020),
            (0, 4.0, 0.885),
            (0, 5.0, 0.997),
            (1, 6.0, 0.097),
            (1, 7.0, 0.918),
            (1, 8.0, 0.998),
            (2, 6.0, 0.0174),
            (2, 7.0, 0.881),
            (2, 8.0, 0.997),
            (3, 9.5, 0.623),
            (3, 10.5, 0.985),
            (4, 13.0, 0.495),
            (4, 14.0, 0.974),
            (5, 15.5, 0.012),
            (5, 16.5, 0.818),
            (5, 17.5, 0.993),
            (6, 20.0, 1.3e-4),
            (6, 21.0, 0.649),
            (6, 22.0, 0.983),
            (7, 22.0, 0.410),
            (7, 23.0, 0.958),
        ];
        for (mode, snr_db, arrives) in published {
            let modelled =
                1.0 - reception(WifiStandard::A, snr_db).error_rate(mode, 2000 - MAC_OVERHEAD as usize);
            assert!(
                (modelled - arrives).abs() < 0.01,
                "mode {mode} at {snr_db} dB: {modelled:.4}, not {arrives}"
            );
        }
    }

    /// Lines of `ns3/rates.txt` of one kind. `ns3/rates.cc` says how to make it again.
    fn ns_3(kind: &str) -> impl Iterator<Item = Vec<&'static str>> {
        let lines = include_str!("ns3/rates.txt").lines().map(|line| line.split(' ').collect::<Vec<_>>());
        lines.filter(move |fields| fields[0] == kind).map(|mut fields| fields.split_off(1))
    }

    /// Returns ns-3's airtime as the standard has it, ns. ns-3 3.44 differs in three points:
    ///
    /// - VHT-SIG-B takes no time in SU PPDUs (21.4.3: 4 µs).
    /// - Symbols with the short guard interval do not fill up to 4 µs (19.4.3, 21.4.3).
    /// - Each HE-LTF has 8 µs (`HePhy::GetTrainingDuration`, "TODO extract from TxVector"). Those of the standard have 6.4 µs,
    ///   or 12.8 µs, and the guard interval (27.3.11.10).
    fn by_the_standard(layer: &Layer, streams: u64, ns: u64, extension_ns: u64) -> u64 {
        let sig_b = if layer.standard == WifiStandard::Ac { 4000 } else { 0 };
        match layer.guard_interval {
            // The preamble is a multiple of 4 µs.
            GuardInterval::Ns400 => (ns - extension_ns).next_multiple_of(4000) + extension_ns + sig_b,
            GuardInterval::Ns800 if layer.standard == WifiStandard::Ax => ns - 800 * streams,
            GuardInterval::Ns3200 => ns + 8000 * streams,
            GuardInterval::Ns800 | GuardInterval::Ns1600 => ns + sig_b,
        }
    }

    #[test]
    fn airtimes_are_those_of_ns_3() {
        let mut compared = 0;
        for fields in ns_3("airtime") {
            let numbers: Vec<u64> = fields[1..].iter().map(|field| field.parse().unwrap()).collect();
            let [band, width, streams, guard, mcs, bytes, ns] = numbers[..] else { panic!("{fields:?}") };
            let standard = match fields[0] {
                "n" => WifiStandard::N,
                "ac" => WifiStandard::Ac,
                _ => WifiStandard::Ax,
            };
            let layer = Layer::all().find(|layer| {
                layer.standard == standard
                    && (layer.band == Band::Ghz2) == (band == 2)
                    && u64::from(layer.width.mhz()) == width
                    && u64::from(layer.guard_interval.ns()) == guard
            });
            let layer = Layer { streams: 2, ..layer.unwrap() };
            let mode = Mode::mcs(&layer, mcs as usize, streams as u8).unwrap();
            let extension_ns = 1000 * Phy::of_layer(layer).extension_us;
            assert_eq!(
                mode.psdu_ns(bytes) + extension_ns,
                by_the_standard(&layer, streams, ns, extension_ns)
            );
            compared += 1;
        }
        assert!(compared > 500, "{compared}");
    }

    #[test]
    fn packet_errors_of_256_and_1024_qam_are_those_of_ns_3() {
        let phy = Phy::usual(WifiStandard::Ax);
        let mut compared = 0;
        for fields in ns_3("lost") {
            let numbers: Vec<f64> = fields.iter().map(|field| field.parse().unwrap()).collect();
            let [mcs, snr_db, lost] = numbers[..] else { panic!("{fields:?}") };
            if mcs < 8.0 {
                continue;
            }
            compared += 1;
            let psdu = 1500 - phy.overhead_bytes as usize;
            let ours = Reception::new(phy, snr_db).error_rate(mcs as usize, psdu);
            assert!((ours - lost).abs() < 0.01, "MCS {mcs} at {snr_db} dB: {ours:.4}, not {lost}");
        }
        assert!(compared > 16, "{compared}");
    }

    /// Returns the rates of a network with up to two streams, Mbit/s, rounded to tenths as in the standard's tables.
    fn rates(standard: WifiStandard, width: ChannelWidth, guard_interval: GuardInterval) -> [Vec<f64>; 2] {
        let layer = Layer { standard, band: Band::Ghz5, width, streams: 2, guard_interval };
        [1, 2].map(|streams| {
            let modes = (0..12).filter_map(|mcs| Mode::mcs(&layer, mcs, streams));
            modes.map(|mode| (10.0 * mode.mbps()).round() / 10.0).collect()
        })
    }

    #[test]
    fn rates_of_wide_channels_and_streams_match_the_standards() {
        use ChannelWidth::{Mhz20, Mhz40, Mhz80};
        use GuardInterval::{Ns400, Ns800, Ns1600, Ns3200};
        use WifiStandard::{Ac, Ax, N};
        // Tables 19-30 and 19-32 to 19-34.
        let ht = [13.5, 27.0, 40.5, 54.0, 81.0, 108.0, 121.5, 135.0];
        assert_eq!(rates(N, Mhz40, Ns800)[0][..8], ht);
        assert_eq!(rates(N, Mhz40, Ns800)[1][..8], ht.map(|mbps| 2.0 * mbps));
        let short = [15.0, 30.0, 45.0, 60.0, 90.0, 120.0, 135.0, 150.0];
        assert_eq!(rates(N, Mhz40, Ns400)[0][..8], short);
        assert_eq!(rates(N, Mhz20, Ns400)[0][..8], [7.2, 14.4, 21.7, 28.9, 43.3, 57.8, 65.0, 72.2]);
        // Tables 21-30, 21-38 and 21-46; 20 MHz have no MCS 9.
        assert_eq!(rates(Ac, Mhz20, Ns400)[1][8], 173.3);
        assert_eq!(rates(Ac, Mhz40, Ns800)[0][8..10], [162.0, 180.0]);
        let vht = [29.3, 58.5, 87.8, 117.0, 175.5, 234.0, 263.3, 292.5, 351.0, 390.0];
        assert_eq!(rates(Ac, Mhz80, Ns800)[0][..10], vht);
        let vht = [65.0, 130.0, 195.0, 260.0, 390.0, 520.0, 585.0, 650.0, 780.0, 866.7];
        assert_eq!(rates(Ac, Mhz80, Ns400)[1][..10], vht);
        // Tables 27-79 to 27-105 for the 242-, 484- and 996-tone RU.
        let he = [8.6, 17.2, 25.8, 34.4, 51.6, 68.8, 77.4, 86.0, 103.2, 114.7, 129.0, 143.4];
        assert_eq!(rates(Ax, Mhz20, Ns800)[0], he);
        let he = [8.1, 16.3, 24.4, 32.5, 48.8, 65.0, 73.1, 81.3, 97.5, 108.3, 121.9, 135.4];
        assert_eq!(rates(Ax, Mhz20, Ns1600)[0], he);
        let he = [7.3, 14.6, 21.9, 29.3, 43.9, 58.5, 65.8, 73.1, 87.8, 97.5, 109.7, 121.9];
        assert_eq!(rates(Ax, Mhz20, Ns3200)[0], he);
        let he = [17.2, 34.4, 51.6, 68.8, 103.2, 137.6, 154.9, 172.1, 206.5, 229.4, 258.1, 286.8];
        assert_eq!(rates(Ax, Mhz40, Ns800)[0], he);
        assert_eq!(rates(Ax, Mhz20, Ns800)[1], he);
        // The tables have 600.5 for MCS 11, and 1134.3 below, from 8166 ⅔ bits in a symbol, of which it carries 8166.
        let he = [36.0, 72.1, 108.1, 144.1, 216.2, 288.2, 324.3, 360.3, 432.4, 480.4, 540.4, 600.4];
        assert_eq!(rates(Ax, Mhz80, Ns800)[0], he);
        assert_eq!(rates(Ax, Mhz80, Ns800)[1][11], 1201.0);
        assert_eq!(rates(Ax, Mhz80, Ns1600)[1][11], 1134.2);
        assert_eq!(rates(Ax, Mhz80, Ns3200)[1][11], 1020.8);
    }

    #[test]
    fn two_antennas_gain_on_one_stream_and_wide_channels_have_more_noise() {
        let layer = Layer {
            standard: WifiStandard::Ax,
            band: Band::Ghz5,
            width: ChannelWidth::Mhz80,
            streams: 2,
            guard_interval: GuardInterval::Ns800,
        };
        let two = Phy::of_layer(layer);
        let one = Phy::of_layer(Layer { streams: 1, ..layer });
        assert_eq!(two.modes.len(), 24);
        assert_eq!(two.top_rate().mbps().round(), 1201.0);
        for mcs in 0..12 {
            let [two, one] = [two, one].map(|phy| Reception::new(phy, 12.0));
            let gained = Reception::new(one.phy, 12.0 + 10.0 * 2f64.log10());
            assert_eq!(two.error_rate(mcs, 1000), gained.error_rate(mcs, 1000));
            assert_eq!(two.error_rate(12 + mcs, 1000), one.error_rate(mcs, 1000));
        }
        // With an ideal choice, the second stream is used where the signal is strong.
        assert!(Reception::new(two, 40.0).best(REFERENCE_BYTES) >= 12);
        assert!(Reception::new(two, 5.0).best(REFERENCE_BYTES) < 12);

        let wide = WirelessNetwork { width: ChannelWidth::Mhz80, ..cotorra_graph_testing::wireless() };
        let noise = WirelessNetwork { width: ChannelWidth::Mhz20, ..wide.clone() }.noise();
        assert!((wide.noise().0 - noise.0 - 6.02).abs() < 0.01);
    }

    #[test]
    fn ideal_rate_follows_the_signal() {
        let at =
            |standard, snrs: &[f64]| snrs.iter().map(|s| reception(standard, *s).mbps()).collect::<Vec<_>>();
        let snrs = [-10.0, 5.0, 8.0, 11.0, 15.0, 18.0, 22.0, 23.0, 26.0, 30.0];
        assert_eq!(at(WifiStandard::G, &snrs), [6.0, 6.0, 12.0, 18.0, 24.0, 36.0, 48.0, 54.0, 54.0, 54.0]);
        assert_eq!(at(WifiStandard::N, &snrs), [6.5, 6.5, 13.0, 19.5, 26.0, 39.0, 52.0, 58.5, 65.0, 65.0]);
        assert_eq!(at(WifiStandard::Ac, &snrs), [6.5, 6.5, 13.0, 19.5, 26.0, 39.0, 52.0, 58.5, 65.0, 78.0]);
    }

    #[test]
    fn errors_fall_with_signal_and_grow_with_length() {
        use WifiStandard::{A, Ac, Ax, G, N};
        for standard in [A, G, N, Ac, Ax] {
            for mode in 0..Phy::usual(standard).modes.len() {
                let lost = |i: i32| reception(standard, f64::from(i) * 0.25).error_rate(mode, 1000);
                assert!((-40..200).map(lost).is_sorted_by(|a, b| a >= b), "{standard:?} mode {mode}");
            }
            let edge = reception(standard, 4.0);
            assert!(edge.error_rate(0, 100) < edge.error_rate(0, 1000));
        }
    }

    #[test]
    fn a_tenth_of_frames_is_lost_at_the_sensitivity() {
        let n = Phy::usual(WifiStandard::N);
        let snr_db = n.sensitivity_db();
        assert!((snr_db - 3.85).abs() < 0.01, "{snr_db}");
        let psdu = 1000 - n.overhead_bytes as usize;
        assert!((reception(WifiStandard::N, snr_db).error_rate(0, psdu) - 0.1).abs() < 1e-4);
    }

    #[test]
    fn an_exchange_backs_off_and_retries_by_the_standard() {
        let strong = reception(WifiStandard::N, 40.0);
        let clear = strong.exchange(REFERENCE_BYTES, false, || 0.999_999);
        assert_eq!(
            (clear.first, clear.retries, clear.received),
            (Duration::from_micros(306), Duration::ZERO, true)
        );
        let contended = strong.exchange(REFERENCE_BYTES, true, || 0.999_999);
        assert_eq!(contended.first, Duration::from_micros(306 + 15 * 9));

        let deaf = reception(WifiStandard::N, -20.0).exchange(REFERENCE_BYTES, true, || 0.999_999);
        let windows = [31, 63, 127, 255, 511, 1023];
        let retries: u64 = windows.iter().map(|w| 2046 + w * 9).sum();
        assert_eq!(deaf.first, Duration::from_micros(2046 + 15 * 9));
        assert_eq!(deaf.retries, Duration::from_micros(retries));
        assert!(!deaf.received);
    }
}
