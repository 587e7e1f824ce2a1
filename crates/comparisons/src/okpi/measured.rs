//! A measured walk: its service times, from a file with seconds and milliseconds.

use std::{io, path::Path};

use cotorra_calibrate::{CsvRow, csv_rows};

use super::{CONTENDERS, Contender, times::Timed};

/// Maximum number of samples of a measured walk.
pub const MAX_ROWS: usize = 100_000;
/// Latest time of a sample, seconds: a day.
const LATEST_S: f64 = 86_400.0;
/// Longest service time, ms: a minute.
const LONGEST_MS: f64 = 60_000.0;

/// The file of a measured walk is no such file.
#[derive(Debug, thiserror::Error)]
pub enum MeasuredError {
    #[error("it cannot be read: {0}")]
    Unreadable(#[from] io::Error),
    /// A line is wrong.
    #[error("line {line}: {reason}")]
    Line {
        /// From 1.
        line: usize,
        reason: String,
    },
    /// A half of the walk has no answered sample.
    #[error("the {0} half of the walk has no service time: a walk needs some in both halves")]
    EmptyHalf(&'static str),
}

/// A measured walk.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    contender: Option<Contender>,
    samples: Vec<Timed>,
}

impl Measured {
    /// Reads a measured walk of a contender, or of no contender.
    ///
    /// # Errors
    /// [`MeasuredError`], also if the file has more than 32 MiB.
    pub fn read(path: &Path, contender: Option<Contender>) -> Result<Self, MeasuredError> {
        Self::parse(&cotorra_testbed_file::read(path)?, contender)
    }

    /// Parses CSV with a line for each sample: seconds since the walk began and the service time in milliseconds. Without an
    /// answer, the service time is empty. The first line can be a head.
    ///
    /// # Errors
    /// [`MeasuredError::Line`] or [`MeasuredError::EmptyHalf`].
    pub fn parse(text: &str, contender: Option<Contender>) -> Result<Self, MeasuredError> {
        let mut samples: Vec<Timed> = Vec::new();
        let mut may_be_head = true;
        for row in csv_rows(text) {
            if std::mem::take(&mut may_be_head) && is_head(&row) {
                continue;
            }
            let wrong = |reason| MeasuredError::Line { line: row.line, reason };
            let sample = sample(&row).map_err(wrong)?;
            if let Some(last) = samples.last().filter(|last| last.at_s > sample.at_s) {
                return Err(wrong(format!(
                    "{} s is before {} s of the sample above",
                    sample.at_s, last.at_s
                )));
            }
            if samples.len() == MAX_ROWS {
                return Err(wrong(format!("a walk has at most {MAX_ROWS} samples")));
            }
            samples.push(sample);
        }
        for (half, name) in super::times::halves(&samples).into_iter().zip(["first", "second"]) {
            if half.iter().all(|sample| sample.ms.is_none()) {
                return Err(MeasuredError::EmptyHalf(name));
            }
        }
        Ok(Self { contender, samples })
    }

    /// Whether it is drawn beside a contender's walk: beside its own, or beside both if it has none.
    pub(super) fn is_beside(&self, contender: &Contender) -> bool {
        self.contender.is_none_or(|its| its == *contender)
    }

