//! What is asked of an Ethereum node, whoever asks: a connection, fees, and a place for the contract.

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

use super::{abi, key::Key, socket::AtOnce};
use crate::{
    outbox::Fees,
    values::{Account, Deployment},
};

/// Why a network cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum EthereumError {
    /// The node does not answer, or answers with an error.
    #[error("the ledger's node at {url} does not do as asked: {reason}")]
    Node {
        /// The node.
        url: String,
        /// Why not.
        reason: String,
    },
    /// No thread for it.
    #[error("there is no thread for the ledger's client: {0}")]
    Thread(std::io::Error),
}

/// So long a node may take for an answer.
pub(super) const ANSWER: Duration = Duration::from_secs(10);

pub(super) type Failed = RpcError<TransportErrorKind>;

/// Deploys the contract, and waits until it is in a block. Returns where it is, and the block.
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

async fn create(url: &str, key: &Key) -> Result<(u64, TransactionReceipt), Failed> {
    let provider = connect(url).await?;
    let from = key.signer.address();
    let input = Bytes::from(abi::bytecode());
    // By both names: nodes know the one or the other.
    let input_of = TransactionInput::both(input.clone());
    let request = TransactionRequest { from: Some(from), input: input_of, ..Default::default() };
    let (base, tip) = asked(&provider).await?;
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

pub(super) async fn connect(url: &str) -> Result<RootProvider, Failed> {
    ProviderBuilder::default().connect_pubsub_with(AtOnce::new(url)).await
}

/// So long a network may take to have the contract in a block.
const DEPLOYMENT: Duration = Duration::from_secs(120);
/// Where a node cannot say what tip is usual: 1 Gwei.
const TIP: u128 = 1_000_000_000;

/// The base fee of the last block, and the tip that is usual.
pub(super) async fn asked(provider: &RootProvider) -> Result<(u128, u128), Failed> {
    let head = provider.get_block_by_number(BlockNumberOrTag::Latest).await?;
    let base = head.and_then(|block| block.header.base_fee_per_gas).unwrap_or_default();
    // Not all nodes have this one.
    let tip = match provider.get_max_priority_fee_per_gas().await {
        Err(error) if error.as_error_resp().is_some() => TIP,
        tip => tip?.max(1),
    };
    Ok((base.into(), tip))
}

/// The gas that a call takes, behind those that wait, where the node knows of such.
pub(super) async fn estimate(provider: &RootProvider, request: TransactionRequest) -> Result<u64, Failed> {
    match provider.estimate_gas(request.clone()).pending().await {
        Err(error) if error.as_error_resp().is_some_and(|e| e.message.contains("not yet supported")) => {
            provider.estimate_gas(request).block(BlockId::latest()).await
        }
        gas => gas,
    }
}

/// Between two attempts to have a block's receipts, and how many there are.
const RECEIPTS: (Duration, u32) = (Duration::from_millis(20), 500);

/// Waits until a node has all receipts of a block: some have the block before them.
pub(super) async fn await_receipts(provider: &RootProvider, block: B256) -> Result<(), Failed> {
    for _ in 0..RECEIPTS.1 {
        // One that does not know the block any more has nothing of it to wait for.
        let Some(block) = provider.get_block_by_hash(block).await? else { return Ok(()) };
        let Some(last) = block.transactions.hashes().last() else { return Ok(()) };
        if provider.get_transaction_receipt(last).await?.is_some() {
            return Ok(());
        }
        tokio::time::sleep(RECEIPTS.0).await;
    }
    Err(TransportErrorKind::custom_str(&format!("the node has the block {block}, but not its receipts")))
}

/// The heads of the chain as they come.
pub(super) enum Heads {
    /// The node tells.
    Told(Subscription<Header>),
    /// The node has no subscriptions, and is asked.
    Asked(Interval),
}

/// Between two questions for the head.
const ASK: Duration = Duration::from_millis(50);

impl Heads {
    pub(super) async fn of(provider: &RootProvider) -> Result<Self, Failed> {
        /// JSON-RPC 2.0, 5.1.
        const METHOD_NOT_FOUND: i64 = -32601;
        match provider.subscribe_blocks().await {
            Err(error) if error.as_error_resp().is_some_and(|e| e.code == METHOD_NOT_FOUND) => {
                let mut interval = tokio::time::interval(ASK);
                // A node that is slow is not asked all the more.
                interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
                Ok(Self::Asked(interval))
            }
            heads => heads.map(Self::Told),
        }
    }

    /// The next head, or the same again; `None`: the connection is broken. Can be dropped and asked anew at any time.
    pub(super) async fn next(&mut self, provider: &RootProvider) -> Result<Option<Header>, Failed> {
        match self {
            Self::Told(heads) => Ok(heads.recv().await.ok()),
            Self::Asked(interval) => {
                interval.tick().await;
                let head = provider.get_block_by_number(BlockNumberOrTag::Latest).await?;
                Ok(head.map(|block| block.header))
            }
        }
    }
}
