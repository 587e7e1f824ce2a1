//! Settings of one direction of a link, and the errors of impossible ones. Wired and wireless links share them, so that a
//! change means the same on both.

use std::{sync::Arc, time::Duration};

use cotorra_graph::{
    BitRate, ConditionChange, Conditions, FixedRate, InvalidCorrelation, InvalidDiscipline, Jitter, LinkId,
    Loss, Medium, NodeId, NotOffered, Probability, QueueLimit, Rate, Scale, Trace,
};

/// An error of a call to the fabric. Nothing has changed then.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FabricError {
    /// An unknown link.
    #[error("there is no link `{0}`")]
    UnknownLink(LinkId),
    /// An unknown robot.
    #[error("there is no robot `{0}`")]
    UnknownRobot(NodeId),
    /// An unknown radio unit.
    #[error("there is no radio unit `{0}`")]
    UnknownRadioUnit(NodeId),
    /// An unknown border.
    #[error("there is no node `{0}` to be a border")]
    UnknownBorder(NodeId),
    /// A radio unit of another network than the robot's.
    #[error("`{radio_unit}` serves another network than the one that `{robot}` joins")]
    OtherNetwork {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
    },
    /// A signal too weak for the lowest rate.
    #[error("`{radio_unit}` is out of the reach of `{robot}`")]
    OutOfReach {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
    },
    /// A trace of which only the name is known.
    #[error(
        "the link has no trace with the digest {0}, and a name alone says no opportunities: give them as `trace_ms`"
    )]
    UnknownTrace(String),
    /// The radio unit is off.
    #[error("`{0}` is off: no vAP is deployed on it")]
    NotServing(NodeId),
    /// A radio unit that has a vAP already.
    #[error("a vAP is deployed on `{0}` already")]
    Serving(NodeId),
    /// A vAP for another network than the radio unit's.
    #[error("`{radio_unit}` is made for the network `{network}`, not for `{asked}`")]
    OtherSsid {
        /// The radio unit.
        radio_unit: NodeId,
        /// The radio unit's network.
        network: String,
        /// The requested network.
        asked: String,
    },
    /// A robot without the key that the radio unit's vAP was deployed with.
    #[error("`{radio_unit}` does not admit `{robot}`, which is of another domain, or has not the right key")]
    NotAdmitted {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
    },
    /// A station that is scanning or handing over.
    #[error("`{0}` is scanning or changing its radio unit: ask again when it is done")]
    Busy(NodeId),
    /// A robot that is attached to a radio unit of another core.
    #[error("the radio of `{0}` is with another core's radio unit: attach it to one of its own first")]
    Elsewhere(NodeId),
    /// A robot that is not attached to a radio unit of another core.
    #[error("the radio of `{0}` is not with another core's radio unit")]
    NotElsewhere(NodeId),
    /// A node without an antenna.
    #[error("`{0}` is no robot and no radio unit of a wireless network")]
    NoAntenna(NodeId),
    /// An antenna that another radio than the fabric's uses.
    #[error("another radio uses the antenna of `{0}`")]
    Lent(NodeId),
    /// An antenna that the fabric's own radio uses.
    #[error("the antenna of `{0}` is not lent to another radio")]
    NotLent(NodeId),
    /// A network whose senders take turns.
    #[error("senders take turns in the network of `{0}`: write `access: edca`")]
    NoContention(NodeId),
    /// An impossible delay.
    #[error("a delay of {0} ms cannot be: it is between 0 ms and one hour, before and after scaling")]
    Delay(f64),
    /// An impossible jitter.
    #[error("a jitter of {0} ms cannot be: its deviation is one hour at most, before and after scaling")]
    Jitter(f64),
    /// A correlation that the jitter's distribution cannot have.
    #[error("such a jitter cannot be: {0}")]
    JitterCorrelation(#[from] InvalidCorrelation),
    /// An impossible ψ.
    #[error("a delay scale of {0} cannot be: it is a number, 0 or more, and 1 leaves the delay as it is")]
    DelayScale(f64),
    /// An impossible δ.
    #[error("a drop scale of {0} cannot be: it is a number above 0, and 1 leaves the throughput as it is")]
    DropScale(f64),
    /// A fixed rate that the network's standard, width and streams do not have.
    #[error("{standard} has no {rate} with these streams in a channel of this width")]
    NoSuchRate {
        /// The standard.
        standard: &'static str,
        /// The rate.
        rate: FixedRate,
    },
    /// A rate above the medium's.
    #[error("{asked_mbps} Mbit/s are above the {medium} that the medium carries")]
    AboveMedium {
        /// Requested rate after scaling.
        asked_mbps: f64,
        /// The medium's rate.
        medium: BitRate,
    },
    /// A delay below the medium's.
    #[error(
        "{offered_ms} ms cannot be offered: the medium itself takes {medium_ms} ms, and no emulation takes time out of it"
    )]
    FasterThanMedium {
        /// The requested ψ·d.
        offered_ms: f64,
        /// The medium's own delay, d_m.
        medium_ms: f64,
    },
    /// A rate scaled down to nothing.
    #[error("a drop scale of {0} leaves less than 1 bit/s, or less than a delivery opportunity in 1000")]
    BelowOneBit(f64),
    /// A bursty loss of all packets.
    #[error("a bursty loss of {0} cannot be: with a share of 1 all packets are lost, which is no burst")]
    BurstyRate(f64),
    /// A mean burst of less than one packet.
    #[error("a mean burst of {0} packets cannot be: it is a number, 1 or more")]
    MeanBurst(f64),
    /// Bursts too short for the share lost: the good state would end before it began.
    #[error(
        "a share of {rate} cannot be lost in bursts of {mean_burst}: they must be {at_least:.3} or longer"
    )]
    BurstsTooShort {
        /// Share lost.
        rate: f64,
        /// Requested mean length.
        mean_burst: f64,
        /// Shortest mean length for that share.
        at_least: f64,
    },
    /// A queue limit of 0.
    #[error("a queue limit of 0 cannot be: give 1 or more packets or bytes")]
    Queue,
    /// An impossible parameter of a queue discipline.
    #[error("a queue discipline cannot be: {0}")]
    QueueDiscipline(#[from] InvalidDiscipline),
    /// A throughput test that is too short to measure, or disturbs for too long.
    #[error("a throughput test of {0:?} cannot be: it lasts from 10 ms to 10 s")]
    TestDuration(Duration),
    /// A throughput test that would overload the emulator.
    #[error("a throughput test at {0} cannot be: 1 Gbit/s is the most")]
    TestRate(BitRate),
    /// A direction with a current or very recent throughput test.
    #[error("`{link}` rests from its last throughput test: ask again in {rest:?}")]
    TestTooSoon {
        /// The link.
        link: LinkId,
        /// Time until the next test may start.
        rest: Duration,
    },
    /// A setting that only wired links have.
    #[error("a wireless link has no `{0}` of its own: its medium decides on it")]
    NotOnWireless(&'static str),
}

/// The longest delay or jitter deviation.
const LONGEST: Duration = Duration::from_secs(3600);

/// Fewest opportunities of a thinned trace, and largest δ of a trace.
const TRACE_RESOLUTION: f64 = 1000.0;

/// The requested conditions of one direction of a link, its medium, and the resulting conditions, which are always
/// possible ones.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    asked: Conditions,
    scale: Scale,
    medium: Medium,
    effective: Conditions,
}

