//! The duration of scans, by how late they make service times.
//!
//! A frame that comes at a random time of a scan of duration G waits uniformly up to G. Above a height u, the lateness of samples
//! is therefore uniform between u and G, with the mean (u + G)/2. If G itself is uniform within ± v of its mean s, longer scans
//! meet more samples, and the mean is (s²·(1 + v²/3) - u²) / (2·(s - u)). The duration follows from the measured mean.
//!
//! The same estimate of the simulated walk, whose scans are known, corrects what this leaves out (indirect inference:
//! Gouriéroux, Monfort and Renault, Journal of Applied Econometrics 8, 1993).

use cotorra_graph::{GapPolicy, WirelessNetwork};
use cotorra_numbers::{Draws, Resampler};

use super::ScanFit;
use crate::{estimate::Estimate, matched::RESAMPLES};

/// Spikes that are nearer to each other are of one scan, seconds.
const ONE_SCAN_S: f64 = 1.0;
/// Fewest scans of a fit.
const LEAST_SCANS: usize = 5;

/// A sample beside the usual ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Late {
    pub at_s: f64,
    /// Time above the region's median, ms.
    pub late_ms: f64,
}

/// The samples of a walk, by time, and the height above which they are spikes.
#[derive(Debug)]
pub(super) struct Spikes {
    pub samples: Vec<Late>,
    pub spike_ms: f64,
}

impl Spikes {
    fn is_spike(&self, sample: &Late) -> bool {
        sample.late_ms > self.spike_ms
    }

    fn share(&self) -> f64 {
        let spikes = self.samples.iter().filter(|sample| self.is_spike(sample)).count();
        spikes as f64 / self.samples.len() as f64
    }

    /// Returns the number of spikes and the sum of their heights, of each scan.
    fn scans(&self) -> Vec<(f64, f64)> {
        let spikes: Vec<_> = self.samples.iter().filter(|sample| self.is_spike(sample)).collect();
        let scans = spikes.chunk_by(|a, b| b.at_s - a.at_s < ONE_SCAN_S);
        scans.map(|scan| (scan.len() as f64, scan.iter().map(|spike| spike.late_ms).sum())).collect()
    }
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

/// Fits the duration of scans.
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
    if times.visits.is_some() {
        return Err("`handover.scan` is divided into visits, which spikes do not tell apart".to_owned());
    }
    if network.gap == GapPolicy::Drop {
        return Err("`gap: drop` loses what comes during a scan, so that nothing is late".to_owned());
    }
    let (found, beside) = (measured.scans(), simulated.scans());
    for (scans, walk) in [(&found, "measured"), (&beside, "simulated")] {
        if scans.len() < LEAST_SCANS {
            return Err(format!(
                "a fit needs {LEAST_SCANS} scans with samples that are more than {spike_ms:.1} ms late, and the {walk} walk has {}",
                scans.len()
            ));
        }
    }
    let duration = |scans: &mut dyn Iterator<Item = (f64, f64)>| {
        let (n, sum) = scans.fold((0.0, 0.0), |(n, sum), (more, late)| (n + more, sum + late));
        duration_ms(sum / n, spike_ms, times.variation)
    };
    let present_ms = times.scan.as_secs_f64() * 1e3;
    let ratio = |found: f64, beside: f64| present_ms * found / beside;
    let value = ratio(duration(&mut found.iter().copied()), duration(&mut beside.iter().copied()));
    let mut drawn = Vec::with_capacity(RESAMPLES);
    for _ in 0..RESAMPLES {
        let [found, beside] = [&found, &beside]
            .map(|scans| duration(&mut (0..scans.len()).map(|_| scans[draws.below(scans.len())])));
        drawn.push(ratio(found, beside));
    }
    Ok(ScanFit {
        scans: found.len(),
        scan_ms: Estimate::around(value, &mut drawn),
        share: share(measured, draws),
        simulated_share: simulated.share(),
    })
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
        let walk = Spikes { samples: samples.collect(), spike_ms: 40.0 };
        assert_eq!(walk.scans(), [(3.0, 180.0), (1.0, 60.0), (1.0, 60.0)]);
        let share = share(&walk, &mut Draws::new(1, "share"));
        assert!(share.low < 0.005 && share.value == 0.005 && share.high > 0.005, "{share:?}");
    }
}
