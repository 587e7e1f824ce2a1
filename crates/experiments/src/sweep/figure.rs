//! A sweep's plot: median service time and share above the target, each with its confidence interval.

use cotorra_testbed::svg;
use kuva::{
    plot::{LinePlot, ScatterPlot},
    render::{figure::Figure, layout::Layout, plots::Plot},
};

use super::{Axis, Cell, Interval, Sweep};

const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 340.0;
const COLOURS: [&str; 8] =
    ["#1f3b5c", "#d35400", "#3a7d44", "#8e44ad", "#c0392b", "#16808a", "#7f6000", "#555555"];

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
pub(super) fn draw(sweep: &Sweep, cells: &[Cell]) -> String {
    let several = |axis: &Axis| axis.values().len() > 1;
    let axes = sweep.axes();
    let numeric = axes.iter().position(|axis| several(axis) && axis.numbers().is_some());
    let along = numeric.or_else(|| axes.iter().position(several));
    let series = series(axes, along, cells);
    let panels: [(&str, f64, Figures); 2] = [
        ("median service time (ms)", 1.0, |cell| cell.service_time_p50_ms),
        ("samples above the target (%)", 100.0, |cell| cell.above_target),
    ];
    let drawn = panels.map(|(label, factor, figures)| {
        let plots: Vec<Plot> =
            series.iter().enumerate().flat_map(|(i, series)| plots(series, i, factor, figures)).collect();
        let highest = cells.iter().filter_map(figures).map(|i| i.high.unwrap_or(i.mean) * factor);
        let mut layout = Layout::auto_from_plots(&plots)
            .with_y_label(label)
            .with_y_axis_min(0.0)
            .with_y_axis_max(highest.fold(0.0, f64::max).max(1e-3) * 1.1);
        if let Some(along) = along {
            layout = layout.with_x_label(axes[along].path());
            if numeric.is_none() {
                layout = layout.with_x_categories(axes[along].values().to_vec());
            }
        }
        (plots, layout)
    });
    let (plots, layouts) = drawn.into_iter().unzip();
    let figure = Figure::new(panels.len(), 1).with_plots(plots).with_layouts(layouts);
    let scene = figure.with_figure_size(WIDTH, HEIGHT * panels.len() as f64).render();
    svg(&scene)
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

fn plots(series: &Series<'_>, place: usize, factor: f64, figures: Figures) -> Vec<Plot> {
    let colour = COLOURS[place % COLOURS.len()];
    let points = series.points.iter().filter_map(|(at, cell)| Some((*at, figures(cell)?)));
    let points: Vec<(f64, Interval)> = points.collect();
    let bound = |of: fn(&Interval) -> Option<f64>| {
        points.iter().map(move |(_, i)| of(i).unwrap_or(i.mean).max(0.0) * factor).collect::<Vec<_>>()
    };
    let means: Vec<_> = points.iter().map(|(at, i)| (*at, i.mean * factor)).collect();
    let line = LinePlot::new().with_data(means.clone()).with_color(colour).with_stroke_width(1.5);
    let line = line.with_band(bound(|i| i.low), bound(|i| i.high));
    let line = if series.name.is_empty() { line } else { line.with_legend(series.name.clone()) };
    let dots = ScatterPlot::new().with_data(means).with_color(colour).with_size(2.5);
    vec![Plot::Line(line), Plot::Scatter(dots)]
}
