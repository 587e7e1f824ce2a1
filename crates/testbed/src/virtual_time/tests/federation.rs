//! A robot leaves its domain's coverage, end to end in virtual time. It is handed over if all goes well. After any fault it
//! stops inside its own coverage, and everything is restored.

use std::{collections::BTreeMap, path::Path};

use cotorra_federation::Step;
use cotorra_graph::{Decision, Event, RobotContext, VnfState};
use cotorra_ledger::{Account, Call, Event as LedgerEvent, Ledger as _, Notice, Wei};
use cotorra_measurements::{History, RunInfo};
use cotorra_testbed_file::Setting;

use crate::virtual_time::*;

/// Returns the steps from the announcement to the attachment without faults.
fn steps_to_attachment() -> impl Iterator<Item = Step> {
    let failures = [Step::BidRejected, Step::DeploymentFailed];
    let steps = Step::ALL.into_iter().take_while(|step| *step != Step::OwnRadioUnitReleased);
    steps.filter(move |step| !failures.contains(step))
}

/// The edge of domain 1's coverage on the walk of `testbeds/federation.yaml`.
const EDGE_M: f64 = 23.8;

/// Only domain 2 bids.
const ALONE: &str = "plugins.orchestrator-3.settings.behaviour=silent";

fn testbed(settings: &[&str]) -> Arc<Testbed> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/federation.yaml");
    let text = std::fs::read_to_string(&path).unwrap();
    // From there, the announcement comes at 15.8 s.
    let walk = &"walks.robot.waypoints=[[10, 0], [34, 0]]";
    let settings = std::iter::once(walk).chain(settings);
    let settings: Vec<Setting> = settings.map(|setting| setting.parse().unwrap()).collect();
    let testbed =
        cotorra_testbed_file::parse_with("federation.yaml", &text, path.parent().unwrap(), &settings);
    Arc::new(testbed.unwrap_or_else(|e| panic!("{e:?}")))
}

/// The events of a run.
#[derive(Default)]
struct Outcome {
    /// Service, step, plug-in and time.
    notes: Vec<(String, String, String, f64)>,
    robots: Vec<(f64, RobotContext)>,
    /// Whether each vAP runs.
    vaps: BTreeMap<String, bool>,
    handovers: Vec<(f64, String, bool)>,
    detached: usize,
    /// Times at which the brain requested a federation.
    requested: Vec<f64>,
    /// Number of service times without an answer.
    lost: usize,
    faults: Vec<String>,
    finished: bool,
}

impl Outcome {
    fn of(simulation: &mut Simulation, until_s: f64) -> Self {
        let mut outcome = Self::default();
        while !simulation.is_finished() && simulation.step().as_secs_f64() < until_s {
            while let Some(event) = simulation.poll_event() {
                outcome.absorb(event);
            }
        }
        outcome.finished = simulation.is_finished();
        outcome
    }

    fn absorb(&mut self, Stamped { at, event }: Stamped) {
        let at = at.as_secs_f64();
        match event {
            Event::Decision(decision) => {
                if let Instruction::Note { process, step, .. } = decision.instruction {
                    self.notes.push((process, step, decision.plugin.to_string(), at));
                }
            }
            Event::Robot(context) => self.robots.push((at, context)),
            Event::Vnf(life) if life.vnf.as_str().starts_with("vAP-") => {
                self.vaps.insert(life.node.to_string(), life.state == VnfState::Started);
            }
            Event::Handover(handover) => self.handovers.push((at, handover.to.to_string(), handover.fast)),
            Event::FederationRequested { .. } => self.requested.push(at),
            Event::Detached { .. } => self.detached += 1,
            Event::ServiceTime(sample) => self.lost += usize::from(sample.took.is_none()),
            Event::PluginFault { plugin, reason } => self.faults.push(format!("{plugin}: {reason}")),
            _ => {}
        }
    }

    fn when(&self, step: Step) -> Option<f64> {
        self.notes.iter().find(|(_, name, ..)| *name == step.as_str()).map(|(.., at)| *at)
    }

    fn detail(&self) -> String {
        self.notes.iter().map(|(_, step, by, at)| format!("{at:.3} {by}: {step}\n")).collect()
    }

    fn farthest(&self) -> f64 {
        self.robots.iter().map(|(_, context)| context.sensors.pose.x).fold(0.0, f64::max)
    }

