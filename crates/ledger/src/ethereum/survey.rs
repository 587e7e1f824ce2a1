//! What there is to know of a network before anybody takes part in it: a mistake in how it is reached is told at once, and not
//! by a negotiation that never begins.
#![allow(clippy::disallowed_types, reason = "the shell that owns the clock: blocks are timed as they come")]

use std::time::{Duration, Instant};

use alloy::{primitives::Address, providers::Provider};

use super::node::{self, ANSWER, EthereumError, Failed, Heads};
use crate::values::{Account, Wei};

/// What a node says of its network and of an account there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Survey {
    /// The network's chain ID (EIP-155).
    pub chain_id: u64,
    /// The node's program, as it calls itself.
    pub client: String,
    /// What the account has.
    pub balance: Wei,
    /// Whether there is a contract where one was asked for.
    pub has_contract: bool,
}

/// Asks a node.
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
            // More than all the money there is would be as much as fits.
            balance: Wei(balance.saturating_to()),
            has_contract,
        })
    })
}

/// Blocks that are timed.
const TIMED: u32 = 3;
/// The longest period for which that is waited for.
const LONGEST: Duration = Duration::from_secs(60);

/// How long a network takes from one block to the next, in the mean of the next three, as they come.
///
/// # Errors
/// [`EthereumError`]; also when blocks are more than a minute apart.
pub fn block_period(url: &str) -> Result<Duration, EthereumError> {
    ask(url, ANSWER + LONGEST * (TIMED + 1), async {
        let provider = node::connect(url).await?;
        let mut heads = Heads::of(&provider).await?;
        let mut heard: Option<(u64, u64)> = None;
        let mut began = Instant::now();
        while let Some(head) = heads.next(&provider).await? {
            match heard {
                // The first may be any age.
                None => heard = Some((head.number, 0)),
                Some((known, 0)) if head.number > known => {
                    (heard, began) = (Some((head.number, head.number)), Instant::now());
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

/// Waits for an answer, but not for ever.
fn ask<T>(
    url: &str,
    patience: Duration,
    answer: impl Future<Output = Result<T, Failed>>,
) -> Result<T, EthereumError> {
    let node = |reason: String| EthereumError::Node { url: url.to_owned(), reason };
    let answer = async { tokio::time::timeout(patience, answer).await };
    match node::runtime()?.block_on(answer) {
        Ok(answer) => answer.map_err(|error| node(error.to_string())),
        Err(_) => Err(node(format!("no answer within {patience:?}"))),
    }
}
