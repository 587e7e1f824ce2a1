use std::{fs, path::PathBuf};

use cotorra_testing::lab;

use super::*;
use crate::Outcome;

const JOBS: NonZero<usize> = NonZero::new(2).unwrap();

fn testbeds() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds")
}

fn sweep(axes: &[&str]) -> Sweep {
    let text = fs::read_to_string(testbeds().join("corridor.yaml")).unwrap();
    let sweep = Sweep::new("corridor.yaml", text, &testbeds()).until(Some(Duration::from_secs(15)));
    axes.iter().fold(sweep, |sweep, axis| sweep.axis(axis.parse().unwrap()))
}

fn files(folder: &Journal) -> Vec<String> {
    FILES.map(|name| fs::read_to_string(folder.path().join(name)).unwrap()).into()
}

#[test]
fn points_are_all_combinations_with_all_seeds() {
    let sweep = sweep(&["links.*.delay_scale=1..2", "plugin=probing,okpi"]).seeds(2);
    let points: Vec<_> = sweep.points().unwrap().iter().map(|point| point.name(sweep.axes())).collect();
    assert_eq!(points.len(), 8);
    assert_eq!(points[0], "links.*.delay_scale=1 plugin=probing seed=1");
    assert_eq!(points[3], "links.*.delay_scale=1 plugin=okpi seed=2");
    assert_eq!(points[7], "links.*.delay_scale=2 plugin=okpi seed=2");
}

#[test]
fn invalid_values_are_rejected_before_any_run() {
    let SweepError::Testbed(wrong) = sweep(&["links.*.delay=1 ms,2"]).points().unwrap_err() else { panic!() };
    assert!(wrong.to_string().contains("`2` has no unit"), "{wrong}");
}

#[test]
fn twice_the_delay_is_twice_the_service_time_and_more_seeds_narrow_the_interval() {
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    let sweep = sweep(&["links.*.delay_scale=1,2"]).seeds(3);
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    assert_eq!((runs.done.len(), runs.resumed, runs.total), (6, 0, 6));
    let medians: Vec<_> = runs.cells().iter().map(|cell| cell.service_time_p50_ms.unwrap()).collect();
    // 2 ms over the air, and 9 ms over the wire once or twice.
    assert!((medians[1].mean - medians[0].mean - 9.0).abs() < 0.1, "{medians:?}");
    assert!(medians.iter().all(|i| i.low.unwrap() <= i.mean && i.mean <= i.high.unwrap()));
    let differences = runs.differences();
    let of = |figure| differences.iter().find(|its| its.figure == figure).unwrap();
    let median = of("service_time_p50_ms");
    assert_eq!((median.pairs, &median.values), (3, &runs.cells()[1].values));
    // The same seeds vary together.
    let pairs = medians[1].mean - medians[0].mean;
    assert!((median.mean - pairs).abs() < 1e-9 && median.is_shown() == Some(true), "{median:?}");
    // Not one of the pairs has another number of handovers.
    assert_eq!((of("handovers").mean, of("handovers").p), (0.0, Some(1.0)));
}

#[test]
fn a_stopped_sweep_continues_and_ends_with_the_same_bytes() {
    let out = tempfile::tempdir().unwrap();
    let open = |name: &str| Journal::open(&out.path().join(name)).unwrap();
    let sweep = sweep(&["plugin=probing,okpi"]).seeds(3);
    let whole = open("whole");
    let runs = sweep.run(&whole, JOBS, |_, _| true).unwrap();
    runs.write(&whole).unwrap();

    let path = {
        let folder = open("stopped");
        let stopped = sweep.run(&folder, JOBS, |done, _| done < 2).unwrap();
        assert!((2..6).contains(&stopped.done.len()), "{}", stopped.done.len());
        folder.path().to_owned()
    };
    // As if the process was killed while it wrote a line.
    let journal = path.join("journal.jsonl");
    let mut text = fs::read_to_string(&journal).unwrap();
    let lines = text.lines().count();
    text += "{\"run\":\"plugin=okpi se";
    fs::write(&journal, text).unwrap();

    let folder = open("stopped");
    let mut progress = Vec::new();
    let rest = sweep
        .run(&folder, JOBS, |done, of| {
            progress.push((done, of));
            true
        })
        .unwrap();
    assert_eq!((rest.done.len(), rest.resumed), (6, lines));
    assert_eq!(progress.first(), Some(&(lines, 6)));
    assert_eq!(rest.done, runs.done);
    rest.write(&folder).unwrap();
    assert_eq!(files(&folder), files(&whole));
}

