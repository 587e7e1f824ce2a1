//! What the packets of the last while tell: delay, jitter and loss.

use std::time::Duration;

use crate::utc::Utc;

/// What became of a test packet, and when it was sent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Outcome {
    pub(crate) sent_at: Utc,
    pub(crate) sample: Option<Sample>,
}

impl Outcome {
    /// The delay there (0) or back (1), if the clocks tell it.
    fn one_way(&self, way: usize) -> Option<Duration> {
        Some(duration(self.sample?.one_way()?[way]))
    }
}

/// What one reply tells.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) replied_at: Utc,
    /// Without the time that the reflector took.
    pub(crate) round_trip: Duration,
    /// Nanoseconds there and back, each from one clock's reading to the other's.
    pub(crate) ways: [i64; 2],
    /// Whether both clocks tell the same time.
    pub(crate) synchronized: bool,
    pub(crate) sequence: u32,
    /// The reflector's count.
    pub(crate) reflected: u32,
}

impl Sample {
    /// Nanoseconds there and back, if both clocks tell the same time.
    pub(crate) fn one_way(&self) -> Option<[i64; 2]> {
        self.synchronized.then_some(self.ways)
    }
}

/// No time at all if it is negative.
pub(crate) fn duration(ns: i64) -> Duration {
    Duration::from_nanos(ns.max(0).unsigned_abs())
}

/// The delays of some packets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delays {
    /// The least.
    pub min: Duration,
    /// The mean.
    pub mean: Duration,
    /// The median.
    pub p50: Duration,
    /// What 99 % did not exceed.
    pub p99: Duration,
    /// The most.
    pub max: Duration,
    /// The mean difference of two packets in a row, without its sign (packet delay variation by RFC 3393, of
    /// consecutive packets as in RFC 5481, section 4.1). `None` if no two in a row were answered.
    pub jitter: Option<Duration>,
}

impl Delays {
    /// Of packets in the order of sending; of some the delay is not known.
    fn of(delays: impl Iterator<Item = Option<Duration>> + Clone) -> Option<Self> {
        let mut sorted: Vec<_> = delays.clone().flatten().collect();
        sorted.sort_unstable();
        let rank = |share: usize| sorted[(sorted.len() * share).div_ceil(100).max(1) - 1];
        let (min, max) = (*sorted.first()?, *sorted.last()?);
        let mean = mean(sorted.iter().copied())?;
        Some(Self { min, mean, p50: rank(50), p99: rank(99), max, jitter: jitter(delays) })
    }
}

/// `None` of nothing.
pub(crate) fn mean(delays: impl Iterator<Item = Duration>) -> Option<Duration> {
    let (count, total) = delays.fold((0, Duration::ZERO), |(n, total), delay| (n + 1, total + delay));
    total.checked_div(count)
}

pub(crate) fn jitter(delays: impl Iterator<Item = Option<Duration>> + Clone) -> Option<Duration> {
    mean(delays.clone().zip(delays.skip(1)).filter_map(|(a, b)| Some(a?.abs_diff(b?))))
}

/// What the delays of one direction come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OneWay {
    /// The mean.
    pub mean: Duration,
    /// As [`Delays::jitter`].
    pub jitter: Option<Duration>,
}

impl OneWay {
    /// Both directions, there and back, by outcomes in the order of sending; `None` if nothing was answered.
    pub(crate) fn of<'a>(outcomes: impl Iterator<Item = &'a Outcome> + Clone) -> Option<[Self; 2]> {
        let way = |i: usize| {
            let delays = outcomes.clone().map(move |outcome| outcome.one_way(i));
            Some(Self { mean: mean(delays.clone().flatten())?, jitter: jitter(delays) })
        };
        Some([way(0)?, way(1)?])
    }
}

/// What probes tell of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkEstimate {
    /// Delay and its variation, and how long ago the latest answer came; `None` if none came within the window.
    pub delays: Option<(OneWay, Duration)>,
    /// Share of those that came to this direction that it lost, from 0 to 1; `None` if none came.
    pub loss: Option<f64>,
    /// How long ago the latest probe was sent that `loss` counts.
    pub loss_age: Duration,
}

/// What was measured over a session's window. Only packets of which it is known what became of them count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Packets that were answered, or given up.
    pub sent: u32,
    /// Packets that were given up.
    pub lost: u32,
    /// Of the packets that got lost or not, how many the way there lost, from 0 to 1. `None` if the reflector has no
    /// count of its own, or too few packets were answered to tell.
    pub forward_loss: Option<f64>,
    /// The same of the way back, of those that reached the reflector.
    pub backward_loss: Option<f64>,
    /// There and back, without the time that the reflector took; `None` if nothing was answered.
    pub round_trip: Option<Delays>,
    /// The way there, where both clocks are synchronised.
    pub forward: Option<Delays>,
    /// The way back, where both clocks are synchronised.
    pub backward: Option<Delays>,
    /// When the latest reply came.
    pub last_reply: Option<Utc>,
}

impl Measurement {
    /// Lost packets, of all, from 0 to 1.
    pub fn loss(&self) -> f64 {
        f64::from(self.lost) / f64::from(self.sent.max(1))
    }

    /// How old the latest reply is.
    pub fn age(&self, now: Utc) -> Option<Duration> {
        self.last_reply.map(|at| now.since(at))
    }

    /// What outcomes, in the order of sending, say; `None` if there are none.
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

/// Of the packets between the first and the last that were answered, which share each direction lost.
pub(crate) fn directions(samples: impl Iterator<Item = Sample> + Clone) -> Option<[f64; 2]> {
    let first = samples.clone().next()?;
    let last = samples.clone().last()?;
    let sent = last.sequence.wrapping_sub(first.sequence);
    let reflected = last.reflected.wrapping_sub(first.reflected);
    let answered = samples.count() as u32 - 1;
    // A reflector that was started again, or that reordered packets, counts something else.
    (sent > 0 && answered <= reflected && reflected <= sent).then(|| {
        let share = |lost: u32, of: u32| if of == 0 { 0.0 } else { f64::from(lost) / f64::from(of) };
        [share(sent - reflected, sent), share(reflected - answered, reflected)]
    })
}
