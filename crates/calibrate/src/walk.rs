//! A testbed, fitted to the service times that were measured along a walk.
//!
//! A service time is one sum: the air, the wires and the server, there and back. So the service times of a walk say, for each
//! region, which is a radio unit and a server:
//!
//! - **how much longer** they take on average than the simulated ones,
//! - **how much** they vary outside of scans, and with 100 samples by which distribution,
//! - and for the whole walk **how long scans last**, or each of their visits and **how many** there are: frames that are held
//!   come up to a visit's length late.
//!
//! They do not say in which direction or on which hop of the region the time passes, nor which phase of a handover takes it,
//! nor anything of signals and thresholds. Those stay as the testbed file has them. By convention, what a region takes longer is
//! put on one wired link that only this region's packets cross.
//!
//! The measured walk does not say where the robot was. It is taken to visit the regions of the simulated walk in the same order,
//! and to change within 30 s of it, where its samples change. Samples near a change are left out.

mod gaps;
mod regions;
mod setting;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use cotorra_graph::{JitterDistribution, Link, LinkId, NodeId, Testbed, WirelessNetwork};
use cotorra_numbers::Draws;
use serde::Serialize;

use self::{
    gaps::{Answers, Late, Spikes},
    regions::Visits,
    setting::Crossings,
};
use crate::{
    estimate::Estimate,
    jitter,
    matched::Matched,
    settings::{FittedSetting, distribution_name},
};

/// Fewest samples of a region that is fitted, measured and simulated.
pub const LEAST_IN_REGION: usize = 20;
/// Fewest samples of a region whose distribution is fitted; with less, it is taken to be normal.
const LEAST_FOR_DISTRIBUTION: usize = 100;
/// A spike is as many deviations above its region's median, at least.
const SPIKE_DEVIATIONS: f64 = 8.0;
/// Deviation of a normal distribution, by its median absolute deviation (Hampel 1974).
const DEVIATION_BY_MEDIAN: f64 = 1.4826;
/// Lowest height of a spike, ms.
const LOWEST_SPIKE_MS: f64 = 1.0;

/// A service time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WalkSample {
    /// Time of the request, seconds since the walk began.
    pub at_s: f64,
    /// Milliseconds; `None` without an answer.
    pub ms: Option<f64>,
}

/// The radio unit and the server of a sample.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Region {
    /// Radio unit that the robot is attached to.
    pub radio_unit: NodeId,
    /// Server that answers.
    pub server: NodeId,
}

/// A service time of the simulated walk.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedSample {
    /// The service time.
    pub sample: WalkSample,
    /// Its region; `None` while the robot has no radio unit.
    pub region: Option<Region>,
}

/// The data that a walk is fitted to.
#[derive(Debug, Clone, Copy)]
pub struct WalkData<'a> {
    /// The testbed that was simulated.
    pub testbed: &'a Testbed,
    /// The robot that walks.
    pub robot: &'a NodeId,
    /// Service times of the simulated walk, by time.
    pub simulated: &'a [SimulatedSample],
    /// The part of the measured service times that is fitted, by time.
    pub measured: &'a [WalkSample],
}

/// A testbed, fitted to a walk.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WalkFit {
    /// Regions that were fitted, by name.
    pub regions: Vec<RegionFit>,
    /// Scans; `None` if the walk does not determine their length.
    pub scan: Option<ScanFit>,
    /// Settings that put the fitted values into the testbed file; none if nothing was fitted.
    pub settings: Vec<FittedSetting>,
    /// Parameters that were not fitted, and the reasons.
    pub notes: Vec<String>,
}

/// A fitted region.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionFit {
    /// The region.
    #[serde(flatten)]
    pub region: Region,
    /// Number of its measured samples.
    pub samples: usize,
    /// Mean round trip less the simulated one, ms.
    pub added_ms: Estimate,
    /// Deviation of the jitter that explains what the simulation does not, ms: half the width of a uniform distribution, the
    /// standard deviation of others.
    pub jitter_ms: Estimate,
    /// Distribution of the jitter.
    pub distribution: JitterDistribution,
    /// Link that gets both.
    pub link: LinkId,
}

impl RegionFit {
    /// Returns the name of the jitter's distribution in a testbed file.
    pub const fn distribution_name(&self) -> &'static str {
        distribution_name(self.distribution)
    }
}

/// Fitted scans.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanFit {
    /// Number of scans whose spikes were measured.
    pub scans: usize,
    /// Mean duration of a scan, or of each of its visits, ms.
    pub scan_ms: Estimate,
    /// Number of visits of a scan; `None` if it is one absence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visits: Option<Estimate>,
    /// Share of samples in spikes. It follows from these and the number of scans, and is in no setting.
    pub share: Estimate,
    /// Share of the simulated samples in spikes.
    pub simulated_share: f64,
}