/// Returns the names and texts of the samples in a folder.
fn samples(folder: &Path) -> Vec<(String, String)> {
    let entries = fs::read_dir(folder.join("samples")).into_iter().flatten().flatten();
    let read = |path: PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        (name, fs::read_to_string(path).unwrap())
    };
    let mut samples: Vec<_> = entries.map(|entry| read(entry.path())).collect();
    samples.sort();
    samples
}

#[test]
fn samples_are_kept_for_each_run_of_the_tables() {
    let lab = Lab::new();
    let folder = Journal::open(&lab.0.path().join("out")).unwrap();
    let run = |sweep: Sweep| {
        let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
        runs.write(&folder).unwrap();
        (runs.resumed, runs.again.to_string(), runs.with_samples(folder.path()))
    };
    let sweep = |seeds| lab.sweep(&["plugin=probing", "links.A-edge.delay_scale=1,2"]).seeds(seeds);
    assert_eq!(run(sweep(1)), (0, String::new(), 0));
    assert_eq!(samples(folder.path()), []);
    assert_eq!(run(sweep(1).keep_samples()), (0, "samples not kept before: 2 runs again\n".to_owned(), 2));
    assert_eq!(run(sweep(2).keep_samples()), (2, String::new(), 4));
    let kept = samples(folder.path());
    assert!(
        kept[0].0.starts_with("plugin=probing_links.A-edge.delay_scale=1_seed=1-")
            && kept[0].0.ends_with(".csv")
    );
    let lines: Vec<_> = kept[0].1.lines().collect();
    assert!(lines[0].starts_with("plugin,links.A-edge.delay_scale,seed,emitted_ns,robot,service,sequence,"));
    assert!(
        lines[1].starts_with("probing,1,1,") && lines[1].contains(",robot,navigation,0,"),
        "{}",
        lines[1]
    );
    // As many as the table of runs says.
    let measured = sweep(2).run(&folder, JOBS, |_, _| true).unwrap();
    assert_eq!(lines.len() - 1, measured.done[0].outcome.measured().unwrap().samples);

    // After an edit, the samples of the runs before it are gone. After it is undone, they are made again.
    lab.write("lab.yaml", &Lab::file().replace("delay: 2 ms", "delay: 4 ms"));
    assert_eq!(run(sweep(2).keep_samples()), (0, "lab.yaml changed: 4 runs again\n".to_owned(), 4));
    assert!(samples(folder.path()) != kept);
    lab.write("lab.yaml", &Lab::file());
    assert_eq!(run(sweep(2)), (4, String::new(), 0));
    assert_eq!(samples(folder.path()), []);
    assert_eq!(run(sweep(2).keep_samples()).1, "samples not kept before: 4 runs again\n");
    assert_eq!(samples(folder.path()), kept);
    // A table of fewer runs has the samples of these.
    assert_eq!(run(sweep(1)), (2, String::new(), 2));
    assert_eq!(samples(folder.path()).len(), 2);
}

#[test]
fn shards_merge_with_their_samples() {
    let lab = Lab::new();
    let out = lab.0.path().join("out");
    let sweep = || lab.sweep(&["plugin=probing"]).seeds(3).keep_samples();
    for shard in ["1/2", "2/2"] {
        let shard: Shard = shard.parse().unwrap();
        let journal = Journal::open(&out.join(shard.folder())).unwrap();
        sweep().run_shard(shard, &journal, JOBS, |_, _| true).unwrap();
    }
    let merged = Journal::open(&out).unwrap();
    let merge = Merge::read(&[out]).unwrap();
    merge.write(&merged).unwrap();
    assert_eq!(merge.runs.with_samples(merged.path()), 3);
    let whole = Journal::open(&lab.0.path().join("whole")).unwrap();
    sweep().run(&whole, JOBS, |_, _| true).unwrap().write(&whole).unwrap();
    assert!(samples(merged.path()) == samples(whole.path()));
    // The merged sweep goes on without making them again.
    assert_eq!(sweep().run(&merged, JOBS, |_, _| true).unwrap().resumed, 3);
}

