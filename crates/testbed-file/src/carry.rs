//! Copies of testbed files that hold what they name. It finds the files, chooses their places beside the copy, and changes
//! only the paths that would lead elsewhere.

use std::{
    collections::BTreeMap,
    ffi::OsStr,
    fs,
    ops::Range,
    path::{Component, Path, PathBuf},
};

use crate::{
    file,
    map_server::image_of,
    tree,
    yaml::{Sink, decode::Node},
};

/// Folder of files from outside the testbed file's folder.
const OTHERS: &str = "files";

/// A testbed file for another folder, and the files that belong beside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Carried {
    /// The text, whose relative paths start at the new folder.
    pub text: String,
    /// Map, traces, recorded conditions, and programs of commands.
    pub files: Vec<CarriedFile>,
}

/// A file that a testbed file names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CarriedFile {
    /// Path from the new folder.
    pub to: PathBuf,
    /// What is to be there.
    pub contents: Contents,
}

/// Contents of a carried file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Contents {
    /// A copy of this file.
    Copy(PathBuf),
    /// This text.
    Text(String),
    /// The conditions of links in the recorded run of this folder.
    Conditions(PathBuf),
}

/// Carries a testbed file that stands in `folder`, and the files that it names, to another folder, in which the names in
/// `taken` are not free. Keeps relative paths that do not lead out of the folder. Commands keep absolute paths, because those
/// are of programs of the machine. A file that cannot be parsed stays as it is.
pub fn carry(text: &str, folder: &Path, taken: &[&str]) -> Carried {
    let mut sink = Sink::default();
    let Some(root) = tree(text, &mut sink) else {
        return Carried { text: text.to_owned(), files: Vec::new() };
    };
    let mut luggage = Luggage { folder, taken, files: BTreeMap::new() };
    let mut changes = Changes::default();
    for (kind, node) in named(&root) {
        let Some(name) = node.text() else { continue };
        if let Some(to) = luggage.pack(kind, name)
            && to != Path::new(name)
        {
            changes.replace(&node.span, name, &to);
        }
    }
    let files = luggage.files.into_iter().map(|(to, contents)| CarriedFile { to, contents });
    Carried { text: changes.apply(text), files: files.collect() }
}

/// Kind of a named file.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Map,
    Trace,
    Conditions,
    /// A word of a command, which may name a file.
    Word,
}

/// Returns all values that name files.
fn named(root: &Node) -> Vec<(Kind, &Node)> {
    let map = root.get("map").map(|node| (Kind::Map, node));
    let replay = root.get("conditions").and_then(|its| its.get("replay"));
    let links = root.get("links").into_iter().flat_map(Node::items);
    let directions = |link| [Some(link), Node::get(link, "forward"), Node::get(link, "backward")];
    let of_links = links.flat_map(directions).flatten();
    let of_schedule = root.get("schedule").into_iter().flat_map(Node::items).filter_map(|its| its.get("set"));
    let traces = of_links.chain(of_schedule).filter_map(|its| its.get("trace"));
    let services = root.get("services").into_iter().flat_map(Node::items);
    let vnfs = services.filter_map(|its| its.get("vnfs")).flat_map(Node::items);
    let plugins = root.get("plugins").into_iter().flat_map(Node::items);
    let commands = vnfs.chain(plugins).filter_map(|its| its.get("command")).flat_map(Node::items);
    let all = map.into_iter().chain(replay.map(|node| (Kind::Conditions, node)));
    all.chain(traces.map(|node| (Kind::Trace, node))).chain(commands.map(|node| (Kind::Word, node))).collect()
}

/// The files so far, by their new paths.
struct Luggage<'a> {
    folder: &'a Path,
    taken: &'a [&'a str],
    files: BTreeMap<PathBuf, Contents>,
}

