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

/// Why a node, a topic or a service could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// A name is none.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The master is not there, or refuses.
    #[error("the master: {0}")]
    Master(#[from] RpcError),
    /// No sockets or threads.
    #[error("the node cannot run: {0}")]
    Io(#[from] io::Error),
    /// The node has that topic or service already.
    #[error("this node publishes or serves {0} already; clone the publisher for more of it")]
    Taken(String),
    /// The node was shut down.
    #[error("the node was shut down")]
    ShutDown,
}

/// What a node's threads, publishers, subscribers and servers have in common.
#[derive(Debug)]
pub(super) struct Shared {
    pub names: Names,
    pub master: Master,
    /// Address of the slave API.
    pub api: String,
    /// Where TCPROS listens.
    pub tcpros: Endpoint,
    pub state: Mutex<State>,
    /// Held while the master is told of registrations, so that they arrive in their order.
    pub registrar: Mutex<()>,
    pub commands: mpsc::Sender<Command>,
    pub waker: mio::Waker,
    pub errands: mpsc::Sender<Errand>,
    pub next_id: AtomicU64,
    pub stopped: AtomicBool,
}

/// What a node is registered for.
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
        // Without an engine, there is nothing left to do.
        if self.commands.send(command).is_ok() {
            let _ = self.waker.wake();
        }
    }

    pub fn errand(&self, errand: Errand) {
        // Without a keeper, all is unregistered.
        let _ = self.errands.send(errand);
    }

    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }

    pub fn next_id(&self) -> u64 {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    /// Adds something to the state and tells the master, or takes it back.
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

/// What the node's other threads have for this one.
#[derive(Debug)]
pub(super) enum Command {
    /// These are a subscription's publishers, says the master; unless it said otherwise since.
    Publishers { subscription: u64, publishers: Vec<String> },
    /// A connection to a publisher was made, with the header sent; or not.
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

/// What is to be told.
#[derive(Debug)]
pub(super) enum Errand {
    /// A topic is no longer published.
    Unpublished(String),
    /// A topic has a subscriber less.
    Unsubscribed(String),
    /// A service is no longer served.
    Unserved(String),
    /// A parameter has a watch less.
    Unwatched(String),
    /// All of it, and then the end.
    Stop,
}
