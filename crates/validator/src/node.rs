//! The shell around a validator: its clock, disk, links and execution client.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the shell that owns the clock")]

use std::{
    fs, io,
    net::TcpListener,
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard,
        mpsc::{self, Receiver, RecvTimeoutError, Sender},
    },
    thread,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use cotorra_graph::Timestamp;

use crate::{
    block::{Block, BlockId},
    consensus::{self, Consensus, Diverged, Order, Output},
    context::Height,
    engine::{Engine, EngineError, Rpc, Secret},
    hex::Bytes,
    links::{self, Heard, Links},
    network::{Account, Key, Network, NetworkError},
    pool::{self, Pool},
    sign::NetworkId,
    store::{Blocks, Notes, StoreError},
    wire::{Decided, Message},
    worker::{Job, Worker},
};

/// Between two attempts to reach the execution client.
pub(crate) const RETRY: Duration = Duration::from_millis(500);
/// Decisions in one message: so many, or so many bytes of them, about.
const SERVED: (u64, usize) = (64, 4 << 20);
/// How a validator runs.
pub struct Config {
    /// Its network.
    pub network: Network,
    /// Its key.
    pub key: Key,
    /// Where it listens for the others.
    pub listen: String,
    /// Its execution client's Engine API, such as `http://127.0.0.1:8551`.
    pub engine: String,
    /// The secret of the Engine API, where it asks for one.
    pub secret: Option<Secret>,
    /// The execution client's JSON-RPC, such as `http://127.0.0.1:8545`.
    pub rpc: String,
    /// Whether to pass on transactions, for execution clients that do not do so themselves.
    pub pass_transactions: bool,
    /// Where it keeps blocks and notes.
    pub folder: PathBuf,
    /// Who gets what transactions pay for being included.
    pub fees: Account,
    /// How long the execution client may look for transactions for a block.
    pub build: Duration,
}

/// Why a validator ends.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// See [`NetworkError`].
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// See [`StoreError`].
    #[error(transparent)]
    Store(#[from] StoreError),
    /// See [`EngineError`].
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// See [`Diverged`].
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// It cannot listen where it is to.
    #[error("{address}: {reason}")]
    Listen {
        /// Where.
        address: String,
        /// Why not.
        reason: io::Error,
    },
    /// Its folder cannot be made.
    #[error("{}: {reason}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        reason: io::Error,
    },
    /// The operating system gives it no thread.
    #[error("no thread can be started: {0}")]
    Thread(io::Error),
}

/// What a validator's threads tell it.
pub(crate) enum Event {
    Heard(Heard),
    Judged(BlockId, bool),
    Built(Order, Block),
    /// Transactions that wait here.
    Waiting(Vec<Bytes>),
    Failed(NodeError),
    Stop,
}

/// Ends a validator.
#[derive(Clone)]
pub struct Stop(Sender<Event>);

impl Stop {
    /// Ends it.
    pub fn stop(&self) {
        let _ = self.0.send(Event::Stop);
    }
}

/// A validator that is to run.
pub struct Node {
    config: Config,
    events: Sender<Event>,
    heard: Receiver<Event>,
}

impl Node {
    /// One that [`Node::run`] runs.
    pub fn new(config: Config) -> Self {
        let (events, heard) = mpsc::channel();
        Self { config, events, heard }
    }

    /// What ends it.
    pub fn stopper(&self) -> Stop {
        Stop(self.events.clone())
    }

