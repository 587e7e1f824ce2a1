//! Arguments of `cotorra-lab experiment`.

use std::{path::PathBuf, time::Duration};

use clap::{Args, Subcommand};
use cotorra::AgentArgs;
use cotorra::{FigureArgs, HISTORY_VARIABLE, HistoryLocation, TrustArgs, parse_duration, parse_seed};
use cotorra_comparisons::{
    federation::Account,
    handover::{KINDS, Kind},
    okpi::Contender,
};
use cotorra_graph::DomainId;
use cotorra_testbed_file::Setting;

use super::bundled::{CORRIDOR, CORRIDOR_WIFI, FEDERATION};

/// Published experiments.
#[derive(Debug, Subcommand)]
pub enum Experiment {
    Okpi(OkpiArgs),
    Federation(FederationArgs),
    Handover(HandoverArgs),
}

/// Arguments of every experiment.
#[derive(Debug, Args)]
pub struct WalkArgs {
    /// Override a value of the file, as in links.*.delay_scale=2; see cotorra run --help
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub settings: Vec<Setting>,
    /// Folder in which the experiment creates its own folder
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub out: PathBuf,
    #[command(flatten)]
    pub figure: FigureArgs,
    /// Write plain lines instead of the live view
    #[arg(long)]
    pub headless: bool,
    /// Only list what would be run
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub trust: TrustArgs,
    /// Log more on standard error; give it twice for even more
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// The words of the command line that have a part in results, for their manifest.
    #[arg(skip)]
    pub given: Vec<String>,
}

/// Cores of experiments that run in virtual time by default.
#[derive(Debug, Args)]
pub struct PowerArgs {
    /// Let idle cores fall asleep
    ///
    /// By default, a run keeps up to four cores awake, at idle priority, because a packet that has to wake a core arrives
    /// some 0.1 ms late.
    #[arg(long, requires = "emulate")]
    pub save_power: bool,
}

/// Compare OKpi with the state of the art, along the corridor and back
///
/// This is the first validation of the COTORRA letter (arXiv 2101.07676). On one walk, navigation stays in the cloud, and
/// the robot roams by periodic probing. On the other, OKpi decides on radio unit and server. The experiment leaves a folder
/// with the figure in the published layout, tables with the published medians, the samples of both, and a folder for each
/// walk.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra-lab experiment okpi                      in virtual time, in seconds
  cotorra-lab experiment okpi --emulate            with real packets, in about 15 minutes
  cotorra-lab experiment okpi --figure pdf,png
  cotorra-lab experiment okpi --set plugins.okpi.settings.gamma=10
  cotorra-lab experiment okpi --measured OKpi=walk.csv    beside a walk that was measured with OKpi

Exit status: 0 done, 1 error, 2 wrong usage, 3 the figures are not valid.")]
pub struct OkpiArgs {
    /// Run with real packets, one walk after the other: about 15 minutes
    #[arg(long, conflicts_with = "simulate")]
    pub emulate: bool,
    /// Run in virtual time, which is the default
    #[arg(long)]
    pub simulate: bool,
    /// The testbed file: a robot with `roaming: instructed` that walks, and its navigation; where the default does not
    /// exist, it is bundled
    ///
    /// The first service is compared. A plug-in `probing` or `okpi` that the file does not list has its default settings.
    /// Medians beside the published ones need the letter's names of radio units, R1 to R6.
    #[arg(long, value_name = "FILE", default_value = CORRIDOR)]
    pub testbed: PathBuf,
    /// Compare with a measured walk, and fit the testbed to its first half: each line has seconds, a comma and milliseconds
    ///
    /// The walk is drawn into the figure: with SoA= or OKpi= beside that walk, otherwise beside both. A table has its shares
    /// above 15 and 40 ms, p95 and p99 with 95 % intervals beside the simulated ones, of the whole walk and of both halves.
    /// The testbed is fitted to the first half and walked again, and another table compares its prediction of the second half.
    /// A sample without an answer has no milliseconds. The first line can be a head.
    #[arg(long, value_name = "[CONTENDER=]FILE", value_parser = parse_measured)]
    pub measured: Option<MeasuredFile>,
    /// Seed of everything random; default: the file's
    #[arg(long, value_name = "N", value_parser = parse_seed)]
    pub seed: Option<u64>,
    /// End each walk after this time, such as 60s or 2min
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Keep the history in a SQLite file or a MySQL or MariaDB database, instead of the run's folder
    ///
    /// Several runs can share one history. A server is named as mysql://USER@HOST:PORT/DATABASE. Set its password in the
    /// environment variable COTORRA_HISTORY_PASSWORD, where nobody else sees it. A server needs a cotorra that was built
    /// with `--features databases`.
    #[arg(long, value_name = "FILE|URL", env = HISTORY_VARIABLE, hide_env_values = true)]
    pub history: Option<HistoryLocation>,
    #[command(flatten)]
    pub power: PowerArgs,
    #[command(flatten)]
    pub walks: WalkArgs,
}

