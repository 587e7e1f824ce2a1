//! Losses and their bursts.

use cotorra_graph::{Loss, Probability};
use cotorra_numbers::Draws;
use serde::Serialize;

use crate::estimate::Estimate;

/// Draws of the posterior.
const DRAWS: usize = 4000;
/// 95 % quantile of χ² with one degree of freedom.
const SIGNIFICANT: f64 = 3.841;
/// Fewest bursts whose mean length is estimated.
const LEAST_BURSTS: u32 = 3;

/// Losses of one series of packets.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LossFit {
    /// Number of lost packets.
    pub lost: usize,
    /// Long-run share of lost packets.
    pub share: Estimate,
    /// Mean number of packets that are lost in a row; `None` with few bursts.
    pub mean_burst: Option<Estimate>,
    /// Whether losses come in bursts, rather than independently: a likelihood-ratio test at 5 %.
    pub bursty: bool,
}

impl LossFit {
    /// Returns the loss for a testbed.
    pub fn model(&self) -> Loss {
        let Some(rate) = Probability::new(self.share.value).filter(|_| self.lost > 0) else {
            return Loss::None;
        };
        match self.mean_burst {
            // The good state cannot be left with a probability above one.
            Some(burst) if self.bursty && rate.get() / (1.0 - rate.get()) <= burst.value => {
                Loss::Bursty { rate, mean_burst: burst.value.max(1.0) }
            }
            _ => Loss::Independent { rate },
        }
    }
}

/// Transitions between good packets and lost ones.
#[derive(Debug, Default)]
struct Transitions {
    /// From good to good, and to lost.
    good: [u32; 2],
    /// From lost to good, and to lost.
    lost: [u32; 2],
}

/// Fits Gilbert's model, whose transitions are counted (Gilbert 1960), and its special case of independent losses.
///
/// Both probabilities of transition have Jeffreys' prior, Beta(1/2, 1/2), and so a beta posterior. Share and mean burst follow
/// from them as in [`Loss::Bursty`]: p/(p + r) and 1/r.
pub(crate) fn fit(lost: &[bool], draws: &mut Draws) -> LossFit {
    let number = lost.iter().filter(|lost| **lost).count();
    let mut counts = Transitions::default();
    for pair in lost.windows(2) {
        let from = if pair[0] { &mut counts.lost } else { &mut counts.good };
        from[usize::from(pair[1])] += 1;
    }
    let bursty = counts.gain() > SIGNIFICANT && counts.lost[1] > 0 && {
        let [good, lost] =
            [&counts.good, &counts.lost].map(|[a, b]| f64::from(*b) / f64::from(a + b).max(1.0));
        lost > good
    };
    let (mut shares, mut bursts) = (Vec::with_capacity(DRAWS), Vec::with_capacity(DRAWS));
    let after = |prior: u32| f64::from(prior) + 0.5;
    for _ in 0..DRAWS {
        let leaves = draws.beta(after(counts.lost[0]), after(counts.lost[1]));
        let enters = draws.beta(after(counts.good[1]), after(counts.good[0]));
        bursts.push(1.0 / leaves);
        shares.push(match bursty {
            true => enters / (enters + leaves),
            false => draws.beta(number as f64 + 0.5, (lost.len() - number) as f64 + 0.5),
        });
    }
    let share = number as f64 / lost.len().max(1) as f64;
    let ended = counts.lost[0];
    let mean_burst = (ended >= LEAST_BURSTS)
        .then(|| Estimate::around(f64::from(ended + counts.lost[1]) / f64::from(ended), &mut bursts));
    let mut share = Estimate::around(share, &mut shares);
    if number == 0 {
        share.low = 0.0;
    }
    LossFit { lost: number, share, mean_burst, bursty }
}

impl Transitions {
    /// Twice the logarithm of the likelihood ratio of two states against one.
    fn gain(&self) -> f64 {
        let log = |[a, b]: [u32; 2]| {
            let term =
                |n: u32| if n == 0 { 0.0 } else { f64::from(n) * (f64::from(n) / f64::from(a + b)).ln() };
            term(a) + term(b)
        };
        let both = [self.good[0] + self.lost[0], self.good[1] + self.lost[1]];
        2.0 * (log(self.good) + log(self.lost) - log(both))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fitted(text: &str) -> LossFit {
        let lost: Vec<bool> = text.chars().map(|c| c == 'x').collect();
        fit(&lost, &mut Draws::new(1, "loss"))
    }

    #[test]
    fn bursts_are_told_from_independent_losses() {
        let bursty = fitted(&"..........................xxxx".repeat(20));
        assert!(bursty.bursty);
        let Loss::Bursty { rate, mean_burst } = bursty.model() else { panic!("{bursty:?}") };
        assert!((rate.get() - 4.0 / 30.0).abs() < 1e-9);
        // The last burst has no end.
        assert!((mean_burst - 79.0 / 19.0).abs() < 1e-9, "{mean_burst}");
        let single = fitted(&".........x".repeat(40));
        assert!(!single.bursty, "never twice in a row is no burst");
        assert!(matches!(single.model(), Loss::Independent { .. }));
    }

    #[test]
    fn no_loss_leaves_a_bound_on_the_share() {
        let none = fitted(&".".repeat(200));
        assert_eq!((none.lost, none.model(), none.mean_burst), (0, Loss::None, None));
        // Jeffreys' interval of 0 in 200 ends at 1.2 %.
        assert!((0.009..0.016).contains(&none.share.high), "{none:?}");
    }

    #[test]
    fn few_losses_give_a_wide_interval_and_no_burst_length() {
        let few = fitted(&format!("{}x{}", ".".repeat(50), ".".repeat(49)));
        assert!(few.mean_burst.is_none());
        // Jeffreys' interval of 1 in 100 is 0.1 % to 4.6 %.
        assert!(few.share.low < 0.002 && few.share.high > 0.04, "{few:?}");
    }
}
