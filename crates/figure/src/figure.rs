//! Figures of panels, one below the other, which share their margins.

use crate::{
    axis::{Axis, ROW},
    colour::Colour,
    font,
    geometry::{Point, Rect},
    legend::{Entry, LEVEL_DASHES, Legend, Look},
    scene::{Anchor, Scene, WIDTH},
    style::{
        ALERT, BANDS, BLACK, BOLD, DASHES, FINE, GREY, LABEL, LIGHT, PALE, SERIES, SMALL, TITLE, WIDE, mark,
        mark_cut,
    },
};

/// Maximum number of panels. A note says how many more there are.
pub const MAX_PANELS: usize = 12;
/// Maximum number of series of a panel, so that each has its own look. A note says how many more there are.
pub const MAX_SERIES: usize = SERIES.len();

/// Room at the top, at the bottom and at the right, points.
const SIDE: f64 = 4.0;
const RIGHT: f64 = 7.0;
/// Width of a name that reads upwards, points.
const NAME: f64 = 10.0;
/// Height of the strip above a plot that names its bands, points.
const STRIP: f64 = 9.0;
/// Room between panels, points.
const BETWEEN: f64 = 5.0;
/// Room that axes leave at the sides for markers, points.
const INSET: f64 = 10.0;
/// Distance between markers of different series at the same place, points, at most.
const DODGE: f64 = 5.0;
/// Half of the width of an error bar's ends, points.
const WHISKER: f64 = 1.6;
/// Length and distance of ticks for missing values, points.
const MISSING: f64 = 4.0;
const MISSING_EVERY: f64 = 0.5;
/// Distance of marks of values above the axis, points.
const CUT_EVERY: f64 = 1.5;
/// A name can stand over the ends of its band if the band has this share of its width.
const OVERHANG: f64 = 0.4;

/// A figure.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Figure {
    /// Empty for none.
    pub title: String,
    pub panels: Vec<Panel>,
    /// The file with what a bounded figure leaves out.
    pub data: String,
}

/// A plot with its axes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Panel {
    /// Empty for none.
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub bands: Vec<Band>,
    /// A value of the vertical axis, as a line across the panel.
    pub level: Option<Level>,
    /// A value of the horizontal axis, as a line up the panel.
    pub upright: Option<Level>,
    pub series: Vec<Series>,
    /// Name in the legend of missing values, and their places on the horizontal axis.
    pub missing: (String, Vec<f64>),
}

/// A part of the horizontal axis with a name and a colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    pub from: f64,
    pub to: f64,
    /// Bands with the same name have the same colour in all panels. Bands without a name are grey.
    pub name: String,
}

/// A value with a name, drawn as a dashed line.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    pub at: f64,
    pub name: String,
}

/// Values of one thing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Name in the legend; empty for no entry.
    pub name: String,
    pub kind: SeriesKind,
    /// Number of its colour, dash and marker, of [`MAX_SERIES`]; by default, its place in the panel. The same thing
    /// looks the same in several panels with the same number.
    pub look: Option<usize>,
    /// Lines, between which values are missing.
    pub parts: Vec<Vec<Sample>>,
}

/// The look of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SeriesKind {
    /// A wide, pale line for many values behind others.
    Faint,
    /// A thin line for many values.
    Dense,
    /// A line with dashes.
    #[default]
    Line,
    /// A line in an area from the lowest to the highest values.
    Range,
    /// Markers with error bars, joined by a line. Markers of different series stand beside each other.
    Marked,
}

/// A value, and the ends of its range or error bar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    pub x: f64,
    pub y: f64,
    pub range: Option<(f64, f64)>,
}

impl Band {
    fn is_finite(&self) -> bool {
        self.from.is_finite() && self.to.is_finite()
    }
}

impl Sample {
    /// Returns the value, or the end of its range or error bar if that is higher.
    fn highest(&self) -> f64 {
        self.range.map_or(self.y, |(_, high)| high.max(self.y))
    }

    fn is_finite(&self) -> bool {
        let (low, high) = self.range.unwrap_or_default();
        [self.x, self.y, low, high].into_iter().all(f64::is_finite)
    }
}

