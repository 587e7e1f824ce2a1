//! `cotorra-validator`: a consensus client for an Ethereum network of domains' own.
#![forbid(unsafe_code)]

use std::{
    fs,
    path::{Path, PathBuf},
    process,
    sync::mpsc,
    time::Duration,
};

use clap::{Parser, Subcommand};
use cotorra_validator::{
    Account, Config, Key, Network, Node, Secret,
    local::{self, LocalError, LocalNetwork},
};
use miette::{Context, IntoDiagnostic, Result, miette};
use serde_json::Value;
use tracing_subscriber::EnvFilter;

/// One validator of a network of Ethereum nodes: it decides blocks with the others (BFT: two thirds of them), and drives its
/// execution client (EthereumJS, geth, reth …) by the Engine API.
#[derive(Parser)]
#[command(
    version,
    after_help = "Examples:
  cotorra-validator key domain-1.key
  cotorra-validator run --network network.json --key domain-1.key --folder data --listen 0.0.0.0:30400 \\
      --engine http://127.0.0.1:8551 --jwt jwt.hex --rpc http://127.0.0.1:8545
  cotorra-validator local --validators 4 --block-period 1"
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Makes a validator's key, and prints its public half for the network's file.
    Key {
        /// The new file.
        file: PathBuf,
    },
    /// Takes part in a network.
    Run(Box<Run>),
    /// Starts a whole network on this machine, and prints the WebSockets of its nodes; Ctrl-C ends and removes it.
    Local(Local),
}

#[derive(clap::Args)]
struct Run {
    /// The network's file, the same for all: {"block_period": SECONDS, "validators": [{"name", "key", "address"}, …]}.
    #[arg(long)]
    network: PathBuf,
    /// This validator's key.
    #[arg(long)]
    key: PathBuf,
    /// Where blocks are kept, and what it said at the height that is being decided: without that it may contradict itself there.
    #[arg(long)]
    folder: PathBuf,
    /// Where to listen for the other validators.
    #[arg(long)]
    listen: String,
    /// The execution client's Engine API.
    #[arg(long)]
    engine: String,
    /// The file with the Engine API's secret. Without one, the execution client is to ask for none.
    #[arg(long)]
    jwt: Option<PathBuf>,
    /// The execution client's JSON-RPC over HTTP.
    #[arg(long)]
    rpc: String,
    /// Pass transactions on to the other validators' execution clients, for those that do not do so themselves (EthereumJS).
    #[arg(long)]
    pass_transactions: bool,
    /// Who gets what transactions pay for being included.
    #[arg(long, default_value = "0x0000000000000000000000000000000000000000")]
    fees_to: Account,
    /// How long the execution client may look for transactions for a block, in milliseconds. geth and reth need some.
    #[arg(long, default_value_t = 100)]
    build_time: u64,
}

#[derive(clap::Args)]
struct Local {
    /// How many, one per domain. Of n, (n-1)/3 may fail: none of two or three, one of four.
    #[arg(long, default_value_t = 4)]
    validators: usize,
    /// From block to block, in seconds.
    #[arg(long, default_value_t = 5.0)]
    block_period: f64,
    /// Accounts with money; without any, those of the operators of tests.
    #[arg(long)]
    fund: Vec<Account>,
    /// @ethereumjs/client's program.
    #[arg(long, default_value = "contracts/node_modules/@ethereumjs/client/dist/esm/bin/cli.js")]
    client: PathBuf,
    /// Folder with key stores (Web3 Secret Storage), whose accounts have money, too.
    #[arg(long)]
    keys: Option<PathBuf>,
    /// A command to run on it; the network ends with it. It has the nodes' WebSockets in COTORRA_TEST_LEDGER, with commas between,
    /// and in COTORRA_LEDGER, COTORRA_LEDGER_KEYS and COTORRA_LEDGER_NETWORK what `cotorra experiment federation` wants to know.
    #[arg(last = true)]
    command: Vec<String>,
}

/// The accounts of the keys 0101…01, 0202…02, 0303…03 and 6363…63, which the tests of the ledger use.
const OPERATORS: [&str; 4] = [
    "0x1a642f0e3c3af545e7acbd38b07251b3990914f1",
    "0x5050a4f4b3f9338c3472dcc01a87c76a144b3c9c",
    "0x3325a78425f17a7e487eb5666b2bfd93abb06c70",
    "0xfc5e22c7be9d60db4bbe0345709734a815fb0e40",
];

