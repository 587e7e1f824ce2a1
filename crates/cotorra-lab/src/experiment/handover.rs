//! `cotorra-lab experiment handover`: handovers on the model of the radio, on real Wi-Fi software, and on real radios.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};

use cotorra::{
    AccessArgs, FileError, Loaded, Stage, Status, count, demand_approval, note, overview, print, tokens,
};
use cotorra_comparisons::{
    handover::{
        Comparison, FILES, HARDWARE, HWSIM, KINDS, Kind, MODEL, Unfit, Walk, Walked, check, read, settings,
    },
    walk_time,
};
use cotorra_datapath::{CapabilityState, simulated_radios};
use cotorra_graph::Testbed;
use cotorra_measurements::History;
use cotorra_plugin::runs::Runs;
use cotorra_testbed::{
    Finished, FolderError, Made, Manifest, Options, Place, Recorded, RecordedError, Repeat, Time,
    wifi_programs,
};
use cotorra_testbed_file::Setting;

use super::{
    args::HandoverArgs,
    folder::{begin, sound, withdraw},
    tell_faults,
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
#[derive(Debug)]
struct Planned {
    kind: Kind,
    walk: Walk,
    seed: u64,
    /// When it ends, if not with the robot's walk.
    until: Option<Duration>,
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
        print(&describe_plan(args, &planned, missing.as_deref()))?;
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(missing) = &missing {
        note!("{missing}");
    }
    for plan in &planned {
        demand_approval(&plan.loaded, &args.testbed, args.walks.trust)?;
    }
    // Before the stage is set, because the user namespace that it may enter has another user.
    let known = Runs::of_user();
    let is_real = kinds.iter().any(|kind| kind.is_real);
    let stage = Stage::set(args.walks.headless, args.walks.verbose, is_real)?;
    let folder = Place::In(args.walks.out.clone()).create("experiment-handover").map_err(Error::from)?;
    note(args, &folder, &planned, &kinds)?;
    earlier.retain(|walked| kinds.iter().all(|kind| kind.name != walked.kind));
    let (mut walks, mut worst) = (earlier, Status::Done);
    let mut done = 0;
    for plan in &planned {
        let finished = walk(args, &stage, &folder, &known, plan).inspect_err(|_| withdraw(&folder))?;
        if finished.was_stopped() {
            if done == 0 {
                return Err(Error::Stopped { folder: finished.folder.display().to_string() }.into());
            }
            break;
        }
        let finished = sound(finished)?;
        walks.push(measure(plan, &finished)?);
        done += 1;
        // So that a walk that is done is not lost with a later one.
        Comparison::of(walks.clone(), first.seed).write(&folder).map_err(Error::from)?;
        tell_faults(&plan.name(), &finished);
        worst = worst.max(Status::of_run(&finished));
    }
    let comparison = Comparison::of(walks, first.seed);
    comparison.write(&folder).map_err(Error::from)?;
    if done == planned.len() {
        Manifest::complete(&folder).map_err(Error::from)?;
    }
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
    print(&text)?;
    if done < planned.len() {
        worst = worst.max(Status::Interrupted);
    }
    Ok(worst.into())
}

/// Returns the kinds of radio to walk on, and what is said about those that this machine or the file lacks.
fn kinds(args: &HandoverArgs) -> (Vec<Kind>, Option<String>) {
    if !args.kinds.is_empty() {
        return (KINDS.into_iter().filter(|kind| args.kinds.contains(kind)).collect(), None);
    }
    let mut kinds = KINDS.to_vec();
    let needed = wifi_programs().into_iter().chain([simulated_radios()]);
    let lacking = needed.into_iter().find_map(|capability| match capability.state {
        CapabilityState::Available(_) | CapabilityState::Unknown { .. } => None,
        CapabilityState::Missing { reason, .. } => Some(format!("{}: {reason}", capability.name)),
    });
    let missing = lacking.map(|lacking| {
        kinds.retain(|kind| *kind != HWSIM);
        format!(
            "Real Wi-Fi software (hwsim) is left out: {lacking}. It needs hostapd, wpa_supplicant, and a kernel with simulated \
             radios, which scripts/radio-kernel builds: scripts/uml --radios 0 cotorra-lab experiment handover --save-power"
        )
    });
    // Most files name no agents, which is nothing to talk about.
    let has_hardware = || load(args, &load_as_model(args)?.testbed, HARDWARE, Walk::Sent);
    if has_hardware().is_err() {
        kinds.retain(|kind| *kind != HARDWARE);
    }
    (kinds, missing)
}

fn plan(args: &HandoverArgs, kinds: &[Kind]) -> miette::Result<Vec<Planned>> {
    let plain = load_as_model(args)?.testbed;
    check(&plain).map_err(|unfit| Error::Unfit { file: args.testbed.clone(), unfit })?;
    let walk_time = plain.walks.first().map(walk_time);
    let mut planned = Vec::new();
    for &kind in kinds {
        for number in 0..args.runs {
            for &walk in kind.walks() {
                let loaded = load(args, &plain, kind, walk)?;
                let seed = args.seed.unwrap_or(plain.seed) + u64::from(number);
                // A robot that nothing drives does not arrive.
                let until = args.until.or(walk_time.filter(|_| !kind.is_emulated));
                planned.push(Planned { kind, walk, seed, until, loaded });
            }
        }
    }
    Ok(planned)
}

/// Reads the file as that of the model, which every kind's is.
fn load_as_model(args: &HandoverArgs) -> Result<Loaded, FileError> {
    let model = setting("wireless.*.wifi", MODEL.name);
    cotorra::load(&args.testbed, &[vec![model], args.walks.settings.clone()].concat())
}

/// Reads the file with the settings of a walk, which depend on what [`load_as_model`] returns.
fn load(args: &HandoverArgs, plain: &Testbed, kind: Kind, walk: Walk) -> Result<Loaded, FileError> {
    let own = settings(plain, kind, walk);
    let own = own.iter().map(|(path, value)| setting(path, value));
    // The user's settings come after them, so that they take precedence.
    let mut settings: Vec<_> = own.chain(args.walks.settings.iter().cloned()).collect();
    settings.extend((!kind.is_emulated).then(|| setting("services", "{}")));
    cotorra::load(&args.testbed, &settings)
}

fn setting(path: &str, value: &str) -> Setting {
    Setting::new(path, value).expect("paths and values of the experiment are settings")
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
        until: plan.until,
        folder: Place::At(folder.join(&name)),
        runs: Some(known.clone()),
        tokens: tokens(&AccessArgs::default())?,
        save_power: args.save_power,
        agents: args.agents.options(),
        ..Options::default()
    };
    if plan.kind.is_real {
        note!("{name}");
        stage.emulate(&plan.loaded, &args.testbed, options)
    } else {
        stage.simulate(&plan.loaded, options, &format!("{name}: "))
    }
}

