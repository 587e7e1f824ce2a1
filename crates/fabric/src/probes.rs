//! Two-way probes of wired links by STAMP (RFC 8762): what a link does to packets, measured by packets that cross it,
//! whether or not any others do. A link's first end asks, its second end answers; both have the fabric's clock, so that
//! each direction is told by itself.

use std::time::Duration;

use cotorra_graph::{Conditions, Direction, Probed, Probing, Timestamp};
use cotorra_stamp::{BASE_LENGTH, Link, PORT, SessionConfig, Told, Utc};

use crate::{
    checksum::{complement, fold, sum},
    fabric::rate_bps,
    frame::{ETHERNET_HEADER, Frame},
    timers::Timers,
};

/// Of a link's rate, the most that its probes take.
const SHARE: f64 = 0.01;

/// Of no station to no station, IPv4.
const ETHERNET: [u8; ETHERNET_HEADER] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x08, 0x00];
const IP_HEADER: usize = 20;
const UDP_HEADER: usize = 8;
const HEADERS: usize = ETHERNET_HEADER + IP_HEADER + UDP_HEADER;
const UDP_CHECKSUM: usize = HEADERS - 2;

/// The probes of all links.
#[derive(Debug)]
pub(crate) struct Probes {
    settings: Probing,
    links: Vec<Link>,
    timers: Timers,
}

impl Probes {
    /// No probes at all.
    pub(crate) fn none() -> Self {
        Self { settings: Probing::default(), links: Vec::new(), timers: Timers::new(0) }
    }

    /// Probes of links with these conditions, forward and backward. They begin one after the other, so that they do
    /// not come in bursts.
    pub(crate) fn new<'a>(
        settings: Probing,
        now: Timestamp,
        links: impl ExactSizeIterator<Item = [&'a Conditions; 2]>,
    ) -> Self {
        let count = links.len();
        let mut probes = Self { settings, links: Vec::with_capacity(count), timers: Timers::new(count) };
        for (i, conditions) in links.enumerate() {
            let begins = utc(now) + settings.interval.mul_f64(i as f64 / count as f64);
            probes.links.push(Link::new(config(&settings, conditions, HEADERS), begins));
            probes.arm(i);
        }
        probes
    }

    /// A link has other conditions.
    pub(crate) fn change(&mut self, link: usize, conditions: [&Conditions; 2]) {
        if let Some(link) = self.links.get_mut(link) {
            link.pace(config(&self.settings, conditions, HEADERS));
        }
    }

    /// When there is something to do.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        self.timers.next().map(|(at, _)| at)
    }

    /// The next probe that is due by then, in a buffer, and the link that it goes over.
    pub(crate) fn poll(
        &mut self,
        now: Timestamp,
        buffer: impl FnOnce(usize) -> Vec<u8>,
    ) -> Option<(usize, Frame)> {
        let (_, link) = self.timers.next().filter(|(at, _)| *at <= now)?;
        let probe = self.links[link].poll(utc(now));
        self.arm(link);
        probe.map(|probe| (link, frame(&probe, buffer(HEADERS + probe.len()))))
    }

    /// A probe has crossed a link and gets its answer; `None` if its answer has crossed back, or if it is damaged.
    pub(crate) fn crossed(
        &mut self,
        now: Timestamp,
        link: usize,
        direction: Direction,
        frame: Frame,
    ) -> Option<Frame> {
        let mut bytes = frame.into_bytes();
        let probed = &mut self.links[link];
        let packet = payload(&bytes)?;
        match direction {
            Direction::Forward => {
                let answer = probed.reflect(packet, utc(now)).ok()?;
                bytes.clear();
                Some(self::frame(&answer, bytes))
            }
            Direction::Backward => {
                // What is damaged in a way that the checksum does not see is nobody's answer.
                let _ = probed.receive(packet, utc(now));
                self.arm(link);
                None
            }
        }
    }

    /// What the probes of a link tell, forward and backward; `None` before it is known of the first what became of it.
    pub(crate) fn probed(&self, now: Timestamp, link: usize) -> Option<[Probed; 2]> {
        Some(self.links.get(link)?.told(utc(now))?.map(probed))
    }

    fn arm(&mut self, link: usize) {
        self.timers.set(link, self.links[link].deadline().map(timestamp));
    }
}

/// How a link with these conditions is probed, with so many octets around each packet.
fn config(settings: &Probing, conditions: [&Conditions; 2], overhead: usize) -> SessionConfig {
    let slowest = conditions.iter().map(|c| rate_bps(&c.rate)).fold(f64::INFINITY, f64::min);
    let config = SessionConfig { interval: settings.interval, ..SessionConfig::default() };
    let config = config.within(SHARE, slowest, overhead);
    // What is sent seldom is kept for longer.
    let window = settings.window.max(config.interval.saturating_mul(4));
    SessionConfig { window, patience: window / 2, ..config }
}

/// What probes tell, in the terms of the graph.
fn probed(told: Told) -> Probed {
    Probed {
        delay: told.delays.map(|(delays, _)| delays.mean),
        jitter: told.delays.and_then(|(delays, _)| delays.jitter),
        delay_age: told.delays.map(|(_, age)| age),
        loss: told.loss,
        loss_age: told.loss_age,
    }
}

fn utc(now: Timestamp) -> Utc {
    Utc::UNIX_EPOCH + Duration::from_nanos(now.as_nanos())
}

fn timestamp(at: Utc) -> Timestamp {
    let ns = at.since(Utc::UNIX_EPOCH).as_nanos();
    Timestamp::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
}

