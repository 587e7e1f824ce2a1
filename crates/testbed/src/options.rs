//! Options of a run.

use std::{
    fmt,
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
    time::Duration,
};

use cotorra_graph::IpNetwork;
use cotorra_measurements::Location;
use cotorra_netem::Confirmed;
use cotorra_plugin::runs::Runs;
use cotorra_recording::Wanted;

use crate::{
    api::{Encryption, Tokens},
    capture::CapturePlan,
    folder::manifest::Origin,
    history::previous_run::PreviousRun,
    report::Place,
};

/// Options of a run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Origin of the run, for its manifest.
    pub origin: Origin,
    /// Replaces the testbed file's seed.
    pub seed: Option<u64>,
    /// Ends the run after this duration, even if walks are not finished.
    pub until: Option<Duration>,
    /// Place of the run's folder.
    pub folder: Place,
    /// Address of the API; by default 127.0.0.1:7700, or the next free port if that is taken.
    pub api: Option<SocketAddr>,
    /// Folder of sockets through which this user's tools find the run; `None` if they need not find it.
    pub runs: Option<Runs>,
    /// Tokens of the API's callers: the operator, and orchestrators of domains.
    pub tokens: Tokens,
    /// Protection of the API on an address beyond loopback.
    pub encryption: Encryption,
    /// Whether idle cores may sleep. Packets then wait for cores to wake, and are later.
    pub save_power: bool,
    /// Networks that the WLAN Access Information Service may send notifications to, beside those of the testbed file.
    pub wais_callbacks: Vec<IpNetwork>,
    /// Replaces `history.sqlite` in the run's folder as the history.
    pub history: Option<Location>,
    /// Largest size of a history in a file, after which the run ends.
    pub history_limit: HistoryLimit,
    /// Changes to interfaces of this machine that the user confirmed, although they may do harm.
    pub interfaces: Confirmed,
    /// Recording and live viewers, beside the history.
    pub recording: Wanted,
    /// Captures of packets, in virtual time.
    pub captures: Vec<CapturePlan>,
    /// Notes of the run that this one continues, in real time.
    pub after: Option<PreviousRun>,
    /// Address and authority for agents.
    pub agents: AgentOptions,
}

/// Address and authority of a run for its agents.
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

/// Largest size of a history in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HistoryLimit {
    pub(crate) bytes: u64,
}

impl HistoryLimit {
    /// Creates a limit of so many bytes.
    pub const fn of_bytes(bytes: u64) -> Self {
        Self { bytes }
    }
}

impl Default for HistoryLimit {
    /// 4 GB, which is several days of a testbed with a few robots.
    fn default() -> Self {
        Self::of_bytes(4_000_000_000)
    }
}

impl fmt::Display for HistoryLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.bytes {
            bytes if bytes >= 1_000_000_000 => write!(f, "{} GB", bytes as f64 / 1e9),
            bytes => write!(f, "{} MB", bytes as f64 / 1e6),
        }
    }
}
