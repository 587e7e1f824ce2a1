//! One direction of a wired link: a queue, a transmitter, and a line with the packets in flight. Due times are
//! worked out in the packets' own time, so that a late poll delays only the delivery itself.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{Conditions, Direction, LinkContext, LinkCounters, LinkId, LostCause, Rate, Timestamp};
use cotorra_numbers::Draws;

use crate::{
    balance::Balance,
    frame::Frame,
    impairment::{Impairments, jittered},
    meter::Meter,
    pool::Pool,
    queue::{Queue, Share, Shared},
    routes::Target,
    settings::{Settings, is_impaired, needs_packets},
    trace::DirectedLink,
    transmitter::Transmitter,
};

/// The reason for which a frame crosses a link.
#[derive(Debug, Clone)]
pub(crate) enum Purpose {
    /// It is on its way to a target.
    Target(Target),
    /// It only loads the link.
    FromEndToEnd,
    /// It measures the link's delay, jitter and loss.
    Probe,
    /// It measures the link's throughput.
    ThroughputTest,
}

/// A frame on its way through the fabric.
#[derive(Debug)]
pub(crate) struct Packet {
    pub(crate) frame: Frame,
    pub(crate) purpose: Purpose,
    /// Time of entering the current link.
    pub(crate) entered: Timestamp,
    /// Start of its transmission over the link.
    pub(crate) began: Timestamp,
}

impl Packet {
    /// Creates a packet that enters a link now.
    pub(crate) fn new(frame: Frame, purpose: Purpose, now: Timestamp) -> Self {
        Self { frame, purpose, entered: now, began: now }
    }

    /// Whether the link's counters include it. Packets that only measure are not counted.
    pub(crate) fn counts(&self) -> bool {
        matches!(self.purpose, Purpose::Target(_) | Purpose::FromEndToEnd)
    }

    fn copy(&self, pool: &mut Pool) -> Self {
        let Self { frame, purpose, entered, began } = self;
        Self { frame: frame.copy(pool), purpose: purpose.clone(), entered: *entered, began: *began }
    }
}

/// A packet on the line of a link.
#[derive(Debug)]
struct InFlight {
    due: Timestamp,
    sent: Timestamp,
    /// Deviation of its delay, in units of the jitter's deviation.
    deviate: f64,
    packet: Packet,
}

/// One direction of a wired link.
#[derive(Debug)]
pub(crate) struct Pipe {
    /// Its name in the ways of frames.
    link: DirectedLink,
    settings: Settings,
    impairments: Impairments,
    transmitter: Transmitter<Packet>,
    queue: Shared<Packet>,
    /// In order of `due`.
    line: VecDeque<InFlight>,
    /// Whether packets pass at once and unchanged while the line is empty.
    clear: bool,
    needs_packets: bool,
    impaired: bool,
    meter: Meter,
    /// Buffer for the packets that a super-packet is cut into.
    cut: Vec<Packet>,
}

impl Pipe {
    /// Creates an empty pipe that draws the random numbers of its impairments and of its queue from a stream each.
    pub(crate) fn new(link: DirectedLink, settings: Settings, rng: Draws, queue_rng: Draws) -> Self {
        let conditions = settings.effective();
        Self {
            link,
            impairments: Impairments::new(conditions, rng),
            transmitter: Transmitter::new(&conditions.rate, Timestamp::ZERO),
            queue: Shared::new(Queue::new(Timestamp::ZERO, conditions, queue_rng)),
            line: VecDeque::new(),
            clear: is_clear(conditions),
            needs_packets: needs_packets(conditions),
            impaired: is_impaired(conditions),
            meter: Meter::default(),
            cut: Vec::new(),
            settings,
        }
    }

    /// Returns its settings.
    pub(crate) fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the counters since the run began.
    pub(crate) fn counters(&self) -> &LinkCounters {
        &self.meter.counters
    }

