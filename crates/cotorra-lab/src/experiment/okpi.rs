//! `cotorra-lab experiment okpi`: OKpi and the state of the art on the published walk.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use cotorra::{
    AccessArgs, Loaded, Stage, Status, count, demand_approval, history_location, note, overview, print,
    tokens,
};
use cotorra_comparisons::okpi::{
    CONTENDERS, Comparison, Contender, FILES, FittedWalk, Measured, MeasuredError, Unfit, WalkFit, Walks,
    check, fit,
};
use cotorra_measurements::Location;
use cotorra_plugin::runs::Runs;
use cotorra_testbed::{Finished, FolderError, Made, Manifest, Options, Place, Repeat, Time};
use cotorra_testbed_file::Setting;

use super::{
    args::{MeasuredFile, OkpiArgs},
    folder::{begin, sound, withdraw},
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
        let loaded = cotorra::load(&args.testbed, &settings(args, contender))?;
        check(&loaded.testbed).map_err(|unfit| Error::Unfit { file: args.testbed.clone(), unfit })?;
        variants.push((contender, loaded));
    }
    let measured = args.measured.as_ref().map(|MeasuredFile { contender, path }| {
        Measured::read(path, *contender).map_err(|reason| Error::Measured { file: path.clone(), reason })
    });
    let measured = measured.transpose()?;
    let history = history_location(args.history.as_ref())?;
    let how = if args.emulate { "emulated with real packets" } else { "in virtual time" };
    if args.walks.dry_run {
        print(&plan(args, how, &variants[0].1))?;
        return Ok(ExitCode::SUCCESS);
    }
    for (_, loaded) in &variants {
        demand_approval(loaded, &args.testbed, args.walks.trust)?;
    }
    // Before the stage is set, because the user namespace that it may enter has another user.
    let known = Runs::of_user();
    let stage = Stage::set(args.walks.headless, args.walks.verbose, args.emulate)?;
    let folder = Place::In(args.walks.out.clone()).create("experiment-okpi").map_err(Error::from)?;
    let made = Made {
        inexact: None,
        time: if args.emulate { Time::Real } else { Time::Virtual },
        seeds: vec![args.seed.unwrap_or(variants[0].1.testbed.seed)],
        until: args.until,
    };
    begin(&folder, &args.testbed, &args.walks, &made, |inputs| {
        let Some(MeasuredFile { contender, path }) = &args.measured else {
            return Ok(Repeat::Words(Vec::new()));
        };
        let beside = contender.map(|contender| format!("{}=", contender.name)).unwrap_or_default();
        let carried = inputs.add(&folder, path, "measured.csv")?;
        Ok(Repeat::Words(vec![format!("--measured={beside}{}", carried.display())]))
    })?;
    let conduct = Conduct { args, stage: &stage, folder: &folder, known: &known, history: history.as_ref() };
    let mut walks = Vec::new();
    for (contender, loaded) in &variants {
        walks.push(conduct.walk(loaded, *contender, contender.name, contender.plugin)?);
    }
    let [soa, okpi] = &walks[..] else { unreachable!("there are two contenders") };
    let walked = Walks {
        testbed: &variants[0].1.testbed,
        soa: &soa.report,
        okpi: &okpi.report,
        measured: measured.as_ref(),
        fitted: &[],
        seed: soa.summary.seed,
    };
    let mut fits = Vec::new();
    for (contender, before) in CONTENDERS.into_iter().zip(&walks) {
        if let Some(fit) = fit(&walked, &contender) {
            let walk = conduct.walk_fitted(contender, &fit)?;
            fits.push((contender, fit, before, walk));
        }
    }
    let fitted: Vec<_> = fits
        .iter()
        .map(|(contender, fit, before, walk)| {
            let report = &walk.as_ref().unwrap_or(before).report;
            FittedWalk { contender: *contender, fit, report }
        })
        .collect();
    let walked = Walks { fitted: &fitted, ..walked };
    let how = format!("{how}, seed {}", soa.summary.seed);
    let comparison = Comparison::of(&walked).with_spent([&soa.summary, &okpi.summary]);
    comparison.write(&folder, &how, &walked).map_err(Error::from)?;
    Manifest::complete(&folder).map_err(Error::from)?;
    for format in args.walks.figure.further() {
        let written = comparison.write_figure(&folder, &walked, format);
        written.map_err(Error::from)?;
    }
    let further = args.walks.figure.files("comparison");
    let files = format!("{}/\n  {}{further}", folder.display(), FILES.join("  "));
    let on_fitted = fits.iter().filter_map(|(contender, .., walk)| Some((contender, walk.as_ref()?)));
    let on_fitted = on_fitted.map(|(contender, walk)| Done {
        name: format!("{}, fitted", contender.name),
        folder: fitted_folder(contender),
        walk,
    });
    let compared = CONTENDERS.iter().zip(&walks).map(|(contender, walk)| Done {
        name: contender.name.to_owned(),
        folder: contender.plugin.to_owned(),
        walk,
    });
    let done: Vec<_> = compared.chain(on_fitted).collect();
    print(&describe(&comparison, &how, &done, &files, history.as_ref()))?;
    let worst = done.iter().map(|done| Status::of_run(done.walk)).max();
    Ok(worst.unwrap_or(Status::Done).into())
}

