//! A run's folder: `runs/<name>-<time>/`, and the files in it.

use std::{
    fmt::Write as _,
    fs, io,
    path::{Path, PathBuf},
};

use super::{
    figure::{Panel, draw},
    summary::{Report, Summary, took_ms},
};

/// A file of the run's folder cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {source}", path.display())]
pub struct FolderError {
    path: PathBuf,
    source: io::Error,
}

/// A run's folder.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes `<parent>/<name>-<local time>/` and `logs/` in it, and puts the testbed file there.
    ///
    /// # Errors
    /// [`FolderError`] when that is not possible.
    pub fn create(parent: &Path, name: &str, testbed_text: &str) -> Result<Self, FolderError> {
        let time = jiff::Zoned::now().strftime("%Y%m%d-%H%M%S");
        let stem = format!("{name}-{time}");
        let fail = |path: &Path| {
            let path = path.to_owned();
            move |source| FolderError { path, source }
        };
        fs::create_dir_all(parent).map_err(fail(parent))?;
        // Two runs within one second each get their own.
        let names = std::iter::once(stem.clone()).chain((2..1000).map(|i| format!("{stem}-{i}")));
        for path in names.map(|name| parent.join(name)) {
            match fs::create_dir(&path) {
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => continue,
                made => made.map_err(fail(&path))?,
            }
            let path = path.canonicalize().map_err(fail(&path))?;
            fs::create_dir(path.join("logs")).map_err(fail(&path))?;
            let folder = Self { path };
            folder.write("testbed.yaml", testbed_text)?;
            return Ok(folder);
        }
        Err(fail(parent)(io::Error::other("1000 runs began within this second")))
    }

    /// Where it is; absolute.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The run's history.
    pub fn history(&self) -> PathBuf {
        self.path.join("history.sqlite")
    }

    /// The VNFs' and plug-ins' logs.
    pub fn logs(&self) -> PathBuf {
        self.path.join("logs")
    }

    fn write(&self, name: &str, text: &str) -> Result<(), FolderError> {
        let path = self.path.join(name);
        // Whole or not at all: a reader never sees half a summary.
        let draft = self.path.join(format!(".{name}.part"));
        fs::write(&draft, text)
            .and_then(|()| fs::rename(&draft, &path))
            .map_err(|source| FolderError { path, source })
    }

    /// Writes `summary.json`, `service_time.csv` and `service_time.svg`.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_report(&self, report: &Report, summary: &Summary) -> Result<(), FolderError> {
        let json = serde_json::to_string_pretty(summary).expect("a summary holds only what JSON can");
        self.write("summary.json", &(json + "\n"))?;
        self.write("service_time.csv", &csv(report))?;
        let panel = Panel {
            title: format!("{}: service time and attachment", summary.name),
            samples: report.samples(),
            regions: report.regions(),
            target_ms: report.target_ms(),
        };
        self.write("service_time.svg", &draw(&[panel]))
    }
}

fn csv(report: &Report) -> String {
    let mut text = String::from("emitted_s,robot,service,sequence,service_time_ms,attachment,server\n");
    let mut samples: Vec<_> = report.samples().iter().collect();
    samples.sort_by_key(|s| s.emitted);
    for s in samples {
        let took = took_ms(s).map(|ms| format!("{ms:.6}")).unwrap_or_default();
        let attachment = s.attachment.as_ref().map_or("", |a| a.as_str());
        let emitted = s.emitted.as_secs_f64();
        // Names hold no character that CSV would need to quote.
        writeln!(
            text,
            "{emitted:.9},{},{},{},{took},{attachment},{}",
            s.robot, s.service, s.sequence, s.server
        )
        .expect("writing into a string cannot fail");
    }
    text
}
