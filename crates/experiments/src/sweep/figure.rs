//! A sweep's plot: median service time and share above the target, each with its confidence interval.

use cotorra_figure::{Axis as Across, Figure, Panel, Sample, Series as Drawn, SeriesKind};
use cotorra_numbers::FEWEST;

use super::{Axis, Cell, Interval};

/// Selects the interval that a panel shows of a cell.
type Figures = fn(&Cell) -> Option<Interval>;

/// One line of a panel: cells that differ only in the value on the horizontal axis.
struct Series<'a> {
    name: String,
    /// Horizontal position and cell.
    points: Vec<(f64, &'a Cell)>,
}

/// Draws a sweep. The horizontal axis is the first with several numbers, or else the first with several values. Each
/// combination of the other values is a line.
pub(super) fn draw(axes: &[Axis], cells: &[Cell]) -> Figure {
    let several = |axis: &Axis| axis.values().len() > 1;
    let numeric = axes.iter().position(|axis| several(axis) && axis.numbers().is_some());
    let along = numeric.or_else(|| axes.iter().position(several));
    let series = series(axes, along, cells);
    let x = along.map_or_else(
        || Across::values("", &[(1.0, "all runs".to_owned())]),
        |along| {
            let axis = &axes[along];
            let values = axis.values().iter().map(|value| (place(axis, value), value.clone()));
            Across::values(axis.path(), &values.collect::<Vec<_>>())
        },
    );
    let panels: [(&str, f64, Figures); 2] = [
        ("median (ms)", 1.0, |cell| cell.service_time_p50_ms),
        ("above target (%)", 100.0, |cell| cell.above_target),
    ];
    let panels = panels.into_iter().enumerate().map(|(i, (label, factor, figures))| {
        let highest = cells.iter().filter_map(figures);
        let highest = highest.map(|i| i.high.filter(|_| i.n >= FEWEST).unwrap_or(i.mean) * factor);
        let mut drawn: Vec<_> = series.iter().map(|series| drawn(series, factor, figures)).collect();
        if i > 0 {
            // One legend names the lines of both panels.
            drawn.iter_mut().for_each(|series| series.name.clear());
        }
        let y = Across::around(label, 0.0, highest.fold(0.0, f64::max));
        Panel { x: x.clone(), y, series: drawn, ..Panel::default() }
    });
    let void = cells.iter().filter(|cell| cell.void.is_some()).count();
    let void = if void > 0 { format!(" ({void} void)") } else { String::new() };
    let title = format!("Service time: means and 95 % confidence intervals{void}");
    Figure { title, panels: panels.collect(), data: "cells.csv".to_owned() }
}

fn series<'a>(axes: &[Axis], along: Option<usize>, cells: &'a [Cell]) -> Vec<Series<'a>> {
    let mut all: Vec<Series<'a>> = Vec::new();
    for cell in cells {
        let others = axes.iter().zip(&cell.values).enumerate();
        let others = others.filter(|(i, (axis, _))| Some(*i) != along && axis.values().len() > 1);
        let name = others
            .map(|(_, (axis, value))| format!("{}={value}", short(axis.path())))
            .collect::<Vec<_>>()
            .join(" ");
        let at = along.map_or(1.0, |along| place(&axes[along], &cell.values[along]));
        match all.iter_mut().find(|series| series.name == name) {
            Some(series) => series.points.push((at, cell)),
            None => all.push(Series { name, points: vec![(at, cell)] }),
        }
    }
    // Lines go from left to right, whatever the order of the values.
    all.iter_mut().for_each(|series| series.points.sort_by(|(a, _), (b, _)| a.total_cmp(b)));
    all
}

/// Returns the last key of a path.
fn short(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path)
}

/// Returns the horizontal position of a value: its number, or its index from 1 if values are no numbers.
fn place(axis: &Axis, value: &str) -> f64 {
    let turn = axis.values().iter().position(|v| v == value).unwrap_or_default();
    axis.numbers().map_or(turn as f64 + 1.0, |numbers| numbers[turn])
}

fn drawn(series: &Series<'_>, factor: f64, figures: Figures) -> Drawn {
    let samples = series.points.iter().filter_map(|(at, cell)| {
        let Interval { n, mean, low, high } = figures(cell)?;
        let range = low.zip(high).map(|(low, high)| (low * factor, high * factor));
        // Of two runs, it would be as high as the panel.
        let range = range.filter(|_| n >= FEWEST);
        Some(Sample { x: *at, y: mean * factor, range })
    });
    Drawn { name: series.name.clone(), kind: SeriesKind::Marked, look: None, parts: vec![samples.collect()] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_in_descending_order_keep_their_labels_and_their_lines() {
        let of = |text: &str| {
            let axes = [text.parse::<Axis>().unwrap()];
            let cell = |value: &String| Cell {
                values: vec![value.clone()],
                service_time_p50_ms: Interval::of(&[value.split(' ').next().unwrap().parse().unwrap()]),
                ..Cell::default()
            };
            draw(&axes, &axes[0].values().iter().map(cell).collect::<Vec<_>>())
        };
        let places = |figure: &Figure| -> Vec<f64> {
            figure.panels[0].series[0].parts[0].iter().map(|sample| sample.x).collect()
        };
        let (up, down) = (of("links.x.delay=10 ms,20 ms,30 ms"), of("links.x.delay=30 ms,20 ms,10 ms"));
        assert_eq!((&up, places(&down)), (&down, vec![10.0, 20.0, 30.0]));
        // A second is not less than 30 ms.
        assert_eq!(places(&of("links.x.delay=30 ms,1 s")), [1.0, 2.0]);
    }
}
