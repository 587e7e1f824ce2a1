//! A network that is there already: looked at before a run begins, so that a wrong URL, another chain, a key store that does not
//! open or an account without money is told before anything is done.

use std::{path::PathBuf, time::Duration};

use cotorra_graph::DomainId;
use cotorra_ledger::Account;

use crate::ledgers::LedgerError;

/// How a domain gets to a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Access {
    /// The domain.
    pub domain: DomainId,
    /// Its node's WebSocket.
    pub url: String,
    /// The file with its key (Web3 Secret Storage, version 3), whose password is in [`PASSWORD`].
    pub key_store: PathBuf,
}

/// The environment variable with the password of key stores, unless settings name another.
pub const PASSWORD: &str = "COTORRA_LEDGER_PASSWORD";

/// A network that all these domains can use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Network {
    /// How they get there.
    pub accesses: Vec<Access>,
    /// The network's chain ID (EIP-155).
    pub chain_id: u64,
    /// The programs of their nodes, as these call themselves, each once.
    pub clients: Vec<String>,
    /// Where the contract is.
    pub contract: Account,
    /// The block that it was deployed in, or any before.
    pub from_block: u64,
    /// How many blocks make a transaction final: 0 where consensus is final at once.
    pub depth: u64,
    /// From block to block.
    pub block_period: Duration,
}

impl Network {
    /// Looks at a network: whether the nodes are of one chain, each domain has a key and money, and the contract is there. Without
    /// `contract`, an address and a block, the first domain deploys it anew. Without `block_period` three blocks are timed.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn join(
        accesses: Vec<Access>,
        contract: Option<(Account, u64)>,
        depth: u64,
        block_period: Option<Duration>,
    ) -> Result<Self, LedgerError> {
        #[cfg(feature = "ethereum")]
        return crate::ethereum::join(accesses, contract, depth, block_period);
        #[cfg(not(feature = "ethereum"))]
        {
            let _ = (accesses, contract, depth, block_period);
            Err(LedgerError::LeftOut)
        }
    }
}
