//! Arguments of `cotorra history`.

use std::{num::NonZero, ops::Bound, path::PathBuf, time::Duration};

use clap::{Args, Subcommand};
use cotorra_graph::{NodeId, SensorId, Timestamp};
use cotorra_measurements::{Cursor, Kind, RunId, export::Format};

use super::place::{HISTORY_VARIABLE, Place};
use crate::{
    duration::{parse_step, parse_time},
    figures::parse_figure_file,
};

/// Examples in the help of the whole command.
pub const EXAMPLES: &str = "\
Examples:
  cotorra history runs
  cotorra history state latest --at 12.5s
  cotorra history series latest service
  cotorra history series latest robot --figure service_time
  cotorra history series latest R1-cloud --figure delay --from 1min --to 2min
  cotorra history series latest R1-cloud --figure time_part
  cotorra history series latest robot --figure x --csv > x.csv
  cotorra history series latest R1-cloud --figure delay -o delay.pdf
  cotorra history events latest --kinds handover,decision
  cotorra history diff runs/corridor-20260101-120000 latest
  cotorra history regret latest runs/corridor-20260101-120000
  cotorra history data latest robot camera -o image.raw
  cotorra history export latest --format parquet --out exported
  cotorra history prune latest --raw 1h
  COTORRA_HISTORY_PASSWORD=secret cotorra history events 7 --history mysql://ana@db.lab/cotorra";

#[derive(Debug, Subcommand)]
pub enum History {
    /// List runs: those in folders, or those of a shared history
    Runs(HistoryRunsArgs),
    /// Show the state of the whole graph at a time
    State(StateArgs),
    Series(SeriesArgs),
    /// List events
    Events(EventsArgs),
    /// Compare two runs: service times, links, handovers, placements, decisions
    Diff(DiffArgs),
    Regret(RegretArgs),
    Data(DataArgs),
    Gaps(GapsArgs),
    Export(ExportArgs),
    Import(ImportArgs),
    Prune(PruneArgs),
}

/// Roll old samples up to one point for each step of time, and drop still older points
///
/// Samples older than --raw are replaced by one point for each step, and for each robot, radio unit, direction of a link
/// and sensor. A point has the last sample, and the count, minimum, maximum and mean of all samples of its step. All other
/// events are kept. Without --yes, the command only reports what it would do. Without --raw, it follows history.retention
/// in the run's testbed file.
///
/// Age is counted from now, or in virtual time from the run's end. The command can be stopped at any time, and resumes
/// where it was. Runs can go on at the same time.
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
    /// The run, or `all` for every run of the history that --history names
    pub run: String,
    /// Age up to which samples are kept as they were recorded, such as 90s, 10min or 24h
    #[arg(long, value_name = "DURATION", value_parser = parse_time)]
    pub raw: Option<Duration>,
    /// Step of the points that replace older samples; it must divide a minute
    #[arg(long, value_name = "DURATION", value_parser = parse_step, default_value = "1s", requires = "raw")]
    pub step: Duration,
    /// Age from which points are dropped
    #[arg(long, value_name = "DURATION", value_parser = parse_time, requires = "raw")]
    pub keep: Option<Duration>,
    /// Only these kinds: robot, radio, link, sensor, machine
    #[arg(long, value_name = "KINDS", value_delimiter = ',', value_parser = ["robot", "radio", "link", "sensor", "machine"])]
    pub kinds: Vec<String>,
    /// Apply the changes instead of only reporting them
    #[arg(long)]
    pub yes: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Export a run as tables for other programs, or as MCAP
///
/// Tables are written to a new folder, one for each kind of event, as csv, parquet, or arrow (Arrow IPC, also known as
/// Feather). Column names include units, as in the history; `n` is an event's position in the run. Names stand in place of
/// ids and codes, such as `forward` for a direction.
///
/// mcap is one file, like that of `cotorra run --record` but without scans, which histories do not keep.
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
    /// The new folder, or with mcap the new file
    #[arg(long, value_name = "DIR|FILE")]
    pub out: PathBuf,
    /// With mcap: folder that relative paths in the testbed file start from, such as that of its map; default: the run's
    /// folder, or testbeds if RUN is a number
    #[arg(long, value_name = "DIR")]
    pub base: Option<PathBuf>,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Format of an export.
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

/// Import an exported run into a history, as a new run
///
/// The history is the one that --history or COTORRA_HISTORY names. If it is a file that does not exist, it is created.
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

/// Location of runs.
#[derive(Debug, Args)]
pub struct HistoryPlace {
    /// History in which runs have numbers: a SQLite file, or mysql://USER@HOST:PORT/DATABASE
    ///
    /// Set the password of a server in the environment variable COTORRA_HISTORY_PASSWORD, where nobody else sees it. A
    /// server needs a cotorra that was built with `--features databases`.
    #[arg(long, value_name = "FILE|URL", env = HISTORY_VARIABLE, hide_env_values = true)]
    pub history: Option<Place>,
    /// Folder with the folders of runs
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
}

/// Time range of a run.
#[derive(Debug, Args)]
pub struct Span {
    /// Start in time of the run, such as 90s or 1.5min
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    pub from: Option<Duration>,
    /// End in time of the run, exclusive
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    pub to: Option<Duration>,
}

