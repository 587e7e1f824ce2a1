//! Sweeps in shards: by hand, and by the job files of schedulers.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    collections::BTreeMap,
    env, fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use cotorra_testing::{peers, slurm::Slurm};
use tempfile::TempDir;

use crate::harness::{between_two_units, cotorra, stderr, stdout, wait_until};

/// A folder of a sweep, whose name is hard on shells and Kubernetes.
const OUT: &str = "o $(u)'t%";

/// A folder with a testbed file, whose names are hard on shells, YAML and Snakemake.
struct Lab {
    parent: TempDir,
}

impl Lab {
    fn new() -> Self {
        Self::with_walk("[[0, 0], [9, 0]], speed_limit: 0.7 m/s, position_interval: 50 ms")
    }

    /// A lab whose runs take long enough to be killed.
    fn with_long_runs() -> Self {
        Self::with_walk("[[0, 0], [9, 0], [0, 0], [9, 0]], speed_limit: 0.5 m/s, position_interval: 20 ms")
    }

    fn with_walk(walk: &str) -> Self {
        let lab = Self { parent: tempfile::tempdir().unwrap() };
        fs::create_dir(lab.folder()).unwrap();
        let testbed = between_two_units(&format!("{{ waypoints: {walk} }}"));
        fs::write(lab.folder().join("the lab.yaml"), testbed).unwrap();
        lab
    }

    fn folder(&self) -> PathBuf {
        self.parent.path().join("robots' {lab} $(100)%")
    }

    /// Returns the command of a sweep of 12 runs.
    fn sweep(&self, out: &str, arguments: &[&str]) -> Command {
        let axis = "wireless.w.shadowing={deviation: 2 dB},{deviation: 6 dB}";
        let mut command = self.cotorra(&["sweep", "the lab.yaml", "--set", axis, "--seeds", "6"]);
        command.args(["--jobs", "1", "--keep", "samples", "--out", out]).args(arguments);
        command
    }

    fn merge(&self, arguments: &[&str]) -> Output {
        self.cotorra(&["sweep", "merge"]).args(arguments).output().unwrap()
    }

    /// Returns a command in the folder.
    fn cotorra(&self, arguments: &[&str]) -> Command {
        let mut command = cotorra(arguments);
        command.current_dir(self.folder());
        command
    }

    /// Writes the job file of the sweep in three shards. Returns its path.
    fn emit(&self, scheduler: &str, out: &str) -> PathBuf {
        let emitted = done(&mut self.sweep(out, &["--emit", scheduler, "--shards", "3", "--figure", "pdf"]));
        assert!(stderr(&emitted).starts_with("12 runs in 3 shards of 4 (about "), "{emitted:?}");
        assert!(stderr(&emitted).contains("warning: shards are short"), "{emitted:?}");
        let file = self.parent.path().join("job file");
        fs::write(&file, emitted.stdout).unwrap();
        file
    }

    /// Returns the tables and figures of a sweep.
    fn files(&self, out: &str) -> BTreeMap<String, Vec<u8>> {
        let files = fs::read_dir(self.folder().join(out)).unwrap().flatten().map(|file| file.path());
        let name = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
        let files =
            files.filter(|path| [".csv", ".tex", ".svg", ".pdf"].iter().any(|end| name(path).ends_with(end)));
        files.map(|path| (name(&path), fs::read(&path).unwrap())).collect()
    }

    /// Asserts that the sweep of these shards has the tables, samples and figures of the sweep on one machine.
    fn is_as_on_one_machine(&self, out: &str) {
        done(&mut self.sweep("whole", &["--figure", "pdf"]));
        let (whole, merged) = (self.files("whole"), self.files(out));
        assert_eq!(whole.len(), 11);
        assert_eq!(merged.keys().collect::<Vec<_>>(), whole.keys().collect::<Vec<_>>());
        let [samples, of_shards] = ["whole", out].map(|out| self.files(&format!("{out}/samples")));
        assert!(samples.len() == 12 && samples == of_shards, "{:?}", of_shards.keys());
        for (name, content) in whole {
            assert!(merged[&name] == content, "{name}: {}", String::from_utf8_lossy(&merged[&name]));
        }
    }
}

/// Runs a command, which succeeds.
fn done(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    output
}

/// Returns a command that runs a script.
fn shell(file: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new("sh");
    command.arg(file).args(arguments);
    command
}

