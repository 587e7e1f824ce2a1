//! `cotorra history prune`: rolls old samples up, or reports what that would do.

use cotorra_graph::{Retention, Timestamp};
use cotorra_measurements::{History, Kind, Pruned, Run};
use indicatif::ProgressBar;

use super::args::PruneArgs;
use super::{
    place::location,
    source::{Error, Source, open},
};
use crate::{output, signals, table::Table};

/// Name of all runs of a history.
const ALL: &str = "all";

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum PruneError {
    #[error("the testbed file of run {0} has no retention of samples")]
    #[diagnostic(help("set it here, as in --raw 1h"))]
    NoRetention(String),
    #[error("`all` needs a history")]
    #[diagnostic(help("name one with --history, as in --history runs/all.sqlite"))]
    Nowhere,
}

/// Prunes runs, or reports what it would do.
pub fn prune(args: &PruneArgs) -> miette::Result<()> {
    let (history, runs) = if args.run == ALL {
        let place = location(args.place.history.as_ref()).map_err(Error::from)?.ok_or(PruneError::Nowhere)?;
        let history = open(&place)?;
        let runs = every_run(&history).map_err(Error::from)?;
        (history, runs)
    } else {
        let Source { history, run, .. } = Source::find(&args.run, &args.place)?;
        (history, vec![run])
    };
    let interrupts = signals::listen()?;
    let bar = ProgressBar::new_spinner();
    let mut table = Table::new("><>>>");
    table.row(["run", "kind", "samples", "become points", "dropped"]);
    let (mut stopped, mut total) = (false, 0);
    for run in &runs {
        let kept = retentions(run, args);
        if kept.is_empty() && runs.len() == 1 {
            return Err(PruneError::NoRetention(run.id.to_string()).into());
        }
        for (kind, retention) in kept {
            let go_on = || {
                bar.set_message(format!("run {}, {}", run.id, kind.as_str()));
                bar.tick();
                stopped |= interrupts.try_recv().is_ok();
                !stopped
            };
            let pruned = history.retain(run.id, kind, &retention, present(run), !args.yes, go_on);
            let Pruned { rolled_up, points, dropped } = pruned.map_err(Error::from)?;
            total += rolled_up + dropped;
            let figures = [rolled_up, points, dropped].map(|n| n.to_string());
            let [samples, points, dropped] = figures;
            table.row([run.id.to_string(), kind.as_str().to_owned(), samples, points, dropped]);
        }
    }
    bar.finish_and_clear();
    let end = match (total, args.yes, stopped) {
        (0, ..) => "no samples are that old\n",
        (_, _, true) => "stopped; the same command resumes from here\n",
        (_, false, _) => "nothing was changed; --yes does this\n",
        (_, true, _) => "done\n",
    };
    output::print(&(table.render("") + end))
}

fn every_run(history: &History) -> cotorra_measurements::Result<Vec<Run>> {
    let mut all: Vec<Run> = Vec::new();
    loop {
        let page = history.runs(all.last().map(|run| run.id), 1000)?;
        if page.is_empty() {
            return Ok(all);
        }
        all.extend(page);
    }
}

/// Returns the retention of each kind: that of the arguments, or else of the run's testbed file.
fn retentions(run: &Run, args: &PruneArgs) -> Vec<(Kind, Retention)> {
    let of: [(Kind, Option<Retention>); 5] = match args.raw {
        Some(raw) => {
            let typed = Retention { raw, step: args.step, keep: args.keep };
            Kind::SAMPLED.map(|kind| (kind, Some(typed)))
        }
        None => {
            let kept = cotorra_testbed_file::retentions(&run.info.testbed).unwrap_or_default();
            [
                (Kind::Robot, kept.robots),
                (Kind::Radio, kept.radio_units),
                (Kind::Link, kept.links),
                (Kind::Sensor, kept.sensors),
                (Kind::Machine, kept.machines),
            ]
        }
    };
    let chosen = |kind: Kind| args.kinds.is_empty() || args.kinds.iter().any(|name| name == kind.as_str());
    of.into_iter().filter(|(kind, _)| chosen(*kind)).filter_map(|(kind, kept)| Some((kind, kept?))).collect()
}

/// Returns the present in time of the run, or the end of a run in virtual time.
#[allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the age of a run needs the calendar")]
fn present(run: &Run) -> Timestamp {
    match (run.info.started_at_unix_ns, run.ended) {
        (0, ended) => ended.unwrap_or(Timestamp::ZERO),
        (began, _) => {
            let since_1970 = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default().as_nanos();
            let since = i128::try_from(since_1970).unwrap_or(i128::MAX) - i128::from(began);
            Timestamp::from_nanos(u64::try_from(since).unwrap_or(0))
        }
    }
}
