//! The table of a run's services, for a terminal of 80 columns.

use cotorra_testbed::DataTable;

use crate::{table::Table, words::count};

const HEADS: [&str; 9] =
    ["robot", "service", "samples", "unanswered", "kept %", "median", "p95", "p99", "max"];
/// Column of the targets in the data. The verdicts name them.
const TARGET: usize = 2;

/// Renders the rows of [`by_service`](cotorra_testbed::by_service) without their targets: those of the total, and of services
/// with these names.
pub fn service_table(services: &DataTable, is_shown: impl Fn(&str) -> bool) -> String {
    let mut table = Table::new("<<>>>>>>>");
    table.row(HEADS);
    // The total is of no service.
    let (totals, services): (Vec<_>, Vec<_>) = services.rows()[1..].iter().partition(|row| row[1].is_empty());
    let shown: Vec<_> = services.iter().copied().filter(|row| is_shown(&row[1])).collect();
    let of = match shown.len() < services.len() {
        true => format!(" of the worst {} of {}", shown.len(), count(services.len(), "service")),
        false => String::new(),
    };
    for row in shown.into_iter().chain(totals) {
        let mut cells = row.clone();
        cells.remove(TARGET);
        // No robot has a blank in its name. That of the total takes both columns.
        if let Some((all, others)) = row[0].rsplit_once(' ') {
            [cells[0], cells[1]] = [all, others].map(str::to_owned);
        }
        table.row(cells);
    }
    format!("  Service times{of} in ms:\n{}", table.render("  "))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SERVICE: [&str; 10] =
        ["robot", "localization", "200", "12345", "123", "100.00", "20.31", "29.35", "29.44", "161.93"];

    fn render(rows: &[[&str; 10]]) -> String {
        let mut data = DataTable::new(SERVICE);
        rows.iter().for_each(|row| data.row(*row));
        service_table(&data, |_| true)
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
    fn services_that_are_left_out_are_counted() {
        let mut data = DataTable::new(SERVICE);
        let total = ["all", "", "", "12345", "0", "100.00", "1.00", "1.00", "1.00", "1.00"];
        let navigation = SERVICE.map(|cell| if cell == "localization" { "navigation" } else { cell });
        [SERVICE, navigation, total].into_iter().for_each(|row| data.row(row));
        let text = service_table(&data, |service| service == "navigation");
        assert!(text.starts_with("  Service times of the worst 1 of 2 services in ms:\n"), "{text}");
        assert!(
            text.contains("navigation") && !text.contains("localization") && text.contains("\n  all "),
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
