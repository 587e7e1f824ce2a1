//! What old context cost, for people: figures of services with the distances of plug-ins and without, and their differences.

use cotorra_graph::{NodeId, ServiceId};
use cotorra_measurements::regret::{Apart, ServiceFigures, ServiceRegret};

use crate::{
    table::{Table, wrap},
    words::signed,
};

/// Columns of the sentences.
const WIDTH: usize = 100;

/// Figures of a service, with the distances of plug-ins and without.
pub struct OfService<'a> {
    pub service: &'a ServiceId,
    pub robot: &'a NodeId,
    pub target_ms: f64,
    pub with: &'a ServiceFigures,
    pub without: &'a ServiceFigures,
}

/// Heads of the cells of [`OfService::rows`].
pub const HEADS: [&str; 4] = ["service", "figure", "with distance", "beside the core"];

impl OfService<'_> {
    /// Returns a row for each figure: the share above the target, the 99th percentile, and the median.
    pub fn rows(&self) -> [[String; 4]; 3] {
        let Self { service, robot, target_ms, with, without } = self;
        let row = |name: String, figure: String, read: &dyn Fn(&ServiceFigures) -> Option<f64>| {
            let of = |its| read(its).map_or("-".to_owned(), |figure| format!("{figure:.2}"));
            [name, figure, of(with), of(without)]
        };
        let above = format!("above {target_ms} ms, %");
        let none = String::new;
        [
            row(format!("{service} of {robot}"), above, &|its| its.above_target.map(|share| share * 100.0)),
            row(none(), "p99, ms".to_owned(), &|its| its.service_time_p99_ms),
            row(none(), "median, ms".to_owned(), &|its| its.service_time_p50_ms),
        ]
    }
}

/// Describes what these distances cost services.
pub fn describe(distances: &str, services: &[ServiceRegret]) -> String {
    let mut table = Table::new("<<>>>");
    table.row(HEADS.into_iter().chain(["regret"]));
    for ServiceRegret { service, robot, service_time_target_ms, with, without, regret } in services {
        let of = OfService { service, robot, target_ms: *service_time_target_ms, with, without };
        let regrets = [
            apart(regret.above_target, 100.0),
            apart(regret.service_time_p99_ms, 1.0),
            apart(regret.service_time_p50_ms, 1.0),
        ];
        for (row, regret) in of.rows().into_iter().zip(regrets) {
            table.row(row.into_iter().chain([regret]));
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
