//! The receiving end of a TCP connection: reassembly, delayed acknowledgements (RFC 5681, section 4.2) and SACK (RFC 2018).

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::Timestamp;

use crate::{
    rtt::milliseconds,
    segment::{MSS, Segment, unwrap_near},
};

/// Longest wait of an acknowledgement for the next segment: Linux's least (`TCP_DELACK_MIN`); RFC 5681 allows 500 ms.
const DELAY: Duration = Duration::from_millis(40);
/// Window that the receiver keeps free, bytes: Linux's largest buffer (`net.ipv4.tcp_rmem`).
pub(crate) const WINDOW: u64 = 6 << 20;

/// The receiving end.
#[derive(Debug, Clone, Default)]
pub(crate) struct Receiver {
    /// Position of the byte that is expected next; `None` before the first segment. Position 0 is the connection's opening.
    expected: Option<u64>,
    /// Ranges beyond it, by their begin.
    beyond: BTreeMap<u64, u64>,
    /// Begins of the ranges of the latest segments, the latest first.
    latest: Vec<u64>,
    /// Bytes that no acknowledgement was sent for.
    unacknowledged: u64,
    /// When an acknowledgement is due at the latest.
    due: Option<Timestamp>,
    /// The sender's time in the last segment that advanced the stream, which acknowledgements answer.
    answered: u32,
}

impl Receiver {
    /// Bytes that arrived in order, without the connection's opening.
    pub(crate) fn bytes(&self) -> u64 {
        self.expected.map_or(0, |expected| expected - 1)
    }

    /// Returns when an acknowledgement is due.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        self.due
    }

    /// Takes a segment. Returns the acknowledgement that it calls for at once.
    pub(crate) fn handle(&mut self, now: Timestamp, segment: &Segment) -> Option<Segment> {
        if segment.syn {
            self.expected.get_or_insert(1);
            self.answered = segment.times.0;
            return Some(Segment { syn: true, ..self.acknowledge(now) });
        }
        let expected = self.expected?;
        let start = unwrap_near(expected, segment.sequence)?;
        let end = start + segment.payload as u64;
        if segment.payload == 0 || end > expected + WINDOW {
            return None;
        }
        if end <= expected {
            return Some(self.acknowledge(now));
        }
        if start > expected {
            self.keep(start, end);
            return Some(self.acknowledge(now));
        }
        let filled_gap = !self.beyond.is_empty();
        self.expected = Some(self.contiguous(end));
        self.answered = segment.times.0;
        self.unacknowledged += end - expected;
        if filled_gap || self.unacknowledged >= 2 * MSS {
            return Some(self.acknowledge(now));
        }
        self.due.get_or_insert(now + DELAY);
        None
    }

    /// Returns the acknowledgement that is due.
    pub(crate) fn poll(&mut self, now: Timestamp) -> Option<Segment> {
        self.due.is_some_and(|due| due <= now).then(|| self.acknowledge(now))
    }

    /// Keeps a range beyond the expected byte, joined with those that it touches.
    fn keep(&mut self, mut start: u64, mut end: u64) {
        let touched: Vec<_> = self
            .beyond
            .range(..=end)
            .filter(|&(_, &its)| its >= start)
            .map(|(&at, &its)| (at, its))
            .collect();
        for (at, its) in touched {
            self.beyond.remove(&at);
            self.latest.retain(|&latest| latest != at);
            (start, end) = (start.min(at), end.max(its));
        }
        self.beyond.insert(start, end);
        self.latest.insert(0, start);
    }

    /// Takes all ranges that continue the stream at `end`, and returns its new end.
    fn contiguous(&mut self, mut end: u64) -> u64 {
        while let Some(first) = self.beyond.first_entry().filter(|first| *first.key() <= end) {
            let (start, its) = first.remove_entry();
            self.latest.retain(|&latest| latest != start);
            end = end.max(its);
        }
        end
    }

    fn acknowledge(&mut self, now: Timestamp) -> Segment {
        (self.unacknowledged, self.due) = (0, None);
        let block = |start: &u64| (*start as u32, self.beyond[start] as u32);
        Segment {
            sequence: 1,
            ack: self.expected.map(|expected| expected as u32),
            times: (milliseconds(now), self.answered),
            sacked: self.latest.iter().take(3).map(block).collect(),
            ..Segment::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::ZERO + Duration::from_millis(ms)
    }

    fn data(number: u64) -> Segment {
        Segment {
            sequence: (1 + number * MSS) as u32,
            payload: MSS as usize,
            ack: Some(1),
            ..Segment::default()
        }
    }

    fn opened() -> Receiver {
        let mut receiver = Receiver::default();
        let opened = receiver.handle(at(0), &Segment { syn: true, ..Segment::default() }).unwrap();
        assert!(opened.syn && opened.ack == Some(1));
        receiver
    }

    #[test]
    fn every_second_segment_is_acknowledged_at_once_and_a_single_one_after_40_ms() {
        let mut receiver = opened();
        assert_eq!(receiver.handle(at(1), &data(0)), None);
        assert_eq!(receiver.handle(at(2), &data(1)).unwrap().ack, Some(1 + 2 * MSS as u32));
        assert_eq!(receiver.handle(at(3), &data(2)), None);
        assert_eq!((receiver.poll(at(42)), receiver.deadline()), (None, Some(at(43))));
        assert_eq!(receiver.poll(at(43)).unwrap().ack, Some(1 + 3 * MSS as u32));
        assert_eq!(receiver.deadline(), None);
    }

    #[test]
    fn segments_beyond_a_gap_are_named_and_the_filled_gap_is_acknowledged_at_once() {
        let mut receiver = opened();
        let block = |from: u64, to: u64| ((1 + from * MSS) as u32, (1 + to * MSS) as u32);
        assert_eq!(receiver.handle(at(1), &data(2)).unwrap().sacked, [block(2, 3)]);
        assert_eq!(receiver.handle(at(2), &data(5)).unwrap().sacked, [block(5, 6), block(2, 3)]);
        let third = receiver.handle(at(3), &data(3)).unwrap();
        assert_eq!((third.ack, third.sacked), (Some(1), vec![block(2, 4), block(5, 6)]));
        receiver.handle(at(4), &data(0));
        let filled = receiver.handle(at(5), &data(1)).unwrap();
        assert_eq!((filled.ack, filled.sacked), (Some(block(0, 4).1), vec![block(5, 6)]));
        assert_eq!(receiver.bytes(), 4 * MSS);
    }
}