fn main() -> Result<()> {
    let filter = EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| EnvFilter::new("cotorra_validator=info,arc_malachitebft_core_consensus=warn"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    match Arguments::parse().command {
        Command::Key { file } => {
            println!("{}", Key::create(&file).into_diagnostic()?.public());
            Ok(())
        }
        Command::Run(arguments) => run(*arguments),
        Command::Local(arguments) => local(arguments),
    }
}

fn run(arguments: Run) -> Result<()> {
    let node = Node::new(Config {
        network: Network::read(&arguments.network).into_diagnostic()?,
        key: Key::read(&arguments.key).into_diagnostic()?,
        listen: arguments.listen,
        engine: arguments.engine,
        secret: arguments.jwt.as_deref().map(Secret::read).transpose().into_diagnostic()?,
        rpc: arguments.rpc,
        pass_transactions: arguments.pass_transactions,
        folder: arguments.folder,
        fees: arguments.fees_to,
        build: Duration::from_millis(arguments.build_time),
    });
    let stop = node.stopper();
    ctrlc::set_handler(move || stop.stop()).into_diagnostic()?;
    node.run().into_diagnostic()
}

fn local(arguments: Local) -> Result<()> {
    let (stop, stopped) = mpsc::channel();
    ctrlc::set_handler(move || _ = stop.send(())).into_diagnostic()?;
    let operators = || OPERATORS.iter().map(|account| account.parse().expect("they are accounts")).collect();
    let mut funded = if arguments.fund.is_empty() { operators() } else { arguments.fund };
    if let Some(keys) = &arguments.keys {
        funded.extend(accounts(keys)?);
    }
    let count = arguments.validators;
    let folder = std::env::temp_dir().join(format!("cotorra-ledger-{}", process::id()));
    fs::create_dir(&folder).into_diagnostic()?;
    eprintln!("starting {count} execution clients and {count} validators …");
    let settings = local::Settings {
        validators: count,
        block_period: arguments.block_period,
        program: std::env::current_exe().into_diagnostic()?,
        client: arguments.client,
        funded,
        folder: folder.clone(),
    };
    let result = LocalNetwork::start(settings, || stopped.try_recv().is_ok()).map(|network| {
        let urls: Vec<String> = (0..count).map(|index| network.url(index)).collect();
        println!("{}", urls.join("\n"));
        eprintln!(
            "{} of {count} may fail; logs are in {}; Ctrl-C ends it",
            (count - 1) / 3,
            folder.display()
        );
        match arguments.command.split_first() {
            Some((program, rest)) => {
                let mut command = process::Command::new(program);
                command.args(rest).env("COTORRA_TEST_LEDGER", urls.join(","));
                // Whoever has no node of its own uses the first domain's.
                let others = urls.iter().enumerate().skip(1);
                let nodes = others.fold(urls[0].clone(), |nodes, (index, url)| {
                    format!("{nodes},domain-{}={url}", index + 1)
                });
                command.env("COTORRA_LEDGER", nodes);
                command.envs(arguments.keys.iter().map(|keys| ("COTORRA_LEDGER_KEYS", keys)));
                let network = format!("a network of {count} validators (Tendermint consensus)");
                command.env("COTORRA_LEDGER_NETWORK", network).status().into_diagnostic()
            }
            None => {
                let _ = stopped.recv();
                Ok(process::ExitStatus::default())
            }
        }
    });
    // What was not there before is not there afterwards; where it failed, its logs tell why.
    if matches!(result, Ok(_) | Err(LocalError::Stopped)) {
        let _ = fs::remove_dir_all(&folder);
    }
    let status = result.into_diagnostic()??;
    if status.success() { Ok(()) } else { Err(miette!("{}: {status}", arguments.command.join(" "))) }
}

/// The accounts of the key stores in a folder.
fn accounts(folder: &Path) -> Result<Vec<Account>> {
    let mut accounts = Vec::new();
    for entry in fs::read_dir(folder).into_diagnostic().wrap_err_with(|| folder.display().to_string())? {
        let path = entry.into_diagnostic()?.path();
        if path.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        let store: Value = serde_json::from_slice(&fs::read(&path).into_diagnostic()?).into_diagnostic()?;
        let address = store["address"].as_str().map(|address| address.trim_start_matches("0x"));
        let account = address.and_then(|address| format!("0x{address}").parse().ok());
        accounts.push(account.ok_or_else(|| miette!("{} is no key store with an address", path.display()))?);
    }
    if accounts.is_empty() { Err(miette!("{} has no key stores", folder.display())) } else { Ok(accounts) }
}
