//! Colours, dashes, markers and sizes of all figures.
//!
//! The colours are those of Okabe and Ito ("Color Universal Design", 2008), which colour-blind readers can distinguish.
//! Lines also differ in dashes and markers, so that a printout without colours shows them as well. Values have the
//! colours of viridis (van der Walt and Smith, 2015), which become lighter in equal steps.

use std::f64::consts::TAU;

use crate::{colour::Colour, geometry::Point, scene::Scene};

pub(crate) const BLACK: Colour = Colour::new(0x00_0000);
pub(crate) const WHITE: Colour = Colour::new(0xff_ffff);
/// Axes and ticks.
pub(crate) const AXIS: Colour = Colour::new(0x44_4444);
pub(crate) const GRID: Colour = Colour::new(0xdd_dddd);
/// Targets and missing values.
pub(crate) const ALERT: Colour = Colour::new(0xb0_1030);
/// Bands without a colour of their own.
pub(crate) const GREY: Colour = Colour::new(0x99_9999);

const BLUE: Colour = Colour::new(0x00_72b2);
const VERMILLION: Colour = Colour::new(0xd5_5e00);
const GREEN: Colour = Colour::new(0x00_9e73);
const PURPLE: Colour = Colour::new(0xcc_79a7);
const ORANGE: Colour = Colour::new(0xe6_9f00);
const SKY: Colour = Colour::new(0x56_b4e9);
const YELLOW: Colour = Colour::new(0xf0_e442);

/// Colours of series, in order.
pub(crate) const SERIES: [Colour; 8] = [BLUE, VERMILLION, GREEN, PURPLE, BLACK, SKY, ORANGE, GREY];
/// Dashes of series, in order. A dashed line shows the line below in its gaps.
pub(crate) const DASHES: [&[f64]; 8] = [
    &[],
    &[4.0, 2.0],
    &[1.2, 1.6],
    &[5.0, 1.6, 1.2, 1.6],
    &[8.0, 2.4],
    &[2.4, 1.2],
    &[5.0, 1.6, 1.2, 1.6, 1.2, 1.6],
    &[1.2, 3.2],
];
/// Colours of bands, in order.
pub(crate) const BANDS: [Colour; 7] = [SKY, ORANGE, GREEN, PURPLE, YELLOW, VERMILLION, BLUE];

/// Colours of values from the lowest to the highest, at equal distances.
const RAMP: [Colour; 11] = [
    Colour::new(0x44_0154),
    Colour::new(0x48_2576),
    Colour::new(0x41_4487),
    Colour::new(0x35_608d),
    Colour::new(0x2a_788e),
    Colour::new(0x21_908c),
    Colour::new(0x22_a884),
    Colour::new(0x43_bf71),
    Colour::new(0x7a_d151),
    Colour::new(0xbb_df27),
    Colour::new(0xfd_e725),
];
/// Share of white in the colours of values, so that walls and lines are seen on them.
const WASHED: f64 = 0.3;

/// Returns the colour of a value at this share of its scale. Beyond its ends, it is that of the end.
pub(crate) fn ramp(share: f64) -> Colour {
    let place = share.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let below = (place as usize).min(RAMP.len() - 2);
    let (Colour(from), Colour(to)) = (RAMP[below], RAMP[below + 1]);
    let between =
        |i: usize| f64::from(from[i]) + (f64::from(to[i]) - f64::from(from[i])) * (place - below as f64);
    Colour([0, 1, 2].map(|i| between(i).round() as u8)).lighter(WASHED)
}

/// Share of white in the shading of a plot, and in the band above it.
pub(crate) const PALE: f64 = 0.85;
pub(crate) const LIGHT: f64 = 0.55;

/// Sizes of letters, points.
pub(crate) const TITLE: f64 = 8.0;
pub(crate) const LABEL: f64 = 7.0;
pub(crate) const SMALL: f64 = 6.5;

/// Widths of lines, points.
pub(crate) const THIN: f64 = 0.4;
pub(crate) const FINE: f64 = 0.6;
pub(crate) const BOLD: f64 = 1.1;
pub(crate) const WIDE: f64 = 1.4;

/// Radius of a marker, points.
pub(crate) const MARKER: f64 = 2.2;

/// Draws the marker of a series. Every other one is hollow, so that the one below can be seen.
pub(crate) fn mark(scene: &mut Scene, (x, y): Point, series: usize) {
    let polygon = |corners: u32, turn: f64, radius: &dyn Fn(u32) -> f64| -> Vec<Point> {
        let corner = |i: u32| {
            let (angle, radius) = (TAU * (f64::from(i) / f64::from(corners) + turn), radius(i) * MARKER);
            (x + angle.sin() * radius, y - angle.cos() * radius)
        };
        (0..corners).map(corner).collect()
    };
    let round = |_| 1.0;
    let outline = match series % SERIES.len() {
        0 => polygon(16, 0.0, &round),
        1 => polygon(4, 0.125, &|_| 1.2),
        2 => polygon(3, 0.0, &|_| 1.2),
        3 => polygon(4, 0.0, &|_| 1.2),
        4 => polygon(3, 0.5, &|_| 1.2),
        5 => polygon(5, 0.0, &|_| 1.1),
        6 => polygon(10, 0.0, &|i| if i % 2 == 0 { 1.3 } else { 0.5 }),
        _ => polygon(8, 0.0, &|i| if i % 2 == 0 { 1.3 } else { 0.5 }),
    };
    let colour = SERIES[series % SERIES.len()];
    scene.area(outline.clone(), if series.is_multiple_of(2) { colour } else { WHITE });
    let closed = outline.iter().chain(outline.first()).copied().collect();
    scene.line(closed, colour, 0.7, &[]);
}

/// Draws the mark of a value above an axis: a triangle below `top` that points there.
pub(crate) fn mark_cut(scene: &mut Scene, (x, top): Point, colour: Colour) {
    scene.area(vec![(x, top), (x + 1.6, top + 3.2), (x - 1.6, top + 3.2)], colour);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Item;

    /// Relative luminance (WCAG 2).
    fn luminance(Colour(rgb): Colour) -> f64 {
        let linear = rgb.map(|part| (f64::from(part) / 255.0).powf(2.2));
        0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    }

    #[test]
    fn higher_values_are_lighter_also_without_colours() {
        let shades: Vec<_> = (0..=40).map(|i| luminance(ramp(f64::from(i) / 40.0))).collect();
        assert!(shades.windows(2).all(|pair| pair[1] > pair[0] + 0.003), "{shades:?}");
        assert_eq!((ramp(-1.0), ramp(2.0)), (ramp(0.0), ramp(1.0)));
        // Walls are seen on the darkest, by the contrast that WCAG 2 wants of graphics.
        assert!((shades[0] + 0.05) / (luminance(BLACK) + 0.05) >= 3.0, "{shades:?}");
    }

    #[test]
    fn every_series_has_its_own_colour_dashes_and_marker() {
        for i in 0..SERIES.len() {
            let drawn = |series| {
                let mut scene = Scene::new();
                mark(&mut scene, (0.0, 0.0), series);
                let Item::Area(outline, _) = scene.items.remove(0) else { panic!("a marker is an area") };
                outline
            };
            for j in i + 1..SERIES.len() {
                assert!(SERIES[i] != SERIES[j] && DASHES[i] != DASHES[j] && drawn(i) != drawn(j), "{i} {j}");
            }
        }
    }
}
