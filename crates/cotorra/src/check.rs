//! `cotorra check`: says all that is wrong with testbed files, or what they hold.

use std::process::ExitCode;

use crate::{cli::CheckArgs, output, testbed_file};

/// Checks every file, wrong ones too.
pub fn check(args: &CheckArgs) -> miette::Result<ExitCode> {
    let mut all_right = true;
    for file in &args.files {
        match testbed_file::load(file, &[]) {
            Ok(loaded) => {
                output::print(&format!("{}: {}\n", file.display(), testbed_file::overview(&loaded.testbed)))?;
            }
            Err(error) => {
                all_right = false;
                error.show();
            }
        }
    }
    Ok(if all_right { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
