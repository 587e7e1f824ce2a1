//! `cotorra view`: serves a finished run to the dashboard.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use cotorra_graph::Timestamp;
use cotorra_measurements::{History, Run, RunId, export::Format};
use cotorra_plugin::runs::Runs;
use cotorra_testbed::replay::{Replay, ReplayError, ReplayOptions};
use miette::IntoDiagnostic;

use crate::{
    arguments::{AccessArgs, note_network, parse_address},
    browser::Opener,
    history::{HistoryPlace, Source},
    run, signals,
    temporary::TemporaryFolder,
    testbed_file::{FileError, recorded},
};

/// Show a finished run in the dashboard
///
/// Serves the run as it was at its end, with its whole history, until Ctrl-C. Nothing can be changed. `cotorra replay` plays
/// a run instead.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra view
  cotorra view --open
  cotorra view runs/corridor-20260101-120000
  cotorra view latest --compare runs/corridor-20260101-120000     two runs on one time axis")]
pub struct ViewArgs {
    /// The folder of a run, `latest`, or the number of a run in the history that --history names
    #[arg(default_value = "latest")]
    pub run: String,
    /// Draw the figures of another run beside those of RUN, on one time axis; named as RUN
    #[arg(long, value_name = "RUN")]
    pub compare: Option<String>,
    /// Open the dashboard in the browser (by xdg-open)
    #[arg(long)]
    pub open: bool,
    /// Address of the HTTP API and the dashboard, as with `cotorra run`
    #[arg(long, value_name = "ADDR:PORT", value_parser = parse_address)]
    pub api: Option<SocketAddr>,
    #[command(flatten)]
    pub access: AccessArgs,
    /// Folder that relative paths in the testbed file start from, such as that of its map; default: the run's folder, or
    /// testbeds if RUN is a number
    #[arg(long, value_name = "DIR")]
    pub base: Option<PathBuf>,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Serves a run until Ctrl-C.
pub fn view(args: &ViewArgs) -> miette::Result<ExitCode> {
    let opener = Opener::prepare(args.open)?;
    let mut source = Source::find(&args.run, &args.place)?;
    let interrupts = signals::listen()?;
    let mut compared = None;
    if let Some(other) = &args.compare {
        let (other, folder) = (Source::find(other, &args.place)?, TemporaryFolder::new().into_diagnostic()?);
        note!("Reading both runs");
        let go_on = || interrupts.try_recv().is_err();
        let (history, run, other) = joined(&source, &other, folder.path(), go_on)?;
        (source.history, source.run) = (history, run);
        compared = Some((folder, other));
    }
    let base = source.base(args.base.as_deref());
    let testbed = recorded(&source.run.info.testbed, &args.run, &base, None).map_err(FileError::from)?;
    let end = end(&source.history, &source.run).map_err(ReplayError::from).into_diagnostic()?;
    let options = ReplayOptions {
        api: args.api,
        known: Some((Runs::of_user(), format!("view of {}", args.run))),
        tokens: run::tokens(&args.access)?,
        encryption: args.access.encryption(None),
        folder: source.folder.clone(),
        speed: None,
        followers: 0,
        from: Timestamp::from_nanos(end.as_nanos().saturating_add(1)),
        to: None,
        foxglove: None,
        to_plugins: false,
    };
    let replay = Replay::new(testbed, source.history, source.run.id, options).into_diagnostic()?;
    let query = compared.as_ref().map(|(_, run)| format!("?compare={run}")).unwrap_or_default();
    note!("Dashboard on http://{}/{query}, view of {}; Ctrl-C ends it", replay.api_address(), args.run);
    note_network(replay.dashboard());
    opener.open(|| replay.dashboard().page(&query));
    replay.play(|_| interrupts.try_recv().is_err()).into_diagnostic()?;
    Ok(ExitCode::SUCCESS)
}

/// Copies two runs into one history in a folder. Returns it, with the first run and the other's number.
fn joined(
    one: &Source,
    other: &Source,
    folder: &Path,
    go_on: impl Fn() -> bool,
) -> miette::Result<(History, Run, RunId)> {
    let history = History::open(folder.join("history.sqlite")).into_diagnostic()?;
    let copy = |name, source: &Source| {
        let tables = folder.join(name);
        source.history.export(source.run.id, Format::Csv, &tables, |_| go_on()).into_diagnostic()?;
        history.import(&tables, |_| go_on()).map(|(run, _)| run).into_diagnostic()
    };
    let (first, other) = (copy("one", one)?, copy("other", other)?);
    let run = history.run(first).into_diagnostic()?;
    Ok((history, run, other))
}

/// Returns the end of a run; that of its last sample if it was killed.
fn end(history: &History, run: &Run) -> Result<Timestamp, cotorra_measurements::Error> {
    if let Some(ended) = run.ended {
        return Ok(ended);
    }
    let state = history.state_at(run.id, Timestamp::MAX)?;
    let links = state.links.iter().map(|sample| sample.at);
    let robots = state.robots.iter().map(|sample| sample.at);
    Ok(links.chain(robots).max().unwrap_or(Timestamp::ZERO))
}
