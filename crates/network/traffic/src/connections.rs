//! The connections of a source: one for all of its data, or one for each transfer.

use cotorra_graph::{Begin, CongestionControl, Sends, Timestamp, Transfers};
use cotorra_numbers::{Draws, Gathered, Quantiles};

use crate::{
    completions::Completions,
    measured::{TcpMeasured, TransfersMeasured, gather},
    segment::{Ends, Segment},
    sender::Counts,
    tcp::{Brought, Connection},
    udp::duration,
};

/// First port of transfers at the host that sends, and the number of such ports. Ports of streams are those of sources.
const FIRST_CLIENT: u16 = 10_000;
const CLIENTS: u16 = 20_000;
/// Most bytes of a transfer.
const MOST_BYTES: f64 = 1e12;

/// The connections of a source.
#[derive(Debug)]
pub(crate) struct Connections {
    congestion_control: CongestionControl,
    /// Seeds of the connections' random numbers.
    draws: Draws,
    open: Vec<Open>,
    /// What the senders of closed connections did.
    closed: Counts,
    round_trips: Gathered,
    plan: Plan,
}

/// A connection with data that is not all acknowledged.
#[derive(Debug)]
struct Open {
    connection: Connection,
    ends: Ends,
    began: Timestamp,
    /// Bytes to send in all.
    bytes: Option<u64>,
    has_arrived: bool,
}

#[derive(Debug)]
enum Plan {
    /// One connection, which finished at that time, if it has an end.
    Stream {
        finished: Option<Timestamp>,
    },
    Transfers(Box<Planned>),
}

/// Transfers, now and in the future.
#[derive(Debug)]
struct Planned {
    spec: Transfers,
    draws: Draws,
    /// When the next begins; `None` while it waits for the last.
    next: Option<Timestamp>,
    /// Number of transfers so far, refused ones included, for their ports.
    begun: u64,
    refused: u64,
    completions: Completions,
}

impl Planned {
    fn new(spec: Transfers, start: Timestamp, mut draws: Draws) -> Self {
        // The first comes as each later one does.
        let next = match spec.begin {
            Begin::AfterPause(pause) => pause,
            Begin::Every(gap, _) => gap,
        };
        let next = Some(start + duration(next.sample(&mut draws)));
        Self { spec, draws, next, begun: 0, refused: 0, completions: Completions::default() }
    }

    /// Returns the time and the size of the next transfer that is due before a time.
    fn take(&mut self, now: Timestamp, stop: Timestamp, open: usize) -> Option<(Timestamp, u64)> {
        loop {
            let at = self.next.filter(|&at| at <= now && at < stop)?;
            let bytes = self.spec.size.sample(&mut self.draws).round().clamp(1.0, MOST_BYTES) as u64;
            self.begun += 1;
            match self.spec.begin {
                Begin::AfterPause(_) => self.next = None,
                Begin::Every(gap, most) => {
                    self.next = Some(at + duration(gap.sample(&mut self.draws)));
                    if open >= usize::from(most) {
                        self.refused += 1;
                        continue;
                    }
                }
            }
            return Some((at, bytes));
        }
    }

    /// Takes a transfer whose last byte arrived.
    fn complete(&mut self, now: Timestamp, began: Timestamp, bytes: u64) {
        self.completions.add(bytes, now.since(began));
        if let Begin::AfterPause(pause) = self.spec.begin {
            self.next = Some(now + duration(pause.sample(&mut self.draws)));
        }
    }
}

impl Connections {
    /// Creates the connections of a source between these ends, whose ports are the source's. `of_transfers` are random
    /// numbers for their times and sizes.
    pub(crate) fn new(
        congestion_control: CongestionControl,
        sends: Sends,
        (start, ends): (Timestamp, Ends),
        [draws, of_transfers]: [Draws; 2],
    ) -> Self {
        let mut open = Vec::new();
        let plan = match sends {
            Sends::Stream(bytes) => {
                let connection = Connection::new(congestion_control, bytes, draws.clone());
                open.push(Open { connection, ends, began: start, bytes, has_arrived: false });
                Plan::Stream { finished: None }
            }
            Sends::Transfers(spec) => Plan::Transfers(Box::new(Planned::new(spec, start, of_transfers))),
        };
        let (closed, round_trips) = (Counts::default(), Gathered::default());
        Self { congestion_control, draws, open, closed, round_trips, plan }
    }

