//! Fitted values as settings of a testbed file.

use cotorra_graph::{Direction, JitterDistribution, Link, Loss, NodeKind, Testbed};
use serde::Serialize;

use crate::{
    error::CalibrateError,
    estimate::Estimate,
    handovers::HandoverFit,
    path::PathFit,
    survey::{FadingFit, SurveyFit},
    times::Means,
};

/// Beginning of a line of a testbed file that notes a setting.
const NOTE: &str = "# set: ";

/// A setting of a testbed file, with the reason for it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FittedSetting {
    /// Path of the key, as `--set` takes it.
    pub path: String,
    /// Value, as YAML.
    pub value: String,
    /// The fitted value with its interval.
    pub note: String,
}

/// Returns the settings of a wireless network.
///
/// Its path loss is that of free space up to 1 m. The fitted reference loss is therefore taken off the transmitted powers of
/// all nodes of the network, which changes both directions alike. With fading, it is that of the mean power.
pub(crate) fn of_network(
    testbed: &Testbed,
    name: &str,
    fit: &SurveyFit,
    fading: Option<&FadingFit>,
) -> Vec<FittedSetting> {
    let mut settings = Vec::new();
    let mut set = |path: String, value: String, note: String| {
        settings.push(FittedSetting { path, value, note });
    };
    let of = |key: &str| format!("wireless.{name}.{key}");
    set(
        of("path_loss"),
        format!("{{ model: log_distance, exponent: {:.3} }}", fit.exponent.value.max(0.0)),
        format!("exponent {:.2}", fit.exponent),
    );
    if let Some(wall) = fit.wall_loss_db {
        let value = format!("{:.2} dB", wall.value.clamp(0.0, 100.0));
        set(of("walls"), value, format!("loss of each wall {wall:.2} dB"));
    }
    let deviation = format!("{:.2} dB", fit.deviation_db.value);
    set(of("shadowing.deviation"), deviation, format!("deviation of shadowing {:.2} dB", fit.deviation_db));
    if let Some(correlation) = fit.correlation_m {
        let value = format!("{:.2} m", correlation.value);
        set(of("shadowing.correlation"), value, format!("correlation distance {correlation:.2} m"));
    }
    let mut reference_loss = fit.reference_loss_db;
    if let Some(fading) = fading {
        reference_loss = reference_loss.shifted(fading.mean_db);
        let motion = testbed.graph.wireless[name].fading.map_or(0.0, |before| before.motion_mps);
        let value = match (fading.is_rayleigh(), motion) {
            (true, 0.0) => "rayleigh".to_owned(),
            (true, motion) => format!("{{ motion: {motion} m/s }}"),
            (false, 0.0) => format!("{{ k_factor: {:.2} dB }}", fading.k_factor_db.value),
            (false, motion) => {
                format!("{{ k_factor: {:.2} dB, motion: {motion} m/s }}", fading.k_factor_db.value)
            }
        };
        set(of("fading"), value, format!("K-factor {:.1} dB", fading.k_factor_db));
    }
    for node in &testbed.graph.nodes {
        let power = match &node.kind {
            NodeKind::RadioUnit(unit) if unit.network == name => unit.tx_power,
            NodeKind::Robot(robot) if robot.network == name => robot.tx_power,
            _ => continue,
        };
        set(
            format!("nodes.{}.tx_power", node.id),
            format!("{:.2} dBm", power.0 - reference_loss.value),
            format!("{} less the reference loss of {:.2} dB", power, reference_loss),
        );
    }
    settings
}

