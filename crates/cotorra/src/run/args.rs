//! Arguments of `cotorra run`.

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use clap::Args;
use cotorra_graph::IpNetwork;
use cotorra_testbed::{CapturePlan, Encryption, HistoryLimit, Speed};
use cotorra_testbed_file::Setting;

use crate::{
    approval::TrustArgs,
    arguments::{AccessArgs, AgentArgs, parse_address, parse_seed},
    duration::parse_duration,
    figures::FigureArgs,
    history::{HISTORY_VARIABLE, Place},
    quantity::parse_size,
    speed::parse_speed,
};

/// Default address of a viewer's connection in Foxglove.
pub const FOXGLOVE: &str = "127.0.0.1:8765";

/// Default address of a run's API. If it is taken, the run uses another port.
pub const DEFAULT_API: &str = "127.0.0.1:7700";

/// Bring a testbed up, run it, and report
///
/// Starts everything in the file: a network namespace for each host, links and radio with real packets between them, a
/// process for each VNF, the robots and the plug-ins. The run ends when every robot has finished its walk, after --until,
/// or with Ctrl-C, which loses nothing. A second Ctrl-C ends it at once.
///
/// It leaves a folder with summary.json, services.csv and services.tex (a row for each robot and service),
/// service_time.csv, service_time.svg, history.sqlite, the logs, the testbed file with its settings and all that it names, and
/// manifest.json, from which `cotorra reproduce` runs it again.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra run testbeds/corridor.yaml
  cotorra run testbeds/corridor.yaml --open
  cotorra run testbeds/corridor.yaml --until 60s --seed 7
  cotorra run testbeds/corridor.yaml --headless --out /tmp/runs
  cotorra run testbeds/corridor.yaml --simulate
  cotorra run testbeds/corridor.yaml --simulate --speed 5x --open
  cotorra run testbeds/corridor.yaml --simulate --set plugin=okpi --set \"plugins.okpi.control_delay=1 s\" --twin
  cotorra run testbeds/corridor.yaml --simulate --capture lan-cloud=cloud.pcapng
  cotorra run testbeds/corridor.yaml --record corridor.mcap
  cotorra run testbeds/corridor.yaml --foxglove
  cotorra run testbeds/corridor.yaml --figure pdf
  cotorra run testbeds/corridor.yaml --set plugin=okpi
  cotorra run testbeds/corridor.yaml --dry-run
  cotorra run abroad.yaml --after latest
  COTORRA_HISTORY_PASSWORD=secret cotorra run testbeds/corridor.yaml --history mysql://ana@db.lab/cotorra
  COTORRA_TOKEN=$(openssl rand -hex 16) cotorra run testbeds/corridor.yaml --api 0.0.0.0:7700     HTTPS for other machines

