//! A node: what a program publishes, subscribes to, serves and asks. It owns sockets, threads and a clock; protocols
//! are elsewhere.

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

/// A ROS 1 node. Clones are the same node; when the last is dropped, it unregisters and ends.
#[derive(Debug, Clone)]
pub struct Node(Arc<Running>);

#[derive(Debug)]
struct Running {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
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

    /// Publishes a topic.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, the node publishes it already, or the master fails.
    pub fn publish<M: Message>(
        &self,
        topic: &str,
        options: PublishOptions,
    ) -> Result<Publisher<M>, NodeError> {
        Publisher::advertise(self.shared(), self.resolve(topic)?, options)
    }

    /// Subscribes to a topic. Publishers are connected to in the background, and again whenever they return. Each
    /// subscriber has connections of its own.
    ///
    /// # Errors
    /// [`NodeError`] if `topic` is no name, or the master fails.
    pub fn subscribe<M: Message>(
        &self,
        topic: &str,
        options: SubscribeOptions,
    ) -> Result<Subscriber<M>, NodeError> {
        Subscriber::subscribe(self.shared(), self.resolve(topic)?, options)
    }

    /// Offers a service. `answer` gives the response to each request, or the reason why not; requests are answered
    /// one at a time, on a thread of the service's own. If it holds a clone of the node, that lives as long as the
    /// service does.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is none, the node offers it already, or the master fails.
    pub fn service<S: Service>(
        &self,
        name: &str,
        answer: impl FnMut(S::Request) -> Result<S::Response, String> + Send + 'static,
    ) -> Result<ServiceServer, NodeError> {
        ServiceServer::offer::<S>(self.shared(), self.resolve(name)?, answer)
    }

    /// Calls a service, and waits for its response so long.
    ///
    /// # Errors
    /// [`CallError`] if there is no such service, it does not answer in time, or it answers that it failed.
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
    /// [`NodeError`] if `name` is none, or the master fails.
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
