//! The next of many deadlines: a binary heap that finds and moves each entry in place. It has one entry per timer, however
//! many packets wait behind it.

use cotorra_graph::Timestamp;

const IDLE: u32 = u32::MAX;

/// One timer for each of a fixed number of owners.
#[derive(Debug)]
pub(crate) struct Timers {
    /// Owners, earliest deadline first; of equal deadlines, the lower number first.
    heap: Vec<u32>,
    /// Index in the heap by owner.
    place: Vec<u32>,
    deadline: Vec<Timestamp>,
}

impl Timers {
    /// Creates a timer for each owner, all unset.
    pub(crate) fn new(owners: usize) -> Self {
        Self { heap: Vec::new(), place: vec![IDLE; owners], deadline: vec![Timestamp::MAX; owners] }
    }

    /// Adds an owner, behind all others.
    pub(crate) fn add(&mut self) {
        self.place.push(IDLE);
        self.deadline.push(Timestamp::MAX);
    }

    /// Returns the next deadline and its owner.
    pub(crate) fn next(&self) -> Option<(Timestamp, usize)> {
        self.heap.first().map(|&owner| (self.deadline[owner as usize], owner as usize))
    }

    /// Returns all deadlines with their owners, in no order.
    pub(crate) fn all(&self) -> impl Iterator<Item = (Timestamp, usize)> + '_ {
        self.heap.iter().map(|&owner| (self.deadline[owner as usize], owner as usize))
    }

    /// Sets, moves or clears an owner's timer.
    pub(crate) fn set(&mut self, owner: usize, deadline: Option<Timestamp>) {
        let place = self.place[owner];
        match (deadline, place) {
            (None, IDLE) => {}
            (None, place) => self.remove(owner, place as usize),
            (Some(deadline), IDLE) => {
                self.deadline[owner] = deadline;
                self.heap.push(owner as u32);
                self.up(self.heap.len() - 1);
            }
            (Some(deadline), place) => {
                let before = std::mem::replace(&mut self.deadline[owner], deadline);
                match deadline.cmp(&before) {
                    std::cmp::Ordering::Less => self.up(place as usize),
                    std::cmp::Ordering::Greater => self.down(place as usize),
                    std::cmp::Ordering::Equal => {}
                }
            }
        }
    }

    fn remove(&mut self, owner: usize, place: usize) {
        self.place[owner] = IDLE;
        let last = self.heap.pop().expect("an owner with a place is in the heap");
        if place < self.heap.len() {
            self.heap[place] = last;
            self.place[last as usize] = place as u32;
            self.up(place);
            self.down(self.place[last as usize] as usize);
        }
    }

    fn key(&self, owner: u32) -> (Timestamp, u32) {
        (self.deadline[owner as usize], owner)
    }

    fn up(&mut self, mut place: usize) {
        let owner = self.heap[place];
        while place > 0 {
            let parent = (place - 1) / 2;
            if self.key(self.heap[parent]) <= self.key(owner) {
                break;
            }
            self.put(place, self.heap[parent]);
            place = parent;
        }
        self.put(place, owner);
    }

    fn down(&mut self, mut place: usize) {
        let owner = self.heap[place];
        loop {
            let mut child = 2 * place + 1;
            if child >= self.heap.len() {
                break;
            }
            if child + 1 < self.heap.len() && self.key(self.heap[child + 1]) < self.key(self.heap[child]) {
                child += 1;
            }
            if self.key(owner) <= self.key(self.heap[child]) {
                break;
            }
            self.put(place, self.heap[child]);
            place = child;
        }
        self.put(place, owner);
    }

    fn put(&mut self, place: usize, owner: u32) {
        self.heap[place] = owner;
        self.place[owner as usize] = place as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn next_is_always_the_earliest(
            changes in prop::collection::vec((0usize..12, prop::option::of(0u64..20)), 0..200),
        ) {
            let mut timers = Timers::new(12);
            let mut model = [None; 12];
            for (owner, deadline) in changes {
                let deadline = deadline.map(Timestamp::from_nanos);
                timers.set(owner, deadline);
                model[owner] = deadline;
                let expected = (0..12).filter_map(|o| model[o].map(|d| (d, o))).min();
                prop_assert_eq!(timers.next(), expected);
            }
        }
    }
}
