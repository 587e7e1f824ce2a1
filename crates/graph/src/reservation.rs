//! Reservations of mapped paths.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::units::BitRate;

/// How wired links keep the reservations of mappings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reservations {
    /// They only limit other mappings. Traffic is not shaped.
    #[default]
    Counted,
    /// Packets of a mapping have at least the reserved rate when they need it, and may borrow what others leave over.
    Guaranteed,
    /// The reserved rate is also the highest one that packets of a mapping have.
    Limited,
}

/// The reservation of one mapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MapReservation {
    /// How wired links keep it, whatever the testbed file says.
    pub kept: Reservations,
    /// Its rate, bit/s, of frames without FCS. By default the sum of the rates of the virtual links between the two nodes.
    #[serde(rename = "rate_bps", default, skip_serializing_if = "Option::is_none")]
    pub rate: Option<BitRate>,
}

impl fmt::Display for MapReservation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.kept {
            Reservations::Counted => "counted",
            Reservations::Guaranteed => "guaranteed",
            Reservations::Limited => "limited",
        })?;
        self.rate.map_or(Ok(()), |rate| write!(f, " at {rate}"))
    }
}