impl Settings {
    /// Creates settings from conditions and their scales.
    pub(crate) fn new(asked: Conditions, scale: Scale, medium: Medium) -> Result<Self, FabricError> {
        let effective = effective(&asked, scale, medium)?;
        Ok(Self { asked, scale, medium, effective })
    }

    /// Returns the settings after a change.
    pub(crate) fn changed(&self, change: &ConditionChange) -> Result<Self, FabricError> {
        let mut asked = self.asked.clone();
        if let Some(ms) = change.delay_ms {
            asked.delay = from_ms(ms).ok_or(FabricError::Delay(ms))?;
        }
        if let Some(jitter) = change.jitter {
            asked.jitter = (!jitter.deviation.is_zero()).then_some(jitter);
        }
        asked.loss = change.loss.unwrap_or(asked.loss);
        asked.duplication = change.duplication.unwrap_or(asked.duplication);
        asked.corruption = change.corruption.unwrap_or(asked.corruption);
        asked.reordering = change.reordering.unwrap_or(asked.reordering);
        asked.rate = match change.rate.clone() {
            Some(Rate::NamedTrace(name))
                if asked.rate.trace_name().is_some_and(|own| own.sha256 == name.sha256) =>
            {
                asked.rate
            }
            changed => changed.unwrap_or(asked.rate),
        };
        asked.queue = change.queue.unwrap_or(asked.queue);
        asked.queue_discipline = change.queue_discipline.unwrap_or(asked.queue_discipline);
        let scale = Scale {
            delay_scale: change.delay_scale.unwrap_or(self.scale.delay_scale),
            drop_scale: change.drop_scale.unwrap_or(self.scale.drop_scale),
        };
        let effective = effective(&asked, scale, self.medium)?;
        Ok(Self { asked, scale, medium: self.medium, effective })
    }

