//! The plug-in's view of the network, kept up to date by events, and the infrastructure that a service sees in it. It
//! remembers instructions that are not done yet, so that the plug-in neither repeats them nor takes their effects for
//! another's.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    Event, HardwareGraph, Instruction, LinkContext, LinkId, NodeId, NodeKind, Nodes, Service, ServiceId,
    Testbed, Timestamp, VnfEvent, VnfId, VnfState, WirelessNetwork,
};
use cotorra_plugin::links::{Beyond, Links, Measurements, Memory, News, RoundTrip};

use crate::model::{self, Infrastructure, Queue};

/// Services whose decisions an event puts in question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Concerned<'e> {
    Nobody,
    All,
    /// All services, as far as measurements count.
    Measured,
    /// All services but that of this VNF, which decided so itself.
    Others(&'e VnfId),
    /// The services of this robot.
    Of(&'e NodeId),
}

impl Concerned<'_> {
    pub(crate) fn includes(self, service: &Service) -> bool {
        match self {
            Self::Nobody | Self::Measured => false,
            Self::All => true,
            Self::Others(own) => !service.vnfs.iter().any(|vnf| vnf.id == *own),
            Self::Of(robot) => service.robot == *robot,
        }
    }
}

/// Figures of the air that a decision counts with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Air {
    Measured,
    Configured,
}

/// The testbed according to its events.
#[derive(Debug)]
pub(crate) struct NetworkView {
    pub(crate) graph: HardwareGraph,
    services: Arc<[Service]>,
    /// a(n).
    placements: BTreeMap<VnfId, Nodes>,
    /// Requested nodes of VNFs that do not serve there yet.
    moves: BTreeMap<VnfId, NodeId>,
    /// The radio units that robots were asked to attach to and are not with yet.
    handovers: BTreeMap<NodeId, NodeId>,
    /// a(n1,n2), in both directions of each virtual link.
    mappings: BTreeMap<(VnfId, VnfId), Vec<LinkId>>,
    /// The paths between nodes that were asked for, and for which service.
    paths: BTreeMap<(NodeId, NodeId), (ServiceId, Vec<LinkId>)>,
    /// Figures of links.
    links: Links,
    now: Timestamp,
}

impl NetworkView {
    /// Creates the view of a testbed as its file has it. With measurements, links count as they are measured, too.
    pub(crate) fn new(testbed: &Testbed, measurements: Option<Measurements>) -> Self {
        Self {
            links: Links::new(testbed, measurements),
            now: Timestamp::ZERO,
            placements: testbed.vnfs().map(|vnf| (vnf.id.clone(), vnf.node.clone())).collect(),
            moves: BTreeMap::new(),
            handovers: BTreeMap::new(),
            mappings: BTreeMap::new(),
            paths: BTreeMap::new(),
            graph: testbed.graph.clone(),
            services: testbed.services.as_slice().into(),
        }
    }

    /// Sets the time.
    pub(crate) fn set_now(&mut self, now: Timestamp) {
        self.now = now;
    }

