//! Plots of curves in Braille characters. Each column of dots shows the range of samples of an interval.

use std::fmt::Write as _;

use cotorra_measurements::{Curve, Point, Values};

/// Rows of characters.
const HEIGHT: usize = 8;
/// Columns of dots of a character.
const WIDE: usize = 2;
/// Rows of dots of a character.
const HIGH: usize = 4;

/// Returns how many points fit beside the scale into this many columns of the terminal.
pub fn points(columns: usize) -> usize {
    WIDE * columns.saturating_sub(SCALE + 1).clamp(20, 200)
}

/// The first of the Braille patterns (Unicode, block U+2800); the others follow by their dots.
const BRAILLE: u32 = 0x2800;
/// Columns of the scale.
const SCALE: usize = 11;

/// Draws a curve of at most [`points`] points. Empty if the curve has no samples.
pub fn draw(curve: &Curve) -> String {
    let values = || curve.points.iter().filter_map(|point| point.values.as_ref());
    let (Some(first), Some(last)) = (curve.points.first(), curve.points.last()) else {
        return String::new();
    };
    let low = values().map(|v| v.min).fold(f64::INFINITY, f64::min);
    let high = values().map(|v| v.max).fold(f64::NEG_INFINITY, f64::max);
    if low > high {
        return String::new();
    }
    let step = (first.until.as_nanos() - first.from.as_nanos()).max(1);
    let place = |point: &Point| ((point.from.as_nanos() - first.from.as_nanos()) / step) as usize;
    let columns = place(last) / WIDE + 1;
    let mut dots = vec![0_u8; columns * HEIGHT];
    let range = if high > low { high - low } else { 1.0 };
    let top = HEIGHT * HIGH - 1;
    let level = |value: f64| top - ((value - low) / range * top as f64).round() as usize;
    for point in &curve.points {
        let Some(values) = &point.values else { continue };
        for y in level(values.max)..=level(values.min) {
            let x = place(point);
            dots[y / HIGH * columns + x / WIDE] |= dot(x % WIDE, y % HIGH);
        }
    }
    let mut text = String::new();
    let mut line = |scale: String, rest: &str| {
        writeln!(text, "{scale:>SCALE$} {}", rest.trim_end()).expect("writing into a string cannot fail");
    };
    for (y, row) in dots.chunks(columns).enumerate() {
        let scale = match y {
            0 => figure(high),
            y if y == HEIGHT - 1 => figure(low),
            _ => String::new(),
        };
        let braille =
            |dots: &u8| char::from_u32(BRAILLE + u32::from(*dots)).filter(|_| *dots > 0).unwrap_or(' ');
        line(scale, &row.iter().map(braille).collect::<String>());
    }
    if curve.points.iter().any(|point| point.gap) {
        let mut marks = vec![' '; columns];
        let gaps = curve.points.iter().filter(|point| point.gap);
        gaps.for_each(|point| marks[place(point) / WIDE] = '!');
        line("lost".to_owned(), &marks.iter().collect::<String>());
    }
    let (from, until) = (first.from.as_secs_f64(), last.until.as_secs_f64());
    let until = format!("{until:.1} s");
    let from = format!("{from:.1} s");
    line(String::new(), &format!("{from}{until:>width$}", width = columns.saturating_sub(from.len())));
    text
}

/// Returns the bit of a dot in a Braille pattern: 1 2 3 7 down the left, 4 5 6 8 down the right.
fn dot(x: usize, y: usize) -> u8 {
    const BITS: [[u8; HIGH]; WIDE] = [[0, 1, 2, 6], [3, 4, 5, 7]];
    1 << BITS[x][y]
}

/// Formats a figure with four significant digits.
pub fn figure(value: f64) -> String {
    let digits = match value.abs() {
        size if size >= 1e6 || (size > 0.0 && size < 1e-3) => return format!("{value:.3e}"),
        size if size >= 1000.0 => 0,
        size if size >= 100.0 => 1,
        size if size >= 10.0 => 2,
        _ => 3,
    };
    format!("{value:.digits$}")
}

/// Marks an approximate quantile.
pub const ABOUT: &str = "≈";

/// Formats one of the quantiles, marked if it is approximate.
pub fn quantile(values: &Values, place: usize) -> String {
    let about = if values.quantiles_within.is_empty() { "" } else { ABOUT };
    format!("{about}{}", figure(values.quantiles[place]))
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Timestamp;

    use super::*;

    fn curve(values: &[Option<f64>]) -> Curve {
        let point = |(i, value): (usize, &Option<f64>)| Point {
            from: Timestamp::from_nanos(i as u64 * 500_000_000),
            until: Timestamp::from_nanos((i as u64 + 1) * 500_000_000),
            gap: value.is_none(),
            values: value.map(|v| Values {
                count: 1,
                rolled_up: 0,
                min: v,
                max: v,
                mean: v,
                last: v,
                quantiles: vec![],
                quantiles_within: vec![],
            }),
        };
        let points = values.iter().enumerate().map(point).collect();
        Curve { figure: "service_time".parse().unwrap(), unit: "ms".to_owned(), quantiles: vec![], points }
    }

    #[test]
    fn a_curve_spans_its_range_and_gaps_are_marked() {
        let rising: Vec<_> = (0..32).map(|i| (i != 20).then_some(f64::from(i) + 10.0)).collect();
        let text = draw(&curve(&rising));
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines.len(), HEIGHT + 2);
        assert!(lines[0].starts_with("      41.00") && lines[0].ends_with('⠊'), "{text}");
        assert!(lines[HEIGHT - 1].starts_with("      10.00 ⡠"), "{text}");
        assert_eq!(lines[HEIGHT].find('!'), Some(SCALE + 1 + 10), "{text}");
        assert!(lines[HEIGHT + 1].trim_start().starts_with("0.0 s") && text.ends_with("16.0 s\n"), "{text}");
    }

    #[test]
    fn a_constant_is_drawn_and_an_empty_curve_is_not() {
        assert!(draw(&curve(&[Some(5.0); 4])).contains("5.000 ⣀⣀"));
        assert_eq!(draw(&curve(&[])), "");
        assert_eq!(draw(&curve(&[None])), "");
    }

    #[test]
    fn figures_have_four_significant_digits() {
        let formatted = [0.0, 1.5, 12.345, 123.4, 54321.0, 2.5e7, 1e-5].map(figure);
        assert_eq!(formatted, ["0.000", "1.500", "12.35", "123.4", "54321", "2.500e7", "1.000e-5"]);
    }
}
