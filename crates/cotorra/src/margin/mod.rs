//! `cotorra margin`: the smallest changes that break a target, and decisions beside their alternatives.

pub mod args;
mod cells;
mod decisions;
mod distances;
mod show;

use std::{fs, num::NonZero, path::Path, process::ExitCode, thread};

use cotorra_experiments::{
    BatchError,
    journal::Journal,
    margin::{Grid, Kind, LOSS_UNITS, Margin, MarginError, Options},
    regret::RegretError,
};
use cotorra_testbed::{FolderError, Made, Manifest, ManyInputs, Repeat, RunError, Time, inexact};

use self::args::{MarginArgs, WhichDecision};
use crate::{
    approval,
    exit::Status,
    origin::{self, SOURCES},
    output,
    progress::Progress,
    signals, testbed_file,
};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error("{0}")]
    #[diagnostic(help("lower --keep, raise the target (`kpis:`), or choose services with --kpi"))]
    Broken(MarginError),
    #[error(transparent)]
    Margin(MarginError),
    #[error("{0}")]
    #[diagnostic(help("`--decision all --dry-run` lists the decisions"))]
    NoDecision(RegretError),
    #[error(transparent)]
    Regret(RegretError),
    #[error("--{name} is above zero, and at most --{most}")]
    Resolution { name: &'static str, most: &'static str },
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Inputs(#[from] RunError),
    #[error(transparent)]
    Signals(#[from] signals::SignalsError),
}

impl From<MarginError> for Error {
    fn from(error: MarginError) -> Self {
        match error {
            MarginError::Broken { .. } => Self::Broken(error),
            other => Self::Margin(other),
        }
    }
}

impl From<RegretError> for Error {
    fn from(error: RegretError) -> Self {
        match error {
            RegretError::NoDecision { .. } => Self::NoDecision(error),
            other => Self::Regret(other),
        }
    }
}

/// Whether the run without changes, or the one whose decisions are examined, was void.
pub fn is_void(error: &miette::Report) -> bool {
    matches!(
        error.downcast_ref(),
        Some(
            Error::Margin(MarginError::Run(BatchError::CutOff { .. }))
                | Error::Regret(RegretError::Batch(BatchError::CutOff { .. }))
        )
    )
}

/// Searches for margins, or examines decisions.
pub fn margin(args: &MarginArgs) -> miette::Result<ExitCode> {
    let loaded = testbed_file::load(&args.file, &args.settings)?;
    if !args.dry_run {
        approval::demand(&loaded, &args.file, args.trust)?;
    }
    let seed = args.seed.unwrap_or(loaded.testbed.seed);
    let jobs = args.jobs.or_else(|| thread::available_parallelism().ok()).unwrap_or(NonZero::<usize>::MIN);
    if let Some(which) = args.decision {
        return decisions::examine(args, loaded, seed, jobs, which);
    }
    let kinds =
        if args.kinds.is_empty() { Kind::ALL.map(|(_, kind)| kind).into() } else { args.kinds.clone() };
    let of_loss = |share: f64| (share * LOSS_UNITS as f64).round() as u64;
    let nanos = |duration: std::time::Duration| duration.as_nanos() as u64;
    let wrong = |name, most| Error::Resolution { name, most };
    let options = Options {
        services: args.kpi.clone(),
        keep: args.keep,
        seed,
        seeds: args.seeds,
        until: args.until,
        kinds,
        on: args.on.clone(),
        delays: Grid::new(nanos(args.most), nanos(args.resolution)).ok_or(wrong("resolution", "most"))?,
        losses: Grid::new(of_loss(args.most_loss.get()), of_loss(args.loss_resolution.get()))
            .ok_or(wrong("loss-resolution", "most-loss"))?,
        pairs: !args.singles,
    };
    let (file, text) = (args.file.display().to_string(), loaded.text.clone());
    let inexact = inexact(&loaded.testbed);
    let margin = Margin::new(&file, loaded.testbed, loaded.text, options).map_err(Error::from)?;
    let place = args.out.clone().unwrap_or_else(|| margin.default_folder(Path::new("margins")));
    if args.dry_run {
        output::print(&(show::plan(&margin, args, jobs) + &again(&place)))?;
        return Ok(ExitCode::SUCCESS);
    }
    let (interrupts, journal) = open(args, &place, (&text, inexact), seed)?;
    let mut progress = Progress::new(args.headless);
    let margins = margin.run(&journal, jobs, |done, of| {
        progress.show(done, of);
        interrupts.try_recv().is_err()
    });
    progress.close();
    let margins = margins.map_err(Error::from)?;
    margins.write(&journal).map_err(Error::from)?;
    if margins.complete {
        Manifest::complete(journal.path()).map_err(Error::from)?;
    }
    output::print(&show::describe(&margins, journal.path()))?;
    Ok(exit(margins.complete, margins.void))
}

/// Opens the folder of the results of runs with this text of the testbed file, carries there what they need, and listens to
/// Ctrl-C.
fn open(
    args: &MarginArgs,
    place: &Path,
    (text, inexact): (&str, Option<String>),
    seed: u64,
) -> Result<(std::sync::mpsc::Receiver<()>, Journal), Error> {
    let interrupts = signals::listen()?;
    inexact.iter().for_each(|why| note!("{why}"));
    let journal = Journal::open(place)?.by(SOURCES);
    if args.fresh {
        journal.clear()?;
    }
    let base = args.file.parent().unwrap_or(Path::new(""));
    let carried = ManyInputs::carry(journal.path(), text, base, &[])?;
    let mut words = args.given.clone();
    words.push(ManyInputs::TESTBED.to_owned());
    let seeds = (0..u64::from(args.seeds)).map(|number| seed.wrapping_add(number)).collect();
    let made = Made { time: Time::Virtual, inexact, seeds, until: args.until };
    origin::note(journal.path(), Repeat::Words(words), &made, &carried)?;
    Ok((interrupts, journal))
}

fn exit(is_complete: bool, void: usize) -> ExitCode {
    let status = match (is_complete, void) {
        (false, _) => Status::Interrupted,
        (true, 0) => Status::Done,
        (true, _) => Status::NotValid,
    };
    status.into()
}

/// Names the folder of the results before they are there.
fn again(place: &Path) -> String {
    let exists = fs::exists(place).unwrap_or(false);
    let again = if exists {
        "; it exists: the runs that it has are not repeated unless something changed"
    } else {
        ""
    };
    format!("\n{}/{again}\n", place.display())
}
