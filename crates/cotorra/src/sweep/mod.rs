//! `cotorra sweep`: many runs in virtual time, with progress and a summary, on one machine or on several.

pub mod args;
mod job_file;
mod merge;
mod results;
mod trial;

use std::{env, fs, io, num::NonZero, path::Path, process::ExitCode, thread};

use cotorra_experiments::{
    journal::Journal,
    sweep::{Axis, FILES, Measured, Point, Runs, Shard, Sweep, SweepError},
};
use cotorra_testbed::{FolderError, Made, Manifest, ManyInputs, Repeat, RunError, Time, Verdict};
use cotorra_testbed_file::Setting;

use args::{Keep, SweepArgs, SweepCommand};
use job_file::{Job, Scheduler};
use trial::Trial;

use crate::{
    approval,
    exit::Status,
    origin::{self, SOURCES},
    output,
    progress::Progress,
    signals,
    table::Table,
    temporary::TemporaryFolder,
    testbed_file::{self, FileError},
    words::{count, of_them},
};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Sweep(SweepError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Inputs(#[from] RunError),
    #[error("the figure is drawn when all shards are merged")]
    #[diagnostic(help("give --figure to `cotorra sweep merge`"))]
    Figure,
    #[error("cannot find the path of this program, or of the current folder: {0}")]
    Place(io::Error),
    #[error(transparent)]
    JobFile(#[from] job_file::JobFileError),
    #[error("no run can pass or fail, because the testbed file demands no share of samples")]
    #[diagnostic(help(
        "demand one of a service, as in `kpis: {{ service_time: 15 ms, kept: 99 % }}`, or leave --require-pass out"
    ))]
    NothingDemanded,
}

/// Converts an error. Mistakes of the testbed file are shown in their place.
fn report(error: SweepError) -> miette::Report {
    match error {
        SweepError::Testbed(wrong) => FileError::from(wrong).into(),
        other => Error::Sweep(other).into(),
    }
}

