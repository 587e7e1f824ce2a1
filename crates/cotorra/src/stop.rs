//! `cotorra stop`: ends a run in order.

use std::io;

use clap::Args;
use cotorra_datapath::Listening;
use cotorra_plugin::runs::{RunEntry, Runs};

use crate::{
    output,
    running::{self, WhichRun},
};

/// End a run or replay in order, as Ctrl-C does, and wait for its end
///
/// Nothing is lost: the run writes its report. If another command stops the same run again before that, the run ends at
/// once.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra stop
  cotorra stop --run corridor                    by the name of its testbed
  cotorra stop --run runs/corridor-20260101-120000
  cotorra stop --run http://127.0.0.1:7701")]
pub struct StopArgs {
    #[command(flatten)]
    pub run: WhichRun,
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] running::Error),
    #[error("cannot stop {run}: {reason}")]
    #[diagnostic(help("it may have ended just now: `cotorra ps` lists your runs"))]
    Signal { run: RunEntry, reason: io::Error },
}

/// Ends a run, and waits for its end.
pub fn stop(args: &StopArgs) -> miette::Result<()> {
    let run = args.run.entry(&Runs::of_user()).map_err(Error::from)?;
    let failed = |reason| Error::Signal { run: run.clone(), reason };
    let process = Listening::on(|| run.connect()).map_err(failed)?;
    process.interrupt().map_err(failed)?;
    note!("stopping {run}");
    process.wait().map_err(failed)?;
    output::print(&format!("stopped {run}\n"))
}