/// A UDP packet over IPv4 on a link of two stations. Nobody routes by its addresses, which are of no host.
fn frame(packet: &[u8], mut bytes: Vec<u8>) -> Frame {
    let udp_length = (UDP_HEADER + packet.len()) as u16;
    bytes.extend(ETHERNET);
    let total = IP_HEADER as u16 + udp_length;
    let [high, low] = total.to_be_bytes();
    // IPv4 without options, TTL 255 as RFC 8762 has it, UDP.
    bytes.extend([0x45, 0, high, low, 0, 0, 0, 0, 255, 17, 0, 0]);
    bytes.extend([0; 8]);
    let checksum = complement(sum(&bytes[ETHERNET_HEADER..]));
    bytes[ETHERNET_HEADER + 10..ETHERNET_HEADER + 12].copy_from_slice(&checksum.to_be_bytes());
    for field in [PORT, PORT, udp_length, 0] {
        bytes.extend(field.to_be_bytes());
    }
    bytes.extend(packet);
    let checksum = complement(udp_sum(&bytes));
    bytes[UDP_CHECKSUM..HEADERS].copy_from_slice(&checksum.to_be_bytes());
    Frame::new(bytes)
}

/// What such a packet carries; `None` if it is damaged.
fn payload(bytes: &[u8]) -> Option<&[u8]> {
    let is_whole = bytes.len() >= HEADERS + BASE_LENGTH
        && bytes.starts_with(&ETHERNET)
        && fold(sum(&bytes[ETHERNET_HEADER..HEADERS - UDP_HEADER])) == 0xffff
        && fold(udp_sum(bytes)) == 0xffff;
    is_whole.then(|| &bytes[HEADERS..])
}

/// The sum that UDP's checksum is made of (RFC 768): addresses are zero.
fn udp_sum(bytes: &[u8]) -> u64 {
    const UDP: u64 = 17;
    let udp = &bytes[ETHERNET_HEADER + IP_HEADER..];
    sum(udp) + UDP + udp.len() as u64
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{ConditionChange, LinkId, testbed_file};

    use super::*;
    use crate::Fabric;

    /// A link with these keys, probed for so long.
    fn after(keys: &str, seconds: u64) -> (Fabric, Timestamp) {
        let text = format!(
            "name: lab\nnodes:\n  a: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB }}\n  b: {{ kind: switch }}\n\
             links:\n  - {{ ends: [a, b], {keys} }}\n"
        );
        let testbed = testbed_file::parse("lab.yaml", &text, ".".as_ref()).unwrap();
        let mut fabric = Fabric::new(&testbed.graph, 1).unwrap();
        fabric.probe_links(Timestamp::ZERO, Probing::default());
        let now = run(&mut fabric, Timestamp::ZERO, seconds);
        (fabric, now)
    }

    /// Goes on for so long.
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

    /// What the context says of both directions.
    fn probed(fabric: &mut Fabric, now: Timestamp) -> Option<[Probed; 2]> {
        let [forward, backward] = &fabric.link_contexts(now)[..] else { panic!("one link") };
        forward.probed.zip(backward.probed).map(|(forward, backward)| [forward, backward])
    }

    fn mean(probed: &Probed) -> Duration {
        probed.delay.unwrap()
    }

    #[test]
    fn each_direction_is_told_by_itself_and_follows_what_changes() {
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
    fn a_link_that_takes_no_time_is_probed_too() {
        let (mut fabric, now) = after("delay: 0 ms, rate: unlimited", 5);
        assert_eq!(probed(&mut fabric, now).unwrap().map(|probed| mean(&probed)), [Duration::ZERO; 2]);
    }

    #[test]
    fn jitter_and_loss_are_those_of_the_link() {
        let settings = Probing { interval: Duration::from_millis(10), window: Duration::from_secs(200) };
        let (mut fabric, now) = after("delay: 10 ms, jitter: 1 ms, loss: 5 %", 1);
        fabric.probe_links(now, settings);
        let now = run(&mut fabric, now, 200);
        for probed in probed(&mut fabric, now).unwrap() {
            // 20,000 probes: four standard deviations are 0.6 points.
            assert!((probed.loss.unwrap() - 0.05).abs() < 0.006, "{probed:?}");
            // The mean difference of two normal values is 2/√π of their deviation; order is kept, which takes some.
            let jitter = probed.jitter.unwrap().as_secs_f64() * 1e3;
            assert!((0.9..1.2).contains(&jitter), "{probed:?}");
        }
    }

    #[test]
    fn a_slow_link_gives_no_more_than_a_hundredth_to_probes() {
        let (mut fabric, now) = after("delay: 1 ms, rate: 20 kbit/s", 1_000);
        let link: LinkId = "a-b".parse().unwrap();
        for direction in [Direction::Forward, Direction::Backward] {
            let bits = fabric.link_lateness(&link, direction).unwrap().frames * 86 * 8;
            assert!((190_000..=200_800).contains(&bits), "{bits}");
        }
        assert!(fabric.link_contexts(now).iter().all(|link| link.counters == Default::default()));
        assert!(
            mean(&probed(&mut fabric, now).unwrap()[0]) > Duration::from_millis(35),
            "86 bytes at 20 kbit/s"
        );
    }

    #[test]
    fn a_damaged_probe_is_lost_and_nothing_more() {
        let (mut fabric, now) = after("delay: 1 ms, corruption: 100 %", 40);
        let [there, back] = probed(&mut fabric, now).unwrap();
        assert_eq!((there.delay, there.loss, back.delay), (None, Some(1.0), None));
    }

    #[test]
    fn nothing_is_told_before_anything_is_known() {
        let (mut fabric, now) = after("delay: 1 ms", 0);
        assert_eq!(probed(&mut fabric, now), None);
        let now = run(&mut fabric, now, 1);
        assert!(probed(&mut fabric, now).is_some());
    }
}
