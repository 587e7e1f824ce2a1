//! Encodes figures for answers: radio figures by IEEE 802.11-2016, places by RFC 6225.

use cotorra_graph::{Band, Dbm, GeoOrigin, Position, WifiStandard};
use cotorra_mec::to_earth;

use crate::types::GeoLocation;

/// Encodes a received power as RCPI (IEEE 802.11-2016, 9.4.2.38): 2·(P + 110) rounded, P in dBm, from 0 (-110 dBm or
/// less) to 220 (0 dBm or more).
pub(crate) fn rcpi(power: Dbm) -> u8 {
    ((power.0 + 110.0) * 2.0).round().clamp(0.0, 220.0) as u8
}

/// Encodes a signal-to-noise ratio as RSNI (IEEE 802.11-2016, 9.4.2.41): 2·(SNR + 10) rounded, SNR in dB, from 0 to
/// 254.
pub(crate) fn rsni(power: Dbm, noise_floor: Dbm) -> u8 {
    ((power.0 - noise_floor.0 + 10.0) * 2.0).round().clamp(0.0, 254.0) as u8
}

/// Encodes a share of time, 255 being all of it.
pub(crate) fn share(share: f64) -> u8 {
    (share * 255.0).round().clamp(0.0, 255.0) as u8
}

/// Returns the global operating class of a 20 MHz channel (IEEE 802.11-2016, Table E-4); `None` for a channel without
/// one.
pub(crate) fn operating_class(standard: WifiStandard, channel: u8) -> Option<u8> {
    match (standard.band(channel), channel) {
        (Band::Ghz2, 1..=13) => Some(81),
        (Band::Ghz2, 14) => Some(82),
        (Band::Ghz5, 36..=48) => Some(115),
        (Band::Ghz5, 52..=64) => Some(118),
        (Band::Ghz5, 100..=144) => Some(121),
        (Band::Ghz5, 149..=177) => Some(125),
        _ => None,
    }
}

/// Returns `dot11PHYType` (IEEE 802.11-2016, Annex C).
pub(crate) fn phy_type(standard: WifiStandard) -> u8 {
    match standard {
        WifiStandard::A => 4,
        WifiStandard::G => 6,
        WifiStandard::N => 7,
        WifiStandard::Ac => 9,
        WifiStandard::Ax => 14,
    }
}

/// Converts a place on the map to a place on Earth. It uses the plane tangent to Earth at the map's origin, which is
/// accurate to centimetres over the size of a campus.
pub(crate) fn geolocation(origin: &GeoOrigin, place: Position) -> GeoLocation {
    let (latitude, longitude) = to_earth(origin, place);
    GeoLocation {
        lat_uncertainty: 0,
        lat: fixed_point(latitude),
        long_uncertainty: 0,
        long: fixed_point(longitude),
        datum: 1,
        altitude_type: origin.altitude.map(|_| 1),
        altitude_uncertainty: origin.altitude.map(|_| 0),
        altitude: origin.altitude.map(|altitude| height(altitude + place.z)),
    }
}

/// Encodes an altitude (RFC 6225, 2.4.1): two's complement in 30 bits, 8 of them fraction.
fn height(metres: f64) -> u32 {
    let most = f64::from((1 << 29) - 1);
    ((metres * 256.0).round().clamp(-most, most) as i32).cast_unsigned() & ((1 << 30) - 1)
}

/// Encodes an angle (RFC 6225, 2.3): two's complement in 34 bits, 25 of them fraction.
fn fixed_point(degrees: f64) -> u64 {
    ((degrees * f64::from(1 << 25)).round() as i64 as u64) & ((1 << 34) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_encoded_in_half_decibels() {
        for (dbm, code) in [(-110.0, 0), (-109.5, 1), (-60.0, 100), (0.0, 220), (5.0, 220), (-200.0, 0)] {
            assert_eq!(rcpi(Dbm(dbm)), code, "{dbm}");
        }
        assert_eq!(rsni(Dbm(-65.0), Dbm(-95.0)), 80);
        assert_eq!((rcpi(Dbm(f64::NEG_INFINITY)), rsni(Dbm(-200.0), Dbm(-95.0))), (0, 0));
        assert_eq!([0.0, 0.5, 1.0, 1.2, -0.1].map(share), [0, 128, 255, 255, 0]);
    }

    #[test]
    fn channels_have_the_operating_classes_of_their_bands() {
        assert_eq!(operating_class(WifiStandard::N, 6), Some(81));
        assert_eq!(operating_class(WifiStandard::Ac, 36), Some(115));
        assert_eq!(operating_class(WifiStandard::A, 157), Some(125));
        assert_eq!(operating_class(WifiStandard::G, 36), None);
    }

    fn degrees(fixed: u64) -> f64 {
        let signed = (fixed << 30) as i64 >> 30;
        signed as f64 / f64::from(1 << 25)
    }

    #[test]
    fn map_places_convert_to_earth() {
        let origin = GeoOrigin { latitude: -33.5, longitude: 151.25, bearing: 0.0, altitude: None };
        let there = geolocation(&origin, Position::new(0.0, 0.0));
        assert_eq!((degrees(there.lat), degrees(there.long), there.datum), (-33.5, 151.25, 1));
        let north = geolocation(&origin, Position::new(0.0, 1111.95));
        assert!((degrees(north.lat) + 33.49).abs() < 1e-6);
        // With the y axis to the east, up on the map is east.
        let turned = GeoOrigin { bearing: std::f64::consts::FRAC_PI_2, ..origin };
        let east = geolocation(&turned, Position::new(0.0, 1000.0));
        assert!((degrees(east.lat) + 33.5).abs() < 1e-6 && degrees(east.long) > 151.26);
        assert_eq!((there.altitude_type, there.altitude), (None, None));
        let below = GeoOrigin { altitude: Some(-5.0), ..origin };
        let flying = geolocation(&below, Position::new(0.0, 0.0).at_height(2.5));
        assert_eq!((flying.altitude_type, flying.altitude), (Some(1), Some((1 << 30) - 640)));
        let pole = GeoOrigin { latitude: 90.0, ..origin };
        assert!(degrees(geolocation(&pole, Position::new(5.0, 5.0)).lat) <= 90.0);
    }
}
