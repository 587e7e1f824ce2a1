//! A run's folder: `runs/<name>-<time>/`, and the files in it.

use std::{
    fs::{self, File},
    io::{self, BufWriter, Write as _},
    path::{Path, PathBuf},
};

use super::{
    figure::{Panel, draw},
    summary::{Report, Summary, service_time_ms},
};

/// A file of the run's folder cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {source}", path.display())]
pub struct FolderError {
    path: PathBuf,
    source: io::Error,
}

impl FolderError {
    /// An error on a path.
    pub fn new(path: &Path, source: io::Error) -> Self {
        Self { path: path.to_owned(), source }
    }
}

/// Where a run's folder is made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// In this folder, named after the testbed and the time.
    In(PathBuf),
    /// It is this one, which does not exist yet.
    At(PathBuf),
}

impl Default for Place {
    fn default() -> Self {
        Self::In(PathBuf::from("runs"))
    }
}

impl Place {
    /// Makes the folder, and those above it; gives its absolute path.
    ///
    /// # Errors
    /// [`FolderError`] when that is not possible, or [`Place::At`] is there already.
    pub fn create(&self, name: &str) -> Result<PathBuf, FolderError> {
        let fail = |path: &Path| {
            let path = path.to_owned();
            move |source| FolderError { path, source }
        };
        let (parent, names): (_, Vec<_>) = match self {
            Self::At(path) => (path.parent().unwrap_or(Path::new("")), vec![path.clone()]),
            Self::In(parent) => {
                let time = chrono::Local::now().format("%Y%m%d-%H%M%S");
                let stem = format!("{name}-{time}");
                // Two runs within one second each get their own.
                let names = std::iter::once(stem.clone()).chain((2..1000).map(|i| format!("{stem}-{i}")));
                (&**parent, names.map(|name| parent.join(name)).collect())
            }
        };
        if !parent.as_os_str().is_empty() {
            fs::create_dir_all(parent).map_err(fail(parent))?;
        }
        let mut taken = None;
        for path in names {
            match fs::create_dir(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                    taken = Some(fail(&path)(error));
                }
                made => return made.and_then(|()| path.canonicalize()).map_err(fail(&path)),
            }
        }
        Err(taken.expect("at least one name was tried"))
    }
}

/// Writes a file whole or not at all: a reader never sees half of one.
pub fn write_file(folder: &Path, name: &str, text: &str) -> Result<(), FolderError> {
    let path = folder.join(name);
    let draft = folder.join(format!(".{name}.part"));
    fs::write(&draft, text)
        .and_then(|()| fs::rename(&draft, &path))
        // It may not be there.
        .inspect_err(|_| drop(fs::remove_file(&draft)))
        .map_err(|source| FolderError { path, source })
}

/// A run's folder.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes it and `logs/` in it, and puts the testbed file there.
    ///
    /// # Errors
    /// [`FolderError`] when that is not possible.
    pub fn create(place: &Place, name: &str, testbed_text: &str) -> Result<Self, FolderError> {
        let path = place.create(name)?;
        let logs = path.join("logs");
        fs::create_dir(&logs).map_err(|source| FolderError { path: logs, source })?;
        write_file(&path, "testbed.yaml", testbed_text)?;
        Ok(Self { path })
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

    /// Writes `summary.json`, `service_time.csv` and `service_time.svg`.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_report(&self, report: &Report, summary: &Summary) -> Result<(), FolderError> {
        let json = serde_json::to_string_pretty(summary).expect("a summary holds only what JSON can");
        write_file(&self.path, "summary.json", &(json + "\n"))?;
        let path = self.path.join("service_time.csv");
        let written = File::create(&path).and_then(|file| write_csv(report, file));
        written.map_err(|source| FolderError { path, source })?;
        let title = format!("{}: service time and attachment", summary.name);
        write_file(&self.path, "service_time.svg", &draw(&Panel::of_services(&title, report)))
    }
}

fn write_csv(report: &Report, to: File) -> io::Result<()> {
    let mut text = BufWriter::new(to);
    writeln!(text, "emitted_ns,robot,service,sequence,service_time_ms,attachment,server")?;
    for s in report.samples().iter() {
        let took = service_time_ms(&s).map(|ms| format!("{ms:.6}")).unwrap_or_default();
        let attachment = s.attachment.as_ref().map_or("", |a| a.as_str());
        let emitted = s.emitted.as_nanos();
        // Names hold no character that CSV would need to quote.
        writeln!(
            text,
            "{emitted},{},{},{},{took},{attachment},{}",
            s.robot, s.service, s.sequence, s.server
        )?;
    }
    text.flush()
}
