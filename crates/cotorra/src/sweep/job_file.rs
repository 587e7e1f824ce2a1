//! Job files: a sweep in shards for a scheduler, with a last step that merges them.

use std::{
    ffi::{OsStr, OsString},
    num::NonZero,
    path::PathBuf,
};

use clap::ValueEnum;

use crate::exit::Status;

/// Exit status of a merge with void runs.
const NOT_VALID: u8 = Status::NotValid.number();

/// Programs that run job files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Scheduler {
    /// A shell script that submits an array of tasks, and a job that depends on them
    Slurm,
    /// An Indexed Job and a Job that merges, for kubectl
    Kubernetes,
    /// A shell script with GNU parallel, for one machine or several that are reached by SSH
    Parallel,
    /// A Snakefile
    Snakemake,
}

/// A sweep in shards.
pub struct Job {
    /// Describes the runs and the shards in a line.
    pub summary: String,
    /// Folder that paths are relative to.
    pub folder: PathBuf,
    /// Folder of the sweep.
    pub out: PathBuf,
    /// Command line of a shard, but for `--shard` and its value.
    pub run: Vec<OsString>,
    /// Command line that merges the shards.
    pub merge: Vec<OsString>,
    pub shards: NonZero<usize>,
    /// Number of runs of a shard at a time.
    pub jobs: NonZero<usize>,
}

/// A word cannot stand in a job file.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error(
    "{0:?} cannot be written into a job file: it is not UTF-8, or has a line break or another control character"
)]
#[diagnostic(help("choose another path or value"))]
pub struct JobFileError(OsString);

/// The texts that all job files have.
struct Parts<'a> {
    summary: &'a str,
    folder: &'a str,
    out: &'a str,
    /// The path of `out`, whatever the current folder is.
    place: &'a str,
    /// Command line for a shell.
    run: String,
    /// Command line for a shell.
    merge: String,
    shards: usize,
    jobs: usize,
}

impl Job {
    /// Returns the job file.
    ///
    /// # Errors
    /// [`JobFileError`].
    pub fn file(&self, scheduler: Scheduler) -> Result<String, JobFileError> {
        let line = |words: &[OsString]| -> Result<String, JobFileError> {
            let words: Vec<_> = words.iter().map(|word| Ok(quoted(text(word)?))).collect::<Result<_, _>>()?;
            Ok(words.join(" "))
        };
        let place = self.folder.join(&self.out);
        let parts = Parts {
            summary: text(OsStr::new(&self.summary))?,
            folder: text(self.folder.as_os_str())?,
            out: text(self.out.as_os_str())?,
            place: text(place.as_os_str())?,
            run: line(&self.run)?,
            merge: line(&self.merge)?,
            shards: self.shards.get(),
            jobs: self.jobs.get(),
        };
        Ok(match scheduler {
            Scheduler::Slurm => parts.slurm(),
            Scheduler::Kubernetes => parts.kubernetes(),
            Scheduler::Parallel => parts.parallel(),
            Scheduler::Snakemake => parts.snakemake(),
        })
    }
}

