//! A network that is there already: looked at before a run begins, so that a wrong URL, another chain, a key store that does not
//! open or an account without money is told before anything is done.

use std::{path::PathBuf, time::Duration};

use cotorra_graph::DomainId;
use cotorra_ledger::Account;

use crate::error::LedgerError;

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
        // To the hundredth: nobody sets it finer, and three blocks say no more.
        None => {
            let timed = ethereum::block_period(&access.url).map_err(LedgerError::real)?.as_secs_f64();
            Duration::from_secs_f64((timed * 100.0).round().max(1.0) / 100.0)
        }
    };
    let clients = clients.into_iter().collect();
    Ok(Network { accesses, chain_id, clients, contract, from_block, depth, block_period })
}