impl Luggage<'_> {
    /// Packs a named file. Returns its new path; `None` if it is not packed.
    fn pack(&mut self, kind: Kind, name: &str) -> Option<PathBuf> {
        let from = self.folder.join(name);
        let is_there = match kind {
            Kind::Map | Kind::Trace => from.is_file(),
            Kind::Conditions => from.is_dir(),
            // A link, such as a virtual environment's Python, would not work as a copy.
            Kind::Word => {
                let file = fs::symlink_metadata(&from);
                file.is_ok_and(|file| file.is_file() && file.len() <= file::MAX_TEXT as u64)
            }
        };
        let stays = self.inside(name);
        if !is_there || (kind == Kind::Word && Path::new(name).is_absolute()) {
            return None;
        }
        let contents = match kind {
            Kind::Conditions => Contents::Conditions(from.clone()),
            _ => Contents::Copy(from.clone()),
        };
        let to = match stays {
            Some(to) => {
                self.files.entry(to.clone()).or_insert(contents);
                to
            }
            None => self.add(&Path::new(OTHERS).join(plain(&from)), contents),
        };
        if kind == Kind::Map {
            self.pack_image(&from, &to);
        }
        Some(to)
    }

    /// Packs the picture of a map, whose description may have to name it anew.
    fn pack_image(&mut self, map: &Path, to: &Path) {
        let Ok(text) = file::read_text(map) else { return };
        let Some((name, span)) = image_of(&text) else { return };
        let picture = map.parent().unwrap_or(Path::new("")).join(&name);
        if !picture.is_file() {
            return;
        }
        let beside = to.parent().unwrap_or(Path::new(""));
        let contents = Contents::Copy(picture.clone());
        let wanted = if is_plain(&name) { beside.join(&name) } else { beside.join(plain(&picture)) };
        let is_from_inside = self.folder.join(&wanted) == picture;
        let at = if is_from_inside {
            self.files.entry(wanted.clone()).or_insert(contents);
            wanted
        } else {
            self.add(&wanted, contents)
        };
        let named = at.strip_prefix(beside).unwrap_or(&at);
        if named != Path::new(&name) {
            let mut changes = Changes::default();
            changes.replace(&span, &name, named);
            self.files.insert(to.to_owned(), Contents::Text(changes.apply(&text)));
        }
    }

    /// Returns the path of a file that can stay where it is in the folder.
    fn inside(&self, name: &str) -> Option<PathBuf> {
        let path = Path::new(name);
        let first = path.components().next()?.as_os_str();
        let is_taken = self.taken.iter().any(|taken| *taken == first);
        (is_plain(name) && !is_taken).then(|| path.to_owned())
    }

    /// Adds a file from elsewhere near the wanted path. Returns its path.
    fn add(&mut self, wanted: &Path, contents: Contents) -> PathBuf {
        let end = wanted.file_name().and_then(OsStr::to_str).unwrap_or("file");
        let names = (1_u64..).map(|i| if i == 1 { end.to_owned() } else { format!("{i}-{end}") });
        let mut free = names.map(|name| wanted.with_file_name(name)).filter(|to| match self.files.get(to) {
            Some(there) => *there == contents,
            // A file of this name may still be packed from there.
            None => !self.folder.join(to).exists(),
        });
        let to = free.next().expect("there are more names than files");
        self.files.insert(to.clone(), contents);
        to
    }
}

/// Whether a relative path leads down from its folder, in so many words.
fn is_plain(name: &str) -> bool {
    let parts = || Path::new(name).components();
    parts().next().is_some() && parts().all(|part| matches!(part, Component::Normal(_)))
}

/// Returns the last part of a path in letters that YAML needs no quotes for.
fn plain(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    let name: String = name.chars().map(|c| if fits(c) { c } else { '_' }).collect();
    if name.starts_with(|c: char| c.is_ascii_alphanumeric()) { name } else { format!("file{name}") }
}

/// New paths in a text.
#[derive(Default)]
struct Changes(BTreeMap<(usize, usize), BTreeMap<String, String>>);

impl Changes {
    fn replace(&mut self, span: &Range<usize>, old: &str, new: &Path) {
        let new = new.to_string_lossy().into_owned();
        self.0.entry((span.start, span.end)).or_default().insert(old.to_owned(), new);
    }

    fn apply(&self, text: &str) -> String {
        let mut changed = text.to_owned();
        // From the end, so that places before stay the same.
        for ((start, end), paths) in self.0.iter().rev() {
            let mut value = text[*start..*end].to_owned();
            for (old, new) in paths {
                match find(&value, old) {
                    Some(at) => value.replace_range(at..at + old.len(), new),
                    // It is written with escapes, or over several lines.
                    None if !text[..*start].ends_with("# set: ") => value = new.clone(),
                    None => {}
                }
            }
            changed.replace_range(*start..*end, &value);
        }
        changed
    }
}

