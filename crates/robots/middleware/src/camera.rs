//! Images of a simulated camera: the map's walls between a floor and a ceiling.
//!
//! Each column of an image casts one ray. Distances count along the optical axis, so that straight walls stay straight.
//! Surfaces darken with distance, and walls that face east and west are brighter than the others. Pixels are square. There
//! is no noise and no blur, and other robots are invisible.

use std::sync::{Arc, OnceLock};

use cotorra_graph::{Camera, DataFormat, Pose, Position};

use crate::world::World;

/// Height of all walls, and of the ceiling, metres.
const WALL: f64 = 2.5;
/// Height of the camera above the robot's lowest point, metres.
const EYE: f64 = 0.3;
/// Visibility of walls, metres.
const REACH: f64 = 50.0;
/// Distance at which the brightness of a surface is halved, metres.
const FADE: f64 = 5.0;
/// Smallest distance of a wall, metres. It fills the image from inside a wall.
const NEAREST: f64 = 0.01;

/// Brightness of a surface at distance 0, and its shares of red, green and blue in 255.
struct Surface {
    brightness: f64,
    tint: [u8; 3],
}

/// Walls that face east and west, and those that face north and south.
const WALLS: [Surface; 2] = [
    Surface { brightness: 240.0, tint: [255, 244, 224] },
    Surface { brightness: 190.0, tint: [255, 244, 224] },
];
const FLOOR: Surface = Surface { brightness: 120.0, tint: [255, 229, 194] };
const CEILING: Surface = Surface { brightness: 160.0, tint: [224, 236, 255] };

/// The view of a camera, which is drawn on demand. The camera looks along the robot's heading and is level.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    world: Arc<World>,
    eye: Position,
    heading: f64,
    width: u16,
    height: u16,
    is_coloured: bool,
    field_of_view: f64,
    /// The image, once it is drawn.
    image: OnceLock<Arc<[u8]>>,
}

/// Shade of a surface at a distance, with its share of each colour.
#[derive(Clone, Copy)]
struct Shade {
    grey: u8,
    tint: [u8; 3],
}

impl Surface {
    fn at(&self, distance: f64) -> Shade {
        Shade { grey: (self.brightness * FADE / (FADE + distance)) as u8, tint: self.tint }
    }
}

impl Shade {
    fn coloured(self) -> [u8; 3] {
        self.tint.map(|share| (u16::from(self.grey) * u16::from(share) / 255) as u8)
    }
}

/// The wall in a column of an image.
struct Column {
    /// First row of the wall.
    top: usize,
    /// First row below the wall.
    bottom: usize,
    shade: Shade,
}

impl View {
    /// Creates the view of this camera from a robot with this pose.
    pub(crate) fn new(camera: &Camera, world: Arc<World>, pose: &Pose) -> Self {
        let Position { x, y, z } = pose.position();
        Self {
            world,
            eye: Position { x, y, z: z + EYE },
            heading: pose.heading,
            width: camera.width,
            height: camera.height,
            is_coloured: camera.format == DataFormat::Rgb8,
            field_of_view: camera.field_of_view,
            image: OnceLock::new(),
        }
    }

    /// Returns the size of the image, bytes.
    pub fn len(&self) -> usize {
        usize::from(self.width) * usize::from(self.height) * if self.is_coloured { 3 } else { 1 }
    }

    /// Whether the image has no pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the image, row by row from the top left. The first call draws it.
    pub fn bytes(&self) -> Arc<[u8]> {
        Arc::clone(self.image.get_or_init(|| self.draw().into()))
    }

    fn draw(&self) -> Vec<u8> {
        // Focal length in pixels.
        let focal = f64::from(self.width) / 2.0 / (self.field_of_view / 2.0).tan();
        let columns: Vec<_> = (0..self.width).map(|column| self.column(column, focal)).collect();
        let mut image = Vec::with_capacity(self.len());
        for row in 0..usize::from(self.height) {
            let behind = self.behind(row, focal);
            let seen = columns
                .iter()
                .map(|column| if (column.top..column.bottom).contains(&row) { column.shade } else { behind });
            if self.is_coloured {
                image.extend(seen.flat_map(Shade::coloured));
            } else {
                image.extend(seen.map(|shade| shade.grey));
            }
        }
        image
    }

