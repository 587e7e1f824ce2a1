//! Coverage of the intervals: over synthetic sites whose true values are known, 95 % intervals hold about 95 % of them.
//!
//! A few sites are fitted each time. With `COTORRA_FULL`, it is 200, and the share must be from 91 to 98 %.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

mod fading;
mod handovers;
mod interference;
mod links;
mod one_way;
mod paths;
mod predictions;
mod survey;

use std::{collections::BTreeMap, env};

use cotorra_calibrate::Estimate;
use cotorra_numbers::Draws;

/// Sites that are fitted each time.
const USUAL: usize = 40;
/// Sites with `COTORRA_FULL`.
const FULL: usize = 200;

/// Share of intervals that held the true value, by parameter.
#[derive(Debug, Default)]
struct Coverage(BTreeMap<&'static str, Vec<bool>>);

impl Coverage {
    fn count(&mut self, parameter: &'static str, estimate: Estimate, truth: f64) {
        self.0.entry(parameter).or_default().push(estimate.covers(truth));
    }

    /// Panics unless each share is as it should be.
    fn check(self) {
        let mut wrong = Vec::new();
        for (parameter, held) in &self.0 {
            let share = held.iter().filter(|held| **held).count() as f64 / held.len() as f64;
            println!("{parameter}: {:.1} % of {}", share * 100.0, held.len());
            // Fewer sites: 3 standard deviations below 95 %.
            let expected = if held.len() > FULL * 9 / 10 { 0.91..=0.98 } else { 0.84..=1.0 };
            if !expected.contains(&share) {
                wrong.push(format!("{parameter}: {:.1} % of {}", share * 100.0, held.len()));
            }
        }
        assert!(wrong.is_empty(), "{wrong:?}");
    }
}

fn sites() -> usize {
    if env::var_os("COTORRA_FULL").is_some() { FULL } else { USUAL }
}

fn between(draws: &mut Draws, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * draws.unit()
}
