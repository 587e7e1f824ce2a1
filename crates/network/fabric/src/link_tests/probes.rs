//! Two-way probes of links by STAMP (RFC 8762), which measure delay, jitter and loss also on links without other traffic.
//! The first end of a link sends, the second end answers. Both share the fabric's clock, so that each direction is measured
//! by itself. On the air, each robot's present link is probed.

use std::time::Duration;

use cotorra_graph::{Conditions, Direction, Probed, Probing, Timestamp};
use cotorra_probes::{FRAME_BYTES, estimate, on_air, on_wire};
use cotorra_stamp::{Link, SessionConfig, Utc};

use super::packet::{self, HEADERS};
use crate::{
    frame::Frame,
    port::{RadioUnitIndex, StationIndex},
    timers::Timers,
};

/// The probes of all links.
#[derive(Debug)]
pub(super) struct Probes {
    settings: Probing,
    wires: Vec<Link>,
    stations: Vec<Station>,
    /// Timers of the wires, then those of the stations.
    timers: Timers,
}

/// The link that a probe crosses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ProbeTarget {
    /// A wired link, by its index in the graph.
    Wire(usize),
    /// A robot's link to a radio unit.
    Air(StationIndex, RadioUnitIndex),
}

/// A probe that crossed one direction of a link.
#[derive(Debug, Clone, PartialEq)]
pub struct Crossing {
    /// Time that it took.
    pub took: Duration,
    /// Answer to send back; `None` if the probe was an answer.
    pub answer: Option<Frame>,
}

/// The probes of a robot's present link.
#[derive(Debug)]
struct Station {
    with: Option<RadioUnitIndex>,
    config: SessionConfig,
    link: Link,
}

impl Probes {
    /// Creates a component that probes nothing.
    pub(super) fn none() -> Self {
        let (wires, stations) = (Vec::new(), Vec::new());
        Self { settings: Probing::default(), wires, stations, timers: Timers::new(0) }
    }

    /// Probes wired links with these conditions, forward and backward, and the links of robots. `stations` give how long a
    /// frame of a size keeps the channel of each robot busy if every robot sends one. The first probes are spread over an
    /// interval, so that they do not come in bursts.
    pub(super) fn new<'a, T>(
        settings: Probing,
        now: Timestamp,
        wires: impl ExactSizeIterator<Item = [&'a Conditions; 2]>,
        stations: impl ExactSizeIterator<Item = T>,
    ) -> Self
    where
        T: FnOnce(usize) -> Duration,
    {
        let count = wires.len() + stations.len();
        let begins = |i: usize| utc(now) + settings.interval.mul_f64(i as f64 / count as f64);
        let first = wires.len();
        let wires =
            wires.enumerate().map(|(i, conditions)| Link::new(on_wire(&settings, conditions), begins(i)));
        let stations = stations.enumerate().map(|(i, turns)| {
            let config = on_air(&settings, turns(FRAME_BYTES));
            Station { with: None, config, link: Link::new(config, begins(first + i)) }
        });
        let (wires, stations) = (wires.collect(), stations.collect());
        let mut probes = Self { settings, wires, stations, timers: Timers::new(count) };
        (0..count).for_each(|place| probes.arm(place));
        probes
    }

    /// Adapts the probes of a wired link to new conditions.
    pub(super) fn change(&mut self, link: usize, conditions: [&Conditions; 2]) {
        if let Some(link) = self.wires.get_mut(link) {
            link.pace(on_wire(&self.settings, conditions));
        }
    }

    /// Returns when a probe is due, or given up.
    pub(super) fn deadline(&self) -> Option<Timestamp> {
        self.timers.next().map(|(at, _)| at)
    }

