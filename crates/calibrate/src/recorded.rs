//! Measurements in the history of a run: a survey by its robots, and the times of its handovers.

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{Event, Handover, NodeId, PoseSource, Position, RobotContext, Stamped, Timestamp};

use crate::survey::{MAX_READINGS, Reading};

/// Least distance between readings of a robot and a radio unit, metres, at first.
const STEP_M: f64 = 0.2;
/// Most handovers of a run.
const MAX_HANDOVERS: usize = 100_000;

/// Times of a handover.
#[derive(Debug, Clone, PartialEq)]
pub struct HandoverTime {
    /// Name of the radio unit after it.
    pub radio_unit: String,
    /// Whether it was a fast transition.
    pub fast: bool,
    /// Time of the scan that preceded it off the channel, ms; `None` without one.
    pub scan_ms: Option<f64>,
    /// Time from there to the end, ms: authentication, reassociation, and the key handshakes unless it was fast.
    pub join_ms: f64,
}

/// Collects the measurements of a run, event by event.
#[derive(Debug)]
pub struct Recorded {
    readings: Vec<Reading>,
    handovers: Vec<HandoverTime>,
    /// Last reading of each robot and radio unit: place, and signal in dBm.
    last: BTreeMap<(NodeId, NodeId), (Position, f64)>,
    /// Last scan of each robot.
    scans: BTreeMap<NodeId, Timestamp>,
    step_m: f64,
}

impl Default for Recorded {
    fn default() -> Self {
        let (last, scans) = (BTreeMap::new(), BTreeMap::new());
        Self { readings: Vec::new(), handovers: Vec::new(), last, scans, step_m: STEP_M }
    }
}

impl Recorded {
    /// Takes an event. Events come in the order of time.
    pub fn take(&mut self, Stamped { at, event }: &Stamped) {
        match event {
            Event::Robot(context) => self.hear(*at, context),
            Event::Scanned { robot } => _ = self.scans.insert(robot.clone(), *at),
            Event::Handover(handover) => self.hand_over(*at, handover),
            _ => {}
        }
    }

    /// Returns the survey: a reading whenever a robot has new signals, at least 0.2 m apart, or more if there are too many.
    /// Poses by odometry drift, and are left out.
    pub fn survey(&self) -> &[Reading] {
        &self.readings
    }

    /// Returns the handovers from one radio unit to another.
    pub fn handovers(&self) -> &[HandoverTime] {
        &self.handovers
    }

    fn hear(&mut self, at: Timestamp, context: &RobotContext) {
        let pose = &context.sensors.pose;
        if !pose.is_finite() || pose.source == PoseSource::Odometry {
            return;
        }
        let place = pose.position();
        for attachment in &context.attachments {
            // A signal of the last scan was heard elsewhere.
            let heard = attachment.signal.filter(|signal| signal.0.is_finite() && attachment.is_news());
            let Some(signal) = heard else { continue };
            let key = (context.robot.clone(), attachment.radio_unit.clone());
            // In older runs, signals have no age: one that is the same was heard elsewhere, too.
            let is_new =
                |(before, same): &(Position, f64)| before.distance(place) >= self.step_m && *same != signal.0;
            if !self.last.get(&key).is_none_or(is_new) {
                continue;
            }
            self.last.insert(key, (place, signal.0));
            self.readings.push(Reading {
                time_s: at.as_secs_f64(),
                place,
                radio_unit: attachment.radio_unit.to_string(),
                signal,
            });
        }
        if self.readings.len() > MAX_READINGS {
            self.thin();
        }
    }

    /// Keeps every second reading of each radio unit, and takes fewer from now on.
    fn thin(&mut self) {
        let mut heard: BTreeMap<String, usize> = BTreeMap::new();
        self.readings.retain(|reading| {
            let number = heard.entry(reading.radio_unit.clone()).or_default();
            *number += 1;
            *number % 2 == 1
        });
        self.step_m *= 2.0;
    }

    fn hand_over(&mut self, at: Timestamp, Handover { robot, from, to, fast, gap }: &Handover) {
        if from.is_none() || self.handovers.len() == MAX_HANDOVERS {
            return;
        }
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
        let since_scan = self.scans.get(robot).map(|scanned| at.since(*scanned)).filter(|since| since < gap);
        self.handovers.push(HandoverTime {
            radio_unit: to.to_string(),
            fast: *fast,
            scan_ms: since_scan.map(|since| ms(*gap - since)),
            join_ms: ms(since_scan.unwrap_or(*gap)),
        });
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Attachment, Dbm, Pose};
    use cotorra_graph_testing as base;

    use super::*;

    fn name(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    fn robot(ms: u64, x: f64, signal: f64, source: PoseSource) -> Stamped {
        let pose = Pose::planar(x, 0.0, 0.0, [0.0; 9], source);
        let signal = Some(Dbm(signal));
        let attachments = vec![Attachment { radio_unit: name("A"), attached: true, signal, age: None }];
        let context = RobotContext { attachments, ..base::robot_context("robot", pose) };
        Stamped { at: at(ms), event: Event::Robot(context) }
    }

    fn recorded(events: &[Stamped]) -> Recorded {
        let mut recorded = Recorded::default();
        events.iter().for_each(|event| recorded.take(event));
        recorded
    }

    #[test]
    fn new_signals_at_new_places_are_readings() {
        use PoseSource::{Odometry, Simulator};
        let events = [
            robot(0, 0.0, -40.0, Simulator),
            robot(100, 0.1, -41.0, Simulator),
            robot(200, 0.3, -40.0, Simulator),
            robot(300, 0.4, -42.0, Simulator),
            robot(400, 0.9, -43.0, Odometry),
            robot(500, 1.0, -44.0, Simulator),
        ];
        let heard: Vec<_> = recorded(&events).survey().iter().map(|r| (r.place.x, r.signal.0)).collect();
        assert_eq!(heard, [(0.0, -40.0), (0.4, -42.0), (1.0, -44.0)]);
    }

    #[test]
    fn a_long_walk_is_thinned() {
        let walk: Vec<_> =
            (0..50_000).map(|i| robot(i, i as f64, -40.0 - (i % 7) as f64, PoseSource::Simulator)).collect();
        let number = recorded(&walk).survey().len();
        assert!((MAX_READINGS / 2..=MAX_READINGS).contains(&number), "{number}");
    }

    fn handover(ms: u64, gap: u64, from: Option<&str>) -> Stamped {
        let event = Event::Handover(Handover {
            robot: name("robot"),
            from: from.map(name),
            to: name("B"),
            fast: true,
            gap: Duration::from_millis(gap),
        });
        Stamped { at: at(ms), event }
    }

    #[test]
    fn a_scan_within_the_gap_is_a_part_of_it() {
        let scanned = |ms| Stamped { at: at(ms), event: Event::Scanned { robot: name("robot") } };
        let events = [
            scanned(1000),
            handover(1035, 130, Some("A")),
            scanned(2000),
            handover(3000, 40, Some("A")),
            handover(4000, 90, None),
        ];
        let times: Vec<_> = recorded(&events).handovers().iter().map(|h| (h.scan_ms, h.join_ms)).collect();
        assert_eq!(times, [(Some(95.0), 35.0), (None, 40.0)]);
    }
}
