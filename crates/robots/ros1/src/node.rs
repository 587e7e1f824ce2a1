//! A node: what a program publishes, subscribes to, serves and asks. It owns sockets, threads and a clock; protocols
//! are elsewhere.

mod engine;
mod keeper;
mod params;
mod service;
mod topics;

use std::{
    collections::BTreeMap,
    io,
    net::{IpAddr, SocketAddr, TcpListener},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
};

use cotorra_ros_messages::Message;
use parking_lot::Mutex;

use crate::{
    config::NodeConfig,
    master::{Master, RpcError},
    names::{NameError, Names},
    uri::Endpoint,
    xmlrpc::Value,
};
use engine::{Command, Engine};
use keeper::Errand;
use params::Watch;
use service::Offer;
use topics::{Publication, Subscription};

pub use cotorra_ros_messages::queue::RecvError;
pub use params::ParamWatch;
pub use service::{CallError, ServiceServer};
pub use topics::{PublishOptions, Publisher, SubscribeOptions, Subscriber};

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

/// A ROS 1 node. Clones are the same node; when the last is dropped, it unregisters and ends.
#[derive(Debug, Clone)]
pub struct Node(Arc<Running>);

#[derive(Debug)]
struct Running {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

/// What a node's threads, publishers, subscribers and servers have in common.
#[derive(Debug)]
pub(crate) struct Shared {
    names: Names,
    master: Master,
    /// Address of the slave API.
    api: String,
    /// Where TCPROS listens.
    tcpros: Endpoint,
    state: Mutex<State>,
    /// Held while the master is told of registrations, so that they arrive in their order.
    registrar: Mutex<()>,
    commands: mpsc::Sender<Command>,
    waker: mio::Waker,
    errands: mpsc::Sender<Errand>,
    next_id: AtomicU64,
    stopped: AtomicBool,
}

/// What a node is registered for.
#[derive(Debug, Default)]
struct State {
    publications: BTreeMap<String, Arc<Publication>>,
    subscriptions: BTreeMap<u64, Arc<Subscription>>,
    services: BTreeMap<String, Arc<Offer>>,
    watches: BTreeMap<u64, Arc<Watch>>,
}

impl State {
    fn subscribes(&self, topic: &str) -> bool {
        self.subscriptions.values().any(|subscription| subscription.topic == topic)
    }

    fn watches(&self, name: &str) -> bool {
        self.watches.values().any(|watch| watch.name == name)
    }

    fn is_empty(&self) -> bool {
        self.publications.is_empty()
            && self.subscriptions.is_empty()
            && self.services.is_empty()
            && self.watches.is_empty()
    }
}

impl Shared {
    fn command(&self, command: Command) {
        // Without an engine, there is nothing left to do.
        if self.commands.send(command).is_ok() {
            let _ = self.waker.wake();
        }
    }

    fn errand(&self, errand: Errand) {
        // Without a keeper, all is unregistered.
        let _ = self.errands.send(errand);
    }

    fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }

    fn next_id(&self) -> u64 {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    /// Adds something to the state and tells the master, or takes it back.
    fn register<T>(
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

impl Node {
    /// Starts a node. It is registered with the master as soon as it publishes, subscribes or serves; private
    /// parameters are set now.
    ///
    /// # Errors
    /// [`NodeError`] if a name is none, the node cannot listen, or its parameters cannot be set.
    pub fn new(config: NodeConfig) -> Result<Self, NodeError> {
        let remappings = config.remappings.iter().map(|(from, to)| (from.as_str(), to.as_str()));
        let names = Names::new(&config.name, &config.namespace, remappings)?;
        let host = config.reachable_host();
        let (slave, tcpros) = (listen(&host, 0)?, listen(&host, 0)?);
        let at = |listener: &TcpListener| -> io::Result<Endpoint> {
            Ok(Endpoint { host: host.clone(), port: listener.local_addr()?.port() })
        };
        let (api, tcpros_endpoint) = (at(&slave)?.http(), at(&tcpros)?);
        let (commands, received) = mpsc::channel();
        let (errands, to_keep) = mpsc::channel();
        let (engine, waker) = Engine::new(slave, tcpros, received)?;
        let shared = Arc::new(Shared {
            master: Master::new(config.master, names.node()),
            names,
            api,
            tcpros: tcpros_endpoint,
            state: Mutex::default(),
            registrar: Mutex::default(),
            commands,
            waker,
            errands,
            next_id: AtomicU64::new(0),
            stopped: AtomicBool::new(false),
        });
        let node = Self(Arc::new(Running { shared: Arc::clone(&shared), threads: Mutex::default() }));
        let spawn = |name: &str, run: Box<dyn FnOnce() + Send>| {
            let thread = thread::Builder::new().name(name.to_owned()).spawn(run)?;
            node.0.threads.lock().push(thread);
            io::Result::Ok(())
        };
        let keeper = Arc::clone(&shared);
        // First the one that ends the other.
        spawn("ros1-keeper", Box::new(move || keeper::run(&keeper, &to_keep)))?;
        spawn("ros1", Box::new(move || engine.run(&shared)))?;
        for (name, value) in config.params {
            node.set_param(&name, value)?;
        }
        Ok(node)
    }

    /// The node's global name.
    pub fn name(&self) -> &str {
        self.shared().names.node()
    }

    /// The global name that a name means in this node.
    ///
    /// # Errors
    /// [`NameError`] if it is no name.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        self.shared().names.resolve(name)
    }

    /// The master, for what is not of this node. Its names are global ones.
    pub fn master(&self) -> &Master {
        &self.shared().master
    }

    /// Unregisters everything and ends. Publishers then publish to nobody, subscribers receive
    /// [`RecvError::ShutDown`]. Returns when it is done: some seconds at most, if the master does not answer.
    pub fn shut_down(&self) {
        self.0.shut_down();
    }

    /// Whether the node was shut down: by [`Self::shut_down`], by `rosnode kill`, or by another node of that name.
    pub fn is_shut_down(&self) -> bool {
        self.shared().is_stopped()
    }

    /// A parameter, or a whole namespace of them; `None` if it is not set.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is none, or the master fails.
    pub fn param(&self, name: &str) -> Result<Option<Value>, NodeError> {
        Ok(self.master().param(&self.resolve(name)?)?)
    }

    /// Sets a parameter; a struct sets a whole namespace.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is none, or the master fails.
    pub fn set_param(&self, name: &str, value: impl Into<Value>) -> Result<(), NodeError> {
        let (name, value) = (self.resolve(name)?, value.into());
        self.master().set_param(&name, value.clone())?;
        // The master tells all but who set it.
        self.shared().state.lock().watches.values().for_each(|watch| watch.update(&name, &value));
        Ok(())
    }

    fn shared(&self) -> &Arc<Shared> {
        &self.0.shared
    }
}

impl Running {
    fn shut_down(&self) {
        self.shared.errand(Errand::Stop);
        for thread in self.threads.lock().drain(..) {
            // A thread that panicked has ended, too.
            let _ = thread.join();
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.shut_down();
    }
}

/// Listens where a host of that name is reached: on loopback only if it is that.
pub(crate) fn listen(host: &str, port: u16) -> io::Result<TcpListener> {
    let any: SocketAddr = match host.parse::<IpAddr>() {
        Ok(ip) if ip.is_loopback() => (ip, port).into(),
        Ok(IpAddr::V6(_)) => ([0u16; 8], port).into(),
        _ if host == "localhost" => ([127, 0, 0, 1], port).into(),
        _ => ([0; 4], port).into(),
    };
    TcpListener::bind(any)
}

/// A message's type, as connection headers and the master name it.
#[derive(Debug)]
struct Kind {
    name: &'static str,
    md5sum: String,
    definition: String,
}

impl Kind {
    fn of<M: Message>() -> Self {
        let description = M::description();
        Self { name: M::ROS1_NAME, md5sum: description.md5sum(), definition: description.ros1_text() }
    }

    /// Whether a peer's header means this type; `*` means any. An absent type counts as any: only its sum matters.
    fn check(&self, md5sum: Option<&str>, name: Option<&str>) -> Result<(), String> {
        let same = |theirs: &str, ours: &str| theirs == "*" || theirs == ours;
        let md5sum = md5sum.ok_or_else(|| "the connection header has no md5sum".to_owned())?;
        if same(md5sum, &self.md5sum) && same(name.unwrap_or("*"), self.name) {
            return Ok(());
        }
        let name = name.unwrap_or("an unnamed type");
        Err(format!("{name} with md5sum {md5sum} where {} with {} is spoken", self.name, self.md5sum))
    }
}