    /// Returns the number of packets in it, counted as they are on the wire.
    pub(crate) fn in_flight(&self) -> u64 {
        let line: u64 = self.line.iter().map(|f| u64::from(f.packet.frame.wire_packets())).sum();
        self.waiting() + line
    }

    /// Returns the number of packets that wait or are being sent.
    pub(crate) fn waiting(&self) -> u64 {
        let sending = self.transmitter.sending().map_or(0, |p| u64::from(p.frame.wire_packets()));
        self.queue.packets() + sending
    }

    /// Returns the outcome of all packets that entered it, without those that only measure.
    pub(crate) fn balance(&self) -> Balance {
        let waiting = self.queue.iter().chain(self.transmitter.sending());
        let all = waiting.chain(self.line.iter().map(|flying| &flying.packet));
        let under_way = all.filter(|packet| packet.counts()).map(|p| u64::from(p.frame.wire_packets())).sum();
        Balance { under_way, ..self.meter.counters.into() }
    }

    /// Returns d, λ, the longest queue, conditions and counters of this direction of the link.
    pub(crate) fn context(&self, now: Timestamp, link: LinkId, direction: Direction) -> LinkContext {
        LinkContext {
            link,
            direction,
            delay: self.meter.delay(now),
            throughput_bps: self.meter.throughput_bps(now),
            queued_packets: Some(self.meter.most_queued(now, self.queue.packets())),
            probed: None,
            tested: None,
            asked: self.settings.asked().clone(),
            scale: self.settings.scale(),
            effective: self.settings.effective().clone(),
            counters: self.meter.counters,
        }
    }

    /// Adds a packet. Returns it if it has crossed already, because nothing delays it.
    pub(crate) fn push(&mut self, now: Timestamp, mut packet: Packet, pool: &mut Pool) -> Option<Packet> {
        if self.clear && self.line.is_empty() {
            self.count_crossing(&packet, now);
            return Some(packet);
        }
        (packet.entered, packet.began) = (now, now);
        let whole = !self.needs_packets && (!self.transmitter.is_busy() || self.queue.fits(&packet));
        if whole {
            self.enter(now, packet, pool);
        } else {
            self.for_each_packet(packet, pool, |pipe, packet, pool| pipe.enter(now, packet, pool));
        }
        None
    }

    /// Returns when [`Self::poll`] is due.
    pub(crate) fn deadline(&self) -> Option<Timestamp> {
        let due = self.line.front().map(|f| f.due);
        match (self.next_sent(), due) {
            (Some(sent), Some(due)) => Some(sent.min(due)),
            (sent, due) => sent.or(due),
        }
    }

    /// Returns when the transmitter has sent its packet, or can send one that waits below the ceiling of its reservation.
    fn next_sent(&self) -> Option<Timestamp> {
        if self.transmitter.is_busy() { self.transmitter.deadline() } else { self.queue.due() }
    }

    /// Takes the next packet that has crossed by the deadline `at`.
    pub(crate) fn poll(&mut self, at: Timestamp, pool: &mut Pool) -> Option<Packet> {
        loop {
            if let Some((packet, sent)) = self.transmitter.finish(at) {
                self.depart(sent, packet, pool);
                self.send_queued(sent, pool);
            } else if !self.transmitter.is_busy()
                && let Some(due) = self.queue.due().filter(|due| *due <= at)
            {
                self.begin_queued(due, pool);
            } else {
                break;
            }
        }
        if self.line.front()?.due > at {
            return None;
        }
        let InFlight { due, packet, .. } = self.line.pop_front()?;
        self.count_crossing(&packet, due);
        Some(packet)
    }

    fn count_crossing(&mut self, packet: &Packet, left: Timestamp) {
        if packet.counts() {
            let frame = &packet.frame;
            self.meter.crossed(packet.entered, left, frame.wire_packets(), frame.wire_bytes());
        }
    }