    /// Asserts that the robot stopped inside its domain's coverage, stayed attached, and everything is as before.
    fn assert_halted_and_put_back(&self, simulation: &Simulation) {
        let detail = self.detail();
        assert!(self.faults.is_empty(), "{:?}", self.faults);
        let (_, last) = self.robots.last().unwrap();
        assert_eq!(last.sensors.velocity, Default::default(), "it stands still: {detail}");
        assert!((15.0..EDGE_M).contains(&self.farthest()), "it stopped at {} m: {detail}", self.farthest());
        assert!(
            self.robots.iter().all(|(_, context)| context.attached_to().is_some_and(|unit| unit == "R3"))
        );
        assert!(!self.vaps.values().any(|on| *on), "{:?}: {detail}", self.vaps);
        assert_eq!(self.vaps.get("R3"), None, "its own radio unit was never released: {detail}");
        assert_eq!(simulation.ledgers.chain().unwrap().contract().holds(), Wei(0), "{detail}");
        assert!(self.when(Step::Failed).is_some(), "{detail}");
    }
}

/// Simulates 180 s with a fault.
fn goes_wrong(settings: &[&str]) -> Outcome {
    let mut simulation = Simulation::new(testbed(settings), 1).unwrap();
    let outcome = Outcome::of(&mut simulation, 180.0);
    outcome.assert_halted_and_put_back(&simulation);
    outcome
}

#[test]
fn a_robot_walks_from_domain_to_domain_and_back_without_stopping() {
    let mut simulation = Simulation::new(testbed(&[]), 1).unwrap();
    let outcome = Outcome::of(&mut simulation, 300.0);
    let detail = outcome.detail();
    assert!(outcome.finished && outcome.faults.is_empty(), "{:?}", outcome.faults);
    use Step::*;
    let steps = steps_to_attachment().chain([OwnRadioUnitReleased, InUse, Returned, Ended, TakenDown]);
    let times: Vec<f64> =
        steps.map(|step| outcome.when(step).unwrap_or_else(|| panic!("{step}: {detail}"))).collect();
    assert!(times.is_sorted(), "{detail}");
    // One block for the announcement, two for bid and choice, one for the confirmation. The rest is the handover.
    let total = times[10] - times[0];
    assert!((15.0..20.2).contains(&total), "{total}: {detail}");
    assert!((times[7] - times[6] - 0.4).abs() < 1e-6, "the deployment takes what the radio unit says");
    // Make before break.
    let handovers: Vec<_> = outcome.handovers.iter().map(|(_, to, fast)| (to.as_str(), *fast)).collect();
    assert_eq!((handovers, outcome.detached, outcome.lost), (vec![("n_AP", true), ("R3", true)], 0, 0));
    let walking = outcome.robots.iter().filter(|(at, _)| (5.0..60.0).contains(at));
    let slowest = walking.map(|(_, context)| context.sensors.velocity.linear).fold(f64::INFINITY, f64::min);
    assert!(slowest > 0.28, "its speed never falls: {slowest}");
    assert_eq!(outcome.vaps, BTreeMap::from([("R3".to_owned(), true), ("n_AP".to_owned(), false)]));
    // The cheaper of the two bidders was paid for the use.
    assert!(
        outcome.notes.iter().all(|(_, step, by, _)| *step != "winner received" || by == "orchestrator-2")
    );
    assert_eq!(simulation.ledgers.chain().unwrap().contract().holds(), Wei(0), "all were paid out");
}

/// Lets the orchestrator of domain 1 wait for the robot's brain.
const BY_BRAIN: &str = "plugins.orchestrator-1.settings.trigger=brain";

#[test]
fn the_brain_triggers_the_federation_on_each_way_out() {
    let mut simulation = Simulation::new(testbed(&[BY_BRAIN]), 1).unwrap();
    let outcome = Outcome::of(&mut simulation, 300.0);
    let detail = outcome.detail();
    assert!(outcome.finished && outcome.faults.is_empty(), "{:?}", outcome.faults);
    assert_eq!((outcome.requested.len(), outcome.lost), (1, 0), "{:?}", outcome.requested);
    // The plug-in announces with the next context, and the whole federation follows.
    let announced = outcome.when(Step::Announced).unwrap_or_else(|| panic!("{detail}"));
    let after = announced - outcome.requested[0];
    assert!((0.0..=0.11).contains(&after), "{after}: {detail}");
    for step in steps_to_attachment().chain([Step::Returned, Step::Ended]) {
        assert!(outcome.when(step).is_some(), "{step}: {detail}");
    }
    // A request as early as the plug-in's own prediction.
    let alone = Outcome::of(&mut Simulation::new(testbed(&[]), 1).unwrap(), 300.0);
    let itself = alone.when(Step::Announced).unwrap();
    assert!((announced - itself).abs() < 0.5, "{announced}, by itself {itself}");
    assert!(alone.requested.is_empty(), "nobody asks the brain");
}