/// The file of a measured walk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeasuredFile {
    /// The contender that it is drawn beside. Without one, it is drawn beside both.
    pub contender: Option<Contender>,
    /// The file.
    pub path: PathBuf,
}

fn parse_measured(text: &str) -> Result<MeasuredFile, String> {
    let named = text.split_once('=').and_then(|(name, path)| Some((Contender::named(name)?, path)));
    let (contender, path) = named.map_or((None, text), |(contender, path)| (Some(contender), path));
    match path {
        "" => Err("write a file, as in walk.csv or OKpi=walk.csv".to_owned()),
        path => Ok(MeasuredFile { contender, path: PathBuf::from(path) }),
    }
}

/// Hand a robot that leaves its domain's coverage over to another domain's virtual access point
///
/// This is the second validation of the COTORRA letter (arXiv 2101.07676). The robot's orchestrator predicts that the robot
/// will leave coverage, announces the service that it needs on a ledger, and chooses among bids. It hands the robot over by
/// fast transition to the virtual access point that the winner deployed. The experiment leaves a folder with the figure in
/// the published layout, a table over block periods, all steps of all runs, and a folder for each run.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra-lab experiment federation                            in virtual time, on a modelled ledger, in seconds
  cotorra-lab experiment federation --runs 20 --block-period 5
  cotorra-lab experiment federation --dishonest --runs 100     count the robots that dishonest providers halt, and the cost
  cotorra-lab experiment federation --emulate --block-period 1  with real packets and an anvil node, some three minutes a run
  COTORRA_LEDGER_PASSWORD=… cotorra-lab experiment federation --emulate --ledger wss://node.example --keys keys \\
      --ledger domain-2=ws://127.0.0.1:8546                 on an existing network, with a node for domain 2
  scripts/ledger-network --block-period 1 -- cotorra-lab experiment federation --emulate
                                                            on a network of several nodes on this machine

Exit status: 0 done, 1 error, 2 wrong usage, 3 the figures are not valid.")]
pub struct FederationArgs {
    /// Run with real packets, on a single anvil node or on --ledger; needs a cotorra built with --features ethereum
    #[arg(long, conflicts_with = "simulate")]
    pub emulate: bool,
    /// Run in virtual time on a modelled ledger, which is the default
    #[arg(long)]
    pub simulate: bool,
    /// The testbed file. Where the default does not exist, it is bundled
    #[arg(long, value_name = "FILE", default_value = FEDERATION)]
    pub testbed: PathBuf,
    /// Seconds between blocks, separated by commas; with --ledger, the network's block period, which is measured if it is
    /// not given [default: 0.5,1,2,5,10]
    #[arg(long, value_name = "SECONDS", value_delimiter = ',', value_parser = parse_period)]
    pub block_period: Vec<Duration>,
    /// Number of runs with each block period
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Seed of the first run, from which the others count up; default: the file's
    #[arg(long, value_name = "N", value_parser = parse_seed)]
    pub seed: Option<u64>,
    /// End each run after this time, such as 60s or 2min [default: twice the duration of the walk, plus a minute]
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Only print how many robots dishonest providers halt, and the cost: simulates the negotiation alone, with --runs
    /// robots for each figure
    #[arg(long, conflicts_with_all = ["emulate", "block_period", "seed", "until"])]
    pub dishonest: bool,
    #[command(flatten)]
    pub power: PowerArgs,
    #[command(flatten)]
    pub walks: WalkArgs,
    #[command(flatten)]
    pub ledger: LedgerArgs,
}

/// Compare handovers on the model of the radio with those of real Wi-Fi software and of real radios
///
/// The robot walks the corridor twice on each kind of radio: once a plug-in sends it to the strongest other radio unit every
/// few seconds, and once it roams by itself, as wpa_supplicant does. The experiment compares gaps, scans and the places of
/// handovers, and says whether the model's gaps lie in the 95 % intervals of the others. The kinds are `model`, in virtual
/// time; `hwsim`: hostapd and wpa_supplicant on radios that Linux simulates, which needs a kernel with the module
/// mac80211_hwsim; and `hardware`: real radios at agents. Where your kernel has no simulated radios, build one by
/// scripts/radio-kernel, and run the experiment in it by scripts/uml.
///
/// Hardware needs a testbed file whose robots and radio units have `agent` and `interface`; the other kinds ignore them.
/// Nothing drives a real robot, unless it drives itself. So it is only sent, for as long as its walk would take, at the times at
/// which the emulated robots are. Its packets and places are not measured, and the file's services are left out.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra-lab experiment handover                          all kinds of radio that this machine has
  cotorra-lab experiment handover --kind model --runs 5
  scripts/uml --radios 0 cotorra-lab experiment handover --save-power --until 2min
                                                       in a kernel of its own with simulated radios
  cotorra-lab experiment handover --kind model --with runs/experiment-handover-…
                                                       beside real software that was measured elsewhere
  cotorra-lab experiment handover --testbed floor.yaml --kind model,hardware --until 5min
                                                       beside the access points of a floor, which have agents

