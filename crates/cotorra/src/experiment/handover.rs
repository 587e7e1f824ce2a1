//! `cotorra experiment handover`: handovers on the model of the radio, and on real Wi-Fi software.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use cotorra_datapath::{CapabilityState, simulated_radios};
use cotorra_experiments::handover::{
    Comparison, FILES, HWSIM, KINDS, Kind, Unfit, Walk, Walked, check, read, settings,
};
use cotorra_measurements::History;
use cotorra_plugin::runs::Runs;
use cotorra_testbed::{Finished, FolderError, Options, Place, Recorded, RecordedError, wifi_programs};
use cotorra_testbed_file::Setting;

use super::{args::HandoverArgs, folder::withdraw};
use crate::{
    output,
    run::{self, Stage},
    testbed_file::{self, Loaded},
    words::count,
};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Recorded(#[from] RecordedError),
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    #[error("{file}: {unfit}", file = file.display())]
    Unfit { file: PathBuf, unfit: Unfit },
    #[error("stopped during the first walk, which is in {folder}")]
    Stopped { folder: String },
    #[error("there is nothing to walk: --kind names no kind of radio")]
    Nothing,
}

/// A walk of the experiment.
struct Planned {
    kind: Kind,
    walk: Walk,
    seed: u64,
    loaded: Loaded,
}

impl Planned {
    /// Returns its name, also that of its folder.
    fn name(&self) -> String {
        format!("{}-{}-{}", self.kind.name, self.walk.name(), self.seed)
    }
}

