//! Places of robots, and notes, which a run that broke off leaves to the next one. The next run keeps the notes as its own,
//! with times before its beginning. Its plug-ins continue from the state in the ledger and the notes.

use std::time::Duration;

use cotorra_federation::{LedgerChoice, Settings};
use cotorra_graph::{
    Decision, Event, Instruction, PluginId, PluginProgram, PluginSpec, RobotContext, Stamped, Testbed,
    Timestamp,
};
use cotorra_measurements::{History, Kind, Run};
use cotorra_plugin::Noted;
use cotorra_testbed_file::{Diagnostics, Setting};

/// Reason for which no run can continue another.
#[derive(Debug, thiserror::Error)]
pub enum CannotGoOn {
    /// The testbeds have different names.
    #[error("it was a run of the testbed `{before}`, and this one is of `{now}`")]
    Testbed {
        /// Name of the previous run's testbed.
        before: String,
        /// Name of this run's testbed.
        now: String,
    },
    /// The ledgers have different contracts.
    #[error("plug-in `{0}`: that run had another ledger for it, or another contract or domain")]
    OtherLedger(PluginId),
    /// The previous run's testbed file is not valid any more.
    #[error("its testbed file cannot be read: {0}")]
    Unreadable(Diagnostics),
    /// The previous run's history cannot be read.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
}

/// Robots and notes of plug-ins of a previous run.
#[derive(Debug, Clone)]
pub struct PreviousRun {
    /// Last known contexts of its robots.
    robots: Vec<RobotContext>,
    /// Nanoseconds since 1970 at which each step was reached, and the note.
    notes: Vec<(i64, Decision)>,
}

impl PreviousRun {
    /// Reads what a run leaves to a run of the testbed `now`. `parse` reads the text of the previous run's testbed file,
    /// which matters only for ledgers that outlive a run.
    ///
    /// # Errors
    /// [`CannotGoOn`].
    pub fn read(
        history: &History,
        run: &Run,
        now: &Testbed,
        parse: impl FnOnce(&str) -> Result<Testbed, Diagnostics>,
    ) -> Result<Self, CannotGoOn> {
        if run.info.name != now.name {
            return Err(CannotGoOn::Testbed { before: run.info.name.clone(), now: now.name.clone() });
        }
        if orchestrators(now).any(|spec| contract(spec).is_some()) {
            check(&parse(&run.info.testbed).map_err(CannotGoOn::Unreadable)?, now)?;
        }
        let mut previous = Self::kept(history, run)?;
        // Ledgers of other orchestrators begin with the run, and know nothing of what was noted.
        let goes_on =
            |plugin: &PluginId| orchestrators(now).any(|spec| spec.id == *plugin && contract(spec).is_some());
        previous.notes.retain(|(_, decision)| goes_on(&decision.plugin));
        let state = history.state_at(run.id, Timestamp::MAX)?;
        previous.robots = state.robots.into_iter().map(|sample| sample.value).collect();
        Ok(previous)
    }

    /// Returns the settings of the testbed's file with which its robots start where they stood, and walk on.
    pub fn starts(&self, testbed: &Testbed) -> Vec<Setting> {
        let mut settings = Vec::new();
        // A name with two dots in a row fits no setting. Such a robot starts anew.
        let mut set = |path: String, value: String| settings.extend(Setting::new(&path, &value).ok());
        for RobotContext { robot, sensors, waypoint, .. } in &self.robots {
            let (place, walk) = (sensors.pose.position(), testbed.walk(robot));
            let is_there = testbed.graph.robots().any(|(node, _)| node.id == *robot);
            // The walk may be another one now.
            let has_waypoint = walk.is_none_or(|walk| *waypoint as usize <= walk.waypoints.len());
            if !is_there || !has_waypoint || !sensors.pose.is_finite() {
                continue;
            }
            let height = if place.z == 0.0 { String::new() } else { format!(", {}", place.z) };
            set(format!("nodes.{robot}.position"), format!("[{}, {}{height}]", place.x, place.y));
            set(format!("nodes.{robot}.heading"), format!("{} rad", sensors.pose.heading));
            if walk.is_some() {
                set(format!("walks.{robot}.next"), waypoint.to_string());
            }
        }
        settings
    }

    /// Whether plug-ins continue from notes, with a ledger that outlives a run.
    pub fn has_notes(&self) -> bool {
        !self.notes.is_empty()
    }

    /// Reads the notes of a run.
    pub(crate) fn kept(history: &History, run: &Run) -> Result<Self, cotorra_measurements::Error> {
        let decisions = history.all_events(run.id, &[Kind::Decision])?;
        let notes = decisions.into_iter().filter_map(|event| note(run.info.started_at_unix_ns, event));
        Ok(Self { robots: Vec::new(), notes: notes.collect() })
    }

