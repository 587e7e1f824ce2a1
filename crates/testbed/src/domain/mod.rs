//! The view of one administrative domain on a testbed, and the instructions that it may give: those for its own nodes.
//! Domains do not trust each other. They make agreements over a ledger.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use cotorra_graph::{
    AccessPoint, Decision, DomainId, Event, Handover, Instruction, LinkId, LostAt, NodeId, Nodes, Part,
    Placement, PluginId, RobotContext, ServiceTime, Stamped, Testbed, VirtualLinkMapping, VnfId,
};
use cotorra_measurements::{Figure, GraphState, Sample};

/// The domains of a testbed, and the plug-ins that are bound to one.
pub(crate) struct Domains {
    views: BTreeMap<DomainId, Arc<DomainView>>,
}

impl Domains {
    pub(crate) fn new(testbed: &Testbed) -> Self {
        let view = |domain: &DomainId| (domain.clone(), Arc::new(DomainView::new(testbed, domain)));
        Self { views: testbed.graph.domains.iter().map(view).collect() }
    }

    /// Returns the view of a domain.
    pub(crate) fn view(&self, domain: &DomainId) -> Option<&Arc<DomainView>> {
        self.views.get(domain)
    }

    /// Returns the view of a plug-in that is bound to a domain; `None` for one that sees everything.
    pub(crate) fn of_plugin(&self, plugin: &PluginId) -> Option<&Arc<DomainView>> {
        self.views.values().find(|view| view.plugins.contains(plugin))
    }
}

/// Returns an event as a view shows it, or unchanged without a view.
pub(crate) fn seen(view: Option<&DomainView>, event: &Arc<Stamped>) -> Option<Arc<Stamped>> {
    match view.map(|view| view.event(event)) {
        None | Some(Some(Cow::Borrowed(_))) => Some(Arc::clone(event)),
        Some(Some(Cow::Owned(part))) => Some(Arc::new(part)),
        Some(None) => None,
    }
}

/// An instruction for nodes of another domain.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} is not of the domain `{domain}`, whose orchestrator changes its own nodes only")]
pub(crate) struct NotOwnError {
    what: String,
    domain: DomainId,
}

/// One domain's part of a testbed.
#[derive(Debug)]
pub(crate) struct DomainView {
    domain: DomainId,
    nodes: BTreeSet<NodeId>,
    /// Nodes of all domains: wireless links are named after their ends.
    all_nodes: BTreeSet<NodeId>,
    wired: BTreeMap<LinkId, [NodeId; 2]>,
    vnfs: BTreeSet<VnfId>,
    plugins: BTreeSet<PluginId>,
    testbed: Testbed,
}

impl DomainView {
    fn new(testbed: &Testbed, domain: &DomainId) -> Self {
        let graph = &testbed.graph;
        let nodes: BTreeSet<_> =
            graph.nodes.iter().filter(|node| node.domain == *domain).map(|node| node.id.clone()).collect();
        let mut part = testbed.clone();
        part.graph.domains.retain(|other| other == domain);
        part.graph.nodes.retain(|node| node.domain == *domain);
        part.graph.links.retain(|link| link.ends.iter().all(|end| nodes.contains(end)));
        part.services.retain(|service| nodes.contains(&service.robot));
        part.containers.engines.retain(|node, _| nodes.contains(node));
        part.containers.hosts.retain(|host| host.node.all().iter().all(|node| nodes.contains(node)));
        part.walks.retain(|walk| nodes.contains(&walk.robot));
        part.plugins.retain(|plugin| plugin.domain.as_ref() == Some(domain));
        let vnfs = part.vnfs().map(|vnf| vnf.id.clone());
        let of_radio_units = part.graph.radio_units().map(|(node, _)| AccessPoint::vnf(&node.id));
        // A caller with the domain's token and no name uses the domain's name.
        let itself = PluginId::new(domain.as_str()).ok();
        Self {
            domain: domain.clone(),
            all_nodes: graph.nodes.iter().map(|node| node.id.clone()).collect(),
            wired: graph.links.iter().map(|link| (link.id.clone(), link.ends.clone())).collect(),
            vnfs: vnfs.chain(of_radio_units).collect(),
            plugins: part.plugins.iter().map(|plugin| plugin.id.clone()).chain(itself).collect(),
            nodes,
            testbed: part,
        }
    }

    pub(crate) fn domain(&self) -> &DomainId {
        &self.domain
    }

    /// Returns the domain's part of the testbed.
    pub(crate) fn testbed(&self) -> &Testbed {
        &self.testbed
    }

    /// Whether a node belongs to the domain.
    pub(crate) fn owns(&self, node: &NodeId) -> bool {
        self.nodes.contains(node)
    }

