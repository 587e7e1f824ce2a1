//! OKpi's decision: the cheapest path through the decision graph, expanded over γ levels for each KPI (Martín-Pérez,
//! Malandrino, Chiasserini, Bernardos, "OKpi: All-KPI Network Slicing Through Efficient Resource Allocation", INFOCOM
//! 2020; "KPI Guarantees in Network Slicing", IEEE/ACM Transactions on Networking 30(2), 2022).
//!
//! A vertex of the decision graph is a host that can carry the next VNF; the way to a radio unit is a hop of its own.
//! A hop weighs its share of each budget, w = (delay / D, log reliability / log H), rounded up to whole levels of
//! 1/γ. Of the labels at a vertex those stay that no other beats in cost and all levels. A label knows its path, so
//! that what the path has already taken of a host or a link is respected.

use std::{num::NonZeroUsize, time::Duration};

use cotorra_graph::{LinkId, NodeId, Placement, VnfId};

use crate::{
    model::{Infrastructure, Service, Vnf},
    paths::{Figures, Paths},
};

/// How a placement is sought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// γ: levels that each KPI's budget is divided into.
    pub gamma: u16,
    /// Paths that are tried between two hosts.
    pub k_paths: NonZeroUsize,
    /// Where no placement keeps the KPIs, give the one that exceeds them least; its slack tells by how much.
    pub relax: bool,
}

/// Where a service goes.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// a(n) for each VNF, in order.
    pub placement: Vec<Placement>,
    /// a(n1,n2): the links from each VNF to the next.
    pub paths: Vec<Vec<LinkId>>,
    /// The radio unit that the robot uses; `None` where nothing leaves it.
    pub attachment: Option<NodeId>,
    /// Price of the CPUs.
    pub cost: f64,
    /// Service time to expect.
    pub service_time: Duration,
    /// Probability that all that it uses works.
    pub reliability: f64,
    /// What the KPIs leave.
    pub slack: Slack,
}

/// By how much KPIs are kept; negative where they are relaxed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slack {
    /// Target less service time, milliseconds.
    pub service_time_ms: f64,
    /// Reliability less its target; `None` without one.
    pub reliability: Option<f64>,
}

/// Why a service cannot be placed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Infeasible {
    /// γ is none.
    #[error("γ = 0 leaves no level to count in; it is 1 or more")]
    NoLevels,
    /// More packets come than a VNF can process.
    #[error("`{vnf}` gets as many packets as it can process, or more; its queue grows forever")]
    Overloaded {
        /// The VNF.
        vnf: VnfId,
    },
    /// No host has what a VNF needs.
    #[error(
        "`{vnf}` needs {cpus} CPUs and {memory_bytes} B of memory, which none of its {hosts} hosts has free; the most free is {most_cpus} CPUs"
    )]
    Capacity {
        /// The VNF.
        vnf: VnfId,
        /// CPUs that it needs.
        cpus: f64,
        /// Memory that it needs.
        memory_bytes: u64,
        /// How many nodes could carry it.
        hosts: usize,
        /// CPUs of the one that has most free.
        most_cpus: f64,
    },
    /// No host of a VNF can be reached from where those before it can be.
    #[error("no host with {cpus} CPUs left for `{vnf}` can be reached with {mbps} Mbit/s free")]
    Unreachable {
        /// The VNF.
        vnf: VnfId,
        /// CPUs that it needs.
        cpus: f64,
        /// What it exchanges with the one before it.
        mbps: f64,
    },
    /// Every placement takes too long.
    #[error("the service time is {least:?} at the least, {excess:?} above its target of {target:?}")]
    ServiceTime {
        /// What can be reached.
        least: Duration,
        /// The KPI.
        target: Duration,
        /// The difference.
        excess: Duration,
    },
    /// Every placement fails too often.
    #[error("the reliability is {most:.6} at the most, {lack:.2e} below its target of {target}")]
    Reliability {
        /// What can be reached.
        most: f64,
        /// The KPI.
        target: f64,
        /// The difference.
        lack: f64,
    },
    /// Each KPI can be kept, but not both by one placement.
    #[error(
        "{service_time:?} is the least service time with the reliability that is needed, {target:?} is its target; without it the target could be kept"
    )]
    Together {
        /// The least service time of those that are reliable enough.
        service_time: Duration,
        /// The KPI.
        target: Duration,
    },
    /// A placement keeps the KPIs, but not when its hops are rounded up.
    #[error(
        "a placement keeps the KPIs exactly, but none does with hops rounded up to levels of 1/{gamma}; a higher γ finds one"
    )]
    Resolution {
        /// γ.
        gamma: u16,
    },
}

