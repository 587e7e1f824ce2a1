//! Shows that the project is built as ARCHITECTURE.md says: which crate imports which, and that no files of a crate import each
//! other in a circle.
#![allow(clippy::unwrap_used, reason = "a test that cannot read the project fails")]

mod imports;
mod source;

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    path::Path,
};

use cotorra_testing::project_file;

use self::{
    imports::{Crate, Table},
    source::{Arrows, Source},
};

#[test]
fn crates_import_what_the_table_allows() {
    let table = Table::read(&project_file("ARCHITECTURE.md"));
    let faults: Vec<_> = Crate::all().iter().flat_map(|its| table.faults(its)).collect();
    assert!(faults.is_empty(), "ARCHITECTURE.md does not allow this:\n{}", faults.join("\n"));
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let crates = Crate::all();
    let roots: Vec<_> = crates.iter().flat_map(|its| &its.roots).collect();
    assert!(roots.len() >= crates.len(), "each crate has a library or a program");
    let circles: String = roots.into_iter().map(|root| circles(&Source::read(root).arrows())).collect();
    assert!(circles.is_empty(), "move what ties these files to where it belongs:\n{circles}");
}

#[test]
fn a_circle_is_found_through_re_exports_and_groups() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("lib.rs", "mod a;\nmod b;\nmod c;\npub use b::B;\n#[cfg(test)]\nmod tests { use crate::a::A; }\n");
    write("a.rs", "use crate::{B, c::C};\npub struct A(B, C);\n");
    write("b.rs", "pub struct B;\nimpl B { fn a(&self) -> crate::a::A { todo!() } }\n");
    write("c.rs", "pub struct C;\n#[cfg(test)]\nmod tests { use crate::a::A; }\n");
    let found = circles(&Source::read(&folder.path().join("lib.rs")).arrows());
    assert!(found.contains("a.rs takes B of ") && found.contains("b.rs takes A of "), "{found}");
    assert!(!found.contains("c.rs"), "{found}");
    write("b.rs", "pub struct B;\n");
    assert_eq!(circles(&Source::read(&folder.path().join("lib.rs")).arrows()), "");
}

/// Returns a line for each arrow of a circle.
fn circles(arrows: &Arrows) -> String {
    let mut next = BTreeMap::<&Path, Vec<&Path>>::new();
    for (from, to) in arrows.keys() {
        next.entry(from).or_default().push(to);
    }
    let mut lines = String::new();
    for ((from, to), names) in arrows {
        if reached(&next, to).contains(from.as_path()) {
            let names: Vec<_> = names.iter().map(String::as_str).collect();
            let _ = writeln!(lines, "{} takes {} of {}", shown(from), names.join(", "), shown(to));
        }
    }
    lines
}

fn shown(file: &Path) -> String {
    file.strip_prefix(project_file("")).unwrap_or(file).display().to_string()
}

/// Returns the files that a file takes names of, also by way of others.
fn reached<'a>(next: &BTreeMap<&'a Path, Vec<&'a Path>>, from: &'a Path) -> BTreeSet<&'a Path> {
    let mut found = BTreeSet::new();
    let mut open = vec![from];
    while let Some(file) = open.pop() {
        open.extend(next.get(file).into_iter().flatten().filter(|file| found.insert(**file)));
    }
    found
}
