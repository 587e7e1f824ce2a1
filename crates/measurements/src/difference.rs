//! Comparison of two runs, for researchers who changed the plug-in, the testbed or the seed. Figures of both runs have the
//! same names and units, so that any two can be compared.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Direction, Event, LinkId, NodeId, PluginId, ServiceId, Timestamp, VnfId, VnfState, millis,
};
use serde::{Deserialize, Serialize};

use crate::{
    Figure, Kind, LinkQuantity, Run, RunId, Values,
    curve::Gathered,
    error::Result,
    page::pages,
    store::{Selection, Span, Store},
};

/// Two runs side by side. Each entry is in both runs, or in one of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Difference {
    /// Both runs.
    #[schema(value_type = Vec<Object>)]
    pub runs: [Run; 2],
    /// Service times, by service and robot.
    pub services: Vec<Entry<ServiceOf, Services>>,
    /// Service times, by region: where the robot was attached and which server answered.
    pub regions: Vec<Entry<RegionOf, Services>>,
    /// Links, by link and direction.
    pub links: Vec<Entry<LinkOf, Links>>,
    /// Handovers, by robot, from and to.
    pub handovers: Vec<Entry<HandoverOf, Handovers>>,
    /// Placements, by VNF and node.
    pub placements: Vec<Entry<PlacementOf, Placements>>,
    /// Decisions, by plug-in and instruction.
    pub decisions: Vec<Entry<DecisionOf, Decisions>>,
    /// Life cycles of VNFs.
    pub vnfs: Vec<Entry<VnfOf, Vnfs>>,
    /// Reasons to doubt the figures.
    pub doubts: [Doubts; 2],
}

/// An item in two runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Entry<K, V> {
    /// The compared item.
    pub of: K,
    /// Its figures in the first and in the second run; `None` where it is missing.
    pub runs: [Option<V>; 2],
}

macro_rules! keys {
    ($($(#[$doc:meta])* $name:ident { $($field:ident: $type:ty,)* })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
        #[allow(missing_docs, reason = "the fields name what they are")]
        pub struct $name { $(pub $field: $type,)* }
    )*};
}

keys! {
    /// A robot's service.
    ServiceOf { service: ServiceId, robot: NodeId, }
    /// A region of a robot's walk.
    RegionOf { service: ServiceId, robot: NodeId, attachment: Option<NodeId>, server: NodeId, }
    /// A direction of a link.
    LinkOf { link: LinkId, direction: Direction, }
    /// A change of attachment.
    HandoverOf { robot: NodeId, from: Option<NodeId>, to: NodeId, }
    /// A VNF on a node.
    PlacementOf { vnf: VnfId, node: NodeId, }
    /// An instruction of a plug-in.
    DecisionOf { plugin: PluginId, instruction: String, }
    /// A VNF.
    VnfOf { vnf: VnfId, }
}

/// Targets of the services of a run.
pub type Targets = BTreeMap<ServiceId, Duration>;

/// Service times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Services {
    /// Position packets, scans and requests, those without an answer in time included.
    #[serde(default)]
    pub samples: u64,
    /// Those that were not answered in time.
    pub unanswered: u64,
    /// Share of all of them that were answered within the target; `None` if the run's testbed file cannot be read.
    #[serde(default)]
    pub kept: Option<f64>,
    /// Service times of answered packets, ms, with quantiles 0.5, 0.95 and 0.99.
    pub service_time_ms: Option<Values>,
}

/// A direction of a link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Links {
    /// d, ms, with quantiles 0.5, 0.95 and 0.99.
    pub delay_ms: Option<Values>,
    /// λ, bit/s, with quantiles 0.5, 0.95 and 0.99.
    pub throughput_bps: Option<Values>,
    /// Packets that entered the link, by the last sample.
    pub packets: u64,
    /// Packets that were lost on the way or found a full queue.
    pub lost: u64,
}

/// Handovers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Handovers {
    /// Number of handovers.
    pub count: u64,
    /// Number of fast handovers.
    pub fast: u64,
    /// Time that each cut the robot off, ms, with quantiles 0.5, 0.95 and 0.99.
    pub gap_ms: Option<Values>,
}

/// A VNF on a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Placements {
    /// Number of times that it was placed there.
    pub count: u64,
    /// Time of the first placement.
    #[serde(rename = "first_ns")]
    pub first: Timestamp,
    /// Total time there, ms, up to the run's end or its last event.
    pub duration_ms: f64,
}

/// Decisions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Decisions {
    /// Number of decisions.
    pub count: u64,
    /// Number of rejected decisions.
    pub refused: u64,
    /// Time of the first decision.
    #[serde(rename = "first_ns")]
    pub first: Timestamp,
}

