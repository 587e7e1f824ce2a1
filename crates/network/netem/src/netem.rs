//! The parameters of one NetEm queueing discipline, in convenient units, and their wire format (`TCA_NETEM_*` in
//! linux/pkt_sched.h).

use std::time::Duration;

use cotorra_graph::{BitRate, Probability};

use crate::{
    distribution::Distribution,
    loss::Loss,
    probability::{from_wire, to_wire},
    structure::{number, word},
};
use cotorra_netlink::{DecodeError, Writer, attributes};

/// Random part of a delay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Jitter {
    /// Half-width of a uniform distribution, standard deviation of the others.
    pub deviation: Duration,
    /// Distribution of the jitter. `None` if unknown: the kernel never reports it.
    pub distribution: Option<Distribution>,
}

/// Parameters of a NetEm discipline.
#[derive(Debug, Clone, PartialEq)]
pub struct Netem {
    /// Fixed delay of every packet.
    pub delay: Duration,
    /// Random addition to the delay, positive or negative.
    pub jitter: Option<Jitter>,
    /// Packet loss.
    pub loss: Loss,
    /// Share of packets that are duplicated.
    pub duplication: Probability,
    /// Share of packets in which one bit is flipped.
    pub corruption: Probability,
    /// Share of packets that skip the delay and so overtake those before them.
    pub reordering: Probability,
    /// Serialisation rate; unlimited if `None`. NetEm rounds to whole bytes per second.
    pub rate: Option<BitRate>,
    /// Queue limit in packets, including those in flight. `None` chooses one; see [`Netem::limit`].
    pub limit: Option<u32>,
    /// Seed of all randomness. Linux 6.7 and later.
    pub seed: Option<u64>,
    /// Whether packets stay in order when jitter or a reduced delay would reorder them. NetEm itself keeps order only
    /// under a rate, so this sets a rate too high to delay any packet.
    pub in_order: bool,
}

impl Default for Netem {
    /// No conditions, in order.
    fn default() -> Self {
        Self {
            delay: Duration::ZERO,
            jitter: None,
            loss: Loss::None,
            duplication: Probability::ZERO,
            corruption: Probability::ZERO,
            reordering: Probability::ZERO,
            rate: None,
            limit: None,
            seed: None,
            in_order: true,
        }
    }
}

const DELAY_CORRELATION: u16 = 1;
const DELAY_DISTRIBUTION: u16 = 2;
const REORDER: u16 = 3;
const CORRUPT: u16 = 4;
const LOSS: u16 = 5;
const RATE: u16 = 6;
const RATE64: u16 = 8;
const LATENCY64: u16 = 10;
const JITTER64: u16 = 11;
const SEED: u16 = 14;
/// Length of `struct tc_netem_qopt`: latency, limit, loss, gap, duplicate, jitter.
const BASE: usize = 24;

/// A rate in bytes per second too high to matter: 1500 bytes take about 1 ns. A rate at or above it only keeps order.
const ORDER_RATE: u64 = 1 << 40;
/// Rate assumed for an unlimited link when its limit is chosen, bit/s.
const FAST: f64 = 10e9;
/// Bits of a full Ethernet frame.
const FRAME_BITS: f64 = 1514.0 * 8.0;
/// Default number of packets that may queue for a rate: Linux's default `txqueuelen`.
pub(crate) const QUEUE: u32 = 1000;

impl Netem {
    /// Returns the limit in force. Without an explicit one it is the number of full frames in flight plus 1000 that
    /// may queue. In flight counts the rate, or 10 Gbit/s if unlimited, during the delay and four deviations.
    ///
    /// NetEm's own default of 1000 in all loses packets from 120 Mbit/s on at a delay of 100 ms.
    pub fn limit(&self) -> u32 {
        self.limit.unwrap_or_else(|| self.limit_for(QUEUE))
    }

    /// Returns the limit that leaves room for `queue` packets beside those in flight.
    pub fn limit_for(&self, queue: u32) -> u32 {
        let jitter = self.jitter.map_or(Duration::ZERO, |jitter| jitter.deviation);
        let longest = self.delay.as_secs_f64() + 4.0 * jitter.as_secs_f64();
        let rate = self.rate.map_or(FAST, |rate| rate.bits_per_second() as f64);
        queue.saturating_add((rate * longest / FRAME_BITS).ceil() as u32)
    }

