//! What the documents show is right.

use std::fs;

use crate::harness::{output, project_file, stderr};

/// The YAML blocks of a document.
fn yaml(text: &str) -> impl Iterator<Item = &str> {
    text.split("\n```yaml\n").skip(1).filter_map(|rest| rest.split_inclusive("\n```").next())
}

#[test]
fn testbeds_in_the_documents_pass_the_check() {
    let folder = tempfile::tempdir().unwrap();
    let documents =
        ["README.md", "docs/testbed-file.md"].map(|d| fs::read_to_string(project_file(d)).unwrap());
    let blocks = documents.iter().flat_map(|document| yaml(document));
    let whole: Vec<_> =
        blocks.filter(|block| block.starts_with("name:")).map(|block| block.trim_end_matches('`')).collect();
    assert!(whole.len() >= 3, "{}", whole.len());
    for (i, testbed) in whole.iter().enumerate() {
        let file = folder.path().join(format!("{i}.yaml"));
        fs::write(&file, testbed).unwrap();
        let checked = output(["check".as_ref(), file.as_os_str()]);
        assert!(checked.status.success(), "{testbed}\n{}", stderr(&checked));
    }
}

#[test]
fn links_between_the_documents_lead_somewhere() {
    for document in
        ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "docs/testbed-file.md", "docs/plugins.md"]
    {
        let path = project_file(document);
        let text = fs::read_to_string(&path).unwrap();
        let targets = text.split("](").skip(1).map(|rest| rest.split([')', '#']).next().unwrap());
        for target in targets.filter(|target| !target.starts_with("http") && !target.is_empty()) {
            assert!(path.parent().unwrap().join(target).exists(), "{document} links to {target}");
        }
    }
}
