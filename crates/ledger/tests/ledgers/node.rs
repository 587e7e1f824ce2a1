//! An anvil node with the contract, that a test can torment.

use std::{
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use cotorra_ledger::{
    Account, Wei,
    ethereum::{
        self, EthereumLedger, Key, Settings,
        anvil::{self, Anvil},
    },
};
use parking_lot::Mutex;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{common::program, operator::Operator};

/// How long anything may take; far more than it does, even on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// The account with the money of an existing network is one test's at a time: its transactions have numbers.
static DEPLOYER: Mutex<()> = Mutex::new(());

pub struct Node {
    anvil: Option<Anvil>,
    program: PathBuf,
    folder: TempDir,
    contract: Account,
    port: u16,
    block_period: Option<Duration>,
    /// The nodes of a network that is there already.
    existing: Vec<String>,
}

/// The key of a test's operator.
pub fn key(number: u8) -> Key {
    Key::from_bytes([number; 32]).unwrap()
}

impl Node {
    /// A node that makes a block for each transaction; `None` where there is no anvil.
    pub fn start() -> Option<Self> {
        Self::start_with(None)
    }

    /// A node that makes a block each period.
    pub fn start_with(block_period: Option<Duration>) -> Option<Self> {
        let mut node = Self {
            block_period,
            anvil: None,
            program: program()?,
            folder: tempfile::tempdir().unwrap(),
            contract: Account::default(),
            port: 0,
            existing: Vec::new(),
        };
        node.restart();
        node.enrich(99);
        (node.contract, _) = ethereum::deploy(&node.url(1), &key(99)).unwrap();
        Some(node)
    }

    /// The network with nodes at these WebSockets, on which the operators of tests have money; the contract is deployed anew.
    pub fn existing(urls: &[&str]) -> Self {
        let _alone = DEPLOYER.lock();
        let (contract, _) = ethereum::deploy(urls[0], &key(99)).unwrap();
        let (anvil, program, folder) = (None, PathBuf::new(), tempfile::tempdir().unwrap());
        let existing = urls.iter().map(|url| (*url).to_owned()).collect();
        Self { anvil, program, folder, contract, port: 0, block_period: None, existing }
    }

    /// The node again, with the chain that it had, where it was.
    pub fn restart(&mut self) {
        let state = Some(self.folder.path().join("state.json"));
        let settings = anvil::Settings {
            program: Some(self.program.clone()),
            state,
            port: self.port,
            block_period: self.block_period,
        };
        let anvil = Anvil::start(&settings).unwrap();
        self.port = anvil.address().port();
        self.anvil = Some(anvil);
    }

    /// Ends the node.
    pub fn stop(&mut self) {
        self.anvil.take().unwrap().stop();
    }

    /// The node of an operator: each has another, where there are several.
    pub fn url(&self, operator: u8) -> String {
        match self.existing.len() {
            0 => format!("ws://127.0.0.1:{}", self.port),
            count => self.existing[(usize::from(operator) - 1) % count].clone(),
        }
    }

    /// Gives an operator money. On a network that is there already, its genesis did, or [`Node::share`].
    pub fn enrich(&self, number: u8) {
        if self.existing.is_empty() {
            let account = key(number).account();
            self.rpc("anvil_setBalance", &format!("[\"{account}\", \"0xffffffffffffffffffff\"]"));
        }
    }

    /// Shares the money of the deployer's account with other operators.
    pub fn share(&self, numbers: impl Iterator<Item = u8>) {
        use alloy::{
            network::EthereumWallet, providers::*, rpc::types::TransactionRequest,
            signers::local::PrivateKeySigner,
        };
        if self.existing.is_empty() {
            return numbers.for_each(|number| self.enrich(number));
        }
        let _alone = DEPLOYER.lock();
        let share = async || {
            let wallet = EthereumWallet::from(PrivateKeySigner::from_slice(&[99; 32]).unwrap());
            let provider = ProviderBuilder::new().wallet(wallet).connect(&self.existing[0]).await.unwrap();
            let first = provider.get_transaction_count(provider.default_signer_address()).await.unwrap();
            let mut last = None;
            // All that a wallet would ask the node for: not all of it is what every node knows.
            for (nonce, number) in (first..).zip(numbers) {
                let to = alloy::primitives::Address::from(key(number).account().0);
                let request = TransactionRequest::default()
                    .to(to)
                    .value(alloy::primitives::U256::from(10_u128.pow(19)))
                    .nonce(nonce)
                    .gas_limit(21_000)
                    .max_fee_per_gas(20_000_000_000)
                    .max_priority_fee_per_gas(1_000_000_000);
                last = Some(provider.send_transaction(request).await.unwrap());
            }
            last.unwrap().get_receipt().await.unwrap();
        };
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(share());
    }

    /// A registered operator with money.
    pub fn operator(&self, number: u8) -> Operator {
        self.enrich(number);
        let mut operator = self.reconnect(number);
        operator.register();
        operator
    }

    /// One without money.
    pub fn poor_operator(&self, number: u8) -> Operator {
        self.reconnect(number)
    }

    /// An operator that may have been there before.
    pub fn reconnect(&self, number: u8) -> Operator {
        self.reconnect_at(number, self.url(number))
    }

    /// The same by another URL.
    pub fn reconnect_at(&self, number: u8, url: String) -> Operator {
        let settings = Settings { url, contract: self.contract, from_block: 0, depth: 2 };
        Operator::new(EthereumLedger::connect(settings, key(number)).unwrap(), key(number))
    }

    /// How many transactions of an operator are on the chain.
    pub fn transactions(&self, operator: &Operator) -> u64 {
        let account = operator.key.account();
        let count = self.rpc("eth_getTransactionCount", &format!("[\"{account}\", \"latest\"]"));
        u64::from_str_radix(&count.as_str().unwrap()[2..], 16).unwrap()
    }

    /// What the contract has.
    pub fn holds(&self) -> Wei {
        let balance = self.rpc("eth_getBalance", &format!("[\"{}\", \"latest\"]", self.contract));
        Wei(u128::from_str_radix(&balance.as_str().unwrap()[2..], 16).unwrap())
    }

    /// What the node answers.
    pub fn rpc(&self, method: &str, params: &str) -> Value {
        let params: Value = serde_json::from_str(params).unwrap();
        let request = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": params });
        let url = format!("http://127.0.0.1:{}", self.port);
        let mut answer: Value = ureq::post(url).send_json(request).unwrap().body_mut().read_json().unwrap();
        assert!(answer.get("error").is_none(), "{method}: {answer}");
        answer["result"].take()
    }

    /// Waits.
    pub fn until(&self, what: &str, mut condition: impl FnMut() -> bool) {
        let began = Instant::now();
        while !condition() {
            assert!(began.elapsed() < PATIENCE, "not within {PATIENCE:?}: {what}");
            thread::sleep(Duration::from_millis(5));
        }
    }
}
