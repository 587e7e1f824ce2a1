//! Service times of one walk, in the order of time.

use cotorra_testbed::service_time_ms;

use super::{Walks, samples};

/// A service time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Timed {
    /// When its packet was emitted, seconds since the walk began.
    pub at_s: f64,
    /// `None` without an answer.
    pub ms: Option<f64>,
}

impl Timed {
    /// Whether it is above a service time. Without an answer, it is above any.
    pub fn is_above(&self, limit_ms: f64) -> bool {
        self.ms.is_none_or(|ms| ms > limit_ms)
    }
}

/// Returns the samples of both walks, the state of the art first.
pub(super) fn of(walks: &Walks<'_>) -> [Vec<Timed>; 2] {
    [walks.soa, walks.okpi].map(|report| {
        let timed = samples(walks.testbed, report)
            .map(|sample| Timed { at_s: sample.emitted.as_secs_f64(), ms: service_time_ms(&sample) });
        let mut timed: Vec<_> = timed.collect();
        timed.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        timed
    })
}

/// Returns the first sample of each whole second, as the published figure has one a second.
pub(super) fn one_a_second(all: &[Timed]) -> Vec<Timed> {
    let seconds = all.chunk_by(|a, b| a.at_s.floor() == b.at_s.floor());
    seconds.filter_map(|second| second.first()).copied().collect()
}

/// Returns the first and the second half of a walk, by time. A walk out and back passes every place in both.
pub(super) fn halves(all: &[Timed]) -> [&[Timed]; 2] {
    let (first, last) = (all.first().map_or(0.0, |t| t.at_s), all.last().map_or(0.0, |t| t.at_s));
    let middle = f64::midpoint(first, last);
    <[_; 2]>::from(all.split_at(all.partition_point(|timed| timed.at_s < middle)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timed(all: &[(f64, f64)]) -> Vec<Timed> {
        all.iter().map(|(at_s, ms)| Timed { at_s: *at_s, ms: Some(*ms) }).collect()
    }

    #[test]
    fn the_first_sample_of_each_second_is_kept() {
        let all = timed(&[(0.3, 1.0), (0.9, 2.0), (1.0, 3.0), (1.5, 4.0), (3.2, 5.0)]);
        assert_eq!(one_a_second(&all), timed(&[(0.3, 1.0), (1.0, 3.0), (3.2, 5.0)]));
        assert_eq!(one_a_second(&[]), []);
    }

    #[test]
    fn halves_split_at_the_middle_of_the_time_and_share_no_sample() {
        let all = timed(&[(10.0, 1.0), (11.0, 2.0), (12.0, 3.0), (20.0, 4.0), (30.0, 5.0)]);
        let [first, second] = halves(&all);
        assert_eq!((first.len(), second.len()), (3, 2));
        assert_eq!([first, second].concat(), all);
        assert_eq!(halves(&[]), [&[][..], &[][..]]);
    }
}