impl Span {
    /// Returns the times of the run between the two ends.
    pub fn range(&self) -> (Bound<Timestamp>, Bound<Timestamp>) {
        let at = |after_start| Timestamp::ZERO + after_start;
        let end = self.to.map_or(Bound::Unbounded, |to| Bound::Excluded(at(to)));
        (self.from.map_or(Bound::Unbounded, |from| Bound::Included(at(from))), end)
    }
}

/// Page of a long answer.
#[derive(Debug, Args)]
pub struct PageArgs {
    /// Maximum number of rows; at most 10000
    #[arg(long, value_name = "N", default_value = "100")]
    pub limit: NonZero<usize>,
    /// Continue after a previous answer, by the cursor at its end
    #[arg(long, value_name = "CURSOR")]
    pub after: Option<Cursor>,
}

#[derive(Debug, Args)]
pub struct HistoryRunsArgs {
    #[command(flatten)]
    pub place: HistoryPlace,
    /// Maximum number of runs; at most 9999
    #[arg(long, value_name = "N", default_value = "50")]
    pub limit: NonZero<usize>,
    /// In a shared history: only runs after this one
    #[arg(long, value_name = "NUMBER")]
    pub after: Option<RunId>,
}

#[derive(Debug, Args)]
pub struct StateArgs {
    /// The run
    pub run: String,
    /// Time of the run, such as 12.5s; default: the end of the run
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    pub at: Option<Duration>,
    /// Write JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Plot a figure over time
///
/// Each point summarises the samples of an interval; the plot shows their range. `!` marks gaps, in which events were lost.
///
/// Figures are delay (ms), throughput (bit/s), queue (packets), delay_scale and drop_scale of a link; x, y, z (m), heading
/// (rad), linear and vertical (m/s), angular (rad/s), nearest_obstacle and localization_error (m) of a robot; load of a
/// radio unit; cpu, load_average and available_memory (bytes) of a machine; time_part (ms) of a link, `sender`, `vnf`,
/// `receiver` or `unknown`, the time of each sample there; service_time and handover_gap (ms) of `service` or of a robot;
/// lateness_p50, lateness_p99 and lateness_max (µs) of `service`, and signal of ROBOT:RADIO_UNIT (dBm). The service times
/// of all robots come with a table of each robot and service, and whether it kept its target.
#[derive(Debug, Args)]
pub struct SeriesArgs {
    /// The run
    pub run: String,
    /// A link, LINK:backward, a robot, ROBOT:RADIO_UNIT, a radio unit, a node with a machine, or `service`
    #[arg(value_name = "OF")]
    pub of: String,
    /// The figure; default: a link's delay, a robot's speed, the signal of ROBOT:RADIO_UNIT, a radio unit's load, a machine's
    /// cpu, or service_time
    #[arg(long, value_name = "FIGURE")]
    pub figure: Option<String>,
    #[command(flatten)]
    pub span: Span,
    /// Maximum number of points; default: 1000 with --csv, 400 with --out, or else the width of the terminal
    #[arg(long, value_name = "N")]
    pub points: Option<NonZero<usize>>,
    /// Write a table of comma-separated values
    #[arg(long)]
    pub csv: bool,
    /// Draw the figure into a file: its name ends with .svg, .pdf or .png
    #[arg(short, long, value_name = "FILE", value_parser = parse_figure_file, conflicts_with = "csv")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub place: HistoryPlace,
}

#[derive(Debug, Args)]
pub struct EventsArgs {
    /// The run
    pub run: String,
    /// Kinds of events, separated by commas; default: all
    #[arg(long, value_name = "KINDS", value_delimiter = ',')]
    pub kinds: Vec<Kind>,
    #[command(flatten)]
    pub span: Span,
    #[command(flatten)]
    pub page: PageArgs,
    /// Write JSON, one event on each line
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Write a large reading of a sensor, such as a scan or an image, to a file
///
/// The run's folder keeps the last readings of each such sensor. The bytes are the same as from the API.
#[derive(Debug, Args)]
pub struct DataArgs {
    /// The run's folder, or `latest`
    pub run: String,
    /// The robot
    pub robot: NodeId,
    /// The robot's sensor
    pub sensor: SensorId,
    /// Number of the reading, as in its event; default: the last reading
    pub sequence: Option<u64>,
    /// The file
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Folder with the folders of runs
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
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

/// Say what old context cost: a run whose plug-ins are away from the core, beside the same run without distances
///
/// Both are runs of the same file with the same seed, which differ in nothing but `control_delay`, `node` and `decides_in` of
/// plug-ins. Any other difference is named and rejected. For each service, there are the figures of both runs, and their
/// difference with an interval (95 %): the same blocks of time are drawn from both runs. docs/use/old-context.md explains it.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra history regret latest runs/corridor-20260101-120000
  cotorra history regret runs/corridor-20260101-120000 runs/corridor-20260101-120000/twins/okpi --json")]
pub struct RegretArgs {
    /// The run with distances, and the run without
    #[arg(value_names = ["FAR", "BESIDE"], num_args = 2, required = true)]
    pub pair: Vec<String>,
    /// Write JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// List gaps, in which events were lost, and services that stopped sampling
///
/// A run that was killed, or that ended while its history could not be written, has no end. It is unknown what it lost
/// after its last recorded event.
///
/// A service counts as silent if it has no sample for more than a second, and for more than five times as long as is
/// usual between two of its samples: its robot stood out of reach, or its VNF did not run. After the end of a robot's walk,
/// no samples are expected. Times of more than two seconds in which nothing was recorded are listed as `anything`: cotorra
/// was kept from running.
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
