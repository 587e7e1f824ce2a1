//! The state that a node's threads and handles share.

use std::{
    collections::BTreeMap,
    io,
    net::TcpStream,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
};

use mio::Token;
use parking_lot::Mutex;

use super::{offer::Offer, publication::Publication, subscription::Subscription, watch::Watch};
use crate::{
    master::{Master, RpcError},
    names::{NameError, Names},
    uri::Endpoint,
};

/// Reason why a node, a topic or a service could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// A name is invalid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The master cannot be reached, or rejects the call.
    #[error("the master: {0}")]
    Master(#[from] RpcError),
    /// A socket or a thread could not be created.
    #[error("the node cannot run: {0}")]
    Io(#[from] io::Error),
    /// The node has that topic or service already.
    #[error("this node publishes or serves {0} already; clone the publisher to use it twice")]
    Taken(String),
    /// The node was shut down.
    #[error("the node was shut down")]
    ShutDown,
}

/// State of a node that its threads, publishers, subscribers and servers share.
#[derive(Debug)]
pub(super) struct Shared {
    pub names: Names,
    pub master: Master,
    /// Address of the slave API.
    pub api: String,
    /// Address of the TCPROS listener.
    pub tcpros: Endpoint,
    pub state: Mutex<State>,
    /// Held during registrations with the master, so that they arrive in order.
    pub registrar: Mutex<()>,
    pub commands: mpsc::Sender<Command>,
    pub waker: mio::Waker,
    pub errands: mpsc::Sender<Errand>,
    pub next_id: AtomicU64,
    pub stopped: AtomicBool,
}

/// Registered topics, services and watches.
#[derive(Debug, Default)]
pub(super) struct State {
    pub publications: BTreeMap<String, Arc<Publication>>,
    pub subscriptions: BTreeMap<u64, Arc<Subscription>>,
    pub services: BTreeMap<String, Arc<Offer>>,
    pub watches: BTreeMap<u64, Arc<Watch>>,
}

impl State {
    pub fn subscribes(&self, topic: &str) -> bool {
        self.subscriptions.values().any(|subscription| subscription.topic == topic)
    }

    pub fn watches(&self, name: &str) -> bool {
        self.watches.values().any(|watch| watch.name == name)
    }

    pub fn is_empty(&self) -> bool {
        self.publications.is_empty()
            && self.subscriptions.is_empty()
            && self.services.is_empty()
            && self.watches.is_empty()
    }
}

impl Shared {
    pub fn command(&self, command: Command) {
        // Without an engine, the node has ended.
        if self.commands.send(command).is_ok() {
            let _ = self.waker.wake();
        }
    }

    pub fn errand(&self, errand: Errand) {
        // Without a keeper, everything is unregistered.
        let _ = self.errands.send(errand);
    }

    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }

    pub fn next_id(&self) -> u64 {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    /// Adds something to the state and registers it with the master. Takes it back if the master fails.
    pub fn register<T>(
        &self,
        add: impl FnOnce(&mut State) -> Result<(), NodeError>,
        tell: impl FnOnce(&Master) -> Result<T, RpcError>,
        take_back: impl FnOnce(&mut State),
    ) -> Result<T, NodeError> {
        let _order = self.registrar.lock();
        {
            let mut state = self.state.lock();
            if self.is_stopped() {
                return Err(NodeError::ShutDown);
            }
            add(&mut state)?;
        }
        tell(&self.master).map_err(|error| {
            take_back(&mut self.state.lock());
            error.into()
        })
    }
}

/// A command to the engine from other threads.
#[derive(Debug)]
pub(super) enum Command {
    /// The master returned the publishers of a subscription. A newer notice from the master takes precedence.
    Publishers { subscription: u64, publishers: Vec<String> },
    /// The connection to a publisher was made and the header sent, or that failed.
    Connected { subscription: u64, publisher: String, stream: Result<TcpStream, String> },
    /// A service answered.
    Response { client: Token, response: Vec<u8> },
    /// A subscription ended.
    Unsubscribed(u64),
    /// A service ended.
    Unserved(String),
    /// The node ends.
    Stop,
}

/// A task of the keeper: unregister something.
#[derive(Debug)]
pub(super) enum Errand {
    /// A topic is no longer published.
    Unpublished(String),
    /// A subscriber of a topic was dropped.
    Unsubscribed(String),
    /// A service is no longer served.
    Unserved(String),
    /// A watch of a parameter was dropped.
    Unwatched(String),
    /// Unregister everything, then end the node.
    Stop,
}
