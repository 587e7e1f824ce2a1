//! Interference by other networks, fitted to how long a channel was busy.

mod channel_survey;

use cotorra_graph::{NodeKind, Testbed};
use cotorra_numbers::{Draws, Resampler};
use serde::Serialize;

pub use self::channel_survey::{ChannelSurvey, Counters, MeasuredChannel, parse_channel_survey};
use crate::{
    error::CalibrateError, estimate::Estimate, matched::RESAMPLES, settings::FittedSetting,
    survey::radio_unit, times::middle,
};

/// Fewest differences of counters.
const LEAST_STEPS: usize = 60;
/// Share of steps at which counters may fall, as when a driver starts again.
const MOST_FALLS: f64 = 0.1;
/// A smaller share of the time is no interference.
const LEAST_LOAD: f64 = 0.001;
/// Fewest arrivals, and departures, that determine a presence.
const LEAST_CHANGES: usize = 10;
/// Levels of two states are so many deviations apart at least. Halves of a normal distribution are 2.6 apart.
const LEAST_APART: f64 = 4.0;

/// Times for which others are there and away.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PresenceFit {
    /// Mean time for which they are there, s.
    pub on_s: Estimate,
    /// Mean time for which they are away, s.
    pub off_s: Estimate,
    /// Share of the time that is busy while they are away.
    pub background: Estimate,
}

/// Interference on the channel of a radio unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InterferenceFit {
    /// Network of the radio unit.
    pub network: String,
    /// Number of its channel.
    pub channel: u8,
    /// Number of differences of counters that were fitted.
    pub steps: usize,
    /// Time on the channel, s.
    pub seconds: f64,
    /// Share of the time that others take while they are there, the background included.
    pub load: Estimate,
    /// When they are there; `None` if that is always, or not known.
    pub presence: Option<PresenceFit>,
    /// Notes on the fit, for people.
    pub notes: Vec<String>,
}

impl InterferenceFit {
    /// Returns the load that is always there, and the one that comes and goes. A load that is too small is left out.
    pub(crate) fn loads(&self) -> [Option<f64>; 2] {
        let loads = match &self.presence {
            None => [self.load.value, 0.0],
            Some(presence) => [presence.background.value, self.load.value - presence.background.value],
        };
        loads.map(|load| (load >= LEAST_LOAD).then_some(load.min(1.0)))
    }
}

/// Fits what others send on the channel of a radio unit. The seed decides resamples.
///
/// The share of the time that is busy by others is what was busy, less transmissions and receptions of its own. If it has two
/// levels that are far apart, others come and go: a Markov chain in continuous time, whose rates follow from the counted
/// transitions between steps.
///
/// # Errors
/// [`CalibrateError::Unsuited`] if the radio unit is not in the testbed, has no position, or its channel was not measured, and
/// [`CalibrateError::TooLittle`] with too few counters, or counters that are no sums.
pub fn fit_interference(
    testbed: &Testbed,
    name: &str,
    survey: &ChannelSurvey,
    seed: u64,
) -> Result<InterferenceFit, CalibrateError> {
    let (unit, _) = radio_unit(testbed, name)?;
    let wireless = &testbed.graph.wireless[&unit.network];
    let own = survey.0.iter().find(|(channel, _)| channel.is(wireless.standard, unit.channel));
    let (_, counters) = own.ok_or_else(|| {
        let all: Vec<_> = survey.0.keys().map(ToString::to_string).collect();
        CalibrateError::unsuited(format!(
            "radio unit `{name}` is on channel {}, but its channel survey has {}",
            unit.channel,
            all.join(", ")
        ))
    })?;
    check_sharing(testbed, name, &unit.network, unit.channel)?;
    let (steps, mut notes) = steps(name, counters)?;
    let draws = &mut Draws::new(seed, &format!("calibrate interference {name}"));
    let (load, presence) = match presence(&steps, draws) {
        Ok(found) => (found.0, Some(found.1)),
        Err(reason) => {
            notes.push(format!("others are always there: {reason}"));
            (mean(&steps, draws), None)
        }
    };
    notes.push(format!(
        "a channel survey does not tell where others are: they are put at `{name}`, where it hears them best"
    ));
    if wireless
        .access
        .interference()
        .iter()
        .any(|other| other.channel == unit.channel && !is_of(&other.name, name))
    {
        notes.push(format!(
            "the testbed has other interference on channel {}, which adds to this: remove it",
            unit.channel
        ));
    }
    let fit = InterferenceFit {
        network: unit.network.clone(),
        channel: unit.channel,
        steps: steps.len(),
        seconds: steps.iter().map(|step| step.seconds).sum(),
        load,
        presence,
        notes,
    };
    Ok(match fit.loads() {
        [None, None] => {
            InterferenceFit { notes: vec!["nothing else was heard, so nothing is set".to_owned()], ..fit }
        }
        _ => fit,
    })
}