#[test]
fn keys_are_never_published() {
    let mut simulation = Simulation::new(testbed(&[]), 1).unwrap();
    let mut access_points = 0;
    while simulation.step().as_secs_f64() < 40.0 {
        while let Some(event) = simulation.poll_event() {
            if let Event::Decision(decision) = event.event
                && let Instruction::Deploy { access_point, .. } | Instruction::Provision { access_point, .. } =
                    decision.instruction
            {
                access_points += 1;
                assert_eq!(access_point.key, None);
            }
        }
    }
    assert_eq!(access_points, 2, "one was deployed, and the robot provisioned for it");
}

#[test]
fn nobody_bids() {
    let outcome = goes_wrong(&[
        "plugins.orchestrator-2.settings.behaviour=silent",
        "plugins.orchestrator-3.settings.behaviour=silent",
    ]);
    assert_eq!(outcome.when(Step::BidSent), None);
}

#[test]
fn all_bids_are_too_dear() {
    let outcome = goes_wrong(&["plugins.orchestrator-1.settings.highest_price=50"]);
    assert!(outcome.when(Step::BidRejected).is_some() && outcome.when(Step::WinnerChosen).is_none());
}

#[test]
fn the_winner_does_not_deploy() {
    let outcome = goes_wrong(&["plugins.orchestrator-2.settings.behaviour=idle", ALONE]);
    assert!(outcome.when(Step::WinnerReceived).is_some() && outcome.when(Step::DeploymentStarted).is_none());
}

#[test]
fn the_deployment_fails() {
    let outcome = goes_wrong(&["nodes.n_AP.cpus=0", ALONE]);
    assert!(outcome.when(Step::DeploymentFailed).is_some() && outcome.when(Step::ConfirmationSent).is_none());
}

#[test]
fn the_provider_lies_about_its_deployment() {
    let outcome = goes_wrong(&["plugins.orchestrator-2.settings.behaviour=lying", ALONE]);
    assert!(outcome.when(Step::ConfirmationReceived).is_some() && outcome.when(Step::Attached).is_none());
}

#[test]
fn if_the_winner_fails_the_robot_continues_with_the_next_bid() {
    for failing in [
        "plugins.orchestrator-2.settings.behaviour=idle",
        "nodes.n_AP.cpus=0",
        "plugins.orchestrator-2.settings.behaviour=lying",
    ] {
        let mut simulation = Simulation::new(testbed(&[failing]), 1).unwrap();
        let outcome = Outcome::of(&mut simulation, 400.0);
        let detail = outcome.detail();
        assert!(outcome.finished && outcome.faults.is_empty(), "{failing}: {:?} {detail}", outcome.faults);
        assert!(outcome.handovers.iter().any(|(_, to, _)| to == "n_AP3"), "{failing}: {detail}");
        assert_eq!(simulation.ledgers.chain().unwrap().contract().holds(), Wei(0), "{failing}: {detail}");
    }
}

#[test]
fn with_time_for_the_next_bid_an_idle_winner_halts_nobody() {
    let early =
        ["plugins.orchestrator-1.settings.lead=60 s", "plugins.orchestrator-1.settings.patience=120 s"];
    let idle = ["plugins.orchestrator-2.settings.behaviour=idle"];
    for (settings, halted) in [([&idle[..], &early].concat(), false), (idle.to_vec(), true)] {
        let mut simulation = Simulation::new(testbed(&settings), 1).unwrap();
        let outcome = Outcome::of(&mut simulation, 100.0);
        assert_eq!(outcome.when(Step::Halted).is_some(), halted, "{settings:?}: {}", outcome.detail());
        assert!(
            outcome.handovers.iter().any(|(_, to, _)| to == "n_AP3"),
            "{settings:?}: {}",
            outcome.detail()
        );
    }
}

#[test]
fn the_ledger_is_out_of_the_creators_reach() {
    for from in ["17 s", "22 s", "27 s", "33 s"] {
        let ledger = format!(
            "plugins.orchestrator-1.settings.ledger={{kind: modelled, block_period: 5 s, outage: [{from}, 130 s]}}"
        );
        goes_wrong(&[&ledger]);
    }
}

#[test]
fn the_ledger_never_exists() {
    let ledger =
        "plugins.orchestrator-1.settings.ledger={kind: modelled, block_period: 5 s, outage: [1 ms, 500 s]}";
    let mut simulation = Simulation::new(testbed(&[ledger]), 1).unwrap();
    let outcome = Outcome::of(&mut simulation, 120.0);
    assert!((15.0..EDGE_M).contains(&outcome.farthest()), "{}", outcome.farthest());
    assert!(outcome.notes.is_empty() && outcome.vaps.is_empty(), "nothing came of it: {}", outcome.detail());
}

