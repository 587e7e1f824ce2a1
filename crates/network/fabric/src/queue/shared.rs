//! Queue of a link that several parties share: a class for each reservation, and one for the rest.
//!
//! It shares as Linux's HTB does (`net/sched/sch_htb.c`) with one parent, which is the link. A class has a bucket of tokens
//! for its assured rate, and one for its ceiling. Classes with tokens of their assured rate go first. What these leave over
//! goes to all others below their ceilings, which borrow it from the link. In both groups, classes take turns by bytes
//! (deficit round robin). Unlike in HTB, turns in the first group are one full frame for all, because tokens bound the rates
//! there, and those of borrowers are in proportion to their rates. Each class keeps its packets under the link's own discipline
//! and limit.
//!
//! Without reservations, there is only the queue of the link.

use std::time::Duration;

use cotorra_graph::{BitRate, Conditions, Timestamp};

use super::{FULL_FRAME, Queue, Queued};
use crate::port::PortId;

/// The source and destination of the packets of a class.
pub(crate) type ClassKey = [PortId; 2];

/// A reservation on one direction of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Share {
    pub(crate) key: ClassKey,
    /// The assured rate.
    pub(crate) rate: BitRate,
    /// Whether it sends no faster than that (`ceil` in HTB). Otherwise the link's rate is its ceiling.
    pub(crate) is_limited: bool,
}

/// Least tokens that a bucket holds, bytes: the default of `tc`, which is its default MTU.
const BURST: u64 = 1600;
/// Most bytes that a class sends in a turn (`htb_change_class`).
const LARGEST_QUANTUM: u64 = 200_000;

/// A queue with classes, or one without.
#[derive(Debug)]
pub(crate) struct Shared<P> {
    /// Packets without a reservation.
    rest: Queue<P>,
    classes: Option<Box<Classes<P>>>,
}

/// Classes of reservations, and what the rest may send. The place 0 is that of the rest; those of reservations follow.
#[derive(Debug)]
struct Classes<P> {
    rest: Credit,
    reserved: Vec<Class<P>>,
    /// Places whose turn it is: of those with tokens of their assured rate, and of those that borrow.
    turns: [usize; 2],
    /// Latest time of any call.
    now: Timestamp,
}

#[derive(Debug)]
struct Class<P> {
    share: Share,
    queue: Queue<P>,
    credit: Credit,
}

/// The source of the bytes that a class sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Group {
    /// Its own assured rate.
    Assured = 0,
    /// What others leave over.
    Borrowed = 1,
}

/// What a class may send.
#[derive(Debug)]
struct Credit {
    /// `None` without an assured rate.
    assured: Option<Bucket>,
    /// `None` if only the link limits it.
    ceiling: Option<Bucket>,
    /// Bytes of a turn in each group.
    quanta: [i64; 2],
    /// Bytes left of its turns in each group.
    deficits: [i64; 2],
}

/// A bucket of tokens that fills at a rate, exactly.
#[derive(Debug)]
struct Bucket {
    rate_bps: u64,
    /// Tokens, bits times nanoseconds in a second. Those of a packet that was too large for them are owed.
    tokens: i128,
    /// Most tokens.
    size: i128,
    at: Timestamp,
}

/// Tokens of a byte.
const BYTE: i128 = 8 * 1_000_000_000;

impl Bucket {
    fn full(now: Timestamp, rate_bps: u64, size: i128) -> Self {
        Self { rate_bps, tokens: size, size, at: now }
    }

    fn fill(&mut self, now: Timestamp) {
        let passed = now.since(self.at).as_nanos() as i128;
        self.tokens = self.size.min(self.tokens.saturating_add(passed.saturating_mul(self.rate_bps.into())));
        self.at = self.at.max(now);
    }

    fn may_send(&self) -> bool {
        self.tokens >= 0
    }

    fn take(&mut self, bytes: u64) {
        self.tokens -= i128::from(bytes) * BYTE;
    }

    /// Returns when it has paid what it owes.
    fn due(&self) -> Timestamp {
        let owed = (-self.tokens).max(0) as u128;
        self.at + Duration::from_nanos(owed.div_ceil(self.rate_bps.max(1).into()) as u64)
    }
}

