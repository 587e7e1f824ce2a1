//! Times that were measured.

use std::time::Duration;

use cotorra_numbers::quantile_of_times;

/// Summary of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Times {
    pub median: Duration,
    pub min: Duration,
    pub max: Duration,
}

impl Times {
    /// Summarises a series; `None` if it is empty.
    pub fn of(mut series: Vec<Duration>) -> Option<Self> {
        series.sort();
        let [min, median, max] = [0.0, 0.5, 1.0].map(|share| quantile_of_times(&series, share));
        Some(Self { median: median?, min: min?, max: max? })
    }
}

/// Returns a time with at least three digits, as in `512 ms`, `51.2 ms`, `3.10 ms` and `0.085 ms`.
pub fn in_ms(time: Duration) -> String {
    let ms = time.as_secs_f64() * 1e3;
    let decimals = match ms {
        100.0.. => 0,
        10.0.. => 1,
        1.0.. => 2,
        _ => 3,
    };
    format!("{ms:.decimals$} ms")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_has_a_median_between_its_ends() {
        let times = |ms: &[u64]| Times::of(ms.iter().copied().map(Duration::from_millis).collect());
        assert_eq!(times(&[]), None);
        let three = times(&[9, 1, 2]).unwrap();
        assert_eq!([three.median, three.min, three.max], [2, 1, 9].map(Duration::from_millis));
        assert_eq!(times(&[1, 2, 4, 9]).unwrap().median, Duration::from_millis(3));
    }

    #[test]
    fn times_have_three_digits() {
        let shown = [512_345, 51_234, 3_104, 85].map(|us| in_ms(Duration::from_micros(us)));
        assert_eq!(shown, ["512 ms", "51.2 ms", "3.10 ms", "0.085 ms"]);
    }
}
