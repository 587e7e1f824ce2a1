//! Scenes as PNG pictures, with smooth edges.

use png::{BitDepth, ColorType, DeflateCompression, Encoder, Filter, PixelDimensions, Unit};

use crate::{
    colour::Colour,
    font,
    geometry::Point,
    scene::{Cells, Item, Line, Scene, Text, WIDTH},
};

/// Pixels of a point: 432 pixels to the inch.
const SCALE: f64 = 6.0;
const INCH_POINTS: f64 = 72.0;
const METRE_INCHES: f64 = 1.0 / 0.0254;
/// Level of compression.
const LEVEL: u8 = 6;

/// A picture, row by row from the top.
struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

pub fn render(scene: &Scene) -> Vec<u8> {
    Picture::of(scene).encode()
}

/// Returns cells as a picture with one pixel each.
pub fn encode(cells: &Cells) -> Vec<u8> {
    let pixels = cells.colours.iter().map(|Colour(rgb)| *rgb).collect();
    Picture { width: cells.columns, height: cells.rows(), pixels }.encode()
}

impl Picture {
    fn of(scene: &Scene) -> Self {
        let [width, height] = [WIDTH, scene.height].map(|length| (length * SCALE).ceil() as usize);
        let mut picture = Self { width, height, pixels: vec![[255; 3]; width * height] };
        for item in &scene.items {
            match item {
                Item::Area(points, colour) => picture.fill(&[scaled(points)], *colour),
                Item::Cells(cells) => picture.copy(cells),
                Item::Line(line) => {
                    let points = scaled(&line.points);
                    let mut parts = Vec::new();
                    for dash in dashes(&points, line) {
                        thicken(&dash, line.width * SCALE / 2.0, &mut parts);
                    }
                    picture.fill(&parts, line.colour);
                }
                Item::Text(text) => picture.fill(&letters(text), text.colour),
            }
        }
        picture
    }

    /// Fills polygons. Where they turn the same way they add up, and where they turn opposite ways they leave a hole.
    fn fill(&mut self, polygons: &[Vec<Point>], colour: Colour) {
        let points = || polygons.iter().flatten();
        let edge = |of: fn(&Point) -> f64, size: usize| {
            let low = points().map(of).fold(f64::INFINITY, f64::min).floor().clamp(0.0, size as f64);
            let high = points().map(of).fold(f64::NEG_INFINITY, f64::max).ceil().clamp(0.0, size as f64);
            (low, (high - low).max(0.0))
        };
        let ((left, wide), (top, high)) =
            (edge(|point| point.0, self.width), edge(|point| point.1, self.height));
        if wide == 0.0 || high == 0.0 {
            return;
        }
        let inside = |(x, y): Point| ((x - left).clamp(0.0, wide), (y - top).clamp(0.0, high));
        let mut mask = Mask::new(wide as usize, high as usize);
        for polygon in polygons {
            for (i, from) in polygon.iter().enumerate() {
                mask.edge(inside(*from), inside(polygon[(i + 1) % polygon.len()]));
            }
        }
        for (y, row) in mask.sums.chunks(mask.stride).enumerate() {
            let begin = (top as usize + y) * self.width + left as usize;
            let pixels = &mut self.pixels[begin..begin + wide as usize];
            let mut sum = 0.0;
            for (pixel, change) in pixels.iter_mut().zip(row) {
                sum += change;
                let covered = sum.abs().min(1.0);
                if covered > 1e-6 {
                    for (part, new) in pixel.iter_mut().zip(colour.0) {
                        *part = (f64::from(*part) * (1.0 - covered) + f64::from(new) * covered).round() as u8;
                    }
                }
            }
        }
    }

    /// Copies cells: each pixel has the colour of the cell at its middle.
    fn copy(&mut self, cells: &Cells) {
        let area = &cells.area;
        let rows = along((area.top, area.bottom), cells.rows(), self.height);
        let columns = along((area.left, area.right), cells.columns, self.width);
        for (y, row) in rows {
            for (x, column) in &columns {
                self.pixels[y * self.width + x] = cells.colours[row * cells.columns + column].0;
            }
        }
    }

