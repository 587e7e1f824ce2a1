//! The report of a calibration, as Markdown.

use std::fmt::Write as _;

use crate::{
    calibration::{Calibration, LinkCalibration, NetworkCalibration, PathCalibration},
    compare::{Comparison, Figures},
    estimate::Estimate,
    handovers::HandoverFit,
    interference::InterferenceFit,
    settings::distribution_name,
    survey::SurveyComparison,
};

/// Name of the time of a packet and its answer.
const ROUND_TRIP: &str = "round trip";

/// Returns the report as Markdown. JSON has the same figures: [`Calibration`] serializes.
pub fn markdown(calibration: &Calibration) -> String {
    let Calibration { testbed, seed, networks, handovers, interference, links, settings } = calibration;
    let mut text = format!("# Calibration of {testbed}\n\nSeed {seed}. Intervals are 95 %.\n");
    for (name, of) in networks {
        text += &network(name, of);
    }
    for (name, fit) in handovers {
        text += &of_handovers(name, fit);
    }
    for (name, fit) in interference {
        text += &of_interference(name, fit);
    }
    for (name, link) in links {
        text += &of_link(name, link);
    }
    text += "\n## Settings\n\n```\n";
    for setting in settings {
        text += &format!("--set '{}={}'\n", setting.path, setting.value);
    }
    text + "```\n"
}

fn network(name: &str, NetworkCalibration { fit, fading, comparison }: &NetworkCalibration) -> String {
    let mut table = vec![
        row("reference loss beyond free space, dB", &fit.reference_loss_db, 2),
        row("exponent", &fit.exponent, 2),
    ];
    table.extend(fit.wall_loss_db.map(|wall| row("loss of each wall, dB", &wall, 2)));
    table.push(row("deviation of shadowing, dB", &fit.deviation_db, 2));
    table.extend(fit.correlation_m.map(|m| row("correlation distance of shadowing, m", &m, 2)));
    table.push(row("deviation of noise, dB (no setting)", &fit.noise_db, 2));
    if let Some(fading) = fading {
        table.push(row("deviation of single frames, dB", &fading.deviation_db, 2));
        table.push(row("K-factor of fading, dB", &fading.k_factor_db, 1));
    }
    let plural = if fit.radio_units == 1 { "" } else { "s" };
    let head = format!(
        "\n## Network {name}\n\n{} readings of {} radio unit{plural} fitted.\n\n",
        fit.readings, fit.radio_units
    );
    head + &fitted(&table) + &notes(&fit.notes) + &predicted(comparison)
}

fn predicted(SurveyComparison { test_readings, block_length, predictions, .. }: &SurveyComparison) -> String {
    let mut text = format!(
        "\n### Test\n\n{test_readings} readings that were not fitted. An error is the measured signal less the predicted one. A median \
         in **bold** agrees with 0, and a share with 90 %. Blocks of the bootstrap have {block_length:.1} times of readings.\n\n\
         | | error p5, dB | p50, dB | p95, dB | root mean square, dB | within 90 % interval, % | Wasserstein, dB |\n\
         |---|---:|---:|---:|---:|---:|---:|\n"
    );
    let bold = |cell: String, agrees: bool| if agrees { format!("**{cell}**") } else { cell };
    for prediction in predictions {
        let within = prediction.within.scaled(100.0);
        text += &format!(
            "| {} | {:.1} | {} | {:.1} | {:.1} | {} | {:.1} |\n",
            prediction.by.name(),
            prediction.p5_db,
            bold(format!("{:.1}", prediction.p50_db), prediction.median_agrees),
            prediction.p95_db,
            prediction.root_mean_square_db,
            bold(format!("{within:.0}"), prediction.within_agrees),
            prediction.wasserstein_db,
        );
    }
    text
}

fn of_handovers(name: &str, fit: &HandoverFit) -> String {
    let means = [
        ("scan before a handover, ms", fit.scan_ms),
        ("authentication and reassociation, ms", fit.fast_ms),
        ("authentication, reassociation and key handshakes, ms", fit.full_ms),
    ];
    let mut table: Vec<String> =
        means.iter().filter_map(|(what, estimate)| Some(row(what, estimate.as_ref()?, 2))).collect();
    table.push(row("variation of each phase, %", &fit.variation.scaled(100.0), 1));
    let head = format!("\n## Handovers of network {name}\n\n{} handovers.\n\n", fit.handovers);
    head + &fitted(&table) + &notes(&fit.notes)
}

fn of_interference(name: &str, fit: &InterferenceFit) -> String {
    let InterferenceFit { network, channel, steps, seconds, load, presence, .. } = fit;
    let mut table = vec![row("load by others, %", &load.scaled(100.0), 2)];
    if let Some(presence) = presence {
        table.push(row("load while they are away, %", &presence.background.scaled(100.0), 2));
        table.push(row("they are there for, s", &presence.on_s, 2));
        table.push(row("they are away for, s", &presence.off_s, 2));
    }
    let head = format!(
        "\n## Interference on channel {channel} of network {network}\n\nMeasured by {name}: {steps} differences of counters over \
         {seconds:.0} s.\n\n"
    );
    head + &fitted(&table) + &notes(&fit.notes)
}

