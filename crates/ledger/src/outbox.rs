//! The life of an operator's transactions, without network or clock. Each gets a nonce and is sent. It is sent again
//! until it is included, with a higher fee if necessary, and again after a reorganisation.
//!
//! A repeated transaction keeps its nonce, so that no chain includes both. If something else used the nonce, it gets
//! another. The contract rejects a call that was already done, because IDs are unique and each state is passed once.

use std::collections::VecDeque;

use crate::{
    ledger::{CallError, Ticket},
    message::Call,
    values::TransactionHash,
};

/// Blocks without inclusion after which a transaction is sent again.
const PATIENCE_BLOCKS: u64 = 3;

/// Fees offered per unit of gas (EIP-1559).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fees {
    /// Maximum, including the tip.
    pub(crate) most: u128,
    pub(crate) tip: u128,
}

impl Fees {
    /// Computes the offer for a base fee and a usual tip; it suffices even if the base fee doubles. An earlier offer
    /// is repeated as long as it suffices. A slow node may still include that transaction, and some (EthereumJS) then
    /// keep its replacement, and include nothing more of the account.
    pub(crate) fn offer(base: u128, tip: u128, before: Option<Self>) -> Self {
        let now = Self { most: 2 * base + tip, tip };
        match before {
            None => now,
            Some(before) if before.most >= base + tip && before.tip >= tip => before,
            // Nodes replace a transaction of the same nonce if both fees are a tenth higher.
            Some(before) => {
                let more = |fee: u128| fee + fee / 4 + 1;
                Self { most: now.most.max(more(before.most)), tip: now.tip.max(more(before.tip)) }
            }
        }
    }
}

/// Action required for a transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Action {
    /// Estimate the call's gas on the node, and report it by [`Outbox::estimated`].
    Estimate { ticket: Ticket, call: Call },
    /// Sign it, report [`Outbox::sent`], and send it. `before` is the last offer.
    Send { ticket: Ticket, call: Call, nonce: u64, gas: u64, before: Option<Fees> },
    /// Find the block with one of these, and report it by [`Outbox::checked`].
    Check { ticket: Ticket, hashes: Vec<TransactionHash> },
}

/// State of a transaction as of the chain's current head.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Status {
    /// In no block.
    Absent,
    /// In a block.
    Included { block: u64 },
    /// In a block, where the contract rejected it.
    Reverted(CallError),
}

/// A report to the operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Report {
    Included(Ticket),
    Refused(Ticket, CallError),
}

#[derive(Debug)]
struct Entry {
    ticket: Ticket,
    call: Call,
    stage: Stage,
}

#[derive(Debug)]
enum Stage {
    Queued,
    Estimating,
    Ready { gas: u64 },
    Sent(Sent),
}

#[derive(Debug)]
struct Sent {
    gas: u64,
    nonce: u64,
    /// Last offer.
    fees: Option<Fees>,
    hashes: Vec<TransactionHash>,
    /// Head when it was last sent.
    at_block: u64,
    is_due: bool,
    /// Head when it was last checked.
    checked: Option<u64>,
    included: Option<u64>,
}

/// An operator's transactions that are not final yet.
#[derive(Debug)]
pub(crate) struct Outbox {
    entries: VecDeque<Entry>,
    /// Number of further blocks that make a transaction final.
    depth: u64,
    head: u64,
    /// Number of the operator's transactions on the chain.
    on_chain: Option<u64>,
}

impl Outbox {
    /// Makes an empty outbox. A transaction with `depth` further blocks is never retracted.
    pub(crate) fn new(depth: u64) -> Self {
        Self { entries: VecDeque::new(), depth, head: 0, on_chain: None }
    }

    pub(crate) fn submit(&mut self, ticket: Ticket, call: Call) {
        self.entries.push_back(Entry { ticket, call, stage: Stage::Queued });
    }

    /// Whether everything submitted is final.
    pub(crate) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Records the chain's head, and the number of the operator's transactions by it.
    pub(crate) fn on_head(&mut self, number: u64, on_chain: u64) {
        self.head = number;
        self.on_chain = Some(on_chain);
        for entry in &mut self.entries {
            if let Stage::Sent(sent) = &mut entry.stage {
                sent.checked = None;
            }
        }
    }

