//! The virtual networks in the catalog.

use std::collections::BTreeSet;

use cotorra_graph::{DomainId, NodeId};

use crate::{
    application::{sees, share},
    applications::Applications,
    error::{LifecycleError, conflict},
    network::{Network, NetworkDescriptor},
};

/// The most virtual networks of the operator.
const MOST_NETWORKS: usize = 256;

impl Applications {
    /// Adds a network to the catalog. Does nothing if the caller has the same one there.
    ///
    /// # Errors
    /// [`LifecycleError`] if the identifier is taken, or there are too many.
    pub fn add_network(
        &mut self,
        viewer: Option<&DomainId>,
        descriptor: NetworkDescriptor,
    ) -> Result<&Network, LifecycleError> {
        let own = self.networks.values().filter(|network| network.owner.as_ref() == viewer).count();
        let (uuid, most) = (descriptor.uuid.clone(), share(viewer, MOST_NETWORKS));
        match self.networks.get(&uuid) {
            Some(known) if sees(viewer, known.owner.as_ref()) && known.descriptor == descriptor => {}
            Some(_) => return conflict(format!("there is another network `{uuid}` already")),
            None if own >= most => {
                return conflict(format!("there are {most} of your networks already: remove one"));
            }
            None => {}
        }
        let (nodes, owner) = (BTreeSet::new(), viewer.cloned());
        Ok(self.networks.entry(uuid).or_insert(Network { descriptor, nodes, owner }))
    }

    /// Returns the networks.
    pub fn networks(&self, viewer: Option<&DomainId>) -> impl Iterator<Item = &Network> {
        self.networks.values().filter(move |network| sees(viewer, network.owner.as_ref()))
    }

    /// Returns a network.
    ///
    /// # Errors
    /// [`LifecycleError::Unknown`].
    pub fn network(&self, viewer: Option<&DomainId>, uuid: &str) -> Result<&Network, LifecycleError> {
        let found = self.networks.get(uuid).filter(|network| sees(viewer, network.owner.as_ref()));
        found.ok_or_else(|| LifecycleError::Unknown("network", uuid.to_owned()))
    }

    /// Removes a network that no instance is connected to.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn remove_network(&mut self, viewer: Option<&DomainId>, uuid: &str) -> Result<(), LifecycleError> {
        self.network(viewer, uuid)?;
        self.check_unused(uuid, None)?;
        self.networks.remove(uuid);
        Ok(())
    }

    /// Adds a network to a node, which is in the emulated network already.
    ///
    /// # Errors
    /// [`LifecycleError::Unknown`].
    pub fn connect(
        &mut self,
        viewer: Option<&DomainId>,
        uuid: &str,
        node: NodeId,
    ) -> Result<&Network, LifecycleError> {
        self.network(viewer, uuid)?;
        let network = self.networks.get_mut(uuid).expect("it was just found");
        network.nodes.insert(node);
        Ok(network)
    }

    /// Removes a network from a node without instances that are connected to it.
    ///
    /// # Errors
    /// [`LifecycleError`].
    pub fn disconnect(
        &mut self,
        viewer: Option<&DomainId>,
        uuid: &str,
        node: &NodeId,
    ) -> Result<&Network, LifecycleError> {
        if !self.network(viewer, uuid)?.nodes.contains(node) {
            return conflict(format!("the network `{uuid}` was not added to the node `{node}`"));
        }
        self.check_unused(uuid, Some(node))?;
        let network = self.networks.get_mut(uuid).expect("it was just found");
        network.nodes.remove(node);
        Ok(network)
    }

    /// Rejects a network that instances are connected to, on a node or anywhere.
    fn check_unused(&self, uuid: &str, node: Option<&NodeId>) -> Result<(), LifecycleError> {
        let connected = |id: &str| self.catalog[id].descriptor.network.as_deref() == Some(uuid);
        let is_there = |at: Option<&NodeId>| node.is_none() || node == at;
        let mut all = self.instances.values();
        let user = all.find(|one| is_there(one.node.as_ref()) && connected(&one.descriptor));
        match user {
            Some(instance) => conflict(format!(
                "the network `{uuid}` has the instance `{}`: remove that first",
                instance.id
            )),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
