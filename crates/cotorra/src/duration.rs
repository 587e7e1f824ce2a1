//! Parsing of durations and times of a run.

use std::time::Duration;

/// Parses a duration above zero, such as `60s`, `1.5min` or `500 ms`.
pub fn parse_duration(text: &str) -> Result<Duration, String> {
    let duration = parse_time(text)?;
    if duration.is_zero() { Err("it must be above zero".to_owned()) } else { Ok(duration) }
}

/// Parses a duration that divides a minute.
pub fn parse_step(text: &str) -> Result<Duration, String> {
    let step = parse_time(text)?;
    if cotorra_graph::Retention::is_step(step) {
        Ok(step)
    } else {
        Err("a minute must be a multiple of it, as of 100ms, 1s, 10s or 1min".to_owned())
    }
}

/// Parses a time, which can be zero. A bare number is an error, because seconds and milliseconds look alike.
pub fn parse_time(text: &str) -> Result<Duration, String> {
    const UNITS: [(&str, f64); 5] = [("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("h", 3600.0), ("d", 86400.0)];
    let text = text.trim();
    let (figure, unit) = text.split_at(text.find(|c: char| c.is_alphabetic()).unwrap_or(text.len()));
    let figure = figure.trim_end();
    let number: f64 = figure.parse().map_err(|_| "write it like 60s or 2min".to_owned())?;
    let Some((_, seconds)) = UNITS.into_iter().find(|(name, _)| *name == unit) else {
        return Err(match unit {
            "" => format!("it has no unit: write {figure}s or {figure}min"),
            "m" => format!("`m` could be minutes or metres: write {figure}min"),
            _ => "the units are ms, s, min, h and d".to_owned(),
        });
    };
    if number < 0.0 {
        return Err("it must not be below zero".to_owned());
    }
    Duration::try_from_secs_f64(number * seconds).map_err(|_| "it is too long".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_need_their_unit() {
        assert_eq!(parse_duration("60s"), Ok(Duration::from_secs(60)));
        assert_eq!(parse_duration("1.5 min"), Ok(Duration::from_secs(90)));
        assert_eq!(parse_duration("250ms"), Ok(Duration::from_millis(250)));
        assert_eq!(parse_duration("90d"), Ok(Duration::from_hours(24 * 90)));
        assert_eq!(parse_duration("60"), Err("it has no unit: write 60s or 60min".to_owned()));
        for wrong in ["", "s", "-1s", "0s", "1 day", "1days", "5m", "1e400s", "1e300h", "nans", "infs"] {
            assert!(parse_duration(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_time("0s"), Ok(Duration::ZERO));
    }
}
