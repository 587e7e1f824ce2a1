//! An operator's connection to a network of Ethereum nodes, by JSON-RPC over WebSocket, in a thread of its own.

use std::{sync::mpsc as std_mpsc, thread, time::Duration};

use alloy::{
    consensus::TxEip1559,
    eips::{BlockNumberOrTag, eip2718::Encodable2718},
    primitives::{Address, BloomInput, Bytes, TxKind, U256},
    providers::{Provider, RootProvider},
    rpc::types::{BlockId, Filter, Header, Log, TransactionInput, TransactionRequest},
};
use cotorra_graph::Timestamp;
use tokio::sync::mpsc;

use super::{
    abi,
    blocks::{Block, Blocks, DEEPEST},
    key::Key,
    node::{self, ANSWER, EthereumError, Heads, RpcFailure},
};
use crate::{
    ledger::{CallError, Ledger, Notice, Ticket},
    message::{Call, Event},
    outbox::{Action, Fees, Outbox, Report, Status},
    values::{Account, BlockHash, ChainTime, Deployment, TransactionHash},
};

/// Access to a network.
#[derive(Debug, Clone)]
pub struct Settings {
    /// WebSocket of a node, `ws://…` or `wss://…`.
    pub url: String,
    /// The chain and the contract's address. Nodes of other chains are rejected.
    pub deployment: Deployment,
    /// Block of the contract's deployment, or any earlier one: events are read from there on.
    pub from_block: u64,
    /// Number of further blocks that make a transaction final: 0 if consensus is final at once.
    pub depth: u64,
}

/// Interval of [`Ledger::poll`]: the longest delay of a negotiation step.
const POLL: Duration = Duration::from_millis(5);
/// Pause between attempts to connect.
const RECONNECT: Duration = Duration::from_millis(500);
/// Most blocks in one query for logs.
const RANGE: u64 = 1000;
/// Gas limit of a call relative to its estimate, in percent plus a constant. The call may write more than when it was
/// estimated, because that depends on the time of its block; a charge, for instance, is still zero then. Unused gas
/// is not paid.
const GAS_PERCENT: u64 = 130;
const GAS_ON_TOP: u64 = 50_000;

/// An operator's access to the contract on an Ethereum network.
#[derive(Debug)]
pub struct EthereumLedger {
    account: Account,
    submitted: u64,
    polled: Timestamp,
    calls: mpsc::UnboundedSender<(Ticket, Call)>,
    notices: std_mpsc::Receiver<Notice>,
}

impl EthereumLedger {
    /// Connects in the background, and reconnects whenever the connection breaks. [`Notice::Up`] and [`Notice::Down`]
    /// report it.
    ///
    /// # Errors
    /// [`EthereumError::Thread`].
    pub fn connect(settings: Settings, key: Key) -> Result<Self, EthereumError> {
        let (calls, submitted) = mpsc::unbounded_channel();
        let (tell, notices) = std_mpsc::channel();
        let account = key.account();
        let runtime = node::runtime()?;
        let client = Client {
            outbox: Outbox::new(settings.depth),
            settings,
            key,
            calls: submitted,
            tell,
            blocks: Blocks::default(),
            next_block: None,
            is_connected: false,
        };
        thread::Builder::new()
            .name("ledger".to_owned())
            .spawn(move || runtime.block_on(client.run()))
            .map_err(EthereumError::Thread)?;
        Ok(Self { account, submitted: 0, polled: Timestamp::ZERO, calls, notices })
    }

    /// Waits for the next notice; [`Ledger::poll`] does not wait.
    ///
    /// # Panics
    /// If the client's thread panicked.
    pub fn wait(&mut self) -> Notice {
        self.notices.recv().expect("the client lives as long as this")
    }
}

impl Ledger for EthereumLedger {
    fn account(&self) -> Account {
        self.account
    }

    fn submit(&mut self, _now: Timestamp, call: Call) -> Ticket {
        self.submitted += 1;
        let ticket = Ticket(self.submitted);
        self.calls.send((ticket, call)).expect("the client lives as long as this");
        ticket
    }

    fn poll(&mut self, now: Timestamp) -> Option<Notice> {
        self.polled = now;
        self.notices.try_recv().ok()
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        Some(self.polled + POLL)
    }
}

/// State of the client's thread.
struct Client {
    settings: Settings,
    key: Key,
    calls: mpsc::UnboundedReceiver<(Ticket, Call)>,
    tell: std_mpsc::Sender<Notice>,
    outbox: Outbox,
    blocks: Blocks,
    /// The first block that was not read yet.
    next_block: Option<u64>,
    /// Whether the outbox has received a head since the connection was made.
    is_connected: bool,
}

