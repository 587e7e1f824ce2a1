//! The imports of crates, and those that ARCHITECTURE.md allows.

use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use cotorra_testing::project_file;
use serde_json::Value;

/// A crate of the workspace.
pub struct Crate {
    /// Its folder, below `crates`, or from `plugins` on.
    pub place: String,
    /// The `lib.rs` and `main.rs` of its library and programs.
    pub roots: Vec<PathBuf>,
    /// Places of the crates that it imports outside of its tests.
    imports: Vec<String>,
}

impl Crate {
    /// Returns all crates of the workspace.
    pub fn all() -> Vec<Self> {
        let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let output = Command::new(cargo)
            .args(["metadata", "--no-deps", "--format-version", "1", "--offline"])
            .current_dir(project_file(""))
            .output()
            .expect("cargo runs");
        let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo describes the workspace");
        metadata["packages"].as_array().unwrap().iter().map(Self::of).collect()
    }

    fn of(package: &Value) -> Self {
        let list = |key: &str| package[key].as_array().unwrap().iter();
        let is_root = |target: &&Value| {
            let kinds = target["kind"].as_array().unwrap();
            kinds.iter().any(|kind| ["lib", "bin", "cdylib"].contains(&kind.as_str().unwrap()))
        };
        let path = |value: &Value| PathBuf::from(value.as_str().unwrap());
        let imports = list("dependencies").filter(|its| its["kind"].is_null() && its["path"].is_string());
        Self {
            place: place(path(&package["manifest_path"]).parent().unwrap()),
            roots: list("targets").filter(is_root).map(|target| path(&target["src_path"])).collect(),
            imports: imports.map(|its| place(&path(&its["path"]))).collect(),
        }
    }
}

/// Returns a crate's folder as ARCHITECTURE.md names it.
fn place(folder: &Path) -> String {
    let place = folder.strip_prefix(project_file("")).expect("crates of the workspace are in its folder");
    place.strip_prefix("crates").unwrap_or(place).display().to_string()
}

/// The table of crates in ARCHITECTURE.md: what each may import; `None` for everything.
pub struct Table(BTreeMap<String, Option<Vec<String>>>);

impl Table {
    /// Reads the table.
    pub fn read(file: &Path) -> Self {
        let text = fs::read_to_string(file).unwrap();
        let rows = text.lines().skip_while(|line| !line.starts_with("| crate |")).skip(2);
        let mut table = BTreeMap::new();
        for row in rows.take_while(|line| line.starts_with('|')) {
            let cells: Vec<_> = row.trim_matches('|').split(" | ").map(str::trim).collect();
            let [crates, _, imports] = cells[..] else { panic!("a row has three cells: {row}") };
            let allowed = match quoted(imports) {
                none if none.is_empty() && imports.starts_with("all of these") => None,
                names => Some(names),
            };
            table.extend(quoted(crates).into_iter().map(|name| (name, allowed.clone())));
        }
        Self(table)
    }

    /// Returns a line for each import of a crate that the table does not allow.
    pub fn faults(&self, its: &Crate) -> Vec<String> {
        let is_named = |name: &String, place: &str| place == name || place.ends_with(&format!("/{name}"));
        match self.0.get(&its.place) {
            None => vec![format!("{} has no row", its.place)],
            Some(None) => Vec::new(),
            Some(Some(allowed)) => {
                let is_undeclared = |place: &&String| !allowed.iter().any(|name| is_named(name, place));
                let undeclared = its.imports.iter().filter(is_undeclared);
                undeclared.map(|place| format!("{} imports {place}", its.place)).collect()
            }
        }
    }
}

/// Returns what stands between backquotes.
fn quoted(text: &str) -> Vec<String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}