    /// Records a new connection. Pending requests to the old node are forgotten.
    pub(crate) fn on_connected(&mut self) {
        self.on_chain = None;
        for entry in &mut self.entries {
            match &mut entry.stage {
                Stage::Estimating => entry.stage = Stage::Queued,
                // The node may be another one, which never received it.
                Stage::Sent(sent) if sent.included.is_none() => sent.is_due = true,
                _ => {}
            }
        }
    }

    /// Returns the next action; `None` until the next head.
    pub(crate) fn next(&mut self) -> Option<Action> {
        let head = self.head;
        let on_chain = self.on_chain?;
        let nonce = self.next_nonce(on_chain);
        for entry in &mut self.entries {
            let (ticket, call) = (entry.ticket, &entry.call);
            match &mut entry.stage {
                Stage::Queued => {
                    entry.stage = Stage::Estimating;
                    return Some(Action::Estimate { ticket, call: call.clone() });
                }
                // Later calls may build on this one.
                Stage::Estimating => return None,
                Stage::Ready { gas } => {
                    let (gas, hashes) = (*gas, Vec::new());
                    let sent = Sent {
                        gas,
                        nonce,
                        fees: None,
                        hashes,
                        at_block: head,
                        is_due: false,
                        checked: Some(head),
                        included: None,
                    };
                    entry.stage = Stage::Sent(sent);
                    return Some(Action::Send { ticket, call: call.clone(), nonce, gas, before: None });
                }
                Stage::Sent(sent) => {
                    if sent.checked != Some(head) && !sent.hashes.is_empty() {
                        sent.checked = Some(head);
                        return Some(Action::Check { ticket, hashes: sent.hashes.clone() });
                    }
                    let is_late = sent.included.is_none() && head >= sent.at_block + PATIENCE_BLOCKS;
                    if sent.is_due || is_late {
                        (sent.is_due, sent.at_block) = (false, head);
                        let Sent { nonce, gas, fees, .. } = *sent;
                        return Some(Action::Send { ticket, call: call.clone(), nonce, gas, before: fees });
                    }
                }
            }
        }
        None
    }

    /// Returns the first nonce used neither on the chain nor by a pending transaction.
    fn next_nonce(&self, on_chain: u64) -> u64 {
        let used = |entry: &Entry| match &entry.stage {
            Stage::Sent(sent) => Some(sent.nonce),
            _ => None,
        };
        let mut used: Vec<u64> = self.entries.iter().filter_map(used).collect();
        used.sort_unstable();
        // Fill gaps first: nodes include nothing behind a gap.
        used.into_iter().fold(on_chain, |next, nonce| if nonce == next { next + 1 } else { next })
    }

    /// Records the estimate of a call.
    pub(crate) fn estimated(&mut self, ticket: Ticket, result: Result<u64, CallError>) -> Option<Report> {
        let entry = self.entries.iter_mut().find(|entry| entry.ticket == ticket)?;
        match result {
            Ok(gas) => {
                entry.stage = Stage::Ready { gas };
                None
            }
            Err(rejection) => {
                self.remove(ticket);
                Some(Report::Refused(ticket, rejection))
            }
        }
    }

    /// Records that a transaction is being sent. It may get into a block even if the connection breaks.
    pub(crate) fn sent(&mut self, ticket: Ticket, hash: TransactionHash, fees: Fees) {
        let Some(sent) = self.sent_mut(ticket) else { return };
        sent.fees = Some(fees);
        if !sent.hashes.contains(&hash) {
            sent.hashes.push(hash);
        }
    }

    /// Records that the node rejected a transaction for good.
    pub(crate) fn not_sent(
        &mut self,
        ticket: Ticket,
        hash: TransactionHash,
        reason: String,
    ) -> Option<Report> {
        let sent = self.sent_mut(ticket)?;
        sent.hashes.retain(|other| *other != hash);
        // One that the node accepted before is still pending.
        if !sent.hashes.is_empty() {
            return None;
        }
        self.remove(ticket);
        Some(Report::Refused(ticket, CallError::Node(reason)))
    }

