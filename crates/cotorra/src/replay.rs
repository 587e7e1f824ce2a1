//! `cotorra replay`: plays a recorded run through the API, and prints the instructions of plug-ins.

use std::{net::SocketAddr, num::NonZero, path::PathBuf, process::ExitCode, time::Duration};

use clap::Args;
use cotorra_graph::{PluginId, Timestamp};
use cotorra_plugin::runs::Runs;
use cotorra_testbed::{
    Manifest, Speed,
    replay::{Played, Replay, ReplayEnd, ReplayOptions},
};
use indicatif::ProgressBar;
use miette::IntoDiagnostic;

use crate::{
    arguments::{AccessArgs, note_network, parse_address},
    browser::Opener,
    exit::Status,
    history::{HistoryPlace, Source, Span},
    output,
    run::{self, FOXGLOVE},
    signals,
    speed::parse_speed,
    testbed_file::{FileError, recorded},
    words::count,
};

/// Play a recorded run through the HTTP API, so that a plug-in can be developed against it
///
/// The API answers as it did at each moment of the run: state, history and events, and nothing of the future. Instructions
/// are refused, because the past cannot be changed. Each is printed as a line of JSON: a decision that the plug-in would
/// have made. A plug-in that floods or hangs is cut off as in a run, which is printed, too.
///
/// With --speed max, the replay begins when a plug-in follows the stream of events under a name (X-Cotorra-Plugin). It
/// waits for the plug-in as virtual time does, so that the plug-in receives exactly the same events each time.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra replay latest
  cotorra replay latest --speed 10x --from 1min --to 2min
  cotorra replay latest --foxglove
  cotorra replay latest --speed max --bundled okpi > decisions.jsonl
  cotorra replay latest --speed max > decisions.jsonl &
  COTORRA_API=http://127.0.0.1:7700 COTORRA_PLUGIN=mine python3 examples/strongest_signal.py

Exit status: 0 all was played, 1 error, 2 wrong usage, 3 a plug-in was cut off or all left before the end, 130 stopped with
Ctrl-C.")]
pub struct ReplayArgs {
    /// The folder of a run, `latest`, or the number of a run in the history that --history names
    pub run: String,
    /// Speed, as in 1x or 2.5x; or max
    #[arg(long, value_name = "SPEED", default_value = "1x", value_parser = parse_speed)]
    pub speed: Speed,
    /// With --speed max: begin when this many plug-ins follow the stream of events, each under its name; default: 1, and 0
    /// with --bundled
    #[arg(long, value_name = "N")]
    pub plugins: Option<NonZero<usize>>,
    /// Play to this bundled plug-in, too, with its settings in the testbed file if it has any
    #[arg(long, value_name = "PLUGIN")]
    pub bundled: Option<PluginId>,
    #[command(flatten)]
    pub span: Span,
    /// Open the dashboard in the browser (by xdg-open)
    #[arg(long)]
    pub open: bool,
    /// Address of the HTTP API and the dashboard, as with `cotorra run`
    #[arg(long, value_name = "ADDR:PORT", value_parser = parse_address)]
    pub api: Option<SocketAddr>,
    #[command(flatten)]
    pub access: AccessArgs,
    /// Serve the replay to Foxglove, too, as with `cotorra run`
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, default_missing_value = FOXGLOVE, value_parser = parse_address)]
    pub foxglove: Option<SocketAddr>,
    /// Folder that relative paths in the testbed file start from, such as that of its map; default: the run's folder, or
    /// testbeds if RUN is a number
    #[arg(long, value_name = "DIR")]
    pub base: Option<PathBuf>,
    #[command(flatten)]
    pub place: HistoryPlace,
}

/// Plays a run to its end.
pub fn replay(args: &ReplayArgs) -> miette::Result<ExitCode> {
    let opener = Opener::prepare(args.open)?;
    let source = Source::find(&args.run, &args.place)?;
    if let Some(folder) = &source.folder
        && let Ok(manifest) = Manifest::read(folder)
    {
        for name in manifest.changed_inputs(folder) {
            note!("warning: {} was changed after the run, or removed", folder.join(name).display());
        }
    }
    let bundled = args.bundled.as_ref().map(|plugin| format!("plugin={plugin}"));
    let setting = bundled.map(|setting| setting.parse().expect("a plug-in's name is a value"));
    let base = source.base(args.base.as_deref());
    let testbed = recorded(&source.run.info.testbed, &args.run, &base, setting);
    let testbed = testbed.map_err(FileError::from)?;
    let after_start = |after: Duration| Timestamp::ZERO + after;
    let options = ReplayOptions {
        api: args.api,
        known: Some((Runs::of_user(), format!("replay of {}", args.run))),
        tokens: run::tokens(&args.access)?,
        encryption: args.access.encryption(None),
        folder: source.folder.clone(),
        speed: Some(args.speed),
        followers: match args.speed {
            Speed::Times(_) => 0,
            Speed::Max => args.plugins.map_or(usize::from(args.bundled.is_none()), NonZero::get),
        },
        from: args.span.from.map_or(Timestamp::ZERO, after_start),
        to: args.span.to.map(after_start),
        foxglove: args.foxglove,
        to_plugins: args.bundled.is_some(),
    };
    let interrupts = signals::listen()?;
    let replay = Replay::new(testbed, source.history, source.run.id, options).into_diagnostic()?;
    note!("API on http://{}, replay of {}", replay.api_address(), args.run);
    note!("Dashboard on http://{}/", replay.api_address());
    note_network(replay.dashboard());
    opener.open(|| replay.dashboard().page(""));
    if let Some(foxglove) = replay.foxglove_address() {
        note!("Foxglove on ws://{foxglove}");
    }
    let bar = ProgressBar::new_spinner();
    let (mut printed, mut cut_off) = (Ok(()), 0);
    let end = replay.play(|played| {
        match played {
            Played::Time(now) => {
                bar.set_message(format!("{:.1} s", now.as_secs_f64()));
                bar.tick();
            }
            Played::Refused(event) | Played::CutOff(event) => {
                cut_off += usize::from(matches!(played, Played::CutOff(_)));
                let json = serde_json::to_string(event).expect("an event holds only what JSON can");
                printed = bar.suspend(|| output::print_exact(&(json + "\n")));
            }
        }
        printed.is_ok() && interrupts.try_recv().is_err()
    });
    bar.finish_and_clear();
    let end = end.into_diagnostic()?;
    printed?;
    let (reason, status) = match end {
        ReplayEnd::Played => ("all was played", Status::Done),
        ReplayEnd::Alone => ("no plug-in follows any more, so the rest was not played", Status::NotValid),
        ReplayEnd::Stopped => ("it was stopped", Status::Interrupted),
    };
    note!("the replay is over: {reason}");
    if cut_off > 0 {
        note!("{} cut off: the decisions are not all that it would have made", count(cut_off, "plug-in"));
        return Ok(status.max(Status::NotValid).into());
    }
    Ok(status.into())
}
