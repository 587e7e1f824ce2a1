//! Intervals of differences between two runs with the same seed. Both are cut into the same slots of time, and the same blocks of
//! slots are drawn from both: what happens at the same time in both runs stays together, and so does what lasts.

use std::time::Duration;

use cotorra_numbers::{Draws, Interval, RESAMPLES, Resampler, block_length, percentile_interval};

use super::{Apart, FiguresApart, ServiceFigures, Took};

/// Length of a slot.
const SLOT: Duration = Duration::from_secs(1);
/// Fewest slots that an interval is told from.
const FEWEST: usize = 10;
/// Shares of the two quantiles.
const QUANTILES: [f64; 2] = [0.5, 0.99];

/// Two runs, slot by slot.
pub(super) struct Paired {
    runs: [Slotted; 2],
    slots: usize,
}

/// The samples of a run by slot.
#[derive(Default)]
struct Slotted {
    /// Service times of answered samples, rising, each with its slot.
    answered: Vec<(f64, usize)>,
    /// Numbers of samples by slot: all, and those above the target.
    counts: Vec<[u64; 2]>,
}

/// The three figures: the share above the target, and the quantiles.
type Figures = [Option<f64>; 3];

impl Slotted {
    fn new(samples: &[Took], target_ms: f64, slots: usize) -> Self {
        let mut all = Self { answered: Vec::with_capacity(samples.len()), counts: vec![[0; 2]; slots] };
        for took in samples {
            let slot = slot(took);
            all.answered.extend(took.ms.map(|ms| (ms, slot)));
            let [samples, above] = &mut all.counts[slot];
            *samples += 1;
            *above += u64::from(took.is_above(target_ms));
        }
        all.answered.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all
    }

    /// Returns the figures if each slot counts so many times.
    fn figures(&self, times: &[u64]) -> Figures {
        let sum =
            |of: usize| self.counts.iter().zip(times).map(|(counts, times)| counts[of] * times).sum::<u64>();
        let samples = sum(0);
        let above = (samples > 0).then(|| sum(1) as f64 / samples as f64);
        let [p50, p99] = self.quantiles(times);
        [above, p50, p99]
    }

    /// Returns the quantiles, as [`cotorra_numbers::quantile`] defines them, if each slot counts so many times.
    fn quantiles(&self, times: &[u64]) -> [Option<f64>; 2] {
        let of = self.answered.iter().map(|(_, slot)| times[*slot]).sum::<u64>();
        let Some(last) = of.checked_sub(1) else { return [None; 2] };
        let mut values = self.answered.iter().map(|(ms, slot)| (*ms, times[*slot]));
        let (mut before, mut value) = (0, 0.0);
        let mut at = |rank: u64| {
            while before <= rank {
                let Some((next, count)) = values.next() else { break };
                before += count;
                if count > 0 {
                    value = next;
                }
            }
            value
        };
        QUANTILES.map(|share| {
            let rank = share * last as f64;
            let (low, high) = (at(rank.floor() as u64), at(rank.ceil() as u64));
            Some(low + (high - low) * rank.fract())
        })
    }

    /// Returns the mean of the answered samples of each slot, ms.
    fn means(&self) -> Vec<Option<f64>> {
        let mut sums = vec![(0.0, 0_u64); self.counts.len()];
        for (ms, slot) in &self.answered {
            sums[*slot].0 += ms;
            sums[*slot].1 += 1;
        }
        sums.into_iter().map(|(sum, count)| (count > 0).then(|| sum / count as f64)).collect()
    }
}

fn slot(took: &Took) -> usize {
    (u128::from(took.emitted.as_nanos()) / SLOT.as_nanos()) as usize
}

impl Paired {
    pub(super) fn new(samples: [&[Took]; 2], target_ms: f64) -> Self {
        let slots = samples.iter().flat_map(|its| its.iter()).map(|took| slot(took) + 1).max().unwrap_or(0);
        Self { runs: samples.map(|its| Slotted::new(its, target_ms, slots)), slots }
    }

