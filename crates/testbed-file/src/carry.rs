//! Copies of testbed files that hold what they name. It finds the files, chooses their places beside the copy, and changes
//! only the paths that would lead elsewhere.

use std::{
    collections::BTreeMap,
    ffi::OsStr,
    fs::{self, File},
    ops::Range,
    path::{Component, Path, PathBuf},
};

use crate::{
    compose, file,
    map_server::image_of,
    python, tree,
    yaml::{Sink, decode::Node},
};

/// Folder of files from outside the testbed file's folder.
const OTHERS: &str = "files";
/// Settings of a federation's ledger that name files.
pub const LEDGER_PATHS: [&str; 3] = ["key_store", "password_file", "program"];
/// Maximum number of files and folders in a folder that is carried.
const MAX_ENTRIES: usize = 1000;
/// Maximum bytes of a program, or of all files in a folder, that are carried.
const MAX_BYTES: u64 = file::MAX_TEXT as u64;

/// A testbed file for another folder, and the files that belong beside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Carried {
    /// The text, whose relative paths start at the new folder.
    pub text: String,
    /// Map, traces, recorded traffic and conditions, files of commands, modules that Python programs import, readable folders, compose
    /// files, and volumes.
    pub files: Vec<CarriedFile>,
}

/// A file or a folder that a testbed file names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CarriedFile {
    /// Path from the new folder.
    pub to: PathBuf,
    /// Its contents.
    pub contents: Contents,
}

/// Contents of a carried file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Contents {
    /// A copy of this file.
    Copy(PathBuf),
    /// Copies of these files in a folder, by their paths in it.
    Folder(PathBuf, Vec<PathBuf>),
    /// This text.
    Text(String),
    /// The conditions of links in the recorded run of this folder.
    Conditions(PathBuf),
}

/// Carries a testbed file that stands in `folder`, and the files that it names, to another folder, in which the names in
/// `taken` are not free. Keeps relative paths that do not lead out of the folder. Keeps absolute paths of programs, readable
/// folders, volumes and keys, because those belong to the machine. Makes relative paths absolute if they lead to something that
/// is not carried: keys, links, and what is too large. A text that cannot be parsed stays as it is.
pub fn carry(text: &str, folder: &Path, taken: &[&str]) -> Carried {
    let (mut texts, files) = carry_all(&[text], folder, taken);
    Carried { text: texts.pop().unwrap_or_default(), files }
}

/// Carries variants of a testbed file as [`carry`] does one, to the same folder. Returns their texts, and the files of all.
pub fn carry_all(texts: &[&str], folder: &Path, taken: &[&str]) -> (Vec<String>, Vec<CarriedFile>) {
    let mut luggage = Luggage::new(folder, taken);
    let texts = texts.iter().map(|text| luggage.pack_all(text)).collect();
    let files = luggage.files.into_iter().map(|(to, contents)| CarriedFile { to, contents });
    (texts, files.collect())
}

/// Kind of a named file.
#[derive(Clone, Copy)]
pub(crate) enum Kind {
    Map,
    /// A trace of a link, or recorded traffic.
    Trace,
    /// Measured demands of a VNF.
    Samples,
    Conditions,
    /// A file or a folder that a VNF may read.
    Readable,
    /// A word of a command, which may name a file.
    Word(Role),
    /// A module that Python runs in the testbed file's folder.
    Module,
    /// A volume of a container, with its path there.
    Volume,
    /// A compose file, which names volumes.
    Compose,
    /// A key or its password.
    Key,
}

/// Role of a file for the command that names it.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    /// The program itself.
    Program,
    /// An argument, which may be a program for an interpreter.
    Argument,
    /// A program for Python.
    Python,
}

impl Kind {
    /// Splits a value into the path and what follows.
    pub(crate) fn split(self, text: &str) -> (&str, &str) {
        match self {
            Self::Volume => text.split_at(text.find(':').unwrap_or(text.len())),
            _ => (text, ""),
        }
    }
}

