//! An anvil node with the contract, under a test's control.

use std::path::PathBuf;

use cotorra_ledger::{
    Deployment, Notice, Ticket, Wei,
    ethereum::{
        self, EthereumLedger, Key, Settings,
        anvil::{self, Anvil},
    },
};
use parking_lot::Mutex;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::operator::Operator;

/// Limit for any condition, in blocks, far more than needed.
pub const BLOCKS: u32 = 1000;

/// Serialises tests that use the rich account of an existing network, because its transactions are numbered.
static DEPLOYER: Mutex<()> = Mutex::new(());

pub struct Node {
    anvil: Option<Anvil>,
    program: PathBuf,
    folder: TempDir,
    deployment: Deployment,
    port: u16,
    blocks: Blocks,
    /// The nodes of an existing network.
    existing: Vec<String>,
}

/// Maker of blocks.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Blocks {
    /// The test, each a second of the chain's time after the last.
    Ours,
    /// The node, one for each transaction.
    ForEachTransaction,
    /// The network.
    Theirs,
}

/// The key of a test's operator.
pub fn key(number: u8) -> Key {
    Key::from_bytes([number; 32]).unwrap()
}

impl Node {
    /// Starts a node whose blocks the test makes; `None` without anvil.
    pub fn start() -> Option<Self> {
        Self::start_with(Blocks::Ours)
    }

    /// Starts a node that makes a block for each transaction.
    pub fn start_automatic() -> Option<Self> {
        Self::start_with(Blocks::ForEachTransaction)
    }

    fn start_with(blocks: Blocks) -> Option<Self> {
        let mut node = Self {
            blocks: Blocks::ForEachTransaction,
            anvil: None,
            program: cotorra_testing::anvil()?,
            folder: tempfile::tempdir().unwrap(),
            deployment: Deployment::default(),
            port: 0,
            existing: Vec::new(),
        };
        node.restart();
        node.enrich(99);
        (node.deployment, _) = ethereum::deploy(&node.url(1), &key(99)).unwrap();
        node.blocks = blocks;
        node.prepare();
        Some(node)
    }

    /// Uses the network with nodes at these WebSockets, on which the test operators have money. The contract is
    /// deployed anew.
    pub fn existing(urls: &[&str]) -> Self {
        let _alone = DEPLOYER.lock();
        let (deployment, _) = ethereum::deploy(urls[0], &key(99)).unwrap();
        let (anvil, program, folder) = (None, PathBuf::new(), tempfile::tempdir().unwrap());
        let existing = urls.iter().map(|url| (*url).to_owned()).collect();
        Self { anvil, program, folder, deployment, port: 0, blocks: Blocks::Theirs, existing }
    }

    /// Restarts the node with its chain at the same address.
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
        self.prepare();
    }

    fn prepare(&self) {
        if self.blocks == Blocks::Ours {
            self.rpc("evm_setAutomine", "[false]");
            self.rpc("anvil_setBlockTimestampInterval", "[1]");
        }
    }

    /// Makes a block if that is the test's task, and waits until all operators have received one more.
    pub fn next_block<'a>(&self, operators: impl IntoIterator<Item = &'a mut Operator>) {
        match self.blocks {
            Blocks::Ours => {
                self.rpc("evm_mine", "[]");
                let number = self.rpc("eth_blockNumber", "[]");
                let number = u64::from_str_radix(&number.as_str().unwrap()[2..], 16).unwrap();
                operators.into_iter().for_each(|operator| operator.hear_block(number));
            }
            // Without a transaction there is none, so wait for any notice.
            Blocks::ForEachTransaction => operators.into_iter().for_each(|operator| _ = operator.wait()),
            Blocks::Theirs => operators.into_iter().for_each(Operator::hear_another_block),
        }
    }

    /// Lets blocks pass until the condition holds for an operator's notices.
    pub fn until(&self, operator: &mut Operator, what: &str, condition: impl Fn(&[Notice]) -> bool) {
        operator.listen();
        for _ in 0..BLOCKS {
            if condition(&operator.notices) {
                return;
            }
            self.next_block([&mut *operator]);
        }
        panic!("not within {BLOCKS} blocks: {what}; heard {:?}", operator.notices);
    }

    /// Lets blocks pass until all of these are registered.
    pub fn register(&self, operators: &mut [Operator]) {
        let tickets: Vec<Ticket> = operators.iter_mut().map(Operator::begin_registration).collect();
        for (operator, ticket) in operators.iter_mut().zip(tickets) {
            self.until(operator, "the registration", |notices| notices.contains(&Notice::Included(ticket)));
        }
    }

    pub fn stop(&mut self) {
        self.anvil.take().unwrap().stop();
    }

    /// URL of an operator's node; each has another if there are several.
    pub fn url(&self, operator: u8) -> String {
        match self.existing.len() {
            0 => format!("ws://127.0.0.1:{}", self.port),
            count => self.existing[(usize::from(operator) - 1) % count].clone(),
        }
    }

    /// Gives an operator money. On an existing network, its genesis or [`Node::share`] does.
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
            // Everything that a wallet would ask the node for, because not every node knows all of it.
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
        let mut operators = [self.reconnect(number)];
        self.register(&mut operators);
        let [operator] = operators;
        operator
    }

    /// Access of an operator that expects the same contract on another chain.
    pub fn stray(&self, number: u8) -> EthereumLedger {
        let deployment = Deployment { chain_id: self.deployment.chain_id + 1, ..self.deployment };
        let settings = Settings { url: self.url(number), deployment, from_block: 0, depth: 2 };
        EthereumLedger::connect(settings, key(number)).unwrap()
    }

    /// An operator without money.
    pub fn poor_operator(&self, number: u8) -> Operator {
        self.reconnect(number)
    }

    /// An operator that may have existed before.
    pub fn reconnect(&self, number: u8) -> Operator {
        self.reconnect_at(number, self.url(number))
    }

    /// The same by another URL.
    pub fn reconnect_at(&self, number: u8, url: String) -> Operator {
        let settings = Settings { url, deployment: self.deployment, from_block: 0, depth: 2 };
        let ledger = EthereumLedger::connect(settings, key(number)).unwrap();
        Operator::new(ledger, key(number), self.deployment)
    }

    /// Number of an operator's transactions on the chain.
    pub fn transactions(&self, operator: &Operator) -> u64 {
        let account = operator.key.account();
        let count = self.rpc("eth_getTransactionCount", &format!("[\"{account}\", \"latest\"]"));
        u64::from_str_radix(&count.as_str().unwrap()[2..], 16).unwrap()
    }

    /// Balance of the contract.
    pub fn holds(&self) -> Wei {
        let balance = self.rpc("eth_getBalance", &format!("[\"{}\", \"latest\"]", self.deployment.contract));
        Wei(u128::from_str_radix(&balance.as_str().unwrap()[2..], 16).unwrap())
    }

    /// The node's answer to a request.
    pub fn rpc(&self, method: &str, params: &str) -> Value {
        let params: Value = serde_json::from_str(params).unwrap();
        let request = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": params });
        let url = format!("http://127.0.0.1:{}", self.port);
        let mut answer: Value = ureq::post(url).send_json(request).unwrap().body_mut().read_json().unwrap();
        assert!(answer.get("error").is_none(), "{method}: {answer}");
        answer["result"].take()
    }

    /// Number of pending transactions.
    pub fn waiting(&self) -> u64 {
        let status = self.rpc("txpool_status", "[]");
        u64::from_str_radix(&status["pending"].as_str().unwrap()[2..], 16).unwrap()
    }
}
