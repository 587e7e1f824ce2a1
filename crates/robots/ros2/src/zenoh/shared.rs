//! State that a node's publishers and subscribers share, and the endpoints that it discovered.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Weak,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use parking_lot::Mutex;
use zenoh::{Session, Wait, liveliness::LivelinessToken};

use super::names::{Role, TokenOwner, read_token};
use crate::{
    carried::Kind,
    error::NodeError,
    names::Names,
    peers::{Endpoint, Peers, types, wanted, warn_of_other_fields},
    qos::Qos,
    topics::Incoming,
};

/// Converts an error of Zenoh.
pub fn refused(error: zenoh::Error) -> NodeError {
    NodeError::Zenoh(error.to_string())
}

/// State of a node that its publishers and subscribers share.
pub struct Shared {
    pub session: Session,
    pub domain: u16,
    pub names: Names,
    pub graph: Arc<Mutex<Graph>>,
    pub incoming: Mutex<Vec<Weak<Incoming>>>,
    pub next_number: AtomicUsize,
    pub closed: AtomicBool,
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
    pub fn new(own_session: String) -> Self {
        Self { own_session, ..Self::default() }
    }

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
    pub fn apply(&mut self, token: &str, there: bool) {
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

    pub fn peers(&self, topic: &str) -> Peers {
        let of = |role| types(self.all(role).map(|(_, other)| other), topic);
        Peers { published: of(Role::Publisher), subscribed: of(Role::Subscriber) }
    }
}