/// A region's samples, measured or simulated.
#[derive(Debug, Clone, Default)]
struct Series {
    /// Seconds and milliseconds.
    samples: Vec<(f64, f64)>,
}

impl Series {
    fn median_ms(&self) -> f64 {
        median(self.samples.iter().map(|(_, ms)| *ms).collect())
    }

    /// Returns the deviation of a normal distribution with the same median absolute deviation, ms.
    fn deviation_ms(&self) -> f64 {
        let middle = self.median_ms();
        DEVIATION_BY_MEDIAN * median(self.samples.iter().map(|(_, ms)| (ms - middle).abs()).collect())
    }

    /// Returns the samples outside of scans, ms. If they are few, it returns all that are no spikes.
    fn usual_ms(&self, spikes: &Spikes, spike_ms: f64) -> Vec<f64> {
        let highest = self.median_ms() + spike_ms;
        let low = || self.samples.iter().filter(move |(_, ms)| *ms <= highest);
        let outside: Vec<_> =
            low().filter(|(at_s, _)| !spikes.is_in_scan(*at_s)).map(|(_, ms)| *ms).collect();
        if outside.len() < LEAST_IN_REGION { low().map(|(_, ms)| *ms).collect() } else { outside }
    }
}

fn median(values: Vec<f64>) -> f64 {
    cotorra_numbers::median(values).unwrap_or(f64::NAN)
}

/// The samples of each region.
type Walk<'a> = BTreeMap<&'a Region, Series>;

/// Fits a testbed to a part of a measured walk. The seed decides resamples.
///
/// Leaves out, with a note, parameters that the samples do not determine.
pub fn fit_walk(data: &WalkData<'_>, seed: u64) -> WalkFit {
    let visits = Visits::of(data.simulated);
    let mut notes = Vec::new();
    let simulated = by_region(&visits, data.simulated.iter().map(|simulated| simulated.sample));
    let aligned = align(&visits, data, &simulated);
    let mut measured = by_region(&aligned, data.measured.iter().copied());
    measured.retain(|region, series| {
        let (found, expected) = (series.samples.len(), simulated.get(region).map_or(0, |s| s.samples.len()));
        let least = found.min(expected);
        if least < LEAST_IN_REGION {
            let which = if found <= expected { "measured" } else { "simulated" };
            notes.push(format!(
                "{region}: a fit needs {LEAST_IN_REGION} {which} samples away from changes of region, and the walk has {least}"
            ));
        }
        least >= LEAST_IN_REGION
    });
    let network = network(data);
    let spike_ms = spike_ms(network.map(|(_, network)| network), [&measured, &simulated]);
    let air_ms = network.map_or(0.0, |(_, network)| 2e3 * network.delay.as_secs_f64());
    let spikes = [
        spikes(&measured, &aligned, data.measured.iter().copied(), spike_ms, air_ms),
        spikes(
            &simulated,
            &visits,
            data.simulated.iter().map(|simulated| simulated.sample),
            spike_ms,
            air_ms,
        ),
    ];
    let crossings = Crossings::of(data, &visits);
    let mut fit = WalkFit { regions: Vec::new(), scan: None, settings: Vec::new(), notes };
    for (region, series) in &measured {
        let link = match crossings.link_of(region) {
            Ok(link) => link,
            Err(reason) => {
                fit.notes.push(format!("{region}: {reason}"));
                continue;
            }
        };
        let walks = [(series, &spikes[0]), (&simulated[region], &spikes[1])]
            .map(|(series, spikes)| series.usual_ms(spikes, spike_ms));
        let of_region = fit_region(region, link, &walks, &mut Draws::new(seed, &format!("walk {region}")));
        let (settings, notes) = setting::of_region(link, &of_region);
        fit.settings.extend(settings);
        fit.notes.extend(notes.into_iter().map(|note| format!("{region}: {note}")));
        fit.regions.push(of_region);
    }
    match scan(network, &spikes, seed) {
        Ok((setting, scan)) => {
            fit.settings.push(setting);
            fit.scan = Some(scan);
        }
        Err(reason) => fit.notes.push(format!("scans: {reason}")),
    }
    fit
}

/// Fits a region to its usual samples, measured and simulated, ms. Intervals are of resamples of both.
fn fit_region(
    region: &Region,
    link: &Link,
    [measured, simulated]: &[Vec<f64>; 2],
    draws: &mut Draws,
) -> RegionFit {
    let distributions: &[JitterDistribution] =
        if measured.len() < LEAST_FOR_DISTRIBUTION { &[JitterDistribution::Normal] } else { &jitter::ALL };
    let matched = Matched::nearest(distributions, measured, draws);
    let distribution = matched.distribution;
    let beside = Matched::nearest(&[distribution], simulated, draws);
    RegionFit {
        region: region.clone(),
        samples: measured.len(),
        added_ms: matched.compared(&beside, |measured, simulated| measured.mean - simulated.mean),
        jitter_ms: matched.compared(&beside, |measured, simulated| {
            setting::left(link, distribution, measured.deviation, simulated.deviation)
        }),
        distribution,
        link: link.id.clone(),
    }
}

