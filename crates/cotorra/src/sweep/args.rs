//! Arguments of `cotorra sweep`.

use std::{
    ffi::OsString,
    num::NonZero,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::{Args, Subcommand, ValueEnum};
use cotorra_experiments::sweep::{Axis, Shard};

use super::job_file::Scheduler;
use crate::{approval::TrustArgs, duration::parse_duration, figures::FigureArgs};

/// Run a testbed in virtual time for all combinations of some settings, each with many seeds
///
/// A setting's values are a list, as in plugin=probing,okpi, or a range, as in 1..4, 0..1:0.25 (in steps of 0.25) or
/// 5..20:5 ms. docs/reference/testbed-file.md, "Variants", explains paths. By default, one run for each CPU goes on
/// at a time.
///
/// Each run is saved as soon as it is done. If a sweep is stopped, the same command resumes it. The command with more
/// values or seeds adds to it. A sweep leaves runs.csv (a row for each run), cells.csv (a row for each combination: means
/// and 95 % confidence intervals), differences.csv (each combination less the first, over runs with the same seed), regions.csv (a row for each stretch of a service with one radio unit and one server)
/// and sweep.svg. services.csv has a row for each robot and service of a run, service_cells.csv one for those of a combination, with means and
/// intervals, and service_cells.tex is the same for a paper, in LaTeX. time_parts.csv has a row for each link and host of a
/// run: what it added to service times above the target. traffic.csv has the goodput of each source of traffic of a run,
/// bill.csv its prices and energy.csv its energies. With --keep samples, samples/ has every service time of each run.
///
/// On several machines, --shard runs a part of the sweep, and `cotorra sweep merge` joins the parts. --emit prints a job
/// file for a scheduler that does both. docs/use/cluster.md explains it.
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_long_help = "\
Exit status: 0 done, 1 error, 2 wrong usage, 3 done but a run is void, 4 done but a run failed (with --require-pass),
130 stopped with Ctrl-C.

Examples:
  cotorra sweep testbeds/corridor.yaml --set plugin=probing,okpi --seeds 20 --figure pdf
  cotorra sweep testbeds/corridor.yaml --set links.*.delay_scale=1..4 --set plugin=probing,okpi --seeds 100
  cotorra sweep testbeds/corridor.yaml --set plugin=probing,okpi --seeds 20 --keep samples --out corridor
  cotorra sweep testbeds/corridor.yaml --set plugin=okpi --set plugins.okpi.settings.gamma=2..20:2 --dry-run
  cotorra sweep testbeds/corridor.yaml --seeds 5000 --emit slurm > sweep.sh   # then, on the cluster: sh sweep.sh
  cotorra sweep testbeds/corridor.yaml --seeds 5000 --out corridor --shard 3/40
  cotorra sweep merge corridor"
)]
pub struct SweepArgs {
    #[command(subcommand)]
    pub command: Option<SweepCommand>,
    /// The testbed file
    #[arg(required = true)]
    file: Option<PathBuf>,
    /// A setting and its values; can be given several times
    #[arg(long = "set", value_name = "PATH=VALUES")]
    pub axes: Vec<Axis>,
    /// Number of runs of each combination; their seeds count up from the file's seed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// End each run after this time, such as 60s or 2min, if the walks take longer
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Number of runs at a time; default: the number of CPUs, and 1 in each shard of a job file
    #[arg(short, long, value_name = "N")]
    pub jobs: Option<NonZero<usize>>,
    /// Folder of the sweep; default: one under sweeps/ that is named after the settings
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// What to keep of each run beside its figures
    ///
    /// Samples are a table for each run in samples/, with the settings and the seed in the first columns. Runs that the folder
    /// has without their samples are made again.
    #[arg(long, value_name = "WHAT")]
    pub keep: Option<Keep>,
    /// Discard the runs that the folder has
    #[arg(long)]
    pub fresh: bool,
    #[command(flatten)]
    pub trust: TrustArgs,
    /// End with exit status 4 if a service of any run failed a KPI of the testbed file
    #[arg(long, conflicts_with_all = ["dry_run"])]
    pub require_pass: bool,
    #[command(flatten)]
    pub figure: FigureArgs,
    /// Write plain lines instead of a progress bar
    #[arg(long)]
    pub headless: bool,
    /// Only list what would be run
    #[arg(long)]
    pub dry_run: bool,
    /// Run only this part of the runs, as in 3/40: the third of 40. `cotorra sweep merge` joins all parts
    #[arg(long, value_name = "I/N", conflicts_with_all = ["dry_run", "emit"])]
    pub shard: Option<Shard>,
    /// Print a job file that runs the sweep in shards and merges them
    ///
    /// Some runs are tried out first, so that each shard takes about two minutes: schedulers need seconds to start one.
    #[arg(long, value_name = "SCHEDULER", conflicts_with_all = ["dry_run", "fresh"])]
    pub emit: Option<Scheduler>,
    /// Number of shards in the job file; default: what the runs that are tried out suggest
    #[arg(long, value_name = "N", requires = "emit")]
    pub shards: Option<NonZero<usize>>,
    /// The words of the command line that have a part in results, for their manifest.
    #[arg(skip)]
    pub given: Vec<String>,
}

