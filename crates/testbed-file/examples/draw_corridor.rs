//! Draws the corridor's map, `testbeds/maps/corridor.pgm`: free ground within 2 m of the walk of
//! `testbeds/corridor.yaml`, a wall around it, and nothing known beyond. The original map is not public.
//!
//! `cargo run -p cotorra-testbed-file --example draw_corridor`, in the root of the project.

use std::{error::Error, fs, path::Path};

use cotorra_graph::Position;

/// Metres a cell.
const RESOLUTION: f64 = 0.05;
/// Lower left corner; the map reaches as far as the radio units do.
const ORIGIN: Position = Position::new(-11.0, -31.0);
/// Upper right corner.
const FAR: Position = Position::new(33.0, 7.0);
/// From the walk's line to the wall.
const HALF_WIDTH: f64 = 2.0;
/// Of the wall.
const THICKNESS: f64 = 0.2;

/// The way out.
const WALK: [(f64, f64); 18] = [
    (25.5, -27.8),
    (25.5, -24.6),
    (25.8, -21.8),
    (26.4, -18.7),
    (27.3, -15.6),
    (27.1, -12.4),
    (27.2, -9.4),
    (27.5, -6.2),
    (25.5, -4.3),
    (22.5, -2.4),
    (19.3, -1.9),
    (16.1, -1.7),
    (12.9, -1.3),
    (9.8, -0.7),
    (6.6, -0.3),
    (3.4, 0.1),
    (0.2, 0.2),
    (-2.1, 0.4),
];

fn main() -> Result<(), Box<dyn Error>> {
    let width = ((FAR.x - ORIGIN.x) / RESOLUTION).round() as usize;
    let height = ((FAR.y - ORIGIN.y) / RESOLUTION).round() as usize;
    let mut picture = format!("P5\n{width} {height}\n255\n").into_bytes();
    for row in (0..height).rev() {
        for column in 0..width {
            let centre = |index: usize| (index as f64 + 0.5) * RESOLUTION;
            let place = Position::new(ORIGIN.x + centre(column), ORIGIN.y + centre(row));
            let off = WALK.windows(2).map(|ends| distance(place, ends[0], ends[1])).fold(f64::MAX, f64::min);
            picture.push(match off {
                off if off <= HALF_WIDTH => 254,
                off if off <= HALF_WIDTH + THICKNESS => 0,
                _ => 205,
            });
        }
    }
    let maps = Path::new("testbeds/maps");
    fs::write(maps.join("corridor.pgm"), picture)?;
    fs::write(
        maps.join("corridor.yaml"),
        format!(
            "# Drawn by `cargo run -p cotorra-testbed-file --example draw_corridor`.\n\
             image: corridor.pgm\n\
             resolution: {RESOLUTION}\n\
             origin: [{:.1}, {:.1}, 0.0]\n\
             negate: 0\n\
             occupied_thresh: 0.65\n\
             free_thresh: 0.196\n",
            ORIGIN.x, ORIGIN.y
        ),
    )?;
    Ok(())
}

/// From a place to the nearest one between two ends.
fn distance(place: Position, (ax, ay): (f64, f64), (bx, by): (f64, f64)) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let along = ((place.x - ax) * dx + (place.y - ay) * dy) / (dx * dx + dy * dy);
    let along = along.clamp(0.0, 1.0);
    place.distance(Position::new(ax + along * dx, ay + along * dy))
}