/// Returns the items of a key's value.
fn items<'a>(node: &'a Node, key: &str) -> impl Iterator<Item = &'a Node> + use<'a> {
    node.get(key).into_iter().flat_map(Node::items)
}

/// Returns the words of a command that may name files.
fn words(command: &Node) -> Vec<(Kind, &Node)> {
    let words: Vec<_> = command.items().collect();
    let is_python = |word: &Node| {
        let name = Path::new(word.text().unwrap_or_default()).file_name();
        name.is_some_and(|name| name.to_string_lossy().starts_with("python"))
    };
    let python = words.iter().position(|word| is_python(word));
    let kind = |at: usize| match python {
        _ if at == 0 => Kind::Word(Role::Program),
        Some(python) if python < at && words[at - 1].text() == Some("-m") => Kind::Module,
        // Options come first.
        Some(python)
            if (python + 1..at).all(|at| words[at].text().is_some_and(|word| word.starts_with('-'))) =>
        {
            Kind::Word(Role::Python)
        }
        _ => Kind::Word(Role::Argument),
    };
    (0..words.len()).map(|at| (kind(at), words[at])).collect()
}

/// Returns all values that name files.
pub(crate) fn named(root: &Node) -> Vec<(Kind, &Node)> {
    let mut found = Vec::new();
    found.extend(root.get("map").map(|node| (Kind::Map, node)));
    found.extend(
        root.get("conditions").and_then(|its| its.get("replay")).map(|node| (Kind::Conditions, node)),
    );
    let links = items(root, "links");
    let directions = |link| [Some(link), Node::get(link, "forward"), Node::get(link, "backward")];
    let of_links = links.flat_map(directions).flatten();
    let of_schedule = items(root, "schedule").filter_map(|its| its.get("set"));
    let traces = of_links.chain(of_schedule).filter_map(|its| its.get("trace"));
    found.extend(traces.map(|node| (Kind::Trace, node)));
    let recorded = items(root, "traffic").flat_map(|its| [its.get("trace"), its.get("pcap")]);
    found.extend(recorded.flatten().map(|node| (Kind::Trace, node)));
    let composed = items(root, "services").filter_map(|its| its.get("compose")?.get("file"));
    found.extend(composed.map(|node| (Kind::Compose, node)));
    let services = items(root, "services");
    let vnfs = services.flat_map(|its| items(its, "vnfs"));
    let demands =
        items(root, "services").flat_map(|its| items(its, "vnfs")).filter_map(|its| its.get("demand"));
    found.extend(demands.filter_map(|its| its.get("samples")).map(|node| (Kind::Samples, node)));
    for program in vnfs.chain(items(root, "nodes")).chain(items(root, "plugins")) {
        if program.get("image").is_some() {
            // Words of its command are inside the image.
            found.extend(items(program, "volumes").map(|node| (Kind::Volume, node)));
            continue;
        }
        let readable: Vec<_> = items(program, "readable").collect();
        for (kind, word) in program.get("command").map(words).unwrap_or_default() {
            let is_readable = readable.iter().any(|path| path.text() == word.text());
            found.push((if is_readable { Kind::Readable } else { kind }, word));
        }
        found.extend(readable.into_iter().map(|node| (Kind::Readable, node)));
        let ledger = program.get("settings").and_then(|its| its.get("ledger"));
        for key in LEDGER_PATHS {
            let kind = if key == "program" { Kind::Word(Role::Program) } else { Kind::Key };
            found.extend(ledger.and_then(|its| its.get(key)).map(|node| (kind, node)));
        }
    }
    found
}

/// The files so far, by their new paths.
pub(crate) struct Luggage<'a> {
    folder: &'a Path,
    taken: &'a [&'a str],
    files: BTreeMap<PathBuf, Contents>,
    /// New paths of files from outside of the folder, by the old ones.
    moved: BTreeMap<PathBuf, PathBuf>,
    /// All files that are named, carried or not, and whether each is only an argument of programs. The folder of a run whose
    /// conditions are replayed stands for that run.
    pub(crate) sources: BTreeMap<PathBuf, bool>,
}

