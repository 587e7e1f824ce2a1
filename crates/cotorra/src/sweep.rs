//! `cotorra sweep`: many runs in virtual time, with progress and a summary.

use std::{
    collections::BTreeSet,
    fs,
    num::NonZero,
    path::{Path, PathBuf},
    process::ExitCode,
    thread,
    time::Duration,
};

use clap::Args;
use cotorra_experiments::{
    journal::Journal,
    sweep::{Axis, Cell, FILES, Interval, Runs, ServiceCell, Sweep, SweepError},
};
use cotorra_testbed::FolderError;

use crate::{
    duration::parse_duration,
    figures::FigureArgs,
    output,
    progress::Progress,
    signals,
    table::Table,
    testbed_file::{self, FileError},
    words::count,
};

/// Run a testbed in virtual time for all combinations of some settings, each with many seeds
///
/// A setting's values are a list, as in plugin=probing,okpi, or a range, as in 1..4, 0..1:0.25 (in steps of 0.25) or
/// 5..20:5 ms. docs/testbed-file.md, "Variants", explains paths. By default, one run for each CPU goes on at a time.
///
/// Each run is saved as soon as it is done. If a sweep is stopped, the same command resumes it. The command with more
/// values or seeds adds to it. A sweep leaves runs.csv (a row for each run), cells.csv (a row for each combination: means
/// and 95 % confidence intervals), regions.csv (a row for each stretch of a service with one radio unit and one server)
/// and sweep.svg. services.csv has a row for each robot and service of a run, service_cells.csv one for those of a combination, with means and
/// intervals, and service_cells.tex is the same for a paper, in LaTeX. time_parts.csv has a row for each link and host of a
/// run: what it added to service times above the target.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra sweep testbeds/corridor.yaml --set plugin=probing,okpi --seeds 20 --figure pdf
  cotorra sweep testbeds/corridor.yaml --set links.*.delay_scale=1..4 --set plugin=probing,okpi --seeds 100
  cotorra sweep testbeds/corridor.yaml --set plugin=okpi --set plugins.okpi.settings.gamma=2..20:2 --dry-run")]
pub struct SweepArgs {
    /// The testbed file
    pub file: PathBuf,
    /// A setting and its values; can be given several times
    #[arg(long = "set", value_name = "PATH=VALUES")]
    pub axes: Vec<Axis>,
    /// Number of runs of each combination; their seeds count up from the file's seed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// End each run after this time, such as 60s or 2min, if the walks take longer
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Number of runs at a time; default: the number of CPUs
    #[arg(short, long, value_name = "N")]
    pub jobs: Option<NonZero<usize>>,
    /// Folder of the sweep; default: one under sweeps/ that is named after the settings
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Discard the runs that the folder has
    #[arg(long)]
    pub fresh: bool,
    #[command(flatten)]
    pub figure: FigureArgs,
    /// Write plain lines instead of a progress bar
    #[arg(long)]
    pub headless: bool,
    /// Only list what would be run
    #[arg(long)]
    pub dry_run: bool,
}

/// Maximum number of combinations that the terminal lists.
const LISTED: usize = 40;

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Sweep(SweepError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error("cannot listen to Ctrl-C: {0}")]
    Signals(ctrlc::Error),
}

/// Converts an error. Mistakes of the testbed file are shown in their place.
fn report(error: SweepError) -> miette::Report {
    match error {
        SweepError::Testbed(wrong) => FileError::from(wrong).into(),
        other => Error::Sweep(other).into(),
    }
}

/// Runs a sweep.
pub fn sweep(args: &SweepArgs) -> miette::Result<ExitCode> {
    let loaded = testbed_file::load(&args.file, &[])?;
    let base = args.file.parent().unwrap_or(Path::new(""));
    let sweep =
        Sweep::new(&args.file.display().to_string(), loaded.text, base).seeds(args.seeds).until(args.until);
    let sweep = args.axes.iter().cloned().fold(sweep, Sweep::axis);
    let runs = sweep.points().map_err(report)?.len();
    let place = match &args.out {
        Some(out) => out.clone(),
        None => sweep.default_folder(Path::new("sweeps")).map_err(report)?,
    };
    let jobs = args.jobs.or_else(|| thread::available_parallelism().ok()).unwrap_or(NonZero::<usize>::MIN);
    if args.dry_run {
        output::print(&plan(&sweep, args, &place, runs, jobs))?;
        return Ok(ExitCode::SUCCESS);
    }
    let interrupts = signals::listen().map_err(Error::Signals)?;
    let folder = Journal::open(&place).map_err(Error::from)?;
    if args.fresh {
        folder.clear().map_err(Error::from)?;
    }
    let mut progress = Progress::new(args.headless);
    let runs = sweep.run(&folder, jobs, |done, of| {
        progress.show(done, of);
        interrupts.try_recv().is_err()
    });
    progress.close();
    let runs = runs.map_err(report)?;
    // A sweep that was stopped has its tables, too.
    sweep.write(&folder, &runs).map_err(Error::from)?;
    for format in args.figure.further() {
        sweep.write_figure(&folder, &runs, format).map_err(Error::from)?;
    }
    output::print(&describe(&sweep, &runs, folder.path(), &args.figure))?;
    Ok(if runs.done.len() == runs.total { ExitCode::SUCCESS } else { ExitCode::from(signals::INTERRUPTED) })
}