/// Walks on all kinds of radio, and compares their handovers.
pub fn handover(args: &HandoverArgs) -> miette::Result<ExitCode> {
    let earlier = args.with.iter().map(|folder| read(folder)).collect::<Result<Vec<_>, _>>();
    let mut earlier: Vec<Walked> = earlier.map_err(Error::from)?.into_iter().flatten().collect();
    let (kinds, missing) = kinds(args);
    let planned = plan(args, &kinds)?;
    let Some(first) = planned.first() else { return Err(Error::Nothing.into()) };
    if args.walks.dry_run {
        output::print(&describe_plan(args, &planned, missing.as_deref()))?;
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(missing) = &missing {
        note!("{missing}");
    }
    // Before the stage is set, because the user namespace that it may enter has another user.
    let known = Runs::of_user();
    let is_real = kinds.iter().any(|kind| kind.is_real);
    let stage = Stage::set(args.walks.headless, args.walks.verbose, is_real)?;
    let folder = Place::In(args.walks.out.clone()).create("experiment-handover").map_err(Error::from)?;
    earlier.retain(|walked| kinds.iter().all(|kind| kind.name != walked.kind));
    let (mut walks, mut invalid) = (earlier, None);
    let mut done = 0;
    for plan in &planned {
        let finished = walk(args, &stage, &folder, &known, plan).inspect_err(|_| withdraw(&folder))?;
        if finished.was_stopped() {
            if done == 0 {
                return Err(Error::Stopped { folder: finished.folder.display().to_string() }.into());
            }
            break;
        }
        walks.push(measure(plan, &finished)?);
        done += 1;
        // So that a walk that is done is not lost with a later one.
        Comparison::of(walks.clone(), first.seed).write(&folder).map_err(Error::from)?;
        if !finished.summary.fidelity.valid {
            invalid = Some(finished.summary);
        }
    }
    let comparison = Comparison::of(walks, first.seed);
    comparison.write(&folder).map_err(Error::from)?;
    for format in args.walks.figure.further() {
        comparison.write_figure(&folder, format).map_err(Error::from)?;
    }
    let files = FILES.join("  ") + &args.walks.figure.files("handover");
    let mut text = comparison.to_markdown();
    text += &format!("\n{}/\n  {files}  {}\n", folder.display(), count(done, "run"));
    text += &missing.map(|missing| format!("{missing}\n")).unwrap_or_default();
    if done < planned.len() {
        text += &format!("STOPPED after {done} of {}\n", count(planned.len(), "walk"));
    }
    output::print(&text)?;
    Ok(invalid.map_or(ExitCode::SUCCESS, |summary| run::verdict(&summary)))
}

/// Returns the kinds of radio to walk on, and what is said about one that this machine lacks.
fn kinds(args: &HandoverArgs) -> (Vec<Kind>, Option<String>) {
    if !args.kinds.is_empty() {
        return (KINDS.into_iter().filter(|kind| args.kinds.contains(kind)).collect(), None);
    }
    let needed = wifi_programs().into_iter().chain([simulated_radios()]);
    let lacking = needed.into_iter().find_map(|capability| match capability.state {
        CapabilityState::Available(_) => None,
        CapabilityState::Missing { reason, .. } => Some(format!("{}: {reason}", capability.name)),
    });
    match lacking {
        None => (KINDS.to_vec(), None),
        Some(lacking) => {
            let rest = KINDS.into_iter().filter(|kind| *kind != HWSIM).collect();
            let missing = format!(
                "Real Wi-Fi software (hwsim) is left out: {lacking}. It needs hostapd, wpa_supplicant, and a kernel with \
                 simulated radios, which scripts/radio-kernel builds: scripts/uml --radios 0 cotorra experiment handover \
                 --save-power"
            );
            (rest, Some(missing))
        }
    }
}

fn plan(args: &HandoverArgs, kinds: &[Kind]) -> miette::Result<Vec<Planned>> {
    let plain = testbed_file::load(&args.testbed, &args.walks.settings)?;
    check(&plain.testbed).map_err(|unfit| Error::Unfit { file: args.testbed.clone(), unfit })?;
    let mut planned = Vec::new();
    for &kind in kinds {
        for number in 0..args.runs {
            for walk in Walk::ALL {
                let own = settings(&plain.testbed, kind, walk).into_iter().map(|(path, value)| {
                    Setting::new(&path, &value).expect("paths and values of the experiment are settings")
                });
                // The user's settings come last, so that they take precedence.
                let settings: Vec<_> = own.chain(args.walks.settings.iter().cloned()).collect();
                let loaded = testbed_file::load(&args.testbed, &settings)?;
                let seed = args.seed.unwrap_or(plain.testbed.seed) + u64::from(number);
                planned.push(Planned { kind, walk, seed, loaded });
            }
        }
    }
    Ok(planned)
}

fn walk(
    args: &HandoverArgs,
    stage: &Stage,
    folder: &Path,
    known: &Runs,
    plan: &Planned,
) -> miette::Result<Finished> {
    let name = plan.name();
    let options = Options {
        seed: Some(plan.seed),
        until: args.until,
        folder: Place::At(folder.join(&name)),
        runs: Some(known.clone()),
        tokens: run::tokens()?,
        save_power: args.save_power,
        ..Options::default()
    };
    if plan.kind.is_real {
        note!("{name}");
        stage.emulate(&plan.loaded, &args.testbed, options)
    } else {
        stage.simulate(&plan.loaded, &options, &format!("{name}: "))
    }
}

fn measure(plan: &Planned, finished: &Finished) -> Result<Walked, Error> {
    let recorded = Recorded::of_folder(&finished.folder)?;
    let history = History::open(&recorded.history)?;
    let of_run = (plan.seed, finished.summary.fidelity.valid);
    Ok(Walked::read(&history, finished.run, &plan.loaded.testbed, (plan.kind, plan.walk), of_run)?)
}

fn describe_plan(args: &HandoverArgs, planned: &[Planned], missing: Option<&str>) -> String {
    let overview = planned.first().map(|plan| testbed_file::overview(&plan.loaded.testbed));
    let mut text = format!("{}: {}\n\n", args.testbed.display(), overview.unwrap_or_default());
    for plan in planned {
        let how = if plan.kind.is_real { "with real packets" } else { "in virtual time" };
        text += &format!("  {}: {}, {how}\n", plan.name(), plan.kind.software);
    }
    text += &missing.map(|missing| format!("\n{missing}\n")).unwrap_or_default();
    let folder = args.walks.out.join("experiment-handover-<time>");
    text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  "))
}
