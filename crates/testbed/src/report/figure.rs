//! The service time over time in the layout of the published figure: the target dashed, the attachment shaded and named.

use cotorra_graph::{ServiceId, ServiceTime};
use kuva::{
    backend::svg::SvgBackend,
    plot::{
        LinePlot, ScatterPlot,
        annotations::{ReferenceLine, ShadedRegion, TextAnnotation},
        legend::LegendPosition,
    },
    render::{figure::Figure, layout::Layout, plots::Plot, render::Scene},
};

use super::{
    samples::Samples,
    summary::{RegionSummary, Report, ServiceSummary, service_time_ms},
};

/// Upper end of the published figure, milliseconds; higher spikes are cut. With a high target the figure ends at twice the
/// target.
const TOP_MS: f64 = 40.0;
const WIDTH: f64 = 1100.0;
const HEIGHT: f64 = 360.0;
/// Colours of regions, light enough for a line in front.
const SHADES: [&str; 6] = ["#4e79a7", "#f28e2b", "#59a14f", "#e15759", "#b07aa1", "#9c755f"];

/// One panel of the figure.
#[derive(Debug)]
pub struct Panel<'a> {
    /// Title above the panel.
    pub title: String,
    pub samples: &'a Samples,
    /// Restricts samples to this service.
    pub service: Option<ServiceId>,
    /// Shaded regions.
    pub regions: Vec<RegionSummary>,
    /// Position of the dashed line, milliseconds.
    pub target_ms: Option<f64>,
    /// Name of the line; a name here or for points adds a legend.
    pub line: Option<&'static str>,
    /// Name of points, and the points: seconds, milliseconds.
    pub points: Option<(&'static str, Vec<(f64, f64)>)>,
}

impl<'a> Panel<'a> {
    /// Creates a panel with the service times of a run.
    pub fn of(title: String, report: &'a Report) -> Self {
        let (samples, regions) = (report.samples(), report.regions());
        Self {
            title,
            samples,
            service: None,
            regions,
            target_ms: report.service_time_target_ms(),
            line: None,
            points: None,
        }
    }

    /// Creates a panel for each service that has samples.
    pub fn of_services(title: &str, report: &'a Report) -> Vec<Self> {
        let services: Vec<_> = report.services().into_iter().filter(|its| its.samples > 0).collect();
        if services.len() < 2 {
            let target_ms = services
                .first()
                .map_or(report.service_time_target_ms(), |its| Some(its.service_time_target_ms));
            return vec![Self { target_ms, ..Self::of(title.to_owned(), report) }];
        }
        let panel = |its: ServiceSummary| {
            let mut regions = report.regions();
            regions.retain(|region| region.service == its.service);
            let (title, target_ms) = (format!("{title}: {}", its.service), Some(its.service_time_target_ms));
            Self { service: Some(its.service), target_ms, regions, ..Self::of(title, report) }
        };
        services.into_iter().map(panel).collect()
    }
}

