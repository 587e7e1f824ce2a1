use std::fs;

use cotorra_testing::lab::Lab;

use super::*;

const JOBS: NonZero<usize> = NonZero::new(2).unwrap();

/// A robot that goes from A to B. `probing` attaches it to B, whose link to the server has this delay.
fn regret(delay: &str) -> Regret {
    let lab = Lab {
        roaming: "instructed",
        b: Some(10),
        links: &[("A, edge", "3 ms"), ("B, edge", delay)],
        walk: "{ waypoints: [[0, 0], [10, 0]], speed_limit: 0.7 m/s, position_interval: 50 ms }",
        rest: "plugins:\n  - { bundled: probing, settings: { interval: 2 s } }\n",
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
