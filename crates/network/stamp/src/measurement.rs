//! Delay, jitter and loss of the packets in a window.

use std::time::Duration;

use cotorra_numbers::quantile_of_times;

use crate::utc::Utc;

/// The outcome of a test packet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Outcome {
    pub(crate) sent_at: Utc,
    pub(crate) sample: Option<Sample>,
}

impl Outcome {
    /// Returns the delay there (0) or back (1), if both clocks are synchronised.
    fn one_way(&self, way: usize) -> Option<Duration> {
        Some(duration(self.sample?.one_way()?[way]))
    }
}

/// Delays of one answered packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    /// Round-trip delay without the reflector's processing time.
    pub round_trip: Duration,
    /// Delays of the way there and the way back, if both clocks are synchronised.
    pub ways: Option<[Duration; 2]>,
}

/// The measurement by one reply.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) replied_at: Utc,
    /// Round-trip time without the reflector's processing time.
    pub(crate) round_trip: Duration,
    /// Differences of both clocks' readings there and back, ns.
    pub(crate) ways: [i64; 2],
    /// Whether both clocks are synchronised.
    pub(crate) synchronized: bool,
    pub(crate) sequence: u32,
    /// The reflector's count.
    pub(crate) reflected: u32,
}

impl Sample {
    pub(crate) fn answer(&self) -> Answer {
        Answer { round_trip: self.round_trip, ways: self.one_way().map(|ways| ways.map(duration)) }
    }

    /// Returns the delays there and back, ns, if both clocks are synchronised.
    pub(crate) fn one_way(&self) -> Option<[i64; 2]> {
        self.synchronized.then_some(self.ways)
    }
}

/// Converts nanoseconds; negative values become zero.
pub(crate) fn duration(ns: i64) -> Duration {
    Duration::from_nanos(ns.max(0).unsigned_abs())
}

/// Statistics of delays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delays {
    /// The minimum.
    pub min: Duration,
    /// The mean.
    pub mean: Duration,
    /// The median.
    pub p50: Duration,
    /// The 99th percentile.
    pub p99: Duration,
    /// The maximum.
    pub max: Duration,
    /// Mean absolute difference of consecutive packets (packet delay variation by RFC 3393, of consecutive packets as in
    /// RFC 5481, section 4.1). `None` if no two consecutive packets were answered.
    pub jitter: Option<Duration>,
}

impl Delays {
    /// Returns the statistics of packets in order of sending. Delays may be unknown.
    fn of(delays: impl Iterator<Item = Option<Duration>> + Clone) -> Option<Self> {
        let mut sorted: Vec<_> = delays.clone().flatten().collect();
        sorted.sort_unstable();
        let at = |share| quantile_of_times(&sorted, share);
        let mean = mean(sorted.iter().copied())?;
        Some(Self {
            min: at(0.0)?,
            mean,
            p50: at(0.5)?,
            p99: at(0.99)?,
            max: at(1.0)?,
            jitter: jitter(delays),
        })
    }
}

/// Returns the mean; `None` without delays.
pub(crate) fn mean(delays: impl Iterator<Item = Duration>) -> Option<Duration> {
    let (count, total) = delays.fold((0, Duration::ZERO), |(n, total), delay| (n + 1, total + delay));
    total.checked_div(count)
}

pub(crate) fn jitter(delays: impl Iterator<Item = Option<Duration>> + Clone) -> Option<Duration> {
    mean(delays.clone().zip(delays.skip(1)).filter_map(|(a, b)| Some(a?.abs_diff(b?))))
}

/// Mean delay and jitter of one direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OneWay {
    /// The mean.
    pub mean: Duration,
    /// The jitter; see [`Delays::jitter`].
    pub jitter: Option<Duration>,
}