/// The common part of all walks.
struct Conduct<'a> {
    args: &'a OkpiArgs,
    stage: &'a Stage,
    folder: &'a Path,
    known: &'a Runs,
    history: Option<&'a Location>,
}

/// A walk that is done.
struct Done<'a> {
    name: String,
    /// Its folder in that of the experiment.
    folder: String,
    walk: &'a Finished,
}

impl Conduct<'_> {
    /// Walks a testbed. `name` is shown meanwhile.
    fn walk(
        &self,
        loaded: &Loaded,
        contender: Contender,
        name: &str,
        folder: &str,
    ) -> miette::Result<Finished> {
        let Self { args, stage, .. } = self;
        let options = Options {
            seed: args.seed,
            until: args.until,
            folder: Place::At(self.folder.join(folder)),
            runs: Some(self.known.clone()),
            tokens: tokens(&AccessArgs::default())?,
            save_power: args.power.save_power,
            history: self.history.cloned(),
            ..Options::default()
        };
        let finished = if args.emulate {
            note!("{name}");
            stage.emulate(loaded, &args.testbed, options)
        } else {
            stage.simulate(loaded, options, &format!("{name}: "))
        };
        let finished = finished.inspect_err(|_| withdraw(self.folder))?;
        if finished.was_stopped() {
            let folder = finished.folder.display().to_string();
            return Err(Error::Stopped { contender: contender.name, folder }.into());
        }
        Ok(sound(finished)?)
    }

    /// Walks the testbed with fitted values; `None` if nothing was fitted, so that the walk would be the same.
    fn walk_fitted(&self, contender: Contender, fit: &WalkFit) -> miette::Result<Option<Finished>> {
        if fit.settings.is_empty() {
            return Ok(None);
        }
        let fitted = fit.settings.iter().map(|its| Setting::new(&its.path, &its.value));
        let fitted = fitted.collect::<Result<Vec<_>, _>>().expect("fitted values are settings");
        let settings: Vec<_> = settings(self.args, contender).into_iter().chain(fitted).collect();
        let loaded = cotorra::load(&self.args.testbed, &settings)?;
        let name = format!("{}, fitted", contender.name);
        self.walk(&loaded, contender, &name, &fitted_folder(&contender)).map(Some)
    }
}

/// Returns the settings of the command line, and the contender's plug-in.
fn settings(args: &OkpiArgs, contender: Contender) -> Vec<Setting> {
    let plugin = Setting::new("plugin", contender.plugin).expect("plug-ins have names");
    args.walks.settings.iter().cloned().chain([plugin]).collect()
}

/// Returns the folder of the walk on the testbed that was fitted to a contender's walk.
fn fitted_folder(contender: &Contender) -> String {
    format!("{}-fitted", contender.plugin)
}

fn plan(args: &OkpiArgs, how: &str, loaded: &Loaded) -> String {
    let mut text = format!("{}: {}\n\n", args.testbed.display(), overview(&loaded.testbed));
    for contender in CONTENDERS {
        text += &format!("  a walk with {} (plug-in `{}`), {how}\n", contender.name, contender.plugin);
    }
    if args.measured.is_some() {
        text += "  a walk again on each testbed that is fitted to the measured walk\n";
    }
    let folder = args.walks.out.join("experiment-okpi-<time>");
    text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  "))
}

fn describe(
    comparison: &Comparison,
    how: &str,
    walks: &[Done<'_>],
    files: &str,
    elsewhere: Option<&Location>,
) -> String {
    let mut text = comparison.to_markdown(how) + "\n";
    for Done { name, walk: Finished { summary, .. }, .. } in walks {
        let samples = count(summary.samples, "sample");
        text += &match &summary.void.reasons().collect::<Vec<_>>()[..] {
            [] => format!("{name}: {samples}, {}: {}\n", summary.fidelity.word(), summary.fidelity.reason),
            void => format!("{name}: {samples}, NOT VALID: {}\n", void.join("; ")),
        };
        text += &summary
            .no_progress
            .iter()
            .map(|stand| format!("{name}: {}: {stand}\n", summary.ended))
            .collect::<String>();
    }
    let folders: Vec<_> = walks.iter().map(|done| format!("{}/", done.folder)).collect();
    text += &format!("\n{files}  {}\n", folders.join("  "));
    if let Some(history) = elsewhere {
        let runs: Vec<_> = walks.iter().map(|done| done.walk.run.to_string()).collect();
        text += &format!("Their histories are runs {} in {history}\n", runs.join(" and "));
    }
    text
}