Exit status: 0 done, 1 error, 2 wrong usage, 3 the figures are not valid.")]
pub struct HandoverArgs {
    /// Kinds of radio: model, hwsim, hardware; by default, all that this machine and the testbed file have
    #[arg(long = "kind", value_name = "KIND", value_delimiter = ',', value_parser = parse_kind)]
    pub kinds: Vec<Kind>,
    /// The testbed file: a robot that walks past radio units for which stations contend, and its navigation; where the default does
    /// not exist, it is bundled
    #[arg(long, value_name = "FILE", default_value = CORRIDOR_WIFI)]
    pub testbed: PathBuf,
    /// Number of times that each walk is repeated, with other seeds
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Seed of the first repetition, from which the others count up; default: the file's
    #[arg(long, value_name = "N", value_parser = parse_seed)]
    pub seed: Option<u64>,
    /// End each walk after this time, such as 60s or 2min
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Add the walks of an earlier experiment on kinds of radio that are not walked now
    #[arg(long, value_name = "FOLDER")]
    pub with: Vec<PathBuf>,
    /// Let idle cores fall asleep while packets are real
    ///
    /// By default, a run keeps up to four cores awake, which would stop the virtual time of scripts/uml.
    #[arg(long)]
    pub save_power: bool,
    #[command(flatten)]
    pub agents: AgentArgs,
    #[command(flatten)]
    pub walks: WalkArgs,
}

fn parse_kind(text: &str) -> Result<Kind, String> {
    let names = || KINDS.map(|kind| kind.name).join(", ");
    KINDS.into_iter().find(|kind| kind.name == text).ok_or_else(|| format!("write one of {}", names()))
}

/// An existing Ethereum network.
#[derive(Debug, Args)]
#[command(next_help_heading = "An Ethereum network")]
pub struct LedgerArgs {
    /// WebSocket of a domain's node (ws:// or wss://), or without DOMAIN= of all domains that have no node of their own;
    /// several are separated by commas
    #[arg(long = "ledger", value_name = "[DOMAIN=]URL", env = "COTORRA_LEDGER", hide_env_values = true, value_delimiter = ',',
        value_parser = parse_node, requires = "emulate", requires = "keys")]
    pub nodes: Vec<LedgerNode>,
    /// Folder with a key store DOMAIN.json for each domain (Web3 Secret Storage, version 3); their password is in
    /// COTORRA_LEDGER_PASSWORD
    #[arg(long, value_name = "DIR", env = "COTORRA_LEDGER_KEYS")]
    pub keys: Option<PathBuf>,
    /// The contract, and the block that it was deployed in; by default, the first domain deploys a new one
    #[arg(long, value_name = "ADDRESS[@BLOCK]", env = "COTORRA_LEDGER_CONTRACT", value_parser = parse_contract)]
    pub contract: Option<(Account, u64)>,
    /// Number of blocks after which a transaction is final: 0 if consensus is final at once
    #[arg(long, value_name = "BLOCKS", env = "COTORRA_LEDGER_DEPTH", default_value_t = 0)]
    pub depth: u64,
    /// Description of the network for the figure and the table, as in "a network of 4 nodes"
    #[arg(long, value_name = "TEXT", env = "COTORRA_LEDGER_NETWORK")]
    pub network: Option<String>,
}

/// A node of the network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LedgerNode {
    /// The domain that uses the node. Without one, it is for all domains that have no node of their own.
    pub domain: Option<DomainId>,
    /// The node's WebSocket.
    pub url: String,
}

fn parse_node(text: &str) -> Result<LedgerNode, String> {
    // A URL can have `=`, too, but only after its `://`.
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
    let block = block.parse().map_err(|_| format!("`{block}` is not a block number"))?;
    Ok((address.parse::<Account>().map_err(|e| e.to_string())?, block))
}

/// Parses seconds between blocks.
fn parse_period(text: &str) -> Result<Duration, String> {
    let seconds = text.trim().trim_end_matches('s').parse::<f64>().ok();
    let seconds = seconds.filter(|seconds| (0.1..=600.0).contains(seconds));
    seconds
        .map(Duration::from_secs_f64)
        .ok_or_else(|| "write seconds from 0.1 to 600, as in 0.5,1,5".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measured_walk_is_of_a_contender_or_of_none() {
        let parsed = |text: &str| {
            let MeasuredFile { contender, path } = parse_measured(text).unwrap();
            (contender.map(|contender| contender.name), path.display().to_string())
        };
        assert_eq!(parsed("okpi=walk.csv"), (Some("OKpi"), "walk.csv".to_owned()));
        assert_eq!(parsed("SoA=a=b.csv"), (Some("SoA"), "a=b.csv".to_owned()));
        assert_eq!(parsed("a=b.csv"), (None, "a=b.csv".to_owned()));
        assert!(parse_measured("SoA=").unwrap_err().contains("OKpi=walk.csv"));
    }
}
