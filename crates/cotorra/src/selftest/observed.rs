//! Results of a run of a scene.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use cotorra_graph::{Event, LinkContext};
use cotorra_measurements::{History, Kind, PageRequest};
use cotorra_numbers::median;
use cotorra_testbed::Recorded;
use serde::Deserialize;

/// The kind of time and packets of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum World {
    /// Virtual time.
    Virtual,
    /// Real packets, in real time.
    Real,
}

/// By how much a time may be too short in either kind of time, ms: rounding, and bytes at the rates of media.
const ROUNDING_MS: f64 = 0.02;
/// By how much a service time may be too long with real packets, ms: what a run may be late and valid on the way there and on the
/// way back, and what both programs take.
const LATE_MS: f64 = 2.5;

impl World {
    /// Returns by how much a right time may be shorter and longer, ms.
    pub fn tolerance_ms(self) -> (f64, f64) {
        match self {
            Self::Virtual => (ROUNDING_MS, ROUNDING_MS),
            Self::Real => (ROUNDING_MS, LATE_MS),
        }
    }
}

/// A service time.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Time of emission, ms.
    pub emitted_ms: f64,
    /// Service time, ms; `None` without an answer.
    pub took_ms: Option<f64>,
}

/// The parts of `summary.json` that scenes check.
#[derive(Debug, Clone, Default, Deserialize)]
pub struct Report {
    #[serde(default)]
    pub handovers: Vec<Gap>,
    pub fidelity: Option<Judged>,
}

/// A handover of `summary.json`.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct Gap {
    pub gap_ms: f64,
}

/// The verdict of `summary.json`.
#[derive(Debug, Clone, Deserialize)]
pub struct Judged {
    pub valid: bool,
    pub reason: String,
}

/// Results of a run of a scene.
#[derive(Debug)]
pub struct Observed {
    pub world: World,
    /// Exit status; `None` if a signal ended it.
    pub status: Option<i32>,
    /// All samples, by emission.
    pub samples: Vec<Sample>,
    pub report: Report,
    /// Contexts of links, by time.
    pub links: Vec<LinkContext>,
    folder: PathBuf,
}

impl Observed {
    /// Reads the folder of a run.
    ///
    /// # Errors
    /// If a file is missing, or cannot be read.
    pub fn read(world: World, status: Option<i32>, folder: &Path) -> io::Result<Self> {
        let report = serde_json::from_str(&fs::read_to_string(folder.join("summary.json"))?)?;
        let samples = samples(&fs::read_to_string(folder.join("service_time.csv"))?)?;
        let links = links(folder).map_err(io::Error::other)?;
        Ok(Self { world, status, samples, report, links, folder: folder.to_owned() })
    }

    /// Returns what a VNF printed.
    pub fn log(&self, vnf: &str) -> Option<String> {
        fs::read_to_string(self.folder.join("logs/vnfs").join(format!("{vnf}.log"))).ok()
    }

    /// Returns the service times of answered samples, ms.
    pub fn answered(&self) -> Vec<f64> {
        self.samples.iter().filter_map(|sample| sample.took_ms).collect()
    }

    /// Returns the number of samples without an answer.
    pub fn unanswered(&self) -> usize {
        self.samples.iter().filter(|sample| sample.took_ms.is_none()).count()
    }

    /// Returns the median of the service times of the samples that were emitted within these milliseconds.
    pub fn median(&self, emitted_ms: std::ops::Range<f64>) -> Option<f64> {
        let within = self.samples.iter().filter(|sample| emitted_ms.contains(&sample.emitted_ms));
        median(within.filter_map(|sample| sample.took_ms).collect())
    }

    /// Returns the exit status as a figure.
    pub fn status(&self) -> Option<f64> {
        self.status.map(f64::from)
    }
}

/// Reads the samples of `service_time.csv`.
fn samples(csv: &str) -> io::Result<Vec<Sample>> {
    #[derive(Deserialize)]
    struct Row {
        emitted_ns: f64,
        // Needs the column, unlike an option without it.
        #[serde(deserialize_with = "Option::deserialize")]
        service_time_ms: Option<f64>,
    }
    let mut rows = csv::Reader::from_reader(csv.as_bytes());
    if rows.headers()?.is_empty() {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "service_time.csv has no service times"));
    }
    let sample = |row: Row| Sample { emitted_ms: row.emitted_ns / 1e6, took_ms: row.service_time_ms };
    Ok(rows.deserialize().map(|row| row.map(sample)).collect::<csv::Result<_>>()?)
}

/// Reads the contexts of all links in a run's history.
fn links(folder: &Path) -> Result<Vec<LinkContext>, Box<dyn std::error::Error + Send + Sync>> {
    let recorded = Recorded::of_folder(folder)?;
    let history = History::open(&recorded.history)?;
    let run = history.runs(None, 1)?.pop().ok_or("the history has no run")?.id;
    let (mut links, mut after) = (Vec::new(), None);
    loop {
        let request = PageRequest { limit: 10_000, after };
        let page = history.events(run, &[Kind::Link], .., request)?;
        links.extend(page.items.into_iter().filter_map(|stamped| match stamped.event {
            Event::Link(context) => Some(context),
            _ => None,
        }));
        after = page.next;
        if after.is_none() {
            return Ok(links);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_without_an_answer_have_no_time() {
        let csv = "emitted_ns,robot,service,sequence,service_time_ms,attachment,server\n\
                   8000000,robot,navigation,0,12.5,unit,edge\n9000000,robot,navigation,1,,unit,edge\n";
        let expected = [(8.0, Some(12.5)), (9.0, None)];
        let expected = expected.map(|(emitted_ms, took_ms)| Sample { emitted_ms, took_ms });
        assert_eq!(samples(csv).unwrap(), expected);
        assert!(samples("emitted_ns\n1\n").is_err());
        assert!(samples("").is_err());
    }
}
