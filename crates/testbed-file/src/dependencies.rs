//! Dependencies of a testbed file's runs: its values, and the files that it names.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

use crate::{
    carry::{Luggage, named},
    setting::noted,
    tree,
    yaml::{
        Sink,
        decode::{Node, Value},
    },
};

/// Dependencies of the results of a testbed file's runs, beside the seed and the duration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dependencies {
    /// The file's keys and values, as its settings make them. Comments and disabled plug-ins are left out.
    pub values: String,
    /// The settings that its last lines note.
    pub settings: Vec<String>,
    /// The files that it names, in order of their paths.
    pub files: Vec<Dependency>,
}

/// A file that a testbed file names.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Dependency {
    /// Its path, which starts at the testbed file's folder if it leads down from there. The folder of a run stands for the
    /// conditions in that run, which are replayed.
    pub path: PathBuf,
    /// Whether it is only named to a program, which may write to it.
    pub is_argument: bool,
}

/// Returns what runs of a testbed file in `folder` depend on. The files are those that [`carry`](crate::carry()) carries, and
/// programs and their arguments wherever they are. Keys, passwords and whatever programs open by themselves are not among
/// them.
pub fn dependencies(text: &str, folder: &Path) -> Dependencies {
    let Some(mut root) = tree(text, &mut Sink::default()) else {
        return Dependencies { values: text.to_owned(), settings: Vec::new(), files: Vec::new() };
    };
    leave_out_disabled(&mut root);
    let mut luggage = Luggage::new(folder, &[]);
    for (kind, node) in named(&root) {
        if let Some(text) = node.text() {
            luggage.pack(kind, kind.split(text).0);
        }
    }
    let below = |path: PathBuf| path.strip_prefix(folder).map(Path::to_owned).unwrap_or(path);
    let file = |(path, is_argument): (PathBuf, bool)| Dependency { path: below(path), is_argument };
    let mut values = String::new();
    write(&root, &mut values);
    let settings = noted(text).0.iter().map(ToString::to_string).collect();
    Dependencies { values, settings, files: luggage.sources.into_iter().map(file).collect() }
}

fn leave_out_disabled(root: &mut Node) {
    let Value::Mapping(entries) = &mut root.value else { return };
    for entry in entries.iter_mut().filter(|entry| entry.key == "plugins") {
        if let Value::Sequence(plugins) = &mut entry.value.value {
            plugins.retain(|plugin| plugin.get("enabled").and_then(Node::plain) != Some("false"));
        }
    }
}

/// Writes a value such that different values have different texts.
fn write(node: &Node, text: &mut String) {
    match &node.value {
        Value::Scalar { text: value, plain: true } => *text += value,
        Value::Scalar { text: value, plain: false } => {
            write!(text, "{value:?}").expect("writing into a string cannot fail");
        }
        Value::Sequence(items) => {
            text.push('[');
            for item in items {
                write(item, text);
                text.push_str(",\n");
            }
            text.push(']');
        }
        Value::Mapping(entries) => {
            text.push('{');
            for entry in entries {
                write!(text, "{:?}: ", entry.key).expect("writing into a string cannot fail");
                write(&entry.value, text);
                text.push_str(",\n");
            }
            text.push('}');
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const TEXT: &str = "name: x # a comment\nmap: maps/hall.yaml\nlinks: [{ ends: [a, b], trace: 'a.trace' }]\n\
        traffic: { t: { trace: t.csv }, p: { pcap: p.pcap } }\nplugins:\n  - { id: a, command: [python3, one.py, log.txt, absent.txt] }\n  \
        - { id: b, command: [./two], settings: { ledger: { key_store: key.json } }, enabled: false }\n";

    fn place() -> tempfile::TempDir {
        let place = tempfile::tempdir().unwrap();
        fs::create_dir(place.path().join("maps")).unwrap();
        for (name, text) in [
            ("maps/hall.yaml", "image: hall.pgm\n"),
            ("maps/hall.pgm", ""),
            ("a.trace", ""),
            ("t.csv", ""),
            ("p.pcap", ""),
            ("one.py", "import module\n"),
            ("module.py", ""),
            ("log.txt", ""),
            ("two", ""),
            ("key.json", ""),
        ] {
            fs::write(place.path().join(name), text).unwrap();
        }
        place
    }

    fn files(text: &str, folder: &Path) -> Vec<(String, bool)> {
        let file = |file: Dependency| (file.path.to_str().unwrap().to_owned(), file.is_argument);
        dependencies(text, folder).files.into_iter().map(file).collect()
    }

    #[test]
    fn runs_depend_on_named_files_and_on_modules_but_not_on_keys() {
        let place = place();
        let expected = [
            ("a.trace", false),
            ("log.txt", true),
            ("maps/hall.pgm", false),
            ("maps/hall.yaml", false),
            ("module.py", false),
            ("one.py", false),
            ("p.pcap", false),
            ("t.csv", false),
        ]
        .map(|(path, is_argument)| (path.to_owned(), is_argument));
        assert_eq!(files(TEXT, place.path()), expected);
        let chosen = crate::annotated(TEXT, &["plugin=b".parse().unwrap()]);
        let names: Vec<_> = files(&chosen, place.path()).into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["a.trace", "maps/hall.pgm", "maps/hall.yaml", "p.pcap", "t.csv", "two"]);
    }

    #[test]
    fn measured_demands_are_depended_on_and_carried() {
        let place = tempfile::tempdir().unwrap();
        fs::write(place.path().join("demand.csv"), "1.5\n").unwrap();
        let text = "services: { s: { vnfs: { v: { image: x, demand: { samples: demand.csv } } } } }\n";
        assert_eq!(files(text, place.path()), [("demand.csv".to_owned(), false)]);
        let carried = crate::carry(text, place.path(), &[]);
        let to: Vec<_> = carried.files.iter().map(|file| file.to.to_str().unwrap()).collect();
        assert_eq!((carried.text.as_str(), to), (text, vec!["demand.csv"]));
    }

    #[test]
    fn programs_elsewhere_count_by_their_whole_path() {
        let place = place();
        let bed = place.path().join("maps");
        let text = format!("plugins: [{{ id: a, command: [{}/two] }}]\n", place.path().display());
        assert_eq!(files(&text, &bed), [(format!("{}/two", place.path().display()), false)]);
    }

    #[test]
    fn only_values_that_a_run_uses_change_the_text() {
        let values = |text: &str| dependencies(text, Path::new("nowhere")).values;
        let same =
            TEXT.replace("# a comment", "").replace("name: x", "name:   x").replace("./two", "./three");
        assert_eq!(values(&same), values(TEXT));
        for (old, new) in
            [("name: x", "name: y"), ("name: x", "name: 'x'"), ("absent.txt", "b.txt"), ("[a, b]", "[b, a]")]
        {
            assert_ne!(values(&TEXT.replace(old, new)), values(TEXT), "{new}");
        }
        let set = |setting: &str| values(&crate::annotated(TEXT, &[setting.parse().unwrap()]));
        assert_ne!(set("plugin=a"), set("plugin=b"));
        assert_eq!(set("name=x"), values(TEXT));
    }
}
