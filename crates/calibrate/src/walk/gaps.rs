//! The duration of scans and the number of their visits of other channels, by how late they make service times.
//!
//! A request that comes at a random time of a visit of duration G waits uniformly up to G. Above a height u, its lateness is
//! therefore uniform between u and G. An answer waits, too: that of a request which left up to r before the visit, the time from
//! the air to the server and back, waits uniformly between G - r and G. So samples that are Δ apart make (G - u + r)/Δ spikes in
//! each visit, on average, and their mean height is ((G² - u²)/2 + G·r - r²/2) / (G - u + r). If G itself is uniform within ± v
//! of its mean, longer scans meet more samples, and G² is larger by the factor 1 + v²/3. Regions differ by r, so that both sums are
//! taken over all of them.
//!
//! The duration follows from the measured mean height, and the number of visits from the number of spikes of a scan. The visits of
//! one scan are a train: they are near to each other, and scans are not.
//!
//! For the duration, the same estimate of the simulated walk, whose scans are known, corrects what this leaves out (indirect
//! inference: Gouriéroux, Monfort and Renault, Journal of Applied Econometrics 8, 1993). The number of visits does without: a
//! simulated walk has few spikes, and would add more chance than it corrects.

use std::time::Duration;

use cotorra_graph::{GapPolicy, HandoverTimes, ScanVisits, WirelessNetwork};
use cotorra_numbers::{Draws, Resampler};

use super::{ScanFit, median};
use crate::{estimate::Estimate, matched::RESAMPLES};

/// Spikes that are nearer to each other are of one scan, seconds. Some visits make no spike.
const ONE_SCAN_S: f64 = 2.0;
/// The same in samples, if these are rare.
const ONE_SCAN_SAMPLES: f64 = 4.0;
/// Samples that are further apart do not show which spikes are of one scan, seconds.
const RARE_S: f64 = 0.5;
/// Fewest scans of a fit.
const LEAST_SCANS: usize = 5;
/// A train with less than this share of the spikes of a typical one is of no scan: what is late for another reason comes alone.
const OF_A_SCAN: f64 = 0.25;
/// A resample has so many scans less: percentiles of resamples of as few values as a walk has scans are too near to each other, by
/// the factor √(1 - 1/n), and by the normal distribution in place of Student's.
const FEWER: usize = 2;
/// Steps by which the duration is found between its least and its largest value.
const HALVINGS: usize = 50;
/// Time on its channel between two visits, of scans that the testbed file does not divide: that of Linux (`net/mac80211/scan.c`).
const BACK: Duration = Duration::from_millis(200);

/// A sample beside the usual ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Late {
    pub at_s: f64,
    /// Time above the region's median, ms.
    pub late_ms: f64,
}

/// The answers of some samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Answers {
    /// Number of the samples.
    pub samples: f64,
    /// Time from the air to the server and back, in which a scan may begin, ms.
    pub after_ms: f64,
}

/// The spikes of a scan.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Train {
    spikes: f64,
    /// Sum of their heights, ms.
    late_ms: f64,
    from_s: f64,
    until_s: f64,
}

/// The samples of a walk, and its scans.
#[derive(Debug)]
pub(super) struct Spikes {
    /// By time.
    samples: Vec<Late>,
    /// Height above which samples are spikes.
    spike_ms: f64,
    answers: Vec<Answers>,
    /// Usual time from one sample to the next, seconds.
    apart_s: f64,
    trains: Vec<Train>,
}

impl Spikes {
    /// Finds the scans of a walk.
    pub fn of(mut samples: Vec<Late>, spike_ms: f64, answers: Vec<Answers>) -> Self {
        samples.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let apart_s = median(samples.windows(2).map(|pair| pair[1].at_s - pair[0].at_s).collect());
        let spikes: Vec<_> = samples.iter().filter(|sample| sample.late_ms > spike_ms).collect();
        let one_scan_s = one_scan_s(apart_s);
        let trains = spikes.chunk_by(|a, b| b.at_s - a.at_s < one_scan_s);
        let train = |train: &[&Late]| Train {
            spikes: train.len() as f64,
            late_ms: train.iter().map(|spike| spike.late_ms).sum(),
            from_s: train[0].at_s,
            until_s: train[train.len() - 1].at_s,
        };
        let trains = trains.map(train).collect();
        Self { samples, spike_ms, answers, apart_s, trains }
    }

