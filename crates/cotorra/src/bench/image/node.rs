//! The node of the image that is measured: a network namespace, in which an engine starts it again and again.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, Sender},
    },
    time::Duration,
};

use cotorra_containers::{Address, ContainerEngine, GuardSettings, Network, Settings, Surroundings};
use cotorra_datapath::Namespace;
use cotorra_engine::{Engine as _, EngineEvent, InstanceId, Outcome};
use cotorra_graph::{EngineKind, NodeId, Vnf};

use super::Error;

/// Time after which a start is said to wait.
const PATIENCE: Duration = Duration::from_secs(3);
/// Lines of a failed container's output that are shown.
const LINES: usize = 8;

/// Whether Ctrl-C was pressed.
#[derive(Debug, Default)]
pub struct Interrupt(AtomicBool);

impl Interrupt {
    pub fn raise(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    pub fn is_raised(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Event that a measurement waits for.
#[derive(Debug, PartialEq, Eq)]
pub enum Message {
    /// The engine has an event.
    Event,
    Interrupted,
}

struct Around {
    namespace: Namespace,
    messages: Sender<Message>,
}

impl Surroundings for Around {
    fn network(&self, _node: &NodeId) -> Result<Network, String> {
        Ok(Network::Namespace(self.namespace.path()))
    }

    fn wake(&self) {
        // The measurement may be over.
        let _ = self.messages.send(Message::Event);
    }
}

/// A node with an engine. Dropping it removes its containers.
pub struct Node {
    engine: ContainerEngine,
    around: Arc<Around>,
    folder: PathBuf,
    last: InstanceId,
}

/// Returns the node's name.
pub fn id() -> NodeId {
    NodeId::new("bench").expect("a name that is right")
}

impl Node {
    /// Creates a node whose containers write their output into a folder.
    pub fn new(
        kind: EngineKind,
        address: Address,
        folder: &Path,
        messages: Sender<Message>,
    ) -> Result<Self, Error> {
        let around = Arc::new(Around { namespace: Namespace::with_loopback()?, messages });
        let settings = Settings {
            kind,
            address,
            folder: folder.to_owned(),
            logs: folder.to_owned(),
            guard: Some(GuardSettings {
                command: ["/proc/self/exe", "guard"].map(str::to_owned).to_vec(),
                log: folder.join("containers.log"),
            }),
        };
        let surroundings: Arc<dyn Surroundings> = Arc::<Around>::clone(&around);
        let engine = ContainerEngine::new(settings, surroundings)?;
        Ok(Self { engine, around, folder: folder.to_owned(), last: InstanceId(0) })
    }

    /// Returns the engine, by whose guard containers of others can be removed, too.
    pub fn engine(&self) -> &ContainerEngine {
        &self.engine
    }

    pub fn namespace(&self) -> &Namespace {
        &self.around.namespace
    }

    /// Starts an image, and returns the time until it is ready; `None` after Ctrl-C. Calls `wait` if it takes long.
    ///
    /// # Errors
    /// The reason for which it does not serve, for people.
    #[allow(clippy::disallowed_types, reason = "real containers take real time")]
    pub fn start(
        &mut self,
        vnf: &Vnf,
        inbox: &Receiver<Message>,
        wait: &dyn Fn(),
    ) -> Result<Option<Duration>, String> {
        self.last = InstanceId(self.last.0 + 1);
        let began = std::time::Instant::now();
        self.engine.start(self.last, vnf, 0, &id())?;
        loop {
            match inbox.recv_timeout(PATIENCE) {
                Ok(Message::Interrupted) | Err(RecvTimeoutError::Disconnected) => return Ok(None),
                Ok(Message::Event) => {}
                Err(RecvTimeoutError::Timeout) => wait(),
            }
            let took = began.elapsed();
            while let Some(EngineEvent { instance, outcome }) = self.engine.poll() {
                match outcome {
                    // A container that was stopped may say that it ended.
                    _ if instance != self.last => {}
                    Outcome::Ready => return Ok(Some(took)),
                    Outcome::Failed(reason) | Outcome::Died(reason) => return Err(reason),
                }
            }
        }
    }

    /// Stops the last container, and waits until it is gone: its listeners must not be taken for those of the next.
    pub fn stop(&mut self) {
        self.engine.stop(self.last);
        self.engine.settle();
    }

    /// Returns the end of the last container's output, on lines of their own.
    pub fn output(&self) -> String {
        let log = fs::read(self.folder.join("image.log")).unwrap_or_default();
        let log = String::from_utf8_lossy(&log);
        let (_, last) = log.rsplit_once("--- instance").unwrap_or_default();
        let lines: Vec<_> = last.lines().skip(1).collect();
        let end = &lines[lines.len().saturating_sub(LINES)..];
        if end.is_empty() { String::new() } else { format!("\nIts output ends with:\n{}", end.join("\n")) }
    }
}