/// Returns the settings of a fit: an interferer that is always there, one that comes and goes, or both, at the radio unit.
pub(crate) fn settings(testbed: &Testbed, radio_unit: &str, fit: &InterferenceFit) -> Vec<FittedSetting> {
    let position = testbed.graph.radio_units().find(|(node, _)| node.id.as_str() == radio_unit);
    let Some(at) = position.and_then(|(node, _)| node.position) else { return Vec::new() };
    let position =
        if at.z == 0.0 { format!("[{}, {}]", at.x, at.y) } else { format!("[{}, {}, {}]", at.x, at.y, at.z) };
    let percent = |share: f64| format!("{:.2} %", share * 100.0);
    let [always, at_times] = fit.loads();
    let [always_name, at_times_name] = names(radio_unit);
    let mut settings = Vec::new();
    let mut set = |name: String, load: f64, presence: String, note: String| {
        settings.push(FittedSetting {
            path: format!("wireless.{}.interference.{name}", fit.network),
            value: format!(
                "{{ kind: network, channel: {}, position: {position}, load: {}{presence} }}",
                fit.channel,
                percent(load)
            ),
            note,
        });
    };
    let load = format!("load by others {:.1} %", fit.load.scaled(100.0));
    match &fit.presence {
        None => {
            always.into_iter().for_each(|share| set(always_name.clone(), share, String::new(), load.clone()))
        }
        Some(presence) => {
            if let Some(share) = always {
                let background =
                    format!("load while others are away {:.1} %", presence.background.scaled(100.0));
                set(always_name, share, String::new(), background);
            }
            if let Some(share) = at_times {
                let times = format!(
                    ", presence: {{ on: {:.3} s, off: {:.3} s }}",
                    presence.on_s.value, presence.off_s.value
                );
                let note =
                    format!("{load}, there for {:.1} s, away for {:.1} s", presence.on_s, presence.off_s);
                set(at_times_name, share, times, note);
            }
        }
    }
    if !settings.is_empty() && !testbed.graph.wireless[&fit.network].access.contends() {
        settings.push(FittedSetting {
            path: format!("wireless.{}.access", fit.network),
            value: "edca".to_owned(),
            note: "interference needs stations that sense the channel".to_owned(),
        });
    }
    settings
}

/// Returns the names of the interferer that is always there, and of the one that comes and goes.
pub(crate) fn names(radio_unit: &str) -> [String; 2] {
    [format!("around-{radio_unit}"), format!("at-times-around-{radio_unit}")]
}

fn is_of(interferer: &str, radio_unit: &str) -> bool {
    names(radio_unit).iter().any(|name| name == interferer)
}

/// Rejects a channel that is shared with a network whose senders take turns, if this one will contend.
fn check_sharing(testbed: &Testbed, name: &str, network: &str, channel: u8) -> Result<(), CalibrateError> {
    if testbed.graph.wireless[network].access.contends() {
        return Ok(());
    }
    let frequencies = |of: &str| -> Vec<u16> {
        let channels = testbed.graph.nodes.iter().filter_map(|node| match &node.kind {
            NodeKind::RadioUnit(unit) if unit.network == of => Some(unit.channel),
            _ => None,
        });
        channels.map(|channel| testbed.graph.wireless[of].standard.frequency_mhz(channel)).collect()
    };
    let own = frequencies(network);
    let shares =
        |other: &&String| other.as_str() != network && frequencies(other).iter().any(|mhz| own.contains(mhz));
    match testbed.graph.wireless.keys().find(shares) {
        None => Ok(()),
        Some(other) => Err(CalibrateError::unsuited(format!(
            "radio unit `{name}` is on channel {channel}, and its network `{network}` shares a channel with `{other}`: interference \
             needs stations that sense the channel, so leave `access: turns` out of both"
        ))),
    }
}

/// Time between two readings of counters.
#[derive(Debug, Clone, Copy)]
struct Step {
    seconds: f64,
    /// Share that was busy by others.
    busy: f64,
}

