//! Odds that a robot is at its particles, updated by how well each scan fits there.

/// Limits of the log odds. They keep every hypothesis open to later scans.
const LEAST: f64 = -8.0;
const MOST: f64 = 16.0;
/// Initial log odds of particles that were chosen to fit a scan, and log odds from which a robot counts as followed.
const CHOSEN: f64 = -4.0;
const FOLLOWED: f64 = 5.0;
/// Returns the relative fit that leaves the odds as they are. Scans that fit worse are bad.
///
/// Wrong places fit by chance, but less well the more votes a scan has. On public logs, scans of lost robots reach 0.7 of
/// the usual share with 30 votes and 0.3 with 100. Those of other robots seldom fall below 0.9 and 0.7.
pub(crate) fn neutral(votes: f64) -> f64 {
    (0.3 + 2.7 / votes.sqrt()).min(0.8)
}
/// Change of the log odds per unit of relative fit.
const SLOPE: f64 = 40.0;
/// Votes from which a scan has full effect; fewer have proportionally less.
const VOTES: f64 = 10.0;
/// Distance from which the errors of two scans are independent, metres.
const APART: f64 = 1.0;
/// Learning rates of the usual share: from scans that fit, and from bad ones.
const RATES: [f64; 2] = [0.05, 0.01];

/// The usual share of a scan's votes at walls, at the best particle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Usual(f64);

impl Usual {
    pub fn new() -> Self {
        Self(0.9)
    }

    /// Returns a share relative to the usual one.
    pub fn relative(self, share: f64) -> f64 {
        share / self.0
    }

    /// Learns from a scan of a followed robot.
    pub fn learn(&mut self, share: f64, bad: bool) {
        self.0 += RATES[usize::from(bad)] * (share - self.0);
    }
}

/// Log odds that the robot is at these particles, against no known hypothesis: a sequential probability ratio test. Of
/// scans taken near each other, only the last counts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Odds {
    log: f64,
    /// Log odds before the scans of the last metre.
    before: f64,
    /// Distance gone since, metres.
    gone: f64,
}

impl Odds {
    fn new(log: f64) -> Self {
        Self { log, before: log, gone: 0.0 }
    }

    /// Odds of a robot at its given start.
    pub fn sure() -> Self {
        Self::new(MOST)
    }

    /// Odds of a robot that may be anywhere.
    pub fn even() -> Self {
        Self::new(0.0)
    }

    /// Odds of particles that were chosen to fit the last scan. It is no evidence for them.
    pub fn chosen() -> Self {
        Self::new(CHOSEN)
    }

    /// Records the relative fit of a scan that was taken `way` metres after the last.
    pub fn record(&mut self, fit: f64, votes: f64, way: f64) {
        self.gone += way;
        let anew = (self.gone / APART).min(1.0);
        let evidence = (votes / VOTES).min(1.0) * SLOPE * (fit - neutral(votes));
        // A good scan near the last is no new evidence; a bad one shows that something has changed.
        let evidence = if evidence > 0.0 { evidence * anew } else { evidence };
        self.log = (self.before + evidence).max(LEAST);
        if anew == 1.0 {
            (self.before, self.gone) = (self.log, 0.0);
        }
    }

    pub fn log(self) -> f64 {
        self.log
    }

    /// Caps the log odds, and returns the excess. Lower those of all other hypotheses by it.
    pub fn limit(&mut self) -> f64 {
        let excess = (self.log - MOST).max(0.0);
        (self.log, self.before) = (self.log.min(MOST), self.before.min(MOST));
        excess
    }

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
    fn bad_scans_lower_the_odds_and_good_ones_restore_them() {
        let mut odds = Odds::sure();
        odds.record(0.5, 30.0, APART);
        assert!((-2.0..8.0).contains(&odds.log()), "{odds:?}");
        odds.record(0.5, 30.0, APART);
        odds.record(0.5, 30.0, APART);
        assert_eq!(odds.log(), LEAST);
        (0..4).for_each(|_| odds.record(1.0, 30.0, APART));
        odds.limit();
        assert_eq!(odds.log(), MOST);
    }

    #[test]
    fn scans_at_one_place_count_once() {
        let mut odds = Odds::sure();
        odds.record(0.5, 30.0, APART / 4.0);
        let once = odds.log();
        odds.record(0.5, 30.0, 0.0);
        odds.record(0.5, 30.0, APART / 4.0);
        assert_eq!(odds.log(), once);
        // A person who stood before the lidar has gone.
        odds.record(1.0, 30.0, 0.0);
        assert!(odds.log() >= MOST, "{odds:?}");
        // The scan that particles were chosen to fit is no evidence for them.
        let mut chosen = Odds::chosen();
        chosen.record(1.0, 30.0, 0.0);
        assert_eq!(chosen.log(), CHOSEN);
        chosen.record(1.0, 30.0, APART);
        assert!(chosen.log() > 0.0, "{chosen:?}");
    }

    #[test]
    fn same_fit_counts_for_a_place_only_with_many_votes() {
        let (mut few, mut many) = (Odds::even(), Odds::even());
        few.record(0.7, 25.0, APART);
        many.record(0.7, 100.0, APART);
        assert!(few.log() < 0.0 && many.log() > 0.0, "{few:?} {many:?}");
        let mut one = Odds::sure();
        one.record(0.0, 0.5, APART);
        assert!(one.log() > 14.0, "{one:?}");
    }

    #[test]
    fn odds_beyond_the_cap_lower_those_of_others() {
        let (mut a, mut b) = (Odds::sure(), Odds::sure());
        a.record(1.0, 30.0, APART);
        b.lower(a.limit());
        assert_eq!(a.log(), MOST);
        assert!((b.log() - (MOST - 8.0)).abs() < 0.5, "{b:?}");
    }

    #[test]
    fn usual_share_is_learned() {
        let mut usual = Usual::new();
        (0..100).for_each(|_| usual.learn(0.7, false));
        assert!((usual.relative(0.7) - 1.0).abs() < 0.01);
        let before = usual.relative(0.7);
        usual.learn(0.1, true);
        assert!((usual.relative(0.7) / before - 1.0).abs() < 0.02);
    }
}