    /// Changes the settings. The caller has polled everything due by `now`.
    pub(crate) fn change(&mut self, now: Timestamp, settings: Settings, pool: &mut Pool) {
        let shorter = settings.effective().delay < self.settings.effective().delay
            || settings.effective().jitter != self.settings.effective().jitter;
        let other_rate = settings.effective().rate != self.settings.effective().rate;
        self.settings = settings;
        let conditions = self.settings.effective();
        self.impairments.change(conditions);
        self.impaired = is_impaired(conditions);
        self.choose_way(pool);
        self.queue.change(now, self.settings.effective(), self.settings.capacity_bps());
        if shorter {
            self.pull_forward(now);
        }
        if other_rate {
            let stopped = self.transmitter.stop(now);
            self.transmitter = Transmitter::new(&self.settings.effective().rate, now);
            if let Some((packet, bits)) = stopped {
                self.transmitter.wake(now);
                self.send(now, packet, bits, pool);
                self.send_queued(now, pool);
            }
        }
    }

    /// Whether there are reservations.
    pub(crate) fn is_shared(&self) -> bool {
        self.queue.is_shared()
    }

    /// Replaces the reservations. The caller has polled everything due by `now`.
    pub(crate) fn reserve(&mut self, now: Timestamp, shares: &[Share], pool: &mut Pool) {
        if shares.is_empty() && !self.queue.is_shared() {
            return;
        }
        self.queue.reserve(now, shares, self.settings.effective(), self.settings.capacity_bps());
        self.choose_way(pool);
        if !self.transmitter.is_busy() {
            self.begin_queued(now, pool);
        }
    }

    /// Chooses whether packets pass at once, and whether super-packets stay whole. Cuts those that wait, if not.
    fn choose_way(&mut self, pool: &mut Pool) {
        let (conditions, is_shared) = (self.settings.effective(), self.queue.is_shared());
        self.clear = is_clear(conditions) && !is_shared;
        self.needs_packets = needs_packets(conditions) || is_shared;
        if self.needs_packets {
            for packet in self.queue.drain() {
                self.for_each_packet(packet, pool, |pipe, packet, _| pipe.queue.insert(packet));
            }
        }
    }

    fn enter(&mut self, now: Timestamp, packet: Packet, pool: &mut Pool) {
        let Self { queue, meter, link, .. } = self;
        let mut drop = |packet| drop_packet(meter, *link, packet, pool);
        if self.transmitter.is_busy() {
            queue.push(now, packet, &mut drop);
        } else if let Some(packet) = queue.pass(now, packet, &mut drop) {
            self.transmitter.wake(now);
            let bits = packet.frame.wire_bytes() * 8;
            self.send(now, packet, bits, pool);
        }
    }

    /// Starts to send the last `bits` of a packet.
    fn send(&mut self, now: Timestamp, packet: Packet, bits: u64, pool: &mut Pool) {
        if let Some(packet) = self.transmitter.begin(now, packet, bits) {
            self.depart(now, packet, pool);
        }
    }

    /// Wakes the idle transmitter for packets of the queue.
    fn begin_queued(&mut self, now: Timestamp, pool: &mut Pool) {
        self.transmitter.wake(now);
        self.send_queued(now, pool);
    }

    /// Starts to send the next packet of the queue, or all that it may send if that takes no time.
    fn send_queued(&mut self, now: Timestamp, pool: &mut Pool) {
        while !self.transmitter.is_busy() {
            // A queue was longest just before a packet left it.
            let waiting = self.queue.packets();
            if waiting > 0 {
                self.meter.queued(now, waiting);
            }
            let Self { queue, meter, link, .. } = self;
            let mut drop = |packet| drop_packet(meter, *link, packet, pool);
            let Some(mut packet) = queue.pop(now, &mut drop) else { return };
            packet.began = now;
            let bits = packet.frame.wire_bytes() * 8;
            self.send(now, packet, bits, pool);
        }
    }

