//! Arguments that several subcommands have, and parsing of seeds and addresses, with errors that say what to write.

use std::{net::SocketAddr, path::PathBuf};

use clap::Args;
use cotorra_testbed::AgentOptions;

/// Who may use the API and the dashboard.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct AccessArgs {
    /// Let every user and every program of this machine use the API and the dashboard
    ///
    /// They can then steer the run, read its history, and start programs in its nodes. By default only you can: over the
    /// run's socket, with COTORRA_TOKEN if you set it, and in browsers that `cotorra open` or --open signed in.
    #[arg(long)]
    pub no_token: bool,
}

/// Agents of real machines.
#[derive(Debug, Args)]
pub struct AgentArgs {
    /// Address at which agents of real machines connect
    #[arg(long, value_name = "ADDR:PORT", default_value_t = AgentOptions::default().listen, value_parser = parse_address)]
    pub agents: SocketAddr,
    /// Folder of the authority with which agents were enrolled; default: cotorra/agents in $XDG_CONFIG_HOME or ~/.config
    #[arg(long, value_name = "DIR")]
    pub authority: Option<PathBuf>,
}

impl AgentArgs {
    /// Returns the options of a run.
    pub fn options(&self) -> AgentOptions {
        AgentOptions { listen: self.agents, authority: self.authority.clone() }
    }
}

/// Parses a seed.
pub fn parse_seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("write a whole number from 0 to {}", u64::MAX))
}

/// Parses an address to listen on.
pub fn parse_address(text: &str) -> Result<SocketAddr, String> {
    let port = text.rsplit(':').next().and_then(|port| port.parse::<u16>().ok()).unwrap_or(7700);
    text.parse().map_err(|_| format!("write an IP address and a port, as in 127.0.0.1:{port}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_whole_numbers() {
        assert_eq!(parse_seed("7"), Ok(7));
        for wrong in ["abc", "-1", "1.5", "", "18446744073709551616"] {
            assert_eq!(
                parse_seed(wrong),
                Err("write a whole number from 0 to 18446744073709551615".to_owned())
            );
        }
    }

    #[test]
    fn a_port_alone_is_completed_to_an_address() {
        assert_eq!(parse_address("127.0.0.1:7851"), Ok(([127, 0, 0, 1], 7851).into()));
        for (wrong, like) in [("7851", 7851), ("localhost:80", 80), ("lab", 7700), ("70000", 7700)] {
            let error = format!("write an IP address and a port, as in 127.0.0.1:{like}");
            assert_eq!(parse_address(wrong), Err(error));
        }
    }
}
