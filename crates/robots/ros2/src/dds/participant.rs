//! A node in DDS: a participant of RustDDS and a thread.

use std::{
    net::IpAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use parking_lot::Mutex;

use super::{
    engine::{self, Engine},
    shared::{LAST_WORDS, Participant, Shared, State},
    topics::{Advertised, Subscribed},
};
use crate::{
    carried::Kind,
    error::NodeError,
    names::{Names, dds_topic},
    peers::Peers,
    qos::Qos,
    topics::{Carrier, Incoming, Inlet, Outlet},
};

/// DDS for a node.
pub struct Dds {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
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