    /// Whether a sample may be of a scan: late, but less than a spike.
    pub fn is_in_scan(&self, at_s: f64) -> bool {
        let around_s = one_scan_s(self.apart_s) / 4.0;
        let next = self.trains.partition_point(|train| train.until_s + around_s < at_s);
        self.trains.get(next).is_some_and(|train| train.from_s - around_s <= at_s)
    }

    fn is_spike(&self, sample: &Late) -> bool {
        sample.late_ms > self.spike_ms
    }

    fn share(&self) -> f64 {
        let spikes = self.samples.iter().filter(|sample| self.is_spike(sample)).count();
        spikes as f64 / self.samples.len() as f64
    }

    /// Returns the time that the samples stand for, seconds.
    fn time_s(&self) -> f64 {
        self.samples.len() as f64 * self.apart_s
    }

    /// Returns the trains that are of scans, by the size at which half of all spikes are in larger ones.
    fn scans(&self) -> Vec<Train> {
        let mut sizes: Vec<_> = self.trains.iter().map(|train| train.spikes).collect();
        sizes.sort_by(|a, b| b.total_cmp(a));
        let half = sizes.iter().sum::<f64>() / 2.0;
        let mut typical = sizes.iter().scan(0.0, |sum, size| {
            *sum += size;
            Some((*sum, *size))
        });
        let typical = typical.find(|(sum, _)| *sum >= half).map_or(0.0, |(_, size)| size);
        self.trains.iter().filter(|train| train.spikes >= OF_A_SCAN * typical).copied().collect()
    }

    /// Returns what the spikes of some scans show, each of whose visits varies by a share.
    fn shape(&self, trains: impl Iterator<Item = Train>, variation: f64) -> Shape {
        let (spikes, late_ms) =
            trains.fold((0.0, 0.0), |(n, sum), train| (n + train.spikes, sum + train.late_ms));
        let mean_ms = late_ms / spikes;
        let duration_ms = self.duration_ms(mean_ms, variation);
        let (visible_ms, _) = self.of_visit(duration_ms, variation);
        Shape { duration_ms, visits: spikes * self.apart_s * 1e3 / visible_ms }
    }

    /// Returns the mean duration of visits that vary uniformly by up to a share, if their spikes are `mean_ms` high on average.
    fn duration_ms(&self, mean_ms: f64, variation: f64) -> f64 {
        // If all spikes were uniform between both, it would be the highest.
        let (mut low, mut high) = (self.spike_ms, 2.0 * mean_ms - self.spike_ms);
        for _ in 0..HALVINGS {
            let middle = f64::midpoint(low, high);
            let (visible_ms, sum) = self.of_visit(middle, variation);
            if sum < mean_ms * visible_ms { low = middle } else { high = middle }
        }
        high
    }

    /// Returns the time in which the request of a spike leaves, ms, of a visit of a mean duration that varies uniformly by up to a
    /// share, and the integral of the spike's height over this time, ms².
    fn of_visit(&self, duration_ms: f64, variation: f64) -> (f64, f64) {
        let (g, u) = (duration_ms, self.spike_ms);
        let squares = g * g * (1.0 + variation * variation / 3.0);
        let all: f64 = self.answers.iter().map(|of| of.samples).sum();
        self.answers.iter().fold((0.0, 0.0), |(visible, sum), of| {
            // An answer that waits less is no spike.
            let r = of.after_ms.min(g - u);
            let share = of.samples / all;
            let integral = (squares - u * u) / 2.0 + g * r - r * r / 2.0;
            (visible + share * (g - u + r), sum + share * integral)
        })
    }
}

/// What spikes of scans show.
#[derive(Debug, Clone, Copy)]
struct Shape {
    /// Mean duration of a visit, ms.
    duration_ms: f64,
    /// Number of visits, of all scans.
    visits: f64,
}

fn one_scan_s(apart_s: f64) -> f64 {
    ONE_SCAN_S.max(ONE_SCAN_SAMPLES * apart_s)
}

/// Returns the longest time that a change of radio unit takes, without a scan, ms.
pub(super) fn longest_change_ms(network: &WirelessNetwork) -> f64 {
    let times = &network.handover;
    let mut phases = times.authenticate + times.reassociate;
    if !network.fast_transition {
        phases += times.handshake;
    }
    phases.as_secs_f64() * 1e3 * (1.0 + times.variation)
}