#[test]
fn tables_are_tidy() {
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    let sweep = sweep(&["walks.robot.waypoints=[[25.5, -27.8], [25.5, -24.6]]", "plugin=probing"]);
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    runs.write(&folder).unwrap();
    let files = files(&folder);
    let head = "walks.robot.waypoints,plugin,seed,duration_ms,walked,samples,unanswered,above_target,";
    assert!(files[0].starts_with(head), "{}", files[0]);
    assert!(files[0].lines().nth(1).unwrap().starts_with("\"[[25.5, -27.8], [25.5, -24.6]]\",probing,1,"));
    for table in files.iter().zip(FILES).filter(|(_, name)| name.ends_with(".csv")).map(|(table, _)| table) {
        let commas = |line: &str| line.replace("\"[[25.5, -27.8], [25.5, -24.6]]\"", "").matches(',').count();
        let columns = commas(table.lines().next().unwrap());
        assert!(table.lines().all(|line| commas(line) == columns), "{table}");
    }
    assert!(files[8].starts_with("<svg"));
    assert!(files[3].contains(",probing,1,robot,navigation,15,"), "{}", files[3]);
    let localization =
        files[4].lines().find(|row| row.contains(",probing,robot,localization,1,200,")).unwrap();
    assert!(localization.ends_with(",0,,,0,,,0,0,"), "{localization}");
    assert!(files[5].contains("probing & robot & navigation & 1 & 15 & 11"), "{}", files[5]);
    let slow = files[6].lines().find(|row| row.contains(",R1-cloud,")).unwrap();
    assert!(slow.contains("probing,1,navigation,R1-cloud,"), "{slow}");
}

#[test]
fn regions_name_the_robot_and_the_service() {
    let out = tempfile::tempdir().unwrap();
    let sweep = sweep(&[]);
    let mut runs = sweep.run(&Journal::open(out.path()).unwrap(), JOBS, |_, _| true).unwrap();
    let Outcome::Measured(measured) = &mut runs.done[0].outcome else { panic!() };
    // As if the robot had a second service on another server.
    let mut other = measured.regions[0].clone();
    (other.service, other.server) = ("second".parse().unwrap(), "fog".parse().unwrap());
    measured.regions.push(other);
    let table = tables::regions(&runs).to_csv();
    let rows: Vec<Vec<_>> = table.lines().map(|row| row.split(',').take(5).collect()).collect();
    let expected = [
        ["seed", "robot", "service", "attachment", "server"],
        ["1", "robot", "navigation", "R1", "cloud"],
        ["1", "robot", "second", "R1", "fog"],
    ];
    assert_eq!(rows, expected);
}

#[test]
fn a_folder_is_open_in_one_process_only() {
    let out = tempfile::tempdir().unwrap();
    let _first = Journal::open(out.path()).unwrap();
    let second = Journal::open(out.path()).unwrap_err().to_string();
    assert!(second.contains("another process uses this folder"), "{second}");
}

#[test]
fn a_run_without_its_plug_in_is_void_in_every_table_and_made_again() {
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    // The program follows no events: it exits, and is cut off.
    let axis = "plugins=[{id: gone, command: [echo, Gone.]}],[probing]";
    let sweep = sweep(&[axis]).until(Some(Duration::from_secs(5)));
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    runs.write(&folder).unwrap();
    assert_eq!((runs.void(), runs.done[1].outcome.void()), (1, None));
    let reason = "plug-in gone was cut off: its program ended: exit status: 0";
    assert_eq!(runs.done[0].outcome.void().unwrap().reason(), reason);
    let cells = runs.cells();
    assert_eq!((cells[0].above_target, cells[0].duration_ms, &cells[0].services[..]), (None, None, &[][..]));
    for (table, name) in files(&folder).into_iter().zip(FILES) {
        match name.rsplit('.').next() {
            // There is nothing to compare.
            Some("csv") if name == "differences.csv" => assert_eq!(table.lines().count(), 1, "{table}"),
            Some("csv") => {
                let rows: Vec<_> = table.lines().filter(|row| row.contains("gone, command")).collect();
                assert_eq!(rows.len(), 1, "{name}: {table}");
                assert!(rows[0].ends_with(&format!(",{reason}")), "{name}: {}", rows[0]);
                assert!(table.lines().next().unwrap().ends_with(",void"), "{name}");
                let blank = rows[0].trim_end_matches(reason).rsplit("}]\"").next().unwrap();
                assert!(blank.chars().all(|c| ",1".contains(c)), "{name}: {blank}");
            }
            Some("tex") => assert!(table.contains(&format!("void: {reason}")), "{table}"),
            _ => assert!(table.contains("confidence intervals (1 void)<"), "{table}"),
        }
    }
    let logs: Vec<_> = fs::read_dir(folder.path().join("logs")).unwrap().flatten().collect();
    let log = fs::read_to_string(logs[0].path().join("plugins/gone.log")).unwrap();
    assert_eq!((logs.len(), log.as_str()), (1, "Gone.\n"));
    assert!(!folder.path().join("run-0").exists() && !folder.path().join("run-1").exists());

    let again = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    assert_eq!((again.resumed, again.void()), (1, 1));
    assert_eq!(again.again.to_string(), "void before: 1 run again\n");
}