fn of_link(name: &str, link: &LinkCalibration) -> String {
    let mut text = String::new();
    for (of, path) in link.paths() {
        let (title, time) = match link {
            LinkCalibration::RoundTrips(_) => (format!("Link {name}"), ROUND_TRIP),
            LinkCalibration::OneWay { .. } => (format!("Link {name}, {of}"), "time"),
        };
        text += &format!("\n## {title}\n\n");
        text += &of_path(path, time, link.mean_is_known());
    }
    if link.notes().is_empty() {
        text
    } else {
        text + &format!("\nOf link {name} as a whole:\n") + &notes(link.notes())
    }
}

fn of_path(PathCalibration { fit, comparison }: &PathCalibration, time: &str, mean_is_known: bool) -> String {
    let mean = if mean_is_known {
        format!("mean {time}, ms")
    } else {
        format!("mean {time} beyond an unknown one (no setting), ms")
    };
    let mut table = vec![
        row(&mean, &fit.mean_ms, 3),
        row(&format!("deviation of {time}s, ms"), &fit.deviation_ms, 3),
        row("correlation with the next, %", &fit.correlation.scaled(100.0), 1),
    ];
    let mut losses = String::new();
    if let Some(loss) = &fit.loss {
        table.push(row(
            if time == ROUND_TRIP { "loss of a round trip, %" } else { "loss, %" },
            &loss.share.scaled(100.0),
            2,
        ));
        table.extend(loss.mean_burst.map(|burst| row("mean burst, packets", &burst, 2)));
        let kind = if loss.bursty { "in bursts" } else { "independent" };
        losses = format!(", of which {} were lost ({kind})", loss.lost);
    }
    table.extend(fit.duplication.map(|share| row("duplication, %", &share.scaled(100.0), 2)));
    let distances: Vec<_> = fit
        .distances_ms
        .iter()
        .map(|(distribution, ms)| format!("{} {ms:.3} ms", distribution_name(*distribution)))
        .collect();
    let head = format!(
        "{} packets fitted{losses}. The distribution is {}. Distances of all to the measured quantiles: {}. Blocks of the bootstrap \
         have {:.1} packets.\n\n",
        fit.packets,
        distribution_name(fit.distribution),
        distances.join(", "),
        fit.block_length
    );
    head + &fitted(&table) + &notes(&fit.notes) + &compared(comparison)
}

fn row(what: &str, estimate: &Estimate, digits: usize) -> String {
    let Estimate { value, low, high } = estimate;
    format!("| {what} | {value:.digits$} | {low:.digits$} to {high:.digits$} |\n")
}

fn fitted(rows: &[String]) -> String {
    format!("| fitted | value | interval |\n|---|---:|---|\n{}", rows.concat())
}

fn notes(notes: &[String]) -> String {
    let mut text = String::new();
    for note in notes {
        write!(text, "\n- Note: {note}.").expect("writing into a string cannot fail");
    }
    if text.is_empty() { text } else { text + "\n" }
}

fn compared(comparison: &Comparison) -> String {
    let Comparison { test_packets, target_ms, measured, predictions, .. } = comparison;
    let target = target_ms.map(|ms| format!(" The target is {ms} ms.")).unwrap_or_default();
    let above = if target_ms.is_some() { " above target, % |" } else { "" };
    let line = if target_ms.is_some() { "---:|" } else { "" };
    let mut text = format!(
        "\n### Test\n\n{test_packets} packets that were not fitted.{target} A figure in **bold** agrees with the test part.\n\n| | p50, ms | p95, ms | p99, ms | change, ms |{above} Wasserstein, ms |\n|---|---:|---:|---:|---:|{line}---:|\n"
    );
    let cell = |estimate: &Estimate| format!("{estimate:.2}");
    let Figures { p50_ms, p95_ms, p99_ms, change_ms, above } = measured;
    let mut cells = vec!["test part".to_owned()];
    cells.extend([p50_ms, p95_ms, p99_ms, change_ms].map(cell));
    cells.extend(above.map(|share| cell(&share.scaled(100.0))));
    cells.push(String::new());
    text += &format!("| {} |\n", cells.join(" | "));
    for prediction in predictions {
        let agrees = &prediction.agrees;
        let cell = |value: f64, agrees: bool| match agrees {
            true => format!("**{value:.2}**"),
            false => format!("{value:.2}"),
        };
        let figures = &prediction.figures;
        let mut cells = vec![
            prediction.by.name().to_owned(),
            cell(figures.p50_ms, agrees.p50_ms),
            cell(figures.p95_ms, agrees.p95_ms),
            cell(figures.p99_ms, agrees.p99_ms),
            cell(figures.change_ms, agrees.change_ms),
        ];
        cells.extend(figures.above.zip(agrees.above).map(|(share, agrees)| cell(share * 100.0, agrees)));
        cells.push(format!("{:.2}", prediction.wasserstein_ms));
        text += &format!("| {} |\n", cells.join(" | "));
    }
    text
}
