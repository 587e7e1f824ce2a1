//! Queue of one direction of a wired link: it holds packets until the transmitter takes them, within a limit and under a
//! discipline.
//!
//! Disciplines have neither a clock nor timers. Their decisions depend on when packets come and leave, on their parameters
//! and on a seeded stream of random numbers.

mod codel;
mod fifo;
mod fq_codel;
pub(crate) mod packet;
mod pie;
mod red;
mod shared;

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{Conditions, QueueDiscipline, QueueLimit, Rate, Timestamp};
use cotorra_numbers::Draws;

pub(crate) use self::shared::{ClassKey, Share, Shared};
use self::{codel::Codel, fifo::Fifo, fq_codel::FqCodel, pie::Pie, red::Red};

/// Bytes of a full Ethernet frame without FCS.
const FULL_FRAME: u64 = 1514;

/// A queue's view of a packet.
pub(crate) trait Queued {
    /// Bytes behind a packet up to which CoDel never drops it (`mtu` in Linux's `codel_should_drop`).
    const SPARED: u64 = FULL_FRAME;

    /// Returns when it came to the link.
    fn entered(&self) -> Timestamp;
    /// Returns the number of packets that it is on the wire.
    fn packets(&self) -> u32;
    /// Returns its bytes on the wire.
    fn bytes(&self) -> u64;
    /// Returns a hash of the flow that it belongs to.
    fn flow(&self) -> u64;
    /// Returns the two hosts to whose reservations it belongs, if it is on their pinned path.
    fn class(&self) -> Option<ClassKey> {
        None
    }
    /// Marks it as having met congestion (CE, RFC 3168). Returns `false`, and changes nothing, if it is not ECN-capable.
    fn mark(&mut self) -> bool;
}

/// Decision of a discipline on a packet that arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// It waits.
    Admit,
    /// It is marked and waits, or is dropped if it is not ECN-capable.
    Mark,
    Drop,
}

impl Verdict {
    /// Carries it out. Returns whether the packet waits.
    fn admits(self, packet: &mut impl Queued) -> bool {
        match self {
            Self::Admit => true,
            Self::Mark => packet.mark(),
            Self::Drop => false,
        }
    }
}

/// A queue of packets of type `P`.
#[derive(Debug)]
pub(crate) struct Queue<P> {
    limit: QueueLimit,
    /// Packets and bytes that wait.
    packets: u64,
    bytes: u64,
    rng: Draws,
    parameters: QueueDiscipline,
    discipline: Discipline<P>,
}

/// The packets, as their discipline keeps them, and its state.
#[derive(Debug)]
enum Discipline<P> {
    DropTail(VecDeque<P>),
    Codel(Fifo<P>, Codel),
    FqCodel(Box<FqCodel<P>>),
    Pie(VecDeque<P>, Pie),
    Red(VecDeque<P>, Red),
}

impl<P: Queued> Discipline<P> {
    fn new(now: Timestamp, conditions: &Conditions, rng: &mut Draws) -> Self {
        match conditions.queue_discipline {
            QueueDiscipline::DropTail => Self::DropTail(VecDeque::new()),
            QueueDiscipline::Codel(codel) => Self::Codel(Fifo::default(), Codel::new(codel)),
            QueueDiscipline::FqCodel(fq) => Self::FqCodel(Box::new(FqCodel::new(fq, rng.bits()))),
            QueueDiscipline::Pie(pie) => Self::Pie(VecDeque::new(), Pie::new(pie, now)),
            QueueDiscipline::Red(red) => Self::Red(VecDeque::new(), Red::new(red, now, &conditions.rate)),
        }
    }

    /// Adds a packet that is admitted.
    fn insert(&mut self, packet: P) {
        match self {
            Self::DropTail(packets) | Self::Pie(packets, _) | Self::Red(packets, _) => {
                packets.push_back(packet);
            }
            Self::Codel(fifo, _) => fifo.push(packet),
            Self::FqCodel(fq) => fq.push(packet),
        }
    }
}

impl<P: Queued> Queue<P> {
    /// Creates an empty queue that draws its random numbers from `rng`.
    pub(crate) fn new(now: Timestamp, conditions: &Conditions, mut rng: Draws) -> Self {
        Self {
            limit: conditions.queue,
            packets: 0,
            bytes: 0,
            discipline: Discipline::new(now, conditions, &mut rng),
            parameters: conditions.queue_discipline,
            rng,
        }
    }

    /// Returns how many packets wait.
    pub(crate) fn packets(&self) -> u64 {
        self.packets
    }

