//! What can be typed: the commands, their options, and the help that says it.

use std::{
    net::{IpAddr, SocketAddr},
    num::NonZero,
    path::PathBuf,
    time::Duration,
};

use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use cotorra_graph::{DomainId, IpNetwork, NodeId, testbed_file::Setting};
use cotorra_measurements::{Cursor, Kind, RunId, export::Format};
use cotorra_testbed::{experiment::federation::Account, sweep::Axis};

use crate::{
    history::{HISTORY_VARIABLE, Place},
    link::Link,
    netem::Netem,
    stamp::Stamp,
};

/// Where Foxglove looks by itself.
const FOXGLOVE: &str = "127.0.0.1:8765";

/// Where a run serves its API unless that is taken.
pub const DEFAULT_API: &str = "127.0.0.1:7700";

/// A context-aware testbed for networked robots.
///
/// cotorra brings a testbed file to life on this machine - robots, radio units, switches, servers and the links
/// between them, with real packets - and measures whether a robot that offloads its navigation keeps its target
/// service time.
#[derive(Debug, Parser)]
#[command(name = "cotorra", version, max_term_width = 100, after_long_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

const EXAMPLES: &str = "\
Examples:
  cotorra doctor                                   what this machine can do
  cotorra check testbeds/corridor.yaml             is this testbed file right?
  cotorra run testbeds/corridor.yaml               bring it up, walk it, measure it
  cotorra sweep testbeds/corridor.yaml --seeds 10  run it ten times in virtual time
  cotorra experiment okpi                          repeat the published comparison
  cotorra history series latest service            what did the last run measure?
  cotorra exec robot -- ping cloud                 run a program inside a node meanwhile
  cotorra link set lan-cloud --delay 40ms          change what a link does meanwhile

Exit status:
  0  done
  1  an error, told on standard error
  2  wrong usage
  3  the run is done and its report written, but its verdict says that the figures are not valid";

#[derive(Debug, Subcommand)]
pub enum Command {
    Run(RunArgs),
    Sweep(SweepArgs),
    /// Repeat a published experiment, and set it beside what was published
    Experiment {
        #[command(subcommand)]
        experiment: Experiment,
    },
    /// Ask what runs recorded
    ///
    /// RUN is the folder of a run, `latest` for the newest under runs/, or the number of a run in the history that
    /// --history or COTORRA_HISTORY names. Answers are bounded, and say how to see more.
    #[command(after_long_help = HISTORY_EXAMPLES)]
    History {
        #[command(subcommand)]
        question: History,
    },
    Replay(ReplayArgs),
    Localize(LocalizeArgs),
    Check(CheckArgs),
    /// Print the JSON Schema of a testbed file
    ///
    /// Editors use it to complete and explain keys, and to mark mistakes while one types.
    #[command(after_long_help = "\
Examples:
  cotorra schema > testbed.schema.json
  # then, as the first line of a testbed file:
  # yaml-language-server: $schema=testbed.schema.json")]
    Schema,
    /// Print the OpenAPI document of the HTTP API
    ///
    /// The same that a run serves at /openapi.json.
    #[command(name = "openapi")]
    OpenApi {
        /// That of the WLAN Access Information Service, which a run serves at /wai/v2/openapi.json
        #[arg(long)]
        wais: bool,
    },
    /// Say what this machine can do, and what to do about the rest
    ///
    /// Everything is tried, nothing is left behind. What is missing comes with the reason and a remedy; most of it
    /// is not needed.
    Doctor,
    Clean(CleanArgs),
    Exec(ExecArgs),
    /// Show, change and test links of the running testbed
    Link {
        #[command(subcommand)]
        link: Link,
    },
    /// Measure a path of any network by STAMP (RFC 8762), or answer those who do
    Stamp {
        #[command(subcommand)]
        stamp: Stamp,
    },
    Bench(BenchArgs),
    /// Give packets of an interface of this machine delay, loss or a rate, by the kernel's NetEm
    ///
    /// For real links, of real robots and servers. It needs root, and a kernel with NetEm (`cotorra doctor` says whether
    /// this one has it); links between a testbed's nodes need neither: they are emulated by cotorra itself.
    Netem {
        #[command(subcommand)]
        netem: Netem,
    },
    /// Print a completion script for a shell
    #[command(after_long_help = "\
Examples:
  cotorra completions bash > ~/.local/share/bash-completion/completions/cotorra
  cotorra completions zsh > ~/.zfunc/_cotorra
  cotorra completions fish > ~/.config/fish/completions/cotorra.fish")]
    Completions {
        /// The shell.
        shell: Shell,
    },
    /// Run a bundled VNF; what a run starts inside nodes.
    #[command(hide = true)]
    Vnf {
        #[command(subcommand)]
        vnf: BundledVnf,
    },
    /// Run one end of a measurement; what a benchmark starts inside a peer.
    #[command(hide = true)]
    Probe {
        #[command(subcommand)]
        probe: Probe,
    },
}

