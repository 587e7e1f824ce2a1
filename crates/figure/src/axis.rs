//! Axes: round ends near the data, ticks whose labels have room, and their drawing.

use crate::{
    font,
    geometry::Rect,
    scene::{Anchor, Scene, WIDTH},
    style::{AXIS, BLACK, GRID, LABEL, THIN},
};

/// Length of a tick, points.
const TICK: f64 = 2.0;
/// Room between a tick and its label, and between labels, points.
const GAP: f64 = 2.0;
/// Further room below ticks, so that the first label does not touch that of the vertical axis, points.
const BELOW: f64 = 0.5;
/// Room between labels along the horizontal axis, points.
const BETWEEN: f64 = 6.0;
/// Room for half of a label beyond the ends of a horizontal axis, points.
const BEYOND: f64 = 12.0;
/// Room for a label that reads upwards, points.
const TURNED_ROOM: f64 = 60.0;
/// Ends of an axis are multiples of a round step, of which it has at most so many.
const FINE_STEPS: f64 = 40.0;
/// Ends of a logarithmic axis, within a power of ten.
const ROUND: [f64; 6] = [1.0, 1.5, 2.0, 3.0, 5.0, 7.0];
/// Height of a line of labels, points.
pub(crate) const ROW: f64 = 9.0;

/// An axis: what it shows, and its ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    pub(crate) label: String,
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Ticks with their labels; none for round numbers.
    ticks: Vec<(f64, String)>,
    scale: Scale,
}

/// The scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scale {
    Linear,
    /// Equal ratios are equally long.
    Logarithmic,
}

impl Default for Axis {
    fn default() -> Self {
        Self::around("", 0.0, 1.0)
    }
}

impl Axis {
    /// Creates an axis from 0 or the lowest value, to the highest value. Its ends are round numbers near both.
    pub fn around(label: &str, low: f64, high: f64) -> Self {
        let (low, high) =
            if low.is_finite() && high.is_finite() { (low.min(high), high.max(low)) } else { (0.0, 0.0) };
        // Values whose lower half is empty begin at 0, and so does a constant.
        let low = if low > 0.0 && (low <= high / 2.0 || low == high) { 0.0 } else { low };
        let high = if high > low { high } else { low + low.abs().max(1.0) * 0.1 };
        let step = round_step((high - low) / FINE_STEPS);
        // Rounding errors do not add a step.
        let from = (low / step + 1e-9).floor() * step;
        let to = (high / step - 1e-9).ceil() * step;
        Self { label: label.to_owned(), from, to, ticks: Vec::new(), scale: Scale::Linear }
    }

    /// Creates an axis with exactly these ends.
    pub(crate) fn between(label: &str, from: f64, to: f64) -> Self {
        Self { label: label.to_owned(), from, to, ticks: Vec::new(), scale: Scale::Linear }
    }

    /// Creates a logarithmic axis from a positive value to a higher one. Its ends are round numbers near both. Values that are not positive lie far below it.
    pub fn logarithmic(label: &str, low: f64, high: f64) -> Self {
        let is_positive = |value: f64| value.is_finite() && value > 0.0;
        let low = if is_positive(low) { low } else { 1.0 };
        let high = if is_positive(high) { high.max(low) } else { low };
        let power = |value: f64| 10_f64.powf(value.log10().floor());
        // Rounding errors do not add a step.
        let below =
            ROUND.iter().rev().map(|factor| factor * power(low)).find(|end| *end <= low * (1.0 + 1e-9));
        let above = ROUND.iter().map(|factor| factor * power(high)).find(|end| *end >= high * (1.0 - 1e-9));
        let from = below.unwrap_or_else(|| power(low));
        let to = above.unwrap_or_else(|| 10.0 * power(high));
        let to = if to > from { to } else { from * 10.0 };
        Self { label: label.to_owned(), from, to, ticks: Vec::new(), scale: Scale::Logarithmic }
    }

    /// Creates an axis with these values, in any order: numbers at their places, or names at 1, 2, 3 and so on.
    pub fn values(label: &str, values: &[(f64, String)]) -> Self {
        let mut ticks = values.to_vec();
        ticks.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let (low, high) =
            ticks.first().zip(ticks.last()).map_or((0.0, 0.0), |((low, _), (high, _))| (*low, *high));
        // A single value stands in the middle.
        let (from, to) = if high > low { (low, high) } else { (low - 1.0, low + 1.0) };
        Self { label: label.to_owned(), from, to, ticks, scale: Scale::Linear }
    }

    /// Returns an axis with the ends of both.
    pub fn joined(self, other: &Self) -> Self {
        Self { from: self.from.min(other.from), to: self.to.max(other.to), ..self }
    }