/// Fits the duration of scans, or of their visits, and the number of these.
///
/// # Errors
/// The reason why the walk does not determine it.
pub(super) fn fit(
    network: &WirelessNetwork,
    measured: &Spikes,
    simulated: &Spikes,
    draws: &mut Draws,
) -> Result<ScanFit, String> {
    let (times, spike_ms) = (&network.handover, measured.spike_ms);
    if times.visits.is_some_and(|visits| visits.passive.is_some()) {
        return Err("`handover.scan` has visits of two durations, which spikes do not tell apart".to_owned());
    }
    if network.gap == GapPolicy::Drop {
        return Err("`gap: drop` loses what comes during a scan, so that nothing is late".to_owned());
    }
    let (found, beside) = (&measured.trains, &simulated.trains);
    for (trains, walk) in [(found, "measured"), (beside, "simulated")] {
        if trains.len() < LEAST_SCANS {
            return Err(format!(
                "a fit needs {LEAST_SCANS} scans with samples that are more than {spike_ms:.1} ms late, and the {walk} walk has {}",
                trains.len()
            ));
        }
    }
    let rare = measured.apart_s > RARE_S;
    // Rare samples miss many visits, and some scans. They show how many visits there are in all, but not of how many scans.
    let mut trains = if rare { found.clone() } else { measured.scans() };
    let scans = if rare {
        (beside.len() as f64 * measured.time_s() / simulated.time_s()).max(1.0)
    } else {
        trains.len() as f64
    };
    trains.resize(trains.len().max(scans.round() as usize), Train::default());
    let present = times.visits.map_or(times.scan, |visits| visits.dwell);
    let number = |shape: Shape, scans: f64| shape.visits / scans;
    let undivided = measured.shape(trains.iter().copied(), times.variation);
    let is_divided = times.visits.is_some() || number(undivided, scans).round() > 1.0;
    // The variation is that of a whole scan.
    let [found_varies, beside_varies] =
        [is_divided, times.visits.is_some()].map(|divided| if divided { 0.0 } else { times.variation });
    let duration =
        |found: Shape, beside: Shape| present.as_secs_f64() * 1e3 * found.duration_ms / beside.duration_ms;
    let all = [
        measured.shape(trains.iter().copied(), found_varies),
        simulated.shape(beside.iter().copied(), beside_varies),
    ];
    let (mut durations, mut numbers) = (Vec::with_capacity(RESAMPLES), Vec::with_capacity(RESAMPLES));
    for _ in 0..RESAMPLES {
        let resampled = |of: &[Train], draws: &mut Draws| -> Vec<Train> {
            (FEWER..of.len()).map(|_| of[draws.below(of.len())]).collect()
        };
        let of_found = resampled(&trains, draws);
        let of_beside = resampled(beside, draws);
        // Walks of the same length differ by a scan at their ends.
        let more = if rare { draws.unit() - 0.5 } else { 0.0 };
        if of_found.iter().all(|train| train.spikes == 0.0) {
            continue;
        }
        let part = of_found.len() as f64 / trains.len() as f64;
        let found = measured.shape(of_found.into_iter(), found_varies);
        durations.push(duration(found, simulated.shape(of_beside.into_iter(), beside_varies)));
        numbers.push(number(found, (scans + more) * part));
    }
    Ok(ScanFit {
        scans: trains.iter().filter(|train| train.spikes > 0.0).count(),
        scan_ms: Estimate::around(duration(all[0], all[1]), &mut durations),
        visits: is_divided.then(|| Estimate::around(number(all[0], scans), &mut numbers)),
        share: share(measured, draws),
        simulated_share: simulated.share(),
    })
}

/// Returns the scans of a fit as a testbed file has them.
pub(super) fn setting(fit: &ScanFit, times: &HandoverTimes) -> String {
    let ms = fit.scan_ms.value;
    let Some(visits) = fit.visits else { return format!("{ms:.2} ms") };
    // By default, spikes are of one visit: the robot is back after each.
    let (away_ms, back) = times.visits.map_or((ms, BACK), |ScanVisits { dwell, away, back, .. }| {
        (ms * away.as_secs_f64() / dwell.as_secs_f64(), back)
    });
    let channels = visits.value.round().clamp(1.0, f64::from(u8::MAX));
    let back_ms = back.as_secs_f64() * 1e3;
    format!("{{ channels: {channels}, dwell: {ms:.2} ms, away: {away_ms:.2} ms, back: {back_ms:.2} ms }}")
}

