//! `cotorra experiment okpi`: OKpi and the state of the art on the published walk.

use std::{path::PathBuf, process::ExitCode};

use cotorra_experiments::okpi::{
    CONTENDERS, Comparison, FILES, Measured, MeasuredError, Unfit, Walks, check,
};
use cotorra_measurements::Location;
use cotorra_plugin::runs::Runs;
use cotorra_testbed::{Finished, FolderError, Options, Place};
use cotorra_testbed_file::Setting;

use super::{
    args::{MeasuredFile, OkpiArgs},
    folder::withdraw,
};
use crate::{
    history, output,
    run::{self, Stage},
    testbed_file::{self, Loaded},
    words::count,
};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error("{file}: {unfit}", file = file.display())]
    Unfit { file: PathBuf, unfit: Unfit },
    #[error("{file}: {reason}", file = file.display())]
    Measured { file: PathBuf, reason: MeasuredError },
    #[error("stopped during the walk of {contender}, which is in {folder}")]
    #[diagnostic(help("a comparison needs both walks: run the experiment again"))]
    Stopped { contender: &'static str, folder: String },
}

/// Runs the walk with OKpi and with the state of the art, and compares them.
pub fn okpi(args: &OkpiArgs) -> miette::Result<ExitCode> {
    let mut variants = Vec::new();
    for contender in CONTENDERS {
        let plugin = Setting::new("plugin", contender.plugin).expect("plug-ins have names");
        let settings: Vec<_> = args.walks.settings.iter().cloned().chain([plugin]).collect();
        let loaded = testbed_file::load(&args.testbed, &settings)?;
        check(&loaded.testbed).map_err(|unfit| Error::Unfit { file: args.testbed.clone(), unfit })?;
        variants.push((contender, loaded));
    }
    let measured = args.measured.as_ref().map(|MeasuredFile { contender, path }| {
        Measured::read(path, *contender).map_err(|reason| Error::Measured { file: path.clone(), reason })
    });
    let measured = measured.transpose()?;
    let history = history::location(args.history.as_ref())?;
    let how = if args.emulate { "emulated with real packets" } else { "in virtual time" };
    if args.walks.dry_run {
        output::print(&plan(args, how, &variants[0].1))?;
        return Ok(ExitCode::SUCCESS);
    }
    // Before the stage is set, because the user namespace that it may enter has another user.
    let known = Runs::of_user();
    let stage = Stage::set(args.walks.headless, args.walks.verbose, args.emulate)?;
    let folder = Place::In(args.walks.out.clone()).create("experiment-okpi").map_err(Error::from)?;
    let mut walks = Vec::new();
    for (i, (contender, loaded)) in variants.iter().enumerate() {
        let options = Options {
            seed: args.seed,
            until: args.until,
            folder: Place::At(folder.join(contender.plugin)),
            runs: Some(known.clone()),
            tokens: run::tokens()?,
            save_power: args.walks.save_power,
            history: history.clone(),
            ..Options::default()
        };
        let finished = if args.emulate {
            note!("{} of {}: {}", i + 1, variants.len(), contender.name);
            stage.emulate(loaded, &args.testbed, options)
        } else {
            stage.simulate(loaded, &options, &format!("{}: ", contender.name))
        };
        let finished = finished.inspect_err(|_| withdraw(&folder))?;
        if finished.was_stopped() {
            let folder = finished.folder.display().to_string();
            return Err(Error::Stopped { contender: contender.name, folder }.into());
        }
        walks.push(finished);
    }
    let [soa, okpi] = &walks[..] else { unreachable!("there are two contenders") };
    let walked = Walks {
        testbed: &variants[0].1.testbed,
        soa: &soa.report,
        okpi: &okpi.report,
        measured: measured.as_ref(),
        seed: soa.summary.seed,
    };
    let how = format!("{how}, seed {}", soa.summary.seed);
    let comparison = Comparison::of(&walked);
    comparison.write(&folder, &how, &walked).map_err(Error::from)?;
    for format in args.walks.figure.further() {
        let written = comparison.write_figure(&folder, &walked, format);
        written.map_err(Error::from)?;
    }
    let further = args.walks.figure.files("comparison");
    let files = format!("{}/\n  {}{further}", folder.display(), FILES.join("  "));
    output::print(&describe(&comparison, &how, &walks, &files, history.as_ref()))?;
    let invalid = walks.iter().find(|walk| !walk.summary.fidelity.valid);
    Ok(run::verdict(&invalid.unwrap_or(okpi).summary))
}

fn plan(args: &OkpiArgs, how: &str, loaded: &Loaded) -> String {
    let mut text = format!("{}: {}\n\n", args.testbed.display(), testbed_file::overview(&loaded.testbed));
    for contender in CONTENDERS {
        text += &format!("  a walk with {} (plug-in `{}`), {how}\n", contender.name, contender.plugin);
    }
    let folder = args.walks.out.join("experiment-okpi-<time>");
    text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  "))
}

fn describe(
    comparison: &Comparison,
    how: &str,
    walks: &[Finished],
    files: &str,
    elsewhere: Option<&Location>,
) -> String {
    let mut text = comparison.to_markdown(how) + "\n";
    for (contender, walk) in CONTENDERS.iter().zip(walks) {
        let Finished { summary, .. } = walk;
        let verdict = if summary.fidelity.valid { "valid" } else { "NOT VALID" };
        let samples = count(summary.samples, "sample");
        text += &format!("{}: {samples}, {verdict}: {}\n", contender.name, summary.fidelity.reason);
    }
    let [soa, okpi] = walks else { unreachable!("there are two contenders") };
    let walks: Vec<_> = CONTENDERS.iter().map(|contender| format!("{}/", contender.plugin)).collect();
    text += &format!("\n{files}  {}\n", walks.join("  "));
    if let Some(history) = elsewhere {
        text += &format!("Their histories are runs {} and {} in {history}\n", soa.run, okpi.run);
    }
    text
}
