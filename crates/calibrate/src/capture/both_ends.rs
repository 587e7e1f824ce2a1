//! One-way times from captures at both ends of a path.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    net::IpAddr,
    time::Duration,
};

use cotorra_pcap::headers::Ip;

use super::{
    Captured,
    clocks::{MOST_DRIFT, lower_slope},
    read,
    tcp::{MOST_PACKET, offloaded},
};
use crate::{
    error::CalibrateError,
    estimate::quantile,
    path::{LEAST_ARRIVED, SHORTEST},
    times::{Means, OneWay, PacketTimes, middle},
};

/// Least bytes of each packet in both captures: an IP header and 8 bytes behind it.
const LEAST_KEPT: usize = 48;
/// Most of the packets at the receiver that the sender's capture does not have.
const MOST_STRAY: f64 = 0.01;
/// Most of a sender's packets that are equal to another one.
const MOST_EQUAL: f64 = 0.1;
/// Fewest packets of a direction, so that there are enough to fit and to test.
const LEAST_MATCHED: usize = 2 * LEAST_ARRIVED;
/// Longest plausible time, relative to the others, ms.
const MOST_MS: f64 = 600_000.0;

/// Source and destination.
type Hosts = (IpAddr, IpAddr);

/// Reads one-way times from captures (pcap or pcapng) at the first and the second end of a path.
///
/// Packets are matched by what no switch or router changes. The times are those of the two hosts with the most packets in both
/// captures. Hosts' places follow from the times: there and back take longer than nothing, whatever the clocks say. The drift
/// of the clocks is taken off. If packets go both ways, each direction gets half of the sum of the shortest times.
///
/// A packet without a match was lost, if it was sent between the first and the last one with a match.
///
/// # Errors
/// [`CalibrateError::Unreadable`] if one of them is no capture or has too much, [`CalibrateError::TooLittle`] if they have few
/// packets in common, and [`CalibrateError::Unsuited`] if packets cannot be told apart or were changed on the way.
pub fn one_way_of_captures(first: &[u8], second: &[u8]) -> Result<OneWay, CalibrateError> {
    let captures = [Capture::parse(first)?, Capture::parse(second)?];
    let kept = captures[0].kept.min(captures[1].kept);
    if kept < LEAST_KEPT {
        return Err(CalibrateError::unsuited(format!(
            "the captures have only {kept} bytes of some packets: capture {} or more, by `tcpdump -s 128`",
            LEAST_KEPT + 14
        )));
    }
    let [near, mut far] = captures.map(|capture| Endpoint::new(&capture, kept));
    let Between { forward, far_ahead_ns } = Between::find(&near, &far).ok_or_else(too_few)?;
    far.ahead_ns = far_ahead_ns;
    let begin_ns = near.packets.first().map_or(0, |packet| near.nanoseconds(packet));
    let backward = (forward.1, forward.0);
    of_ways([Way::new(&near, &far, forward, begin_ns)?, Way::new(&far, &near, backward, begin_ns)?])
}

fn too_few() -> CalibrateError {
    CalibrateError::too_little(format!(
        "no host sent another one {LEAST_MATCHED} packets that are in both captures: capture the same packets at both ends, \
         without address translation between them"
    ))
}

/// Puts the times of both directions on one clock.
fn of_ways(ways: [Way; 2]) -> Result<OneWay, CalibrateError> {
    let mut notes = Vec::new();
    let mut ways = ways.map(|way| (way.arrived().count() >= LEAST_MATCHED).then_some(way));
    let drift = match &ways {
        [Some(forward), Some(backward)] => {
            let slopes = [forward.slope(), -backward.slope()];
            let [a, b] =
                [forward.spread(slopes[0]), backward.spread(-slopes[1])].map(|ms| ms.max(1e-6).powi(-2));
            (a * slopes[0] + b * slopes[1]) / (a + b)
        }
        [Some(forward), None] => forward.slope(),
        [None, Some(backward)] => -backward.slope(),
        [None, None] => return Err(too_few()),
    };
    if drift.abs() > MOST_DRIFT {
        notes.push(format!(
            "the shortest times change by {:.0} ppm, which is more than clocks drift apart, so that nothing was taken off",
            drift * 1e3
        ));
    } else {
        for (way, drift) in ways.iter_mut().zip([drift, -drift]) {
            way.iter_mut().for_each(|way| way.change(|at_s, ms| ms - drift * at_s));
        }
    }
    let means = match &mut ways {
        [Some(forward), Some(backward)] => {
            let [there, back] = [forward.shortest_ms(), backward.shortest_ms()];
            let half = (there + back) / 2.0;
            if half < 0.0 {
                return Err(CalibrateError::unsuited(
                    "there and back take less than no time together: a clock was set during the captures",
                ));
            }
            forward.change(|_, ms| ms - there + half);
            backward.change(|_, ms| ms - back + half);
            Means::Halves
        }
        ways => {
            notes.push(format!(
                "fewer than {LEAST_MATCHED} packets went the other way, so that it is unknown how far apart the clocks are: the mean \
                 is unknown, and a lasting change of the delay was taken for a drift of the clocks"
            ));
            for way in ways.iter_mut().flatten() {
                let shortest = way.shortest_ms();
                way.change(|_, ms| ms - shortest);
            }
            Means::Unknown
        }
    };
    Ok(OneWay { ways: ways.map(|way| way.map(Way::times)), means, notes })
}

