//! Text that several answers share: times, and how to see more of an answer that is bounded.

use std::fmt::Write as _;

use cotorra_graph::Timestamp;
use cotorra_measurements::{Cursor, Page};

/// Formats a time of the run in seconds, to the millisecond.
pub fn seconds(at: Timestamp) -> String {
    format!("{:.3}", at.as_secs_f64())
}

/// Says how to see what comes after a page. Empty if that was the last one.
pub fn more<T>(page: &Page<T>) -> String {
    page.next.map(|next: Cursor| format!("... more with --after {next}\n")).unwrap_or_default()
}

/// Adds how many lines were left out, if only the first are `shown`, and `how` to see all.
pub fn first_of(text: &mut String, shown: usize, of: usize, how: &str) {
    if of > shown {
        writeln!(text, "  ... and {} more: {how}", of - shown).expect("writing into a string cannot fail");
    }
}