Exit status: 0 done, 1 error or incomplete record, 2 wrong usage, 3 done but the figures are not valid, 4 done and valid but
a service kept its target less often than the testbed file demands, 5 ended because no robot made progress.")]
pub struct RunArgs {
    /// The testbed file
    pub file: PathBuf,
    /// Override a value of the file, as in plugin=okpi or links.*.delay_scale=2
    ///
    /// A path leads from key to key; * matches any part of a name. See docs/reference/testbed-file.md, "Variants". Can be
    /// given several times.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub settings: Vec<Setting>,
    /// End after this time, such as 60s or 2min, if the walks take longer
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Seed of everything random; default: the file's
    #[arg(long, value_name = "N", value_parser = parse_seed)]
    pub seed: Option<u64>,
    /// Folder in which the run creates its own folder
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub out: PathBuf,
    /// Keep the history in a SQLite file or a MySQL or MariaDB database, instead of the run's folder
    ///
    /// Several runs can share one history. A server is named as mysql://USER@HOST:PORT/DATABASE. Set its password in the
    /// environment variable COTORRA_HISTORY_PASSWORD, where nobody else sees it. A server needs a cotorra that was built
    /// with `--features databases`.
    #[arg(long, value_name = "FILE|URL", env = HISTORY_VARIABLE, hide_env_values = true)]
    pub history: Option<Place>,
    /// End the run in order when its history has grown by this, as in 2GB; a history on a server has no such limit
    #[arg(long, value_name = "SIZE", default_value_t, value_parser = parse_history_limit)]
    pub history_limit: HistoryLimit,
    /// Continue after a run of the same testbed, such as one that was killed: its folder, `latest`, or its number in
    /// --history
    ///
    /// Robots start where the earlier run's history last saw them, and walk on from there. If the testbed federates on an
    /// Ethereum network, which holds the state of each service, the steps that the earlier run noted are copied into the
    /// new run's history, each with its age, and are not noted again.
    #[arg(long, value_name = "RUN")]
    pub after: Option<String>,
    /// Write plain lines instead of the live view
    ///
    /// This is the default if standard error is not a terminal.
    #[arg(long)]
    pub headless: bool,
    /// Open the dashboard in the browser (by xdg-open)
    #[arg(long)]
    pub open: bool,
    /// Address of the HTTP API and the dashboard
    ///
    /// The default is 127.0.0.1:7700, or another port if that is taken. Your tools, such as `cotorra exec`, find the run by
    /// themselves, and `cotorra open` opens its dashboard. An address that others can reach needs a token of 16 characters or
    /// more in COTORRA_TOKEN, and is served with TLS; the run prints the certificate that clients need. On loopback it stays
    /// without TLS.
    #[arg(long, value_name = "ADDR:PORT", value_parser = parse_address)]
    pub api: Option<SocketAddr>,
    #[command(flatten)]
    pub access: AccessArgs,
    #[command(flatten)]
    pub trust: TrustArgs,
    /// Let the WLAN Access Information Service send notifications to a network, as in 10.1.0.0/16
    ///
    /// This adds to the networks that the testbed file names, and to loopback for the operator's own service. Can be given
    /// several times.
    #[arg(long, value_name = "NETWORK")]
    pub wais_callbacks: Vec<IpNetwork>,
    /// Run in virtual time: as fast as this machine can, with identical results each time
    ///
    /// Network, robots, VNFs and plug-ins are the same, but without namespaces and without packets in the kernel. If a
    /// plug-in is a separate program, the API is served, and time stands still while the plug-in answers. VNFs that are
    /// separate programs cannot take part.
    #[arg(long)]
    pub simulate: bool,
    /// Run the twin, too: the same run with a plug-in beside the core, to say what its distance cost
    ///
    /// Each plug-in with a `control_delay`, a `node` or a time of decisions has a twin, in twins/ in the run's folder. The
    /// difference by service is in the terminal and in summary.json, as `staleness_regret`. It takes as long again.
    #[arg(long, requires = "simulate", conflicts_with_all = ["speed", "open", "after"])]
    pub twin: bool,
    /// Serve virtual time to the dashboard and the API at a speed, as in 1x, 2.5x or max; with --open, the default is 1x
    ///
    /// The dashboard can stop time, take it on by steps, and change its speed. The results are the same, unless somebody
    /// gives instructions.
    #[arg(long, value_name = "SPEED", requires = "simulate", value_parser = parse_speed)]
    pub speed: Option<Speed>,
    /// Capture the packets that cross a link, or the links of a node, into a new pcapng file, as in lan-cloud=cloud.pcapng
    ///
    /// Wireshark opens it. `cotorra capture` does the same with a run in real time. Can be given several times.
    #[arg(long = "capture", value_name = "LINK|NODE=FILE", requires = "simulate")]
    pub captures: Vec<CapturePlan>,
    /// Record the run as MCAP, for Foxglove, PlotJuggler and `ros2 bag`: in recording.mcap in the run's folder, or in FILE
    ///
    /// The recording has poses, scans, transforms, the map, radio units, attachments, service times and everything else as
    /// ROS 2 messages. If the disk is too slow, messages are dropped and counted; the run never waits.
    #[arg(long, value_name = "FILE.mcap", num_args = 0..=1, value_parser = parse_recording)]
    pub record: Option<Option<PathBuf>>,
    #[command(flatten)]
    pub figure: FigureArgs,
    /// Serve the run live to Foxglove; by default on 127.0.0.1:8765
    ///
    /// Needs a cotorra that was built with `--features foxglove`. Whoever can reach the address can watch.
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, default_missing_value = FOXGLOVE, conflicts_with = "simulate",
        value_parser = parse_address)]
    pub foxglove: Option<SocketAddr>,
    /// Let idle cores fall asleep
    ///
    /// By default, a run keeps up to four cores awake, at idle priority, because a packet that has to wake a core arrives
    /// some 0.1 ms late.
    #[arg(long, conflicts_with = "simulate")]
    pub save_power: bool,
    /// Replace existing queueing disciplines on interfaces of the testbed's links; the end of the run restores them
    #[arg(long)]
    pub replace: bool,
    /// Allow a link over this interface even if it is the loopback, or carries the default route; or a gateway on one with
    /// the default route
    ///
    /// All other traffic of the interface then has the link's conditions, too, until the run ends. A gateway leaves other
    /// traffic as it is. Can be given several times.
    #[arg(long, value_name = "NAME")]
    pub allow_interface: Vec<String>,
    #[command(flatten)]
    pub agents: AgentArgs,
    /// Only list what would be started, and what would be changed on interfaces of this machine
    #[arg(long)]
    pub dry_run: bool,
    /// Log more on standard error; give it twice for even more
    ///
    /// The log in the run's folder is always more detailed than standard error. COTORRA_LOG filters both.
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

impl RunArgs {
    /// Returns what protects the API on the network.
    pub fn encryption(&self) -> Encryption {
        self.access.encryption(self.agents.authority.clone())
    }

    /// Returns the speed of virtual time if somebody watches it.
    pub fn watched(&self) -> Option<Speed> {
        self.speed.or(self.open.then_some(Speed::Times(1.0)))
    }
}

/// Parses the largest size of a history.
fn parse_history_limit(text: &str) -> Result<HistoryLimit, String> {
    parse_size(text).map(HistoryLimit::of_bytes)
}

/// Parses the name of a recording.
///
/// The ending is required because a testbed file after --record would otherwise be taken for the recording.
fn parse_recording(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    let is_mcap = path.extension().is_some_and(|extension| extension == "mcap");
    is_mcap.then_some(path).ok_or_else(|| {
        "the recording's name must end with .mcap; put the testbed file before --record".to_owned()
    })
}
