//! The link of a region, and the settings that give it the fitted values.

use std::collections::BTreeMap;

use cotorra_graph::{JitterDistribution, Link, NodeId, Scale, Testbed};

use super::{Region, RegionFit, Visits, WalkData};
use crate::{jitter::standard_quantile, path::SHORTEST, settings::FittedSetting};

/// The wired links that the packets of each region cross.
#[derive(Debug)]
pub(super) struct Crossings<'a> {
    /// Those that a region crosses in both directions, from the radio unit on.
    by_region: BTreeMap<&'a Region, Vec<&'a Link>>,
}

impl<'a> Crossings<'a> {
    pub fn of(data: &WalkData<'a>, visits: &Visits<'a>) -> Self {
        let by_region = visits.regions().map(|region| (region, crossed(data, region))).collect();
        Self { by_region }
    }

    /// Returns the first link that only this region's packets cross.
    ///
    /// # Errors
    /// The reason why there is none.
    pub fn link_of(&self, region: &Region) -> Result<&'a Link, &'static str> {
        let others = || self.by_region.iter().filter(|(other, _)| **other != region);
        let is_own =
            |link: &&&Link| !others().any(|(_, links)| links.iter().any(|crossed| crossed.id == link.id));
        let own = self.by_region.get(region).into_iter().flatten().find(is_own);
        let link = own
            .ok_or("each of its wired links carries another region, too, so that its delay is not its own")?;
        match link.scales == [Scale::default(); 2] {
            true => Ok(link),
            false => Err("its link has a delay_scale or drop_scale, which would change what is fitted"),
        }
    }
}

fn crossed<'a>(data: &WalkData<'a>, region: &Region) -> Vec<&'a Link> {
    let testbed: &'a Testbed = data.testbed;
    let graph = &testbed.graph;
    let attached = |node: &NodeId| (node == data.robot).then_some(&region.radio_unit);
    let there = graph.route(data.robot, &region.server, attached);
    let back = graph.route(&region.server, data.robot, attached);
    let (Some(there), Some(back)) = (there, back) else { return Vec::new() };
    let both = there.links.iter().filter(|link| back.links.contains(link));
    both.filter_map(|link| graph.link(link)).collect()
}

/// Returns the deviation of a jitter with a link's packets forward, ms, so that round trips get a deviation that was
/// `simulated` before. Variances of independent delays add up.
pub(super) fn left(link: &Link, distribution: JitterDistribution, measured: f64, simulated: f64) -> f64 {
    let square = |distribution, deviation: f64| (deviation * unit(distribution)).powi(2);
    let present = link
        .forward
        .jitter
        .map_or(0.0, |jitter| square(jitter.distribution, jitter.deviation.as_secs_f64() * 1e3));
    let elsewhere = (square(distribution, simulated) - present).max(0.0);
    (square(distribution, measured) - elsewhere).max(0.0).sqrt() / unit(distribution)
}

/// Returns the standard deviation of a jitter with the deviation 1.
fn unit(distribution: JitterDistribution) -> f64 {
    match distribution {
        // Half the width.
        JitterDistribution::Uniform => 1.0 / 3.0f64.sqrt(),
        JitterDistribution::Normal | JitterDistribution::Pareto => 1.0,
    }
}

/// Returns the settings of a region's link, and what they cannot do.
///
/// Round trips do not show directions. Each direction gets half of the added delay. The jitter is counted forward, and
/// delay that it needs to stay above zero is moved there.
pub(super) fn of_region(link: &Link, fit: &RegionFit) -> (Vec<FittedSetting>, Vec<String>) {
    let delays = [&link.forward, &link.backward].map(|conditions| conditions.delay.as_secs_f64() * 1e3);
    let added = fit.added_ms.value;
    let below_mean = -fit.jitter_ms.value * standard_quantile(fit.distribution, SHORTEST);
    let [forward, backward] = with_least(halves(delays, added), below_mean);
    let mut notes = Vec::new();
    let missing = delays[0] + delays[1] + added;
    if missing < 0.0 {
        notes.push(format!("it was {:.2} ms faster than a delay of 0 ms at `{}` allows", -missing, link.id));
    }
    if forward + backward < below_mean {
        notes.push(format!(
            "the delay of `{}` is shorter than its jitter: it is cut off at 0 ms, which makes the mean longer and the \
             variation less",
            link.id
        ));
    }
    let set = |key: &str, value: String, note: &str| FittedSetting {
        path: format!("links.{}.{key}", link.id),
        value,
        note: format!("{}: {note}", fit.region),
    };
    let added = format!("added round trip {:.3} ms", fit.added_ms);
    let jitter =
        format!("{{ deviation: {:.4} ms, distribution: {} }}", fit.jitter_ms.value, fit.distribution_name());
    let settings = vec![
        set("forward.delay", format!("{forward:.4} ms"), &added),
        set("backward.delay", format!("{backward:.4} ms"), "the other part of it"),
        set("forward.jitter", jitter, &format!("jitter of the round trip {:.3} ms", fit.jitter_ms)),
    ];
    (settings, notes)
}

/// Adds half of a time to each of two delays. What one cannot lose, the other loses, and none falls below zero.
fn halves(delays: [f64; 2], added: f64) -> [f64; 2] {
    let [a, b] = delays.map(|delay| delay + added / 2.0);
    [a + b.min(0.0), b + a.min(0.0)].map(|delay| delay.max(0.0))
}

/// Moves time from the second delay to the first until the first has a least value, or the second is zero.
fn with_least([first, second]: [f64; 2], least: f64) -> [f64; 2] {
    let moved = (least - first).clamp(0.0, second);
    [first + moved, second - moved]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_are_added_by_halves_and_do_not_fall_below_zero() {
        assert_eq!(halves([4.0, 1.0], 1.0), [4.5, 1.5]);
        assert_eq!(halves([4.0, 1.0], -3.0), [2.0, 0.0]);
        assert_eq!(halves([4.0, 1.0], -9.0), [0.0, 0.0]);
    }

    #[test]
    fn the_direction_with_the_jitter_gets_delay_from_the_other() {
        assert_eq!(with_least([4.0, 1.0], 3.0), [4.0, 1.0]);
        assert_eq!(with_least([4.0, 1.0], 4.5), [4.5, 0.5]);
        assert_eq!(with_least([4.0, 1.0], 9.0), [5.0, 0.0]);
    }
}