#[test]
fn a_run_without_frames_is_void_as_it_is_alone() {
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    let links = &[("lan, A", "1 ms"), ("lan, edge", "2 ms")];
    let text = lab::Lab { b: None, links, ..lab::Lab::default() }.to_string();
    let sweep = Sweep::new("lab.yaml", text, Path::new(""));
    let sweep = sweep.axis("nodes.A.position=[0, 1],[90000, 1]".parse().unwrap());
    let runs = sweep.until(Some(Duration::from_secs(12))).run(&folder, JOBS, |_, _| true).unwrap();
    let cells = runs.cells();
    assert_eq!((runs.void(), &cells[0].void), (1, &None));
    let void = cells[1].void.as_ref().unwrap().to_string();
    assert_eq!(void, "void: no frame crossed the emulated network");
    assert!(cells[1].duration_ms.is_none() && !folder.path().join("logs").exists(), "{cells:?}");
}

/// A folder with a testbed whose plug-in is a program, which sets the delay of a link that its module names.
struct Lab(tempfile::TempDir);

impl Lab {
    fn file() -> String {
        lab::Lab::with_program()
    }

    fn program() -> String {
        format!("from amount import AMOUNT_MS\n{}", lab::SETS_DELAY)
    }

    fn new() -> Self {
        let lab = Self(tempfile::tempdir().unwrap());
        lab.write("lab.yaml", &Self::file());
        lab.write("mine.py", &Self::program());
        lab.write("amount.py", "AMOUNT_MS = 2\n");
        lab
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.0.path().join(name), text).unwrap();
    }

    fn sweep(&self, axes: &[&str]) -> Sweep {
        let text = fs::read_to_string(self.0.path().join("lab.yaml")).unwrap();
        let sweep = Sweep::new("beds/lab.yaml", text, self.0.path());
        axes.iter().fold(sweep, |sweep, axis| sweep.axis(axis.parse().unwrap()))
    }

    /// Returns the runs, and their median service times rounded to milliseconds.
    fn run(&self, journal: &Journal, axes: &[&str]) -> (Runs, Vec<f64>) {
        let runs = self.sweep(axes).run(journal, JOBS, |_, _| true).unwrap();
        let median = |done: &Done| done.outcome.measured().unwrap().service_time_p50_ms.unwrap().round();
        let medians = runs.done.iter().map(median).collect();
        (runs, medians)
    }
}

