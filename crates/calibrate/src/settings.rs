//! Fitted values as settings of a testbed file.

use cotorra_graph::{JitterDistribution, Link, Loss, NodeKind, Testbed};
use serde::Serialize;

use crate::{error::CalibrateError, estimate::Estimate, path::PathFit, survey::SurveyFit};

/// Beginning of a line of a testbed file that notes a setting.
const NOTE: &str = "# set: ";

/// A setting of a testbed file, with the reason for it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FittedSetting {
    /// Path of the key, as `--set` takes it.
    pub path: String,
    /// Value, as YAML.
    pub value: String,
    /// What was fitted, with its interval.
    pub note: String,
}

/// Returns the settings of a wireless network.
///
/// Its path loss is that of free space up to 1 m. The fitted reference loss is therefore taken off the transmitted powers of
/// all nodes of the network, which changes both directions alike.
pub(crate) fn of_network(testbed: &Testbed, name: &str, fit: &SurveyFit) -> Vec<FittedSetting> {
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
    for node in &testbed.graph.nodes {
        let power = match &node.kind {
            NodeKind::RadioUnit(unit) if unit.network == name => unit.tx_power,
            NodeKind::Robot(robot) if robot.network == name => robot.tx_power,
            _ => continue,
        };
        set(
            format!("nodes.{}.tx_power", node.id),
            format!("{:.2} dBm", power.0 - fit.reference_loss_db.value),
            format!("{} less the reference loss of {:.2} dB", power, fit.reference_loss_db),
        );
    }
    settings
}

/// Returns the settings of a link, whose frames take some time to be sent in each direction, ms.
///
/// Round trips do not tell the direction of jitter and loss. Both directions get half of the shortest round trip. The rest of
/// the mean, jitter, loss and duplication are those of the forward direction, so that round trips are as they were fitted.
///
/// # Errors
/// [`CalibrateError::Unsuited`] if sending takes longer than the shortest round trip.
pub(crate) fn of_link(
    link: &Link,
    fit: &PathFit,
    sending_ms: [f64; 2],
) -> Result<Vec<FittedSetting>, CalibrateError> {
    let shortest = fit.shortest_ms();
    let backward = shortest / 2.0 - sending_ms[1];
    let forward = fit.mean_ms.value - shortest / 2.0 - sending_ms[0];
    if forward < 0.0 || backward < 0.0 {
        return Err(CalibrateError::unsuited(format!(
            "at the rates of the testbed, sending a frame takes {:.3} ms, but the shortest round trip is {shortest:.3} ms: set \
             the link's `rate` to that of the site",
            sending_ms[0] + sending_ms[1]
        )));
    }
    let loss = match fit.loss.model() {
        Loss::None => "0 %".to_owned(),
        Loss::Independent { rate } => percent(rate.get()),
        Loss::Bursty { rate, mean_burst } => {
            format!("{{ rate: {}, mean_burst: {mean_burst:.3} }}", percent(rate.get()))
        }
    };
    let distribution = distribution_name(fit.distribution);
    let jitter = format!("{{ deviation: {:.4} ms, distribution: {distribution} }}", fit.deviation_ms.value);
    let lost = format!("loss of a round trip {}", percents(fit.loss.share));
    let lost = match fit.loss.mean_burst {
        Some(burst) => format!("{lost}, mean burst {burst:.1}"),
        None => lost,
    };
    let mean = format!("mean round trip {:.3} ms", fit.mean_ms);
    let set = |key: &str, value: String, note: String| FittedSetting {
        path: format!("links.{}.{key}", link.id),
        value,
        note,
    };
    let half = "half of the shortest round trip";
    let other = || "counted forward".to_owned();
    Ok(vec![
        set("forward.delay", format!("{forward:.4} ms"), mean),
        set("forward.jitter", jitter, format!("deviation of round trips {:.3} ms", fit.deviation_ms)),
        set("forward.loss", loss, lost),
        set(
            "forward.duplication",
            percent(fit.duplication.value),
            format!("share that arrives twice {}", percents(fit.duplication)),
        ),
        set("backward.delay", format!("{backward:.4} ms"), half.to_owned()),
        set("backward.jitter", "0 ms".to_owned(), other()),
        set("backward.loss", "0 %".to_owned(), other()),
        set("backward.duplication", "0 %".to_owned(), other()),
    ])
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
