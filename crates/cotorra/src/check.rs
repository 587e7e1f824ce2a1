//! `cotorra check`: reports every mistake in testbed files, and summarises valid ones.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use cotorra_testbed::Rehearsal;

use crate::{output, testbed_file};

/// Check testbed files
///
/// Reports every mistake of a file in its place, with the remedy, or summarises the testbed if there is none. Plug-ins are
/// created as in a run, but no ledger is contacted.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra check testbeds/*.yaml

Exit status: 0 if all files are valid, 1 if one is not.")]
pub struct CheckArgs {
    /// The testbed files
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
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

/// Checks every file, also after one that is not valid.
pub fn check(args: &CheckArgs) -> miette::Result<ExitCode> {
    let mut all_valid = true;
    for file in &args.files {
        match testbed_file::load(file, &[]) {
            Ok(loaded) => match cotorra_testbed::rehearse(&loaded.testbed) {
                Ok(script) => {
                    let overview = testbed_file::overview(&loaded.testbed) + &scripted(script);
                    output::print(&format!("{}: {overview}\n", file.display()))?;
                }
                Err(error) => {
                    all_valid = false;
                    note!("{}: {error}", file.display());
                }
            },
            Err(error) => {
                all_valid = false;
                error.show();
            }
        }
    }
    Ok(if all_valid { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
