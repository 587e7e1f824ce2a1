//! Links as decisions count with them: the configuration, and what was measured beyond it.
//!
//! [`Links`] learns contexts of links and returns figures over a window, for any plug-in that compares links. What a single
//! context has is in [`LinkContext::figures`].
//!
//! - **Delay.** That of [`LinkContext::measured_delay`]: by probes that are fresh, else by packets of the last second. What it
//!   exceeds the configured delay by counts from the tolerance on. On wires the highest of the window counts: it rises at once,
//!   and falls when the window has passed. On the air the lowest counts, and only after as long a time as the window of OKpi
//!   and that of the probes together: scans and handovers hold up packets for moments.
//! - **Throughput.** What is left: the rate less the mean load of the window ([`cotorra_graph::available_bps`]). A rate that others
//!   declare, and may have reserved, is not left either: [`RoundTrip::free_bps`].
//! - **Loss.** As far as the counters or the probes of the window prove it: the lower bound of Wilson's 95 % interval.
//!
//! [`Links::candidates`] has the delay over the air to each radio unit that a robot can use. [`Links::air`] has figures for decisions,
//! over the window.
//!
//! [`Memory`] keeps a service from coming back to a link that is idle only because the service left it.

mod figures;
mod history;
mod memory;
mod settings;
#[cfg(test)]
mod tests;
mod way;

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Candidate, Direction, HardwareGraph, LinkContext, LinkId, NodeId, RobotContext, Scale, Testbed, Timestamp,
};

use self::way::{Carrier, Configured, Measuring, OneWay, Way};
pub use self::{
    figures::{Beyond, RoundTrip},
    history::LinkHistory,
    memory::Memory,
    settings::Measurements,
};

/// Effect of a context on decisions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum News {
    /// None.
    Nothing,
    /// A measurement changed by as much as counts.
    Measured,
    /// The link is configured otherwise.
    Configured,
}

/// What is known of all links: wires, and the air between robots and radio units that they used.
#[derive(Debug)]
pub struct Links {
    /// `None` for the configured figures alone.
    measuring: Option<Measuring>,
    ways: BTreeMap<(LinkId, Direction), Way>,
    /// Configuration of the air around each robot.
    air: BTreeMap<NodeId, Configured>,
    /// The last contexts of the air, with their times.
    latest: BTreeMap<(LinkId, Direction), (Timestamp, LinkContext)>,
}

impl Links {
    /// Creates the links of a testbed as they are configured. Without measurements, only the configuration counts.
    pub fn new(testbed: &Testbed, measurements: Option<Measurements>) -> Self {
        let graph = &testbed.graph;
        let wires = graph.links.iter().flat_map(|link| {
            let ways = [(Direction::Forward, &link.forward), (Direction::Backward, &link.backward)];
            ways.into_iter().zip(link.scales).map(|((direction, conditions), scale)| {
                let medium = link.medium.bits_per_second() as f64;
                let configured = scaled(conditions.into(), scale, medium);
                ((link.id.clone(), direction), Way::new(Carrier::Wire, configured))
            })
        });
        let air = graph.robots().filter_map(|(node, robot)| {
            let network = graph.wireless.get(&robot.network)?;
            let rate_bps = network.rate.map_or(f64::INFINITY, |rate| rate.bits_per_second() as f64);
            Some((node.id.clone(), Configured { delay: network.delay, rate_bps }))
        });
        Self {
            ways: wires.collect(),
            air: air.collect(),
            latest: BTreeMap::new(),
            measuring: measurements.map(|measurements| Measuring { measurements, probing: testbed.probes }),
        }
    }

