//! What can be typed behind `cotorra experiment`.

use std::{path::PathBuf, time::Duration};

use clap::{Args, Subcommand};
use cotorra_experiments::federation::Account;
use cotorra_graph::DomainId;
use cotorra_testbed_file::Setting;

use crate::{
    duration::parse_duration,
    history::{HISTORY_VARIABLE, Place},
};

/// Published experiments.
#[derive(Debug, Subcommand)]
pub enum Experiment {
    Okpi(OkpiArgs),
    Federation(FederationArgs),
}

/// What every experiment takes.
#[derive(Debug, Args)]
pub struct WalkArgs {
    /// Run the file as if it said something else, as in links.*.delay_scale=2; see cotorra run --help
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub settings: Vec<Setting>,
    /// Folder in which the experiment gets a folder of its own
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub out: PathBuf,
    /// Write plain lines in place of the live view
    #[arg(long)]
    pub headless: bool,
    /// Let idle cores fall asleep
    ///
    /// A run keeps up to four cores awake, at a priority that takes nothing from anyone else: a packet that has to wake a
    /// core comes some 0.1 ms later.
    #[arg(long, requires = "emulate")]
    pub save_power: bool,
    /// Only say what would be run
    #[arg(long)]
    pub dry_run: bool,
    /// Say more on standard error; twice for even more
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// OKpi beside the state of the art, along the corridor and back
///
/// The first validation of the COTORRA letter (arXiv 2101.07676): once navigation stays in the cloud and the robot
/// roams by periodic probing, and once OKpi decides on radio unit and server. It leaves a folder with the figure in the
/// published layout, the tables beside the published medians, the samples behind both, and a folder for each walk.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra experiment okpi                      in virtual time, in seconds
  cotorra experiment okpi --emulate            with real packets, in about 15 minutes
  cotorra experiment okpi --set plugins.okpi.settings.gamma=10

Exit status: 0 done, 1 error, 2 wrong usage, 3 done but the figures are not valid.")]
pub struct OkpiArgs {
    /// With real packets, one walk after the other: about 15 minutes
    #[arg(long, conflicts_with = "simulate")]
    pub emulate: bool,
    /// In virtual time, as without --emulate
    #[arg(long)]
    pub simulate: bool,
    /// The testbed file; its radio units are named as the letter's
    #[arg(long, value_name = "FILE", default_value = "testbeds/corridor.yaml")]
    pub testbed: PathBuf,
    /// Seed of everything random, in place of the file's
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// End each walk after so much time, such as 60s or 2min
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Keep the history elsewhere than in the run's folder: a SQLite file, or a database of MySQL or MariaDB
    ///
    /// Several runs can share one. A server is named as mysql://USER@HOST:PORT/DATABASE, and its password in the environment
    /// variable COTORRA_HISTORY_PASSWORD, where nobody else sees it. Needs a cotorra that was built with `--features mariadb`.
    #[arg(long, value_name = "FILE|URL", env = HISTORY_VARIABLE, hide_env_values = true)]
    pub history: Option<Place>,
    #[command(flatten)]
    pub walks: WalkArgs,
}

/// A robot leaves its domain's coverage, and another domain's virtual access point waits for it
///
/// The second validation of the COTORRA letter (arXiv 2101.07676): the robot's orchestrator foresees that it leaves coverage,
/// announces what it needs on a ledger, chooses among bids, and hands the robot over by fast transition to the virtual access
/// point that the winner deployed. It leaves a folder with the figure in the published layout, a table over block periods, all
/// steps of all runs, and a folder for each run.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra experiment federation                            in virtual time, on a modelled ledger, in seconds
  cotorra experiment federation --runs 20 --block-period 5
  cotorra experiment federation --dishonest --runs 100     how many robots dishonest providers halt, and at what cost
  cotorra experiment federation --emulate --block-period 1  with real packets and an anvil node, some three minutes a run
  COTORRA_LEDGER_PASSWORD=… cotorra experiment federation --emulate --ledger wss://node.example --keys keys \\
      --ledger domain-2=ws://127.0.0.1:8546                 on a network that is there already: domain 2 by a node of its own
  scripts/ledger-network --block-period 1 -- cotorra experiment federation --emulate
                                                            on a network of several nodes on this machine

Exit status: 0 done, 1 error, 2 wrong usage, 3 done but the figures are not valid.")]
pub struct FederationArgs {
    /// With real packets, on an anvil node, which makes blocks alone, or on --ledger: needs a cotorra built with --features ethereum
    #[arg(long, conflicts_with = "simulate")]
    pub emulate: bool,
    /// In virtual time on a modelled ledger, as without --emulate
    #[arg(long)]
    pub simulate: bool,
    /// The testbed file
    #[arg(long, value_name = "FILE", default_value = "testbeds/federation.yaml")]
    pub testbed: PathBuf,
    /// Seconds between blocks, several with commas between; on --ledger the network's own, timed unless it is given [default:
    /// 0.5,1,2,5,10]
    #[arg(long, value_name = "SECONDS", value_delimiter = ',', value_parser = parse_period)]
    pub block_period: Vec<Duration>,
    /// Runs with each block period
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Seed of the first run, in place of the file's; each other has the next
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// End each run after so much time, such as 60s or 2min [default: twice what the walk takes, and a minute]
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Instead, print how many robots dishonest providers halt, and at what cost: the negotiation alone, in virtual time, with
    /// --runs robots for each figure
    #[arg(long, conflicts_with_all = ["emulate", "block_period", "seed", "until"])]
    pub dishonest: bool,
    #[command(flatten)]
    pub walks: WalkArgs,
    #[command(flatten)]
    pub ledger: LedgerArgs,
}

/// An Ethereum network that is there already.
#[derive(Debug, Args)]
#[command(next_help_heading = "An Ethereum network")]
pub struct LedgerArgs {
    /// WebSocket of a node (ws:// or wss://): a domain's, and without DOMAIN= that of all domains that have none of their own; several
    /// with commas between
    #[arg(long = "ledger", value_name = "[DOMAIN=]URL", env = "COTORRA_LEDGER", hide_env_values = true, value_delimiter = ',',
        value_parser = parse_node, requires = "emulate", requires = "keys")]
    pub nodes: Vec<LedgerNode>,
    /// Folder with the domains' key stores, DOMAIN.json each (Web3 Secret Storage, version 3), whose password is in
    /// COTORRA_LEDGER_PASSWORD
    #[arg(long, value_name = "DIR", env = "COTORRA_LEDGER_KEYS")]
    pub keys: Option<PathBuf>,
    /// The contract, and the block that it was deployed in; without it the first domain deploys it
    #[arg(long, value_name = "ADDRESS[@BLOCK]", env = "COTORRA_LEDGER_CONTRACT", value_parser = parse_contract)]
    pub contract: Option<(Account, u64)>,
    /// How many blocks make a transaction final: 0 where consensus is final at once
    #[arg(long, value_name = "BLOCKS", env = "COTORRA_LEDGER_DEPTH", default_value_t = 0)]
    pub depth: u64,
    /// What the network is, for the figure and the table, as in "a network of 4 nodes"
    #[arg(long, value_name = "TEXT", env = "COTORRA_LEDGER_NETWORK")]
    pub network: Option<String>,
}

