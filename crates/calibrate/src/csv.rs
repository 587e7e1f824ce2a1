//! Tables of comma-separated values (RFC 4180) as people and their tools write them: with or without quotes and a byte order
//! mark. Lines that begin with `#`, and empty ones, are skipped everywhere.

use crate::error::CalibrateError;

/// Largest number of lines of a file of measurements.
pub const MAX_LINES: usize = 1_000_000;

/// A row, its cells without quotes and without spaces around them.
#[derive(Debug)]
pub struct CsvRow {
    /// Number of its last line, from 1.
    pub line: usize,
    cells: csv::StringRecord,
}

/// Returns the rows of a table, its header included.
pub fn csv_rows(text: &str) -> impl Iterator<Item = CsvRow> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let (mut line, mut counted) = (1, 0);
    let rows = std::iter::from_fn(move || {
        let mut cells = csv::StringRecord::new();
        let is_row = reader.read_record(&mut cells).expect("a text in memory is readable, and UTF-8");
        // The reader's own number of lines is that before comments.
        let read = usize::try_from(reader.position().byte()).unwrap_or(text.len());
        let end = text[..read].trim_end_matches(['\r', '\n']).len();
        line += text[counted..end].matches('\n').count();
        counted = end;
        is_row.then_some(CsvRow { line, cells })
    });
    rows.filter(|row| row.cells.iter().any(|cell| !cell.is_empty()))
}

impl CsvRow {
    /// Returns its cells.
    pub fn cells(&self) -> impl Iterator<Item = &str> {
        self.cells.iter()
    }

    pub(crate) fn text(&self, column: usize) -> &str {
        &self.cells[column]
    }

    /// Returns a number within bounds.
    pub(crate) fn number(&self, column: usize, [least, most]: [f64; 2]) -> Result<f64, CalibrateError> {
        let number = self.text(column).parse().ok().filter(|number: &f64| (least..=most).contains(number));
        number.ok_or_else(|| {
            let found: String = self.text(column).chars().take(40).collect();
            CalibrateError::line(self.line, format!("`{found}` is not a number from {least} to {most}"))
        })
    }
}

/// A table with a header, whose columns can be in any order.
#[derive(Debug)]
pub(crate) struct Table<'a> {
    text: &'a str,
    header: CsvRow,
}

impl<'a> Table<'a> {
    /// Reads the header.
    pub fn new(text: &'a str) -> Result<Self, CalibrateError> {
        let header = csv_rows(text)
            .next()
            .ok_or_else(|| CalibrateError::Unreadable("the file is empty: it needs a header".to_owned()))?;
        Ok(Self { text, header })
    }

    /// Returns the place of a column; `None` if the table has none of that name.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.header.cells().position(|column| column == name)
    }

    /// Returns the place of a column that must be there.
    pub fn required(&self, name: &str, usual: &str) -> Result<usize, CalibrateError> {
        self.column(name).ok_or_else(|| {
            let reason = format!("there is no column `{name}`: write a header such as `{usual}`");
            CalibrateError::line(self.header.line, reason)
        })
    }

    /// Returns the rows below the header.
    pub fn rows(&self) -> impl Iterator<Item = Result<CsvRow, CalibrateError>> + use<'a> {
        let columns = self.header.cells.len();
        csv_rows(self.text).skip(1).map(move |row| {
            let cells = row.cells.len();
            if cells == columns {
                return Ok(row);
            }
            let reason = format!("it has {cells} cells, but the header has {columns}");
            Err(CalibrateError::line(row.line, reason))
        })
    }
}

/// Rejects a text with too many lines.
pub(crate) fn check_length(text: &str) -> Result<(), CalibrateError> {
    match text.lines().nth(MAX_LINES) {
        Some(_) => Err(CalibrateError::Unreadable(format!("the file has more than {MAX_LINES} lines"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Vec<(usize, Vec<String>)> {
        csv_rows(text).map(|row| (row.line, row.cells().map(str::to_owned).collect())).collect()
    }

    #[test]
    fn quotes_marks_and_line_ends_change_nothing() {
        let plain = read("time_s,rtt_ms\n0, 4.5\n1,\n");
        assert_eq!(plain[1..], [(2, vec!["0".into(), "4.5".into()]), (3, vec!["1".into(), String::new()])]);
        for text in [
            "\u{feff}time_s,rtt_ms\n0,4.5\n1,",
            "\"time_s\",\"rtt_ms\"\n\"0\",\"4.5\"\n\"1\",\"\"\n",
            "\u{feff}\"time_s\",\"rtt_ms\"\r\n0,\"4.5\"\r\n1,\r\n",
        ] {
            assert_eq!(read(text), plain, "{text:?}");
        }
        assert_eq!(read("\"a \"\"b\"\", c\",1\n"), [(1, vec!["a \"b\", c".into(), "1".into()])]);
    }

    #[test]
    fn rows_keep_their_lines_beside_comments_and_empty_lines() {
        for end in ["\n", "\r\n"] {
            let text = ["# one", "a,b", "", "# four, \"", "1,2", "  ", "3,4", ""].join(end);
            let lines: Vec<_> = read(&text).into_iter().map(|(line, cells)| (line, cells.concat())).collect();
            assert_eq!(lines, [(2, "ab".into()), (5, "12".into()), (7, "34".into())], "{end:?}");
        }
        assert_eq!(read("\n \n# x\n"), []);
    }
}