#[test]
fn the_ledger_is_out_of_the_winners_reach() {
    let outcome = goes_wrong(&[
        "plugins.orchestrator-2.settings.ledger={kind: modelled, block_period: 5 s, outage: [27 s, 130 s]}",
        ALONE,
    ]);
    assert_eq!(outcome.when(Step::WinnerReceived), None, "{}", outcome.detail());
}

#[test]
fn a_ledger_that_returns_in_time_does_no_harm() {
    let mut simulation = Simulation::new(
        testbed(&["plugins.orchestrator-1.settings.ledger={kind: modelled, block_period: 5 s, outage: [22 s, 27 s]}"]),
        1,
    )
    .unwrap();
    let outcome = Outcome::of(&mut simulation, 300.0);
    assert!(outcome.finished && outcome.when(Step::Returned).is_some(), "{}", outcome.detail());
}

#[test]
fn a_replayed_announcement_changes_nothing() {
    let mut simulation = Simulation::new(testbed(&[]), 1).unwrap();
    Outcome::of(&mut simulation, 21.0);
    let chain = simulation.ledgers.chain().unwrap().clone();
    let mut eve = chain.ledger(Account([0xee; 20]));
    let now = Timestamp::from_secs_f64(21.0);
    let heard: Vec<_> = std::iter::from_fn(|| eve.poll(now)).collect();
    let announced = heard.into_iter().find_map(|notice| match notice {
        Notice::Event(LedgerEvent::ServiceAnnounced { key, requirements, terms, .. }) => {
            Some((key, requirements, terms))
        }
        _ => None,
    });
    // The chain does not contain the salt. A copy needs another salt, gets another id, and belongs to Eve.
    let (key, requirements, terms) = announced.unwrap();
    eve.submit(now, Call::Register { name: "Eve".to_owned() });
    for salt in [[1; 32], [1; 32], [2; 32]] {
        let salt = cotorra_ledger::Salt(salt);
        let (requirements, key) = (requirements.clone(), key);
        eve.submit(now, Call::Announce { salt, key, requirements, terms });
    }
    let outcome = Outcome::of(&mut simulation, 300.0);
    assert!(outcome.finished && outcome.faults.is_empty(), "{:?}", outcome.faults);
    assert!(outcome.when(Step::Returned).is_some(), "{}", outcome.detail());
    assert_eq!((outcome.detached, outcome.lost), (0, 0));
    let heard: Vec<_> = std::iter::from_fn(|| eve.poll(Timestamp::from_secs_f64(300.0))).collect();
    let refused = heard.iter().filter(|notice| matches!(notice, Notice::Refused(..))).count();
    assert_eq!(refused, 1, "the same announcement is there once");
    assert_eq!(chain.contract().holds(), Wei(0));
}

#[test]
fn a_restarted_core_continues_from_the_chain() {
    // Before the announcement, between all steps, and during the vAP's use.
    for stopped_at in [10.0, 17.0, 22.0, 27.0, 30.2, 33.0, 36.0, 42.0, 60.0] {
        let mut before = Simulation::new(testbed(&[]), 1).unwrap();
        let outcome = Outcome::of(&mut before, stopped_at);
        let at = outcome.robots.last().unwrap().1.sensors.pose.x;
        let ledgers = std::mem::take(&mut before.ledgers);
        drop(before);
        ledgers.chain().unwrap().begin_run(Timestamp::from_secs_f64(stopped_at));
        // The robot stays where it was; everything else starts as in the file.
        let walk = format!("walks.robot.waypoints=[[{at}, 0], [34, 0]]");
        let testbed = testbed(&[&walk, "walks.robot.and_back=false"]);
        let mut after = Simulation::on(testbed, 1, ledgers, None, None).unwrap();
        let outcome = Outcome::of(&mut after, 200.0);
        let detail = outcome.detail();
        assert!(
            outcome.finished && outcome.faults.is_empty(),
            "stopped at {stopped_at}: {:?} {detail}",
            outcome.faults
        );
        assert!(outcome.when(Step::Attached).is_some(), "stopped at {stopped_at}: {detail}");
        let services: std::collections::BTreeSet<_> = outcome.notes.iter().map(|(id, ..)| id).collect();
        assert_eq!(services.len(), 1, "stopped at {stopped_at}, it was announced once: {detail}");
        assert_eq!(outcome.detached, 0, "stopped at {stopped_at}: {detail}");
    }
}

