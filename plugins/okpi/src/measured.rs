//! Figures of wired links that decisions count with: the configured ones, and what was measured beyond them.
//!
//! - **Delay.** The mean of the link's probes, if they are fresh, else that of its packets over the last second. What it
//!   exceeds the configured delay by counts from the tolerance on. It rises at once, and falls only when the window has
//!   passed: the highest of the window counts.
//! - **Throughput.** What is left: the rate less the mean load of the window.
//! - **Loss.** As far as the counters of the window prove it: the lower bound of Wilson's 95 % interval.
//!
//! A measured delay has the queueing in it that the service itself causes. A service that leaves a link because of what was
//! measured there would find it idle, and come back. Therefore [`Memory`] keeps the figures of a link that a service left,
//! for that service, and twice as long each time.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use cotorra_graph::{Conditions, Direction, HardwareGraph, LinkContext, LinkId, Probed, Scale, Timestamp};
use cotorra_numbers::wilson;

use crate::settings::Measurements;

/// Load that counts, as a share of a link's rate, at the least.
const LEAST_LOAD: f64 = 0.05;
/// Samples of counters in a window.
const SAMPLES: u32 = 10;
/// Longest time for which [`Memory`] keeps figures.
const LONGEST_HOLD: Duration = Duration::from_secs(600);

/// Configured figures of one direction of a link.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Configured {
    delay: Duration,
    rate_bps: f64,
}

/// Effect of a context on decisions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum News {
    Nothing,
    /// A measurement changed by as much as counts.
    Measured,
    /// The link is configured otherwise.
    Configured,
}

/// Figures of both directions of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LinkFigures {
    /// Configured delay there and back.
    pub(crate) configured: Duration,
    /// Configured rate of the slower direction, bit/s.
    pub(crate) rate_bps: f64,
    /// What was measured beyond that.
    pub(crate) beyond: Beyond,
}

/// What was measured beyond the configuration of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Beyond {
    /// Further delay there and back.
    pub(crate) delay: Duration,
    /// Load of the busier direction, bit/s.
    pub(crate) load_bps: f64,
    /// Probability that a packet and its answer cross.
    pub(crate) delivery: f64,
}

/// Nothing.
impl Default for Beyond {
    fn default() -> Self {
        Self { delay: Duration::ZERO, load_bps: 0.0, delivery: 1.0 }
    }
}

