//! `cotorra view`: serves a finished run to the dashboard.

use std::{net::SocketAddr, path::PathBuf, process::ExitCode};

use clap::Args;
use cotorra_graph::Timestamp;
use cotorra_measurements::{History, Run};
use cotorra_plugin::runs::Runs;
use cotorra_testbed::replay::{Replay, ReplayError, ReplayOptions, Speed};
use miette::IntoDiagnostic;

use crate::{
    arguments::parse_address,
    browser::Opener,
    history::{HistoryPlace, Source},
    run, signals,
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
  cotorra view runs/corridor-20260101-120000")]
pub struct ViewArgs {
    /// The folder of a run, `latest`, or the number of a run in the history that --history names
    #[arg(default_value = "latest")]
    pub run: String,
    /// Open the dashboard in the browser (by xdg-open)
    #[arg(long)]
    pub open: bool,
    /// Address of the HTTP API and the dashboard, as with `cotorra run`
    #[arg(long, value_name = "ADDR:PORT", value_parser = parse_address)]
    pub api: Option<SocketAddr>,
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
    let source = Source::find(&args.run, &args.place)?;
    let base = source.base(args.base.as_deref());
    let testbed = recorded(&source.run.info.testbed, &args.run, &base, None).map_err(FileError::from)?;
    let end = end(&source.history, &source.run).map_err(ReplayError::from).into_diagnostic()?;
    let options = ReplayOptions {
        api: args.api,
        known: Some((Runs::of_user(), format!("view of {}", args.run))),
        tokens: run::tokens()?,
        folder: source.folder.clone(),
        speed: Speed::Times(1.0),
        from: Timestamp::from_nanos(end.as_nanos().saturating_add(1)),
        to: None,
        foxglove: None,
        to_plugins: false,
    };
    let interrupts = signals::listen()?;
    let replay = Replay::new(testbed, source.history, source.run.id, options).into_diagnostic()?;
    let address = format!("http://{}/", replay.api_address());
    note!("Dashboard on {address}, view of {}; Ctrl-C ends it", args.run);
    opener.open(&address);
    replay.hold(|_| interrupts.try_recv().is_err());
    Ok(ExitCode::SUCCESS)
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
