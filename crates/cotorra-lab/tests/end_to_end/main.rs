//! End-to-end tests of the real program `cotorra-lab`.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
    process::Command,
};

use cotorra_testing::{command, project_file};

mod command_line;
mod experiment;
mod reproduce;

const PROGRAM: &str = env!("CARGO_BIN_EXE_cotorra-lab");

/// Returns a command for the program.
fn lab<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let mut command = command(PROGRAM);
    command.args(arguments);
    command
}

/// Returns a command for `cotorra`, which is built beside it.
fn cotorra<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let mut command = command(Path::new(PROGRAM).with_file_name("cotorra"));
    command.args(arguments);
    command
}

fn corridor() -> PathBuf {
    project_file("testbeds/corridor.yaml")
}
