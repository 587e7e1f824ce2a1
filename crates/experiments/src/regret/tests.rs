use std::fs;

use cotorra_testing::lab::Lab;

use super::*;

const JOBS: NonZero<usize> = NonZero::new(2).unwrap();

/// A robot that goes from A to B. `probing` attaches it to B, whose link to the server has this delay.
fn regret(delay: &str) -> Regret {
    regret_with(["3 ms", delay], "")
}

/// The same, with these delays of A and of B, and these keys of the plug-in.
fn regret_with([a, b]: [&str; 2], plugin: &str) -> Regret {
    let lab = Lab {
        roaming: "instructed",
        b: Some(10),
        links: &[("A, edge", a), ("B, edge", b)],
        walk: "{ waypoints: [[0, 0], [10, 0]], speed_limit: 0.7 m/s, position_interval: 50 ms }",
        rest: &format!("plugins:\n  - {{ bundled: probing, settings: {{ interval: 2 s }}{plugin} }}\n"),
        ..Lab::default()
    };
    let text = lab.to_string();
    let testbed = cotorra_testbed_file::parse("lab.yaml", &text, Path::new(""));
    let testbed = testbed.unwrap_or_else(|wrong| panic!("{wrong}"));
    Regret::new(("lab.yaml", testbed, text), &[], 1, None).unwrap()
}

fn examine(regret: &Regret, out: &Path) -> Regrets {
    let recorded = regret.record(Path::new(""), || true).unwrap().unwrap();
    regret.examine(&recorded, None, &Journal::open(out).unwrap(), JOBS, |_, _| true).unwrap()
}

#[test]
fn a_decision_for_a_slow_path_is_regretted() {
    let out = tempfile::tempdir().unwrap();
    let regrets = examine(&regret("10 ms"), out.path());
    let [one] = &regrets.examined[..] else { panic!("{regrets:?}") };
    assert_eq!((one.decided.subject(), one.decided.chosen()), ("robot", "B".to_owned()));
    let [tried] = &one.tried[..] else { panic!("{one:?}") };
    assert!(tried.target == "A" && tried.stays, "{tried:?}");
    let stayed = tried.stood.as_ref().unwrap();
    assert!(stayed.walked && stayed.kept.unwrap() > 0.9 && one.stood.kept.unwrap() < 0.1, "{one:?}");
    assert_eq!(one.regret_kept, Some(stayed.kept.unwrap() - one.stood.kept.unwrap()));
    // 7 ms less in each direction.
    assert!((one.regret_ms.unwrap() - 14.0).abs() < 0.5, "{one:?}");
}

#[test]
fn a_decision_for_a_fast_path_is_not_regretted() {
    let out = tempfile::tempdir().unwrap();
    let regrets = examine(&regret("1 ms"), out.path());
    let [one] = &regrets.examined[..] else { panic!("{regrets:?}") };
    assert!((one.regret_ms.unwrap() + 4.0).abs() < 0.5, "{one:?}");
}

#[test]
fn several_seeds_tell_whether_an_alternative_is_better_by_more_than_chance() {
    let compared = |delay: &str, seeds: u32| {
        let out = tempfile::tempdir().unwrap();
        let regrets = examine(&regret(delay).seeds(seeds), out.path());
        assert_eq!((regrets.seed, regrets.seeds, regrets.examined.len()), (1, seeds, seeds as usize));
        let [one] = &regrets.compared[..] else { panic!("{regrets:?}") };
        assert_eq!((one.pairs as u32, one.undone, one.target.as_str()), (seeds, 0, "A"));
        one.clone()
    };
    let slow = compared("10 ms", 4);
    assert_eq!(slow.verdict(), Verdict::Better);
    let Paired { mean, low, high, .. } = slow.kept.unwrap();
    assert!(
        low.unwrap() > 0.5 && low.unwrap() <= mean && mean <= high.unwrap() && high.unwrap() <= 1.0,
        "{slow:?}"
    );
    // 7 ms less in each direction.
    assert!((slow.service_time_p50_ms.unwrap().mean + 14.0).abs() < 0.5, "{slow:?}");
    assert!(slow.late.unwrap().mean < -10.0, "{slow:?}");
    // Navigation has its CPUs at the same server.
    assert_eq!(slow.cost.unwrap().mean, 0.0);
    assert_eq!(slow.handovers.unwrap().mean, -1.0, "it stays: {slow:?}");
    // Both keep the target.
    assert_eq!(compared("1 ms", 3).verdict(), Verdict::Open);
    let two = compared("10 ms", 2);
    assert_eq!((two.verdict(), two.kept.unwrap().p), (Verdict::TooFew, None));
}

#[test]
fn an_alternative_is_held_only_as_long_as_asked() {
    let out = tempfile::tempdir().unwrap();
    let kept = |hold| {
        let regrets = examine(&regret("10 ms").hold(hold), out.path());
        regrets.examined[0].tried[0].stood.as_ref().unwrap().kept.unwrap()
    };
    let (short, long) = (kept(Some(Duration::from_secs(1))), kept(None));
    // Two seconds later, `probing` attaches the robot to B anyway.
    assert!(short < long - 0.2, "{short} {long}");
}

