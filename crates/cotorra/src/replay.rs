//! `cotorra replay`: plays a recorded run through the API, and prints what a plug-in asks for meanwhile.

use std::{path::Path, process::ExitCode, time::Duration};

use cotorra_graph::{
    Testbed, Timestamp,
    testbed_file::{self, Setting},
};
use cotorra_testbed::replay::{Played, Replay, ReplayEnd, ReplayError, ReplayOptions, Speed};
use indicatif::ProgressBar;

use crate::{
    cli::{self, ReplayArgs},
    history::Source,
    output, run, signals,
    testbed_file::FileError,
};

/// What a shell calls a program that SIGINT ended.
const INTERRUPTED: u8 = 130;

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error("cannot listen to Ctrl-C: {0}")]
    Signals(ctrlc::Error),
}

/// Plays a run.
pub fn replay(args: &ReplayArgs) -> miette::Result<ExitCode> {
    let source = Source::find(&args.run, &args.place)?;
    let testbed = recorded(&source.run.info.testbed, &args.run, &args.base).map_err(FileError::from)?;
    let after_start = |after: Duration| Timestamp::ZERO + after;
    let options = ReplayOptions {
        api: args.api,
        tokens: run::tokens()?,
        speed: match args.speed {
            cli::Speed::Times(times) => Speed::Times(times),
            cli::Speed::Max => Speed::Max { followers: args.plugins.get() },
        },
        from: args.span.from.map_or(Timestamp::ZERO, after_start),
        to: args.span.to.map(after_start),
        foxglove: args.foxglove,
    };
    let interrupts = signals::listen().map_err(Error::Signals)?;
    let replay = Replay::new(testbed, source.history, source.run.id, options).map_err(Error::from)?;
    eprintln!("API on http://{}, replay of {}", replay.api_address(), args.run);
    if let Some(foxglove) = replay.foxglove_address() {
        eprintln!("Foxglove on ws://{foxglove}");
    }
    let bar = ProgressBar::new_spinner();
    let mut printed = Ok(());
    let end = replay.play(|played| {
        match played {
            Played::Time(now) => {
                bar.set_message(format!("{:.1} s", now.as_secs_f64()));
                bar.tick();
            }
            Played::Refused(decision) => {
                let json = serde_json::to_string(decision).expect("a decision holds only what JSON can");
                printed = bar.suspend(|| output::print(&(json + "\n")));
            }
            Played::LeftBehind(plugin) => {
                bar.suspend(|| eprintln!("{plugin} was silent for too long, and is not waited for any more"));
            }
        }
        printed.is_ok() && interrupts.try_recv().is_err()
    });
    bar.finish_and_clear();
    let end = end.map_err(Error::from)?;
    printed?;
    let (told, code) = match end {
        ReplayEnd::Played => ("all was played", ExitCode::SUCCESS),
        ReplayEnd::Alone => ("nobody follows any more", ExitCode::SUCCESS),
        ReplayEnd::Stopped => ("it was stopped", ExitCode::from(INTERRUPTED)),
    };
    eprintln!("the replay is over: {told}");
    Ok(code)
}

/// The testbed as it was run, with the settings that were noted behind its file.
pub fn recorded(text: &str, run: &str, base: &Path) -> Result<Testbed, cotorra_graph::Diagnostics> {
    let noted = text.lines().rev().map_while(|line| line.strip_prefix("# set: "));
    let mut settings: Vec<Setting> = noted.filter_map(|setting| setting.parse().ok()).collect();
    settings.reverse();
    testbed_file::parse_with(&format!("the testbed file of {run}"), text, base, &settings)
}