/// Notes in the experiment's folder how it came to be.
fn note(args: &HandoverArgs, folder: &Path, planned: &[Planned], kinds: &[Kind]) -> miette::Result<()> {
    let mut seeds: Vec<_> = planned.iter().map(|plan| plan.seed).collect();
    seeds.dedup();
    let time = if kinds.iter().any(|kind| kind.is_real) { Time::Real } else { Time::Virtual };
    begin(
        folder,
        &args.testbed,
        &args.walks,
        &Made { time, inexact: None, seeds, until: args.until },
        |inputs| {
            let mut words = Vec::new();
            if args.kinds.is_empty() {
                // By default, they are those of the machine.
                words.extend(kinds.iter().map(|kind| format!("--kind={}", kind.name)));
            }
            for (number, with) in args.with.iter().enumerate() {
                let file = FILES[2];
                let carried = inputs.add(folder, &with.join(file), &format!("with-{number}/{file}"))?;
                let with = carried.parent().unwrap_or(Path::new(""));
                words.push(format!("--with={}", with.display()));
            }
            Ok(Repeat::Words(words))
        },
    )
}

fn measure(plan: &Planned, finished: &Finished) -> Result<Walked, Error> {
    let recorded = Recorded::of_folder(&finished.folder)?;
    let history = History::open(&recorded.history)?;
    let of_run = (plan.seed, finished.summary.is_valid());
    Ok(Walked::read(&history, finished.run, &plan.loaded.testbed, (plan.kind, plan.walk), of_run)?)
}

