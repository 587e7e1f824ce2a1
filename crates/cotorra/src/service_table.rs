//! The table of a run's services, for a terminal of 80 columns.

use cotorra_testbed::DataTable;

use crate::table::Table;

const HEADS: [&str; 9] =
    ["robot", "service", "samples", "unanswered", "kept %", "median", "p95", "p99", "max"];
/// Column of the targets in the data. The verdicts name them.
const TARGET: usize = 2;

/// Renders the rows of [`by_service`](cotorra_testbed::by_service) without their targets.
pub fn service_table(services: &DataTable) -> String {
    let mut table = Table::new("<<>>>>>>>");
    table.row(HEADS);
    for row in &services.rows()[1..] {
        let mut cells = row.clone();
        cells.remove(TARGET);
        // No robot has a blank in its name. That of the total takes both columns.
        if let Some((all, others)) = row[0].rsplit_once(' ') {
            [cells[0], cells[1]] = [all, others].map(str::to_owned);
        }
        table.row(cells);
    }
    format!("  Service times in ms:\n{}", table.render("  "))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SERVICE: [&str; 10] =
        ["robot", "localization", "200", "12345", "123", "100.00", "20.31", "29.35", "29.44", "161.93"];

    fn render(rows: &[[&str; 10]]) -> String {
        let mut data = DataTable::new(SERVICE);
        rows.iter().for_each(|row| data.row(*row));
        service_table(&data)
    }

    #[test]
    fn the_table_fits_a_terminal_of_80_columns() {
        let text = render(&[SERVICE]);
        assert!(text.lines().all(|line| line.len() <= 80), "{text}");
        assert!(
            text.ends_with(
                "  robot  localization    12345         123  100.00   20.31  29.35  29.44  161.93\n"
            ),
            "{text}"
        );
    }

    #[test]
    fn the_name_of_the_total_takes_two_columns() {
        let total = ["all but localization", "", "", "12345", "0", "100.00", "1.00", "1.00", "1.00", "1.00"];
        let text = render(&[SERVICE, total]);
        assert!(text.contains("\n  all but  localization    12345"), "{text}");
    }
}
