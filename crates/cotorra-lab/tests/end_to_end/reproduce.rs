//! Experiments that are made again from their folder alone.

use std::{fs, path::Path, process::Command};

use cotorra_testing::{stderr, stdout};
use tempfile::TempDir;

use crate::{corridor, cotorra, lab};

/// Asserts that a folder is reproduced by this `reproduce`, from the root folder. Returns what it prints.
fn is_reproduced(mut reproduce: Command, folder: &Path) -> String {
    let done = reproduce.arg(folder).current_dir("/").output().unwrap();
    assert_eq!(done.status.code(), Some(0), "{}{}", stdout(&done), stderr(&done));
    assert!(stdout(&done).ends_with("\nREPRODUCED\n"), "{}", stdout(&done));
    stdout(&done)
}

#[test]
fn an_experiment_is_reproduced_with_its_walks() {
    let place = TempDir::new().unwrap();
    let walk: String = (0..100).map(|i| format!("{},{}\n", i as f64 / 10.0, 12 + i % 7)).collect();
    fs::write(place.path().join("walk.csv"), walk).unwrap();
    let line = "experiment okpi --until 10s --set links.*.delay_scale=2 --measured OKpi=walk.csv --headless --out runs --testbed";
    let done = lab(line.split(' ')).arg(corridor()).current_dir(place.path()).output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    fs::remove_file(place.path().join("walk.csv")).unwrap();
    let folder = fs::read_dir(place.path().join("runs")).unwrap().next().unwrap().unwrap().path();
    let plan = lab(["reproduce", "--dry-run"]).arg(&folder).output().unwrap();
    assert!(stdout(&plan).contains("\n  cotorra-lab experiment okpi "), "{}", stdout(&plan));
    let printed = is_reproduced(lab(["reproduce"]), &folder);
    for walk in ["okpi: all files", "probing: all files"] {
        assert!(printed.contains(walk), "{printed}");
    }
    // A walk is a run of its own.
    is_reproduced(cotorra(["reproduce"]), &folder.join("okpi"));

    // Each program repeats what it makes.
    for (mut program, folder) in
        [(cotorra(["reproduce"]), folder.clone()), (lab(["reproduce"]), folder.join("okpi"))]
    {
        let refused = program.arg(&folder).output().unwrap();
        assert_eq!(refused.status.code(), Some(1), "{}", stdout(&refused));
        let advice = stderr(&refused).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(advice.contains("`cotorra-lab reproduce`"), "{advice}");
    }
}