    /// Returns the share of the axis below a value.
    pub(crate) fn share(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => (value - self.from) / (self.to - self.from),
            Scale::Logarithmic => {
                let value = if value > 0.0 { value } else { f64::MIN_POSITIVE };
                (value / self.from).ln() / (self.to / self.from).ln()
            }
        }
    }

    /// Returns the ticks and labels of a vertical axis of this height.
    pub(crate) fn up(&self, height: f64) -> Vec<(f64, String)> {
        if self.scale == Scale::Logarithmic {
            let apart = |pair: &[(f64, String)]| (self.share(pair[1].0) - self.share(pair[0].0)) * height;
            return self.powers(|ticks| ticks.windows(2).all(|pair| apart(pair) > LABEL * 1.2));
        }
        let most = (height / (LABEL * 1.9)).clamp(2.0, 7.0);
        let ticks = self.round_ticks(most);
        // An axis that does not end at round numbers can have a single one of them.
        let have_room = |ticks: &Vec<(f64, String)>| {
            let apart = |pair: &[(f64, String)]| (self.share(pair[1].0) - self.share(pair[0].0)) * height;
            ticks.len() > 1 && ticks.windows(2).all(|pair| apart(pair) > LABEL * 1.2)
        };
        let mut finer = [1.5, 2.0, 3.0].into_iter().map(|more| self.round_ticks(more * most));
        if ticks.len() > 1 { ticks } else { finer.find(have_room).unwrap_or(ticks) }
    }

    /// Returns the ticks and labels of a horizontal axis of this width.
    fn along(&self, width: f64) -> Vec<(f64, String)> {
        if !self.ticks.is_empty() {
            return self.ticks.clone();
        }
        if self.scale == Scale::Logarithmic {
            return self.powers(|ticks| self.have_room(ticks, width));
        }
        let fewer = (2..=8).rev().map(|most| self.round_ticks(f64::from(most)));
        fewer.into_iter().find(|ticks| self.have_room(ticks, width)).unwrap_or_default()
    }

    /// Whether labels stand beside each other on a horizontal axis of this width.
    fn have_room(&self, ticks: &[(f64, String)], width: f64) -> bool {
        let wide = |label: &str| font::width(label, LABEL) / 2.0;
        let is_within = |(at, label): &(f64, String)| {
            let share = self.share(*at);
            wide(label) <= share.min(1.0 - share) * width + BEYOND
        };
        ticks.iter().all(is_within)
            && ticks.windows(2).all(|pair| {
                let apart = (self.share(pair[1].0) - self.share(pair[0].0)) * width;
                apart >= wide(&pair[0].1) + wide(&pair[1].1) + BETWEEN
            })
    }

    /// Returns the most ticks of a logarithmic axis that fit: 1, 2 and 5 times each power of ten, or every power, or every
    /// second power, and so on.
    fn powers(&self, fit: impl Fn(&[(f64, String)]) -> bool) -> Vec<(f64, String)> {
        let (first, last) =
            ((self.from.log10() - 1e-9).floor() as i32, (self.to.log10() + 1e-9).floor() as i32);
        let within = |at: f64| (self.from * (1.0 - 1e-9)..=self.to * (1.0 + 1e-9)).contains(&at);
        let ticks = |every: usize, factors: &[f64]| -> Vec<(f64, String)> {
            let powers = (first..=last).rev().step_by(every);
            let all = powers.flat_map(|power| factors.iter().rev().map(move |factor| (power, *factor)));
            let tick = |(power, factor): (i32, f64)| {
                let (at, decimals) = (factor * 10_f64.powi(power), usize::try_from(-power).unwrap_or(0));
                within(at).then(|| (at, format!("{at:.decimals$}")))
            };
            let mut ticks: Vec<_> = all.filter_map(tick).collect();
            ticks.reverse();
            ticks
        };
        let mut sparser =
            std::iter::once(ticks(1, &[1.0, 2.0, 5.0])).chain((1..8).map(|every| ticks(every, &[1.0])));
        sparser.find(|ticks| fit(ticks)).unwrap_or_default()
    }

    /// Returns multiples of a round step within the axis: at most `most` steps.
    fn round_ticks(&self, most: f64) -> Vec<(f64, String)> {
        let step = round_step((self.to - self.from) / most);
        let (first, last) = ((self.from / step - 1e-9).ceil() as i64, (self.to / step + 1e-9).floor() as i64);
        let decimals = (-step.log10().floor()).max(0.0) as usize;
        let tick = |i: i64| {
            let at = i as f64 * step;
            (at, format!("{at:.decimals$}").replace('-', "−"))
        };
        (first..=last).map(tick).collect()
    }

    /// Returns the height below a plot of this width for ticks, labels and the name of the axis.
    pub(crate) fn height(&self, width: f64) -> f64 {
        TICK + GAP + BELOW + self.labels_height(width) + if self.label.is_empty() { 0.0 } else { ROW }
    }

    /// Returns the width of the widest label of a horizontal axis of this width.
    pub(crate) fn label_width(&self, width: f64) -> f64 {
        self.along(width).iter().map(|(_, label)| font::width(label, LABEL)).fold(0.0, f64::max)
    }

    fn labels_height(&self, width: f64) -> f64 {
        let ticks = self.along(width);
        if self.have_room(&ticks, width) {
            return ROW - 1.0;
        }
        self.label_width(width).min(TURNED_ROOM) + GAP
    }

    /// Draws ticks below a plot, and labels and the name of the axis if `is_labelled`. The axis ends `inset` from the sides of
    /// the plot.
    pub(crate) fn draw_below(&self, scene: &mut Scene, plot: &Rect, inset: f64, is_labelled: bool) {
        let width = plot.width() - 2.0 * inset;
        let ticks = self.along(width);
        let side_by_side = self.have_room(&ticks, width);
        scene.line(vec![(plot.left, plot.bottom), (plot.right, plot.bottom)], AXIS, THIN, &[]);
        let labels = plot.bottom + TICK + GAP + BELOW;
        // Turned labels that are too close leave some out.
        let mut free_from = f64::NEG_INFINITY;
        for (at, label) in &ticks {
            let x = plot.left + inset + self.share(*at) * width;
            scene.line(vec![(x, plot.bottom), (x, plot.bottom + TICK)], AXIS, THIN, &[]);
            if !is_labelled {
                continue;
            }
            if side_by_side {
                let half = font::width(label, LABEL) / 2.0;
                let x = x.min(WIDTH - half - 0.5);
                scene.text((x, labels + font::ASCENT * LABEL), label, LABEL, Anchor::Middle, BLACK);
            } else if x - LABEL / 2.0 > free_from {
                let label = font::fit(label, LABEL, TURNED_ROOM);
                scene.turned((x + LABEL * 0.35, labels), &label, LABEL, Anchor::End, BLACK);
                free_from = x + LABEL / 2.0;
            }
        }
        if is_labelled && !self.label.is_empty() {
            let label = font::fit(&self.label, LABEL, WIDTH - 4.0);
            let half = font::width(&label, LABEL) / 2.0;
            let middle = ((plot.left + plot.right) / 2.0).min(WIDTH - half - 1.0);
            let y = labels + self.labels_height(width) + font::ASCENT * LABEL + 1.0;
            scene.text((middle, y), &label, LABEL, Anchor::Middle, BLACK);
        }
    }

    /// Draws ticks and labels of a vertical axis beside a plot, and lines in it if `has_grid`.
    pub(crate) fn draw_beside(&self, scene: &mut Scene, plot: &Rect, has_grid: bool) {
        for (at, label) in self.up(plot.height()) {
            let y = plot.bottom - self.share(at) * plot.height();
            if has_grid {
                scene.line(vec![(plot.left, y), (plot.right, y)], GRID, THIN, &[]);
            }
            scene.line(vec![(plot.left - TICK, y), (plot.left, y)], AXIS, THIN, &[]);
            let baseline = y + LABEL * 0.36;
            scene.text((plot.left - TICK - GAP, baseline), &label, LABEL, Anchor::End, BLACK);
        }
        scene.line(vec![(plot.left, plot.top), (plot.left, plot.bottom)], AXIS, THIN, &[]);
    }

    /// Returns the width left of a plot of this height for ticks and labels.
    pub(crate) fn width(&self, height: f64) -> f64 {
        let labels = self.up(height).into_iter().map(|(_, label)| font::width(&label, LABEL));
        labels.fold(0.0, f64::max) + TICK + GAP
    }
}

