//! An axis of a sweep: a setting and its values.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// Highest number of values; more are surely a mistake.
const MOST: usize = 10_000;

/// A setting and its values, written `path=value,value` or `path=from..to`, where `to` is included. The step is 1 unless
/// one follows, as in `1..2:0.25`. A unit follows last, as in `5..20:5 ms`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Axis {
    text: String,
    path: String,
    values: Vec<String>,
}

/// Error of reading an axis.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidAxis {
    /// The text has no `=`, or nothing on one side of it.
    #[error("`{0}` has no values: write it like links.*.delay_scale=1..4 or plugin=probing,okpi")]
    Form(String),
    /// The steps of a range never reach its end.
    #[error("`{0}` never reaches its end: a range goes up, by a step above 0")]
    Range(String),
    /// A range has too many values.
    #[error("`{0}` has more than {MOST} values")]
    Many(String),
    /// A value appears twice.
    #[error("`{0}` appears twice")]
    Twice(String),
}

impl Axis {
    /// Returns the setting's path.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Returns the values: at least one, and no duplicates.
    pub fn values(&self) -> &[String] {
        &self.values
    }

    /// Returns the values as numbers without their unit, if all are numbers with the same unit or without one, and differ.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        let unit = |value: &str| value.split_whitespace().skip(1).collect::<String>();
        let number =
            |value: &String| value.split_whitespace().next()?.parse().ok().filter(|n: &f64| n.is_finite());
        let numbers: Vec<f64> = self.values.iter().map(number).collect::<Option<_>>()?;
        let mut sorted = numbers.clone();
        sorted.sort_by(f64::total_cmp);
        let has_one_unit = self.values.windows(2).all(|pair| unit(&pair[0]) == unit(&pair[1]));
        (has_one_unit && sorted.windows(2).all(|pair| pair[0] < pair[1])).then_some(numbers)
    }
}

impl FromStr for Axis {
    type Err = InvalidAxis;

    fn from_str(text: &str) -> Result<Self, InvalidAxis> {
        let form = || InvalidAxis::Form(text.to_owned());
        let (path, values) = text.split_once('=').ok_or_else(form)?;
        let path = path.trim().to_owned();
        let mut all = Vec::new();
        for part in split(values) {
            match range(part) {
                Some(range) => all.extend(range?),
                None => all.push(part.to_owned()),
            }
        }
        if path.is_empty() || all.iter().any(String::is_empty) {
            return Err(form());
        }
        if all.len() > MOST {
            return Err(InvalidAxis::Many(values.to_owned()));
        }
        let mut sorted: Vec<_> = all.iter().collect();
        sorted.sort();
        match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => Err(InvalidAxis::Twice(pair[0].clone())),
            None => Ok(Self { text: text.to_owned(), path, values: all }),
        }
    }
}

/// Writes the text that the axis was read from.
impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl TryFrom<String> for Axis {
    type Error = InvalidAxis;

    fn try_from(text: String) -> Result<Self, InvalidAxis> {
        text.parse()
    }
}

impl From<Axis> for String {
    fn from(axis: Axis) -> Self {
        axis.text
    }
}

/// Returns all combinations of the axes' values. The last axis changes fastest.
pub(super) fn combinations(axes: &[Axis]) -> Vec<Vec<String>> {
    axes.iter().fold(vec![Vec::new()], |before, axis| {
        let with = |values: &Vec<String>, value: &String| {
            let mut values = values.clone();
            values.push(value.clone());
            values
        };
        before.iter().flat_map(|values| axis.values().iter().map(move |value| with(values, value))).collect()
    })
}

/// Splits at commas outside brackets and quotes.
fn split(text: &str) -> Vec<&str> {
    let (mut parts, mut start, mut depth, mut quote) = (Vec::new(), 0, 0_u32, None);
    for (at, c) in text.char_indices() {
        match (c, quote) {
            (_, Some(open)) => quote = (c != open).then_some(open),
            ('"' | '\'', None) => quote = Some(c),
            ('[' | '{', None) => depth += 1,
            (']' | '}', None) => depth = depth.saturating_sub(1),
            (',', None) if depth == 0 => {
                parts.push(text[start..at].trim());
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(text[start..].trim());
    parts
}

/// Returns the values of a range; `None` if the text is no range.
fn range(text: &str) -> Option<Result<Vec<String>, InvalidAxis>> {
    let (from, rest) = text.split_once("..")?;
    let from: f64 = from.trim().parse().ok()?;
    let numeric = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | ':' | ' ');
    let (numbers, unit) = rest.split_at(rest.find(|c| !numeric(c)).unwrap_or(rest.len()));
    let (to, step) = numbers.split_once(':').unwrap_or((numbers, "1"));
    let (to, step): (f64, f64) = (to.trim().parse().ok()?, step.trim().parse().ok()?);
    let steps = ((to - from) / step + 1e-9).floor();
    if !(steps >= 0.0 && step > 0.0) {
        return Some(Err(InvalidAxis::Range(text.to_owned())));
    }
    if steps >= MOST as f64 {
        return Some(Err(InvalidAxis::Many(text.to_owned())));
    }
    let value = |i: usize| {
        // Rounded as people write it: 0.3, not 0.30000000000000004.
        let number = ((from + i as f64 * step) * 1e9).round() / 1e9;
        format!("{number} {}", unit.trim()).trim_end().to_owned()
    };
    Some(Ok((0..=steps as usize).map(value).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_lists_and_ranges() {
        for (text, expected) in [
            ("a.b=1..4", &["1", "2", "3", "4"][..]),
            ("a=0..1:0.25", &["0", "0.25", "0.5", "0.75", "1"]),
            ("a=0.1..0.4:0.1", &["0.1", "0.2", "0.3", "0.4"]),
            ("a=5..20:5 ms", &["5 ms", "10 ms", "15 ms", "20 ms"]),
            ("a=5..7ms", &["5 ms", "6 ms", "7 ms"]),
            ("a=1..4:2,9", &["1", "3", "9"]),
            ("plugin=probing, okpi", &["probing", "okpi"]),
            ("a=[1, 2],{b: 3, c: [4, 5]},'x, y'", &["[1, 2]", "{b: 3, c: [4, 5]}", "'x, y'"]),
            ("a=10 Mbit/s", &["10 Mbit/s"]),
            ("a=-2..-1", &["-2", "-1"]),
        ] {
            assert_eq!(text.parse::<Axis>().unwrap().values(), expected, "{text}");
        }
    }

    #[test]
    fn invalid_axes_are_rejected_with_the_reason() {
        for (text, said) in [
            ("a", "has no values"),
            ("=1", "has no values"),
            ("a=1,,2", "has no values"),
            ("a=4..1", "never reaches its end"),
            ("a=1..4:0", "never reaches its end"),
            ("a=1..100000", "more than"),
            ("a=1..3,2", "`2` appears twice"),
        ] {
            let wrong = text.parse::<Axis>().unwrap_err().to_string();
            assert!(wrong.contains(said), "{text}: {wrong}");
        }
    }

    #[test]
    fn numbers_may_have_units() {
        let axis = |text: &str| text.parse::<Axis>().unwrap();
        assert_eq!(axis("a=5..6 ms").numbers(), Some(vec![5.0, 6.0]));
        assert_eq!(axis("a=30 ms,20 ms,10 ms").numbers(), Some(vec![30.0, 20.0, 10.0]));
        for text in ["a=one,2", "a=30 ms,1 s", "a=1,2 ms", "a=1,1.0"] {
            assert_eq!(axis(text).numbers(), None, "{text}");
        }
    }
}
