//! The core's end.

use std::{collections::BTreeMap, fs, net::SocketAddr, path::PathBuf, sync::Arc};

use cotorra_agent_protocol::{Report, RobotCommand, RobotReading, RobotTurn, Run, Transmit};
use cotorra_graph::AgentId;
use zenoh::{
    Session, Wait,
    key_expr::KeyExpr,
    qos::{CongestionControl, Priority},
    query::Query,
    sample::{Locality, Sample, SampleKind},
};

use crate::{
    config::{self, Credentials, Granted},
    error::{TransportError, session},
    keys,
};

/// Messages of an agent that wait for the core. Further ones are dropped, so that a flood by one agent harms no other.
const MOST_WAITING: usize = 64;
/// Longest context, bytes.
const LONGEST_CONTEXT: usize = 256 << 10;

/// Something that arrived from an agent.
#[derive(Debug)]
pub enum FromAgent {
    /// The connection of its process with this `boot` began or ended.
    Connection {
        boot: u64,
        is_there: bool,
    },
    Report(Report),
    /// The context of its machine, encoded.
    Context(Vec<u8>),
    /// Its robot says this.
    Reading(Box<RobotReading>),
    /// A turn of its robot's lidar.
    Turn(RobotTurn),
    /// A message of it was rejected, with the reason.
    Rejected(String),
}

/// Receives what arrives: the agent, the message, and a part to keep until the message is handled. Called from threads of Zenoh.
pub type Receiver = Arc<dyn Fn(AgentId, FromAgent, Arc<()>) + Send + Sync>;

/// A router that agents connect to. Dropping it ends their connections.
pub struct Router {
    session: Session,
    /// Keys of messages, declared. Zenoh finds the way of a declared key once. It compares each message of another key with all
    /// subscriptions of all agents.
    _keys: Vec<KeyExpr<'static>>,
}

impl std::fmt::Debug for Router {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Router").finish_non_exhaustive()
    }
}

impl Router {
    /// Listens for the agents that are granted. Passes what arrives from them to `receiver`, and serves them `files` by
    /// their SHA-256.
    ///
    /// # Errors
    /// [`TransportError`], if the address cannot be used or a credential is not valid.
    pub fn open(
        listen: SocketAddr,
        credentials: Credentials<'_>,
        granted: &[Granted],
        run: Run,
        files: BTreeMap<String, PathBuf>,
        receiver: &Receiver,
    ) -> Result<Self, TransportError> {
        let config = config::router(listen, credentials, granted)?;
        let opened = zenoh::open(config).wait();
        let opened = opened.map_err(|e| TransportError::Listen { address: listen, reason: e.to_string() })?;
        let files = Arc::new(files);
        let mut agents: Vec<_> = granted.iter().map(|granted| granted.agent.clone()).collect();
        agents.sort();
        agents.dedup();
        let mut declared = Vec::new();
        for agent in agents {
            follow(&opened, run, &agent, &files, receiver)?;
            for kind in keys::MESSAGES {
                let key = opened.declare_keyexpr(format!("{}/{kind}", keys::in_run(run, &agent)));
                declared.push(key.wait().map_err(session)?);
            }
        }
        Ok(Self { session: opened, _keys: declared })
    }

    /// Sends a message to its agent. An agent that is not connected does not get it.
    ///
    /// # Errors
    /// [`TransportError::Session`] if the router is closed.
    pub fn send(&self, run: Run, transmit: &Transmit) -> Result<(), TransportError> {
        let (agent, kind, bytes) = match transmit {
            Transmit::Wanted(agent, wanted) => (agent, keys::WANTED, wanted.encode()),
            Transmit::Beat(agent, beat) => (agent, keys::BEAT, beat.encode()),
        };
        self.put(&format!("{}/{kind}", keys::in_run(run, agent)), bytes)
    }

    /// Sends a command to the robot of an agent. An agent that is not connected does not get it.
    ///
    /// # Errors
    /// [`TransportError::Session`] if the router is closed.
    pub fn command(&self, agent: &AgentId, command: &RobotCommand) -> Result<(), TransportError> {
        let keys = keys::in_run(command.session.run, agent);
        self.put(&format!("{keys}/{}", keys::COMMAND), command.encode())
    }