    fn encode(&self) -> Vec<u8> {
        let [width, height] = [self.width, self.height].map(|size| size as u32);
        let density = (SCALE * INCH_POINTS * METRE_INCHES).round() as u32;
        let mut file = Vec::new();
        let mut encoder = Encoder::new(&mut file, width, height);
        encoder.set_color(ColorType::Rgb);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_pixel_dims(Some(PixelDimensions { xppu: density, yppu: density, unit: Unit::Meter }));
        encoder.set_deflate_compression(DeflateCompression::Level(LEVEL));
        encoder.set_filter(Filter::NoFilter);
        let mut writer = encoder.write_header().expect("a picture has pixels, and memory can be written");
        writer.write_image_data(self.pixels.as_flattened()).expect("the picture has all its pixels");
        writer.finish().expect("memory can be written");
        file
    }
}

/// Returns the pixels between two places, of `size`, each with the cell at its middle, of `count`.
fn along((from, to): (f64, f64), count: usize, size: usize) -> Vec<(usize, usize)> {
    let (from, to) = (from * SCALE, to * SCALE);
    let pixels = (from.round().max(0.0) as usize)..(to.round().max(0.0) as usize).min(size);
    let cell = |pixel: usize| ((pixel as f64 + 0.5 - from) / (to - from) * count as f64) as usize;
    pixels.map(|pixel| (pixel, cell(pixel).min(count.saturating_sub(1)))).collect()
}

/// Part of each pixel that polygons cover: in each row, the sum from the left.
struct Mask {
    /// One more than the width, because an edge on the right also changes what follows it.
    stride: usize,
    height: usize,
    sums: Vec<f64>,
}

impl Mask {
    fn new(width: usize, height: usize) -> Self {
        let stride = width + 2;
        Self { stride, height, sums: vec![0.0; stride * height] }
    }

    /// Adds the area to the right of an edge: negative for edges that go up.
    fn edge(&mut self, from: Point, to: Point) {
        let (sign, (mut x, begin), (last_x, end)) =
            if from.1 <= to.1 { (1.0, from, to) } else { (-1.0, to, from) };
        if begin == end {
            return;
        }
        let slope = (last_x - x) / (end - begin);
        for row in begin as usize..(end.ceil() as usize).min(self.height) {
            let part = (row as f64 + 1.0).min(end) - (row as f64).max(begin);
            let next = x + slope * part;
            self.row(row, sign * part, (x.min(next), x.max(next)));
            x = next;
        }
    }

    /// Adds an edge within a row: its signed height, and its ends. Each of its pixels takes an equal share of the height for
    /// equal widths; a pixel gets what lies to the right of its part, and the next one the rest.
    fn row(&mut self, row: usize, height: f64, (from, to): (f64, f64)) {
        let sums = &mut self.sums[row * self.stride..(row + 1) * self.stride];
        let (first, last) = (from as usize, to as usize);
        for pixel in first..=last {
            let (left, right) = (from.max(pixel as f64), to.min(pixel as f64 + 1.0));
            let share = if to > from { (right - left) / (to - from) } else { 1.0 };
            let beyond = (left + right) / 2.0 - pixel as f64;
            sums[pixel] += height * share * (1.0 - beyond);
            sums[pixel + 1] += height * share * beyond;
        }
    }
}

fn scaled(points: &[Point]) -> Vec<Point> {
    points.iter().map(|(x, y)| (x * SCALE, y * SCALE)).collect()
}

/// Cuts a line into its dashes.
fn dashes(points: &[Point], line: &Line) -> Vec<Vec<Point>> {
    if line.dashes.is_empty() {
        return vec![points.to_vec()];
    }
    let (mut turn, mut left) = (0, line.dashes[0] * SCALE);
    let mut dashes = Vec::new();
    let mut dash: Vec<Point> = points.first().into_iter().copied().collect();
    for pair in points.windows(2) {
        let ((mut x, mut y), (to_x, to_y)) = (pair[0], pair[1]);
        loop {
            let length = (to_x - x).hypot(to_y - y);
            if length < left {
                left -= length;
                break;
            }
            let share = if length > 0.0 { left / length } else { 1.0 };
            (x, y) = (x + (to_x - x) * share, y + (to_y - y) * share);
            dash.push((x, y));
            // Every other part is a gap.
            if turn % 2 == 0 {
                dashes.push(std::mem::take(&mut dash));
            }
            dash = vec![(x, y)];
            turn += 1;
            left = line.dashes[turn % line.dashes.len()] * SCALE;
        }
        dash.push((to_x, to_y));
    }
    if turn % 2 == 0 {
        dashes.push(dash);
    }
    dashes
}