/// The IP packets of a capture.
struct Capture<'a> {
    packets: Vec<(Captured<'a>, Ip<'a>)>,
    /// Bytes that it has of each packet.
    kept: usize,
}

impl<'a> Capture<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, CalibrateError> {
        let packets: Vec<_> =
            read(bytes)?.into_iter().filter_map(|packet| Some((packet, Ip::read(packet.ip)?))).collect();
        if let Some((_, ip)) = packets.iter().find(|(_, ip)| ip.length > MOST_PACKET) {
            return Err(offloaded(ip.length));
        }
        let cut = packets.iter().filter(|(packet, ip)| packet.cut && packet.ip.len() < ip.length);
        let kept = cut.map(|(packet, _)| packet.ip.len()).min().unwrap_or(usize::MAX);
        Ok(Self { packets, kept })
    }
}

/// A packet, as it is matched.
#[derive(Debug, Clone, Copy)]
struct Seen {
    at_ns: i64,
    source: IpAddr,
    destination: IpAddr,
    print: u64,
    frame_bytes: usize,
}

/// The packets at one end, with their fingerprints.
struct Endpoint {
    packets: Vec<Seen>,
    /// First place of a fingerprint, and the number of its packets.
    places: HashMap<u64, (usize, usize)>,
    /// Time by which its clock is ahead of the clock at the first end, about.
    ahead_ns: i64,
}

impl Endpoint {
    fn new(capture: &Capture<'_>, kept: usize) -> Self {
        let seen = |(packet, ip): &(Captured<'_>, Ip<'_>)| Seen {
            at_ns: packet.at_ns,
            source: ip.source,
            destination: ip.destination,
            print: ip.fingerprint(kept),
            frame_bytes: packet.frame_bytes,
        };
        let packets: Vec<Seen> = capture.packets.iter().map(seen).collect();
        let mut places = HashMap::with_capacity(packets.len());
        for (i, packet) in packets.iter().enumerate() {
            places.entry(packet.print).or_insert((i, 0)).1 += 1;
        }
        Self { packets, places, ahead_ns: 0 }
    }

    fn first(&self, print: u64) -> Option<&Seen> {
        self.places.get(&print).map(|(first, _)| &self.packets[*first])
    }

    fn number(&self, print: u64) -> usize {
        self.places.get(&print).map_or(0, |(_, number)| *number)
    }

    /// Returns the packets between two hosts, from the first that the other end has, too, to the last.
    fn common(&self, other: &Self, (source, destination): Hosts) -> Vec<&Seen> {
        let is_of = |packet: &&Seen| packet.source == source && packet.destination == destination;
        let mut packets: Vec<&Seen> = self.packets.iter().filter(is_of).collect();
        let is_common = |packet: &&Seen| other.number(packet.print) > 0;
        packets.truncate(packets.iter().rposition(is_common).map_or(0, |last| last + 1));
        packets.drain(..packets.iter().position(is_common).unwrap_or(0));
        packets
    }

    /// Returns a time in ns on the clock at the first end.
    fn nanoseconds(&self, packet: &Seen) -> i128 {
        i128::from(packet.at_ns) - i128::from(self.ahead_ns)
    }
}

/// The two hosts at the ends, and their clocks.
struct Between {
    /// Source and destination of forward packets.
    forward: Hosts,
    /// Time by which the clock at the second end is ahead, with the delay of the path.
    far_ahead_ns: i64,
}

impl Between {
    /// Finds the hosts with the most packets in both captures; `None` if those are too few.
    ///
    /// A packet's time at the second end, less that at the first, is later for forward packets than for backward ones, on any
    /// clocks. If all go one way, the clocks decide.
    fn find(near: &Endpoint, far: &Endpoint) -> Option<Self> {
        let mut apart: BTreeMap<Hosts, Vec<i64>> = BTreeMap::new();
        for packet in &near.packets {
            if let Some(other) = far.first(packet.print) {
                let ns = other.at_ns.saturating_sub(packet.at_ns);
                apart.entry((packet.source, packet.destination)).or_default().push(ns);
            }
        }
        let (hosts, found) = apart.iter().max_by_key(|(_, found)| found.len())?;
        if found.len() < LEAST_MATCHED {
            return None;
        }
        let opposite = (hosts.1, hosts.0);
        let there = middle(found.clone())?;
        let is_forward = match apart.get(&opposite).cloned().and_then(middle) {
            Some(back) => there >= back,
            None => there >= 0,
        };
        Some(Self { forward: if is_forward { *hosts } else { opposite }, far_ahead_ns: there })
    }
}