    /// Returns the requested conditions, unscaled.
    pub(crate) fn asked(&self) -> &Conditions {
        &self.asked
    }

    /// Returns ψ and δ.
    pub(crate) fn scale(&self) -> Scale {
        self.scale
    }

    /// Returns the scaled conditions.
    pub(crate) fn effective(&self) -> &Conditions {
        &self.effective
    }

    /// Returns the highest throughput, bit/s.
    pub(crate) fn capacity_bps(&self) -> f64 {
        self.effective.rate.mean_bits_per_second().min(self.medium.rate.bits_per_second() as f64)
    }

    /// Whether it loses every packet.
    pub(crate) fn is_cut(&self) -> bool {
        matches!(self.effective.loss, Loss::Independent { rate } if rate == Probability::ONE)
    }
}

/// Converts milliseconds to whole nanoseconds; `None` below zero, above an hour, and for NaN.
fn from_ms(ms: f64) -> Option<Duration> {
    let duration = (0.0..=LONGEST.as_secs_f64() * 1e3).contains(&ms);
    duration.then(|| Duration::from_nanos((ms * 1e6).round() as u64))
}

fn scaled(duration: Duration, factor: f64) -> Option<Duration> {
    if factor == 1.0 {
        return (duration <= LONGEST).then_some(duration);
    }
    from_ms(duration.as_secs_f64() * 1e3 * factor)
}

fn effective(asked: &Conditions, scale: Scale, medium: Medium) -> Result<Conditions, FabricError> {
    let Scale { delay_scale, drop_scale } = scale;
    if !(delay_scale.is_finite() && delay_scale >= 0.0) {
        return Err(FabricError::DelayScale(delay_scale));
    }
    if !(drop_scale.is_finite() && drop_scale > 0.0) {
        return Err(FabricError::DropScale(drop_scale));
    }
    let ms = |d: Duration| d.as_secs_f64() * 1e3;
    let absurd = || FabricError::Delay(ms(asked.delay + medium.delay) * delay_scale);
    let delay = match medium.offered_delay(asked.delay, delay_scale) {
        Ok(delay) if delay <= LONGEST => delay,
        Ok(_) | Err(NotOffered::Absurd) => return Err(absurd()),
        Err(NotOffered::BelowMedium { offered }) => {
            return Err(FabricError::FasterThanMedium {
                offered_ms: ms(offered),
                medium_ms: ms(medium.delay),
            });
        }
    };
    let jitter = match asked.jitter {
        None => None,
        Some(jitter) => {
            jitter.check()?;
            let error = FabricError::Jitter(ms(jitter.deviation) * delay_scale);
            let deviation = scaled(jitter.deviation, delay_scale).ok_or(error)?;
            (!deviation.is_zero()).then_some(Jitter { deviation, ..jitter })
        }
    };
    check_loss(asked.loss)?;
    if matches!(asked.queue, QueueLimit::Packets(0) | QueueLimit::Bytes(0)) {
        return Err(FabricError::Queue);
    }
    asked.queue_discipline.check()?;
    let rate = scaled_rate(&asked.rate, drop_scale, medium.rate)?;
    Ok(Conditions { delay, jitter, rate, ..asked.clone() })
}

