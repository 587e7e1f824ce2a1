//! d and λ of one direction of a link for decisions: as configured, as measured, and what is left, each with its age and
//! source.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{context::LinkContext, units::millis};

/// Source of a figure of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FigureSource {
    /// The effective conditions.
    Configured,
    /// Probes of this link.
    Probed,
    /// Packets that crossed this link.
    Carried,
    /// Other figures.
    Estimated,
}

/// A delay of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DelayFigure {
    /// The delay.
    #[serde(rename = "delay_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub delay: Duration,
    /// Longest time since the newest measurement in it, up to the time of the context; 0 for configured figures.
    #[serde(rename = "age_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub age: Duration,
    /// Its source.
    pub source: FigureSource,
}

impl DelayFigure {
    /// Returns a configured delay, which is valid now.
    pub const fn configured(delay: Duration) -> Self {
        Self { delay, age: Duration::ZERO, source: FigureSource::Configured }
    }
}

/// A throughput of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ThroughputFigure {
    /// The throughput, bit/s.
    pub throughput_bps: f64,
    /// Longest time since the newest measurement in it, up to the time of the context; 0 for configured figures.
    #[serde(rename = "age_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub age: Duration,
    /// Its source.
    pub source: FigureSource,
}

/// Delays of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DelayFigures {
    /// Configured delay, scaled.
    pub configured: DelayFigure,
    /// By probes that are [fresh](LinkContext::FRESH), else by packets; `None` without both.
    pub measured: Option<DelayFigure>,
}

impl DelayFigures {
    /// Returns the delay to count with: the measured one, and at least the configured one.
    pub fn expected(&self) -> DelayFigure {
        self.measured.filter(|measured| measured.delay > self.configured.delay).unwrap_or(self.configured)
    }
}

/// Throughputs of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ThroughputFigures {
    /// Configured rate, scaled; a trace's mean. `None` without a limit.
    pub configured: Option<ThroughputFigure>,
    /// What crossed over the last second.
    pub measured: ThroughputFigure,
    /// What is left, by [`available_bps`] over the last second. `None` without a limit.
    pub available: Option<ThroughputFigure>,
}

/// d and λ of one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LinkFigures {
    /// d.
    pub delay: DelayFigures,
    /// λ.
    pub throughput: ThroughputFigures,
}

/// Returns what is left of a capacity beside a mean load, bit/s: A = C (1 - u) with the mean utilization u, the available
/// bandwidth of a hop (Prasad, Murray, Dovrolis and claffy, "Bandwidth estimation: metrics, measurement techniques, and tools",
/// IEEE Network 17(6), 2003).
///
/// A rate that is reserved but idle counts as left, because a wire lends it to others. A further reservation cannot count on it:
/// give the larger of the metered load and the reserved rates as the load.
pub fn available_bps(capacity_bps: f64, load_bps: f64) -> f64 {
    (capacity_bps - load_bps).max(0.0)
}

impl LinkContext {
    /// Age up to which probes of a link count before its packets.
    pub const FRESH: Duration = Duration::from_secs(10);
    /// Time over which packets are measured.
    pub const METERED: Duration = Duration::from_secs(1);

    /// Returns the delay by probes that are not older than `fresh`, else by packets; `None` without both.
    ///
    /// Probes come at regular times, and wait as a small packet of any service does. Packets of a burst wait for each other.
    pub fn measured_delay(&self, fresh: Duration) -> Option<DelayFigure> {
        let probed = self.probed.and_then(|probed| {
            let (delay, age) = (probed.delay?, probed.delay_age?);
            (age <= fresh).then_some(DelayFigure { delay, age, source: FigureSource::Probed })
        });
        let carried = |delay| DelayFigure { delay, age: Self::METERED, source: FigureSource::Carried };
        probed.or(self.delay.map(carried))
    }