/// Returns the share of samples in spikes.
fn share(walk: &Spikes, draws: &mut Draws) -> Estimate {
    let series: Vec<_> = walk.samples.iter().map(|late| f64::from(u8::from(walk.is_spike(late)))).collect();
    let resampler = Resampler::new(&series);
    let resample = |_| {
        let mut spikes = 0.0;
        resampler.resample(draws, |i| spikes += series[i]);
        spikes / series.len() as f64
    };
    Estimate::around(walk.share(), &mut (0..RESAMPLES).map(resample).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_once() -> Vec<Answers> {
        vec![Answers { samples: 1.0, after_ms: 0.0 }]
    }

    /// Counts samples each 0.01 ms, from before a visit until its end.
    #[test]
    fn the_height_and_the_number_of_spikes_give_the_visit_back() {
        for (duration, after) in [(110, 0.0), (110, 25.0), (60, 15.0), (60, 30.0)] {
            let spike = 40.0;
            let samples = (-5_000..duration * 100).map(|i| f64::from(i) / 100.0);
            let duration = f64::from(duration);
            let held = |at_ms: f64| if (0.0..duration).contains(&at_ms) { duration - at_ms } else { 0.0 };
            let heights = samples.map(|at_ms| if at_ms >= 0.0 { held(at_ms) } else { held(at_ms + after) });
            let heights: Vec<_> = heights.filter(|height| *height > spike).collect();
            let mean = heights.iter().sum::<f64>() / heights.len() as f64;
            let answers = vec![Answers { samples: 7.0, after_ms: after }];
            let walk = Spikes::of(Vec::new(), spike, answers);
            let found = walk.duration_ms(mean, 0.0);
            assert!((found - duration).abs() < 0.05, "{found} {duration} {after}");
            let (visible, _) = walk.of_visit(found, 0.0);
            assert!((visible - heights.len() as f64 / 100.0).abs() < 0.1, "{visible} {duration} {after}");
        }
    }

    #[test]
    fn scans_that_vary_have_the_same_mean() {
        let walk = Spikes::of(Vec::new(), 40.0, at_once());
        for (duration, variation) in [(110.0, 0.25), (250.0, 0.5)] {
            let squares = duration * duration * (1.0 + variation * variation / 3.0);
            let mean = (squares - 1600.0) / (2.0 * (duration - 40.0));
            let found = walk.duration_ms(mean, variation);
            assert!((found - duration).abs() < 1e-6, "{found} {duration}");
        }
    }

    #[test]
    fn late_samples_alone_are_of_no_scan_beside_trains() {
        let late = |i: u32| if i % 400 < 30 || i % 400 == 200 { 60.0 } else { 0.0 };
        let samples = (0..4000).map(|i| Late { at_s: f64::from(i) / 20.0, late_ms: late(i) });
        let walk = Spikes::of(samples.collect(), 40.0, at_once());
        assert_eq!((walk.trains.len(), walk.scans().len()), (20, 10));
        let alone = (0..4000).map(|i| Late { at_s: f64::from(i) / 20.0, late_ms: late(i + 30) });
        let alone: Vec<_> = alone.filter(|late| late.at_s < 18.0).collect();
        let walk = Spikes::of(alone, 40.0, at_once());
        assert_eq!(walk.trains, walk.scans());
    }

    #[test]
    fn spikes_near_each_other_are_of_one_scan() {
        let late = |i: u32| match i {
            100..=102 | 300 | 700 => 60.0,
            _ => f64::from(i % 5),
        };
        let samples = (0..1000).map(|i| Late { at_s: f64::from(i) / 20.0, late_ms: late(i) });
        let walk = Spikes::of(samples.collect(), 40.0, at_once());
        let trains: Vec<_> = walk.trains.iter().map(|train| (train.spikes, train.late_ms)).collect();
        assert_eq!(trains, [(3.0, 180.0), (1.0, 60.0), (1.0, 60.0)]);
        let in_scans = [4.4, 4.6, 5.5, 5.7, 15.0, 20.0].map(|at_s| walk.is_in_scan(at_s));
        assert_eq!(in_scans, [false, true, true, false, true, false]);
        let share = share(&walk, &mut Draws::new(1, "share"));
        assert!(share.low < 0.005 && share.value == 0.005 && share.high > 0.005, "{share:?}");
    }
}
