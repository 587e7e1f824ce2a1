//! The regions of a walk over time.

use std::collections::BTreeMap;

use super::{Region, SimulatedSample, WalkSample};

/// Samples within this time of a change of region are left out, seconds: they may be of either, or of the change itself.
const AROUND_CHANGE_S: f64 = 2.0;
/// Most by which a change of the measured walk is earlier or later than that of the simulated one, seconds: a robot that roams
/// by scans changes at the next scan, up to 25 s behind the place at which another radio unit is stronger.
const MOST_APART_S: f64 = 30.0;

/// The visits of a walk, by time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Visits<'a> {
    /// Beginning of each, seconds, and its region. Two that follow each other have different regions.
    visits: Vec<(f64, &'a Region)>,
    /// End of the walk, seconds.
    end_s: f64,
}

impl<'a> Visits<'a> {
    /// Returns the visits of a simulated walk. Time without a radio unit belongs to the visit before.
    pub fn of(walk: &'a [SimulatedSample]) -> Self {
        let mut visits: Vec<(f64, &Region)> = Vec::new();
        for SimulatedSample { sample, region } in walk {
            if let Some(region) =
                region.as_ref().filter(|its| visits.last().is_none_or(|last| last.1 != *its))
            {
                visits.push((sample.at_s, region));
            }
        }
        Self { visits, end_s: walk.last().map_or(0.0, |last| last.sample.at_s) }
    }

    /// Returns the same visits with the changes at which measured samples change best from one region's level to that of the
    /// next: with the least sum of absolute deviations. A change without a level on both sides stays. Each stays between the
    /// middles of its two visits.
    pub fn aligned(&self, measured: &[WalkSample], levels_ms: &BTreeMap<&Region, f64>) -> Self {
        let mut aligned = self.clone();
        for i in 1..self.visits.len() {
            let (change_s, to) = self.visits[i];
            let (before_s, from) = self.visits[i - 1];
            let after_s = self.visits.get(i + 1).map_or(self.end_s, |(after_s, _)| *after_s);
            let Some((from_ms, to_ms)) = levels_ms.get(from).zip(levels_ms.get(to)) else { continue };
            let first_s = f64::midpoint(before_s, change_s).max(change_s - MOST_APART_S);
            let last_s = f64::midpoint(change_s, after_s).min(change_s + MOST_APART_S);
            let inside = |its: &&WalkSample| (first_s..=last_s).contains(&its.at_s);
            // The sum of deviations if the change is behind a sample, less that if it is before all.
            let (mut sum, mut best) = (0.0, (0.0, first_s));
            let mut nearest = |sum: f64, at_s: f64| {
                let is_nearer = (at_s - change_s).abs() < (best.1 - change_s).abs();
                if sum < best.0 || sum == best.0 && is_nearer {
                    best = (sum, at_s);
                }
            };
            for WalkSample { at_s, ms } in measured.iter().filter(inside) {
                nearest(sum, *at_s);
                if let Some(ms) = ms {
                    sum += (ms - from_ms).abs() - (ms - to_ms).abs();
                }
            }
            nearest(sum, last_s);
            aligned.visits[i].0 = best.1;
        }
        aligned
    }

    /// Returns the region at a time; `None` before and after the walk.
    pub fn at(&self, at_s: f64) -> Option<&'a Region> {
        let next = self.visits.partition_point(|(from_s, _)| *from_s <= at_s);
        let (_, region) = self.visits.get(next.checked_sub(1)?)?;
        (at_s <= self.end_s + AROUND_CHANGE_S).then_some(*region)
    }

    /// Returns the region at a time; `None` near a change of region, and after the walk.
    pub fn settled(&self, at_s: f64) -> Option<&'a Region> {
        let region = self.at(at_s)?;
        let next = self.visits.partition_point(|(from_s, _)| *from_s <= at_s);
        let from_s = self.visits[next - 1].0;
        let is_after = next == 1 || at_s >= from_s + AROUND_CHANGE_S;
        let is_before = self.visits.get(next).is_none_or(|(to_s, _)| at_s <= to_s - AROUND_CHANGE_S);
        (is_after && is_before).then_some(region)
    }

    /// Returns all regions, each once or more.
    pub fn regions(&self) -> impl Iterator<Item = &'a Region> {
        self.visits.iter().map(|(_, region)| *region)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region(unit: &str) -> Region {
        Region { radio_unit: unit.parse().unwrap(), server: "cloud".parse().unwrap() }
    }

    /// A walk of 40 s that changes from R1 to R2 after 20 s.
    fn walk() -> Vec<SimulatedSample> {
        let at = |second: u32| SimulatedSample {
            sample: WalkSample { at_s: f64::from(second), ms: None },
            region: Some(region(if second < 20 { "R1" } else { "R2" })),
        };
        (0..40).map(at).collect()
    }

    #[test]
    fn samples_near_a_change_of_region_and_after_the_walk_are_in_none() {
        let walk = walk();
        let visits = Visits::of(&walk);
        let unit = |at_s| visits.settled(at_s).map(|region| region.radio_unit.as_str());
        assert_eq!([0.0, 18.0, 18.1, 21.9].map(unit), [Some("R1"), Some("R1"), None, None]);
        assert_eq!([22.0, 39.0, 41.0, 41.1].map(unit), [Some("R2"), Some("R2"), Some("R2"), None]);
        let unit = |at_s| visits.at(at_s).map(|region| region.radio_unit.as_str());
        assert_eq!(
            [-0.1, 0.0, 19.9, 20.0, 41.0, 41.1].map(unit),
            [None, Some("R1"), Some("R1"), Some("R2"), Some("R2"), None]
        );
        assert_eq!(visits.regions().count(), 2);
        assert_eq!(Visits::of(&[]).settled(1.0), None);
    }

    #[test]
    fn time_without_a_radio_unit_belongs_to_the_visit_before() {
        let mut walk = walk();
        walk[10].region = None;
        walk[20].region = None;
        let changes: Vec<_> = Visits::of(&walk).visits.iter().map(|(at_s, _)| *at_s).collect();
        assert_eq!(changes, [0.0, 21.0]);
    }

    #[test]
    fn a_change_moves_to_where_the_measured_samples_change() {
        let walk = walk();
        let visits = Visits::of(&walk);
        let units = ["R1", "R2"].map(region);
        let changed = |at: u32, levels: [f64; 2]| {
            let ms = |second: u32| Some(if second == 13 { 150.0 } else { levels[usize::from(second >= at)] });
            let sample = |second| WalkSample { at_s: f64::from(second), ms: ms(second) };
            let measured: Vec<_> = (0..40).map(sample).collect();
            visits.aligned(&measured, &units.iter().zip(levels).collect()).visits[1].0
        };
        assert_eq!([12, 17, 20, 27].map(|at| changed(at, [10.0, 20.0])), [12.0, 17.0, 20.0, 27.0]);
        // Equal levels determine nothing.
        assert_eq!(changed(15, [10.0, 10.0]), 20.0);
        assert_eq!(visits.aligned(&[], &BTreeMap::new()), visits);
    }
}