    /// Calls `each` with every packet that this one is on the wire.
    fn for_each_packet(
        &mut self,
        packet: Packet,
        pool: &mut Pool,
        mut each: impl FnMut(&mut Self, Packet, &mut Pool),
    ) {
        if packet.frame.offload().segmentation.is_none() {
            return each(self, packet, pool);
        }
        let mut cut = std::mem::take(&mut self.cut);
        let Packet { frame, purpose, entered, began } = packet;
        frame
            .segment_with(pool, |frame| cut.push(Packet { frame, purpose: purpose.clone(), entered, began }))
            .expect("a frame's offload is checked where it enters the fabric");
        cut.drain(..).for_each(|packet| each(self, packet, pool));
        self.cut = cut;
    }

    /// Applies the random impairments to a sent packet and puts the rest on the line.
    fn depart(&mut self, sent: Timestamp, packet: Packet, pool: &mut Pool) {
        if self.impaired {
            self.for_each_packet(packet, pool, |pipe, packet, pool| pipe.impair(sent, packet, pool));
        } else {
            self.line_up(sent, 0.0, packet);
        }
    }

    fn impair(&mut self, sent: Timestamp, mut packet: Packet, pool: &mut Pool) {
        let counts = u64::from(packet.counts());
        if self.impairments.loses() {
            self.meter.counters.lost += counts;
            packet.frame.end(Some(self.link), LostCause::Loss);
            return pool.discard(packet.frame);
        }
        if self.impairments.corrupts(&mut packet.frame) {
            self.meter.counters.corrupted += counts;
            packet.frame.end(Some(self.link), LostCause::Corruption);
        }
        let copy = self.impairments.duplicates().then(|| packet.copy(pool));
        self.meter.counters.duplicated += counts * u64::from(copy.is_some());
        if self.impairments.reorders() {
            for packet in [Some(packet), copy].into_iter().flatten() {
                self.overtake(sent, packet);
            }
        } else {
            let deviate = self.impairments.deviate(sent);
            for packet in [Some(packet), copy].into_iter().flatten() {
                self.line_up(sent, deviate, packet);
            }
        }
    }

    /// Adds a packet to the end of the line, due no earlier than the one before.
    fn line_up(&mut self, sent: Timestamp, deviate: f64, packet: Packet) {
        let due = sent + self.delay(deviate);
        let due = self.line.back().map_or(due, |before| due.max(before.due));
        self.line.push_back(InFlight { due, sent, deviate, packet });
    }

    /// Adds a packet to the head of the line, behind those that are due.
    fn overtake(&mut self, sent: Timestamp, packet: Packet) {
        let place = self.line.partition_point(|f| f.due <= sent);
        self.line.insert(place, InFlight { due: sent, sent, deviate: 0.0, packet });
    }

    fn delay(&self, deviate: f64) -> Duration {
        let Conditions { delay, jitter, .. } = self.settings.effective();
        jittered(*delay, deviate, *jitter)
    }

    /// Applies a shorter delay to the packets on the line, so that later ones need not wait for them.
    fn pull_forward(&mut self, now: Timestamp) {
        let mut before = now;
        for i in 0..self.line.len() {
            let InFlight { due, sent, deviate, .. } = self.line[i];
            let due = due.min(sent + self.delay(deviate)).max(before);
            self.line[i].due = due;
            before = due;
        }
    }
}

/// Counts a packet that the queue dropped, and frees its buffer.
fn drop_packet(meter: &mut Meter, link: DirectedLink, mut packet: Packet, pool: &mut Pool) {
    packet.frame.end(Some(link), LostCause::FullQueue);
    if packet.counts() {
        meter.counters.overflowed += u64::from(packet.frame.wire_packets());
    }
    pool.discard(packet.frame);
}

/// Whether a link with these conditions passes packets at once and unchanged.
fn is_clear(conditions: &Conditions) -> bool {
    conditions.delay.is_zero() && conditions.rate == Rate::Unlimited && !is_impaired(conditions)
}
