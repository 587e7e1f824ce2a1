//! Maps in the files of ROS's map_server: a YAML file that says how to read a PGM or PNG picture.

use std::path::Path;

use serde_json::{Value as Json, json};

use cotorra_graph::{Cell, OccupancyGrid, Position};

use crate::{
    file,
    png::{self, Pixel, PngError},
    yaml::{
        self, Diagnostics, Sink, Span,
        decode::{Amount, Decode, Node, Spanned, choice, expected, record},
    },
};

record! {
    /// Description of a map: its picture, and how to read it.
    MapRecord {
        /// Path of the picture, from this file's folder: PGM, or PNG.
        image: Spanned<String>,
        /// Side of a cell, metres.
        resolution: Spanned<Amount>,
        /// Lower left corner of the map: x, y in metres, and yaw in radians, which turns no cell by half of its side.
        origin: Spanned<Vec<f64>>,
        /// Whether white is occupied, and black free.
        negate: Flag = 0,
        /// Darker than this share is occupied.
        occupied_thresh: Spanned<Amount> = 0.65,
        /// Brighter than the rest of this share is free.
        free_thresh: Spanned<Amount> = 0.196,
        /// Reading of values between the thresholds: as unknown.
        mode: Mode = "trinary",
        /// What others take the map for; nothing here.
        map_type: Option<String>,
    }
}

/// `mode`; the others of map_server give probabilities, for which nothing here has a use.
#[derive(Debug)]
pub(crate) enum Mode {
    Trinary,
}

choice!(Mode, "supported mode", { "trinary" => Self::Trinary, "free, occupied or unknown"; });

/// A truth value, as map_server writes it.
#[derive(Debug)]
pub(crate) struct Flag(bool);

impl Decode for Flag {
    fn schema() -> Json {
        json!({ "enum": [0, 1, false, true, "False", "FALSE", "no", "off", "True", "TRUE", "yes", "on"] })
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        match node.plain() {
            Some("0" | "false" | "False" | "FALSE" | "no" | "off") => Some(Self(false)),
            Some("1" | "true" | "True" | "TRUE" | "yes" | "on") => Some(Self(true)),
            _ => {
                expected(node, "0 or 1", "write `0` where black is occupied, as map_server does", sink);
                None
            }
        }
    }
}

/// Reads a map: the YAML file, and the picture that it names.
///
/// # Errors
/// Everything that is wrong with the YAML file, each in its place; a picture's mistake shows at its name.
pub fn load(path: impl AsRef<Path>) -> Result<OccupancyGrid, Diagnostics> {
    load_with_warnings(path).map(|(grid, _)| grid)
}

/// As [`load`], and returns warnings, too.
///
/// # Errors
/// As [`load`].
pub fn load_with_warnings(
    path: impl AsRef<Path>,
) -> Result<(OccupancyGrid, Option<Diagnostics>), Diagnostics> {
    let path = path.as_ref();
    let name = path.display().to_string();
    let text = file::read_text(path).map_err(|error| {
        Diagnostics::of_file(&name, format!("the map cannot be read: {error}"), "check its path")
    })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    read(&name, &text, |image| file::read(&folder.join(image), MAX_PICTURE).map_err(|e| e.to_string()))
}

/// Returns the name of the picture in a map's YAML text, and its place.
pub(crate) fn image_of(text: &str) -> Option<(String, Span)> {
    let mut sink = Sink::default();
    let root = yaml::parse(text, &mut sink)?;
    let image = root.get("image")?;
    Some((image.text()?.to_owned(), image.span.clone()))
}

/// Reads a map from its YAML text and whatever reads the picture that it names.
///
/// # Errors
/// As [`load`].
pub fn parse(
    source_name: &str,
    text: &str,
    read_image: impl FnOnce(&str) -> Result<Vec<u8>, String>,
) -> Result<OccupancyGrid, Diagnostics> {
    read(source_name, text, read_image).map(|(grid, _)| grid)
}

fn read(
    source_name: &str,
    text: &str,
    read_image: impl FnOnce(&str) -> Result<Vec<u8>, String>,
) -> Result<(OccupancyGrid, Option<Diagnostics>), Diagnostics> {
    let mut sink = Sink::default();
    let grid = yaml::parse(text, &mut sink)
        .and_then(|root| MapRecord::decode(&root, &mut sink))
        .and_then(|record| build(record, read_image, &mut sink));
    match grid {
        Some(grid) if sink.is_empty() => Ok((grid, sink.finish_warnings(source_name, text))),
        _ => Err(sink.finish(source_name, text)),
    }
}

