//! The program `cotorra-lab`: published experiments, benchmarks of the emulated network, and fault tests. Users of the testbed
//! need none of them.
#![forbid(unsafe_code)]
// The macros panic when the reader has closed the pipe.
#![deny(clippy::print_stderr, clippy::print_stdout)]

mod bench;
mod cli;
mod experiment;
mod fault_test;

use std::{env, process::ExitCode};

use clap::{CommandFactory, Parser};
use cotorra::{end_with_report, given, guard, print_completions, reproduce, serve_vnf};

use cli::{Cli, Command};

fn main() -> ExitCode {
    end_with_report(|| dispatch(Cli::parse().command), experiment::is_void)
}

fn dispatch(command: Command) -> miette::Result<ExitCode> {
    match command {
        Command::Experiment { experiment } => {
            return experiment::experiment(*experiment, given(Cli::command(), env::args_os()));
        }
        Command::Reproduce(args) => return reproduce(&args, &["experiment"]),
        Command::FaultTest(args) => return fault_test::fault_test(&args),
        Command::Bench(args) => return bench::bench(&args),
        Command::Completions { shell } => print_completions(shell, Cli::command(), "cotorra-lab")?,
        Command::Vnf { vnf } => match serve_vnf(vnf)? {},
        Command::Guard { record } => guard(&record)?,
        Command::Probe { probe } => bench::probe(&probe)?,
    }
    Ok(ExitCode::SUCCESS)
}