/// Returns the notes of a simulation until then, or until its end.
fn notes(simulation: &mut Simulation, until_s: f64) -> (Vec<Stamped>, f64) {
    let (mut notes, mut x) = (Vec::new(), 0.0);
    while !simulation.is_finished() && simulation.step().as_secs_f64() < until_s {
        while let Some(stamped) = simulation.poll_event() {
            match &stamped.event {
                Event::Robot(context) => x = context.sensors.pose.x,
                Event::Decision(decision) if matches!(decision.instruction, Instruction::Note { .. }) => {
                    notes.push(stamped);
                }
                Event::PluginFault { plugin, reason } => panic!("{plugin}: {reason}"),
                _ => {}
            }
        }
    }
    (notes, x)
}

#[test]
fn a_restarted_core_with_its_notes_has_the_whole_timeline_and_no_step_twice() {
    use Step::*;
    // After each step, and during the vAP's use.
    for stopped_at in [16.5, 22.0, 27.0, 30.2, 33.0, 36.0, 42.0, 60.0] {
        let mut before = Simulation::new(testbed(&[]), 1).unwrap();
        let (noted, x) = notes(&mut before, stopped_at);
        let ledgers = std::mem::take(&mut before.ledgers);
        drop(before);
        ledgers.chain().unwrap().begin_run(Timestamp::from_secs_f64(stopped_at));
        // Its history was kept, and is read.
        let history = History::in_memory().unwrap();
        let info =
            RunInfo { name: "federation".into(), seed: 1, started_at_unix_ns: 0, testbed: String::new() };
        let run = history.begin_run(&info).unwrap();
        let recorder = history.recorder(run).unwrap();
        noted.iter().for_each(|note| recorder.record(note.clone()));
        recorder.flush().unwrap();
        let earlier = PreviousRun::kept(&history, &history.run(run).unwrap()).unwrap();

        let walk = format!("walks.robot.waypoints=[[{x}, 0], [34, 0]]");
        let testbed = testbed(&[&walk, "walks.robot.and_back=false"]);
        let mut after = Simulation::on(testbed, 1, ledgers, None, Some(&earlier)).unwrap();
        let (new, _) = notes(&mut after, 200.0);
        assert!(after.is_finished(), "stopped at {stopped_at}");

        let kept = earlier.notes_before((stopped_at * 1e9) as i64);
        let timeline: Vec<_> = kept
            .chain(new)
            .map(|Stamped { at, event }| {
                let Event::Decision(Decision { plugin, instruction, reason, .. }) = event else { panic!() };
                let Instruction::Note { process, step, ago } = instruction else { panic!() };
                let at = at.as_secs_f64() - ago.unwrap_or_default().as_secs_f64();
                (at, plugin.to_string(), process, step, reason)
            })
            .collect();
        let outcome = format!("stopped at {stopped_at}: {timeline:#?}");
        let once: std::collections::BTreeSet<_> =
            timeline.iter().map(|(_, plugin, process, step, why)| (plugin, process, step, why)).collect();
        assert_eq!(once.len(), timeline.len(), "{outcome}");
        assert!(timeline.is_sorted_by_key(|(at, ..)| *at), "{outcome}");
        let first = |step: Step| {
            let found = timeline.iter().find(|(_, _, _, name, _)| *name == step.as_str());
            found.unwrap_or_else(|| panic!("{step} is missing, {outcome}")).0
        };
        assert!(steps_to_attachment().chain([InUse]).map(first).is_sorted(), "{outcome}");
        assert!((first(Announced) + stopped_at - 15.8).abs() < 0.5, "when it was, not now: {outcome}");
    }
}

#[test]
fn a_provider_that_stops_serving_stops_its_robot() {
    // The longest use ends while the robot is away. It is short beside the wait for the acceptance, which makes it dear.
    let settings = ["use_for=20 s", "highest_price=1000"];
    let settings = settings.map(|setting| format!("plugins.orchestrator-1.settings.{setting}"));
    let mut simulation = Simulation::new(testbed(&settings.each_ref().map(String::as_str)), 1).unwrap();
    let outcome = Outcome::of(&mut simulation, 200.0);
    let detail = outcome.detail();
    assert!(outcome.faults.is_empty(), "{:?}", outcome.faults);
    assert!(outcome.notes.iter().any(|(_, step, ..)| step == "ended"), "{detail}");
    assert_eq!(outcome.vaps.get("n_AP"), Some(&false), "{detail}");
}
