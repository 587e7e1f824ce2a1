//! Tables of results for other programs and for papers: CSV, LaTeX and Markdown.

use std::fmt::Write as _;

/// A table of results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DataTable {
    /// Whether each column is aligned to the right.
    right: Vec<bool>,
    /// All rows. The first one has the heads of the columns.
    rows: Vec<Vec<String>>,
}

impl DataTable {
    /// Creates a table without rows. Columns are aligned to the left.
    pub fn new<S: Into<String>>(heads: impl IntoIterator<Item = S>) -> Self {
        let heads: Vec<String> = heads.into_iter().map(Into::into).collect();
        Self { right: vec![false; heads.len()], rows: vec![heads] }
    }

    /// Aligns all columns after the first `columns` to the right.
    pub fn right_after(mut self, columns: usize) -> Self {
        self.right.iter_mut().skip(columns).for_each(|right| *right = true);
        self
    }

    /// Adds a row.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        let cells: Vec<String> = cells.into_iter().map(Into::into).collect();
        debug_assert_eq!(cells.len(), self.right.len(), "{cells:?}");
        self.rows.push(cells);
    }

    /// Returns all rows, the heads first.
    pub fn rows(&self) -> &[Vec<String>] {
        &self.rows
    }

    /// Returns the table as comma-separated values (RFC 4180), with cells quoted where necessary.
    pub fn to_csv(&self) -> String {
        let mut text = csv::Writer::from_writer(Vec::new());
        for row in &self.rows {
            text.write_record(row).expect("rows are equally long, and memory can be written");
        }
        String::from_utf8(text.into_inner().expect("memory can be written")).expect("cells are UTF-8")
    }

    /// Returns the table as a LaTeX `tabular` with the rules of the package booktabs.
    pub fn to_latex(&self) -> String {
        let columns: String = self.right.iter().map(|right| if *right { 'r' } else { 'l' }).collect();
        let lines = self.lines("", " & ", " \\\\\n", |cell| latex(cell));
        let (head, body) = lines.split_first().expect("a table has heads");
        let body = body.concat();
        format!(
            "% \\usepackage{{booktabs}}\n\\begin{{tabular}}{{{columns}}}\n\\toprule\n{head}\\midrule\n{body}\\bottomrule\n\
             \\end{{tabular}}\n"
        )
    }

    /// Returns the table in Markdown.
    pub fn to_markdown(&self) -> String {
        let mut lines = self.lines("| ", " | ", " |\n", |cell| cell.replace('|', "\\|"));
        let rules: String = self.right.iter().map(|right| if *right { "---:|" } else { "---|" }).collect();
        lines.insert(1, format!("|{rules}\n"));
        lines.concat()
    }

    fn lines(&self, begin: &str, between: &str, end: &str, cell: impl Fn(&String) -> String) -> Vec<String> {
        let line = |row: &Vec<String>| {
            let cells: Vec<_> = row.iter().map(&cell).collect();
            format!("{begin}{}{end}", cells.join(between))
        };
        self.rows.iter().map(line).collect()
    }
}

/// Escapes the characters that LaTeX gives a meaning, and those that its text fonts lack.
fn latex(text: &str) -> String {
    let mut escaped = String::new();
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => write!(escaped, "\\{c}"),
            '~' => write!(escaped, "\\textasciitilde{{}}"),
            '^' => write!(escaped, "\\textasciicircum{{}}"),
            '\\' => write!(escaped, "\\textbackslash{{}}"),
            '<' | '>' | '|' => write!(escaped, "${c}$"),
            '±' => write!(escaped, "$\\pm$"),
            'µ' => write!(escaped, "$\\mu$"),
            c => write!(escaped, "{c}"),
        }
        .expect("writing into a string cannot fail");
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> DataTable {
        let mut table = DataTable::new(["path", "median, ms"]).right_after(1);
        table.row(["links.*.delay_scale", "11.21 ± 0.02"]);
        table.row(["say \"50 %\", twice", "-"]);
        table
    }

    #[test]
    fn csv_quotes_what_would_break_a_row() {
        let text = "path,\"median, ms\"\nlinks.*.delay_scale,11.21 ± 0.02\n\"say \"\"50 %\"\", twice\",-\n";
        assert_eq!(table().to_csv(), text);
    }

    #[test]
    fn latex_escapes_what_it_would_interpret() {
        let lines = [
            "% \\usepackage{booktabs}",
            "\\begin{tabular}{lr}",
            "\\toprule",
            "path & median, ms \\\\",
            "\\midrule",
            "links.*.delay\\_scale & 11.21 $\\pm$ 0.02 \\\\",
            "say \"50 \\%\", twice & - \\\\",
            "\\bottomrule",
            "\\end{tabular}\n",
        ];
        assert_eq!(table().to_latex(), lines.join("\n"));
        assert_eq!(
            latex("a\\b~c^d{e}<f"),
            "a\\textbackslash{}b\\textasciitilde{}c\\textasciicircum{}d\\{e\\}$<$f"
        );
    }

    #[test]
    fn markdown_aligns_columns_and_keeps_bars_inside_cells() {
        let mut table = table();
        table.row(["a|b", "1"]);
        let text = table.to_markdown();
        assert!(text.starts_with("| path | median, ms |\n|---|---:|\n| links.*.delay_scale | "), "{text}");
        assert!(text.ends_with("| a\\|b | 1 |\n"), "{text}");
    }
}