    /// Returns the next probe due by `now`, in a buffer from `buffer`, and the link that it crosses. `with` gives the radio
    /// unit of a robot's present link.
    pub(super) fn poll(
        &mut self,
        now: Timestamp,
        with: impl FnOnce(StationIndex) -> Option<RadioUnitIndex>,
        buffer: impl FnOnce(usize) -> Vec<u8>,
    ) -> Option<(ProbeTarget, Frame)> {
        let (_, place) = self.timers.next().filter(|(at, _)| *at <= now)?;
        let (target, probe) = match place.checked_sub(self.wires.len()) {
            None => (Some(ProbeTarget::Wire(place)), self.wires[place].poll(utc(now))),
            Some(robot) => {
                let station = &mut self.stations[robot];
                station.follow(utc(now), with(robot));
                (station.with.map(|unit| ProbeTarget::Air(robot, unit)), station.link.poll(utc(now)))
            }
        };
        self.arm(place);
        let (target, probe) = target.zip(probe)?;
        Some((target, packet::probe(&probe, buffer(HEADERS + probe.len()))))
    }

    /// Records a probe that left a link at `received`, and builds the answer as of `now`. `None` if the probe is damaged
    /// or of no current session.
    pub(super) fn crossed(
        &mut self,
        received: Timestamp,
        now: Timestamp,
        (target, direction): (ProbeTarget, Direction),
        frame: Frame,
    ) -> Option<Crossing> {
        let mut bytes = frame.into_bytes();
        let (place, probed) = match target {
            ProbeTarget::Wire(link) => (link, self.wires.get_mut(link)?),
            ProbeTarget::Air(robot, unit) => {
                let place = self.wires.len() + robot;
                let station = self.stations.get_mut(robot)?;
                // A probe of another radio unit belongs to a session that is over.
                (station.with == Some(unit)).then_some((place, &mut station.link))?
            }
        };
        let stamp = packet::stamp(&bytes)?;
        match direction {
            Direction::Forward => {
                let (answer, took) = probed.reflect(stamp, utc(received), utc(now)).ok()?;
                bytes.clear();
                Some(Crossing { took, answer: Some(packet::probe(&answer, bytes)) })
            }
            Direction::Backward => {
                // Ignores damage that the checksum does not detect.
                let took = probed.receive(stamp, utc(received)).ok().flatten();
                self.arm(place);
                took.map(|took| Crossing { took, answer: None })
            }
        }
    }

    /// Returns the estimates of a link's probes, forward and backward. `None` until the first probe was answered or given
    /// up, and for a link that a robot has left.
    pub(super) fn probed(&self, now: Timestamp, target: ProbeTarget) -> Option<[Probed; 2]> {
        let link = match target {
            ProbeTarget::Wire(link) => self.wires.get(link)?,
            ProbeTarget::Air(robot, unit) => {
                &self.stations.get(robot).filter(|station| station.with == Some(unit))?.link
            }
        };
        Some(link.estimates(utc(now))?.map(estimate))
    }

    fn arm(&mut self, place: usize) {
        let link = match place.checked_sub(self.wires.len()) {
            None => &self.wires[place],
            Some(robot) => &self.stations[robot].link,
        };
        self.timers.set(place, link.deadline().map(timestamp));
    }
}

impl Station {
    /// Probes the link to this radio unit from now on.
    fn follow(&mut self, now: Utc, unit: Option<RadioUnitIndex>) {
        if self.with != unit {
            self.with = unit;
            self.link = Link::new(self.config, now);
        }
    }
}

fn utc(now: Timestamp) -> Utc {
    Utc::UNIX_EPOCH + Duration::from_nanos(now.as_nanos())
}

