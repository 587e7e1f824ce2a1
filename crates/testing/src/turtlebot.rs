//! A TurtleBot 2 to drive: emulators of its Kobuki base and its RPLIDAR A2.
//!
//! They are written from the published protocols, and share no code with the drivers. As state machines, they take the
//! time, and are joined to a driver by [`Memory`]. [`Emulated`] runs both on pseudo-terminals.

mod emulated;
mod kobuki;
mod memory;
mod rplidar;

pub use emulated::{Emulated, Terminal};
pub use kobuki::Kobuki;
pub use memory::Memory;
pub use rplidar::Rplidar;

/// True place of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Place {
    /// Metres.
    pub x: f64,
    /// Metres.
    pub y: f64,
    /// Radians, counter-clockwise.
    pub heading: f64,
}

/// A wall from one point to another, metres.
pub type Wall = [(f64, f64); 2];

/// Returns the walls of a room.
pub fn room((left, low): (f64, f64), (right, high): (f64, f64)) -> Vec<Wall> {
    let corners = [(left, low), (right, low), (right, high), (left, high)];
    (0..4).map(|i| [corners[i], corners[(i + 1) % 4]]).collect()
}

/// Returns the distance of the first wall in a direction, metres.
fn cast(walls: &[Wall], from: &Place, direction: f64) -> Option<f64> {
    let (sin, cos) = direction.sin_cos();
    let hit = |[a, b]: &Wall| {
        // from + t (cos, sin) = a + u (b - a)
        let (along, to) = ((b.0 - a.0, b.1 - a.1), (a.0 - from.x, a.1 - from.y));
        let cross = cos * along.1 - sin * along.0;
        let (t, u) = ((to.0 * along.1 - to.1 * along.0) / cross, (to.0 * sin - to.1 * cos) / cross);
        (t > 0.0 && (0.0..=1.0).contains(&u)).then_some(t)
    };
    walls.iter().filter_map(hit).min_by(f64::total_cmp)
}
