//! Round trips of TCP from a capture at the sender's side: data and their acknowledgements.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    net::IpAddr,
    time::Duration,
};

use cotorra_pcap::headers::{Ip, Segment};

use super::{read, unreadable};
use crate::{
    error::CalibrateError,
    times::{PacketTimes, middle},
};

/// Most connections of a capture.
const MAX_CONNECTIONS: usize = 65_536;
/// Most segments of a direction that wait for their acknowledgement.
const MAX_OUTSTANDING: usize = 16_384;
/// Bytes of an Ethernet frame with an acknowledgement and timestamps.
const ACKNOWLEDGEMENT: usize = 66;
/// Longer packets were captured before a network card cut them, or after it joined them.
pub(super) const MOST_PACKET: usize = 9216;
/// If the shortest round trip to one side is more than this share of that to the other, the capture was made between them.
const BETWEEN: f64 = 0.1;
/// If more than this share of acknowledgements is of one segment, they may have been delayed.
const SINGLE: f64 = 0.5;

/// Addresses and ports of one end.
type End = (IpAddr, u16);

/// Reads round trips from a capture (pcap or pcapng) at one end of a path, by TCP's data and acknowledgements.
///
/// A round trip is the time from a segment to the first acknowledgement that ends where the segment ends. If a segment that it
/// acknowledges was sent twice, the one whose timestamp the acknowledgement echoes counts (RFC 7323, 4). Without
/// timestamps, none does (Karn and Partridge 1987). Round trips are those between the two hosts with the most, seen from the
/// one to which they are longer. Losses are not measured.
///
/// # Errors
/// [`CalibrateError::Unreadable`] if it is no capture, has too much, or no round trips of TCP.
pub fn round_trips_of_capture(bytes: &[u8]) -> Result<PacketTimes, CalibrateError> {
    let mut flows: BTreeMap<(End, End), Flow> = BTreeMap::new();
    let mut pairs: BTreeMap<[IpAddr; 2], Vec<RoundTrip>> = BTreeMap::new();
    for packet in read(bytes)? {
        let Some((ip, segment)) = Ip::read(packet.ip).and_then(|ip| Some((ip, ip.segment()?))) else {
            continue;
        };
        if ip.length > MOST_PACKET {
            return Err(offloaded(ip.length));
        }
        let [from, to] = [(ip.source, segment.ports[0]), (ip.destination, segment.ports[1])];
        if let Some(flow) = flows.get_mut(&(to, from))
            && let Some(trip) = flow.acknowledge(packet.at_ns, &segment)
        {
            pairs.entry([ip.destination, ip.source]).or_default().push(trip);
        }
        if segment.length == 0 || segment.is_reset {
            continue;
        }
        if flows.len() >= MAX_CONNECTIONS && !flows.contains_key(&(from, to)) {
            return Err(unreadable(format!(
                "the capture has more than {MAX_CONNECTIONS} connections: filter one flow, as by `tcpdump tcp port 5201`"
            )));
        }
        flows.entry((from, to)).or_default().send(packet.at_ns, packet.frame_bytes, &segment);
    }
    let busiest = |pairs: &BTreeMap<[IpAddr; 2], Vec<RoundTrip>>| {
        let number = |hosts: &[IpAddr; 2]| pairs.get(hosts).map_or(0, Vec::len);
        pairs.keys().copied().max_by_key(|[a, b]| number(&[*a, *b]) + number(&[*b, *a]))
    };
    let [near, far] = busiest(&pairs).ok_or_else(|| {
        unreadable("the capture has no TCP data with acknowledgements: for other flows, capture at both ends")
    })?;
    let ways = [[near, far], [far, near]].map(|hosts| pairs.remove(&hosts).unwrap_or_default());
    Ok(series(ways))
}

/// Returns the error of a packet that no link carries.
pub(super) fn offloaded(length: usize) -> CalibrateError {
    unreadable(format!(
        "the capture has packets of {length} bytes, which the network card cuts or has joined: switch offloads off, by \
         `ethtool -K IF tso off gso off gro off`"
    ))
}

