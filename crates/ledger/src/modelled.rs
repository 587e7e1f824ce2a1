//! A ledger for virtual time: the contract's rules, and a block each period.
//!
//! It is a model without network, consensus or fees, and with only those forks that are requested. Blocks are
//! punctual, have room for everything, and all operators see them at once.

use std::{collections::VecDeque, ops::Range, sync::Arc, time::Duration};

use cotorra_graph::Timestamp;
use parking_lot::Mutex;

use crate::{
    contract::Contract,
    ledger::{Ledger, Notice, Ticket},
    message::Call,
    values::{Account, ChainTime, Deployment},
};

/// The modelled chain, shared by operators.
#[derive(Debug, Clone)]
pub struct ModelledChain(Arc<Mutex<Chain>>);

#[derive(Debug)]
struct Chain {
    contract: Contract,
    period: Duration,
    /// Nanoseconds since 1970 of the run's start, on the chain's clock.
    began_ns: u64,
    next_block: Timestamp,
    /// Number of the last block.
    number: u64,
    /// Calls for the next block, in order.
    pending: Vec<(usize, Ticket, Call)>,
    operators: Vec<Operator>,
    /// All notices so far, for operators that come later.
    reported: Vec<Notice>,
    /// The blocks that have calls, oldest first.
    blocks: Vec<Block>,
}

#[derive(Debug)]
struct Block {
    time: ChainTime,
    /// The included calls. Each made an event.
    calls: Vec<(usize, Ticket, Call)>,
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
    /// Time during which it cannot reach the chain, and whether that was reported.
    outage: Option<(Range<Timestamp>, bool)>,
    /// Calls submitted during the outage.
    kept: Vec<(Ticket, Call)>,
}

/// The chain's time when its first run began; arbitrary.
const GENESIS: ChainTime = ChainTime(1_600_000_000);
/// No real chain has this ID, so that messages for the model are useless elsewhere.
const DEPLOYMENT: Deployment = Deployment { chain_id: 0, contract: Account([0; 20]) };

impl ModelledChain {
    /// Makes a chain whose first block comes one `period` into the run.
    ///
    /// # Panics
    /// If `period` is zero.
    pub fn new(period: Duration) -> Self {
        assert!(period > Duration::ZERO, "the block period must be above zero");
        Self(Arc::new(Mutex::new(Chain {
            contract: Contract::new(DEPLOYMENT),
            period,
            began_ns: GENESIS.0 * 1_000_000_000,
            next_block: Timestamp::ZERO + period,
            number: 0,
            pending: Vec::new(),
            operators: Vec::new(),
            reported: Vec::new(),
            blocks: Vec::new(),
        })))
    }

    pub fn deployment(&self) -> Deployment {
        DEPLOYMENT
    }

    /// Returns the access of the operator with that address. It first receives all past events.
    pub fn ledger(&self, account: Account) -> ModelledLedger {
        let mut chain = self.0.lock();
        let index = chain.operators.len();
        let notices = std::iter::once(&Notice::Up).chain(&chain.reported).cloned().collect();
        chain.operators.push(Operator { account, notices, submitted: 0 });
        ModelledLedger { chain: self.clone(), index, account, outage: None, kept: Vec::new() }
    }

    /// Begins another run, whose time zero is `now` of the run before. The chain continues, with new operators.
    pub fn begin_run(&self, now: Timestamp) {
        let mut chain = self.0.lock();
        chain.advance(now);
        chain.began_ns += now.as_nanos();
        chain.next_block = Timestamp::ZERO + chain.next_block.since(now);
    }

    /// Replaces the last blocks by empty ones, beginning with the `depth`th last block that has calls, like a fork
    /// that becomes the longest chain. Their events are retracted, and their calls go into the next block. Returns
    /// whether there was such a block.
    pub fn reorganise(&self, now: Timestamp, depth: usize) -> bool {
        let mut chain = self.0.lock();
        chain.advance(now);
        let remaining = chain.blocks.len().saturating_sub(depth);
        let gone = chain.blocks.split_off(remaining);
        let calls: Vec<_> = gone.into_iter().flat_map(|block| block.calls).collect();
        if calls.is_empty() {
            return false;
        }
        // Recompute the contract from the remaining calls.
        let Chain { contract, blocks, operators, .. } = &mut *chain;
        *contract = Contract::new(DEPLOYMENT);
        for Block { time, calls } in blocks {
            for (index, _, call) in calls {
                let again = contract.apply(*time, operators[*index].account, call);
                debug_assert!(again.is_ok(), "it was accepted before");
            }
        }
        for _ in &calls {
            if let Some(Notice::Event(event)) = chain.reported.pop() {
                chain.report(&Notice::Retracted(event));
            }
        }
        let later = std::mem::replace(&mut chain.pending, calls);
        chain.pending.extend(later);
        true
    }

