//! Weights from log-likelihoods without overflow, and tempering of sharp likelihoods.

use crate::fast::exp;

/// Multiplies each weight by exp(share · score), up to a common factor. Returns the evidence: the logarithm of the sum's
/// change, that factor included.
pub(crate) fn multiply(weights: &mut [f32], scores: &[f32], share: f32) -> f64 {
    let best = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (mut before, mut after) = (0.0, 0.0);
    for (weight, score) in weights.iter_mut().zip(scores) {
        before += f64::from(*weight);
        *weight *= exp(share * (score - best));
        after += f64::from(*weight);
    }
    f64::from(share * best) + (after / before).ln()
}

/// Weights that are computed at once.
const LANES: usize = 8;

/// Returns the largest share in (0, 1] of the log-likelihood that leaves at least `least` effective particles, to within 1
/// %. It is one step of an annealed filter (Del Moral, Doucet and Jasra 2006, section 3.3).
pub(crate) fn tempered(weights: &[f32], scores: &[f32], least: f64) -> f32 {
    let best = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (chunks, left) = (weights.as_chunks::<LANES>(), scores.as_chunks::<LANES>());
    let ((weights, weights_left), (scores, scores_left)) = (chunks, left);
    let bearable = |share: f32| {
        // Separate sums per lane let the loop vectorize.
        let (mut sums, mut squares) = ([0.0; LANES], [0.0; LANES]);
        for (weights, scores) in weights.iter().zip(scores) {
            for lane in 0..LANES {
                let weight = weights[lane] * exp(share * (scores[lane] - best));
                sums[lane] += weight;
                squares[lane] += weight * weight;
            }
        }
        for (lane, (weight, score)) in weights_left.iter().zip(scores_left).enumerate() {
            let weight = weight * exp(share * (score - best));
            sums[lane] += weight;
            squares[lane] += weight * weight;
        }
        let (sum, squares): (f32, f32) = (sums.iter().sum(), squares.iter().sum());
        f64::from(sum * sum / squares) >= least
    };
    if bearable(1.0) {
        return 1.0;
    }
    let (mut low, mut high) = (0.0_f32, 1.0_f32);
    while high - low > 0.01 * high && high > 1e-3 {
        let middle = (low + high) / 2.0;
        if bearable(middle) { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_survive_likelihoods_beyond_the_range_of_floats() {
        let mut weights = [0.5, 0.5];
        multiply(&mut weights, &[-5000.0, -5001.0], 1.0);
        assert!((weights[1] / weights[0] - (-1.0_f32).exp()).abs() < 1e-6);
    }

    #[test]
    fn tempering_keeps_the_wanted_number_of_effective_particles() {
        let weights = [0.01; 100];
        let scores: Vec<f32> = (0..100).map(|i| -(i as f32)).collect();
        let share = tempered(&weights, &scores, 20.0);
        let mut after = weights;
        multiply(&mut after, &scores, share);
        let (sum, squares) = after.iter().fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
        assert!((sum * sum / squares - 20.0).abs() < 1.0);
        assert_eq!(tempered(&weights, &[-3.0; 100], 20.0), 1.0);
    }
}