/// Draws the panels, one below the other, as SVG.
pub fn draw(panels: &[Panel<'_>]) -> String {
    let end = panels.iter().map(|panel| panel.samples.end().as_secs_f64()).fold(1.0, f64::max);
    // A radio unit has the same colour in all panels.
    let mut names: Vec<&str> = Vec::new();
    for region in panels.iter().flat_map(|panel| &panel.regions) {
        let name = name(region);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let (plots, layouts) = panels.iter().map(|panel| draw_panel(panel, end, &names)).unzip();
    let scene = Figure::new(panels.len(), 1)
        .with_plots(plots)
        .with_layouts(layouts)
        .with_figure_size(WIDTH, HEIGHT * panels.len() as f64)
        .render();
    svg(&scene)
}

/// Renders a scene as SVG. The library numbers clip paths across the whole process; they are renumbered, so that the same
/// scene always has the same bytes.
pub fn svg(scene: &Scene) -> String {
    const MARK: &str = "<clipPath id=\"";
    let svg = SvgBackend::new().render_scene(scene);
    let ids = svg.split(MARK).skip(1).filter_map(|rest| rest.split('"').next().map(str::to_owned));
    ids.collect::<Vec<_>>().iter().enumerate().fold(svg, |svg, (i, id)| {
        svg.replace(&format!("\"{id}\""), &format!("\"clip{i}\""))
            .replace(&format!("url(#{id})"), &format!("url(#clip{i})"))
    })
}

fn name(region: &RegionSummary) -> &str {
    region.attachment.as_ref().map_or("none", |attachment| attachment.as_str())
}

fn draw_panel(panel: &Panel<'_>, end: f64, names: &[&str]) -> (Vec<Plot>, Layout) {
    // A sample without an answer is drawn at the top, its best case.
    let top_ms = panel.target_ms.map_or(TOP_MS, |target| TOP_MS.max(target * 2.0));
    let point = |s: ServiceTime| (s.emitted.as_secs_f64(), service_time_ms(&s).unwrap_or(top_ms).min(top_ms));
    let is_its = |s: &ServiceTime| panel.service.as_ref().is_none_or(|service| *service == s.service);
    let points = panel.samples.iter().filter(is_its).map(point);
    let line = LinePlot::new().with_data(thin(points, end)).with_color("#1f3b5c").with_stroke_width(1.2);
    let line = if let Some(name) = panel.line { line.with_legend(name) } else { line };
    let mut plots = vec![Plot::Line(line)];
    if let Some((name, points)) = &panel.points {
        let points =
            ScatterPlot::new().with_data(points.iter().copied()).with_color("#d35400").with_size(2.5);
        plots.push(Plot::Scatter(points.with_legend(*name)));
    }
    let mut layout = Layout::auto_from_plots(&plots)
        .with_title(panel.title.clone())
        .with_x_label("time (s)")
        .with_y_label("service time (ms)")
        .with_show_grid(false)
        .with_x_axis_min(0.0)
        .with_x_axis_max((end / 50.0).ceil() * 50.0)
        .with_y_axis_min(0.0)
        .with_y_axis_max(top_ms)
        .with_legend_position(LegendPosition::InsideBottomRight);
    if let Some(target) = panel.target_ms {
        let line =
            ReferenceLine::horizontal(target).with_color("#c0392b").with_label(format!("target {target} ms"));
        layout = layout.with_reference_line(line);
    }
    for (region, to) in close_gaps(&panel.regions) {
        let name = name(region);
        let shade = names.iter().position(|n| *n == name).unwrap_or_default();
        let shading = ShadedRegion::vertical(region.from.as_secs_f64(), to)
            .with_color(SHADES[shade % SHADES.len()])
            .with_opacity(0.22);
        layout = layout.with_shaded_region(shading);
        // Names are only drawn where there is room.
        if (to - region.from.as_secs_f64()) / end > 0.03 {
            let middle = (region.from.as_secs_f64() + to) / 2.0;
            layout =
                layout.with_annotation(TextAnnotation::new(name, middle, top_ms * 0.94).with_font_size(13));
        }
    }
    (plots, layout)
}

/// Returns the lowest and the highest point of each column of the figure, in order: everything that is visible.
fn thin(points: impl Iterator<Item = (f64, f64)>, end: f64) -> Vec<(f64, f64)> {
    let mut thinned = Vec::new();
    // The column, and the first of its lowest and of its highest points.
    let mut open: Option<(u32, [(f64, f64); 2])> = None;
    let mut close = |open: Option<(u32, [(f64, f64); 2])>| {
        if let Some((_, [low, high])) = open {
            let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
            thinned.push(first);
            if second != first {
                thinned.push(second);
            }
        }
    };
    for point in points {
        let column = (point.0 / end * WIDTH) as u32;
        match &mut open {
            Some((of, [low, high])) if *of == column => {
                if point.1 < low.1 {
                    *low = point;
                }
                if point.1 > high.1 {
                    *high = point;
                }
            }
            _ => close(open.replace((column, [point; 2]))),
        }
    }
    close(open);
    thinned
}

/// Returns regions with the end of their shading: the beginning of the next region.
fn close_gaps(regions: &[RegionSummary]) -> impl Iterator<Item = (&RegionSummary, f64)> {
    let ends = regions
        .iter()
        .skip(1)
        .map(|next| next.from.as_secs_f64())
        .chain(regions.last().map(|last| last.until.as_secs_f64()));
    regions.iter().zip(ends)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_every_spike_and_the_order() {
        let at = |i: u32| f64::from(i) / 10_000.0 * 400.0;
        let spike = |i: u32| if i % 1000 == 500 { 35.0 } else { 11.0 };
        let thinned = thin((0..10_000).map(|i| (at(i), spike(i))), 400.0);
        assert!(thinned.len() <= 2 * WIDTH as usize, "{}", thinned.len());
        assert!(thinned.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let spikes: Vec<_> = thinned.iter().filter(|point| point.1 == 35.0).map(|point| point.0).collect();
        assert_eq!(spikes, (0..10).map(|i| at(500 + 1000 * i)).collect::<Vec<_>>());
        assert_eq!(thin(std::iter::empty(), 1.0), []);
    }
}
