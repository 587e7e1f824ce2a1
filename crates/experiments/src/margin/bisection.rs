//! Bisection for the smallest amount of a change that breaks a target.

/// Amounts in equal steps from zero; the last one may be nearer. Their unit is the caller's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    most: u64,
    step: u64,
}

impl Grid {
    /// The grid with one amount.
    pub(crate) const ONE: Self = Self { most: 1, step: 1 };

    /// Creates a grid up to `most`; `None` if the step is zero or above `most`.
    pub fn new(most: u64, step: u64) -> Option<Self> {
        (1..=most).contains(&step).then_some(Self { most, step })
    }

    /// Returns the number of amounts above zero.
    pub(crate) fn len(self) -> u64 {
        self.most.div_ceil(self.step)
    }

    /// Returns an amount.
    pub(crate) fn at(self, place: u64) -> u64 {
        place.saturating_mul(self.step).min(self.most)
    }

    /// Returns the largest number of tests of a bisection.
    pub(crate) fn most_tests(self) -> u64 {
        1 + u64::from(self.len().next_power_of_two().trailing_zeros())
    }
}

/// A search, for a target that an amount of zero keeps. It assumes that all amounts above a breaking one break, too. Even
/// where that is wrong, the amount that it finds was tested and breaks, and the one before it was tested and does not.
#[derive(Debug, Clone)]
pub(crate) struct Bisection {
    grid: Grid,
    /// Place of the largest amount that was tested and survived.
    survived: u64,
    /// Place of the smallest amount that was tested and broke the target.
    broke: Option<u64>,
}

impl Bisection {
    pub(crate) fn new(grid: Grid) -> Self {
        Self { grid, survived: 0, broke: None }
    }

    /// Returns the next amount to test; `None` at the end. The first is the largest.
    pub(crate) fn next(&self) -> Option<u64> {
        let place = match self.broke {
            None => Some(self.grid.len()).filter(|last| *last > self.survived),
            Some(broke) => Some(self.survived.midpoint(broke)).filter(|middle| *middle > self.survived),
        };
        place.map(|place| self.grid.at(place))
    }

    /// Takes the result of the test of [`Self::next`].
    pub(crate) fn learn(&mut self, breaks: bool) {
        let place = match self.broke {
            None => self.grid.len(),
            Some(broke) => self.survived.midpoint(broke),
        };
        if breaks { self.broke = Some(place) } else { self.survived = place }
    }

    /// Returns the largest amount that survived so far; zero survives.
    pub(crate) fn survived(&self) -> u64 {
        self.grid.at(self.survived)
    }

    /// Returns the smallest amount that broke the target so far.
    pub(crate) fn broke(&self) -> Option<u64> {
        self.broke.map(|place| self.grid.at(place))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Searches with a function, and returns the finished search and the number of tests.
    fn search(grid: Grid, breaks: impl Fn(u64) -> bool) -> (Bisection, u64) {
        let mut bisection = Bisection::new(grid);
        let mut tests = 0;
        while let Some(amount) = bisection.next() {
            bisection.learn(breaks(amount));
            tests += 1;
        }
        (bisection, tests)
    }

    #[test]
    fn a_known_threshold_is_found_to_the_step() {
        let grid = Grid::new(100_000, 100).unwrap();
        let (found, tests) = search(grid, |amount| amount >= 3_050);
        assert_eq!((found.survived(), found.broke()), (3_000, Some(3_100)));
        assert_eq!((tests, grid.most_tests()), (11, 11));
    }

    #[test]
    fn a_target_that_nothing_breaks_takes_one_test() {
        let (found, tests) = search(Grid::new(100, 3).unwrap(), |_| false);
        assert_eq!((found.survived(), found.broke(), tests), (100, None, 1));
    }

    #[test]
    fn steps_beyond_the_most_are_no_grid() {
        assert_eq!(Grid::new(10, 0), None);
        assert_eq!(Grid::new(10, 11), None);
        assert_eq!(Grid::new(10, 10), Some(Grid { most: 10, step: 10 }));
        assert_eq!(Grid::new(u64::MAX, u64::MAX - 1).unwrap().at(2), u64::MAX);
    }

    proptest! {
        #[test]
        fn the_found_amount_breaks_and_one_step_less_does_not(
            most in 1..100_000_u64,
            step in 1..1_000_u64,
            threshold in 1..120_000_u64,
        ) {
            let grid = Grid::new(most, step.min(most)).unwrap();
            let breaks = |amount| amount >= threshold;
            let (found, tests) = search(grid, breaks);
            prop_assert!(tests <= grid.most_tests());
            prop_assert!(!breaks(found.survived()));
            match found.broke() {
                Some(amount) => {
                    prop_assert!(breaks(amount));
                    prop_assert!(amount > found.survived() && amount - found.survived() <= step);
                }
                None => prop_assert!(found.survived() == most && threshold > most),
            }
        }

        #[test]
        fn both_ends_were_tested_even_without_a_threshold(
            most in 1..500_u64,
            broken in proptest::collection::btree_set(1..500_u64, 0..100),
        ) {
            let (found, _) = search(Grid::new(most, 1).unwrap(), |amount| broken.contains(&amount));
            prop_assert!(!broken.contains(&found.survived()));
            prop_assert!(found.broke().is_none_or(|amount| broken.contains(&amount)));
            prop_assert!(found.broke().is_none_or(|amount| amount == found.survived() + 1));
        }
    }
}