fn check_loss(loss: Loss) -> Result<(), FabricError> {
    let Loss::Bursty { rate, mean_burst } = loss else { return Ok(()) };
    let rate = rate.get();
    if rate >= 1.0 {
        return Err(FabricError::BurstyRate(rate));
    }
    if !(mean_burst.is_finite() && mean_burst >= 1.0) {
        return Err(FabricError::MeanBurst(mean_burst));
    }
    let at_least = rate / (1.0 - rate);
    // Tolerates rounding: a share like 0.9 has no exact quotient.
    if mean_burst * (1.0 + 1e-9) < at_least {
        return Err(FabricError::BurstsTooShort { rate, mean_burst, at_least });
    }
    Ok(())
}

/// Returns λ/δ. An unlimited rate is scaled from the medium's own.
fn scaled_rate(rate: &Rate, drop_scale: f64, medium: BitRate) -> Result<Rate, FabricError> {
    let within = |bits_per_second: f64| {
        if bits_per_second > medium.bits_per_second() as f64 {
            Err(FabricError::AboveMedium { asked_mbps: bits_per_second / 1e6, medium })
        } else {
            Ok(bits_per_second)
        }
    };
    let fixed = |bits_per_second: BitRate| {
        if drop_scale == 1.0 {
            within(bits_per_second.bits_per_second() as f64)?;
            return Ok(Rate::Fixed { bits_per_second });
        }
        let scaled = within(bits_per_second.bits_per_second() as f64 / drop_scale)?;
        let bits_per_second = BitRate::from_bits_per_second(scaled.round() as u64)
            .ok_or(FabricError::BelowOneBit(drop_scale))?;
        Ok(Rate::Fixed { bits_per_second })
    };
    match rate {
        Rate::Unlimited if drop_scale == 1.0 => Ok(Rate::Unlimited),
        Rate::Unlimited => fixed(medium),
        Rate::Fixed { bits_per_second } => fixed(*bits_per_second),
        Rate::NamedTrace(name) => Err(FabricError::UnknownTrace(name.sha256.clone())),
        Rate::Trace { trace } => {
            within(trace.mean_bits_per_second() / drop_scale)?;
            Ok(Rate::Trace { trace: thinned(trace, drop_scale)? })
        }
    }
}

/// Divides the opportunities of a trace by δ: thins them evenly above 1, multiplies them below. The trace is unrolled
/// first, over enough periods to keep the mean rate within 0.1 %.
fn thinned(trace: &Arc<Trace>, drop_scale: f64) -> Result<Arc<Trace>, FabricError> {
    if drop_scale == 1.0 {
        return Ok(Arc::clone(trace));
    }
    if drop_scale > TRACE_RESOLUTION {
        return Err(FabricError::BelowOneBit(drop_scale));
    }
    let times = trace.opportunities_ms();
    let periods = ((TRACE_RESOLUTION * drop_scale).ceil() as usize).div_ceil(times.len()) as u64;
    let total = times.len() as u64 * periods;
    // Counts from the end, which always keeps the last opportunity: it sets the period.
    let before = |from_end: u64| (from_end as f64 / drop_scale).ceil() as u64;
    let mut kept = Vec::new();
    for (i, ms) in (0..periods).flat_map(|p| times.iter().map(move |t| t + p * trace.period_ms())).enumerate()
    {
        let from_end = total - 1 - i as u64;
        let copies = before(from_end + 1) - before(from_end);
        kept.extend(std::iter::repeat_n(ms, copies as usize));
    }
    let kept = Trace::try_from(kept).expect("a trace's own times, thinned, never fall and end where it ends");
    Ok(Arc::new(match &trace.name().file {
        Some(file) => kept.in_file(file),
        None => kept,
    }))
}

/// Whether a link needs single packets: it has a random impairment, a queue that decides on each packet, or a rate at which
/// a super-packet would occupy it for long.
pub(crate) fn needs_packets(conditions: &Conditions) -> bool {
    /// At 1 Gbit/s a super-packet of 64 KiB takes half a millisecond.
    const COARSE: u64 = 1_000_000_000;
    let slow = match &conditions.rate {
        Rate::Unlimited => false,
        Rate::Fixed { bits_per_second } => bits_per_second.bits_per_second() < COARSE,
        Rate::Trace { .. } | Rate::NamedTrace(_) => true,
    };
    // Without a rate, no packet waits.
    let decides = !conditions.queue_discipline.is_drop_tail() && conditions.rate != Rate::Unlimited;
    slow || decides || is_impaired(conditions)
}