/// Returns the steps of an empirical distribution function: the share of values up to each, in per cent. Values that are not
/// finite count, but have no step.
pub fn shares_up_to(mut values: Vec<f64>) -> Vec<Sample> {
    values.sort_by(f64::total_cmp);
    let share = |count: usize| count as f64 / values.len() as f64 * 100.0;
    let mut steps = vec![Sample { x: 0.0, y: 0.0, range: None }];
    for (i, value) in values.iter().enumerate().filter(|(_, value)| value.is_finite()) {
        steps.extend([i, i + 1].map(|count| Sample { x: *value, y: share(count), range: None }));
    }
    steps
}

/// The place of a panel in the figure.
struct Place<'a> {
    panel: &'a Panel,
    legend: Legend,
    plot: Rect,
    inset: f64,
    /// Whether the horizontal axis has labels here, and not only below another panel.
    is_labelled: bool,
}

impl Figure {
    /// Draws the figure.
    pub fn draw(&self) -> Scene {
        let shown = &self.panels[..self.panels.len().min(MAX_PANELS)];
        let names = names(shown);
        let height = match shown.len() {
            0 | 1 => 96.0,
            2 => 76.0,
            _ => 56.0,
        };
        let widths = shown.iter().map(|panel| panel.y.width(height));
        let left = SIDE + NAME + widths.fold(0.0, f64::max);
        let mut scene = Scene::new();
        let mut top = SIDE;
        if !self.title.is_empty() {
            let title = font::fit(&self.title, TITLE, WIDTH - 2.0 * SIDE);
            scene.text((SIDE, top + font::ASCENT * TITLE), &title, TITLE, Anchor::Start, BLACK);
            top += TITLE + SIDE;
        }
        let mut places = Vec::new();
        for (i, panel) in shown.iter().enumerate() {
            let is_labelled = shown.get(i + 1).is_none_or(|next| next.x != panel.x);
            let place = Place::below(&mut top, panel, (left, height), is_labelled, &names);
            places.push(place);
        }
        for place in &places {
            place.draw(&mut scene, &names);
        }
        draw_names(&mut scene, &places);
        for note in self.notes() {
            let note = font::fit(&note, SMALL, WIDTH - 2.0 * SIDE);
            scene.text((SIDE, top + font::ASCENT * SMALL), &note, SMALL, Anchor::Start, BLACK);
            top += ROW;
        }
        scene.height = top.ceil();
        scene
    }

    /// Says what the bounds leave out.
    fn notes(&self) -> Vec<String> {
        let most = self.panels.iter().map(|panel| panel.series.len()).max().unwrap_or_default();
        let counts = [(self.panels.len(), MAX_PANELS, "panels"), (most, MAX_SERIES, "lines")];
        let over = counts.into_iter().filter(|(count, bound, _)| count > bound);
        over.map(|(count, bound, what)| format!("{bound} of {count} {what}; {} has all", self.data)).collect()
    }
}

/// Returns the names of all bands, in the order of their colours.
fn names(panels: &[Panel]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for band in panels.iter().flat_map(|panel| &panel.bands) {
        if !band.name.is_empty() && !names.contains(&band.name) {
            names.push(band.name.clone());
        }
    }
    names
}

/// Writes a value above an axis with three digits, or all digits before the point.
fn short(value: f64) -> String {
    let decimals = match value.abs() {
        100.0.. => 0,
        10.0.. => 1,
        _ => 2,
    };
    let factor = [1.0, 10.0, 100.0][decimals];
    ((value * factor).round() / factor).to_string().replace('-', "−")
}

fn colour(name: &str, names: &[String]) -> Colour {
    names.iter().position(|other| other == name).map_or(GREY, |place| BANDS[place % BANDS.len()])
}

