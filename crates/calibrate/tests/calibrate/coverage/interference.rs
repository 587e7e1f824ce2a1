//! Channels on which another network comes and goes, or is always there.

use std::{collections::BTreeMap, path::Path};

use cotorra_calibrate::{ChannelSurvey, Counters, MeasuredChannel, fit_interference};
use cotorra_numbers::Draws;

use super::{Coverage, between, sites};

const TESTBED: &str = "name: lab
wireless: { lab: {} }
nodes:
  R: { kind: radio_unit, position: [0, 0], channel: 1 }
";
/// Seconds of a survey, with a reading each.
const SECONDS: usize = 1800;

/// Returns counters of a channel with frames of 2 ms at random, for a load, while others are there. They arrive and depart in
/// continuous time.
fn survey(load: f64, presence: Option<[f64; 2]>, draws: &mut Draws) -> ChannelSurvey {
    const FRAME_S: f64 = 0.002;
    let exponential = |draws: &mut Draws, mean: f64| -mean * (1.0 - draws.unit()).ln();
    let mut there = presence.is_none_or(|[on, off]| draws.unit() < on / (on + off));
    let time = |there: bool, draws: &mut Draws| match presence {
        None => f64::INFINITY,
        Some([on, off]) => exponential(draws, if there { on } else { off }),
    };
    let mut changes = time(there, draws);
    let mut busy_s = [0.0; SECONDS];
    let mut now = exponential(draws, FRAME_S / load);
    while now < SECONDS as f64 {
        while changes < now {
            there = !there;
            changes += time(there, draws);
        }
        if there {
            busy_s[now as usize] += FRAME_S;
        }
        now += exponential(draws, FRAME_S / load);
    }
    let mut sum = Counters { transmit: Some(0.0), own_receive: Some(0.0), ..Counters::default() };
    let mut counters = vec![sum];
    for busy in busy_s {
        sum.active += 1000.0;
        sum.busy += (busy * 1000.0).min(1000.0);
        counters.push(sum);
    }
    ChannelSurvey(BTreeMap::from([(MeasuredChannel::Number(1), counters)]))
}

#[test]
fn interference_intervals_hold_the_true_values() {
    let parsed = cotorra_testbed_file::parse("lab", TESTBED, Path::new(""));
    let testbed = parsed.unwrap_or_else(|wrong| panic!("{wrong}"));
    let mut coverage = Coverage::default();
    for seed in 0..sites() as u64 {
        let draws = &mut Draws::new(seed, "channel");
        let load = between(draws, [0.05, 0.6]);
        let fit = fit_interference(&testbed, "R", &survey(load, None, draws), seed).unwrap();
        assert_eq!(fit.presence, None);
        coverage.count("load that is always there", fit.load, load);
        let times = [between(draws, [10.0, 40.0]), between(draws, [10.0, 60.0])];
        let fit = fit_interference(&testbed, "R", &survey(load, Some(times), draws), seed).unwrap();
        coverage.count("load that comes and goes", fit.load, load);
        let presence = fit.presence.unwrap();
        coverage.count("time that others are there", presence.on_s, times[0]);
        coverage.count("time that others are away", presence.off_s, times[1]);
    }
    coverage.check();
}
