//! How likely it is that the robot is lost, from how well its scans fit.

/// Logarithms of the odds stay between these: a robot is never beyond doubt, nor beyond hope.
const LIMITS: [f64; 2] = [-16.0, 6.0];
/// A scan that fits so well, beside what is usual, says nothing of whether the robot is lost; one that fits worse is bad.
/// On public logs, scans of lost robots reach some 0.5, and others seldom less than 0.8.
const NEUTRAL: f64 = 0.8;
/// By how much one that fits by a hundredth of the usual better or worse changes the logarithm of the odds, times 100.
const SLOPE: f64 = 40.0;
/// A scan of fewer votes says less.
const VOTES: f64 = 10.0;
/// How fast what is usual follows scans that fit, and bad ones.
const RATES: [f64; 2] = [0.05, 0.01];
/// While the logarithm of the odds is above that, nothing is learned of what is usual.
const UNSURE: f64 = -5.0;

/// The odds that the robot is at none of the particles: a filter with two states and one number to go by, which share of
/// a scan's votes is at walls where it fits best.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Doubt {
    /// Logarithm of the odds.
    odds: f64,
    /// Share of the votes that is usual.
    usual: f64,
    /// How many scans in a row were bad.
    bad: u32,
}

impl Doubt {
    /// Of a robot that is where it was said to be.
    pub fn none() -> Self {
        Self { odds: LIMITS[0], usual: 0.9, bad: 0 }
    }

    /// Of a robot that may be anywhere.
    pub fn even() -> Self {
        Self { odds: 0.0, ..Self::none() }
    }

    /// Takes in which share of a scan's votes is at walls where it fits best.
    pub fn see(&mut self, share: f64, votes: f64) {
        let fit = self.relative(share);
        let weight = (votes / VOTES).min(1.0);
        self.odds = (self.odds + weight * SLOPE * (NEUTRAL - fit)).clamp(LIMITS[0], LIMITS[1]);
        self.bad = if fit < NEUTRAL { self.bad + 1 } else { 0 };
        if self.odds < UNSURE {
            self.usual += RATES[usize::from(self.bad > 0)] * (share - self.usual);
        }
    }

    /// Such a share beside the usual one.
    pub fn relative(&self, share: f64) -> f64 {
        share / self.usual
    }

    /// How many scans in a row were bad.
    pub fn bad(&self) -> u32 {
        self.bad
    }

    /// How likely it is that the robot is lost.
    pub fn probability(&self) -> f64 {
        1.0 / (1.0 + (-self.odds).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_bad_scan_raises_doubt_two_make_sure_and_good_ones_end_it() {
        let mut doubt = Doubt::none();
        (0..20).for_each(|_| doubt.see(0.95, 30.0));
        assert!(doubt.probability() < 1e-6 && doubt.bad() == 0);
        doubt.see(0.5, 30.0);
        assert!((1e-4..0.5).contains(&doubt.probability()), "{}", doubt.probability());
        doubt.see(0.5, 30.0);
        assert!(doubt.probability() > 0.9 && doubt.bad() == 2);
        assert!((doubt.relative(0.5) - 0.5 / 0.93).abs() < 0.03, "{}", doubt.relative(0.5));
        (0..4).for_each(|_| doubt.see(0.95, 30.0));
        assert!(doubt.probability() < 1e-6 && doubt.bad() == 0);
    }

    #[test]
    fn what_is_usual_is_learned_but_not_from_a_lost_robot() {
        let (mut cluttered, mut lost) = (Doubt::none(), Doubt::none());
        (0..100).for_each(|_| cluttered.see(0.75, 30.0));
        assert!(cluttered.relative(0.65) > NEUTRAL && cluttered.probability() < 1e-6);
        (0..100).for_each(|_| lost.see(0.5, 30.0));
        assert!(lost.relative(0.65) < NEUTRAL && lost.probability() > 0.9);
    }

    #[test]
    fn a_scan_of_few_beams_says_little() {
        let mut doubt = Doubt::none();
        doubt.see(0.0, 0.5);
        assert!(doubt.probability() < 1e-5);
    }
}
