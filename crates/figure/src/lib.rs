//! Figures: panels of lines over an axis, bars over time, and values over a floor, as SVG, PDF and PNG.
//!
//! A [`Figure`], a [`Timeline`] or a [`FloorMap`] becomes a [`Scene`] of lines, areas and texts, which [`Scene::render`]
//! writes in a [`Format`]. A scene is as wide as a column of a paper (8.5 cm), with letters of at least 6.5 points. The same scene has
//! the same bytes each time.

#![forbid(unsafe_code)]

mod axis;
mod colour;
mod figure;
mod floor_map;
mod font;
mod format;
mod geometry;
mod legend;
mod names;
mod pdf;
mod png;
mod scene;
mod style;
mod svg;
mod timeline;

pub use axis::Axis;
pub use figure::{
    Band, Figure, Level, MAX_PANELS, MAX_SERIES, Panel, Sample, Series, SeriesKind, shares_up_to,
};
pub use floor_map::{Extent, FloorMap, FloorPanel, Path, Spot};
pub use format::Format;
pub use scene::Scene;
pub use timeline::{Bar, Row, Timeline};
