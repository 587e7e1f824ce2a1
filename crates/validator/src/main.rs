//! `cotorra-validator`: a consensus client for an Ethereum network of domains' own.
#![forbid(unsafe_code)]

use std::{path::PathBuf, process, sync::mpsc, time::Duration};

use clap::{Parser, Subcommand};
use cotorra_validator::{
    Account, Config, Key, Network, Node, Secret,
    local::{self, LocalError, LocalNetwork},
};
use miette::{IntoDiagnostic, Result, miette};
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
    /// A command to run on it, which has the nodes' WebSockets in COTORRA_TEST_LEDGER, with commas between; the network ends with it.
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
    let folder = std::env::temp_dir().join(format!("cotorra-ledger-{}", std::process::id()));
    std::fs::create_dir(&folder).into_diagnostic()?;
    let operators = || OPERATORS.iter().map(|account| account.parse().expect("they are accounts")).collect();
    let funded = if arguments.fund.is_empty() { operators() } else { arguments.fund };
    let count = arguments.validators;
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
                command.args(rest).env("COTORRA_TEST_LEDGER", urls.join(",")).status().into_diagnostic()
            }
            None => {
                let _ = stopped.recv();
                Ok(process::ExitStatus::default())
            }
        }
    });
    // What was not there before is not there afterwards; where it failed, its logs tell why.
    if matches!(result, Ok(_) | Err(LocalError::Stopped)) {
        let _ = std::fs::remove_dir_all(&folder);
    }
    let status = result.into_diagnostic()??;
    if status.success() { Ok(()) } else { Err(miette!("{}: {status}", arguments.command.join(" "))) }
}
