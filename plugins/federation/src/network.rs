//! Existing Ethereum networks. A network is checked before a run begins, so that a wrong URL or chain, an unreadable
//! key store, or an account without money is reported before anything else happens.

use std::{path::PathBuf, time::Duration};

use cotorra_graph::DomainId;
use cotorra_ledger::Account;

use crate::error::LedgerError;

/// A domain's access to a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Access {
    pub domain: DomainId,
    /// WebSocket of its node.
    pub url: String,
    /// File with its key (Web3 Secret Storage, version 3). The password is in [`PASSWORD`].
    pub key_store: PathBuf,
}

/// Environment variable with the password of key stores, unless settings name another.
pub const PASSWORD: &str = "COTORRA_LEDGER_PASSWORD";

/// A network that all of its domains can use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Network {
    /// The domains' accesses.
    pub accesses: Vec<Access>,
    /// Chain ID (EIP-155).
    pub chain_id: u64,
    /// Distinct programs of the domains' nodes, by their own names.
    pub clients: Vec<String>,
    /// Address of the contract.
    pub contract: Account,
    /// Block of the contract's deployment, or any earlier one.
    pub from_block: u64,
    /// Number of further blocks that make a transaction final: 0 if consensus is final at once.
    pub depth: u64,
    /// Time between blocks.
    pub block_period: Duration,
}

impl Network {
    /// Checks a network: all nodes must be of one chain, each domain needs a key and money, and the contract must
    /// exist. Without `contract`, an address and a block, the first domain deploys a new one. Without `block_period`,
    /// three blocks are timed.
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
        return join(accesses, contract, depth, block_period);
        #[cfg(not(feature = "ethereum"))]
        {
            let _ = (accesses, contract, depth, block_period);
            Err(LedgerError::LeftOut)
        }
    }
}

#[cfg(feature = "ethereum")]
fn join(
    accesses: Vec<Access>,
    contract: Option<(Account, u64)>,
    depth: u64,
    block_period: Option<Duration>,
) -> Result<Network, LedgerError> {
    use std::collections::BTreeSet;

    use cotorra_ledger::ethereum::{self, Key, Password};

    let (mut keys, mut accounts, mut surveys) = (Vec::new(), BTreeSet::new(), Vec::new());
    for access in &accesses {
        let Access { domain, url, key_store } = access;
        let of_domain =
            |reason: &dyn ToString| LedgerError::real(format!("{domain}: {}", reason.to_string()));
        let key = Key::open(key_store, &Password::Environment(PASSWORD.to_owned()));
        let key = key.map_err(|e| of_domain(&e))?;
        let account = key.account();
        if !accounts.insert(account) {
            return Err(of_domain(&format!(
                "another domain has the account {account}, too; each needs its own"
            )));
        }
        let of_contract = contract.map(|(address, _)| address);
        let survey = ethereum::survey(url, account, of_contract).map_err(|e| of_domain(&e))?;
        if survey.balance.0 == 0 {
            let poor =
                format!("its account {account} has no money on the chain {} for fees", survey.chain_id);
            return Err(of_domain(&poor));
        }
        if let Some(address) = of_contract.filter(|_| !survey.has_contract) {
            let chain = survey.chain_id;
            return Err(of_domain(&format!("there is no contract at {address} on the chain {chain}")));
        }
        keys.push(key);
        surveys.push(survey);
    }
    let (Some(first), Some(key), Some(access)) = (surveys.first(), keys.first(), accesses.first()) else {
        return Err(LedgerError::real("no domain has a ledger"));
    };
    let chain_id = first.chain_id;
    if let Some(other) = surveys.iter().find(|survey| survey.chain_id != chain_id) {
        let other = other.chain_id;
        return Err(LedgerError::real(format!(
            "the domains' nodes are of two chains, {chain_id} and {other}"
        )));
    }
    let clients: BTreeSet<_> = surveys.iter().map(|survey| survey.client.clone()).collect();
    let (contract, from_block) = match contract {
        Some(there) => there,
        None => {
            let (deployment, block) = ethereum::deploy(&access.url, key).map_err(LedgerError::real)?;
            (deployment.contract, block)
        }
    };
    let block_period = match block_period {
        Some(period) => period,
        // Rounded to a hundredth: three blocks are no more precise.
        None => {
            let timed = ethereum::block_period(&access.url).map_err(LedgerError::real)?.as_secs_f64();
            Duration::from_secs_f64((timed * 100.0).round().max(1.0) / 100.0)
        }
    };
    let clients = clients.into_iter().collect();
    Ok(Network { accesses, chain_id, clients, contract, from_block, depth, block_period })
}