/// Reason for the end of a session with a node.
enum SessionEnd {
    /// The ledger was dropped.
    Ledger,
    Connection(String),
}

impl From<RpcFailure> for SessionEnd {
    fn from(reason: RpcFailure) -> Self {
        Self::Connection(reason.to_string())
    }
}

impl Client {
    async fn run(mut self) {
        let mut was_up = true;
        loop {
            match self.session(&mut was_up).await {
                Err(SessionEnd::Ledger) => return,
                Err(SessionEnd::Connection(reason)) if was_up => {
                    was_up = false;
                    if self.tell(Notice::Down(reason)).is_err() {
                        return;
                    }
                }
                Ok(()) | Err(SessionEnd::Connection(_)) => {}
            }
            // Calls are kept while there is no node.
            let until = tokio::time::Instant::now() + RECONNECT;
            while let Ok(call) = tokio::time::timeout_at(until, self.calls.recv()).await {
                match call {
                    Some((ticket, call)) => self.outbox.submit(ticket, call),
                    None => return,
                }
            }
        }
    }

    fn tell(&self, notice: Notice) -> Result<(), SessionEnd> {
        self.tell.send(notice).map_err(|_| SessionEnd::Ledger)
    }

    /// Runs a connection until it ends.
    async fn session(&mut self, was_up: &mut bool) -> Result<(), SessionEnd> {
        let late =
            |_| SessionEnd::Connection(format!("{} did not answer within {ANSWER:?}", self.settings.url));
        let provider =
            tokio::time::timeout(ANSWER, node::connect(&self.settings.url)).await.map_err(late)??;
        let chain = provider.get_chain_id().await?;
        let wanted = self.settings.deployment.chain_id;
        if chain != wanted {
            let url = &self.settings.url;
            let reason = format!(
                "the node at {url} is on chain {chain}, not {wanted}: correct `chain_id` or use another node"
            );
            return Err(SessionEnd::Connection(reason));
        }
        let contract = Address::from(self.settings.deployment.contract.0);
        if provider.get_code_at(contract).await?.is_empty() {
            let reason = format!("there is no contract at {contract} on chain {chain}");
            return Err(SessionEnd::Connection(reason));
        }
        let mut heads = Heads::of(&provider).await?;
        let head = provider.get_block_by_number(BlockNumberOrTag::Latest).await?;
        let head = head.ok_or_else(|| SessionEnd::Connection("the node has no block".to_owned()))?.header;
        self.tell(Notice::Up)?;
        *was_up = true;
        self.outbox.on_connected();
        self.is_connected = false;
        self.on_head(&provider, head).await?;
        loop {
            self.act(&provider, chain).await?;
            tokio::select! {
                head = heads.next(&provider) => {
                    let head = head?.ok_or_else(|| SessionEnd::Connection("the connection broke".to_owned()))?;
                    self.on_head(&provider, head).await?;
                }
                call = self.calls.recv() => {
                    let (ticket, call) = call.ok_or(SessionEnd::Ledger)?;
                    self.outbox.submit(ticket, call);
                }
            }
        }
    }

    /// Reports what a new head adds and retracts.
    async fn on_head(&mut self, provider: &RootProvider, head: Header) -> Result<(), SessionEnd> {
        let hash = BlockHash(head.hash.0);
        if !self.blocks.knows(hash) {
            self.take_in(provider, head).await?;
        } else if self.is_connected {
            return Ok(());
        } else if self.blocks.head().is_some_and(|latest| latest.hash == hash) {
            // Nothing happened while the node was away. Report that now, because the next block may take long.
            self.tell(Notice::Head { number: head.number, time: ChainTime(head.timestamp) })?;
        }
        self.is_connected = true;
        let Some(&Block { number, hash, .. }) = self.blocks.head() else { return Ok(()) };
        if !self.outbox.is_empty() {
            // Without its receipts, included transactions would be taken for absent ones.
            node::await_receipts(provider, hash.0.into()).await?;
        }
        // Query by the head that was read: the node may have a newer one already.
        let mined = provider.get_transaction_count(self.key.signer.address()).number(number).await?;
        self.outbox.on_head(number, mined);
        Ok(())
    }