    /// Records that the node reported the nonce as used.
    pub(crate) fn nonce_is_used(&mut self, ticket: Ticket) {
        // This transaction used it, which a check will show, or something else did.
        match self.sent_mut(ticket) {
            Some(sent) if !sent.hashes.is_empty() => sent.checked = None,
            _ => self.requeue(ticket),
        }
    }

    /// Records the state of a transaction as of the head.
    pub(crate) fn checked(&mut self, ticket: Ticket, status: Status) -> Option<Report> {
        let (head, depth, on_chain) = (self.head, self.depth, self.on_chain);
        let sent = self.sent_mut(ticket)?;
        match status {
            Status::Included { block } => {
                let is_news = sent.included.replace(block) != Some(block);
                if head >= block + depth {
                    self.remove(ticket);
                }
                is_news.then_some(Report::Included(ticket))
            }
            Status::Reverted(rejection) => {
                self.remove(ticket);
                Some(Report::Refused(ticket, rejection))
            }
            Status::Absent => {
                // Retracted: the node may no longer have it.
                sent.is_due |= sent.included.take().is_some();
                if on_chain.is_some_and(|count| count > sent.nonce) {
                    self.requeue(ticket);
                }
                None
            }
        }
    }

    fn requeue(&mut self, ticket: Ticket) {
        if let Some(entry) = self.entries.iter_mut().find(|entry| entry.ticket == ticket) {
            entry.stage = Stage::Queued;
        }
    }

    fn sent_mut(&mut self, ticket: Ticket) -> Option<&mut Sent> {
        self.entries.iter_mut().find(|entry| entry.ticket == ticket).and_then(|entry| {
            match &mut entry.stage {
                Stage::Sent(sent) => Some(sent),
                _ => None,
            }
        })
    }

