//! What can be typed behind `cotorra run`.

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use clap::Args;
use cotorra_graph::IpNetwork;
use cotorra_testbed_file::Setting;

use crate::{
    duration::parse_duration,
    history::{HISTORY_VARIABLE, Place},
};

/// Where Foxglove looks by itself.
pub const FOXGLOVE: &str = "127.0.0.1:8765";

/// Where a run serves its API unless that is taken.
pub const DEFAULT_API: &str = "127.0.0.1:7700";

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

Exit status: 0 done, 1 error or not all could be recorded, 2 wrong usage, 3 done but the figures are not valid.")]
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
    /// variable COTORRA_HISTORY_PASSWORD, where nobody else sees it. Needs a cotorra that was built with `--features mariadb`.
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
    /// of 16 characters or more in COTORRA_TOKEN. Tools of the same user, as `cotorra exec`, find the run by themselves.
    #[arg(long, value_name = "ADDR:PORT")]
    pub api: Option<SocketAddr>,
    /// Let the WLAN Access Information Service send notifications to a network, as in 10.1.0.0/16
    ///
    /// Beside what the testbed file names, and loopback for the operator's own service. Can be given several times.
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

/// Reads the name of a recording. Without the ending, the testbed file behind --record would be overlooked.
fn parse_recording(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    let is_mcap = path.extension().is_some_and(|extension| extension == "mcap");
    is_mcap
        .then_some(path)
        .ok_or_else(|| "the recording's name ends with .mcap; a testbed file goes before --record".to_owned())
}
