//! Examples and links in the documents.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use crate::harness::{output, project_file, stderr};

/// Returns the YAML blocks of a document.
fn yaml(text: &str) -> impl Iterator<Item = &str> {
    text.split("\n```yaml\n").skip(1).filter_map(|rest| rest.split_inclusive("\n```").next())
}

#[test]
fn testbeds_in_the_documents_pass_the_check() {
    let folder = tempfile::tempdir().unwrap();
    let documents = [
        "README.md",
        "docs/reference/testbed-file.md",
        "docs/use/ros.md",
        "docs/use/ros2.md",
        "docs/use/turtlebot.md",
    ]
    .map(|d| fs::read_to_string(project_file(d)).unwrap());
    let blocks = documents.iter().flat_map(|document| yaml(document));
    let whole: Vec<_> =
        blocks.filter(|block| block.starts_with("name:")).map(|block| block.trim_end_matches('`')).collect();
    assert!(whole.len() >= 7, "{}", whole.len());
    for (i, testbed) in whole.iter().enumerate() {
        let file = folder.path().join(format!("{i}.yaml"));
        fs::write(&file, testbed).unwrap();
        let checked = output(["check".as_ref(), file.as_os_str()]);
        assert!(checked.status.success(), "{testbed}\n{}", stderr(&checked));
    }
}

#[test]
fn the_readme_has_the_command_for_users_and_the_one_for_tests() {
    let readme = fs::read_to_string(project_file("README.md")).unwrap();
    for (command, file) in [
        ("cargo run --release -- run testbeds/corridor.yaml", "testbeds/corridor.yaml"),
        ("scripts/test", "scripts/test"),
    ] {
        assert!(readme.contains(&format!("\n$ {command} ")), "{command}");
        assert!(project_file(file).exists(), "{file}");
    }
    let head = fs::read_to_string(project_file("scripts/test")).unwrap();
    assert!(head.contains("\n# Installs what the tests need, and runs them"));
}

#[test]
fn files_to_change_exist() {
    let page = fs::read_to_string(project_file("docs/internals/extending.md")).unwrap();
    let quoted = page.split('`').skip(1).step_by(2);
    let is_path = |words: &&str| ["crates/", "docs/"].iter().any(|folder| words.starts_with(folder));
    let paths: Vec<_> = quoted.filter(is_path).collect();
    assert!(paths.len() > 40, "{paths:?}");
    for path in paths {
        assert!(project_file(path).exists(), "{path}");
    }
}

/// Returns the sources and manifests of a folder and all below it.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries =
        fs::read_dir(folder).expect("the folder exists").filter_map(|entry| Some(entry.ok()?.path()));
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let is_source = |path: &PathBuf| path.extension().is_some_and(|e| e == "rs" || e == "toml");
    files.into_iter().filter(is_source).chain(folders.iter().flat_map(|folder| sources(folder))).collect()
}

#[test]
fn tests_that_the_page_on_the_letter_names_exist() {
    let page = fs::read_to_string(project_file("docs/reference/letter.md")).unwrap();
    let rows = page.lines().filter(|line| line.starts_with('|'));
    let names: BTreeSet<_> = rows.flat_map(|row| row.split('`').skip(1).step_by(2)).collect();
    let all: Vec<_> =
        ["crates", "plugins"].iter().flat_map(|folder| sources(&project_file(folder))).collect();
    let has_tests = |path: &Path| {
        let text = fs::read_to_string(path).unwrap();
        text.contains("#[test]") || text.contains("proptest!")
    };
    let modules = names.iter().filter_map(|name| name.strip_suffix("::"));
    let is_in = |path: &Path, module: &str| {
        path.with_extension("").components().any(|part| part.as_os_str() == module) && has_tests(path)
    };
    let modules: Vec<_> = modules.collect();
    for module in &modules {
        assert!(all.iter().any(|path| is_in(path, module)), "no test is in a module `{module}`");
    }
    let is_package = |name: &&&str| name.starts_with("cotorra-") && !name.contains(' ');
    let packages: Vec<_> = names.iter().filter(is_package).collect();
    for package in &packages {
        let line = format!("name = \"{package}\"");
        let is_its = |path: &&PathBuf| {
            path.ends_with("Cargo.toml") && fs::read_to_string(path).unwrap().contains(&line)
        };
        let manifest = all.iter().find(is_its).unwrap_or_else(|| panic!("there is no package `{package}`"));
        let folder = manifest.parent().unwrap();
        assert!(all.iter().any(|path| path.starts_with(folder) && has_tests(path)), "{package} has no tests");
    }
    assert!(modules.len() > 15 && packages.len() > 5, "{modules:?} {packages:?}");
}

#[test]
fn links_between_documents_resolve() {
    let folders = ["README.md", "docs/use/plugins.md", "examples/README.md"];
    let folders = folders.map(|document| project_file(document).parent().unwrap().to_owned());
    let files =
        folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap()).map(|file| file.unwrap().path());
    let documents: Vec<_> = files.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    assert!(documents.len() > 8, "{documents:?}");
    for path in documents {
        let text = fs::read_to_string(&path).unwrap();
        let targets = text.split("](").skip(1).map(|rest| rest.split([')', '#']).next().unwrap());
        for target in targets.filter(|target| !target.starts_with("http") && !target.is_empty()) {
            assert!(path.parent().unwrap().join(target).exists(), "{} links to {target}", path.display());
        }
    }
}