    /// Returns the differences of these figures, with their intervals.
    pub(super) fn apart(&self, [with, without]: [ServiceFigures; 2]) -> FiguresApart {
        let of = |figures: ServiceFigures| {
            [figures.above_target, figures.service_time_p50_ms, figures.service_time_p99_ms]
        };
        let intervals = self.intervals();
        let mut apart =
            of(with).into_iter().zip(of(without)).zip(intervals).map(|((with, without), interval)| {
                let (low, high) = (interval.map(|its| its.low), interval.map(|its| its.high));
                Some(Apart { difference: with? - without?, low, high })
            });
        let mut next = || apart.next().flatten();
        FiguresApart { above_target: next(), service_time_p50_ms: next(), service_time_p99_ms: next() }
    }

    fn intervals(&self) -> [Option<Interval>; 3] {
        if self.slots < FEWEST {
            return [None; 3];
        }
        let resampler = Resampler::of_length(self.slots, self.block_length());
        let mut draws = Draws::new(0, "regret of old context");
        let mut found = [const { Vec::new() }; 3];
        let mut times = vec![0; self.slots];
        for _ in 0..RESAMPLES {
            times.fill(0);
            resampler.resample(&mut draws, |slot| times[slot] += 1);
            let [with, without] = self.runs.each_ref().map(|run| run.figures(&times));
            for ((found, with), without) in found.iter_mut().zip(with).zip(without) {
                found.extend(with.zip(without).map(|(with, without)| with - without));
            }
        }
        found.map(percentile_interval)
    }

