//! What can be typed behind `cotorra history`.

use std::{num::NonZero, ops::Bound, path::PathBuf, time::Duration};

use clap::{Args, Subcommand};
use cotorra_graph::{NodeId, SensorId, Timestamp};
use cotorra_measurements::{Cursor, Kind, RunId, export::Format};

use super::place::{HISTORY_VARIABLE, Place};
use crate::duration::{parse_step, parse_time};

/// Of the whole command.
pub const EXAMPLES: &str = "\
Examples:
  cotorra history runs
  cotorra history state latest --at 12.5s
  cotorra history series latest service
  cotorra history series latest R1~lan --figure delay --from 1min --to 2min
  cotorra history series latest robot --figure x --csv > x.csv
  cotorra history events latest --kinds handover,decision
  cotorra history diff runs/corridor-20260101-120000 latest
  cotorra history data latest robot camera -o image.raw
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
    Data(DataArgs),
    /// List where events were lost
    Gaps(GapsArgs),
    Export(ExportArgs),
    Import(ImportArgs),
    Prune(PruneArgs),
}

/// Roll old samples up to points, one for each step of time, and drop what is older still
///
/// Of samples that are older than --raw there is left, for each robot, radio unit, direction of a link and sensor and each
/// step, the last sample, and the count, least, greatest and mean of all. Everything that happened otherwise is kept. It
/// says what it would do, and does it with --yes. Without --raw it keeps to what the run's testbed file says under
/// history.retention.
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
    /// Of these kinds only: robot, radio, link, sensor
    #[arg(long, value_name = "KINDS", value_delimiter = ',', value_parser = ["robot", "radio", "link", "sensor"])]
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
    /// Its password is in the environment variable COTORRA_HISTORY_PASSWORD, where nobody else sees it. A server needs a
    /// cotorra that was built with `--features mariadb`.
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

impl Span {
    /// Returns the times of the run between the two ends.
    pub fn range(&self) -> (Bound<Timestamp>, Bound<Timestamp>) {
        let at = |after_start| Timestamp::ZERO + after_start;
        let end = self.to.map_or(Bound::Unbounded, |to| Bound::Excluded(at(to)));
        (self.from.map_or(Bound::Unbounded, |from| Bound::Included(at(from))), end)
    }
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
/// Figures are delay (ms), throughput (bit/s), delay_scale and drop_scale of a link; x, y, z (m), heading (rad), speed
/// and climb (m/s), turn (rad/s) and obstacle (m) of a robot; load of a radio unit; service_time and handover_gap (ms),
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

/// Write large data of a sensor, such as a scan or an image, to a file
///
/// It is in the run's folder, which has the last readings of each such sensor. The bytes are as the API gives them.
#[derive(Debug, Args)]
pub struct DataArgs {
    /// The run's folder, or `latest`
    pub run: String,
    /// The robot
    pub robot: NodeId,
    /// Its sensor
    pub sensor: SensorId,
    /// The number of a reading, as events have it; the last one if it is left out
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
