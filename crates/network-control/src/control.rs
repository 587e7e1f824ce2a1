//! What Network Control offers to plug-ins and to the API: contexts of the network, and changes to it.

use std::collections::BTreeMap;

use cotorra_fabric::Fabric;
use cotorra_graph::{
    Attachment, ConditionChange, Direction, Event, Instruction, Lateness, LinkContext, LinkId, NodeId,
    Placement, Position, Service, Testbed, ThroughputTest, Timestamp, VirtualLinkMapping, VnfId,
};

use crate::{
    access::AccessPoints,
    vim::{Engine, Managed, Vim},
};

/// Names in notes have so many characters at most.
const LONGEST_NAME: usize = 128;

/// The emulated network, wherever it runs: on another thread in real time, right here in virtual time.
pub trait Network {
    /// Does something with the fabric, at its own time, and gives what came of it.
    ///
    /// # Errors
    /// [`NetworkGone`] once it is stopped.
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone>;

    /// Changes what a link does, in one direction or both, and gives its contexts; it does so when this returns.
    ///
    /// # Errors
    /// [`Refused`] with the reason; then nothing changed.
    fn change(
        &self,
        link: &LinkId,
        direction: Option<Direction>,
        change: &ConditionChange,
    ) -> Result<Vec<LinkContext>, Refused> {
        change_fabric(self, link, direction, change)
    }

    /// Begins to test what one direction of a link carries; what came of it is in its context later.
    ///
    /// # Errors
    /// [`Refused`] with the reason; then no packet was sent.
    fn test_throughput(
        &self,
        link: &LinkId,
        direction: Direction,
        test: ThroughputTest,
    ) -> Result<(), Refused> {
        test_fabric_throughput(self, link, direction, test)
    }

    /// Completes what the fabric knows of links, where not only the fabric carries packets.
    fn complete(&self, _now: Timestamp, contexts: Vec<LinkContext>) -> Vec<LinkContext> {
        contexts
    }

    /// How late packets were, where not only the fabric carries them, which was that late.
    fn lateness(&self, fabric: Lateness) -> Lateness {
        fabric
    }
}

/// [`Network::change`] in the fabric alone.
///
/// # Errors
/// As there.
pub fn change_fabric<N: Network + ?Sized>(
    network: &N,
    link: &LinkId,
    direction: Option<Direction>,
    change: &ConditionChange,
) -> Result<Vec<LinkContext>, Refused> {
    let (link, change) = (link.clone(), change.clone());
    let apply = move |fabric: &mut Fabric, now| {
        fabric.change(now, &link, direction, &change).map_err(refused)?;
        Ok(fabric.link_contexts(now).into_iter().filter(|context| context.link == link).collect())
    };
    network.with(apply).map_err(refused)?
}

/// [`Network::test_throughput`] in the fabric.
///
/// # Errors
/// As there.
pub fn test_fabric_throughput<N: Network + ?Sized>(
    network: &N,
    link: &LinkId,
    direction: Direction,
    test: ThroughputTest,
) -> Result<(), Refused> {
    let link = link.clone();
    let begin = move |fabric: &mut Fabric, now| fabric.test_throughput(now, &link, direction, test);
    network.with(begin).map_err(refused)?.map_err(refused)
}

/// The emulated network was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the emulated network was stopped")]
pub struct NetworkGone;

/// Why an instruction was not done; for people.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refused(pub String);

fn refused(reason: impl ToString) -> Refused {
    Refused(reason.to_string())
}

/// The Network Control block.
pub struct NetworkControl<N, E> {
    network: N,
    vim: Vim<E>,
    access_points: AccessPoints,
    services: Vec<Service>,
    mappings: BTreeMap<(VnfId, VnfId), VirtualLinkMapping>,
}

impl<N: Network, E: Engine> NetworkControl<N, E> {
    /// Controls this network; nothing runs before [`NetworkControl::start`].
    pub fn new(testbed: &Testbed, network: N, engine: E) -> Self {
        Self {
            network,
            vim: Vim::new(testbed.graph.clone(), &testbed.services, engine),
            access_points: AccessPoints::new(&testbed.graph),
            services: testbed.services.clone(),
            mappings: BTreeMap::new(),
        }
    }

    /// Starts the VNFs.
    pub fn start(&mut self, now: Timestamp) -> Vec<Event> {
        self.vim.start(now)
    }

    /// Whether every VNF serves.
    pub fn all_ready(&self) -> bool {
        self.vim.all_ready()
    }

    /// The node on which a VNF runs.
    pub fn node(&self, vnf: &VnfId) -> Option<&NodeId> {
        self.vim.node(vnf)
    }

    /// a(n) of all nodes.
    pub fn placements(&self) -> Vec<Placement> {
        self.vim.placements()
    }