fn timestamp(at: Utc) -> Timestamp {
    let ns = at.since(Utc::UNIX_EPOCH).as_nanos();
    Timestamp::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{ConditionChange, LinkContext, LinkId, NodeId};

    use super::*;
    use crate::Fabric;

    /// A link with these keys of the testbed file, after some seconds of probes.
    fn after(keys: &str, seconds: u64) -> (Fabric, Timestamp) {
        let text = format!(
            "name: lab\nnodes:\n  a: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}\n  b: {{ kind: switch }}\n\
             links:\n  - {{ ends: [a, b], {keys} }}\n"
        );
        let testbed = cotorra_testbed_file::parse("lab.yaml", &text, ".".as_ref()).unwrap();
        let mut fabric = Fabric::new(&testbed.graph, 1).unwrap();
        fabric.probe_links(Timestamp::ZERO, Probing::default());
        let now = run(&mut fabric, Timestamp::ZERO, seconds);
        (fabric, now)
    }

    /// Runs for some seconds.
    fn run(fabric: &mut Fabric, from: Timestamp, seconds: u64) -> Timestamp {
        let (mut now, end) = (from, from + Duration::from_secs(seconds));
        while let Some(deadline) = fabric.poll(now, &mut |_, _| panic!("probes are for no host")) {
            if deadline > end {
                break;
            }
            now = deadline;
        }
        end
    }

    /// Counts the probes that are sent in some seconds, one at a time.
    fn count(fabric: &mut Fabric, from: Timestamp, seconds: u64) -> u64 {
        let (mut now, mut under_way, mut count) = (from, 0, 0);
        while now < from + Duration::from_secs(seconds) {
            let deadline = fabric.poll(now, &mut |_, _| panic!("probes are for no host")).unwrap();
            let before = std::mem::replace(&mut under_way, fabric.in_flight());
            count += under_way.saturating_sub(before);
            now = deadline;
        }
        count
    }

    /// Returns the estimates of both directions in the contexts.
    fn probed(fabric: &mut Fabric, now: Timestamp) -> Option<[Probed; 2]> {
        let [forward, backward] = &fabric.link_contexts(now)[..] else { panic!("one link") };
        forward.probed.zip(backward.probed).map(|(forward, backward)| [forward, backward])
    }

    fn mean(probed: &Probed) -> Duration {
        probed.delay.unwrap()
    }

    #[test]
    fn each_direction_is_measured_by_itself_and_follows_changes() {
        let (mut fabric, now) = after("delay: 3 ms, rate: 10 Gbit/s", 20);
        let [there, back] = probed(&mut fabric, now).unwrap();
        // 86 bytes take 68.8 ns at that rate.
        assert_eq!(
            (mean(&there), mean(&back)),
            (Duration::from_nanos(3_000_068), Duration::from_nanos(3_000_068))
        );
        assert_eq!((there.loss, back.loss), (Some(0.0), Some(0.0)));
        assert!(there.delay_age.unwrap() <= Probing::default().interval);
        let link: LinkId = "a-b".parse().unwrap();
        let slower = ConditionChange { delay_ms: Some(30.0), ..ConditionChange::default() };
        fabric.change(now, &link, Some(Direction::Backward), &slower).unwrap();
        let now = run(&mut fabric, now, 20);
        let [there, back] = probed(&mut fabric, now).unwrap();
        assert_eq!(
            (mean(&there), mean(&back)),
            (Duration::from_nanos(3_000_068), Duration::from_nanos(30_000_068))
        );
    }

    #[test]
    fn links_without_delay_are_probed() {
        let (mut fabric, now) = after("delay: 0 ms, rate: unlimited", 5);
        assert_eq!(probed(&mut fabric, now).unwrap().map(|probed| mean(&probed)), [Duration::ZERO; 2]);
    }

    #[test]
    fn probes_measure_jitter_and_loss() {
        let settings = Probing { interval: Duration::from_millis(10), window: Duration::from_secs(200) };
        let (mut fabric, now) = after("delay: 10 ms, jitter: 1 ms, loss: 5 %", 1);
        fabric.probe_links(now, settings);
        let now = run(&mut fabric, now, 200);
        for probed in probed(&mut fabric, now).unwrap() {
            // 20,000 probes: four standard deviations are 0.6 points.
            assert!((probed.loss.unwrap() - 0.05).abs() < 0.006, "{probed:?}");
            // The mean difference of two normal values is 2/√π of their deviation. Keeping order lowers it.
            let jitter = probed.jitter.unwrap().as_secs_f64() * 1e3;
            assert!((0.9..1.2).contains(&jitter), "{probed:?}");
        }
    }

    #[test]
    fn probes_take_at_most_a_hundredth_of_a_slow_link() {
        let (mut fabric, now) = after("delay: 1 ms, rate: 20 kbit/s", 10);
        // Each is answered.
        let bits = count(&mut fabric, now, 1_000) * 86 * 8;
        assert!((190_000..=200_800).contains(&bits), "{bits}");
        let now = now + Duration::from_secs(1_000);
        assert!(fabric.link_contexts(now).iter().all(|link| link.counters == Default::default()));
        assert!(
            mean(&probed(&mut fabric, now).unwrap()[0]) > Duration::from_millis(35),
            "86 bytes at 20 kbit/s"
        );
    }

    #[test]
    fn damaged_probes_count_as_lost() {
        let (mut fabric, now) = after("delay: 1 ms, corruption: 100 %", 40);
        let [there, back] = probed(&mut fabric, now).unwrap();
        assert_eq!((there.delay, there.loss, back.delay), (None, Some(1.0), None));
    }

    #[test]
    fn there_are_no_estimates_before_the_first_answer() {
        let (mut fabric, now) = after("delay: 1 ms", 0);
        assert_eq!(probed(&mut fabric, now), None);
        let now = run(&mut fabric, now, 1);
        assert!(probed(&mut fabric, now).is_some());
    }

    /// Robots at two radio units on one channel, probed from the beginning.
    fn robots(count: usize) -> Fabric {
        let robots: String = (0..count)
            .map(|i| format!("  r{i}: {{ kind: robot, cpus: 1, memory: 1 GB, position: [1, 0] }}\n"))
            .collect();
        let text = format!(
            "name: lab\nwireless:\n  lab: {{ standard: n, delay: 1 ms, rate: 8 Mbit/s, shadowing: {{ deviation: 0 dB }} }}\n\
             nodes:\n  A: {{ kind: radio_unit, position: [0, 0], channel: 1 }}\n  \
             B: {{ kind: radio_unit, position: [9, 0], channel: 1 }}\n{robots}\
             links:\n  - {{ ends: [A, B] }}\n"
        );
        let testbed = cotorra_testbed_file::parse("lab.yaml", &text, ".".as_ref()).unwrap();
        let mut fabric = Fabric::new(&testbed.graph, 1).unwrap();
        fabric.probe_links(Timestamp::ZERO, Probing::default());
        fabric
    }

    /// Returns name and mean delay of both directions of each wireless link in use, ms.
    fn on_air(fabric: &mut Fabric, now: Timestamp) -> Vec<(String, Option<u128>)> {
        let wireless = fabric.link_contexts(now).into_iter().filter(|context| context.link.as_str() != "A-B");
        let told = |link: LinkContext| {
            (
                link.link.to_string(),
                link.probed.and_then(|probed| probed.delay).map(|delay| delay.as_millis()),
            )
        };
        wireless.map(told).collect()
    }

    #[test]
    fn only_the_present_link_of_a_robot_is_probed() {
        let mut fabric = robots(1);
        let now = run(&mut fabric, Timestamp::ZERO, 5);
        // The delay covers the airtime of such short frames. Waits for other frames are microseconds.
        let millisecond = Some(1);
        let told = |link: &str, delay| vec![(link.to_owned(), delay); 2];
        assert_eq!(on_air(&mut fabric, now), told("r0~A", millisecond));
        let [robot, unit] = ["r0", "B"].map(|name| NodeId::new(name).unwrap());
        fabric.attach(now, &robot, &unit).unwrap();
        let now = run(&mut fabric, now, 5);
        assert_eq!(on_air(&mut fabric, now), [told("r0~A", None), told("r0~B", millisecond)].concat());
        assert!(fabric.link_contexts(now).iter().all(|link| link.counters == Default::default()));
    }

    #[test]
    fn probes_of_robots_take_at_most_a_hundredth_of_a_channel() {
        let mut fabric = robots(40);
        let mut now = Timestamp::ZERO;
        let mut loads = Vec::new();
        for _ in 0..100 {
            now = run(&mut fabric, now, 1);
            loads.push(fabric.radio_contexts(now)[0].load.unwrap());
        }
        // Both radio units' beacons take 2.192 ms each 102.4 ms.
        let load = loads.iter().sum::<f64>() / loads.len() as f64 - 2.0 * 2.192 / 102.4;
        assert!((0.001..=0.01).contains(&load), "{load}");
        assert!(on_air(&mut fabric, now).iter().all(|(_, delay)| delay.is_some()));
    }
}
