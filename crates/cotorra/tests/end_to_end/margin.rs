//! Margins beside sweeps, searches that are stopped and resumed, and decisions beside their alternatives.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use cotorra_testing::lab::Lab;
use serde_json::Value;

use crate::harness::{cotorra, project_file, stderr, stdout};

/// Writes a testbed with a robot that goes from A to B, whose link is the slower one.
fn write(file: PathBuf, plugin: &str) -> PathBuf {
    let lab = Lab {
        roaming: "instructed",
        b: Some(8),
        links: &[("lan, A", "1 ms"), ("lan, B", "2 ms"), ("lan, edge", "1 ms")],
        walk: "{ waypoints: [[0, 0], [8, 0]], speed_limit: 0.7 m/s, position_interval: 50 ms }",
        rest: &format!("plugins:\n  - {{ {plugin} }}\n"),
        ..Lab::default()
    };
    fs::write(&file, lab.to_string()).unwrap();
    file
}

/// Writes it with a program as its plug-in.
fn with_program(folder: &Path, command: &str) -> PathBuf {
    write(folder.join("program.yaml"), &format!("id: mine, command: [{command}]"))
}

/// The Python example, which scans every second and attaches to the strongest radio unit.
fn strongest_signal() -> String {
    format!("python3, {}, '1'", project_file("examples/strongest_signal.py").display())
}

/// Writes it with `probing`, which attaches the robot to B in the meantime.
fn lab(folder: &Path) -> PathBuf {
    write(folder.join("lab.yaml"), "bundled: probing, settings: { interval: 3 s }")
}

fn margin(folder: &Path, out: &str) -> Command {
    let mut command =
        cotorra(["margin", "--headless", "--jobs", "1", "--keep", "0.9", "--kpi", "navigation"]);
    command.arg(lab(folder)).arg("--out").arg(folder.join(out));
    command
}

/// Returns the `breaks` figure of the only search, as many times the resolution above `survives`.
fn breaks_at(folder: &Path, quantity: &str, resolution: f64) -> f64 {
    let margins = fs::read_to_string(folder.join("margin/margins.json")).unwrap();
    let found = serde_json::from_str::<Value>(&margins).unwrap()["findings"].clone();
    assert_eq!(found.as_array().unwrap().len(), 1);
    let [survives, breaks] =
        ["survives", "breaks"].map(|end| found[0][format!("{end}_{quantity}")].as_f64().unwrap());
    assert!((breaks - survives - resolution).abs() < 1e-9, "{survives} {breaks}");
    breaks
}

/// Sweeps an axis. Returns each value, without its unit, and whether it breaks the target.
fn swept(folder: &Path, axis: &str, unit: &str) -> Vec<(f64, bool)> {
    let mut sweep = cotorra(["sweep", "--headless", "--set", axis, "--out"]);
    let sweep = sweep.arg(folder.join("sweep")).arg(lab(folder)).output().unwrap();
    assert!(sweep.status.success(), "{}", stderr(&sweep));
    let table = fs::read_to_string(folder.join("sweep/runs.csv")).unwrap();
    let column = table.lines().next().unwrap().split(',').position(|name| name == "above_target").unwrap();
    let rows = table.lines().skip(1).map(|row| row.split(',').collect::<Vec<_>>());
    rows.map(|row| {
        (row[0].trim_end_matches(unit).parse().unwrap(), row[column].parse::<f64>().unwrap() > 0.1)
    })
    .collect()
}

#[test]
fn a_margin_agrees_with_a_sweep_over_the_same_axis() {
    let out = tempfile::tempdir().unwrap();
    let bounds = ["--change", "delay", "--on", "lan-edge", "--most", "8ms", "--resolution", "0.5ms"];
    let found = margin(out.path(), "margin").args(bounds).output().unwrap();
    assert!(found.status.success(), "{}", stderr(&found));
    let breaks = breaks_at(out.path(), "ms", 0.5);
    let sentence = format!("delay: fails first at +{breaks} ms on lan-edge.");
    assert!(stdout(&found).contains(&sentence), "{}", stdout(&found));

    let values = swept(out.path(), "links.lan-edge.delay=1..9:0.5 ms", " ms");
    assert_eq!(values.len(), 17);
    for (delay, is_broken) in values {
        assert_eq!(is_broken, delay - 1.0 >= breaks, "{delay}");
    }
}

