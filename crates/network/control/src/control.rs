//! The interface of Network Control: contexts of the network, and instructions that change it.

use std::{collections::BTreeMap, time::Duration};

use cotorra_engine::{Engine, InstanceWaits, VnfComputed};
use cotorra_fabric::{Fabric, PinnedPath};
use cotorra_graph::{
    Attachment, Dbm, Direction, Event, InstancePath, Instruction, LinkId, MapReservation, NodeId, PathKind,
    Placement, Position, Reservations, Testbed, Timestamp, VirtualLink, VirtualLinkMapping, VnfId,
};

use crate::{
    access::AccessPoints,
    mappings::{Mapping, Mappings},
    network::{InstructionError, Network, NetworkGone, rejected},
    vim::{Managed, Vim},
};

/// The Network Control block.
pub struct NetworkControl<N, E> {
    network: N,
    vim: Vim<E>,
    access_points: AccessPoints,
    virtual_links: Vec<VirtualLink>,
    mappings: Mappings,
    /// How links keep reservations.
    reservations: Reservations,
    /// The paths that are pinned in the fabric.
    pinned: Vec<PinnedPath>,
    /// The last reported a(n1,n2).
    reported: BTreeMap<(VnfId, VnfId), VirtualLinkMapping>,
}

impl<N: Network, E: Engine> NetworkControl<N, E> {
    /// Creates the control of a network. No VNF runs before [`NetworkControl::start`].
    pub fn new(testbed: &Testbed, network: N, engine: E) -> Self {
        Self {
            network,
            vim: Vim::new(testbed.graph.clone(), testbed.vnfs(), engine),
            access_points: AccessPoints::new(&testbed.graph),
            virtual_links: testbed
                .services
                .iter()
                .flat_map(|service| service.virtual_links.clone())
                .collect(),
            mappings: Mappings::default(),
            reservations: testbed.reservations,
            pinned: Vec::new(),
            reported: BTreeMap::new(),
        }
    }

    /// Starts the VNFs.
    pub fn start(&mut self, now: Timestamp) -> Vec<Event> {
        self.vim.start(now)
    }

    /// Whether all instances of every VNF of the testbed file are ready.
    pub fn all_ready(&self) -> bool {
        self.vim.all_ready()
    }

    /// Returns the node on which a VNF runs; of several, the preferred one.
    pub fn node(&self, vnf: &VnfId) -> Option<&NodeId> {
        self.vim.node(vnf)
    }

    /// Returns the nodes of a VNF's serving instances, preferred ones first.
    pub fn serving(&self, vnf: &VnfId) -> Vec<&NodeId> {
        self.vim.serving(vnf)
    }

