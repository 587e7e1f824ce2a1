//! Phases of handovers, fitted to their times.

use std::collections::BTreeMap;

use cotorra_graph::{HandoverTimes, Testbed};
use cotorra_numbers::Draws;
use serde::Serialize;

use crate::{error::CalibrateError, estimate::Estimate, recorded::HandoverTime, survey::find_radio_unit};

/// Fewest handovers of a fit.
pub const LEAST_HANDOVERS: usize = 10;
/// Draws of the pivots.
const DRAWS: usize = 2000;
/// Most times that are fitted; further ones say little more.
const MAX_FITTED: usize = 1000;

/// The handovers of one wireless network, fitted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HandoverFit {
    /// Number of handovers.
    pub handovers: usize,
    /// Mean of scans that precede a handover, ms; `None` with few, or if the testbed's scans visit one channel after another.
    pub scan_ms: Option<Estimate>,
    /// Mean of authentication and reassociation together, ms; `None` with few fast transitions.
    pub fast_ms: Option<Estimate>,
    /// Mean of authentication, reassociation and key handshakes together, ms; `None` with few handovers that are not fast.
    pub full_ms: Option<Estimate>,
    /// Share by which each phase varies.
    pub variation: Estimate,
    /// Notes on the fit, for people.
    pub notes: Vec<String>,
}

/// Fits the phases of the handovers of each wireless network. The seed decides the draws.
///
/// A phase is uniform around its mean, as [`HandoverTimes`] has it, and a time is a sum of phases. What cannot be seen, such as
/// the share of authentication in a fast transition, is as in the testbed. A sum is then a mean plus a deviation times a known
/// distribution. Both follow from the least and the greatest time. Their intervals hold for few handovers, too: the estimates'
/// errors, in units of the range, have a distribution that depends on the number of handovers alone, and is simulated.
///
/// # Errors
/// [`CalibrateError::Unsuited`] if a radio unit is not in the testbed, and [`CalibrateError::TooLittle`] if a network has no
/// kind of handover ten times.
pub fn fit_handovers(
    testbed: &Testbed,
    handovers: &[HandoverTime],
    seed: u64,
) -> Result<BTreeMap<String, HandoverFit>, CalibrateError> {
    let mut networks: BTreeMap<&str, Vec<&HandoverTime>> = BTreeMap::new();
    for handover in handovers {
        let (_, unit) = find_radio_unit(testbed, &handover.radio_unit)?;
        networks.entry(&unit.network).or_default().push(handover);
    }
    let fit = |(name, handovers): (&str, Vec<&HandoverTime>)| {
        let draws = &mut Draws::new(seed, &format!("calibrate handovers {name}"));
        let fitted = fit_network(name, &testbed.graph.wireless[name].handover, &handovers, draws)?;
        Ok((name.to_owned(), fitted))
    };
    networks.into_iter().map(fit).collect()
}

fn fit_network(
    name: &str,
    times: &HandoverTimes,
    handovers: &[&HandoverTime],
    draws: &mut Draws,
) -> Result<HandoverFit, CalibrateError> {
    let ms = |of: fn(&HandoverTimes) -> std::time::Duration| of(times).as_secs_f64() * 1e3;
    let [authenticate, reassociate] = [ms(|times| times.authenticate), ms(|times| times.reassociate)];
    let joins = |fast: bool| -> Vec<f64> {
        handovers.iter().filter(|handover| handover.fast == fast).map(|handover| handover.join_ms).collect()
    };
    let mut notes = Vec::new();
    let mut fit = |what: &str, times: Vec<f64>, phases: &[f64]| {
        if (1..LEAST_HANDOVERS).contains(&times.len()) {
            notes.push(format!("{} {what} are too few to fit: it takes {LEAST_HANDOVERS}", times.len()));
        }
        (times.len() >= LEAST_HANDOVERS).then(|| Sum::fit(&times, phases, draws))
    };
    let fast = fit("fast transitions", joins(true), &[authenticate, reassociate]);
    // The time beyond a fast transition is that of the handshakes.
    let full_times = joins(false);
    let (short, middle) =
        (authenticate + reassociate, full_times.iter().sum::<f64>() / full_times.len().max(1) as f64);
    let phases = match &fast {
        Some(fast) if short > 0.0 => {
            let scale = fast.mean / short;
            [authenticate * scale, reassociate * scale, (middle - fast.mean).max(0.0)]
        }
        _ => [authenticate, reassociate, ms(|times| times.handshake)],
    };
    let full = fit("handovers with key handshakes", full_times, &phases);
    let scans: Vec<f64> = handovers.iter().filter_map(|handover| handover.scan_ms).collect();
    let scan = match times.visits {
        None => fit("scans before handovers", scans, &[1.0]),
        Some(_) => None,
    };
    let sums: Vec<&Sum> = [&scan, &fast, &full].into_iter().flatten().collect();
    if sums.is_empty() {
        return Err(CalibrateError::too_little(format!(
            "network `{name}` has {} handovers: a fit needs {LEAST_HANDOVERS} or more of a kind (fast, or with key handshakes)",
            handovers.len()
        )));
    }
    let (variation, agree) = pooled(&sums);
    if !agree {
        notes.push("phases vary by different shares, but a testbed has one for all".to_owned());
    }
    if variation.value > 1.0 {
        notes.push("times vary more than uniform phases can, and the setting is 100 %".to_owned());
    }
    let mean = |sum: &Option<Sum>| sum.as_ref().map(|sum| Estimate::around(sum.mean, &mut sum.means.clone()));
    let [scan_ms, fast_ms, full_ms] = [mean(&scan), mean(&fast), mean(&full)];
    Ok(HandoverFit { handovers: handovers.len(), scan_ms, fast_ms, full_ms, variation, notes })
}

