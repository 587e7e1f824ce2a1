//! Arguments of `cotorra agent`.

use std::{path::PathBuf, time::Duration};

use clap::{Args, Subcommand};
use cotorra_enrolment::CoreEndpoint;
use cotorra_graph::AgentId;

use crate::duration::{parse_duration, parse_time};

#[derive(Debug, Subcommand)]
pub enum Agent {
    Enrol(EnrolArgs),
    Renew(RenewArgs),
    Revoke(RevokeArgs),
    List(ListArgs),
}

/// Enrol an agent, and write the file that it needs
///
/// The file has the address of the core, the agent's certificate and its key. Copy it to the agent's machine over a secure
/// path, such as scp, and remove it here. An agent that was revoked can be enrolled again.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra agent enrol robot --core 192.168.1.10:7448
  cotorra agent enrol edge-1 --core lab.example.org:7448 --valid 30d --out edge.agent")]
pub struct EnrolArgs {
    /// The agent's name: up to 53 letters, digits, `_`, `-` or `~`
    pub name: AgentId,
    /// Host name or IPv4 address, and port, at which the agent reaches the core
    #[arg(long, value_name = "HOST:PORT")]
    pub core: CoreEndpoint,
    /// Validity of the certificate
    #[arg(long, value_name = "DURATION", default_value = "90d", value_parser = parse_duration)]
    pub valid: Duration,
    #[command(flatten)]
    pub file: FileArgs,
    #[command(flatten)]
    pub authority: AuthorityArgs,
}

/// Make new credentials for an agent
///
/// The old ones end after an overlap, so that the agent stays connected until it has the new file.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra agent renew robot --force                        replaces robot.agent
  cotorra agent renew robot --out new.agent --overlap 1d
  cotorra agent renew robot --overlap 0s --force           the old file ends at once
  cotorra agent renew robot --core 10.0.0.7:7448 --force   the core has moved")]
pub struct RenewArgs {
    /// The agent's name
    pub name: AgentId,
    /// Other host name or IPv4 address, and port, at which the agent reaches the core
    #[arg(long, value_name = "HOST:PORT")]
    pub core: Option<CoreEndpoint>,
    /// Validity of the certificate; default: that of the one before
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub valid: Option<Duration>,
    /// How long the agent may still connect with its old files
    #[arg(long, value_name = "DURATION", default_value = "1h", value_parser = parse_time)]
    pub overlap: Duration,
    #[command(flatten)]
    pub file: FileArgs,
    #[command(flatten)]
    pub authority: AuthorityArgs,
}

/// End all credentials of an agent at once
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra agent revoke robot")]
pub struct RevokeArgs {
    /// The agent's name
    pub name: AgentId,
    #[command(flatten)]
    pub authority: AuthorityArgs,
}

/// List all agents with their newest certificate, and the certificates with which they may connect
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra agent list
  cotorra agent list --json")]
pub struct ListArgs {
    /// Write JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub authority: AuthorityArgs,
}

/// The file for the agent.
#[derive(Debug, Args)]
pub struct FileArgs {
    /// The file to write; default: the agent's name with `.agent`
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace the file if it exists
    #[arg(long)]
    pub force: bool,
}

#[derive(Debug, Args)]
pub struct AuthorityArgs {
    /// Folder of the authority; default: cotorra/agents in $XDG_CONFIG_HOME or ~/.config
    #[arg(long, value_name = "DIR")]
    pub authority: Option<PathBuf>,
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use cotorra_enrolment::Renewal;

    use super::*;
    use crate::cli::{Cli, Command};

    #[test]
    fn defaults_are_90_days_and_the_overlap_of_a_renewal() {
        let agent = |words: &[&str]| {
            let words = ["cotorra", "agent"].iter().chain(words);
            let Command::Agent { agent } = Cli::try_parse_from(words).unwrap().command else {
                unreachable!()
            };
            agent
        };
        let enrol = agent(&["enrol", "robot", "--core", "lab:7448"]);
        assert!(matches!(enrol, Agent::Enrol(EnrolArgs { valid, .. }) if valid.as_secs() == 90 * 86400));
        let Agent::Renew(RenewArgs { core, valid, overlap, .. }) = agent(&["renew", "robot"]) else {
            unreachable!()
        };
        assert_eq!(Renewal { core, validity: valid, overlap }, Renewal::default());
    }
}
