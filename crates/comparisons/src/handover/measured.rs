//! Handovers and scans of one walk, from its events.

use cotorra_graph::{
    Event, Instruction, Node, NodeId, Position, Stamped, Testbed, Timestamp, WifiContext, WifiStation, millis,
};
use cotorra_measurements::{History, Kind as EventKind, RunId};
use cotorra_testbed::DataTable;
use serde::{Deserialize, Serialize};

use super::{Kind, Walk};

/// After a handover or a scan, packets that still wait for it arrive within this time.
const AFTER_S: f64 = 0.2;
/// Longest scan of an instruction. Longer ones have another cause.
const LONGEST_SCAN_S: f64 = 30.0;

/// A handover of a robot that had a radio unit before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Roam {
    /// When it was done, seconds since the run began.
    pub at_s: f64,
    pub from: NodeId,
    pub to: NodeId,
    /// Whether it was a fast transition (802.11r).
    pub fast: bool,
    /// The gap by events: from the first step to the association.
    pub gap_ms: f64,
    /// The gap by packets: the longest time between two answers around it; `None` without answers.
    pub packet_gap_ms: Option<f64>,
    /// Position of the robot, x and y in metres; `None` if it was not known yet.
    pub position: Option<[f64; 2]>,
    /// Distance that the robot had walked, metres along its way; `None` if it is not known.
    pub walked_m: Option<f64>,
}

/// A scan that a plug-in asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// When it was done, seconds since the run began.
    pub at_s: f64,
    /// Time from the instruction to the result.
    pub took_ms: f64,
    /// The longest time between two answers during the scan; `None` without answers.
    pub packet_gap_ms: Option<f64>,
}

/// The measurements of one walk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Walked {
    /// Name of the kind of radio.
    pub kind: String,
    pub walk: Walk,
    pub seed: u64,
    /// Whether the run's figures are valid.
    pub is_valid: bool,
    pub roams: Vec<Roam>,
    pub scans: Vec<Scan>,
    /// Number of times that the robot lost its radio unit.
    pub losses: usize,
    /// Handovers that a plug-in asked for, and further tries of them.
    pub asked: usize,
    pub retries: usize,
    /// Position packets, and those without an answer.
    pub packets: usize,
    pub unanswered: usize,
    /// Frames that the robot's radio sent again, as its kernel counts them. Those after the last reading before a handover are
    /// missing. `None` if its kernel is not read.
    #[serde(default)]
    pub frames_again: Option<u64>,
}

impl Walked {
    /// Reads a walk from the history of its run.
    ///
    /// # Errors
    /// [`cotorra_measurements::Error`].
    pub fn read(
        history: &History,
        run: RunId,
        testbed: &Testbed,
        (kind, walk): (Kind, Walk),
        (seed, is_valid): (u64, bool),
    ) -> Result<Self, cotorra_measurements::Error> {
        let kinds = [
            EventKind::Robot,
            EventKind::Handover,
            EventKind::Detached,
            EventKind::Scanned,
            EventKind::Decision,
            EventKind::ServiceTime,
            EventKind::Machine,
        ];
        let events = history.all_events(run, &kinds)?;
        let walked = Self { kind: kind.name.to_owned(), walk, seed, is_valid, ..Self::empty() };
        Ok(walked.with(testbed, &events))
    }

    /// Returns a walk without any event.
    pub(super) fn empty() -> Self {
        Self {
            kind: String::new(),
            walk: Walk::Sent,
            seed: 0,
            is_valid: true,
            roams: Vec::new(),
            scans: Vec::new(),
            losses: 0,
            asked: 0,
            retries: 0,
            packets: 0,
            unanswered: 0,
            frames_again: None,
        }
    }

