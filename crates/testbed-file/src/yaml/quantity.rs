//! Figures with units: `5 ms`, `10 Mbit/s`, `8 GB`. A figure without its unit is refused, as is one that cannot be.

use std::{f64::consts::PI, time::Duration};

use serde_json::{Value as Json, json};

use super::{
    Sink,
    decode::{Decode, Node, expected, nearest, words},
};
use cotorra_graph::{
    BitRate, Correlation, CpuFactor, Dbm, DecidesIn, FixedRate, Probability, QueueLimit, Rate, UdpRate,
};

/// A ratio in dB, 0 or more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Decibels(pub f64);

/// An amount of memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bytes(pub u64);

/// A length in metres, 0 or more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Metres(pub f64);

/// A speed in m/s, 0 or more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Speed(pub f64);

/// An electric power in watts, 0 or more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Watts(pub f64);

/// An energy in watt hours, 0 or more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct WattHours(pub f64);

/// A frequency in Hz, 0 or more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Frequency(pub f64);

/// A largest error of a rate, parts per million.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Drift(pub f64);

/// An angle in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Angle(pub f64);

/// Kind of figure: its units and bounds.
struct Kind {
    what: &'static str,
    example: &'static str,
    /// Units and what one of them is in the first's terms, or in the base unit's.
    units: &'static [(&'static str, f64)],
    signed: bool,
    /// The largest that makes sense, in the base unit.
    most: f64,
}

impl Kind {
    fn schema(&self) -> Json {
        let units: Vec<_> = self.units.iter().map(|(unit, _)| unit.replace('/', "\\/")).collect();
        let sign = if self.signed { "-?" } else { "" };
        json!({
            "type": "string",
            "pattern": format!("^{sign}[0-9]*\\.?[0-9]+(e-?[0-9]+)? ?({})$", units.join("|")),
            "examples": [self.example],
        })
    }

    /// Reads a figure, in the base unit, and the place of its unit in the list.
    fn read(&self, node: &Node, sink: &mut Sink) -> Option<(f64, usize)> {
        let Some(text) = node.text() else {
            expected(node, self.what, &format!("write it like `{}`", self.example), sink);
            return None;
        };
        let (figure, unit) = split(text);
        let mut refuse = |message: String, help: String| {
            sink.error(&node.span, message).help(help);
            None
        };
        let like = format!("write it like `{}`", self.example);
        let Some(number) = figure.parse::<f64>().ok().filter(|n| n.is_finite()) else {
            return refuse(format!("{} is not {}", node.describe(), self.what), like);
        };
        let names: Vec<_> = self.units.iter().map(|(name, _)| *name).collect();
        let Some(place) = names.iter().position(|name| *name == unit) else {
            let units = match &names[..] {
                [only] => format!("the unit is `{only}`"),
                several => format!("the units are {}", words(several)),
            };
            let usual = self.example.split(' ').next_back().unwrap_or_default();
            let (message, help) = if unit.is_empty() {
                (format!("`{text}` has no unit"), format!("write it like `{figure} {usual}`; {units}"))
            } else {
                let help = match nearest(unit, names.iter().copied()) {
                    Some(near) => format!("did you mean `{figure} {near}`?"),
                    None => format!("write it like `{figure} {usual}`; {units}"),
                };
                (format!("{} has no unit of {}", node.describe(), self.what), help)
            };
            return refuse(message, help);
        };
        if number.is_sign_negative() && number != 0.0 && !self.signed {
            return refuse(format!("`{text}` is below zero"), format!("{} is zero or more", self.what));
        }
        let value = number * self.units[place].1;
        if value.abs() > self.most {
            let (unit, factor) = self.units[place];
            return refuse(
                format!("`{text}` is too much"),
                format!("{} is at most {} {unit}", self.what, self.most / factor),
            );
        }
        Some((value, place))
    }
}

/// The figure and the unit.
fn split(text: &str) -> (&str, &str) {
    let bytes = text.as_bytes();
    let digits = |from: usize| bytes[from..].iter().take_while(|b| b.is_ascii_digit()).count();
    let mut end = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
    end += digits(end);
    if bytes.get(end) == Some(&b'.') {
        end += 1 + digits(end + 1);
    }
    if matches!(bytes.get(end), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
        let exponent = digits(end + 1 + sign);
        if exponent > 0 {
            end += 1 + sign + exponent;
        }
    }
    (&text[..end], text[end..].trim())
}