/// A sum of uniform phases that vary by the same share.
struct Sum {
    mean: f64,
    variation: f64,
    /// Draws of both.
    means: Vec<f64>,
    variations: Vec<f64>,
}

impl Sum {
    /// Fits times, two or more, of phases in these proportions.
    fn fit(times: &[f64], phases: &[f64], draws: &mut Draws) -> Self {
        let whole: f64 = phases.iter().sum();
        let share = |phase: &f64| if whole > 0.0 { phase / whole } else { 1.0 / phases.len() as f64 };
        let shares: Vec<f64> = phases.iter().map(share).collect();
        let number = times.len().min(MAX_FITTED);
        let [least, greatest] = ends(times[..number].iter().copied());
        let (middle, range) = ((least + greatest) / 2.0, greatest - least);
        // Standard times are sums of phases of mean 0 that vary by 1.
        let standard: Vec<[f64; 2]> = (0..DRAWS)
            .map(|_| {
                let time = |_| shares.iter().map(|share| share * (2.0 * draws.unit() - 1.0)).sum::<f64>();
                let [least, greatest] = ends((0..number).map(time));
                [(least + greatest) / 2.0, greatest - least]
            })
            .collect();
        let usual = standard.iter().map(|[_, range]| range).sum::<f64>() / DRAWS as f64;
        let (mut means, mut variations) = (Vec::with_capacity(DRAWS), Vec::with_capacity(DRAWS));
        for [standard_middle, standard_range] in standard {
            let deviation = range / standard_range;
            let mean = (middle - standard_middle * deviation).max(f64::MIN_POSITIVE);
            means.push(mean);
            variations.push(deviation / mean);
        }
        let mean = middle.max(f64::MIN_POSITIVE);
        Self { mean, variation: range / usual / mean, means, variations }
    }

    fn variance(&self) -> f64 {
        let n = self.variations.len() as f64;
        let mean = self.variations.iter().sum::<f64>() / n;
        self.variations.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n
    }
}

/// Returns the least and the greatest value.
fn ends(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, greatest], v| [least.min(v), greatest.max(v)])
}

/// Returns the variation of all, weighted by their certainty, and whether their intervals overlap.
fn pooled(sums: &[&Sum]) -> (Estimate, bool) {
    // Times that are all equal are certain.
    const LEAST_VARIANCE: f64 = 1e-12;
    let weights: Vec<f64> = sums.iter().map(|sum| 1.0 / sum.variance().max(LEAST_VARIANCE)).collect();
    let whole: f64 = weights.iter().sum();
    let weighted = |of: &dyn Fn(&Sum) -> f64| {
        sums.iter().zip(&weights).map(|(sum, weight)| of(sum) * weight).sum::<f64>() / whole
    };
    let mut draws: Vec<f64> = (0..DRAWS).map(|i| weighted(&|sum| sum.variations[i])).collect();
    let each = sums.iter().map(|sum| Estimate::around(sum.variation, &mut sum.variations.clone()));
    let (low, high) =
        each.fold((0.0_f64, f64::INFINITY), |(low, high), its| (low.max(its.low), high.min(its.high)));
    (Estimate::around(weighted(&|sum| sum.variation), &mut draws), low <= high)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uniform(draws: &mut Draws, mean: f64, variation: f64) -> f64 {
        mean * (1.0 + variation * (2.0 * draws.unit() - 1.0))
    }

    #[test]
    fn intervals_hold_the_true_values() {
        let (mut means, mut variations) = (0, 0);
        for seed in 0..100 {
            let draws = &mut Draws::new(seed, "sum");
            let times: Vec<f64> =
                (0..20).map(|_| uniform(draws, 15.0, 0.3) + uniform(draws, 20.0, 0.3)).collect();
            let mut sum = Sum::fit(&times, &[15.0, 20.0], draws);
            means += usize::from(Estimate::around(sum.mean, &mut sum.means).covers(35.0));
            variations += usize::from(Estimate::around(sum.variation, &mut sum.variations).covers(0.3));
        }
        assert!((88..=100).contains(&means) && (88..=100).contains(&variations), "{means} {variations}");
    }

    #[test]
    fn the_range_of_one_phase_matches_order_statistics() {
        // The range of n uniform times is (n - 1)/(n + 1) of the whole width, on average.
        let times: Vec<f64> = (0..=10).map(|i| 90.0 + 2.0 * f64::from(i)).collect();
        let sum = Sum::fit(&times, &[1.0], &mut Draws::new(1, "range"));
        assert_eq!(sum.mean, 100.0);
        let expected = 10.0 / 100.0 * 12.0 / 10.0;
        assert!((sum.variation / expected - 1.0).abs() < 0.01, "{} {expected}", sum.variation);
    }

    #[test]
    fn equal_times_do_not_vary() {
        let sum = Sum::fit(&[35.0; 12], &[15.0, 20.0], &mut Draws::new(1, "equal"));
        let (variation, agree) = pooled(&[&sum]);
        assert_eq!((sum.mean, variation.value, variation.high, agree), (35.0, 0.0, 0.0, true));
    }
}