    /// Returns every VNF with its instances, by name.
    pub fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        self.vim.managed()
    }

    /// What became of VNFs, and what happened in the network, since the last call.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn poll(&mut self, now: Timestamp) -> Result<Vec<Event>, NetworkGone> {
        let mut events = self.vim.poll(now);
        events.extend(self.access_points.poll(now, &self.network, &mut self.vim)?);
        Ok(events)
    }

    /// When [`NetworkControl::poll`] has something to do by itself.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.vim.next_deadline().into_iter().chain(self.access_points.next_deadline()).min()
    }

    /// Tells the network where robots are, and gives φ of each, in the same order.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn locate(&self, robots: Vec<(NodeId, Position)>) -> Result<Vec<Vec<Attachment>>, NetworkGone> {
        self.network.with(move |fabric, now| {
            for (robot, position) in &robots {
                if let Err(refused) = fabric.move_robot(now, robot, *position) {
                    tracing::warn!("the network does not know where {robot} is: {refused}");
                }
            }
            robots.iter().map(|(robot, _)| fabric.attachments(robot)).collect()
        })
    }

    /// ι of every radio unit, d, λ and conditions of every link, the emulator's lateness, and those virtual links
    /// that other hardware links carry than at the last call.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn observe(&mut self) -> Result<Vec<Event>, NetworkGone> {
        let wanted: Vec<_> = self
            .services
            .iter()
            .flat_map(|service| &service.virtual_links)
            .filter_map(|link| {
                let ends = (self.vim.node(&link.from)?.clone(), self.vim.node(&link.to)?.clone());
                Some(((link.from.clone(), link.to.clone()), ends))
            })
            .collect();
        let (now, radios, links, lateness, routes) = self.network.with(move |fabric, now| {
            let (radios, links) = (fabric.radio_contexts(now), fabric.link_contexts(now));
            let routes: Vec<_> = wanted
                .into_iter()
                .map(|(key, (from, to))| (key, fabric.route(&from, &to).unwrap_or_default()))
                .collect();
            (now, radios, links, fabric.lateness(), routes)
        })?;
        let (links, lateness) = (self.network.complete(now, links), self.network.lateness(lateness));
        let radios = radios.into_iter().map(Event::Radio);
        let mut events: Vec<_> =
            radios.chain(links.into_iter().map(Event::Link)).chain([Event::Lateness(lateness)]).collect();
        for ((from, to), links) in routes {
            let mapping = VirtualLinkMapping { from: from.clone(), to: to.clone(), links };
            if self.mappings.get(&(from.clone(), to.clone())) != Some(&mapping) {
                self.mappings.insert((from, to), mapping.clone());
                events.push(Event::VirtualLink(mapping));
            }
        }
        Ok(events)
    }

    /// Does what was asked: scans, attachments, placements, conditions and tests. Movements are the Robot Middleware's.
    ///
    /// # Errors
    /// [`Refused`] with the reason; then nothing changed.
    pub fn instruct(&mut self, now: Timestamp, instruction: &Instruction) -> Result<Vec<Event>, Refused> {
        match instruction.clone() {
            Instruction::Scan { robot } => {
                self.network
                    .with(move |fabric, now| fabric.scan(now, &robot))
                    .map_err(refused)?
                    .map_err(refused)?;
                Ok(Vec::new())
            }
            Instruction::Attach { robot, radio_unit } => {
                let attach = move |fabric: &mut Fabric, now| fabric.attach(now, &robot, &radio_unit);
                self.network.with(attach).map_err(refused)?.map_err(refused)?;
                Ok(Vec::new())
            }
            Instruction::Place { vnf, node } => self.vim.place(now, &vnf, &node).map_err(refused),
            Instruction::Condition { link, direction, change } => {
                let contexts = self.network.change(&link, direction, &change)?;
                Ok(self.network.complete(now, contexts).into_iter().map(Event::Link).collect())
            }
            Instruction::TestThroughput { link, direction, test } => {
                self.network.test_throughput(&link, direction, test)?;
                Ok(Vec::new())
            }
            Instruction::Deploy { radio_unit, access_point } => {
                self.access_points.deploy(now, &radio_unit, access_point, &self.network, &mut self.vim)?;
                Ok(Vec::new())
            }
            Instruction::Remove { radio_unit } => {
                self.access_points.remove(&radio_unit, &self.network, &mut self.vim)
            }
            Instruction::Provision { robot, radio_unit, access_point } => {
                let provision =
                    move |fabric: &mut Fabric, _| fabric.provision(&robot, &radio_unit, access_point);
                self.network.with(provision).map_err(refused)?.map_err(refused)?;
                Ok(Vec::new())
            }
            Instruction::Note { process, step, .. } => {
                let fits = |name: &str| (1..=LONGEST_NAME).contains(&name.chars().count());
                if fits(&process) && fits(&step) {
                    Ok(Vec::new())
                } else {
                    Err(Refused(format!("what a note names has 1 to {LONGEST_NAME} characters")))
                }
            }
            Instruction::Move { .. } | Instruction::Halt { .. } | Instruction::Go { .. } => {
                Err(Refused("movements are the Robot Middleware's".to_owned()))
            }
        }
    }

    /// Stops every VNF and waits for it.
    pub fn shut_down(&mut self) {
        self.vim.shut_down();
    }
}
