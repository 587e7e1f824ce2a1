//! Cells of tables for programs.

/// Returns a figure with nanosecond resolution for milliseconds; empty without one.
pub(crate) fn number(figure: Option<f64>) -> String {
    figure.map(|figure| ((figure * 1e6).round() / 1e6).to_string()).unwrap_or_default()
}