#[test]
fn a_margin_of_loss_on_the_air_agrees_with_a_sweep() {
    let out = tempfile::tempdir().unwrap();
    let bounds = ["--change", "loss", "--on", "w", "--most-loss", "10%", "--loss-resolution", "1%"];
    let found = margin(out.path(), "margin").args(bounds).output().unwrap();
    assert!(found.status.success(), "{}", stderr(&found));
    let breaks = breaks_at(out.path(), "loss", 0.01);
    assert!((0.02..0.09).contains(&breaks), "0.95² is 0.9: {breaks}");

    let values = swept(out.path(), "wireless.w.loss=0..10:1 %", " %");
    assert_eq!(values.len(), 11);
    let tested = [breaks - 0.01, breaks].map(|share| (share * 100.0).round());
    for (percent, is_broken) in values {
        if tested.contains(&percent) || percent == 0.0 {
            assert_eq!(is_broken, percent == tested[1], "{percent} %");
        }
    }
}

#[test]
fn a_search_stopped_by_ctrl_c_is_resumed_to_the_same_bytes() {
    let out = tempfile::tempdir().unwrap();
    let search = |name: &str| {
        let mut command = margin(out.path(), name);
        command.args(["--change", "delay,answers,down", "--most", "20ms", "--resolution", "1ms"]);
        command
    };
    let whole = search("whole").output().unwrap();
    assert!(whole.status.success(), "{}", stderr(&whole));
    let mut child = search("stopped").stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let pid = child.id().to_string();
    for line in BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok) {
        if line.starts_with("2 of ") {
            assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        }
    }
    let stopped = child.wait_with_output().unwrap();
    assert_eq!(stopped.status.code(), Some(130), "{}", stdout(&stopped));
    assert!(stdout(&stopped).contains("the same command resumes it"), "{}", stdout(&stopped));

    let dry = search("stopped").arg("--dry-run").output().unwrap();
    assert!(stdout(&dry).contains("the runs that it has are not repeated"), "{}", stdout(&dry));
    let rest = search("stopped").output().unwrap();
    assert!(rest.status.success() && stdout(&rest).contains(" of them from before"), "{}", stdout(&rest));
    for name in ["margins.csv", "margins.json"] {
        let [whole, resumed] = ["whole", "stopped"]
            .map(|folder| fs::read_to_string(out.path().join(folder).join(name)).unwrap());
        assert_eq!(whole, resumed);
    }
    assert!(stdout(&rest).contains("radio units: survives any single one down."), "{}", stdout(&rest));
}

#[test]
fn a_decision_is_compared_with_its_alternatives() {
    let out = tempfile::tempdir().unwrap();
    let examine = |more: &[&str]| {
        let mut command = cotorra(["margin", "--headless"]);
        command.arg(lab(out.path())).arg("--out").arg(out.path().join("decisions")).args(more);
        command.output().unwrap()
    };
    let dry = examine(&["--decision", "all", "--dry-run"]);
    assert!(stdout(&dry).starts_with("1 decision, 1 run with alternatives\n"), "{}", stdout(&dry));
    let one = examine(&["--decision", "1"]);
    let text = stdout(&one);
    assert!(text.contains("probing chose B for robot") && text.contains("A (no change)"), "{text}");
    // B's link takes 1 ms more in each direction.
    assert!(text.contains("and +2.0") || text.contains("and +1.9"), "{text}");
    let table = fs::read_to_string(out.path().join("decisions/decisions.csv")).unwrap();
    assert_eq!(table.lines().count(), 3, "{table}");
    assert!(stdout(&examine(&["--decision", "all"])).contains("1 of them from before"));

    let beyond = examine(&["--decision", "7"]);
    assert_eq!(beyond.status.code(), Some(1));
    assert!(stderr(&beyond).contains("--dry-run` lists the decisions"), "{}", stderr(&beyond));
}

#[test]
fn plug_ins_that_are_programs_take_part_in_searches() {
    let out = tempfile::tempdir().unwrap();
    let file = with_program(out.path(), &strongest_signal());
    let search = |name: &str, jobs: &str| {
        let mut command = cotorra(["margin", "--headless", "--keep", "0.9", "--jobs", jobs]);
        command.args(["--change", "delay", "--on", "lan-edge", "--on", "lan-B", "--singles"]);
        command.args(["--most", "8ms", "--resolution", "1ms"]).arg(&file).arg("--out");
        let found = command.arg(out.path().join(name)).output().unwrap();
        assert!(found.status.success(), "{}", stderr(&found));
        let text = fs::read_to_string(out.path().join(name).join("margins.json")).unwrap();
        let mut names: Vec<_> =
            fs::read_dir(out.path().join(name)).unwrap().flatten().map(|file| file.file_name()).collect();
        names.sort();
        let expected = ["inputs", "journal.jsonl", "manifest.json", "margins.csv", "margins.json"];
        assert_eq!(names, expected, "a run's folder is left");
        text
    };
    let one = search("one", "1");
    // Several at a time, each with its own API.
    assert_eq!(search("two", "2"), one);
    let margins: Value = serde_json::from_str(&one).unwrap();
    let findings = margins["findings"].as_array().unwrap();
    assert_eq!(findings.len(), 2, "{one}");
    // The robot goes to B in time only if the program attaches it there.
    assert!(findings.iter().all(|finding| finding["breaks"] == true), "{one}");
}

