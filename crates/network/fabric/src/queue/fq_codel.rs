//! FQ-CoDel (RFC 8290): a queue with CoDel for each flow. Flows take turns by bytes (deficit round robin), and those that
//! have just begun go first.

use std::collections::{HashMap, VecDeque};

use cotorra_graph::{FqCodel as Parameters, Timestamp};

use super::{Queued, codel::Codel, fifo::Fifo};

/// Queues of flows.
#[derive(Debug)]
pub(super) struct FqCodel<P> {
    parameters: Parameters,
    /// Varies which flows share a queue.
    salt: u64,
    /// Queues that were in use, by the number that flows are hashed to.
    numbers: HashMap<u64, usize>,
    flows: Vec<Flow<P>>,
    /// Queues of flows that have just begun, and all others that have packets, in the order of their turns.
    new: VecDeque<usize>,
    old: VecDeque<usize>,
}

/// The queue of a flow, or of several with the same hash.
#[derive(Debug)]
struct Flow<P> {
    queue: Fifo<P>,
    codel: Codel,
    /// Bytes that it may send in this round.
    credits: i64,
    /// Whether it is in one of the lists.
    is_listed: bool,
}

impl<P: Queued> FqCodel<P> {
    pub fn new(parameters: Parameters, salt: u64) -> Self {
        let (new, old) = (VecDeque::new(), VecDeque::new());
        Self { parameters, salt, numbers: HashMap::new(), flows: Vec::new(), new, old }
    }

    /// Adds a packet to the queue of its flow (RFC 8290, section 4.1).
    pub fn push(&mut self, packet: P) {
        let place = self.place(packet.flow());
        let flow = &mut self.flows[place];
        flow.queue.push(packet);
        if !flow.is_listed {
            (flow.is_listed, flow.credits) = (true, self.parameters.quantum.into());
            self.new.push_back(place);
        }
    }

    /// Takes the next packet to send (RFC 8290, section 4.2). Calls `drop` with every packet that CoDel drops before it.
    pub fn pop(&mut self, now: Timestamp, drop: &mut dyn FnMut(P)) -> Option<P> {
        loop {
            let is_new = !self.new.is_empty();
            let list = if is_new { &mut self.new } else { &mut self.old };
            let place = *list.front()?;
            let flow = &mut self.flows[place];
            if flow.credits <= 0 {
                flow.credits += i64::from(self.parameters.quantum);
            } else if let Some(packet) = flow.codel.pop(now, &mut flow.queue, drop) {
                flow.credits -= packet.bytes() as i64;
                return Some(packet);
            } else if !is_new {
                flow.is_listed = false;
                list.pop_front();
                continue;
            }
            // An empty new queue goes to the old ones, too. Otherwise its next packet would come before theirs again.
            list.pop_front();
            self.old.push_back(place);
        }
    }

    /// Takes the first packet of the queue with the most bytes.
    pub fn pop_longest(&mut self) -> Option<P> {
        let listed = self.new.iter().chain(&self.old).copied();
        let longest = listed.rev().max_by_key(|place| self.flows[*place].queue.bytes())?;
        self.flows[longest].queue.pop()
    }

    pub fn iter(&self) -> impl Iterator<Item = &P> {
        self.flows.iter().flat_map(|flow| flow.queue.iter())
    }

    /// Takes all packets out.
    pub fn drain(&mut self) -> impl Iterator<Item = P> {
        self.flows.iter_mut().flat_map(|flow| flow.queue.drain())
    }

    fn place(&mut self, flow: u64) -> usize {
        let number = mixed(flow ^ self.salt) % u64::from(self.parameters.flows);
        let Self { numbers, flows, parameters, .. } = self;
        *numbers.entry(number).or_insert_with(|| {
            let codel = Codel::new(parameters.codel());
            flows.push(Flow { queue: Fifo::default(), codel, credits: 0, is_listed: false });
            flows.len() - 1
        })
    }
}

