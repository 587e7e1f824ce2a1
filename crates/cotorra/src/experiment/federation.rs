//! `cotorra experiment federation`: the robot that leaves its domain's coverage, over ledgers with several block periods.

use std::{process::ExitCode, time::Duration};

use cotorra_graph::testbed_file::Setting;
use cotorra_measurements::{History, RunId};
use cotorra_testbed::{
    FolderError, Options, Place, Recorded, RecordedError,
    experiment::federation::{Comparison, FILES, Federated, NoFederation, settings},
};

use crate::{
    cli::FederationArgs,
    output,
    run::{self, Stage},
    testbed_file::{self, Loaded, count},
};

/// Why the experiment has no result.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Recorded(#[from] RecordedError),
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    #[error("no run shows a federation; the last of them, {folder}: {source}")]
    #[diagnostic(help("`cotorra history events {folder} --kinds decision` shows what happened"))]
    None { folder: String, source: NoFederation },
    #[error("stopped during a run, which is in {folder}; it was the first")]
    Stopped { folder: String },
}

/// A run that is to be.
struct Planned {
    block_period: Duration,
    seed: u64,
    settings: Vec<Setting>,
    loaded: Loaded,
}

/// Runs the robot's walk with each block period.
pub fn federation(args: &FederationArgs) -> miette::Result<ExitCode> {
    let planned = plan(args)?;
    let how = if args.emulate {
        "emulated with real packets, on an anvil node: one node without consensus"
    } else {
        "in virtual time, on a modelled ledger"
    };
    if args.dry_run {
        output::print(&describe_plan(args, how, &planned))?;
        return Ok(ExitCode::SUCCESS);
    }
    let stage = Stage::set(args.headless, args.verbose, args.emulate)?;
    let folder = Place::In(args.out.clone()).create("experiment-federation").map_err(Error::from)?;
    // A run that goes wrong, or is stopped, takes nothing from those that did not.
    let (mut runs, mut failed, mut invalid) = (Vec::new(), Vec::new(), None);
    for (number, plan) in planned.iter().enumerate() {
        let name = format!("{number:03}-{}s", plan.block_period.as_secs_f64());
        let options = Options {
            seed: Some(plan.seed),
            until: args.until,
            folder: Place::At(folder.join(&name)),
            tokens: run::tokens()?,
            save_power: args.save_power,
            settings: plan.settings.clone(),
            ..Options::default()
        };
        let what = format!("{name}: ");
        let finished = if args.emulate {
            eprintln!("{what}{} of {}", number + 1, planned.len());
            stage.emulate(&plan.loaded, &args.testbed, options)
        } else {
            stage.simulate(&plan.loaded, &options, &what)
        };
        let finished = finished.inspect_err(|_| super::withdraw(&folder))?;
        let at = finished.folder.display().to_string();
        if finished.was_stopped() {
            if runs.is_empty() {
                return Err(Error::Stopped { folder: at }.into());
            }
            break;
        }
        let read =
            |history: &History, run: RunId| Federated::read(history, run, plan.block_period, plan.seed);
        let recorded = Recorded::of_folder(&finished.folder).map_err(Error::from)?;
        let history = History::open(&recorded.history).map_err(Error::from)?;
        match read(&history, finished.run) {
            Ok(run) => runs.push(run),
            Err(source) => failed.push((at, source)),
        }
        if !finished.summary.fidelity.valid {
            invalid = Some(finished.summary);
        }
    }
    if runs.is_empty()
        && let Some((folder, source)) = failed.pop()
    {
        return Err(Error::None { folder, source }.into());
    }
    let comparison = Comparison { runs };
    comparison.write(&folder, how).map_err(Error::from)?;
    let mut text = comparison.to_markdown(how);
    text += &format!("\n{}/\n  {}  {}\n", folder.display(), FILES.join("  "), count(planned.len(), "run"));
    for (folder, source) in &failed {
        text += &format!("NOT COUNTED: {folder}: {source}\n");
    }
    output::print(&text)?;
    let invalid = invalid.map_or(ExitCode::SUCCESS, |summary| run::verdict(&summary));
    Ok(if failed.is_empty() { invalid } else { ExitCode::from(run::NOT_VALID) })
}

fn plan(args: &FederationArgs) -> miette::Result<Vec<Planned>> {
    let plain = testbed_file::load(&args.testbed, &args.settings)?;
    let kind = if args.emulate { "anvil" } else { "modelled" };
    let mut planned = Vec::new();
    for block_period in &args.block_period {
        for number in 0..args.runs {
            // Spread over a block period, so that announcements come at all of its times.
            let phase = (f64::from(number) + 0.5) / f64::from(args.runs);
            let for_blocks = settings(&plain.testbed, kind, *block_period, phase).into_iter();
            let for_blocks = for_blocks.map(|(path, value)| {
                Setting::new(&path, &value).expect("paths and values of the experiment are settings")
            });
            // What the user sets comes last, and so wins.
            let settings: Vec<_> = for_blocks.chain(args.settings.iter().cloned()).collect();
            let loaded = testbed_file::load(&args.testbed, &settings)?;
            let seed = args.seed.unwrap_or(plain.testbed.seed) + u64::from(number);
            planned.push(Planned { block_period: *block_period, seed, settings, loaded });
        }
    }
    Ok(planned)
}

fn describe_plan(args: &FederationArgs, how: &str, planned: &[Planned]) -> String {
    let mut text = args.testbed.display().to_string();
    if let Some(first) = planned.first() {
        text += &format!(": {}\n\n", testbed_file::overview(&first.loaded.testbed));
    }
    for block_period in &args.block_period {
        let seconds = block_period.as_secs_f64();
        text += &format!("  {} with a block each {seconds} s, {how}\n", count(args.runs as usize, "run"));
    }
    let folder = args.out.join("experiment-federation-<time>");
    text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  "))
}