impl Parts<'_> {
    fn slurm(&self) -> String {
        let Self { summary, run, merge, shards, jobs, .. } = self;
        let (folder, out) = (quoted(self.folder), quoted(self.out));
        // Slurm replaces patterns such as %a in names of files.
        let log = |name: &str| quoted(&format!("{}/slurm-{name}.log", self.out.replace('%', "%%")));
        let (logs, log) = (log("%a"), log("merge"));
        format!(
            r#"#!/bin/sh
# {summary}.
# Submit with `sh FILE`. If shards fail, submit again: they go on with the runs that they have.
# Add to both sbatch what your cluster wants, such as --partition, --account or --time.
set -eu
# All nodes must share this folder.
cd {folder}
mkdir -p {out}
shards=$(sbatch --parsable --job-name=sweep --array=1-{shards} --cpus-per-task={jobs} --requeue \
    --open-mode=append --output={logs} <<'END'
#!/bin/sh
exec {run} --shard "$SLURM_ARRAY_TASK_ID/{shards}"
END
)
sbatch --job-name=sweep-merge --dependency="afterok:${{shards%%;*}}" --kill-on-invalid-dep=yes \
    --output={log} <<'END'
#!/bin/sh
exec {merge}
END
"#
        )
    }

    fn kubernetes(&self) -> String {
        let Self { summary, shards, jobs, .. } = self;
        let folder = json(self.folder);
        // Kubernetes replaces $(NAME) in commands, and $$ by $.
        let [run, merge] = [&self.run, &self.merge].map(|line| line.replace('$', "$$"));
        let run = json(&format!(r#"exec {run} --shard "$((JOB_COMPLETION_INDEX + 1))/{shards}""#));
        // With void runs, its status is 3.
        let merge = json(&format!("until {merge} || [ $? -eq {NOT_VALID} ]; do sleep 60; done"));
        format!(
            r#"# {summary}.
# Start with `kubectl create -f FILE`. A shard that was killed goes on with the runs that it has.
# Set `image`, which has cotorra, and `claimName`, a volume for all nodes with the files of the folder in `workingDir`.
apiVersion: batch/v1
kind: Job
metadata: {{generateName: sweep-}}
spec:
  completionMode: Indexed
  completions: {shards}
  parallelism: {shards}
  backoffLimit: {retries}
  template:
    spec:
      restartPolicy: OnFailure
      volumes: [{{name: sweep, persistentVolumeClaim: {{claimName: SET-A-CLAIM}}}}]
      containers:
        - name: shard
          image: SET-AN-IMAGE
          workingDir: {folder}
          volumeMounts: [{{name: sweep, mountPath: {folder}}}]
          resources: {{requests: {{cpu: {jobs}}}}}
          command: [sh, -c, {run}]
---
# Waits until no run is missing.
apiVersion: batch/v1
kind: Job
metadata: {{generateName: sweep-merge-}}
spec:
  template:
    spec:
      restartPolicy: OnFailure
      volumes: [{{name: sweep, persistentVolumeClaim: {{claimName: SET-A-CLAIM}}}}]
      containers:
        - name: merge
          image: SET-AN-IMAGE
          workingDir: {folder}
          volumeMounts: [{{name: sweep, mountPath: {folder}}}]
          command: [sh, -c, {merge}]
"#,
            retries = shards * 6,
        )
    }

    fn parallel(&self) -> String {
        let Self { summary, run, merge, shards, jobs, .. } = self;
        let folder = quoted(self.folder);
        // Each shard takes several CPUs.
        let share = (100 / jobs).max(1);
        format!(
            r#"#!/bin/sh
# {summary}.
# Run with `sh FILE`, or `sh FILE 3` for shard 3 alone. If it ends early, run it again: it goes on with the runs that it has.
# For several machines that share this file and the folder, add `--sshlogin host1,host2` to parallel.
set -eu
file=$(realpath "$0")
cd {folder}
if [ $# -gt 0 ]; then
    exec {run} --shard "$1/{shards}"
fi
seq {shards} | parallel --jobs {share}% --halt soon,fail=1 --quote sh "$file"
exec {merge}
"#
        )
    }

    fn snakemake(&self) -> String {
        let Self { summary, run, merge, shards, jobs, .. } = self;
        // Snakemake replaces {NAME} in commands.
        let line = |line: &str, rest: &str| {
            json(
                &(format!("cd {} && {line}", quoted(self.folder)).replace('{', "{{").replace('}', "}}")
                    + rest),
            )
        };
        let run = line(&format!("exec {run}"), &format!(" --shard {{wildcards.shard}}/{shards}"));
        // Its status is not 0 with void runs, after which Snakemake would remove the tables.
        let merge = line(&format!("{merge} || [ $? -eq {NOT_VALID} ]"), "");
        let place = json(self.place);
        format!(
            r#"# {summary}.
# Run with `snakemake --snakefile FILE --cores all`, or on a cluster with --executor.
# If it ends early, run it again: shards go on with the runs that they have.
workdir: {place}

rule merge:
    input: expand("shard-{{shard}}-of-{shards}.done", shard=range(1, {shards} + 1))
    output: "runs.csv", "cells.csv"
    shell: {merge}

rule shard:
    output: touch("shard-{{shard}}-of-{shards}.done")
    threads: {jobs}
    shell: {run}
"#
        )
    }
}

/// Returns a word as text that stands in one line.
fn text(word: &OsStr) -> Result<&str, JobFileError> {
    let text = word.to_str().filter(|text| !text.contains(char::is_control));
    text.ok_or_else(|| JobFileError(word.to_owned()))
}

/// Returns a word as a shell reads it.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-+=.,:/@%".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// Returns a text in double quotes, as YAML and Python read it, too.
fn json(text: &str) -> String {
    serde_json::to_string(text).expect("a text is valid JSON")
}
