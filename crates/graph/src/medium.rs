//! Delay and rate of a link's medium, and the delay that ψ makes of them. Every emulator of links computes it here.

use std::time::Duration;

use crate::units::BitRate;

/// Delay d_m and rate λ_m of a link's medium in one direction, before emulation.
///
/// Emulation at ψ = δ = 1 adds a configured delay a and limits the rate to a configured r. The link then has
///
/// > d = d_m + a, λ = min(r, λ_m)
///
/// and is offered at ψ·d and λ/δ, as in the COTORRA letter (arXiv 2101.07676). Emulation therefore adds
///
/// > e = ψ·(d_m + a) - d_m
///
/// which is (ψ - 1)·d_m without a configured delay. No emulation makes a medium faster: a change that would need e < 0 or
/// λ/δ > λ_m is rejected.
///
/// **Source of d_m.** A link that is emulated as a whole has no medium: d_m = 0, and d is the configured delay, exact to the
/// nanosecond. Probes of it would include queueing and the emulated delay, so scaling their result would scale the same delay
/// again with each change. Over a real interface, d_m is declared, or measured before emulation begins. It stays for the whole
/// run, so that emulated delay is never scaled again. λ_m is declared, because counters show what crossed, not what could.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Medium {
    /// d_m.
    pub delay: Duration,
    /// λ_m.
    pub rate: BitRate,
}

/// Reason why a delay cannot be emulated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NotOffered {
    /// The delay is below zero, or no number of nanoseconds.
    Absurd,
    /// The medium alone takes longer.
    BelowMedium {
        /// Delay that the scale would need.
        offered: Duration,
    },
}

impl Medium {
    /// ψ·(d_m + a), in whole nanoseconds.
    ///
    /// # Errors
    /// [`NotOffered`].
    pub fn offered_delay(&self, asked: Duration, delay_scale: f64) -> Result<Duration, NotOffered> {
        let unscaled = self.delay.checked_add(asked).ok_or(NotOffered::Absurd)?;
        if delay_scale == 1.0 {
            return Ok(unscaled);
        }
        // Milliseconds, as people ask for them, are multiplied: 10 ms by 1.1 is 11 ms then.
        let ns = (unscaled.as_secs_f64() * 1e3 * delay_scale * 1e6).round();
        if !(0.0..=u64::MAX as f64).contains(&ns) {
            return Err(NotOffered::Absurd);
        }
        let offered = Duration::from_nanos(ns as u64);
        if offered < self.delay { Err(NotOffered::BelowMedium { offered }) } else { Ok(offered) }
    }

    /// e: what emulation adds for a delay that is offered.
    pub fn added_delay(&self, offered: Duration) -> Duration {
        offered.saturating_sub(self.delay)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn medium(ns: u64) -> Medium {
        Medium { delay: Duration::from_nanos(ns), rate: BitRate::from_mbps(100.0).unwrap() }
    }

    /// Up to a minute.
    const NS: std::ops::Range<u64> = 0..60_000_000_000;

    proptest! {
        /// The medium's delay and the added delay sum up to the scaled delay ψ·d.
        #[test]
        fn medium_and_added_delay_sum_up_to_the_scaled_delay(own in NS, asked in NS, psi in 0.0..100.0) {
            let (medium, d) = (medium(own), (own + asked) as f64);
            match medium.offered_delay(Duration::from_nanos(asked), psi) {
                Ok(offered) => {
                    prop_assert_eq!(medium.delay + medium.added_delay(offered), offered);
                    prop_assert!((offered.as_nanos() as f64 - psi * d).abs() <= 1.0 + psi * d * 1e-12);
                }
                Err(NotOffered::BelowMedium { offered }) => {
                    prop_assert!(offered < medium.delay && psi < 1.0);
                }
                Err(NotOffered::Absurd) => prop_assert!(false, "a minute by 100 can be said"),
            }
        }

        /// ψ from 1 on is never refused, and 1 adds what was asked for to the nanosecond.
        #[test]
        fn scales_from_1_on_are_accepted(own in NS, asked in NS, psi in 1.0..100.0) {
            let medium = medium(own);
            let asked = Duration::from_nanos(asked);
            prop_assert!(medium.offered_delay(asked, psi).unwrap() >= medium.delay);
            prop_assert_eq!(medium.added_delay(medium.offered_delay(asked, 1.0).unwrap()), asked);
        }

        /// A link that is emulated as a whole accepts any ψ from 0 on.
        #[test]
        fn without_a_medium_no_scale_is_too_small(asked in NS, psi in 0.0..1.0) {
            let asked = Duration::from_nanos(asked);
            prop_assert!(medium(0).offered_delay(asked, psi).unwrap() <= asked);
        }
    }

    #[test]
    fn medium_of_2_ms_is_scaled_by_three() {
        let medium = medium(2_000_000);
        let ms = Duration::from_millis;
        assert_eq!(medium.offered_delay(ms(0), 3.0), Ok(ms(6)));
        assert_eq!(medium.added_delay(ms(6)), ms(4), "(ψ - 1)·d");
        assert_eq!(medium.offered_delay(ms(8), 0.5), Ok(ms(5)), "half of 10 ms, 3 ms of it added");
        assert_eq!(medium.offered_delay(ms(0), 0.5), Err(NotOffered::BelowMedium { offered: ms(1) }));
        for wrong in [-1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(medium.offered_delay(ms(0), wrong), Err(NotOffered::Absurd), "{wrong}");
        }
    }
}