    /// Casts the ray of a column.
    fn column(&self, column: u16, focal: f64) -> Column {
        let left = (f64::from(self.width) / 2.0 - f64::from(column) - 0.5) / focal;
        let (sin, cos) = self.heading.sin_cos();
        // Length of the ray per distance along the axis.
        let slant = left.hypot(1.0);
        let towards = ((cos - left * sin) / slant, (sin + left * cos) / slant);
        let Some(range) = self.world.cast(self.eye, towards, REACH) else {
            return Column { top: 0, bottom: 0, shade: WALLS[0].at(REACH) };
        };
        let hit =
            Position { x: self.eye.x + range * towards.0, y: self.eye.y + range * towards.1, ..self.eye };
        let wall = &WALLS[usize::from(!self.world.faces_across(hit))];
        let distance = (range / slant).max(NEAREST);
        let (middle, height) = (f64::from(self.height) / 2.0 - 0.5, f64::from(self.height));
        let row = |above: f64| middle - focal * above / distance;
        let within = |row: f64| row.clamp(0.0, height) as usize;
        Column {
            top: within(row(WALL - self.eye.z).ceil()),
            bottom: within(row(-self.eye.z).floor() + 1.0),
            shade: wall.at(distance),
        }
    }

    /// Returns the shade of floor or ceiling in a row.
    fn behind(&self, row: usize, focal: f64) -> Shade {
        let up = (f64::from(self.height) / 2.0 - row as f64 - 0.5) / focal;
        if up > 0.0 {
            // A camera above the walls sees the sky.
            CEILING.at(((WALL - self.eye.z) / up).max(0.0))
        } else {
            FLOOR.at(self.eye.z / -up)
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use cotorra_graph::PoseSource;

    use super::*;
    use crate::fixtures::room;

    fn camera(width: u16, height: u16, format: DataFormat) -> Camera {
        Camera { width, height, format, field_of_view: FRAC_PI_2, to: None, keep_bytes: 0 }
    }

    /// Draws a room of 12 m × 6 m from 2 m east of the western wall. A camera that looks north is 3 m off the northern
    /// wall.
    fn seen(camera: &Camera, heading: f64, height: f64) -> Vec<u8> {
        // A ray along the border of two cells would hit a corner.
        let aside = 0.02;
        let [x, y] = if heading == FRAC_PI_2 { [2.0 + aside, 3.0] } else { [2.0, 3.0 + aside] };
        let pose = Pose::planar(x, y, heading, [0.0; 9], PoseSource::Simulator);
        let view = View::new(camera, Arc::new(World::new(&room(12.0, 6.0))), &Pose { z: height, ..pose });
        let image = view.draw();
        assert_eq!(image.len(), view.len());
        image
    }

    /// Returns the first row of the wall and the first row below, in a column.
    fn wall(image: &[u8], width: usize, column: usize) -> (usize, usize) {
        let rows: Vec<_> = image.chunks(width).map(|row| row[column]).collect();
        // The wall is at the horizon.
        let shade = rows[rows.len() / 2];
        let top = rows.iter().position(|&grey| grey == shade).unwrap();
        (top, top + rows[top..].iter().position(|&grey| grey != shade).unwrap_or(rows.len() - top))
    }

    #[test]
    fn wall_ahead_covers_the_same_rows_in_all_columns() {
        // A right angle over 400 columns: 200 pixels per metre at a distance of 1 m.
        let camera = camera(400, 600, DataFormat::Mono8);
        let image = seen(&camera, PI, 0.0);
        // At 2 m, 2.2 m above the camera are 220 pixels above the horizon, and 0.3 m below it are 30.
        for column in [0, 1, 100, 200, 399] {
            assert_eq!(wall(&image, 400, column), (300 - 220, 300 + 30), "column {column}");
        }
    }

    #[test]
    fn nearer_walls_are_higher_and_brighter_and_sides_differ() {
        let camera = camera(101, 101, DataFormat::Mono8);
        let (west, east, north) =
            (seen(&camera, PI, 0.0), seen(&camera, 0.0, 0.0), seen(&camera, FRAC_PI_2, 0.0));
        let height = |image: &[u8]| {
            let (top, bottom) = wall(image, 101, 50);
            bottom - top
        };
        let shade = |image: &[u8]| image[50 * 101 + 50];
        assert!(height(&west) > height(&north) && height(&north) > height(&east));
        assert!(shade(&west) > shade(&north) && shade(&north) > shade(&east));
        assert_eq!(
            [shade(&west), shade(&north)],
            [(240.0 * 5.0 / 7.0) as u8, (190.0 * 5.0 / 8.0) as u8],
            "2 m and 3 m away"
        );
        // Floor and ceiling are brighter where they are nearer.
        let column: Vec<_> = east.chunks(101).map(|row| row[50]).collect();
        let (top, bottom) = wall(&east, 101, 50);
        assert!(column[..top].is_sorted_by(|a, b| a >= b) && column[0] > column[top - 1]);
        assert!(column[bottom..].is_sorted() && column[bottom] < column[100]);
    }

    #[test]
    fn wall_on_the_left_is_on_the_left_of_the_image() {
        // The camera looks east, 1 m off the northern wall, which is on the left.
        let pose = Pose::planar(2.0, 5.0, 0.0, [0.0; 9], PoseSource::Simulator);
        let camera = camera(100, 100, DataFormat::Mono8);
        let image = View::new(&camera, Arc::new(World::new(&room(12.0, 6.0))), &pose).draw();
        let row = &image[50 * 100..51 * 100];
        assert!(row[0] > 2 * row[50], "{row:?}");
        assert!(row[99] < row[0]);
    }

    #[test]
    fn walls_are_lower_in_the_image_from_higher_up() {
        let camera = camera(400, 600, DataFormat::Mono8);
        // The camera is 1.3 m above the floor.
        assert_eq!(wall(&seen(&camera, PI, 1.0), 400, 200), (300 - 120, 300 + 130));
        // From above the walls, their top is below the horizon, and the sky above it.
        let image = seen(&camera, PI, 3.0);
        assert_eq!((image[299 * 400], image[0]), (160, 160));
        assert!(image[(300 + 79) * 400] < image[(300 + 80) * 400], "the wall begins 0.8 m below the eye");
    }

    #[test]
    fn images_have_the_size_and_shades_of_their_format() {
        let [mono, rgb] = [DataFormat::Mono8, DataFormat::Rgb8].map(|f| seen(&camera(32, 24, f), 0.5, 0.0));
        assert_eq!((mono.len(), rgb.len()), (32 * 24, 32 * 24 * 3));
        for (grey, colour) in mono.iter().zip(rgb.chunks(3)) {
            assert_eq!(colour.iter().max().unwrap(), grey, "the strongest colour is the shade");
        }
        assert_eq!(mono, seen(&camera(32, 24, DataFormat::Mono8), 0.5, 0.0));
    }

    #[test]
    fn open_space_and_the_inside_of_a_wall_are_drawn() {
        let small = camera(8, 8, DataFormat::Mono8);
        let pose = Pose::planar(0.0, 0.0, 0.0, [0.0; 9], PoseSource::Simulator);
        let open = View::new(&small, Arc::new(World::open()), &pose).draw();
        assert!(open.chunks(8).all(|row| row.iter().all(|grey| *grey == row[0])));
        let inside = Pose::planar(-0.02, 3.0, 0.0, [0.0; 9], PoseSource::Simulator);
        let image = View::new(&small, Arc::new(World::new(&room(12.0, 6.0))), &inside).draw();
        assert!(image.iter().all(|grey| *grey == image[0]));
    }
}