/// The life cycle of a VNF.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Vnfs {
    /// Number of starts.
    pub started: u64,
    /// Number of times that it ended by itself.
    pub died: u64,
    /// Number of failed starts.
    pub failed: u64,
}

/// Reasons to doubt a run's figures.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Doubts {
    /// Lost events; at least these if the run has no end.
    pub lost_events: u64,
    /// The emulator's lateness, 99th percentile over the run, µs; `None` in virtual time.
    pub lateness_p99_us: Option<f64>,
    /// Number of times that a plug-in was cut off.
    pub plugin_faults: u64,
}

const QUANTILES: [f64; 3] = [0.5, 0.95, 0.99];
const EVER: Span = Span { from: 0, until: i64::MAX };

/// Service times gathered from one run.
#[derive(Default)]
struct Times {
    unanswered: u64,
    within_target: u64,
    target: Option<Duration>,
    took: Gathered,
}

impl Times {
    fn add(&mut self, took: Option<Duration>) {
        match took {
            Some(took) => {
                self.took.add(millis::of(took));
                self.within_target += u64::from(self.target.is_some_and(|target| took <= target));
            }
            None => self.unanswered += 1,
        }
    }

    fn finish(mut self) -> Services {
        let service_time_ms = self.took.finish(&QUANTILES);
        let samples = self.unanswered + service_time_ms.as_ref().map_or(0, |values| values.count);
        let kept = self.target.map(|_| self.within_target as f64 / samples as f64);
        Services { samples, unanswered: self.unanswered, kept, service_time_ms }
    }
}

/// Figures gathered from one run.
#[derive(Default)]
struct Side {
    targets: Targets,
    services: BTreeMap<ServiceOf, Times>,
    regions: BTreeMap<RegionOf, Times>,
    links: BTreeMap<LinkOf, Links>,
    handovers: BTreeMap<HandoverOf, (u64, u64, Gathered)>,
    placements: BTreeMap<PlacementOf, Placements>,
    /// Node of each VNF, and the time since which it is there.
    placed: BTreeMap<VnfId, BTreeMap<NodeId, Timestamp>>,
    decisions: BTreeMap<DecisionOf, Decisions>,
    vnfs: BTreeMap<VnfOf, Vnfs>,
    doubts: Doubts,
    last: Timestamp,
}

/// Compares two runs. Reads their events once, in pages. Its memory is bounded by the size of the graph.
pub(crate) fn difference(
    a: (&dyn Store, RunId),
    b: (&dyn Store, RunId),
    [of_a, of_b]: [Targets; 2],
) -> Result<Difference> {
    let [(x, a), (y, b)] = [(a.0, a.0.run(a.1)?), (b.0, b.0.run(b.1)?)];
    let [x, y] = [Side::of(x, &a, of_a)?, Side::of(y, &b, of_b)?];
    let handovers = |(count, fast, mut gap): (u64, u64, Gathered)| Handovers {
        count,
        fast,
        gap_ms: gap.finish(&QUANTILES),
    };
    Ok(Difference {
        runs: [a, b],
        services: join(x.services, y.services, Times::finish),
        regions: join(x.regions, y.regions, Times::finish),
        links: join(x.links, y.links, |links| links),
        handovers: join(x.handovers, y.handovers, handovers),
        placements: join(x.placements, y.placements, |placements| placements),
        decisions: join(x.decisions, y.decisions, |decisions| decisions),
        vnfs: join(x.vnfs, y.vnfs, |vnfs| vnfs),
        doubts: [x.doubts, y.doubts],
    })
}

fn join<K: Ord, G, V>(a: BTreeMap<K, G>, b: BTreeMap<K, G>, summary: impl Fn(G) -> V) -> Vec<Entry<K, V>> {
    let mut joined: BTreeMap<K, [Option<V>; 2]> = BTreeMap::new();
    for (side, its) in [a, b].into_iter().enumerate() {
        for (key, gathered) in its {
            joined.entry(key).or_insert([None, None])[side] = Some(summary(gathered));
        }
    }
    joined.into_iter().map(|(of, runs)| Entry { of, runs }).collect()
}

