//! The search through the expanded decision graph.
//!
//! A vertex is a host that can carry the next VNF; the way to a radio unit is a hop of its own. A hop weighs its share
//! of each budget, w = (delay / D, log reliability / log H), rounded up to whole levels of 1/γ. Labels are taken up
//! cheapest first, with what must still come counted at its least, so that the first that reaches the last VNF is the
//! cheapest. A label knows its path: what that has taken of hosts and links is not offered twice. For that same reason
//! a label that beats another in cost and levels does not make it needless: it may have taken what a later VNF needs.
//! Some of those that are beaten are therefore kept.

use std::{cmp::Reverse, collections::BinaryHeap, rc::Rc, time::Duration};

use cotorra_graph::Placement;

use crate::{
    model::{Infrastructure, Node, Service},
    paths::{Figures, Paths, Shortest, Tree, fits},
    search::{Infeasible, Placed, Search, Slack},
};

/// Service time and unreliability: a figure of each.
type Pair<T> = [T; 2];

/// Treatment of a KPI by a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kpi {
    /// The KPI is kept.
    Kept,
    /// The KPI is exceeded as little as possible, at any cost.
    Relaxed,
    /// The KPI is ignored.
    Ignored,
}

/// γ of a search for what can be reached where nothing keeps the KPIs: a level is next to nothing.
pub(crate) const EXACTLY: f64 = 1e9;

/// Order in which labels are explored: levels beyond the budgets and cost, both with the least that must still follow;
/// then the index of the radio unit, delay and unreliability.
type Rank = (u64, u64, usize, u64, u64);

/// A VNF on a host, and the step that put it there.
#[derive(Debug)]
struct Label {
    vnf: usize,
    node: usize,
    cost: u64,
    /// Index of the wireless link in the infrastructure; breaks ties of cost.
    preference: usize,
    levels: Pair<u64>,
    exact: Figures,
    /// The label of the VNF before.
    before: Option<usize>,
    way: Way,
    /// Whether a later VNF can miss what its way, or one before, took of a link.
    narrow: bool,
}

/// A way from one host to the next.
#[derive(Debug, Clone)]
struct Way {
    /// Wireless links at its ends.
    wireless: Pair<Option<usize>>,
    wired: Wired,
    /// Figures of the wireless link at the beginning, the wired part, and the wireless link at the end.
    hops: [Figures; 3],
    /// Free rate on the narrowest link, bit/s.
    free_bps: f64,
}

impl Way {
    /// Makes the path from a host to itself.
    fn stay() -> Self {
        let hops = [Figures::default(); 3];
        Self { wireless: [None; 2], wired: Wired::Nothing, hops, free_bps: f64::INFINITY }
    }
}

/// The wired part of a way.
#[derive(Debug, Clone)]
enum Wired {
    Nothing,
    /// The path that a tree has to a node.
    Tree(Rc<Tree>, usize),
}

impl Wired {
    fn links(&self) -> Vec<usize> {
        match self {
            Self::Nothing => Vec::new(),
            Self::Tree(tree, to) => tree.links(*to),
        }
    }
}

/// State that all searches of a decision share.
pub(crate) struct Decision<'a> {
    service: &'a Service,
    infrastructure: &'a Infrastructure,
    rivals: usize,
    paths: Paths<'a>,
    processing_ns: Vec<u64>,
    /// Negative logarithm of each node's reliability; zero where it has no bound.
    node_failure: Vec<f64>,
    /// Whole units of cost in one of the infrastructure's, so that sums are exact and equals are equal.
    cost_units: f64,
    /// The wireless links that a way can begin or end with at each node; the one `None` where it is wired.
    ends: Vec<Vec<Option<usize>>>,
    /// For each VNF, the needs of those after it.
    after: Vec<Need>,
}

/// Needs of VNFs.
#[derive(Debug, Clone, Default)]
struct Need {
    cpus: f64,
    memory_bytes: u64,
    rate_bps: f64,
    /// Lowest cost.
    cost: u64,
    /// Delay from each node, at the least, nanoseconds.
    delay_ns: Vec<u64>,
    /// One of them has a robot for a host.
    robot: bool,
}

