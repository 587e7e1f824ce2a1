//! An anvil node with the contract, for the four domains of `testbeds/federation.yaml`.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use cotorra_ledger::ethereum::{
    self, Key, Password,
    anvil::{self, Anvil},
};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::harness::project_file;

const DOMAINS: [&str; 4] = ["domain-1", "domain-2", "domain-3", "domain-4"];

/// Steps of a federation, in their order.
pub const STEPS: [&str; 12] = [
    "announced",
    "announcement received",
    "bid sent",
    "bid received",
    "winner chosen",
    "winner received",
    "deployment started",
    "deployment finished",
    "confirmation sent",
    "confirmation received",
    "attached",
    "in use",
];

/// An anvil node that makes a block each second.
pub struct Chain {
    place: TempDir,
    settings: anvil::Settings,
    node: Option<Anvil>,
    chain_id: u64,
    contract: String,
    from_block: u64,
}

impl Chain {
    /// Starts a node with the contract, and with money for each domain. `None` without anvil.
    pub fn start() -> Option<Self> {
        let program = cotorra_testing::anvil()?;
        let place = tempfile::tempdir().unwrap();
        let program = Some(at_home(&program, place.path()));
        let block_period = Some(Duration::from_secs(1));
        let settings = anvil::Settings { program, block_period, ..Default::default() };
        let node = Anvil::start(&settings).unwrap();
        let settings = anvil::Settings { port: node.address().port(), ..settings };
        fs::write(place.path().join("password"), "trial").unwrap();
        let (chain_id, contract, from_block) = (0, String::new(), 0);
        let mut chain = Self { place, settings, node: Some(node), chain_id, contract, from_block };
        for domain in DOMAINS {
            chain.rpc(
                "anvil_setBalance",
                &json!([chain.key(domain).account().to_string(), "0xffffffffffffffffffff"]),
            );
        }
        let (deployment, from_block) = ethereum::deploy(&chain.url(), &chain.key("domain-1")).unwrap();
        (chain.chain_id, chain.contract) = (deployment.chain_id, deployment.contract.to_string());
        chain.from_block = from_block;
        Some(chain)
    }

    fn key(&self, domain: &str) -> Key {
        let file = project_file("testbeds/trial-keys").join(format!("{domain}.json"));
        Key::open(&file, &Password::File(self.place.path().join("password"))).unwrap()
    }

    /// Returns the node's port at 127.0.0.1.
    pub fn port(&self) -> u16 {
        self.settings.port
    }

    fn url(&self) -> String {
        format!("ws://127.0.0.1:{}", self.settings.port)
    }

    fn rpc(&self, method: &str, params: &Value) -> Value {
        let call = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": params });
        let agent = ureq::Agent::config_builder().proxy(None).build().new_agent();
        let url = format!("http://127.0.0.1:{}", self.settings.port);
        let mut answer = agent.post(url).send_json(call).unwrap();
        answer.body_mut().read_json::<Value>().unwrap()["result"].clone()
    }

    /// Returns settings that let the orchestrators use this chain, with transactions that are final after `depth` blocks.
    pub fn settings(&self, depth: u64) -> [String; 4] {
        self.settings_at(&self.url(), depth)
    }

    /// Does the same as [`Self::settings`] where the node is at another URL.
    pub fn settings_at(&self, url: &str, depth: u64) -> [String; 4] {
        DOMAINS.map(|domain| {
            let ledger = json!({
                "kind": "ethereum", "url": url, "chain_id": self.chain_id, "contract": self.contract,
                "from_block": self.from_block, "depth": depth,
                "key_store": project_file("testbeds/trial-keys").join(format!("{domain}.json")),
                "password_file": self.place.path().join("password"),
            });
            format!("plugins.{}.settings.ledger={ledger}", domain.replace("domain", "orchestrator"))
        })
    }

    /// Saves the state of the chain for [`Self::resume`].
    pub fn keep(&mut self) {
        let state = self.rpc("anvil_dumpState", &json!([]));
        let packed = self.place.path().join("packed");
        fs::write(&packed, state.as_str().unwrap()).unwrap();
        let unpack =
            "import gzip, sys; sys.stdout.buffer.write(gzip.decompress(bytes.fromhex(sys.stdin.read()[2:])))";
        let state = self.place.path().join("state.json");
        let mut python = Command::new("python3");
        python
            .args(["-c", unpack])
            .stdin(fs::File::open(packed).unwrap())
            .stdout(fs::File::create(&state).unwrap());
        assert!(python.status().unwrap().success());
        self.settings.state = Some(state);
    }

    /// Kills the node with SIGKILL.
    pub fn kill(&mut self) {
        drop(self.node.take());
    }

    /// Restarts the node on the same port, with the chain as it was saved last.
    pub fn resume(&mut self) {
        self.node = Some(Anvil::start(&self.settings).unwrap());
    }
}

/// Wraps the program to run with its own home, where a killed node leaves files.
fn at_home(program: &Path, folder: &Path) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let script = folder.join("anvil");
    fs::write(&script, format!("#!/bin/sh\nHOME={} exec {} \"$@\"\n", folder.display(), program.display()))
        .unwrap();
    fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
    script
}