const DURATION: Kind = Kind {
    what: "a duration",
    example: "5 ms",
    units: &[
        ("ns", 1e-9),
        ("us", 1e-6),
        ("µs", 1e-6),
        ("ms", 1e-3),
        ("s", 1.0),
        ("min", 60.0),
        ("h", 3600.0),
    ],
    signed: false,
    most: 86_400.0,
};

const RATE: Kind = Kind {
    what: "a rate",
    example: "10 Mbit/s",
    units: &[("bit/s", 1.0), ("kbit/s", 1e3), ("Mbit/s", 1e6), ("Gbit/s", 1e9)],
    signed: false,
    most: 1e13,
};

const MEMORY: Kind = Kind {
    what: "an amount of memory",
    example: "8 GB",
    units: &[
        ("B", 1.0),
        ("kB", 1e3),
        ("MB", 1e6),
        ("GB", 1e9),
        ("TB", 1e12),
        ("KiB", 1024.0),
        ("MiB", 1_048_576.0),
        ("GiB", 1_073_741_824.0),
        ("TiB", 1_099_511_627_776.0),
    ],
    signed: false,
    most: 1e15,
};

const QUEUE: Kind = Kind {
    what: "a queue limit",
    example: "100 packets",
    units: &[
        ("packets", 1.0),
        ("packet", 1.0),
        ("B", 1.0),
        ("kB", 1e3),
        ("MB", 1e6),
        ("KiB", 1024.0),
        ("MiB", 1_048_576.0),
    ],
    signed: false,
    most: 4e9,
};

const POWER: Kind =
    Kind { what: "a power", example: "15 dBm", units: &[("dBm", 1.0)], signed: true, most: 200.0 };
const WATTS: Kind = Kind {
    what: "an electric power",
    example: "40 W",
    units: &[("W", 1.0), ("mW", 1e-3), ("kW", 1e3)],
    signed: false,
    most: 1e6,
};
const ENERGY: Kind = Kind {
    what: "an energy",
    example: "55 Wh",
    units: &[("Wh", 1.0), ("kWh", 1e3)],
    signed: false,
    most: 1e6,
};
const RATIO: Kind =
    Kind { what: "a ratio", example: "4 dB", units: &[("dB", 1.0)], signed: false, most: 200.0 };
const LENGTH: Kind = Kind {
    what: "a length",
    example: "5 m",
    units: &[("cm", 1e-2), ("m", 1.0), ("km", 1e3)],
    signed: false,
    most: 1e6,
};
const SPEED: Kind =
    Kind { what: "a speed", example: "0.3 m/s", units: &[("m/s", 1.0)], signed: false, most: 100.0 };
const FREQUENCY: Kind =
    Kind { what: "a frequency", example: "10 Hz", units: &[("Hz", 1.0)], signed: false, most: 1000.0 };
const DRIFT: Kind =
    Kind { what: "a drift", example: "50 ppm", units: &[("ppm", 1.0), ("%", 1e4)], signed: false, most: 1e5 };
const ANGLE: Kind = Kind {
    what: "an angle",
    example: "90 deg",
    units: &[("deg", PI / 180.0), ("rad", 1.0)],
    signed: true,
    most: 4.0 * PI,
};
const SHARE: Kind =
    Kind { what: "a share", example: "0.1 %", units: &[("%", 0.01)], signed: false, most: 1.0 };
const CORRELATION: Kind =
    Kind { what: "a correlation", example: "40 %", units: &[("%", 0.01)], signed: true, most: 1.0 };

macro_rules! quantity {
    ($type:ty, $kind:ident, $read:expr) => {
        impl Decode for $type {
            fn schema() -> Json {
                $kind.schema()
            }
            fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
                $kind.read(node, sink).map($read)
            }
        }
    };
}

