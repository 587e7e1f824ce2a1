//! What old context cost, for people: figures of services with the distances of plug-ins and without, and their differences.

use cotorra_measurements::regret::{Apart, ServiceRegret};

use crate::{
    table::{Table, wrap},
    words::signed,
};

/// Columns of the sentences.
const WIDTH: usize = 100;

/// Describes what these distances cost services.
pub fn describe(distances: &str, services: &[ServiceRegret]) -> String {
    let mut table = Table::new("<<>>>");
    table.row(["service", "figure", "with distance", "beside the core", "regret"]);
    for its in services {
        let ServiceRegret { service, robot, service_time_target_ms, with, without, regret } = its;
        let above = format!("above {service_time_target_ms} ms, %");
        let rows = [
            (above.as_str(), with.above_target, without.above_target, regret.above_target, 100.0),
            (
                "p99, ms",
                with.service_time_p99_ms,
                without.service_time_p99_ms,
                regret.service_time_p99_ms,
                1.0,
            ),
            (
                "median, ms",
                with.service_time_p50_ms,
                without.service_time_p50_ms,
                regret.service_time_p50_ms,
                1.0,
            ),
        ];
        for (place, (figure, with, without, regret, factor)) in rows.into_iter().enumerate() {
            let name = if place == 0 { format!("{service} of {robot}") } else { String::new() };
            let of = |figure: Option<f64>| {
                figure.map_or("-".to_owned(), |figure| format!("{:.2}", figure * factor))
            };
            table.row([name, figure.to_owned(), of(with), of(without), apart(regret, factor)]);
        }
    }
    let services =
        if services.is_empty() { "  no service has samples\n".to_owned() } else { table.render("  ") };
    format!("What old context cost ({distances}):\n\n{services}")
}

/// Says what intervals mean.
pub fn explain() -> String {
    let text = "Intervals (95 %) are over blocks of time of one pair of runs with the same seed. `cotorra margin --decision all \
                --seeds 10` gives those over seeds.";
    format!("\n{}", wrap(text, "", WIDTH))
}

/// `+0.16 (-0.02 to +0.34)`.
fn apart(apart: Option<Apart>, factor: f64) -> String {
    let Some(Apart { difference, low, high }) = apart else { return "-".to_owned() };
    let difference = signed(difference * factor);
    match low.zip(high) {
        Some((low, high)) => format!("{difference} ({} to {})", signed(low * factor), signed(high * factor)),
        None => difference,
    }
}
