//! The command line of cotorra.
//!
//! It reads arguments, calls the other crates, and shows their results. All decisions are made in those crates. [`cotorra()`]
//! is the program; the rest of the interface are the parts that `cotorra-lab` shares.
#![forbid(unsafe_code)]
// The macros panic when the reader has closed the pipe.
#![deny(clippy::print_stderr, clippy::print_stdout)]

#[macro_use]
mod output;

mod agent;
mod approval;
mod arguments;
mod bench;
mod browser;
mod calibrate;
mod capture;
mod check;
mod clean;
mod cli;
mod doctor;
mod duration;
mod edit;
mod exec;
mod exit;
mod explanation;
mod fdu;
mod figures;
mod history;
mod link;
mod localize;
mod logs;
mod margin;
mod moved;
mod netem;
mod new;
mod open;
mod origin;
mod progress;
mod ps;
mod quantity;
mod regret_table;
mod replaced;
mod replay;
mod reproduce;
mod run;
mod running;
mod selftest;
mod service_table;
mod signals;
mod speed;
mod stamp;
mod stop;
mod sweep;
mod table;
mod temporary;
mod testbed_file;
mod verdict;
mod view;
mod words;

use std::{env, path::Path, process::ExitCode};

use clap::{CommandFactory, Parser};
use miette::{IntoDiagnostic, MietteHandlerOpts};

use cli::{Cli, Command};
use margin::args::MarginArgs;

pub use approval::{TrustArgs, demand as demand_approval};
pub use arguments::AgentArgs;
pub use arguments::{AccessArgs, parse_seed};
pub use cli::{BundledVnf, serve_vnf};
pub use duration::parse_duration;
pub use exit::Status;
pub use figures::FigureArgs;
pub use history::{HISTORY_VARIABLE, Place as HistoryLocation, location as history_location};
pub use origin::{given, note as note_origin};
pub use output::{print, write_note};
pub use progress::Progress;
pub use reproduce::{ReproduceArgs, reproduce};
pub use run::{Stage, tokens};
pub use signals::listen;
pub use table::Table;
pub use temporary::TemporaryFolder;
pub use testbed_file::{FileError, Loaded, load, overview};
pub use words::count;

/// Runs the program `cotorra`.
pub fn cotorra() -> ExitCode {
    end_with_report(|| dispatch(Cli::parse().command), margin::is_void)
}

/// Runs a program, and shows the error that ends it. `is_void` says whether the error is that of void figures.
pub fn end_with_report(
    program: impl FnOnce() -> miette::Result<ExitCode>,
    is_void: impl FnOnce(&miette::Report) -> bool,
) -> ExitCode {
    // The messages of our errors include their causes.
    miette::set_hook(Box::new(|_| Box::new(MietteHandlerOpts::new().without_cause_chain().build())))
        .expect("nothing was reported yet");
    match program() {
        Ok(code) => code,
        Err(report) => {
            let is_void = is_void(&report);
            match report.downcast::<FileError>() {
                Ok(error) => error.show(),
                Err(report) => note!("{report:?}"),
            }
            if is_void { Status::NotValid.into() } else { Status::Error.into() }
        }
    }
}

/// Removes the containers of a run that was killed.
pub fn guard(record: &Path) -> miette::Result<()> {
    cotorra_testbed::guard_containers(record).into_diagnostic()
}

/// Prints the completion script of a program for a shell.
pub fn print_completions(
    shell: clap_complete::Shell,
    mut program: clap::Command,
    name: &str,
) -> miette::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut program, name, &mut script);
    output::print_exact(&String::from_utf8_lossy(&script))
}

fn dispatch(command: Command) -> miette::Result<ExitCode> {
    let given = || origin::given(Cli::command(), env::args_os());
    match command {
        Command::Run(args) => return run::run(args),
        Command::Sweep(mut args) => {
            args.given = given();
            return sweep::sweep(&args);
        }
        Command::Margin(args) => return margin::margin(&MarginArgs { given: given(), ..args }),
        Command::Experiment(moved) => return Err(moved.error("experiment").into()),
        Command::FaultTest(moved) => return Err(moved.error("fault-test").into()),
        Command::History { command } => return history::history(&command),
        Command::Replay(args) => return replay::replay(&args),
        Command::Reproduce(args) => return reproduce(&args, &["margin", "run", "sweep"]),
        Command::View(args) => return view::view(&args),
        Command::Localize(args) => return localize::localize(&args),
        Command::Check(args) => return Ok(check::check(&args)?.into()),
        Command::Edit(args) => return edit::edit(&args),
        Command::Selftest(args) => return selftest::selftest(&args),
        Command::Calibrate(args) => calibrate::calibrate(&args)?,
        Command::New { new } => new::new(&new)?,
        Command::Schema => output::print_exact(&format!("{:#}\n", cotorra_testbed_file::schema()))?,
        Command::OpenApi { service } => output::print_exact(&service.document())?,
        Command::Agent { agent } => agent::agent(&agent)?,
        Command::Fdu { fdu } => fdu::fdu(&fdu)?,
        Command::Doctor(args) => doctor::doctor(&args)?,
        Command::Clean(args) => clean::clean(&args)?,
        Command::Exec(args) => return Ok(exec::exec(&args)?),
        Command::Open(args) => open::open(&args)?,
        Command::Ps(args) => ps::ps(&args)?,
        Command::Stop(args) => stop::stop(&args)?,
        Command::Link { link } => link::link(&link)?,
        Command::Capture(args) => capture::capture(&args)?,
        Command::Stamp { stamp } => stamp::stamp(&stamp)?,
        Command::Bench(args) => return bench::bench(&args),
        Command::Netem { netem } => netem::netem(&netem)?,
        Command::Completions { shell } => print_completions(shell, Cli::command(), "cotorra")?,
        Command::Vnf { vnf } => match serve_vnf(vnf)? {},
        Command::Guard { record } => guard(&record)?,
    }
    Ok(ExitCode::SUCCESS)
}
