use std::fs;

use cotorra_testing::lab::Lab;

use super::*;
use crate::sweep::Sweep;

const JOBS: NonZero<usize> = NonZero::new(2).unwrap();

fn lab() -> String {
    Lab::default().to_string()
}

fn options(kinds: &[Kind]) -> Options {
    Options {
        services: Vec::new(),
        keep: 0.9,
        seed: 1,
        seeds: 1,
        until: None,
        kinds: kinds.into(),
        on: Vec::new(),
        delays: Grid::new(20_000_000, 100_000).unwrap(),
        losses: Grid::new(LOSS_UNITS, LOSS_UNITS / 100).unwrap(),
        pairs: true,
    }
}

fn margin(text: &str, options: Options) -> Margin {
    let testbed = cotorra_testbed_file::parse("lab.yaml", text, Path::new(""));
    let testbed = testbed.unwrap_or_else(|wrong| panic!("{wrong}"));
    Margin::new("lab.yaml", testbed, text.to_owned(), options).unwrap()
}

fn run(margin: &Margin) -> Margins {
    let out = tempfile::tempdir().unwrap();
    margin.run(&Journal::open(out.path()).unwrap(), JOBS, |_, _| true).unwrap()
}

/// Returns the finding of a search.
fn of<'a>(margins: &'a Margins, change: Kind, on: Option<&str>, down: Option<&str>) -> &'a Finding {
    let finding = margins.findings.iter().find(|finding| {
        finding.change == change.name()
            && finding.on.as_deref() == on
            && finding.down.as_ref().map(NodeId::as_str) == down
    });
    finding.unwrap_or_else(|| panic!("{change:?} {on:?} {down:?}: {margins:?}"))
}

#[test]
fn a_margin_is_where_a_sweep_over_the_same_axis_breaks() {
    let margins = run(&margin(&lab(), Options { on: vec!["lan-edge".into()], ..options(&[Kind::Delay]) }));
    assert!(margins.complete && margins.findings.len() == 1, "{margins:?}");
    let finding = of(&margins, Kind::Delay, Some("lan-edge"), None);
    let (survives, breaks) = (finding.survives_ms.unwrap(), finding.breaks_ms.unwrap());
    assert!((breaks - survives - 0.1).abs() < 1e-9, "{survives} {breaks}");
    // 7 ms less the time of the frames are left for both directions.
    assert!((2.5..3.6).contains(&breaks), "{breaks}");

    let axis = format!("links.lan-edge.delay={} ms,{} ms", 2.0 + survives, 2.0 + breaks);
    let sweep = Sweep::new("lab.yaml", lab(), Path::new("")).axis(axis.parse().unwrap());
    let out = tempfile::tempdir().unwrap();
    let runs = sweep.run(&Journal::open(out.path()).unwrap(), JOBS, |_, _| true).unwrap();
    let above: Vec<_> =
        runs.done.iter().map(|done| done.outcome.measured().unwrap().above_target.unwrap()).collect();
    assert!(above[0] <= 0.1 && above[1] > 0.1, "{above:?}");
    assert_eq!(margins.findings[0].kept, Some(1.0 - above[1]));
}