impl<'a> Decision<'a> {
    pub(crate) fn new(
        service: &'a Service,
        infrastructure: &'a Infrastructure,
        search: Search,
    ) -> Result<Self, Infeasible> {
        let nodes = &infrastructure.nodes;
        let mut processing_ns = Vec::new();
        for vnf in &service.vnfs {
            let delay = vnf.processing.map(|queue| queue.delay());
            let delay = delay.unwrap_or(Some(Duration::ZERO));
            let delay = delay.ok_or_else(|| Infeasible::Overloaded { vnf: vnf.id.clone() })?;
            processing_ns.push(u64::try_from(delay.as_nanos()).unwrap_or(u64::MAX));
            if !vnf.hosts.iter().any(|&host| nodes[host].carries(vnf.cpus, vnf.memory_bytes)) {
                return Err(Infeasible::Capacity {
                    vnf: vnf.id.clone(),
                    cpus: vnf.cpus,
                    memory_bytes: vnf.memory_bytes,
                    hosts: vnf.hosts.len(),
                    most_cpus: vnf.hosts.iter().map(|&host| nodes[host].cpus).fold(0.0, f64::max),
                });
            }
        }
        let mut ends = vec![Vec::new(); nodes.len()];
        for (i, link) in infrastructure.links.iter().enumerate().filter(|(_, link)| link.wireless) {
            ends[link.ends[0]].push(Some(i));
        }
        ends.iter_mut().filter(|ends| ends.is_empty()).for_each(|ends| ends.push(None));
        let dearest = nodes.iter().map(|node| node.cost).fold(0.0, f64::max);
        let all_cpus: f64 = service.vnfs.iter().map(|vnf| vnf.cpus).sum();
        let counts = service.reliability.is_some();
        let mut decision = Self {
            service,
            infrastructure,
            rivals: search.rivals.get(),
            paths: Paths::new(infrastructure, search.k_paths.get(), counts),
            processing_ns,
            node_failure: nodes.iter().map(|n| if counts { -n.reliability.ln() } else { 0.0 }).collect(),
            cost_units: (1u64 << 48) as f64 / (dearest * all_cpus).max(f64::MIN_POSITIVE),
            ends,
            after: Vec::new(),
        };
        decision.after = decision.needs();
        Ok(decision)
    }

    /// Computes the needs of the VNFs after each, from the last one back.
    fn needs(&self) -> Vec<Need> {
        let mut needs = vec![Need::default()];
        for (i, vnf) in self.service.vnfs.iter().enumerate().skip(1).rev() {
            let after = &needs[needs.len() - 1];
            let begin = vnf.hosts.iter().map(|&host| {
                let after = after.delay_ns.get(host).copied().unwrap_or(0);
                let delay_ns = after.saturating_add(self.processing_ns[i]);
                (host, Figures { delay_ns, failure: 0.0 })
            });
            let need = Need {
                cpus: after.cpus + vnf.cpus,
                memory_bytes: after.memory_bytes.saturating_add(vnf.memory_bytes),
                rate_bps: after.rate_bps + vnf.rate_bps,
                cost: after.cost + vnf.hosts.iter().map(|&host| self.cost(i, host)).min().unwrap_or(0),
                delay_ns: self.paths.to_any(begin.collect(), vnf.rate_bps),
                robot: after.robot || vnf.hosts.iter().any(|&host| self.ends[host][0].is_some()),
            };
            needs.push(need);
        }
        needs.reverse();
        needs
    }

    /// Returns the price of a VNF on a host.
    fn cost(&self, vnf: usize, host: usize) -> u64 {
        (self.service.vnfs[vnf].cpus * self.infrastructure.nodes[host].cost * self.cost_units).round() as u64
    }
}

/// One search through the expanded decision graph.
pub(crate) struct Exploration<'d, 'a> {
    decision: &'d mut Decision<'a>,
    gamma: u64,
    kpis: Pair<Kpi>,
    /// Whether cost matters, and which radio unit is taken.
    priced: bool,
    /// Levels in a nanosecond, and in a unit of unreliability.
    scale: Pair<f64>,
    labels: Vec<Label>,
    /// Labels of each VNF on each host.
    fronts: Vec<Vec<usize>>,
    queue: BinaryHeap<Reverse<(Rank, usize)>>,
    /// Rate that the continued path sends over each link, bit/s; `None` for unused links.
    used: Vec<Option<f64>>,
}