/// Returns the differences of counters, with notes.
fn steps(name: &str, counters: &[Counters]) -> Result<(Vec<Step>, Vec<String>), CalibrateError> {
    let mut steps = Vec::new();
    let mut falls = 0;
    for pair in counters.windows(2) {
        let [before, after] = pair else { continue };
        let active = after.active - before.active;
        let since = |of: fn(&Counters) -> Option<f64>| {
            of(before).zip(of(after)).map_or(0.0, |(before, after)| (after - before).max(0.0))
        };
        let busy = after.busy - before.busy;
        if active < 0.0 || busy < 0.0 {
            falls += 1;
        } else if active > 0.0 {
            let others = busy - since(|c| c.transmit) - since(|c| c.own_receive);
            steps.push(Step { seconds: active / 1e3, busy: (others / active).clamp(0.0, 1.0) });
        }
    }
    if falls as f64 > MOST_FALLS * counters.len() as f64 {
        return Err(CalibrateError::too_little(format!(
            "the counters of radio unit `{name}` fell {falls} times: the driver seems to clear them, so write their sums as CSV"
        )));
    }
    if steps.len() < LEAST_STEPS {
        return Err(CalibrateError::too_little(format!(
            "radio unit `{name}` has {} differences of counters: a fit needs {LEAST_STEPS} or more",
            steps.len()
        )));
    }
    let mut notes = Vec::new();
    let lacks = |of: fn(&Counters) -> Option<f64>| counters.iter().any(|c| of(c).is_none());
    if lacks(|c| c.transmit) {
        notes.push("its own transmissions were not counted, and are a part of the load".to_owned());
    }
    if lacks(|c| c.own_receive) {
        notes.push("frames of its own stations were not counted, and are a part of the load".to_owned());
    }
    Ok((steps, notes))
}

/// Returns the mean share of steps, 1 or more, with an interval by the stationary bootstrap.
fn mean(steps: &[Step], draws: &mut Draws) -> Estimate {
    let shares: Vec<f64> = steps.iter().map(|step| step.busy).collect();
    let resampler = Resampler::new(&shares);
    let mut drawn: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let (mut busy, mut seconds) = (0.0, 0.0);
            resampler.resample(draws, |i| {
                busy += steps[i].busy * steps[i].seconds;
                seconds += steps[i].seconds;
            });
            busy / seconds
        })
        .collect();
    let [busy, seconds] =
        steps.iter().fold([0.0; 2], |[busy, s], step| [busy + step.busy * step.seconds, s + step.seconds]);
    Estimate::around(busy / seconds, &mut drawn)
}

/// Fits a presence: the load, and when it is there. Otherwise, it returns why the steps do not determine it.
fn presence(steps: &[Step], draws: &mut Draws) -> Result<(Estimate, PresenceFit), String> {
    let usual = middle(steps.iter().map(|step| step.seconds).collect()).unwrap_or_default();
    let threshold = threshold(steps);
    let on: Vec<bool> = steps.iter().map(|step| step.busy > threshold).collect();
    // Steps in whose midst the state changes have neither level.
    let level = |state: bool| -> Vec<Step> {
        let inner = |i: &usize| on[i - 1..=i + 1].iter().all(|s| *s == state);
        (1..steps.len() - 1).filter(inner).map(|i| steps[i]).collect()
    };
    let (there, away) = (level(true), level(false));
    if there.is_empty() || away.is_empty() {
        return Err("their share of the time has no two levels".to_owned());
    }
    let moments = |level: &[Step]| {
        let n = level.len() as f64;
        let mean = level.iter().map(|step| step.busy).sum::<f64>() / n;
        (mean, (level.iter().map(|step| (step.busy - mean).powi(2)).sum::<f64>() / n).sqrt())
    };
    let ((high, high_deviation), (low, low_deviation)) = (moments(&there), moments(&away));
    if high - low < LEAST_APART * high_deviation.max(low_deviation) || high - low < LEAST_LOAD {
        return Err("their share of the time has no two levels".to_owned());
    }
    // Transitions between steps of the usual length, from each state to each.
    let mut counts = [[0usize; 2]; 2];
    for (i, pair) in steps.windows(2).enumerate() {
        if pair.iter().all(|step| (step.seconds / usual - 1.0).abs() < 0.5) {
            counts[usize::from(on[i])][usize::from(on[i + 1])] += 1;
        }
    }
    let changes = counts[0][1].min(counts[1][0]);
    if changes < LEAST_CHANGES {
        return Err(format!(
            "they came and went {changes} times, and it takes {LEAST_CHANGES} to know how often"
        ));
    }
    let [arrive, depart] = [counts[0], counts[1]].map(|row| row.iter().sum::<usize>() as f64);
    let rates = rates([counts[0][1] as f64 / arrive, counts[1][0] as f64 / depart], usual);
    let rates = rates.ok_or("they come and go faster than counters were read")?;
    let beta = |draws: &mut Draws, changed: usize, stayed: usize| {
        draws.beta(changed as f64 + 0.5, stayed as f64 + 0.5)
    };
    let drawn: Vec<[f64; 2]> = (0..2 * RESAMPLES)
        .filter_map(|_| {
            let arrives = beta(draws, counts[0][1], counts[0][0]);
            crate::interference::rates([arrives, beta(draws, counts[1][0], counts[1][1])], usual)
        })
        .collect();
    let time = |k: usize| {
        let mut times: Vec<f64> = drawn.iter().map(|rates| 1.0 / rates[k]).collect();
        Estimate::around(1.0 / rates[k], &mut times)
    };
    let presence = PresenceFit { on_s: time(1), off_s: time(0), background: mean(&away, draws) };
    Ok((mean(&there, draws), presence))
}