#[test]
fn runs_are_made_again_only_where_something_that_they_depend_on_changed() {
    let lab = Lab::new();
    let journal = Journal::open(&lab.0.path().join("out")).unwrap();
    let axes = ["plugin=mine,probing"];
    let run = || lab.run(&journal, &axes);
    let (first, medians) = run();
    assert_eq!((first.resumed, first.again.to_string(), medians), (0, String::new(), vec![6.0, 6.0]));
    assert_eq!(run().0.resumed, 2);

    // A module of the program, which only one of them runs. Each text has another length: Python takes one of the same length
    // and second for the same.
    lab.write("amount.py", "AMOUNT_MS = 5.0\n");
    let (edited, medians) = run();
    assert_eq!(edited.again.to_string(), "amount.py changed: 1 run again\n");
    assert_eq!((edited.resumed, medians), (1, vec![12.0, 6.0]));

    lab.write("lab.yaml", &Lab::file().replace("delay: 2 ms", "delay: 4 ms"));
    let (edited, medians) = run();
    assert_eq!(edited.again.to_string(), "lab.yaml changed: 2 runs again\n");
    assert_eq!((edited.resumed, medians), (0, vec![12.0, 10.0]));

    lab.write("mine.py", &(Lab::program() + "# The end.\n"));
    lab.write("amount.py", "AMOUNT_MS = 3.00\n");
    let (edited, medians) = run();
    assert_eq!(edited.again.to_string(), "amount.py and mine.py changed: 1 run again\n");
    assert_eq!((edited.resumed, medians), (1, vec![8.0, 10.0]));

    // As it was in the beginning.
    lab.write("lab.yaml", &Lab::file());
    lab.write("mine.py", &Lab::program());
    lab.write("amount.py", "AMOUNT_MS = 2\n");
    assert_eq!((run().0.resumed, run().1), (2, vec![6.0, 6.0]));
}

#[test]
fn another_limit_or_another_program_makes_runs_again() {
    let lab = Lab::new();
    let journal = |program: &str| Journal::open(&lab.0.path().join("out")).unwrap().by(program);
    let run = |program: &str, until| {
        let sweep = lab.sweep(&["plugin=probing"]).until(until);
        sweep.run(&journal(program), JOBS, |_, _| true).unwrap()
    };
    let duration = |runs: &Runs| runs.done[0].outcome.measured().unwrap().duration_ms;
    let whole = run("a", None);
    let until = run("a", Some(Duration::from_secs(1)));
    assert_eq!(until.again.to_string(), "--until changed: 1 run again\n");
    assert_eq!((until.resumed, duration(&until)), (0, 1000.0));
    let other = run("b", None);
    assert_eq!(
        (other.resumed, other.again.to_string()),
        (0, "cotorra and --until changed: 1 run again\n".to_owned())
    );
    assert_eq!((run("a", None).resumed, duration(&other)), (1, duration(&whole)));
}

#[test]
fn a_journal_of_an_earlier_version_is_not_believed() {
    let lab = Lab::new();
    let journal = Journal::open(&lab.0.path().join("out")).unwrap();
    lab.run(&journal, &["plugin=probing"]);
    let path = journal.path().join("journal.jsonl");
    let line: serde_json::Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    let old = serde_json::json!({ "run": line["run"], "measured": line["measured"] });
    fs::write(&path, format!("{old}\n")).unwrap();
    let (again, _) = lab.run(&journal, &["plugin=probing"]);
    let said = again.again.to_string();
    assert_eq!(
        (again.resumed, said.as_str()),
        (0, "the journal is of an earlier version of cotorra: 1 run again\n")
    );
    assert_eq!(lab.run(&journal, &["plugin=probing"]).0.resumed, 1);
}

#[test]
fn a_file_that_changes_during_a_run_ends_the_sweep() {
    let lab = Lab::new();
    let journal = Journal::open(&lab.0.path().join("out")).unwrap();
    let sweep = lab.sweep(&["plugin=mine"]).seeds(2);
    let error = sweep.run(&journal, NonZero::<usize>::MIN, |done, _| {
        if done == 1 {
            lab.write("amount.py", "AMOUNT_MS = 50\n");
        }
        true
    });
    let error = error.unwrap_err().to_string();
    assert!(error.contains("amount.py changed during the run"), "{error}");
}

#[test]
fn shards_of_edited_programs_are_made_again_and_never_merged_with_others() {
    let lab = Lab::new();
    let [one, other] = ["1/2", "2/2"];
    let shards = lab.0.path().join("out");
    let sweep = || lab.sweep(&["plugin=mine"]).seeds(2);
    run_shard(&sweep(), one, &shards);
    lab.write("amount.py", "AMOUNT_MS = 5.0\n");
    run_shard(&sweep(), other, &shards);
    let error = merge_error(&[&shards]);
    assert!(error.contains("different sweeps: they have another amount.py"), "{error}");

    let again = run_shard(&sweep(), one, &shards);
    assert_eq!((again.resumed, again.again.to_string()), (0, "amount.py changed: 1 run again\n".to_owned()));
    let merged = Journal::open(&shards).unwrap();
    merge(&shards).write(&merged).unwrap();
    assert_eq!(lab.run(&merged, &["plugin=mine"]).1, [12.0]);

    // The merged folder believes neither what it had before.
    lab.write("amount.py", "AMOUNT_MS = 2\n");
    for shard in [one, other] {
        run_shard(&sweep(), shard, &shards);
    }
    merge(&shards).write(&merged).unwrap();
    let runs = sweep().run(&merged, JOBS, |_, _| true).unwrap();
    assert_eq!(runs.resumed, 2);
}