impl Side {
    fn of(store: &dyn Store, run: &Run, targets: Targets) -> Result<Self> {
        let mut side = Self { targets, ..Self::default() };
        const TOLD: [Kind; 7] = [
            Kind::Placement,
            Kind::ServiceTime,
            Kind::Handover,
            Kind::Vnf,
            Kind::Decision,
            Kind::PluginFault,
            Kind::Lateness,
        ];
        pages(
            |page| store.events(run.id, &Selection::Kinds(&TOLD), EVER, page),
            |stamped| {
                side.last = stamped.at;
                side.add(stamped.at, stamped.event);
            },
        )?;
        pages(|page| store.gaps(run.id, EVER, page), |gap| side.doubts.lost_events += gap.events)?;
        for stamped in store.latest(run.id, i64::MAX)? {
            side.last = side.last.max(stamped.at);
            if let Event::Link(context) = &stamped.event {
                let (link, direction) = (context.link.clone(), context.direction);
                let mut values =
                    [LinkQuantity::Delay, LinkQuantity::Throughput].into_iter().map(|quantity| {
                        let (figure, mut gathered) =
                            (Figure::Link(link.clone(), direction, quantity), Gathered::default());
                        store.values(run.id, &figure, EVER, &mut |_, reading| gathered.read(reading))?;
                        Ok(gathered.finish(&QUANTILES))
                    });
                let (delay_ms, throughput_bps) =
                    (values.next().transpose()?.flatten(), values.next().transpose()?.flatten());
                let counters = &context.counters;
                let (packets, lost) = (counters.packets, counters.lost + counters.overflowed);
                side.links
                    .insert(LinkOf { link, direction }, Links { delay_ms, throughput_bps, packets, lost });
            }
        }
        let end = run.ended.unwrap_or(side.last);
        for (vnf, nodes) in std::mem::take(&mut side.placed) {
            nodes.into_iter().for_each(|(node, since)| side.stayed(vnf.clone(), node, since, end));
        }
        Ok(side)
    }

    fn stayed(&mut self, vnf: VnfId, node: NodeId, since: Timestamp, until: Timestamp) {
        if let Some(placements) = self.placements.get_mut(&PlacementOf { vnf, node }) {
            placements.duration_ms += millis::of(until.since(since));
        }
    }

    fn add(&mut self, at: Timestamp, event: Event) {
        match event {
            Event::Placement(placement) => {
                let (vnf, nodes) = (placement.vnf, placement.node.all());
                let mut before = self.placed.remove(&vnf).unwrap_or_default();
                let mut placed = BTreeMap::new();
                for node in nodes {
                    // Other instances came or went.
                    let stays = nodes.len() > 1 || before.len() > 1;
                    let since = if stays { before.remove(node) } else { None };
                    placed.insert(node.clone(), since.unwrap_or(at));
                    if since.is_none() {
                        let of = PlacementOf { vnf: vnf.clone(), node: node.clone() };
                        let new = Placements { count: 0, first: at, duration_ms: 0.0 };
                        self.placements.entry(of).or_insert(new).count += 1;
                    }
                }
                before.into_iter().for_each(|(node, since)| self.stayed(vnf.clone(), node, since, at));
                self.placed.insert(vnf, placed);
            }
            Event::ServiceTime(time) => {
                let target = self.targets.get(&time.service).copied();
                let service = ServiceOf { service: time.service.clone(), robot: time.robot.clone() };
                let (attachment, server) = (time.attachment, time.server);
                let region = RegionOf { service: time.service, robot: time.robot, attachment, server };
                let both =
                    [self.services.entry(service).or_default(), self.regions.entry(region).or_default()];
                for times in both {
                    times.target = target;
                    times.add(time.took);
                }
            }
            Event::Handover(handover) => {
                let of = HandoverOf { robot: handover.robot, from: handover.from, to: handover.to };
                let (count, fast, gathered) = self.handovers.entry(of).or_default();
                *count += 1;
                *fast += u64::from(handover.fast);
                gathered.add(millis::of(handover.gap));
            }
            Event::Vnf(vnf) => {
                let vnfs = self.vnfs.entry(VnfOf { vnf: vnf.vnf }).or_default();
                match vnf.state {
                    VnfState::Started => vnfs.started += 1,
                    VnfState::Died => vnfs.died += 1,
                    VnfState::Failed => vnfs.failed += 1,
                    VnfState::Stopped => {}
                }
            }
            Event::Decision(decision) => {
                let instruction = decision.instruction.name();
                let of = DecisionOf { plugin: decision.plugin, instruction: instruction.to_owned() };
                let new = Decisions { count: 0, refused: 0, first: at };
                let decisions = self.decisions.entry(of).or_insert(new);
                decisions.count += 1;
                decisions.refused += u64::from(decision.refused.is_some());
            }
            Event::PluginFault { .. } => self.doubts.plugin_faults += 1,
            Event::Lateness(lateness) => self.doubts.lateness_p99_us = Some(lateness.p99_us),
            _ => {}
        }
    }
}