impl<'d, 'a> Exploration<'d, 'a> {
    pub(crate) fn new(decision: &'d mut Decision<'a>, gamma: f64, kpis: Pair<Kpi>, priced: bool) -> Self {
        let Service { vnfs, service_time, reliability } = decision.service;
        let budgets =
            [service_time.as_nanos() as f64, reliability.map_or(f64::INFINITY, |target| -target.ln())];
        let fronts = vec![Vec::new(); vnfs.len() * decision.infrastructure.nodes.len()];
        let scale = budgets.map(|budget| gamma / budget);
        let gamma = gamma as u64;
        let used = vec![None; decision.infrastructure.links.len()];
        Self {
            decision,
            gamma,
            kpis,
            priced,
            scale,
            labels: Vec::new(),
            fronts,
            queue: BinaryHeap::new(),
            used,
        }
    }

    /// The best placement, or the first VNF that gets none.
    pub(crate) fn run(mut self) -> Result<Placed, usize> {
        for host in self.decision.service.vnfs[0].hosts.clone() {
            self.reach(None, host, Way::stay());
        }
        let last = self.decision.service.vnfs.len() - 1;
        let mut farthest = None;
        while let Some(Reverse((_, at))) = self.queue.pop() {
            farthest = farthest.max(Some(self.labels[at].vnf));
            if self.labels[at].vnf == last {
                return Ok(self.read(at));
            }
            // A later state may have beaten it.
            if !self.is_needless(&self.labels[at], Some(at)) {
                let used = self.taken_of_links(&self.labels[at]);
                used.iter().for_each(|&(link, sent)| self.used[link] = Some(sent));
                self.go_on(at);
                used.iter().for_each(|(link, _)| self.used[*link] = None);
            }
        }
        Err(farthest.map_or(0, |vnf| vnf + 1))
    }

    /// Tries the ways from a label's host to those for the next VNF.
    fn go_on(&mut self, before: usize) {
        let Label { vnf, node: from, .. } = self.labels[before];
        let (service, links) = (self.decision.service, &self.decision.infrastructure.links);
        let next = &service.vnfs[vnf + 1];
        let rate = next.rate_bps;
        if next.hosts.contains(&from) {
            self.reach(Some(before), from, Way::stay());
        }
        let unit = |link: usize| links[link].ends[1];
        let wide = |link: &Option<usize>| link.is_none_or(|link| links[link].free_bps >= rate);
        for first in self.decision.ends[from].clone().into_iter().filter(wide) {
            let start = first.map_or(from, unit);
            let mut trees = self.decision.paths.shortest(start, rate);
            for &to in next.hosts.iter().filter(|&&to| to != from) {
                for place in 0..self.decision.ends[to].len() {
                    let last = self.decision.ends[to][place];
                    if wide(&last) {
                        let end = last.map_or(to, unit);
                        self.go_to(before, to, [first, last], [start, end], &mut trees);
                    }
                }
            }
        }
    }

    /// Tries the ways from a label's host to another over these wireless links, between whose other ends it is wired.
    fn go_to(
        &mut self,
        before: usize,
        to: usize,
        wireless: Pair<Option<usize>>,
        [start, end]: [usize; 2],
        trees: &mut Shortest,
    ) {
        let [first, last] = wireless.map(|link| self.over_the_air(link));
        let way = |wired, figures, free_bps: f64| Way {
            wireless,
            wired,
            hops: [first.0, figures, last.0],
            free_bps: free_bps.min(first.1).min(last.1),
        };
        let over = |tree: &Rc<Tree>| Wired::Tree(Rc::clone(tree), end);
        let Some((fastest, free_bps)) = trees.fastest.to(end) else { return };
        let figures = self.anew(fastest, trees.fastest.walk(end));
        let finds_room = self.reach(Some(before), to, way(over(&trees.fastest), figures, free_bps));
        // Another path helps where it fails less often …
        if let Some(tree) = &trees.safest
            && let Some((safest, free_bps)) = tree.to(end)
            && safest.failure < fastest.failure
        {
            let figures = self.anew(safest, tree.walk(end));
            self.reach(Some(before), to, way(over(tree), figures, free_bps));
        }
        // … or where the fastest is full of what the service sends over it already.
        if !finds_room {
            let rate = self.decision.service.vnfs[self.labels[before].vnf + 1].rate_bps;
            let Some(tree) = self.decision.paths.around(trees, start, rate, &self.used) else { return };
            if let Some((figures, free_bps)) = tree.to(end) {
                let figures = self.anew(figures, tree.walk(end));
                self.reach(Some(before), to, way(over(&tree), figures, free_bps));
            }
        }
    }