/// Levels of service time and of unreliability.
type Levels = [u64; 2];

/// A VNF on a host, and how it came there.
struct Label {
    cost: f64,
    /// How late the wireless link comes in the infrastructure; breaks ties of cost.
    preference: usize,
    levels: Levels,
    node: usize,
    /// The label of the VNF before.
    before: Option<usize>,
    links: Vec<usize>,
    exact: Figures,
}

impl Label {
    /// Whether it makes another one needless.
    fn beats(&self, cost: f64, preference: usize, levels: Levels) -> bool {
        (self.cost, self.preference) <= (cost, preference)
            && self.levels[0] <= levels[0]
            && self.levels[1] <= levels[1]
    }
}

/// A way from one host to the next.
struct Way {
    from: usize,
    to: usize,
    /// Wireless links at its ends.
    wireless: [Option<usize>; 2],
    wired: Wired,
}

/// The wired part of a way.
enum Wired {
    None,
    Shortest(usize, usize),
    Links(Vec<usize>),
}

/// Places a service at the least cost that keeps all its KPIs. Of equals, the one over the first wireless link is
/// taken.
///
/// # Errors
/// [`Infeasible`]: what stands against it, and by how much.
pub fn place(
    service: &Service,
    infrastructure: &Infrastructure,
    search: Search,
) -> Result<Placed, Infeasible> {
    if search.gamma == 0 {
        return Err(Infeasible::NoLevels);
    }
    let mut decision = Decision::new(service, infrastructure, search)?;
    if let Ok(labels) = decision.explore(u64::from(search.gamma))
        && let Some(&best) = labels.iter().min_by(|&&a, &&b| decision.order(a, b))
    {
        return Ok(decision.read(best));
    }
    // Without limits, and nearly exact, the labels tell what can be reached at all.
    decision.gamma = search.gamma.max(NEARLY_EXACT);
    let labels = decision.explore(u64::MAX).map_err(|vnf| decision.unreachable(vnf))?;
    let excess = |label: usize| {
        let over = decision.labels[label].levels.map(|level| level.saturating_sub(decision.gamma.into()));
        over[0].max(over[1])
    };
    match labels.iter().copied().min_by(|&a, &b| excess(a).cmp(&excess(b)).then_with(|| decision.order(a, b)))
    {
        Some(least) if search.relax => Ok(decision.read(least)),
        _ => Err(decision.explain(&labels, search.gamma)),
    }
}

/// γ of the search that tells what can be reached where nothing keeps the KPIs.
const NEARLY_EXACT: u16 = 1000;

struct Decision<'a> {
    service: &'a Service,
    infrastructure: &'a Infrastructure,
    gamma: u16,
    paths: Paths<'a>,
    processing_ns: Vec<u64>,
    /// Negative logarithm of each node's reliability.
    node_failure: Vec<f64>,
    /// Sum of the rates up to each VNF: what a link needs at most.
    rate_up_to: Vec<f64>,
    /// Wireless links of each robot.
    wireless: Vec<Vec<usize>>,
    labels: Vec<Label>,
}

impl<'a> Decision<'a> {
    fn new(
        service: &'a Service,
        infrastructure: &'a Infrastructure,
        search: Search,
    ) -> Result<Self, Infeasible> {
        let mut processing_ns = Vec::new();
        for vnf in &service.vnfs {
            let delay = vnf.processing.map(|queue| queue.delay());
            let delay = delay.unwrap_or(Some(Duration::ZERO));
            let delay = delay.ok_or_else(|| Infeasible::Overloaded { vnf: vnf.id.clone() })?;
            processing_ns.push(u64::try_from(delay.as_nanos()).unwrap_or(u64::MAX));
            let fits = |&host: &usize| {
                let node = &infrastructure.nodes[host];
                fits(node.cpus, vnf.cpus) && vnf.memory_bytes <= node.memory_bytes
            };
            if !vnf.hosts.iter().any(fits) {
                let most = vnf.hosts.iter().map(|&host| infrastructure.nodes[host].cpus);
                return Err(Infeasible::Capacity {
                    vnf: vnf.id.clone(),
                    cpus: vnf.cpus,
                    memory_bytes: vnf.memory_bytes,
                    hosts: vnf.hosts.len(),
                    most_cpus: most.fold(0.0, f64::max),
                });
            }
        }
        let mut wireless = vec![Vec::new(); infrastructure.nodes.len()];
        for (i, link) in infrastructure.links.iter().enumerate().filter(|(_, link)| link.wireless) {
            wireless[link.ends[0]].push(i);
        }
        let rates = service.vnfs.iter().scan(0.0, |sum, vnf| {
            *sum += vnf.rate_bps;
            Some(*sum)
        });
        Ok(Self {
            service,
            infrastructure,
            gamma: search.gamma,
            paths: Paths::new(infrastructure, search.k_paths.get()),
            processing_ns,
            node_failure: infrastructure.nodes.iter().map(|node| -node.reliability.ln()).collect(),
            rate_up_to: rates.collect(),
            wireless,
            labels: Vec::new(),
        })
    }