    /// Returns the contract as of the last block.
    pub fn contract(&self) -> Contract {
        self.0.lock().contract.clone()
    }
}

impl Chain {
    /// Makes all blocks that are due.
    fn advance(&mut self, now: Timestamp) {
        while self.next_block <= now {
            let time = ChainTime((self.began_ns + self.next_block.as_nanos()) / 1_000_000_000);
            self.number += 1;
            let pending = std::mem::take(&mut self.pending);
            let mut included = Vec::new();
            for (index, ticket, call) in pending {
                match self.contract.apply(time, self.operators[index].account, &call) {
                    Ok(event) => {
                        self.operators[index].notices.push_back(Notice::Included(ticket));
                        self.report(&Notice::Event(event));
                        included.push((index, ticket, call));
                    }
                    Err(refusal) => {
                        self.operators[index].notices.push_back(Notice::Refused(ticket, refusal.into()))
                    }
                }
            }
            if !included.is_empty() {
                self.blocks.push(Block { time, calls: included });
            }
            self.report(&Notice::Head { number: self.number, time });
            self.next_block = self.next_block + self.period;
        }
    }

    fn report(&mut self, notice: &Notice) {
        if let Notice::Event(_) = notice {
            self.reported.push(notice.clone());
        }
        for operator in &mut self.operators {
            operator.notices.push_back(notice.clone());
        }
    }
}

impl ModelledLedger {
    /// Makes the ledger unreachable for some time: it has no notices then, and submitted calls are kept.
    #[must_use]
    pub fn with_outage(self, outage: Range<Timestamp>) -> Self {
        Self { outage: Some((outage, false)), ..self }
    }

    fn is_away(&self, now: Timestamp) -> bool {
        self.outage.as_ref().is_some_and(|(outage, _)| outage.contains(&now))
    }
}

impl Ledger for ModelledLedger {
    fn account(&self) -> Account {
        self.account
    }

    fn submit(&mut self, now: Timestamp, call: Call) -> Ticket {
        let is_away = self.is_away(now);
        let mut chain = self.chain.0.lock();
        chain.advance(now);
        let operator = &mut chain.operators[self.index];
        operator.submitted += 1;
        let ticket = Ticket(operator.submitted);
        if is_away {
            self.kept.push((ticket, call));
        } else {
            chain.pending.push((self.index, ticket, call));
        }
        ticket
    }