    /// Returns the figures of a wireless link now, and its free rate; zero and infinite without a link.
    fn over_the_air(&self, link: Option<usize>) -> (Figures, f64) {
        link.map_or((Figures::default(), f64::INFINITY), |link| {
            let figures = self.decision.paths.figures(link);
            let figures = if self.used[link].is_some() { figures.again() } else { figures };
            (figures, self.decision.infrastructure.links[link].free_bps)
        })
    }

    /// Returns the figures of a path without the failure probability of links that are in use already.
    fn anew(&self, figures: Figures, path: impl Iterator<Item = usize>) -> Figures {
        if self.decision.service.reliability.is_none() {
            return figures;
        }
        let again = path.filter(|&link| self.used[link].is_some());
        let known: f64 = again.map(|link| self.decision.paths.figures(link).failure).sum();
        Figures { failure: (figures.failure - known).max(0.0), ..figures }
    }

    /// Adds the label of a VNF that is reached so, unless it cannot be, exceeds what is to be kept, or is needless.
    /// False where another way to the same host could find the room that this one does not.
    fn reach(&mut self, before: Option<usize>, node: usize, way: Way) -> bool {
        let decision = &*self.decision;
        let last = before.map(|before| &self.labels[before]);
        let vnf = last.map_or(0, |label| label.vnf + 1);
        let after = &decision.after[vnf];
        // A part in use fails only once: the reliability of the rest is unknown.
        let delay_ns = after.delay_ns.get(node).copied().unwrap_or(0);
        let to_come = Figures { delay_ns, failure: 0.0 };
        // A host counts once, however many VNFs it carries.
        let known = || self.chain(before).any(|label| label.node == node);
        let failure = decision.node_failure[node];
        let failure = if failure > 0.0 && known() { 0.0 } else { failure };
        let own = Figures { delay_ns: decision.processing_ns[vnf], failure };
        // The host's work is part of the hop that leads to it.
        let rounded = match way.wireless[1] {
            None => [way.hops[0], way.hops[1].and(own), way.hops[2]],
            Some(_) => [way.hops[0], way.hops[1], way.hops[2].and(own)],
        };
        let mut levels = last.map_or([0; 2], |label| label.levels);
        for hop in rounded {
            let hop = self.levels(hop);
            levels = [levels[0].saturating_add(hop[0]), levels[1].saturating_add(hop[1])];
        }
        let to_come = self.levels(to_come);
        let mut excess = 0;
        for (kpi, so_far, to_come) in [(0, levels[0], to_come[0]), (1, levels[1], to_come[1])] {
            let beyond = so_far.saturating_add(to_come).saturating_sub(self.gamma);
            match self.kpis[kpi] {
                Kpi::Kept if beyond > 0 => return true,
                Kpi::Relaxed => excess = excess.max(beyond),
                Kpi::Kept | Kpi::Ignored => {}
            }
        }
        let (mut cost, mut preference, mut cost_to_come) = (0, 0, 0);
        if self.priced {
            cost = last.map_or(0, |label| label.cost) + decision.cost(vnf, node);
            cost_to_come = after.cost;
            let used = way.wireless.iter().flatten().max().copied().unwrap_or(0);
            preference = last.map_or(0, |label| label.preference).max(used);
        }
        let exact = way.hops.iter().fold(own, |sum, hop| sum.and(*hop));
        let exact = last.map_or(exact, |label| label.exact.and(exact));
        let narrow = way.free_bps < decision.after[0].rate_bps || last.is_some_and(|label| label.narrow);
        let label = Label { vnf, node, cost, preference, levels, exact, before, way, narrow };
        if !self.host_fits(&label) || self.is_needless(&label, None) {
            return true;
        }
        if !self.links_fit(&label) {
            return false;
        }
        let rank =
            (excess, cost + cost_to_come, preference, exact.delay_ns, exact.failure.max(0.0).to_bits());
        let front = self.front(&label);
        self.fronts[front].push(self.labels.len());
        self.queue.push(Reverse((rank, self.labels.len())));
        self.labels.push(label);
        true
    }