#[test]
fn a_margin_and_a_sweep_go_by_any_figure_that_the_file_bounds() {
    let kpi = "service_time p95 <= 12 ms";
    let text = lab().replace("service_time: 15 ms", &format!("service_time: 15 ms, require: [{kpi}]"));
    let margins = run(&margin(&text, Options { on: vec!["lan-edge".into()], ..options(&[Kind::Delay]) }));
    let finding = of(&margins, Kind::Delay, Some("lan-edge"), None);
    let breaks = finding.breaks_ms.unwrap();
    assert!(breaks < 2.5 && finding.failed.as_deref() == Some(kpi), "the target allows more: {finding:?}");

    let axis = "links.lan-edge.delay=2 ms,7 ms".parse().unwrap();
    let sweep = Sweep::new("lab.yaml", text, Path::new("")).axis(axis).seeds(2);
    let out = tempfile::tempdir().unwrap();
    let folder = Journal::open(out.path()).unwrap();
    let runs = sweep.run(&folder, JOBS, |_, _| true).unwrap();
    let verdicts: Vec<_> = runs.cells().iter().map(|cell| cell.verdicts.failed_runs).collect();
    assert_eq!(verdicts, [0, 2]);
    let differences = runs.differences();
    let figure = format!("navigation: {kpi}");
    let of_kpi = differences.iter().find(|its| its.figure == figure).unwrap();
    let p95 = differences.iter().find(|its| its.figure == "service_time_p95_ms").unwrap();
    assert!((of_kpi.mean - p95.mean).abs() < 1e-9 && of_kpi.mean > 8.0, "{of_kpi:?} {p95:?}");
    runs.write(&folder).unwrap();
    let table = fs::read_to_string(out.path().join("kpis.csv")).unwrap();
    let rows: Vec<_> = table.lines().collect();
    assert!(
        rows.len() == 5 && rows[0].ends_with(",seed,robot,service,kpi,value,unit,passed,void"),
        "{table}"
    );
    assert!(rows[1].contains(&format!(",robot,navigation,{kpi},")) && rows[1].ends_with(",ms,1,"), "{table}");
    assert!(rows[4].ends_with(",ms,0,"), "{table}");
}

#[test]
fn a_slow_server_has_the_margin_of_both_directions_of_its_link() {
    let margins = run(&margin(&lab(), Options { on: vec!["edge".into()], ..options(&[Kind::Answers]) }));
    let of_link = run(&margin(&lab(), Options { on: vec!["lan-edge".into()], ..options(&[Kind::Delay]) }));
    let answers = of(&margins, Kind::Answers, Some("edge"), None).breaks_ms.unwrap();
    let delay = of(&of_link, Kind::Delay, Some("lan-edge"), None).breaks_ms.unwrap();
    assert!((answers - 2.0 * delay).abs() <= 0.21, "{answers} {delay}");
}

#[test]
fn delays_are_searched_again_with_each_radio_unit_that_is_survived() {
    let margins = run(&margin(&lab(), options(&[Kind::Delay, Kind::Down])));
    assert!(!of(&margins, Kind::Down, None, Some("A")).breaks);
    assert!(!of(&margins, Kind::Down, None, Some("B")).breaks);
    // The robot is at A. Without A, it is at B.
    let delay = |on, down| of(&margins, Kind::Delay, Some(on), down);
    assert_eq!((delay("lan-B", None).survives_ms, delay("lan-B", None).breaks_ms), (Some(20.0), None));
    assert!(delay("lan-B", Some("A")).breaks && !delay("lan-A", Some("A")).breaks);
    assert!(delay("lan-A", None).breaks && delay("w", None).breaks);
    let without = run(&margin(&lab(), Options { pairs: false, ..options(&[Kind::Delay, Kind::Down]) }));
    assert_eq!(without.findings, margins.findings[..without.findings.len()]);
    assert!(without.findings.iter().all(|finding| finding.on.is_none() || finding.down.is_none()));
}

#[test]
fn a_walk_that_does_not_end_without_a_radio_unit_is_broken() {
    let alone =
        lab().replace("  B: { kind: radio_unit, position: [9, 1], channel: 6 }\n", "").replace("[A, B]", "A");
    let margins = run(&margin(&alone, options(&[Kind::Down, Kind::Delay])));
    assert!(of(&margins, Kind::Down, None, Some("A")).breaks);
    assert!(margins.findings.iter().all(|finding| finding.on.is_none() || finding.down.is_none()));
}

#[test]
fn loss_breaks_where_too_few_round_trips_survive() {
    let on = vec!["lan-edge".into()];
    let margins = run(&margin(&lab(), Options { on, seeds: 4, ..options(&[Kind::Loss]) }));
    let finding = of(&margins, Kind::Loss, Some("lan-edge"), None);
    let (survives, breaks) = (finding.survives_loss.unwrap(), finding.breaks_loss.unwrap());
    // 0.95² is 0.9.
    assert!((0.02..0.09).contains(&survives), "{finding:?}");
    assert!((breaks - survives - 0.01).abs() < 1e-9 && finding.breaks_ms.is_none(), "{finding:?}");
}

