//! Transactions that wait: passed on between the execution clients, for those that do not do so themselves. Whose turn it is to
//! make a block then has all of them.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "looks again and again")]

use std::{
    collections::{HashSet, VecDeque},
    sync::mpsc::{Receiver, RecvTimeoutError, Sender},
    time::{Duration, Instant},
};

use crate::{
    engine::{self, Rpc},
    hex::Bytes,
    node::Event,
};

/// How often transactions that wait are looked for.
const LOOK: Duration = Duration::from_millis(100);
/// Transactions whose passing on is remembered.
const REMEMBERED: usize = 1 << 16;

/// What the pool of transactions is told.
pub(crate) enum Pool {
    /// Another validator's transactions.
    Take(Vec<Bytes>),
    /// A validator is back: it may know none.
    Again,
}

/// Passes transactions on: those that wait here to the others, and theirs to the execution client here.
pub(crate) fn pass(rpc: &Rpc, told: &Receiver<Pool>, events: &Sender<Event>) {
    let mut known = Known::default();
    loop {
        let until = Instant::now() + LOOK;
        loop {
            match told.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(Pool::Take(transactions)) => {
                    for transaction in transactions {
                        if let Err(reason) = engine::submit(rpc, &transaction) {
                            tracing::debug!(%reason, "a transaction that is not taken");
                        } else {
                            known.insert(crate::transaction::hash(&transaction));
                        }
                    }
                }
                Ok(Pool::Again) => known.forget(),
                Err(RecvTimeoutError::Timeout) => break,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
        let Ok(waiting) = engine::pending(rpc) else { continue };
        let new: Vec<Bytes> =
            waiting.into_iter().filter(|raw| known.insert(raw.hash)).map(|raw| raw.bytes).collect();
        if !new.is_empty() && events.send(Event::Waiting(new)).is_err() {
            return;
        }
    }
}

/// The hashes of the last transactions.
#[derive(Default)]
struct Known {
    hashes: HashSet<[u8; 32]>,
    order: VecDeque<[u8; 32]>,
}

impl Known {
    fn insert(&mut self, hash: [u8; 32]) -> bool {
        let is_new = self.hashes.insert(hash);
        if is_new {
            self.order.push_back(hash);
            if self.order.len() > REMEMBERED
                && let Some(oldest) = self.order.pop_front()
            {
                self.hashes.remove(&oldest);
            }
        }
        is_new
    }

    fn forget(&mut self) {
        self.hashes.clear();
        self.order.clear();
    }
}
