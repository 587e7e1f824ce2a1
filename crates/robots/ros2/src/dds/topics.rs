//! Publishers and subscribers in DDS.

use std::sync::Arc;

use cotorra_ros_messages::queue::Waiting;
use parking_lot::Mutex;
use rustdds::{
    RTPSEntity,
    mio1::{Interest, Token},
};

use super::{
    codec,
    graph::Gid,
    shared::{LAST_WORDS, Output, Publication, Shared, Subscription},
};
use crate::{
    carried::Kind,
    error::NodeError,
    names::dds_topic,
    qos::Qos,
    topics::{Incoming, Inlet, Outlet},
};

/// Publishes a topic until it is dropped.
pub struct Advertised {
    shared: Arc<Shared>,
    publication: Arc<Publication>,
}

impl Advertised {
    pub fn new(shared: &Arc<Shared>, topic: &str, kinds: Vec<Kind>, qos: Qos) -> Result<Self, NodeError> {
        let writers = match &kinds[..] {
            [kind] => vec![Some(shared.open_writer(topic, kind, qos)?)],
            kinds => kinds.iter().map(|_| None).collect(),
        };
        let output = Mutex::new(Output { writers, waiting: Waiting::new(qos.depth()), closed: false });
        let topic = topic.to_owned();
        let publication = Arc::new(Publication { id: shared.next_id(), topic, kinds, qos, output });
        shared.state.lock().publications.insert(publication.id, Arc::clone(&publication));
        Ok(Self { shared: Arc::clone(shared), publication })
    }

    fn gids(&self) -> Vec<Gid> {
        let output = self.publication.output.lock();
        output.writers.iter().flatten().map(|writer| writer.guid().to_bytes()).collect()
    }
}

impl Outlet for Advertised {
    fn send(&self, encode: &dyn Fn(usize) -> Vec<u8>) {
        let Self { shared, publication } = self;
        let mut output = publication.output.lock();
        if output.closed {
            return;
        }
        let numbers = match &publication.kinds[..] {
            [_] => [0].into(),
            kinds => shared.graph.lock().wanted(&dds_topic(&publication.topic), kinds),
        };
        for number in numbers {
            if output.writers[number].is_none()
                && let Err(error) = publication.open(number, &mut output, shared)
            {
                let kind = publication.kinds[number].name;
                tracing::warn!("{}: not published as {kind}: {error}", publication.topic);
                continue;
            }
            output.waiting.push((number, codec::body(encode(number))));
        }
        if publication.flush_output(&mut output, shared) {
            shared.wake();
        }
    }

    fn subscribers(&self) -> usize {
        let gids = self.gids();
        let graph = self.shared.graph.lock();
        gids.iter().map(|gid| graph.connected(gid)).sum()
    }

    fn dropped(&self) -> u64 {
        self.publication.output.lock().waiting.dropped()
    }
}

impl Drop for Advertised {
    fn drop(&mut self) {
        self.shared.state.lock().publications.remove(&self.publication.id);
        let gids = self.gids();
        self.publication.close(&self.shared, LAST_WORDS);
        self.shared.forget(&gids);
    }
}

/// Subscribes to a topic until it is dropped.
pub struct Subscribed {
    shared: Arc<Shared>,
    subscription: Arc<Subscription>,
    gids: Vec<Gid>,
    ids: Vec<usize>,
}

impl Subscribed {
    pub fn new(
        shared: &Arc<Shared>,
        incoming: Arc<Incoming>,
        kinds: Vec<Kind>,
        qos: Qos,
    ) -> Result<Self, NodeError> {
        let opened: Result<Vec<_>, _> =
            kinds.iter().map(|kind| shared.open_reader(&incoming.topic, kind, qos)).collect();
        let mut readers = opened?;
        let gids = readers.iter().map(|reader| reader.guid().to_bytes()).collect();
        let ids: Vec<_> = readers.iter().map(|_| shared.next_id()).collect();
        let subscription = Arc::new(Subscription { kinds, readers: Mutex::default(), incoming });
        let mut state = shared.state.lock();
        for (number, (id, reader)) in ids.iter().zip(&mut readers).enumerate() {
            state.readers.insert(*id, (Arc::clone(&subscription), number));
            shared.registry.register(reader, Token(*id), Interest::READABLE)?;
        }
        *subscription.readers.lock() = readers;
        drop(state);
        // Messages that arrived before the registration.
        shared.wake();
        Ok(Self { shared: Arc::clone(shared), subscription, gids, ids })
    }
}

impl Inlet for Subscribed {
    fn publishers(&self) -> usize {
        let graph = self.shared.graph.lock();
        self.gids.iter().map(|gid| graph.connected(gid)).sum()
    }
}

impl Drop for Subscribed {
    fn drop(&mut self) {
        self.shared.state.lock().readers.retain(|id, _| !self.ids.contains(id));
        self.subscription.close();
        self.shared.forget(&self.gids);
    }
}