    /// Returns configured, measured and available figures.
    pub fn figures(&self) -> LinkFigures {
        let figure =
            |source| move |throughput_bps| ThroughputFigure { throughput_bps, age: Duration::ZERO, source };
        let capacity = self.effective.rate.mean_bits_per_second();
        let capacity = capacity.is_finite().then_some(capacity);
        LinkFigures {
            delay: DelayFigures {
                configured: DelayFigure::configured(self.effective.delay),
                measured: self.measured_delay(Self::FRESH),
            },
            throughput: ThroughputFigures {
                configured: capacity.map(figure(FigureSource::Configured)),
                // Counted up to the time of the context.
                measured: figure(FigureSource::Carried)(self.throughput_bps),
                available: capacity
                    .map(|capacity| available_bps(capacity, self.throughput_bps))
                    .map(figure(FigureSource::Estimated)),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{BitRate, Conditions, Direction, Probed, Rate};

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// A link of 5 ms and 10 Mbit/s that carried nothing.
    fn context() -> LinkContext {
        let rate = Rate::Fixed { bits_per_second: BitRate::from_mbps(10.0).unwrap() };
        LinkContext {
            link: "lan-cloud".parse().unwrap(),
            direction: Direction::Forward,
            delay: None,
            throughput_bps: 0.0,
            queued_packets: None,
            probed: None,
            tested: None,
            asked: Conditions::default(),
            scale: Default::default(),
            effective: Conditions { delay: ms(5), rate, ..Conditions::default() },
            counters: Default::default(),
        }
    }

    fn probed(delay: u64, age: u64) -> Option<Probed> {
        let (delay, age) = (Some(ms(delay)), ms(age));
        Some(Probed { delay, jitter: None, delay_age: Some(age), loss: None, loss_age: age })
    }

    #[test]
    fn probes_count_before_packets_while_they_are_fresh() {
        let of = |delay, probed| LinkContext { delay, probed, ..context() }.figures().delay;
        assert_eq!(of(None, None).measured, None);
        assert_eq!(of(None, None).expected(), DelayFigure::configured(ms(5)));
        let by_probes = of(Some(ms(40)), probed(29, 10_000)).measured.unwrap();
        assert_eq!(by_probes, DelayFigure { delay: ms(29), age: ms(10_000), source: FigureSource::Probed });
        let by_packets = of(Some(ms(40)), probed(29, 10_001)).measured.unwrap();
        assert_eq!(
            by_packets,
            DelayFigure { delay: ms(40), age: LinkContext::METERED, source: FigureSource::Carried }
        );
        assert_eq!(of(None, probed(29, 10_001)).measured, None);
    }

    #[test]
    fn the_configured_delay_is_the_least_to_count_with() {
        let expected =
            |delay| LinkContext { probed: probed(delay, 0), ..context() }.figures().delay.expected();
        assert_eq!((expected(4).delay, expected(4).source), (ms(5), FigureSource::Configured));
        assert_eq!((expected(6).delay, expected(6).source), (ms(6), FigureSource::Probed));
    }

    #[test]
    fn a_link_without_a_limit_has_no_available_throughput() {
        let effective = Conditions { rate: Rate::Unlimited, ..context().effective };
        let figures = LinkContext { throughput_bps: 3e6, effective, ..context() }.figures().throughput;
        assert_eq!((figures.configured, figures.available), (None, None));
        assert_eq!(figures.measured.throughput_bps, 3e6);
    }

    #[test]
    fn figures_are_in_json_with_age_and_source() {
        let json = serde_json::to_value(LinkContext { throughput_bps: 4e6, ..context() }.figures()).unwrap();
        assert_eq!(json["delay"]["configured"]["delay_ms"], 5.0);
        assert_eq!(json["delay"]["measured"], serde_json::Value::Null);
        let available = &json["throughput"]["available"];
        assert_eq!(
            available,
            &serde_json::json!({ "throughput_bps": 6e6, "age_ms": 0.0, "source": "estimated" })
        );
    }

    proptest! {
        #[test]
        fn what_is_left_and_the_load_make_up_the_capacity(load_bps in 0.0f64..2e7) {
            let figures = LinkContext { throughput_bps: load_bps, ..context() }.figures().throughput;
            let left = figures.available.unwrap().throughput_bps;
            prop_assert!((0.0..=1e7).contains(&left));
            prop_assert!(load_bps > 1e7 || (left + load_bps - 1e7).abs() < 1e-3);
        }
    }
}