    fn remove(&mut self, ticket: Ticket) {
        self.entries.retain(|entry| entry.ticket != ticket);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use proptest::prelude::*;

    use super::*;
    use crate::values::ServiceId;

    /// A chain with one operator, whose node loses transactions and whose blocks are retracted.
    #[derive(Default)]
    struct Node {
        /// Pending transactions by nonce: hash, fees and content.
        pool: HashMap<u64, (TransactionHash, Fees, Call)>,
        base_fee: u128,
        blocks: Vec<Vec<(u64, TransactionHash, Call)>>,
    }

    impl Node {
        fn count(&self) -> u64 {
            self.blocks.iter().flatten().count() as u64
        }

        fn block_of(&self, hashes: &[TransactionHash]) -> Option<u64> {
            let has = |block: &Vec<(u64, TransactionHash, Call)>| {
                block.iter().any(|(_, hash, _)| hashes.contains(hash))
            };
            self.blocks.iter().position(has).map(|at| at as u64 + 1)
        }

        fn mine(&mut self) {
            let mut block = Vec::new();
            loop {
                let nonce = self.count() + block.len() as u64;
                if self.pool.get(&nonce).is_none_or(|(_, fees, _)| fees.most < self.base_fee) {
                    break;
                }
                let (hash, _, call) = self.pool.remove(&nonce).unwrap();
                block.push((nonce, hash, call));
            }
            self.blocks.push(block);
        }

        fn act(&mut self, outbox: &mut Outbox, action: Action) -> Option<Report> {
            match action {
                Action::Estimate { ticket, .. } => outbox.estimated(ticket, Ok(100_000)),
                Action::Send { ticket, call, nonce, before, .. } => {
                    let fees = Fees::offer(self.base_fee, 1, before);
                    // The same transaction has the same hash.
                    let mut hash = TransactionHash::default();
                    hash.0[..8].copy_from_slice(&(1000 * ticket.0 + nonce).to_be_bytes());
                    hash.0[8..24].copy_from_slice(&fees.most.to_be_bytes());
                    outbox.sent(ticket, hash, fees);
                    if nonce < self.count() {
                        outbox.nonce_is_used(ticket);
                    } else {
                        let is_better = |other: Fees| {
                            10 * fees.most >= 11 * other.most && 10 * fees.tip >= 11 * other.tip
                        };
                        if self.pool.get(&nonce).is_none_or(|(_, other, _)| is_better(*other)) {
                            self.pool.insert(nonce, (hash, fees, call));
                        }
                    }
                    None
                }
                Action::Check { ticket, hashes } => outbox.checked(
                    ticket,
                    self.block_of(&hashes).map_or(Status::Absent, |block| Status::Included { block }),
                ),
            }
        }
    }

    #[derive(Debug, Clone, Copy)]
    enum Incident {
        Submit,
        Mine,
        /// The node forgets pending transactions.
        Drop,
        /// Fees rise above the offers.
        Dearer,
        /// The last block is retracted, and its transactions forgotten.
        Reorganise,
        Reconnect,
    }

    fn incident() -> impl Strategy<Value = Incident> {
        use Incident::*;
        prop_oneof![3 => Just(Submit), 4 => Just(Mine), 1 => Just(Drop), 1 => Just(Dearer), 1 => Just(Reorganise), 1 => Just(Reconnect)]
    }

    fn call(number: u64) -> Call {
        let mut id = ServiceId::default();
        id.0[..8].copy_from_slice(&number.to_be_bytes());
        Call::Accept { id }
    }

    proptest! {
        #[test]
        fn every_call_is_on_the_chain_exactly_once(
            happenings in prop::collection::vec(incident(), 1..60),
        ) {
            let (mut node, mut outbox) = (Node::default(), Outbox::new(3));
            let mut submitted = 0;
            let after = vec![Incident::Mine; 40];
            for incident in happenings.into_iter().chain(after) {
                match incident {
                    Incident::Submit => {
                        submitted += 1;
                        outbox.submit(Ticket(submitted), call(submitted));
                    }
                    Incident::Mine => node.mine(),
                    Incident::Drop => node.pool.clear(),
                    Incident::Dearer => node.base_fee = 3 * node.base_fee + 10,
                    Incident::Reorganise => {
                        // No deeper than the outbox's depth: the replacing block follows at once.
                        if node.blocks.pop().is_some() {
                            node.pool.clear();
                            node.blocks.push(Vec::new());
                        }
                    }
                    Incident::Reconnect => outbox.on_connected(),
                }
                outbox.on_head(node.blocks.len() as u64, node.count());
                for _ in 0..1000 {
                    let Some(action) = outbox.next() else { break };
                    node.act(&mut outbox, action);
                }
            }
            let mut calls: Vec<&Call> = node.blocks.iter().flatten().map(|(_, _, call)| call).collect();
            calls.sort_by_key(|call| format!("{call:?}"));
            let mut wanted: Vec<Call> = (1..=submitted).map(call).collect();
            wanted.sort_by_key(|call| format!("{call:?}"));
            prop_assert_eq!(calls, wanted.iter().collect::<Vec<_>>());
            prop_assert!(outbox.entries.is_empty(), "{:?}", outbox.entries);
        }
    }

    #[test]
    fn rejected_calls_are_reported_and_use_no_nonce() {
        let mut outbox = Outbox::new(0);
        outbox.on_head(1, 5);
        outbox.submit(Ticket(1), call(1));
        outbox.submit(Ticket(2), call(2));
        assert!(matches!(outbox.next(), Some(Action::Estimate { ticket: Ticket(1), .. })));
        assert_eq!(outbox.next(), None, "the second may build on the first");
        let rejection = CallError::from(crate::ContractError::OnlyCreator);
        assert_eq!(
            outbox.estimated(Ticket(1), Err(rejection.clone())),
            Some(Report::Refused(Ticket(1), rejection))
        );
        outbox.next();
        outbox.estimated(Ticket(2), Ok(7));
        let sent = Action::Send { ticket: Ticket(2), call: call(2), nonce: 5, gas: 7, before: None };
        assert_eq!(outbox.next(), Some(sent));
    }

    #[test]
    fn sufficient_offers_are_repeated_unchanged() {
        let before = Fees::offer(7, 1, None);
        assert_eq!(before, Fees { most: 15, tip: 1 });
        assert_eq!(Fees::offer(7, 1, Some(before)), before);
        assert_eq!(Fees::offer(14, 1, Some(before)), before, "it can still be included");
        assert_eq!(Fees::offer(15, 1, Some(before)), Fees { most: 31, tip: 2 }, "it cannot");
        assert_eq!(Fees::offer(7, 2, Some(before)), Fees { most: 19, tip: 2 }, "others pay more");
    }
}
