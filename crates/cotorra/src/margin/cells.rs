//! Cells of the tables of decisions.

use cotorra_experiments::regret::{Decided, Paired};
use cotorra_graph::Timestamp;
use cotorra_numbers::FEWEST;

use crate::words::signed;
/// Maximum number of decisions that the terminal lists.
pub(super) const LISTED: usize = 40;

/// Returns the first cells of a decision's row.
pub(super) fn heads(decided: &Decided) -> [String; 5] {
    let Decided { number, at, plugin, .. } = decided;
    [number.to_string(), seconds(*at), plugin.to_string(), decided.subject().to_owned(), decided.chosen()]
}

pub(super) fn seconds(at: Timestamp) -> String {
    format!("{:.1} s", at.as_secs_f64())
}

/// `0.012`, `<0.001`.
pub(super) fn shown_p(p: f64) -> String {
    if p < 0.001 { "<0.001".to_owned() } else { format!("{p:.3}") }
}

/// `+0.16 (-0.02 to +0.34)`; two pairs are too few for an interval.
pub(super) fn paired(paired: Option<Paired>, factor: f64) -> String {
    let Some(Paired { n, mean, low, high, .. }) = paired else { return "-".to_owned() };
    let mean = signed(mean * factor);
    match low.zip(high) {
        Some((low, high)) if n >= FEWEST => {
            format!("{mean} ({} to {})", signed(low * factor), signed(high * factor))
        }
        _ => format!("{mean} (n = {n})"),
    }
}