fn build(
    record: MapRecord,
    read_image: impl FnOnce(&str) -> Result<Vec<u8>, String>,
    sink: &mut Sink,
) -> Option<OccupancyGrid> {
    let resolution = record.resolution.value.0;
    if !(0.001..=100.0).contains(&resolution) {
        sink.error(&record.resolution.span, format!("a cell of {resolution} m is not possible"))
            .help("the side of a cell is 0.001 to 100 metres, usually 0.05");
    }
    let (occupied, free) = (record.occupied_thresh.value.0, record.free_thresh.value.0);
    if occupied > 1.0 {
        sink.error(&record.occupied_thresh.span, "a threshold above 1").help("write a share, usually 0.65");
    }
    if free > occupied {
        sink.error(&record.free_thresh.span, "the free threshold is above the occupied one")
            .help("write a smaller share, usually 0.196");
    }
    // map_server does not read the type, either.
    let (Mode::Trinary, _) = (record.mode, &record.map_type);
    let unexplored_floor = std::cell::Cell::new(0_usize);
    let cell = |brightness: f64| {
        let occupancy = if record.negate.0 { brightness } else { 1.0 - brightness };
        if occupancy > occupied {
            Cell::Occupied
        } else if occupancy < free {
            if brightness == UNEXPLORED {
                unexplored_floor.update(|cells| cells + 1);
            }
            Cell::Free
        } else {
            Cell::Unknown
        }
    };
    let picture = read_image(&record.image.value)
        .map_err(|error| format!("`{}` cannot be read: {error}", record.image.value))
        .and_then(|bytes| {
            Picture::parse(&bytes, cell).map_err(|error| format!("`{}`: {error}", record.image.value))
        });
    let side = picture.as_ref().map_or(1, |its| its.width.max(its.cells.len() / its.width)) as f64;
    let is_near = |x: f64, y: f64| x.abs() <= 1e6 && y.abs() <= 1e6;
    let origin = match record.origin.value[..] {
        // Files of SLAM have yaws such as 1e-17.
        [x, y, yaw] if is_near(x, y) && yaw.abs() * side < 0.5 => Some(Position::new(x, y)),
        [x, y, yaw] if is_near(x, y) => {
            sink.error(&record.origin.span, format!("the map is turned by {yaw} rad"))
                .help("turn the picture instead, and write a yaw of 0");
            None
        }
        _ => {
            sink.error(&record.origin.span, "this is not an origin")
                .help("write `[x, y, 0]`: the lower left corner in metres, within 1000 km of 0, and no yaw");
            None
        }
    };
    let picture = match picture {
        Ok(picture) => picture,
        Err(message) => {
            sink.error(&record.image.span, message)
                .help("name a PGM file (P2 or P5) or a PNG file, from this file's folder");
            return None;
        }
    };
    if !sink.is_empty() {
        return None;
    }
    if let cells @ 1.. = unexplored_floor.get() {
        sink.warning(&record.free_thresh.span, format!("{cells} cells of grey 205 count as floor"))
            .help("map_saver writes 205 where nothing was explored; with `free_thresh: 0.196` such cells are unknown");
    }
    // A picture begins with its uppermost row, a grid with its lowest.
    let cells = picture.cells.chunks(picture.width).rev().flatten().copied().collect();
    OccupancyGrid::new(picture.width, picture.height, resolution, origin?, cells)
}

/// Share of white that map_saver writes for cells that were not explored.
const UNEXPLORED: f64 = 205.0 / 255.0;

/// The cells of a greyscale picture, row by row from the top.
struct Picture {
    width: usize,
    height: usize,
    cells: Vec<Cell>,
}

