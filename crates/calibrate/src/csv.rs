//! Tables of comma-separated values with a header, whose columns can be in any order.

use crate::error::CalibrateError;

/// Largest number of lines of a file of measurements.
pub const MAX_LINES: usize = 1_000_000;

/// A table, line by line.
#[derive(Debug)]
pub(crate) struct Table<'a> {
    text: &'a str,
    columns: Vec<&'a str>,
}

/// A row: its line number, and the cells of the columns asked for.
pub(crate) struct Row<'a> {
    pub line: usize,
    cells: Vec<&'a str>,
}

impl<'a> Table<'a> {
    /// Reads the header. Lines that begin with `#`, and empty ones, are skipped everywhere.
    pub fn new(text: &'a str) -> Result<Self, CalibrateError> {
        let (_, header) = lines(text)
            .next()
            .ok_or_else(|| CalibrateError::Unreadable("the file is empty: it needs a header".to_owned()))?;
        Ok(Self { text, columns: header.split(',').map(str::trim).collect() })
    }

    /// Returns the place of a column; `None` if the table has none of that name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| *column == name)
    }

    /// Returns the place of a column that must be there.
    pub fn required(&self, name: &str, usual: &str) -> Result<usize, CalibrateError> {
        self.column(name).ok_or_else(|| {
            CalibrateError::line(1, format!("there is no column `{name}`: write a header such as `{usual}`"))
        })
    }

    /// Returns the rows.
    pub fn rows(&self) -> impl Iterator<Item = Result<Row<'a>, CalibrateError>> {
        let columns = self.columns.len();
        lines(self.text).skip(1).map(move |(line, text)| {
            let cells: Vec<_> = text.split(',').map(str::trim).collect();
            match cells.len() == columns {
                true => Ok(Row { line, cells }),
                false => Err(CalibrateError::line(
                    line,
                    format!("it has {} cells, but the header has {columns}", cells.len()),
                )),
            }
        })
    }
}

impl<'a> Row<'a> {
    pub fn text(&self, column: usize) -> &'a str {
        self.cells[column]
    }

    /// Returns a number within bounds.
    pub fn number(&self, column: usize, [least, most]: [f64; 2]) -> Result<f64, CalibrateError> {
        let number = self.text(column).parse().ok().filter(|number: &f64| (least..=most).contains(number));
        number.ok_or_else(|| {
            let found: String = self.text(column).chars().take(40).collect();
            CalibrateError::line(self.line, format!("`{found}` is not a number from {least} to {most}"))
        })
    }
}

fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// Rejects a text with too many lines.
pub(crate) fn check_length(text: &str) -> Result<(), CalibrateError> {
    match text.lines().nth(MAX_LINES) {
        Some(_) => Err(CalibrateError::Unreadable(format!("the file has more than {MAX_LINES} lines"))),
        None => Ok(()),
    }
}