    /// Returns the packets that wait, in no particular order.
    pub(crate) fn iter(&self) -> Box<dyn Iterator<Item = &P> + '_> {
        match &self.discipline {
            Discipline::DropTail(packets) | Discipline::Pie(packets, _) | Discipline::Red(packets, _) => {
                Box::new(packets.iter())
            }
            Discipline::Codel(fifo, _) => Box::new(fifo.iter()),
            Discipline::FqCodel(fq) => Box::new(fq.iter()),
        }
    }

    /// Whether there is room for a packet.
    pub(crate) fn fits(&self, packet: &P) -> bool {
        match self.limit {
            QueueLimit::Packets(limit) => self.packets + u64::from(packet.packets()) <= u64::from(limit),
            QueueLimit::Bytes(limit) => self.bytes + packet.bytes() <= limit,
        }
    }

    /// Adds a packet that has to wait. Calls `drop` with every packet that the queue drops.
    pub(crate) fn push(&mut self, now: Timestamp, mut packet: P, drop: &mut dyn FnMut(P)) {
        if !self.decide(now, &packet).admits(&mut packet) {
            return drop(packet);
        }
        if matches!(self.discipline, Discipline::FqCodel(_)) {
            self.insert(packet);
            return self.shorten(drop);
        }
        if self.fits(&packet) { self.insert(packet) } else { drop(packet) }
    }

    /// Takes a packet through the empty queue to the idle transmitter, whatever the limit. Returns it, unless the
    /// discipline drops it.
    pub(crate) fn pass(&mut self, now: Timestamp, mut packet: P, drop: &mut dyn FnMut(P)) -> Option<P> {
        if self.parameters.is_drop_tail() {
            return Some(packet);
        }
        if !self.decide(now, &packet).admits(&mut packet) {
            drop(packet);
            return None;
        }
        self.insert(packet);
        self.pop(now, drop)
    }

    /// Takes the next packet to send. Calls `drop` with every packet that the queue drops instead. Without a packet, the
    /// transmitter is idle from `now` on.
    pub(crate) fn pop(&mut self, now: Timestamp, drop: &mut dyn FnMut(P)) -> Option<P> {
        let Self { packets, bytes, discipline, .. } = self;
        let mut leave = |packet: &P| {
            *packets -= u64::from(packet.packets());
            *bytes -= packet.bytes();
        };
        let packet = match discipline {
            Discipline::DropTail(packets) => packets.pop_front(),
            Discipline::Codel(fifo, codel) => codel.pop(now, fifo, &mut |packet| {
                leave(&packet);
                drop(packet);
            }),
            Discipline::FqCodel(fq) => fq.pop(now, &mut |packet| {
                leave(&packet);
                drop(packet);
            }),
            Discipline::Pie(packets, pie) => {
                let packet = packets.pop_front();
                let waited = packet.as_ref().map_or(Duration::ZERO, |packet| now.since(packet.entered()));
                pie.left(now, waited);
                packet
            }
            Discipline::Red(packets, red) => {
                if packets.is_empty() {
                    red.idle(now);
                }
                packets.pop_front()
            }
        };
        packet.as_ref().map(leave);
        packet
    }

    /// Changes the limit, the discipline and the rate that it serves. The packets stay; another discipline begins anew.
    pub(crate) fn change(&mut self, now: Timestamp, conditions: &Conditions) {
        self.limit = conditions.queue;
        if conditions.queue_discipline != self.parameters {
            let waiting = self.drain();
            self.parameters = conditions.queue_discipline;
            self.discipline = Discipline::new(now, conditions, &mut self.rng);
            waiting.into_iter().for_each(|packet| self.insert(packet));
        }
        if let Discipline::Red(_, red) = &mut self.discipline {
            red.set_rate(&conditions.rate);
        }
    }

    /// Takes all packets out, in the order in which they came.
    pub(crate) fn drain(&mut self) -> Vec<P> {
        (self.packets, self.bytes) = (0, 0);
        match &mut self.discipline {
            Discipline::DropTail(packets) | Discipline::Pie(packets, _) | Discipline::Red(packets, _) => {
                packets.drain(..).collect()
            }
            Discipline::Codel(fifo, _) => fifo.drain().collect(),
            Discipline::FqCodel(fq) => {
                let mut packets: Vec<_> = fq.drain().collect();
                packets.sort_by_key(P::entered);
                packets
            }
        }
    }

    /// Adds a packet, whatever the limit and the discipline say.
    pub(crate) fn insert(&mut self, packet: P) {
        self.packets += u64::from(packet.packets());
        self.bytes += packet.bytes();
        self.discipline.insert(packet);
    }

    fn decide(&mut self, now: Timestamp, packet: &P) -> Verdict {
        let Self { packets, bytes, rng, .. } = self;
        match &mut self.discipline {
            Discipline::DropTail(_) | Discipline::Codel(..) | Discipline::FqCodel(_) => Verdict::Admit,
            Discipline::Pie(_, pie) => pie.decide(now, *bytes, rng),
            Discipline::Red(_, red) => red.decide(now, [*packets, *bytes], packet.bytes(), rng),
        }
    }

    /// Drops from the longest flow until the limit holds (RFC 8290, section 4.1).
    fn shorten(&mut self, drop: &mut dyn FnMut(P)) {
        let Discipline::FqCodel(fq) = &mut self.discipline else { return };
        let exceeds = |packets: u64, bytes: u64| match self.limit {
            QueueLimit::Packets(limit) => packets > u64::from(limit),
            QueueLimit::Bytes(limit) => bytes > limit,
        };
        while exceeds(self.packets, self.bytes) {
            let Some(packet) = fq.pop_longest() else { return };
            self.packets -= u64::from(packet.packets());
            self.bytes -= packet.bytes();
            drop(packet);
        }
    }
}

/// Returns the time to send so many bytes at a rate, or at a trace's mean rate.
fn sending_time(rate: &Rate, bytes: u64) -> Duration {
    Duration::from_secs_f64(bytes as f64 * 8.0 / rate.mean_bits_per_second())
}

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
