//! A node: what a program publishes and subscribes to, over whatever carries it.

use std::{fmt, io, sync::Arc};

use crate::{
    carried::Carried,
    config::{Middleware, NodeConfig},
    dds::Dds,
    names::{NameError, Names},
    peers::Peers,
    qos::Qos,
    topics::{Carrier, Incoming, Publisher, Subscriber},
};

/// Why a node or a topic could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// A name is none.
    #[error(transparent)]
    Name(#[from] NameError),
    /// DDS refuses; ports or memory may be lacking.
    #[error("DDS: {0}")]
    Dds(#[from] rustdds::dds::CreateError),
    /// Zenoh refuses.
    #[error("Zenoh: {0}")]
    Zenoh(String),
    /// Zenoh is left out of this build.
    #[error("this program was built without Zenoh: build it with `--features zenoh`")]
    WithoutZenoh,
    /// No thread, or nothing that wakes it.
    #[error("the node cannot run: {0}")]
    Io(#[from] io::Error),
    /// The node was shut down.
    #[error("the node was shut down")]
    ShutDown,
}

/// A ROS 2 node. Clones are the same node; when the last is dropped, it leaves.
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
    /// Starts a node; peers find it, and it them, within moments.
    ///
    /// # Errors
    /// [`NodeError`] if a name is none, or there are no sockets and threads for it.
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

    /// The node's global name.
    pub fn name(&self) -> String {
        self.0.names.node()
    }

    /// The global name that a name means in this node.
    ///
    /// # Errors
    /// [`NameError`] if it is no name.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        self.0.names.resolve(name)
    }

    /// Which types others publish on a topic, and subscribe to there, as far as they were discovered.
    ///
    /// # Errors
    /// [`NameError`] if `topic` is no name.
    pub fn peers(&self, topic: &str) -> Result<Peers, NameError> {
        Ok(self.0.carrier.peers(&self.resolve(topic)?))
    }

    /// Publishes a topic. What can be of several types, such as [`Command`](crate::Command), is published as those
    /// that its subscribers have, once these are discovered.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, or the middleware refuses.
    pub fn publish<M: Carried>(&self, topic: &str, qos: Qos) -> Result<Publisher<M>, NodeError> {
        let topic = self.resolve(topic)?;
        let outlet = self.0.carrier.publish(&topic, M::kinds(), qos)?;
        Ok(Publisher::new(topic, outlet))
    }

    /// Subscribes to a topic. Publishers are connected to as soon as they are discovered, whenever they come.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, or the middleware refuses.
    pub fn subscribe<M: Carried>(&self, topic: &str, qos: Qos) -> Result<Subscriber<M>, NodeError> {
        let incoming = Arc::new(Incoming::new(self.resolve(topic)?, qos));
        let inlet = self.0.carrier.subscribe(Arc::clone(&incoming), M::kinds(), qos)?;
        Ok(Subscriber::new(incoming, inlet))
    }

    /// Leaves. Publishers then publish to nobody, subscribers receive [`RecvError::ShutDown`]. What was published
    /// reliably is given some tenths of a second to arrive.
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
