//! Lines of the live view, which fit the terminal also while its width changes.

use std::iter::repeat;

use console::{Term, measure_text_width};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use crate::{output, table::wrap};

/// Resolution of the progress bar.
const STEPS: u64 = 10_000;
/// Columns between a label and its text.
const GAP: usize = 2;
/// Columns of a terminal that does not say how many it has.
const USUAL: usize = 80;

/// A progress bar, and labelled lines below it. Longer text is wrapped.
pub struct Lines {
    terminal: MultiProgress,
    bar: ProgressBar,
    lines: Vec<Line>,
    /// Columns of labels.
    label: usize,
    /// Columns of the terminal when it was drawn.
    width: usize,
}

struct Line {
    text: String,
    shown: ProgressBar,
    rows: usize,
}

impl Lines {
    /// Draws a progress bar. Labels are padded to `label` columns.
    pub fn new(terminal: &MultiProgress, name: &str, label: usize) -> Self {
        let style = ProgressStyle::with_template("{prefix:.bold}  {wide_bar:.cyan/dim}  {msg}")
            .expect("a template that is right")
            .progress_chars("━╸─");
        let bar = terminal.add(ProgressBar::new(STEPS).with_style(style));
        bar.set_prefix(format!("{name:label$}"));
        Self { terminal: terminal.clone(), bar, lines: Vec::new(), label, width: columns() }
    }

    /// Adds a line, and returns its number.
    pub fn add(&mut self, label: &str, text: &str) -> usize {
        // The label comes first, so that all lines are aligned.
        let style = ProgressStyle::with_template("{prefix:.bold}  {msg}").expect("a template that is right");
        let shown = self.terminal.add(ProgressBar::new_spinner().with_style(style));
        let label = output::escaped(label, false);
        shown.set_prefix(format!("{label:width$}", width = self.label));
        self.lines.push(Line { text: String::new(), shown, rows: 1 });
        let number = self.lines.len() - 1;
        self.set(number, text.to_owned());
        number
    }

    /// Changes the text of a line.
    pub fn set(&mut self, number: usize, text: String) {
        let line = &mut self.lines[number];
        let text = output::escaped(&text, console::colors_enabled_stderr()).into_owned();
        let wrapped = wrapped(&text, self.label + GAP, self.width);
        line.rows = rows(&wrapped, self.label + GAP, self.width);
        line.text = text;
        line.shown.set_message(wrapped);
    }

    /// Changes the bar: the progress from 0 to 1, and in words.
    pub fn progress(&self, share: f64, text: String) {
        self.bar.set_position((share * STEPS as f64) as u64);
        self.bar.set_message(output::escaped(&text, console::colors_enabled_stderr()).into_owned());
    }

    /// Fits the lines to the terminal if its width has changed, and leaves nothing of those before.
    pub fn fit(&mut self) {
        let (before, now) = (self.width, columns());
        if before == now {
            return;
        }
        let drawn = 1 + self.lines.iter().map(|line| line.rows).sum::<usize>();
        let flowed = rows_after(drawn, before, now);
        let screen = Term::stderr();
        // The lines are cleared as far as they reached. A wider terminal has joined them to fewer rows, and others above
        // must stay; a narrower one has broken them into more. What cannot be written is not drawn either.
        let _ = screen.write_str(&"\n".repeat(drawn.saturating_sub(flowed)));
        self.terminal.suspend(|| {
            let _ = screen.clear_last_lines(flowed.saturating_sub(drawn));
        });
        self.width = now;
        for number in 0..self.lines.len() {
            let text = std::mem::take(&mut self.lines[number].text);
            self.set(number, text);
        }
    }

    /// Removes the lines.
    pub fn close(self) {
        let lines = self.lines.into_iter().map(|line| line.shown).chain([self.bar]);
        lines.for_each(|line| line.finish_and_clear());
    }
}

/// Returns the width of the terminal.
fn columns() -> usize {
    Term::stderr().size_checked().map_or(USUAL, |(_, columns)| usize::from(columns).max(1))
}

/// Returns the rows that full rows take after the width of the terminal has changed. Terminals join rows that are full, and
/// break them again.
fn rows_after(rows: usize, before: usize, now: usize) -> usize {
    (rows * before).div_ceil(now)
}

/// Returns the rows of wrapped text behind a label. The terminal breaks words that are longer than a row, such as a path.
fn rows(wrapped: &str, indent: usize, width: usize) -> usize {
    let first = [indent].into_iter().chain(repeat(0));
    let columns = wrapped.lines().zip(first).map(|(line, before)| before + measure_text_width(line));
    columns.map(|columns| columns.div_ceil(width).max(1)).sum::<usize>().max(1)
}

/// Wraps text behind a label. Rows after the first are indented.
fn wrapped(text: &str, indent: usize, width: usize) -> String {
    wrap(text, &" ".repeat(indent), width).trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_text_is_wrapped_and_not_cut() {
        let text =
            "at (12.34, 5.67), R1 (-52 dBm), navigation on cloud, navigation 12.3 ms, localization 30.1 ms";
        let shown = wrapped(text, 10, 80);
        assert_eq!(shown.split_whitespace().collect::<Vec<_>>(), text.split_whitespace().collect::<Vec<_>>());
        let rows: Vec<_> = shown.lines().collect();
        assert_eq!(rows.len(), 2, "{shown}");
        assert!(
            rows[0].len() + 10 <= 80 && rows[1].len() <= 80 && rows[1].starts_with("          "),
            "{shown}"
        );
        assert_eq!(wrapped("", 10, 80), "");
    }

    #[test]
    fn words_longer_than_a_row_take_several() {
        assert_eq!(rows("", 10, 80), 1);
        assert_eq!(rows(&wrapped(&"x".repeat(70), 10, 80), 10, 80), 1);
        assert_eq!(rows(&wrapped(&"x".repeat(71), 10, 80), 10, 80), 2);
        assert_eq!(rows(&wrapped(&format!("run in {}", "x".repeat(171)), 10, 80), 10, 80), 4);
    }

    #[test]
    fn full_rows_are_joined_and_broken_with_the_width() {
        assert_eq!(rows_after(4, 120, 80), 6);
        assert_eq!(rows_after(4, 80, 120), 3);
        assert_eq!(rows_after(5, 80, 80), 5);
    }
}