#[test]
fn examined_decisions_are_resumed_and_end_with_the_same_bytes() {
    let out = tempfile::tempdir().unwrap();
    let regret = regret("10 ms");
    let files = |folder: &Path| FILES.map(|name| fs::read_to_string(folder.join(name)).unwrap());
    let recorded = regret.record(Path::new(""), || true).unwrap().unwrap();
    let examine = |name: &str, go_on: bool| {
        let journal = Journal::open(&out.path().join(name)).unwrap();
        let regrets = regret.examine(&recorded, None, &journal, JOBS, |_, _| go_on).unwrap();
        regrets.write(&journal).unwrap();
        (regrets, files(journal.path()))
    };
    let (whole, bytes) = examine("whole", true);
    assert!(whole.complete && whole.resumed == 0);
    let (stopped, _) = examine("stopped", false);
    assert!(!stopped.complete && stopped.examined[0].regret_kept.is_none());
    assert_eq!(examine("stopped", true).1, bytes);
    assert_eq!(examine("stopped", true).0.resumed, 1);
    assert!(bytes[0].lines().nth(1).unwrap().contains(",probing,robot,B,true,true,,"), "{}", bytes[0]);
    // Another file is another run, although the decision has the same name.
    let other = self::regret("9 ms");
    let recorded_there = other.record(Path::new(""), || true).unwrap().unwrap();
    let there = Journal::open(&out.path().join("stopped")).unwrap();
    let again = other.examine(&recorded_there, None, &there, JOBS, |_, _| true).unwrap();
    assert_eq!((again.resumed, again.again.to_string()), (0, "lab.yaml changed: 1 run again\n".to_owned()));
    let beyond = NonZero::new(2);
    let journal = Journal::open(&out.path().join("whole")).unwrap();
    let wrong = regret.examine(&recorded, beyond, &journal, JOBS, |_, _| true).unwrap_err();
    assert_eq!(
        wrong.to_string(),
        "the run has no decision 2: its plug-ins made 1 about attachments and placements"
    );
}

#[test]
fn a_regret_beside_a_void_run_is_unknown() {
    let out = tempfile::tempdir().unwrap();
    let examined = examine(&regret("10 ms"), out.path()).examined.remove(0);
    let Examined { seed, decided, stood, mut tried, .. } = examined;
    let void = serde_json::from_str("\"plug-in mine: ended\"").unwrap();
    tried.push(Tried { target: "C".into(), stays: false, stood: None, refused: None, void: Some(void) });
    let examined = Examined::of(seed, decided, stood, tried);
    assert_eq!((examined.regret_kept, examined.regret_ms), (None, None));
}

/// The way from A is too slow, so that a decision that comes later costs samples.
fn far(keys: &str, seeds: u32) -> Regrets {
    let out = tempfile::tempdir().unwrap();
    examine(&regret_with(["10 ms", "1 ms"], keys).seeds(seeds), out.path())
}

#[test]
fn the_distance_of_a_plugin_costs_what_its_twin_beside_the_core_saves() {
    let regrets = far(", control_delay: 700 ms", 3);
    assert_eq!((regrets.runs, regrets.examined.len(), regrets.complete), (6, 3, true), "{regrets:?}");
    for its in &regrets.examined {
        let twin = its.twin.as_ref().unwrap();
        assert_eq!((twin.gave, twin.instruction.as_ref()), (TwinGave::Same, Some(&its.decided.instruction)));
        // The ways there and back, and no more than a further scan.
        assert!((700.0..3500.0).contains(&twin.earlier_ms.unwrap()), "{twin:?}");
        assert_eq!(its.decided.at.since(twin.at.unwrap()).as_secs_f64() * 1e3, twin.earlier_ms.unwrap());
    }
    let [cost] = &regrets.distances[..] else { panic!("{regrets:?}") };
    assert_eq!((cost.plugin.as_str(), cost.pairs, cost.void.is_none()), ("probing", 3, true));
    assert_eq!(cost.distance.to_string(), "control_delay 700 ms");
    let [service] = &cost.services[..] else { panic!("{cost:?}") };
    let above = service.regret.above_target.unwrap();
    let (with, without) = (service.with.above_target.unwrap(), service.without.above_target.unwrap());
    assert!(above.mean > 0.03 && above.low.unwrap() > 0.0, "{service:?}");
    assert!((with - without - above.mean).abs() < 1e-12, "{service:?}");
    assert!(above.p.unwrap() < 0.05, "{service:?}");
}

#[test]
fn without_a_distance_there_is_no_twin() {
    let json = |regrets: &Regrets| serde_json::to_value(regrets).unwrap();
    let beside = far("", 1);
    assert!(beside.distances.is_empty() && beside.examined[0].twin.is_none() && beside.runs == 1);
    assert!(json(&beside).get("distances").is_none() && json(&beside)["examined"][0].get("twin").is_none());
    assert_eq!(json(&far(", control_delay: 0 ms", 1)), json(&beside));
    assert!(json(&far(", decides_in: 1 s", 1)).get("distances").is_some());
}

#[test]
fn twins_are_resumed() {
    let out = tempfile::tempdir().unwrap();
    let regret = regret_with(["10 ms", "1 ms"], ", control_delay: 700 ms").seeds(2);
    let (first, again) = (examine(&regret, out.path()), examine(&regret, out.path()));
    assert_eq!((first.resumed, again.resumed, again.runs), (0, 4, 4));
    assert_eq!((&first.distances, &first.examined), (&again.distances, &again.examined));
}