fn plan(sweep: &Sweep, args: &SweepArgs, place: &Path, runs: usize, jobs: NonZero<usize>) -> String {
    let mut table = Table::new("<<");
    for axis in sweep.axes() {
        table.row([axis.path().to_owned(), axis.values().join(", ")]);
    }
    table.row(["seeds".to_owned(), args.seeds.to_string()]);
    let again = if fs::exists(place).unwrap_or(false) {
        "; it exists: the runs that it has are not repeated"
    } else {
        ""
    };
    let text =
        format!("{}: {} in virtual time, {jobs} at a time\n\n", args.file.display(), count(runs, "run"));
    text + &table.render("  ") + &format!("\n{}/{again}\n  {}\n", place.display(), FILES.join("  "))
}

fn describe(sweep: &Sweep, runs: &Runs, folder: &Path, figure: &FigureArgs) -> String {
    let resumed =
        if runs.resumed > 0 { format!(", {} of them from before", runs.resumed) } else { String::new() };
    let mut text = format!("{} of {}{resumed}\n\n", runs.done.len(), count(runs.total, "run"));
    let cells = sweep.cells(runs);
    let axes = sweep.axes();
    let mut table = Table::new(&("<".repeat(axes.len()) + ">>>>>>>"));
    let heads = ["runs", "median, ms", "p99, ms", "above target, %", "took, s", "blind, m", "at once, m"]
        .map(str::to_owned);
    table.row(axes.iter().map(|axis| axis.path().to_owned()).chain(heads));
    for cell in cells.iter().take(LISTED) {
        let Cell { values, runs, service_time_p50_ms, service_time_p99_ms, above_target, .. } = cell;
        let Cell { duration_ms, blind_m, longest_blind_m, .. } = cell;
        let figures = [
            runs.to_string(),
            interval(*service_time_p50_ms, 1.0),
            interval(*service_time_p99_ms, 1.0),
            interval(*above_target, 100.0),
            interval(*duration_ms, 1e-3),
            interval(*blind_m, 1.0),
            interval(*longest_blind_m, 1.0),
        ];
        table.row(values.iter().cloned().chain(figures));
    }
    text += &table.render("  ");
    if cells.len() > LISTED {
        text += &format!("  and {} more in cells.csv\n", cells.len() - LISTED);
    }
    text += &services(sweep, &cells);
    if runs.done.len() < runs.total {
        text += "\nThe sweep was stopped; the same command resumes it.\n";
    }
    let figures = figure.files("sweep");
    text + &format!("\n{}/\n  {}{figures}\n", folder.display(), FILES.join("  "))
}

/// Returns the table of each robot and service, if several have samples. Names those that have none in any run.
fn services(sweep: &Sweep, cells: &[Cell]) -> String {
    let mut text = String::new();
    let all = || cells.iter().flat_map(|cell| &cell.services);
    let name = |its: &ServiceCell| format!("{} of {}", its.service, its.robot);
    let measured: BTreeSet<_> = all().filter(|its| its.runs > 0).map(name).collect();
    if measured.len() > 1 {
        let by_service = sweep.by_service(cells);
        let listed = &by_service.rows()[..by_service.rows().len().min(LISTED + 1)];
        text += &format!("\n{}", Table::of(listed, sweep.axes().len() + 2).render("  "));
        if by_service.rows().len() > LISTED + 1 {
            let more = by_service.rows().len() - LISTED - 1;
            text += &format!("  and {more} more in service_cells.csv\n");
        }
    }
    let without: BTreeSet<_> = all().map(name).filter(|name| !measured.contains(name)).collect();
    if !without.is_empty() {
        let names: Vec<_> = without.into_iter().collect();
        text += &format!("\nwithout samples: {}\n", names.join(", "));
    }
    text
}

fn interval(interval: Option<Interval>, factor: f64) -> String {
    interval.map_or("-".to_owned(), |interval| interval.times(factor))
}
