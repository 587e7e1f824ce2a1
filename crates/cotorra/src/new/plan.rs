//! Maps of new testbeds: from a picture of a floor plan, or drawn.

use std::{
    fs::{self, File},
    io::{self, Read as _},
    path::Path,
};

use cotorra_graph::{Cell, OccupancyGrid, Position, Probability};
use cotorra_testbed_file::{
    map_server,
    png::{self, Pixel, PngError},
};

/// Bytes of the largest file of a picture.
const MAX_FILE: u64 = 128 << 20;
/// Sides of a pixel that a floor plan can have, metres.
const PIXELS: std::ops::RangeInclusive<f64> = 0.001..=0.5;
/// Side of a cell, at most, unless the picture is coarser or very large; metres.
const CELL: f64 = 0.05;
/// Cells of the largest map: 200 m in square, at 0.05 m a cell.
const MAX_CELLS: usize = 16 << 20;
/// Floor outside the walls is no floor if the walls enclose at least this share of all floor.
const ENCLOSED: f64 = 0.1;

/// Error of a floor plan.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    #[error("it cannot be read: {0}")]
    Unreadable(#[from] io::Error),
    #[error("it is not a regular file of at most {MAX_FILE} bytes")]
    NotAFile,
    #[error("it is neither a PNG nor a PGM picture; convert it, as in `magick plan.jpg plan.png`")]
    Format,
    #[error(transparent)]
    Png(#[from] PngError),
    /// A PGM picture's mistake.
    #[error("{0}")]
    Pgm(String),
    #[error("a pixel of {0} m is not possible; a floor plan has pixels of 0.001 to 0.5 m")]
    Scale(f64),
}

/// Size of the floor that a picture shows.
#[derive(Debug, Clone, Copy)]
pub enum Size {
    /// Side of a pixel, metres.
    Pixel(f64),
    /// Width of the whole picture, metres.
    Width(f64),
}

/// Map of a floor plan.
#[derive(Debug, PartialEq)]
pub struct Plan {
    pub grid: OccupancyGrid,
    /// Whether floor leads out of the picture or past the walls.
    pub is_open: bool,
}

/// Reads a floor plan: PNG or PGM, dark where walls are.
///
/// # Errors
/// [`PlanError`] if it is not such a picture, or the size is impossible.
pub fn read(path: &Path, size: Size, threshold: Probability) -> Result<Plan, PlanError> {
    // Asked before it is opened, which waits for a pipe's other end.
    let metadata = fs::metadata(path)?;
    if !metadata.is_file() || metadata.len() > MAX_FILE {
        return Err(PlanError::NotAFile);
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(MAX_FILE).read_to_end(&mut bytes)?;
    parse(bytes, size, threshold)
}

fn parse(bytes: Vec<u8>, size: Size, threshold: Probability) -> Result<Plan, PlanError> {
    let pgm = if bytes.starts_with(png::SIGNATURE) {
        png::to_pgm(&bytes, Pixel::on_white)?
    } else if bytes.starts_with(b"P2") || bytes.starts_with(b"P5") {
        bytes
    } else {
        return Err(PlanError::Format);
    };
    let threshold = threshold.get();
    let how = format!(
        "image: picture\nresolution: 1\norigin: [0, 0, 0]\noccupied_thresh: {threshold}\nfree_thresh: {threshold}\n"
    );
    let pixels = map_server::parse("the floor plan", &how, |_| Ok(pgm)).map_err(|found| {
        let message = found.list.into_iter().next().map(|mistake| mistake.message).unwrap_or_default();
        PlanError::Pgm(message.trim_start_matches("`picture`: ").to_owned())
    })?;
    let pixel = match size {
        Size::Pixel(pixel) => pixel,
        Size::Width(width) => width / pixels.width() as f64,
    };
    if !PIXELS.contains(&pixel) {
        return Err(PlanError::Scale(pixel));
    }
    Ok(without_outside(&coarser(&pixels, pixel)))
}

/// Merges pixels to cells. A cell is occupied if one of its pixels is, so that thin walls stay.
fn coarser(pixels: &OccupancyGrid, pixel: f64) -> OccupancyGrid {
    let every = pixels_per_cell(pixels.width(), pixels.height(), pixel);
    let (width, height) = (pixels.width().div_ceil(every), pixels.height().div_ceil(every));
    let mut cells = vec![Cell::Free; width * height];
    for row in 0..pixels.height() {
        for column in 0..pixels.width() {
            if pixels.cell(column, row) != Cell::Free {
                cells[row / every * width + column / every] = Cell::Occupied;
            }
        }
    }
    grid(width, height, pixel * every as f64, cells)
}

/// Returns the pixels along the side of a cell.
fn pixels_per_cell(width: usize, height: usize, pixel: f64) -> usize {
    let mut every = ((CELL / pixel + 1e-6) as usize).max(1);
    while width.div_ceil(every) * height.div_ceil(every) > MAX_CELLS {
        every += 1;
    }
    every
}

/// Marks floor outside the walls as unknown, if walls enclose enough of the floor.
fn without_outside(plan: &OccupancyGrid) -> Plan {
    let (width, height) = (plan.width(), plan.height());
    let all_cells = width * height;
    let mut cells: Vec<_> = (0..all_cells).map(|cell| plan.cell(cell % width, cell / width)).collect();
    let is_free = |cell: &&Cell| **cell == Cell::Free;
    let all = cells.iter().filter(is_free).count();
    let before = cells.clone();
    let rows = (0..height).flat_map(|row| [row * width, row * width + width - 1]);
    let columns = (0..width).flat_map(|column| [column, (height - 1) * width + column]);
    let mut open = Vec::new();
    let mut leave = |cell: usize, open: &mut Vec<usize>| {
        if cells[cell] == Cell::Free {
            cells[cell] = Cell::Unknown;
            open.push(cell);
        }
    };
    rows.chain(columns).for_each(|cell| leave(cell, &mut open));
    while let Some(cell) = open.pop() {
        let column = cell % width;
        let beside = [(column > 0).then(|| cell - 1), (column + 1 < width).then_some(cell + 1)];
        let in_line = [cell.checked_sub(width), (cell + width < all_cells).then_some(cell + width)];
        beside.into_iter().chain(in_line).flatten().for_each(|cell| leave(cell, &mut open));
    }
    let enclosed = cells.iter().filter(is_free).count();
    let is_open = (enclosed as f64) < all as f64 * ENCLOSED;
    let cells = if is_open { before } else { cells };
    Plan { grid: grid(width, height, plan.resolution(), cells), is_open }
}

/// Draws a small building: a corridor, and two rooms beside it.
pub fn building() -> OccupancyGrid {
    const CELLS: (usize, usize) = (240, 120);
    let cell = |at: usize| {
        let (x, y) = (at % CELLS.0, at / CELLS.0);
        let outer = x < 2 || x >= CELLS.0 - 2 || y < 2 || y >= CELLS.1 - 2;
        let is_door = (50..64).contains(&x) || (176..190).contains(&x);
        let corridor = (28..30).contains(&y) && !is_door;
        let between = (119..121).contains(&x) && y >= 28;
        if outer || corridor || between { Cell::Occupied } else { Cell::Free }
    };
    grid(CELLS.0, CELLS.1, 0.1, (0..CELLS.0 * CELLS.1).map(cell).collect())
}

fn grid(width: usize, height: usize, resolution: f64, cells: Vec<Cell>) -> OccupancyGrid {
    OccupancyGrid::new(width, height, resolution, Position::new(0.0, 0.0), cells)
        .expect("there are as many cells as the sides say")
}

/// Returns a map as a PGM picture, with the values of ROS's map_saver.
pub fn pgm(grid: &OccupancyGrid) -> Vec<u8> {
    let mut picture = format!("P5\n{} {}\n255\n", grid.width(), grid.height()).into_bytes();
    for row in (0..grid.height()).rev() {
        picture.extend((0..grid.width()).map(|column| match grid.cell(column, row) {
            Cell::Occupied => 0,
            Cell::Free => 254,
            Cell::Unknown => 205,
        }));
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    fn threshold() -> Probability {
        Probability::new(0.5).unwrap()
    }

    fn drawn(rows: &[&str]) -> Vec<u8> {
        let value = |c: char| match c {
            '#' => "0 ",
            '+' => "150 ",
            _ => "255 ",
        };
        let values: String = rows.iter().flat_map(|row| row.chars().map(value)).collect();
        format!("P2\n{} {}\n255\n{values}", rows[0].len(), rows.len()).into_bytes()
    }

    fn rows(grid: &OccupancyGrid) -> Vec<String> {
        let cell = |cell| match cell {
            Cell::Occupied => '#',
            Cell::Free => '.',
            Cell::Unknown => '?',
        };
        let row = |row| (0..grid.width()).map(|column| cell(grid.cell(column, row))).collect();
        (0..grid.height()).rev().map(row).collect()
    }

    #[test]
    fn floor_outside_the_walls_is_unknown() {
        let plan = parse(drawn(&["......", ".####.", ".#...#", ".####."]), Size::Pixel(0.1), threshold());
        let plan = plan.unwrap();
        assert_eq!(rows(&plan.grid), ["??????", "?####?", "?#...#", "?####?"]);
        assert_eq!(plan.grid.resolution(), 0.1);
        assert!(!plan.is_open);
    }

    #[test]
    fn an_open_plan_stays_as_it_is() {
        let open = ["......", ".##.#.", ".#..#.", ".####."];
        let plan = parse(drawn(&open), Size::Width(0.6), threshold()).unwrap();
        assert_eq!(rows(&plan.grid), open);
        assert!(plan.is_open);
    }

    #[test]
    fn fine_pixels_merge_to_cells_that_keep_thin_walls() {
        let room = ["######", "#....#", "#....#", "#....#", "#....#", "######"];
        let plan = parse(drawn(&room), Size::Pixel(0.025), threshold()).unwrap();
        assert_eq!(rows(&plan.grid), ["###", "#.#", "###"]);
        assert_eq!(plan.grid.resolution(), 0.05);
    }

    #[test]
    fn cells_grow_where_a_picture_is_very_large() {
        assert_eq!(pixels_per_cell(8000, 4000, 0.05), 2);
        assert_eq!(pixels_per_cell(8000, 8000, 0.025), 2);
        assert_eq!(pixels_per_cell(4000, 4000, 0.05), 1);
        assert_eq!(pixels_per_cell(64 << 20, 1, 0.5), 4);
        // A pixel that is coarser than a cell is never divided.
        assert_eq!(pixels_per_cell(10, 10, 0.5), 1);
    }

    #[test]
    fn the_threshold_decides_what_a_wall_is() {
        let grey = |share| parse(drawn(&["+."]), Size::Pixel(0.1), Probability::new(share).unwrap()).unwrap();
        assert_eq!(rows(&grey(0.5).grid), [".."]);
        assert_eq!(rows(&grey(0.3).grid), ["#."]);
    }

    #[test]
    fn unusable_plans_say_what_to_do() {
        let wrong = |bytes: &[u8], size| parse(bytes.to_vec(), size, threshold()).unwrap_err().to_string();
        let jpeg = wrong(b"\xff\xd8\xff", Size::Pixel(0.1));
        assert!(jpeg.contains("convert it"), "{jpeg}");
        let coarse = wrong(&drawn(&["#."]), Size::Width(40.0));
        assert!(coarse.starts_with("a pixel of 20 m"), "{coarse}");
        assert!(wrong(&drawn(&["#."]), Size::Pixel(f64::NAN)).starts_with("a pixel of NaN m"));
        let short = wrong(b"P5 2 2 255\nabc", Size::Pixel(0.1));
        assert_eq!(short, "it ends after 3 of 4 pixels");
        let device = read(Path::new("/dev/zero"), Size::Pixel(0.1), threshold()).unwrap_err();
        assert!(matches!(device, PlanError::NotAFile), "{device}");
    }

    #[test]
    fn a_written_map_reads_as_it_was() {
        let grid = building();
        let yaml = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n";
        let read = map_server::parse("map.yaml", yaml, |_| Ok(pgm(&grid))).unwrap();
        assert!(read == grid);
    }
}
