//! Reading of testbed files, and display of their mistakes in place.

use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use cotorra_graph::{NodeKind, OccupancyGrid, Position, Testbed};
use cotorra_testbed_file::{Diagnostics, Setting, map_server};
use miette::{LabeledSpan, NamedSource, Severity};

use crate::words::count;

/// A valid testbed file, and its text with the settings noted in it.
#[derive(Debug)]
pub struct Loaded {
    pub testbed: Testbed,
    pub text: String,
    /// Checks to make before its results are trusted.
    pub warnings: Vec<Mistake>,
}

impl Loaded {
    /// Shows the warnings on standard error, each in its place.
    pub fn warn(&self) {
        self.warnings.iter().for_each(|warning| note!("{:?}", warning.report()));
    }
}

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum FileError {
    #[error("cannot read {}: {reason}", path.display())]
    #[diagnostic(help("{}", help_for(path)))]
    Unreadable { path: PathBuf, reason: std::io::Error },
    #[error("{name} has {}", count(mistakes.len(), "mistake"))]
    Wrong { name: String, mistakes: Vec<Mistake> },
}

/// Maximum number of files that the help lists.
const LISTED: usize = 8;

/// Returns what to name instead of a path that cannot be read.
fn help_for(path: &Path) -> String {
    let Ok(folder) = fs::read_dir(path) else {
        return "the testbeds that ship with cotorra are in testbeds/".to_owned();
    };
    let names = folder.flatten().map(|file| file.file_name().to_string_lossy().into_owned());
    let mut files: Vec<_> = names.filter(|name| name.ends_with(".yaml")).collect();
    files.sort();
    files.truncate(LISTED);
    match &files[..] {
        [] => "it is a folder: name a testbed file".to_owned(),
        files => format!("it is a folder: name a file in it, such as {}", files.join(", ")),
    }
}

impl FileError {
    /// Shows the error on standard error, every mistake in its place.
    pub fn show(self) {
        if let Self::Wrong { name, mistakes } = self {
            let all = count(mistakes.len(), "mistake");
            mistakes.iter().for_each(|mistake| note!("{:?}", mistake.report()));
            note!("{name} has {all}");
        } else {
            note!("{:?}", miette::Report::new(self));
        }
    }
}

/// Reads a testbed file, applies settings, and checks the result.
pub fn load(path: &Path, settings: &[Setting]) -> Result<Loaded, FileError> {
    let text = cotorra_testbed_file::read(path)
        .map_err(|reason| FileError::Unreadable { path: path.to_owned(), reason })?;
    let base = path.parent().unwrap_or(Path::new(""));
    match cotorra_testbed_file::parse_with_warnings(&path.display().to_string(), &text, base, settings) {
        Ok((testbed, warnings)) => Ok(Loaded {
            testbed,
            text: cotorra_testbed_file::annotated(&text, settings),
            warnings: warnings.map(|found| Mistake::all(found, Severity::Warning)).unwrap_or_default(),
        }),
        Err(found) => Err(found.into()),
    }
}

/// Reads a map of map_server, and shows its warnings on standard error.
pub fn load_map(path: &Path) -> Result<OccupancyGrid, FileError> {
    let (map, warnings) = map_server::load_with_warnings(path)?;
    let warnings = warnings.map(|found| Mistake::all(found, Severity::Warning)).unwrap_or_default();
    warnings.iter().for_each(|warning| note!("{:?}", warning.report()));
    Ok(map)
}

/// A mistake, or a warning, with the source text to show it in.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{message}")]
pub struct Mistake {
    message: String,
    severity: Severity,
    found: cotorra_testbed_file::Diagnostic,
    /// `None` if lines are too long to show.
    source_code: Option<Arc<NamedSource<String>>>,
}

impl miette::Diagnostic for Mistake {
    fn severity(&self) -> Option<Severity> {
        Some(self.severity)
    }

    fn help(&self) -> Option<Box<dyn std::fmt::Display + '_>> {
        self.found.help.as_ref().map(|help| Box::new(help) as _)
    }

    fn source_code(&self) -> Option<&dyn miette::SourceCode> {
        self.source_code.as_ref().map(|source| source as _)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        self.source_code.as_ref()?;
        let label = if self.found.label.is_empty() { "here" } else { &self.found.label };
        let span = LabeledSpan::new_with_span(Some(label.to_owned()), self.found.span.clone());
        Some(Box::new(std::iter::once(span)))
    }
}