    /// Learns from an event, and says whose decisions it puts in question.
    pub(crate) fn learn<'e>(&mut self, event: &'e Event) -> Concerned<'e> {
        match event {
            Event::Link(context) => match self.learn_link(self.now, context) {
                News::Configured => Concerned::All,
                News::Measured => Concerned::Measured,
                News::Nothing => Concerned::Nobody,
            },
            Event::Placement(placement) => {
                let before = self.placements.insert(placement.vnf.clone(), placement.node.clone());
                if placement.node.only().is_some_and(|node| self.end_move(&placement.vnf, node)) {
                    Concerned::Others(&placement.vnf)
                } else if before.as_ref() != Some(&placement.node) {
                    Concerned::All
                } else {
                    Concerned::Nobody
                }
            }
            Event::VirtualLink(mapping) => {
                let key = (mapping.from.clone(), mapping.to.clone());
                let before = self.mappings.insert(key, mapping.links.clone());
                let changed = before.as_ref() != Some(&mapping.links);
                if changed { Concerned::Others(&mapping.from) } else { Concerned::Nobody }
            }
            Event::Handover(handover) => {
                let asked = self.handovers.remove(&handover.robot);
                if asked.as_ref() == Some(&handover.to) {
                    Concerned::Nobody
                } else {
                    Concerned::Of(&handover.robot)
                }
            }
            Event::Detached { robot, .. } => {
                self.handovers.remove(robot);
                Concerned::Of(robot)
            }
            // It was there already.
            Event::Robot(context) => {
                if let Some(unit) = context.attached_to() {
                    self.end_handover(&context.robot, unit);
                }
                Concerned::Nobody
            }
            // A rejected or failed action is requested again at the next location, if it is wanted then.
            Event::Decision(decision) if decision.refused.is_some() => {
                match &decision.instruction {
                    Instruction::Place { vnf, node } => drop(self.end_move(vnf, node.first())),
                    Instruction::Attach { robot, radio_unit } => self.end_handover(robot, radio_unit),
                    Instruction::Map { from, to, links, .. } => {
                        let ends = (from.clone(), to.clone());
                        if self.paths.get(&ends).is_some_and(|(_, asked)| asked == links) {
                            self.paths.remove(&ends);
                        }
                    }
                    _ => {}
                }
                Concerned::Nobody
            }
            Event::Vnf(VnfEvent { vnf, node, state: VnfState::Failed, .. }) => {
                self.end_move(vnf, node);
                Concerned::Nobody
            }
            _ => Concerned::Nobody,
        }
    }

    /// Learns the context of a link at a time.
    pub(crate) fn learn_link(&mut self, at: Timestamp, context: &LinkContext) -> News {
        self.links.learn(at, context)
    }

    /// Whether decisions differ from those by configured figures alone, as far as measurements of present count.
    pub(crate) fn any_beyond(&mut self) -> bool {
        self.links.forget(self.now);
        self.links.any_beyond()
    }

    /// Notes the links that a service leaves for these paths, as they are now. Returns the slowest of those that are slower than
    /// configured, and by how much.
    pub(crate) fn leave(
        &self,
        service: &Service,
        paths: &[Vec<LinkId>],
        memory: &mut Memory,
        hold: Duration,
    ) -> Option<(LinkId, Duration)> {
        let mut slowest = None;
        for link in self.carriers(service).into_keys() {
            let beyond = self.links.figures(link).beyond;
            if beyond != Beyond::default() && !paths.iter().flatten().any(|kept| kept == link) {
                memory.leave(self.now, link, beyond, hold);
                slowest = slowest.max(Some((beyond.delay, link)));
            }
        }
        slowest.filter(|(delay, _)| !delay.is_zero()).map(|(delay, link)| (link.clone(), delay))
    }

    /// Returns the links that carry a service, with the rate that it declares over each, bit/s. The decision counts a link once
    /// for both directions.
    fn carriers(&self, service: &Service) -> BTreeMap<&LinkId, f64> {
        let mut carriers: BTreeMap<&LinkId, f64> = BTreeMap::new();
        for link in &service.virtual_links {
            let there = self.mappings.get(&(link.from.clone(), link.to.clone()));
            let back = self.mappings.get(&(link.to.clone(), link.from.clone()));
            let both: BTreeSet<_> = there.into_iter().chain(back).flatten().collect();
            for carrier in both {
                *carriers.entry(carrier).or_default() += link.rate.bits_per_second() as f64;
            }
        }
        carriers
    }

    /// Whether a VNF was on its way to a node; it is not any more.
    fn end_move(&mut self, vnf: &VnfId, node: &NodeId) -> bool {
        let under_way = self.moves.get(vnf) == Some(node);
        if under_way {
            self.moves.remove(vnf);
        }
        under_way
    }

    fn end_handover(&mut self, robot: &NodeId, unit: &NodeId) {
        if self.handovers.get(robot) == Some(unit) {
            self.handovers.remove(robot);
        }
    }

    /// Wants a VNF on a node: whether that has to be asked for, which is noted.
    pub(crate) fn wants_place(&mut self, vnf: &VnfId, node: &NodeId) -> bool {
        let serves = self.placements.get(vnf).and_then(Nodes::only) == Some(node);
        match self.moves.get(vnf) {
            Some(under_way) if under_way == node => false,
            // A move that is given up ends without a word.
            Some(_) if serves => self.moves.remove(vnf).is_some(),
            None if serves => false,
            _ => {
                self.moves.insert(vnf.clone(), node.clone());
                true
            }
        }
    }

    /// Wants these paths for a service, and no others: returns what has to be asked for, which is noted. What other
    /// services have mapped between two nodes stays. While a VNF of the service moves, packets still go to where it was.
    pub(crate) fn wants_paths(
        &mut self,
        service: &Service,
        wanted: BTreeMap<(NodeId, NodeId), Vec<LinkId>>,
    ) -> Vec<(NodeId, NodeId, Vec<LinkId>)> {
        let mut asked = Vec::new();
        if !service.vnfs.iter().any(|vnf| self.moves.contains_key(&vnf.id)) {
            let needless = |ends: &_, (owner, _): &mut (ServiceId, _)| {
                *owner == service.id && !wanted.contains_key(ends)
            };
            let taken_back = self.paths.extract_if(.., needless);
            asked.extend(taken_back.map(|((from, to), _)| (from, to, Vec::new())));
        }
        for (ends, links) in wanted {
            let own = (service.id.clone(), links);
            let known = self.paths.get(&ends);
            if known.is_none_or(|known| known.0 == own.0 && known.1 != own.1) {
                asked.push((ends.0.clone(), ends.1.clone(), own.1.clone()));
                self.paths.insert(ends, own);
            }
        }
        asked
    }

    /// Wants a robot with a radio unit: whether that has to be asked for, which is noted.
    pub(crate) fn wants_attachment(
        &mut self,
        robot: &NodeId,
        present: Option<&NodeId>,
        unit: &NodeId,
    ) -> bool {
        let wanted = present != Some(unit) && self.handovers.get(robot) != Some(unit);
        if wanted {
            self.handovers.insert(robot.clone(), unit.clone());
        }
        wanted
    }

    /// Whether a robot was asked to attach to a radio unit and is still on its way.
    pub(crate) fn hands_over(&self, robot: &NodeId) -> bool {
        self.handovers.contains_key(robot)
    }

    /// Returns the figures of a link, no better than they were when the service left it.
    fn remembered(&self, link: &LinkId, figures: RoundTrip, memory: &Memory) -> RoundTrip {
        RoundTrip { beyond: memory.with(self.now, link, figures.beyond), ..figures }
    }

    /// Whether anything was measured beyond the configuration of the air between a robot and one of these radio units.
    pub(crate) fn is_air_beyond(&self, robot: &NodeId, units: &[NodeId], memory: &Memory) -> bool {
        let beyond = |unit| {
            self.remembered(&LinkId::wireless(robot, unit), self.links.air(robot, unit), memory).beyond
        };
        units.iter().any(|unit| beyond(unit) != Beyond::default())
    }

    /// Returns the infrastructure for a service: all that no other service takes, with these radio units in the robot's
    /// reach, and links that the service left no better than they were.
    pub(crate) fn infrastructure(
        &self,
        service: &Service,
        units: &[NodeId],
        memory: &Memory,
        air: Air,
    ) -> Infrastructure {
        let place: BTreeMap<_, _> =
            self.graph.nodes.iter().enumerate().map(|(i, node)| (&node.id, i)).collect();
        let mut nodes: Vec<_> = self.graph.nodes.iter().map(node).collect();
        let mut taken: BTreeMap<&LinkId, f64> = BTreeMap::new();
        for other in self.services.iter().filter(|other| other.id != service.id) {
            for vnf in &other.vnfs {
                // While it moves it has two instances.
                let placed = self.placements.get(&vnf.id).map_or(&[][..], Nodes::all);
                let at = placed.iter().chain(self.moves.get(&vnf.id));
                for &at in at.filter_map(|node| place.get(node)) {
                    nodes[at].cpus -= vnf.cpus;
                    nodes[at].memory_bytes = nodes[at].memory_bytes.saturating_sub(vnf.memory_bytes);
                }
            }
            for (carrier, rate) in self.carriers(other) {
                *taken.entry(carrier).or_default() += rate;
            }
        }
        let own = self.carriers(service);
        let wire = |id: LinkId, ends, figures: RoundTrip| {
            let rate = |rates: &BTreeMap<&LinkId, f64>| rates.get(&id).copied().unwrap_or(0.0);
            model::Link {
                free_bps: figures.free_bps(rate(&own), rate(&taken)),
                round_trip: figures.configured + figures.beyond.delay,
                reliability: figures.beyond.delivery,
                wireless: false,
                id,
                ends,
            }
        };
        let offers =
            |network: &WirelessNetwork| service.kpis.radio.is_none_or(|radio| radio == network.standard);
        let network = self.graph.node(&service.robot).and_then(|node| match &node.kind {
            NodeKind::Robot(robot) => self.graph.wireless.get(&robot.network),
            _ => None,
        });
        let units = if network.is_some_and(offers) { units } else { &[] };
        let attachments = units.iter().filter_map(|unit| {
            let id = LinkId::wireless(&service.robot, unit);
            let mut figures = self.remembered(&id, self.links.air(&service.robot, unit), memory);
            if air == Air::Configured {
                figures.beyond = Beyond::default();
            }
            let ends = [*place.get(&service.robot)?, *place.get(unit)?];
            Some(model::Link { wireless: true, ..wire(id, ends, figures) })
        });
        let wired = self.graph.links.iter().map(|link| {
            let mut figures = self.remembered(&link.id, self.links.figures(&link.id), memory);
            figures.rate_bps = figures.rate_bps.min(link.medium.bits_per_second() as f64);
            let ends = link.ends.each_ref().map(|end| place[end]);
            let wire = wire(link.id.clone(), ends, figures);
            model::Link { reliability: wire.reliability.min(link.reliability), ..wire }
        });
        Infrastructure { nodes, links: attachments.chain(wired).collect() }
    }

    /// A service as the decision takes it. A VNF that is not pinned can go to any server; a virtual link between VNFs
    /// that do not follow each other takes its rate of every hop between.
    pub(crate) fn service(&self, service: &Service, processing: &BTreeMap<VnfId, Queue>) -> model::Service {
        let order = |id: &VnfId| service.vnfs.iter().position(|vnf| vnf.id == *id);
        let rate_before = |i: usize| {
            let crosses = |link: &&cotorra_graph::VirtualLink| match (order(&link.from), order(&link.to)) {
                (Some(from), Some(to)) => from.min(to) < i && i <= from.max(to),
                _ => false,
            };
            let links = service.virtual_links.iter().filter(crosses);
            links.map(|link| link.rate.bits_per_second() as f64).sum()
        };
        let hosts = |pinned: Option<&NodeId>| {
            let can = |node: &cotorra_graph::Node| match pinned {
                Some(pinned) => node.id == *pinned,
                None => matches!(node.kind, NodeKind::Server(_)),
            };
            self.graph.nodes.iter().enumerate().filter(|(_, node)| can(node)).map(|(i, _)| i).collect()
        };
        let vnf = |(i, vnf): (usize, &cotorra_graph::Vnf)| model::Vnf {
            id: vnf.id.clone(),
            cpus: vnf.cpus,
            memory_bytes: vnf.memory_bytes,
            hosts: hosts(vnf.pinned_to.as_ref()),
            rate_bps: rate_before(i),
            processing: processing.get(&vnf.id).copied(),
        };
        model::Service {
            vnfs: service.vnfs.iter().enumerate().map(vnf).collect(),
            service_time: service.kpis.service_time,
            reliability: service.kpis.reliability,
        }
    }

    pub(crate) fn services(&self) -> Arc<[Service]> {
        Arc::clone(&self.services)
    }
}

