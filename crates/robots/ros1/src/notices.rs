//! Notices of a master that wait to be sent: those for each address in order, and the addresses in turn.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    net::IpAddr,
};

use crate::registry::Notice;

/// Most notices that wait for one address. The oldest are dropped.
const MOST_OF_ADDRESS: usize = 4096;

/// The notices that wait. One at a time is under way for each address that registered nodes, so that nodes that do not answer
/// only delay those of their own address.
#[derive(Debug, Default)]
pub(crate) struct Notices {
    queues: BTreeMap<IpAddr, Queue>,
    busy: BTreeSet<IpAddr>,
    /// The address that had its turn last.
    last: Option<IpAddr>,
}

#[derive(Debug, Default)]
struct Queue {
    order: VecDeque<Notice>,
    waiting: BTreeSet<Notice>,
}

impl Notices {
    /// Adds a notice, unless the same one waits.
    pub fn push(&mut self, notice: Notice) {
        let queue = self.queues.entry(notice.owner).or_default();
        if !queue.waiting.insert(notice.clone()) {
            return;
        }
        queue.order.push_back(notice);
        if queue.order.len() > MOST_OF_ADDRESS
            && let Some(oldest) = queue.order.pop_front()
        {
            queue.waiting.remove(&oldest);
        }
    }

    /// Returns the next notice of an address for which none is under way. Call [`Self::done`] when it was sent.
    pub fn next(&mut self) -> Option<Notice> {
        let is_free = |address: &&IpAddr| !self.busy.contains(address);
        let after = self.queues.keys().filter(|address| self.last.is_none_or(|last| **address > last));
        let address = after.chain(self.queues.keys()).find(is_free).copied()?;
        let queue = self.queues.get_mut(&address)?;
        let notice = queue.order.pop_front()?;
        queue.waiting.remove(&notice);
        if queue.order.is_empty() {
            self.queues.remove(&address);
        }
        self.busy.insert(address);
        self.last = Some(address);
        Some(notice)
    }

    /// Records that a notice was sent, or could not be.
    pub fn done(&mut self, address: IpAddr) {
        self.busy.remove(&address);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::About;

    fn notice(owner: u8, topic: usize) -> Notice {
        let about = About::Publishers(format!("/t{topic}"));
        Notice { owner: IpAddr::from([10, 77, 0, owner]), node: "http://n:1/".to_owned(), about }
    }

    #[test]
    fn addresses_take_turns_with_one_notice_each_under_way() {
        let mut notices = Notices::default();
        (0..3).for_each(|topic| notices.push(notice(1, topic)));
        notices.push(notice(2, 7));
        assert_eq!(notices.next(), Some(notice(1, 0)));
        assert_eq!(notices.next(), Some(notice(2, 7)));
        assert_eq!(notices.next(), None, "the first address is busy");
        notices.push(notice(2, 8));
        notices.done(notice(2, 0).owner);
        assert_eq!((notices.next(), notices.next()), (Some(notice(2, 8)), None));
        notices.done(notice(1, 0).owner);
        assert_eq!(notices.next(), Some(notice(1, 1)));
    }

    #[test]
    fn the_same_notice_waits_once_and_no_address_has_too_many() {
        let mut notices = Notices::default();
        (0..10).for_each(|_| notices.push(notice(1, 0)));
        assert_eq!((notices.next(), notices.next()), (Some(notice(1, 0)), None));
        notices.push(notice(1, 0));
        assert!(!notices.queues.is_empty(), "it changed while it was sent");
        (0..3 * MOST_OF_ADDRESS).for_each(|topic| notices.push(notice(1, topic)));
        let queue = &notices.queues[&notice(1, 0).owner];
        assert_eq!((queue.order.len(), queue.waiting.len()), (MOST_OF_ADDRESS, MOST_OF_ADDRESS));
    }
}