    /// Returns the nodes of each VNF's instances by their distance from a host, the nearest first. The distance is the
    /// present delay of all links there and back. Of equal delays, fewer links are nearer, then the first name.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn by_distance(&self, pairs: Vec<(NodeId, VnfId)>) -> Result<Vec<Vec<NodeId>>, NetworkGone> {
        let known = |(from, vnf): (NodeId, VnfId)| (from, self.vim.nodes(&vnf).cloned().collect());
        let pairs: Vec<(NodeId, Vec<NodeId>)> = pairs.into_iter().map(known).collect();
        self.network.with(move |fabric, _| {
            let near = |(from, nodes): (NodeId, Vec<NodeId>)| {
                let distance = |node: &NodeId| {
                    let (delay, links) =
                        fabric.round_trip(&from, node).unwrap_or((Duration::MAX, usize::MAX));
                    (delay, links, node.clone())
                };
                let mut nodes = nodes;
                nodes.sort_by_cached_key(distance);
                nodes
            };
            pairs.into_iter().map(near).collect()
        })
    }

    /// Returns a(n) of all nodes.
    pub fn placements(&self) -> Vec<Placement> {
        self.vim.placements()
    }

    /// Returns every replica of every VNF with its instances, by the VNF's name.
    pub fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        self.vim.managed()
    }

    /// Returns the nodes of a VNF that was added during the run, with those that it is moving to; `None` for all others.
    pub fn nodes_of_added(&self, vnf: &VnfId) -> Option<impl Iterator<Item = &NodeId>> {
        self.vim.nodes_of_added(vnf)
    }

    /// Returns the events of VNFs and vAPs since the last call.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn poll(&mut self, now: Timestamp) -> Result<Vec<Event>, NetworkGone> {
        let mut events = self.vim.poll(now);
        events.extend(self.access_points.poll(now, &self.network, &mut self.vim)?);
        Ok(events)
    }

    /// Returns when [`NetworkControl::poll`] is due without an event of the engine.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.vim.next_deadline().into_iter().chain(self.access_points.next_deadline()).min()
    }

    /// Moves robots in the network. Returns φ of each, in the same order.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn locate(&self, robots: Vec<(NodeId, Position)>) -> Result<Vec<Vec<Attachment>>, NetworkGone> {
        let (now, located) = self.network.with(move |fabric, now| {
            let locate = |(robot, position): (NodeId, Position)| {
                if let Err(error) = fabric.move_robot(now, &robot, position) {
                    tracing::warn!("cannot move {robot} in the emulated network: {error}");
                }
                robot
            };
            let robots: Vec<_> = robots.into_iter().map(locate).collect();
            let with_attachments = |robot: NodeId| {
                let attachments = fabric.attachments(now, &robot);
                (robot, attachments)
            };
            (now, robots.into_iter().map(with_attachments).collect::<Vec<_>>())
        })?;
        let complete = |(robot, mut attachments): (NodeId, Vec<Attachment>)| {
            self.network.complete_attachments(now, &robot, &mut attachments);
            attachments
        };
        Ok(located.into_iter().map(complete).collect())
    }

    /// Records that a robot went to a radio unit of another core. Its packets leave there, and those to it at the border.
    /// Without a border, it is silent.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    pub fn depart(
        &self,
        robot: &NodeId,
        mobility_domain: u16,
        border: Option<&NodeId>,
    ) -> Result<(), InstructionError> {
        let (robot, border) = (robot.clone(), border.cloned());
        let depart =
            move |fabric: &mut Fabric, now| fabric.depart(now, &robot, mobility_domain, border.as_ref());
        self.network.with(depart).map_err(rejected)?.map_err(rejected)
    }

    /// Lets a robot that lost a radio unit of another core look for one of this core.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    pub fn come_back(&self, robot: &NodeId) -> Result<(), InstructionError> {
        let robot = robot.clone();
        let come_back = move |fabric: &mut Fabric, now| fabric.come_back(now, &robot);
        self.network.with(come_back).map_err(rejected)?.map_err(rejected)
    }

    /// Returns the radio unit of this core that a robot is attached to.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn attached_to(&self, robot: &NodeId) -> Result<Option<NodeId>, NetworkGone> {
        let robot = robot.clone();
        self.network.with(move |fabric, _| fabric.attached_to(&robot).cloned())
    }

    /// Returns the signal of each radio unit at a robot; `None` if it is off, or out of reach.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn reach(&self, pairs: Vec<(NodeId, NodeId)>) -> Result<Vec<Option<Dbm>>, NetworkGone> {
        self.network.with(move |fabric, _| {
            let reach = |(robot, unit): &(NodeId, NodeId)| fabric.reach(robot, unit).ok().flatten();
            pairs.iter().map(reach).collect()
        })
    }

    /// Returns ι of every radio unit, d, λ and conditions of every link, the emulator's lateness, and the virtual links
    /// whose hardware links have changed since the last call.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn observe(&mut self) -> Result<Vec<Event>, NetworkGone> {
        let (now, radios, links, lateness) = self.network.with(|fabric, now| {
            (now, fabric.radio_contexts(now), fabric.link_contexts(now), fabric.lateness())
        })?;
        let (links, lateness) = (self.network.complete(now, links), self.network.lateness(lateness));
        let radios = radios.into_iter().map(|mut context| {
            self.network.complete_radio(&mut context);
            Event::Radio(context)
        });
        let mut events: Vec<_> =
            radios.chain(links.into_iter().map(Event::Link)).chain([Event::Lateness(lateness)]).collect();
        events.extend(self.settle()?);
        events.extend(self.changed_virtual_links()?);
        Ok(events)
    }

    /// Returns the remarks on services' flows at the end of a run.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn flow_remarks(&self) -> Result<Vec<Event>, NetworkGone> {
        let remarks = self.network.with(|fabric, _| fabric.flow_remarks())?;
        Ok(remarks.into_iter().map(|message| Event::Notice { message }).collect())
    }

    /// Updates mappings after a change of attachments, links or placements. Returns the virtual links whose hardware links
    /// have changed. Does nothing without present or former mappings.
    ///
    /// # Errors
    /// [`NetworkGone`].
    pub fn remap(&mut self) -> Result<Vec<Event>, NetworkGone> {
        if self.mappings.is_empty() && self.pinned.is_empty() {
            return Ok(Vec::new());
        }
        let mut events = self.settle()?;
        events.extend(self.changed_virtual_links()?);
        Ok(events)
    }

    /// Returns the reservations of mappings on each direction of a link, bit/s.
    pub fn reserved(&self) -> impl Iterator<Item = (&LinkId, Direction, f64)> {
        self.mappings.reserved().into_iter().map(|((link, direction), bps)| (link, *direction, bps))
    }

    /// Updates the reservations and states of mappings, and pins their paths in the fabric.
    fn settle(&mut self) -> Result<Vec<Event>, NetworkGone> {
        let mut mappings = std::mem::take(&mut self.mappings);
        let changes = self.work_out(&mut mappings);
        self.mappings = mappings;
        let mut messages = changes?;
        let pinned: Vec<_> =
            self.mappings.pinned().map(|mapping| mapping.pinned(self.reservations)).collect();
        if pinned != self.pinned {
            self.pinned = pinned.clone();
            if let Err(error) = self.network.pin(pinned)? {
                messages.push(format!("reservations are not kept: {error}"));
            }
        }
        Ok(messages.into_iter().map(|message| Event::Notice { message }).collect())
    }

    /// Updates the reservations and states of mappings. Returns the changes, for people.
    fn work_out(&self, mappings: &mut Mappings) -> Result<Vec<String>, NetworkGone> {
        if mappings.is_empty() {
            return Ok(Vec::new());
        }
        let hops: Vec<_> = mappings.hops().cloned().collect();
        let carries = self.network.with(move |fabric, _| {
            let carries = hops.into_iter().map(|hop| (fabric.carries(&hop.0, hop.1), hop));
            carries.filter_map(|(carries, hop)| Some((hop, carries?))).collect()
        })?;
        Ok(mappings.settle(|a, b| self.rate_between(a, b).unwrap_or(0.0), &carries))
    }

    /// Returns both directions of the virtual links whose hardware links have changed since the last call.
    fn changed_virtual_links(&mut self) -> Result<Vec<Event>, NetworkGone> {
        let both =
            self.virtual_links.iter().flat_map(|link| [(&link.from, &link.to), (&link.to, &link.from)]);
        let wanted: BTreeMap<_, _> = both
            .map(|(from, to)| {
                let ends = self.vim.nodes(from).flat_map(|a| self.vim.nodes(to).map(move |b| (a, b)));
                ((from.clone(), to.clone()), ends.map(|(a, b)| (a.clone(), b.clone())).collect::<Vec<_>>())
            })
            .collect();
        let routes: Vec<_> = self.network.with(move |fabric, _| {
            let route = |(a, b): (NodeId, NodeId)| (fabric.route(&a, &b).unwrap_or_default(), a, b);
            let routes = |(key, ends): (_, Vec<_>)| (key, ends.into_iter().map(route).collect::<Vec<_>>());
            wanted.into_iter().map(routes).collect()
        })?;
        let mut events = Vec::new();
        for (key, routes) in routes {
            let path = |(links, from, to): (Vec<LinkId>, NodeId, NodeId)| {
                let path = match self.mappings.get(&from, &to) {
                    None => PathKind::Shortest,
                    Some(mapping) if mapping.is_used() && mapping.links == links => PathKind::Mapped,
                    Some(_) => PathKind::Fallback,
                };
                InstancePath { from, to, links, path }
            };
            let mut paths = routes.into_iter().map(path);
            let Some(InstancePath { links, path, .. }) = paths.next() else { continue };
            let (from, to) = key.clone();
            let mapping = VirtualLinkMapping { from, to, links, path, others: paths.collect() };
            if self.reported.get(&key) != Some(&mapping) {
                self.reported.insert(key, mapping.clone());
                events.push(Event::VirtualLink(mapping));
            }
        }
        Ok(events)
    }

    /// Maps the virtual links between two nodes to a path, or removes the mapping if `links` is empty.
    fn map(
        &mut self,
        from: NodeId,
        to: NodeId,
        links: Vec<LinkId>,
        own: Option<MapReservation>,
    ) -> Result<(), InstructionError> {
        if links.is_empty() {
            let removed = self.mappings.remove(&from, &to);
            return if removed {
                Ok(())
            } else {
                Err(InstructionError(format!("nothing is mapped from `{from}` to `{to}`")))
            };
        }
        let path = (from.clone(), to.clone(), links.clone());
        let check = move |fabric: &mut Fabric, _| fabric.check_path(&path.0, &path.1, &path.2);
        let hops = self.network.with(check).map_err(rejected)?.map_err(rejected)?;
        if own.and_then(|own| own.rate).is_none() && self.rate_between(&from, &to).is_none() {
            return Err(InstructionError(format!("no virtual link is between VNFs on `{from}` and `{to}`")));
        }
        let mapping = Mapping::new([from, to], links, hops, own);
        let mut planned = self.mappings.clone();
        planned.insert(mapping.clone());
        self.work_out(&mut planned).map_err(rejected)?;
        if let Some(shortage) = planned.get(&mapping.from, &mapping.to).and_then(Mapping::shortage) {
            return Err(rejected(shortage));
        }
        self.mappings.insert(mapping);
        Ok(())
    }

    /// Returns the sum of the rates of virtual links between VNFs on two nodes, or on their way there, bit/s; `None`
    /// without virtual links. A virtual link has its rate in each direction.
    fn rate_between(&self, a: &NodeId, b: &NodeId) -> Option<f64> {
        let joins = |link: &&VirtualLink| {
            let lies = |from, to| self.vim.is_on(&link.from, from) && self.vim.is_on(&link.to, to);
            lies(a, b) || lies(b, a)
        };
        let rates = self.virtual_links.iter().filter(joins).map(|link| link.rate.bits_per_second() as f64);
        rates.reduce(|sum, rate| sum + rate)
    }

    /// Carries out an instruction: scans, attachments, placements, mappings, conditions and tests. Movements belong to the
    /// Robot Middleware.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    pub fn instruct(
        &mut self,
        now: Timestamp,
        instruction: &Instruction,
    ) -> Result<Vec<Event>, InstructionError> {
        let mut events = self.follow(now, instruction)?;
        // The instruction is done, even if the network stops now.
        events.extend(self.remap().unwrap_or_default());
        Ok(events)
    }

    fn follow(&mut self, now: Timestamp, instruction: &Instruction) -> Result<Vec<Event>, InstructionError> {
        match instruction.clone() {
            Instruction::Scan { robot } => {
                self.network.scan(&robot)?;
                Ok(Vec::new())
            }
            Instruction::Attach { robot, radio_unit } => {
                self.network.attach(&robot, &radio_unit)?;
                Ok(Vec::new())
            }
            Instruction::Suggest { robot, radio_unit } => {
                let status = self.network.suggest(&robot, &radio_unit)?;
                let answer = |status| Event::SuggestionAnswered { robot, radio_unit, status };
                Ok(status.map(answer).into_iter().collect())
            }
            Instruction::Place { vnf, node } => self.vim.place(now, &vnf, &node).map_err(rejected),
            Instruction::AddVnf { vnf } => self.vim.add(now, &vnf).map_err(rejected),
            Instruction::RemoveVnf { vnf } => self.vim.remove(now, &vnf).map_err(rejected),
            Instruction::Map { from, to, links, reservation } => {
                self.map(from, to, links, reservation).map(|()| Vec::new())
            }
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
                self.network.provision(&robot, &radio_unit, access_point)?;
                Ok(Vec::new())
            }
            Instruction::Note { process, step, .. } => {
                let longest = Instruction::LONGEST_NAME;
                let fits = |name: &str| (1..=longest).contains(&name.chars().count());
                if fits(&process) && fits(&step) {
                    Ok(Vec::new())
                } else {
                    Err(InstructionError(format!("what a note names has 1 to {longest} characters")))
                }
            }
            _ => Err(InstructionError("movements are the Robot Middleware's".to_owned())),
        }
    }

    /// Returns for how long instances of VNFs have waited for a processor so far, as far as the engine knows.
    pub fn processor_waits(&self) -> Vec<InstanceWaits> {
        self.vim.processor_waits()
    }

    /// Returns what instances with demands have computed so far, as far as the engine knows.
    pub fn computed(&self) -> Vec<VnfComputed> {
        self.vim.computed()
    }

    /// Stops every VNF and waits for their ends.
    pub fn shut_down(&mut self) {
        self.vim.shut_down();
    }
}

#[cfg(test)]
mod tests;
