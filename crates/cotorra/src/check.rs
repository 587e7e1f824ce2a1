//! `cotorra check`: says all that is wrong with testbed files, or what they hold.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use cotorra_testbed::Rehearsal;

use crate::{output, testbed_file};

/// Check testbed files
///
/// Says everything that is wrong with each, in its place, with what would be right; or, where nothing is, what the
/// testbed holds. Plug-ins are made as a run makes them, but no ledger is reached for.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra check testbeds/*.yaml

Exit status: 0 if all are right, 1 if one is not.")]
pub struct CheckArgs {
    /// The testbed files.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
}

/// What is scripted for links, in a few words; nothing if nothing is.
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

/// Checks every file, wrong ones too.
pub fn check(args: &CheckArgs) -> miette::Result<ExitCode> {
    let mut all_right = true;
    for file in &args.files {
        match testbed_file::load(file, &[]) {
            Ok(loaded) => match cotorra_testbed::rehearse(&loaded.testbed) {
                Ok(script) => {
                    let overview = testbed_file::overview(&loaded.testbed) + &scripted(script);
                    output::print(&format!("{}: {overview}\n", file.display()))?;
                }
                Err(error) => {
                    all_right = false;
                    note!("{}: {error}", file.display());
                }
            },
            Err(error) => {
                all_right = false;
                error.show();
            }
        }
    }
    Ok(if all_right { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