#[test]
fn localization_counts_by_name_and_has_a_margin_of_its_own() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let testbed = cotorra_testbed_file::load(&file).unwrap();
    let text = fs::read_to_string(file).unwrap();
    let options = Options {
        until: Some(Duration::from_secs(15)),
        on: vec!["R1-edge".into()],
        delays: Grid::new(200_000_000, 5_000_000).unwrap(),
        ..options(&[Kind::Delay])
    };
    let all = Margin::new("corridor.yaml", testbed.clone(), text.clone(), options.clone()).unwrap();
    assert_eq!(all.services().iter().map(ServiceId::as_str).collect::<Vec<_>>(), ["navigation"]);
    let named = Options { services: vec!["localization".into()], ..options };
    let margins = run(&Margin::new("corridor.yaml", testbed, text, named).unwrap());
    assert!(margins.unchanged[0].samples > 8 && margins.unchanged[0].kept == Some(1.0), "{margins:?}");
    let finding = of(&margins, Kind::Delay, Some("R1-edge"), None);
    assert_eq!(finding.service.as_ref().map(ServiceId::as_str), Some("localization"));
    // Some 192 ms of 200 ms are left for both directions.
    assert_eq!((finding.survives_ms, finding.breaks_ms), (Some(95.0), Some(100.0)), "{finding:?}");
}

#[test]
fn a_stopped_search_continues_and_ends_with_the_same_bytes() {
    let out = tempfile::tempdir().unwrap();
    let open = |name: &str| Journal::open(&out.path().join(name)).unwrap();
    let margin = margin(&lab(), Options { seeds: 2, ..options(&[Kind::Delay, Kind::Answers, Kind::Down]) });
    let files = |journal: &Journal| FILES.map(|name| fs::read_to_string(journal.path().join(name)).unwrap());
    let whole = open("whole");
    let all = margin.run(&whole, JOBS, |_, _| true).unwrap();
    all.write(&whole).unwrap();
    let estimate = margin.estimate();
    assert!((estimate.least..=estimate.most).contains(&(all.runs as u64)), "{estimate:?} {}", all.runs);

    // Once in the first round, and once in a later one.
    let mut before = 0;
    for stop_at in [1, 30] {
        let stopped = margin.run(&open("stopped"), JOBS, |done, _| done < stop_at).unwrap();
        assert!(!stopped.complete && stopped.runs >= stop_at, "{stopped:?}");
        assert_eq!(stopped.resumed, before);
        before = stopped.runs;
    }
    let journal = open("stopped");
    let rest = margin.run(&journal, JOBS, |_, _| true).unwrap();
    assert_eq!((rest.resumed, rest.runs), (before, all.runs));
    rest.write(&journal).unwrap();
    assert_eq!(files(&journal), files(&whole));
    let [table, _] = files(&whole);
    assert_eq!(table.lines().count(), 1 + all.findings.len());
    assert!(table.lines().nth(1).unwrap().starts_with("delay,lan-A,,true,true,navigation,"), "{table}");
    assert!(table.starts_with("change,on,down,complete,breaks,service,"));
}

#[test]
fn a_target_that_is_broken_before_has_no_margin() {
    let strict = lab().replace("service_time: 15 ms", "service_time: 5 ms");
    let out = tempfile::tempdir().unwrap();
    let journal = Journal::open(out.path()).unwrap();
    let broken = margin(&strict, options(&[Kind::Delay])).run(&journal, JOBS, |_, _| true).unwrap_err();
    assert!(broken.to_string().contains("`navigation` keeps its target in 0.00 %"), "{broken}");
}

