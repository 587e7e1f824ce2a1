//! A network on one machine, for tests and trials: for each domain an EthereumJS execution client and a validator, each a
//! process of its own.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "waits for real processes")]

use std::{
    fs, io,
    net::TcpListener,
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::{
    engine::Rpc,
    hex,
    network::{Account, Key, Member, Network, NetworkError},
};

/// How long a network may take to make its first block.
const PATIENCE: Duration = Duration::from_secs(120);
/// Below the ports that the kernel hands out.
const PORTS: std::ops::Range<u16> = 10_000..32_000;
/// JSON-RPC over HTTP and over WebSocket, Engine API over both, devp2p, validator.
const PORTS_EACH: u16 = 6;

/// Preloaded into the execution client: its WebSocket would listen on all interfaces, whatever address it is given, and everybody
/// has the keys of a network of trials. As a URL it has no `?`, `#` or `%`.
const LOOPBACK_ONLY: &str = "data:text/javascript,\
    import { Server } from 'node:net'; \
    const listen = Server.prototype.listen; \
    Server.prototype.listen = function (port, host, ...rest) { \
        rest.unshift(host); \
        if (typeof port === 'number' && typeof host !== 'string') rest.unshift('127.0.0.1'); \
        return listen.call(this, port, ...rest); \
    };";

/// What a local network is to be.
#[derive(Debug, Clone)]
pub struct Settings {
    /// How many domains, each with a validator.
    pub validators: usize,
    /// From block to block, in seconds.
    pub block_period: f64,
    /// The program of a validator: `cotorra-validator`.
    pub program: PathBuf,
    /// `@ethereumjs/client`'s `dist/esm/bin/cli.js`.
    pub client: PathBuf,
    /// Accounts that have money from the beginning.
    pub funded: Vec<Account>,
    /// Where everything is kept.
    pub folder: PathBuf,
}

/// Why there is no network.
#[derive(Debug, thiserror::Error)]
pub enum LocalError {
    /// The execution client is not installed.
    #[error(
        "there is no execution client at {}; install it with `npm install --prefix contracts --no-save` \
         (Node.js 20 or later)",
        path.display()
    )]
    NoClient {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// A program cannot be started.
    #[error("{program} does not start: {reason}")]
    Start {
        /// The program.
        program: String,
        /// Why not.
        reason: io::Error,
    },
    /// A file cannot be written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: io::Error,
    },
    /// See [`NetworkError`].
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// There are too many domains, or none.
    #[error("a local network has 1 to 16 validators")]
    Count,
    /// No ports are free.
    #[error("there are no free ports between {} and {}", PORTS.start, PORTS.end)]
    Ports,
    /// It was stopped before its first block.
    #[error("it was stopped before its first block")]
    Stopped,
    /// It made no block.
    #[error("a process ended, or no block was made within {PATIENCE:?}; see the logs in {}", folder.display())]
    Silent {
        /// Where they are.
        folder: PathBuf,
    },
}

/// A local network. All its processes end when it is dropped.
pub struct LocalNetwork {
    settings: Settings,
    first_port: u16,
    running: Vec<Option<Domain>>,
}

/// The two processes of a domain.
struct Domain {
    client: Child,
    validator: Child,
}

