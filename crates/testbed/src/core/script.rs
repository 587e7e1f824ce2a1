//! Scripted link conditions: by time, by the place of a robot, or as in a recorded run. Changes are given as instructions
//! like those of plug-ins, so that they are published, rejected and recorded in the same way.

use std::{
    collections::{BTreeMap, VecDeque},
    path::{Path, PathBuf},
};

use cotorra_fabric::{Fabric, FabricError, GraphError};
use cotorra_graph::{
    ConditionChange, Conditions, Direction, Event, HardwareGraph, Instruction, LinkId, NodeId, Position,
    Scale, Scheduled, Stamped, Testbed, Timestamp, When,
};
use cotorra_measurements::{
    History, Kind, Location, PageRequest, RunId,
    export::{ExportError, Format},
};

use crate::history::recorded::{Recorded, RecordedError};

/// Events per query of a history.
const STEP: usize = 10_000;

/// Error of a testbed's script.
#[derive(Debug, thiserror::Error)]
pub enum ScriptError {
    /// The folder is not a run's.
    #[error("{} is neither the folder of a run nor that of an export: it has no history.sqlite, history.json or run.json", .0.display())]
    NotARun(PathBuf),
    /// The folder's note about its history cannot be read.
    #[error(transparent)]
    Recorded(#[from] RecordedError),
    /// The run is in a history that needs a password, which a folder does not have.
    #[error("{} was recorded in {history}: export it (`cotorra history export`), and replay that", folder.display())]
    Elsewhere {
        /// The run's folder.
        folder: PathBuf,
        /// Location of the history.
        history: String,
    },
    /// The history cannot be read.
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    /// The export cannot be read.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The recorded run has no link of this testbed.
    #[error("the run in {} has no link of this testbed; its links: {there}", folder.display())]
    OtherLinks {
        /// The run's folder.
        folder: PathBuf,
        /// Links of the recorded run.
        there: String,
    },
    /// A link rejects a change.
    #[error("{what}: `{link}` rejects the change: {refusal}")]
    Refused {
        /// Part of the script.
        what: String,
        link: LinkId,
        /// Reason of the rejection.
        refusal: FabricError,
    },
    /// The testbed's graph makes no network.
    #[error(transparent)]
    Fabric(#[from] GraphError),
}

/// A change of one link, and the part of the script that it comes from.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Change {
    link: LinkId,
    direction: Option<Direction>,
    change: ConditionChange,
    pub(crate) reason: String,
}

impl Change {
    pub(crate) fn instruction(&self) -> Instruction {
        let Self { link, direction, change, .. } = self.clone();
        Instruction::Condition { link, direction, change }
    }
}

/// The remaining changes of a script.
#[derive(Debug, Default)]
pub(crate) struct Script {
    /// In order of time.
    timed: VecDeque<(Timestamp, Change)>,
    areas: Vec<Area>,
}

#[derive(Debug)]
struct Area {
    robot: NodeId,
    corners: Vec<Position>,
    inside: bool,
    changes: Vec<Change>,
}

/// The size of a script.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rehearsal {
    /// Number of timed changes.
    pub timed: usize,
    /// Number of areas with changes.
    pub areas: usize,
    /// Number of changes from a recorded run.
    pub replayed: usize,
}

impl Script {
    /// Loads the script of a testbed file, with the changes of a recorded run, and checks that links accept it.
    ///
    /// # Errors
    /// [`ScriptError`].
    pub(crate) fn load(testbed: &Testbed) -> Result<(Self, Rehearsal), ScriptError> {
        let mut timed = match &testbed.script.replay {
            Some(folder) => replayed(folder, &testbed.graph)?,
            None => Vec::new(),
        };
        let mut rehearsal = Rehearsal { replayed: timed.len(), ..Rehearsal::default() };
        let mut areas = Vec::new();
        for (place, entry) in testbed.script.schedule.iter().enumerate() {
            let changes = changes(entry, place + 1);
            match &entry.when {
                When::At(at) => {
                    rehearsal.timed += 1;
                    timed.extend(changes.into_iter().map(|change| (Timestamp::ZERO + *at, change)));
                }
                When::Enters { robot, area } => {
                    let (robot, corners) = (robot.clone(), area.clone());
                    areas.push(Area { robot, corners, inside: false, changes });
                }
            }
        }
        rehearsal.areas = areas.len();
        // Stable: changes at the same time keep the file's order.
        timed.sort_by_key(|(at, _)| *at);
        let script = Self { timed: timed.into(), areas };
        script.try_out(&testbed.graph)?;
        Ok((script, rehearsal))
    }

