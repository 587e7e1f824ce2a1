//! `cotorra-lab fault-test`: runs random testbeds with random faults in virtual time, and checks all promises after each step.

use std::{num::NonZero, path::PathBuf, process::ExitCode, thread};

use clap::Args;
use cotorra::{Progress, Status, Table, count, listen, parse_seed, print};
use cotorra_faults::{Checked, FaultTest, FaultTested, Invariant};
use miette::IntoDiagnostic;

/// Inject faults into random testbeds in virtual time, and check that every promise holds
///
/// Each run has a random testbed, and random faults at random times: links are cut, VNFs killed, hung and slowed, plug-ins
/// panic, hang and flood, robots fall silent, disks fill up, ledgers are reorganised, answers are forged. A seed repeats
/// its run to the last event. docs/reference/reliability.md has all faults and promises.
///
/// If a promise is broken, the command that repeats the run is printed, and the exit status is 1. Ctrl-C ends the test, and
/// the totals of the finished runs are printed.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra-lab fault-test --runs 10000                         ten thousand runs, from seed 1 on
  cotorra-lab fault-test --runs 1000 --seed 50000             another thousand
  cotorra-lab fault-test --runs 1 --seed 4711 --keep broken   one run; if it fails, its files are kept")]
pub struct FaultTestArgs {
    /// Number of runs, each with its own seed
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub runs: u64,
    /// Seed of the first run; the seeds of the others count up from it
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = parse_seed)]
    pub seed: u64,
    /// Number of runs at a time; default: the number of CPUs
    #[arg(short, long, value_name = "J")]
    pub jobs: Option<NonZero<usize>>,
    /// Keep the testbed file, the plan and the history of each run that breaks a promise, under this folder
    #[arg(long, value_name = "FOLDER")]
    pub keep: Option<PathBuf>,
    /// Write plain lines instead of a progress bar
    #[arg(long)]
    pub headless: bool,
}

/// Maximum number of broken promises that are listed.
const LISTED: usize = 10;

/// Runs the test, and prints the totals.
pub fn fault_test(args: &FaultTestArgs) -> miette::Result<ExitCode> {
    let jobs = args.jobs.or_else(|| thread::available_parallelism().ok()).unwrap_or(NonZero::<usize>::MIN);
    let test = FaultTest { first_seed: args.seed, runs: args.runs, jobs, keep: args.keep.clone() };
    let interrupts = listen()?;
    let mut progress = Progress::new(args.headless);
    let shown = &mut progress;
    let tested = test.run(&mut move |done| {
        shown.show(done as usize, args.runs as usize);
        interrupts.try_recv().is_err()
    });
    progress.close();
    let tested = tested.into_diagnostic()?;
    print(&describe(&tested, args.runs))?;
    Ok(if !tested.violations.is_empty() {
        ExitCode::FAILURE
    } else if tested.runs < args.runs {
        Status::Interrupted.into()
    } else {
        ExitCode::SUCCESS
    })
}

fn describe(tested: &FaultTested, runs: u64) -> String {
    let faults: u64 = tested.faults.values().sum();
    let mut text = format!(
        "{} of {}, {faults} faults, {} events\n\n",
        tested.runs,
        count(runs as usize, "run"),
        tested.events
    );
    let mut table = Table::new("<>");
    for (kind, faults) in &tested.faults {
        table.row([(*kind).to_owned(), faults.to_string()]);
    }
    text += &table.render("  ");
    let mut table = Table::new("<>>>");
    table.row(["promise", "checked", "exercised", "broken"].map(str::to_owned));
    for invariant in Invariant::ALL {
        let Checked { checks, exercised } = tested.checked[invariant as usize];
        let broken = tested.violations.iter().filter(|violation| violation.invariant == invariant).count();
        let figures = [checks.to_string(), exercised.to_string(), broken.to_string()];
        table.row([invariant.promise().to_owned()].into_iter().chain(figures));
    }
    text += "\n";
    text += &table.render("  ");
    for violation in tested.violations.iter().take(LISTED) {
        text += &format!(
            "\nseed {}, at {}: expected that {}\n  found: {}\n  repeat it: cotorra-lab fault-test --seed {} --runs 1\n",
            violation.seed,
            violation.at,
            violation.invariant.promise(),
            violation.found,
            violation.seed,
        );
        if let Some(kept) = &violation.kept {
            text += &format!("  kept: {}/\n", kept.display());
        }
    }
    if let Some(more @ 1..) = tested.violations.len().checked_sub(LISTED) {
        text += &format!("\nand {more} more\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use cotorra_faults::Violation;
    use cotorra_graph::Timestamp;

    use super::*;

    #[test]
    fn a_broken_promise_is_listed_with_the_command_that_repeats_it() {
        let violation = Violation {
            seed: 42,
            at: Timestamp::from_secs_f64(1.5),
            invariant: Invariant::Conserved,
            found: "one is missing".to_owned(),
            kept: Some("broken/seed-42".into()),
        };
        let violations = vec![violation; LISTED + 2];
        let tested = FaultTested { runs: 3, violations, ..FaultTested::default() };
        let text = describe(&tested, 5);
        assert!(text.starts_with("3 of 5 runs, 0 faults, 0 events\n"), "{text}");
        let expected = "seed 42, at 1.500 s: expected that packets are conserved\n  found: one is missing\n  repeat it: \
                    cotorra-lab fault-test --seed 42 --runs 1\n  kept: broken/seed-42/\n";
        assert_eq!(text.matches(expected).count(), LISTED, "{text}");
        assert!(text.ends_with("\nand 2 more\n"), "{text}");
    }
}