/// Ends of measurements.
#[derive(Debug, Clone, Copy, Subcommand)]
pub enum Probe {
    /// Round trips to an echo, on top of twice the delay; prints median, 99th percentile and maximum in ns.
    RoundTrips {
        one_way_us: u64,
        count: usize,
        /// The far side, as rattan tells it.
        #[arg(long, env = "RATTAN_BASE")]
        to: IpAddr,
    },
    /// Sends over TCP until the other side has enough.
    Send {
        /// The far side, as rattan tells it.
        #[arg(long, env = "RATTAN_BASE")]
        to: IpAddr,
    },
}

/// VNFs that come with cotorra.
#[derive(Debug, Clone, Copy, Subcommand)]
pub enum BundledVnf {
    /// The brain: answers position packets with navigation packets.
    Navigation,
    /// Monte Carlo localization: answers scans with poses.
    Localization,
}

/// Bring a testbed up, run it, and report
///
/// Everything in the file comes to life: a network namespace for each host, links and radio with real packets
/// between them, a process for each VNF, the robots and the plug-ins. The run ends when every robot is at the end of
/// its walk, with --until, or with Ctrl-C, which loses nothing; a second Ctrl-C ends it at once.
///
/// It leaves a folder with summary.json, service_time.csv, service_time.svg, history.sqlite, the logs and the testbed
/// file as it was run.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra run testbeds/corridor.yaml
  cotorra run testbeds/corridor.yaml --until 60s --seed 7
  cotorra run testbeds/corridor.yaml --headless --out /tmp/runs
  cotorra run testbeds/corridor.yaml --simulate
  cotorra run testbeds/corridor.yaml --record corridor.mcap
  cotorra run testbeds/corridor.yaml --foxglove
  cotorra run testbeds/corridor.yaml --set plugin=okpi
  cotorra run testbeds/corridor.yaml --dry-run
  cotorra run abroad.yaml --after latest
  COTORRA_HISTORY_PASSWORD=secret cotorra run testbeds/corridor.yaml --history mysql://ana@db.lab/cotorra
  COTORRA_TOKEN=$(openssl rand -hex 16) cotorra run testbeds/corridor.yaml --api 0.0.0.0:7700

