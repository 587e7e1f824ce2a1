//! Two clocks of which one goes faster.

/// Largest drift between clocks that are not broken, ms in a second: 500 ppm, the most that Linux corrects (adjtimex(2)).
pub(super) const MOST_DRIFT: f64 = 0.5;

/// Returns the slope of the line below all points that is nearest to them, by the sum of the distances. It is the drift between
/// two clocks in delays (y) over time (x): the shortest delays stay the same, and longer ones do not count (Moon, Skelly and
/// Towsley, Estimation and removal of clock skew from network delay measurements, INFOCOM 1999).
///
/// The line is the side of the lower convex hull that holds the mean of x. Without two different x, the slope is 0.
pub(super) fn lower_slope(points: &mut [(f64, f64)]) -> f64 {
    points.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mean = points.iter().map(|(x, _)| x).sum::<f64>() / points.len().max(1) as f64;
    // Andrew's monotone chain.
    let mut hull: Vec<(f64, f64)> = Vec::new();
    for &point in points.iter() {
        if hull.last().is_some_and(|last| last.0 == point.0) {
            continue;
        }
        while let [.., a, b] = hull[..]
            && (b.0 - a.0) * (point.1 - a.1) <= (b.1 - a.1) * (point.0 - a.0)
        {
            hull.pop();
        }
        hull.push(point);
    }
    let side = hull.windows(2).find(|side| side[1].0 >= mean);
    side.map_or(0.0, |side| (side[1].1 - side[0].1) / (side[1].0 - side[0].0))
}

#[cfg(test)]
mod tests {
    use cotorra_numbers::Draws;

    use super::*;

    #[test]
    fn the_drift_is_found_below_delays_that_only_add() {
        let mut draws = Draws::new(1, "clocks");
        for drift in [0.0, 0.05, -0.2] {
            let delay = |x: f64, draws: &mut Draws| 20.0 + drift * x - 3.0 * (1.0 - draws.unit()).ln();
            let mut points: Vec<_> =
                (0..1000).map(|i| 0.1 * f64::from(i)).map(|x| (x, delay(x, &mut draws))).collect();
            let found = lower_slope(&mut points);
            // The shortest of 1000 delays are within 0.1 ms, over 100 s.
            assert!((found - drift).abs() < 2e-3, "{found} {drift}");
        }
    }

    #[test]
    fn points_at_one_time_have_no_slope() {
        assert_eq!(lower_slope(&mut [(1.0, 2.0), (1.0, 3.0)]), 0.0);
        assert_eq!(lower_slope(&mut []), 0.0);
        assert_eq!(lower_slope(&mut [(0.0, 2.0), (1.0, 3.0)]), 1.0);
    }
}