    /// Returns the notes of a plug-in.
    pub(crate) fn noted_by(&self, plugin: &PluginId) -> Vec<Noted> {
        let by_it = self.notes.iter().filter(|(_, decision)| decision.plugin == *plugin);
        let noted = by_it.filter_map(|(_, decision)| match &decision.instruction {
            Instruction::Note { process, step, .. } => {
                let (process, step, reason) = (process.clone(), step.clone(), decision.reason.clone());
                Some(Noted { process, step, reason })
            }
            _ => None,
        });
        noted.collect()
    }

    /// Returns the notes as events of a run that began at that time, in nanoseconds since 1970.
    pub(crate) fn notes_before(&self, began_unix_ns: i64) -> impl Iterator<Item = Stamped> {
        self.notes.iter().map(move |(at, decision)| {
            let mut decision = decision.clone();
            if let Instruction::Note { ago, .. } = &mut decision.instruction {
                // A clock that was set back must not put a note into the future.
                let before = u64::try_from(began_unix_ns.saturating_sub(*at)).unwrap_or_default();
                *ago = Some(Duration::from_nanos(before));
            }
            Stamped { at: Timestamp::ZERO, event: Event::Decision(decision) }
        })
    }
}

/// Returns a recorded note, and the time at which its step was reached.
fn note(began_unix_ns: i64, Stamped { at, event }: Stamped) -> Option<(i64, Decision)> {
    let Event::Decision(decision) = event else { return None };
    let Instruction::Note { ago, .. } = &decision.instruction else { return None };
    let ago = ago.unwrap_or_default().as_nanos();
    let since = i128::from(at.as_nanos()) - i128::try_from(ago).ok()?;
    let at = i64::try_from(i128::from(began_unix_ns) + since).ok()?;
    decision.refused.is_none().then_some((at, decision))
}

/// Checks that orchestrators of one testbed can continue those of another: the same domains on the same contract. Those
/// whose ledger begins with the run start afresh.
fn check(before: &Testbed, now: &Testbed) -> Result<(), CannotGoOn> {
    for spec in orchestrators(now) {
        let Some(contract) = contract(spec) else { continue };
        let was = orchestrators(before).find(|was| was.id == spec.id && was.domain == spec.domain);
        if was.and_then(self::contract) != Some(contract) {
            return Err(CannotGoOn::OtherLedger(spec.id.clone()));
        }
    }
    Ok(())
}

/// Returns the chain and the contract of an orchestrator, if its ledger outlives a run.
fn contract(spec: &PluginSpec) -> Option<(u64, String)> {
    match Settings::decode(&spec.settings).ok()?.ledger {
        LedgerChoice::Ethereum(network) => Some((network.chain_id, network.contract.to_ascii_lowercase())),
        LedgerChoice::Modelled { .. } | LedgerChoice::Anvil { .. } => None,
    }
}

