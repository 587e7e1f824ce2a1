//! Parsing of figures with units.

use std::time::Duration;

use cotorra_graph::{BitRate, Correlation, CorrelationTime, Probability};

/// Parses a figure, and returns it in the base unit.
fn quantity(text: &str, like: &str, units: &[(&str, f64)]) -> Result<f64, String> {
    let text = text.trim();
    let digits = |c: char| !(c.is_ascii_digit() || c == '.');
    let (figure, unit) = text.split_at(text.find(digits).unwrap_or(text.len()));
    let number: f64 = figure.parse().map_err(|_| format!("write it like {like}"))?;
    let unit = unit.trim();
    let Some((_, factor)) = units.iter().find(|(name, _)| *name == unit) else {
        let names: Vec<_> = units.iter().map(|(name, _)| *name).collect();
        return Err(format!("write it like {like}; units are {}", names.join(", ")));
    };
    Ok(number * factor)
}

/// Parses a time of one hour at most.
pub fn parse_time(text: &str) -> Result<Duration, String> {
    let seconds =
        quantity(text, "10ms", &[("us", 1e-6), ("µs", 1e-6), ("ms", 1e-3), ("s", 1.0), ("min", 60.0)])?;
    if seconds > 3600.0 {
        return Err("it is one hour at most".to_owned());
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// Parses a share in percent.
pub fn parse_share(text: &str) -> Result<Probability, String> {
    let share = quantity(text, "1%", &[("%", 0.01)])?;
    Probability::new(share).ok_or_else(|| "it is 100% at most".to_owned())
}

/// Parses a time over which a jitter changes.
pub fn parse_correlation_time(text: &str) -> Result<CorrelationTime, String> {
    CorrelationTime::new(parse_time(text)?).ok_or_else(|| "it is 1ms to 65s".to_owned())
}

/// Parses a correlation in percent.
pub fn parse_correlation(text: &str) -> Result<Correlation, String> {
    let (sign, figure) = text.trim().strip_prefix('-').map_or((1.0, text), |figure| (-1.0, figure));
    let correlation = sign * quantity(figure, "40%", &[("%", 0.01)])?;
    Correlation::new(correlation).ok_or_else(|| "it is above -100% and below 100%".to_owned())
}

/// Parses a rate of 1 bit/s to 8000 Gbit/s.
pub fn parse_rate(text: &str) -> Result<BitRate, String> {
    let units = [("bit/s", 1.0), ("kbit/s", 1e3), ("Mbit/s", 1e6), ("Gbit/s", 1e9)];
    let rate = quantity(text, "20Mbit/s", &units)?;
    if rate > 8e12 {
        return Err("it is 8000 Gbit/s at most".to_owned());
    }
    BitRate::from_bits_per_second(rate.round() as u64).ok_or_else(|| "it is 1 bit/s or more".to_owned())
}

/// Parses a length above 0 of 10 km at most. Returns it in metres.
pub fn parse_length(text: &str) -> Result<f64, String> {
    let metres = quantity(text, "5cm", &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("km", 1e3)])?;
    if metres > 0.0 && metres <= 1e4 { Ok(metres) } else { Err("it is above 0 and 10 km at most".to_owned()) }
}

/// Parses a size of 1 MB or more. Returns it in bytes.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let bytes = quantity(text, "2GB", &[("MB", 1e6), ("GB", 1e9), ("TB", 1e12)])?;
    if bytes >= 1e6 { Ok(bytes as u64) } else { Err("it is 1 MB or more".to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_units() {
        assert_eq!(parse_time("250us"), Ok(Duration::from_micros(250)));
        assert_eq!(parse_time("1.5 ms"), Ok(Duration::from_micros(1500)));
        assert_eq!(parse_share("0.5%"), Ok(Probability::new(0.005).unwrap()));
        assert_eq!(parse_correlation("40%"), Ok(Correlation::new(0.4).unwrap()));
        assert_eq!(parse_correlation("-25 %"), Ok(Correlation::new(-0.25).unwrap()));
        assert_eq!(parse_rate("20Mbit/s"), Ok(BitRate::from_mbps(20.0).unwrap()));
        for wrong in ["", "10", "ms", "-1ms", "1h", "61min", "1e3ms", "nanms"] {
            assert!(parse_time(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_size("2GB"), Ok(2_000_000_000));
        assert_eq!(parse_size("1.5 MB"), Ok(1_500_000));
        for wrong in ["2", "0.5MB", "-1GB", "2GiB"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_length("2.5 cm"), Ok(0.025));
        assert_eq!(parse_length("30m"), Ok(30.0));
        for wrong in ["30", "0m", "-1m", "11km", "1 inch"] {
            assert!(parse_length(wrong).is_err(), "{wrong}");
        }
        for wrong in ["1", "101%", "0.01", "-1%"] {
            assert!(parse_share(wrong).is_err(), "{wrong}");
        }
        for wrong in ["0.4", "100%", "--4%", "-100%"] {
            assert!(parse_correlation(wrong).is_err(), "{wrong}");
        }
        for wrong in ["10", "0bit/s", "10mbit", "9000Gbit/s"] {
            assert!(parse_rate(wrong).is_err(), "{wrong}");
        }
    }
}
