//! The font of all figures: widths of letters for their layout, and outlines for pictures.
//!
//! It is Arimo, whose widths are those of Arial, Helvetica and Liberation Sans. The file holds simple glyphs only.

use std::ops::Range;

use crate::geometry::Point;

/// The font as TrueType.
pub const FILE: &[u8] = include_bytes!("arimo.ttf");

/// Heights of letters above and below the baseline, as shares of their size.
pub const ASCENT: f64 = 0.74;
pub const DESCENT: f64 = 0.22;
/// Units of the font's size.
pub const UNITS: f64 = 2048.0;
/// Straight parts of each curve.
const STEPS: u32 = 6;

/// Returns the width of a text of this size.
pub fn width(text: &str, size: f64) -> f64 {
    text.chars().map(|letter| f64::from(advance(glyph(letter)))).sum::<f64>() / UNITS * size
}

/// Cuts a text to this width, with an ellipsis.
pub fn fit(text: &str, size: f64, room: f64) -> String {
    if width(text, size) <= room {
        return text.to_owned();
    }
    let mut cut = text.to_owned();
    while cut.pop().is_some() {
        let shorter = cut.trim_end().to_owned() + "…";
        if width(&shorter, size) <= room {
            return shorter;
        }
    }
    String::new()
}

/// Returns the glyph of a letter; 0 if the font lacks it.
pub fn glyph(letter: char) -> u16 {
    let Ok(code) = u16::try_from(u32::from(letter)) else { return 0 };
    let cmap = table(b"cmap");
    // The only subtable's format is 4: segments of codes.
    let at = u32_at(cmap, 8) as usize;
    let map = &cmap[at..];
    let segments = usize::from(u16_at(map, 6)) / 2;
    let [ends, starts, deltas, offsets] = [14, 16 + 2 * segments, 16 + 4 * segments, 16 + 6 * segments];
    for segment in 0..segments {
        let of = |array: usize| u16_at(map, array + 2 * segment);
        if of(ends) < code {
            continue;
        }
        let Some(beyond) = code.checked_sub(of(starts)) else { return 0 };
        return match of(offsets) {
            0 => code.wrapping_add(of(deltas)),
            offset => u16_at(map, offsets + 2 * segment + usize::from(offset) + 2 * usize::from(beyond)),
        };
    }
    0
}

/// Returns the width of a glyph in units.
pub fn advance(glyph: u16) -> u16 {
    let last = u16_at(table(b"hhea"), 34) - 1;
    u16_at(table(b"hmtx"), 4 * usize::from(glyph.min(last)))
}

/// Returns the outlines of a glyph as polygons, in units, with y upwards.
pub fn outlines(glyph: u16) -> Vec<Vec<Point>> {
    let loca = table(b"loca");
    let place = |index: usize| 2 * usize::from(u16_at(loca, 2 * index));
    let bytes = &table(b"glyf")[place(glyph.into())..place(usize::from(glyph) + 1)];
    if bytes.is_empty() {
        return Vec::new();
    }
    let contours = usize::from(u16_at(bytes, 0));
    let ends: Vec<usize> = (0..contours).map(|i| usize::from(u16_at(bytes, 10 + 2 * i))).collect();
    let count = ends.last().map_or(0, |last| last + 1);
    let hints = 10 + 2 * contours;
    let mut rest = bytes[hints + 2 + usize::from(u16_at(bytes, hints))..].iter().copied();
    let mut next = || rest.next().unwrap_or_default();
    let mut flags = Vec::with_capacity(count);
    while flags.len() < count {
        let flag = next();
        let repeated = if flag & 8 > 0 { next() } else { 0 };
        flags.extend((0..=repeated).map(|_| flag));
    }
    let mut axis = |short: u8, same: u8| {
        let mut at = 0_i32;
        let mut coordinates = Vec::with_capacity(count);
        for flag in &flags {
            at += match (flag & short > 0, flag & same > 0) {
                (true, positive) => i32::from(next()) * if positive { 1 } else { -1 },
                (false, true) => 0,
                (false, false) => i32::from(i16::from_be_bytes([next(), next()])),
            };
            coordinates.push(f64::from(at));
        }
        coordinates
    };
    let (xs, ys) = (axis(2, 16), axis(4, 32));
    let starts = std::iter::once(0).chain(ends.iter().map(|end| end + 1));
    let contour = |range: Range<usize>| {
        let points: Vec<_> = range.map(|i| ((xs[i], ys[i]), flags[i] & 1 > 0)).collect();
        flatten(&points)
    };
    starts.zip(&ends).map(|(start, end)| contour(start..end + 1)).collect()
}

