//! Places on the map and on Earth (WGS 84), on the plane tangent to Earth at the map's origin.

use cotorra_graph::{GeoOrigin, Position};

/// Metres per degree of latitude: the mean meridian of WGS 84.
const METRES_A_DEGREE: f64 = 111_195.0;

/// Converts a place on the map to latitude and longitude in degrees. The plane is accurate to centimetres over the
/// size of a campus.
pub fn to_earth(origin: &GeoOrigin, place: Position) -> (f64, f64) {
    let (east, north) = to_north(origin, place);
    let latitude = origin.latitude + north / METRES_A_DEGREE;
    let longitude = origin.longitude + east / (METRES_A_DEGREE * origin.latitude.to_radians().cos());
    // At a pole every longitude is valid.
    let longitude = if longitude.is_finite() { longitude.clamp(-180.0, 180.0) } else { 0.0 };
    (latitude.clamp(-90.0, 90.0), longitude)
}

/// Converts latitude and longitude in degrees to a place on the map's floor.
pub fn to_map(origin: &GeoOrigin, latitude: f64, longitude: f64) -> Position {
    let north = (latitude - origin.latitude) * METRES_A_DEGREE;
    let east = (longitude - origin.longitude) * METRES_A_DEGREE * origin.latitude.to_radians().cos();
    let (sin, cos) = origin.bearing.sin_cos();
    Position::new(east * cos - north * sin, east * sin + north * cos)
}

/// Returns how far a place on the map is to the east and to the north of the origin, metres.
pub fn to_north(origin: &GeoOrigin, place: Position) -> (f64, f64) {
    let (sin, cos) = origin.bearing.sin_cos();
    (place.y * sin + place.x * cos, place.y * cos - place.x * sin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_convert_both_ways() {
        let origin = GeoOrigin { latitude: 41.5, longitude: 2.25, bearing: 0.5, altitude: None };
        let (latitude, longitude) = to_earth(&origin, Position::new(0.0, 1000.0));
        // The map's y axis points half a radian east of north.
        assert!((latitude - 41.5 - 0.5_f64.cos() * 1000.0 / 111_195.0).abs() < 1e-9, "{latitude}");
        assert!(longitude > 2.25);
        for (x, y) in [(0.0, 0.0), (12.5, -300.0), (-7.0, 42.0)] {
            let (latitude, longitude) = to_earth(&origin, Position::new(x, y));
            let back = to_map(&origin, latitude, longitude);
            assert!((back.x - x).abs() < 1e-6 && (back.y - y).abs() < 1e-6, "{back:?}");
        }
    }
}
