//! Turns of callers on the threads that read files and the history. The operator's threads are its own: whatever domains and
//! plug-ins ask, the operator does not wait for them.

use std::{
    collections::BTreeMap,
    sync::{Arc, LazyLock},
};

use parking_lot::Mutex;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{connections::Whose, context::BLOCKING_THREADS};

/// Threads of all domains and plug-ins together. Few, so that they leave processors to the operator.
const OF_OTHERS: usize = 4;
/// Threads of one domain or plug-in.
const OF_EACH: usize = 2;

/// The turns of all callers.
pub(super) struct Turns {
    operator: Arc<Semaphore>,
    others: Arc<Semaphore>,
    each: Mutex<BTreeMap<Whose, Arc<Semaphore>>>,
}

/// The turns on the threads of this process.
pub(super) static TURNS: LazyLock<Turns> = LazyLock::new(Turns::default);

/// A turn, until it is dropped.
pub(super) struct Turn {
    _of_all: OwnedSemaphorePermit,
    _own: Option<OwnedSemaphorePermit>,
}

impl Default for Turns {
    fn default() -> Self {
        let all = |threads| Arc::new(Semaphore::new(threads));
        Self { operator: all(BLOCKING_THREADS - OF_OTHERS), others: all(OF_OTHERS), each: Mutex::default() }
    }
}

impl Turns {
    /// Waits for a turn. Each domain and plug-in waits for its own turns first, so that those who ask much are served no more
    /// often than those who ask little.
    pub(super) async fn take(&self, whose: Whose) -> Turn {
        let closed = "turns are never closed";
        if whose == Whose::Operator {
            let of_all = Arc::clone(&self.operator).acquire_owned().await.expect(closed);
            return Turn { _of_all: of_all, _own: None };
        }
        let own = self.each.lock().entry(whose).or_insert_with(|| Arc::new(Semaphore::new(OF_EACH))).clone();
        let own = own.acquire_owned().await.expect(closed);
        let of_all = Arc::clone(&self.others).acquire_owned().await.expect(closed);
        Turn { _of_all: of_all, _own: Some(own) }
    }
}

#[cfg(test)]
mod tests {
    use std::{
        pin::pin,
        task::{Context, Poll, Waker},
    };

    use super::*;

    /// Takes turns until one has to be waited for, at most 100.
    fn take(turns: &Turns, whose: &Whose) -> Vec<Turn> {
        let now = || match pin!(turns.take(whose.clone())).poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(turn) => Some(turn),
            Poll::Pending => None,
        };
        (0..100).map_while(|_| now()).collect()
    }

    #[test]
    fn domains_and_plugins_take_no_turns_of_the_operator_or_of_each_other() {
        let domain = |name: &str| Whose::Domain(name.parse().unwrap());
        let turns = Turns::default();
        let one = take(&turns, &domain("one"));
        let plugin = take(&turns, &Whose::Plugin("one".parse().unwrap()));
        assert_eq!((one.len(), plugin.len()), (OF_EACH, OF_EACH));
        assert_eq!(take(&turns, &domain("two")).len(), 0, "it waits for one of theirs");
        assert_eq!(take(&turns, &Whose::Operator).len(), BLOCKING_THREADS - OF_OTHERS);
        drop(one);
        assert_eq!(take(&turns, &domain("two")).len(), OF_EACH);
    }
}
