//! The Zenoh session of a node.

use std::sync::{
    Arc, Weak,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

use parking_lot::Mutex;
use zenoh::{
    Config, Wait,
    liveliness::LivelinessToken,
    pubsub::Subscriber,
    sample::{Sample, SampleKind},
};

use super::{
    names::{TokenOwner, all_tokens},
    shared::{Graph, Shared, refused},
    topics::{Advertised, Subscribed},
};
use crate::{
    carried::Kind,
    error::NodeError,
    names::Names,
    peers::Peers,
    qos::Qos,
    topics::{Carrier, Incoming, Inlet, Outlet},
};

/// Zenoh for a node.
pub struct Zenoh {
    shared: Arc<Shared>,
    /// The node's token; `None` after shutdown.
    told: Mutex<Option<(LivelinessToken, Subscriber<()>)>>,
}

/// Configuration of `rmw_zenoh`'s nodes by default: peers that discover each other through a router, not by multicast.
/// On one machine, they then exchange messages without the router.
fn config(router: &str) -> Result<Config, NodeError> {
    let mut config = Config::default();
    let endpoint = serde_json::Value::from(router);
    for (key, value) in [
        ("mode", r#""peer""#),
        ("connect/endpoints", &format!("[{endpoint}]")),
        ("listen/endpoints", r#"["tcp/127.0.0.1:0"]"#),
        ("scouting/multicast/enabled", "false"),
        // Latched messages arrive in the order of their timestamps.
        ("timestamping/enabled", "true"),
    ] {
        config.insert_json5(key, value).map_err(refused)?;
    }
    Ok(config)
}

impl Zenoh {
    /// Opens a session that connects to a router, and again whenever it returns.
    pub fn open(domain: u16, router: &str, names: Names) -> Result<Self, NodeError> {
        let session = zenoh::open(config(router)?).wait().map_err(refused)?;
        let own_session = session.zid().to_string();
        let owner = TokenOwner { domain, session: &own_session, names: &names };
        let token = session.liveliness().declare_token(owner.node()).wait().map_err(refused)?;
        let graph = Arc::new(Mutex::new(Graph::new(own_session)));
        let known = Arc::clone(&graph);
        let discovery = session
            .liveliness()
            .declare_subscriber(all_tokens(domain))
            .history(true)
            .callback(move |sample: Sample| {
                known.lock().apply(sample.key_expr().as_str(), sample.kind() == SampleKind::Put);
            })
            .wait()
            .map_err(refused)?;
        let shared = Arc::new(Shared {
            session,
            domain,
            names,
            graph,
            incoming: Mutex::default(),
            next_number: AtomicUsize::new(1),
            closed: AtomicBool::new(false),
        });
        Ok(Self { shared, told: Mutex::new(Some((token, discovery))) })
    }

    fn is_open(&self) -> Result<(), NodeError> {
        if self.shared.is_closed() { Err(NodeError::ShutDown) } else { Ok(()) }
    }
}

impl Carrier for Zenoh {
    fn publish(&self, topic: &str, kinds: Vec<Kind>, qos: Qos) -> Result<Box<dyn Outlet>, NodeError> {
        self.is_open()?;
        Ok(Box::new(Advertised::new(&self.shared, topic, kinds, qos)?))
    }

    fn subscribe(
        &self,
        incoming: Arc<Incoming>,
        kinds: Vec<Kind>,
        qos: Qos,
    ) -> Result<Box<dyn Inlet>, NodeError> {
        self.is_open()?;
        let mut all = self.shared.incoming.lock();
        all.retain(|incoming| incoming.strong_count() > 0);
        all.push(Arc::downgrade(&incoming));
        drop(all);
        Ok(Box::new(Subscribed::new(&self.shared, &incoming, &kinds, qos)?))
    }

    fn peers(&self, topic: &str) -> Peers {
        self.shared.graph.lock().peers(topic)
    }

    fn shut_down(&self) {
        if self.shared.closed.swap(true, Ordering::AcqRel) {
            return;
        }
        drop(self.told.lock().take());
        // Peers also notice the missing tokens.
        if let Err(error) = self.shared.session.close().wait() {
            tracing::debug!("{}: {error}", self.shared.names.node());
        }
        let incoming = std::mem::take(&mut *self.shared.incoming.lock());
        incoming.iter().filter_map(Weak::upgrade).for_each(|incoming| incoming.inbox.close());
    }

    fn is_shut_down(&self) -> bool {
        self.shared.is_closed()
    }
}