impl<'a> Luggage<'a> {
    pub(crate) fn new(folder: &'a Path, taken: &'a [&'a str]) -> Self {
        Self { folder, taken, files: BTreeMap::new(), moved: BTreeMap::new(), sources: BTreeMap::new() }
    }

    /// Packs what a testbed file names. Returns its text with the new paths.
    fn pack_all(&mut self, text: &str) -> String {
        let Some(root) = tree(text, &mut Sink::default()) else { return text.to_owned() };
        let mut changes = Changes::default();
        for (kind, node) in named(&root) {
            let Some(value) = node.text() else { continue };
            let (name, rest) = kind.split(value);
            if let Some(to) = self.pack(kind, name)
                && to != Path::new(name)
            {
                changes.replace(&node.span, value, &format!("{}{rest}", to.display()));
            }
        }
        changes.apply(text)
    }

    /// Packs a named file, if it can be packed. Returns its new path; `None` if the path stays as it is.
    pub(crate) fn pack(&mut self, kind: Kind, name: &str) -> Option<PathBuf> {
        let from = self.folder.join(name);
        let mut modules = Vec::new();
        match kind {
            Kind::Word(role) if from.is_file() => modules = self.note_program(&from, role),
            Kind::Word(_) if is_plain(name) && from.is_dir() => {
                if let Some(contents) = small_folder(&from) {
                    self.note_all(&contents, true);
                }
            }
            // A line for a shell may name programs.
            Kind::Word(role) if name.contains(char::is_whitespace) => {
                let ends = |c: char| c.is_whitespace() || "'\";&|()<>=`$".contains(c);
                for word in name.split(ends).filter(|word| self.folder.join(word).is_file()) {
                    self.note_program(&self.folder.join(word), role);
                    if self.inside(word).is_some() {
                        self.pack(kind, word);
                    }
                }
                return None;
            }
            Kind::Module => {
                for module in python::module(self.folder, name) {
                    self.note(self.folder.join(&module), false);
                    self.pack_inside(&module);
                }
                return None;
            }
            Kind::Map | Kind::Trace | Kind::Samples | Kind::Compose if from.is_file() => {
                self.note(from.clone(), false)
            }
            Kind::Conditions if from.is_dir() => self.note(from.clone(), false),
            _ => {}
        }
        let contents = match kind {
            Kind::Map | Kind::Trace | Kind::Samples | Kind::Compose => {
                Some(Contents::Copy(from.is_file().then(|| from.clone())?))
            }
            Kind::Conditions => Some(Contents::Conditions(from.is_dir().then(|| from.clone())?)),
            Kind::Readable | Kind::Volume | Kind::Word(_) | Kind::Key if Path::new(name).is_absolute() => {
                return None;
            }
            Kind::Readable | Kind::Volume => small_file(&from).or_else(|| small_folder(&from)),
            Kind::Word(_) => small_file(&from),
            Kind::Key | Kind::Module => None,
        };
        let Some(contents) = contents else {
            let is_path = name.contains('/') || !matches!(kind, Kind::Word(_));
            return Some(from).filter(|from| is_path && stays(from));
        };
        if matches!(kind, Kind::Readable | Kind::Volume) {
            self.note_all(&contents, false);
        }
        let to = match self.inside(name) {
            _ if !modules.is_empty() => self.pack_program(name, &from, &modules),
            Some(to) => {
                self.files.entry(to.clone()).or_insert(contents);
                to
            }
            // Its contents may be changed by now.
            None if self.moved.contains_key(&from) => return self.moved.get(&from).cloned(),
            None => {
                let to = self.add(&Path::new(OTHERS).join(plain(&from)), contents);
                self.moved.insert(from.clone(), to.clone());
                to
            }
        };
        match kind {
            Kind::Map => self.pack_image(&from, &to),
            Kind::Compose => self.pack_volumes(&from, &to),
            _ => {}
        }
        Some(to)
    }

    /// Notes a program or an argument, and the modules that it imports if it is for Python. Returns these.
    fn note_program(&mut self, from: &Path, role: Role) -> Vec<PathBuf> {
        let is_python = role == Role::Python || python::is_python(from);
        let modules = if is_python { python::modules(from) } else { Vec::new() };
        self.note(from.to_owned(), role == Role::Argument && !is_python);
        modules.iter().for_each(|module| self.note(from.with_file_name(module), false));
        modules
    }

    /// Notes a file that is named.
    fn note(&mut self, source: PathBuf, is_argument: bool) {
        let noted = self.sources.entry(source).or_insert(is_argument);
        *noted &= is_argument;
    }

    /// Notes the files that are copied.
    fn note_all(&mut self, contents: &Contents, is_argument: bool) {
        match contents {
            Contents::Copy(from) => self.note(from.clone(), is_argument),
            Contents::Folder(from, files) => {
                files.iter().for_each(|file| self.note(from.join(file), is_argument));
            }
            Contents::Text(_) | Contents::Conditions(_) => {}
        }
    }

    /// Packs a file of the folder in its place, if that is free and the file can be packed.
    fn pack_inside(&mut self, name: &Path) {
        if let (Some(to), Some(contents)) =
            (name.to_str().and_then(|name| self.inside(name)), small_file(&self.folder.join(name)))
        {
            self.files.entry(to).or_insert(contents);
        }
    }

    /// Packs a Python program and the modules beside it, which keep their names and their places. Returns its new path.
    fn pack_program(&mut self, name: &str, from: &Path, modules: &[PathBuf]) -> PathBuf {
        let stays = |to: &PathBuf| {
            let mut all = modules.iter().map(|module| to.with_file_name(module));
            all.all(|to| to.to_str().is_some_and(|to| self.inside(to).is_some()))
        };
        let to = self.inside(name).filter(stays).unwrap_or_else(|| self.own_folder(from).join(plain(from)));
        let beside = modules.iter().map(|module| (to.with_file_name(module), from.with_file_name(module)));
        for (to, from) in beside.chain([(to.clone(), from.to_owned())]) {
            if let Some(contents) = small_file(&from) {
                self.files.entry(to).or_insert(contents);
            }
        }
        to
    }

    /// Returns a new folder for a program from elsewhere, or the one that it has.
    fn own_folder(&self, program: &Path) -> PathBuf {
        let name = plain(&program.with_extension(""));
        let names = (1_u64..).map(|i| if i == 1 { name.clone() } else { format!("{i}-{name}") });
        let mut free = names.map(|name| Path::new(OTHERS).join(name)).filter(|own| {
            let has_it =
                self.files.get(&own.join(plain(program))) == Some(&Contents::Copy(program.to_owned()));
            let is_used = self.files.keys().any(|to| to.starts_with(own)) || self.folder.join(own).exists();
            has_it || !is_used
        });
        free.next().expect("there are more names than programs")
    }

    /// Packs the picture of a map, whose description may have to name it anew.
    fn pack_image(&mut self, map: &Path, to: &Path) {
        let Ok(text) = file::read_text(map) else { return };
        let Some((name, span)) = image_of(&text) else { return };
        let picture = map.parent().unwrap_or(Path::new("")).join(&name);
        if !picture.is_file() {
            return;
        }
        self.note(picture.clone(), false);
        let named = self.pack_beside(to, &name, &picture, Contents::Copy(picture.clone()));
        if named != Path::new(&name) {
            let mut changes = Changes::default();
            changes.replace(&span, &name, &named.to_string_lossy());
            self.files.insert(to.to_owned(), Contents::Text(changes.apply(&text)));
        }
    }

    /// Packs the volumes of a compose file, which may have to name them anew.
    fn pack_volumes(&mut self, file: &Path, to: &Path) {
        let Ok(text) = file::read_text_of(file, compose::MAX_FILE) else { return };
        let mut changes = Changes::default();
        for compose::NamedSource { source, text: written, span } in compose::sources(&text) {
            let path = Path::new(&source);
            if path.is_absolute() || source.starts_with('~') {
                continue;
            }
            let from: PathBuf = file.parent().unwrap_or(Path::new("")).join(path).components().collect();
            let new = match small_file(&from).or_else(|| small_folder(&from)) {
                // Without `./`, a name would be that of a named volume.
                Some(contents) => {
                    self.note_all(&contents, false);
                    let name = source.trim_start_matches("./");
                    Path::new(".").join(self.pack_beside(to, name, &from, contents))
                }
                None if stays(&from) => from,
                None => continue,
            };
            let from_here = |at: &Path| at.strip_prefix(".").unwrap_or(at).to_owned();
            if from_here(&new) != from_here(path) {
                changes.replace(&span, &written, &written.replacen(&source, &new.to_string_lossy(), 1));
            }
        }
        if !changes.0.is_empty() {
            self.files.insert(to.to_owned(), Contents::Text(changes.apply(&text)));
        }
    }

    /// Packs what a carried file names, near it. Returns its new path from there.
    fn pack_beside(&mut self, to: &Path, name: &str, from: &Path, contents: Contents) -> PathBuf {
        let beside = to.parent().unwrap_or(Path::new(""));
        let wanted = if is_plain(name) { beside.join(name) } else { beside.join(plain(from)) };
        let at = if self.folder.join(&wanted) == from {
            self.files.entry(wanted.clone()).or_insert(contents);
            wanted
        } else {
            self.add(&wanted, contents)
        };
        at.strip_prefix(beside).map(Path::to_owned).unwrap_or(at)
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
            None => !self.folder.join(to).exists() && !self.files.keys().any(|at| at.starts_with(to)),
        });
        let to = free.next().expect("there are more names than files");
        self.files.insert(to.clone(), contents);
        to
    }
}