/// Whether a link has random impairments.
pub(crate) fn is_impaired(conditions: &Conditions) -> bool {
    let random = [conditions.duplication, conditions.corruption, conditions.reordering];
    conditions.loss != Loss::None
        || conditions.jitter.is_some()
        || random.into_iter().any(|p| p != Probability::ZERO)
}

/// The capacity of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carries {
    /// Highest throughput, bit/s.
    pub rate_bps: f64,
    /// Whether it loses every packet.
    pub is_cut: bool,
    /// Whether the link exists now. A wireless link does while its robot is attached over it, a wired one always.
    pub is_there: bool,
}

impl Carries {
    pub(crate) fn of(settings: &Settings) -> Self {
        Self { rate_bps: settings.capacity_bps(), is_cut: settings.is_cut(), is_there: true }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Correlation, JitterDistribution};

    use super::*;

    fn mbps(rate: f64) -> BitRate {
        BitRate::from_mbps(rate).unwrap()
    }

    fn fixed(rate: f64) -> Rate {
        Rate::Fixed { bits_per_second: mbps(rate) }
    }

    fn settings(asked: Conditions) -> Settings {
        let medium = Medium { delay: Duration::ZERO, rate: mbps(1000.0) };
        Settings::new(asked, Scale::default(), medium).unwrap()
    }

    fn rejected(change: ConditionChange) -> FabricError {
        let before = settings(Conditions { rate: fixed(100.0), ..Conditions::default() });
        before.changed(&change).unwrap_err()
    }

    #[test]
    fn scales_multiply_the_delay_and_divide_the_rate() {
        let jitter = Jitter { deviation: Duration::from_millis(2), ..Jitter::default() };
        let asked = Conditions {
            delay: Duration::from_millis(10),
            jitter: Some(jitter),
            rate: fixed(100.0),
            ..Conditions::default()
        };
        let change =
            ConditionChange { delay_scale: Some(1.5), drop_scale: Some(4.0), ..ConditionChange::default() };
        let after = settings(asked.clone()).changed(&change).unwrap();
        assert_eq!(after.asked(), &asked);
        assert_eq!(after.effective().delay, Duration::from_millis(15));
        assert_eq!(after.effective().jitter.unwrap().deviation, Duration::from_millis(3));
        assert_eq!(after.effective().rate, fixed(25.0));
        let back =
            ConditionChange { delay_scale: Some(1.0), drop_scale: Some(1.0), ..ConditionChange::default() };
        assert_eq!(after.changed(&back).unwrap().effective(), &asked);
    }

    #[test]
    fn the_mediums_delay_is_scaled_with_the_requested_one() {
        let ms = Duration::from_millis;
        let medium = Medium { delay: ms(4), rate: mbps(1000.0) };
        let asked = Conditions { delay: ms(6), ..Conditions::default() };
        let settings = Settings::new(asked, Scale::default(), medium).unwrap();
        let scaled = |delay_scale| {
            settings
                .changed(&ConditionChange { delay_scale: Some(delay_scale), ..ConditionChange::default() })
        };
        assert_eq!(settings.effective().delay, ms(10));
        assert_eq!(scaled(2.0).unwrap().effective().delay, ms(20));
        assert_eq!(scaled(0.4).unwrap().effective().delay, ms(4));
        let error = FabricError::FasterThanMedium { offered_ms: 3.0, medium_ms: 4.0 };
        assert_eq!(scaled(0.3).unwrap_err(), error);
        assert!(matches!(scaled(1e9), Err(FabricError::Delay(_))));
    }

    #[test]
    fn an_unlimited_rate_scales_from_the_medium() {
        let change = ConditionChange { drop_scale: Some(10.0), ..ConditionChange::default() };
        let after = settings(Conditions::default()).changed(&change).unwrap();
        assert_eq!(after.effective().rate, fixed(100.0));
    }