    /// Learns the context of a link at a time.
    pub fn learn(&mut self, at: Timestamp, context: &LinkContext) -> News {
        let key = (context.link.clone(), context.direction);
        if self.air_of(&context.link).is_some() {
            self.latest.insert(key.clone(), (at, context.clone()));
        }
        let way = match self.ways.get_mut(&key) {
            Some(way) => way,
            None => {
                let Some(&configured) = self.air_of(&context.link) else { return News::Nothing };
                self.ways.entry(key).or_insert(Way::new(Carrier::Air, configured))
            }
        };
        let changes = way.configure(at, (&context.effective).into());
        let measured = self.measuring.as_ref().is_some_and(|measuring| {
            way.measure(at, context, measuring);
            way.has_news(measuring)
        });
        match (changes, measured) {
            (true, _) => News::Configured,
            (false, true) => News::Measured,
            (false, false) => News::Nothing,
        }
    }

    /// Returns the configuration of the air of a wireless link; `None` for other links.
    fn air_of(&self, link: &LinkId) -> Option<&Configured> {
        let name = link.as_str();
        name.match_indices('~').find_map(|(end, _)| self.air.get(&name[..end]))
    }

    /// Drops measurements that are too old.
    pub fn forget(&mut self, now: Timestamp) {
        if let Some(measuring) = &self.measuring {
            self.ways.values_mut().for_each(|way| way.forget(now, measuring));
        }
    }

    /// Whether anything was measured beyond the configuration.
    pub fn any_beyond(&self) -> bool {
        let differs = |measuring| self.ways.values().any(|way| way.beyond(measuring) != OneWay::default());
        self.measuring.as_ref().is_some_and(differs)
    }

    /// Returns the radio units that a robot can use, with the delay over the air to each, its source and its age as of `now`. `stations`
    /// are the robots of its network with their radio units.
    pub fn candidates(
        &self,
        now: Timestamp,
        graph: &HardwareGraph,
        robot: &RobotContext,
        stations: &[(&NodeId, &NodeId)],
    ) -> Vec<Candidate> {
        let latest = |link: &LinkId, direction| {
            let (at, context) = self.latest.get(&(link.clone(), direction))?;
            Some((context, now.since(*at)))
        };
        cotorra_graph::candidates(robot, graph, stations, latest)
    }

    /// Returns the figures of the air between a robot and a radio unit. If candidates count, and this robot measured nothing there
    /// over the window, the delay of a direction is the mean of what other robots measured.
    pub fn air(&self, robot: &NodeId, unit: &NodeId) -> RoundTrip {
        let own = LinkId::wireless(robot, unit);
        let figures = self.figures(&own);
        let Some(measuring) = self.measuring.filter(|measuring| measuring.measurements.candidates) else {
            return figures;
        };
        let delay = |direction| {
            let way = |link: LinkId| self.ways.get(&(link, direction)).filter(|way| way.is_measured());
            if let Some(own) = way(own.clone()) {
                return own.beyond(&measuring).delay;
            }
            let others = self.air.keys().filter_map(|other| way(LinkId::wireless(other, unit)));
            let (sum, count) = others.fold((Duration::ZERO, 0), |(sum, count), other| {
                (sum + other.beyond(&measuring).delay, count + 1)
            });
            sum.checked_div(count).unwrap_or_default()
        };
        let delay = delay(Direction::Forward) + delay(Direction::Backward);
        RoundTrip { beyond: Beyond { delay, ..figures.beyond }, ..figures }
    }

    /// Returns the figures of a wire; those of the air are configured alone until the robot used it.
    pub fn figures(&self, link: &LinkId) -> RoundTrip {
        let [(there, out), (back, home)] = [Direction::Forward, Direction::Backward].map(|direction| {
            match self.ways.get(&(link.clone(), direction)) {
                Some(way) => {
                    let beyond = self.measuring.as_ref().map(|measuring| way.beyond(measuring));
                    (way.configured(), beyond.unwrap_or_default())
                }
                None => (self.air_of(link).copied().unwrap_or_default(), OneWay::default()),
            }
        });
        RoundTrip {
            configured: there.delay + back.delay,
            rate_bps: there.rate_bps.min(back.rate_bps),
            beyond: Beyond {
                delay: out.delay + home.delay,
                load_bps: out.load_bps.max(home.load_bps),
                delivery: (1.0 - out.loss) * (1.0 - home.loss),
            },
        }
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