    /// Checks that links accept the script: timed changes in order, and those of areas each by itself.
    fn try_out(&self, graph: &HardwareGraph) -> Result<(), ScriptError> {
        let mut fabric = Fabric::new(graph, 0)?;
        for area in &self.areas {
            let mut fresh = Fabric::new(graph, 0)?;
            area.changes.iter().try_for_each(|change| try_change(&mut fresh, Timestamp::ZERO, change))?;
        }
        self.timed.iter().try_for_each(|(at, change)| try_change(&mut fabric, *at, change))
    }

    /// Returns the time of the next timed change.
    pub(crate) fn next_deadline(&self) -> Option<Timestamp> {
        self.timed.front().map(|(at, _)| *at)
    }

    /// Returns the next due change.
    pub(crate) fn poll(&mut self, now: Timestamp) -> Option<Change> {
        self.timed.pop_front_if(|(at, _)| *at <= now).map(|(_, change)| change)
    }

    /// Returns the changes that robots at these positions trigger.
    pub(crate) fn moved(&mut self, robots: &[(NodeId, Position)]) -> Vec<Change> {
        let mut due = Vec::new();
        for area in &mut self.areas {
            let Some((_, place)) = robots.iter().find(|(robot, _)| *robot == area.robot) else { continue };
            let inside = place.is_within(&area.corners);
            if inside && !area.inside {
                due.extend(area.changes.iter().cloned());
            }
            area.inside = inside;
        }
        due
    }
}

fn try_change(fabric: &mut Fabric, at: Timestamp, change: &Change) -> Result<(), ScriptError> {
    let Change { link, direction, change, reason } = change;
    let done = fabric.change(at, link, *direction, change);
    done.map_err(|refusal| ScriptError::Refused { what: reason.clone(), link: link.clone(), refusal })
}

/// Returns the changes of a schedule's entry.
fn changes(entry: &Scheduled, number: usize) -> Vec<Change> {
    let reason = match &entry.when {
        When::At(at) => format!("entry {number} of the schedule, at {at:?}"),
        When::Enters { robot, .. } => format!("entry {number} of the schedule, where {robot} is"),
    };
    let change = |link: &LinkId| Change {
        link: link.clone(),
        direction: entry.direction,
        change: entry.set.clone(),
        reason: reason.clone(),
    };
    entry.links.iter().map(change).collect()
}

/// Returns the changes of this graph's links in the run of a folder.
fn replayed(folder: &Path, graph: &HardwareGraph) -> Result<Vec<(Timestamp, Change)>, ScriptError> {
    let (history, run) = open(folder)?;
    let mut last: BTreeMap<(LinkId, Direction), (Conditions, Scale)> = BTreeMap::new();
    for link in &graph.links {
        let [forward, backward] = link.scales;
        last.insert((link.id.clone(), Direction::Forward), (link.forward.clone(), forward));
        last.insert((link.id.clone(), Direction::Backward), (link.backward.clone(), backward));
    }
    let wireless: Vec<_> = graph
        .robots()
        .flat_map(|(robot, _)| graph.radio_units().map(|(unit, _)| LinkId::wireless(&robot.id, &unit.id)))
        .collect();
    let (mut changes, mut known, mut there) = (Vec::new(), false, std::collections::BTreeSet::new());
    let mut request = PageRequest::first(STEP);
    loop {
        let page = history.events(run, &[Kind::Link], .., request)?;
        for Stamped { at, event } in page.items {
            let Event::Link(context) = event else { continue };
            let key = (context.link.clone(), context.direction);
            if !last.contains_key(&key) && !wireless.contains(&key.0) {
                there.insert(key.0);
                continue;
            }
            known = true;
            let now = (context.asked.clone(), context.scale);
            if last.get(&key) != Some(&now) {
                let change = Change {
                    link: key.0.clone(),
                    direction: Some(key.1),
                    change: context.again(),
                    reason: "as in the recorded run".to_owned(),
                };
                changes.push((at, change));
                last.insert(key, now);
            }
        }
        let Some(next) = page.next else { break };
        request = PageRequest::after(next, STEP);
    }
    if known {
        return Ok(changes);
    }
    let there: Vec<_> = there.iter().map(LinkId::as_str).take(20).collect();
    let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
    Err(ScriptError::OtherLinks { folder: folder.to_owned(), there })
}

