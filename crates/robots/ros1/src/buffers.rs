//! Bytes that a node or a master holds for its peers: calls, answers and messages that have not arrived in full.

use std::{collections::BTreeMap, net::IpAddr, sync::Arc};

use parking_lot::Mutex;

/// The bytes by the address of the peer.
#[derive(Debug)]
pub(crate) struct Held {
    most: usize,
    most_of_address: usize,
    by_address: Mutex<BTreeMap<IpAddr, usize>>,
}

impl Held {
    /// Bounds the bytes for all peers, and for those at one address.
    pub fn new(most: usize, most_of_address: usize) -> Arc<Self> {
        Arc::new(Self { most, most_of_address, by_address: Mutex::default() })
    }
}

/// The part of one connection, which it returns when it is dropped.
#[derive(Debug)]
pub(crate) struct Buffers {
    held: Arc<Held>,
    from: IpAddr,
    bytes: usize,
}

impl Buffers {
    pub fn new(held: &Arc<Held>, from: IpAddr) -> Self {
        Self { held: Arc::clone(held), from, bytes: 0 }
    }

    /// Changes what this connection holds. Returns whether there is room for it; nothing has changed otherwise.
    pub fn hold(&mut self, bytes: usize) -> bool {
        let Held { most, most_of_address, by_address } = &*self.held;
        let mut held = by_address.lock();
        let of_address = held.get(&self.from).copied().unwrap_or_default() - self.bytes + bytes;
        let all = held.values().sum::<usize>() - self.bytes + bytes;
        if bytes > self.bytes && (of_address > *most_of_address || all > *most) {
            return false;
        }
        match of_address {
            0 => drop(held.remove(&self.from)),
            bytes => drop(held.insert(self.from, bytes)),
        }
        self.bytes = bytes;
        true
    }
}

impl Drop for Buffers {
    fn drop(&mut self) {
        self.hold(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_holds_a_share_only_and_returns_it() {
        const MOST: usize = 4000;
        const MOST_OF_ADDRESS: usize = 1000;
        let held = Held::new(MOST, MOST_OF_ADDRESS);
        let from = |last| Buffers::new(&held, IpAddr::from([10, 77, 0, last]));
        let mut greedy = [from(1), from(1)];
        assert!(greedy[0].hold(MOST_OF_ADDRESS) && !greedy[1].hold(1));
        assert!(greedy[0].hold(MOST_OF_ADDRESS - 1) && greedy[1].hold(1));
        let mut others: Vec<_> = (2..9).map(from).collect();
        let held_now = others.iter_mut().filter_map(|its| its.hold(MOST_OF_ADDRESS).then_some(())).count();
        assert_eq!(held_now, MOST / MOST_OF_ADDRESS - 1);
        drop((greedy, others));
        assert!(held.by_address.lock().is_empty());
    }
}