    /// Whether a plug-in belongs to the domain, or its name is the domain's.
    pub(crate) fn has_plugin(&self, plugin: &PluginId) -> bool {
        self.plugins.contains(plugin)
    }

    /// Whether a VNF belongs to the domain. `added` returns the nodes of a VNF that was added during the run: it is the domain's
    /// while all its nodes are.
    pub(crate) fn has_vnf(&self, vnf: &VnfId, added: impl Fn(&VnfId) -> Option<Vec<NodeId>>) -> bool {
        self.vnfs.contains(vnf) || added(vnf).is_some_and(|nodes| nodes.iter().all(|node| self.owns(node)))
    }

    /// Returns a(n) of one of the domain's VNFs, or the part on its nodes of another's.
    pub(crate) fn placement(&self, placement: &Placement) -> Option<Placement> {
        if self.vnfs.contains(&placement.vnf) {
            return Some(placement.clone());
        }
        let own = placement.node.all().iter().filter(|node| self.owns(node)).cloned().collect();
        Some(Placement { vnf: placement.vnf.clone(), node: Nodes::new(own).ok()? })
    }

    /// Whether the domain sees a link: one of the two ends belongs to it.
    pub(crate) fn sees_link(&self, link: &LinkId) -> bool {
        self.ends(link).is_some_and(|ends| ends.iter().any(|end| self.owns(end)))
    }

    fn ends(&self, link: &LinkId) -> Option<[NodeId; 2]> {
        if let Some(ends) = self.wired.get(link) {
            return Some(ends.clone());
        }
        let name = link.as_str();
        let split = |(at, _): (usize, &str)| {
            let end = |name: &str| self.all_nodes.get(name).cloned();
            Some([end(&name[..at])?, end(&name[at + 1..])?])
        };
        name.match_indices('~').find_map(split)
    }

    /// Returns κ of one of the domain's robots. Of other domains' radio units it has those that the robot hears or is
    /// attached to.
    pub(crate) fn robot(&self, context: &RobotContext) -> Option<RobotContext> {
        if !self.owns(&context.robot) {
            return None;
        }
        let mut context = context.clone();
        context.attachments.retain(|a| self.owns(&a.radio_unit) || a.attached || a.signal.is_some());
        Some(context)
    }

    /// Returns a(n1,n2) of a virtual link to or from one of the domain's VNFs, without links of others.
    pub(crate) fn virtual_link(&self, mapping: &VirtualLinkMapping) -> Option<VirtualLinkMapping> {
        let own = self.vnfs.contains(&mapping.from) || self.vnfs.contains(&mapping.to);
        let seen = || {
            let mut mapping = mapping.clone();
            mapping.links.retain(|link| self.sees_link(link));
            for other in &mut mapping.others {
                other.links.retain(|link| self.sees_link(link));
            }
            mapping
        };
        own.then(seen)
    }

    /// Returns the domain's part of the graph's state.
    pub(crate) fn state(&self, state: GraphState) -> GraphState {
        fn part<T>(all: Vec<Sample<T>>, seen: impl Fn(&T) -> Option<T>) -> Vec<Sample<T>> {
            all.into_iter().filter_map(|one| Some(Sample { value: seen(&one.value)?, at: one.at })).collect()
        }
        let GraphState { at, robots, mut radio_units, mut links, placements, virtual_links, .. } = state;
        let (mut sensors, mut machines) = (state.sensors, state.machines);
        radio_units.retain(|one| self.owns(&one.value.radio_unit));
        links.retain(|one| self.sees_link(&one.value.link));
        sensors.retain(|one| self.owns(&one.value.robot));
        machines.retain(|one| self.owns(&one.value.node));
        GraphState {
            at,
            robots: part(robots, |robot| self.robot(robot)),
            radio_units,
            links,
            placements: part(placements, |placement| self.placement(placement)),
            virtual_links: part(virtual_links, |mapping| self.virtual_link(mapping)),
            sensors,
            machines,
        }
    }

    /// Whether the domain sees a figure of the history. Figures of all robots together are the operator's, and so are times
    /// on links, which may be another domain's.
    pub(crate) fn sees_figure(&self, figure: &Figure) -> bool {
        let owns = |robot: &Option<NodeId>| robot.as_ref().is_some_and(|robot| self.owns(robot));
        match figure {
            Figure::Link(link, ..) => self.sees_link(link),
            Figure::Robot(node, _) | Figure::Load(node) | Figure::Machine(node, _) => self.owns(node),
            Figure::Signal { robot, .. } | Figure::Sensor { robot, .. } => self.owns(robot),
            Figure::ServiceTime { service, robot } => {
                let own = self.testbed.services.iter().any(|one| service.as_ref() == Some(&one.id));
                own || owns(robot)
            }
            Figure::HandoverGap { robot } => owns(robot),
            Figure::TimePart { .. } => false,
            Figure::Lateness(_) => true,
        }
    }

