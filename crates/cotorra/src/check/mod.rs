//! `cotorra check`: reports every mistake in testbed files, and summarises valid ones. `--coverage` draws the signal of
//! their radio units, and `--against` compares their figures with those of another simulator.

mod against;
mod coverage;
mod extent;
mod start;
mod walls;

pub use start::hints as start_hints;

use std::{path::PathBuf, thread, time::Duration};

use clap::Args;
use cotorra_graph::{Program, Testbed};
use cotorra_testbed::{Rehearsal, missing_cpus};

use self::against::{AgainstArgs, AgainstError};
use crate::{
    approval::{self, TrustArgs},
    exit::Status,
    figures::parse_figure_file,
    output, signals, testbed_file,
};

/// Check testbed files
///
/// Reports every mistake of a file in its place, with the remedy, or summarises the testbed if there is none. Warnings stand
/// in their place, too: check them before you trust results. Plug-ins are created as in a run, but no ledger is contacted.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra check testbeds/*.yaml
  cotorra check testbeds/corridor.yaml --coverage signal.svg     the signal of its radio units, over its map
  cotorra check testbeds/camera.yaml --against ns3 --seeds 5     its service times beside those of ns-3

Exit status: 0 if all files are valid, 1 if one is not, 4 if a figure of another simulator differs, 130 if stopped by Ctrl-C.")]
pub struct CheckArgs {
    /// The testbed files
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Draw the mean signal of each radio unit over the map into a file: its name ends with .svg, .pdf or .png
    ///
    /// The mean is that of path loss and of the walls of networks that have `walls`, without shadowing and fading, at the height
    /// at which robots walk farthest. It takes one testbed file. A file that exists is not overwritten.
    #[arg(long, value_name = "PICTURE", value_parser = parse_figure_file)]
    pub coverage: Option<PathBuf>,
    #[command(flatten)]
    pub against: AgainstArgs,
    #[command(flatten)]
    pub trust: TrustArgs,
}

/// Summarises the scripted changes of links. Empty if there are none.
fn scripted(Rehearsal { timed, areas, replayed }: Rehearsal) -> String {
    let parts = [
        (timed, "at a time", "conditions"),
        (areas, "where a robot is", "conditions"),
        (replayed, "of a recorded run", "changes"),
    ];
    let parts =
        parts.into_iter().filter(|(n, ..)| *n > 0).map(|(n, when, what)| format!("{n} {what} {when}"));
    let parts: Vec<_> = parts.collect();
    if parts.is_empty() { String::new() } else { format!("; links: {}", parts.join(", ")) }
}

/// Returns a hint for each image whose times virtual time would take for zero.
fn hints(testbed: &Testbed) -> Vec<String> {
    let is_instant = |program: &Program, start: Duration, processing: Duration| {
        // A command in a container does not run in virtual time.
        program.serves_robots() && (start + processing).is_zero()
    };
    let images = testbed.vnfs().filter_map(|vnf| Some((vnf, vnf.image.as_deref()?)));
    let images = images.filter(|(vnf, _)| vnf.computing.is_none());
    let instant = images.filter(|(vnf, image)| is_instant(&vnf.program, image.start, image.processing));
    let hint = |id| {
        format!(
            "hint: VNF `{id}` has an image, but neither `start_time` nor `processing_delay`: in virtual time, it starts and \
             answers at once. `cotorra bench image` measures both"
        )
    };
    instant.map(|(vnf, _)| hint(&vnf.id)).collect()
}

/// Checks every file, also after one that is not valid.
pub fn check(args: &CheckArgs) -> miette::Result<Status> {
    if let Some(out) = &args.coverage {
        coverage::check(out, args.files.len())?;
    }
    if args.against.out.is_some() && args.files.len() > 1 {
        return Err(AgainstError::ManyFiles(args.files.len()).into());
    }
    // Ctrl-C can be listened to once, for all files.
    let interrupts = args.against.against.map(|_| signals::listen()).transpose()?;
    let mut status = Status::Done;
    for file in &args.files {
        match testbed_file::load(file, &[]) {
            Ok(loaded) => match cotorra_testbed::rehearse(&loaded.testbed) {
                Ok(script) => {
                    let overview = testbed_file::overview(&loaded.testbed) + &scripted(script);
                    output::print(&format!("{}: {overview}\n", file.display()))?;
                    loaded.warn();
                    let cpus = thread::available_parallelism().ok();
                    let missing = cpus.and_then(|have| missing_cpus(&loaded.testbed, have.get()));
                    missing.iter().for_each(|missing| note!("{}: hint: {missing}", file.display()));
                    let hints = hints(&loaded.testbed).into_iter().chain(start_hints(&loaded.testbed));
                    hints.for_each(|hint| note!("{}: {hint}", file.display()));
                    if let Some(out) = &args.coverage {
                        let shown = coverage::write(&loaded.testbed, out)?;
                        output::print(&format!("{}: {shown}\n", out.display()))?;
                    }
                    if let Some(interrupts) = &interrupts {
                        approval::demand(&loaded, file, args.trust)?;
                        match against::against(&loaded, &args.against, interrupts)? {
                            Status::Interrupted => return Ok(Status::Interrupted),
                            compared => status = status.max(compared),
                        }
                    }
                }
                Err(error) => {
                    status = Status::Error;
                    note!("{}: {error}", file.display());
                }
            },
            Err(error) => {
                status = Status::Error;
                error.show();
            }
        }
    }
    Ok(status)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_graph::Testbed;

    #[test]
    fn images_in_roles_without_times_get_a_hint() {
        let folder = cotorra_testing::project_file("testbeds");
        let corridor = std::fs::read_to_string(folder.join("corridor.yaml")).unwrap();
        let role = |keys: &str| {
            let text = corridor.replace("program: navigation,", &format!("{keys},"));
            let parsed = cotorra_testbed_file::parse("corridor.yaml", &text, &folder);
            super::hints(&parsed.unwrap_or_else(|wrong| panic!("{wrong}\n{text}")))
        };
        let [hint] = &role("program: navigation, image: x")[..] else { panic!("one hint") };
        assert!(hint.contains("VNF `navigation`"), "{hint}");
        for keys in [
            "program: navigation, image: x, start_time: 1 s",
            "program: navigation, image: x, processing_delay: 1 ms",
            "program: navigation",
            "image: x, command: [y]",
        ] {
            assert_eq!(role(keys), Vec::<String>::new(), "{keys}");
        }
    }

    /// Returns a testbed of a switch, these radio units, whose lines begin with their names, and a robot with this walk.
    pub fn testbed(units: &str, walk: &str) -> Testbed {
        let names: Vec<_> = units.lines().filter_map(|line| line.split(':').next()).map(str::trim).collect();
        let links = if names.is_empty() {
            String::new()
        } else {
            format!("links:\n  - {{ ends: [lan, [{}]] }}\n", names.join(", "))
        };
        let text = format!(
            "name: floor\nwireless: {{ lab: {{ path_loss: {{ model: log_distance, exponent: 3.0 }} }} }}\nnodes:\n  \
             lan: {{ kind: switch }}\n  robot: {{ kind: robot, model: quadrotor }}\n{units}{links}\
             walks:\n  robot: {{ waypoints: {walk}, speed_limit: 1 m/s }}\n"
        );
        cotorra_testbed_file::parse("floor.yaml", &text, Path::new(""))
            .unwrap_or_else(|wrong| panic!("{wrong}\n{text}"))
    }
}
