//! The duration of scans and the number of their visits of other channels, by how late they make service times.
//!
//! A frame that comes at a random time of a visit of duration G waits uniformly up to G. Above a height u, the lateness of samples
//! is therefore uniform between u and G, with the mean (u + G)/2. If G itself is uniform within ± v of its mean s, longer scans
//! meet more samples, and the mean is (s²·(1 + v²/3) - u²) / (2·(s - u)). The duration follows from the measured mean.
//!
//! Samples that are Δ apart make (G - u)/Δ spikes in each visit, on average. So the spikes of a scan give the number of its
//! visits. The visits of one scan are a train: they are near to each other, and scans are not.
//!
//! The same estimate of the simulated walk, whose scans are known, corrects what this leaves out (indirect inference:
//! Gouriéroux, Monfort and Renault, Journal of Applied Econometrics 8, 1993).

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
/// Time on its channel between two visits, of scans that the testbed file does not divide: that of Linux (`net/mac80211/scan.c`).
const BACK: Duration = Duration::from_millis(200);

/// A sample beside the usual ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Late {
    pub at_s: f64,
    /// Time above the region's median, ms.
    pub late_ms: f64,
}

/// The spikes of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// Usual time from one sample to the next, seconds.
    apart_s: f64,
    trains: Vec<Train>,
}

impl Spikes {
    /// Finds the scans of a walk.
    pub fn of(mut samples: Vec<Late>, spike_ms: f64) -> Self {
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
        Self { samples, spike_ms, apart_s, trains }
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

    /// Returns the mean height of the spikes of scans, ms, and the number of visits of one of so many scans.
    fn shape(&self, trains: impl Iterator<Item = Train>, scans: f64) -> Shape {
        let (spikes, late_ms) =
            trains.fold((0.0, 0.0), |(n, sum), train| (n + train.spikes, sum + train.late_ms));
        let mean_ms = late_ms / spikes;
        let visible_s = 2.0 * (mean_ms - self.spike_ms) / 1e3;
        Shape { mean_ms, visits: spikes * self.apart_s / (scans * visible_s) }
    }
}

/// What spikes show of a scan.
#[derive(Debug, Clone, Copy)]
struct Shape {
    mean_ms: f64,
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
    let simulated_scans = beside.len() as f64;
    // Rare samples miss many visits. They show how many there are in all, but not of how many scans.
    let scans = if measured.apart_s > RARE_S {
        (simulated_scans * measured.time_s() / simulated.time_s()).max(1.0)
    } else {
        found.len() as f64
    };
    let present = times.visits.map_or(times.scan, |visits| visits.dwell);
    let present_visits = times.scan.as_secs_f64() / present.as_secs_f64();
    let visits = |found: Shape, beside: Shape| present_visits * found.visits / beside.visits;
    let all = [
        measured.shape(found.iter().copied(), scans),
        simulated.shape(beside.iter().copied(), simulated_scans),
    ];
    let number = visits(all[0], all[1]);
    let is_divided = times.visits.is_some() || number.round() > 1.0;
    // The variation is that of a whole scan.
    let [found_varies, beside_varies] =
        [is_divided, times.visits.is_some()].map(|divided| if divided { 0.0 } else { times.variation });
    let duration = |found: Shape, beside: Shape| {
        present.as_secs_f64() * 1e3 * duration_ms(found.mean_ms, spike_ms, found_varies)
            / duration_ms(beside.mean_ms, spike_ms, beside_varies)
    };
    let (mut durations, mut numbers) = (Vec::with_capacity(RESAMPLES), Vec::with_capacity(RESAMPLES));
    for _ in 0..RESAMPLES {
        let [found, beside] = [(measured, scans), (simulated, simulated_scans)].map(|(walk, scans)| {
            let trains = &walk.trains;
            walk.shape((0..trains.len()).map(|_| trains[draws.below(trains.len())]), scans)
        });
        durations.push(duration(found, beside));
        numbers.push(visits(found, beside));
    }
    Ok(ScanFit {
        scans: found.len(),
        scan_ms: Estimate::around(duration(all[0], all[1]), &mut durations),
        visits: is_divided.then(|| Estimate::around(number, &mut numbers)),
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

/// Returns the mean duration of scans that vary uniformly by up to a share, if samples that are later than `spike_ms` are
/// `mean_ms` late on average.
fn duration_ms(mean_ms: f64, spike_ms: f64, variation: f64) -> f64 {
    let a = 1.0 + variation * variation / 3.0;
    let inside = mean_ms * mean_ms - a * spike_ms * (2.0 * mean_ms - spike_ms);
    (mean_ms + inside.max(0.0).sqrt()) / a
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

    #[test]
    fn the_mean_lateness_gives_the_duration_back() {
        for (duration, variation) in [(110.0, 0.0), (110.0, 0.25), (250.0, 0.5)] {
            let spike = 40.0;
            let squares = duration * duration * (1.0 + variation * variation / 3.0);
            let mean = (squares - spike * spike) / (2.0 * (duration - spike));
            let found = duration_ms(mean, spike, variation);
            assert!((found - duration).abs() < 1e-9, "{found} {duration}");
        }
    }

    #[test]
    fn spikes_near_each_other_are_of_one_scan() {
        let late = |i: u32| match i {
            100..=102 | 300 | 700 => 60.0,
            _ => f64::from(i % 5),
        };
        let samples = (0..1000).map(|i| Late { at_s: f64::from(i) / 20.0, late_ms: late(i) });
        let walk = Spikes::of(samples.collect(), 40.0);
        let trains: Vec<_> = walk.trains.iter().map(|train| (train.spikes, train.late_ms)).collect();
        assert_eq!(trains, [(3.0, 180.0), (1.0, 60.0), (1.0, 60.0)]);
        let in_scans = [4.4, 4.6, 5.5, 5.7, 15.0, 20.0].map(|at_s| walk.is_in_scan(at_s));
        assert_eq!(in_scans, [false, true, true, false, true, false]);
        let share = share(&walk, &mut Draws::new(1, "share"));
        assert!(share.low < 0.005 && share.value == 0.005 && share.high > 0.005, "{share:?}");
    }
}