// Whole nanoseconds, rounded: 0.001 ms is 1000 ns, not 999.
quantity!(Duration, DURATION, |(seconds, _)| Duration::from_nanos((seconds * 1e9).round() as u64));
quantity!(Bytes, MEMORY, |(bytes, _)| Self(bytes.round() as u64));
quantity!(Dbm, POWER, |(dbm, _)| Self(dbm));
quantity!(Decibels, RATIO, |(db, _)| Self(db));
quantity!(Metres, LENGTH, |(metres, _)| Self(metres));
quantity!(Speed, SPEED, |(speed, _)| Self(speed));
quantity!(Watts, WATTS, |(watts, _)| Self(watts));
quantity!(WattHours, ENERGY, |(watt_hours, _)| Self(watt_hours));
quantity!(Frequency, FREQUENCY, |(hertz, _)| Self(hertz));
quantity!(Drift, DRIFT, |(ppm, _)| Self(ppm));
quantity!(Angle, ANGLE, |(radians, _)| Self(radians));
quantity!(Probability, SHARE, |(share, _)| Self::new(share).expect("the kind bounds it"));
quantity!(QueueLimit, QUEUE, |(amount, unit)| {
    if QUEUE.units[unit].0.starts_with("packet") {
        Self::Packets(amount.round() as u32)
    } else {
        Self::Bytes(amount.round() as u64)
    }
});

/// The time of a plug-in's decision: a duration, `cpu`, or a multiple of it; `None` for none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DecisionTime(pub Option<DecidesIn>);

impl Decode for DecisionTime {
    fn schema() -> Json {
        json!({ "anyOf": [
            DURATION.schema(),
            { "type": "string", "pattern": "^([0-9]*\\.?[0-9]+x )?cpu$", "examples": ["cpu", "2.5x cpu"] },
        ] })
    }

    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let Some(factor) = node.plain().and_then(|text| text.strip_suffix("cpu")) else {
            return Duration::decode(node, sink).map(|time| Self(DecidesIn::fixed(time)));
        };
        let factor = match factor.trim_end() {
            "" => Some(CpuFactor::ONE),
            times => times.strip_suffix('x').and_then(|times| CpuFactor::new(times.trim_end().parse().ok()?)),
        };
        if factor.is_none() {
            expected(
                node,
                "the CPU time that a decision takes",
                &format!("write `cpu`, or a multiple up to {} such as `2.5x cpu`", CpuFactor::MOST),
                sink,
            );
        }
        factor.map(|factor| Self(Some(DecidesIn::Cpu { factor })))
    }
}

impl Decode for BitRate {
    fn schema() -> Json {
        RATE.schema()
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let (rate, _) = RATE.read(node, sink)?;
        let rate = Self::from_bits_per_second(rate.round() as u64);
        if rate.is_none() {
            sink.error(&node.span, format!("{} lets nothing pass", node.describe()))
                .help("a rate is at least 1 bit/s; to lose everything, write `loss: 100 %`");
        }
        rate
    }
}

impl Decode for Correlation {
    fn schema() -> Json {
        CORRELATION.schema()
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let (correlation, _) = CORRELATION.read(node, sink)?;
        let correlation = Self::new(correlation);
        if correlation.is_none() {
            sink.error(&node.span, format!("{} leaves nothing to chance", node.describe()))
                .help("a correlation is above -100 % and below 100 %");
        }
        correlation
    }
}

impl Decode for UdpRate {
    fn schema() -> Json {
        let mut rate = RATE.schema();
        rate["description"] = json!("A rate, or `saturated`.");
        rate["pattern"] = json!(format!("^saturated$|{}", rate["pattern"].as_str().unwrap_or_default()));
        rate
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        if node.text() == Some("saturated") {
            return Some(Self::Saturated);
        }
        if node.text().is_some_and(|text| text.starts_with(char::is_alphabetic)) {
            sink.error(&node.span, format!("{} is not a rate", node.describe()))
                .help("write it like `10 Mbit/s`, or `saturated`");
            return None;
        }
        BitRate::decode(node, sink).map(Self::Rate)
    }
}

/// MCS indices of all standards and streams.
const MOST_MCS: u8 = 31;

