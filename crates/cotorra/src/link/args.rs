//! Arguments of `cotorra link`.

use std::{path::PathBuf, time::Duration};

use clap::{ArgGroup, Args, Subcommand, ValueEnum};
use cotorra_graph::{
    BitRate, ConditionChange, Correlation, CorrelationTime, Direction, Jitter, LinkId, Loss, Probability,
    Rate, ThroughputTest,
};

use crate::{
    duration::parse_duration,
    quantity::{parse_correlation, parse_correlation_time, parse_rate, parse_share, parse_time},
    running::WhichRun,
};

#[derive(Debug, Subcommand)]
pub enum Link {
    Show(ShowArgs),
    Set(SetArgs),
    Test(TestArgs),
}

/// Show the delay and throughput of links, their conditions, and results of probes and tests
///
/// → is the forward direction, from a link's first end to its second. d and λ are of the last second, by all packets.
/// --figures shows what decisions count with: d as configured and as measured, by probes that are not older than 10 s, else by
/// packets; λ as configured, as measured, and what is left. Each measured delay has its age.
/// --json has both, and more, such as the age of each result.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra link show
  cotorra link show lan-cloud --json
  cotorra link show --figures                               configured, measured and available
  cotorra link show --run corridor                          one of several runs
  cotorra link show --run https://lab:7700 --ca ca.pem      one of another machine, by the certificate that it printed")]
pub struct ShowArgs {
    /// The link; default: all links
    pub link: Option<LinkId>,
    /// Print JSON, with times in milliseconds
    #[arg(long)]
    pub json: bool,
    /// Show configured, measured and available figures
    #[arg(long, conflicts_with = "json")]
    pub figures: bool,
    #[command(flatten)]
    pub api: ApiArgs,
}

/// Change the conditions of a link, in one direction or both
///
/// Conditions without an option stay as they are. The scales multiply the current delay and divide the current rate.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("change").required(true).multiple(true)),
    after_long_help = "\
Examples:
  cotorra link set lan-cloud --delay 40ms --rate 20Mbit/s
  cotorra link set lan-cloud --delay-scale 2 --drop-scale 4     twice the delay, a quarter of the rate
  cotorra link set lan-cloud --direction backward --loss 1% --burst 5
  cotorra link set lan-cloud --jitter 2ms --jitter-correlation 40%"
)]
pub struct SetArgs {
    /// The link
    pub link: LinkId,
    /// One direction; default: both
    #[arg(long, value_enum)]
    pub direction: Option<Way>,
    /// Delay, such as 10ms or 250us
    #[arg(long, value_name = "DURATION", value_parser = parse_time, group = "change")]
    delay: Option<Duration>,
    /// Standard deviation of the normally distributed delay; 0ms for none
    #[arg(long, value_name = "DURATION", value_parser = parse_time, group = "change")]
    jitter: Option<Duration>,
    /// Correlation of the jitter of packets that follow each other, such as 40%
    #[arg(long, value_name = "SHARE", value_parser = parse_correlation, requires = "jitter", allow_hyphen_values = true)]
    jitter_correlation: Option<Correlation>,
    /// Time over which the jitter changes, whatever is sent, such as 50ms
    #[arg(long, value_name = "DURATION", value_parser = parse_correlation_time, requires = "jitter", conflicts_with = "jitter_correlation")]
    jitter_over: Option<CorrelationTime>,
    /// Share of packets that are lost, such as 1%
    #[arg(long, value_name = "SHARE", value_parser = parse_share, group = "change")]
    loss: Option<Probability>,
    /// Mean length of a burst of losses, in packets
    #[arg(long, value_name = "PACKETS", requires = "loss")]
    burst: Option<f64>,
    /// Rate, such as 20Mbit/s
    #[arg(long, value_name = "RATE", value_parser = parse_rate, group = "change")]
    rate: Option<BitRate>,
    /// ψ: multiplies the delay
    #[arg(long, value_name = "NUMBER", group = "change")]
    delay_scale: Option<f64>,
    /// δ: divides the throughput
    #[arg(long, value_name = "NUMBER", group = "change")]
    drop_scale: Option<f64>,
    #[command(flatten)]
    pub api: ApiArgs,
}

/// Test the throughput of a wired link, by packets that cross it
///
/// The test shares the link with all other packets. It is limited to 10 s and 1 Gbit/s, and to one test of a direction at a
/// time. After a test, the direction rests for four times its duration. A link that carries every packet of the test may
/// carry more.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra link test lan-cloud
  cotorra link test lan-cloud --direction backward --duration 3s --rate-limit 5Mbit/s")]
pub struct TestArgs {
    /// The link
    pub link: LinkId,
    /// The direction
    #[arg(long, value_enum, default_value = "forward")]
    pub direction: Way,
    /// Duration of the test: 10ms to 10s
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = parse_duration)]
    pub duration: Duration,
    /// Rate of the test; default: a tenth above the rate that is set for the link
    #[arg(long, value_name = "RATE", value_parser = parse_rate)]
    rate_limit: Option<BitRate>,
    #[command(flatten)]
    pub api: ApiArgs,
}

/// Choice of a run, which may be on another machine.
#[derive(Debug, Args)]
pub struct ApiArgs {
    #[command(flatten)]
    pub run: WhichRun,
    /// Certificate of the authority by which an https address in --run is known; the run prints its file
    #[arg(long, value_name = "FILE", env = "COTORRA_CA")]
    pub ca: Option<PathBuf>,
    /// Trust the program on the http address in --run, as on another machine, and send it the token in COTORRA_TOKEN
    ///
    /// Its identity is not verified, and the connection is not encrypted.
    #[arg(long, requires = "run")]
    pub unverified: bool,
}

/// A direction of a link.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum Way {
    /// From its first end to its second
    Forward,
    /// From its second end to its first
    Backward,
}

impl From<Way> for Direction {
    fn from(way: Way) -> Self {
        match way {
            Way::Forward => Self::Forward,
            Way::Backward => Self::Backward,
        }
    }
}

impl SetArgs {
    /// Returns the change. The testbed decides whether it is valid.
    pub fn change(&self) -> ConditionChange {
        let loss = |rate: Probability| match self.burst {
            _ if rate == Probability::ZERO => Loss::None,
            None => Loss::Independent { rate },
            Some(mean_burst) => Loss::Bursty { rate, mean_burst },
        };
        ConditionChange {
            delay_ms: self.delay.map(|delay| delay.as_secs_f64() * 1e3),
            jitter: self.jitter.map(|deviation| Jitter {
                deviation,
                correlation: self.jitter_correlation.unwrap_or_default(),
                over: self.jitter_over,
                ..Jitter::default()
            }),
            loss: self.loss.map(loss),
            rate: self.rate.map(|bits_per_second| Rate::Fixed { bits_per_second }),
            delay_scale: self.delay_scale,
            drop_scale: self.drop_scale,
            ..ConditionChange::default()
        }
    }
}

impl TestArgs {
    /// Returns the test. The testbed decides whether it is valid.
    pub fn test(&self) -> ThroughputTest {
        ThroughputTest { duration: self.duration, rate_limit: self.rate_limit }
    }
}
