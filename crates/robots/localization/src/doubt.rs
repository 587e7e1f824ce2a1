//! How likely it is that a robot is where particles say, from how well its scans fit there.

/// Logarithms of the odds stay between these: no particles are beyond doubt, nor beyond hope.
const LEAST: f64 = -8.0;
const MOST: f64 = 16.0;
/// Odds at which particles begin that were chosen to fit a scan, and at which their robot counts as followed.
const CHOSEN: f64 = -4.0;
const FOLLOWED: f64 = 5.0;
/// A scan that fits so well, beside what is usual, says nothing; one that fits worse is bad. Wrong places fit by chance,
/// and the less so the more votes a scan has: on public logs, scans of lost robots reach 0.7 of what is usual with 30 votes
/// and 0.3 with 100, and those of others seldom less than 0.9 and 0.7.
pub(crate) fn neutral(votes: f64) -> f64 {
    (0.3 + 2.7 / votes.sqrt()).min(0.8)
}
/// By how much one that fits by a hundredth of the usual better or worse changes the logarithm of the odds, times 100.
const SLOPE: f64 = 40.0;
/// A scan of fewer votes says less.
const VOTES: f64 = 10.0;
/// Scans that far apart err independently, metres.
const APART: f64 = 1.0;
/// How fast what is usual follows scans that fit, and bad ones.
const RATES: [f64; 2] = [0.05, 0.01];

/// Which share of a scan's votes is usually at walls where it fits best.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Usual(f64);

impl Usual {
    pub fn new() -> Self {
        Self(0.9)
    }

    /// Such a share beside the usual one.
    pub fn relative(self, share: f64) -> f64 {
        share / self.0
    }

    /// Learns from a scan of a robot that is followed.
    pub fn learn(&mut self, share: f64, bad: bool) {
        self.0 += RATES[usize::from(bad)] * (share - self.0);
    }
}

/// The logarithm of the odds that the robot is at these particles, against that it is at none that are known: a
/// sequential probability ratio test. Of scans taken near each other, only the last counts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Odds {
    log: f64,
    /// The same before the scans of the last metre.
    before: f64,
    /// How far the robot has gone since.
    gone: f64,
}

impl Odds {
    fn new(log: f64) -> Self {
        Self { log, before: log, gone: 0.0 }
    }

    /// Of a robot that is where it was said to be.
    pub fn sure() -> Self {
        Self::new(MOST)
    }

    /// Of a robot that may be anywhere.
    pub fn even() -> Self {
        Self::new(0.0)
    }

    /// Of particles that were chosen to fit the last scan, of which it therefore says little.
    pub fn chosen() -> Self {
        Self::new(CHOSEN)
    }

    /// Takes in how well a scan fits that was taken so many metres on.
    pub fn see(&mut self, fit: f64, votes: f64, way: f64) {
        self.gone += way;
        let anew = (self.gone / APART).min(1.0);
        let says = (votes / VOTES).min(1.0) * SLOPE * (fit - neutral(votes));
        // A good scan near by only says the same again; a bad one says that something has changed.
        let says = if says > 0.0 { says * anew } else { says };
        self.log = (self.before + says).max(LEAST);
        if anew == 1.0 {
            (self.before, self.gone) = (self.log, 0.0);
        }
    }

    pub fn log(self) -> f64 {
        self.log
    }

    /// Takes back what is beyond the most, and returns it: the odds of all others are that much smaller.
    pub fn limit(&mut self) -> f64 {
        let excess = (self.log - MOST).max(0.0);
        (self.log, self.before) = (self.log.min(MOST), self.before.min(MOST));
        excess
    }

    /// Makes them smaller.
    pub fn lower(&mut self, excess: f64) {
        self.log = (self.log - excess).max(LEAST);
        self.before = (self.before - excess).max(LEAST);
    }

    pub fn is_followed(self) -> bool {
        self.log >= FOLLOWED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_that_fits_badly_raises_doubt_two_make_sure_and_good_ones_end_it() {
        let mut odds = Odds::sure();
        odds.see(0.5, 30.0, APART);
        assert!((-2.0..8.0).contains(&odds.log()), "{odds:?}");
        odds.see(0.5, 30.0, APART);
        odds.see(0.5, 30.0, APART);
        assert_eq!(odds.log(), LEAST);
        (0..4).for_each(|_| odds.see(1.0, 30.0, APART));
        odds.limit();
        assert_eq!(odds.log(), MOST);
    }

    #[test]
    fn scans_of_one_place_count_once() {
        let mut odds = Odds::sure();
        odds.see(0.5, 30.0, APART / 4.0);
        let once = odds.log();
        odds.see(0.5, 30.0, 0.0);
        odds.see(0.5, 30.0, APART / 4.0);
        assert_eq!(odds.log(), once);
        // Who stood before the lidar has gone.
        odds.see(1.0, 30.0, 0.0);
        assert!(odds.log() >= MOST, "{odds:?}");
        // The scan that particles were chosen to fit says nothing for them.
        let mut chosen = Odds::chosen();
        chosen.see(1.0, 30.0, 0.0);
        assert_eq!(chosen.log(), CHOSEN);
        chosen.see(1.0, 30.0, APART);
        assert!(chosen.log() > 0.0, "{chosen:?}");
    }

    #[test]
    fn many_votes_make_a_poor_fit_a_good_one() {
        let (mut few, mut many) = (Odds::even(), Odds::even());
        few.see(0.7, 25.0, APART);
        many.see(0.7, 100.0, APART);
        assert!(few.log() < 0.0 && many.log() > 0.0, "{few:?} {many:?}");
        let mut one = Odds::sure();
        one.see(0.0, 0.5, APART);
        assert!(one.log() > 14.0, "{one:?}");
    }

    #[test]
    fn odds_beyond_the_most_lower_those_of_others() {
        let (mut a, mut b) = (Odds::sure(), Odds::sure());
        a.see(1.0, 30.0, APART);
        b.lower(a.limit());
        assert_eq!(a.log(), MOST);
        assert!((b.log() - (MOST - 8.0)).abs() < 0.5, "{b:?}");
    }

    #[test]
    fn what_is_usual_is_learned() {
        let mut usual = Usual::new();
        (0..100).for_each(|_| usual.learn(0.7, false));
        assert!((usual.relative(0.7) - 1.0).abs() < 0.01);
        let before = usual.relative(0.7);
        usual.learn(0.1, true);
        assert!((usual.relative(0.7) / before - 1.0).abs() < 0.02);
    }
}