/// Returns the settings of the handovers of a wireless network. Phases that cannot be told apart keep their proportions.
pub(crate) fn of_handovers(testbed: &Testbed, name: &str, fit: &HandoverFit) -> Vec<FittedSetting> {
    let times = &testbed.graph.wireless[name].handover;
    let [authenticate, reassociate, handshake] =
        [times.authenticate, times.reassociate, times.handshake].map(|phase| phase.as_secs_f64() * 1e3);
    let of = |key: &str| format!("wireless.{name}.handover.{key}");
    let mut settings = Vec::new();
    let mut phases = |values: &[(&str, f64)], whole: f64, note: &str| {
        let sum: f64 = values.iter().map(|(_, ms)| ms).sum();
        for (key, ms) in values {
            let share = if sum > 0.0 { ms / sum } else { 1.0 / values.len() as f64 };
            settings.push(setting(of(key), format!("{:.3} ms", share * whole), note.to_owned()));
        }
    };
    let join = [("authenticate", authenticate), ("reassociate", reassociate)];
    match (fit.fast_ms, fit.full_ms) {
        (Some(fast), full) => {
            phases(&join, fast.value, &format!("a fast transition takes {fast:.1} ms"));
            if let Some(full) = full {
                let rest = (full.value - fast.value).max(0.0);
                phases(&[("handshake", rest)], rest, &format!("the rest of a handover of {full:.1} ms"));
            }
        }
        (None, Some(full)) => {
            let all = [join[0], join[1], ("handshake", handshake)];
            phases(&all, full.value, &format!("a handover takes {full:.1} ms"));
        }
        (None, None) => {}
    }
    if let Some(scan) = fit.scan_ms {
        phases(&[("scan", scan.value)], scan.value, &format!("a scan takes {scan:.1} ms"));
    }
    let varied = format!("phases vary by {}", percents(fit.variation));
    settings.push(setting(of("variation"), percent(fit.variation.value.clamp(0.0, 1.0)), varied));
    settings
}

/// Returns the settings of a link by round trips. Its frames take some time to be sent in each direction, ms.
///
/// Round trips do not show the direction of jitter and loss. Both directions get half of the shortest round trip. The
/// rest of the mean, jitter, loss and duplication are those of the forward direction, so that round trips are as they
/// were fitted.
///
/// # Errors
/// [`CalibrateError::Unsuited`] if sending takes longer than the shortest round trip.
pub(crate) fn of_round_trips(
    link: &Link,
    fit: &PathFit,
    sending_ms: [f64; 2],
) -> Result<Vec<FittedSetting>, CalibrateError> {
    let shortest = fit.shortest_ms();
    let backward = shortest / 2.0 - sending_ms[1];
    let forward = fit.mean_ms.value - shortest / 2.0 - sending_ms[0];
    if forward < 0.0 || backward < 0.0 {
        return Err(too_slow("round trip", sending_ms[0] + sending_ms[1], shortest));
    }
    let there = |key: &'static str| format!("links.{}.forward.{key}", link.id);
    let back = |key: &'static str| format!("links.{}.backward.{key}", link.id);
    let mean = format!("mean round trip {:.3} ms", fit.mean_ms);
    let mut settings = vec![setting(there("delay"), format!("{forward:.4} ms"), mean)];
    settings.extend(of_impairments(there, fit, "round trips", "round trip"));
    let half = "half of the shortest round trip";
    settings.push(setting(back("delay"), format!("{backward:.4} ms"), half.to_owned()));
    let mut none = |key, value: &str| {
        settings.push(setting(back(key), value.to_owned(), "counted forward".to_owned()));
    };
    none("jitter", "0 ms");
    if fit.loss.is_some() {
        none("loss", "0 %");
    }
    if fit.duplication.is_some() {
        none("duplication", "0 %");
    }
    Ok(settings)
}

/// Returns the settings of one direction of a link, whose frames take some time to be sent, ms. Without a known mean, its delay
/// stays as it is.
///
/// # Errors
/// [`CalibrateError::Unsuited`] if sending takes longer than the mean.
pub(crate) fn of_way(
    link: &Link,
    direction: Direction,
    fit: &PathFit,
    means: Means,
    sending_ms: f64,
) -> Result<Vec<FittedSetting>, CalibrateError> {
    let way = match direction {
        Direction::Forward => "forward",
        Direction::Backward => "backward",
    };
    let of = |key: &'static str| format!("links.{}.{way}.{key}", link.id);
    let delay = fit.mean_ms.value - sending_ms;
    let reason = match means {
        Means::Measured => "",
        Means::Halves => ", with half of the shortest time there and back",
        Means::Unknown => return Ok(of_impairments(of, fit, "one-way times", "packet")),
    };
    if delay < 0.0 {
        return Err(too_slow("one-way time", sending_ms, fit.shortest_ms()));
    }
    let mean = format!("mean {:.3} ms{reason}", fit.mean_ms);
    let mut settings = vec![setting(of("delay"), format!("{delay:.4} ms"), mean)];
    settings.extend(of_impairments(of, fit, "one-way times", "packet"));
    Ok(settings)
}

