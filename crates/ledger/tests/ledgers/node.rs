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
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{common::program, operator::Operator};

/// How long anything may take; far more than it does, even on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

pub struct Node {
    anvil: Option<Anvil>,
    program: PathBuf,
    folder: TempDir,
    contract: Account,
    port: u16,
    /// The nodes of a network that is there already.
    existing: Vec<String>,
}

/// The key of a test's operator.
pub fn key(number: u8) -> Key {
    Key::from_bytes([number; 32]).unwrap()
}

impl Node {
    /// A node; `None` where there is no anvil.
    pub fn start() -> Option<Self> {
        let mut node = Self {
            anvil: None,
            program: program()?,
            folder: tempfile::tempdir().unwrap(),
            contract: Account::default(),
            port: 0,
            existing: Vec::new(),
        };
        node.restart();
        let deployer = key(99);
        node.enrich(deployer.account());
        (node.contract, _) = ethereum::deploy(&node.url(1), &deployer).unwrap();
        Some(node)
    }

    /// The network with nodes at these WebSockets, on which the operators of tests have money; the contract is deployed anew.
    pub fn existing(urls: &[&str]) -> Self {
        let (contract, _) = ethereum::deploy(urls[0], &key(99)).unwrap();
        let (anvil, program, folder) = (None, PathBuf::new(), tempfile::tempdir().unwrap());
        let existing = urls.iter().map(|url| (*url).to_owned()).collect();
        Self { anvil, program, folder, contract, port: 0, existing }
    }

    /// The node again, with the chain that it had, where it was.
    pub fn restart(&mut self) {
        let state = Some(self.folder.path().join("state.json"));
        let settings = anvil::Settings {
            program: Some(self.program.clone()),
            state,
            port: self.port,
            block_period: None,
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
    fn url(&self, operator: u8) -> String {
        match self.existing.len() {
            0 => format!("ws://127.0.0.1:{}", self.port),
            count => self.existing[(usize::from(operator) - 1) % count].clone(),
        }
    }

    fn enrich(&self, account: Account) {
        if !self.existing.is_empty() {
            return;
        }
        self.rpc("anvil_setBalance", &format!("[\"{account}\", \"0xffffffffffffffffffff\"]"));
    }

    /// A registered operator with money.
    pub fn operator(&self, number: u8) -> Operator {
        self.enrich(key(number).account());
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
        let settings = Settings { url: self.url(number), contract: self.contract, from_block: 0, depth: 2 };
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
