//! Publishers and subscribers in Zenoh.

use std::sync::Arc;

use parking_lot::Mutex;
use twox_hash::XxHash3_128;
use zenoh::{
    Wait,
    liveliness::LivelinessToken,
    qos::CongestionControl,
    sample::{Sample, SampleKind},
};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt, AdvancedSubscriber, AdvancedSubscriberBuilderExt,
    CacheConfig, HistoryConfig,
};

use super::{
    names::{Role, topic_key},
    shared::{Shared, refused},
};
use crate::{
    carried::Kind,
    error::NodeError,
    peers::Endpoint,
    qos::Qos,
    topics::{Incoming, Inlet, Outlet},
};

/// Returns the endpoint of a topic and type.
fn endpoint(topic: &str, kind: &Kind) -> Endpoint {
    Endpoint { topic: topic.to_owned(), kind: kind.dds_name.clone(), hash: Some(kind.hash.clone()) }
}

/// Publishes a topic until it is dropped.
pub struct Advertised {
    shared: Arc<Shared>,
    topic: String,
    kinds: Vec<Kind>,
    qos: Qos,
    /// Writer of each type, once the type is published.
    writers: Mutex<Vec<Option<Writer>>>,
}

/// Publishes a topic as one type.
struct Writer {
    publisher: AdvancedPublisher<'static>,
    gid: [u8; 16],
    /// Sequence number of the last message.
    sequence: i64,
    _told: LivelinessToken,
}

impl Writer {
    fn open(shared: &Shared, topic: &str, kind: &Kind, qos: Qos) -> Result<Self, NodeError> {
        let publisher = shared
            .session
            .declare_publisher(topic_key(shared.domain, topic, kind))
            // As in `rmw_zenoh`: never waits for slow subscribers.
            .congestion_control(CongestionControl::Drop)
            .advanced();
        let publisher = if qos.latched {
            publisher.cache(CacheConfig::default().max_samples(qos.depth())).publisher_detection()
        } else {
            publisher
        };
        let publisher = publisher.wait().map_err(refused)?;
        let (told, token) = shared.tell(Role::Publisher, topic, kind, qos)?;
        shared.graph.lock().add_own(endpoint(topic, kind));
        // Identifies the publisher of a message.
        let gid = XxHash3_128::oneshot(token.as_bytes()).to_le_bytes();
        Ok(Self { publisher, gid, sequence: 0, _told: told })
    }

    fn send(&mut self, shared: &Shared, encoded: Vec<u8>) -> Result<(), zenoh::Error> {
        self.sequence += 1;
        let at = shared.session.new_timestamp().get_time().to_duration().as_nanos();
        let at = i64::try_from(at).unwrap_or(i64::MAX);
        self.publisher.put(encoded).attachment(attachment(self.sequence, at, &self.gid)).wait()
    }
}

/// Encodes `rmw_zenoh`'s attachment of a message: its number from 1, its time in ns since 1970, and its publisher.
fn attachment(sequence: i64, at: i64, gid: &[u8; 16]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(33);
    bytes.extend_from_slice(&sequence.to_le_bytes());
    bytes.extend_from_slice(&at.to_le_bytes());
    bytes.push(gid.len() as u8);
    bytes.extend_from_slice(gid);
    bytes
}

impl Advertised {
    pub fn new(shared: &Arc<Shared>, topic: &str, kinds: Vec<Kind>, qos: Qos) -> Result<Self, NodeError> {
        let writers = match &kinds[..] {
            [kind] => vec![Some(Writer::open(shared, topic, kind, qos)?)],
            kinds => kinds.iter().map(|_| None).collect(),
        };
        let (shared, topic) = (Arc::clone(shared), topic.to_owned());
        Ok(Self { shared, topic, kinds, qos, writers: Mutex::new(writers) })
    }

    /// Returns the endpoints of the types that are published.
    fn open_kinds(&self) -> Vec<Endpoint> {
        let writers = self.writers.lock();
        let open = self.kinds.iter().zip(&*writers).filter(|(_, writer)| writer.is_some());
        open.map(|(kind, _)| endpoint(&self.topic, kind)).collect()
    }
}