#[test]
fn decisions_of_programs_are_compared_with_their_alternatives() {
    let out = tempfile::tempdir().unwrap();
    let file = with_program(out.path(), &strongest_signal());
    let examine = |more: &[&str]| {
        let mut command = cotorra(["margin", "--headless", "--decision", "1"]);
        command.arg(&file).arg("--out").arg(out.path().join("decisions")).args(more);
        let done = command.output().unwrap();
        assert!(done.status.success(), "{}", stderr(&done));
        stdout(&done)
    };
    let dry = examine(&["--dry-run"]);
    assert!(dry.starts_with("1 decision, 1 run with alternatives\n") && dry.contains("mine"), "{dry}");
    assert!(!out.path().join("decisions").exists());
    let text = examine(&[]);
    assert!(text.contains("mine chose B for robot: B is received with"), "{text}");
    assert!(text.contains("A (no change)") && text.contains("Regret: "), "{text}");
}

#[test]
fn a_program_that_fails_ends_a_search_with_its_log() {
    let out = tempfile::tempdir().unwrap();
    let file = with_program(out.path(), "sh, -c, 'echo no such luck; exit 1'");
    for more in [&["--change", "down"][..], &["--decision", "all"]] {
        let folder = out.path().join(more[1]);
        let mut command = cotorra(["margin", "--headless", "--jobs", "1"]);
        let failed = command.arg(&file).arg("--out").arg(&folder).args(more).output().unwrap();
        assert_eq!(failed.status.code(), Some(3));
        let text = stderr(&failed).replace("\n  │ ", " ");
        assert!(text.contains("plug-in mine was cut off: ") && text.contains("its log is in"), "{text}");
        // That of the run as it was is in its own folder.
        let folders = [folder.join("logs"), folder.join("run-as-it-was")];
        let folders = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten();
        let logs: Vec<_> =
            folders.filter_map(|at| fs::read_to_string(at.path().join("plugins/mine.log")).ok()).collect();
        assert_eq!(logs, ["no such luck\n"]);
    }
}

#[test]
fn an_edit_of_the_file_the_program_or_the_settings_is_searched_anew() {
    let out = tempfile::tempdir().unwrap();
    fs::copy(project_file("examples/strongest_signal.py"), out.path().join("mine.py")).unwrap();
    let file = with_program(out.path(), "python3, mine.py, '1'");
    let search = |more: &[&str]| {
        let mut command =
            cotorra(["margin", "--headless", "--keep", "0.9", "--singles", "--change", "delay"]);
        command.args(["--on", "lan-edge", "--most", "8ms", "--resolution", "1ms"]).args(more).arg(&file);
        let found = command.arg("--out").arg(out.path().join("margin")).output().unwrap();
        assert!(found.status.success(), "{}", stderr(&found));
        stdout(&found)
    };
    let breaks = || breaks_at(out.path(), "ms", 1.0);
    let first = search(&[]);
    let before = breaks();
    assert!(!first.contains("again") && search(&[]).contains(" of them from before; "), "{first}");

    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("ends: [lan, edge], delay: 1 ms", "ends: [lan, edge], delay: 3 ms"))
        .unwrap();
    let edited = search(&[]);
    assert!(edited.contains("\nprogram.yaml changed: ") && !edited.contains("from before"), "{edited}");
    assert_eq!(breaks(), before - 2.0);
    let set = search(&["--set", "links.lan-edge.delay=1 ms"]);
    assert!(set.contains("\n--set changed: "), "{set}");
    assert_eq!(breaks(), before);
    let until = search(&["--until", "1min"]);
    assert!(until.contains("\n--until changed: ") || until.contains("\n--until and "), "{until}");

    let program = fs::read_to_string(out.path().join("mine.py")).unwrap();
    fs::write(out.path().join("mine.py"), program + "\n# Edited.\n").unwrap();
    let edited = search(&["--until", "1min"]);
    assert!(edited.contains("\nmine.py changed: ") && !edited.contains("from before"), "{edited}");
}

#[test]
fn a_target_that_is_broken_already_is_an_error_with_advice() {
    let out = tempfile::tempdir().unwrap();
    let broken =
        margin(out.path(), "broken").args(["--set", "services.navigation.kpis.service_time=4ms"]).output();
    let broken = broken.unwrap();
    assert_eq!(broken.status.code(), Some(1));
    let text = stderr(&broken).replace("\n  │ ", " ");
    assert!(text.contains("before anything changes") && text.contains("lower --keep"), "{text}");
    let wrong = margin(out.path(), "broken").args(["--most", "1ms", "--resolution", "2ms"]).output().unwrap();
    assert!(stderr(&wrong).contains("--resolution is above zero, and at most --most"), "{}", stderr(&wrong));
}