/// Returns the plug-ins that orchestrate a domain: the bundled ones named `federation`.
pub fn orchestrators(testbed: &Testbed) -> impl Iterator<Item = &PluginSpec> {
    let is_orchestrator =
        |spec: &&PluginSpec| matches!(&spec.program, PluginProgram::Bundled(name) if name == "federation");
    testbed.plugins.iter().filter(is_orchestrator)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_graph::{Pose, PoseSource, Position};
    use cotorra_graph_testing as base;
    use cotorra_measurements::RunInfo;

    use super::*;

    const BEGAN: i64 = 1_700_000_000_000_000_000;

    fn testbed(settings: &[&str]) -> Testbed {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/federation.yaml");
        let text = std::fs::read_to_string(&path).unwrap();
        let settings: Vec<Setting> = settings.iter().map(|setting| setting.parse().unwrap()).collect();
        cotorra_testbed_file::parse_with("federation.yaml", &text, path.parent().unwrap(), &settings).unwrap()
    }

    fn on(contract: &str) -> Testbed {
        on_chain(1, contract)
    }

    fn on_chain(chain_id: u64, contract: &str) -> Testbed {
        let ledger = format!(
            "plugins.*.settings.ledger={{kind: ethereum, url: 'ws://127.0.0.1:1', chain_id: {chain_id}, contract: '{contract}', key_store: k}}"
        );
        testbed(&[&ledger])
    }

    /// Records a run, with the notes that it has at its beginning and later.
    fn keep(history: &History, began: i64, notes: impl IntoIterator<Item = Stamped>) -> Run {
        let info =
            RunInfo { name: "federation".into(), seed: 1, started_at_unix_ns: began, testbed: String::new() };
        let run = history.begin_run(&info).unwrap();
        let recorder = history.recorder(run).unwrap();
        notes.into_iter().for_each(|note| recorder.record(note));
        recorder.flush().unwrap();
        history.run(run).unwrap()
    }

    fn noted(at_s: u64, plugin: &str, step: &str, refused: Option<&str>) -> Stamped {
        let instruction = Instruction::Note { process: "service-1".into(), step: step.into(), ago: None };
        let plugin = plugin.parse().unwrap();
        let refused = refused.map(str::to_owned);
        let decision = Decision { plugin, instruction, reason: Some("why".into()), refused };
        Stamped { at: Timestamp::ZERO + Duration::from_secs(at_s), event: Event::Decision(decision) }
    }

    /// Returns the steps of notes, and their ages in seconds.
    fn steps(notes: impl Iterator<Item = Stamped>) -> Vec<(String, u64)> {
        notes
            .map(|note| match note.event {
                Event::Decision(Decision { instruction: Instruction::Note { step, ago, .. }, .. }) => {
                    (step, ago.unwrap().as_secs())
                }
                other => panic!("{other:?}"),
            })
            .collect()
    }

    #[test]
    fn notes_pass_from_run_to_run_with_their_times() {
        let history = History::in_memory().unwrap();
        let (second, on) = (1_000_000_000, on("0xAb"));
        let first = keep(
            &history,
            BEGAN,
            [
                noted(20, "orchestrator-1", "announced", None),
                noted(25, "orchestrator-2", "bid sent", None),
                noted(26, "orchestrator-2", "nonsense", Some("it was refused")),
            ],
        );
        let previous = PreviousRun::read(&history, &first, &on, |_| Ok(on.clone())).unwrap();
        let notes: Vec<_> = previous.notes_before(BEGAN + 60 * second).collect();
        assert!(notes.iter().all(|note| note.at == Timestamp::ZERO));
        assert_eq!(steps(notes.clone().into_iter()), [("announced".into(), 40), ("bid sent".into(), 35)]);
        let by = previous.noted_by(&"orchestrator-2".parse().unwrap());
        let bid = Noted { process: "service-1".into(), step: "bid sent".into(), reason: Some("why".into()) };
        assert_eq!(by, [bid]);

        // The next run is killed, too.
        let more = [noted(3, "orchestrator-1", "winner chosen", None)];
        let next = keep(&history, BEGAN + 60 * second, notes.into_iter().chain(more));
        let previous = PreviousRun::read(&history, &next, &on, |_| Ok(on.clone())).unwrap();
        let kept_steps = steps(previous.notes_before(BEGAN + 100 * second));
        assert_eq!(
            kept_steps,
            [("announced".into(), 80), ("bid sent".into(), 75), ("winner chosen".into(), 37)]
        );
        // A clock that was set back.
        assert_eq!(steps(previous.notes_before(0))[0].1, 0);
    }

    #[test]
    fn robots_start_where_they_stood_with_the_same_next_waypoint() {
        let history = History::in_memory().unwrap();
        let now = testbed(&[]);
        let stood = |robot: &str, at_s, x, waypoint| {
            let pose = Pose::planar(x, -2.5, 0.25, [0.0; 9], PoseSource::Simulator);
            let context = RobotContext {
                robot: robot.parse().unwrap(),
                waypoint,
                ..base::robot_context("robot", pose)
            };
            Stamped { at: Timestamp::ZERO + Duration::from_secs(at_s), event: Event::Robot(context) }
        };
        let run = keep(
            &history,
            BEGAN,
            [stood("robot", 1, 5.0, 0), stood("robot", 2, 7.5, 1), stood("gone", 2, 1.0, 0)],
        );
        // Only a ledger that outlives a run needs the testbed file, whose map may be gone.
        let previous = PreviousRun::read(&history, &run, &now, |_| panic!("it is not needed")).unwrap();
        let settings: Vec<_> = previous.starts(&now).iter().map(ToString::to_string).collect();
        let expected =
            ["nodes.robot.position=[7.5, -2.5]", "nodes.robot.heading=0.25 rad", "walks.robot.next=1"];
        assert_eq!(settings, expected);
        let settings: Vec<_> = expected.to_vec();
        let again = testbed(&settings);
        assert_eq!(again.walks[0].next, Some(1));
        let (node, robot) = again.graph.robots().next().unwrap();
        assert_eq!((node.position, robot.heading), (Some(Position::new(7.5, -2.5)), 0.25));

        // The walk has fewer waypoints now.
        let run = keep(&history, BEGAN, [stood("robot", 1, 5.0, 99)]);
        let previous = PreviousRun::read(&history, &run, &now, |_| Ok(now.clone())).unwrap();
        assert!(previous.starts(&now).is_empty());
    }

    #[test]
    fn runs_that_cannot_be_continued_name_the_reason() {
        let (here, modelled) = (on("0xab"), testbed(&[]));
        let refused = |before: &Testbed, now: &Testbed| check(before, now).unwrap_err().to_string();
        assert!(check(&on("0xAB"), &here).is_ok(), "an address is the same in capitals");
        assert!(check(&modelled, &modelled).is_ok(), "a ledger that begins with the run");
        assert!(refused(&modelled, &here).contains("that run had another ledger"));
        assert!(refused(&on("0xac"), &here).contains("another contract"));
        assert!(refused(&on_chain(2, "0xab"), &here).contains("another ledger"));
        let history = History::in_memory().unwrap();
        let run = keep(&history, BEGAN, []);
        let renamed = Testbed { name: "corridor".into(), ..here };
        let other =
            PreviousRun::read(&history, &run, &renamed, |_| panic!("it is not looked at")).unwrap_err();
        assert!(other.to_string().contains("`federation`, and this one is of `corridor`"), "{other}");
    }
}