/// Returns a `PATH` on which the program is, as in a container.
fn path_with_cotorra() -> String {
    let program = PathBuf::from(cotorra([""; 0]).get_program());
    format!("{}:{}", program.parent().unwrap().display(), env::var("PATH").unwrap())
}

fn lines(path: &Path) -> usize {
    fs::read_to_string(path).map_or(0, |text| text.lines().count())
}

#[test]
fn shards_merge_into_the_bytes_of_the_whole_sweep_although_one_was_killed() {
    let lab = Lab::with_long_runs();
    let shard = |text: &str| lab.sweep("out", &["--headless", "--shard", text]);
    let mut child = shard("2/2").stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let mut progress = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(progress.any(|line| line == "2 of 6 runs"));
    child.kill().unwrap();
    child.wait().unwrap();
    done(&mut shard("1/2"));

    let refused = lab.merge(&["out"]);
    assert_eq!(refused.status.code(), Some(1));
    let said = stderr(&refused);
    assert!(said.contains("of 12 runs are missing") && said.contains("shard 2/2: "), "{said}");
    assert!(said.contains("{deviation: 6 dB} seed=5") && said.contains("--partial"), "{said}");
    assert!(lab.files("out").is_empty(), "nothing is written");
    let partial = lab.merge(&["out", "--partial", "--out", "part"]);
    assert!(partial.status.success() && stdout(&partial).contains("runs are missing"), "{partial:?}");
    assert!((9..=12).contains(&lines(&lab.folder().join("part/runs.csv"))));

    let resumed = done(&mut shard("2/2"));
    assert!(stdout(&resumed).contains("shard 2/2: 6 of 6 runs"), "{resumed:?}");
    assert!(!stderr(&resumed).contains("0 of 6 runs"), "it goes on: {resumed:?}");
    for folders in [&["out"][..], &["out/shard-2-of-2", "out/shard-1-of-2"]] {
        let merged = lab.merge(&[folders, &["--figure", "pdf"]].concat());
        assert!(stdout(&merged).starts_with("12 of 12 runs\n"), "{merged:?}");
        lab.is_as_on_one_machine("out");
    }
    assert_eq!(lines(&lab.folder().join("out/journal.jsonl")), 12);
    let again = done(&mut lab.sweep("out", &[]));
    assert!(stdout(&again).starts_with("12 of 12 runs, 12 of them from before\n"), "{again:?}");
}

#[test]
fn impossible_shards_are_rejected_and_change_nothing() {
    let lab = Lab::new();
    for (arguments, status, said) in [
        (&["--shard", "0/4"][..], 2, "there is no shard 0/4: the shards are 1/4 to 4/4"),
        (&["--shard", "4/3"], 2, "there is no shard 4/3: the shards are 1/3 to 3/3"),
        (&["--shard", "half"], 2, "`half` is not a shard: write it like 3/40"),
        (&["--shard", "1/13"], 1, "there are more shards (13) than runs (12)"),
        (&["--shard", "1/2", "--figure", "pdf"], 1, "give --figure to `cotorra sweep merge`"),
        (&["--shard", "1/2", "--emit", "slurm"], 2, "cannot be used with"),
        (&["--emit", "slurm", "--shards", "13"], 1, "there are more shards (13) than runs (12)"),
        (&["--emit", "pbs"], 2, "slurm, kubernetes, parallel, snakemake"),
        (&["--shards", "2"], 2, "--emit"),
    ] {
        let refused = lab.sweep("out", arguments).output().unwrap();
        assert_eq!(refused.status.code(), Some(status), "{arguments:?}");
        assert!(stderr(&refused).contains(said), "{arguments:?}: {}", stderr(&refused));
        assert!(refused.stdout.is_empty() && !lab.folder().join("out").exists(), "{arguments:?}");
    }
    let unnameable = lab.sweep("a\nb", &["--emit", "parallel"]).output().unwrap();
    assert!(stderr(&unnameable).contains("cannot be written into a job file"), "{unnameable:?}");
}

#[test]
fn the_script_for_gnu_parallel_leaves_the_whole_sweep() {
    let lab = Lab::new();
    let file = lab.emit("parallel", OUT);
    let one = done(&mut shell(&file, &["3"]));
    assert!(stdout(&one).contains("shard 3/3: 4 of 4 runs"), "{one:?}");
    if cotorra_testing::parallel().is_some() {
        done(&mut shell(&file, &[]));
    } else {
        for shard in ["1", "2"] {
            done(&mut shell(&file, &[shard]));
        }
        done(&mut lab.cotorra(&["sweep", "merge", OUT, "--figure", "pdf"]));
    }
    lab.is_as_on_one_machine(OUT);
}