    /// The labels of the last VNF whose levels stay within a limit, or the first VNF that gets none.
    fn explore(&mut self, limit: u64) -> Result<Vec<usize>, usize> {
        self.labels.clear();
        let mut layer = Vec::new();
        for i in 0..self.service.vnfs.len() {
            // Of each host, the labels that none beats.
            let mut fronts: Vec<Vec<usize>> = vec![Vec::new(); self.infrastructure.nodes.len()];
            if i == 0 {
                for &host in &self.service.vnfs[0].hosts {
                    let stay = Way { from: host, to: host, wireless: [None; 2], wired: Wired::None };
                    self.reach(i, None, stay, [Figures::default(); 3], limit, &mut fronts);
                }
            }
            for &before in &layer {
                for &host in &self.service.vnfs[i].hosts {
                    self.go(i, before, host, limit, &mut fronts);
                }
            }
            layer = self.service.vnfs[i]
                .hosts
                .iter()
                .flat_map(|&host| std::mem::take(&mut fronts[host]))
                .collect();
            if layer.is_empty() {
                return Err(i);
            }
        }
        Ok(layer)
    }

    /// Tries the ways from a label's host to one for the next VNF.
    fn go(&mut self, i: usize, before: usize, to: usize, limit: u64, fronts: &mut [Vec<usize>]) {
        let from = self.labels[before].node;
        if from == to {
            let stay = Way { from, to, wireless: [None; 2], wired: Wired::None };
            self.reach(i, Some(before), stay, [Figures::default(); 3], limit, fronts);
            return;
        }
        let rate = self.service.vnfs[i].rate_bps;
        for first in self.wireless_ends(from, rate) {
            for last in self.wireless_ends(to, rate) {
                let wireless = [first, last];
                let unit = |link: usize| self.infrastructure.links[link].ends[1];
                let (start, end) = (first.map_or(from, unit), last.map_or(to, unit));
                let at_ends = wireless.map(|l| l.map_or(Figures::default(), |link| self.paths.figures(link)));
                let Some(shortest) = self.paths.shortest(start, rate).figures(end) else { continue };
                let way = Way { from, to, wireless, wired: Wired::Shortest(start, end) };
                let hops = [at_ends[0], shortest, at_ends[1]];
                let carried = self.reach(i, Some(before), way, hops, limit, fronts);
                // Longer paths help only where the shortest is full, or fails.
                let reliable = self.service.reliability.is_none() || shortest.failure == 0.0;
                if carried && reliable {
                    continue;
                }
                for path in self.paths.next(start, end, rate).iter() {
                    let way = Way { from, to, wireless, wired: Wired::Links(path.links.clone()) };
                    let hops = [at_ends[0], path.figures, at_ends[1]];
                    self.reach(i, Some(before), way, hops, limit, fronts);
                }
            }
        }
    }

    /// The wireless links that a way can begin or end with at a node; none at what is wired.
    fn wireless_ends(&self, node: usize, rate: f64) -> Vec<Option<usize>> {
        let all = &self.wireless[node];
        if all.is_empty() {
            return vec![None];
        }
        all.iter()
            .filter(|&&link| self.infrastructure.links[link].free_bps >= rate)
            .map(|&link| Some(link))
            .collect()
    }

