//! A node: what a program publishes and subscribes to. It owns RustDDS's participant and a thread.

mod engine;
mod topics;

use std::{
    collections::BTreeMap,
    io,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle},
};

use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity, Topic, TopicKind, dds::CreateError,
    mio1 as mio, no_key::DataWriterCdr,
};

use crate::{
    announce::{self, NodeEntitiesInfo, ParticipantEntitiesInfo},
    carried::Kind,
    config::NodeConfig,
    graph::{Gid, Graph, Peers},
    names::{NameError, Names, dds_topic, dds_type},
    qos::Qos,
    queue::lock,
};
use engine::Engine;
use topics::{Publication, Subscription};

pub use topics::{Publisher, Subscriber};

/// Why a node or a topic could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// A name is none.
    #[error(transparent)]
    Name(#[from] NameError),
    /// DDS refuses; ports or memory may be lacking.
    #[error("DDS: {0}")]
    Dds(#[from] CreateError),
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

#[derive(Debug)]
struct Running {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// What a node's thread, publishers and subscribers have in common.
pub(crate) struct Shared {
    names: Names,
    /// None once it was shut down.
    participant: Mutex<Option<Participant>>,
    state: Mutex<State>,
    graph: Mutex<Graph>,
    registry: mio::Registry,
    waker: mio::Waker,
    next_id: AtomicUsize,
    stopped: AtomicBool,
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Node").field(&self.names.node()).finish()
    }
}

/// What a node has.
#[derive(Default)]
struct State {
    publications: BTreeMap<usize, Arc<Publication>>,
    /// Each reader's subscription, and which of its types it is.
    readers: BTreeMap<usize, (Arc<Subscription>, usize)>,
}

/// The node in DDS.
struct Participant {
    dds: DomainParticipant,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    /// Tells others which endpoints are the node's.
    announcer: DataWriterCdr<ParticipantEntitiesInfo>,
    readers: Vec<Gid>,
    writers: Vec<Gid>,
}

impl Participant {
    fn new(config: &NodeConfig) -> Result<Self, CreateError> {
        let builder = DomainParticipantBuilder::new(config.domain);
        let builder = match config.interface {
            Some(interface) => builder.with_only_networks([interface]),
            None => builder,
        };
        let dds = builder.build()?;
        let none = QosPolicies::qos_none();
        let (publisher, subscriber) = (dds.create_publisher(&none)?, dds.create_subscriber(&none)?);
        let (topic, kind) = (announce::TOPIC.to_owned(), dds_type(announce::TYPE_NAME));
        let topic = dds.create_topic(topic, kind, &Qos::LATCHED.policies(true), TopicKind::NoKey)?;
        let announcer = publisher.create_datawriter_no_key(&topic, None)?;
        Ok(Self { dds, publisher, subscriber, announcer, readers: Vec::new(), writers: Vec::new() })
    }

    fn topic(&self, global: &str, kind: &Kind, policies: &QosPolicies) -> Result<Topic, CreateError> {
        self.dds.create_topic(dds_topic(global), kind.dds_name.clone(), policies, TopicKind::NoKey)
    }

    fn announce(&self, names: &Names) {
        let node = NodeEntitiesInfo {
            namespace: names.namespace().to_owned(),
            name: names.name().to_owned(),
            readers: self.readers.clone(),
            writers: self.writers.clone(),
        };
        let info = ParticipantEntitiesInfo { gid: self.dds.guid().to_bytes(), nodes: vec![node] };
        if let Err(error) = self.announcer.write(info, None) {
            tracing::warn!("{} is not announced: {}", names.node(), error.forget_data());
        }
    }
}

impl Shared {
    /// Does something with the node's participant.
    fn with<T>(&self, act: impl FnOnce(&mut Participant) -> Result<T, NodeError>) -> Result<T, NodeError> {
        lock(&self.participant).as_mut().map_or(Err(NodeError::ShutDown), act)
    }

    fn wake(&self) {
        // Without a thread, there is nothing left to do.
        let _ = self.waker.wake();
    }

    fn next_id(&self) -> usize {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
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
        let participant = Participant::new(&config)?;
        participant.announce(&names);
        let (poll, waker) = engine::poll()?;
        let shared = Arc::new(Shared {
            names,
            registry: poll.registry().try_clone()?,
            waker,
            state: Mutex::default(),
            graph: Mutex::default(),
            next_id: AtomicUsize::new(engine::FIRST_ID),
            stopped: AtomicBool::new(false),
            participant: Mutex::new(None),
        });
        let engine = Engine::new(poll, participant.dds.status_listener(), Arc::clone(&shared))?;
        *lock(&shared.participant) = Some(participant);
        let thread = thread::Builder::new().name("ros2".to_owned()).spawn(move || engine.run())?;
        Ok(Self(Arc::new(Running { shared, thread: Mutex::new(Some(thread)) })))
    }

    /// The node's global name.
    pub fn name(&self) -> String {
        self.shared().names.node()
    }

    /// The global name that a name means in this node.
    ///
    /// # Errors
    /// [`NameError`] if it is no name.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        self.shared().names.resolve(name)
    }

    /// Which types others publish on a topic, and subscribe to there, as far as they were discovered.
    ///
    /// # Errors
    /// [`NameError`] if `topic` is no name.
    pub fn peers(&self, topic: &str) -> Result<Peers, NameError> {
        let topic = dds_topic(&self.resolve(topic)?);
        Ok(lock(&self.shared().graph).peers(&topic))
    }

    /// Leaves. Publishers then publish to nobody, subscribers receive [`RecvError::ShutDown`]. What was published
    /// reliably is given some tenths of a second to arrive.
    ///
    /// [`RecvError::ShutDown`]: crate::RecvError::ShutDown
    pub fn shut_down(&self) {
        self.0.shut_down();
    }

    /// Whether the node was shut down.
    pub fn is_shut_down(&self) -> bool {
        self.shared().is_stopped()
    }

    fn shared(&self) -> &Arc<Shared> {
        &self.0.shared
    }
}

impl Running {
    fn shut_down(&self) {
        self.shared.stopped.store(true, Ordering::Release);
        self.shared.wake();
        if let Some(thread) = lock(&self.thread).take() {
            // A thread that panicked has ended, too.
            let _ = thread.join();
        }
        let State { publications, readers } = std::mem::take(&mut *lock(&self.shared.state));
        publications.values().for_each(|publication| publication.close(&self.shared));
        readers.values().for_each(|(subscription, _)| subscription.close());
        // The last one that holds it: it tells others, and waits for its threads.
        drop(lock(&self.shared.participant).take());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.shut_down();
    }
}
