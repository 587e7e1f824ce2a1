//! `cotorra localize` on the simulated log of a robot in a room.

#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{f64::consts::PI, fmt::Write as _, fs, path::Path};

use crate::harness::{output, stderr, stdout};

/// Writes the map of a room of 6 m × 4 m with walls of 0.1 m, and the log of a walk through it. Odometry is 3 % too long.
fn room(folder: &Path) {
    let (width, height) = (124, 84);
    let mut picture = format!("P5\n{width} {height}\n255\n").into_bytes();
    for row in 0..height {
        for column in 0..width {
            let wall = row < 2 || column < 2 || row >= height - 2 || column >= width - 2;
            picture.push(if wall { 0 } else { 254 });
        }
    }
    fs::write(folder.join("room.pgm"), picture).unwrap();
    let yaml = "image: room.pgm\nresolution: 0.05\norigin: [-0.1, -0.1, 0]\n";
    fs::write(folder.join("room.yaml"), yaml).unwrap();
    let (mut log, mut reference) = ("# a log\n".to_owned(), "time,x,y,heading\n".to_owned());
    for scan in 0..40 {
        let (x, y) = (1.0 + 0.1 * f64::from(scan), 1.5);
        log += "FLASER 180";
        for beam in 0..180 {
            let (sin, cos) = (f64::from(beam) * PI / 180.0 - PI / 2.0).sin_cos();
            let towards = |along: f64, at: f64, side: f64| match along {
                along if along > 1e-9 => (side - at) / along,
                along if along < -1e-9 => -at / along,
                _ => f64::INFINITY,
            };
            write!(log, " {:.3}", towards(cos, x, 6.0).min(towards(sin, y, 4.0))).unwrap();
        }
        let odometry = 7.0 + 0.103 * f64::from(scan);
        writeln!(log, " {odometry:.3} 2 0 {odometry:.3} 2 0 {scan} host {scan}").unwrap();
        writeln!(reference, "{scan},{x},{y},0").unwrap();
    }
    fs::write(folder.join("log"), log).unwrap();
    fs::write(folder.join("reference.csv"), reference).unwrap();
}

fn localize(folder: &Path, more: &[&str]) -> std::process::Output {
    let at = |name: &str| folder.join(name).display().to_string();
    let (map, log, reference) = (at("room.yaml"), at("log"), at("reference.csv"));
    let given = ["localize", "--map", &map, "--log", &log, "--reference", &reference];
    output(given.into_iter().chain(more.iter().copied()))
}

#[test]
fn a_log_becomes_a_trajectory_and_its_error() {
    let folder = tempfile::tempdir().unwrap();
    room(folder.path());
    let found = localize(folder.path(), &[]);
    assert!(found.status.success(), "{}", stderr(&found));
    let table = stdout(&found);
    assert_eq!(table.lines().count(), 41);
    let last: Vec<f64> = table.lines().last().unwrap().split(',').map(|cell| cell.parse().unwrap()).collect();
    assert!((last[1] - 4.9).abs() < 0.1 && (last[2] - 1.5).abs() < 0.1, "{last:?}");
    let errors = stderr(&found);
    assert!(errors.contains("40 of 40 scans") && errors.contains("lost (over 1 m) 0.00 %"), "{errors}");
    // The same seed gives the same table, another one does not.
    assert_eq!(table, stdout(&localize(folder.path(), &["--seed", "1"])));
    assert_ne!(table, stdout(&localize(folder.path(), &["--seed", "2"])));

    let out = folder.path().join("found.csv");
    let found = localize(folder.path(), &["--mode", "amcl", "--out", out.to_str().unwrap()]);
    assert!(stdout(&found).contains("position RMSE"), "{}", stdout(&found));
    assert_eq!(fs::read_to_string(out).unwrap().lines().count(), 41);
}

#[test]
fn an_invalid_log_is_rejected_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    room(folder.path());
    let log = folder.path().join("log");
    let wrong = fs::read_to_string(&log).unwrap().replacen("FLASER 180", "FLASER 190", 2);
    fs::write(&log, wrong).unwrap();
    let found = localize(folder.path(), &[]);
    assert_eq!(found.status.code(), Some(1));
    assert!(stderr(&found).contains("line 2: "), "{}", stderr(&found));
    fs::write(&log, "PARAM robot_width 1\n").unwrap();
    assert!(stderr(&localize(folder.path(), &[])).contains("has no laser message"));
    fs::remove_file(&log).unwrap();
    assert!(stderr(&localize(folder.path(), &[])).contains("cannot read"));
}

/// Removes the line breaks and bars of a diagnostic.
fn in_one_line(errors: &str) -> String {
    errors.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

#[test]
fn unusable_odometry_maps_and_scans_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    room(folder.path());
    let at = |name: &str| folder.path().join(name);
    let log = fs::read_to_string(at("log")).unwrap();
    let told = |changed: &str| {
        fs::write(at("log"), changed).unwrap();
        let found = localize(folder.path(), &[]);
        (found.status.code(), in_one_line(&stderr(&found)))
    };
    // The odometry of the second scan.
    let (code, errors) = told(&log.replacen(" 7.103 2 0", " 1e300 2 0", 2));
    assert!(
        code == Some(1) && errors.contains("line 3: the laser's pose of `FLASER` is (1e300, 2.0)"),
        "{errors}"
    );
    let (code, errors) = told(&log.replacen("FLASER 180", "FLASER -5", 1));
    assert!(code == Some(1) && errors.contains("announces -5 ranges, which is no count"), "{errors}");
    // Beams that hit nothing: in one scan, and in all.
    let blind = |line: &str| {
        let fields: Vec<&str> = line.split(' ').collect();
        if fields[0] != "FLASER" {
            return format!("{line}\n");
        }
        format!("FLASER 180{} {}\n", " 0".repeat(180), fields[182..].join(" "))
    };
    let line = log.lines().nth(5).unwrap();
    let (code, errors) = told(&log.replacen(&format!("{line}\n"), &blind(line), 1));
    assert!(code == Some(0) && errors.contains("warning: 1 scans have no beam"), "{errors}");
    let (code, errors) = told(&log.lines().map(blind).collect::<String>());
    assert!(code == Some(1) && errors.contains("has a beam that hit anything within 80 m"), "{errors}");

    fs::write(at("log"), &log).unwrap();
    for (level, missing) in [(254, "wall"), (0, "free cell")] {
        let mut picture = b"P5\n124 84\n255\n".to_vec();
        picture.resize(picture.len() + 124 * 84, level);
        fs::write(at("room.pgm"), picture).unwrap();
        let found = localize(folder.path(), &[]);
        assert_eq!(found.status.code(), Some(1));
        let errors = in_one_line(&stderr(&found));
        assert!(errors.contains(&format!("the map has no {missing}")), "{errors}");
    }
}
