//! Sweeps that are stopped and resumed.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Output, Stdio},
};

use cotorra_testing::lab::{Lab, SETS_DELAY};
use tempfile::TempDir;

use crate::harness::{corridor, cotorra, stderr, stdout};

fn sweep(out: &std::path::Path, seeds: &str) -> Command {
    let mut command =
        cotorra(["sweep", "--headless", "--jobs", "1", "--until", "60s", "--seeds", seeds, "--out"]);
    command.arg(out).arg(corridor()).args(["--set", "links.*.delay_scale=1,2"]);
    command
}

#[test]
fn a_sweep_stopped_by_ctrl_c_is_resumed() {
    let out = tempfile::tempdir().unwrap();
    let folder = out.path().join("sweep");
    let mut child = sweep(&folder, "30").stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let pid = child.id().to_string();
    for line in lines.map_while(Result::ok) {
        if line.starts_with("3 of 60 runs") {
            assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        }
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", stdout(&output));
    assert!(stdout(&output).contains("the same command resumes it"), "{}", stdout(&output));
    let runs = || fs::read_to_string(folder.join("runs.csv")).unwrap();
    let kept = runs();
    assert!((4..60).contains(&kept.lines().count()), "{kept}");

    // With fewer seeds, so that the rest takes less time.
    let dry = sweep(&folder, "3").arg("--dry-run").output().unwrap();
    assert!(
        stdout(&dry).contains("6 runs") && stdout(&dry).contains("the runs that it has are not repeated")
    );
    let rest = sweep(&folder, "3").args(["--figure", "pdf"]).output().unwrap();
    assert!(rest.status.success(), "{}", stderr(&rest));
    assert!(stdout(&rest).contains("6 of 6 runs, 3 of them from before"), "{}", stdout(&rest));
    assert_eq!(runs().lines().count(), 7);
    assert!(runs().lines().nth(3).unwrap() == kept.lines().nth(3).unwrap(), "a run's row stays as it was");
    let cells = fs::read_to_string(folder.join("cells.csv")).unwrap();
    assert!(cells.lines().nth(2).unwrap().starts_with("2,3,20.2"), "{cells}");
    assert!(fs::read_to_string(folder.join("sweep.svg")).unwrap().starts_with("<svg"));
    assert!(fs::read(folder.join("sweep.pdf")).unwrap().starts_with(b"%PDF-1.4"));
    assert!(
        stdout(&rest).contains("  sweep.svg  ") && stdout(&rest).contains("  sweep.pdf\n"),
        "{}",
        stdout(&rest)
    );
}

/// Returns a plug-in that sets the delay of the link.
fn sets_delay(ms: u32) -> String {
    SETS_DELAY.replace("AMOUNT_MS", &ms.to_string())
}

/// Runs the sweep of both plug-ins in a folder.
fn both(lab: &Path, more: &[&str]) -> Output {
    let mut command = cotorra(["sweep", "lab.yaml", "--headless", "--set", "plugin=mine,probing"]);
    command.args(more).current_dir(lab).output().unwrap()
}

fn lab() -> TempDir {
    let lab = tempfile::tempdir().unwrap();
    fs::write(lab.path().join("lab.yaml"), Lab::with_program()).unwrap();
    fs::write(lab.path().join("mine.py"), sets_delay(2)).unwrap();
    lab
}

/// Returns a column of a table.
fn column(table: &Path, name: &str) -> Vec<String> {
    let table = fs::read_to_string(table).unwrap();
    let place = table.lines().next().unwrap().split(',').position(|head| head == name).unwrap();
    table.lines().skip(1).map(|row| row.split(',').nth(place).unwrap().to_owned()).collect()
}

#[test]
fn an_edit_of_the_file_the_program_or_the_limit_gives_new_figures_and_says_so() {
    let lab = lab();
    // With and without a folder of its own.
    for out in [&["--out", "out"][..], &[]] {
        fs::write(lab.path().join("mine.py"), sets_delay(2)).unwrap();
        let sweep = |more: &[&str]| {
            let done = both(lab.path(), &[out, more].concat());
            assert!(done.status.success(), "{}", stderr(&done));
            let text = stdout(&done);
            let folder = text.lines().rev().find_map(|line| line.strip_suffix('/')).unwrap();
            let medians = column(&Path::new(folder).join("runs.csv"), "service_time_p50_ms");
            (text, medians.iter().map(|ms| ms.parse::<f64>().unwrap().round()).collect::<Vec<_>>())
        };
        let (first, medians) = sweep(&[]);
        assert!(first.starts_with("2 of 2 runs\n\n"), "{first}");
        assert_eq!(medians, [6.0, 6.0]);
        assert!(sweep(&[]).0.starts_with("2 of 2 runs, 2 of them from before\n\n"));

        fs::write(lab.path().join("mine.py"), sets_delay(5)).unwrap();
        let (edited, medians) = sweep(&[]);
        let said = "2 of 2 runs, 1 of them from before\nmine.py changed: 1 run again\n";
        assert!(edited.starts_with(said), "{edited}");
        assert_eq!(medians, [12.0, 6.0]);
    }

    let out = ["--out", "out"];
    let table = lab.path().join("out/runs.csv");
    let took = || column(&table, "duration_ms");
    let whole = took();
    let shorter = both(lab.path(), &[&out[..], &["--until", "2s"]].concat());
    assert!(
        stdout(&shorter).starts_with("2 of 2 runs\n--until changed: 2 runs again\n"),
        "{}",
        stdout(&shorter)
    );
    assert_eq!(took(), ["2000", "2000"]);
    assert_ne!(whole, took());

    fs::write(lab.path().join("lab.yaml"), Lab::with_program().replace("delay: 2 ms", "delay: 7 ms"))
        .unwrap();
    let edited = both(lab.path(), &out);
    assert!(stdout(&edited).starts_with("2 of 2 runs\n--until and lab.yaml changed: 2 runs again\n"));
    let medians = column(&table, "service_time_p50_ms");
    assert!(medians[0].starts_with("12.") && medians[1].starts_with("16."), "{medians:?}");
}

#[test]
fn a_plug_in_that_fails_at_its_first_import_makes_its_cell_void() {
    let lab = lab();
    let program = "print('starting')\nimport no_such_module\n";
    fs::write(lab.path().join("mine.py"), program).unwrap();
    let swept = both(lab.path(), &["--out", "out"]);
    assert_eq!(swept.status.code(), Some(3), "{}", stderr(&swept));
    let text = stdout(&swept);
    let reason = "plug-in mine was cut off: its program ended: exit status: 1";
    assert!(text.starts_with("2 of 2 runs, 1 of them void\n"), "{text}");
    let cell = text.lines().find(|line| line.trim_start().starts_with("mine ")).unwrap();
    assert!(cell.contains(&format!("void: {reason}")), "{text}");
    assert!(text.contains("logs/ has the output of plug-ins"), "{text}");
    let out = lab.path().join("out");
    for table in ["runs.csv", "cells.csv", "services.csv", "service_cells.csv", "regions.csv"] {
        assert_eq!(column(&out.join(table), "void")[0], reason, "{table}");
    }
    assert_eq!(column(&out.join("runs.csv"), "service_time_p50_ms")[0], "");
    let logs: Vec<_> = fs::read_dir(out.join("logs")).unwrap().flatten().collect();
    let log = fs::read_to_string(logs[0].path().join("plugins/mine.log")).unwrap();
    assert!(log.contains("starting") && log.contains("No module named 'no_such_module'"), "{log}");

    // With the module that it lacked, it is made again.
    fs::write(lab.path().join("no_such_module.py"), sets_delay(2)).unwrap();
    let mended = both(lab.path(), &["--out", "out"]);
    assert!(mended.status.success(), "{}", stderr(&mended));
    let said = "2 of 2 runs, 1 of them from before\nno_such_module.py changed: 1 run again\n";
    assert!(stdout(&mended).starts_with(said), "{}", stdout(&mended));
    assert!(!out.join("logs").read_dir().unwrap().any(|_| true), "the log of the void run is gone");
}

#[test]
fn a_shard_with_a_void_run_is_merged_as_void() {
    let lab = lab();
    fs::write(lab.path().join("mine.py"), "import no_such_module\n").unwrap();
    for shard in ["1/2", "2/2"] {
        let done = both(lab.path(), &["--out", "out", "--shard", shard]);
        assert!(done.status.success(), "{}", stderr(&done));
    }
    let merged = cotorra(["sweep", "merge", "out"]).current_dir(lab.path()).output().unwrap();
    assert_eq!(merged.status.code(), Some(3), "{}", stderr(&merged));
    assert!(
        stdout(&merged).contains("void: plug-in mine was cut off: its program ended"),
        "{}",
        stdout(&merged)
    );
    assert!(
        lab.path().join("out/shard-1-of-2/logs").exists()
            || lab.path().join("out/shard-2-of-2/logs").exists()
    );

    // One that was edited since is not merged with the other.
    fs::write(lab.path().join("mine.py"), sets_delay(2)).unwrap();
    let done = both(lab.path(), &["--out", "out", "--shard", "1/2"]);
    assert!(stdout(&done).contains("mine.py changed: 1 run again\n"), "{}", stdout(&done));
    let refused = cotorra(["sweep", "merge", "out"]).current_dir(lab.path()).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    let said = stderr(&refused).replace("\n  │ ", " ");
    assert!(said.contains("they have another mine.py"), "{said}");
}