    /// Returns these parameters as the kernel stores them: whole bytes per second, probabilities in units of 2^-32,
    /// an explicit limit.
    pub fn as_kept(&self) -> Self {
        let quantise = |p: Probability| from_wire(to_wire(p));
        Self {
            jitter: self.jitter.filter(|jitter| !jitter.deviation.is_zero()),
            loss: self.loss.as_kept(),
            duplication: quantise(self.duplication),
            corruption: quantise(self.corruption),
            reordering: quantise(self.reordering),
            rate: self.rate.and_then(|rate| from_bytes(to_bytes(rate))),
            limit: Some(self.limit()),
            in_order: self.in_order || self.rate.is_some(),
            ..self.clone()
        }
    }

    /// Encodes the options of an add or change request. `before` is the current state of an existing discipline. An
    /// unchanged Gilbert-Elliott model is not sent again, because that would reset its state and cut a burst short.
    pub(crate) fn encode(&self, before: Option<&Self>) -> Vec<u8> {
        let mut w = Writer::default();
        let jitter = self.jitter.filter(|jitter| !jitter.deviation.is_zero());
        let deviation = jitter.map_or(Duration::ZERO, |jitter| jitter.deviation);
        let reorder = to_wire(self.reordering);
        // A gap of 1 makes every packet a candidate. With a gap of 0 the kernel reorders nothing.
        let base = [
            0,
            self.limit(),
            to_wire(self.loss.independent()),
            u32::from(reorder > 0),
            to_wire(self.duplication),
            0,
        ];
        w.raw(&base.map(u32::to_ne_bytes).concat());
        // The kernel keeps the value of every omitted attribute, so zeros are sent, too.
        w.u64(LATENCY64, nanos(self.delay)).u64(JITTER64, nanos(deviation));
        w.words(DELAY_CORRELATION, &[0, 0, 0]).words(REORDER, &[reorder, 0]);
        w.words(CORRUPT, &[to_wire(self.corruption), 0]);
        let bytes = self.rate.map_or(if self.in_order { ORDER_RATE } else { 0 }, to_bytes);
        // Rate, packet overhead, cell size, cell overhead. The kernel takes the larger of the two rates.
        w.words(RATE, &[u32::try_from(bytes).unwrap_or(u32::MAX), 0, 0, 0]);
        if bytes >= 1 << 32 {
            w.u64(RATE64, bytes);
        }
        // Without a new distribution, the discipline keeps its current table.
        if let Some(distribution) =
            jitter.and_then(|j| j.distribution.or(before.is_none().then(Distribution::default)))
        {
            let table = distribution.table();
            w.bytes(DELAY_DISTRIBUTION, &table.iter().flat_map(|v| v.to_ne_bytes()).collect::<Vec<_>>());
        }
        if let Some(parameters) = self.loss.model() {
            let same = before.and_then(|before| before.loss.model()) == Some(parameters);
            // An empty nest keeps the model and its state. Without a nest, loss would become independent.
            w.with(LOSS, |w| {
                if !same {
                    w.words(GILBERT_ELLIOTT, &parameters);
                }
            });
        }
        if let Some(seed) = self.seed {
            w.u64(SEED, seed);
        }
        w.finish()
    }

    /// Reads the options in the kernel's answer.
    pub(crate) fn decode(options: &[u8]) -> Result<Self, DecodeError> {
        let (base, rest) =
            options.split_at_checked(BASE).ok_or(DecodeError("NetEm's options are too short"))?;
        let mut latency = ticks(word(base, 0)?);
        let mut deviation = ticks(word(base, 5)?);
        let mut model = None;
        let mut bytes = 0;
        let mut netem =
            Self { limit: Some(word(base, 1)?), duplication: from_wire(word(base, 4)?), ..Self::default() };
        let gap = word(base, 3)?;
        for attribute in attributes(rest) {
            let (kind, value) = attribute?;
            match kind {
                LATENCY64 => latency = Duration::from_nanos(number(value)?),
                JITTER64 => deviation = Duration::from_nanos(number(value)?),
                REORDER if gap > 0 => netem.reordering = from_wire(word(value, 0)?),
                CORRUPT => netem.corruption = from_wire(word(value, 0)?),
                RATE => bytes = bytes.max(u64::from(word(value, 0)?)),
                RATE64 => bytes = bytes.max(number(value)?),
                SEED => netem.seed = Some(number(value)?),
                LOSS => {
                    for attribute in attributes(value) {
                        let (kind, value) = attribute?;
                        if kind == GILBERT_ELLIOTT {
                            model =
                                Some([word(value, 0)?, word(value, 1)?, word(value, 2)?, word(value, 3)?]);
                        }
                    }
                }
                _ => {}
            }
        }
        netem.delay = latency;
        netem.jitter = (!deviation.is_zero()).then_some(Jitter { deviation, distribution: None });
        netem.loss = Loss::from_wire(word(base, 2)?, model);
        netem.in_order = bytes > 0;
        netem.rate = if bytes >= ORDER_RATE { None } else { from_bytes(bytes) };
        Ok(netem)
    }
}