impl Mistake {
    fn all(found: Diagnostics, severity: Severity) -> Vec<Self> {
        let name = found.source_name.clone();
        let source_code = found
            .can_be_shown_in_place()
            .then(|| Arc::new(NamedSource::new(&found.source_name, found.source_text).with_language("YAML")));
        let mistake = |found: cotorra_testbed_file::Diagnostic| Self {
            message: match source_code {
                Some(_) => found.message.clone(),
                None => format!("{name}:{}:{}: {}", found.line, found.column, found.message),
            },
            found,
            severity,
            source_code: source_code.clone(),
        };
        found.list.into_iter().map(mistake).collect()
    }

    fn report(&self) -> miette::Report {
        miette::Report::new(self.clone())
    }
}

impl From<Diagnostics> for FileError {
    fn from(found: Diagnostics) -> Self {
        Self::Wrong { name: found.source_name.clone(), mistakes: Mistake::all(found, Severity::Error) }
    }
}

/// Summarises a testbed in one line.
pub fn overview(testbed: &Testbed) -> String {
    let graph = &testbed.graph;
    let of = |is_one: fn(&NodeKind) -> bool| graph.nodes.iter().filter(|node| is_one(&node.kind)).count();
    let nodes = [
        (graph.robots().count(), "robot"),
        (graph.radio_units().count(), "radio unit"),
        (of(|kind| matches!(kind, NodeKind::Switch)), "switch"),
        (graph.servers().count(), "server"),
        (graph.gateways().count(), "gateway"),
        (of(|kind| matches!(kind, NodeKind::Machine(_))), "real machine"),
        (graph.links.len(), "link"),
    ];
    let real = graph.real_servers().count();
    let described = |(n, what): &(usize, &str)| match *what {
        "server" if real > 0 => format!("{} ({real} real)", count(*n, what)),
        _ => count(*n, what),
    };
    let mut text = nodes.iter().filter(|(n, _)| *n > 0).map(described).collect::<Vec<_>>().join(", ");
    let vnfs: usize = testbed.services.iter().map(|s| s.vnfs.len()).sum();
    if !testbed.services.is_empty() {
        let add = write!(text, "; {} of {}", count(testbed.services.len(), "service"), count(vnfs, "VNF"));
        add.expect("writing into a string cannot fail");
    }
    let walked: f64 = testbed.walks.iter().map(|walk| length(&walk.waypoints)).sum();
    if walked > 0.0 {
        let add = write!(text, "; {} of {walked:.0} m", count(testbed.walks.len(), "walk"));
        add.expect("writing into a string cannot fail");
    }
    if let Some(border) = &testbed.border {
        text += &format!("; a border at {} for {}", border.address, count(border.visitors.len(), "visitor"));
    }
    if !testbed.plugins.is_empty() {
        let names: Vec<_> = testbed.plugins.iter().map(|plugin| plugin.id.as_str()).collect();
        text += &format!("; plug-ins: {}", names.join(", "));
    }
    text
}

/// Returns the length of a walk in metres.
pub fn length(waypoints: &[Position]) -> f64 {
    waypoints.windows(2).map(|leg| leg[0].distance(leg[1])).sum()
}

/// Parses the testbed file of a recorded run, with a further setting.
pub fn recorded(
    text: &str,
    run: &str,
    base: &Path,
    setting: Option<Setting>,
) -> Result<Testbed, Diagnostics> {
    cotorra_testbed_file::parse_with(&format!("the testbed file of {run}"), text, base, setting.as_slice())
}

#[cfg(test)]
mod tests {
    use miette::Diagnostic;

    use super::*;

    #[test]
    fn a_folder_instead_of_a_file_lists_the_testbeds_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let help = || load(folder.path(), &[]).unwrap_err().help().unwrap().to_string();
        assert_eq!(help(), "it is a folder: name a testbed file");
        for name in ["walk.yaml", "drive.yaml", "notes.txt"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        assert_eq!(help(), "it is a folder: name a file in it, such as drive.yaml, walk.yaml");
    }
}