/// Packets of one direction, from the first that arrived to the last.
struct Way {
    /// When each was sent, s, and the time that it took, ms; `None` if it was lost.
    packets: Vec<(f64, Option<f64>)>,
    duplicated: BTreeSet<usize>,
    late: usize,
    frame_bytes: usize,
}

impl Way {
    /// Matches the packets from a sender to a receiver. Times count from `begin_ns`.
    fn new(
        sender: &Endpoint,
        receiver: &Endpoint,
        hosts: Hosts,
        begin_ns: i128,
    ) -> Result<Self, CalibrateError> {
        let all = sender.common(receiver, hosts);
        let sent: Vec<&Seen> =
            all.iter().copied().filter(|packet| sender.number(packet.print) == 1).collect();
        let equal = all.len() - sent.len();
        if equal as f64 > MOST_EQUAL * all.len() as f64 {
            return Err(CalibrateError::unsuited(format!(
                "{equal} of {} packets are equal to another one: send packets with a number in each",
                all.len()
            )));
        }
        let received = receiver.common(sender, hosts);
        let strays = received.iter().filter(|packet| sender.number(packet.print) == 0).count();
        if strays as f64 > MOST_STRAY * received.len() as f64 {
            return Err(CalibrateError::unsuited(format!(
                "{strays} of {} packets that arrived are not in the sender's capture: switch offloads off (`ethtool -K IF tso off \
                 gso off gro off`), and look whether `tcpdump` dropped packets",
                received.len()
            )));
        }
        let mut way = Self {
            packets: Vec::with_capacity(sent.len()),
            duplicated: BTreeSet::new(),
            late: 0,
            frame_bytes: middle(sent.iter().map(|packet| packet.frame_bytes).collect()).unwrap_or(0),
        };
        let mut latest = i64::MIN;
        for packet in sent {
            let sent_ns = sender.nanoseconds(packet);
            let ms = receiver.first(packet.print).map(|other| {
                if receiver.number(packet.print) > 1 {
                    way.duplicated.insert(way.packets.len());
                }
                way.late += usize::from(other.at_ns < latest);
                latest = latest.max(other.at_ns);
                (receiver.nanoseconds(other) - sent_ns) as f64 / 1e6
            });
            if ms.is_some_and(|ms| ms.abs() > MOST_MS) {
                return Err(CalibrateError::unsuited(
                    "some packets took ten minutes longer than others: a clock was set during the captures",
                ));
            }
            way.packets.push(((sent_ns - begin_ns) as f64 / 1e9, ms));
        }
        Ok(way)
    }

    fn arrived(&self) -> impl Iterator<Item = (f64, f64)> {
        self.packets.iter().filter_map(|(at_s, ms)| Some((*at_s, (*ms)?)))
    }

    /// Returns how much the shortest times grow, ms in a second.
    fn slope(&self) -> f64 {
        lower_slope(&mut self.arrived().collect::<Vec<_>>())
    }

    /// Returns how far the times are above the shortest one on average, ms, without a slope.
    fn spread(&self, slope: f64) -> f64 {
        let level = || self.arrived().map(|(at_s, ms)| ms - slope * at_s);
        level().sum::<f64>() / self.arrived().count().max(1) as f64 - level().fold(f64::INFINITY, f64::min)
    }

    fn shortest_ms(&self) -> f64 {
        let mut times: Vec<f64> = self.arrived().map(|(_, ms)| ms).collect();
        times.sort_unstable_by(f64::total_cmp);
        quantile(&times, SHORTEST)
    }

    /// Changes each time by when its packet was sent.
    fn change(&mut self, to: impl Fn(f64, f64) -> f64) {
        for (at_s, ms) in &mut self.packets {
            *ms = ms.map(|ms| to(*at_s, ms));
        }
    }

    fn times(self) -> PacketTimes {
        let apart = self.packets.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        PacketTimes {
            interval: middle(apart).and_then(|s| Duration::try_from_secs_f64(s).ok()),
            times_ms: self.packets.into_iter().map(|(_, ms)| ms).collect(),
            duplicated: self.duplicated,
            late: self.late,
            counts_losses: true,
            frame_bytes: [self.frame_bytes; 2],
            notes: Vec::new(),
        }
    }
}