/// Parts of each run that a sweep keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Keep {
    /// Every service time
    Samples,
}

#[derive(Debug, Subcommand)]
pub enum SweepCommand {
    Merge(MergeArgs),
}

impl SweepArgs {
    /// Returns the path of the testbed file, if there is no subcommand.
    pub fn file(&self) -> &Path {
        self.file.as_deref().expect("without a subcommand, the file is required")
    }

    /// Returns the command line of a shard in this folder of the sweep, but for `--shard` itself.
    pub fn command(&self, program: &Path, out: &Path, jobs: NonZero<usize>) -> Vec<OsString> {
        let option = |name: &str, value: String| [name.into(), value.into()];
        let axes = self.axes.iter().flat_map(|axis| option("--set", axis.to_string()));
        let until = self.until.map(|until| option("--until", format!("{}s", until.as_secs_f64())));
        let mut words = vec![program.into(), "sweep".into(), self.file().into()];
        words.extend(axes);
        words.extend(option("--seeds", self.seeds.to_string()));
        words.extend(until.into_iter().flatten());
        words.extend(self.keep.iter().flat_map(|Keep::Samples| option("--keep", "samples".to_owned())));
        words.extend(option("--jobs", jobs.to_string()));
        words.extend(["--out".into(), out.into()]);
        words
    }

    /// Returns the command line that merges the shards in this folder of the sweep.
    pub fn merge_command(&self, program: &Path, out: &Path) -> Vec<OsString> {
        let mut words = vec![program.into(), "sweep".into(), "merge".into(), out.into()];
        let formats: Vec<_> = self.figure.further().map(|format| format.to_string()).collect();
        if !formats.is_empty() {
            words.extend(["--figure".into(), formats.join(",").into()]);
        }
        if self.require_pass {
            words.push("--require-pass".into());
        }
        words
    }
}

/// Join the shards of a sweep
///
/// Leaves the same tables and the same figure as the sweep on one machine, to the byte. Also joins the journals, so that the
/// sweep can go on in the same folder without its shards. Merging again changes nothing.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra sweep merge sweeps/corridor-1a2b3c4d
  cotorra sweep merge from-one-cluster from-another --out corridor --figure pdf
  cotorra sweep merge sweeps/corridor-1a2b3c4d --partial")]
pub struct MergeArgs {
    /// Folder of the sweep, or of a shard; can be several
    #[arg(required = true, value_name = "DIR")]
    pub(super) folders: Vec<PathBuf>,
    /// Folder for the result; default: the one that holds the first shard
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    /// Merge what there is, even if runs are missing
    #[arg(long)]
    pub(super) partial: bool,
    /// End with exit status 4 if a service of any run kept its target less often than the testbed file demands
    #[arg(long)]
    pub(super) require_pass: bool,
    #[command(flatten)]
    pub(super) figure: FigureArgs,
}
