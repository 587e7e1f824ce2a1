//! Options for a run's agents.

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
};

/// Where agents connect to a run.
#[derive(Debug, Clone)]
pub struct AgentOptions {
    /// Address at which the core listens.
    pub listen: SocketAddr,
    /// Folder of the authority with which agents are enrolled.
    pub authority: Option<PathBuf>,
}

impl AgentOptions {
    /// Port at which the core listens.
    pub const PORT: u16 = 7448;
}

impl Default for AgentOptions {
    fn default() -> Self {
        Self { listen: SocketAddr::new(Ipv4Addr::UNSPECIFIED.into(), Self::PORT), authority: None }
    }
}