fn shard(text: &str) -> Shard {
    text.parse().unwrap()
}

/// Runs a shard in its folder.
fn run_shard(sweep: &Sweep, text: &str, folder: &Path) -> Runs {
    let journal = Journal::open(&folder.join(shard(text).folder())).unwrap().durable();
    sweep.run_shard(shard(text), &journal, JOBS, |_, _| true).unwrap()
}

fn merge(folder: &Path) -> Merge {
    Merge::read(&[folder.to_owned()]).unwrap()
}

fn merge_error(folders: &[&Path]) -> String {
    Merge::read(&folders.iter().map(|&folder| folder.to_owned()).collect::<Vec<_>>()).unwrap_err().to_string()
}

#[test]
fn merged_shards_have_the_bytes_of_the_whole_sweep() {
    let out = tempfile::tempdir().unwrap();
    let sweep = sweep(&["plugin=probing,okpi"]).seeds(3);
    let whole = Journal::open(&out.path().join("whole")).unwrap();
    sweep.run(&whole, JOBS, |_, _| true).unwrap().write(&whole).unwrap();

    let folder = out.path().join("shards");
    let journal = {
        let journal = Journal::open(&folder.join(shard("2/2").folder())).unwrap();
        let stopped = sweep.run_shard(shard("2/2"), &journal, NonZero::<usize>::MIN, |done, _| done < 1);
        let stopped = stopped.unwrap();
        assert_eq!((stopped.done.len(), stopped.total), (1, 3));
        journal.path().join("journal.jsonl")
    };
    run_shard(&sweep, "1/2", &folder);
    // As if the node of the other shard was killed while it wrote a line.
    fs::write(&journal, fs::read_to_string(&journal).unwrap() + "{\"run\":\"plugin=okpi se").unwrap();
    let part = merge(&folder);
    assert_eq!((part.runs.done.len(), part.runs.total), (4, 6));
    let missing: Vec<_> = part.missing.into_iter().collect();
    let names = ["plugin=probing seed=3", "plugin=okpi seed=3"].map(str::to_owned);
    assert_eq!(missing, [(shard("2/2"), names.to_vec())]);

    assert_eq!(run_shard(&sweep, "2/2", &folder).resumed, 1);
    let merged = Journal::open(&folder).unwrap();
    let written = || {
        let merge = merge(&folder);
        assert_eq!((merge.missing.len(), &merge.folder), (0, &merged.path().to_owned()));
        merge.write(&merged).unwrap();
        fs::read_to_string(merged.path().join("journal.jsonl")).unwrap()
    };
    let once = written();
    assert_eq!(files(&merged), files(&whole));
    assert_eq!(written(), once, "merging again changes nothing");
    assert_eq!(files(&merged), files(&whole));
    assert_eq!(sweep.run(&merged, JOBS, |_, _| true).unwrap().resumed, 6);
}

#[test]
fn a_sweep_can_be_divided_anew() {
    let out = tempfile::tempdir().unwrap();
    let sweep = sweep(&[]).until(Some(Duration::from_secs(2))).seeds(4);
    for text in ["1/2", "1/4", "2/4"] {
        run_shard(&sweep, text, out.path());
    }
    // Shard 1/2 has the runs of 1/4, and of one more.
    let merged = merge(out.path());
    let missing: Vec<_> = merged.missing.keys().map(ToString::to_string).collect();
    assert_eq!((merged.runs.done.len(), missing), (3, vec!["3/4".to_owned()]));
}