impl Outlet for Advertised {
    fn send(&self, encode: &dyn Fn(usize) -> Vec<u8>) {
        let Self { shared, topic, kinds, qos, writers } = self;
        let mut writers = writers.lock();
        if shared.is_closed() {
            return;
        }
        let numbers = match &kinds[..] {
            [_] => [0].into(),
            kinds => shared.graph.lock().wanted(topic, kinds),
        };
        for number in numbers {
            if writers[number].is_none() {
                match Writer::open(shared, topic, &kinds[number], *qos) {
                    Ok(writer) => writers[number] = Some(writer),
                    Err(error) => {
                        tracing::warn!("{topic}: not published as {}: {error}", kinds[number].name);
                    }
                }
            }
            if let Some(writer) = &mut writers[number]
                && let Err(error) = writer.send(shared, encode(number))
            {
                tracing::warn!("{topic}: a message is not sent: {error}");
            }
        }
    }

    fn subscribers(&self) -> usize {
        let graph = self.shared.graph.lock();
        self.open_kinds().iter().map(|own| graph.connected(own, Role::Subscriber)).sum()
    }

    fn dropped(&self) -> u64 {
        // Zenoh does not count.
        0
    }
}

impl Drop for Advertised {
    fn drop(&mut self) {
        let open = self.open_kinds();
        let mut graph = self.shared.graph.lock();
        open.iter().for_each(|own| graph.remove_own(own));
    }
}

/// Subscribes to a topic until it is dropped.
pub struct Subscribed {
    shared: Arc<Shared>,
    kinds: Vec<Endpoint>,
    _readers: Vec<(AdvancedSubscriber<()>, LivelinessToken)>,
}

impl Subscribed {
    pub fn new(
        shared: &Arc<Shared>,
        incoming: &Arc<Incoming>,
        kinds: &[Kind],
        qos: Qos,
    ) -> Result<Self, NodeError> {
        let open = |(number, kind): (usize, &Kind)| {
            let into = Arc::clone(incoming);
            let take = move |sample: Sample| {
                if sample.kind() == SampleKind::Put {
                    into.push(number, sample.payload().to_bytes().into_owned());
                }
            };
            let key = topic_key(shared.domain, &incoming.topic, kind);
            let reader = shared.session.declare_subscriber(key).callback(take).advanced();
            let reader = if qos.latched {
                reader.history(HistoryConfig::default().detect_late_publishers().max_samples(qos.depth()))
            } else {
                reader
            };
            let reader = reader.wait().map_err(refused)?;
            let (told, _) = shared.tell(Role::Subscriber, &incoming.topic, kind, qos)?;
            Ok((reader, told))
        };
        let readers = kinds.iter().enumerate().map(open).collect::<Result<_, NodeError>>()?;
        let kinds: Vec<_> = kinds.iter().map(|kind| endpoint(&incoming.topic, kind)).collect();
        kinds.iter().for_each(|own| shared.graph.lock().add_own(own.clone()));
        Ok(Self { shared: Arc::clone(shared), kinds, _readers: readers })
    }
}

impl Inlet for Subscribed {
    fn publishers(&self) -> usize {
        let graph = self.shared.graph.lock();
        self.kinds.iter().map(|own| graph.connected(own, Role::Publisher)).sum()
    }
}

impl Drop for Subscribed {
    fn drop(&mut self) {
        let mut graph = self.shared.graph.lock();
        self.kinds.iter().for_each(|own| graph.remove_own(own));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attachments_are_33_bytes() {
        let bytes = attachment(1, 0x0102_0304, &[7; 16]);
        assert_eq!(bytes[..8], [1, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[8..17], [4, 3, 2, 1, 0, 0, 0, 0, 16]);
        assert_eq!((bytes[17..].to_vec(), bytes.len()), (vec![7; 16], 33));
    }
}