impl Beyond {
    /// Returns the worse of each figure.
    fn worse(self, other: Self) -> Self {
        Self {
            delay: self.delay.max(other.delay),
            load_bps: self.load_bps.max(other.load_bps),
            delivery: self.delivery.min(other.delivery),
        }
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

/// One direction of a link.
#[derive(Debug, Default)]
struct Way {
    configured: Configured,
    /// Measurements from before this time met other conditions.
    since: Timestamp,
    /// Delays beyond the configured one, with their times. Only those that are the highest of the window at some time: from
    /// the oldest and highest to the latest.
    delays: VecDeque<(Timestamp, Duration)>,
    /// The window's counters.
    counted: VecDeque<Counted>,
    /// The further delay and the load of the last report of news.
    reported: (Duration, f64),
}

impl Way {
    fn measure(&mut self, now: Timestamp, context: &LinkContext, measurements: &Measurements) {
        let window = measurements.window;
        if let Some(delay) = self.delay(now, context, window) {
            let beyond = delay.saturating_sub(self.configured.delay);
            let beyond = if beyond >= measurements.tolerance { beyond } else { Duration::ZERO };
            while self.delays.pop_back_if(|(_, earlier)| *earlier <= beyond).is_some() {}
            self.delays.push_back((now, beyond));
        }
        let counters = &context.counters;
        let (packets, bytes, lost) = (counters.packets, counters.bytes, counters.lost + counters.overflowed);
        let counted = Counted { at: now, packets, lost, bytes };
        let is_due = |last: &Counted| now.since(last.at) >= window / SAMPLES;
        if self.counted.back().is_none_or(is_due) {
            self.counted.push_back(counted);
        }
        self.forget(now, window);
    }

    /// Returns the measured delay that met the present conditions.
    fn delay(&self, now: Timestamp, context: &LinkContext, window: Duration) -> Option<Duration> {
        let settled = |over: Duration| self.since == Timestamp::ZERO || now.since(self.since) >= over;
        let fresh = |probed: &Probed| probed.delay_age.is_some_and(|age| age <= window);
        match context.probed.filter(fresh) {
            Some(probed) => probed.delay.filter(|_| settled(window)),
            None => context.delay.filter(|_| settled(Duration::from_secs(1) + self.configured.delay)),
        }
    }

    /// Drops what is older than the window. One earlier sample of the counters stays as their beginning.
    fn forget(&mut self, now: Timestamp, window: Duration) {
        let is_old = |at: Timestamp| now.since(at) > window;
        while self.delays.pop_front_if(|(at, _)| is_old(*at)).is_some() {}
        while self.counted.get(1).is_some_and(|counted| is_old(counted.at)) {
            self.counted.pop_front();
        }
    }

    /// Returns the further delay, the load, and the share of packets that are certainly lost.
    fn beyond(&self) -> (Duration, f64, f64) {
        let delay = self.delays.front().map_or(Duration::ZERO, |(_, delay)| *delay);
        let (Some(first), Some(last)) = (self.counted.front(), self.counted.back()) else {
            return (delay, 0.0, 0.0);
        };
        let seconds = last.at.since(first.at).as_secs_f64();
        let bits = last.bytes.saturating_sub(first.bytes) as f64 * 8.0;
        let load = if seconds > 0.0 { bits / seconds } else { 0.0 };
        let load = if load >= LEAST_LOAD * self.configured.rate_bps { load } else { 0.0 };
        let lost = last.lost.saturating_sub(first.lost);
        let sent = lost + last.packets.saturating_sub(first.packets);
        (delay, load, wilson(lost, sent).map_or(0.0, |interval| interval.low.max(0.0)))
    }

    /// Returns whether the figures differ from those of the last report by as much as counts, and reports them if so.
    fn has_news(&mut self, tolerance: Duration) -> bool {
        let (delay, load, _) = self.beyond();
        let differ = delay.abs_diff(self.reported.0) >= tolerance
            || (load - self.reported.1).abs() >= LEAST_LOAD * self.configured.rate_bps;
        if differ {
            self.reported = (delay, load);
        }
        differ
    }
}

/// What is known of all wired links.
#[derive(Debug)]
pub(crate) struct Links {
    /// `None` for the configured figures alone.
    measurements: Option<Measurements>,
    ways: BTreeMap<(LinkId, Direction), Way>,
}

impl Links {
    /// Creates the links of a graph as they are configured.
    pub(crate) fn new(graph: &HardwareGraph, measurements: Option<Measurements>) -> Self {
        let ways = graph.links.iter().flat_map(|link| {
            let ways = [(Direction::Forward, &link.forward), (Direction::Backward, &link.backward)];
            ways.into_iter().zip(link.scales).map(|((direction, conditions), scale)| {
                let medium = link.medium.bits_per_second() as f64;
                let configured = scaled(configured(conditions), scale, medium);
                ((link.id.clone(), direction), Way { configured, ..Way::default() })
            })
        });
        Self { measurements, ways: ways.collect() }
    }

    /// Learns the context of a link at a time.
    pub(crate) fn learn(&mut self, at: Timestamp, context: &LinkContext) -> News {
        let Some(way) = self.ways.get_mut(&(context.link.clone(), context.direction)) else {
            return News::Nothing;
        };
        let configured = configured(&context.effective);
        let changes = way.configured != configured;
        if changes {
            if way.configured.delay != configured.delay {
                way.since = at;
                way.delays.clear();
            }
            way.configured = configured;
        }
        let measured = self.measurements.is_some_and(|measurements| {
            way.measure(at, context, &measurements);
            way.has_news(measurements.tolerance)
        });
        match (changes, measured) {
            (true, _) => News::Configured,
            (false, true) => News::Measured,
            (false, false) => News::Nothing,
        }
    }

    /// Drops measurements that are too old.
    pub(crate) fn forget(&mut self, now: Timestamp) {
        if let Some(measurements) = &self.measurements {
            self.ways.values_mut().for_each(|way| way.forget(now, measurements.window));
        }
    }

    /// Whether anything was measured beyond the configuration.
    pub(crate) fn any_beyond(&self) -> bool {
        self.measurements.is_some()
            && self.ways.values().any(|way| way.beyond() != (Duration::ZERO, 0.0, 0.0))
    }

    /// Returns the figures of a link.
    pub(crate) fn figures(&self, link: &LinkId) -> LinkFigures {
        let way = |direction| self.ways.get(&(link.clone(), direction));
        let ways = [way(Direction::Forward), way(Direction::Backward)].map(|way| {
            let measured = way.filter(|_| self.measurements.is_some());
            let beyond = measured.map_or((Duration::ZERO, 0.0, 0.0), Way::beyond);
            (way.map_or_else(Configured::default, |way| way.configured), beyond)
        });
        let [(there, out), (back, home)] = ways;
        LinkFigures {
            configured: there.delay + back.delay,
            rate_bps: there.rate_bps.min(back.rate_bps),
            beyond: Beyond {
                delay: out.0 + home.0,
                load_bps: out.1.max(home.1),
                delivery: (1.0 - out.2) * (1.0 - home.2),
            },
        }
    }
}

/// Links that a service left, as they were then.
#[derive(Debug, Default)]
pub(crate) struct Memory(BTreeMap<LinkId, Left>);

/// A link that was left.
#[derive(Debug)]
struct Left {
    beyond: Beyond,
    /// Until then the figures count.
    until: Timestamp,
    hold: Duration,
}

impl Memory {
    /// Notes that a service leaves a link with these figures. A service that comes back and leaves again stays away for twice
    /// as long.
    pub(crate) fn leave(&mut self, now: Timestamp, link: &LinkId, beyond: Beyond, hold: Duration) {
        let left =
            self.0.entry(link.clone()).or_insert_with(|| Left { beyond, until: now, hold: Duration::ZERO });
        if left.hold.is_zero() || now > left.until + left.hold {
            (left.hold, left.beyond) = (hold, beyond);
        } else if now >= left.until {
            (left.hold, left.beyond) = ((left.hold * 2).min(LONGEST_HOLD.max(hold)), beyond);
        } else {
            // It is still on its way.
            left.beyond = left.beyond.worse(beyond);
        }
        left.until = now + left.hold;
    }

    /// Returns the figures of a link with those at which it was left.
    pub(crate) fn with(&self, now: Timestamp, link: &LinkId, beyond: Beyond) -> Beyond {
        match self.0.get(link) {
            Some(left) if now < left.until => beyond.worse(left.beyond),
            _ => beyond,
        }
    }

    /// Whether any of them counts.
    pub(crate) fn is_held(&self, now: Timestamp) -> bool {
        self.0.values().any(|left| now < left.until)
    }
}

/// Returns the figures of a link that is scaled from the start, before its first event: delay ψ·d, throughput λ/δ.
fn scaled(Configured { delay, rate_bps }: Configured, scale: Scale, medium_bps: f64) -> Configured {
    let seconds = delay.as_secs_f64() * scale.delay_scale;
    let delay =
        if scale.delay_scale == 1.0 { delay } else { Duration::try_from_secs_f64(seconds).unwrap_or(delay) };
    let untouched = scale.drop_scale == 1.0;
    let rate_bps = if untouched { rate_bps } else { rate_bps.min(medium_bps) / scale.drop_scale };
    Configured { delay, rate_bps }
}

fn configured(conditions: &Conditions) -> Configured {
    Configured { delay: conditions.delay, rate_bps: conditions.rate.mean_bits_per_second() }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{LinkCounters, Rate};
    use cotorra_graph_testing as base;
    use proptest::prelude::*;

    use super::*;

    const WAYS: [Direction; 2] = [Direction::Forward, Direction::Backward];

    fn seconds(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    fn ms(ms: f64) -> Duration {
        Duration::from_secs_f64(ms / 1e3)
    }

    fn link() -> LinkId {
        LinkId::new("lan-cloud").unwrap()
    }

    /// One link of 5 ms and 10 Mbit/s each way.
    struct Bed {
        links: Links,
        context: LinkContext,
        /// Rate at which bytes cross forward, bit/s.
        load_bps: f64,
    }

    fn bed(measurements: Option<Measurements>) -> Bed {
        let text = "
name: one
nodes: { lan: { kind: switch }, cloud: { kind: server, tier: cloud, cpus: 1, memory: 1 GB } }
links: [{ ends: [lan, cloud], delay: 5 ms, rate: 10 Mbit/s }]
";
        let testbed = cotorra_testbed_file::parse("one.yaml", text, std::path::Path::new("")).unwrap();
        let rate = Rate::Fixed { bits_per_second: cotorra_graph::BitRate::from_mbps(10.0).unwrap() };
        let effective = Conditions { delay: ms(5.0), rate, ..Conditions::default() };
        let context = LinkContext { effective, ..base::link_context("lan-cloud") };
        Bed { links: Links::new(&testbed.graph, measurements), context, load_bps: 0.0 }
    }

    impl Bed {
        /// Learns contexts from `from` to `to`, ten a second. Returns how often there were news of measurements.
        fn learn(&mut self, from: f64, to: f64) -> usize {
            let steps = ((to - from) * 10.0).round() as u32;
            let mut news = 0;
            for step in 0..steps {
                let now = seconds(from + f64::from(step) / 10.0);
                self.context.counters.bytes += (self.load_bps / 80.0) as u64;
                self.links.forget(now);
                for direction in WAYS {
                    let idle = LinkContext {
                        probed: None,
                        delay: None,
                        counters: LinkCounters::default(),
                        ..self.context.clone()
                    };
                    let context = if direction == Direction::Forward { self.context.clone() } else { idle };
                    let context = LinkContext { direction, ..context };
                    news += usize::from(self.links.learn(now, &context) == News::Measured);
                }
            }
            news
        }

        fn probed(&mut self, delay: f64) {
            let (delay, age) = (Some(ms(delay)), ms(100.0));
            let probed = Probed { delay, jitter: None, delay_age: Some(age), loss: None, loss_age: age };
            self.context.probed = Some(probed);
        }

        fn beyond(&self) -> Beyond {
            self.links.figures(&link()).beyond
        }
    }

    #[test]
    fn measured_delay_counts_at_once_and_until_the_window_has_passed() {
        let mut bed = bed(Some(Measurements::default()));
        bed.probed(5.9);
        assert_eq!(bed.learn(0.0, 5.0), 0, "that is within the tolerance");
        assert_eq!(bed.beyond(), Beyond::default());
        bed.probed(29.0);
        assert_eq!(bed.learn(5.0, 5.1), 1);
        assert_eq!(bed.beyond().delay, ms(24.0));
        assert_eq!(bed.links.figures(&link()).configured, ms(10.0));
        bed.probed(5.0);
        assert_eq!(bed.learn(5.1, 15.0), 0);
        assert_eq!(bed.beyond().delay, ms(24.0), "it was so 9.9 s ago");
        assert_eq!(bed.learn(15.0, 16.0), 1);
        assert_eq!(bed.beyond(), Beyond::default());
    }

    #[test]
    fn the_configured_delay_is_the_least() {
        let mut bed = bed(Some(Measurements::default()));
        bed.probed(1.0);
        bed.learn(0.0, 5.0);
        let figures = bed.links.figures(&link());
        assert_eq!((figures.configured, figures.beyond), (ms(10.0), Beyond::default()));
    }

    #[test]
    fn packets_count_where_probes_are_old_or_absent() {
        let mut bed = bed(Some(Measurements::default()));
        bed.context.delay = Some(ms(12.0));
        bed.learn(0.0, 1.0);
        assert_eq!(bed.beyond().delay, ms(7.0));
        bed.probed(5.0);
        bed.learn(1.0, 12.0);
        assert_eq!(bed.beyond().delay, Duration::ZERO, "what probes meet counts first");
        bed.context.probed.as_mut().unwrap().delay_age = Some(ms(10_100.0));
        bed.learn(12.0, 12.1);
        assert_eq!(bed.beyond().delay, ms(7.0));
    }

    #[test]
    fn measurements_of_other_conditions_do_not_count() {
        let mut bed = bed(Some(Measurements::default()));
        bed.context.effective.delay = ms(30.0);
        bed.probed(30.0);
        bed.learn(0.0, 20.0);
        bed.context.effective.delay = ms(5.0);
        bed.learn(20.0, 20.1);
        let figures = bed.links.figures(&link());
        assert_eq!((figures.configured, figures.beyond.delay), (ms(10.0), Duration::ZERO));
        bed.learn(20.1, 29.0);
        assert_eq!(bed.beyond().delay, Duration::ZERO, "probes of before are in their mean");
        bed.learn(29.0, 31.0);
        assert_eq!(bed.beyond().delay, ms(25.0));
    }

    #[test]
    fn load_is_the_mean_of_the_window_and_counts_from_a_twentieth_of_the_rate() {
        let mut bed = bed(Some(Measurements::default()));
        bed.load_bps = 0.4e6;
        bed.learn(0.0, 10.0);
        assert_eq!(bed.beyond().load_bps, 0.0);
        bed.load_bps = 8e6;
        bed.learn(10.0, 25.0);
        assert!((bed.beyond().load_bps / 8e6 - 1.0).abs() < 0.01, "{:?}", bed.beyond());
    }

    #[test]
    fn loss_counts_as_far_as_it_is_certain() {
        let mut bed = bed(Some(Measurements::default()));
        bed.learn(0.0, 1.0);
        bed.context.counters = LinkCounters { packets: 199, lost: 1, ..LinkCounters::default() };
        bed.learn(1.0, 3.0);
        let one = bed.beyond().delivery;
        assert!((0.998..1.0).contains(&one), "{one}");
        bed.context.counters =
            LinkCounters { packets: 1980, lost: 10, overflowed: 10, ..LinkCounters::default() };
        bed.learn(3.0, 5.0);
        let many = bed.beyond().delivery;
        assert!((0.99..0.995).contains(&many), "of 1 %: {many}");
    }

    #[test]
    fn without_measurements_only_the_configuration_counts() {
        let mut bed = bed(None);
        bed.probed(29.0);
        bed.load_bps = 8e6;
        assert_eq!(bed.learn(0.0, 20.0), 0);
        assert_eq!(bed.beyond(), Beyond::default());
        assert!(!bed.links.any_beyond());
        bed.context.effective.delay = ms(6.0);
        let context = bed.context.clone();
        assert_eq!(bed.links.learn(seconds(20.0), &context), News::Configured);
        assert_eq!(bed.links.figures(&link()).configured, ms(11.0));
    }

    #[test]
    fn a_link_that_is_left_again_is_held_twice_as_long() {
        let (mut memory, hold) = (Memory::default(), Duration::from_secs(60));
        let slow = Beyond { delay: ms(24.0), ..Beyond::default() };
        let held = |memory: &Memory, at: f64| memory.with(seconds(at), &link(), Beyond::default()) == slow;
        memory.leave(seconds(100.0), &link(), slow, hold);
        memory.leave(seconds(101.0), &link(), slow, hold);
        assert!(held(&memory, 160.0) && !held(&memory, 162.0), "it was on its way");
        memory.leave(seconds(170.0), &link(), slow, hold);
        assert!(held(&memory, 289.0) && !held(&memory, 291.0));
        // It stayed for long.
        memory.leave(seconds(1000.0), &link(), slow, hold);
        assert!(held(&memory, 1059.0) && !held(&memory, 1061.0));
    }

    proptest! {
        #[test]
        fn a_link_is_never_left_for_longer_than_the_longest_hold(times in prop::collection::vec(0u32..5000, 1..50)) {
            let mut times = times;
            times.sort_unstable();
            let mut memory = Memory::default();
            for time in times {
                let now = seconds(f64::from(time));
                memory.leave(now, &link(), Beyond::default(), Duration::from_secs(60));
                prop_assert!(!memory.is_held(now + LONGEST_HOLD));
            }
        }
    }
}