/// Replaces the quadratic curves of a contour by straight lines. Each point says whether it is on the contour; between two
/// points that are not lies one that is.
fn flatten(points: &[(Point, bool)]) -> Vec<Point> {
    let middle = |a: Point, b: Point| ((a.0 + b.0) / 2.0, (a.1 + b.1) / 2.0);
    let mut on_contour = Vec::with_capacity(2 * points.len());
    for (i, (point, is_on)) in points.iter().enumerate() {
        on_contour.push((*point, *is_on));
        let (next, next_is_on) = points[(i + 1) % points.len()];
        if !is_on && !next_is_on {
            on_contour.push((middle(*point, next), true));
        }
    }
    let Some(first) = on_contour.iter().position(|(_, is_on)| *is_on) else { return Vec::new() };
    on_contour.rotate_left(first);
    let mut line = Vec::new();
    let mut from = on_contour[0].0;
    for (i, (point, is_on)) in on_contour.iter().enumerate() {
        if *is_on {
            line.push(*point);
            from = *point;
            continue;
        }
        let to = on_contour[(i + 1) % on_contour.len()].0;
        for step in 1..STEPS {
            let t = f64::from(step) / f64::from(STEPS);
            let of = |a: f64, b: f64, c: f64| (1.0 - t).powi(2) * a + 2.0 * t * (1.0 - t) * b + t * t * c;
            line.push((of(from.0, point.0, to.0), of(from.1, point.1, to.1)));
        }
    }
    line
}

fn table(name: &[u8; 4]) -> &'static [u8] {
    let count = usize::from(u16_at(FILE, 4));
    let entry = (0..count).map(|i| 12 + 16 * i).find(|entry| FILE[*entry..*entry + 4] == *name);
    let entry = entry.expect("the font has all tables");
    let (at, length) = (u32_at(FILE, entry + 8) as usize, u32_at(FILE, entry + 12) as usize);
    &FILE[at..at + length]
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from(u16_at(bytes, at)) << 16 | u32::from(u16_at(bytes, at + 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_are_those_of_helvetica() {
        // From the font metrics that Adobe published, in thousandths.
        for (letter, thousandths) in [(' ', 278.0), ('a', 556.0), ('W', 944.0), ('i', 222.0), ('5', 556.0)] {
            let width = width(&letter.to_string(), 1000.0);
            assert!((width - thousandths).abs() < 1.0, "{letter}: {width}");
        }
        assert!((width("µ×ψ", 1.0) - width("µ", 1.0) - width("×ψ", 1.0)).abs() < 1e-9);
    }

    #[test]
    fn letters_have_glyphs_and_others_the_box() {
        let letters = (' '..='~').chain("µ×±°äé–…−λψδικ".chars());
        assert!(letters.clone().all(|letter| glyph(letter) > 0));
        let empty: Vec<_> = letters.filter(|letter| outlines(glyph(*letter)).is_empty()).collect();
        assert_eq!(empty, [' ']);
        for missing in ['\u{0}', '語', '\u{1f600}'] {
            assert_eq!(glyph(missing), 0);
        }
    }

    #[test]
    fn outlines_stay_within_the_height_of_letters() {
        for letter in "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789%=-µλ±×".chars() {
            let glyph = glyph(letter);
            for (x, y) in outlines(glyph).into_iter().flatten() {
                let room = f64::from(advance(glyph)) + 0.1 * UNITS;
                assert!(x > -0.1 * UNITS && x < room, "{letter}: {x}");
                assert!((-DESCENT * UNITS..=ASCENT * UNITS).contains(&y), "{letter}: {y}");
            }
        }
        // A ring has an outer and an inner outline.
        assert_eq!(outlines(glyph('o')).len(), 2);
        assert_eq!(outlines(glyph('i')).len(), 2);
    }

    #[test]
    fn long_texts_are_cut_to_their_room() {
        assert_eq!(fit("robot", 7.0, 100.0), "robot");
        let cut = fit("a very long name of a testbed", 7.0, 40.0);
        assert!(cut.ends_with('…') && width(&cut, 7.0) <= 40.0 && cut.len() > 8, "{cut}");
        assert_eq!(fit("robot", 7.0, 1.0), "");
    }
}
