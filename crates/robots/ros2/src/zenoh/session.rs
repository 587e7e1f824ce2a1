//! The Zenoh session of a node, and the endpoints that it discovered.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Weak,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use parking_lot::Mutex;
use zenoh::{
    Config, Session, Wait,
    liveliness::LivelinessToken,
    pubsub::Subscriber,
    sample::{Sample, SampleKind},
};

use super::{
    names::{Role, TokenOwner, all_tokens, read_token},
    topics::{Advertised, Subscribed},
};
use crate::{
    carried::Kind,
    names::Names,
    node::NodeError,
    peers::{Endpoint, Peers, types, wanted, warn_of_other_fields},
    qos::Qos,
    topics::{Carrier, Incoming, Inlet, Outlet},
};

/// Converts an error of Zenoh.
pub fn refused(error: zenoh::Error) -> NodeError {
    NodeError::Zenoh(error.to_string())
}

/// Zenoh for a node.
pub struct Zenoh {
    shared: Arc<Shared>,
    /// The node's token; `None` after shutdown.
    told: Mutex<Option<(LivelinessToken, Subscriber<()>)>>,
}

/// State of a node that its publishers and subscribers share.
pub struct Shared {
    pub session: Session,
    pub domain: u16,
    names: Names,
    pub graph: Arc<Mutex<Graph>>,
    incoming: Mutex<Vec<Weak<Incoming>>>,
    next_number: AtomicUsize,
    closed: AtomicBool,
}

impl Shared {
    /// Announces a publisher or subscriber as long as the returned token lives. Returns the text of the token, too.
    pub fn tell(
        &self,
        role: Role,
        topic: &str,
        kind: &Kind,
        qos: Qos,
    ) -> Result<(LivelinessToken, String), NodeError> {
        let number = self.next_number.fetch_add(1, Ordering::Relaxed);
        let session = self.session.zid().to_string();
        let owner = TokenOwner { domain: self.domain, session: &session, names: &self.names };
        let token = owner.endpoint(number, role, topic, kind, qos);
        let told = self.session.liveliness().declare_token(&token).wait().map_err(refused)?;
        Ok((told, token))
    }

    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }
}

/// Discovered endpoints.
#[derive(Debug, Default)]
pub struct Graph {
    own_session: String,
    own: Vec<Endpoint>,
    /// Endpoints by token.
    others: BTreeMap<String, (String, Role, Endpoint)>,
}

impl Graph {
    /// Adds an endpoint of the node itself.
    pub fn add_own(&mut self, endpoint: Endpoint) {
        self.others.values().for_each(|(_, _, other)| warn_of_other_fields(&endpoint, other));
        self.own.push(endpoint);
    }

    /// Removes an endpoint of the node itself.
    pub fn remove_own(&mut self, endpoint: &Endpoint) {
        if let Some(place) = self.own.iter().position(|own| own == endpoint) {
            self.own.swap_remove(place);
        }
    }

    /// Applies the appearance or loss of a token.
    fn apply(&mut self, token: &str, there: bool) {
        if !there {
            self.others.remove(token);
            return;
        }
        let Some((session, role, endpoint)) = read_token(token) else { return };
        if session != self.own_session && !self.others.contains_key(token) {
            self.own.iter().for_each(|own| warn_of_other_fields(own, &endpoint));
            self.others.insert(token.to_owned(), (session.to_owned(), role, endpoint));
        }
    }

    fn all(&self, role: Role) -> impl Iterator<Item = (&str, &Endpoint)> {
        let others = self.others.values().filter(move |(_, its, _)| *its == role);
        others.map(|(session, _, endpoint)| (session.as_str(), endpoint))
    }

    /// Returns the number of remote endpoints of a role with the topic, type and hash of `own`.
    pub fn connected(&self, own: &Endpoint, role: Role) -> usize {
        self.all(role).filter(|(_, other)| *other == own).count()
    }

    /// Returns the indices of the types to publish a topic as.
    pub fn wanted(&self, topic: &str, kinds: &[Kind]) -> std::collections::BTreeSet<usize> {
        wanted(self.all(Role::Subscriber), topic, kinds)
    }

    fn peers(&self, topic: &str) -> Peers {
        let of = |role| types(self.all(role).map(|(_, other)| other), topic);
        Peers { published: of(Role::Publisher), subscribed: of(Role::Subscriber) }
    }
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
        let graph = Arc::new(Mutex::new(Graph { own_session, ..Graph::default() }));
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