#[test]
fn shards_of_other_sweeps_are_not_merged() {
    let out = tempfile::tempdir().unwrap();
    let base = |until| sweep(&["links.*.delay_scale=1,2"]).until(Some(Duration::from_secs(until))).seeds(2);
    let own = out.path().join("own");
    run_shard(&base(2), "1/2", &own);
    for (name, other, difference) in [
        ("seeds", base(2).seeds(3), "another number of seeds"),
        ("until", base(3), "--until"),
        (
            "values",
            sweep(&["links.*.delay_scale=1,3"]).until(Some(Duration::from_secs(2))).seeds(2),
            "values of",
        ),
    ] {
        let folder = out.path().join(name);
        run_shard(&other, "2/2", &folder);
        let error = merge_error(&[&own, &folder]);
        assert!(error.contains("of different sweeps") && error.contains(difference), "{error}");
    }
    let none = tempfile::tempdir().unwrap();
    assert!(merge_error(&[&own, none.path()]).contains("there is no shard in"));
    assert!(merge_error(&[&none.path().join("gone")]).contains("gone"));
}

#[test]
fn runs_with_two_results_are_not_merged() {
    let out = tempfile::tempdir().unwrap();
    let sweep = sweep(&[]).until(Some(Duration::from_secs(2))).seeds(2);
    let [own, other] = ["own", "other"].map(|name| out.path().join(name));
    for folder in [&own, &other] {
        run_shard(&sweep, "1/2", folder);
    }
    let journal = other.join("shard-1-of-2/journal.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    assert!(text.contains("\"samples\":"));
    fs::write(&journal, text.replacen("\"samples\":", "\"samples\":1", 1)).unwrap();
    let error = merge_error(&[&own, &other]);
    assert!(error.starts_with("seed=1 has other results in "), "{error}");

    // The same against runs that the folder of the sweep has.
    merge(&other).write(&Journal::open(&other).unwrap()).unwrap();
    let kept = fs::read_to_string(other.join("journal.jsonl")).unwrap();
    let error = merge(&own).write(&Journal::open(&other).unwrap()).unwrap_err().to_string();
    assert!(error.starts_with("seed=1 has other results in "), "{error}");
    assert_eq!(fs::read_to_string(other.join("journal.jsonl")).unwrap(), kept);
}

#[test]
fn a_shard_makes_the_runs_of_another_sweep_again() {
    let out = tempfile::tempdir().unwrap();
    let of = |until| sweep(&[]).until(Some(Duration::from_secs(until)));
    run_shard(&of(2), "1/1", out.path());
    let journal = Journal::open(&out.path().join(shard("1/1").folder())).unwrap();
    let go_on = |sweep: &Sweep| sweep.run_shard(shard("1/1"), &journal, JOBS, |_, _| true);
    let other = go_on(&of(3)).unwrap();
    assert_eq!((other.resumed, other.again.to_string()), (0, "--until changed: 1 run again\n".to_owned()));
    assert_eq!(go_on(&of(3).seeds(2)).unwrap().resumed, 1, "more seeds add to it");
}

#[test]
fn goodputs_of_sources_have_a_table_and_intervals() {
    let text = "name: traffic\nprobes: none\nnodes:\n  \
                a: { kind: server, tier: fog, cpus: 1, memory: 1 GB }\n  \
                b: { kind: server, tier: edge, cpus: 1, memory: 1 GB }\n\
                links: [{ ends: [a, b], delay: 1 ms, rate: 10 Mbit/s }]\n\
                traffic:\n  full: { from: a, to: b, protocol: udp, rate: saturated }\n";
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    let sweep =
        Sweep::new("traffic.yaml", text.to_owned(), Path::new("")).until(Some(Duration::from_secs(5)));
    let sweep = sweep.axis("links.a-b.rate=10 Mbit/s,20 Mbit/s".parse().unwrap()).seeds(3);
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    runs.write(&folder).unwrap();
    let table = fs::read_to_string(folder.path().join("traffic.csv")).unwrap();
    assert!(table.starts_with("links.a-b.rate,seed,source,goodput_bps,"), "{table}");
    assert_eq!(table.matches(",full,").count(), 2 * 3, "{table}");
    for (cell, rate) in runs.cells().iter().zip([10e6, 20e6]) {
        let [(source, goodput)] = &cell.goodput_bps[..] else { panic!("{cell:?}") };
        assert_eq!((source.as_str(), goodput.n), ("full", 3));
        assert!(goodput.mean > 0.95 * rate && goodput.mean < rate, "{goodput:?}");
    }
}

