//! One end of a measurement through a peer: `cotorra-lab probe`, which a benchmark starts inside rattan.

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
    time::Duration,
};

use clap::Subcommand;
use cotorra::print;
use miette::IntoDiagnostic;

use super::emulator::{Percentiles, round_trips, send};

/// Port of the other end.
pub const PORT: u16 = 7711;

/// Ends of measurements.
#[derive(Debug, Clone, Copy, Subcommand)]
pub enum Probe {
    /// Measure round trips to an echo, less twice the delay; prints median, 99th percentile and maximum in ns.
    RoundTrips {
        one_way_us: u64,
        count: usize,
        /// Address of the far side, which rattan puts into the environment.
        #[arg(long, env = "RATTAN_BASE")]
        to: IpAddr,
    },
    /// Send over TCP until the other side has enough.
    Send {
        /// Address of the far side, which rattan puts into the environment.
        #[arg(long, env = "RATTAN_BASE")]
        to: IpAddr,
    },
}

/// Runs one end of a measurement, and prints its result.
pub fn probe(probe: &Probe) -> miette::Result<()> {
    match *probe {
        Probe::RoundTrips { to, one_way_us, count } => {
            let client = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).into_diagnostic()?;
            client.set_read_timeout(Some(Duration::from_secs(1))).into_diagnostic()?;
            let (to, one_way) = (SocketAddr::new(to, PORT), Duration::from_micros(one_way_us));
            let Percentiles { p50, p99, max } = round_trips(&client, to, one_way, count).into_diagnostic()?;
            print(&format!("{} {} {}\n", p50.as_nanos(), p99.as_nanos(), max.as_nanos()))
        }
        Probe::Send { to } => send(SocketAddr::new(to, PORT)).into_diagnostic(),
    }
}
