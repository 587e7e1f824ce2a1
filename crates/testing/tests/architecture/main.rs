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
    let circles: String = roots.into_iter().map(|root| circles(&Source::read(root))).collect();
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
    let found = circles(&Source::read(&folder.path().join("lib.rs")));
    assert!(found.contains("a.rs takes B of ") && found.contains("b.rs takes A of "), "{found}");
    assert!(!found.contains("c.rs"), "{found}");
    write("b.rs", "pub struct B;\n");
    assert_eq!(circles(&Source::read(&folder.path().join("lib.rs"))), "");
}

#[test]
fn a_circle_is_found_through_a_module_that_a_file_is_inside_of() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    std::fs::create_dir(folder.path().join("a")).unwrap();
    write("lib.rs", "mod a;\nmod b;\n");
    write("a.rs", "mod c;\npub use c::C;\npub struct A(crate::b::B, C);\n");
    write("a/c.rs", "use super::A;\npub struct C(Option<Box<A>>);\n");
    write("b.rs", "use crate::a::C;\npub struct B(C);\n");
    let found = circles(&Source::read(&folder.path().join("lib.rs")));
    for arrow in ["a.rs takes B of ", "b.rs takes C of ", "a/c.rs takes A of "] {
        assert!(found.contains(arrow), "{found}");
    }
    // The module with what is inside of it is no such circle.
    write("b.rs", "pub struct B;\n");
    assert_eq!(circles(&Source::read(&folder.path().join("lib.rs"))), "");
}

/// Returns a line for each arrow of a circle. A module and those inside of it may take names of each other, if no other file
/// stands between them.
fn circles(source: &Source) -> String {
    let all = source.arrows();
    let mut apart = all.clone();
    apart.retain(|(from, to), _| !source.is_inside(from, to));
    let (next, next_apart) = (nexts(&all), nexts(&apart));
    let mut lines = String::new();
    for ((from, to), names) in &all {
        let behind = reached(&next, to);
        if !behind.contains(from.as_path()) {
            continue;
        }
        let circle: Vec<_> =
            behind.into_iter().filter(|file| reached(&next, file).contains(to.as_path())).collect();
        let holds_all = |outer: &&Path| {
            *outer != source.root()
                && circle.iter().all(|file| file == outer || source.is_inside(file, outer))
        };
        let is_apart = apart.contains_key(&(from.clone(), to.clone()));
        if !circle.iter().any(holds_all) || is_apart && reached(&next_apart, to).contains(from.as_path()) {
            let names: Vec<_> = names.iter().map(String::as_str).collect();
            let _ = writeln!(lines, "{} takes {} of {}", shown(from), names.join(", "), shown(to));
        }
    }
    lines
}

/// Returns the files that each file takes names of.
fn nexts(arrows: &Arrows) -> BTreeMap<&Path, Vec<&Path>> {
    let mut next = BTreeMap::<&Path, Vec<&Path>>::new();
    for (from, to) in arrows.keys() {
        next.entry(from).or_default().push(to);
    }
    next
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