#[test]
fn unknown_names_list_the_known_ones() {
    let prepare = |options| {
        let testbed = cotorra_testbed_file::parse("lab.yaml", &lab(), Path::new("")).unwrap();
        Margin::new("lab.yaml", testbed, lab(), options).unwrap_err().to_string()
    };
    let wrong = prepare(Options { services: vec!["x".into()], ..options(&[Kind::Delay]) });
    assert_eq!(wrong, "there is no service `x` in the testbed file; its services: navigation");
    let wrong = prepare(Options { on: vec!["x".into()], ..options(&[Kind::Delay]) });
    assert!(wrong.starts_with("`x` is no link") && wrong.ends_with("lan-A, lan-B, lan-edge, w"), "{wrong}");
}

/// A plug-in that is a program.
const PROGRAM: &str = "plugins:\n  - { id: mine, command: [sh, mine.sh] }\n";

#[test]
fn a_search_is_made_again_if_the_testbed_or_the_limit_changes() {
    let out = tempfile::tempdir().unwrap();
    let journal = Journal::open(out.path()).unwrap();
    let options = Options { on: vec!["lan-edge".into()], ..options(&[Kind::Delay]) };
    let search = |text: &str, options: &Options| {
        margin(text, options.clone()).run(&journal, JOBS, |_, _| true).unwrap()
    };
    let first = search(&lab(), &options);
    assert_eq!((first.resumed, first.again.to_string()), (0, String::new()));
    let same = search(&lab().replace("name: lab", "name: lab # the same"), &options);
    assert_eq!((same.resumed, &same.findings), (first.runs, &first.findings));

    let slower = search(&lab().replace("delay: 2 ms", "delay: 3 ms"), &options);
    let breaks = |margins: &Margins| margins.findings[0].breaks_ms.unwrap();
    assert!((breaks(&first) - breaks(&slower) - 1.0).abs() < 0.05, "{slower:?}");
    assert_eq!(slower.resumed, 0);
    assert!(slower.again.to_string().starts_with("lab.yaml changed: "), "{}", slower.again);

    let until = Options { until: Some(Duration::from_secs(4)), ..options.clone() };
    let shorter = search(&lab(), &until);
    assert!(
        shorter.resumed == 0 && shorter.again.to_string().starts_with("--until and lab.yaml changed: "),
        "{shorter:?}"
    );
    // Earlier runs are there, too.
    assert_eq!(search(&lab(), &options).resumed, first.runs);
}

#[test]
fn a_search_without_its_plug_in_finds_nothing() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("mine.sh"), "echo I am gone; exit 1\n").unwrap();
    let text = lab() + PROGRAM;
    let testbed = cotorra_testbed_file::parse("lab.yaml", &text, place.path()).unwrap();
    let margin = Margin::new("lab.yaml", testbed, text, options(&[Kind::Down])).unwrap();
    let journal = Journal::open(&place.path().join("out")).unwrap();
    let error = margin.run(&journal, JOBS, |_, _| true).unwrap_err().to_string();
    assert!(error.contains("plug-in mine was cut off: ") && error.contains("its log is in "), "{error}");
    let logs: Vec<_> = fs::read_dir(journal.path().join("logs")).unwrap().flatten().collect();
    let log = fs::read_to_string(logs[0].path().join("plugins/mine.log")).unwrap();
    assert_eq!((logs.len(), log.as_str()), (1, "I am gone\n"));
}

#[test]
fn a_search_that_meets_a_void_run_ends_without_a_result() {
    let grid = Grid::new(8, 1).unwrap();
    let mut search = Search::new(Some(Dimension::Delay("lan-edge".parse().unwrap())), None, grid);
    search.learn(Verdict { breaks: true, first: None });
    search.void = Some(serde_json::from_str("\"plug-in mine: ended\"").unwrap());
    assert_eq!(search.next(), None);
    let finding = search.finding();
    assert!(!finding.breaks && !finding.complete && finding.void.is_some(), "{finding:?}");
    assert_eq!((finding.survives_ms, finding.breaks_ms, finding.kept), (None, None, None));
}
