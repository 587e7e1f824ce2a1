//! Progress over many runs: a bar on a terminal, or else plain lines.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// Lines that are printed in total if there is no bar.
const LINES: usize = 20;

pub struct Progress {
    bar: Option<ProgressBar>,
    lines: usize,
    /// The last total, which grows while a search goes on.
    of: usize,
}

impl Progress {
    pub fn new(headless: bool) -> Self {
        let style = ProgressStyle::with_template("{wide_bar:.cyan/dim}  {pos} of {len} runs, {eta} to go")
            .expect("a template that is right")
            .progress_chars("━╸─");
        let bar = ProgressBar::new(0).with_style(style);
        bar.enable_steady_tick(Duration::from_millis(200));
        let shown = !headless && !bar.is_hidden();
        Self { bar: shown.then_some(bar), lines: 0, of: 0 }
    }

    pub fn show(&mut self, done: usize, of: usize) {
        match &self.bar {
            Some(bar) => {
                if bar.length() != Some(of as u64) {
                    // Runs that a resumed sweep already has say nothing about the remaining time.
                    bar.set_length(of as u64);
                    bar.set_position(done as u64);
                    bar.reset_eta();
                }
                bar.set_position(done as u64);
            }
            None if done * LINES / of.max(1) >= self.lines || of != self.of => {
                (self.lines, self.of) = (done * LINES / of.max(1) + 1, of);
                note!("{done} of {of} runs");
            }
            None => {}
        }
    }

    pub fn close(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}