Exit status: 0 done, 1 error, 2 wrong usage, 3 done but the figures are not valid.")]
pub struct RunArgs {
    /// The testbed file.
    pub file: PathBuf,
    /// Run the file as if it said something else, as in plugin=okpi or links.*.delay_scale=2
    ///
    /// A path leads from key to key; * stands for any part of a name. See docs/testbed-file.md, "Variants". Can be
    /// given several times.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub settings: Vec<Setting>,
    /// End after so much time, such as 60s or 2min, if the walks take longer
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Seed of everything random, in place of the file's
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Folder in which the run gets a folder of its own
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub out: PathBuf,
    /// Keep the history elsewhere than in the run's folder: a SQLite file, or a database of MySQL or MariaDB
    ///
    /// Several runs can share one. A server is named as mysql://USER@HOST:PORT/DATABASE, and its password in the environment
    /// variable COTORRA_HISTORY_PASSWORD, where nobody else sees it.
    #[arg(long, value_name = "FILE|URL", env = HISTORY_VARIABLE, hide_env_values = true)]
    pub history: Option<Place>,
    /// Go on after a run that was broken off, as one that crashed: its folder, `latest`, or its number in --history
    ///
    /// For testbeds that federate on an Ethereum network, which knows how far each service is. What that run noted of its
    /// services is kept in the new run's history, each with how long before; what was noted is not noted again.
    #[arg(long, value_name = "RUN", conflicts_with = "simulate")]
    pub after: Option<String>,
    /// Write plain lines in place of the live view
    ///
    /// So it is by itself where standard error is no terminal.
    #[arg(long)]
    pub headless: bool,
    /// Address of the HTTP API
    ///
    /// Without it, 127.0.0.1:7700, or another port if that is taken. An address that others can reach needs a token
    /// of 16 characters or more in COTORRA_TOKEN.
    #[arg(long, value_name = "ADDR:PORT")]
    pub api: Option<SocketAddr>,
    /// Let the WLAN Access Information Service send notifications to a network, as in 10.1.0.0/16
    ///
    /// Beside this machine's loopback addresses and what the testbed file names. Can be given several times.
    #[arg(long, value_name = "NETWORK")]
    pub wais_callbacks: Vec<IpNetwork>,
    /// Run in virtual time: as fast as this machine can, and the same to the byte each time
    ///
    /// The same network, robots, VNFs and plug-ins, without namespaces or packets of the kernel's. For plug-ins that are
    /// programs of their own, time stands still while they answer, and the API is served. VNFs that are programs cannot
    /// take part.
    #[arg(long)]
    pub simulate: bool,
    /// Record the run as MCAP, for Foxglove, PlotJuggler and `ros2 bag`: in recording.mcap in the run's folder, or in FILE
    ///
    /// Poses, scans, transforms, the map, radio units, attachments, service times and all else as ROS 2 messages. What
    /// the disk cannot keep up with is dropped and counted; the run never waits.
    #[arg(long, value_name = "FILE.mcap", num_args = 0..=1, value_parser = parse_recording)]
    pub record: Option<Option<PathBuf>>,
    /// Serve the run live to Foxglove; by default on 127.0.0.1:8765
    ///
    /// Needs a cotorra that was built with `--features foxglove`. Whoever can reach the address can watch.
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, default_missing_value = FOXGLOVE, conflicts_with = "simulate")]
    pub foxglove: Option<SocketAddr>,
    /// Let idle cores fall asleep
    ///
    /// A run keeps up to four cores awake, at a priority that takes nothing from anyone else: a packet that has to wake a
    /// core comes some 0.1 ms later.
    #[arg(long, conflicts_with = "simulate")]
    pub save_power: bool,
    /// On interfaces that the testbed's links lead over, take the place of queueing disciplines that somebody put there; the
    /// end of the run puts them back
    #[arg(long)]
    pub replace: bool,
    /// Let a link lead over this interface though it is the loopback, or carries the default route
    ///
    /// Whoever reaches this machine over it shares the link's conditions, as long as the run goes on. Can be given several
    /// times.
    #[arg(long, value_name = "NAME")]
    pub allow_interface: Vec<String>,
    /// Only say what would be brought up, and done to interfaces of this machine
    #[arg(long)]
    pub dry_run: bool,
    /// Say more on standard error; twice for even more
    ///
    /// The log in the run's folder always has the first of the two; COTORRA_LOG filters both in more detail.
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// Run a testbed in virtual time for all combinations of some settings, each with many seeds
///
/// A setting's values are a list, as in plugin=probing,okpi, or a range, as in 1..4, 0..1:0.25 (in steps of 0.25) or
/// 5..20:5 ms. What a path is: docs/testbed-file.md, "Variants". As many runs go on at a time as there are CPUs.
///
/// Each run is kept as soon as it is done. The same command goes on where one was stopped, and one with more values or
/// seeds adds to it. It leaves runs.csv (a row a run), cells.csv (a row a combination: means and 95 % confidence
/// intervals), regions.csv (a row for each radio unit and server of a run) and sweep.svg.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra sweep testbeds/corridor.yaml --set plugin=probing,okpi --seeds 20
  cotorra sweep testbeds/corridor.yaml --set links.*.delay_scale=1..4 --set plugin=probing,okpi --seeds 100
  cotorra sweep testbeds/corridor.yaml --set plugin=okpi --set plugins.okpi.settings.gamma=2..20:2 --dry-run")]
