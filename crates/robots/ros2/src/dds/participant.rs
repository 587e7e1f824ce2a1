//! A node in DDS: a participant of RustDDS and a thread.

use std::{
    collections::BTreeMap,
    net::IpAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use parking_lot::Mutex;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity, Topic, TopicKind, dds::CreateError,
    mio1 as mio, no_key::DataWriterCdr,
};

use super::{
    announce::{self, NodeEntitiesInfo, ParticipantEntitiesInfo},
    engine::{self, Engine},
    graph::{Gid, Graph},
    topics::{Advertised, LAST_WORDS, Publication, Subscribed, Subscription},
};
use crate::{
    carried::Kind,
    names::{Names, dds_topic, dds_type},
    node::NodeError,
    peers::Peers,
    qos::Qos,
    topics::{Carrier, Incoming, Inlet, Outlet},
};

/// DDS for a node.
pub struct Dds {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// State of a node that its thread, publishers and subscribers share.
pub struct Shared {
    pub names: Names,
    /// `None` after shutdown.
    participant: Mutex<Option<Participant>>,
    pub state: Mutex<State>,
    pub graph: Mutex<Graph>,
    pub registry: mio::Registry,
    waker: mio::Waker,
    next_id: AtomicUsize,
    stopped: AtomicBool,
}

/// Topics of a node.
#[derive(Default)]
pub struct State {
    pub publications: BTreeMap<usize, Arc<Publication>>,
    /// Subscription of each reader, with the index of its type.
    pub readers: BTreeMap<usize, (Arc<Subscription>, usize)>,
}

/// A DDS participant with its endpoints.
pub struct Participant {
    dds: DomainParticipant,
    pub publisher: rustdds::Publisher,
    pub subscriber: rustdds::Subscriber,
    /// Announces the endpoints of the node.
    announcer: DataWriterCdr<ParticipantEntitiesInfo>,
    pub readers: Vec<Gid>,
    pub writers: Vec<Gid>,
}

impl Participant {
    fn new(domain: u16, interface: Option<IpAddr>) -> Result<Self, CreateError> {
        let builder = DomainParticipantBuilder::new(domain);
        let builder = match interface {
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

    pub fn topic(&self, global: &str, kind: &Kind, policies: &QosPolicies) -> Result<Topic, CreateError> {
        self.dds.create_topic(dds_topic(global), kind.dds_name.clone(), policies, TopicKind::NoKey)
    }

    pub fn announce(&self, names: &Names) {
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
    /// Runs `act` with the node's participant.
    pub fn with<T>(
        &self,
        act: impl FnOnce(&mut Participant) -> Result<T, NodeError>,
    ) -> Result<T, NodeError> {
        self.participant.lock().as_mut().map_or(Err(NodeError::ShutDown), act)
    }

    pub fn wake(&self) {
        // Without a thread, the node has ended.
        let _ = self.waker.wake();
    }

    pub fn next_id(&self) -> usize {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }
}

impl Dds {
    /// Joins a domain over one interface, or all.
    pub fn start(domain: u16, interface: Option<IpAddr>, names: Names) -> Result<Self, NodeError> {
        let participant = Participant::new(domain, interface)?;
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
        *shared.participant.lock() = Some(participant);
        let thread = thread::Builder::new().name("ros2".to_owned()).spawn(move || engine.run())?;
        Ok(Self { shared, thread: Mutex::new(Some(thread)) })
    }
}

impl Carrier for Dds {
    fn publish(&self, topic: &str, kinds: Vec<Kind>, qos: Qos) -> Result<Box<dyn Outlet>, NodeError> {
        Ok(Box::new(Advertised::new(&self.shared, topic, kinds, qos)?))
    }

    fn subscribe(
        &self,
        incoming: Arc<Incoming>,
        kinds: Vec<Kind>,
        qos: Qos,
    ) -> Result<Box<dyn Inlet>, NodeError> {
        Ok(Box::new(Subscribed::new(&self.shared, incoming, kinds, qos)?))
    }

    fn peers(&self, topic: &str) -> Peers {
        self.shared.graph.lock().peers(&dds_topic(topic))
    }

    fn shut_down(&self) {
        self.shared.stopped.store(true, Ordering::Release);
        self.shared.wake();
        if let Some(thread) = self.thread.lock().take() {
            // A panicked thread has ended, too.
            let _ = thread.join();
        }
        let State { publications, readers } = std::mem::take(&mut *self.shared.state.lock());
        // After one publisher waited in vain, the others do not wait: together they wait as long as one.
        let mut patience = LAST_WORDS;
        for publication in publications.values() {
            if !publication.close(&self.shared, patience) {
                patience = Duration::ZERO;
            }
        }
        readers.values().for_each(|(subscription, _)| subscription.close());
        // The last reference: the participant announces its end, and waits for its threads.
        drop(self.shared.participant.lock().take());
    }

    fn is_shut_down(&self) -> bool {
        self.shared.is_stopped()
    }
}