impl Decode for FixedRate {
    fn schema() -> Json {
        let mut rate = RATE.schema();
        let pattern = format!("^MCS [0-9]+$|{}", rate["pattern"].as_str().unwrap_or_default());
        rate["pattern"] = json!(pattern);
        rate["examples"] = json!(["MCS 7", "24 Mbit/s"]);
        rate
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        let text = node.text().unwrap_or_default();
        if let Some(number) = text.strip_prefix("MCS ") {
            let mcs = number.parse().ok().filter(|mcs| *mcs <= MOST_MCS);
            if mcs.is_none() {
                sink.error(&node.span, format!("{} is no MCS", node.describe()))
                    .help(format!("write a number from 0 to {MOST_MCS}, such as `MCS 7`"));
            }
            return mcs.map(Self::Mcs);
        }
        if split(text).1.is_empty() || text.starts_with(char::is_alphabetic) {
            sink.error(&node.span, format!("{} is no fixed rate", node.describe()))
                .help("write an MCS, such as `MCS 7`, or a rate of 802.11a and g, such as `24 Mbit/s`");
            return None;
        }
        BitRate::decode(node, sink).map(Self::BitsPerSecond)
    }
}

impl Decode for Rate {
    fn schema() -> Json {
        let mut rate = RATE.schema();
        rate["description"] = json!("A rate, or `unlimited`.");
        rate["pattern"] = json!(format!("^unlimited$|{}", rate["pattern"].as_str().unwrap_or_default()));
        rate
    }
    fn decode(node: &Node, sink: &mut Sink) -> Option<Self> {
        if node.text() == Some("unlimited") {
            return Some(Self::Unlimited);
        }
        BitRate::decode(node, sink).map(|bits_per_second| Self::Fixed { bits_per_second })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read<T: Decode>(text: &str) -> Option<T> {
        let node = Node::from_json(&Json::String(text.to_owned()));
        let mut sink = Sink::default();
        let value = T::decode(&node, &mut sink);
        assert_eq!(value.is_some(), sink.is_empty(), "{text}");
        value
    }

    #[test]
    fn figures_with_their_units() {
        assert_eq!(read("4.5 ms"), Some(Duration::from_micros(4500)));
        assert_eq!(read("4.5ms"), Some(Duration::from_micros(4500)));
        assert_eq!(read("1e-3 s"), Some(Duration::from_millis(1)));
        assert_eq!(read("0.001 ms"), Some(Duration::from_nanos(1000)));
        assert_eq!(read("3 µs"), Some(Duration::from_micros(3)));
        assert_eq!(read("10 Gbit/s"), BitRate::from_bits_per_second(10_000_000_000));
        assert_eq!(read("8 GB"), Some(Bytes(8_000_000_000)));
        assert_eq!(read("8 GiB"), Some(Bytes(8 << 30)));
        assert_eq!(read("-95 dBm"), Some(Dbm(-95.0)));
        assert_eq!(read("0.1 %"), Probability::new(0.001));
        assert_eq!(read("100 %"), Some(Probability::ONE));
        assert_eq!(read("-40 %"), Correlation::new(-0.4));
        assert_eq!(read::<Correlation>("100 %"), None);
        assert_eq!(read("180 deg"), Some(Angle(PI)));
        assert_eq!(read("250 mW"), Some(Watts(0.25)));
        assert_eq!(read("0.055 kWh"), Some(WattHours(55.0)));
        assert_eq!(read("1 packet"), Some(QueueLimit::Packets(1)));
        assert_eq!(read("64 KiB"), Some(QueueLimit::Bytes(65536)));
        assert_eq!(read("unlimited"), Some(Rate::Unlimited));
    }

    proptest! {
        #[test]
        fn durations_survive_formatting(nanos in 0_u64..86_400_000_000_000) {
            prop_assert_eq!(read(&format!("{nanos} ns")), Some(Duration::from_nanos(nanos)));
        }

        #[test]
        fn rates_survive_formatting(rate in 1_u64..1_000_000_000_000) {
            prop_assert_eq!(read(&format!("{rate} bit/s")), BitRate::from_bits_per_second(rate));
        }

        #[test]
        fn other_texts_are_not_figures(text in "\\PC{0,12}") {
            if let Some(duration) = read::<Duration>(&text) {
                prop_assert!(duration <= Duration::from_secs(86_400));
            }
            if let Some(share) = read::<Probability>(&text) {
                prop_assert!((0.0..=1.0).contains(&share.get()));
            }
            if let Some(QueueLimit::Bytes(bytes)) = read::<QueueLimit>(&text) {
                prop_assert!(bytes <= 4_000_000_000);
            }
        }
    }
}