pub struct SweepArgs {
    /// The testbed file.
    pub file: PathBuf,
    /// A setting and its values; can be given several times
    #[arg(long = "set", value_name = "PATH=VALUES")]
    pub axes: Vec<Axis>,
    /// Runs of each combination, each with a seed of its own, from the file's seed on
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// End each run after so much time, such as 60s or 2min, if the walks take longer
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Runs at a time; as many as there are CPUs if it is left out
    #[arg(short, long, value_name = "N")]
    pub jobs: Option<NonZero<usize>>,
    /// The sweep's folder, in place of one under sweeps/ that is named after what is swept
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Forget the runs that the folder has
    #[arg(long)]
    pub fresh: bool,
    /// Write plain lines in place of the progress bar
    #[arg(long)]
    pub headless: bool,
    /// Only say what would be run
    #[arg(long)]
    pub dry_run: bool,
}

/// Published experiments.
#[derive(Debug, Subcommand)]
pub enum Experiment {
    Okpi(OkpiArgs),
    Federation(FederationArgs),
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
    /// Run the file as if it said something else, as in links.*.delay_scale=2; see cotorra run --help
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub settings: Vec<Setting>,
    /// Seed of everything random, in place of the file's
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// End each walk after so much time, such as 60s or 2min
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Folder in which the experiment gets a folder of its own
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub out: PathBuf,
    /// Keep the history elsewhere than in the run's folder: a SQLite file, or a database of MySQL or MariaDB
    ///
    /// Several runs can share one. A server is named as mysql://USER@HOST:PORT/DATABASE, and its password in the environment
    /// variable COTORRA_HISTORY_PASSWORD, where nobody else sees it.
    #[arg(long, value_name = "FILE|URL", env = HISTORY_VARIABLE, hide_env_values = true)]
    pub history: Option<Place>,
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
  cotorra experiment federation --emulate --block-period 1  with real packets and an anvil node, some three minutes a run
  COTORRA_LEDGER_PASSWORD=… cotorra experiment federation --emulate --ledger wss://node.example --keys keys \\
      --ledger domain-2=ws://127.0.0.1:8546                 on a network that is there already: domain 2 by a node of its own
  scripts/ledger-network --block-period 1 -- cotorra experiment federation --emulate
                                                            on a network of this machine with consensus

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
    /// Run the file as if it said something else, as in links.*.delay_scale=2; see cotorra run --help
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub settings: Vec<Setting>,
    /// Seed of the first run, in place of the file's; each other has the next
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// End each run after so much time, such as 60s or 2min [default: twice what the walk takes, and a minute]
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Folder in which the experiment gets a folder of its own
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub out: PathBuf,
    /// Write plain lines in place of the live view
    #[arg(long)]
    pub headless: bool,
    /// Let idle cores fall asleep
    #[arg(long, requires = "emulate")]
    pub save_power: bool,
    /// Only say what would be run
    #[arg(long)]
    pub dry_run: bool,
    /// Say more on standard error; twice for even more
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,
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
    /// What the network is, for the figure and the table, as in "a network of 4 validators"
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

/// Play a recorded run through the HTTP API, so that a plug-in can be developed against it
///
/// What is known, what was up to then and what happens are as in the run; nothing of what is to come is told.
/// Instructions are refused, because nothing can change what was, and printed: a line of JSON each, as the decisions that
/// the plug-in would have made.
///
/// With --speed max the replay begins when a plug-in follows the stream of events under a name (X-Cotorra-Plugin), and
/// waits for it as virtual time does: it sees the same events each time, and none too many or too few.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra replay latest
  cotorra replay latest --speed 10x --from 1min --to 2min
  cotorra replay latest --foxglove
  cotorra replay latest --speed max > decisions.jsonl &
  COTORRA_PLUGIN=mine python3 examples/strongest_signal.py")]
pub struct ReplayArgs {
    /// The folder of a run, `latest`, or the number of a run in the history that --history names
    pub run: String,
    /// So many seconds of the run in one, as in 1x or 2.5x; or max
    #[arg(long, value_name = "SPEED", default_value = "1x", value_parser = parse_speed)]
    pub speed: Speed,
    /// With --speed max: begin when so many follow the stream of events, each under a name
    #[arg(long, value_name = "N", default_value = "1")]
    pub plugins: NonZero<usize>,
    #[command(flatten)]
    pub span: Span,
    /// Address of the HTTP API, as of `cotorra run`
    #[arg(long, value_name = "ADDR:PORT")]
    pub api: Option<SocketAddr>,
    /// Serve what is played to Foxglove, too, as of `cotorra run`
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, default_missing_value = FOXGLOVE)]
    pub foxglove: Option<SocketAddr>,
    /// Folder from which the testbed file's own paths lead, such as its map's
    #[arg(long, value_name = "DIR", default_value = "testbeds")]
    pub base: PathBuf,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// How fast a run is played.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Speed {
    Times(f64),
    Max,
}

