//! Requests to an Ethereum node: connection, fees, and deployment of the contract.

use std::time::Duration;

use alloy::{
    consensus::TxEip1559,
    eips::{BlockId, BlockNumberOrTag, eip2718::Encodable2718},
    primitives::{B256, Bytes, TxKind},
    providers::{Provider, ProviderBuilder, RootProvider},
    pubsub::Subscription,
    rpc::types::{Header, TransactionInput, TransactionReceipt, TransactionRequest},
    transports::{RpcError, TransportErrorKind},
};
use tokio::{
    runtime::{Builder, Runtime},
    time::{Interval, MissedTickBehavior},
};

use super::{abi, key::Key, socket::NoDelay};
use crate::{
    outbox::Fees,
    values::{Account, Deployment},
};

/// A network that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum EthereumError {
    /// The node does not answer, or answers with an error.
    #[error("the ledger's node at {url} failed: {reason}")]
    Node { url: String, reason: String },
    /// No thread could be started.
    #[error("cannot start a thread for the ledger's client: {0}")]
    Thread(std::io::Error),
}

/// Deadline of a node's answer.
pub(super) const ANSWER: Duration = Duration::from_secs(10);

pub(super) type RpcFailure = RpcError<TransportErrorKind>;

/// Deploys the contract, and waits until it is in a block. Returns its deployment and the block.
///
/// # Errors
/// [`EthereumError`].
pub fn deploy(url: &str, key: &Key) -> Result<(Deployment, u64), EthereumError> {
    let node = |reason: String| EthereumError::Node { url: url.to_owned(), reason };
    let created = runtime()?.block_on(create(url, key));
    let (chain_id, receipt) = created.map_err(|reason| node(reason.to_string()))?;
    match (receipt.status(), receipt.contract_address, receipt.block_number) {
        (true, Some(address), Some(block)) => {
            Ok((Deployment { chain_id, contract: Account(address.into()) }, block))
        }
        _ => Err(node("it did not deploy the contract".to_owned())),
    }
}

async fn create(url: &str, key: &Key) -> Result<(u64, TransactionReceipt), RpcFailure> {
    let provider = connect(url).await?;
    let from = key.signer.address();
    let input = Bytes::from(abi::bytecode());
    // Under both names: nodes know one or the other.
    let input_of = TransactionInput::both(input.clone());
    let request = TransactionRequest { from: Some(from), input: input_of, ..Default::default() };
    let (base, tip) = current_fees(&provider).await?;
    let fees = Fees::offer(base, tip, None);
    let chain_id = provider.get_chain_id().await?;
    let transaction = key.sign(TxEip1559 {
        chain_id,
        nonce: provider.get_transaction_count(from).pending().await?,
        gas_limit: estimate(&provider, request).await?,
        max_fee_per_gas: fees.most,
        max_priority_fee_per_gas: fees.tip,
        to: TxKind::Create,
        input,
        ..TxEip1559::default()
    });
    let hash = *provider.send_raw_transaction(&transaction.encoded_2718()).await?.tx_hash();
    let asks = DEPLOYMENT.as_millis() / ASK.as_millis();
    for _ in 0..asks {
        if let Some(receipt) = provider.get_transaction_receipt(hash).await? {
            return Ok((chain_id, receipt));
        }
        tokio::time::sleep(ASK).await;
    }
    Err(TransportErrorKind::custom_str(&format!(
        "the transaction {hash} is in no block after {DEPLOYMENT:?}"
    )))
}

pub(super) fn runtime() -> Result<Runtime, EthereumError> {
    Builder::new_current_thread().enable_all().build().map_err(EthereumError::Thread)
}

pub(super) async fn connect(url: &str) -> Result<RootProvider, RpcFailure> {
    ProviderBuilder::default().connect_pubsub_with(NoDelay::new(url)).await
}

/// Deadline for the contract to be in a block.
const DEPLOYMENT: Duration = Duration::from_secs(120);
/// Tip if a node cannot suggest one: 1 Gwei.
const TIP: u128 = 1_000_000_000;

/// Returns the base fee of the last block and the usual tip.
pub(super) async fn current_fees(provider: &RootProvider) -> Result<(u128, u128), RpcFailure> {
    let head = provider.get_block_by_number(BlockNumberOrTag::Latest).await?;
    let base = head.and_then(|block| block.header.base_fee_per_gas).unwrap_or_default();
    // Not all nodes have this method.
    let tip = match provider.get_max_priority_fee_per_gas().await {
        Err(error) if error.as_error_resp().is_some() => TIP,
        tip => tip?.max(1),
    };
    Ok((base.into(), tip))
}

/// Estimates the gas of a call after those pending, if the node knows of pending ones.
pub(super) async fn estimate(
    provider: &RootProvider,
    request: TransactionRequest,
) -> Result<u64, RpcFailure> {
    match provider.estimate_gas(request.clone()).pending().await {
        Err(error) if error.as_error_resp().is_some_and(|e| e.message.contains("not yet supported")) => {
            provider.estimate_gas(request).block(BlockId::latest()).await
        }
        gas => gas,
    }
}

/// Pause between attempts to read a block's receipts, and their number.
const RECEIPTS: (Duration, u32) = (Duration::from_millis(20), 500);

/// Waits until a node has all receipts of a block. Some have the block before them.
pub(super) async fn await_receipts(provider: &RootProvider, block: B256) -> Result<(), RpcFailure> {
    for _ in 0..RECEIPTS.1 {
        // A node that no longer knows the block has no receipts to wait for.
        let Some(block) = provider.get_block_by_hash(block).await? else { return Ok(()) };
        let Some(last) = block.transactions.hashes().last() else { return Ok(()) };
        if provider.get_transaction_receipt(last).await?.is_some() {
            return Ok(());
        }
        tokio::time::sleep(RECEIPTS.0).await;
    }
    Err(TransportErrorKind::custom_str(&format!("the node has the block {block}, but not its receipts")))
}

/// The heads of the chain as they arrive.
pub(super) enum Heads {
    /// The node announces them.
    Announced(Subscription<Header>),
    /// The node has no subscriptions, and is polled.
    Polled(Interval),
}

/// Interval of polling the head.
const ASK: Duration = Duration::from_millis(50);

impl Heads {
    pub(super) async fn of(provider: &RootProvider) -> Result<Self, RpcFailure> {
        /// JSON-RPC 2.0, 5.1.
        const METHOD_NOT_FOUND: i64 = -32601;
        match provider.subscribe_blocks().await {
            Err(error) if error.as_error_resp().is_some_and(|e| e.code == METHOD_NOT_FOUND) => {
                let mut interval = tokio::time::interval(ASK);
                // Does not poll a slow node faster.
                interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
                Ok(Self::Polled(interval))
            }
            heads => heads.map(Self::Announced),
        }
    }

    /// Returns the next head, or the same again; `None` if the connection broke. May be dropped and called anew at
    /// any time.
    pub(super) async fn next(&mut self, provider: &RootProvider) -> Result<Option<Header>, RpcFailure> {
        match self {
            Self::Announced(heads) => Ok(heads.recv().await.ok()),
            Self::Polled(interval) => {
                interval.tick().await;
                let head = provider.get_block_by_number(BlockNumberOrTag::Latest).await?;
                Ok(head.map(|block| block.header))
            }
        }
    }
}
