//! Probabilities as NetEm has them: shares of 2^32 - 1.

use cotorra_graph::Probability;

/// Encodes a probability.
pub(crate) fn to_wire(p: Probability) -> u32 {
    (p.get() * f64::from(u32::MAX)).round() as u32
}

/// Decodes a probability.
pub(crate) fn from_wire(p: u32) -> Probability {
    Probability::new(f64::from(p) / f64::from(u32::MAX)).expect("a part of the whole is between 0 and 1")
}