/// Draws the name of each vertical axis, once for panels that follow each other and have the same.
fn draw_names(scene: &mut Scene, places: &[Place<'_>]) {
    for group in places.chunk_by(|a, b| a.panel.y.label == b.panel.y.label) {
        let (first, last) = (&group[0].plot, &group[group.len() - 1].plot);
        let room = last.bottom - first.top + STRIP;
        let label = font::fit(&group[0].panel.y.label, LABEL, room);
        let at = (SIDE + LABEL * 0.8, (first.top + last.bottom) / 2.0);
        scene.turned(at, &label, LABEL, Anchor::Middle, BLACK);
    }
}

impl<'a> Place<'a> {
    /// Places a panel below `top`, and moves `top` below it.
    fn below(
        top: &mut f64,
        panel: &'a Panel,
        (left, height): (f64, f64),
        is_labelled: bool,
        names: &[String],
    ) -> Self {
        let right = WIDTH - RIGHT;
        let is_marked = panel.series.iter().any(|series| series.kind == SeriesKind::Marked);
        let inset = if is_marked { INSET } else { 0.0 };
        let title = font::fit(&panel.title, LABEL, right - left);
        let mut plot = Rect { left, top: *top, right, bottom: *top + height };
        let place = Self { panel, legend: Legend::new(Vec::new(), 0.0, WIDTH), plot, inset, is_labelled };
        let entries = place.entries(names);
        let has_head = !title.is_empty() || !entries.is_empty();
        let beside_title = if title.is_empty() { 0.0 } else { font::width(&title, LABEL) + SIDE };
        let legend = Legend::new(entries, WIDTH - left - beside_title, WIDTH - left);
        let strip = if panel.bands.is_empty() { 0.0 } else { STRIP };
        let head = if has_head { ROW + legend.height() + 1.0 } else { 2.0 };
        plot.top = *top + head + strip;
        plot.bottom = plot.top + height;
        let below = if is_labelled { panel.x.height(plot.width() - 2.0 * inset) } else { 2.0 };
        *top = plot.bottom + below + BETWEEN;
        Self { legend, plot, ..place }
    }

    fn top(&self) -> f64 {
        let strip = if self.panel.bands.is_empty() { 0.0 } else { STRIP };
        self.plot.top - strip - 1.0 - ROW - self.legend.height()
    }

    fn entries(&self, names: &[String]) -> Vec<Entry> {
        let panel = self.panel;
        let series = panel.series.iter().take(MAX_SERIES).enumerate().map(|(i, series)| {
            let number = series.look.unwrap_or(i);
            let look = match series.kind {
                SeriesKind::Faint => Look::Faint(number),
                SeriesKind::Dense => Look::Dense(number),
                SeriesKind::Line => Look::Line(number),
                SeriesKind::Range => Look::Range(number),
                SeriesKind::Marked => Look::Marked(number),
            };
            Entry { name: series.name.clone(), look }
        });
        let levels = panel.level.iter().chain(&panel.upright);
        let level = levels.map(|level| Entry { name: level.name.clone(), look: Look::Level });
        let cut = self.highest_cut();
        let cut = cut
            .map(|value| Entry { name: format!("above the axis: up to {}", short(value)), look: Look::Cut });
        let missing = (!panel.missing.1.is_empty())
            .then(|| Entry { name: panel.missing.0.clone(), look: Look::Missing });
        series
            .chain(level)
            .chain(missing)
            .chain(cut)
            .filter(|entry| !entry.name.is_empty())
            .chain(self.outside_strip(names))
            .collect()
    }

    /// Returns the entries of bands whose names have no room in the strip. Where names are more than colours, an entry has all
    /// names of its colour.
    fn outside_strip(&self, names: &[String]) -> Vec<Entry> {
        let in_strip = self.names_in_strip();
        let in_panel = |name: &&String| self.panel.bands.iter().any(|band| band.name == **name);
        let is_outside = |name: &&String| !in_strip.iter().any(|(_, named)| *named == name.as_str());
        let mut colours: Vec<Colour> = Vec::new();
        for name in names.iter().filter(in_panel).filter(is_outside) {
            let colour = colour(name, names);
            if !colours.contains(&colour) {
                colours.push(colour);
            }
        }
        let entry = |wanted: Colour| {
            let same = names.iter().filter(in_panel).filter(|name| colour(name, names) == wanted);
            let name = same.map(String::as_str).collect::<Vec<_>>().join(" or ");
            Entry { name, look: Look::Area(wanted.lighter(LIGHT)) }
        };
        colours.into_iter().map(entry).collect()
    }

    fn x(&self, value: f64) -> f64 {
        self.plot.left + self.inset + self.panel.x.share(value) * (self.plot.width() - 2.0 * self.inset)
    }

    fn y(&self, value: f64) -> f64 {
        self.plot.bottom - self.panel.y.share(value) * self.plot.height()
    }

    /// Returns the ends of a band, points.
    fn ends(&self, band: &Band) -> (f64, f64) {
        let within = |value| self.x(value).clamp(self.plot.left, self.plot.right);
        (within(band.from), within(band.to))
    }

    /// Returns the middles of names in the strip: of all bands that are wide enough, then of narrower ones beside which there
    /// is room.
    fn names_in_strip(&self) -> Vec<(f64, &str)> {
        let named = self.panel.bands.iter().filter(|band| !band.name.is_empty() && band.is_finite());
        let (wide, narrow): (Vec<_>, Vec<_>) = named
            .map(|band| (self.ends(band), font::width(&band.name, SMALL) + 2.0, band.name.as_str()))
            .partition(|((from, to), width, _)| *width <= to - from);
        let mut placed: Vec<(f64, f64, &str)> = wide
            .into_iter()
            .map(|((from, to), width, name)| (f64::midpoint(from, to), width, name))
            .collect();
        for ((from, to), width, name) in narrow {
            // Beside the last band is the margin, and beside the first are the labels of the axis.
            let (first, last) = (self.plot.left + width / 2.0, WIDTH - width / 2.0);
            let middle = f64::midpoint(from, to).min(last).max(first);
            let is_free = |(other, its, _): &(f64, f64, &str)| (middle - other).abs() >= (width + its) / 2.0;
            if to - from >= OVERHANG * width && placed.iter().all(is_free) {
                placed.push((middle, width, name));
            }
        }
        placed.into_iter().map(|(middle, _, name)| (middle, name)).collect()
    }

    /// Whether a value is above the vertical axis, other than by rounding.
    fn is_cut(&self, value: f64) -> bool {
        self.panel.y.share(value) > 1.0 + 1e-9
    }

    /// Returns the highest value above the vertical axis.
    fn highest_cut(&self) -> Option<f64> {
        let series = self.panel.series.iter().take(MAX_SERIES);
        let samples = series.flat_map(|series| &series.parts).flatten().filter(|sample| sample.is_finite());
        samples.map(Sample::highest).filter(|value| self.is_cut(*value)).max_by(f64::total_cmp)
    }

    fn draw(&self, scene: &mut Scene, names: &[String]) {
        let (panel, plot) = (self.panel, &self.plot);
        let title = font::fit(&panel.title, LABEL, plot.width());
        if !title.is_empty() {
            let at = (plot.left, self.top() + ROW / 2.0 + LABEL * 0.34);
            scene.text(at, &title, LABEL, Anchor::Start, BLACK);
        }
        self.legend.draw(scene, self.top());
        for band in panel.bands.iter().filter(|band| band.is_finite()) {
            let ((left, right), colour) = (self.ends(band), colour(&band.name, names));
            scene.area(Rect { left, right, ..*plot }.corners(), colour.lighter(PALE));
            let strip = Rect { left, right, top: plot.top - STRIP, bottom: plot.top };
            scene.area(strip.corners(), colour.lighter(LIGHT));
        }
        for (middle, name) in self.names_in_strip() {
            let at = (middle, plot.top - STRIP / 2.0 + SMALL * 0.35);
            scene.text(at, name, SMALL, Anchor::Middle, BLACK);
        }
        panel.y.draw_beside(scene, plot, true);
        panel.x.draw_below(scene, plot, self.inset, self.is_labelled);
        if let Some(level) =
            panel.level.as_ref().filter(|level| (panel.y.from..=panel.y.to).contains(&level.at))
        {
            let y = self.y(level.at);
            scene.line(vec![(plot.left, y), (plot.right, y)], ALERT, FINE * 1.4, LEVEL_DASHES);
        }
        if let Some(upright) =
            panel.upright.as_ref().filter(|upright| (panel.x.from..=panel.x.to).contains(&upright.at))
        {
            let x = self.x(upright.at);
            scene.line(vec![(x, plot.bottom), (x, plot.top)], ALERT, FINE * 1.4, LEVEL_DASHES);
        }
        let shown = panel.series.len().min(MAX_SERIES);
        for (i, series) in panel.series.iter().take(shown).enumerate() {
            self.draw_series(scene, i, series, shown);
        }
        for (i, series) in panel.series.iter().take(shown).enumerate() {
            self.draw_cuts(scene, i, series, shown);
        }
        let mut free_from = f64::NEG_INFINITY;
        for x in panel.missing.1.iter().map(|at| self.x(*at)) {
            if x >= free_from && x <= plot.right {
                scene.line(vec![(x, plot.top), (x, plot.top + MISSING)], ALERT, FINE, &[]);
                free_from = x + MISSING_EVERY;
            }
        }
    }

    fn draw_series(&self, scene: &mut Scene, place: usize, series: &Series, shown: usize) {
        let number = series.look.unwrap_or(place);
        let (colour, dashes) = (SERIES[number % SERIES.len()], DASHES[number % DASHES.len()]);
        let aside = self.dodge(place, shown);
        for part in &series.parts {
            let samples: Vec<_> = part.iter().filter(|sample| sample.is_finite()).collect();
            let at = |sample: &Sample, value: f64| (self.x(sample.x) + aside, self.y(value));
            let mut line: Vec<Point> = samples.iter().map(|sample| at(sample, sample.y)).collect();
            match series.kind {
                SeriesKind::Faint | SeriesKind::Dense | SeriesKind::Line => {
                    // A single value is a short line.
                    if let [(x, y)] = line[..] {
                        line = vec![(x - FINE / 2.0, y), (x + FINE / 2.0, y)];
                    }
                    match series.kind {
                        SeriesKind::Faint => self.clipped(scene, &line, colour.lighter(LIGHT), WIDE, &[]),
                        SeriesKind::Dense => self.clipped(scene, &line, colour, FINE, &[]),
                        _ => self.clipped(scene, &line, colour, BOLD, dashes),
                    }
                }
                SeriesKind::Range => {
                    let edge = |of: fn((f64, f64)) -> f64| -> Vec<Point> {
                        let inside = |(x, y): Point| (x, y.clamp(self.plot.top, self.plot.bottom));
                        samples.iter().map(|s| inside(at(s, of(s.range.unwrap_or((s.y, s.y)))))).collect()
                    };
                    let (low, mut high) = (edge(|range| range.0), edge(|range| range.1));
                    high.reverse();
                    scene.area([low, high].concat(), colour.lighter(0.6));
                    self.clipped(scene, &line, colour, FINE, &[]);
                }
                SeriesKind::Marked => {
                    self.clipped(scene, &line, colour, BOLD, dashes);
                    for sample in samples {
                        if let Some((low, high)) = sample.range {
                            let [(x, bottom), (_, top)] = [at(sample, low), at(sample, high)];
                            self.clipped(scene, &[(x, bottom), (x, top)], colour, FINE, &[]);
                            for y in [bottom, top] {
                                self.clipped(scene, &[(x - WHISKER, y), (x + WHISKER, y)], colour, FINE, &[]);
                            }
                        }
                        mark(scene, at(sample, sample.y), number);
                    }
                }
            }
        }
    }

    /// Marks the values of a series above the vertical axis, at the top of the plot.
    fn draw_cuts(&self, scene: &mut Scene, place: usize, series: &Series, shown: usize) {
        let number = series.look.unwrap_or(place);
        let aside = self.dodge(place, shown);
        let mut last = f64::NEG_INFINITY;
        let cut = series.parts.iter().flatten().filter(|sample| sample.is_finite());
        for sample in cut.filter(|sample| self.is_cut(sample.highest())) {
            let x = self.x(sample.x) + aside;
            if (self.plot.left..=self.plot.right).contains(&x) && (x - last).abs() >= CUT_EVERY {
                mark_cut(scene, (x, self.plot.top), SERIES[number % SERIES.len()]);
                last = x;
            }
        }
    }

    fn clipped(&self, scene: &mut Scene, line: &[Point], colour: Colour, width: f64, dashes: &'static [f64]) {
        for part in self.plot.clip_line(line) {
            scene.line(part, colour, width, dashes);
        }
    }

    /// Returns how far the markers of a series stand aside, points, so that none hides another.
    fn dodge(&self, place: usize, shown: usize) -> f64 {
        let is_marked = |series: &&Series| series.kind == SeriesKind::Marked;
        let mut places: Vec<f64> = self
            .panel
            .series
            .iter()
            .filter(is_marked)
            .flat_map(|s| &s.parts)
            .flatten()
            .map(|sample| self.x(sample.x))
            .filter(|x| x.is_finite())
            .collect();
        if places.is_empty() || shown < 2 {
            return 0.0;
        }
        places.sort_by(f64::total_cmp);
        let apart = places.windows(2).map(|pair| pair[1] - pair[0]).filter(|apart| *apart > 1e-6);
        let room = apart.fold(f64::INFINITY, f64::min).min(2.0 * INSET);
        let step = (room * 0.8 / (shown - 1) as f64).min(DODGE);
        (place as f64 - (shown - 1) as f64 / 2.0) * step
    }
}

#[cfg(test)]
mod tests;
