//! Figures of curves: the mean in the range of samples of each interval.

use cotorra_figure::{Axis, Figure, Panel, Sample, Series, SeriesKind};
use cotorra_measurements::{Curve, Point};

/// Points of a figure by default; more cannot be told apart.
pub const POINTS: usize = 400;

/// Draws a curve of a run.
pub fn draw(run: &str, curve: &Curve) -> Figure {
    let values = || curve.points.iter().filter_map(|point| point.values.as_ref());
    let low = values().map(|values| values.min).fold(f64::INFINITY, f64::min);
    let high = values().map(|values| values.max).fold(f64::NEG_INFINITY, f64::max);
    let (factor, prefix) = match low.abs().max(high.abs()) {
        _ if curve.unit != "bit/s" => (1.0, ""),
        size if size >= 1e9 => (1e-9, "G"),
        size if size >= 1e6 => (1e-6, "M"),
        size if size >= 1e3 => (1e-3, "k"),
        _ => (1.0, ""),
    };
    let figure = curve.figure.to_string();
    let name = curve.figure.declared().name.replace('_', " ");
    let label = if curve.unit.is_empty() { name } else { format!("{name} ({prefix}{})", curve.unit) };
    // The line goes on over intervals without samples, unless events were lost there.
    let parts = curve.points.chunk_by(|_, next| !next.gap).map(|part| {
        let sample = |point: &Point| {
            let values = point.values.as_ref()?;
            let range = Some((values.min * factor, values.max * factor));
            Some(Sample { x: middle(point), y: values.mean * factor, range })
        };
        part.iter().filter_map(sample).collect::<Vec<_>>()
    });
    let from = curve.points.first().map_or(0.0, |point| point.from.as_secs_f64());
    let until = curve.points.last().map_or(0.0, |point| point.until.as_secs_f64());
    let gaps = curve.points.iter().filter(|point| point.gap).map(middle).collect();
    let panel = Panel {
        title: figure,
        x: Axis::around("time (s)", from, until),
        y: Axis::around(&label, low * factor, high * factor),
        series: vec![Series {
            name: "lowest to highest".to_owned(),
            kind: SeriesKind::Range,
            look: None,
            parts: parts.filter(|part| !part.is_empty()).collect(),
        }],
        missing: ("events lost".to_owned(), gaps),
        ..Panel::default()
    };
    Figure { title: run.to_owned(), panels: vec![panel], data: String::new() }
}

/// Returns the middle of a point's interval, seconds.
fn middle(point: &Point) -> f64 {
    f64::midpoint(point.from.as_secs_f64(), point.until.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use cotorra_figure::Format;
    use cotorra_graph::Timestamp;
    use cotorra_measurements::Values;

    use super::*;

    #[test]
    fn large_rates_have_a_prefix_and_lost_events_break_the_line() {
        let point = |i: u64| Point {
            from: Timestamp::from_nanos(i * 500_000_000),
            until: Timestamp::from_nanos((i + 1) * 500_000_000),
            gap: i == 7,
            values: (i != 7).then(|| Values {
                count: 2,
                rolled_up: 0,
                min: 2e6,
                max: 4e6,
                mean: 3e6,
                last: 3e6,
                quantiles: vec![],
                quantiles_within: vec![],
            }),
        };
        let points = (0..20).map(point).collect();
        let figure = "throughput:lan-cloud:forward".parse().unwrap();
        let curve = Curve { figure, unit: "bit/s".to_owned(), quantiles: vec![], points };
        let drawn = draw("corridor", &curve);
        assert_eq!(drawn.panels[0].series[0].parts.iter().map(Vec::len).collect::<Vec<_>>(), [7, 12]);
        let scene = drawn.draw();
        assert_eq!(scene.collisions(), Vec::<String>::new());
        let svg = String::from_utf8(scene.render(Format::Svg)).unwrap();
        assert!(svg.contains(">throughput (Mbit/s)<") && svg.contains(">events lost<"), "{svg}");
    }
}