/// Fills `bucket` and sets its rate and size. Creates or removes it, if it shall be or shall not be.
fn set_rate(bucket: &mut Option<Bucket>, now: Timestamp, rate_bps: Option<u64>, size: i128) {
    match (bucket.as_mut(), rate_bps) {
        (Some(bucket), Some(rate_bps)) => {
            bucket.fill(now);
            (bucket.rate_bps, bucket.size) = (rate_bps, size);
        }
        (_, rate_bps) => *bucket = rate_bps.map(|rate_bps| Bucket::full(now, rate_bps, size)),
    }
}

impl Credit {
    fn new() -> Self {
        Self { assured: None, ceiling: None, quanta: [FULL_FRAME as i64; 2], deficits: [0; 2] }
    }

    fn set(&mut self, now: Timestamp, rate_bps: u64, is_limited: bool, quantum: i64, bucket: i128) {
        set_rate(&mut self.assured, now, (rate_bps > 0).then_some(rate_bps), bucket);
        set_rate(&mut self.ceiling, now, is_limited.then_some(rate_bps), bucket);
        self.quanta[Group::Borrowed as usize] = quantum;
    }

    fn fill(&mut self, now: Timestamp) {
        self.assured.iter_mut().chain(&mut self.ceiling).for_each(|bucket| bucket.fill(now));
    }

    /// Returns the group in which it may send; `None` at its ceiling.
    fn group(&self) -> Option<Group> {
        if !self.ceiling.as_ref().is_none_or(Bucket::may_send) {
            return None;
        }
        Some(if self.assured.as_ref().is_some_and(Bucket::may_send) {
            Group::Assured
        } else {
            Group::Borrowed
        })
    }

    /// Accounts for a packet. Returns whether its turn is over.
    fn charge(&mut self, group: Group, bytes: u64) -> bool {
        if let (Group::Assured, Some(assured)) = (group, &mut self.assured) {
            assured.take(bytes);
        }
        if let Some(ceiling) = &mut self.ceiling {
            ceiling.take(bytes);
        }
        let deficit = &mut self.deficits[group as usize];
        *deficit -= bytes as i64;
        let is_over = *deficit < 0;
        if is_over {
            *deficit += self.quanta[group as usize];
        }
        is_over
    }
}

impl<P> Classes<P> {
    fn place(&self, key: Option<ClassKey>) -> usize {
        let reserved = key.and_then(|key| self.reserved.iter().position(|class| class.share.key == key));
        reserved.map_or(0, |index| index + 1)
    }

    fn credit(&mut self, place: usize) -> &mut Credit {
        match place {
            0 => &mut self.rest,
            _ => &mut self.reserved[place - 1].credit,
        }
    }

    /// Sets the assured rates, and the bytes of borrowers' turns. The rest has what is not reserved.
    fn divide(&mut self, now: Timestamp, capacity_bps: f64) {
        let reserved: u64 =
            self.reserved.iter().map(|class| class.share.rate.bits_per_second()).fold(0, u64::saturating_add);
        let left = (capacity_bps as u64).saturating_sub(reserved);
        let rates = self.reserved.iter().map(|class| class.share.rate.bits_per_second());
        let least = rates.chain((left > 0).then_some(left)).min().unwrap_or(1).max(1);
        // The smallest turn is one full frame, so that a round is as short as it can be.
        let quantum = |rate: u64| {
            let bytes = u128::from(FULL_FRAME) * u128::from(rate) / u128::from(least);
            bytes.clamp(FULL_FRAME.into(), LARGEST_QUANTUM.into()) as i64
        };
        // A class loses no tokens while each other one has its turn.
        let round = f64::from(FULL_FRAME as u32) * (self.reserved.len() + 1) as f64;
        let bucket =
            |rate: u64| (BURST as f64 + round * (rate as f64 / capacity_bps).min(1.0)) as i128 * BYTE;
        self.rest.set(now, left, false, quantum(left), bucket(left));
        for class in &mut self.reserved {
            let rate = class.share.rate.bits_per_second();
            class.credit.set(now, rate, class.share.is_limited, quantum(rate), bucket(rate));
        }
    }
}

