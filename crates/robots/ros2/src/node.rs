//! A node: the topics of a program, over either middleware.

use std::{fmt, sync::Arc};

use crate::{
    carried::Carried,
    config::{Middleware, NodeConfig},
    dds::Dds,
    error::NodeError,
    names::{NameError, Names},
    peers::Peers,
    qos::Qos,
    topics::{Carrier, Incoming, Publisher, Subscriber},
};

/// A ROS 2 node. Clones share the node. It leaves the network when the last is dropped.
#[derive(Debug, Clone)]
pub struct Node(Arc<Running>);

struct Running {
    names: Names,
    carrier: Box<dyn Carrier>,
}

impl fmt::Debug for Running {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names.node())
    }
}

impl Node {
    /// Starts a node. Discovery of peers takes some moments.
    ///
    /// # Errors
    /// [`NodeError`] if a name is invalid, or sockets or threads cannot be created.
    pub fn new(config: NodeConfig) -> Result<Self, NodeError> {
        let remappings = config.remappings.iter().map(|(from, to)| (from.as_str(), to.as_str()));
        let names = Names::new(&config.name, &config.namespace, remappings)?;
        let carrier: Box<dyn Carrier> = match &config.middleware {
            Middleware::Dds { interface } => Box::new(Dds::start(config.domain, *interface, names.clone())?),
            #[cfg(feature = "zenoh")]
            Middleware::Zenoh { router } => {
                Box::new(crate::zenoh::Zenoh::open(config.domain, router, names.clone())?)
            }
            #[cfg(not(feature = "zenoh"))]
            Middleware::Zenoh { .. } => return Err(NodeError::WithoutZenoh),
        };
        Ok(Self(Arc::new(Running { names, carrier })))
    }

    /// Returns the node's global name.
    pub fn name(&self) -> String {
        self.0.names.node()
    }

    /// Resolves a name of this node to its global one.
    ///
    /// # Errors
    /// [`NameError`] if `name` is invalid.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        self.0.names.resolve(name)
    }

    /// Returns the types that discovered peers publish and subscribe to on a topic.
    ///
    /// # Errors
    /// [`NameError`] if `topic` is invalid.
    pub fn peers(&self, topic: &str) -> Result<Peers, NameError> {
        Ok(self.0.carrier.peers(&self.resolve(topic)?))
    }

    /// Publishes a topic. Content of several types, such as [`Command`](crate::Command), is published as the types of the
    /// discovered subscribers.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is invalid, or the middleware fails.
    pub fn publish<M: Carried>(&self, topic: &str, qos: Qos) -> Result<Publisher<M>, NodeError> {
        let topic = self.resolve(topic)?;
        let outlet = self.0.carrier.publish(&topic, M::kinds(), qos)?;
        Ok(Publisher::new(topic, outlet))
    }

    /// Subscribes to a topic. Publishers are connected as soon as they are discovered.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is invalid, or the middleware fails.
    pub fn subscribe<M: Carried>(&self, topic: &str, qos: Qos) -> Result<Subscriber<M>, NodeError> {
        let incoming = Arc::new(Incoming::new(self.resolve(topic)?, qos));
        let inlet = self.0.carrier.subscribe(Arc::clone(&incoming), M::kinds(), qos)?;
        Ok(Subscriber::new(incoming, inlet))
    }

    /// Leaves the network. Publishers then drop messages, and subscribers receive [`RecvError::ShutDown`]. Waits some
    /// tenths of a second for reliable messages to arrive.
    ///
    /// [`RecvError::ShutDown`]: crate::RecvError::ShutDown
    pub fn shut_down(&self) {
        self.0.carrier.shut_down();
    }

    /// Whether the node was shut down.
    pub fn is_shut_down(&self) -> bool {
        self.0.carrier.is_shut_down()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.carrier.shut_down();
    }
}