fn node(node: &cotorra_graph::Node) -> model::Node {
    let (cost, reliability) = match &node.kind {
        NodeKind::Server(server) => (server.cost, server.reliability),
        _ => (0.0, 1.0),
    };
    let (cpus, memory_bytes) = node.capacity().map_or((0.0, 0), |free| (free.cpus, free.memory_bytes));
    model::Node { id: node.id.clone(), cpus, memory_bytes, cost, reliability, forwards: node.forwards() }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_graph::{
        Attachment, Conditions, Decision, Handover, LinkContext, PathKind, Placement, Pose, PoseSource,
        RobotContext, VirtualLinkMapping,
    };
    use cotorra_graph_testing as base;

    use super::*;

    /// Two robots with a service each, which share two servers behind one switch.
    const TEXT: &str = "
name: two
wireless: { w: { delay: 1 ms, rate: 8 Mbit/s } }
nodes:
  r: { kind: robot, position: [0, 0] }
  q: { kind: robot, position: [0, 0] }
  U: { kind: radio_unit, position: [0, 0], channel: 1 }
  P: { kind: radio_unit, position: [9, 0], channel: 6 }
  lan: { kind: switch }
  near: { kind: server, tier: fog, cpus: 4, memory: 8 GB, cost: 3 }
  far: { kind: server, tier: cloud, cpus: 4, memory: 8 GB, cost: 1 }
links:
  - { ends: [lan, [U, P, near]], delay: 1 ms, rate: 10 Mbit/s }
  - { ends: [lan, far], delay: 5 ms, rate: 10 Mbit/s }
services:
  first:
    robot: r
    kpis: { service_time: 20 ms }
    vnfs:
      r-driver: { program: robot_driver, pinned_to: r }
      r-brain: { program: navigation, node: far, cpus: 2, memory: 1 GB }
    virtual_links: [{ from: r-driver, to: r-brain, rate: 3 Mbit/s }]
  second:
    robot: q
    kpis: { service_time: 20 ms }
    vnfs:
      q-driver: { program: robot_driver, pinned_to: q }
      q-brain: { program: navigation, node: far, cpus: 1, memory: 2 GB }
    virtual_links: [{ from: q-driver, to: q-brain, rate: 2 Mbit/s }]
walks:
  r: { waypoints: [[0, 0], [9, 0]] }
  q: { waypoints: [[0, 0], [9, 0]] }
";

    fn testbed() -> Testbed {
        cotorra_testbed_file::parse("x.yaml", TEXT, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
    }

    fn node_id(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn vnf_id(name: &str) -> VnfId {
        VnfId::new(name).unwrap()
    }

    fn placed(vnf: &str, node: &str) -> Event {
        Event::Placement(Placement { vnf: vnf_id(vnf), node: node_id(node).into() })
    }

    fn handed_over(robot: &str, to: &str) -> Event {
        let gap = Duration::from_millis(30);
        Event::Handover(Handover { robot: node_id(robot), from: None, to: node_id(to), fast: true, gap })
    }

    fn refused(instruction: Instruction) -> Event {
        let plugin = "okpi".parse().unwrap();
        Event::Decision(Decision { plugin, instruction, reason: None, refused: Some("no".into()) })
    }

    fn attach(robot: &str, unit: &str) -> Instruction {
        Instruction::Attach { robot: node_id(robot), radio_unit: node_id(unit) }
    }

    /// Returns those of the two services whose decisions an event puts in question.
    fn concerned(now: &mut NetworkView, event: &Event) -> Vec<String> {
        let concerned = now.learn(event);
        let services = now.services();
        services.iter().filter(|s| concerned.includes(s)).map(|s| s.id.to_string()).collect()
    }

    #[test]
    fn only_changes_by_others_reopen_a_decision() {
        let mut now = NetworkView::new(&testbed(), None);
        assert!(concerned(&mut now, &placed("r-brain", "far")).is_empty(), "it was there before");
        assert_eq!(concerned(&mut now, &placed("r-brain", "near")), ["first", "second"], "another moved it");
        assert!(now.wants_place(&vnf_id("r-brain"), &node_id("far")));
        assert_eq!(concerned(&mut now, &placed("r-brain", "far")), ["second"], "it was asked to");
        let mapping = |link: &str| {
            let links = vec![LinkId::new(link).unwrap()];
            let (from, to) = (vnf_id("q-driver"), vnf_id("q-brain"));
            Event::VirtualLink(VirtualLinkMapping {
                from,
                to,
                links,
                path: PathKind::Shortest,
                others: Vec::new(),
            })
        };
        assert_eq!(concerned(&mut now, &mapping("lan-far")), ["first"]);
        assert!(concerned(&mut now, &mapping("lan-far")).is_empty());
        assert_eq!(concerned(&mut now, &handed_over("r", "P")), ["first"], "it roamed by itself");
        assert!(now.wants_attachment(&node_id("r"), Some(&node_id("P")), &node_id("U")));
        assert!(concerned(&mut now, &handed_over("r", "U")).is_empty(), "it was asked to");
        let lost = Event::Detached { robot: node_id("q"), from: node_id("P") };
        assert_eq!(concerned(&mut now, &lost), ["second"]);
    }

    #[test]
    fn link_changes_reopen_all_decisions() {
        let testbed = testbed();
        let mut now = NetworkView::new(&testbed, None);
        let link = testbed.graph.links.last().unwrap();
        let event = |delay_ms| {
            let effective = Conditions { delay: Duration::from_millis(delay_ms), ..link.forward.clone() };
            Event::Link(LinkContext {
                link: link.id.clone(),
                asked: effective.clone(),
                effective,
                ..base::link_context("link")
            })
        };
        assert!(concerned(&mut now, &event(5)).is_empty());
        assert_eq!(concerned(&mut now, &event(7)), ["first", "second"]);
        let seen = now.infrastructure(&testbed.services[0], &[], &Memory::default(), Air::Measured);
        assert_eq!(seen.links.last().unwrap().round_trip, Duration::from_millis(12));
    }

    #[test]
    fn the_air_of_other_radio_units_counts_as_their_stations_measure_it() {
        let testbed = testbed();
        let round_trips = |candidates| {
            let measurements = Measurements { candidates, ..Measurements::default() };
            let mut now = NetworkView::new(&testbed, Some(measurements));
            let delay = Some(Duration::from_millis(21));
            let effective = Conditions { delay: Duration::from_millis(1), ..Conditions::default() };
            let context = LinkContext { delay, effective, ..base::link_context("q~U") };
            for second in 0..30 {
                now.learn_link(Timestamp::from_secs_f64(f64::from(second)), &context);
            }
            let units = [node_id("U"), node_id("P")];
            let seen = now.infrastructure(&testbed.services[0], &units, &Memory::default(), Air::Measured);
            [0, 1].map(|air| seen.links[air].round_trip.as_millis())
        };
        assert_eq!(round_trips(false), [2, 2]);
        assert_eq!(round_trips(true), [22, 2]);
    }

    #[test]
    fn links_scaled_from_the_start_are_seen_scaled() {
        let text = TEXT.replace("delay: 5 ms,", "delay: 5 ms, delay_scale: 2, drop_scale: 4,");
        let testbed = cotorra_testbed_file::parse("x.yaml", &text, Path::new(""))
            .unwrap_or_else(|wrong| panic!("{wrong}"));
        let seen = NetworkView::new(&testbed, None).infrastructure(
            &testbed.services[0],
            &[],
            &Memory::default(),
            Air::Measured,
        );
        let far = seen.links.last().unwrap();
        assert_eq!((far.round_trip, far.free_bps), (Duration::from_millis(20), 2.5e6));
    }

    #[test]
    fn attachments_are_instructed_once_until_they_end() {
        let (robot, unit, other) = (node_id("r"), node_id("U"), node_id("P"));
        let pose = Pose::planar(0.0, 0.0, 0.0, [0.0; 9], PoseSource::Simulator);
        let attachments =
            vec![Attachment { radio_unit: unit.clone(), attached: true, signal: None, age: None }];
        let there = Event::Robot(RobotContext {
            robot: robot.clone(),
            attachments,
            ..base::robot_context("robot", pose)
        });
        let lost = Event::Detached { robot: robot.clone(), from: other.clone() };
        for end in [handed_over("r", "U"), lost, refused(attach("r", "U")), there] {
            let mut now = NetworkView::new(&testbed(), None);
            assert!(!now.wants_attachment(&robot, Some(&unit), &unit), "it is there");
            assert!(now.wants_attachment(&robot, Some(&other), &unit));
            assert!(!now.wants_attachment(&robot, Some(&other), &unit), "it is under way");
            for another in [handed_over("q", "U"), refused(attach("r", "P"))] {
                now.learn(&another);
                assert!(now.hands_over(&robot));
            }
            now.learn(&end);
            assert!(!now.hands_over(&robot), "{end:?}");
            assert!(now.wants_attachment(&robot, Some(&other), &unit));
        }
    }

    #[test]
    fn placements_are_instructed_once_until_settled() {
        let (vnf, near, far) = (vnf_id("r-brain"), node_id("near"), node_id("far"));
        let mut now = NetworkView::new(&testbed(), None);
        assert!(!now.wants_place(&vnf, &far), "it is there");
        assert!(now.wants_place(&vnf, &near));
        assert!(!now.wants_place(&vnf, &near), "it is under way");
        assert!(now.wants_place(&vnf, &far), "the move is given up");
        assert!(!now.wants_place(&vnf, &far));
        let failed = VnfEvent { vnf: vnf.clone(), node: near.clone(), state: VnfState::Failed, detail: None };
        let refused = refused(Instruction::Place { vnf: vnf.clone(), node: near.clone().into() });
        for end in [refused, Event::Vnf(failed)] {
            assert!(now.wants_place(&vnf, &near));
            now.learn(&end);
        }
        assert!(now.wants_place(&vnf, &near));
        now.learn(&placed("r-brain", "near"));
        assert!(!now.wants_place(&vnf, &near) && now.wants_place(&vnf, &far));
    }

    #[test]
    fn paths_are_mapped_once_and_removed_after_a_move() {
        let testbed = testbed();
        let (service, other) = (&testbed.services[0], &testbed.services[1]);
        let ends = |server: &str| (node_id("r"), node_id(server));
        let over = |server: &str| vec![LinkId::new("r~U").unwrap(), LinkId::new(server).unwrap()];
        let to = |server: &str| BTreeMap::from([(ends(server), over(server))]);
        let asked = |server: &str, links| vec![(node_id("r"), node_id(server), links)];
        let mut now = NetworkView::new(&testbed, None);
        assert_eq!(now.wants_paths(service, to("far")), asked("far", over("far")));
        assert_eq!(now.wants_paths(service, to("far")), [], "it was asked for");
        assert_eq!(now.wants_paths(other, BTreeMap::from([(ends("far"), over("near"))])), [], "it is taken");
        now.learn(&refused(Instruction::Map {
            from: node_id("r"),
            to: node_id("far"),
            links: over("far"),
            reservation: None,
        }));
        assert_eq!(now.wants_paths(service, to("far")), asked("far", over("far")), "it was refused");
        assert!(now.wants_place(&vnf_id("r-brain"), &node_id("near")));
        assert_eq!(now.wants_paths(service, to("near")), asked("near", over("near")), "it is under way");
        now.learn(&placed("r-brain", "near"));
        assert_eq!(now.wants_paths(service, to("near")), asked("far", Vec::new()));
        assert_eq!(now.wants_paths(service, to("near")), []);
    }

    #[test]
    fn resources_of_other_services_are_not_offered() {
        let testbed = testbed();
        let mut now = NetworkView::new(&testbed, None);
        let free = |now: &NetworkView, node: &str| {
            let seen = now.infrastructure(&testbed.services[0], &[], &Memory::default(), Air::Measured);
            let node = seen.nodes.iter().find(|n| n.id == node).unwrap();
            (node.cpus, node.memory_bytes / 1_000_000_000)
        };
        assert_eq!((free(&now, "far"), free(&now, "near")), ((3.0, 6), (4.0, 8)));
        assert!(now.wants_place(&vnf_id("q-brain"), &node_id("near")));
        assert_eq!((free(&now, "far"), free(&now, "near")), ((3.0, 6), (3.0, 6)), "two instances");
        now.learn(&placed("q-brain", "near"));
        assert_eq!((free(&now, "far"), free(&now, "near")), ((4.0, 8), (3.0, 6)));
        let links = vec![LinkId::new("lan-near").unwrap()];
        let (from, to) = (vnf_id("q-driver"), vnf_id("q-brain"));
        now.learn(&Event::VirtualLink(VirtualLinkMapping {
            from,
            to,
            links,
            path: PathKind::Mapped,
            others: Vec::new(),
        }));
        let seen = now.infrastructure(&testbed.services[0], &[], &Memory::default(), Air::Measured);
        let free = |name: &str| seen.links.iter().find(|l| l.id == name).unwrap().free_bps;
        assert_eq!((free("lan-near"), free("lan-far")), (8e6, 10e6));
    }
}
