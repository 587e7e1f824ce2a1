//! Bytes of calls and answers that a master holds for its callers.

use std::{collections::BTreeMap, net::IpAddr, sync::Arc};

use parking_lot::Mutex;

/// Most bytes for all callers.
const MOST: usize = 32 << 20;
/// Most bytes for the callers at one address.
const MOST_OF_ADDRESS: usize = 8 << 20;

/// The bytes by the address of the caller.
pub(crate) type Held = Arc<Mutex<BTreeMap<IpAddr, usize>>>;

/// The part of one connection.
#[derive(Debug)]
pub(crate) struct Buffers {
    held: Held,
    from: IpAddr,
    bytes: usize,
}

impl Buffers {
    pub fn new(held: &Held, from: IpAddr) -> Self {
        Self { held: Arc::clone(held), from, bytes: 0 }
    }

    /// Changes what this connection holds. Returns whether there is room for it; nothing has changed otherwise.
    pub fn hold(&mut self, bytes: usize) -> bool {
        let mut held = self.held.lock();
        let of_address = held.get(&self.from).copied().unwrap_or_default() - self.bytes + bytes;
        let all = held.values().sum::<usize>() - self.bytes + bytes;
        if bytes > self.bytes && (of_address > MOST_OF_ADDRESS || all > MOST) {
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
        let held = Held::default();
        let from = |last| Buffers::new(&held, IpAddr::from([10, 77, 0, last]));
        let mut greedy = [from(1), from(1)];
        assert!(greedy[0].hold(MOST_OF_ADDRESS) && !greedy[1].hold(1));
        assert!(greedy[0].hold(MOST_OF_ADDRESS - 1) && greedy[1].hold(1));
        let mut others: Vec<_> = (2..9).map(from).collect();
        let held_now = others.iter_mut().filter_map(|its| its.hold(MOST_OF_ADDRESS).then_some(())).count();
        assert_eq!(held_now, MOST / MOST_OF_ADDRESS - 1);
        drop((greedy, others));
        assert!(held.lock().is_empty());
    }
}