fn describe_plan(args: &HandoverArgs, planned: &[Planned], missing: Option<&str>) -> String {
    let overview = planned.first().map(|plan| overview(&plan.loaded.testbed));
    let mut text = format!("{}: {}\n\n", args.testbed.display(), overview.unwrap_or_default());
    for plan in planned {
        let how = match plan.kind {
            Kind { is_emulated: false, .. } => "without services",
            Kind { is_real: true, .. } => "with real packets",
            Kind { .. } => "in virtual time",
        };
        text += &format!("  {}: {}, {how}\n", plan.name(), plan.kind.software);
    }
    text += &missing.map(|missing| format!("\n{missing}\n")).unwrap_or_default();
    let folder = args.walks.out.join("experiment-handover-<time>");
    text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  "))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    const TESTBED: &str = "
name: small
wireless: { lab: { access: edca } }
nodes:
  robot: { kind: robot, agent: turtle1, interface: wlan0 }
  A: { kind: radio_unit, position: [0, 1], channel: 1, agent: ap1, interface: wlan0 }
  B: { kind: radio_unit, position: [9, 1], channel: 6, agent: ap2, interface: wlan0 }
  edge: { kind: server, tier: edge, cpus: 4, memory: 4 GB }
links:
  - { ends: [edge, [A, B]] }
services:
  navigation:
    robot: robot
    kpis: { service_time: 15 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: robot }
      navigation: { program: navigation, node: edge, cpus: 1 }
walks:
  robot: { waypoints: [[0, 0], [9, 0]], speed_limit: 0.3 m/s }
";

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: HandoverArgs,
    }

    /// Plans walks on a testbed, on these kinds of radio.
    fn planned(testbed: &str, on: &str) -> Result<Vec<Planned>, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("testbed.yaml");
        std::fs::write(&file, testbed).expect("it is written");
        let line = ["handover", "--kind", on, "--testbed", file.to_str().expect("a path in UTF-8")];
        let args = Line::try_parse_from(line).map_err(|error| error.to_string())?.args;
        plan(&args, &kinds(&args).0).map_err(|report| match report.downcast_ref() {
            Some(FileError::Wrong { mistakes, .. }) => mistakes[0].to_string(),
            _ => report.to_string(),
        })
    }

    #[test]
    fn the_same_file_is_walked_on_all_kinds() {
        for wifi in ["", ", wifi: hardware"] {
            let testbed = TESTBED.replace("access: edca", &format!("access: edca{wifi}"));
            let planned = planned(&testbed, "model,hwsim,hardware").unwrap();
            let names: Vec<_> = planned.iter().map(Planned::name).collect();
            let expected =
                ["model-sent-1", "model-alone-1", "hwsim-sent-1", "hwsim-alone-1", "hardware-sent-1"];
            assert_eq!(names, expected);
            let [model, .., hardware] = &planned[..] else { panic!() };
            // Its own walk ends the run of the model.
            assert_eq!((model.until, hardware.until), (None, Some(Duration::from_secs(30))));
            assert_eq!((model.loaded.testbed.services.len(), hardware.loaded.testbed.services.len()), (1, 0));
            assert_eq!(hardware.loaded.testbed.agents_at_start().count(), 3);
        }
    }

    #[test]
    fn hardware_needs_an_interface_of_each_radio() {
        let testbed = TESTBED.replace(", agent: ap2, interface: wlan0", "");
        assert!(planned(&testbed, "model").is_ok());
        let error = planned(&testbed, "hardware").unwrap_err();
        assert_eq!(error, "`B` has no radio, and its network has `wifi: hardware`");
        assert!(planned(&testbed, "radar").unwrap_err().contains("write one of model, hwsim, hardware"));
    }
}
