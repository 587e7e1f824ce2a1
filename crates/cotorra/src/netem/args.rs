//! Arguments of `cotorra netem`.

use std::time::Duration;

use clap::{ArgGroup, Args, Subcommand, ValueEnum};
use cotorra_graph::{BitRate, IpNetwork, JitterDistribution, Probability};
use cotorra_netem::{Distribution, Jitter, Loss, Rule, Side};

use crate::{
    arguments::parse_seed,
    quantity::{parse_rate, parse_share, parse_time},
};

#[derive(Debug, Subcommand)]
pub enum Netem {
    Set(SetArgs),
    Show(ShowArgs),
    Clear(ClearArgs),
}

/// Set the conditions of an interface
///
/// The options are the complete set of conditions: a condition without an option is off. An existing rule for the same
/// packets is changed in place, and no packet is lost or overtaken.
///
/// On real interfaces, loss, duplication and corruption apply to the units that the kernel hands over, which for TCP are up
/// to 64 KB. With `ethtool -K eth0 tso off gso off`, they apply to packets.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("conditions").required(true).multiple(true)),
    after_long_help = "\
Examples:
  cotorra netem set eth0 --delay 10ms --jitter 2ms --loss 1%
  cotorra netem set eth0 --delay 40ms --rate 20Mbit/s                 a slow link
  cotorra netem set eth0 --loss 1% --burst 5                          losses in bursts of 5 packets
  cotorra netem set eth0 --to 10.0.0.7 --delay 30ms                   only packets to one address
  cotorra netem set eth0 --to 10.1.0.0/16 --delay 60ms --dry-run      print the commands of tc
  cotorra netem set eth0 --ingress --loss 0.5%                        arriving packets
  cotorra netem set eth0 --ingress --from 10.0.0.7 --delay 5ms        arriving packets from one address
  cotorra netem show eth0
  cotorra netem clear eth0"
)]
pub struct SetArgs {
    #[command(flatten)]
    pub packets: PacketsArgs,
    /// Delay of each packet, such as 10ms or 250us
    #[arg(long, value_name = "DURATION", value_parser = parse_time, group = "conditions")]
    pub delay: Option<Duration>,
    /// Variation of the delay: its standard deviation, or half its width if it is uniform
    #[arg(long, value_name = "DURATION", value_parser = parse_time, requires = "delay")]
    pub jitter: Option<Duration>,
    /// Distribution of the jitter
    #[arg(long, value_name = "SHAPE", value_enum, default_value = "normal", requires = "jitter")]
    pub distribution: Shape,
    /// Share of packets that are lost, such as 1%
    #[arg(long, value_name = "SHARE", value_parser = parse_share, group = "conditions")]
    pub loss: Option<Probability>,
    /// Mean length of a burst of losses in packets, by the model of Gilbert and Elliott
    #[arg(long, value_name = "PACKETS", requires = "loss")]
    pub burst: Option<f64>,
    /// Rate at which packets leave, such as 20Mbit/s
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
    /// Maximum number of packets in the queue, including those in flight
    ///
    /// The default is 1000 packets, plus those in flight at the rate (or else 10 Gbit/s) during the delay and four
    /// deviations.
    #[arg(long, value_name = "PACKETS", value_parser = clap::value_parser!(u32).range(1..), group = "conditions")]
    pub limit: Option<u32>,
    /// Seed of everything random; needs Linux 6.7 or later
    #[arg(long, value_name = "N", value_parser = parse_seed)]
    pub seed: Option<u64>,
    /// Let jitter and a falling delay reorder packets, which is NetEm's own default
    #[arg(long)]
    pub unordered: bool,
    /// Replace an existing queueing discipline; `clear` restores it
    #[arg(long)]
    pub replace: bool,
    /// Only print what would be done, as commands of tc and ip
    #[arg(long)]
    pub dry_run: bool,
}

/// Choice of packets.
#[derive(Debug, Args)]
pub struct PacketsArgs {
    /// The interface, by its name in `ip link`
    pub interface: String,
    /// Only packets to this address or network
    #[arg(long, value_name = "ADDRESS", conflicts_with = "ingress")]
    pub to: Option<IpNetwork>,
    /// Arriving packets instead of leaving ones
    #[arg(long)]
    pub ingress: bool,
    /// Only packets that arrive from this address or network
    #[arg(long, value_name = "ADDRESS", requires = "ingress")]
    pub from: Option<IpNetwork>,
}

/// Show the conditions of interfaces, and the kernel's counters
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra netem show
  cotorra netem show eth0 --json")]
pub struct ShowArgs {
    /// The interface; default: all
    pub interface: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Remove conditions, and restore the queueing disciplines that they replaced
///
/// Without options, all conditions of the interface are removed. Packets in their queues are lost.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra netem clear eth0
  cotorra netem clear eth0 --to 10.0.0.7
  cotorra netem clear eth0 --ingress --dry-run")]
pub struct ClearArgs {
    #[command(flatten)]
    pub packets: PacketsArgs,
    /// Only print what would be done, as commands of tc and ip
    #[arg(long)]
    pub dry_run: bool,
}

/// Distributions of jitter.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum Shape {
    /// Every value is equally likely
    Uniform,
    /// Gaussian
    Normal,
    /// With a long upper tail
    Pareto,
    /// A quarter normal, three quarters Pareto
    Paretonormal,
}

impl PacketsArgs {
    /// Returns the side, and the network that packets go to or come from.
    pub fn which(&self) -> (Side, Option<IpNetwork>) {
        if self.ingress { (Side::Ingress, self.from) } else { (Side::Egress, self.to) }
    }
}

impl SetArgs {
    /// Returns the mean delay if the jitter raises it; `None` for a mixture of distributions, too.
    pub fn raised_mean(&self) -> Option<Duration> {
        let distribution = match self.distribution {
            Shape::Uniform => JitterDistribution::Uniform,
            Shape::Normal => JitterDistribution::Normal,
            Shape::Pareto => JitterDistribution::Pareto,
            Shape::Paretonormal => return None,
        };
        let jitter = cotorra_graph::Jitter { deviation: self.jitter?, distribution, ..Default::default() };
        jitter.raised_mean(self.delay.unwrap_or_default())
    }

    /// Returns the rule, or the reason why the options make none.
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
                    "{share} % cannot be lost in bursts of {burst} packets: bursts at that share are {:.3} packets or \
                     longer, and the share is below 100 %",
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
