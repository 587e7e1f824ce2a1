//! Measurements of one direction of a link over a window.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{Conditions, FigureSource, LinkContext, Probing, Timestamp};
use cotorra_numbers::wilson;

use super::settings::Measurements;

/// Load that counts, as a share of a link's rate, at the least.
const LEAST_LOAD: f64 = 0.05;
/// Samples of counters in a window.
const SAMPLES: u32 = 10;

/// Configured figures of one direction of a link.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Configured {
    pub(super) delay: Duration,
    pub(super) rate_bps: f64,
}

impl From<&Conditions> for Configured {
    fn from(conditions: &Conditions) -> Self {
        Self { delay: conditions.delay, rate_bps: conditions.rate.mean_bits_per_second() }
    }
}

/// What carries packets.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Carrier {
    /// A wire, whose queue any packet can find full.
    #[default]
    Wire,
    /// The air, which scans and handovers interrupt for moments.
    Air,
}

/// Settings of all measurements.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measuring {
    pub(super) measurements: Measurements,
    /// Probes of links; `None` if they are not probed.
    pub(super) probing: Option<Probing>,
}

impl Measuring {
    /// Returns the time for which delays count.
    fn window(&self, carrier: Carrier) -> Duration {
        let window = self.measurements.window;
        match carrier {
            Carrier::Wire => window,
            // An interrupted probe is in the mean for so long.
            Carrier::Air => window + self.probing.map_or(Duration::ZERO, |probing| probing.window),
        }
    }

    /// Returns the lower bound of the probability of a loss by the share of lost probes. Their number is that of their interval.
    fn certain_loss(&self, share: f64) -> f64 {
        let Some(Probing { interval, window }) = self.probing else { return 0.0 };
        let probes = (window.as_secs_f64() / interval.as_secs_f64()).clamp(1.0, f64::from(Probing::MOST));
        let lost = (share * probes).floor();
        wilson(lost as u64, probes as u64).map_or(0.0, |interval| interval.low.max(0.0))
    }
}

/// Counters of one direction at a time.
#[derive(Debug, Clone, Copy)]
struct Counted {
    at: Timestamp,
    packets: u64,
    lost: u64,
    bytes: u64,
}

/// What was measured of one direction beyond the configuration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct OneWay {
    /// Further delay.
    pub(super) delay: Duration,
    /// Load, bit/s.
    pub(super) load_bps: f64,
    /// Share of packets that are certainly lost.
    pub(super) loss: f64,
}

/// One direction of a link.
#[derive(Debug, Default)]
pub(super) struct Way {
    carrier: Carrier,
    configured: Configured,
    /// Measurements from before this time met other conditions.
    since: Timestamp,
    /// Delays beyond the configured one, with their times: from the oldest, which counts, to the latest. Only those that count at
    /// some time.
    delays: VecDeque<(Timestamp, Duration)>,
    /// Time from which on there are delays.
    begun: Timestamp,
    /// The window's counters.
    counted: VecDeque<Counted>,
    /// Certain loss of the last fresh probes, with its time.
    probed_loss: Option<(Timestamp, f64)>,
    /// The further delay and the load of the last report of news.
    reported: (Duration, f64),
}

impl Way {
    pub(super) fn new(carrier: Carrier, configured: Configured) -> Self {
        Self { carrier, configured, ..Self::default() }
    }

    /// Whether delays of the window are known.
    pub(super) fn is_measured(&self) -> bool {
        !self.delays.is_empty()
    }

    pub(super) fn configured(&self) -> Configured {
        self.configured
    }

    /// Sets the configuration. Returns whether it is another one.
    pub(super) fn configure(&mut self, now: Timestamp, configured: Configured) -> bool {
        let changes = self.configured != configured;
        if self.configured.delay != configured.delay {
            self.since = now;
            self.delays.clear();
        }
        self.configured = configured;
        changes
    }