    /// Shares of the budgets, in levels, rounded up; none of what does not matter.
    fn levels(&self, figures: Figures) -> Pair<u64> {
        let level = |kpi: usize, amount: f64| {
            // A share that is a whole number of levels but for rounding errors is that number.
            if self.kpis[kpi] == Kpi::Ignored { 0 } else { (amount * self.scale[kpi] - 1e-9).ceil() as u64 }
        };
        [level(0, figures.delay_ns as f64), level(1, figures.failure)]
    }

    fn front(&self, label: &Label) -> usize {
        label.vnf * self.decision.infrastructure.nodes.len() + label.node
    }

    /// A label's place, or that of the one before it, and so back to the first VNF's.
    fn chain(&self, from: Option<usize>) -> impl Iterator<Item = &Label> {
        std::iter::successors(from.map(|label| &self.labels[label]), |label| {
            label.before.map(|before| &self.labels[before])
        })
    }

    /// A label, which may not be in its place yet, and those before it.
    fn path<'l>(&'l self, label: &'l Label) -> impl Iterator<Item = &'l Label> {
        std::iter::once(label).chain(self.chain(label.before))
    }

    /// CPUs and memory that a path takes of a host.
    fn taken_of_host(&self, label: &Label, host: usize) -> (f64, u64) {
        let vnfs = &self.decision.service.vnfs;
        let here = self.path(label).filter(|label| label.node == host).map(|label| &vnfs[label.vnf]);
        here.fold((0.0, 0), |(cpus, memory), vnf| {
            (cpus + vnf.cpus, u64::saturating_add(memory, vnf.memory_bytes))
        })
    }

    /// The links of a label's way.
    fn links(&self, label: &Label) -> Vec<usize> {
        let [first, last] = label.way.wireless;
        first.into_iter().chain(label.way.wired.links()).chain(last).collect()
    }

    /// Returns the rate that a path takes of each of its links, bit/s.
    fn taken_of_links(&self, label: &Label) -> Vec<(usize, f64)> {
        let mut taken: Vec<(usize, f64)> = Vec::new();
        for label in self.path(label) {
            let rate = self.decision.service.vnfs[label.vnf].rate_bps;
            for link in self.links(label) {
                match taken.iter_mut().find(|(known, _)| *known == link) {
                    Some((_, sum)) => *sum += rate,
                    None => taken.push((link, rate)),
                }
            }
        }
        taken
    }

    /// The wireless link that a path uses.
    fn unit(&self, label: &Label) -> Option<usize> {
        self.path(label).find_map(|label| label.way.wireless[0].or(label.way.wireless[1]))
    }

    /// Whether a label's host has what it needs besides what the path before takes there, and its robot uses no other
    /// radio unit.
    fn host_fits(&self, label: &Label) -> bool {
        let Infrastructure { nodes, links } = self.decision.infrastructure;
        let (cpus, memory) = self.taken_of_host(label, label.node);
        let other = |wireless: usize| {
            let used = self.path(label).flat_map(|label| label.way.wireless).flatten();
            used.into_iter().any(|used| used != wireless && links[used].ends[0] == links[wireless].ends[0])
        };
        nodes[label.node].carries(cpus, memory) && !label.way.wireless.into_iter().flatten().any(other)
    }

    /// Whether the links of a label's way have what it needs besides what the path before takes.
    fn links_fit(&self, label: &Label) -> bool {
        let links = &self.decision.infrastructure.links;
        let free = |(link, taken): (usize, f64)| fits(links[link].free_bps, taken);
        !label.narrow || self.taken_of_links(label).into_iter().all(free)
    }

