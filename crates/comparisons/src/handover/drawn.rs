//! The figure: distributions of gaps by events and by packets, and the places of handovers that robots decided on.

use cotorra_figure::{Axis, Figure, Panel, Sample, Series, SeriesKind, shares_up_to};

use super::{FILES, KINDS, Walk, Walked, measured::Roam};

/// Reads a figure of a handover.
type Read = fn(&Roam) -> Option<f64>;

pub(super) fn figure(walks: &[Walked]) -> Figure {
    let by: [(&str, Read); 2] = [
        ("gap by events (ms)", |roam| Some(roam.gap_ms)),
        ("gap by packets (ms)", |roam| roam.packet_gap_ms),
    ];
    let mut panels: Vec<_> =
        by.iter().filter_map(|(label, read)| distribution(walks, label, *read)).collect();
    panels.extend(places(walks));
    Figure { panels, data: FILES[3].to_owned(), ..Figure::default() }
}

fn of<'a>(walks: &'a [Walked], kind: &'a str, walk: Walk) -> impl Iterator<Item = &'a Roam> {
    let walks = walks.iter().filter(move |walked| walked.kind == kind && walked.walk == walk);
    walks.flat_map(|walked| &walked.roams)
}

/// Draws the share of handovers up to each gap; `None` without handovers.
fn distribution(walks: &[Walked], label: &str, read: Read) -> Option<Panel> {
    let mut series = Vec::new();
    let mut longest = 0.0_f64;
    for (look, kind) in KINDS.iter().enumerate() {
        let gaps: Vec<f64> = of(walks, kind.name, Walk::Sent).filter_map(read).collect();
        let Some(most) = gaps.iter().copied().reduce(f64::max) else { continue };
        longest = longest.max(most);
        series.push(Series {
            name: kind.name.to_owned(),
            kind: SeriesKind::Line,
            look: Some(look),
            parts: vec![shares_up_to(gaps)],
        });
    }
    (!series.is_empty()).then(|| Panel {
        x: Axis::around(label, 0.0, longest),
        y: Axis::around("handovers up to (%)", 0.0, 100.0),
        series,
        ..Panel::default()
    })
}

/// Draws the gaps of handovers that robots decided on over the way that they had come; `None` without such handovers.
fn places(walks: &[Walked]) -> Option<Panel> {
    let mut series = Vec::new();
    let (mut farthest, mut longest) = (0.0_f64, 0.0_f64);
    for (look, kind) in KINDS.iter().enumerate() {
        let point = |roam: &Roam| Some(Sample { x: roam.walked_m?, y: roam.gap_ms, range: None });
        let points: Vec<_> = of(walks, kind.name, Walk::Alone).filter_map(point).collect();
        for point in &points {
            (farthest, longest) = (farthest.max(point.x), longest.max(point.y));
        }
        if !points.is_empty() {
            // Each for itself, so that no line joins them.
            let parts = points.into_iter().map(|point| vec![point]).collect();
            series.push(Series { name: String::new(), kind: SeriesKind::Marked, look: Some(look), parts });
        }
    }
    (!series.is_empty()).then(|| Panel {
        title: "Roams by itself".to_owned(),
        x: Axis::around("way so far (m)", 0.0, farthest),
        y: Axis::around("gap by events (ms)", 0.0, longest),
        series,
        ..Panel::default()
    })
}
