//! Sine, cosine and exponential in single precision, as plain arithmetic. Loops over them vectorize, and results are the
//! same to the bit on every machine. The polynomials are those of Cephes (Moshier 1989), with errors of some 1e-7.

use std::f32::consts::{FRAC_2_PI, LOG2_E};

/// Adding and subtracting it rounds a number to the nearest integer. After the addition, the lowest bits are that integer.
const ROUND: f32 = 12_582_912.0; // 1.5 · 2²³

/// Returns sine and cosine of an angle of at most some hundred turns, radians.
#[inline(always)]
pub(crate) fn sin_cos(angle: f32) -> (f32, f32) {
    // π/2 in three parts. The first two have few bits, so that their products are exact.
    const PARTS: [f32; 3] = [1.570_312_5, 4.837_513e-4, 7.549_79e-8];
    let shifted = angle * FRAC_2_PI + ROUND;
    let quarters = shifted - ROUND;
    let quadrant = shifted.to_bits();
    let rest = ((angle - quarters * PARTS[0]) - quarters * PARTS[1]) - quarters * PARTS[2];
    let square = rest * rest;
    let sine = ((-1.951_529_6e-4 * square + 8.332_161e-3) * square - 1.666_665_5e-1) * square * rest + rest;
    let cosine = ((2.443_315_7e-5 * square - 1.388_731_6e-3) * square + 4.166_664_6e-2) * square * square
        - 0.5 * square
        + 1.0;
    let (sine, cosine) = if quadrant & 1 == 0 { (sine, cosine) } else { (cosine, sine) };
    let negative = |value: f32, sign: u32| f32::from_bits(value.to_bits() ^ (sign << 31));
    (negative(sine, quadrant >> 1 & 1), negative(cosine, (quadrant >> 1 ^ quadrant) & 1))
}

/// Returns e to a power of at most 0; 0 below -87.
#[inline(always)]
pub(crate) fn exp(power: f32) -> f32 {
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    // A plain comparison is a single instruction. NaN counts as -87.
    let power = if power > -87.0 { power } else { -87.0 };
    let shifted = power * LOG2_E + ROUND;
    let twos = shifted - ROUND;
    let rest = (power - twos * LN_2[0]) - twos * LN_2[1];
    let mut series = 1.987_569_1e-4;
    for term in [1.398_2e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 5e-1] {
        series = series * rest + term;
    }
    let series = series * rest * rest + rest + 1.0;
    let scale = f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000));
    if power > -87.0 { series * scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn they_are_as_good_as_single_precision(angle in -700.0..700.0_f32, power in -86.9..0.0_f32) {
            let (sine, cosine) = sin_cos(angle);
            prop_assert!((f64::from(sine) - f64::from(angle).sin()).abs() < 3e-7, "sin {} is {}", angle, sine);
            prop_assert!((f64::from(cosine) - f64::from(angle).cos()).abs() < 3e-7, "cos {} is {}", angle, cosine);
            let exact = f64::from(power).exp();
            prop_assert!((f64::from(exp(power)) / exact - 1.0).abs() < 3e-7, "exp {} is {}", power, exp(power));
        }
    }

    #[test]
    fn at_the_ends_they_are_exact() {
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        assert_eq!((exp(0.0), exp(-1e9), exp(f32::NEG_INFINITY), exp(f32::NAN)), (1.0, 0.0, 0.0, 0.0));
    }
}
