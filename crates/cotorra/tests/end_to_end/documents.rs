//! Examples and links in the documents.

use std::fs;

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