    /// Returns the mean length of blocks: the longer of those for the means and for the shares above the target.
    fn block_length(&self) -> f64 {
        let [with, without] = &self.runs;
        let apart =
            |(with, without): (Option<f64>, Option<f64>)| with.zip(without).map_or(0.0, |(a, b)| a - b);
        let shares = |run: &Slotted| -> Vec<Option<f64>> {
            let share = |[of, above]: &[u64; 2]| (*of > 0).then(|| *above as f64 / *of as f64);
            run.counts.iter().map(share).collect()
        };
        let means: Vec<_> = with.means().into_iter().zip(without.means()).map(apart).collect();
        let shares: Vec<_> = shares(with).into_iter().zip(shares(without)).map(apart).collect();
        block_length(&means).max(block_length(&shares))
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Timestamp;
    use cotorra_numbers::quantile;

    use super::{super::ServiceTimes, *};

    /// Ten samples a second, with a service time from the number of the sample.
    fn run(seconds: u64, ms: impl Fn(u64) -> Option<f64>) -> ServiceTimes {
        let took = |i| Took { emitted: Timestamp::from_nanos(i * 100_000_000), ms: ms(i) };
        ServiceTimes((0..seconds * 10).map(took).collect())
    }

    fn apart(with: &ServiceTimes, without: &ServiceTimes) -> FiguresApart {
        let figures = [with, without].map(|times| times.figures(15.0));
        Paired::new([&with.0, &without.0], 15.0).apart(figures)
    }

    fn noisy(seed: u64, more: f64, seconds: u64) -> ServiceTimes {
        let mut draws = Draws::from_seed(seed);
        let all: Vec<f64> = (0..seconds * 10).map(|_| 10.0 + draws.normal() + more).collect();
        run(seconds, |i| Some(all[i as usize]))
    }

    #[test]
    fn equal_runs_differ_by_nothing() {
        let one = noisy(1, 0.0, 60);
        let zero = Some(Apart { difference: 0.0, low: Some(0.0), high: Some(0.0) });
        let FiguresApart { above_target, service_time_p50_ms, service_time_p99_ms } = apart(&one, &one);
        assert_eq!([above_target, service_time_p50_ms, service_time_p99_ms], [zero; 3]);
    }

    #[test]
    fn a_constant_difference_has_a_narrow_interval_although_the_run_varies() {
        let wave = |more: f64| move |i: u64| Some(10.0 + 4.0 * (i as f64 / 200.0).sin() + more);
        let found = apart(&run(120, wave(2.0)), &run(120, wave(0.0))).service_time_p50_ms.unwrap();
        assert!((found.difference - 2.0).abs() < 1e-9, "{found:?}");
        assert!(
            (found.low.unwrap() - 2.0).abs() < 1e-9 && (found.high.unwrap() - 2.0).abs() < 1e-9,
            "{found:?}"
        );
    }

    #[test]
    fn a_stretch_of_late_samples_has_an_interval_as_wide_as_one_stretch_says() {
        let late = |i: u64| Some(if (300..400).contains(&i) { 40.0 } else { 10.0 });
        let found = apart(&run(100, late), &run(100, |_| Some(10.0))).above_target.unwrap();
        assert!((found.difference - 0.1).abs() < 1e-12, "{found:?}");
        // Single seconds would give ±0.06.
        assert!(found.low.unwrap() < 0.03 && found.high.unwrap() > 0.18, "{found:?}");
    }

    #[test]
    fn missing_answers_are_above_the_target_and_in_no_quantile() {
        let lost = run(20, |i| (i % 4 > 0).then_some(10.0));
        let figures = lost.figures(15.0);
        assert_eq!((figures.samples, figures.above_target), (200, Some(0.25)));
        assert_eq!(figures.service_time_p99_ms, Some(10.0));
        let found = apart(&lost, &run(20, |_| Some(10.0)));
        assert_eq!(found.above_target.unwrap().difference, 0.25);
        let none = apart(&run(20, |_| None), &lost);
        assert_eq!((none.service_time_p50_ms, none.above_target.unwrap().difference), (None, 0.75));
    }

    #[test]
    fn short_runs_have_no_interval() {
        let found = apart(&noisy(1, 1.0, 9), &noisy(1, 0.0, 9)).service_time_p50_ms.unwrap();
        assert!((found.difference - 1.0).abs() < 1e-9 && found.low.is_none(), "{found:?}");
        assert_eq!(apart(&run(0, |_| None), &run(0, |_| None)).above_target, None);
    }

    #[test]
    fn intervals_of_runs_without_a_difference_hold_zero_in_most_cases() {
        let holds = |pair: &u64| {
            let found =
                apart(&noisy(2 * pair, 0.0, 60), &noisy(2 * pair + 1, 0.0, 60)).service_time_p50_ms.unwrap();
            found.low.unwrap() <= 0.0 && 0.0 <= found.high.unwrap()
        };
        let count = (0..40).filter(holds).count();
        assert!((34..=40).contains(&count), "{count}");
    }

    #[test]
    fn slots_that_count_once_have_the_quantiles_of_all_samples() {
        let one = noisy(5, 0.0, 17);
        let slotted = Slotted::new(&one.0, 15.0, 17);
        let mut all: Vec<f64> = one.0.iter().filter_map(|took| took.ms).collect();
        all.sort_by(f64::total_cmp);
        let close = |a: Option<f64>, b: Option<f64>| (a.unwrap() - b.unwrap()).abs() < 1e-9;
        let [p50, p99] = slotted.quantiles(&[1; 17]);
        assert!(close(p50, quantile(&all, 0.5)) && close(p99, quantile(&all, 0.99)), "{p50:?} {p99:?}");
        // Each twice, and slots that do not count.
        let mut times = [2; 17];
        times[3] = 0;
        let mut drawn: Vec<f64> =
            one.0.iter().filter(|took| slot(took) != 3).flat_map(|took| [took.ms.unwrap(); 2]).collect();
        drawn.sort_by(f64::total_cmp);
        let [p50, p99] = slotted.quantiles(&times);
        assert!(close(p50, quantile(&drawn, 0.5)) && close(p99, quantile(&drawn, 0.99)), "{p50:?} {p99:?}");
    }
}
