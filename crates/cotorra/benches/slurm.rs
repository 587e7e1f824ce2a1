//! Cost of a cluster: a sweep of 280 walks on two nodes of Slurm, beside the same sweep without Slurm. Starts its own
//! cluster on this machine. Run with `cargo bench -p cotorra --bench slurm`.
#![allow(
    clippy::disallowed_types,
    clippy::unwrap_used,
    reason = "a benchmark reads the clock, and panics on failures"
)]

use std::{
    fs,
    path::Path,
    process::{Command, Output},
    time::{Duration, Instant},
};

use cotorra_testing::{project_file, slurm::Slurm};

const SWEEP: [&str; 6] =
    ["--set", "links.*.delay_scale=0.5..2:0.25", "--set", "plugin=probing,okpi", "--seeds", "20"];

fn main() {
    // As `cargo test --benches` calls it.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let slurm = Slurm::start(2).expect("Slurm is installed");
    let folder = tempfile::tempdir().unwrap();
    let times = folder.path().join("times");
    let sweep = |out: &str, arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_cotorra"));
        command.arg("sweep").arg(project_file("testbeds/corridor.yaml")).args(SWEEP);
        command.args(["--out", out]).args(arguments).current_dir(folder.path());
        command
    };

    let local = sweep("local", &["--jobs", "2"]);
    let words: Vec<_> = local.get_args().map(|word| format!("'{}'", word.to_str().unwrap())).collect();
    let script = format!("exec '{}' {}\n", env!("CARGO_BIN_EXE_cotorra"), words.join(" "));
    let local = measured("without Slurm, two at a time", &times, || {
        succeeds(Command::new("sh").args(["-c", &timed(&script, &times)]).current_dir(folder.path()));
    });

    let job = succeeds(&mut sweep("slurm", &["--emit", "slurm", "--shards", "2"]));
    let job = timed(std::str::from_utf8(&job.stdout).unwrap(), &times);
    let cluster = measured("on two nodes of Slurm", &times, || {
        let submitted = succeeds(slurm.command("sh").args(["-c", &job]));
        let submitted = String::from_utf8(submitted.stdout).unwrap();
        slurm.wait(submitted.trim().rsplit(' ').next().unwrap());
    });

    let table = |out: &str| fs::read(folder.path().join(out).join("runs.csv")).unwrap();
    assert!(table("local") == table("slurm"), "both sweeps have the same runs");
    println!("{:<30} {:>+10.1} %", "difference of CPU time", (cluster / local - 1.0) * 100.0);
}

/// Prints what something took. Returns its CPU time in seconds, which it adds to a file of `times`.
fn measured(name: &str, times: &Path, run: impl FnOnce()) -> f64 {
    let _ = fs::remove_file(times);
    let began = Instant::now();
    run();
    let took: Duration = began.elapsed();
    let cpu_s: f64 = fs::read_to_string(times).unwrap().split_whitespace().map(seconds).sum();
    println!("{name:<30} {cpu_s:>10.1} s of CPU time, {:.1} s", took.as_secs_f64());
    cpu_s
}

/// Lets a script add the CPU time of each program that it ends with to a file.
fn timed(script: &str, times: &Path) -> String {
    let line = |line: &str| match line.strip_prefix("exec ") {
        Some(program) => format!("{program} && times >> '{}'\n", times.display()),
        None => format!("{line}\n"),
    };
    script.lines().map(line).collect()
}

/// Reads a time such as `1m2.5s`.
fn seconds(time: &str) -> f64 {
    let (minutes, seconds) = time.strip_suffix('s').unwrap().split_once('m').unwrap();
    minutes.parse::<f64>().unwrap() * 60.0 + seconds.parse::<f64>().unwrap()
}

fn succeeds(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    output
}
