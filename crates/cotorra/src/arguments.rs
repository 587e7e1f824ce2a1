//! Arguments that several subcommands have, and parsing of seeds and addresses, with errors that say what to write.

use std::{net::SocketAddr, path::PathBuf};

use clap::Args;
use cotorra_testbed::AgentOptions;
use cotorra_testbed::{Dashboard, Encryption};

/// Access to the API and the dashboard, and their protection on the network.
#[derive(Debug, Clone, Default, Args)]
pub struct AccessArgs {
    /// Let every user and every program of this machine use the API and the dashboard
    ///
    /// They can then steer the run, read its history, and start programs in its nodes. By default only you can: over the
    /// run's socket, with COTORRA_TOKEN if you set it, and in browsers that `cotorra open` or --open signed in.
    #[arg(long)]
    pub no_token: bool,
    /// Serve --api without TLS on an address that others can reach
    ///
    /// Whoever sees the packets then sees the token, and can steer the run. By default such an address has HTTPS, with a
    /// certificate by the authority of your agents, which is made if there is none.
    #[arg(long, requires = "api")]
    pub no_tls: bool,
    /// Certificate of --api in PEM with those that lead to its authority, in place of one by the authority of your agents
    #[arg(long, value_name = "FILE", requires_all = ["api", "api_key"], conflicts_with = "no_tls")]
    pub api_certificate: Option<PathBuf>,
    /// Key of --api-certificate, in PEM
    #[arg(long, value_name = "FILE", requires = "api_certificate")]
    pub api_key: Option<PathBuf>,
}

impl AccessArgs {
    /// Returns what protects the API on the network: a certificate by the authority in this folder, unless the user wants
    /// something else.
    pub fn encryption(&self, authority: Option<PathBuf>) -> Encryption {
        match (self.no_tls, &self.api_certificate, &self.api_key) {
            (true, ..) => Encryption::Off,
            (false, Some(certificate), Some(key)) => {
                Encryption::Own { certificate: certificate.clone(), key: key.clone() }
            }
            _ => Encryption::Authority(authority),
        }
    }
}

/// Notes how other machines reach an API, if they do.
pub fn note_network(dashboard: &Dashboard) {
    dashboard.network().into_iter().for_each(|network| note!("Network on {network}"));
}

/// Agents of real machines.
#[derive(Debug, Args)]
pub struct AgentArgs {
    /// Address at which agents of real machines connect
    #[arg(long, value_name = "ADDR:PORT", default_value_t = AgentOptions::default().listen, value_parser = parse_address)]
    pub agents: SocketAddr,
    /// Folder of the authority with which agents were enrolled, and which certifies --api; default: cotorra/agents in
    /// $XDG_CONFIG_HOME or ~/.config
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