fn setting(path: String, value: String, note: String) -> FittedSetting {
    FittedSetting { path, value, note }
}

fn too_slow(of: &str, sending_ms: f64, shortest_ms: f64) -> CalibrateError {
    CalibrateError::unsuited(format!(
        "at the rates of the testbed, sending a frame takes {sending_ms:.3} ms, but the shortest {of} is {shortest_ms:.3} ms: set \
         the link's `rate` to that of the site"
    ))
}

/// Returns jitter, and loss and duplication if they were measured.
fn of_impairments(
    path: impl Fn(&'static str) -> String,
    fit: &PathFit,
    times: &str,
    packet: &str,
) -> Vec<FittedSetting> {
    let distribution = distribution_name(fit.distribution);
    let mut jitter = format!("deviation: {:.4} ms, distribution: {distribution}", fit.deviation_ms.value);
    let mut deviation = format!("deviation of {times} {:.3} ms", fit.deviation_ms);
    let correlation = fit.jitter_correlation();
    if !correlation.is_none() {
        jitter += &format!(", correlation: {}", percent(correlation.get()));
        deviation += &format!(", correlation with the next {}", percents(fit.correlation));
    }
    let jitter = format!("{{ {jitter} }}");
    let mut settings = vec![setting(path("jitter"), jitter, deviation)];
    if let Some(fitted) = &fit.loss {
        let loss = match fitted.model() {
            Loss::None => "0 %".to_owned(),
            Loss::Independent { rate } => percent(rate.get()),
            Loss::Bursty { rate, mean_burst } => {
                format!("{{ rate: {}, mean_burst: {mean_burst:.3} }}", percent(rate.get()))
            }
        };
        let lost = format!("loss of a {packet} {}", percents(fitted.share));
        let lost = match fitted.mean_burst {
            Some(burst) => format!("{lost}, mean burst {burst:.1}"),
            None => lost,
        };
        settings.push(setting(path("loss"), loss, lost));
    }
    if let Some(share) = fit.duplication {
        let twice = format!("share that arrives twice {}", percents(share));
        settings.push(setting(path("duplication"), percent(share.value), twice));
    }
    settings
}

/// Returns a testbed file's text with settings behind it, each explained by a comment. Comments of the text stay as they are.
///
/// The settings are lines that begin with `# set: `, which every command applies. They have to be the last lines of the text,
/// so that comments go before those that the text has already.
pub fn calibrated_text(text: &str, settings: &[FittedSetting]) -> String {
    let mut end = text.len();
    for line in text.split_inclusive('\n').rev() {
        if !line.starts_with(NOTE) {
            break;
        }
        end -= line.len();
    }
    let (mut written, noted) = (text[..end].to_owned(), &text[end..]);
    let end_line = |text: &mut String| {
        if !text.is_empty() && !text.ends_with('\n') {
            text.push('\n');
        }
    };
    end_line(&mut written);
    written += "\n# Calibrated by `cotorra calibrate`; values with their 95 % intervals:\n";
    for FittedSetting { path, note, .. } in settings {
        written += &format!("#   {path}: {note}\n");
    }
    written += "# The settings below override the values above. Change them here, or move them there.\n";
    written += noted;
    end_line(&mut written);
    for FittedSetting { path, value, .. } in settings {
        written += &format!("{NOTE}{path}={value}\n");
    }
    written
}

/// Returns the name of a distribution in a testbed file.
pub(crate) const fn distribution_name(distribution: JitterDistribution) -> &'static str {
    match distribution {
        JitterDistribution::Uniform => "uniform",
        JitterDistribution::Normal => "normal",
        JitterDistribution::Pareto => "pareto",
    }
}

fn percent(share: f64) -> String {
    format!("{:.4} %", share * 100.0)
}

fn percents(share: Estimate) -> String {
    format!("{:.2} %", share.scaled(100.0))
}
