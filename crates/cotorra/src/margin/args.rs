//! Arguments of `cotorra margin`.

use std::{num::NonZero, path::PathBuf, time::Duration};

use clap::{
    Args,
    builder::{PossibleValuesParser, TypedValueParser},
};
use cotorra_experiments::margin::Kind;
use cotorra_graph::Probability;
use cotorra_testbed_file::Setting;

use crate::{
    approval::TrustArgs,
    arguments::parse_seed,
    duration::parse_duration,
    quantity::{parse_share, parse_time},
};

/// Find the smallest change that breaks a target, or compare decisions of plug-ins with their alternatives
///
/// Runs a testbed in virtual time with more delay on each link, more loss, servers that answer later, and each radio unit
/// down. Delays are also tried with each radio unit down that the target survives. A target is broken if less than --keep of
/// a service's samples is within it, over all seeds, or if a walk does not end. Each search tries --most first, and then
/// halves the interval down to --resolution.
///
/// With --decision, it repeats one run instead, takes each alternative at a decision of a plug-in (another radio unit in
/// range, another node, or no change), and goes on with the same random streams. The regret is what the best alternative
/// keeps, less what the decision kept. One seed does not show whether that is chance. With --seeds, the differences of
/// several seeds have intervals, and probabilities that are corrected for the number of alternatives.
///
/// Each run is saved as soon as it is done. If the command is stopped, the same command resumes it. It leaves margins.csv
/// and margins.json, or decisions.csv and decisions.json. docs/use/margin.md explains them.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra margin testbeds/aisle.yaml --kpi navigation --keep 0.9
  cotorra margin testbeds/corridor.yaml --set plugin=okpi --seeds 3 --dry-run
  cotorra margin testbeds/corridor.yaml --set plugin=okpi --change delay --on lan-edge --most 20ms
  cotorra margin testbeds/corridor.yaml --decision all
  cotorra margin testbeds/corridor.yaml --set plugin=okpi --decision 8 --seeds 10
  cotorra margin testbeds/corridor.yaml --decision 3 --hold 10s")]
pub struct MarginArgs {
    /// The testbed file
    pub file: PathBuf,
    /// Service whose target counts; can be given several times; default: all that have samples
    #[arg(long, value_name = "SERVICE")]
    pub kpi: Vec<String>,
    /// Share of a service's samples that must be within its target
    #[arg(long, value_name = "SHARE", default_value = "0.99", value_parser = parse_keep)]
    pub keep: f64,
    /// Override a value of the file, as in plugin=okpi; can be given several times
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub settings: Vec<Setting>,
    /// Seed of the first run; default: the file's
    #[arg(long, value_name = "N", value_parser = parse_seed)]
    pub seed: Option<u64>,
    /// Number of seeds of each change or decision, counted up from the first
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub seeds: u32,
    /// End each run after this time, such as 60s or 2min; default: twice the time of the unchanged run
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub until: Option<Duration>,
    /// Kinds of changes to try; answers: servers that answer later, down: radio units; default: all
    #[arg(long = "change", value_name = "KINDS", value_delimiter = ',', value_parser = kinds())]
    pub kinds: Vec<Kind>,
    /// Link, wireless network, server or radio unit to change; can be given several times; default: all
    #[arg(long, value_name = "NAME")]
    pub on: Vec<String>,
    /// Largest extra delay of a link or on the air, in each direction, and of a server's answers
    #[arg(long, value_name = "DURATION", default_value = "100ms", value_parser = parse_time)]
    pub most: Duration,
    /// Resolution of delays
    #[arg(long, value_name = "DURATION", default_value = "0.1ms", value_parser = parse_time)]
    pub resolution: Duration,
    /// Largest extra loss of a link or on the air, in each direction
    #[arg(long, value_name = "SHARE", default_value = "10%", value_parser = parse_share)]
    pub most_loss: Probability,
    /// Resolution of losses; 0.0001% at least
    #[arg(long, value_name = "SHARE", default_value = "0.1%", value_parser = parse_share)]
    pub loss_resolution: Probability,
    /// Do not try delays with a radio unit down
    #[arg(long)]
    pub singles: bool,
    /// Compare a decision of a plug-in with its alternatives: its number in the run, from 1, or `all`
    #[arg(long, value_name = "N|all", value_parser = parse_decision,
        conflicts_with_all = ["keep", "kinds", "on", "most", "resolution", "most_loss", "loss_resolution", "singles"])]
    pub decision: Option<WhichDecision>,
    /// Reject further decisions about the same robot or VNF for this long; default: until the next one in the run
    #[arg(long, value_name = "DURATION", value_parser = parse_duration, requires = "decision")]
    pub hold: Option<Duration>,
    /// Number of runs at a time; default: the number of CPUs
    #[arg(short, long, value_name = "N")]
    pub jobs: Option<NonZero<usize>>,
    /// Folder of the results; default: one under margins/ that is named after the testbed
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Discard the runs that the folder has
    #[arg(long)]
    pub fresh: bool,
    /// Write plain lines instead of a progress bar
    #[arg(long)]
    pub headless: bool,
    /// Only list what would be tried, and the number of runs
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub trust: TrustArgs,
    /// The words of the command line that have a part in results, for their manifest.
    #[arg(skip)]
    pub given: Vec<String>,
}

/// A decision, or all of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhichDecision {
    All,
    Number(NonZero<usize>),
}

fn parse_decision(text: &str) -> Result<WhichDecision, String> {
    match text {
        "all" => Ok(WhichDecision::All),
        number => {
            let number = number.parse().map_err(|_| "write a whole number from 1, or `all`".to_owned())?;
            Ok(WhichDecision::Number(number))
        }
    }
}

fn parse_keep(text: &str) -> Result<f64, String> {
    let keep: Option<f64> = text.parse().ok();
    let keep = keep.filter(|keep| *keep > 0.0 && *keep <= 1.0);
    keep.ok_or_else(|| "write a share above 0 and 1 at most, as in 0.99".to_owned())
}

fn kinds() -> impl TypedValueParser<Value = Kind> {
    let names = Kind::ALL.map(|(name, _)| name);
    PossibleValuesParser::new(names).map(|name| {
        let kind = Kind::ALL.into_iter().find(|(known, _)| *known == name);
        kind.expect("the parser knows these names only").1
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decisions_are_numbers_from_1_or_all() {
        assert_eq!(parse_decision("all"), Ok(WhichDecision::All));
        assert_eq!(parse_decision("3"), Ok(WhichDecision::Number(NonZero::new(3).unwrap())));
        for wrong in ["0", "-1", "first", ""] {
            assert!(parse_decision(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_share_to_keep_is_above_0_and_1_at_most() {
        assert_eq!(parse_keep("0.99"), Ok(0.99));
        assert_eq!(parse_keep("1"), Ok(1.0));
        for wrong in ["0", "1.01", "99", "99%", "nan", ""] {
            assert!(parse_keep(wrong).is_err(), "{wrong}");
        }
    }
}