/// Returns the network that the robot joins.
fn network<'a>(data: &WalkData<'a>) -> Option<(&'a str, &'a WirelessNetwork)> {
    let graph = &data.testbed.graph;
    let (_, robot) = graph.robots().find(|(node, _)| node.id == *data.robot)?;
    let (name, network) = graph.wireless.get_key_value(&robot.network)?;
    Some((name.as_str(), network))
}

/// Moves the changes of region from the simulated to the measured walk: at first with the simulated levels, all moved by what
/// most measured samples are above them, and then with those that follow.
fn align<'a>(visits: &Visits<'a>, data: &WalkData<'_>, simulated: &Walk<'a>) -> Visits<'a> {
    let at_once = by_region(visits, data.measured.iter().copied());
    let levels: BTreeMap<_, _> =
        simulated.iter().map(|(region, series)| (*region, series.median_ms())).collect();
    let above = at_once.iter().filter_map(|(region, series)| Some((series, levels.get(region)?)));
    let above: Vec<f64> =
        above.flat_map(|(series, level)| series.samples.iter().map(move |(_, ms)| ms - level)).collect();
    if above.is_empty() {
        return visits.clone();
    }
    let above = median(above);
    let levels = levels.into_iter().map(|(region, level)| (region, level + above)).collect();
    let by_simulated = visits.aligned(data.measured, &levels);
    let measured = by_region(&by_simulated, data.measured.iter().copied());
    let levels = measured.iter().map(|(region, series)| (*region, series.median_ms())).collect();
    visits.aligned(data.measured, &levels)
}

/// Returns the answered samples of each region, away from its ends.
fn by_region<'a>(visits: &Visits<'a>, samples: impl Iterator<Item = WalkSample>) -> Walk<'a> {
    let mut found = Walk::new();
    for WalkSample { at_s, ms } in samples {
        if let (Some(region), Some(ms)) = (visits.settled(at_s), ms) {
            found.entry(region).or_default().samples.push((at_s, ms));
        }
    }
    found
}

/// Returns the spikes of a walk whose frames are on the air for `air_ms` there and back. Those near changes of region count, too:
/// a robot that roams by scans changes right behind a scan.
fn spikes(
    walk: &Walk<'_>,
    visits: &Visits<'_>,
    samples: impl Iterator<Item = WalkSample>,
    spike_ms: f64,
    air_ms: f64,
) -> Spikes {
    let usual: BTreeMap<_, _> = walk.iter().map(|(region, series)| (*region, series.median_ms())).collect();
    let late = samples.filter_map(|WalkSample { at_s, ms }| {
        let usual_ms = usual.get(visits.at(at_s)?)?;
        Some(Late { at_s, late_ms: ms? - usual_ms })
    });
    let answers = walk.iter().map(|(region, series)| Answers {
        samples: series.samples.len() as f64,
        after_ms: (usual[region] - air_ms).max(0.0),
    });
    Spikes::of(late.collect(), spike_ms, answers.collect())
}

/// Returns the height above which a sample is a spike of a scan, ms: above the usual variation, and above the longest change of
/// radio unit without a scan.
fn spike_ms(network: Option<&WirelessNetwork>, walks: [&Walk<'_>; 2]) -> f64 {
    let deviations = walks.into_iter().flat_map(|walk| walk.values()).map(Series::deviation_ms);
    let usual = SPIKE_DEVIATIONS * deviations.fold(0.0, f64::max);
    let change = network.map_or(0.0, gaps::longest_change_ms);
    usual.max(change).max(LOWEST_SPIKE_MS)
}

/// Fits the scans.
fn scan(
    network: Option<(&str, &WirelessNetwork)>,
    [measured, simulated]: &[Spikes; 2],
    seed: u64,
) -> Result<(FittedSetting, ScanFit), String> {
    let (name, network) = network.ok_or("the robot joins no network")?;
    let scan = gaps::fit(network, measured, simulated, &mut Draws::new(seed, "walk scans"))?;
    let note = match scan.visits {
        None => format!("duration of a scan {:.1} ms", scan.scan_ms),
        Some(visits) => format!("{visits:.1} visits of {:.1} ms", scan.scan_ms),
    };
    let setting = FittedSetting {
        path: format!("wireless.{name}.handover.scan"),
        value: gaps::setting(&scan, &network.handover),
        note,
    };
    Ok((setting, scan))
}

impl std::fmt::Display for Region {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} + {}", self.radio_unit, self.server)
    }
}