/// Returns the threshold between two levels: the one that leaves the least variance within them (Otsu, A threshold selection
/// method from gray-level histograms, 1979).
fn threshold(steps: &[Step]) -> f64 {
    let mut sorted: Vec<f64> = steps.iter().map(|step| step.busy).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let (n, sum) = (sorted.len() as f64, sorted.iter().sum::<f64>());
    let (mut below, mut best, mut threshold) = (0.0, f64::NEG_INFINITY, sorted[sorted.len() - 1]);
    for (i, pair) in sorted.windows(2).enumerate() {
        below += pair[0];
        let k = (i + 1) as f64;
        let between = (below / k - (sum - below) / (n - k)).powi(2) * k * (n - k);
        if pair[1] > pair[0] && between > best {
            (best, threshold) = (between, f64::midpoint(pair[0], pair[1]));
        }
    }
    threshold
}

/// Returns the rates, per second, at which others arrive and depart, for the probabilities that they do so within a step. `None`
/// if the chain does not remember its state for half of the step at least.
///
/// Of a chain in continuous time with the rates a and d, the probability of an arrival is a/(a + d)·(1 - exp(-(a + d)·t)), and
/// likewise that of a departure (Cox and Miller, The theory of stochastic processes, 1965, 4.5).
fn rates([arrives, departs]: [f64; 2], step_s: f64) -> Option<[f64; 2]> {
    const LEAST_MEMORY: f64 = 0.5;
    let memory = 1.0 - arrives - departs;
    if memory < LEAST_MEMORY {
        return None;
    }
    let both = -memory.ln() / step_s;
    Some([arrives, departs].map(|p| p / (arrives + departs) * both))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps_of(shares: impl IntoIterator<Item = f64>) -> Vec<Step> {
        shares.into_iter().map(|busy| Step { seconds: 1.0, busy }).collect()
    }

    #[test]
    fn rates_give_their_probabilities_back() {
        let (arrive, depart) = (0.05f64, 0.1f64);
        let gone = 1.0 - (-(arrive + depart) * 2.0).exp();
        let found = rates([arrive, depart].map(|rate| rate / (arrive + depart) * gone), 2.0).unwrap();
        assert!((found[0] - arrive).abs() < 1e-12 && (found[1] - depart).abs() < 1e-12, "{found:?}");
        assert_eq!(rates([0.3, 0.3], 1.0), None);
    }

    #[test]
    fn a_threshold_lies_between_two_levels() {
        let threshold = threshold(&steps_of([0.1, 0.5, 0.12, 0.48, 0.11, 0.09]));
        assert!((0.12..0.48).contains(&threshold), "{threshold}");
    }

    #[test]
    fn own_frames_are_no_interference_and_a_restart_is_skipped() {
        let counters = |i: u32| {
            let i = f64::from(if i < 80 { i } else { i - 80 });
            Counters {
                active: 1000.0 * i,
                busy: 500.0 * i,
                transmit: Some(100.0 * i),
                own_receive: Some(150.0 * i),
            }
        };
        let (steps, notes) = steps("R", &(0..160).map(counters).collect::<Vec<_>>()).unwrap();
        assert_eq!((steps.len(), notes.len()), (158, 0));
        assert!(steps.iter().all(|step| (step.busy - 0.25).abs() < 1e-12));
    }

    #[test]
    fn a_load_that_varies_evenly_is_always_there() {
        let mut draws = Draws::new(1, "load");
        let mut level = 0.0;
        let mut share = || {
            level = 0.9 * level + 0.02 * draws.normal();
            0.3 + level
        };
        let reason =
            presence(&steps_of((0..600).map(|_| share())), &mut Draws::new(1, "presence")).unwrap_err();
        assert_eq!(reason, "their share of the time has no two levels");
        let few = steps_of((0..600).map(|i| if (i / 100) % 2 == 0 { 0.4 } else { 0.0 }));
        let reason = presence(&few, &mut Draws::new(1, "presence")).unwrap_err();
        assert_eq!(reason, "they came and went 2 times, and it takes 10 to know how often");
    }
}
