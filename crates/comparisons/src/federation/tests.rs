use cotorra_federation::Step;
use cotorra_graph::{Decision, Event, Handover, Instruction, NodeId, Stamped, Timestamp};

use super::*;

/// A run with a block every 5 s, and 120 ms beyond blocks and attachment.
fn events() -> Vec<Stamped> {
    let times = [10.0, 13.0, 13.02, 18.0, 18.03, 23.0, 23.01, 23.41, 23.42, 28.12, 28.16];
    let note = |plugin: &str, step: Step, at: f64| Stamped {
        at: Timestamp::from_secs_f64(at),
        event: Event::Decision(Decision {
            plugin: plugin.parse().unwrap(),
            instruction: Instruction::Note { process: "service-1".into(), step: step.to_string(), ago: None },
            reason: None,
            refused: None,
        }),
    };
    let creator = |step: Step| {
        matches!(
            step,
            Step::Announced
                | Step::BidReceived
                | Step::WinnerChosen
                | Step::ConfirmationReceived
                | Step::Attached
        )
    };
    let mut events: Vec<_> = STEPS
        .iter()
        .zip(times)
        .map(|(step, at)| note(if creator(*step) { "one" } else { "two" }, *step, at))
        .collect();
    // A loser receives the announcement a little earlier.
    events.insert(1, note("three", Step::AnnouncementReceived, 12.5));
    let handover = Event::Handover(Handover {
        robot: "robot".parse().unwrap(),
        from: Some("R3".parse().unwrap()),
        to: "n_AP".parse().unwrap(),
        fast: true,
        gap: Duration::from_millis(40),
    });
    let last = events.len() - 1;
    events.insert(last, Stamped { at: Timestamp::from_secs_f64(28.16), event: handover });
    events
}

fn federated() -> Federated {
    Federated::of(&events(), Duration::from_secs(5), 7).unwrap()
}

#[test]
fn own_time_excludes_blocks_and_attachment() {
    let run = federated();
    assert!((run.total_s() - 18.16).abs() < 1e-9);
    assert!((run.bound_s() - 20.44).abs() < 1e-9, "{}", run.bound_s());
    assert!((run.beyond_s() - 0.12).abs() < 1e-9, "{}", run.beyond_s());
    assert_eq!(run.attachments.each_ref().map(NodeId::as_str), ["R3", "n_AP"]);
    // A deployment longer than a block waits for another.
    let slow = Federated { block_period_s: 0.25, ..run };
    assert!((slow.beyond_s() - (18.16 - 3.0 - 4.0 * 0.25 - 0.04)).abs() < 1e-9);
}

#[test]
fn steps_from_before_a_continued_run_keep_their_times() {
    let (whole, mut events) = (federated(), events());
    // The run broke off after the choice, and continues at 20 s.
    for Stamped { at, event } in &mut events {
        let since = at.as_secs_f64() - 20.0;
        *at = Timestamp::from_secs_f64(since.max(0.0));
        if let Event::Decision(Decision { instruction: Instruction::Note { ago, .. }, .. }) = event {
            *ago = (since < 0.0).then(|| Duration::from_secs_f64(-since));
        }
    }
    let run = Federated::of(&events, Duration::from_secs(5), 7).unwrap();
    assert!((run.steps_s[0] + 10.0).abs() < 1e-6, "{:?}", run.steps_s);
    assert!(
        (run.total_s() - whole.total_s()).abs() < 1e-6 && (run.beyond_s() - whole.beyond_s()).abs() < 1e-6
    );
}

#[test]
fn an_incomplete_run_names_its_reached_steps() {
    let short: Vec<_> = events().into_iter().take(5).collect();
    let error = Federated::of(&short, Duration::from_secs(5), 7).unwrap_err().to_string();
    assert!(error.contains("no `winner chosen`") && error.contains("bid received at 18.00 s"), "{error}");
}

#[test]
fn tables_figure_and_steps_are_written() {
    let comparison = Comparison {
        how: "in virtual time".to_owned(),
        ledger: LedgerBackend::Modelled.to_string(),
        runs: vec![federated(), Federated { block_period_s: 1.0, ..federated() }, federated()],
    };
    let table = comparison.to_markdown();
    assert!(table.contains("(in virtual time, on a modelled ledger)"), "{table}");
    assert!(table.contains("| 5 s | 2 | 18.16 ± 0.00 s | 18.16 s | 18.16 s | 20.44 s | 120 ms |"), "{table}");
    let none = Federated { gap_s: -0.0, ..federated() };
    let rounded = Federated { gap_s: -0.000_2, block_period_s: 1.0, ..federated() };
    let spans = Comparison { runs: vec![none, rounded], ..comparison.clone() }.to_markdown();
    assert!(spans.contains("| 0 ms |") && !spans.contains("-0"), "{spans}");
    let folder = tempfile::tempdir().unwrap();
    comparison.write(folder.path()).unwrap();
    let read = |file: &str| std::fs::read_to_string(folder.path().join(file)).unwrap();
    let steps = read("steps.csv");
    assert_eq!((steps.lines().count(), steps.lines().next().unwrap().split(',').count()), (4, 18));
    assert!(steps.lines().all(|row| row.split(',').count() == 18), "{steps}");
    let figure = read("federation.svg");
    assert!(figure.contains("n_AP (vAP)") && figure.contains("on a modelled ledger"));
}
