//! Instances and a(n): the VNFs of services as applications, and which instruction `place` starts, moves or stops an instance.

use cotorra_graph::{DomainId, Instruction, NodeId, Nodes, Service, Timestamp, Vnf, VnfId};

use crate::{
    application::{Application, Seen, Stage},
    applications::{Applications, Known},
    descriptor::Descriptor,
    error::LifecycleError,
};

impl Applications {
    /// Adds a service's VNF: its descriptor under its own name, and an instance on each of its nodes. Only a domain and the
    /// operator see it; `None` is the operator alone.
    pub fn add_service_vnf(&mut self, owner: Option<DomainId>, service: &Service, vnf: &Vnf) {
        self.add_known(owner.clone(), Descriptor::of_service(service, vnf), &vnf.id);
        self.wanted.insert(vnf.id.clone(), vnf.node.clone());
        for node in vnf.node.all() {
            self.find(owner.clone(), &vnf.id, node, Seen::Starting);
        }
    }

    /// Adds an instance that was found running. Its identifier takes none from those of instances that are defined.
    fn find(&mut self, owner: Option<DomainId>, vnf: &VnfId, node: &NodeId, seen: Seen) {
        self.found += 1;
        let id = format!("c0704a00-0000-4000-8001-{:012x}", self.found);
        let instance = Application {
            id: id.clone(),
            descriptor: vnf.to_string(),
            name: None,
            description: None,
            node: Some(node.clone()),
            stage: Stage::Started(vnf.clone(), seen),
            owner,
            output: None,
            is_busy: false,
            is_found: true,
        };
        self.instances.insert(id, instance);
    }

    /// Records a(n) of a VNF, and the nodes that it was last placed on. Its instances follow: one stays on its node, one
    /// without its node has moved to a node without an instance, and one that is left over is gone. A node that is left over
    /// has an instance that others started.
    pub fn observe_nodes(&mut self, vnf: &VnfId, placed: &[NodeId], wanted: &Nodes, now: Timestamp) {
        self.wanted.insert(vnf.clone(), wanted.clone());
        if self.started(vnf).any(|instance| instance.is_busy) {
            // The outcome of the operation comes first.
            return;
        }
        let has_served = |instance: &Application| {
            !matches!(instance.stage, Stage::Started(_, Seen::Starting | Seen::Failed(_)))
        };
        let stays = |instance: &&Application| {
            let on = |nodes: &[NodeId]| instance.node.as_ref().is_some_and(|node| nodes.contains(node));
            on(placed) || (!has_served(instance) && on(wanted.all()))
        };
        let staying: Vec<_> = self.present(vnf).filter(stays).collect();
        let is_taken = |node: &&NodeId| staying.iter().any(|one| one.node.as_ref() == Some(node));
        let mut free = placed.iter().filter(|node| !is_taken(node));
        let begin_to_serve: Vec<_> = staying
            .iter()
            .filter(|one| matches!(one.stage, Stage::Started(_, Seen::Starting)))
            .filter(|one| one.node.as_ref().is_some_and(|node| placed.contains(node)))
            .map(|one| one.id.clone())
            .collect();
        let moved: Vec<_> = self
            .present(vnf)
            .filter(|instance| !stays(instance))
            .map(|instance| (instance.id.clone(), free.next().cloned()))
            .collect();
        let new: Vec<_> = free.cloned().collect();
        for id in begin_to_serve {
            self.change(&id, now, |instance| instance.stage = Stage::Started(vnf.clone(), Seen::Serves));
        }
        for (id, to) in moved {
            match to {
                Some(node) => self.change(&id, now, |instance| instance.node = Some(node)),
                // Before anything serves, nothing is gone.
                None if placed.is_empty() => {}
                None => {
                    self.change(&id, now, |one| one.stage = Stage::Started(vnf.clone(), Seen::Gone));
                    self.instances.retain(|_, instance| instance.id != id || !instance.is_found);
                }
            }
        }
        let Some(known) = self.service_vnf(vnf) else { return };
        let owner = known.owner.clone();
        new.iter().for_each(|node| self.find(owner.clone(), vnf, node, Seen::Serves));
    }

    /// Returns the instruction that places a VNF on a further node.
    pub(crate) fn place_also(&self, vnf: &VnfId, node: NodeId) -> Result<Instruction, LifecycleError> {
        place(vnf, self.nodes(vnf).iter().cloned().chain([node]).collect())
    }

    /// Returns the instruction that places a service's VNF on another node in place of an instance's, or on the nodes of the
    /// other instances only. Where there are none, it removes the VNF. An application's VNF is that of one instance.
    pub(crate) fn place_elsewhere(
        &self,
        vnf: &VnfId,
        id: &str,
        to: Option<NodeId>,
    ) -> Result<Instruction, LifecycleError> {
        let is_shared = self.service_vnf(vnf).is_some();
        let mut nodes = if is_shared { self.nodes(vnf).to_vec() } else { Vec::new() };
        match (self.place_of(vnf, id).filter(|_| is_shared), to) {
            (Some(place), Some(to)) => nodes[place] = to,
            (Some(place), None) => drop(nodes.remove(place)),
            // It leaves already, or is the only one.
            (None, to) => nodes.extend(to),
        }
        if nodes.is_empty() {
            return Ok(Instruction::RemoveVnf { vnf: vnf.clone() });
        }
        place(vnf, nodes)
    }

    /// Returns a service's VNF; `None` for a VNF that was added.
    fn service_vnf(&self, vnf: &VnfId) -> Option<&Known> {
        self.catalog.values().find(|known| known.of_service.as_ref() == Some(vnf))
    }

    /// Returns the started instances of a VNF that are not gone.
    fn present(&self, vnf: &VnfId) -> impl Iterator<Item = &Application> {
        self.started(vnf).filter(|instance| !matches!(instance.stage, Stage::Started(_, Seen::Gone)))
    }

    fn nodes(&self, vnf: &VnfId) -> &[NodeId] {
        self.wanted.get(vnf).map_or(&[], Nodes::all)
    }

    /// Returns the index of the node that an instance has, or is moving to, among those that its VNF was placed on.
    fn place_of(&self, vnf: &VnfId, id: &str) -> Option<usize> {
        let nodes = self.nodes(vnf);
        let position = |node: &NodeId| nodes.iter().position(|one| one == node);
        let place = |instance: &Application| instance.node.as_ref().and_then(position);
        if let Some(found) = place(self.instances.get(id)?) {
            return Some(found);
        }
        // Those that move are on no such node, and no instance is on the nodes that they move to.
        let moving = self.present(vnf).filter(|instance| place(instance).is_none());
        let is_free = |place: &usize| !self.present(vnf).any(|one| one.node.as_ref() == Some(&nodes[*place]));
        let mut targets = (0..nodes.len()).filter(is_free);
        moving.zip(&mut targets).find(|(instance, _)| instance.id == id).map(|(_, place)| place)
    }
}

/// Returns the instruction that places a VNF on nodes.
fn place(vnf: &VnfId, nodes: Vec<NodeId>) -> Result<Instruction, LifecycleError> {
    let node = Nodes::new(nodes).map_err(|error| LifecycleError::Conflict(error.to_string()))?;
    Ok(Instruction::Place { vnf: vnf.clone(), node })
}

#[cfg(test)]
mod tests;