    fn put(&self, key: &str, bytes: Vec<u8>) -> Result<(), TransportError> {
        self.session
            .put(key, bytes)
            // Otherwise Zenoh compares the key with all subscriptions of this end, too.
            .allowed_destination(Locality::Remote)
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::RealTime)
            .express(true)
            .wait()
            .map_err(session)
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        if let Err(error) = self.session.close().wait() {
            tracing::debug!("cannot close the agents' router: {error}");
        }
    }
}

/// Receives everything of one agent. Each has subscriptions of its own, because access control compares whole key expressions.
fn follow(
    opened: &Session,
    run: Run,
    agent: &AgentId,
    files: &Arc<BTreeMap<String, PathBuf>>,
    receiver: &Receiver,
) -> Result<(), TransportError> {
    let waiting = Arc::new(());
    let keys = keys::of_agent(agent);
    let pass = {
        let (agent, receiver, waiting) = (agent.clone(), Arc::clone(receiver), waiting);
        move |message| {
            if Arc::strong_count(&waiting) <= MOST_WAITING {
                receiver(agent.clone(), message, Arc::clone(&waiting));
            }
        }
    };
    let on_state = pass.clone();
    opened
        .declare_subscriber(format!("{keys}/{}", keys::STATE))
        .callback(move |sample: Sample| {
            // Copied: a sample that is kept would hold the whole buffer that it arrived in.
            let report = Report::decode(&sample.payload().to_bytes());
            on_state(report.map_or_else(|e| FromAgent::Rejected(e.to_string()), FromAgent::Report));
        })
        .background()
        .wait()
        .map_err(session)?;
    for kind in [keys::READING, keys::TURN] {
        let on_robot = pass.clone();
        opened
            .declare_subscriber(format!("{keys}/{kind}"))
            .callback(move |sample: Sample| {
                let bytes = sample.payload().to_bytes();
                on_robot(match kind {
                    keys::READING => RobotReading::decode(&bytes).map_or_else(
                        |e| FromAgent::Rejected(e.to_string()),
                        |reading| FromAgent::Reading(Box::new(reading)),
                    ),
                    _ => RobotTurn::decode(&bytes)
                        .map_or_else(|e| FromAgent::Rejected(e.to_string()), FromAgent::Turn),
                });
            })
            .background()
            .wait()
            .map_err(session)?;
    }
    let on_context = pass.clone();
    opened
        .declare_subscriber(format!("{keys}/{}", keys::CONTEXT))
        .callback(move |sample: Sample| {
            let payload = sample.payload();
            on_context(if payload.len() > LONGEST_CONTEXT {
                FromAgent::Rejected(format!("a context of {} bytes", payload.len()))
            } else {
                FromAgent::Context(payload.to_bytes().into_owned())
            });
        })
        .background()
        .wait()
        .map_err(session)?;
    opened
        .liveliness()
        .declare_subscriber(format!("{keys}/{}/*", keys::ALIVE))
        .history(true)
        .callback(move |sample: Sample| {
            let boot = sample.key_expr().as_str().rsplit('/').next().and_then(|boot| boot.parse().ok());
            let is_there = sample.kind() == SampleKind::Put;
            boot.into_iter().for_each(|boot| pass(FromAgent::Connection { boot, is_there }));
        })
        .background()
        .wait()
        .map_err(session)?;
    let files = Arc::clone(files);
    opened
        .declare_queryable(format!("{}/{}/*", keys::in_run(run, agent), keys::FILE))
        .callback(move |query: Query| answer(&query, &files))
        .background()
        .wait()
        .map_err(session)
}

/// Answers a query for a file. Only files of the run have a SHA-256 here.
fn answer(query: &Query, files: &BTreeMap<String, PathBuf>) {
    let sha256 = query.key_expr().as_str().rsplit('/').next().unwrap_or_default();
    let Some(path) = files.get(sha256) else { return };
    match fs::read(path) {
        Ok(bytes) => {
            if let Err(error) = query.reply(query.key_expr(), bytes).wait() {
                tracing::debug!("cannot send {}: {error}", path.display());
            }
        }
        Err(error) => tracing::warn!("an agent needs {}: {error}", path.display()),
    }
}
