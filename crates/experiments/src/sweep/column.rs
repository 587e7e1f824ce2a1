//! Columns of tables: figures by the names of their declarations, and others.

use cotorra_graph::{Figure, Statistic, Total};

/// A column of a table: its name, and a value.
pub(crate) type Column<T> = (String, T);

/// Returns the column of a figure that is one number.
pub(crate) fn total<T>(total: Total, value: T) -> Column<T> {
    (total.declared().column(None), value)
}

/// Returns the column of a statistic of service times.
pub(crate) fn service_time<T>(statistic: Statistic, value: T) -> Column<T> {
    (Figure::ServiceTime { service: None, robot: None }.declared().column(Some(statistic)), value)
}

/// Returns the column of a statistic of the times that handovers took.
pub(crate) fn handover_gap<T>(statistic: Statistic, value: T) -> Column<T> {
    (Figure::HandoverGap { robot: None }.declared().column(Some(statistic)), value)
}

/// Returns the column of the share of samples above the target, which is what `kept` leaves.
pub(crate) fn above_target<T>(value: T) -> Column<T> {
    other("above_target", value)
}

/// Returns a column of another name.
pub(crate) fn other<T>(name: &str, value: T) -> Column<T> {
    (name.to_owned(), value)
}
