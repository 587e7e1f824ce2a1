//! Fixtures that tests and benchmarks of several crates share: servers, peers, machines with radios, testbeds and graphs.
//!
//! Only ever a dev-dependency. Unit tests of a crate that this one depends on would see two copies of that crate's types;
//! its integration tests and benchmarks see one.
//!
//! A fixture whose program is not installed is `None`, with a message on standard error. In continuous integration, where
//! `CI` is set, it panics instead.
#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used, reason = "a fixture that fails, fails the test")]
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "waits for real processes")]

pub mod browser;
pub mod containers;
pub mod lab;
pub mod mariadb;
pub mod placement;
pub mod process;
pub mod radios;
pub mod robot;
pub mod ros1;
pub mod ros2;
pub mod slurm;
pub mod turtlebot;

mod mutations;

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use cotorra_graph::Testbed;

pub use mutations::mutations;

/// Returns the path of a file of the project, which need not exist.
///
/// scripts/test runs some tests from a copy of the project, and says where by `CARGO_MANIFEST_DIR` in the environment.
pub fn project_file(path: &str) -> PathBuf {
    let package = env::var_os("CARGO_MANIFEST_DIR").unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    let root = Path::new(&package).ancestors().find(|folder| folder.join("Cargo.lock").exists());
    root.expect("the package is in the workspace").join(path)
}

/// Returns a command for a program of cotorra, without cotorra's own environment variables.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.env_remove("COTORRA_TOKEN").env_remove("COTORRA_LOG").env("NO_COLOR", "1");
    // Most tests run commands of files that they wrote just now.
    command.env("COTORRA_TRUST", "1");
    command.env_remove("COTORRA_API").env_remove("COTORRA_HISTORY").env_remove("COTORRA_HISTORY_PASSWORD");
    command
}

/// Returns the text on standard output.
pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Returns the text on standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Loads the published testbed as it ships.
pub fn corridor() -> Testbed {
    cotorra_testbed_file::load(project_file("testbeds/corridor.yaml"))
        .unwrap_or_else(|error| panic!("{error:?}"))
}

/// Finds anvil, the Ethereum node: the program that `COTORRA_ANVIL` names, or the one that npm installed in `contracts`.
pub fn anvil() -> Option<PathBuf> {
    let installed = project_file("contracts/node_modules/@foundry-rs/anvil-linux-amd64/bin/anvil");
    let program = env::var_os("COTORRA_ANVIL").map_or(installed, PathBuf::from);
    found(program.exists(), "anvil", "npm install --prefix contracts --no-save").then_some(program)
}

/// Finds axe-core, which examines a page for what keeps people from using it: the file that `COTORRA_AXE` names, or the one
/// that scripts/test installs.
pub fn axe() -> Option<PathBuf> {
    let installed = project_file("target/tools/page/node_modules/axe-core/axe.min.js");
    let file = env::var_os("COTORRA_AXE").map_or(installed, PathBuf::from);
    found(file.exists(), "axe-core", "scripts/check-page installs it").then_some(file)
}

/// Returns the Python of the peers that scripts/test installs, as `COTORRA_PEERS` names it. `peer` is for the message.
pub fn peers(peer: &str) -> Option<PathBuf> {
    let python = env::var_os("COTORRA_PEERS").map(PathBuf::from);
    found(python.is_some(), peer, "scripts/test installs it, and sets COTORRA_PEERS").then_some(python?)
}

/// Returns a Python that has these modules: that of the peers, or else the system's. `peer` is for the message.
pub fn python(modules: &str, peer: &str) -> Option<PathBuf> {
    let python = env::var_os("COTORRA_PEERS").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let import = format!("import {modules}");
    let imported = Command::new(&python).args(["-c", &import]).stderr(Stdio::null()).status();
    let has_modules = imported.is_ok_and(|status| status.success());
    found(has_modules, peer, "scripts/test installs it").then_some(python)
}

/// Returns a command for tshark, which reads captures.
pub fn tshark() -> Option<Command> {
    installed("tshark", "--version", "tshark")
}

/// Returns commands for pdfinfo and pdftotext, which read PDF.
pub fn pdf_readers() -> Option<[Command; 2]> {
    let [info, text] = ["pdfinfo", "pdftotext"].map(|program| installed(program, "-v", "poppler-utils"));
    Some([info?, text?])
}

/// Returns a command for GNU parallel.
pub fn parallel() -> Option<Command> {
    installed("parallel", "--version", "parallel")
}

/// Returns a command for a program, if it is installed by that package. `version` lets it print its version.
fn installed(program: &str, version: &str, package: &str) -> Option<Command> {
    let is_there = Command::new(program).arg(version).stdout(Stdio::null()).stderr(Stdio::null()).status();
    found(is_there.is_ok(), program, &format!("install the package {package}")).then(|| Command::new(program))
}

/// Returns the path of a program, which may be one for administrators.
fn program(name: &str) -> Option<PathBuf> {
    let path = env::var("PATH").unwrap_or_default() + ":/usr/sbin:/usr/bin";
    path.split(':').map(|folder| Path::new(folder).join(name)).find(|file| file.is_file())
}

/// Returns whether a program was found, and says how to install it otherwise.
///
/// # Panics
///
/// In continuous integration, if it was not.
fn found(found: bool, program: &str, remedy: &str) -> bool {
    if !found {
        assert!(env::var_os("CI").is_none(), "{program} is not installed: {remedy}");
        eprintln!("skipped: {program} is not installed ({remedy})");
    }
    found
}

/// Returns whether agents can be enrolled in this kernel. Certificates are signed with the wide registers of a processor that has
/// them, and user-mode-linux does not keep those of processors with AMX (`scripts/uml`).
pub fn can_enroll_agents() -> bool {
    let narrow = env::var_os("COTORRA_NARROW_REGISTERS").is_some();
    if narrow {
        eprintln!(
            "skipped: on this processor, this kernel does not keep the registers that sign certificates"
        );
    }
    !narrow
}

/// Returns free ports of the loopback interface, from one that depends on the process.
///
/// They lie below those that the kernel hands out, so that no connection takes one before its server comes back to it.
fn free_ports() -> impl Iterator<Item = u16> {
    let first = 10_000 + std::process::id() % 20_000;
    (first..)
        .map(|port| u16::try_from(port).unwrap())
        .filter(|port| std::net::TcpListener::bind(("127.0.0.1", *port)).is_ok())
}