    /// Adds the label of a VNF that is reached so, unless its levels exceed the limit or another label beats it.
    /// Whether the way can carry it at all.
    fn reach(
        &mut self,
        i: usize,
        before: Option<usize>,
        way: Way,
        hops: [Figures; 3],
        limit: u64,
        fronts: &mut [Vec<usize>],
    ) -> bool {
        let vnf = &self.service.vnfs[i];
        let last = before.map(|before| &self.labels[before]);
        // A host counts once, however many VNFs it carries.
        let known = self.chain(before).any(|label| label.node == way.to);
        let failure = if known { 0.0 } else { self.node_failure[way.to] };
        let own = Figures { delay_ns: self.processing_ns[i], failure };
        // What the host does is part of the hop that leads to it.
        let rounded = match way.wireless[1] {
            None => [hops[0], hops[1].and(own), hops[2]],
            Some(_) => [hops[0], hops[1], hops[2].and(own)],
        };
        let levels = rounded.iter().fold(last.map_or([0; 2], |label| label.levels), |sum, hop| {
            let hop = self.levels(*hop);
            [sum[0].saturating_add(hop[0]), sum[1].saturating_add(hop[1])]
        });
        let cost = last.map_or(0.0, |label| label.cost) + vnf.cpus * self.infrastructure.nodes[way.to].cost;
        let used = way.wireless.iter().flatten().max().copied().unwrap_or(0);
        let preference = last.map_or(0, |label| label.preference).max(used);
        let beaten = |&label: &usize| self.labels[label].beats(cost, preference, levels);
        let needless = levels.iter().any(|&level| level > limit) || fronts[way.to].iter().any(beaten);
        if needless || !self.host_fits(before, vnf, way.to) {
            return true;
        }
        let Some(links) = self.links_if_free(i, before, &way) else { return false };
        let labels = &self.labels;
        fronts[way.to].retain(|&label| {
            let other = &labels[label];
            let beats = (cost, preference) <= (other.cost, other.preference)
                && levels[0] <= other.levels[0]
                && levels[1] <= other.levels[1];
            !beats
        });
        fronts[way.to].push(self.labels.len());
        let exact = hops.iter().fold(own, |sum, hop| sum.and(*hop));
        let exact = last.map_or(exact, |label| label.exact.and(exact));
        self.labels.push(Label { cost, preference, levels, node: way.to, before, links, exact });
        true
    }

    /// A hop's shares of the budgets, in levels, rounded up.
    fn levels(&self, hop: Figures) -> Levels {
        let level = |amount: f64, budget: f64| {
            if amount <= 0.0 {
                return 0;
            }
            // A share that is a whole number of levels but for rounding errors is that number.
            (amount / budget * f64::from(self.gamma) - 1e-9).ceil() as u64
        };
        let target = self.service.reliability.map_or(f64::INFINITY, |target| -target.ln());
        [level(hop.delay_ns as f64, self.service.service_time.as_nanos() as f64), level(hop.failure, target)]
    }

    /// The labels from one back to the first VNF's.
    fn chain(&self, from: Option<usize>) -> impl Iterator<Item = &Label> {
        std::iter::successors(from.map(|label| &self.labels[label]), |label| {
            label.before.map(|before| &self.labels[before])
        })
    }

    /// Whether a host has what a VNF needs, besides what the VNFs before it take there.
    fn host_fits(&self, before: Option<usize>, vnf: &Vnf, host: usize) -> bool {
        let (mut cpus, mut memory) = (vnf.cpus, vnf.memory_bytes);
        let vnfs = before.map_or(0, |_| self.chain(before).count());
        for (label, vnf) in self.chain(before).zip(self.service.vnfs[..vnfs].iter().rev()) {
            if label.node == host {
                cpus += vnf.cpus;
                memory = memory.saturating_add(vnf.memory_bytes);
            }
        }
        let node = &self.infrastructure.nodes[host];
        fits(node.cpus, cpus) && memory <= node.memory_bytes
    }