    /// Takes part until it is stopped.
    ///
    /// # Errors
    /// [`NodeError`]: what it does not go on without.
    pub fn run(self) -> Result<(), NodeError> {
        let Self { config, events, heard } = self;
        let (validators, me) = (config.network.validators(), config.network.index_of(config.key.public())?);
        let folder = &config.folder;
        fs::create_dir_all(folder).map_err(|reason| NodeError::Folder { folder: folder.clone(), reason })?;
        let mut blocks = Blocks::open(folder)?;
        let (notes, noted) = Notes::open(folder)?;
        let listener = TcpListener::bind(&config.listen)
            .map_err(|reason| NodeError::Listen { address: config.listen.clone(), reason })?;
        let rpc = Rpc::new(&config.rpc, None);
        let Some(genesis) = until_reached(&heard, || rpc.genesis())? else { return Ok(()) };
        let network = NetworkId::new(&genesis.hash, &validators);
        let last = blocks.read(blocks.len())?.map_or(genesis, |decided| decided.block.position());
        tracing::info!(
            validator = config.network.validators[me].name,
            height = last.number,
            tolerated = validators.tolerated(),
            "takes part"
        );
        let blocks = Arc::new(Mutex::new(blocks));
        let (jobs, to_do) = mpsc::channel();
        let engine = Engine::new(&config.engine, config.secret, config.fees.0, config.build);
        let worker = Worker { engine, blocks: blocks.clone(), events: events.clone() };
        spawn("engine", move || worker.run(&to_do))?;
        if last.number > 0 {
            let _ = jobs.send(Job::Finalize(last));
        }
        let (pool, told) = mpsc::channel();
        if config.pass_transactions {
            let events = events.clone();
            spawn("pool", move || pool::pass(&rpc, &told, &events))?;
        }
        let (key, period) = (config.key.0, config.network.period());
        let settings = links::Settings { validators: validators.clone(), me, key: key.clone(), network };
        let addresses: Vec<String> =
            config.network.validators.into_iter().map(|member| member.address).collect();
        let hear = move |heard| _ = events.send(Event::Heard(heard));
        let links = Links::start(settings, listener, &addresses, hear).map_err(NodeError::Thread)?;
        let clock = Clock::new();
        let settings = consensus::Settings { validators, me, key, network, period };
        let mut consensus = Consensus::new(settings, last, clock.now());
        consensus.start(clock.now(), noted)?;
        let mut shell = Shell { links, jobs, pool, blocks, notes };
        loop {
            shell.perform(&mut consensus)?;
            match heard.recv_timeout(consensus.next_deadline().since(clock.now())) {
                Ok(Event::Heard(Heard::Message(_, Message::Transactions(transactions)))) => {
                    let _ = shell.pool.send(Pool::Take(transactions));
                }
                Ok(Event::Heard(Heard::Message(from, message))) => consensus.hear(clock.now(), from, message),
                Ok(Event::Heard(Heard::Connected)) => _ = shell.pool.send(Pool::Again),
                Ok(Event::Judged(block, is_valid)) => consensus.judged(clock.now(), block, is_valid),
                Ok(Event::Built(order, block)) => consensus.built(clock.now(), &order, block),
                Ok(Event::Waiting(transactions)) => {
                    shell.links.say(None, &Message::Transactions(transactions))
                }
                Ok(Event::Failed(error)) => return Err(error),
                Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {}
            }
            consensus.expire(clock.now());
        }
    }
}

fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> Result<(), NodeError> {
    thread::Builder::new().name(name.to_owned()).spawn(run).map(drop).map_err(NodeError::Thread)
}

/// Asks again while nobody answers; `None` when the validator is stopped meanwhile.
fn until_reached<T>(
    heard: &Receiver<Event>,
    ask: impl Fn() -> Result<T, EngineError>,
) -> Result<Option<T>, NodeError> {
    loop {
        match ask() {
            Ok(answer) => return Ok(Some(answer)),
            Err(EngineError::Away { url, reason }) => {
                tracing::info!(%url, %reason, "waits for the execution client")
            }
            Err(error) => return Err(error.into()),
        }
        if let Ok(Event::Stop) = heard.recv_timeout(RETRY) {
            return Ok(None);
        }
    }
}

/// Time of Unix as it was at the start, and on from there without jumps.
struct Clock {
    began: Instant,
    unix: Duration,
}

impl Clock {
    fn new() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { began: Instant::now(), unix }
    }

    fn now(&self) -> Timestamp {
        Timestamp::ZERO + self.unix + self.began.elapsed()
    }
}

pub(crate) fn lock(blocks: &Mutex<Blocks>) -> MutexGuard<'_, Blocks> {
    blocks.lock().expect("nobody panics with it")
}

/// What a validator's outputs go to.
struct Shell {
    links: Links,
    jobs: Sender<Job>,
    pool: Sender<Pool>,
    blocks: Arc<Mutex<Blocks>>,
    notes: Notes,
}

impl Shell {
    fn perform(&mut self, consensus: &mut Consensus) -> Result<(), NodeError> {
        while let Some(output) = consensus.poll() {
            match output {
                Output::Note(note) => self.notes.append(&note)?,
                Output::Say(to, message) => {
                    self.notes.sync()?;
                    self.links.say(to, &message);
                }
                Output::Judge(block) => _ = self.jobs.send(Job::Judge(block)),
                Output::Build(order) => _ = self.jobs.send(Job::Build(order)),
                Output::Decided(decided) => self.decided(&decided)?,
                Output::Serve(to, from) => {
                    let decided = self.serve(from)?;
                    if !decided.is_empty() {
                        self.links.say(Some(to), &Message::Decided(decided));
                    }
                }
            }
        }
        Ok(())
    }

    fn decided(&mut self, decided: &Decided) -> Result<(), NodeError> {
        lock(&self.blocks).append(decided)?;
        self.notes.clear()?;
        let (position, transactions) = (decided.block.position(), decided.block.transactions());
        tracing::info!(block = position.number, transactions, "decided");
        let _ = self.jobs.send(Job::Finalize(position));
        Ok(())
    }

    fn serve(&mut self, Height(from): Height) -> Result<Vec<Decided>, NodeError> {
        let mut blocks = lock(&self.blocks);
        let (mut decided, mut bytes) = (Vec::new(), 0);
        for number in from..from.saturating_add(SERVED.0) {
            let Some(next) = blocks.read(number)? else { break };
            bytes += next.block.size();
            decided.push(next);
            if bytes > SERVED.1 {
                break;
            }
        }
        Ok(decided)
    }
}