/// Runs a sweep or a shard, prints a job file, or merges shards.
pub fn sweep(args: &SweepArgs) -> miette::Result<ExitCode> {
    if let Some(SweepCommand::Merge(args)) = &args.command {
        return merge::merge(args);
    }
    let loaded = testbed_file::load(args.file(), &[])?;
    let base = args.file().parent().unwrap_or(Path::new(""));
    let sweep = Sweep::new(&args.file().display().to_string(), loaded.text.clone(), base)
        .seeds(args.seeds)
        .until(args.until);
    let sweep = args.axes.iter().cloned().fold(sweep, Sweep::axis);
    let sweep = match args.keep {
        Some(Keep::Samples) => sweep.keep_samples(),
        None => sweep,
    };
    let place = match &args.out {
        Some(out) => out.clone(),
        None => sweep.default_folder(Path::new("sweeps")).map_err(report)?,
    };
    if args.dry_run {
        output::print(&plan(&sweep, args, &place)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    approval::demand(&loaded, args.file(), args.trust)?;
    match args {
        SweepArgs { emit: Some(scheduler), .. } => emit(&sweep, args, &place, *scheduler),
        SweepArgs { shard: Some(_), figure, .. } if figure.further().next().is_some() => {
            Err(Error::Figure.into())
        }
        _ => run(&sweep, args, &place, &loaded.text),
    }
}

/// Runs a sweep or a shard of it.
fn run(sweep: &Sweep, args: &SweepArgs, place: &Path, text: &str) -> miette::Result<ExitCode> {
    // So that an invalid sweep leaves no folder.
    let points = sweep.points().map_err(report)?;
    if let Some(shard) = args.shard {
        Shard::check(shard.shards(), points.len()).map_err(report)?;
    }
    let interrupts = signals::listen()?;
    let folder = match args.shard {
        Some(shard) => Journal::open(&place.join(shard.folder())).map(Journal::durable),
        None => Journal::open(place),
    };
    let folder = folder.map_err(Error::from)?.by(SOURCES);
    if args.fresh {
        folder.clear().map_err(Error::from)?;
    }
    note(sweep, args, &points, text, folder.path())?;
    let mut progress = Progress::new(args.headless);
    let go_on = |done, of| {
        progress.show(done, of);
        interrupts.try_recv().is_err()
    };
    let jobs = jobs(args);
    let runs = match args.shard {
        Some(shard) => sweep.run_shard(shard, &folder, jobs, go_on),
        None => sweep.run(&folder, jobs, go_on),
    };
    progress.close();
    let runs = runs.map_err(report)?;
    let whole = runs.done.len() == runs.total;
    let stopped = if whole { "" } else { "\nThe sweep was stopped; the same command resumes it.\n" };
    match args.shard {
        Some(shard) => {
            let (done, folder) = (runs.done.len(), folder.path().display());
            let (all, of_them) = (count(runs.total, "run"), of_them(0, runs.void()));
            let again = &runs.again;
            output::print(&format!(
                "shard {shard}: {done} of {all}{of_them}\n{again}{stopped}\n{folder}/\n"
            ))?;
        }
        None => {
            // A sweep that was stopped has its tables, too.
            runs.write(&folder).map_err(Error::from)?;
            if whole {
                Manifest::complete(folder.path()).map_err(Error::from)?;
            }
            for format in args.figure.further() {
                runs.write_figure(&folder, format).map_err(Error::from)?;
            }
            output::print(&results::describe(&runs, stopped, folder.path(), &args.figure))?;
        }
    }
    match args.shard {
        _ if !whole => Ok(Status::Interrupted.into()),
        // Its void runs are those of the whole sweep, which merging says, so that schedulers get there.
        Some(_) => Ok(ExitCode::SUCCESS),
        None => outcome(&runs, args.require_pass),
    }
}

/// Returns the exit status after a sweep whose runs may have to pass.
fn outcome(runs: &Runs, must_pass: bool) -> miette::Result<ExitCode> {
    let measured = runs.done.iter().filter_map(|done| done.outcome.measured());
    let status = match Verdict::of_all(measured.map(Measured::verdict)) {
        _ if runs.void() > 0 => Status::NotValid,
        _ if !must_pass => Status::Done,
        Some(Verdict::Pass) => Status::Done,
        Some(Verdict::Fail) => Status::Failed,
        None => return Err(Error::NothingDemanded.into()),
    };
    Ok(status.into())
}

/// Carries the inputs of a sweep into its folder, and notes there how it came to be.
fn note(sweep: &Sweep, args: &SweepArgs, points: &[Point], text: &str, folder: &Path) -> Result<(), Error> {
    // Numbers name no files.
    let axes = sweep.axes().iter().filter(|axis| axis.numbers().is_none());
    let of = |axis: &Axis| -> Vec<_> {
        axis.values().iter().filter_map(|value| Setting::new(axis.path(), value).ok()).collect()
    };
    let settings: Vec<_> = axes.flat_map(of).collect();
    let base = args.file().parent().unwrap_or(Path::new(""));
    let carried = ManyInputs::carry(folder, text, base, &settings)?;
    // The tables have the values as they were given, so that others would make other tables.
    let moved = settings.iter().zip(&carried.settings).find(|(given, carried)| given != carried);
    let repeat = match moved {
        Some((given, _)) => {
            Repeat::Not(format!("`--set {given}` leads out of the folder of the testbed file"))
        }
        None => {
            let mut words = args.given.clone();
            words.push(ManyInputs::TESTBED.to_owned());
            Repeat::Words(words)
        }
    };
    let mut seeds: Vec<_> = points.iter().map(|point| point.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let inexact = sweep.inexact().map_err(Error::Sweep)?;
    inexact.iter().for_each(|why| note!("{why}"));
    let made = Made { time: Time::Virtual, inexact, seeds, until: args.until };
    Ok(origin::note(folder, repeat, &made, &carried)?)
}

fn jobs(args: &SweepArgs) -> NonZero<usize> {
    args.jobs.or_else(|| thread::available_parallelism().ok()).unwrap_or(NonZero::<usize>::MIN)
}

/// Prints a job file, and notes on its shards to standard error.
fn emit(sweep: &Sweep, args: &SweepArgs, place: &Path, scheduler: Scheduler) -> miette::Result<ExitCode> {
    let points = sweep.points().map_err(report)?;
    let jobs = args.jobs.unwrap_or(NonZero::<usize>::MIN);
    if let Some(shards) = args.shards {
        Shard::check(shards, points.len()).map_err(report)?;
    }
    let logs = TemporaryFolder::new().map_err(Error::from)?;
    let trial = Trial::new(sweep, &points, jobs, &logs.path().join("run")).map_err(report)?;
    let shards = args.shards.unwrap_or_else(|| trial.shards());
    let summary = trial.summary(shards);
    note!("{summary}");
    if let Some(warning) = trial.warning(shards) {
        note!("{warning}");
    }
    let program = match scheduler {
        // The one of the container.
        Scheduler::Kubernetes => "cotorra".into(),
        _ => env::current_exe().map_err(Error::Place)?,
    };
    let job = Job {
        summary: format!("{}: {summary}", args.file().display()),
        folder: env::current_dir().map_err(Error::Place)?,
        out: place.to_owned(),
        run: args.command(&program, place, jobs),
        merge: args.merge_command(&program, place),
        shards,
        jobs,
    };
    output::print_exact(&job.file(scheduler).map_err(Error::from)?)?;
    Ok(ExitCode::SUCCESS)
}

/// Describes what would be run.
fn plan(sweep: &Sweep, args: &SweepArgs, place: &Path) -> miette::Result<String> {
    let runs = sweep.points().map_err(report)?.len();
    let jobs = jobs(args);
    let mut table = Table::new("<<");
    for axis in sweep.axes() {
        table.row([axis.path().to_owned(), axis.values().join(", ")]);
    }
    table.row(["seeds".to_owned(), args.seeds.to_string()]);
    let again = if fs::exists(place).unwrap_or(false) {
        "; it exists: the runs that it has are not repeated unless something changed"
    } else {
        ""
    };
    let text =
        format!("{}: {} in virtual time, {jobs} at a time\n\n", args.file().display(), count(runs, "run"));
    Ok(text + &table.render("  ") + &format!("\n{}/{again}\n  {}\n", place.display(), FILES.join("  ")))
}
