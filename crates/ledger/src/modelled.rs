//! A ledger for virtual time: the contract's rules, and a block each period. It is a model: no network, no consensus, no
//! forks and no fees; blocks are punctual, have room for everything, and everybody sees them at once.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use cotorra_graph::Timestamp;

use crate::{
    contract::Contract,
    ledger::{Ledger, Notice, Ticket},
    message::Call,
    values::{Account, ChainTime},
};

/// The modelled chain, which operators share.
#[derive(Debug, Clone)]
pub struct ModelledChain(Arc<Mutex<Chain>>);

#[derive(Debug)]
struct Chain {
    contract: Contract,
    period: Duration,
    next_block: Timestamp,
    /// The number of the last block.
    number: u64,
    /// What goes into the next block, in order.
    pending: Vec<(usize, Ticket, Call)>,
    operators: Vec<Operator>,
}

#[derive(Debug)]
struct Operator {
    account: Account,
    notices: VecDeque<Notice>,
    submitted: u64,
}

/// One operator's access to a [`ModelledChain`].
#[derive(Debug)]
pub struct ModelledLedger {
    chain: ModelledChain,
    index: usize,
    account: Account,
}

/// The chain's time when the run began; any would do.
const GENESIS: ChainTime = ChainTime(1_600_000_000);

impl ModelledChain {
    /// A chain whose first block comes a `period` into the run.
    ///
    /// # Panics
    /// If `period` is zero.
    pub fn new(period: Duration) -> Self {
        assert!(period > Duration::ZERO, "blocks are some time apart");
        Self(Arc::new(Mutex::new(Chain {
            contract: Contract::default(),
            period,
            next_block: Timestamp::ZERO + period,
            number: 0,
            pending: Vec::new(),
            operators: Vec::new(),
        })))
    }

    /// The access of the operator with that address. It hears of what happens from now on.
    pub fn ledger(&self, account: Account) -> ModelledLedger {
        let mut chain = self.lock();
        let index = chain.operators.len();
        chain.operators.push(Operator { account, notices: [Notice::Up].into(), submitted: 0 });
        ModelledLedger { chain: self.clone(), index, account }
    }

    /// The contract, as of the last block.
    pub fn contract(&self) -> Contract {
        self.lock().contract.clone()
    }

    fn lock(&self) -> MutexGuard<'_, Chain> {
        // Whoever panicked did so between two blocks: calls are applied whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Chain {
    /// Makes all blocks that are due.
    fn advance(&mut self, now: Timestamp) {
        while self.next_block <= now {
            let time = ChainTime(GENESIS.0 + self.next_block.as_nanos() / 1_000_000_000);
            self.number += 1;
            for (index, ticket, call) in std::mem::take(&mut self.pending) {
                match self.contract.apply(time, self.operators[index].account, &call) {
                    Ok(event) => {
                        self.operators[index].notices.push_back(Notice::Included(ticket));
                        self.tell(&Notice::Event(event));
                    }
                    Err(refusal) => {
                        self.operators[index].notices.push_back(Notice::Refused(ticket, refusal.into()))
                    }
                }
            }
            self.tell(&Notice::Head { number: self.number, time });
            self.next_block = self.next_block + self.period;
        }
    }

    fn tell(&mut self, notice: &Notice) {
        for operator in &mut self.operators {
            operator.notices.push_back(notice.clone());
        }
    }
}

impl Ledger for ModelledLedger {
    fn account(&self) -> Account {
        self.account
    }

    fn submit(&mut self, now: Timestamp, call: Call) -> Ticket {
        let mut chain = self.chain.lock();
        chain.advance(now);
        let operator = &mut chain.operators[self.index];
        operator.submitted += 1;
        let ticket = Ticket(operator.submitted);
        chain.pending.push((self.index, ticket, call));
        ticket
    }

    fn poll(&mut self, now: Timestamp) -> Option<Notice> {
        let mut chain = self.chain.lock();
        chain.advance(now);
        chain.operators[self.index].notices.pop_front()
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        let chain = self.chain.lock();
        let waiting = !chain.operators[self.index].notices.is_empty();
        Some(if waiting { Timestamp::ZERO } else { chain.next_block })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Event, Refusal};

    fn seconds(seconds: u64) -> Timestamp {
        Timestamp::ZERO + Duration::from_secs(seconds)
    }

    fn all(ledger: &mut ModelledLedger, now: Timestamp) -> Vec<Notice> {
        std::iter::from_fn(|| ledger.poll(now)).collect()
    }

    #[test]
    fn what_is_submitted_is_in_the_next_block_for_everybody_at_once() {
        let chain = ModelledChain::new(Duration::from_secs(5));
        let (mut one, mut two) = (chain.ledger(Account([1; 20])), chain.ledger(Account([2; 20])));
        assert_eq!(all(&mut one, seconds(1)), [Notice::Up]);
        assert_eq!(all(&mut two, seconds(1)), [Notice::Up]);
        let ticket = one.submit(seconds(2), Call::Register { name: "one".to_owned() });
        let again = one.submit(seconds(3), Call::Register { name: "again".to_owned() });
        assert_eq!(one.poll(seconds(4)), None);
        assert_eq!(one.next_deadline(), Some(seconds(5)));
        let event =
            Notice::Event(Event::OperatorRegistered { operator: Account([1; 20]), name: "one".to_owned() });
        let head = Notice::Head { number: 1, time: ChainTime(GENESIS.0 + 5) };
        assert_eq!(
            all(&mut one, seconds(5)),
            [
                Notice::Included(ticket),
                event.clone(),
                Notice::Refused(again, Refusal::AlreadyRegistered.into()),
                head.clone()
            ]
        );
        assert_eq!(all(&mut two, seconds(7)), [event, head]);
        assert_eq!(all(&mut two, seconds(20)).len(), 3, "a block each 5 s, even an empty one");
    }
}
