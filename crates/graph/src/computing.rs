//! Computing as a resource: the CPU time that requests to a VNF take, and the order in which it serves them.

use std::{sync::Arc, time::Duration};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

use crate::units::millis;

/// How a VNF computes its answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Computing {
    /// CPU time that each request takes, on a CPU of speed 1.
    pub demand: Demand,
    /// CPU time for each kilobyte of a request beside that.
    #[serde(rename = "per_kb_ms", with = "millis", default)]
    #[schema(value_type = f64)]
    pub per_kb: Duration,
    /// The order in which it serves requests.
    pub scheduling: Scheduling,
    /// Most requests that wait or are served at a time. One more is dropped.
    pub backlog: u32,
    /// What the first requests after a start cost more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_up: Option<WarmUp>,
}

impl Computing {
    /// The usual backlog.
    pub const BACKLOG: u32 = 1000;
}

/// Distribution of the CPU time of a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Demand {
    /// The same for all.
    Constant {
        /// The time.
        #[serde(rename = "time_ms", with = "millis")]
        #[schema(value_type = f64)]
        time: Duration,
    },
    /// Exponential.
    Exponential {
        /// The mean, above 0.
        #[serde(rename = "mean_ms", with = "millis")]
        #[schema(value_type = f64)]
        mean: Duration,
    },
    /// Lognormal.
    Lognormal {
        /// The median, above 0.
        #[serde(rename = "p50_ms", with = "millis")]
        #[schema(value_type = f64)]
        median: Duration,
        /// The 95th percentile, not below the median.
        #[serde(rename = "p95_ms", with = "millis")]
        #[schema(value_type = f64)]
        p95: Duration,
    },
    /// Uniform.
    Uniform {
        /// The least.
        #[serde(rename = "least_ms", with = "millis")]
        #[schema(value_type = f64)]
        least: Duration,
        /// The greatest, not below the least.
        #[serde(rename = "greatest_ms", with = "millis")]
        #[schema(value_type = f64)]
        greatest: Duration,
    },
    /// Measured times, of which each request draws one.
    Samples {
        /// The times.
        #[serde(rename = "times_ms")]
        samples: MeasuredTimes,
    },
}

/// Measured times, at least one and at most [`Self::MOST`]. Copies share them.
#[derive(Debug, Clone, PartialEq, Eq, utoipa::ToSchema)]
#[schema(value_type = Vec<f64>)]
pub struct MeasuredTimes(Arc<[Duration]>);

/// Error in measured times.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidMeasuredTimes {
    /// No time, or too many.
    #[error("there are {0} times, and 1 to {most} are allowed", most = MeasuredTimes::MOST)]
    Number(usize),
    /// A line that is no time.
    #[error("line {line}: `{text}` is not a time in milliseconds, from 0 to 3600000")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// Its text.
        text: String,
    },
}

impl MeasuredTimes {
    /// Highest number of times.
    pub const MOST: usize = 1_000_000;

    /// Returns these times.
    ///
    /// # Errors
    /// [`InvalidMeasuredTimes::Number`].
    pub fn new(times: Vec<Duration>) -> Result<Self, InvalidMeasuredTimes> {
        match times.len() {
            1..=Self::MOST => Ok(Self(times.into())),
            other => Err(InvalidMeasuredTimes::Number(other)),
        }
    }

    /// Reads a time in milliseconds from the first column of each line. A first line that is no number is a header; empty
    /// lines are skipped.
    ///
    /// # Errors
    /// [`InvalidMeasuredTimes`].
    pub fn parse(text: &str) -> Result<Self, InvalidMeasuredTimes> {
        let mut times = Vec::new();
        for (at, line) in text.lines().enumerate() {
            let column = line.split(',').next().unwrap_or_default().trim().trim_matches('"');
            if column.is_empty() {
                continue;
            }
            match column.parse::<f64>() {
                Ok(ms) if (0.0..=3_600_000.0).contains(&ms) => {
                    times.push(Duration::from_nanos((ms * 1e6).round() as u64));
                }
                Err(_) if at == 0 => {}
                _ => {
                    let text = column.chars().take(40).collect();
                    return Err(InvalidMeasuredTimes::Line { line: at + 1, text });
                }
            }
        }
        Self::new(times)
    }

    /// Returns the times.
    pub fn times(&self) -> &[Duration] {
        &self.0
    }
}

impl Serialize for MeasuredTimes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|time| millis::of(*time)))
    }
}

impl<'de> Deserialize<'de> for MeasuredTimes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let ms = Vec::<f64>::deserialize(deserializer)?;
        let time = |ms: f64| {
            let is_time = (0.0..=3_600_000.0).contains(&ms);
            is_time.then(|| Duration::from_nanos((ms * 1e6).round() as u64))
        };
        let times: Option<Vec<_>> = ms.into_iter().map(time).collect();
        Self::new(times.ok_or_else(|| D::Error::custom("a time is from 0 to 3600000 ms"))?)
            .map_err(D::Error::custom)
    }
}

/// The order in which a VNF serves requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scheduling {
    /// In the order of their arrival.
    Fifo {
        /// Number of requests that it serves at a time, 1 or more.
        workers: u32,
    },
    /// All at once: they share the VNF's CPUs evenly.
    Shared,
}

impl Default for Scheduling {
    fn default() -> Self {
        Self::Fifo { workers: 1 }
    }
}

/// What the first requests after a start of a VNF cost more.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WarmUp {
    /// Their number.
    pub requests: u32,
    /// Factor of their demand, 0 or more.
    pub factor: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_times_are_read_with_and_without_a_header() {
        for text in ["3\n0.25\n", "time_ms,robot\n3,a\n\n0.25,b\n", "\"time_ms\"\r\n\"3\"\r\n0.25"] {
            let times = MeasuredTimes::parse(text).unwrap();
            assert_eq!(times.times(), [Duration::from_millis(3), Duration::from_micros(250)], "{text}");
        }
        for (text, error) in [
            ("", "there are 0 times, and 1 to 1000000 are allowed"),
            ("ms\n", "there are 0 times, and 1 to 1000000 are allowed"),
            ("1\nx\n", "line 2: `x` is not a time in milliseconds, from 0 to 3600000"),
            ("-1\n", "line 1: `-1` is not a time in milliseconds, from 0 to 3600000"),
            ("1\nNaN\n", "line 2: `NaN` is not a time in milliseconds, from 0 to 3600000"),
        ] {
            assert_eq!(MeasuredTimes::parse(text).unwrap_err().to_string(), error);
        }
    }

    #[test]
    fn computing_survives_json() {
        let samples = MeasuredTimes::parse("1\n2.5\n").unwrap();
        for (demand, json) in [
            (Demand::Samples { samples }, r#"{"samples":{"times_ms":[1.0,2.5]}}"#),
            (Demand::Exponential { mean: Duration::from_millis(3) }, r#"{"exponential":{"mean_ms":3.0}}"#),
        ] {
            let computing = Computing {
                demand,
                per_kb: Duration::from_micros(10),
                scheduling: Scheduling::Fifo { workers: 2 },
                backlog: Computing::BACKLOG,
                warm_up: Some(WarmUp { requests: 50, factor: 3.0 }),
            };
            let text = serde_json::to_string(&computing).unwrap();
            assert!(text.starts_with(&format!(r#"{{"demand":{json},"per_kb_ms":0.01,"#)), "{text}");
            assert_eq!(serde_json::from_str::<Computing>(&text).unwrap(), computing);
        }
        let wrong = r#"{"samples":{"times_ms":[-1.0]}}"#;
        assert!(serde_json::from_str::<Demand>(wrong).is_err());
    }
}