    pub(super) fn measure(&mut self, now: Timestamp, context: &LinkContext, measuring: &Measuring) {
        let Measurements { window, tolerance, .. } = measuring.measurements;
        if let Some(delay) = self.delay(now, context, window) {
            let beyond = delay.saturating_sub(self.configured.delay);
            let beyond = if beyond >= tolerance { beyond } else { Duration::ZERO };
            if self.delays.is_empty() {
                self.begun = now;
            }
            let counts_before = |earlier: Duration| match self.carrier {
                Carrier::Wire => earlier > beyond,
                Carrier::Air => earlier < beyond,
            };
            while self.delays.pop_back_if(|(_, earlier)| !counts_before(*earlier)).is_some() {}
            self.delays.push_back((now, beyond));
        }
        if let Some(probed) = context.probed.filter(|probed| probed.loss_age <= window)
            && self.is_settled(now, window)
        {
            self.probed_loss = probed.loss.map(|share| (now, measuring.certain_loss(share)));
        }
        let counters = &context.counters;
        let (packets, bytes, lost) = (counters.packets, counters.bytes, counters.lost + counters.overflowed);
        let counted = Counted { at: now, packets, lost, bytes };
        let is_due = |last: &Counted| now.since(last.at) >= window / SAMPLES;
        if self.counted.back().is_none_or(is_due) {
            self.counted.push_back(counted);
        }
        self.forget(now, measuring);
    }

    /// Whether measurements over a time met the present conditions alone.
    fn is_settled(&self, now: Timestamp, over: Duration) -> bool {
        self.since == Timestamp::ZERO || now.since(self.since) >= over
    }

    /// Returns the measured delay that met the present conditions.
    fn delay(&self, now: Timestamp, context: &LinkContext, window: Duration) -> Option<Duration> {
        let measured = context.measured_delay(window)?;
        let over = match measured.source {
            FigureSource::Probed => window,
            _ => LinkContext::METERED + self.configured.delay,
        };
        self.is_settled(now, over).then_some(measured.delay)
    }

    /// Drops what is older than the window. One earlier sample of the counters stays as their beginning.
    pub(super) fn forget(&mut self, now: Timestamp, measuring: &Measuring) {
        let is_older = |at: Timestamp, window| now.since(at) > window;
        let (delays, window) = (measuring.window(self.carrier), measuring.measurements.window);
        while self.delays.pop_front_if(|(at, _)| is_older(*at, delays)).is_some() {}
        while self.counted.get(1).is_some_and(|counted| is_older(counted.at, window)) {
            self.counted.pop_front();
        }
        self.probed_loss = self.probed_loss.filter(|(at, _)| !is_older(*at, window));
    }

    /// Returns what was measured beyond the configuration.
    pub(super) fn beyond(&self, measuring: &Measuring) -> OneWay {
        let lasted = self.delays.back().is_some_and(|(last, _)| match self.carrier {
            Carrier::Wire => true,
            Carrier::Air => last.since(self.begun) >= measuring.window(Carrier::Air),
        });
        let delay = self.delays.front().filter(|_| lasted).map_or(Duration::ZERO, |(_, delay)| *delay);
        let probed_loss = self.probed_loss.map_or(0.0, |(_, loss)| loss);
        let (Some(first), Some(last)) = (self.counted.front(), self.counted.back()) else {
            return OneWay { delay, load_bps: 0.0, loss: probed_loss };
        };
        let seconds = last.at.since(first.at).as_secs_f64();
        let bits = last.bytes.saturating_sub(first.bytes) as f64 * 8.0;
        let load = if seconds > 0.0 { bits / seconds } else { 0.0 };
        let load_bps = if load >= LEAST_LOAD * self.configured.rate_bps { load } else { 0.0 };
        let lost = last.lost.saturating_sub(first.lost);
        let sent = lost + last.packets.saturating_sub(first.packets);
        let counted_loss = wilson(lost, sent).map_or(0.0, |interval| interval.low.max(0.0));
        OneWay { delay, load_bps, loss: counted_loss.max(probed_loss) }
    }

    /// Returns whether delay and load differ from those of the last report by as much as counts, and reports them if so.
    pub(super) fn has_news(&mut self, measuring: &Measuring) -> bool {
        let OneWay { delay, load_bps, .. } = self.beyond(measuring);
        let differ = delay.abs_diff(self.reported.0) >= measuring.measurements.tolerance
            || (load_bps - self.reported.1).abs() >= LEAST_LOAD * self.configured.rate_bps;
        if differ {
            self.reported = (delay, load_bps);
        }
        differ
    }
}
