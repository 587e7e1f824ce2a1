//! A chain for tests: an anvil node that makes a block for each transaction, at a time that the test sets.

use std::{fs, path::Path};

use cotorra_ledger::{
    Account, Call, ChainTime, ContractError, Deployment, Event,
    ethereum::{
        self,
        anvil::{self, Anvil},
    },
};
use serde_json::{Value, json};

/// Earliest time of a test's first block.
pub const START: ChainTime = ChainTime(4_000_000_000);
/// Balance of each test account, wei.
const WEALTH: &str = "0xffffffffffffffffffffffffffffffffff";

/// An anvil node with the contract on it.
pub struct Chain {
    node: Anvil,
    agent: ureq::Agent,
    contract: Account,
    /// Gas of the deployment.
    pub deployment_gas: u64,
}

/// Effects of a transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Receipt {
    /// The contract's events.
    pub events: Vec<Event>,
    /// Gas used.
    pub gas: u64,
}

impl Chain {
    /// Starts a new chain; `None` without anvil.
    pub fn new() -> Option<Self> {
        let settings =
            anvil::Settings { program: Some(cotorra_testing::anvil()?), ..anvil::Settings::default() };
        let node = Anvil::start(&settings).unwrap();
        let mut chain = Self {
            node,
            agent: ureq::Agent::new_with_defaults(),
            contract: Account::default(),
            deployment_gas: 0,
        };
        chain.rpc("anvil_autoImpersonateAccount", json!([true]));
        chain.renew();
        Some(chain)
    }

    /// Deploys the contract anew.
    pub fn renew(&mut self) {
        let receipt = self.deploy(account(99), &ethereum::bytecode());
        self.contract = receipt["contractAddress"].as_str().unwrap().parse().unwrap();
        self.deployment_gas = number(&receipt["gasUsed"]);
    }

    /// The contract and its chain.
    pub fn deployment(&self) -> Deployment {
        let chain_id = number(&self.rpc("eth_chainId", json!([])));
        Deployment { chain_id, contract: self.contract }
    }

    pub fn contract(&self) -> Account {
        self.contract
    }

    /// Calls the contract in a block of time `now`.
    pub fn call(&self, now: ChainTime, caller: Account, call: &Call) -> Result<Receipt, ContractError> {
        self.transact(now, caller, self.contract, &ethereum::encode(call), call.value().0)
    }

    /// Makes a transaction in a block of its own.
    pub fn transact(
        &self,
        now: ChainTime,
        from: Account,
        to: Account,
        input: &[u8],
        value: u128,
    ) -> Result<Receipt, ContractError> {
        let (transaction, receipt) = self.send(now, from, to, input, value);
        if receipt["status"] == "0x0" {
            let error = self.try_rpc("eth_call", json!([transaction, receipt["blockNumber"]])).unwrap_err();
            let data = unhex(error["data"].as_str().unwrap_or_else(|| panic!("{error}")));
            return Err(ethereum::decode_error(&data).unwrap());
        }
        let events = receipt["logs"].as_array().unwrap().iter();
        let events = events.filter(|log| log["address"] == self.contract.to_string()).map(|log| {
            let topics = log["topics"].as_array().unwrap().iter();
            let topics: Vec<[u8; 32]> =
                topics.map(|topic| unhex(topic.as_str().unwrap()).try_into().unwrap()).collect();
            ethereum::decode_event(&topics, &unhex(log["data"].as_str().unwrap())).unwrap()
        });
        Ok(Receipt { events: events.collect(), gas: number(&receipt["gasUsed"]) })
    }

    /// Whether a transaction is reverted, for any reason.
    pub fn is_reverted(&self, now: ChainTime, from: Account, to: Account, input: &[u8], value: u128) -> bool {
        self.send(now, from, to, input, value).1["status"] == "0x0"
    }

    /// Makes a transaction and returns its receipt.
    fn send(&self, now: ChainTime, from: Account, to: Account, input: &[u8], value: u128) -> (Value, Value) {
        self.rpc("anvil_setBalance", json!([from.to_string(), WEALTH]));
        self.rpc("evm_setNextBlockTimestamp", json!([now.0]));
        let transaction = json!({
            "from": from.to_string(),
            "to": to.to_string(),
            "input": hex(input),
            "value": format!("{value:#x}"),
            "gas": "0x1e8480",
        });
        let receipt = self.rpc("eth_sendTransactionSync", json!([transaction]));
        (transaction, receipt)
    }

    /// Calls a contract without a transaction.
    pub fn view(&self, contract: Account, input: &[u8]) -> Vec<u8> {
        let call = json!({ "to": contract.to_string(), "input": hex(input) });
        unhex(self.rpc("eth_call", json!([call, "latest"])).as_str().unwrap())
    }

    /// Creates a contract.
    pub fn create(&self, from: Account, code: &[u8]) -> Account {
        self.deploy(from, code)["contractAddress"].as_str().unwrap().parse().unwrap()
    }

    fn deploy(&self, from: Account, code: &[u8]) -> Value {
        self.rpc("anvil_setBalance", json!([from.to_string(), WEALTH]));
        let transaction = json!({ "from": from.to_string(), "input": hex(code) });
        let receipt = self.rpc("eth_sendTransactionSync", json!([transaction]));
        assert_eq!(receipt["status"], "0x1", "{receipt}");
        receipt
    }

    /// Balance of an account, wei.
    pub fn wealth(&self, of: Account) -> u128 {
        let balance = self.rpc("eth_getBalance", json!([of.to_string(), "latest"]));
        u128::from_str_radix(balance.as_str().unwrap().trim_start_matches("0x"), 16).unwrap()
    }

    fn rpc(&self, method: &str, params: Value) -> Value {
        self.try_rpc(method, params).unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    fn try_rpc(&self, method: &str, params: Value) -> Result<Value, Value> {
        let request = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": params });
        let url = format!("http://{}", self.node.address());
        let mut answer: Value =
            self.agent.post(url).send_json(request).unwrap().body_mut().read_json().unwrap();
        match answer.get_mut("error") {
            Some(error) => Err(error.take()),
            None => Ok(answer["result"].take()),
        }
    }
}

/// An account of a test.
pub fn account(number: u8) -> Account {
    Account([number; 20])
}

/// Encodes bytes for JSON-RPC.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold("0x".to_owned(), |text, byte| text + &format!("{byte:02x}"))
}

/// Decodes bytes from JSON-RPC.
pub fn unhex(text: &str) -> Vec<u8> {
    let digits = text.strip_prefix("0x").unwrap();
    (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect()
}

fn number(quantity: &Value) -> u64 {
    u64::from_str_radix(quantity.as_str().unwrap().trim_start_matches("0x"), 16).unwrap()
}

/// Bytecode of an attacking contract: `contracts/Attackers.sol`.
pub fn attacker(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../contracts/Attackers.json");
    let code: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    unhex(code[name].as_str().unwrap())
}
