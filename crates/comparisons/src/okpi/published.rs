//! The published walk: the corridor's segments, its medians and OKpi's changes (arXiv 2101.07676).

use cotorra_graph::{NodeId, Position};
use serde::Serialize;

/// A part of the walk, and its published medians, ms.
pub(super) struct Published {
    pub name: &'static str,
    pub segment: Segment,
    pub leg: Leg,
    pub theory: f64,
    pub okpi: f64,
    pub soa: f64,
}

pub(super) const PUBLISHED: [Published; 5] = {
    use {Leg::*, Segment::*};
    [
        Published { name: "R1/R3 out", segment: A, leg: Out, theory: 11.0, okpi: 11.34, soa: 11.80 },
        Published { name: "R2/R4 out", segment: B, leg: Out, theory: 10.0, okpi: 10.39, soa: 20.35 },
        Published { name: "R5/R6", segment: C, leg: Out, theory: 11.0, okpi: 10.77, soa: 28.91 },
        Published { name: "R2/R4 back", segment: B, leg: Back, theory: 10.0, okpi: 10.27, soa: 20.32 },
        Published { name: "R1/R3 back", segment: A, leg: Back, theory: 11.0, okpi: 11.37, soa: 11.46 },
    ]
};

/// A published change of radio unit and server. `metres` is the coordinate along `axis` at which it happened.
pub(super) struct PublishedChange {
    pub leg: Leg,
    pub axis: Axis,
    pub metres: f64,
    pub radio_unit: &'static str,
    pub server: &'static str,
}

pub(super) const PUBLISHED_CHANGES: [PublishedChange; 6] = {
    use {Axis::*, Leg::*};
    [
        PublishedChange { leg: Out, axis: Y, metres: -24.6, radio_unit: "R3", server: "cloud" },
        PublishedChange { leg: Out, axis: Y, metres: -10.9, radio_unit: "R2", server: "edge" },
        PublishedChange { leg: Out, axis: X, metres: 15.8, radio_unit: "R5", server: "fog" },
        PublishedChange { leg: Back, axis: X, metres: 17.8, radio_unit: "R2", server: "edge" },
        PublishedChange { leg: Back, axis: Y, metres: -12.5, radio_unit: "R3", server: "cloud" },
        PublishedChange { leg: Back, axis: Y, metres: -26.1, radio_unit: "R1", server: "cloud" },
    ]
};

/// The corridor's segments, each with its radio units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Segment {
    A,
    B,
    C,
}

impl Segment {
    pub fn of(radio_unit: &NodeId) -> Option<Self> {
        match radio_unit.as_str() {
            "R1" | "R3" => Some(Self::A),
            "R2" | "R4" => Some(Self::B),
            "R5" | "R6" => Some(Self::C),
            _ => None,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Leg {
    Out,
    Back,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Axis {
    X,
    Y,
}

impl Axis {
    pub fn of(self, position: Position) -> f64 {
        match self {
            Self::X => position.x,
            Self::Y => position.y,
        }
    }
}
