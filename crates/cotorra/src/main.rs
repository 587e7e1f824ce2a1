//! The command line of cotorra.
//!
//! It reads arguments, calls the other crates, and shows their results. All decisions are made in those crates.
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
mod experiment;
mod explanation;
mod fault_test;
mod fdu;
mod figures;
mod given;
mod history;
mod link;
mod localize;
mod logs;
mod margin;
mod netem;
mod new;
mod open;
mod origin;
mod progress;
mod ps;
mod quantity;
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

use std::process::ExitCode;

use clap::{CommandFactory, Parser};
use miette::{IntoDiagnostic, MietteHandlerOpts};

use cli::{BundledVnf, Cli, Command};
use exit::Status;
use testbed_file::FileError;

fn main() -> ExitCode {
    // The messages of our errors include their causes.
    miette::set_hook(Box::new(|_| Box::new(MietteHandlerOpts::new().without_cause_chain().build())))
        .expect("nothing was reported yet");
    match dispatch(Cli::parse().command) {
        Ok(code) => code,
        Err(report) => {
            let is_void = experiment::is_void(&report) || margin::is_void(&report);
            match report.downcast::<FileError>() {
                Ok(error) => error.show(),
                Err(report) => note!("{report:?}"),
            }
            if is_void { Status::NotValid.into() } else { Status::Error.into() }
        }
    }
}

fn dispatch(command: Command) -> miette::Result<ExitCode> {
    match command {
        Command::Run(args) => return run::run(args),
        Command::Experiment { experiment } => return experiment::experiment(experiment),
        Command::Sweep(args) => return sweep::sweep(&args),
        Command::Margin(args) => return margin::margin(&args),
        Command::FaultTest(args) => return fault_test::fault_test(&args),
        Command::History { command } => return history::history(&command),
        Command::Replay(args) => return replay::replay(&args),
        Command::Reproduce(args) => return reproduce::reproduce(&args),
        Command::View(args) => return view::view(&args),
        Command::Localize(args) => return localize::localize(&args),
        Command::Check(args) => return check::check(&args),
        Command::Edit(args) => return edit::edit(&args),
        Command::Selftest(args) => return selftest::selftest(&args),
        Command::Calibrate(args) => calibrate::calibrate(&args)?,
        Command::New { new } => new::new(&new)?,
        Command::Schema => output::print_exact(&format!("{:#}\n", cotorra_testbed_file::schema()))?,
        Command::OpenApi { app_lcm: true, .. } => output::print_exact(&cotorra_testbed::app_lcm_openapi())?,
        Command::OpenApi { wais: false, .. } => output::print_exact(&cotorra_testbed::openapi())?,
        Command::OpenApi { wais: true, .. } => output::print_exact(&cotorra_testbed::wais_openapi())?,
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
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "cotorra", &mut script);
            output::print_exact(&String::from_utf8_lossy(&script))?;
        }
        Command::Vnf { vnf } => {
            let served = match vnf {
                BundledVnf::Navigation => cotorra_vnfs::navigation(cotorra_datapath::be_punctual),
                BundledVnf::Localization => cotorra_vnfs::localization(),
            };
            match served.into_diagnostic()? {}
        }
        Command::Guard { record } => cotorra_testbed::guard_containers(&record).into_diagnostic()?,
        Command::Probe { probe } => bench::probe(&probe)?,
    }
    Ok(ExitCode::SUCCESS)
}
