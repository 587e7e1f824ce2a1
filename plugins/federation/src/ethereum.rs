//! Real ledgers: an anvil node started with the run, or any Ethereum network.

use std::{path::PathBuf, time::Duration};

use cotorra_ledger::{
    Deployment, Ledger, Secret,
    ethereum::{self, EthereumLedger, Key, Password, anvil},
};

use crate::{error::LedgerError, settings::Joining};

/// The well-known keys of anvil's accounts, which have money on every anvil node.
const KEYS: [&str; 10] = [
    "ac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80",
    "59c6995e998f97a5a0044966f0945389dc9e86dae88c7a8412f4603b6b78690d",
    "5de4111afa1a4b94908f83103eb1f1706367c2e68ca870fc3fb9a804cdab365a",
    "7c852118294e51e653712a81e05800f419141751be58f605c371e15141b007a6",
    "47e179ec197488593b187f80a00eb0da91f1b9d0b13f8733639f19c30a34926a",
    "8b3a350cf5c34c9194ca85829a2df0ec3153be0318b5e2d3348e872092edffba",
    "92db14e403b83dfe3df233f83dfa3a0d7096f21ca9b0d6d6b8d88b2b4ec1564e",
    "4bbbf85ce3377467afe5d46f804f221813b2bb87f24d81f60f1fcdbf7cbf4356",
    "dbda1821b80551c9d65939329250298aa3472ba22feea921c0cf5d620ea67b97",
    "2a871d0798f97d79848a013d4936a73bf4cc922c825d33c1cf7073dff6d409c6",
];

/// An anvil node with the contract on it. Dropping it ends the node.
#[derive(Debug)]
pub(crate) struct Node {
    block_period: Duration,
    url: String,
    deployment: Deployment,
    from_block: u64,
    /// Number of its accounts in use.
    taken: usize,
    _anvil: anvil::Anvil,
}

impl Node {
    /// Starts a node, and deploys the contract in its first block.
    pub(crate) fn start(block_period: Duration, program: Option<PathBuf>) -> Result<Self, LedgerError> {
        let settings =
            anvil::Settings { program, block_period: Some(block_period), ..anvil::Settings::default() };
        let anvil = anvil::Anvil::start(&settings).map_err(LedgerError::real)?;
        let url = format!("ws://{}", anvil.address());
        let (deployment, from_block) = ethereum::deploy(&url, &key(KEYS[0])).map_err(LedgerError::real)?;
        Ok(Self { block_period, url, deployment, from_block, taken: 0, _anvil: anvil })
    }

    pub(crate) fn block_period(&self) -> Duration {
        self.block_period
    }

    /// Opens the access of another domain.
    pub(crate) fn open(&mut self) -> Result<(Box<dyn Ledger>, Secret), LedgerError> {
        let key = KEYS.get(self.taken).map(|text| key(text)).ok_or_else(|| {
            LedgerError::real(format!(
                "an anvil node has accounts for {} domains: use a network of your own for more",
                KEYS.len()
            ))
        })?;
        self.taken += 1;
        connect(&self.url, self.deployment, self.from_block, 0, key)
    }
}

/// Opens a domain's access to a network.
pub(crate) fn open(network: &Joining) -> Result<(Box<dyn Ledger>, Secret), LedgerError> {
    let password = match &network.password_file {
        Some(path) => Password::File(path.clone()),
        None => Password::Environment(network.password_variable.clone()),
    };
    let key = Key::open(&network.key_store, &password).map_err(LedgerError::real)?;
    let contract = network.contract.parse().map_err(LedgerError::real)?;
    let deployment = Deployment { chain_id: network.chain_id, contract };
    connect(&network.url, deployment, network.from_block, network.depth, key)
}

fn connect(
    url: &str,
    deployment: Deployment,
    from_block: u64,
    depth: u64,
    key: Key,
) -> Result<(Box<dyn Ledger>, Secret), LedgerError> {
    let secret = key.secret(deployment);
    let settings = ethereum::Settings { url: url.to_owned(), deployment, from_block, depth };
    let ledger = EthereumLedger::connect(settings, key).map_err(LedgerError::real)?;
    Ok((Box::new(ledger), secret))
}

fn key(text: &str) -> Key {
    let byte =
        |i: usize| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).expect("the keys above are hexadecimal");
    Key::from_bytes(std::array::from_fn(byte)).expect("the keys above are keys")
}
