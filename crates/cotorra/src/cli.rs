//! The commands and their help. The arguments of a command stand in the module that carries it out.

use std::convert::Infallible;

use clap::{Parser, Subcommand};
use clap_complete::Shell;
use miette::IntoDiagnostic;

use crate::{
    agent::Agent,
    bench::BenchArgs,
    calibrate::CalibrateArgs,
    capture::CaptureArgs,
    check::CheckArgs,
    clean::CleanArgs,
    doctor::DoctorArgs,
    edit::EditArgs,
    exec::ExecArgs,
    fdu::Fdu,
    history::{self, History},
    link::Link,
    localize::LocalizeArgs,
    margin::args::MarginArgs,
    moved::Moved,
    netem::Netem,
    new::New,
    open::OpenArgs,
    ps::PsArgs,
    replay::ReplayArgs,
    reproduce::ReproduceArgs,
    run::RunArgs,
    selftest::SelftestArgs,
    stamp::Stamp,
    stop::StopArgs,
    sweep::args::SweepArgs,
    view::ViewArgs,
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
  cotorra doctor                                   find out what this machine can do
  cotorra selftest                                 compare runs with answers that are known
  cotorra check testbeds/corridor.yaml             check a testbed file
  cotorra run testbeds/corridor.yaml               bring it up, walk it, measure it
  cotorra sweep testbeds/corridor.yaml --seeds 10  run it ten times in virtual time
  cotorra calibrate site.yaml --survey walk.csv    fit it to a real site
  cotorra history series latest service            plot the service time of the last run
  cotorra reproduce runs/corridor-20260101-120000  run it again from its folder, and compare
  cotorra open                                     open the dashboard of a run
  cotorra view --open                              see the last run in a browser
  cotorra exec robot -- ping cloud                 run a program inside a node of a run
  cotorra link set lan-cloud --delay 40ms          change a link of a run
  cotorra ps                                       list your runs
  cotorra stop                                     end a run in order
  cotorra capture lan-cloud -o cloud.pcapng        look into its packets

Exit status:
  0    done
  1    an error, reported on standard error, or a record that is not complete
  2    wrong usage
  3    done and reported, but the figures are not valid, or a run is void; or a repeat differs
  4    the figures are valid, but a service kept its target less often than the testbed file demands
  5    the run ended because no robot made progress on its walk
  130  stopped with Ctrl-C before the end";

#[derive(Debug, Subcommand)]
pub enum Command {
    Run(RunArgs),
    Sweep(SweepArgs),
    Margin(MarginArgs),
    /// Moved to `cotorra-lab`
    #[command(hide = true, disable_help_flag = true)]
    Experiment(Moved),
    /// Moved to `cotorra-lab`
    #[command(hide = true, disable_help_flag = true)]
    FaultTest(Moved),
    /// Query recorded runs
    ///
    /// RUN is the folder of a run, `latest` for the newest under runs/, or the number of a run in the history that
    /// --history or COTORRA_HISTORY names. Long answers are cut off, and say how to see more.
    #[command(after_long_help = history::EXAMPLES)]
    History {
        #[command(subcommand)]
        command: History,
    },
    Replay(ReplayArgs),
    Reproduce(ReproduceArgs),
    View(ViewArgs),
    Localize(LocalizeArgs),
    Check(CheckArgs),
    Edit(EditArgs),
    Calibrate(CalibrateArgs),
    /// Make a testbed or a plug-in from a template
    New {
        #[command(subcommand)]
        new: New,
    },
    /// Use descriptors of Eclipse fog05
    Fdu {
        #[command(subcommand)]
        fdu: Fdu,
    },
    /// Print the JSON Schema of a testbed file
    ///
    /// Editors use it to complete and explain keys, and to mark mistakes as you type.
    #[command(after_long_help = "\
Examples:
  cotorra schema > testbed.schema.json
  # then, as the first line of a testbed file:
  # yaml-language-server: $schema=testbed.schema.json")]
    Schema,
    /// Print the OpenAPI document of the HTTP API
    ///
    /// A run serves the same document at /openapi.json.
    #[command(name = "openapi")]
    OpenApi {
        #[command(flatten)]
        service: OfService,
    },
    Doctor(DoctorArgs),
    Selftest(SelftestArgs),
    Clean(CleanArgs),
    Exec(ExecArgs),
    Open(OpenArgs),
    Ps(PsArgs),
    Stop(StopArgs),
    /// Show, change and test links of the running testbed
    Link {
        #[command(subcommand)]
        link: Link,
    },
    Capture(CaptureArgs),
    /// Make, renew and revoke the credentials of agents on real machines
    ///
    /// An authority in a folder of yours makes them: ~/.config/cotorra/agents by default. Whoever reads that folder can enrol
    /// agents.
    Agent {
        #[command(subcommand)]
        agent: Agent,
    },
    /// Measure a path of any network by STAMP (RFC 8762), or reflect the packets of such a measurement
    Stamp {
        #[command(subcommand)]
        stamp: Stamp,
    },
    Bench(BenchArgs),
    /// Add delay, loss or a rate limit to an interface of this machine, by the kernel's NetEm
    ///
    /// This is for links to real robots and servers. It needs root and a kernel with NetEm; `cotorra doctor` says whether
    /// this kernel has it. Links between a testbed's nodes need neither, because cotorra emulates them itself.
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
        record: std::path::PathBuf,
    },
}