/// Error of a PGM picture.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
enum InvalidPicture {
    #[error("it is neither a PGM nor a PNG picture")]
    Magic,
    #[error(transparent)]
    Png(#[from] PngError),
    #[error("its {0} is missing or no whole number")]
    Header(&'static str),
    #[error("it has {0} × {1} pixels, but a map has 1 to {MAX_CELLS} cells")]
    Size(usize, usize),
    #[error("its maximum value is {0}, but PGM has 1 to 65535")]
    Max(usize),
    #[error("it ends after {found} of {wanted} pixels")]
    Short { found: usize, wanted: usize },
    #[error("pixel {place} is `{value}`, but the maximum is {max}")]
    Value { place: usize, value: usize, max: u16 },
}

/// 290 m in square, at 0.05 m a cell.
const MAX_CELLS: usize = 32 << 20;
/// Bytes of a picture: as text, a cell of 8 bits takes four at most.
const MAX_PICTURE: usize = 4 * MAX_CELLS + 1024;

impl Picture {
    /// Reads a PNG picture, or a PGM picture: P2 (text) or P5 (binary, of 8 or 16 bits). `cell` reads a pixel by its share of
    /// white. Nothing else is kept of a pixel.
    fn parse(bytes: &[u8], cell: impl Fn(f64) -> Cell) -> Result<Self, InvalidPicture> {
        if bytes.starts_with(png::SIGNATURE) {
            return Self::parse(&png::to_pgm(bytes, Pixel::mean)?, cell);
        }
        let binary = match bytes.get(..2) {
            Some(b"P5") => true,
            Some(b"P2") => false,
            _ => return Err(InvalidPicture::Magic),
        };
        let mut rest = &bytes[2..];
        let mut header = |name| number(&mut rest).ok_or(InvalidPicture::Header(name));
        let (width, height, max) = (header("width")?, header("height")?, header("maximum value")?);
        let wanted = width.checked_mul(height).filter(|n| (1..=MAX_CELLS).contains(n));
        let wanted = wanted.ok_or(InvalidPicture::Size(width, height))?;
        let max = u16::try_from(max).ok().filter(|&m| m > 0).ok_or(InvalidPicture::Max(max))?;
        let value = |(place, value)| match u16::try_from(value) {
            Ok(value) if value <= max => Ok(cell(f64::from(value) / f64::from(max))),
            _ => Err(InvalidPicture::Value { place, value, max }),
        };
        let cells: Vec<Cell> = if !binary {
            let values = std::iter::from_fn(|| number(&mut rest)).take(wanted);
            values.enumerate().map(value).collect::<Result<_, _>>()?
        } else {
            // One whitespace character ends the header.
            let raster = rest.get(1..).unwrap_or_default();
            let two_bytes = |pair: &[u8]| usize::from(u16::from_be_bytes([pair[0], pair[1]]));
            if max < 256 {
                let values = raster.iter().take(wanted).map(|&byte| byte.into());
                values.enumerate().map(value).collect::<Result<_, _>>()?
            } else {
                let values = raster.chunks_exact(2).take(wanted).map(two_bytes);
                values.enumerate().map(value).collect::<Result<_, _>>()?
            }
        };
        if cells.len() < wanted {
            return Err(InvalidPicture::Short { found: cells.len(), wanted });
        }
        Ok(Self { width, height, cells })
    }
}

/// Takes a whole number off the front, behind whitespace and comments.
fn number(rest: &mut &[u8]) -> Option<usize> {
    loop {
        *rest = rest.trim_ascii_start();
        if rest.first() != Some(&b'#') {
            break;
        }
        let end = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        *rest = &rest[end..];
    }
    let digits = rest.iter().take_while(|b| b.is_ascii_digit()).count();
    let (number, behind) = rest.split_at(digits);
    *rest = behind;
    std::str::from_utf8(number).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const YAML: &str = "image: x.pgm\nresolution: 0.5\norigin: [-1, 2, 0]\n";

    fn read(yaml: &str, image: &[u8]) -> Result<OccupancyGrid, Diagnostics> {
        parse("map.yaml", yaml, |name| {
            assert_eq!(name, "x.pgm");
            Ok(image.to_vec())
        })
    }

    fn cells(grid: &OccupancyGrid) -> Vec<Cell> {
        (0..grid.height())
            .flat_map(|row| (0..grid.width()).map(move |column| grid.cell(column, row)))
            .collect()
    }

    #[test]
    fn thresholds_as_map_server_reads_them() {
        // map_saver writes 254 for free, 0 for occupied, 205 for unknown; the uppermost row comes first.
        let image = b"P2 # comment\n3 2 # size\n255\n254 0 205\n0 254 205\n";
        let grid = read(YAML, image).unwrap();
        use Cell::{Free, Occupied, Unknown};
        assert_eq!(cells(&grid), [Occupied, Free, Unknown, Free, Occupied, Unknown]);
        assert_eq!(grid.origin(), Position::new(-1.0, 2.0));
        assert_eq!(grid.at(Position::new(-0.9, 2.9)), Free);

        // Occupancy 0.995, 0 and 0.80: white is occupied.
        let negated = read(&format!("{YAML}negate: 1\n"), image).unwrap();
        assert_eq!(cells(&negated)[..3], [Free, Occupied, Occupied]);
        let strict = read(&format!("{YAML}occupied_thresh: 0.9\nfree_thresh: 0.21\n"), image).unwrap();
        assert_eq!(cells(&strict)[2], Free);
    }

    #[test]
    fn files_of_slam_are_read_as_map_server_reads_them() {
        let image = b"P2 3 2 255\n254 0 205\n0 254 205\n";
        let plain = read(YAML, image).unwrap();
        for more in ["negate: False\n", "negate: no\nmap_type: occupancy\n"] {
            assert_eq!(read(&format!("{YAML}{more}"), image).unwrap(), plain, "{more}");
        }
        assert_ne!(read(&format!("{YAML}negate: True\n"), image).unwrap(), plain);
        // A yaw that turns no cell by half of its side.
        let turned = |yaw: &str| read(&YAML.replace("2, 0]", &format!("2, {yaw}]")), image);
        assert_eq!(turned("1.2e-17").unwrap(), plain);
        assert_eq!(turned("0.16").unwrap(), plain);
        assert_eq!(turned("0.17").unwrap_err().list[0].message, "the map is turned by 0.17 rad");
    }

    #[test]
    fn a_threshold_that_takes_unexplored_cells_for_floor_is_a_warning() {
        let image = b"P2 3 2 255\n254 0 205\n0 254 205\n";
        let warnings = |more: &str| {
            let text = format!("{YAML}{more}");
            let (_, warnings) = super::read("map.yaml", &text, |_| Ok(image.to_vec())).unwrap();
            warnings.map(|found| (found.list.len(), found.list[0].message.clone(), found.list[0].line))
        };
        assert_eq!(warnings(""), None);
        let message = "2 cells of grey 205 count as floor".to_owned();
        assert_eq!(warnings("free_thresh: 0.25\n"), Some((1, message, 4)));
    }

    #[test]
    fn a_png_picture_gives_the_map_of_a_pgm_picture() {
        let png = png::picture((3, 2), 8, 0, &[], &[0, 254, 0, 205, 0, 0, 254, 205]);
        let pgm = b"P2 3 2 255\n254 0 205\n0 254 205\n";
        assert_eq!(read(YAML, &png).unwrap(), read(YAML, pgm).unwrap());
        let cut = read(YAML, &png[..40]).unwrap_err().list[0].message.clone();
        assert!(cut.starts_with("`x.pgm`: the PNG picture is cut off or damaged"), "{cut}");
    }

    #[test]
    fn invalid_pictures_are_rejected() {
        let wrong = |image: &[u8]| read(YAML, image).unwrap_err().list[0].message.clone();
        assert_eq!(wrong(b"GIF89a"), "`x.pgm`: it is neither a PGM nor a PNG picture");
        assert_eq!(wrong(b"P5 2"), "`x.pgm`: its height is missing or no whole number");
        assert_eq!(wrong(b"P5 2 2 0\n"), "`x.pgm`: its maximum value is 0, but PGM has 1 to 65535");
        assert_eq!(wrong(b"P5 2 2 255\nabc"), "`x.pgm`: it ends after 3 of 4 pixels");
        assert_eq!(wrong(b"P2 2 2 9\n1 2 3 10"), "`x.pgm`: pixel 3 is `10`, but the maximum is 9");
        assert_eq!(
            wrong(b"P5 99999 99999 255\n"),
            "`x.pgm`: it has 99999 × 99999 pixels, but a map has 1 to 33554432 cells"
        );
    }

    proptest! {
        /// Every kind of PGM gives the same map.
        #[test]
        fn formats_agree(width in 1_usize..9, values in prop::collection::vec(0_u8..=255, 1..60)) {
            let height = values.len() / width;
            prop_assume!(height > 0);
            let values = &values[..width * height];
            let text: String = values.iter().map(|v| format!("{v}\n")).collect();
            let p2 = format!("P2\n{width} {height}\n255\n{text}").into_bytes();
            let mut p5 = format!("P5\n{width} {height}\n255\n").into_bytes();
            p5.extend(values);
            // 65535 = 257 · 255: the same shares in 16 bits.
            let mut wide = format!("P5\n{width} {height}\n65535\n").into_bytes();
            wide.extend(values.iter().flat_map(|&v| (u16::from(v) * 257).to_be_bytes()));
            let grid = read(YAML, &p2).unwrap();
            prop_assert_eq!((grid.width(), grid.height()), (width, height));
            prop_assert_eq!(&grid, &read(YAML, &p5).unwrap());
            prop_assert_eq!(&grid, &read(YAML, &wide).unwrap());
        }

        #[test]
        fn no_picture_panics(image in prop::collection::vec(any::<u8>(), 0..60), header in "P[25] [0-9]{1,2} [0-9]{1,2} [0-9]{1,5}\n") {
            _ = read(YAML, &image);
            _ = read(YAML, &[header.as_bytes(), &image].concat());
        }
    }
}