/// Spreads similar numbers over all 64 bits (the finalizer of SplitMix64, Steele et al., OOPSLA 2014).
fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::testing::{TestPacket, ms, packet};

    fn queues() -> FqCodel<TestPacket> {
        FqCodel::new(Parameters::default(), 1)
    }

    /// Adds packets of a flow, which come now.
    fn add(fq: &mut FqCodel<TestPacket>, flow: u64, packets: u32, bytes: u64) {
        (0..packets).for_each(|number| fq.push(TestPacket { flow, bytes, ..packet(number, ms(0.0)) }));
    }

    /// Takes packets. No time passes, so that CoDel drops none.
    fn take(fq: &mut FqCodel<TestPacket>, packets: usize) -> Vec<TestPacket> {
        let mut pop = || fq.pop(ms(0.0), &mut |packet| panic!("{packet:?} is dropped"));
        (0..packets).map_while(|_| pop()).collect()
    }

    #[test]
    fn a_flow_that_has_just_begun_goes_first() {
        let mut fq = queues();
        add(&mut fq, 1, 10, 1514);
        take(&mut fq, 2);
        add(&mut fq, 2, 1, 100);
        assert_eq!(take(&mut fq, 2).iter().map(|packet| packet.flow).collect::<Vec<_>>(), [2, 1]);
    }

    #[test]
    fn a_sparse_flow_never_waits_for_more_than_one_packet() {
        let mut fq = queues();
        add(&mut fq, 1, 100, 1514);
        // Its one packet leaves before the next one comes, and the empty queue had its turn among the old ones.
        for _ in 0..20 {
            take(&mut fq, 2);
            add(&mut fq, 2, 1, 100);
            assert_eq!(take(&mut fq, 1)[0].flow, 2);
        }
    }

    /// RFC 8290, section 4.2: a queue that empties goes to the old ones, so that its next packet cannot starve them.
    #[test]
    fn an_emptied_new_flow_waits_for_the_old_ones() {
        let mut fq = queues();
        add(&mut fq, 1, 10, 1514);
        take(&mut fq, 1);
        for _ in 0..5 {
            add(&mut fq, 2, 1, 1000);
            let sent = take(&mut fq, 1);
            add(&mut fq, 2, 1, 1000);
            let sent = [sent, take(&mut fq, 2)].concat();
            assert!(sent.iter().any(|packet| packet.flow == 1), "{sent:?}");
        }
    }

    #[test]
    fn flows_get_the_same_bytes_whatever_the_size_of_their_packets() {
        let mut fq = queues();
        add(&mut fq, 1, 2000, 300);
        add(&mut fq, 2, 2000, 1500);
        let sent = take(&mut fq, 1200);
        let bytes = [1, 2].map(|flow| sent.iter().filter(|p| p.flow == flow).map(|p| p.bytes).sum::<u64>());
        assert!(bytes[0].abs_diff(bytes[1]) <= 2 * (1514 + 1500), "{bytes:?}");
    }

    #[test]
    fn a_greedy_flow_delays_no_other() {
        let mut fq = queues();
        add(&mut fq, 1, 1000, 1514);
        add(&mut fq, 2, 5, 1514);
        let sent = take(&mut fq, 11);
        assert_eq!(sent.iter().filter(|packet| packet.flow == 2).count(), 5);
    }

    #[test]
    fn codel_drops_from_the_flow_that_waits() {
        let mut fq = queues();
        let mut dropped = Vec::new();
        for at in (0..2000).map(f64::from) {
            // One packet leaves each millisecond. Flow 1 brings two, flow 2 one every ten milliseconds.
            let due = [2, u32::from(at % 10.0 == 0.0)];
            for (flow, packets) in [1, 2].into_iter().zip(due) {
                (0..packets).for_each(|_| fq.push(TestPacket { flow, ..packet(0, ms(at)) }));
            }
            fq.pop(ms(at), &mut |packet| dropped.push(packet.flow)).unwrap();
        }
        assert!(dropped.len() > 10);
        assert!(dropped.iter().all(|flow| *flow == 1));
    }

    #[test]
    fn the_longest_flow_is_shortened_at_its_head() {
        let mut fq = queues();
        add(&mut fq, 1, 3, 400);
        add(&mut fq, 2, 2, 700);
        assert_eq!(fq.pop_longest().map(|packet| (packet.flow, packet.number)), Some((2, 0)));
        assert_eq!(fq.pop_longest().map(|packet| (packet.flow, packet.number)), Some((1, 0)));
    }

    #[test]
    fn one_queue_for_all_flows_keeps_their_order() {
        let mut fq = FqCodel::new(Parameters { flows: 1, ..Parameters::default() }, 1);
        for number in 0..10 {
            fq.push(TestPacket { flow: u64::from(number), ..packet(number, ms(0.0)) });
        }
        assert!(take(&mut fq, 10).iter().map(|packet| packet.number).eq(0..10));
    }

    #[test]
    fn the_salt_decides_which_flows_share_a_queue() {
        let numbers = |salt| {
            let mut fq = FqCodel::new(Parameters { flows: 16, ..Parameters::default() }, salt);
            (0..32)
                .map(|flow| {
                    fq.push(TestPacket { flow, ..packet(0, ms(0.0)) });
                    fq.place(flow)
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(numbers(1), numbers(1));
        assert_ne!(numbers(1), numbers(2));
    }
}
