//! Max-min fair shares.

/// Shares a capacity among those who want so much each: nobody gets more than that, and nobody could get more unless somebody
/// with no larger share got less. Rounding leaves less than one unit for each unused. Writes the shares to `shares`.
pub(crate) fn share(capacity: u64, wants: &[u64], shares: &mut Vec<u64>) {
    shares.clear();
    if wants.iter().try_fold(0_u64, |sum, want| sum.checked_add(*want)).is_some_and(|sum| sum <= capacity) {
        shares.extend_from_slice(wants);
        return;
    }
    let mut order: Vec<usize> = (0..wants.len()).collect();
    order.sort_by_key(|place| wants[*place]);
    shares.resize(wants.len(), 0);
    let mut left = capacity;
    for (served, place) in order.into_iter().enumerate() {
        let level = left / (wants.len() - served) as u64;
        shares[place] = wants[place].min(level);
        left -= shares[place];
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;

    fn shared(capacity: u64, wants: &[u64]) -> Vec<u64> {
        let mut shares = Vec::new();
        share(capacity, wants, &mut shares);
        shares
    }

    #[test]
    fn small_wants_are_met_and_others_share_the_rest() {
        assert_eq!(shared(10, &[2, 8, 8]), [2, 4, 4]);
        assert_eq!(shared(10, &[8, 1, 3]), [6, 1, 3]);
        assert_eq!(shared(10, &[3, 3]), [3, 3]);
        assert_eq!(shared(10, &[]), [] as [u64; 0]);
    }

    proptest! {
        #[test]
        fn shares_are_max_min_fair(capacity in 0..1000_u64, wants in vec(0..300_u64, 0..12)) {
            let shares = shared(capacity, &wants);
            let sum: u64 = shares.iter().sum();
            prop_assert!(sum <= capacity);
            prop_assert!(shares.iter().zip(&wants).all(|(share, want)| share <= want));
            let short = || shares.iter().zip(&wants).filter(|(share, want)| share < want).map(|(share, _)| *share);
            if let (Some(least), Some(most)) = (short().min(), shares.iter().max()) {
                // Whoever gets less than it wants gets as much as anybody, but for rounding, and nothing else is left.
                prop_assert!(most - least <= 1, "{shares:?}");
                prop_assert!(capacity - sum < wants.len() as u64);
            } else {
                prop_assert_eq!(sum, wants.iter().sum::<u64>());
            }
        }
    }
}
