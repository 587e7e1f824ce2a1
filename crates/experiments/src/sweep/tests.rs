use std::{fs, path::PathBuf};

use super::*;

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
    assert!(median.interval.unwrap().holds(pairs), "{median:?}");
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
    assert!(files[7].starts_with("<svg"));
    assert!(files[3].contains(",probing,1,robot,navigation,15,"), "{}", files[3]);
    let localization =
        files[4].lines().find(|row| row.contains(",probing,robot,localization,1,200,")).unwrap();
    assert!(localization.ends_with(",0,,,0,,"), "{localization}");
    assert!(files[5].contains("probing & robot & navigation & 1 & 15 & 11"), "{}", files[5]);
    let slow = files[6].lines().find(|row| row.contains(",R1-cloud,")).unwrap();
    assert!(slow.contains("probing,1,navigation,R1-cloud,"), "{slow}");
}

#[test]
fn regions_name_the_robot_and_the_service() {
    let out = tempfile::tempdir().unwrap();
    let sweep = sweep(&[]);
    let mut runs = sweep.run(&Journal::open(out.path()).unwrap(), JOBS, |_, _| true).unwrap();
    let measured = &mut runs.done[0].measured;
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
fn programs_leave_logs_only_where_they_failed() {
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(&out.path().join("sweep")).unwrap();
    // The program follows no events: it exits, and is cut off.
    let axis = "plugins=[{id: gone, command: ['true']}],[probing]";
    let sweep = sweep(&[axis]).until(Some(Duration::from_secs(5)));
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    let faults: Vec<_> = runs.done.iter().map(|done| done.measured.plugin_faults).collect();
    assert_eq!(faults, [1, 0]);
    assert!(folder.path().join("run-0/logs/plugin-gone.log").exists());
    assert!(!folder.path().join("run-1").exists());
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
fn a_shard_does_not_go_on_with_another_sweep() {
    let out = tempfile::tempdir().unwrap();
    let of = |until| sweep(&[]).until(Some(Duration::from_secs(until)));
    run_shard(&of(2), "1/1", out.path());
    let journal = Journal::open(&out.path().join(shard("1/1").folder())).unwrap();
    let go_on = |sweep: &Sweep| sweep.run_shard(shard("1/1"), &journal, JOBS, |_, _| true);
    let error = go_on(&of(3)).unwrap_err().to_string();
    assert!(error.contains("has runs of another sweep"), "{error}");
    journal.clear().unwrap();
    assert_eq!(go_on(&of(3)).unwrap().resumed, 0);
    assert_eq!(go_on(&of(3).seeds(2)).unwrap().resumed, 1, "more seeds add to it");
}