impl<P: Queued> Shared<P> {
    /// Creates a queue without reservations.
    pub(crate) fn new(rest: Queue<P>) -> Self {
        Self { rest, classes: None }
    }

    /// Whether there are reservations.
    pub(crate) fn is_shared(&self) -> bool {
        self.classes.is_some()
    }

    /// Returns how many packets wait.
    pub(crate) fn packets(&self) -> u64 {
        self.queues().map(Queue::packets).sum()
    }

    /// Returns the packets that wait, in no particular order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &P> {
        self.queues().flat_map(Queue::iter)
    }

    /// Whether there is room for a packet.
    pub(crate) fn fits(&self, packet: &P) -> bool {
        let place = self.place(packet);
        self.queues().nth(place).is_some_and(|queue| queue.fits(packet))
    }

    /// Adds a packet that has to wait. Calls `drop` with every packet that the queue drops.
    pub(crate) fn push(&mut self, now: Timestamp, packet: P, drop: &mut dyn FnMut(P)) {
        let place = self.place(&packet);
        self.queue_mut(place).push(now, packet, drop);
    }

    /// Takes a packet to the idle transmitter, whatever the limit. Returns it, unless it has to wait below its ceiling or the
    /// discipline drops it.
    pub(crate) fn pass(&mut self, now: Timestamp, packet: P, drop: &mut dyn FnMut(P)) -> Option<P> {
        let place = self.place(&packet);
        let Some(classes) = &mut self.classes else { return self.rest.pass(now, packet, drop) };
        classes.now = now;
        let credit = classes.credit(place);
        credit.fill(now);
        let group = credit.group();
        let queue = self.queue_mut(place);
        let Some(group) = group.filter(|_| queue.packets() == 0) else {
            queue.push(now, packet, drop);
            return None;
        };
        let packet = queue.pass(now, packet, drop)?;
        self.charge(place, group, packet.bytes());
        Some(packet)
    }

    /// Takes the next packet to send. Calls `drop` with every packet that the queue drops instead. Without a packet, the
    /// transmitter is idle from `now` on, until [`Self::due`].
    pub(crate) fn pop(&mut self, now: Timestamp, drop: &mut dyn FnMut(P)) -> Option<P> {
        if self.classes.is_none() {
            return self.rest.pop(now, drop);
        }
        while let Some((group, place)) = self.next(now) {
            if let Some(packet) = self.queue_mut(place).pop(now, drop) {
                self.charge(place, group, packet.bytes());
                return Some(packet);
            }
        }
        // Empty queues learn that they are idle.
        let places = self.queues().count();
        for place in 0..places {
            let queue = self.queue_mut(place);
            if queue.packets() == 0 {
                queue.pop(now, drop);
            }
        }
        None
    }

    /// Returns when the idle transmitter can send a packet that waits below its ceiling.
    pub(crate) fn due(&self) -> Option<Timestamp> {
        let classes = self.classes.as_ref()?;
        let rest = (self.rest.packets() > 0).then_some(classes.now);
        let waiting = classes.reserved.iter().filter(|class| class.queue.packets() > 0);
        let due = |class: &Class<P>| class.credit.ceiling.as_ref().map_or(classes.now, Bucket::due);
        waiting.map(|class| due(class).max(classes.now)).chain(rest).min()
    }

    /// Changes the limit, the discipline and the rate that it serves. The packets stay; another discipline begins anew.
    pub(crate) fn change(&mut self, now: Timestamp, conditions: &Conditions, capacity_bps: f64) {
        self.rest.change(now, conditions);
        if let Some(classes) = &mut self.classes {
            classes.reserved.iter_mut().for_each(|class| class.queue.change(now, conditions));
            classes.divide(now, capacity_bps);
        }
    }

    /// Replaces the reservations. The packets stay, in their order. Classes that stay keep their tokens.
    pub(crate) fn reserve(
        &mut self,
        now: Timestamp,
        shares: &[Share],
        conditions: &Conditions,
        capacity_bps: f64,
    ) {
        let before = self.classes.as_ref().map(|classes| &classes.reserved[..]).unwrap_or_default();
        let are_same = before.iter().map(|class| class.share.key).eq(shares.iter().map(|share| share.key));
        let waiting = if are_same { Vec::new() } else { self.drain() };
        let (rest, before) = match self.classes.take() {
            Some(classes) => (classes.rest, classes.reserved),
            None => (Credit::new(), Vec::new()),
        };
        if !shares.is_empty() {
            let mut before: Vec<_> = before.into_iter().map(Some).collect();
            let class = |share: &Share| {
                let own = |class: &&mut Option<Class<P>>| {
                    class.as_ref().is_some_and(|class| class.share.key == share.key)
                };
                match before.iter_mut().find(own).and_then(Option::take) {
                    Some(class) => Class { share: *share, ..class },
                    None => {
                        let queue = Queue::new(now, conditions, self.rest.rng.fork());
                        Class { share: *share, queue, credit: Credit::new() }
                    }
                }
            };
            let reserved = shares.iter().map(class).collect();
            let mut classes = Classes { rest, reserved, turns: [0; 2], now };
            classes.divide(now, capacity_bps);
            self.classes = Some(Box::new(classes));
        }
        waiting.into_iter().for_each(|packet| self.insert(packet));
    }

    /// Takes all packets out, in the order in which they came.
    pub(crate) fn drain(&mut self) -> Vec<P> {
        let mut packets = self.rest.drain();
        if let Some(classes) = &mut self.classes {
            packets.extend(classes.reserved.iter_mut().flat_map(|class| class.queue.drain()));
            packets.sort_by_key(P::entered);
        }
        packets
    }

    /// Adds a packet, whatever the limit and the discipline say.
    pub(crate) fn insert(&mut self, packet: P) {
        let place = self.place(&packet);
        self.queue_mut(place).insert(packet);
    }

    /// Returns the class whose turn it is.
    fn next(&mut self, now: Timestamp) -> Option<(Group, usize)> {
        let Self { rest, classes } = self;
        let classes = classes.as_mut()?;
        classes.now = now;
        let places = classes.reserved.len() + 1;
        let mut borrows = None;
        let distance = |turn: usize, place: usize| (place + places - turn) % places;
        let mut assured = None;
        for place in 0..places {
            let waits = match place {
                0 => rest.packets(),
                _ => classes.reserved[place - 1].queue.packets(),
            };
            if waits == 0 {
                continue;
            }
            let credit = classes.credit(place);
            credit.fill(now);
            let (best, group) = match credit.group() {
                Some(Group::Assured) => (&mut assured, Group::Assured),
                Some(Group::Borrowed) => (&mut borrows, Group::Borrowed),
                None => continue,
            };
            let turn = classes.turns[group as usize];
            if best.is_none_or(|best| distance(turn, place) < distance(turn, best)) {
                *best = Some(place);
            }
        }
        let (group, place) = match (assured, borrows) {
            (Some(place), _) => (Group::Assured, place),
            (None, place) => (Group::Borrowed, place?),
        };
        classes.turns[group as usize] = place;
        Some((group, place))
    }

    /// Accounts for a packet that a class sends.
    fn charge(&mut self, place: usize, group: Group, bytes: u64) {
        let Some(classes) = &mut self.classes else { return };
        if classes.credit(place).charge(group, bytes) {
            classes.turns[group as usize] = (place + 1) % (classes.reserved.len() + 1);
        }
    }

    fn place(&self, packet: &P) -> usize {
        self.classes.as_ref().map_or(0, |classes| classes.place(packet.class()))
    }

    fn queues(&self) -> impl Iterator<Item = &Queue<P>> {
        let reserved = self.classes.as_ref().map(|classes| &classes.reserved[..]).unwrap_or_default();
        std::iter::once(&self.rest).chain(reserved.iter().map(|class| &class.queue))
    }

    fn queue_mut(&mut self, place: usize) -> &mut Queue<P> {
        match (&mut self.classes, place) {
            (Some(classes), 1..) => &mut classes.reserved[place - 1].queue,
            _ => &mut self.rest,
        }
    }
}

#[cfg(test)]
mod tests;