fn parse_speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed::Max);
    }
    let times = text.strip_suffix('x').and_then(|times| times.parse::<f64>().ok());
    let times = times.filter(|times| (1e-3..=1e6).contains(times));
    times.map(Speed::Times).ok_or_else(|| "write it like 1x, 2.5x or max".to_owned())
}

const HISTORY_EXAMPLES: &str = "\
Examples:
  cotorra history runs
  cotorra history state latest --at 12.5s
  cotorra history series latest service
  cotorra history series latest R1~lan --figure delay --from 1min --to 2min
  cotorra history series latest robot --figure x --csv > x.csv
  cotorra history events latest --kinds handover,decision
  cotorra history diff runs/corridor-20260101-120000 latest
  cotorra history export latest --format parquet --out exported
  cotorra history prune latest --raw 1h
  COTORRA_HISTORY_PASSWORD=secret cotorra history events 7 --history mysql://ana@db.lab/cotorra";

/// What a history can be asked.
#[derive(Debug, Subcommand)]
pub enum History {
    /// List runs: those that left folders, or those of a history that several share
    Runs(HistoryRunsArgs),
    /// Show the whole graph at a time: of everything the last that was known
    State(StateArgs),
    Series(SeriesArgs),
    /// List what happened
    Events(EventsArgs),
    /// Set two runs side by side: service times, links, handovers, placements, decisions
    Diff(DiffArgs),
    /// List where events were lost
    Gaps(GapsArgs),
    Export(ExportArgs),
    Import(ImportArgs),
    Prune(PruneArgs),
}