/// Returns the lowest of 1, 2 and 5 times a power of ten that is not below a value.
fn round_step(least: f64) -> f64 {
    let power = 10_f64.powf(least.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= least * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * power
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Item;

    fn ends(low: f64, high: f64) -> (f64, f64) {
        let Axis { from, to, .. } = Axis::around("", low, high);
        (from, to)
    }

    #[test]
    fn axes_end_at_round_numbers_near_the_data() {
        assert_eq!(ends(0.0, 391.0), (0.0, 400.0));
        assert_eq!(ends(0.0, 63.0), (0.0, 64.0));
        assert_eq!(ends(0.0, 51.0), (0.0, 52.0));
        assert_eq!(ends(3.0, 36.3), (0.0, 37.0));
        assert_eq!(ends(-80.5, -41.0), (-81.0, -41.0));
        assert_eq!(ends(90.0, 101.0), (90.0, 101.0));
        assert_eq!(ends(0.0, 0.0), (0.0, 0.1));
        assert_eq!(ends(4.0, 4.0), (0.0, 4.0));
        assert_eq!(ends(f64::INFINITY, f64::NEG_INFINITY), (0.0, 0.1));
        for high in 1..2000 {
            let (_, to) = ends(0.0, f64::from(high));
            assert!(to >= f64::from(high) && to <= f64::from(high) * 1.07, "{high}: {to}");
        }
    }

    #[test]
    fn ticks_are_round_and_their_labels_have_room() {
        let labels =
            |axis: &Axis, width| axis.along(width).into_iter().map(|(_, label)| label).collect::<Vec<_>>();
        assert_eq!(
            labels(&Axis::around("", 0.0, 400.0), 200.0),
            ["0", "50", "100", "150", "200", "250", "300", "350", "400"]
        );
        assert_eq!(labels(&Axis::around("", 0.0, 400.0), 60.0), ["0", "200", "400"]);
        assert_eq!(
            labels(&Axis::around("", -0.3, 0.3), 200.0),
            ["−0.3", "−0.2", "−0.1", "0.0", "0.1", "0.2", "0.3"]
        );
        let large = Axis::around("", 0.0, 123_456_789.0);
        assert!(large.have_room(&large.along(100.0), 100.0));
        assert!(large.up(60.0).len() >= 3);
    }

    #[test]
    fn a_logarithmic_axis_gives_equal_ratios_equal_lengths() {
        for (low, high, from, to) in
            [(9.1, 131.0, 7.0, 150.0), (0.012, 100.0, 0.01, 100.0), (5.0, 71.0, 5.0, 100.0)]
        {
            let axis = Axis::logarithmic("", low, high);
            assert!((axis.from / from - 1.0).abs() < 1e-9 && (axis.to / to - 1.0).abs() < 1e-9, "{axis:?}");
        }
        let axis = Axis::logarithmic("", 5.0, 200.0);
        let step = axis.share(20.0) - axis.share(10.0);
        assert!((axis.share(100.0) - axis.share(50.0) - step).abs() < 1e-12);
        assert!((axis.share(5.0), axis.share(200.0)) == (0.0, 1.0));
        assert!(axis.share(0.0) < -10.0 && axis.share(0.0).is_finite());
        let same = Axis::logarithmic("", 10.0, 10.0);
        assert!(same.to > same.from, "{same:?}");
        let none = Axis::logarithmic("", 0.0, f64::NAN);
        assert!(none.from > 0.0 && none.to > none.from, "{none:?}");
    }

    #[test]
    fn a_logarithmic_axis_names_as_many_round_numbers_as_have_room() {
        let labels =
            |ticks: Vec<(f64, String)>| ticks.into_iter().map(|(_, label)| label).collect::<Vec<_>>();
        let times = Axis::logarithmic("", 5.0, 200.0);
        assert_eq!(labels(times.along(200.0)), ["5", "10", "20", "50", "100", "200"]);
        assert_eq!(labels(times.along(50.0)), ["10", "100"]);
        let shares = Axis::logarithmic("", 0.01, 100.0);
        assert_eq!(labels(shares.up(60.0)), ["0.01", "0.1", "1", "10", "100"]);
        assert_eq!(labels(shares.up(25.0)), ["0.01", "1", "100"]);
    }

    #[test]
    fn values_in_any_order_keep_their_labels() {
        let labels = |places: &[u32]| {
            let values: Vec<_> = places.iter().map(|at| (f64::from(*at), format!("{at} ms"))).collect();
            let mut scene = Scene::new();
            let plot = Rect { left: 30.0, top: 0.0, right: 230.0, bottom: 50.0 };
            Axis::values("delay", &values).draw_below(&mut scene, &plot, 8.0, true);
            let text = |item: &Item| match item {
                Item::Text(text) if !text.is_turned => Some(text.text.clone()),
                _ => None,
            };
            scene.items.iter().filter_map(text).collect::<Vec<_>>()
        };
        for places in [[10, 20, 30], [30, 20, 10], [20, 30, 10]] {
            assert_eq!(labels(&places), ["10 ms", "20 ms", "30 ms", "delay"], "{places:?}");
        }
    }

    #[test]
    fn long_names_of_values_are_turned_and_never_overlap() {
        let names = |count: u32| -> Vec<_> {
            (1..=count).map(|i| (f64::from(i), format!("a plug-in with the number {i}"))).collect()
        };
        let plot = Rect { left: 30.0, top: 0.0, right: 230.0, bottom: 50.0 };
        for count in [1, 2, 5, 60] {
            let axis = Axis::values("plug-in", &names(count));
            let mut scene = Scene::new();
            axis.draw_below(&mut scene, &plot, 8.0, true);
            scene.height = plot.bottom + axis.height(plot.width() - 16.0);
            assert_eq!(scene.collisions(), Vec::<String>::new(), "{count}");
        }
    }
}
