//! Models of packet loss. Bursty loss is Gilbert-Elliott's. NetEm's correlated loss is left out because it is broken
//! in the kernel: 1 % with a correlation of 25 % loses nothing at all.

use cotorra_graph::Probability;

use crate::probability::{from_wire, to_wire};

/// Model of packet loss.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Loss {
    /// No loss.
    #[default]
    None,
    /// Each packet is lost with the same probability, independent of the others.
    Independent {
        /// Long-run share of lost packets.
        rate: Probability,
    },
    /// The model of Gilbert (1960) and Elliott (1963): a good and a bad state that change from packet to packet.
    GilbertElliott {
        /// p: transition probability from good to bad.
        to_bad: Probability,
        /// r: transition probability from bad to good. The mean burst is 1/r packets long.
        to_good: Probability,
        /// 1 - h: loss probability in the bad state.
        lost_in_bad: Probability,
        /// 1 - k: loss probability in the good state.
        lost_in_good: Probability,
    },
}

impl Loss {
    /// Returns Gilbert's simple model, which loses all packets in the bad state and none in the good state. With a
    /// long-run loss `rate` and a mean burst length in packets, r = 1/mean_burst and p = r·rate/(1-rate).
    ///
    /// Returns `None` if no such model exists: the rate is 1, the burst is shorter than a packet, or p would exceed
    /// 1.
    pub fn bursty(rate: Probability, mean_burst: f64) -> Option<Self> {
        if !(mean_burst.is_finite() && mean_burst >= 1.0 && rate.get() < 1.0) {
            return None;
        }
        let to_good = 1.0 / mean_burst;
        let to_bad = to_good * rate.get() / (1.0 - rate.get());
        // A rate like 0.9 has no exact quotient.
        if to_bad > 1.0 + 1e-9 {
            return None;
        }
        Some(Self::GilbertElliott {
            to_bad: Probability::new(to_bad.min(1.0))?,
            to_good: Probability::new(to_good)?,
            lost_in_bad: Probability::ONE,
            lost_in_good: Probability::ZERO,
        })
    }

    /// Returns the long-run share of lost packets.
    pub fn share(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Independent { rate } => rate.get(),
            Self::GilbertElliott { to_bad, to_good, lost_in_bad, lost_in_good } => {
                let (p, r) = (to_bad.get(), to_good.get());
                // With p = 0 the bad state is never entered, whatever r is.
                let bad = if p == 0.0 { 0.0 } else { p / (p + r) };
                bad * lost_in_bad.get() + (1.0 - bad) * lost_in_good.get()
            }
        }
    }

    pub(crate) fn independent(self) -> Probability {
        match self {
            Self::Independent { rate } => rate,
            _ => Probability::ZERO,
        }
    }

    /// Encodes `struct tc_netem_gemodel`: p, r, h, 1-k.
    pub(crate) fn model(self) -> Option<[u32; 4]> {
        let Self::GilbertElliott { to_bad, to_good, lost_in_bad, lost_in_good } = self else { return None };
        Some([to_wire(to_bad), to_wire(to_good), u32::MAX - to_wire(lost_in_bad), to_wire(lost_in_good)])
    }

    pub(crate) fn from_wire(independent: u32, model: Option<[u32; 4]>) -> Self {
        match (model, independent) {
            (Some([p, r, h, lost_in_good]), _) => Self::GilbertElliott {
                to_bad: from_wire(p),
                to_good: from_wire(r),
                lost_in_bad: from_wire(u32::MAX - h),
                lost_in_good: from_wire(lost_in_good),
            },
            (None, 0) => Self::None,
            (None, rate) => Self::Independent { rate: from_wire(rate) },
        }
    }

    pub(crate) fn as_kept(self) -> Self {
        Self::from_wire(to_wire(self.independent()), self.model())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;

    fn p(p: f64) -> Probability {
        Probability::new(p).unwrap()
    }

    pub(crate) fn any_loss() -> impl Strategy<Value = Loss> {
        let any = || (0.0..=1.0).prop_map(p);
        prop_oneof![
            Just(Loss::None),
            any().prop_map(|rate| Loss::Independent { rate }),
            [any(), any(), any(), any()].prop_map(|[to_bad, to_good, lost_in_bad, lost_in_good]| {
                Loss::GilbertElliott { to_bad, to_good, lost_in_bad, lost_in_good }
            }),
        ]
    }

    proptest! {
        #[test]
        fn bursts_lose_the_requested_share(rate in 0.0..0.99, mean_burst in 1.0..100.0) {
            if let Some(loss) = Loss::bursty(p(rate), mean_burst) {
                prop_assert!((loss.share() - rate).abs() < 1e-9);
            } else {
                prop_assert!(mean_burst < rate / (1.0 - rate));
            }
        }
    }

    #[test]
    fn impossible_bursts_have_no_model() {
        assert_eq!(Loss::bursty(p(1.0), 5.0), None);
        assert_eq!(Loss::bursty(p(0.1), 0.5), None);
        assert_eq!(Loss::bursty(p(0.1), f64::NAN), None);
        assert!(Loss::bursty(p(0.9), 9.0).is_some());
    }
}