    /// Returns its samples, of which there is one with an answer in each half.
    pub(super) fn samples(&self) -> &[Timed] {
        &self.samples
    }
}

impl Contender {
    /// Returns the contender of this name, in any case.
    pub fn named(name: &str) -> Option<Self> {
        CONTENDERS.into_iter().find(|contender| contender.name.eq_ignore_ascii_case(name))
    }
}

/// Whether a row has the names of columns, i.e. no number.
fn is_head(row: &CsvRow) -> bool {
    row.cells().all(|field| !field.is_empty() && field.parse::<f64>().is_err())
}

fn sample(row: &CsvRow) -> Result<Timed, String> {
    let fields: Vec<_> = row.cells().collect();
    let [seconds, ms] = fields[..] else {
        return Err(format!(
            "it has {} columns; write seconds and milliseconds, as in 12.0,10.4",
            fields.len()
        ));
    };
    let at_s = number(seconds, "seconds since the walk began", 0.0..=LATEST_S)?;
    let ms = if ms.is_empty() {
        None
    } else {
        Some(number(ms, "a service time in milliseconds", f64::MIN_POSITIVE..=LONGEST_MS)?)
    };
    Ok(Timed { at_s, ms })
}

fn number(text: &str, what: &str, range: std::ops::RangeInclusive<f64>) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| range.contains(number));
    number.ok_or_else(|| {
        // The least service time is any above 0.
        let from = if *range.start() > 0.0 { "above 0" } else { "from 0" };
        let shown: String = text.chars().take(40).collect();
        format!("`{shown}` is not {what}, {from} to {}", range.end())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        Measured::parse(text, None).unwrap_err().to_string()
    }

    #[test]
    fn a_walk_has_seconds_and_milliseconds_with_or_without_a_head() {
        let rows = "0,11.2\n1.0, 10.9\r\n2,\n\n3,152\n";
        let plain = Measured::parse(rows, None).unwrap();
        let ms: Vec<_> = plain.samples().iter().map(|sample| (sample.at_s, sample.ms)).collect();
        assert_eq!(ms, [(0.0, Some(11.2)), (1.0, Some(10.9)), (2.0, None), (3.0, Some(152.0))]);
        for head in
            ["seconds,milliseconds\n", "\u{feff}t,ms\n", "\ntime (s),service time (ms)\n", "\"t\",\"ms\"\n"]
        {
            assert_eq!(Measured::parse(&format!("{head}{rows}"), None).unwrap(), plain, "{head}");
        }
        let quoted = "\"0\",\"11.2\"\n\"1.0\",10.9\n2,\"\"\n3,\"152\"\n";
        assert_eq!(Measured::parse(quoted, None).unwrap(), plain);
    }

    #[test]
    fn a_wrong_line_is_rejected_with_its_number() {
        for (text, expected) in [
            ("0,11\n1,soon\n", "line 2: `soon` is not a service time in milliseconds, above 0 to 60000"),
            ("t,ms\n0,11\n\nt,ms\n", "line 4: `t` is not seconds since the walk began, from 0 to 86400"),
            ("0,11\n1\n", "line 2: it has 1 columns"),
            ("0,11,R1\n", "line 1: it has 3 columns"),
            ("5,11\n4,11\n", "line 2: 4 s is before 5 s of the sample above"),
            ("0,0\n", "line 1: `0` is not"),
            ("0,NaN\n", "line 1: `NaN` is not"),
            ("1600000000,11\n", "line 1: `1600000000` is not seconds since the walk began"),
        ] {
            let error = error(text);
            assert!(error.starts_with(expected), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_walk_needs_answers_in_both_halves() {
        for (text, half) in
            [("", "first"), ("t,ms\n", "first"), ("0,11\n9,\n", "second"), ("0,\n9,11\n", "first")]
        {
            assert!(error(text).starts_with(&format!("the {half} half")), "{text:?}: {}", error(text));
        }
    }

    #[test]
    fn the_number_of_samples_is_bounded() {
        let rows = |count| "1,1\n".repeat(count);
        assert_eq!(
            error(&("0,1\n".to_owned() + &rows(MAX_ROWS))),
            "line 100001: a walk has at most 100000 samples"
        );
        Measured::parse(&("0,1\n".to_owned() + &rows(MAX_ROWS - 1)), None).unwrap();
    }

    #[test]
    fn a_walk_is_drawn_beside_its_contender_or_beside_both() {
        let of = |contender| Measured::parse("0,1\n1,1\n", contender).unwrap();
        let beside = |contender| CONTENDERS.map(|other| of(contender).is_beside(&other));
        assert_eq!(beside(None), [true, true]);
        assert_eq!(beside(Contender::named("soa")), [true, false]);
        assert_eq!(beside(Contender::named("OKPI")), [false, true]);
        assert_eq!(Contender::named("probing"), None);
    }
}