#[test]
fn the_snakefile_leaves_the_whole_sweep() {
    let Some(python) = peers("Snakemake") else { return };
    let lab = Lab::new();
    let file = lab.emit("snakemake", OUT);
    let mut snakemake = Command::new(python);
    snakemake.args(["-m", "snakemake", "--cores", "2", "--scheduler", "greedy", "--snakefile"]).arg(file);
    snakemake.current_dir(lab.parent.path()).env("HOME", lab.parent.path());
    done(&mut snakemake);
    lab.is_as_on_one_machine(OUT);
}

#[test]
fn the_jobs_for_kubernetes_leave_the_whole_sweep() {
    let Some(python) = peers("Kubernetes's schemas") else { return };
    let lab = Lab::new();
    let file = lab.emit("kubernetes", OUT);
    // Also rejects fields that the oldest and the newest supported Kubernetes do not know.
    let read = "import json, sys, yaml, kubernetes_validate
jobs = list(yaml.safe_load_all(open(sys.argv[1])))
for job in jobs:
    for version in '1.35', '1.37':
        kubernetes_validate.validate(job, version, strict=True)
print(json.dumps(jobs))";
    let read = done(Command::new(python).args(["-c", read]).arg(file));
    let jobs: serde_json::Value = serde_json::from_slice(&read.stdout).unwrap();
    let [sweep, merge] = [&jobs[0], &jobs[1]];
    assert_eq!((&sweep["kind"], &merge["kind"]), (&"Job".into(), &"Job".into()));
    assert_eq!(sweep["spec"]["completionMode"], "Indexed");
    assert_eq!(sweep["spec"]["completions"], 3);
    let run = |job: &serde_json::Value, index: &str| {
        let container = &job["spec"]["template"]["spec"]["containers"][0];
        assert_eq!(container["workingDir"], container["volumeMounts"][0]["mountPath"]);
        // As Kubernetes does.
        let words = container["command"]
            .as_array()
            .unwrap()
            .iter()
            .map(|word| word.as_str().unwrap().replace("$$", "$"));
        let words: Vec<_> = words.collect();
        let mut command = Command::new(&words[0]);
        command.args(&words[1..]).current_dir(container["workingDir"].as_str().unwrap());
        done(command.env("PATH", path_with_cotorra()).env("JOB_COMPLETION_INDEX", index))
    };
    for index in ["2", "0", "1"] {
        run(sweep, index);
    }
    run(merge, "");
    lab.is_as_on_one_machine(OUT);
}

#[test]
fn a_slurm_cluster_that_loses_a_node_leaves_the_whole_sweep() {
    let Some(mut slurm) = Slurm::start(2) else { return };
    let lab = Lab::with_long_runs();
    let file = lab.emit("slurm", OUT);
    let submitted = done(slurm.command("sh").arg(file));
    let merge = stdout(&submitted);
    let merge = merge.trim().strip_prefix("Submitted batch job ").unwrap();

    // Both nodes have a shard; one is killed after its first run.
    let journal = |shard: u32| lab.folder().join(OUT).join(format!("shard-{shard}-of-3/journal.jsonl"));
    wait_until(|| lines(&journal(2)) > 0);
    let node = slurm.node_of("2");
    slurm.kill(node);
    let kept = fs::read_to_string(journal(2)).unwrap();
    assert!((1..4).contains(&kept.lines().count()), "{kept}");
    let kept = &kept[..=kept.rfind('\n').unwrap()];

    slurm.wait(merge);
    let log = fs::read_to_string(lab.folder().join(OUT).join("slurm-2.log")).unwrap();
    assert!(log.contains("0 of 4 runs") && log.contains("shard 2/3: 4 of 4 runs"), "{log}");
    assert!(fs::read_to_string(journal(2)).unwrap().starts_with(kept), "no run is lost or repeated");
    assert_eq!(lines(&journal(2)), 4);
    let jobs = slurm.output("scontrol", &["show", "job", "--oneliner"]);
    let requeued = |job: &&str| job.contains("ArrayTaskId=2 ") && job.contains(" Restarts=1 ");
    assert_eq!(stdout(&jobs).lines().filter(requeued).count(), 1, "{}", stdout(&jobs));
    lab.is_as_on_one_machine(OUT);
}