    /// Returns a service time of one of the domain's robots. The time on links of others counts as unknown, and so does what
    /// they lost.
    pub(crate) fn service_time(&self, sample: &ServiceTime) -> ServiceTime {
        let mut sample = sample.clone();
        if let Some(parts) = &mut sample.parts {
            parts.hide_links(|link| self.sees_link(link));
        }
        let is_seen = |at: &LostAt| at.link.as_ref().is_none_or(|link| self.sees_link(link));
        sample.lost_at = sample.lost_at.filter(|at| is_seen(at));
        sample
    }

    /// Returns an event as the domain sees it; `None` if it does not.
    pub(crate) fn event<'a>(&self, stamped: &'a Stamped) -> Option<Cow<'a, Stamped>> {
        let changed = |event| Some(Cow::Owned(Stamped { at: stamped.at, event }));
        let seen = match &stamped.event {
            Event::Robot(context) => return changed(Event::Robot(self.robot(context)?)),
            Event::Handover(handover) if !self.owns(&handover.robot) => {
                return changed(self.visitor(handover)?);
            }
            Event::VirtualLink(mapping) => {
                return changed(Event::VirtualLink(self.virtual_link(mapping)?));
            }
            Event::Placement(placement) => return changed(Event::Placement(self.placement(placement)?)),
            Event::ServiceTime(sample)
                if self.owns(&sample.robot) && (sample.parts.is_some() || sample.lost_at.is_some()) =>
            {
                return changed(Event::ServiceTime(self.service_time(sample)));
            }
            Event::Decision(Decision { plugin, instruction, .. }) => {
                let changes_nothing = instruction.changes(|_| Err(())).is_ok();
                self.has_plugin(plugin) || (!changes_nothing && self.check(instruction, |_| None).is_ok())
            }
            // A radio unit knows its stations, including those of other domains.
            event => event.is_about(|part| self.sees(part)),
        };
        seen.then_some(Cow::Borrowed(stamped))
    }

    /// Whether the domain sees what happens to a part of the testbed. All see the emulator, which belongs to no node.
    fn sees(&self, part: Part<'_>) -> bool {
        match part {
            Part::Node(node) => self.owns(node),
            Part::Nodes(nodes) => nodes.iter().all(|node| self.owns(node)),
            Part::Link(link) => self.sees_link(link),
            Part::Links(links) => links.iter().all(|link| self.sees_link(link)),
            Part::Vnf(vnf) => self.vnfs.contains(vnf),
            Part::Plugin(plugin) => self.has_plugin(plugin),
            Part::Emulator => true,
        }
    }

    /// Returns the visible part of a handover of another domain's robot: its arrival or its departure.
    fn visitor(&self, handover: &Handover) -> Option<Event> {
        let from = handover.from.clone().filter(|from| self.owns(from));
        if self.owns(&handover.to) {
            return Some(Event::Handover(Handover { from, ..handover.clone() }));
        }
        from.map(|from| Event::Detached { robot: handover.robot.clone(), from })
    }

    /// Checks that an instruction is for the domain's nodes. Whether a robot may attach is decided by the radio unit's
    /// domain. `added` is as in [`Self::has_vnf`].
    pub(crate) fn check(
        &self,
        instruction: &Instruction,
        added: impl Fn(&VnfId) -> Option<Vec<NodeId>>,
    ) -> Result<(), NotOwnError> {
        let not_own = |what: String| NotOwnError { what, domain: self.domain.clone() };
        let own_node =
            |node: &NodeId| self.owns(node).then_some(()).ok_or_else(|| not_own(format!("`{node}`")));
        let own_link = |link: &LinkId| {
            let own = self.ends(link).is_some_and(|ends| ends.iter().all(|end| self.owns(end)));
            own.then_some(()).ok_or_else(|| not_own(format!("the link `{link}`")))
        };
        let own_vnf = |vnf: &VnfId| {
            self.has_vnf(vnf, &added).then_some(()).ok_or_else(|| not_own(format!("the VNF `{vnf}`")))
        };
        instruction.changes(|part| match part {
            Part::Node(node) => own_node(node),
            Part::Nodes(nodes) => nodes.iter().try_for_each(own_node),
            Part::Link(link) => own_link(link),
            Part::Links(links) => links.iter().try_for_each(own_link),
            Part::Vnf(vnf) => own_vnf(vnf),
            Part::Plugin(plugin) => self
                .has_plugin(plugin)
                .then_some(())
                .ok_or_else(|| not_own(format!("the plug-in `{plugin}`"))),
            Part::Emulator => Err(not_own("the emulator".to_owned())),
        })
    }
}

#[cfg(test)]
mod tests;