/// Returns a copy of a small file. A link, such as a virtual environment's Python, would not work as a copy.
fn small_file(path: &Path) -> Option<Contents> {
    let file = fs::symlink_metadata(path).ok()?;
    (file.is_file() && file.len() <= MAX_BYTES && File::open(path).is_ok())
        .then(|| Contents::Copy(path.to_owned()))
}

/// Returns copies of the files in a small folder. Links and devices in it would not work as copies.
fn small_folder(path: &Path) -> Option<Contents> {
    let (mut files, mut folders) = (Vec::new(), vec![PathBuf::new()]);
    let (mut entries, mut bytes) = (0, 0);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(path.join(&folder)).ok()? {
            let entry = entry.ok()?;
            let (name, kind) = (folder.join(entry.file_name()), entry.file_type().ok()?);
            entries += 1;
            if kind.is_dir() {
                folders.push(name);
            } else {
                small_file(&entry.path())?;
                bytes += entry.metadata().ok()?.len();
                files.push(name);
            }
            if entries > MAX_ENTRIES || bytes > MAX_BYTES {
                return None;
            }
        }
    }
    files.sort();
    Some(Contents::Folder(path.to_owned(), files))
}

/// Whether something that is not carried is there, and YAML needs no quotes for its path.
fn stays(path: &Path) -> bool {
    let fits = |c: char| c.is_alphanumeric() || matches!(c, '.' | '_' | '-' | '/');
    path.exists() && path.to_string_lossy().chars().all(fits)
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
    fn replace(&mut self, span: &Range<usize>, old: &str, new: &str) {
        self.0.entry((span.start, span.end)).or_default().insert(old.to_owned(), new.to_owned());
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
            "map: \"../elsewhere/hall.yaml\"  # both\nlinks:\n  - {{ ends: [a, b], \
             forward: {{ trace: '{0}/air 1.trace' }}, backward: {{ trace: '{0}/air 1.trace' }} }}\n",
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
    fn a_readable_folder_is_carried_with_the_word_that_names_it() {
        let place = place();
        fs::create_dir(place.path().join("elsewhere/lib")).unwrap();
        fs::write(place.path().join("elsewhere/lib/a.py"), "").unwrap();
        let text = |elsewhere: &str| {
            format!(
                "services: {{ s: {{ vnfs: {{ v: {{ command: [python3, serve.py, {elsewhere}], \
                 readable: [{elsewhere}, maps, absent, /usr] }} }} }} }}\n"
            )
        };
        let carried = carry(&text("../elsewhere"), &place.path().join("bed"), &[]);
        assert_eq!(carried.text, text("files/elsewhere"));
        assert_eq!(files(&carried), ["files/elsewhere", "maps", "serve.py"]);
        let Contents::Folder(_, inside) = &carried.files[0].contents else { panic!("{carried:?}") };
        assert_eq!(inside, &["air 1.trace", "hall.yaml", "lib/a.py"].map(PathBuf::from));
    }

    #[test]
    fn paths_to_what_is_not_carried_become_absolute() {
        let place = place();
        let bed = place.path().join("bed");
        std::os::unix::fs::symlink("serve.py", bed.join("link.py")).unwrap();
        fs::create_dir_all(bed.join("full/below")).unwrap();
        (0..MAX_ENTRIES).for_each(|i| fs::write(bed.join(format!("full/below/{i}")), "").unwrap());
        File::create(place.path().join("large")).unwrap().set_len(MAX_BYTES + 1).unwrap();
        let text = |at: &str| {
            format!(
                "services: {{ s: {{ vnfs: {{ v: {{ command: [{at}./link.py, link.py, {at}../large, ../absent], \
                 readable: [{at}full] }} }} }} }}\n\
                 plugins: [{{ bundled: federation, settings: {{ ledger: {{ key_store: {at}serve.py }} }} }}]\n"
            )
        };
        let carried = carry(&text(""), &bed, &[]);
        assert_eq!(carried.text, text(&format!("{}/", bed.display())));
        assert_eq!(files(&carried), [""; 0]);
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

    #[test]
    fn variants_share_files_and_keep_others_apart() {
        let place = place();
        let bed = place.path().join("bed");
        fs::create_dir(bed.join("other")).unwrap();
        fs::write(bed.join("other/hall.yaml"), "image: x.pgm\n").unwrap();
        fs::write(bed.join("hall.yaml"), "image: x.pgm\n").unwrap();
        let text = |map: &str| format!("map: {map}\nlinks: [{{ ends: [a, b], trace: hall.yaml }}]\n");
        let outside = format!("{}/other/hall.yaml", bed.display());
        let variants = ["../elsewhere/hall.yaml", "hall.yaml", &outside, "../elsewhere/hall.yaml"].map(text);
        let variants: Vec<_> = variants.iter().map(String::as_str).collect();
        let (texts, files) = carry_all(&variants, &bed, &[]);
        let expected = ["files/hall.yaml", "hall.yaml", "files/2-hall.yaml", "files/hall.yaml"].map(text);
        assert_eq!(texts, expected);
        let files: Vec<_> = files.iter().map(|file| file.to.to_str().unwrap()).collect();
        assert_eq!(files, ["files/2-hall.yaml", "files/hall.pgm", "files/hall.yaml", "hall.yaml"]);
    }

    #[test]
    fn modules_are_carried_beside_the_program_that_imports_them() {
        let place = place();
        let bed = place.path().join("bed");
        fs::create_dir(place.path().join("elsewhere/pack")).unwrap();
        for (name, text) in [
            ("bed/serve.py", "import helper\n"),
            ("bed/helper.py", "from maps import names\n"),
            ("bed/maps/names.py", ""),
            ("bed/unused.py", ""),
            ("bed/main.py", ""),
            ("elsewhere/move it.py", "import pack, helper\n"),
            ("elsewhere/helper.py", ""),
            ("elsewhere/pack/__init__.py", ""),
        ] {
            fs::write(place.path().join(name), text).unwrap();
        }
        let text = |program: &str| {
            format!(
                "plugins: [{{ id: a, command: [python3, -u, serve.py] }}, {{ id: b, command: [python3, -m, main] }}, \
                 {{ id: c, command: ['{program}'] }}, {{ id: d, command: [sh, -c, \"exec '{program}'\"] }}]\n"
            )
        };
        let carried = carry(&text("../elsewhere/move it.py"), &bed, &[]);
        let expected = text("files/move_it/move_it.py")
            .replace("exec 'files/move_it/move_it.py'", "exec '../elsewhere/move it.py'");
        assert_eq!(carried.text, expected);
        let expected = [
            "files/move_it/helper.py",
            "files/move_it/move_it.py",
            "files/move_it/pack/__init__.py",
            "helper.py",
            "main.py",
            "maps/names.py",
            "serve.py",
        ];
        assert_eq!(files(&carried), expected);
        // The modules' places are taken, so that the program moves with them.
        let carried = carry("nodes: { n: { command: [python3, serve.py] } }\n", &bed, &["maps"]);
        assert_eq!(carried.text, "nodes: { n: { command: [python3, files/serve/serve.py] } }\n");
        assert_eq!(
            files(&carried),
            ["files/serve/helper.py", "files/serve/maps/names.py", "files/serve/serve.py"]
        );
    }

    #[test]
    fn volumes_are_carried_and_words_inside_images_stay() {
        let place = place();
        let text = |volume: &str| {
            format!(
                "nodes: {{ n: {{ image: x, volumes: ['{volume}:/data:rw', '/srv:/srv', absent:/a] }} }}\n\
                 services: {{ s: {{ vnfs: {{ v: {{ image: x, command: [./serve.py], volumes: [maps:/maps] }} }} }} }}\n"
            )
        };
        let carried = carry(&text("../elsewhere"), &place.path().join("bed"), &[]);
        assert_eq!(carried.text, text("files/elsewhere"));
        assert_eq!(files(&carried), ["files/elsewhere", "maps"]);
    }

    #[test]
    fn a_compose_file_is_carried_with_its_volumes() {
        let place = place();
        let compose = |one: &str| {
            format!(
                "services:\n  a: {{ image: x, volumes: ['./maps:/maps', '{one}:/one:ro', /srv:/srv, data:/d] }}\n  \
                 b: {{ image: x, volumes: [{{ type: bind, source: ./maps, target: /maps }}, ./absent:/a] }}\n"
            )
        };
        let bed = place.path().join("bed");
        fs::write(bed.join("compose.yaml"), compose("../elsewhere")).unwrap();
        let text = "services: { s: { compose: { file: compose.yaml, node: n } } }\n";
        let carried = carry(text, &bed, &[]);
        assert_eq!(carried.text, text);
        assert_eq!(files(&carried), ["compose.yaml", "elsewhere", "maps"]);
        assert_eq!(carried.files[0].contents, Contents::Text(compose("./elsewhere")));
    }

    #[test]
    fn a_compose_file_from_elsewhere_gets_a_path_in_the_folder() {
        let place = place();
        let compose = "services: { a: { image: x, volumes: ['./hall.yaml:/hall.yaml'] } }\n";
        fs::write(place.path().join("elsewhere/stack.yaml"), compose).unwrap();
        let text = |file: &str| format!("services: {{ s: {{ compose: {{ file: {file}, node: n }} }} }}\n");
        let carried = carry(&text("../elsewhere/stack.yaml"), &place.path().join("bed"), &[]);
        assert_eq!(carried.text, text("files/stack.yaml"));
        assert_eq!(files(&carried), ["files/hall.yaml", "files/stack.yaml"]);
        let original = place.path().join("bed/../elsewhere/stack.yaml");
        assert_eq!(carried.files[1].contents, Contents::Copy(original));
    }
}