/// Returns the changes of links in the recorded run that a testbed replays, as a text: other changes have another. It is empty
/// if the testbed replays none.
///
/// # Errors
/// [`ScriptError`] if the run cannot be read.
pub fn replayed_conditions(testbed: &Testbed) -> Result<String, ScriptError> {
    let changes =
        testbed.script.replay.as_ref().map(|folder| replayed(folder, &testbed.graph)).transpose()?;
    Ok(changes.map(|changes| format!("{changes:?}")).unwrap_or_default())
}

/// Copies the conditions of links in the run of a folder, as an export to another folder.
pub(crate) fn copy_conditions(of: &Path, to: &Path) -> Result<(), ScriptError> {
    let (history, run) = open(of)?;
    let copy = History::in_memory()?;
    let copied = copy.begin_run(&history.run(run)?.info)?;
    let recorder = copy.paced_recorder(copied)?;
    let mut last: BTreeMap<(LinkId, Direction), (Conditions, Scale)> = BTreeMap::new();
    let mut request = PageRequest::first(STEP);
    loop {
        let page = history.events(run, &[Kind::Link], .., request)?;
        for stamped in page.items {
            let Event::Link(context) = &stamped.event else { continue };
            let now = (context.asked.clone(), context.scale);
            let before = last.insert((context.link.clone(), context.direction), now.clone());
            if before.is_none_or(|before| before != now) {
                recorder.record(stamped);
            }
        }
        recorder.flush()?;
        let Some(next) = page.next else { break };
        request = PageRequest::after(next, STEP);
    }
    copy.export(copied, Format::Csv, to, |_| true)?;
    Ok(())
}