    /// A way's links, if each has its rate free besides what the ways before it take, and the robot at its ends has
    /// used no other radio unit.
    fn links_if_free(&self, i: usize, before: Option<usize>, way: &Way) -> Option<Vec<usize>> {
        let rate = self.service.vnfs[i].rate_bps;
        let wired = match &way.wired {
            Wired::None => Vec::new(),
            Wired::Shortest(from, to) => self.paths.known(*from, *to, rate),
            Wired::Links(links) => links.clone(),
        };
        let ends = way.wireless;
        let links: Vec<_> = ends[0].into_iter().chain(wired).chain(ends[1]).collect();
        let specs = &self.infrastructure.links;
        let another = |robot: usize, unit: usize| {
            let mut used = self.chain(before).flat_map(|label| &label.links);
            used.any(|&link| specs[link].wireless && specs[link].ends[0] == robot && link != unit)
        };
        if ends[0].is_some_and(|unit| another(way.from, unit))
            || ends[1].is_some_and(|unit| another(way.to, unit))
        {
            return None;
        }
        let free = |&link: &usize| {
            if specs[link].free_bps >= self.rate_up_to[i] {
                return true;
            }
            let before: f64 = self
                .chain(before)
                .zip(self.service.vnfs[..i].iter().rev())
                .filter(|(label, _)| label.links.contains(&link))
                .map(|(_, vnf)| vnf.rate_bps)
                .sum();
            fits(specs[link].free_bps, before + rate)
        };
        links.iter().all(free).then_some(links)
    }

    /// Cheaper first, then over the earlier wireless link, then faster, then more reliable.
    fn order(&self, a: usize, b: usize) -> std::cmp::Ordering {
        let (a, b) = (&self.labels[a], &self.labels[b]);
        let by_cost = a.cost.total_cmp(&b.cost).then(a.preference.cmp(&b.preference));
        by_cost
            .then(a.exact.delay_ns.cmp(&b.exact.delay_ns))
            .then(a.exact.failure.total_cmp(&b.exact.failure))
    }

    fn read(&self, label: usize) -> Placed {
        let mut chain: Vec<_> = self.chain(Some(label)).collect();
        chain.reverse();
        let Infrastructure { nodes, links } = self.infrastructure;
        let placement = chain.iter().zip(&self.service.vnfs);
        let placement = placement
            .map(|(label, vnf)| Placement { vnf: vnf.id.clone(), node: nodes[label.node].id.clone() })
            .collect();
        let name = |label: &&Label| label.links.iter().map(|&link| links[link].id.clone()).collect();
        let mut used: Vec<usize> = chain.iter().flat_map(|label| label.links.iter().copied()).collect();
        let attachment = used.iter().find(|&&link| links[link].wireless);
        let attachment = attachment.map(|&link| nodes[links[link].ends[1]].id.clone());
        // All that is used must work, each once.
        used.sort_unstable();
        used.dedup();
        let mut hosts: Vec<_> = chain.iter().map(|label| label.node).collect();
        hosts.sort_unstable();
        hosts.dedup();
        let reliability = used.iter().map(|&link| links[link].reliability).product::<f64>()
            * hosts.iter().map(|&host| nodes[host].reliability).product::<f64>();
        let Label { cost, exact, .. } = self.labels[label];
        let service_time = Duration::from_nanos(exact.delay_ns);
        let slack = Slack {
            service_time_ms: self.service.service_time.as_secs_f64() * 1e3 - service_time.as_secs_f64() * 1e3,
            reliability: self.service.reliability.map(|target| reliability - target),
        };
        let paths = chain.iter().skip(1).map(name).collect();
        Placed { placement, paths, attachment, cost, service_time, reliability, slack }
    }

    fn unreachable(&self, vnf: usize) -> Infeasible {
        let Vnf { id, cpus, rate_bps, .. } = &self.service.vnfs[vnf];
        Infeasible::Unreachable { vnf: id.clone(), cpus: *cpus, mbps: rate_bps / 1e6 }
    }

    /// What stands against all of these.
    fn explain(&self, labels: &[usize], gamma: u16) -> Infeasible {
        let target = self.service.service_time;
        let all = || labels.iter().map(|&label| self.read(label));
        let least = all().map(|placed| placed.service_time).min().unwrap_or(target);
        if least > target {
            return Infeasible::ServiceTime { least, target, excess: least - target };
        }
        let reliable = |placed: &Placed| placed.slack.reliability.is_none_or(|slack| slack >= 0.0);
        let enough = all().filter(reliable).map(|placed| placed.service_time).min();
        match (enough, self.service.reliability) {
            (None, Some(target)) => {
                let most = all().map(|placed| placed.reliability).fold(0.0, f64::max);
                Infeasible::Reliability { most, target, lack: target - most }
            }
            (Some(service_time), _) if service_time > target => Infeasible::Together { service_time, target },
            _ => Infeasible::Resolution { gamma },
        }
    }
}

/// Whether so much is free, but for rounding errors of sums.
fn fits(free: f64, needed: f64) -> bool {
    needed <= free + free.abs().min(1e12) * 1e-9
}