/// A node, and the domain whose it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LedgerNode {
    /// The domain; without one it is that of all domains that have none of their own.
    pub domain: Option<DomainId>,
    /// Its WebSocket.
    pub url: String,
}

fn parse_node(text: &str) -> Result<LedgerNode, String> {
    // URLs have `=`, too, but not before their `://`.
    let (domain, url) = match text.split_once('=') {
        Some((domain, url)) if !domain.contains("://") => {
            (Some(domain.parse::<DomainId>().map_err(|e| e.to_string())?), url)
        }
        _ => (None, text),
    };
    let host = url.strip_prefix("ws://").or_else(|| url.strip_prefix("wss://"));
    match host {
        Some(host) if !host.is_empty() => Ok(LedgerNode { domain, url: url.to_owned() }),
        _ => Err("write a WebSocket, as in ws://127.0.0.1:8546 or domain-2=wss://node.example".to_owned()),
    }
}

fn parse_contract(text: &str) -> Result<(Account, u64), String> {
    let (address, block) = text.split_once('@').unwrap_or((text, "0"));
    let block = block.parse().map_err(|_| format!("`{block}` is no number of a block"))?;
    Ok((address.parse::<Account>().map_err(|e| e.to_string())?, block))
}

/// Seconds between blocks.
fn parse_period(text: &str) -> Result<Duration, String> {
    let seconds = text.trim().trim_end_matches('s').parse::<f64>().ok();
    let seconds = seconds.filter(|seconds| (0.1..=600.0).contains(seconds));
    seconds
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "write seconds from 0.1 to 600, as in 0.5,1,5".to_owned())
}
