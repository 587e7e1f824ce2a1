//! The speed of virtual time and of a replay, as an argument.

use cotorra_testbed::Speed;

/// Parses a speed.
pub fn parse_speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed::Max);
    }
    let times = text.strip_suffix('x').and_then(|times| times.parse::<f64>().ok());
    times.and_then(Speed::times).ok_or_else(|| "write it like 1x, 2.5x or max".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_speed_is_a_factor_or_max() {
        assert_eq!(parse_speed("2.5x"), Ok(Speed::Times(2.5)));
        assert_eq!(parse_speed("max"), Ok(Speed::Max));
        for wrong in ["2", "0x", "-1x", "nanx", "infx", "fast"] {
            assert!(parse_speed(wrong).is_err(), "{wrong}");
        }
    }
}
