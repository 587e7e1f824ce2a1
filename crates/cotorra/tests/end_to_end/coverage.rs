//! Pictures of coverage: `cotorra check --coverage`.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use crate::harness::{corridor, output, project_file, stderr, stdout};

fn check(testbeds: &[PathBuf], out: &Path) -> Output {
    let files = testbeds.iter().map(|file| file.as_os_str());
    output(["check".as_ref(), "--coverage".as_ref(), out.as_os_str()].into_iter().chain(files))
}

/// Returns the names of all files in a folder, hidden ones included.
fn names(folder: &Path) -> Vec<String> {
    let files = fs::read_dir(folder).unwrap();
    files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn the_corridor_is_drawn_in_all_formats_with_the_same_bytes_each_time() {
    let folder = tempfile::tempdir().unwrap();
    for (format, begin) in [("svg", &b"<svg "[..]), ("pdf", b"%PDF-1.4\n"), ("png", b"\x89PNG\r\n\x1a\n")] {
        let files = ["first", "second"].map(|stem| folder.path().join(stem).with_extension(format));
        let pictures = files.map(|file| {
            let drawn = check(&[corridor()], &file);
            assert!(drawn.status.success(), "{}", stderr(&drawn));
            let shown = format!("{}: mean signal of 6 radio units at a height of 0 m\n", file.display());
            assert!(stdout(&drawn).ends_with(&shown), "{}", stdout(&drawn));
            fs::read(file).unwrap()
        });
        assert!(pictures[0].starts_with(begin), "{format}");
        assert!(pictures[0] == pictures[1], "{format}");
        assert!(pictures[0].len() < 1_000_000, "{format}: {} bytes", pictures[0].len());
    }
    let svg = fs::read_to_string(folder.path().join("first.svg")).unwrap();
    for text in [
        "corridor",
        "mean signal (dBm)",
        "sensitivity: −91.2 dBm",
        "strongest of 6 radio units",
        "R4",
        "R4: channel 11, 15 dBm",
        "x (m)",
        "robot",
        "The mean by path loss alone: walls, shadowing and fading are left out.",
        "At a height of 0 m, that of the robots.",
    ] {
        assert!(svg.contains(&format!(">{text}<")), "{text}");
    }
    // The scale, the strongest of all and six radio units.
    assert_eq!(svg.matches("<image ").count(), 8);
    assert_eq!(names(folder.path()).len(), 6);
}

#[test]
fn a_picture_that_exists_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("signal.svg");
    fs::write(&file, "mine").unwrap();
    let drawn = check(&[corridor()], &file);
    assert_eq!((drawn.status.code(), stdout(&drawn).as_str()), (Some(1), ""));
    assert!(stderr(&drawn).contains("exists already"), "{}", stderr(&drawn));
    assert_eq!(fs::read(&file).unwrap(), b"mine");
    assert_eq!(names(folder.path()), ["signal.svg"]);
}

#[test]
fn a_picture_is_of_one_testbed_with_radio_units() {
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.yaml");
    fs::write(&bad, "name: bad\n").unwrap();
    let two_hosts = project_file("testbeds/two-hosts.yaml");
    let out = folder.path().join("signal.png");
    for (testbeds, reason) in [
        (vec![corridor(), two_hosts.clone()], "draws one testbed, and these are 2 files"),
        (vec![two_hosts], "`two-hosts` has no radio units"),
        (vec![bad], "bad.yaml has "),
    ] {
        let drawn = check(&testbeds, &out);
        assert_eq!(drawn.status.code(), Some(1));
        assert!(stderr(&drawn).contains(reason), "{}", stderr(&drawn));
        assert_eq!(names(folder.path()), ["bad.yaml"]);
    }
}

#[test]
fn names_that_no_picture_can_have_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let unknown = check(&[corridor()], &folder.path().join("signal.gif"));
    assert_eq!(unknown.status.code(), Some(2));
    assert!(stderr(&unknown).contains("must end with .svg, .pdf or .png"), "{}", stderr(&unknown));
    let nowhere = check(&[corridor()], &folder.path().join("no/signal.svg"));
    assert_eq!(nowhere.status.code(), Some(1));
    assert!(stderr(&nowhere).contains("cannot write"), "{}", stderr(&nowhere));
    assert_eq!(names(folder.path()), Vec::<String>::new());
}