#[test]
fn prices_have_a_table_and_intervals_where_there_is_a_currency() {
    let text = "name: bill\ncurrency: EUR\nprobes: none\nnodes:\n  \
                a: { kind: server, tier: fog, cpus: 1, memory: 1 GB }\n  \
                b: { kind: server, tier: edge, cpus: 1, memory: 1 GB }\n\
                links: [{ ends: [a, b], delay: 1 ms, rate: 10 Mbit/s, cost: 0.09 }]\n\
                traffic:\n  full: { from: a, to: b, protocol: udp, rate: saturated }\n";
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    let sweep = Sweep::new("bill.yaml", text.to_owned(), Path::new("")).until(Some(Duration::from_secs(36)));
    let sweep = sweep.axis("links.a-b.rate=10 Mbit/s,20 Mbit/s".parse().unwrap()).seeds(2);
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    runs.write(&folder).unwrap();
    let table = fs::read_to_string(folder.path().join("bill.csv")).unwrap();
    assert!(table.starts_with("links.a-b.rate,seed,of,currency,price,price_per_hour,"), "{table}");
    assert_eq!(table.matches(",everything,EUR,").count(), 2 * 2, "{table}");
    for (cell, rate) in runs.cells().iter().zip([10e6, 20e6]) {
        let [all, link] = &cell.bill[..] else { panic!("{cell:?}") };
        assert_eq!([&all.of, &link.of], ["everything", "link a-b"]);
        // A GB is eight gigabits: the link is full but for the first and the last moment.
        let full = rate * 3600.0 / 8e9 * 0.09;
        assert!((link.per_hour.mean / full - 1.0).abs() < 0.03, "{} for {full}", link.per_hour.mean);
        assert!((link.amount.mean * 100.0 - link.per_hour.mean).abs() < 1e-9, "a hundredth of an hour");
        assert_eq!(all.amount, link.amount);
    }
}

#[test]
fn energies_have_a_table_and_intervals_where_a_node_has_a_power() {
    let text = "name: energy\ncurrency: EUR\nprobes: none\nnodes:\n  \
                a: { kind: server, tier: fog, cpus: 1, memory: 1 GB, power: { idle: 50 W, full: 90 W, cost: 0.25 } }\n  \
                b: { kind: server, tier: edge, cpus: 1, memory: 1 GB }\n\
                links: [{ ends: [a, b], delay: 1 ms, rate: 10 Mbit/s }]\n\
                traffic:\n  full: { from: a, to: b, protocol: udp, rate: 1 Mbit/s }\n";
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    let sweep =
        Sweep::new("energy.yaml", text.to_owned(), Path::new("")).until(Some(Duration::from_secs(36)));
    let sweep = sweep.axis("nodes.a.power.idle=50 W,70 W".parse().unwrap()).seeds(2);
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    runs.write(&folder).unwrap();
    let table = fs::read_to_string(folder.path().join("energy.csv")).unwrap();
    assert!(table.starts_with("nodes.a.power.idle,seed,of,energy_wh,mean_power_w,"), "{table}");
    assert_eq!(table.matches(",server a,").count(), 2 * 2, "{table}");
    let for_papers = fs::read_to_string(folder.path().join("energy.tex")).unwrap();
    assert!(for_papers.contains("70 W & server a & 70.00 (n = 2) W"), "{for_papers}");
    for (cell, watts) in runs.cells().iter().zip([50.0, 70.0]) {
        let [all, server] = &cell.energy[..] else { panic!("{cell:?}") };
        assert_eq!([&all.of, &server.of], ["everything", "server a"]);
        assert_eq!((all.amount, server.unit.as_str()), (server.amount, "Wh"));
        assert!((server.per_hour.mean - watts).abs() < 1e-9, "{server:?}");
        let [_, energy] = &cell.bill[..] else { panic!("{cell:?}") };
        assert!((energy.per_hour.mean - 0.25 * watts / 1000.0).abs() < 1e-12, "{energy:?}");
    }
    assert!(runs.differences().iter().any(|its| its.figure == "energy of server a" && its.mean > 0.0));
}
