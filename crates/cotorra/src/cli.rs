//! What can be typed: the commands, and the help on all of them. What can be typed behind each stands beside what it does.

use clap::{Parser, Subcommand};
use clap_complete::Shell;

use crate::{
    bench::{BenchArgs, Probe},
    check::CheckArgs,
    clean::CleanArgs,
    exec::ExecArgs,
    experiment::Experiment,
    fault_test::FaultTestArgs,
    history::{self, History},
    link::Link,
    localize::LocalizeArgs,
    netem::Netem,
    replay::ReplayArgs,
    run::RunArgs,
    stamp::Stamp,
    sweep::SweepArgs,
};

/// A context-aware testbed for networked robots.
///
/// cotorra brings a testbed file to life on this machine - robots, radio units, switches, servers and the links
/// between them, with real packets - and measures whether a robot that offloads its navigation keeps its target
/// service time.
#[derive(Debug, Parser)]
#[command(name = "cotorra", version, max_term_width = 100, after_long_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

const EXAMPLES: &str = "\
Examples:
  cotorra doctor                                   what this machine can do
  cotorra check testbeds/corridor.yaml             is this testbed file right?
  cotorra run testbeds/corridor.yaml               bring it up, walk it, measure it
  cotorra sweep testbeds/corridor.yaml --seeds 10  run it ten times in virtual time
  cotorra experiment okpi                          repeat the published comparison
  cotorra history series latest service            what did the last run measure?
  cotorra exec robot -- ping cloud                 run a program inside a node meanwhile
  cotorra link set lan-cloud --delay 40ms          change what a link does meanwhile

Exit status:
  0  done
  1  an error, told on standard error
  2  wrong usage
  3  the run is done and its report written, but its verdict says that the figures are not valid";

#[derive(Debug, Subcommand)]
pub enum Command {
    Run(RunArgs),
    Sweep(SweepArgs),
    /// Repeat a published experiment, and set it beside what was published
    Experiment {
        #[command(subcommand)]
        experiment: Experiment,
    },
    FaultTest(FaultTestArgs),
    /// Ask what runs recorded
    ///
    /// RUN is the folder of a run, `latest` for the newest under runs/, or the number of a run in the history that
    /// --history or COTORRA_HISTORY names. Answers are bounded, and say how to see more.
    #[command(after_long_help = history::EXAMPLES)]
    History {
        #[command(subcommand)]
        question: History,
    },
    Replay(ReplayArgs),
    Localize(LocalizeArgs),
    Check(CheckArgs),
    /// Print the JSON Schema of a testbed file
    ///
    /// Editors use it to complete and explain keys, and to mark mistakes while one types.
    #[command(after_long_help = "\
Examples:
  cotorra schema > testbed.schema.json
  # then, as the first line of a testbed file:
  # yaml-language-server: $schema=testbed.schema.json")]
    Schema,
    /// Print the OpenAPI document of the HTTP API
    ///
    /// The same that a run serves at /openapi.json.
    #[command(name = "openapi")]
    OpenApi {
        /// That of the WLAN Access Information Service, which a run serves at /wai/v2/openapi.json
        #[arg(long)]
        wais: bool,
    },
    /// Say what this machine can do, and what to do about the rest
    ///
    /// Everything is tried, nothing is left behind. What is missing comes with the reason and a remedy; most of it
    /// is not needed.
    Doctor,
    Clean(CleanArgs),
    Exec(ExecArgs),
    /// Show, change and test links of the running testbed
    Link {
        #[command(subcommand)]
        link: Link,
    },
    /// Measure a path of any network by STAMP (RFC 8762), or answer those who do
    Stamp {
        #[command(subcommand)]
        stamp: Stamp,
    },
    Bench(BenchArgs),
    /// Give packets of an interface of this machine delay, loss or a rate, by the kernel's NetEm
    ///
    /// For real links, of real robots and servers. It needs root, and a kernel with NetEm (`cotorra doctor` says whether
    /// this one has it); links between a testbed's nodes need neither: they are emulated by cotorra itself.
    Netem {
        #[command(subcommand)]
        netem: Netem,
    },
    /// Print a completion script for a shell
    #[command(after_long_help = "\
Examples:
  cotorra completions bash > ~/.local/share/bash-completion/completions/cotorra
  cotorra completions zsh > ~/.zfunc/_cotorra
  cotorra completions fish > ~/.config/fish/completions/cotorra.fish")]
    Completions {
        /// The shell.
        shell: Shell,
    },
    /// Run a bundled VNF; what a run starts inside nodes.
    #[command(hide = true)]
    Vnf {
        #[command(subcommand)]
        vnf: BundledVnf,
    },
    /// Run one end of a measurement; what a benchmark starts inside a peer.
    #[command(hide = true)]
    Probe {
        #[command(subcommand)]
        probe: Probe,
    },
}

/// VNFs that come with cotorra.
#[derive(Debug, Clone, Copy, Subcommand)]
pub enum BundledVnf {
    /// The brain: answers position packets with navigation packets.
    Navigation,
    /// Monte Carlo localization: answers scans with poses.
    Localization,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