    async fn take_in(&mut self, provider: &RootProvider, head: Header) -> Result<(), SessionEnd> {
        self.catch_up(provider, head.number).await?;
        // Go from the head back to a known block, usually its parent. At the start, go back to the first block to
        // read.
        let first = self.next_block.unwrap_or(self.settings.from_block);
        let mut news = vec![head];
        loop {
            let oldest = news.last().expect("it begins with the head");
            let is_first = self.blocks.head().is_none() && oldest.number <= first;
            if is_first || self.blocks.knows(BlockHash(oldest.parent_hash.0)) {
                break;
            }
            if news.len() == DEEPEST || oldest.number == 0 {
                let reason = "the node has switched to another chain".to_owned();
                return Err(SessionEnd::Connection(reason));
            }
            let parent = provider.get_block_by_hash(oldest.parent_hash).await?;
            let parent = parent.ok_or_else(|| SessionEnd::Connection("a block is gone".to_owned()))?;
            news.push(parent.header);
        }
        let head = news.first().expect("it begins with the head");
        let head = Notice::Head { number: head.number, time: ChainTime(head.timestamp) };
        let oldest = news.last().expect("it begins with the head");
        for event in self.blocks.retract_to(BlockHash(oldest.parent_hash.0)) {
            self.tell(Notice::Retracted(event))?;
        }
        for header in news.into_iter().rev() {
            let events = self.events_in(provider, &header).await?;
            for event in &events {
                self.tell(Notice::Event(event.clone()))?;
            }
            self.next_block = Some(header.number + 1);
            self.blocks.push(Block { number: header.number, hash: BlockHash(header.hash.0), events });
        }
        // Only now: the receiver of a head acts on everything reported before it.
        self.tell(head)
    }

    /// Reports the events of blocks too old to be retracted.
    async fn catch_up(&mut self, provider: &RootProvider, head: u64) -> Result<(), SessionEnd> {
        let contract = Address::from(self.settings.deployment.contract.0);
        let mut from = self.next_block.unwrap_or(self.settings.from_block);
        // The last blocks are read one by one. Behind a deeper gap, no known block can be compared.
        let until = head.saturating_sub(DEEPEST as u64 / 2);
        if from >= until {
            return Ok(());
        }
        self.blocks = Blocks::default();
        while from < until {
            let to = (from + RANGE - 1).min(until - 1);
            let filter = Filter::new().address(contract).from_block(from).to_block(to);
            for event in self.events(provider, &filter).await? {
                self.tell(Notice::Event(event))?;
            }
            from = to + 1;
            self.next_block = Some(from);
        }
        Ok(())
    }

    /// Returns the contract's events in a block.
    async fn events_in(&self, provider: &RootProvider, header: &Header) -> Result<Vec<Event>, SessionEnd> {
        let contract = Address::from(self.settings.deployment.contract.0);
        // The header's bloom filter shows whether there may be any.
        if !header.logs_bloom.contains_input(BloomInput::Raw(contract.as_slice())) {
            return Ok(Vec::new());
        }
        let filter = Filter::new().address(contract).at_block_hash(header.hash);
        let events = self.events(provider, &filter).await?;
        if !events.is_empty() {
            return Ok(events);
        }
        // Some nodes have a block before its receipts, and until then find no logs in it.
        node::await_receipts(provider, header.hash).await?;
        self.events(provider, &filter).await
    }

    async fn events(&self, provider: &RootProvider, filter: &Filter) -> Result<Vec<Event>, SessionEnd> {
        let logs = provider.get_logs(filter).await?;
        let decode = |log: &Log| {
            let topics: Vec<[u8; 32]> = log.topics().iter().map(|topic| topic.0).collect();
            abi::decode_event(&topics, &log.data().data)
        };
        // Another contract at the address, or a lying node, is as good as no node.
        logs.iter()
            .map(decode)
            .collect::<Result<_, _>>()
            .map_err(|reason| SessionEnd::Connection(reason.to_string()))
    }

    /// Executes the actions that the outbox requests.
    async fn act(&mut self, provider: &RootProvider, chain: u64) -> Result<(), SessionEnd> {
        while let Some(action) = self.outbox.next() {
            let report = match action {
                Action::Estimate { ticket, call } => {
                    let result = match node::estimate(provider, self.request(&call)).await {
                        Ok(gas) => Ok(gas * GAS_PERCENT / 100 + GAS_ON_TOP),
                        Err(error) => Err(rejection(error)?),
                    };
                    self.outbox.estimated(ticket, result)
                }
                Action::Send { ticket, call, nonce, gas, before } => {
                    self.send(provider, chain, ticket, &call, (nonce, gas, before)).await?
                }
                Action::Check { ticket, hashes } => {
                    let status = self.status(provider, hashes).await?;
                    self.outbox.checked(ticket, status)
                }
            };
            match report {
                Some(Report::Included(ticket)) => self.tell(Notice::Included(ticket))?,
                Some(Report::Refused(ticket, rejection)) => self.tell(Notice::Refused(ticket, rejection))?,
                None => {}
            }
        }
        Ok(())
    }