/// Opens the history of a run's folder, or of an export's, and returns the run's number in it.
fn open(folder: &Path) -> Result<(History, RunId), ScriptError> {
    let Recorded { history: name, run } = match Recorded::of_folder(folder) {
        Ok(recorded) => recorded,
        Err(RecordedError::NotARun(_)) => {
            let history = History::in_memory()?;
            let (run, _) = history.import(folder, |_| true).map_err(|error| match error {
                ExportError::NotAnExport(_) => ScriptError::NotARun(folder.to_owned()),
                other => other.into(),
            })?;
            return Ok((history, run));
        }
        Err(error) => return Err(error.into()),
    };
    let Ok(location @ Location::File(_)) = name.parse() else {
        return Err(ScriptError::Elsewhere { folder: folder.to_owned(), history: name });
    };
    let history = History::connect_to_read(&location)?;
    let run = match run {
        Some(run) => run,
        None => match history.runs(None, 1)?.first() {
            Some(first) => first.id,
            None => return Err(ScriptError::NotARun(folder.to_owned())),
        },
    };
    Ok((history, run))
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Decision, Event};

    use super::*;
    use crate::real::rehearse::rehearse;
    use crate::{Options, Place, simulate};

    const LAB: &str = "name: lab\nnodes:\n  a: { kind: server, tier: edge, cpus: 1, memory: 1 GB }\n  b: { kind: switch }\n\
                       links:\n  - { ends: [a, b], delay: 1 ms, rate: 10 Mbit/s }\n";

    fn lab(more: &str) -> Testbed {
        cotorra_testbed_file::parse("lab.yaml", &format!("{LAB}{more}"), Path::new(""))
            .unwrap_or_else(|e| panic!("{e}"))
    }

    /// Simulates a testbed. Returns the folder, and the changes of the link's forward direction in the history: time in s,
    /// ψ, δ, and delay in ms.
    fn run(testbed: &Testbed, until_s: u64, out: &Path) -> (PathBuf, Vec<(f64, f64, f64, f64)>) {
        let until = Some(std::time::Duration::from_secs(until_s));
        let options = Options { until, folder: Place::In(out.to_owned()), ..Options::default() };
        let finished = simulate(testbed.clone(), "", &options, |_| true).unwrap();
        let history = History::open(finished.folder.join("history.sqlite")).unwrap();
        let page = history.events(finished.run, &[Kind::Link], .., PageRequest::first(STEP)).unwrap();
        let mut changes: Vec<(f64, f64, f64, f64)> = Vec::new();
        for Stamped { at, event } in page.items {
            let Event::Link(context) = event else { continue };
            let Scale { delay_scale, drop_scale } = context.scale;
            let ms = context.effective.delay.as_secs_f64() * 1e3;
            let now = (at.as_secs_f64(), delay_scale, drop_scale, ms);
            let is_new = changes.last().is_none_or(|last| (last.1, last.2, last.3) != (now.1, now.2, now.3));
            if context.direction == Direction::Forward && is_new {
                changes.push(now);
            }
        }
        let decided = history.events(finished.run, &[Kind::Decision], .., PageRequest::first(STEP)).unwrap();
        for Stamped { event, .. } in decided.items {
            let Event::Decision(Decision { plugin, refused, .. }) = event else { continue };
            assert_eq!((plugin.as_str(), refused), ("schedule", None));
        }
        (finished.folder, changes)
    }

    #[test]
    fn a_schedule_is_followed_exactly_and_a_replay_repeats_it() {
        let out = tempfile::tempdir().unwrap();
        let scripted =
            lab("schedule:\n  - { at: 4.5 s, links: a-b, set: { delay_scale: 1, drop_scale: 1 } }\n  \
             - { at: 1250 ms, links: [a-b], set: { delay: 8 ms, delay_scale: 2.5, drop_scale: 4 } }\n");
        let rehearsed = Rehearsal { timed: 2, areas: 0, replayed: 0 };
        assert_eq!(rehearse(&scripted).unwrap(), rehearsed);
        let (folder, changes) = run(&scripted, 6, out.path());
        let expected = [(0.0, 1.0, 1.0, 1.0), (1.25, 2.5, 4.0, 20.0), (4.5, 1.0, 1.0, 8.0)];
        assert_eq!(changes, expected);

        let replay = lab(&format!("conditions: {{ replay: {} }}\n", folder.display()));
        // Both directions, twice.
        assert_eq!(rehearse(&replay).unwrap(), Rehearsal { replayed: 4, ..Rehearsal::default() });
        assert_eq!(run(&replay, 6, out.path()).1, expected);
    }

    #[test]
    fn a_robot_that_enters_an_area_changes_links_each_time() {
        let mut script = Script {
            timed: VecDeque::new(),
            areas: vec![Area {
                robot: "r".parse().unwrap(),
                corners: vec![Position::new(0.0, 0.0), Position::new(2.0, 0.0), Position::new(0.0, 2.0)],
                inside: false,
                changes: vec![Change {
                    link: "a-b".parse().unwrap(),
                    direction: None,
                    change: ConditionChange::default(),
                    reason: String::new(),
                }],
            }],
        };
        let mut at = |robot: &str, x, y| script.moved(&[(robot.parse().unwrap(), Position::new(x, y))]).len();
        let places = [
            ("r", 3.0, 3.0),
            ("s", 0.5, 0.5),
            ("r", 0.5, 0.5),
            ("r", 0.6, 0.5),
            ("r", 1.5, 1.5),
            ("r", 0.1, 0.1),
        ];
        assert_eq!(places.map(|(robot, x, y)| at(robot, x, y)), [0, 0, 1, 0, 0, 1]);
    }

    #[test]
    fn invalid_scripts_are_rejected_before_a_run() {
        let refused = |more: &str| rehearse(&lab(more)).unwrap_err().to_string();
        assert_eq!(
            refused("schedule:\n  - { at: 1 s, links: a-b, set: { delay_scale: 10000000 } }\n"),
            "entry 1 of the schedule, at 1s: `a-b` rejects the change: a delay of 10000000 ms cannot be: it is between 0 ms \
             and one hour, before and after scaling"
        );
        let empty = tempfile::tempdir().unwrap();
        let error = refused(&format!("conditions: {{ replay: {} }}\n", empty.path().display()));
        assert!(error.contains("neither the folder of a run nor that of an export"), "{error}");
        let out = tempfile::tempdir().unwrap();
        let other = cotorra_testbed_file::parse(
            "o.yaml",
            &LAB.replace("ends: [a, b]", "id: other, ends: [a, b]"),
            Path::new(""),
        );
        let (folder, _) = run(&other.unwrap(), 2, out.path());
        let error = refused(&format!("conditions: {{ replay: {} }}\n", folder.display()));
        assert!(error.contains("has no link of this testbed; its links: other"), "{error}");
    }
}
