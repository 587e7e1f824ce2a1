//! The commands and their help. The arguments of a command stand in the module that carries it out.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use clap_complete::Shell;
use cotorra::{BundledVnf, ReproduceArgs};

use crate::{
    bench::{BenchArgs, Probe},
    experiment::args::Experiment,
    fault_test::FaultTestArgs,
};

/// Experiments with cotorra, the context-aware testbed for networked robots.
///
/// cotorra-lab repeats published experiments, measures the emulated network, and breaks random testbeds.
#[derive(Debug, Parser)]
#[command(name = "cotorra-lab", version, max_term_width = 100, after_long_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

const EXAMPLES: &str = "\
Examples:
  cotorra-lab experiment okpi             repeat the published comparison
  cotorra-lab fault-test --runs 1000      break random testbeds, and check that every promise holds
  cotorra-lab bench tcp                   measure TCP through the emulated network

Exit status:
  0    done
  1    an error, reported on standard error, or a broken promise
  2    wrong usage
  3    done and reported, but the figures are not valid, or a run is void; or a repeat differs
  4    the figures are valid, but a service kept its target less often than the testbed file demands
  5    a run ended because no robot made progress on its walk
  130  stopped with Ctrl-C before the end";

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Repeat a published experiment beside the published result, or compare kinds of radio
    Experiment {
        #[command(subcommand)]
        experiment: Box<Experiment>,
    },
    Reproduce(ReproduceArgs),
    FaultTest(FaultTestArgs),
    Bench(BenchArgs),
    /// Print a completion script for a shell
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Run a bundled VNF; a run starts it inside nodes.
    #[command(hide = true)]
    Vnf {
        #[command(subcommand)]
        vnf: BundledVnf,
    },
    /// Remove the containers of a run that was killed; a run starts it.
    #[command(hide = true)]
    Guard {
        /// The record of the run's containers
        record: PathBuf,
    },
    /// Run one end of a measurement; a benchmark starts it inside a peer.
    #[command(hide = true)]
    Probe {
        #[command(subcommand)]
        probe: Probe,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn arguments_that_decide_results_are_given_again() {
        let line =
            "cotorra-lab experiment okpi --until 60s --set a=1 --seed 7 --figure pdf -vv --measured w.csv";
        let given = cotorra::given(Cli::command(), line.split(' '));
        assert_eq!(given, ["experiment", "okpi", "--seed=7", "--until=60s"]);
    }
}
