//! A run's folder: `runs/<name>-<time>/`, and the files in it.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    os::unix::fs::DirBuilderExt as _,
    path::{Path, PathBuf},
};

use cotorra_figure::Format;

use super::{
    figure::draw,
    folder::{FolderError, Place, SUMMARY, write_file},
    services,
    summary::{Report, Summary, service_time_ms},
};
use crate::folder::manifest::Manifest;

/// Bytes of the disk that are reserved for it at the run's start. A run that fills the disk still leaves its summary.
const SUMMARY_ROOM: usize = 256 << 10;

/// A run's folder.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Names in the folder that the run itself uses.
    pub const NAMES: [&str; 20] = [
        Self::RESERVED,
        "history.json",
        "history.sqlite",
        "history.sqlite-journal",
        "history.sqlite-shm",
        "history.sqlite-wal",
        "logs",
        Manifest::NAME,
        "recording.mcap",
        "samples",
        "sensors",
        "service_time.csv",
        "service_time.pdf",
        "service_time.png",
        "service_time.svg",
        "services.csv",
        "services.tex",
        SUMMARY,
        "twins",
        "vnfs",
    ];
    /// Name of the summary until it is written.
    pub(crate) const RESERVED: &str = ".summary.json.part";
    /// Name of the testbed file in the folder.
    pub const TESTBED: &str = "testbed.yaml";

    /// Name of the folder of the VNFs' logs among the logs. A VNF with the name of another log has its own there.
    const VNFS: &str = "vnfs";

    /// Creates the folder and its `logs/`, and writes the testbed file there.
    ///
    /// # Errors
    /// [`FolderError`] if that fails.
    pub fn create(place: &Place, name: &str, testbed_text: &str) -> Result<Self, FolderError> {
        let path = place.create(name)?;
        let logs = path.join("logs");
        // Output of programs may hold secrets.
        fs::DirBuilder::new().mode(0o700).create(&logs).map_err(|source| FolderError::new(&logs, source))?;
        let of_vnfs = logs.join(Self::VNFS);
        fs::create_dir(&of_vnfs).map_err(|source| FolderError::new(&of_vnfs, source))?;
        write_file(&path, Self::TESTBED, testbed_text)?;
        let reserved = path.join(Self::RESERVED);
        fs::write(&reserved, vec![0; SUMMARY_ROOM]).map_err(|source| FolderError::new(&reserved, source))?;
        Ok(Self { path })
    }

    /// Writes the summary into the room that is reserved for it. The file has its name only once it is whole.
    fn write_summary(&self, summary: &Summary) -> Result<(), FolderError> {
        let json = serde_json::to_string_pretty(summary).expect("a summary is valid JSON") + "\n";
        let reserved = self.path.join(Self::RESERVED);
        let write = || {
            let mut file = File::options().create(true).write(true).truncate(false).open(&reserved)?;
            file.write_all(json.as_bytes())?;
            file.set_len(json.len() as u64)?;
            file.sync_data()?;
            fs::rename(&reserved, self.path.join(SUMMARY))
        };
        write().map_err(|source| FolderError::new(&self.path.join(SUMMARY), source))
    }

    /// Returns the absolute path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of the testbed file.
    pub fn testbed(&self) -> PathBuf {
        self.path.join(Self::TESTBED)
    }

    /// Returns the path of the run's history.
    pub fn history(&self) -> PathBuf {
        self.path.join("history.sqlite")
    }

    /// Returns the folder of all logs.
    pub fn logs(&self) -> PathBuf {
        self.path.join("logs")
    }

    /// Returns the folder of the VNFs' logs.
    pub fn vnf_logs(&self) -> PathBuf {
        self.logs().join(Self::VNFS)
    }

    /// Writes `summary.json`, `services.csv`, `services.tex`, `service_time.csv` and `service_time.svg`.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_report(&self, report: &Report, summary: &Summary) -> Result<(), FolderError> {
        self.write_summary(summary)?;
        write_file(&self.path, "services.csv", services::exact(&summary.services).to_csv())?;
        write_file(&self.path, "services.tex", summary.by_service().to_latex())?;
        let path = self.path.join("service_time.csv");
        let written = File::create(&path).and_then(|file| write_samples(report, [&[], &[]], file));
        written.map_err(|source| FolderError::new(&path, source))?;
        write_figure(&self.path, report, summary, Format::Svg)
    }
}

/// Replaces the summary in the folder of a run that has ended.
///
/// # Errors
/// [`FolderError`].
pub(crate) fn rewrite_summary(folder: &Path, summary: &Summary) -> Result<(), FolderError> {
    RunFolder { path: folder.to_owned() }.write_summary(summary)
}

/// Writes the figure of a run, `service_time`, in a format.
///
/// # Errors
/// [`FolderError`].
pub fn write_figure(
    folder: &Path,
    report: &Report,
    summary: &Summary,
    format: Format,
) -> Result<(), FolderError> {
    let mark = if summary.is_valid() { "" } else { "NOT VALID: " };
    let title = format!("{mark}{}: service time and attachment", summary.name);
    let scene = draw(&title, report, &summary.robots).draw();
    write_file(folder, &format!("service_time.{format}"), scene.render(format))
}

/// Writes the service times of a run as comma-separated values. `before` are the heads and the values of columns that come
/// first.
///
/// # Errors
/// Those of writing.
pub fn write_samples(report: &Report, before: [&[String]; 2], to: impl io::Write) -> io::Result<()> {
    const HEADS: [&str; 7] =
        ["emitted_ns", "robot", "service", "sequence", "service_time_ms", "attachment", "server"];
    let mut table = csv::Writer::from_writer(to);
    let [heads, values] = before.map(|cells| cells.iter().map(String::as_str));
    table.write_record(heads.chain(HEADS))?;
    for s in report.samples().iter() {
        let took = service_time_ms(&s).map(|ms| format!("{ms:.6}")).unwrap_or_default();
        let attachment = s.attachment.as_ref().map_or("", |a| a.as_str());
        let (emitted, sequence) = (s.emitted.as_nanos().to_string(), s.sequence.to_string());
        let (robot, service, server) = (s.robot.as_str(), s.service.as_str(), s.server.as_str());
        let sample = [&*emitted, robot, service, &sequence, &took, attachment, server];
        table.write_record(values.clone().chain(sample))?;
    }
    table.flush()
}
