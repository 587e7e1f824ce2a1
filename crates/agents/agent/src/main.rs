//! The agent of a real machine: runs VNFs of a testbed there, and reports the machine's context to the core.
#![forbid(unsafe_code)]

mod environments;
mod error;
mod files;
mod guard;
mod holder;
mod images;
mod journal;
mod launcher;
mod links;
mod options;
mod radios;
mod robot;
mod service;
mod wake;
mod works;

use std::{
    io::{self, IsTerminal},
    process::ExitCode,
};

use clap::{Args, Parser, Subcommand};
use cotorra_agent_transport::diagnose;
use cotorra_netem::Confirmed;
use tracing_subscriber::{Layer, filter::Targets, fmt, layer::SubscriberExt, util::SubscriberInitExt};

use crate::{error::AgentError, options::Options, service::Service};

/// Run VNFs of cotorra testbeds on this machine, and report its context
///
/// `cotorra agent enrol NAME` on the core's machine makes the credentials. docs/use/machines.md has all
/// steps, and a systemd unit.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Connect to the core, and do what it wants until Ctrl-C
    ///
    /// The agent connects again whenever the connection was lost, and uses new credentials as soon as the file changes. If the
    /// core is away for longer than two seconds, VNFs stop, unless the testbed file lets them go on (`keep: true`).
    #[command(after_long_help = "\
Examples:
  cotorra-agent run /etc/cotorra/edge1.agent
  cotorra-agent run edge1.agent --state /tmp/edge1 --allow-trusted
  cotorra-agent run edge1.agent --images podman
  cotorra-agent run gate1.agent --allow-interface eth0
  cotorra-agent run ap1.agent --wifi wlan0")]
    Run(RunArgs),
    /// Try the connection to the core once, and report what is wrong
    Check {
        /// The file that `cotorra agent enrol` wrote
        credentials: std::path::PathBuf,
    },
    /// Serve a robot as a VNF; started by the agent
    #[command(hide = true)]
    Vnf {
        #[command(subcommand)]
        vnf: BundledVnf,
    },
    /// Hold a VNF; started by the agent
    #[command(hide = true)]
    Hold {
        #[arg(long)]
        user: Option<options::User>,
        #[arg(last = true)]
        words: Vec<String>,
    },
    /// Leave a robot at rest if the agent is gone; started by the agent
    #[command(hide = true)]
    Guard,
    /// Remove the containers of an agent that is gone; started by the agent
    #[command(hide = true)]
    GuardContainers { record: std::path::PathBuf },
}

#[derive(Debug, Args)]
struct RunArgs {
    /// The file that `cotorra agent enrol` wrote
    credentials: std::path::PathBuf,
    /// Folder of the agent's state; default: /var/lib/cotorra-agent for root, ~/.local/state/cotorra-agent for others
    #[arg(long, value_name = "DIR")]
    state: Option<std::path::PathBuf>,
    /// User of commands that are not trusted, if the agent is root, as numbers
    #[arg(long, value_name = "UID:GID", default_value = "65534:65534")]
    vnf_user: options::User,
    /// Run commands of `trusted: true` with the agent's own rights; without it, they are rejected
    #[arg(long)]
    allow_trusted: bool,
    /// Run VNFs that have an image in containers of this engine; without it, they are rejected
    ///
    /// A container is in the network of this machine, without capabilities. Devices, capabilities, and volumes other than files of
    /// the run need `--allow-trusted`, too.
    #[arg(long, value_name = "ENGINE")]
    images: Option<options::ImageEngine>,
    /// Give an interface conditions even if it is the loopback one or carries the default route; can be repeated
    #[arg(long, value_name = "NAME")]
    allow_interface: Vec<String>,
    /// Let NetEm replace queueing disciplines that somebody put on interfaces; they are put back afterwards
    #[arg(long)]
    replace: bool,
    /// Lend a Wi-Fi interface to testbeds, which put their own access point or network there; can be repeated
    ///
    /// The state from before is restored at the end of a run, when the core is lost, and by the next start after a kill.
    #[arg(long, value_name = "INTERFACE")]
    wifi: Vec<cotorra_wifi::InterfaceName>,
}

#[derive(Debug, Subcommand)]
enum BundledVnf {
    Navigation,
    Localization,
}

fn main() -> ExitCode {
    let filter =
        Targets::new().with_default(tracing::Level::WARN).with_target("cotorra_agent", tracing::Level::INFO);
    let stderr = fmt::layer().with_target(false).with_ansi(io::stderr().is_terminal());
    tracing_subscriber::registry().with(stderr.with_writer(io::stderr).with_filter(filter)).init();
    match dispatch(Cli::parse().command) {
        Ok(code) => code,
        Err(error) => {
            tracing::error!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn dispatch(command: Command) -> Result<ExitCode, AgentError> {
    match command {
        Command::Run(args) => {
            let confirmed = Confirmed { replace: args.replace, interfaces: args.allow_interface };
            let wifi = args.wifi.into_iter().collect();
            let RunArgs { credentials, state, vnf_user, allow_trusted, images, .. } = args;
            let options = Options::new(credentials, state, vnf_user, allow_trusted, images, confirmed)?;
            Service::start(Options { wifi, ..options })?.run();
        }
        Command::Check { credentials } => {
            let bundle = options::bundle(&credentials)?;
            diagnose(&bundle.core().to_string(), options::credentials(&bundle))
                .map_err(|reason| AgentError::Refused { core: bundle.core().to_string(), reason })?;
            tracing::info!("{} accepts `{}`", bundle.core(), bundle.certificate().common_name());
        }
        // Navigation needs no higher priority here: the machine is the VNF's own.
        Command::Vnf { vnf: BundledVnf::Navigation } => match cotorra_vnfs::navigation(|| ())? {},
        Command::Vnf { vnf: BundledVnf::Localization } => match cotorra_vnfs::localization()? {},
        Command::Hold { user, words } => return holder::hold(user, &words).map_err(AgentError::Hold),
        Command::Guard => guard::guard().map_err(AgentError::Guard)?,
        Command::GuardContainers { record } => images::guard(&record).map_err(AgentError::GuardContainers)?,
    }
    Ok(ExitCode::SUCCESS)
}