    /// Returns the next segment to send now, with its ends. No transfer begins from `stop` on.
    pub(crate) fn poll(&mut self, now: Timestamp, stop: Timestamp, ends: Ends) -> Option<(Segment, Ends)> {
        match self.plan {
            Plan::Stream { .. } if now >= stop => {
                self.open.iter_mut().for_each(|open| open.connection.stop())
            }
            Plan::Stream { .. } => {}
            Plan::Transfers(_) => self.begin_transfers(now, stop, ends),
        }
        self.open.iter_mut().find_map(|open| {
            let (segment, is_answer) = open.connection.poll(now)?;
            Some((segment, if is_answer { open.ends.reversed() } else { open.ends }))
        })
    }

    fn begin_transfers(&mut self, now: Timestamp, stop: Timestamp, ends: Ends) {
        while let Plan::Transfers(plan) = &mut self.plan
            && let Some((began, bytes)) = plan.take(now, stop, self.open.len())
        {
            let port = |number: u64| FIRST_CLIENT + (number % u64::from(CLIENTS)) as u16;
            // A port whose connection is still open is left out. There are more ports than open connections.
            while self.open.iter().any(|open| open.ends.from.1 == port(plan.begun)) {
                plan.begun += 1;
            }
            let ends = Ends { from: (ends.from.0, port(plan.begun)), ..ends };
            let connection = Connection::new(self.congestion_control, Some(bytes), self.draws.fork());
            self.open.push(Open { connection, ends, began, bytes: Some(bytes), has_arrived: false });
        }
    }

    /// Returns when [`Self::poll`] may have something to send.
    pub(crate) fn deadline(&self, now: Timestamp, stop: Timestamp) -> Option<Timestamp> {
        let next = match &self.plan {
            Plan::Stream { .. } => None,
            Plan::Transfers(plan) => plan.next.filter(|&at| at < stop),
        };
        self.open.iter().filter_map(|open| open.connection.deadline(now)).chain(next).min()
    }

    /// Takes a frame of the connection with this port at the host that sends: at the receiver if it `arrives`, else at the
    /// sender. Returns the bytes that newly arrived in order.
    pub(crate) fn handle(&mut self, now: Timestamp, client: u16, arrives: bool, frame: &[u8]) -> u64 {
        let Some(place) = self.open.iter().position(|open| open.ends.from.1 == client) else { return 0 };
        let open = &mut self.open[place];
        match open.connection.handle(now, open.ends, arrives, frame) {
            Brought::Data(new) => {
                let all = open.bytes.filter(|&bytes| open.connection.has_arrived(bytes));
                if let (Some(bytes), Plan::Transfers(plan), false) = (all, &mut self.plan, open.has_arrived) {
                    open.has_arrived = true;
                    plan.complete(now, open.began, bytes);
                }
                new
            }
            Brought::Acknowledgement(sample) => {
                if let Some(sample) = sample {
                    gather(&mut self.round_trips, sample);
                }
                if open.bytes.is_some_and(|bytes| open.connection.has_delivered(bytes)) {
                    self.finish(now, place);
                }
                0
            }
            Brought::Nothing => 0,
        }
    }

    /// Notes that all data of a connection is acknowledged.
    fn finish(&mut self, now: Timestamp, place: usize) {
        match &mut self.plan {
            Plan::Stream { finished } => _ = finished.get_or_insert(now),
            Plan::Transfers(_) => self.closed += self.open.remove(place).connection.counts(),
        }
    }

    /// Returns the packets that were sent, what was measured, and when all bytes were acknowledged.
    pub(crate) fn measured(&self, start: Timestamp) -> (u64, TcpMeasured, Option<Timestamp>) {
        let mut counts = self.closed;
        self.open.iter().for_each(|open| counts += open.connection.counts());
        let (finished, smoothed, transfers) = match &self.plan {
            Plan::Stream { finished } => {
                let smoothed = self.open.first().and_then(|open| open.connection.smoothed_round_trip());
                (*finished, smoothed, None)
            }
            Plan::Transfers(plan) => {
                let open_transfers = self.open.iter().filter(|open| !open.has_arrived).count() as u64;
                let (refused_transfers, (all, by_size)) = (plan.refused, plan.completions.measured());
                (None, None, Some(TransfersMeasured { refused_transfers, open_transfers, all, by_size }))
            }
        };
        let measured = TcpMeasured {
            retransmitted_packets: counts.retransmitted,
            timeouts: counts.timeouts,
            smoothed_round_trip_ms: smoothed.map(|trip| trip.as_secs_f64() * 1e3),
            round_trip_ms: Quantiles::gathered(&self.round_trips),
            finished_after_ms: finished.map(|at| at.since(start).as_secs_f64() * 1e3),
            transfers,
        };
        (counts.sent, measured, finished)
    }
}
