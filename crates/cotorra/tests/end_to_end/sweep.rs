//! Sweeps that are stopped and resumed.

use std::{
    fs,
    io::{BufRead, BufReader},
    process::{Command, Stdio},
};

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
    assert!(stdout(&rest).contains("sweep.svg  sweep.pdf\n"), "{}", stdout(&rest));
}