    #[test]
    fn a_scaled_trace_keeps_its_period_and_gets_its_share() {
        for text in ["1", "0\n0\n3\n7\n10"] {
            let trace = Arc::new(Trace::parse(text).unwrap());
            for drop_scale in [1.5, 2.0, 3.7, 100.0, 999.0, 0.25] {
                let scaled = thinned(&trace, drop_scale).unwrap();
                let share = scaled.mean_bits_per_second() * drop_scale / trace.mean_bits_per_second();
                assert!((share - 1.0).abs() < 0.0011, "{text:?} by {drop_scale}: {share}");
                assert_eq!(scaled.period_ms() % trace.period_ms(), 0);
            }
        }
    }

    #[test]
    fn impossible_conditions_are_rejected_with_a_reason() {
        let base = ConditionChange::default;
        for ms in [-1.0, f64::NAN, f64::INFINITY, 3_600_001.0] {
            assert!(matches!(
                rejected(ConditionChange { delay_ms: Some(ms), ..base() }),
                FabricError::Delay(_)
            ));
        }
        assert!(matches!(
            rejected(ConditionChange { delay_ms: Some(10.0), delay_scale: Some(1e9), ..base() }),
            FabricError::Delay(_)
        ));
        let jitter = Jitter {
            deviation: Duration::from_millis(1),
            distribution: JitterDistribution::Pareto,
            correlation: Correlation::new(-0.5).unwrap(),
            over: None,
        };
        assert!(matches!(
            rejected(ConditionChange { jitter: Some(jitter), ..base() }),
            FabricError::JitterCorrelation(_)
        ));
        for scale in [-0.1, f64::NAN, f64::INFINITY] {
            let change = ConditionChange { delay_scale: Some(scale), ..base() };
            assert!(matches!(rejected(change), FabricError::DelayScale(_)));
        }
        for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let change = ConditionChange { drop_scale: Some(scale), ..base() };
            assert!(matches!(rejected(change), FabricError::DropScale(_)));
        }
        let above = FabricError::AboveMedium { asked_mbps: 2000.0, medium: mbps(1000.0) };
        assert_eq!(rejected(ConditionChange { rate: Some(fixed(2000.0)), ..base() }), above);
        assert_eq!(rejected(ConditionChange { drop_scale: Some(0.05), ..base() }), above);
        assert_eq!(
            rejected(ConditionChange { drop_scale: Some(1e12), ..base() }),
            FabricError::BelowOneBit(1e12)
        );
        let bursty = |rate, mean_burst| {
            let rate = Probability::new(rate).unwrap();
            rejected(ConditionChange { loss: Some(Loss::Bursty { rate, mean_burst }), ..base() })
        };
        assert_eq!(bursty(1.0, 3.0), FabricError::BurstyRate(1.0));
        assert_eq!(bursty(0.1, 0.5), FabricError::MeanBurst(0.5));
        assert!(matches!(bursty(0.1, f64::NAN), FabricError::MeanBurst(_)));
        assert!(matches!(bursty(0.8, 2.0), FabricError::BurstsTooShort { .. }));
        let most = Loss::Bursty { rate: Probability::new(0.9).unwrap(), mean_burst: 9.0 };
        assert_eq!(check_loss(most), Ok(()));
        for queue in [QueueLimit::Packets(0), QueueLimit::Bytes(0)] {
            assert_eq!(rejected(ConditionChange { queue: Some(queue), ..base() }), FabricError::Queue);
        }
    }

    #[test]
    fn only_impairments_and_low_rates_need_single_packets() {
        assert!(!needs_packets(&Conditions::default()));
        assert!(!needs_packets(&Conditions { rate: fixed(1000.0), ..Conditions::default() }));
        assert!(needs_packets(&Conditions { rate: fixed(999.0), ..Conditions::default() }));
        let loss = Loss::Independent { rate: Probability::new(0.01).unwrap() };
        assert!(needs_packets(&Conditions { loss, ..Conditions::default() }));
        assert!(!needs_packets(&Conditions { delay: Duration::from_millis(5), ..Conditions::default() }));
    }
}
