//! Tables and wrapped text for a terminal. Widths are counted in terminal columns.

use std::fmt::Write as _;

use console::{Alignment, Term, measure_text_width, pad_str};

/// Rows of cells, each column as wide as its widest cell.
#[derive(Debug, Default)]
pub struct Table {
    right: Vec<bool>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// Creates a table with one column for each character: `<` is aligned to the left, `>` to the right.
    pub fn new(alignment: &str) -> Self {
        Self { right: alignment.chars().map(|c| c == '>').collect(), rows: Vec::new() }
    }

    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.rows.push(cells.into_iter().map(Into::into).collect());
    }

    /// Creates a table for a terminal. All columns after the first `left` are aligned to the right.
    pub fn of(data: &[Vec<String>], left: usize) -> Self {
        let right = (0..data.first().map_or(0, Vec::len)).map(|column| column >= left).collect();
        Self { right, rows: data.to_vec() }
    }

    /// Renders the lines, each prefixed with `indent`.
    pub fn render(&self, indent: &str) -> String {
        let width = |column: usize| {
            self.rows
                .iter()
                .filter_map(|row| row.get(column))
                .map(|c| measure_text_width(c))
                .max()
                .unwrap_or(0)
        };
        let widths: Vec<_> = (0..self.right.len()).map(width).collect();
        let mut text = String::new();
        for row in &self.rows {
            let cells = row.iter().zip(&self.right).zip(&widths).map(|((cell, right), width)| {
                pad_str(cell, *width, if *right { Alignment::Right } else { Alignment::Left }, None)
            });
            let line = cells.collect::<Vec<_>>().join("  ");
            writeln!(text, "{indent}{}", line.trim_end()).expect("writing into a string cannot fail");
        }
        text
    }
}

/// Returns the columns of the terminal that shows the output. Output that goes elsewhere has no limit.
pub fn columns() -> usize {
    Term::stdout().size_checked().map_or(usize::MAX, |(_, columns)| columns.into())
}

/// Breaks text into lines of at most `width` columns, each prefixed with `indent`. A longer word gets a line of its own.
pub fn wrap(text: &str, indent: &str, width: usize) -> String {
    let mut wrapped = String::new();
    let mut column = 0;
    for word in text.split_whitespace() {
        let length = measure_text_width(word);
        if wrapped.is_empty() || column + 1 + length > width {
            if !wrapped.is_empty() {
                wrapped.push('\n');
            }
            wrapped.push_str(indent);
            column = measure_text_width(indent);
        } else {
            wrapped.push(' ');
            column += 1;
        }
        wrapped.push_str(word);
        column += length;
    }
    wrapped.push('\n');
    wrapped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_widest_cell_and_no_line_ends_in_blanks() {
        let mut table = Table::new("<><");
        table.row(["name", "µs", "note"]);
        table.row(["a", "12.5", ""]);
        assert_eq!(table.render("  "), "  name    µs  note\n  a     12.5\n");
    }

    #[test]
    fn text_breaks_between_words_and_nowhere_else() {
        assert_eq!(wrap("one two three", "  ", 9), "  one two\n  three\n");
        assert_eq!(wrap("one two three", "  ", usize::MAX), "  one two three\n");
        assert_eq!(wrap("incomprehensibilities so", "> ", 8), "> incomprehensibilities\n> so\n");
    }
}
