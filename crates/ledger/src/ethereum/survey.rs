//! Surveys a network before a run takes part in it, so that wrong settings are reported at once instead of by a
//! negotiation that never begins.
#![allow(clippy::disallowed_types, reason = "measures the time between blocks")]

use std::time::{Duration, Instant};

use alloy::{primitives::Address, providers::Provider};

use super::node::{self, ANSWER, EthereumError, Heads, RpcFailure};
use crate::values::{Account, Wei};

/// A node's answers about its network and an account.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Survey {
    /// Chain ID (EIP-155).
    pub chain_id: u64,
    /// Name of the node's program.
    pub client: String,
    /// Balance of the account.
    pub balance: Wei,
    /// Whether there is a contract at the requested address.
    pub has_contract: bool,
}

/// Surveys a network through a node.
///
/// # Errors
/// [`EthereumError`].
pub fn survey(url: &str, account: Account, contract: Option<Account>) -> Result<Survey, EthereumError> {
    ask(url, ANSWER, async {
        let provider = node::connect(url).await?;
        let balance = provider.get_balance(Address::from(account.0)).await?;
        let has_contract = match contract {
            Some(contract) => !provider.get_code_at(Address::from(contract.0)).await?.is_empty(),
            None => false,
        };
        Ok(Survey {
            chain_id: provider.get_chain_id().await?,
            client: provider.get_client_version().await?,
            // Saturates at more than all the money there is.
            balance: Wei(balance.saturating_to()),
            has_contract,
        })
    })
}

/// Number of blocks to time.
const TIMED: u32 = 3;
/// Longest block period to wait for.
const LONGEST: Duration = Duration::from_secs(60);

/// Measures the mean time between the next three blocks.
///
/// # Errors
/// [`EthereumError`], also if blocks are more than a minute apart.
pub fn block_period(url: &str) -> Result<Duration, EthereumError> {
    ask(url, ANSWER + LONGEST * (TIMED + 1), async {
        let provider = node::connect(url).await?;
        let mut heads = Heads::of(&provider).await?;
        let mut received: Option<(u64, u64)> = None;
        let mut began = Instant::now();
        while let Some(head) = heads.next(&provider).await? {
            match received {
                // The first may be of any age.
                None => received = Some((head.number, 0)),
                Some((known, 0)) if head.number > known => {
                    (received, began) = (Some((head.number, head.number)), Instant::now());
                }
                Some((_, first)) if first > 0 && head.number >= first + u64::from(TIMED) => {
                    let blocks = u32::try_from(head.number - first).unwrap_or(u32::MAX);
                    return Ok(began.elapsed() / blocks);
                }
                Some(_) => {}
            }
        }
        Err(alloy::transports::TransportErrorKind::backend_gone())
    })
}

/// Waits for an answer within a deadline.
fn ask<T>(
    url: &str,
    patience: Duration,
    answer: impl Future<Output = Result<T, RpcFailure>>,
) -> Result<T, EthereumError> {
    let node = |reason: String| EthereumError::Node { url: url.to_owned(), reason };
    let answer = async { tokio::time::timeout(patience, answer).await };
    match node::runtime()?.block_on(answer) {
        Ok(answer) => answer.map_err(|error| node(error.to_string())),
        Err(_) => Err(node(format!("no answer within {patience:?}"))),
    }
}