/// Adds polygons that turn the same way and cover a line: one for each segment, and one for each bend.
fn thicken(line: &[Point], half: f64, to: &mut Vec<Vec<Point>>) {
    const CORNERS: u32 = 8;
    for pair in line.windows(2) {
        let ((ax, ay), (bx, by)) = (pair[0], pair[1]);
        let length = (bx - ax).hypot(by - ay);
        if length > 0.0 {
            let (nx, ny) = (-(by - ay) / length * half, (bx - ax) / length * half);
            to.push(vec![(ax + nx, ay + ny), (bx + nx, by + ny), (bx - nx, by - ny), (ax - nx, ay - ny)]);
        }
    }
    for (x, y) in line.iter().skip(1).take(line.len().saturating_sub(2)) {
        let corner = |i: u32| {
            let angle = -std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS);
            (x + half * angle.cos(), y + half * angle.sin())
        };
        to.push((0..CORNERS).map(corner).collect());
    }
}

/// Returns the outlines of a text's letters in pixels.
fn letters(text: &Text) -> Vec<Vec<Point>> {
    let ((x, y), scale) = (text.start(), text.size / font::UNITS);
    let mut along = 0.0;
    let mut polygons = Vec::new();
    for letter in text.text.chars() {
        let glyph = font::glyph(letter);
        for outline in font::outlines(glyph) {
            let place = |(right, up): &Point| {
                let (right, up) = ((right + along) * scale, up * scale);
                let (dx, dy) = if text.is_turned { (-up, -right) } else { (right, -up) };
                ((x + dx) * SCALE, (y + dy) * SCALE)
            };
            polygons.push(outline.iter().map(place).collect());
        }
        along += f64::from(font::advance(glyph));
    }
    polygons
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{
        scene::{Anchor, tests::checkers},
        style::{BLACK, WHITE},
    };

    fn blank() -> Picture {
        Picture { width: 8, height: 4, pixels: vec![[255; 3]; 32] }
    }

    fn row(picture: &Picture, row: usize) -> Vec<u8> {
        picture.pixels[row * picture.width..][..picture.width].iter().map(|pixel| pixel[0]).collect()
    }

    /// Sums how dark the pixels are, in pixels.
    fn darkness(picture: &Picture) -> f64 {
        picture.pixels.iter().map(|pixel| 1.0 - f64::from(pixel[0]) / 255.0).sum()
    }

    #[test]
    fn areas_cover_parts_of_pixels() {
        let mut picture = blank();
        picture.fill(&[vec![(1.5, 1.0), (4.0, 1.0), (4.0, 2.5), (1.5, 2.5)]], BLACK);
        assert_eq!(row(&picture, 0), [255; 8]);
        assert_eq!(row(&picture, 1), [255, 128, 0, 0, 255, 255, 255, 255]);
        assert_eq!(row(&picture, 2), [255, 191, 128, 128, 255, 255, 255, 255]);
        let mut halves = blank();
        halves.fill(&[vec![(0.0, 0.0), (8.0, 0.0), (0.0, 4.0)]], BLACK);
        assert!((darkness(&halves) - 16.0).abs() < 0.1, "{}", darkness(&halves));
    }

    #[test]
    fn inner_outlines_leave_holes_and_edges_of_the_page_cut() {
        let square = |from: f64, to: f64| vec![(from, from), (to, from), (to, to), (from, to)];
        let mut ring = blank();
        let inner = square(1.0, 3.0).into_iter().rev().collect();
        ring.fill(&[square(0.0, 4.0), inner], BLACK);
        assert_eq!(row(&ring, 1), [0, 255, 255, 0, 255, 255, 255, 255]);
        let mut cut = blank();
        cut.fill(&[square(-5.0, 50.0)], BLACK);
        assert_eq!(darkness(&cut), 32.0);
    }

    #[test]
    fn cells_fill_their_area() {
        let mut scene = Scene { height: 14.0, ..Scene::new() };
        scene.area(vec![(0.0, 0.0), (WIDTH, 0.0), (WIDTH, 14.0), (0.0, 14.0)], WHITE);
        scene.cells(checkers());
        // The black cell is 10 by 10 points.
        let picture = Picture::of(&scene);
        assert_eq!(darkness(&picture) / SCALE / SCALE, 100.0);
        let colour_at =
            |x: f64, y: f64| picture.pixels[(y * SCALE) as usize * picture.width + (x * SCALE) as usize][0];
        assert_eq!(
            [(9.9, 5.0), (10.1, 2.1), (19.9, 11.9), (20.1, 5.0)].map(|(x, y)| colour_at(x, y)),
            [255, 0, 0, 255]
        );
    }

    #[test]
    fn dashes_have_their_lengths() {
        let line = Line { points: vec![], colour: BLACK, width: 1.0, dashes: &[2.0, 1.0] };
        // 20 points with a bend after 10; each 3 points have 2 of line.
        let points = scaled(&[(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]);
        let dashes = dashes(&points, &line);
        let length = |dash: &Vec<Point>| -> f64 {
            dash.windows(2).map(|p| (p[1].0 - p[0].0).hypot(p[1].1 - p[0].1)).sum::<f64>() / SCALE
        };
        assert_eq!(dashes.len(), 7);
        assert!(dashes.iter().all(|dash| (length(dash) - 2.0).abs() < 1e-9), "{dashes:?}");
        assert_eq!(dashes[3], scaled(&[(9.0, 0.0), (10.0, 0.0), (10.0, 1.0)]));
        let solid = Line { dashes: &[], ..line };
        assert_eq!(super::dashes(&points, &solid), [points]);
    }

    #[test]
    fn lines_are_as_wide_as_they_should_be() {
        let mut scene = Scene { height: 100.0, ..Scene::new() };
        scene.line(vec![(10.0, 10.0), (60.0, 10.0), (60.0, 60.0)], BLACK, 1.0, &[]);
        let dark = darkness(&Picture::of(&scene)) / SCALE / SCALE;
        assert!((dark - 100.0).abs() < 1.0, "{dark}");
    }

    #[test]
    fn texts_are_drawn_in_their_bounds() {
        let mut scene = Scene { height: 60.0, ..Scene::new() };
        scene.text((40.0, 20.0), "Robot 1: p95", 7.0, Anchor::Middle, BLACK);
        scene.turned((100.0, 40.0), "delay", 7.0, Anchor::Start, BLACK);
        let picture = Picture::of(&scene);
        let bounds: Vec<_> = scene
            .items
            .iter()
            .map(|item| if let Item::Text(text) = item { text.bounds() } else { panic!("no text") })
            .collect();
        let mut dark = [0; 2];
        for (i, pixel) in picture.pixels.iter().enumerate().filter(|(_, pixel)| **pixel != [255; 3]) {
            let (x, y) = ((i % picture.width) as f64 / SCALE, (i / picture.width) as f64 / SCALE);
            let within = bounds.iter().position(|b| {
                (b.left - 0.5..b.right + 0.5).contains(&x) && (b.top - 0.5..b.bottom + 0.5).contains(&y)
            });
            dark[within.unwrap_or_else(|| panic!("{pixel:?} at {x} {y} is outside of all texts"))] += 1;
        }
        assert!(dark.iter().all(|count| *count > 300), "{dark:?}");
    }

    #[test]
    fn pictures_have_whole_chunks_and_all_rows() {
        let mut scene = Scene { height: 2.0, ..Scene::new() };
        scene.area(vec![(0.0, 0.0), (WIDTH, 0.0), (WIDTH, 2.0), (0.0, 2.0)], BLACK);
        scene.area(vec![(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], WHITE);
        let file = render(&scene);
        let mut rest = file.strip_prefix(b"\x89PNG\r\n\x1a\n").unwrap();
        let mut names = Vec::new();
        while let Some((length, behind)) = rest.split_first_chunk::<4>() {
            names.push(&behind[..4]);
            rest = &behind[8 + u32::from_be_bytes(*length) as usize..];
        }
        assert_eq!(names, [b"IHDR", b"pHYs", b"IDAT", b"IEND"]);
        // The checksum that the standard gives for an empty last chunk.
        assert!(file.ends_with(&[0xae, 0x42, 0x60, 0x82]));
        // This checks all checksums.
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        reader.finish().unwrap();
        assert_eq!((pixels.len(), pixels[0], pixels[18]), (12 * 3 * 1446, 255, 0));
    }

    proptest! {
        #[test]
        fn no_polygon_panics(points in prop::collection::vec((-20.0..20.0_f64, -20.0..20.0_f64), 0..9)) {
            let mut picture = blank();
            picture.fill(&[points], BLACK);
        }
    }
}