    async fn send(
        &mut self,
        provider: &RootProvider,
        chain: u64,
        ticket: Ticket,
        call: &Call,
        (nonce, gas, before): (u64, u64, Option<Fees>),
    ) -> Result<Option<Report>, SessionEnd> {
        let (base, tip) = node::current_fees(provider).await?;
        let fees = Fees::offer(base, tip, before);
        let transaction = self.key.sign(TxEip1559 {
            chain_id: chain,
            nonce,
            gas_limit: gas,
            max_fee_per_gas: fees.most,
            max_priority_fee_per_gas: fees.tip,
            to: TxKind::Call(Address::from(self.settings.deployment.contract.0)),
            value: U256::from(call.value().0),
            input: Bytes::from(abi::encode(call)),
            ..TxEip1559::default()
        });
        let hash = TransactionHash(transaction.tx_hash().0);
        self.outbox.sent(ticket, hash, fees);
        let Err(error) = provider.send_raw_transaction(&transaction.encoded_2718()).await else {
            return Ok(None);
        };
        let Some(payload) = error.as_error_resp() else { return Err(error.into()) };
        match Objection::of(&payload.message) {
            Objection::Waits => Ok(None),
            Objection::NonceIsUsed => {
                self.outbox.nonce_is_used(ticket);
                Ok(None)
            }
            Objection::Other => Ok(self.outbox.not_sent(ticket, hash, payload.message.to_string())),
        }
    }

    async fn status(
        &self,
        provider: &RootProvider,
        hashes: Vec<TransactionHash>,
    ) -> Result<Status, SessionEnd> {
        for hash in hashes {
            let Some(receipt) = provider.get_transaction_receipt(hash.0.into()).await? else { continue };
            let Some(block) = receipt.block_number else { continue };
            if receipt.status() {
                return Ok(Status::Included { block });
            }
            // Repeats the call in the block's state to get the contract's error.
            let transaction = provider.get_transaction_by_hash(hash.0.into()).await?;
            let answer = match transaction.map(|t| TransactionRequest::from_recovered_transaction(t.inner)) {
                Some(TransactionRequest { from, to, value, input, .. }) => {
                    let request =
                        TransactionRequest { from, to, value, input, ..TransactionRequest::default() };
                    provider.call(request).block(BlockId::number(block)).await
                }
                None => Ok(Bytes::new()),
            };
            let unknown = || CallError::Node(format!("the transaction {hash} was reverted"));
            let reason = match answer {
                Ok(_) => unknown(),
                Err(error) => rejection(error)?,
            };
            return Ok(Status::Reverted(reason));
        }
        Ok(Status::Absent)
    }

    fn request(&self, call: &Call) -> TransactionRequest {
        TransactionRequest::default()
            .from(self.key.signer.address())
            .to(Address::from(self.settings.deployment.contract.0))
            .value(U256::from(call.value().0))
            .input(TransactionInput::both(Bytes::from(abi::encode(call))))
    }
}

/// Reason for which a node rejects a transaction.
#[derive(Debug, PartialEq, Eq)]
enum Objection {
    /// It already has this transaction, or another with its nonce.
    Waits,
    NonceIsUsed,
    /// A permanent reason.
    Other,
}

impl Objection {
    /// Classifies a node's message. Nodes have no error codes for these.
    fn of(message: &str) -> Self {
        let message = message.to_lowercase();
        let says = |words: &[&str]| words.iter().any(|words| message.contains(words));
        if says(&[
            "already known",
            "already imported",
            "already in the txpool",
            "underpriced",
            "replacement gas too low",
        ]) {
            Self::Waits
        } else if says(&["nonce too low"]) {
            Self::NonceIsUsed
        } else {
            Self::Other
        }
    }
}

/// Converts the error of a call. Errors of the connection are passed on.
fn rejection(error: RpcFailure) -> Result<CallError, SessionEnd> {
    let Some(payload) = error.as_error_resp() else { return Err(error.into()) };
    let contract_error = payload.as_revert_data().and_then(|data| abi::decode_error(&data).ok());
    Ok(contract_error.map_or_else(|| CallError::Node(payload.message.to_string()), CallError::Contract))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waiting_transactions_are_not_mistaken_for_rejected_ones() {
        for (said, means) in [
            // geth, anvil
            ("already known", Objection::Waits),
            ("transaction already imported", Objection::Waits),
            ("replacement transaction underpriced", Objection::Waits),
            ("nonce too low: next nonce 3, tx nonce 2", Objection::NonceIsUsed),
            ("insufficient funds for gas * price + value", Objection::Other),
            // EthereumJS
            ("0x12ab: this transaction is already in the TxPool", Objection::Waits),
            ("replacement gas too low, got tip 1, min: 2, got fee 3, min: 4", Objection::Waits),
            (
                "0x12ab tries to send a tx with nonce 2, but account has nonce 3 (tx nonce too low)",
                Objection::NonceIsUsed,
            ),
        ] {
            assert_eq!(Objection::of(said), means, "{said}");
        }
    }
}
