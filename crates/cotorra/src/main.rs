//! The program `cotorra`. Everything is in the library, some of which `cotorra-lab` shares.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    cotorra::cotorra()
}
