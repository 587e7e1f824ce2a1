//! Figures that other programs open.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::fs;

use cotorra_testing::pdf_readers;

use crate::harness::{corridor, output, stderr, stdout};

#[test]
fn a_figure_as_pdf_opens_with_its_title_and_axes_as_text() {
    let out = tempfile::tempdir().unwrap();
    let folder = out.path().to_str().unwrap();
    let simulate = ["run", "--simulate", "--headless", "--until", "20s", "--figure", "pdf", "--out", folder];
    let run = output(simulate.into_iter().chain([corridor().to_str().unwrap()]));
    assert!(run.status.success(), "{}", stderr(&run));
    let figure = fs::read_dir(folder).unwrap().next().unwrap().unwrap().path().join("service_time.pdf");
    let Some([mut info, mut text]) = pdf_readers() else { return };
    let info = info.arg(&figure).output().unwrap();
    assert!(info.status.success() && info.stderr.is_empty(), "{}", stderr(&info));
    let pages =
        stdout(&info).lines().find_map(|line| line.strip_prefix("Pages:").map(str::trim).map(str::to_owned));
    assert_eq!(pages.as_deref(), Some("1"), "{}", stdout(&info));
    let text = text.arg(&figure).arg("-").output().unwrap();
    assert!(text.status.success() && text.stderr.is_empty(), "{}", stderr(&text));
    let lines = stdout(&text);
    let lines: Vec<_> = lines.lines().map(str::trim).collect();
    for expected in
        ["corridor: service time and attachment", "service time (ms)", "time (s)", "target 15 ms", "R1"]
    {
        assert!(lines.contains(&expected), "{expected}: {lines:?}");
    }
}
