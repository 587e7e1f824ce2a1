//! An agent's end.

use std::{thread, time::Duration};

use cotorra_agent_protocol::{Beat, Report, RobotCommand, RobotReading, RobotTurn, Run, Wanted};
use cotorra_graph::AgentId;
use zenoh::{
    Session, Wait,
    liveliness::LivelinessToken,
    qos::{CongestionControl, Priority},
    sample::Sample,
};

use crate::{
    config::{self, Credentials},
    error::{TransportError, session},
    keys,
};

/// Time for one file.
const FILE_TIMEOUT: Duration = Duration::from_secs(10);
/// Attempts to fetch a file, and the pause after each.
const FILE_ATTEMPTS: u32 = 10;
const FILE_PAUSE: Duration = Duration::from_millis(200);
/// Something that arrived from the core.
#[derive(Debug)]
pub enum FromCore {
    Wanted(Box<Wanted>),
    Beat(Beat),
    /// A command to its robot.
    Command(RobotCommand),
    /// A message was rejected, with the reason.
    Rejected(String),
}

/// A connection to the core, which returns by itself when it was lost.
pub struct Dialer {
    session: Session,
    agent: AgentId,
    alive: Option<(Run, LivelinessToken)>,
}

impl std::fmt::Debug for Dialer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Dialer").field("agent", &self.agent).finish_non_exhaustive()
    }
}

impl Dialer {
    /// Begins to connect to the core at `core`, such as `192.168.1.2:7447`, whose certificate has this common name. Passes what arrives to `receiver`, from
    /// threads of Zenoh.
    ///
    /// # Errors
    /// [`TransportError`] if a credential is not valid.
    pub fn open(
        core: &str,
        core_common_name: &str,
        agent: AgentId,
        credentials: Credentials<'_>,
        receiver: impl Fn(FromCore) + Clone + Send + Sync + 'static,
    ) -> Result<Self, TransportError> {
        let opened = zenoh::open(config::client(core, core_common_name, &agent, credentials)?)
            .wait()
            .map_err(session)?;
        for kind in [keys::WANTED, keys::BEAT, keys::COMMAND] {
            let receiver = receiver.clone();
            opened
                .declare_subscriber(format!("{}/{kind}", keys::of_agent(&agent)))
                .callback(move |sample: Sample| {
                    let bytes = sample.payload().to_bytes();
                    let message = match kind {
                        keys::WANTED => {
                            Wanted::decode(&bytes).map(|wanted| FromCore::Wanted(Box::new(wanted)))
                        }
                        keys::BEAT => Beat::decode(&bytes).map(FromCore::Beat),
                        _ => RobotCommand::decode(&bytes).map(FromCore::Command),
                    };
                    let message = message.unwrap_or_else(|error| FromCore::Rejected(error.to_string()));
                    receiver(message);
                })
                .background()
                .wait()
                .map_err(session)?;
        }
        Ok(Self { session: opened, agent, alive: None })
    }

    /// Sends a report. Without a connection it is lost.
    ///
    /// # Errors
    /// [`TransportError::Session`].
    pub fn report(&mut self, report: &Report) -> Result<(), TransportError> {
        let keys = keys::in_run(report.run, &self.agent);
        if self.alive.as_ref().is_none_or(|(run, _)| *run != report.run) {
            let token =
                self.session.liveliness().declare_token(format!("{keys}/{}/{}", keys::ALIVE, report.boot));
            self.alive = Some((report.run, token.wait().map_err(session)?));
        }
        put(&self.session, &format!("{keys}/{}", keys::STATE), report.encode(), Priority::RealTime)
    }

    /// Sends the context of the machine, encoded. Without a connection it is lost.
    ///
    /// # Errors
    /// [`TransportError::Session`].
    pub fn context(&self, run: Run, context: Vec<u8>) -> Result<(), TransportError> {
        let key = format!("{}/{}", keys::in_run(run, &self.agent), keys::CONTEXT);
        put(&self.session, &key, context, Priority::Data)
    }

    /// Returns a way to send what the agent's robot says on another thread.
    pub fn robot_sender(&self) -> RobotSender {
        RobotSender { session: self.session.clone(), agent: self.agent.clone() }
    }

    /// Returns a way to fetch files on another thread.
    pub fn fetcher(&self) -> Fetcher {
        Fetcher { session: self.session.clone(), agent: self.agent.clone() }
    }
}

/// Sends a message at once. One that does not fit into the buffers is lost.
fn put(opened: &Session, key: &str, bytes: Vec<u8>, priority: Priority) -> Result<(), TransportError> {
    opened
        .put(key, bytes)
        .congestion_control(CongestionControl::Drop)
        .priority(priority)
        .express(true)
        .wait()
        .map_err(session)
}

/// Sends what a robot says. Without a connection it is lost.
#[derive(Clone)]
pub struct RobotSender {
    session: Session,
    agent: AgentId,
}

impl RobotSender {
    /// Sends a reading.
    ///
    /// # Errors
    /// [`TransportError::Session`].
    pub fn reading(&self, reading: &RobotReading) -> Result<(), TransportError> {
        let key = format!("{}/{}", keys::in_run(reading.session.run, &self.agent), keys::READING);
        put(&self.session, &key, reading.encode(), Priority::RealTime)
    }

    /// Sends a turn of its lidar.
    ///
    /// # Errors
    /// [`TransportError::Session`].
    pub fn turn(&self, turn: &RobotTurn) -> Result<(), TransportError> {
        let key = format!("{}/{}", keys::in_run(turn.session.run, &self.agent), keys::TURN);
        put(&self.session, &key, turn.encode(), Priority::InteractiveHigh)
    }
}

#[allow(clippy::disallowed_methods, reason = "waits for the other end on a thread that does nothing else")]
fn pause() {
    thread::sleep(FILE_PAUSE);
}

/// Fetches files of a run from the core.
#[derive(Clone)]
pub struct Fetcher {
    session: Session,
    agent: AgentId,
}

impl Fetcher {
    /// Fetches a file by its SHA-256. Blocks until it is there, or for some seconds. The bytes are not verified.
    ///
    /// # Errors
    /// [`TransportError::NoFile`].
    pub fn fetch(&self, run: Run, sha256: &str) -> Result<Vec<u8>, TransportError> {
        let key = format!("{}/{}/{sha256}", keys::in_run(run, &self.agent), keys::FILE);
        // A core can send what it wants before this end of the connection knows that the core has files.
        for _ in 0..FILE_ATTEMPTS {
            let replies = self.session.get(&key).timeout(FILE_TIMEOUT).wait().map_err(session)?;
            while let Ok(reply) = replies.recv() {
                if let Ok(sample) = reply.result() {
                    return Ok(sample.payload().to_bytes().into_owned());
                }
            }
            pause();
        }
        Err(TransportError::NoFile(sha256.to_owned()))
    }
}