/// Returns the last place of a path in a value that is not part of a longer one.
fn find(value: &str, path: &str) -> Option<usize> {
    let continues = |c: char| c.is_alphanumeric() || matches!(c, '.' | '_' | '-' | '/');
    let mut places = value.rmatch_indices(path).map(|(at, _)| at);
    places.find(|&at| {
        let after = value[at + path.len()..].starts_with(continues);
        !after && !value[..at].ends_with(continues)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder with a testbed's files, and a file elsewhere.
    fn place() -> tempfile::TempDir {
        let place = tempfile::tempdir().unwrap();
        for folder in ["bed/maps", "elsewhere", "bed/earlier"] {
            fs::create_dir_all(place.path().join(folder)).unwrap();
        }
        for (name, text) in [
            ("bed/maps/hall.yaml", "image: hall.pgm\nresolution: 1\norigin: [0, 0, 0]\n"),
            ("bed/maps/hall.pgm", "P2 1 1 1\n1\n"),
            ("bed/serve.py", ""),
            ("elsewhere/hall.yaml", "image: '../bed/maps/hall.pgm' # shared\nresolution: 1\n"),
            ("elsewhere/air 1.trace", "1\n"),
        ] {
            fs::write(place.path().join(name), text).unwrap();
        }
        place
    }

    fn files(carried: &Carried) -> Vec<&str> {
        carried.files.iter().map(|file| file.to.to_str().unwrap()).collect()
    }

    #[test]
    fn files_inside_the_folder_keep_their_paths_and_the_text_its_bytes() {
        let place = place();
        let text = "# A hall.\nmap: maps/hall.yaml\nconditions: { replay: earlier }\n\
                    plugins: [{ id: a, command: [python3, serve.py, absent.py] }]\n";
        let carried = carry(text, &place.path().join("bed"), &["logs"]);
        assert_eq!(carried.text, text);
        assert_eq!(files(&carried), ["earlier", "maps/hall.pgm", "maps/hall.yaml", "serve.py"]);
        assert!(matches!(&carried.files[0].contents, Contents::Conditions(_)));
    }

    #[test]
    fn files_from_elsewhere_get_paths_in_the_folder() {
        let place = place();
        let elsewhere = place.path().join("elsewhere");
        let text = format!(
            "map: \"../elsewhere/hall.yaml\"  # both\nlinks:\n  - {{ ends: [a, b], forward: {{ trace: '{0}/air 1.trace' }}, \
             backward: {{ trace: '{0}/air 1.trace' }} }}\n",
            elsewhere.display()
        );
        let carried = carry(&text, &place.path().join("bed"), &[]);
        let expected = "map: \"files/hall.yaml\"  # both\nlinks:\n  - { ends: [a, b], forward: \
                        { trace: 'files/air_1.trace' }, backward: { trace: 'files/air_1.trace' } }\n";
        assert_eq!(carried.text, expected);
        assert_eq!(files(&carried), ["files/air_1.trace", "files/hall.pgm", "files/hall.yaml"]);
        let map = Contents::Text("image: 'hall.pgm' # shared\nresolution: 1\n".to_owned());
        assert_eq!(carried.files[2].contents, map);
    }

    #[test]
    fn paths_in_settings_are_changed_in_their_notes() {
        let place = place();
        let path = place.path().join("elsewhere/hall.yaml");
        let settings = [format!("map={}", path.display()).parse().unwrap()];
        let text = crate::annotated("name: x\n", &settings);
        let carried = carry(&text, &place.path().join("bed"), &[]);
        assert_eq!(carried.text, "name: x\n# set: map=files/hall.yaml\n");
    }

    #[test]
    fn a_path_that_the_new_folder_needs_itself_is_changed() {
        let place = place();
        let carried = carry("map: maps/hall.yaml\n", &place.path().join("bed"), &["maps"]);
        assert_eq!(carried.text, "map: files/hall.yaml\n");
        assert_eq!(files(&carried), ["files/hall.pgm", "files/hall.yaml"]);
    }

    #[test]
    fn different_files_of_one_name_stay_apart() {
        let place = place();
        let bed = place.path().join("bed");
        fs::create_dir(bed.join("files")).unwrap();
        fs::write(bed.join("files/hall.yaml"), "image: x.pgm\n").unwrap();
        let text = "map: ../elsewhere/hall.yaml\nlinks: [{ ends: [a, b], trace: files/hall.yaml }]\n";
        let carried = carry(text, &bed, &[]);
        assert_eq!(
            carried.text,
            "map: files/2-hall.yaml\nlinks: [{ ends: [a, b], trace: files/hall.yaml }]\n"
        );
    }
}