    /// Whether another label of the same VNF on the same host does all that this one can, or so many beat it that one
    /// of them most likely does.
    fn is_needless(&self, label: &Label, place: Option<usize>) -> bool {
        let mut beaten_by = 0;
        for &other in &self.fronts[self.front(label)] {
            let rival = &self.labels[other];
            let beats = rival.cost <= label.cost
                && rival.preference <= label.preference
                && rival.levels[0] <= label.levels[0]
                && rival.levels[1] <= label.levels[1];
            // Of equals, the first counts.
            let later = place.is_some_and(|place| place <= other) && self.is_equal(rival, label);
            if !beats || later {
                continue;
            }
            beaten_by += 1;
            if beaten_by == self.decision.rivals || self.leaves_as_much(rival, label) {
                return true;
            }
        }
        false
    }

    fn is_equal(&self, a: &Label, b: &Label) -> bool {
        (a.cost, a.preference, a.levels) == (b.cost, b.preference, b.levels)
    }

    /// Whether a path has left all that later VNFs can need and another path leaves.
    fn leaves_as_much(&self, rival: &Label, label: &Label) -> bool {
        let Infrastructure { nodes, links } = self.decision.infrastructure;
        let after = &self.decision.after[rival.vnf];
        if after.delay_ns.is_empty() {
            return true;
        }
        if (after.robot || self.decision.ends[rival.node][0].is_some())
            && self.unit(rival) != self.unit(label)
        {
            return false;
        }
        let host_left = |&Label { node, .. }: &Label| {
            let (cpus, memory) = self.taken_of_host(rival, node);
            let enough = nodes[node].carries(cpus + after.cpus, memory.saturating_add(after.memory_bytes));
            let of_other = self.taken_of_host(label, node);
            enough || (cpus <= of_other.0 && memory <= of_other.1)
        };
        // A host that only the other path knows could be used again without being counted again.
        let known = |other: &Label| {
            self.decision.node_failure[other.node] == 0.0
                || self.path(rival).any(|own| own.node == other.node)
        };
        let links_left = || {
            let of_other = self.taken_of_links(label);
            let left = |(link, taken): (usize, f64)| {
                let other =
                    of_other.iter().find(|(other, _)| *other == link).map_or(0.0, |(_, taken)| *taken);
                fits(links[link].free_bps, taken + after.rate_bps) || taken <= other
            };
            self.taken_of_links(rival).into_iter().all(left)
        };
        self.path(rival).all(host_left) && self.path(label).all(known) && (!rival.narrow || links_left())
    }

    fn read(&self, label: usize) -> Placed {
        let mut chain: Vec<_> = self.chain(Some(label)).collect();
        chain.reverse();
        let service = self.decision.service;
        let Infrastructure { nodes, links } = self.decision.infrastructure;
        let placement = chain.iter().zip(&service.vnfs);
        let placement = placement
            .map(|(label, vnf)| Placement { vnf: vnf.id.clone(), node: nodes[label.node].id.clone().into() })
            .collect();
        let ways: Vec<Vec<usize>> = chain.iter().map(|label| self.links(label)).collect();
        let mut used = ways.concat();
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
        let cost =
            chain.iter().zip(&service.vnfs).map(|(label, vnf)| vnf.cpus * nodes[label.node].cost).sum();
        let service_time = Duration::from_nanos(self.labels[label].exact.delay_ns);
        let slack = Slack {
            service_time_ms: service.service_time.as_secs_f64() * 1e3 - service_time.as_secs_f64() * 1e3,
            reliability: service.reliability.map(|target| reliability - target),
        };
        let name = |way: &Vec<usize>| way.iter().map(|&link| links[link].id.clone()).collect();
        let paths = ways.iter().skip(1).map(name).collect();
        Placed { placement, paths, attachment, cost, service_time, reliability, slack }
    }
}

impl Node {
    /// Whether so much of it is free.
    fn carries(&self, cpus: f64, memory_bytes: u64) -> bool {
        fits(self.cpus, cpus) && memory_bytes <= self.memory_bytes
    }
}