/// Roll old samples up to points, one for each step of time, and drop what is older still
///
/// Of samples that are older than --raw there is left, for each robot, radio unit and direction of a link and each step,
/// the last sample, and the count, least, greatest and mean of all. Everything that happened otherwise is kept. It says what
/// it would do, and does it with --yes. Without --raw it keeps to what the run's testbed file says under history.retention.
///
/// Age counts to now; in virtual time, to the run's end. It can be stopped at any time, and goes on where it was; runs may
/// go on meanwhile.
#[derive(Debug, Args)]
#[command(
    after_long_help = "\
Examples:
  cotorra history prune latest
  cotorra history prune latest --raw 1h
  cotorra history prune latest --raw 1h --step 10s --kinds link --yes
  cotorra history prune all --history runs/all.sqlite --raw 24h --keep 720h --yes",
    visible_alias = "roll-up"
)]
pub struct PruneArgs {
    /// The run, or `all` of the history that --history names
    pub run: String,
    /// Keep samples so long as they were recorded, such as 90s, 10min or 24h
    #[arg(long, value_name = "DURATION", value_parser = parse_time)]
    pub raw: Option<Duration>,
    /// Then one point for each step of time, which divides a minute
    #[arg(long, value_name = "DURATION", value_parser = parse_step, default_value = "1s", requires = "raw")]
    pub step: Duration,
    /// Drop points that are older
    #[arg(long, value_name = "DURATION", value_parser = parse_time, requires = "raw")]
    pub keep: Option<Duration>,
    /// Of these kinds only: robot, radio, link
    #[arg(long, value_name = "KINDS", value_delimiter = ',', value_parser = ["robot", "radio", "link"])]
    pub kinds: Vec<String>,
    /// Do it
    #[arg(long)]
    pub yes: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Write a run as tables that other programs read, or as MCAP
///
/// One table for each kind of events, in a new folder: csv, parquet, or arrow (Arrow IPC, also known as Feather). Columns
/// are named with their units, as in the history; `n` is an event's place in the run.
///
/// mcap is one file, as `cotorra run --record` writes it, but without scans, which no history keeps.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra history export latest --out exported
  cotorra history export latest --format parquet --out exported
  cotorra history export latest --format mcap --out run.mcap
  cotorra history export 7 --history runs/all.sqlite --format arrow --out exported")]
pub struct ExportArgs {
    /// The run
    pub run: String,
    /// csv, parquet, arrow or mcap
    #[arg(long, default_value = "csv", value_parser = parse_export)]
    pub format: ExportFormat,
    /// The new folder; of mcap, the new file
    #[arg(long, value_name = "DIR|FILE")]
    pub out: PathBuf,
    /// With mcap: folder from which the testbed file's own paths lead, such as its map's
    #[arg(long, value_name = "DIR", default_value = "testbeds")]
    pub base: PathBuf,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// What a run is exported as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportFormat {
    Tables(Format),
    Mcap,
}

fn parse_export(name: &str) -> Result<ExportFormat, String> {
    match name {
        "mcap" => Ok(ExportFormat::Mcap),
        name => name
            .parse()
            .map(ExportFormat::Tables)
            .map_err(|_| "formats are csv, parquet, arrow and mcap".to_owned()),
    }
}

/// Keep a run that was exported as a new run of a history
///
/// The history is the one that --history or COTORRA_HISTORY names; a file is made if it is not there.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra history import exported --history runs/all.sqlite")]
pub struct ImportArgs {
    /// The folder of the export
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Where runs are looked for.
#[derive(Debug, Args)]
pub struct HistoryPlace {
    /// The history that runs are numbered in: a SQLite file, or mysql://USER@HOST:PORT/DATABASE
    ///
    /// Its password is in the environment variable COTORRA_HISTORY_PASSWORD, where nobody else sees it.
    #[arg(long, value_name = "FILE|URL", env = HISTORY_VARIABLE, hide_env_values = true)]
    pub history: Option<Place>,
    /// Folder with the folders of runs
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
}

/// A part of a run.
#[derive(Debug, Args)]
pub struct Span {
    /// From this time of the run on, such as 90s or 1.5min
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    pub from: Option<Duration>,
    /// Up to this time of the run, this excluded
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    pub to: Option<Duration>,
}

/// A part of an answer.
#[derive(Debug, Args)]
pub struct PageArgs {
    /// No more than so many; at most 10000
    #[arg(long, value_name = "N", default_value = "100")]
    pub limit: NonZero<usize>,
    /// Go on where the answer before ended, as it said
    #[arg(long, value_name = "CURSOR")]
    pub after: Option<Cursor>,
}

#[derive(Debug, Args)]
pub struct HistoryRunsArgs {
    #[command(flatten)]
    pub place: HistoryPlace,
    /// No more than so many; at most 9999
    #[arg(long, value_name = "N", default_value = "50")]
    pub limit: NonZero<usize>,
    /// In a history that several share: those after this one
    #[arg(long, value_name = "NUMBER")]
    pub after: Option<RunId>,
}

#[derive(Debug, Args)]
pub struct StateArgs {
    /// The run
    pub run: String,
    /// When, such as 12.5s; the end of the run if it is left out
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    pub at: Option<Duration>,
    /// Write JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Show a figure over time
///
/// Each point says what the samples of its stretch of time were; the picture shows their range. `!` marks where events
/// were lost.
///
/// Figures are delay (ms), throughput (bit/s), delay_scale and drop_scale of a link; x, y (m), heading (rad), speed
/// (m/s), turn (rad/s) and obstacle (m) of a robot; load of a radio unit; service_time and handover_gap (ms),
/// lateness_p50, lateness_p99 and lateness_max (µs) of `service`, and signal of ROBOT:RADIO_UNIT (dBm).
#[derive(Debug, Args)]
pub struct SeriesArgs {
    /// The run
    pub run: String,
    /// A link, LINK:backward, a robot, ROBOT:RADIO_UNIT, a radio unit, or `service`
    #[arg(value_name = "OF")]
    pub of: String,
    /// Which figure; if it is left out, a link's delay, a robot's speed, a radio unit's load, or service_time
    #[arg(long, value_name = "FIGURE")]
    pub figure: Option<String>,
    #[command(flatten)]
    pub span: Span,
    /// In so many points at most; 1000 with --csv, else as many as the terminal is wide
    #[arg(long, value_name = "N")]
    pub points: Option<NonZero<usize>>,
    /// Write a table, values separated by commas
    #[arg(long)]
    pub csv: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

#[derive(Debug, Args)]
pub struct EventsArgs {
    /// The run
    pub run: String,
    /// Kinds of events, with commas between; all if it is left out
    #[arg(long, value_name = "KINDS", value_delimiter = ',')]
    pub kinds: Vec<Kind>,
    #[command(flatten)]
    pub span: Span,
    #[command(flatten)]
    pub page: PageArgs,
    /// Write JSON, a line an event
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

#[derive(Debug, Args)]
pub struct DiffArgs {
    /// The two runs
    #[arg(value_name = "RUN", num_args = 2, required = true)]
    pub pair: Vec<String>,
    /// Write JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

#[derive(Debug, Args)]
pub struct GapsArgs {
    /// The run
    pub run: String,
    #[command(flatten)]
    pub span: Span,
    #[command(flatten)]
    pub page: PageArgs,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Find where a robot was, from a recorded log and a map
///
/// Monte Carlo localization, as it runs in a testbed, on a log of CARMEN (ROBOTLASER1 or FLASER), the format of most
/// public lidar data sets. Odometry is taken from the laser messages. The trajectory is written as a table: time, pose,
/// covariance, how many particles there were, and whether the scan was used.
///
/// Given a reference, it says how far off the trajectory is. A reference is a corrected log, or lines of
/// `time,x,y,heading` or in the TUM format.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra localize --map intel.yaml --log intel.log > trajectory.csv
  cotorra localize --map intel.yaml --log intel.log --reference intel.corrected.log --out trajectory.csv
  cotorra localize --map intel.yaml --log intel.log --reference intel.corrected.log --mode amcl --seed 7
  cotorra localize --map intel.yaml --log intel.log --global

Exit status: 0 done, 1 error, 2 wrong usage, 130 stopped with Ctrl-C; what was found until then is written.")]
pub struct LocalizeArgs {
    /// The map: a YAML file of map_server
    #[arg(long, value_name = "MAP.yaml")]
    pub map: PathBuf,
    /// The log
    #[arg(long, value_name = "LOG")]
    pub log: PathBuf,
    /// Where the robot really was
    #[arg(long, value_name = "FILE")]
    pub reference: Option<PathBuf>,
    /// How particles are weighed
    #[arg(long, value_enum, default_value = "likelihood")]
    pub mode: LocalizeMode,
    /// Where the robot is at the first scan, metres and degrees; if it is left out, where the reference or else the
    /// log's odometry says
    #[arg(long, value_name = "X,Y,HEADING", value_parser = parse_start, allow_hyphen_values = true, conflicts_with = "global")]
    pub start: Option<[f64; 3]>,
    /// Nothing is known of where it is
    #[arg(long)]
    pub global: bool,
    /// The laser's reach, in place of what the log says or else 80: farther readings hit nothing
    #[arg(long, value_name = "METRES")]
    pub max_range: Option<f64>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Write the trajectory there in place of standard output
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Show no progress bar
    #[arg(long)]
    pub headless: bool,
}

/// How particles are weighed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LocalizeMode {
    /// By the likelihood of what the lidar saw
    Likelihood,
    /// As ROS AMCL does, with its defaults
    Amcl,
}

/// Check testbed files
///
/// Says everything that is wrong with each, in its place, with what would be right; or, where nothing is, what the
/// testbed holds.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra check testbeds/*.yaml

Exit status: 0 if all are right, 1 if one is not.")]
pub struct CheckArgs {
    /// The testbed files.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
}

/// Remove what killed runs left behind
///
/// Namespaces, their interfaces and processes go with their run, however it ends. When a run is killed with SIGKILL, control
/// groups do not, nor do conditions of this machine's own interfaces; the next run removes them, or this.
#[derive(Debug, Args)]
pub struct CleanArgs {
    /// Only say what would be removed
    #[arg(short = 'n', long)]
    pub dry_run: bool,
}

/// Run a program inside a node of the running testbed
///
/// The program sees the node's network and nothing else changes: same files, same user, same terminal. Nodes have
/// their names.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra exec robot -- ping -c 3 cloud
  cotorra exec edge -- iperf3 -s
  cotorra exec robot -- bash

Exit status: the program's.")]
pub struct ExecArgs {
    /// The node.
    pub node: NodeId,
    /// The program and its arguments.
    #[arg(required = true, last = true, value_name = "COMMAND")]
    pub command: Vec<String>,
    /// Address of the run's API, as its terminal shows it
    #[arg(long, value_name = "ADDR:PORT", default_value = DEFAULT_API)]
    pub api: SocketAddr,
}

/// Measure what the emulated network does on this machine
///
/// Prints median and tail of each figure. Peers are measured beside it where they are installed: rattan (from PATH or
/// --rattan) and Mininet (`mn`).
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Which benchmarks; all if none is named
    #[arg(value_name = "NAME")]
    pub names: Vec<String>,
    /// List the benchmarks
    #[arg(long, conflicts_with = "names")]
    pub list: bool,
    /// The program rattan, to be measured beside
    #[arg(long, value_name = "PATH", default_value = "rattan")]
    pub rattan: PathBuf,
}

/// Reads the name of a recording. Without the ending, the testbed file behind --record would be overlooked.
fn parse_recording(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    let is_mcap = path.extension().is_some_and(|extension| extension == "mcap");
    is_mcap
        .then_some(path)
        .ok_or_else(|| "the recording's name ends with .mcap; a testbed file goes before --record".to_owned())
}

/// Reads `60s`, `1.5min`, `500 ms`. A bare number is an error, because seconds and milliseconds look alike.
pub fn parse_duration(text: &str) -> Result<Duration, String> {
    let duration = parse_time(text)?;
    if duration.is_zero() { Err("it must be above zero".to_owned()) } else { Ok(duration) }
}

fn parse_step(text: &str) -> Result<Duration, String> {
    let step = parse_time(text)?;
    if cotorra_graph::Retention::is_step(step) {
        Ok(step)
    } else {
        Err("a minute must be a multiple of it, as of 100ms, 1s, 10s or 1min".to_owned())
    }
}

/// The same; zero is a time, too.
fn parse_time(text: &str) -> Result<Duration, String> {
    const UNITS: [(&str, f64); 4] = [("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("h", 3600.0)];
    let text = text.trim();
    let (figure, unit) = text.split_at(text.find(|c: char| c.is_alphabetic()).unwrap_or(text.len()));
    let figure = figure.trim_end();
    let number: f64 = figure.parse().map_err(|_| "write it like 60s or 2min".to_owned())?;
    let Some((_, seconds)) = UNITS.into_iter().find(|(name, _)| *name == unit) else {
        return Err(match unit {
            "" => format!("it has no unit: write {figure}s or {figure}min"),
            "m" => format!("`m` could be minutes or metres: write {figure}min"),
            _ => "the units are ms, s, min and h".to_owned(),
        });
    };
    if number < 0.0 {
        return Err("it must not be below zero".to_owned());
    }
    Duration::try_from_secs_f64(number * seconds).map_err(|_| "it is too long".to_owned())
}

/// Reads `1.5,-2,90`; the heading comes back in radians.
fn parse_start(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text.split(',').map_while(|part| part.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y, degrees] if [x, y, degrees].iter().all(|number| number.is_finite()) => {
            Ok([x, y, degrees.to_radians()])
        }
        _ => Err("write x, y and heading, such as 1.5,-2,90".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn durations_need_their_unit() {
        assert_eq!(parse_duration("60s"), Ok(Duration::from_secs(60)));
        assert_eq!(parse_duration("1.5 min"), Ok(Duration::from_secs(90)));
        assert_eq!(parse_duration("250ms"), Ok(Duration::from_millis(250)));
        assert_eq!(parse_duration("60"), Err("it has no unit: write 60s or 60min".to_owned()));
        for wrong in ["", "s", "-1s", "0s", "1 day", "5m", "1e400s", "1e300h", "nans", "infs"] {
            assert!(parse_duration(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_start("1.5, -2,0"), Ok([1.5, -2.0, 0.0]));
        for wrong in ["", "1,2", "1,2,3,4", "1,2,nan", "a,b,c"] {
            assert!(parse_start(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_time("0s"), Ok(Duration::ZERO));
        assert_eq!(parse_speed("2.5x"), Ok(Speed::Times(2.5)));
        for wrong in ["2", "0x", "-1x", "nanx", "infx", "fast"] {
            assert!(parse_speed(wrong).is_err(), "{wrong}");
        }
    }
}