/// Makes a series of the round trips that both of two hosts see.
fn series(ways: [Vec<RoundTrip>; 2]) -> PacketTimes {
    let shortest = ways.each_ref().map(|trips| trips.iter().map(|trip| trip.ms).reduce(f64::min));
    let [first, second] = shortest.map(|ms| ms.unwrap_or(0.0));
    let [mut there, back] = ways;
    let (mut notes, mut shorter) = (Vec::new(), second);
    if second > first {
        (there, shorter) = (back, first);
    }
    if shorter > BETWEEN * first.max(second) {
        notes.push(format!(
            "the capture was made between both hosts: the other side is {shorter:.3} ms away, which is not in the round trips"
        ));
    }
    there.sort_by_key(|trip| trip.sent_ns);
    let single = there.iter().filter(|trip| trip.acknowledges_one).count();
    if single as f64 > SINGLE * there.len() as f64 {
        notes.push(
            "most acknowledgements are of one segment, so that the receiver may have delayed them (RFC 9293, 3.8.6.3)".to_owned(),
        );
    }
    let apart: Vec<u64> = there.windows(2).map(|pair| pair[0].sent_ns.abs_diff(pair[1].sent_ns)).collect();
    PacketTimes {
        times_ms: there.iter().map(|trip| Some(trip.ms)).collect(),
        duplicated: BTreeSet::new(),
        late: 0,
        counts_losses: false,
        interval: middle(apart).map(Duration::from_nanos),
        frame_bytes: [
            middle(there.iter().map(|trip| trip.frame_bytes).collect()).unwrap_or(ACKNOWLEDGEMENT),
            ACKNOWLEDGEMENT,
        ],
        notes,
    }
}

/// A segment, acknowledged.
#[derive(Debug, Clone, Copy, PartialEq)]
struct RoundTrip {
    sent_ns: i64,
    ms: f64,
    frame_bytes: usize,
    /// Whether no other segment was acknowledged with it.
    acknowledges_one: bool,
}

/// A segment that is not acknowledged yet.
#[derive(Debug, Clone, Copy)]
struct Sent {
    /// The sequence number behind it.
    end: u32,
    at_ns: i64,
    stamp: Option<u32>,
    frame_bytes: usize,
    /// Whether some of it was sent more than once.
    is_ambiguous: bool,
}

/// One direction of a connection.
#[derive(Debug, Default)]
struct Flow {
    /// By sequence number; segments that were sent again are behind their first ones.
    outstanding: VecDeque<Sent>,
    /// The highest sequence number behind a segment.
    end: Option<u32>,
}

/// Whether a sequence number is behind another one, modulo 2³² (RFC 9293, 3.4).
fn is_after(a: u32, b: u32) -> bool {
    a.wrapping_sub(b).cast_signed() > 0
}

impl Flow {
    fn send(&mut self, at_ns: i64, frame_bytes: usize, segment: &Segment) {
        let (begin, end) = (segment.sequence, segment.sequence.wrapping_add(segment.length));
        let is_again = self.end.is_some_and(|highest| is_after(highest, begin));
        if is_again {
            let overlapping = self.outstanding.partition_point(|sent| !is_after(sent.end, begin));
            let overlapping = self.outstanding.range_mut(overlapping..);
            overlapping.take_while(|sent| !is_after(sent.end, end)).for_each(|sent| sent.is_ambiguous = true);
        }
        if self.end.is_none_or(|highest| is_after(end, highest)) {
            self.end = Some(end);
        }
        if self.outstanding.len() == MAX_OUTSTANDING {
            self.outstanding.pop_front();
        }
        let stamp = segment.stamps.map(|[own, _]| own);
        let place = match is_again {
            true => self.outstanding.partition_point(|sent| !is_after(sent.end, end)),
            false => self.outstanding.len(),
        };
        self.outstanding.insert(place, Sent { end, at_ns, stamp, frame_bytes, is_ambiguous: is_again });
    }

    /// Takes an acknowledgement; returns the round trip that it ends.
    fn acknowledge(&mut self, at_ns: i64, segment: &Segment) -> Option<RoundTrip> {
        let to = segment.acknowledged?;
        let number = self.outstanding.iter().take_while(|sent| !is_after(sent.end, to)).count();
        let acknowledged: Vec<Sent> = self.outstanding.drain(..number).collect();
        let found = if acknowledged.iter().any(|sent| sent.is_ambiguous) {
            let [_, echo] = segment.stamps?;
            let mut echoed = acknowledged.iter().filter(|sent| sent.stamp == Some(echo));
            let found = echoed.next()?;
            echoed.next().is_none().then_some(found)?
        } else {
            acknowledged.iter().find(|sent| sent.end == to)?
        };
        Some(RoundTrip {
            sent_ns: found.at_ns,
            ms: at_ns.checked_sub(found.at_ns).filter(|ns| *ns >= 0)? as f64 / 1e6,
            frame_bytes: found.frame_bytes,
            acknowledges_one: number == 1,
        })
    }
}