    /// Adds what the events show of the first robot that walks.
    pub(super) fn with(mut self, testbed: &Testbed, events: &[Stamped]) -> Self {
        let Some(walk) = testbed.walks.first() else { return self };
        let own = |robot: &NodeId| *robot == walk.robot;
        let service = testbed.services.iter().find(|service| service.navigates()).map(|service| &service.id);
        let mut answers = Vec::new();
        for Stamped { event, .. } in events {
            if let Event::ServiceTime(sample) = event
                && Some(&sample.service) == service
            {
                self.packets += 1;
                match sample.took {
                    Some(took) => answers.push((sample.emitted + took).as_secs_f64()),
                    None => self.unanswered += 1,
                }
            }
        }
        answers.sort_by(f64::total_cmp);
        let answers = Answers(answers);
        let moves = Kind::named(&self.kind).is_none_or(|kind| kind.is_emulated);
        let radio = testbed.graph.node(&walk.robot).and_then(Node::radio);
        let mut counter = Counter::default();
        let (mut place, mut walked_m) = (None::<Position>, moves.then_some(0.0));
        let (mut asked_scan, mut last_attach) = (None::<Timestamp>, None::<NodeId>);
        for Stamped { at, event } in events {
            let at_s = at.as_secs_f64();
            match event {
                Event::Robot(context) if moves && own(&context.robot) => {
                    let now = context.sensors.pose.position();
                    let further = place.map_or(0.0, |before| before.distance(now));
                    walked_m = walked_m.map(|walked_m| walked_m + further);
                    place = Some(now);
                }
                Event::Machine(context) if own(&context.node) => {
                    let its =
                        |wifi: &&WifiContext| radio.is_some_and(|radio| radio.interface == wifi.interface);
                    // A client's only station is its access point.
                    let station = context.wifi.iter().find(its).and_then(|wifi| wifi.stations.first());
                    let further = station.and_then(|station| counter.advance(station));
                    if let Some(further) = further {
                        *self.frames_again.get_or_insert(0) += u64::from(further);
                    }
                }
                Event::Decision(decision) if decision.refused.is_none() => match &decision.instruction {
                    Instruction::Scan { robot } if own(robot) => asked_scan = Some(*at),
                    Instruction::Attach { robot, radio_unit } if own(robot) => {
                        self.asked += 1;
                        // The robot has not come there since.
                        self.retries += usize::from(last_attach.as_ref() == Some(radio_unit));
                        last_attach = Some(radio_unit.clone());
                    }
                    _ => {}
                },
                Event::Scanned { robot } if own(robot) => {
                    let began =
                        asked_scan.take().filter(|began| at.since(*began).as_secs_f64() < LONGEST_SCAN_S);
                    self.scans.extend(began.map(|began| Scan {
                        at_s,
                        took_ms: millis::of(at.since(began)),
                        packet_gap_ms: answers.longest_between(began.as_secs_f64(), at_s),
                    }));
                }
                Event::Detached { robot, .. } if own(robot) => self.losses += 1,
                Event::Handover(handover) if own(&handover.robot) => {
                    last_attach = None;
                    let gap_s = handover.gap.as_secs_f64();
                    self.roams.extend(handover.from.clone().map(|from| Roam {
                        at_s,
                        from,
                        to: handover.to.clone(),
                        fast: handover.fast,
                        gap_ms: gap_s * 1e3,
                        packet_gap_ms: answers.longest_between(at_s - gap_s, at_s),
                        position: place.map(|place| [place.x, place.y]),
                        walked_m,
                    }));
                }
                _ => {}
            }
        }
        self
    }
}

/// A counter of frames that a station sent again, which begins anew at each access point.
#[derive(Default)]
struct Counter {
    last: Option<(String, u32)>,
}

impl Counter {
    /// Returns the number of frames since the last reading; `None` if the driver does not count them.
    fn advance(&mut self, access_point: &WifiStation) -> Option<u32> {
        let now = access_point.retransmissions?;
        Some(match self.last.replace((access_point.mac.clone(), now)) {
            // It may have counted since long before the run.
            None => 0,
            Some((mac, before)) if mac == access_point.mac && before <= now => now - before,
            Some(_) => now,
        })
    }
}

/// Times at which answers came, in order.
struct Answers(Vec<f64>);

impl Answers {
    /// Returns the longest time without an answer that overlaps with a span, or with the time just after it, ms.
    fn longest_between(&self, from_s: f64, to_s: f64) -> Option<f64> {
        let Self(times) = self;
        let (from, to) =
            (times.partition_point(|t| *t < from_s), times.partition_point(|t| *t <= to_s + AFTER_S));
        let around = times.get(from.saturating_sub(1)..(to + 1).min(times.len()))?;
        let gaps = around.windows(2).map(|pair| (pair[1] - pair[0]) * 1e3);
        gaps.max_by(f64::total_cmp)
    }
}

/// Returns all handovers, with all digits.
pub(super) fn roams(walks: &[Walked]) -> DataTable {
    let mut table = DataTable::new([
        "kind",
        "walk",
        "seed",
        "at_s",
        "from",
        "to",
        "fast",
        "gap_ms",
        "packet_gap_ms",
        "x",
        "y",
        "walked_m",
    ]);
    for (walked, roam) in walks.iter().flat_map(|walked| walked.roams.iter().map(move |roam| (walked, roam)))
    {
        let [x, y] = roam.position.map_or_else(Default::default, |place| place.map(|at| at.to_string()));
        table.row([
            walked.kind.clone(),
            walked.walk.name().to_owned(),
            walked.seed.to_string(),
            roam.at_s.to_string(),
            roam.from.to_string(),
            roam.to.to_string(),
            roam.fast.to_string(),
            roam.gap_ms.to_string(),
            roam.packet_gap_ms.map_or_else(String::new, |ms| ms.to_string()),
            x,
            y,
            roam.walked_m.map_or_else(String::new, |walked_m| walked_m.to_string()),
        ]);
    }
    table
}

/// Returns all scans, with all digits.
pub(super) fn scans(walks: &[Walked]) -> DataTable {
    let mut table = DataTable::new(["kind", "walk", "seed", "at_s", "took_ms", "packet_gap_ms"]);
    for (walked, scan) in walks.iter().flat_map(|walked| walked.scans.iter().map(move |scan| (walked, scan)))
    {
        table.row([
            walked.kind.clone(),
            walked.walk.name().to_owned(),
            walked.seed.to_string(),
            scan.at_s.to_string(),
            scan.took_ms.to_string(),
            scan.packet_gap_ms.map_or_else(String::new, |ms| ms.to_string()),
        ]);
    }
    table
}