    fn poll(&mut self, now: Timestamp) -> Option<Notice> {
        let mut chain = self.chain.0.lock();
        chain.advance(now);
        match &mut self.outage {
            Some((outage, reported)) if outage.contains(&now) => {
                let news = !std::mem::replace(reported, true);
                return news.then(|| Notice::Down("the modelled ledger is out of reach".to_owned()));
            }
            Some((outage, true)) if now >= outage.end => {
                self.outage = None;
                let kept = self.kept.drain(..).map(|(ticket, call)| (self.index, ticket, call));
                chain.pending.extend(kept);
                return Some(Notice::Up);
            }
            _ => {}
        }
        chain.operators[self.index].notices.pop_front()
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        let chain = self.chain.0.lock();
        match &self.outage {
            Some((outage, true)) => return Some(outage.end),
            Some((outage, false)) if chain.operators[self.index].notices.is_empty() => {
                return Some(outage.start.min(chain.next_block));
            }
            _ => {}
        }
        let waiting = !chain.operators[self.index].notices.is_empty();
        Some(if waiting { Timestamp::ZERO } else { chain.next_block })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{ContractError, Event};

    fn seconds(seconds: u64) -> Timestamp {
        Timestamp::ZERO + Duration::from_secs(seconds)
    }

    fn all(ledger: &mut ModelledLedger, now: Timestamp) -> Vec<Notice> {
        std::iter::from_fn(|| ledger.poll(now)).collect()
    }

    #[test]
    fn submitted_calls_are_in_the_next_block_for_all_operators() {
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
                Notice::Refused(again, ContractError::AlreadyRegistered.into()),
                head.clone()
            ]
        );
        assert_eq!(all(&mut two, seconds(7)), [event, head]);
        assert_eq!(all(&mut two, seconds(20)).len(), 3, "a block each 5 s, even an empty one");
    }

    #[test]
    fn reorganised_calls_are_retracted_and_included_again() {
        let chain = ModelledChain::new(Duration::from_secs(5));
        let (mut one, mut two) = (chain.ledger(Account([1; 20])), chain.ledger(Account([2; 20])));
        let register = |name: &str| Call::Register { name: name.to_owned() };
        let said = |operator, name: &str| Event::OperatorRegistered {
            operator: Account([operator; 20]),
            name: name.into(),
        };
        assert!(!chain.reorganise(seconds(1), 1), "there is no block yet");
        let first = one.submit(seconds(1), register("one"));
        all(&mut one, seconds(6));
        two.submit(seconds(7), register("two"));
        all(&mut one, seconds(20));
        assert!(chain.reorganise(seconds(21), 2));
        let back = [Notice::Retracted(said(2, "two")), Notice::Retracted(said(1, "one"))];
        assert_eq!(all(&mut one, seconds(21)), back);
        // An operator joining now receives none of it.
        assert_eq!(all(&mut chain.ledger(Account([3; 20])), seconds(21)), [Notice::Up]);
        let head = Notice::Head { number: 5, time: ChainTime(GENESIS.0 + 25) };
        let again =
            [Notice::Included(first), Notice::Event(said(1, "one")), Notice::Event(said(2, "two")), head];
        assert_eq!(all(&mut one, seconds(25)), again);
        // A single remaining one.
        assert!(chain.reorganise(seconds(26), 9));
        assert!(!chain.reorganise(seconds(26), 9));
        assert_eq!(all(&mut one, seconds(26)).len(), 2);
    }

    #[test]
    fn later_operators_receive_past_events() {
        let chain = ModelledChain::new(Duration::from_secs(5));
        let mut one = chain.ledger(Account([1; 20]));
        one.submit(seconds(1), Call::Register { name: "one".to_owned() });
        all(&mut one, seconds(6));
        let event =
            Notice::Event(Event::OperatorRegistered { operator: Account([1; 20]), name: "one".to_owned() });
        let mut again = chain.ledger(Account([1; 20]));
        assert_eq!(all(&mut again, seconds(6)), [Notice::Up, event]);
    }

    #[test]
    fn calls_wait_during_an_outage() {
        let chain = ModelledChain::new(Duration::from_secs(5));
        let mut one = chain.ledger(Account([1; 20])).with_outage(seconds(3)..seconds(12));
        assert_eq!(all(&mut one, seconds(2)), [Notice::Up]);
        assert_eq!(one.next_deadline(), Some(seconds(3)));
        assert!(matches!(all(&mut one, seconds(3))[..], [Notice::Down(_)]));
        assert_eq!(one.next_deadline(), Some(seconds(12)));
        let ticket = one.submit(seconds(4), Call::Register { name: "one".to_owned() });
        assert_eq!(all(&mut one, seconds(11)), []);
        let heard = all(&mut one, seconds(12));
        assert_eq!(heard[0], Notice::Up);
        assert!(!heard.contains(&Notice::Included(ticket)));
        assert!(all(&mut one, seconds(15)).contains(&Notice::Included(ticket)));
    }

    #[test]
    fn chains_continue_in_the_next_run() {
        let chain = ModelledChain::new(Duration::from_secs(5));
        chain.begin_run(seconds(7));
        let mut one = chain.ledger(Account([1; 20]));
        assert_eq!(one.poll(seconds(0)), Some(Notice::Up));
        assert_eq!(one.next_deadline(), Some(seconds(3)));
        let head = Notice::Head { number: 2, time: ChainTime(GENESIS.0 + 10) };
        assert_eq!(all(&mut one, seconds(3)), [head]);
    }
}
