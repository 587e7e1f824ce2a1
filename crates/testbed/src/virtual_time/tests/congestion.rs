//! OKpi where a camera fills the links to the cloud.

use super::*;

/// Returns the testbed whose robot's camera fills the link to the cloud, and its text, with this source of delays.
fn room(delays: &str) -> (Testbed, String) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/congestion.yaml");
    let text = std::fs::read_to_string(&file).unwrap();
    let text = text.replace("delays: measured", &format!("delays: {delays}"));
    assert!(text.contains(delays));
    let testbed = cotorra_testbed_file::parse("congestion.yaml", &text, file.parent().unwrap()).unwrap();
    (testbed, text)
}

/// The decisions of a minute, with their times, and the service times of navigation by time of emission.
#[derive(Debug, PartialEq)]
struct Minute {
    moves: Vec<(f64, String, String)>,
    samples: Vec<(f64, Option<f64>)>,
}

fn minute(delays: &str) -> Minute {
    let (testbed, _) = room(delays);
    let (mut moves, mut samples) = (Vec::new(), Vec::new());
    for Stamped { at, event } in events_of(&Arc::new(testbed), 1, 60.0) {
        match event {
            Event::Decision(decision) => {
                assert_eq!(decision.refused, None);
                if let Instruction::Place { node, .. } = decision.instruction {
                    moves.push((at.as_secs_f64(), node.first().to_string(), decision.reason.unwrap()));
                }
            }
            Event::ServiceTime(sample) if is_of_navigation(&sample) => {
                let took = sample.took.map(|took| took.as_secs_f64() * 1e3);
                samples.push((sample.emitted.as_secs_f64(), took));
            }
            _ => {}
        }
    }
    Minute { moves, samples }
}

/// Returns the share of samples from a time on that keep 15 ms.
fn kept(samples: &[(f64, Option<f64>)], from: f64) -> f64 {
    let of: Vec<_> = samples.iter().filter(|(at, _)| *at >= from).collect();
    assert!(of.len() > 400, "{}", of.len());
    of.iter().filter(|(_, took)| took.is_some_and(|took| took <= 15.0)).count() as f64 / of.len() as f64
}

#[test]
fn okpi_leaves_links_that_a_camera_fills_and_does_not_come_back() {
    let Minute { moves, samples } = minute("measured");
    let [(at, node, reason)] = &moves[..] else { panic!("{moves:#?}") };
    assert_eq!(node, "edge");
    assert!(*at < 10.0, "{at}");
    assert!(reason.contains("slower than configured"), "{reason}");
    let share = kept(&samples, at + 1.0);
    assert!(share > 0.95, "{share}, after {at} s: {reason}");
    println!("after {at} s, {share} keep 15 ms: {reason}");
}

#[test]
fn the_bill_of_cpus_is_the_objective_of_okpi_over_time() {
    let (mut testbed, _) = room("measured");
    testbed.currency = Some("EUR".to_owned());
    let mut report = Report::new(&testbed, 1);
    let mut costs = vec![(0.0, 2.0 * 1.0)];
    for stamped in events_of(&Arc::new(testbed), 1, 60.0) {
        report.absorb(&stamped);
        if let Event::Decision(Decision { instruction: Instruction::Place { .. }, reason, .. }) =
            stamped.event
        {
            let reason = reason.unwrap();
            let (_, cost) = reason.split_once("for a cost of ").unwrap();
            costs.push((stamped.at.as_secs_f64(), cost.split(':').next().unwrap().parse().unwrap()));
        }
    }
    let end = Timestamp::from_secs_f64(60.0);
    let bill = report.summary(end, "ended", Losses::default()).bill.unwrap();
    let until = costs.iter().skip(1).map(|(at, _)| *at).chain([60.0]);
    let spent: Vec<f64> =
        costs.iter().zip(until).map(|((at, cost), until)| cost * (until - at) / 3600.0).collect();
    let [before, after] = spent[..] else { panic!("{costs:?}") };
    let navigation = &bill.services[0];
    assert_eq!(navigation.service.as_str(), "navigation");
    // A placement takes effect a few microseconds after its decision.
    let of_all = navigation.taken.cpu_price / (before + after);
    assert!((of_all - 1.0).abs() < 1e-6, "{spent:?} {bill:?}");
    assert_eq!(navigation.taken.migrations, 1);
    println!("{} for {costs:?}", bill.sentence());
}

#[test]
fn okpi_stays_on_full_links_if_it_counts_with_the_configuration() {
    let Minute { moves, samples } = minute("asked");
    assert_eq!(moves, []);
    let share = kept(&samples, 2.0);
    assert!(share < 0.01, "{share}");
    println!("{share} keep 15 ms");
}

#[test]
fn okpi_decides_as_configured_where_links_do_as_configured() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let text = std::fs::read_to_string(&file).unwrap().replace("  - probing\n", "");
    let of = |delays: &str| {
        let text = text.replace(
            "    enabled: false\n    settings:\n",
            &format!("    settings:\n      delays: {delays}\n"),
        );
        assert!(text.contains(delays));
        let testbed = cotorra_testbed_file::parse("corridor.yaml", &text, file.parent().unwrap()).unwrap();
        events_of(&Arc::new(testbed), 1, 70.0)
    };
    let (measured, asked) = (of("measured"), of("asked"));
    let decided = |events: &[Stamped]| {
        events.iter().filter(|stamped| matches!(stamped.event, Event::Decision(_))).count()
    };
    assert!(decided(&asked) > 4, "{}", decided(&asked));
    assert!(measured == asked, "{} and {} decisions", decided(&measured), decided(&asked));
}

#[test]
fn okpi_reads_measurements_from_the_history_of_its_own_run() {
    let (testbed, text) = room("history");
    let out = tempfile::tempdir().unwrap();
    let options = Options {
        until: Some(Duration::from_secs(12)),
        folder: Place::In(out.path().to_owned()),
        ..Options::default()
    };
    let run = simulate(testbed.clone(), &text, &options, |_| true).unwrap();
    let history = cotorra_measurements::History::open(run.folder.join("history.sqlite")).unwrap();
    let places =
        history.all_events(run.run, &[]).unwrap().into_iter().filter_map(|stamped| match stamped.event {
            Event::Decision(Decision {
                instruction: Instruction::Place { node, .. }, refused: None, ..
            }) => Some(node.first().to_string()),
            _ => None,
        });
    assert_eq!(places.collect::<Vec<_>>(), ["edge"]);
    // Without a folder there is no history to read.
    let error = Simulation::new(Arc::new(testbed), 1).err().unwrap().to_string();
    assert!(error.contains("`history` needs a history"), "{error}");
}