impl OneWay {
    /// Returns both directions, there and back, of outcomes in order of sending; `None` without answers.
    pub(crate) fn of<'a>(outcomes: impl Iterator<Item = &'a Outcome> + Clone) -> Option<[Self; 2]> {
        let way = |i: usize| {
            let delays = outcomes.clone().map(move |outcome| outcome.one_way(i));
            Some(Self { mean: mean(delays.clone().flatten())?, jitter: jitter(delays) })
        };
        Some([way(0)?, way(1)?])
    }
}

/// The estimate of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkEstimate {
    /// Delay and jitter, with the age of the latest answer; `None` without an answer within the window.
    pub delays: Option<(OneWay, Duration)>,
    /// Lost share of the packets that entered this direction, from 0 to 1; `None` if none did.
    pub loss: Option<f64>,
    /// Age of the latest packet that `loss` counts.
    pub loss_age: Duration,
}

/// The measurement over a session's window. Only answered and given-up packets count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Answered and given-up packets.
    pub sent: u32,
    /// Given-up packets.
    pub lost: u32,
    /// Share of packets lost on the way there, from 0 to 1. `None` if the reflector does not count its replies, or too few
    /// packets were answered.
    pub forward_loss: Option<f64>,
    /// Share of packets lost on the way back, of those that reached the reflector.
    pub backward_loss: Option<f64>,
    /// Round-trip delays without the reflector's processing time; `None` without answers.
    pub round_trip: Option<Delays>,
    /// Delays of the way there, if both clocks are synchronised.
    pub forward: Option<Delays>,
    /// Delays of the way back, if both clocks are synchronised.
    pub backward: Option<Delays>,
    /// Time of the latest reply.
    pub last_reply: Option<Utc>,
}

impl Measurement {
    /// Returns the lost share of all packets, from 0 to 1.
    pub fn loss(&self) -> f64 {
        f64::from(self.lost) / f64::from(self.sent.max(1))
    }

    /// Returns the age of the latest reply.
    pub fn age(&self, now: Utc) -> Option<Duration> {
        self.last_reply.map(|at| now.since(at))
    }

    /// Returns the measurement of outcomes in order of sending; `None` without outcomes.
    pub(crate) fn of<'a>(outcomes: impl Iterator<Item = &'a Outcome> + Clone, counts: bool) -> Option<Self> {
        let samples = outcomes.clone().filter_map(|outcome| outcome.sample);
        let sent = outcomes.clone().count() as u32;
        let lost = sent - samples.clone().count() as u32;
        let loss = counts.then(|| directions(samples.clone())).flatten();
        let way = |i: usize| Delays::of(outcomes.clone().map(move |outcome| outcome.one_way(i)));
        let round_trips = outcomes.clone().map(|outcome| outcome.sample.map(|sample| sample.round_trip));
        (sent > 0).then(|| Self {
            sent,
            lost,
            forward_loss: loss.map(|[forward, _]| forward),
            backward_loss: loss.map(|[_, backward]| backward),
            round_trip: Delays::of(round_trips),
            forward: way(0),
            backward: way(1),
            last_reply: samples.clone().map(|sample| sample.replied_at).max(),
        })
    }
}

/// Returns the share that each direction lost of the packets between the first and the last answered one; `None` if the
/// reflector's count is unusable.
pub(crate) fn directions(samples: impl Iterator<Item = Sample> + Clone) -> Option<[f64; 2]> {
    let first = samples.clone().next()?;
    let last = samples.clone().last()?;
    let sent = last.sequence.wrapping_sub(first.sequence);
    let reflected = last.reflected.wrapping_sub(first.reflected);
    let answered = samples.count() as u32 - 1;
    // The count is inconsistent if the reflector was restarted, or packets were reordered.
    (sent > 0 && answered <= reflected && reflected <= sent).then(|| {
        let share = |lost: u32, of: u32| if of == 0 { 0.0 } else { f64::from(lost) / f64::from(of) };
        [share(sent - reflected, sent), share(reflected - answered, reflected)]
    })
}
