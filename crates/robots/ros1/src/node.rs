//! A node: the topics, services and parameters of a program. It owns sockets, threads and a clock; protocols are in
//! other modules.

mod engine;
mod keeper;
mod kind;
mod offer;
mod params;
mod publication;
mod service;
mod shared;
mod subscription;
mod topics;
mod watch;

use std::{
    io,
    net::{IpAddr, SocketAddr, TcpListener},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use cotorra_ros_messages::{Message, Service};
use parking_lot::Mutex;

use crate::{
    config::NodeConfig,
    master::Master,
    names::{NameError, Names},
    uri::Endpoint,
    xmlrpc::Value,
};
use engine::Engine;
use shared::{Errand, Shared};

pub use cotorra_ros_messages::queue::RecvError;
pub use params::ParamWatch;
pub use publication::PublishOptions;
pub use service::{CallError, ServiceServer};
pub use shared::NodeError;
pub use subscription::SubscribeOptions;
pub use topics::{Publisher, Subscriber};

/// A ROS 1 node. Clones share the node. It unregisters and ends when the last is dropped.
#[derive(Debug, Clone)]
pub struct Node(Arc<Running>);

#[derive(Debug)]
struct Running {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl Node {
    /// Starts a node and sets its private parameters. It registers with the master as soon as it publishes, subscribes
    /// or serves.
    ///
    /// # Errors
    /// [`NodeError`] if a name is invalid, the node cannot listen, or its parameters cannot be set.
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
        // The keeper first: it ends the engine.
        spawn("ros1-keeper", Box::new(move || keeper::run(&keeper, &to_keep)))?;
        spawn("ros1", Box::new(move || engine.run(&shared)))?;
        for (name, value) in config.params {
            node.set_param(&name, value)?;
        }
        Ok(node)
    }

    /// Returns the node's global name.
    pub fn name(&self) -> &str {
        self.shared().names.node()
    }

    /// Resolves a name of this node to its global one.
    ///
    /// # Errors
    /// [`NameError`] if `name` is invalid.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        self.shared().names.resolve(name)
    }

    /// Returns the client of the master, for queries about other nodes. Its names are global.
    pub fn master(&self) -> &Master {
        &self.shared().master
    }

    /// Unregisters everything and ends the node. Publishers then drop messages, and subscribers receive
    /// [`RecvError::ShutDown`]. Blocks until that is done: for some seconds, if the master does not answer.
    pub fn shut_down(&self) {
        self.0.shut_down();
    }

    /// Whether the node was shut down: by [`Self::shut_down`], by `rosnode kill`, or by another node of its name.
    pub fn is_shut_down(&self) -> bool {
        self.shared().is_stopped()
    }

    /// Returns a parameter, or a whole namespace of them; `None` if it is not set.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is invalid, or the master fails.
    pub fn param(&self, name: &str) -> Result<Option<Value>, NodeError> {
        Ok(self.master().param(&self.resolve(name)?)?)
    }

    /// Sets a parameter; a struct sets a whole namespace.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is invalid, or the master fails.
    pub fn set_param(&self, name: &str, value: impl Into<Value>) -> Result<(), NodeError> {
        let (name, value) = (self.resolve(name)?, value.into());
        self.master().set_param(&name, value.clone())?;
        // The master notifies all watchers but the author of a change.
        self.shared().state.lock().watches.values().for_each(|watch| watch.update(&name, &value));
        Ok(())
    }

    /// Publishes a topic.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is invalid, the node publishes it already, or the master fails.
    pub fn publish<M: Message>(
        &self,
        topic: &str,
        options: PublishOptions,
    ) -> Result<Publisher<M>, NodeError> {
        Publisher::advertise(self.shared(), self.resolve(topic)?, options)
    }

    /// Subscribes to a topic. Connects to publishers in the background, and again whenever they return. Each
    /// subscriber has connections of its own.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is invalid, or the master fails.
    pub fn subscribe<M: Message>(
        &self,
        topic: &str,
        options: SubscribeOptions,
    ) -> Result<Subscriber<M>, NodeError> {
        Subscriber::subscribe(self.shared(), self.resolve(topic)?, options)
    }

    /// Offers a service. `answer` returns the response to each request, or the reason of a failure. It takes requests
    /// one at a time, on a thread of the service's own. A clone of the node in it keeps the node alive as long as the
    /// service.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is invalid, the node offers it already, or the master fails.
    pub fn service<S: Service>(
        &self,
        name: &str,
        answer: impl FnMut(S::Request) -> Result<S::Response, String> + Send + 'static,
    ) -> Result<ServiceServer, NodeError> {
        ServiceServer::offer::<S>(self.shared(), self.resolve(name)?, answer)
    }

    /// Calls a service, and waits for its response until `timeout`.
    ///
    /// # Errors
    /// [`CallError`] if the service does not exist, does not answer in time, or fails.
    pub fn call<S: Service>(
        &self,
        name: &str,
        request: &S::Request,
        timeout: Duration,
    ) -> Result<S::Response, CallError> {
        service::call::<S>(self.shared(), &self.resolve(name)?, request, timeout)
    }

    /// Watches a parameter, or a whole namespace of them.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is invalid, or the master fails.
    pub fn watch_param(&self, name: &str) -> Result<ParamWatch, NodeError> {
        ParamWatch::start(self.shared(), self.resolve(name)?)
    }

    fn shared(&self) -> &Arc<Shared> {
        &self.0.shared
    }
}

impl Running {
    fn shut_down(&self) {
        self.shared.errand(Errand::Stop);
        for thread in self.threads.lock().drain(..) {
            // A panicked thread has ended, too.
            let _ = thread.join();
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.shut_down();
    }
}

/// Listens on loopback if `host` is a loopback address, else on all addresses.
pub(crate) fn listen(host: &str, port: u16) -> io::Result<TcpListener> {
    let any: SocketAddr = match host.parse::<IpAddr>() {
        Ok(ip) if ip.is_loopback() => (ip, port).into(),
        Ok(IpAddr::V6(_)) => ([0u16; 8], port).into(),
        _ if host == "localhost" => ([127, 0, 0, 1], port).into(),
        _ => ([0; 4], port).into(),
    };
    TcpListener::bind(any)
}