/// `NETEM_LOSS_GE`: p, r, 1-h and 1-k as probabilities.
const GILBERT_ELLIOTT: u16 = 2;

fn to_bytes(rate: BitRate) -> u64 {
    rate.bits_per_second().div_ceil(8)
}

fn from_bytes(bytes: u64) -> Option<BitRate> {
    BitRate::from_bits_per_second(bytes.saturating_mul(8))
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX >> 1)
}

/// Converts ticks of the kernel's packet clock, 64 ns each. Used only where the kernel reports no nanoseconds.
fn ticks(ticks: u32) -> Duration {
    Duration::from_nanos(u64::from(ticks) * 64)
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::loss::tests::any_loss;

    fn any_probability() -> impl Strategy<Value = Probability> {
        prop_oneof![Just(0.0), Just(1.0), 0.0..1.0].prop_map(|p| Probability::new(p).unwrap())
    }

    prop_compose! {
        pub(crate) fn any_netem()(
            delay in 0_u64..3_600_000_000_000,
            jitter in prop::option::of(1_u64..3_600_000_000),
            loss in any_loss(),
            random in [any_probability(), any_probability(), any_probability()],
            rate in prop::option::of(1_u64..8_000_000_000_000),
            limit in prop::option::of(1_u32..),
            seed in prop::option::of(any::<u64>()),
            in_order: bool,
        ) -> Netem {
            let [duplication, corruption, reordering] = random;
            let jitter = jitter.map(|ns| Jitter { deviation: Duration::from_nanos(ns), distribution: None });
            let rate = rate.and_then(BitRate::from_bits_per_second);
            Netem { delay: Duration::from_nanos(delay), jitter, loss, duplication, corruption, reordering, rate, limit, seed, in_order }
        }
    }

    proptest! {
        /// The decoded parameters equal the requested ones, in the kernel's units.
        #[test]
        fn parameters_survive_encoding(netem in any_netem()) {
            prop_assert_eq!(Netem::decode(&netem.encode(None)), Ok(netem.as_kept()));
        }

        #[test]
        fn as_kept_is_idempotent(netem in any_netem()) {
            prop_assert_eq!(netem.as_kept().as_kept(), netem.as_kept());
        }

        #[test]
        fn arbitrary_options_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            _ = Netem::decode(&bytes);
        }
    }

    fn nests(options: &[u8]) -> Option<usize> {
        let mut read = attributes(&options[BASE..]).map(Result::unwrap);
        read.find(|(kind, _)| *kind == LOSS).map(|(_, value)| value.len())
    }

    #[test]
    fn unchanged_burst_models_are_not_sent_again() {
        let p = |p| Probability::new(p).unwrap();
        let loss = Loss::bursty(p(0.1), 5.0).unwrap();
        let one = Netem { loss, ..Netem::default() };
        let later = Netem { delay: Duration::from_millis(5), ..one.clone() };
        assert_eq!(nests(&one.encode(None)), Some(20));
        assert_eq!(nests(&later.encode(Some(&one.as_kept()))), Some(0), "the same model");
        let other = Netem { loss: Loss::bursty(p(0.1), 6.0).unwrap(), ..one.clone() };
        assert_eq!(nests(&other.encode(Some(&one))), Some(20), "another model");
        assert_eq!(nests(&Netem::default().encode(Some(&one))), None, "no model any more");
    }

    #[test]
    fn limit_covers_packets_in_flight() {
        let plain = Netem::default();
        assert_eq!(plain.limit(), QUEUE);
        let long =
            Netem { delay: Duration::from_millis(100), rate: BitRate::from_mbps(1000.0), ..Netem::default() };
        // 100 Mbit is 8257 full frames.
        assert_eq!(long.limit(), QUEUE + 8257);
        assert_eq!(Netem { limit: Some(7), ..long }.limit(), 7);
    }

    #[test]
    fn order_is_kept_by_an_unreachable_rate() {
        let kept = |netem: Netem| Netem::decode(&netem.encode(None)).unwrap();
        assert_eq!(kept(Netem::default()), Netem { limit: Some(QUEUE), ..Netem::default() });
        let free = kept(Netem { in_order: false, ..Netem::default() });
        assert!(!free.in_order && free.rate.is_none());
        let slow = kept(Netem { in_order: false, rate: BitRate::from_mbps(1.0), ..Netem::default() });
        assert!(slow.in_order, "NetEm keeps order under a rate");
    }
}