/// Bundled VNFs.
#[derive(Debug, Clone, Copy, Subcommand)]
pub enum BundledVnf {
    /// The brain: answers position packets with navigation packets.
    Navigation,
    /// Monte Carlo localization: answers scans with poses.
    Localization,
    /// The brain as a ROS node: answers poses with velocities.
    RosNavigation,
}

/// Serves a bundled VNF for as long as the process lives.
pub fn serve_vnf(vnf: BundledVnf) -> miette::Result<Infallible> {
    match vnf {
        BundledVnf::Navigation => cotorra_vnfs::navigation(cotorra_datapath::be_punctual).into_diagnostic(),
        BundledVnf::Localization => cotorra_vnfs::localization().into_diagnostic(),
        BundledVnf::RosNavigation => cotorra_ros_brain::serve(cotorra_datapath::be_timely).into_diagnostic(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use cotorra_testing::project_file;

    use crate::testbed_file;

    /// Returns the help of a command and of all commands below it.
    fn help(command: &mut clap::Command) -> String {
        let below: String = command.get_subcommands_mut().map(help).collect();
        command.render_long_help().to_string() + &below
    }

    #[test]
    fn links_in_examples_are_links_of_the_corridor() {
        let corridor = testbed_file::load(&project_file("testbeds/corridor.yaml"), &[]).unwrap().testbed;
        let text = help(&mut Cli::command());
        let after = |before: &str| {
            let rests = text.lines().filter_map(|line| line.trim().strip_prefix(before)?.split(' ').nth(1));
            rests
                .filter(|word| !word.starts_with("--") && !word.is_empty())
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        let figures = text.lines().filter(|line| line.contains("--figure delay"));
        let of_history = figures.filter_map(|line| line.trim().split(' ').nth(4).map(str::to_owned));
        let changed = ["show", "set", "test"].map(|verb| after(&format!("cotorra link {verb}"))).concat();
        let named: Vec<_> = changed.into_iter().chain(of_history).collect();
        assert!(named.len() > 5, "{named:?}");
        for name in named {
            assert!(corridor.graph.links.iter().any(|link| link.id.as_str() == name), "{name}");
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}

/// A service of ETSI MEC that has an OpenAPI document.
#[derive(Debug, clap::Args)]
#[group(multiple = false)]
pub(crate) struct OfService {
    /// Print the document of the WLAN Access Information Service, which a run serves at /wai/v2/openapi.json
    #[arg(long)]
    pub(crate) wais: bool,
    /// Print the document of the Location API, which a run serves at /location/v2/openapi.json
    #[arg(long)]
    pub(crate) location: bool,
    /// Print the document of the Bandwidth Management API, which a run serves at /bwm/v1/openapi.json
    #[arg(long)]
    pub(crate) bwm: bool,
    /// Print the document of application life cycle management, which a run serves at /app_lcm/v1/openapi.json
    #[arg(long)]
    pub(crate) app_lcm: bool,
}

impl OfService {
    /// Returns its document; without one, that of the HTTP API.
    pub(crate) fn document(&self) -> String {
        match () {
            () if self.wais => cotorra_testbed::wais_openapi(),
            () if self.location => cotorra_testbed::location_openapi(),
            () if self.bwm => cotorra_testbed::bwm_openapi(),
            () if self.app_lcm => cotorra_testbed::app_lcm_openapi(),
            () => cotorra_testbed::openapi(),
        }
    }
}
