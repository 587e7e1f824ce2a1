//! What can be typed behind `cotorra netem`.

use std::time::Duration;

use clap::{ArgGroup, Args, Subcommand, ValueEnum};
use cotorra_graph::{BitRate, Probability};
use cotorra_netem::{Distribution, Jitter, Loss, Network, Rule, Side};

use crate::quantity::{parse_rate, parse_share, parse_time};

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Netem {
    Set(SetArgs),
    Show(ShowArgs),
    Clear(ClearArgs),
}

/// Say what happens to packets of an interface
///
/// Whatever is not said does not happen: the options are the whole of it. Where a rule for the same packets is there
/// already, it is changed in place, and no packet is lost or overtaken.
///
/// On real interfaces loss, duplication and corruption count what the kernel hands over in one piece, which for TCP is up
/// to 64 KB: `ethtool -K eth0 tso off gso off` lets them count packets.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("conditions").required(true).multiple(true)),
    after_long_help = "\
Examples:
  cotorra netem set eth0 --delay 10ms --jitter 2ms --loss 1%
  cotorra netem set eth0 --delay 40ms --rate 20Mbit/s                 a slow link
  cotorra netem set eth0 --loss 1% --burst 5                          losses in bursts of 5 packets
  cotorra netem set eth0 --to 10.0.0.7 --delay 30ms                   only what goes to one address
  cotorra netem set eth0 --to 10.1.0.0/16 --delay 60ms --dry-run      what would be done, in the words of tc
  cotorra netem set eth0 --ingress --loss 0.5%                        what arrives
  cotorra netem set eth0 --ingress --from 10.0.0.7 --delay 5ms        what arrives from one address
  cotorra netem show eth0
  cotorra netem clear eth0"
)]
pub struct SetArgs {
    #[command(flatten)]
    pub packets: PacketsArgs,
    /// What each packet waits, such as 10ms or 250us
    #[arg(long, value_name = "DURATION", value_parser = parse_time, group = "conditions")]
    pub delay: Option<Duration>,
    /// What it waits more or less: standard deviation, or half the width if it is uniform
    #[arg(long, value_name = "DURATION", value_parser = parse_time, requires = "delay")]
    pub jitter: Option<Duration>,
    /// The jitter's shape
    #[arg(long, value_name = "SHAPE", value_enum, default_value = "normal", requires = "jitter")]
    pub distribution: Shape,
    /// Share of packets that vanish, such as 1%
    #[arg(long, value_name = "SHARE", value_parser = parse_share, group = "conditions")]
    pub loss: Option<Probability>,
    /// Lose so many packets in a row on average, by the model of Gilbert and Elliott
    #[arg(long, value_name = "PACKETS", requires = "loss")]
    pub burst: Option<f64>,
    /// How fast packets leave, such as 20Mbit/s
    #[arg(long, value_name = "RATE", value_parser = parse_rate, group = "conditions")]
    pub rate: Option<BitRate>,
    /// Share of packets that arrive twice
    #[arg(long, value_name = "SHARE", value_parser = parse_share, group = "conditions")]
    pub duplicate: Option<Probability>,
    /// Share of packets in which one bit is flipped
    #[arg(long, value_name = "SHARE", value_parser = parse_share, group = "conditions")]
    pub corrupt: Option<Probability>,
    /// Share of packets that skip the delay, and so overtake others
    #[arg(long, value_name = "SHARE", value_parser = parse_share, requires = "delay")]
    pub reorder: Option<Probability>,
    /// Most packets that wait, those in flight included
    ///
    /// Without it, as many as are in flight at the rate (10 Gbit/s without one) during delay and four deviations, and 1000
    /// that queue.
    #[arg(long, value_name = "PACKETS", value_parser = clap::value_parser!(u32).range(1..), group = "conditions")]
    pub limit: Option<u32>,
    /// Seed of everything random; Linux 6.7 and later
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Let jitter and a delay that falls reorder packets, as NetEm does by itself
    #[arg(long)]
    pub unordered: bool,
    /// Take the place of a queueing discipline that somebody put there; `clear` puts it back
    #[arg(long)]
    pub replace: bool,
    /// Only say what would be done, in the words of tc and ip
    #[arg(long)]
    pub dry_run: bool,
}

/// Which packets.
#[derive(Debug, Args)]
pub struct PacketsArgs {
    /// The interface, as `ip link` names it.
    pub interface: String,
    /// Only what goes to this address or network
    #[arg(long, value_name = "ADDRESS", conflicts_with = "ingress")]
    pub to: Option<Network>,
    /// What arrives, in place of what leaves
    #[arg(long)]
    pub ingress: bool,
    /// Only what arrives from this address or network
    #[arg(long, value_name = "ADDRESS", requires = "ingress")]
    pub from: Option<Network>,
}

/// Show what happens to packets, and what the kernel counted
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra netem show
  cotorra netem show eth0 --json")]
pub struct ShowArgs {
    /// The interface; without it, all.
    pub interface: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Take conditions away, and put back what they replaced
///
/// Without options, all conditions of the interface. What waits in their queues is lost.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra netem clear eth0
  cotorra netem clear eth0 --to 10.0.0.7
  cotorra netem clear eth0 --ingress --dry-run")]
pub struct ClearArgs {
    #[command(flatten)]
    pub packets: PacketsArgs,
    /// Only say what would be done, in the words of tc and ip
    #[arg(long)]
    pub dry_run: bool,
}

/// Shapes of jitter.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum Shape {
    /// Every value as likely
    Uniform,
    /// Gaussian
    Normal,
    /// With a long upper tail
    Pareto,
    /// A quarter normal, three quarters Pareto
    Paretonormal,
}

impl PacketsArgs {
    /// Those that leave or arrive, and the network to which or from which.
    pub fn which(&self) -> (Side, Option<Network>) {
        if self.ingress { (Side::Ingress, self.from) } else { (Side::Egress, self.to) }
    }
}

impl SetArgs {
    /// The rule; the error says why there is none.
    pub fn rule(&self) -> Result<Rule, String> {
        let distribution = match self.distribution {
            Shape::Uniform => Distribution::Uniform,
            Shape::Normal => Distribution::Normal,
            Shape::Pareto => Distribution::Pareto,
            Shape::Paretonormal => Distribution::ParetoNormal,
        };
        let jitter = self.jitter.filter(|deviation| !deviation.is_zero());
        let loss = match (self.loss, self.burst) {
            (None, _) => Loss::None,
            (Some(rate), None) => Loss::Independent { rate },
            (Some(rate), Some(burst)) => Loss::bursty(rate, burst).ok_or_else(|| {
                let share = rate.get() * 100.0;
                format!(
                    "{share} % cannot be lost in bursts of {burst} packets: bursts are {:.3} packets or longer then, and \
                     not all is lost",
                    (rate.get() / (1.0 - rate.get())).max(1.0)
                )
            })?,
        };
        let (side, network) = self.packets.which();
        let netem = cotorra_netem::Netem {
            delay: self.delay.unwrap_or_default(),
            jitter: jitter.map(|deviation| Jitter { deviation, distribution: Some(distribution) }),
            loss,
            duplication: self.duplicate.unwrap_or_default(),
            corruption: self.corrupt.unwrap_or_default(),
            reordering: self.reorder.unwrap_or_default(),
            rate: self.rate,
            limit: self.limit,
            seed: self.seed,
            in_order: !self.unordered,
        };
        Ok(Rule { side, network, netem })
    }
}
