//! Requests of bundled VNFs with a demand. Their programs report each arrival and each answer in a line of their standard
//! output, so that the figures are complete however an instance ends.

use std::{fmt, str::FromStr, time::Duration};

use cotorra_graph::{NodeId, VnfId};
use cotorra_numbers::Gathered;

/// First word of a line.
const WORD: &str = "request";

/// A line that a program reports of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequestLine {
    /// One arrived, and will be answered.
    Arrived,
    /// One arrived, and was dropped, because the backlog was full.
    Dropped,
    /// One was answered.
    Served {
        /// CPU time that it took.
        cpu_time: Duration,
        /// Rest of the time since it arrived.
        waiting: Duration,
    },
}

impl fmt::Display for RequestLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Arrived => write!(f, "{WORD} arrived"),
            Self::Dropped => write!(f, "{WORD} dropped"),
            Self::Served { cpu_time, waiting } => {
                write!(f, "{WORD} served {} {}", cpu_time.as_nanos(), waiting.as_nanos())
            }
        }
    }
}

/// A line that is none of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not a line of a request")]
pub struct NoRequestLine;

impl FromStr for RequestLine {
    type Err = NoRequestLine;

    fn from_str(line: &str) -> Result<Self, NoRequestLine> {
        let mut words = line.split(' ');
        if words.next() != Some(WORD) {
            return Err(NoRequestLine);
        }
        let event = words.next();
        let mut time = || Some(Duration::from_nanos(words.next()?.parse().ok()?));
        let line = match event {
            Some("arrived") => Some(Self::Arrived),
            Some("dropped") => Some(Self::Dropped),
            Some("served") => {
                time().zip(time()).map(|(cpu_time, waiting)| Self::Served { cpu_time, waiting })
            }
            _ => None,
        };
        line.filter(|_| words.next().is_none()).ok_or(NoRequestLine)
    }
}

/// What the instances of a VNF on a node computed so far.
#[derive(Debug, Clone)]
pub struct VnfComputed {
    pub vnf: VnfId,
    /// The node that they ran on.
    pub node: NodeId,
    /// Most CPUs that an instance uses.
    pub limit: f64,
    /// Time for which instances served there.
    pub ran: Duration,
    pub requests: Requests,
}

/// Requests of a VNF's instances on a node so far.
#[derive(Debug, Clone, Default)]
pub struct Requests {
    /// Requests that arrived.
    pub arrived: u64,
    /// Requests that were answered.
    pub served: u64,
    /// Requests that were dropped, because the backlog was full.
    pub dropped: u64,
    /// Requests that an instance had when it ended.
    pub lost: u64,
    /// Most requests that were with an instance at a time.
    pub most: u32,
    /// CPU time of the answered ones.
    pub cpu_time: Duration,
    /// Waits of the answered ones.
    pub waited: Duration,
    /// Each of these, ms.
    pub waiting_ms: Gathered,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn lines_are_read_as_they_are_written() {
        let served = RequestLine::Served { cpu_time: us(5000), waiting: us(1) };
        for line in [RequestLine::Arrived, RequestLine::Dropped, served] {
            assert_eq!(line.to_string().parse(), Ok(line));
        }
        for other in [
            "",
            "ready",
            "request",
            "request gone",
            "request arrived 1",
            "request served 1",
            "request served 1 x",
        ] {
            assert_eq!(other.parse::<RequestLine>(), Err(NoRequestLine), "{other}");
        }
    }
}