impl Drop for Domain {
    fn drop(&mut self) {
        for child in [&mut self.validator, &mut self.client] {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl LocalNetwork {
    /// Starts one, and waits for its first block, unless it is to stop before.
    ///
    /// # Errors
    /// [`LocalError`].
    pub fn start(mut settings: Settings, is_stopped: impl Fn() -> bool) -> Result<Self, LocalError> {
        if !(1..=16).contains(&settings.validators) {
            return Err(LocalError::Count);
        }
        settings.client = fs::canonicalize(&settings.client)
            .map_err(|_| LocalError::NoClient { path: settings.client.clone() })?;
        let first_port = free_ports(PORTS_EACH * settings.validators as u16).ok_or(LocalError::Ports)?;
        let mut network = Self { settings, first_port, running: Vec::new() };
        network.write_files()?;
        for index in 0..network.settings.validators {
            let domain = network.spawn(index)?;
            network.running.push(Some(domain));
        }
        let began = Instant::now();
        while !(0..network.running.len()).all(|index| network.height(index).is_some_and(|height| height > 0))
        {
            if is_stopped() {
                return Err(LocalError::Stopped);
            }
            let has_ended = |child: &mut Child| !matches!(child.try_wait(), Ok(None));
            let mut domains = network.running.iter_mut().flatten();
            if began.elapsed() > PATIENCE
                || domains.any(|d| has_ended(&mut d.client) || has_ended(&mut d.validator))
            {
                return Err(LocalError::Silent { folder: network.settings.folder.clone() });
            }
            thread::sleep(Duration::from_millis(100));
        }
        Ok(network)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.settings.folder.join(name)
    }

    fn write_files(&self) -> Result<(), LocalError> {
        let mut members = Vec::new();
        for index in 0..self.settings.validators {
            let key = Key::create(&self.path(&format!("domain-{}.key", index + 1)))?;
            members.push(Member {
                name: format!("domain-{}", index + 1),
                key: key.public(),
                address: format!("127.0.0.1:{}", self.port(index, 5)),
            });
        }
        let network = Network { block_period: self.settings.block_period, validators: members };
        self.write("network.json", &serde_json::to_string_pretty(&network).expect("it has no maps"))?;
        self.write("genesis.json", &genesis(&self.settings.funded).to_string())?;
        self.write("jwt", &hex::encode(&rand::random::<[u8; 32]>()))
    }

    fn write(&self, name: &str, text: &str) -> Result<(), LocalError> {
        let path = self.path(name);
        fs::write(&path, text).map_err(|reason| LocalError::File { path, reason })
    }

    fn port(&self, index: usize, which: u16) -> u16 {
        self.first_port + PORTS_EACH * index as u16 + which
    }

    fn spawn(&self, index: usize) -> Result<Domain, LocalError> {
        let name = format!("domain-{}", index + 1);
        let folder = |of: &str| self.path(&format!("{name}.{of}"));
        let port = |which| self.port(index, which).to_string();
        let mut client = Command::new("node");
        client
            .args(["--import", LOOPBACK_ONLY])
            .arg(&self.settings.client)
            .arg("--dataDir")
            .arg(folder("chain"));
        client.arg("--gethGenesis").arg(self.path("genesis.json"));
        client.args(["--isSingleNode", "--saveReceipts", "--no-logFile", "--logLevel", "warn"]);
        client.args(["--rpc", "--rpcPort", &port(0), "--ws", "--wsPort", &port(1)]);
        client.args([
            "--rpcEngine",
            "--rpcEnginePort",
            &port(2),
            "--wsEnginePort",
            &port(3),
            "--port",
            &port(4),
        ]);
        client.arg("--jwtSecret").arg(self.path("jwt"));
        let mut client = self.run(client, &folder("client.log"))?;
        let mut validator = Command::new(&self.settings.program);
        validator.arg("run").arg("--network").arg(self.path("network.json"));
        validator.arg("--key").arg(folder("key")).arg("--folder").arg(folder("validator"));
        validator
            .args(["--engine", &format!("http://127.0.0.1:{}", port(2))])
            .arg("--jwt")
            .arg(self.path("jwt"));
        validator.args([
            "--rpc",
            &format!("http://127.0.0.1:{}", port(0)),
            "--listen",
            &format!("127.0.0.1:{}", port(5)),
        ]);
        // EthereumJS looks for transactions when it is asked for the block, and keeps those of its users to itself.
        validator.args(["--build-time", "0", "--pass-transactions"]);
        match self.run(validator, &folder("validator.log")) {
            Ok(validator) => Ok(Domain { client, validator }),
            Err(error) => {
                let _ = client.kill();
                let _ = client.wait();
                Err(error)
            }
        }
    }

    /// Starts a program whose output goes to a file, and that Ctrl-C at the terminal does not reach.
    fn run(&self, mut command: Command, log: &Path) -> Result<Child, LocalError> {
        let opened = fs::OpenOptions::new().create(true).append(true).open(log);
        let output = opened.and_then(|file| Ok((file.try_clone()?, file)));
        let (out, err) = output.map_err(|reason| LocalError::File { path: log.to_owned(), reason })?;
        command
            .current_dir(&self.settings.folder)
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(out)
            .stderr(err);
        let program = command.get_program().to_string_lossy().into_owned();
        command.spawn().map_err(|reason| LocalError::Start { program, reason })
    }

    /// The WebSocket of a domain's node.
    pub fn url(&self, index: usize) -> String {
        format!("ws://127.0.0.1:{}", self.port(index, 1))
    }

    /// What a domain's node answers, if it does.
    pub fn ask(&self, index: usize, method: &'static str, params: Value) -> Option<Value> {
        Rpc::new(&format!("http://127.0.0.1:{}", self.port(index, 0)), None).call(method, params).ok()
    }

    /// How many blocks a domain's node has behind the genesis.
    pub fn height(&self, index: usize) -> Option<u64> {
        let number = self.ask(index, "eth_blockNumber", json!([]))?;
        u64::from_str_radix(number.as_str()?.strip_prefix("0x")?, 16).ok()
    }

    /// Kills a domain's processes as a power failure would.
    pub fn kill(&mut self, index: usize) {
        self.running[index] = None;
    }

    /// Starts a domain again.
    ///
    /// # Errors
    /// [`LocalError`].
    pub fn restart(&mut self, index: usize) -> Result<(), LocalError> {
        self.running[index] = None;
        self.running[index] = Some(self.spawn(index)?);
        Ok(())
    }
}

/// A chain of the Shanghai fork from the beginning.
fn genesis(funded: &[Account]) -> Value {
    let balance =
        |account: &Account| (account.to_string(), json!({ "balance": "0xffffffffffffffffffffffff" }));
    let alloc: serde_json::Map<String, Value> = funded.iter().map(balance).collect();
    let mut config = json!({
        "chainId": 7701,
        "mergeForkBlock": 0,
        "terminalTotalDifficulty": 0,
        "terminalTotalDifficultyPassed": true,
        "shanghaiTime": 0,
    });
    for fork in [
        "homestead",
        "eip150",
        "eip155",
        "eip158",
        "byzantium",
        "constantinople",
        "petersburg",
        "istanbul",
        "berlin",
        "london",
    ] {
        config[format!("{fork}Block")] = json!(0);
    }
    json!({
        "config": config,
        "alloc": alloc,
        "nonce": "0x0",
        "timestamp": "0x5f5e1000",
        "extraData": "0x",
        "gasLimit": "0x1c9c380",
        "difficulty": "0x0",
        "mixHash": hex::encode(&[0; 32]),
        "coinbase": hex::encode(&[0; 20]),
        "baseFeePerGas": "0x7",
        "number": "0x0",
        "gasUsed": "0x0",
        "parentHash": hex::encode(&[0; 32]),
    })
}

/// So many ports in a row that nobody has; other processes look elsewhere first.
fn free_ports(count: u16) -> Option<u16> {
    let is_free = |port: u16| TcpListener::bind(("127.0.0.1", port)).is_ok();
    let choices = (PORTS.end - PORTS.start) / count;
    let offset = (std::process::id() % u32::from(choices)) as u16;
    let first = |choice| PORTS.start + (choice + offset) % choices * count;
    (0..choices).map(first).find(|first| (*first..first + count).all(is_free))
}
