use std::{collections::VecDeque, time::Duration};

use super::*;

/// Carries frames of two hosts with this delay, and loses each of these numbers. Returns when all copies have arrived.
fn carry(copies: &mut Copies, ids: &[CopyId], mut now: Timestamp, lost: impl Fn(u64) -> bool) -> Timestamp {
    const DELAY: Duration = Duration::from_millis(5);
    let (mut flying, mut number) = (VecDeque::new(), 0);
    loop {
        let mut frame = Vec::new();
        while let Some(from) = copies.poll(now, &mut frame) {
            if !lost(number) {
                flying.push_back((now + DELAY, 1 - from, std::mem::take(&mut frame)));
            }
            number += 1;
        }
        if ids.iter().all(|id| copies.has_arrived(*id)) {
            return now;
        }
        let arrival = flying.front().map(|(at, ..)| *at);
        now = now.max(copies.deadline(now).into_iter().chain(arrival).min().unwrap());
        while let Some((_, host, frame)) = flying.pop_front_if(|(at, ..)| *at <= now) {
            assert!(copies.handle(now, host, &frame).is_some());
        }
    }
}

#[test]
fn all_bytes_arrive_also_of_data_that_is_added_later() {
    for lost in [|_| false, |number| number % 50 == 7] {
        let mut copies = Copies::default();
        let ids = [copies.begin(0, 1).unwrap(), copies.begin(0, 1).unwrap(), copies.begin(1, 0).unwrap()];
        ids.iter().for_each(|id| copies.add(*id, 1_000_000));
        let first = carry(&mut copies, &ids, Timestamp::ZERO, lost);
        assert_eq!(ids.map(|id| copies.arrived(id)), [1_000_000; 3]);
        copies.add(ids[1], 1);
        assert!(!copies.has_arrived(ids[1]));
        let second = carry(&mut copies, &ids, first, lost);
        assert_eq!(ids.map(|id| copies.arrived(id)), [1_000_000, 1_000_001, 1_000_000]);
        assert!(second > first);
    }
}

#[test]
fn an_ended_copy_sends_nothing_and_takes_no_frames() {
    let mut copies = Copies::default();
    let id = copies.begin(0, 1).unwrap();
    copies.add(id, 10);
    let mut frame = Vec::new();
    assert_eq!(copies.poll(Timestamp::ZERO, &mut frame), Some(0));
    assert_eq!(copies.handle(Timestamp::ZERO, 0, &frame), None, "the sender's own frame");
    copies.end(id);
    assert_eq!(copies.handle(Timestamp::ZERO, 1, &frame), None);
    assert_eq!((copies.deadline(Timestamp::ZERO), copies.poll(Timestamp::ZERO, &mut frame)), (None, None));
    assert_ne!(copies.begin(0, 1), Some(id), "late frames of a former copy are not the next one's");
}

#[test]
fn there_is_a_bound_on_open_copies() {
    let mut copies = Copies::default();
    let all: Vec<_> = std::iter::from_fn(|| copies.begin(0, 1)).collect();
    assert_eq!(all.len(), usize::from(PORTS));
    copies.end(all[77]);
    assert_eq!((copies.begin(0, 1), copies.begin(0, 1)), (Some(all[77]), None));
}
