//! Networks of real execution clients and validators, each a process: they agree, go on without one of four, stop without two,
//! and go on again with what they had.
#![allow(clippy::unwrap_used, reason = "tests, and what helps them")]
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "waits for real processes")]

use std::{
    env,
    path::Path,
    thread,
    time::{Duration, Instant},
};

use cotorra_validator::local::{LocalNetwork, Settings};
use serde_json::{Value, json};
use tempfile::TempDir;

/// How long anything may take; far more than it does, even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);
const PERIOD: Duration = Duration::from_millis(500);

/// A network of so many; `None`, and a message, where no execution client is installed.
fn network(validators: usize) -> Option<(LocalNetwork, TempDir)> {
    let client = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../contracts/node_modules/@ethereumjs/client/dist/esm/bin/cli.js");
    if !client.exists() {
        assert!(
            env::var_os("CI").is_none(),
            "EthereumJS is missing: npm install --prefix contracts --no-save"
        );
        eprintln!("skipped: EthereumJS is not installed (npm install --prefix contracts --no-save)");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let settings = Settings {
        validators,
        block_period: PERIOD.as_secs_f64(),
        program: env!("CARGO_BIN_EXE_cotorra-validator").into(),
        client,
        funded: Vec::new(),
        folder: folder.path().to_owned(),
    };
    Some((LocalNetwork::start(settings, || false).unwrap(), folder))
}

fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < PATIENCE, "not within {PATIENCE:?}: {what}");
        thread::sleep(Duration::from_millis(50));
    }
}

fn height(network: &LocalNetwork, of: &[usize]) -> u64 {
    of.iter().map(|index| network.height(*index).unwrap_or(0)).min().unwrap()
}

/// Waits until all of these have so many blocks more.
fn goes_on(network: &LocalNetwork, of: &[usize]) {
    let reached = of.iter().filter_map(|index| network.height(*index)).max().unwrap() + 5;
    until("more blocks", || height(network, of) >= reached);
}

/// The blocks of a domain's node, up to that one.
fn blocks(network: &LocalNetwork, of: usize, to: u64) -> Vec<Value> {
    let block = |number: u64| {
        network.ask(of, "eth_getBlockByNumber", json!([format!("{number:#x}"), false])).unwrap()
    };
    (0..=to).map(|number| block(number)["hash"].clone()).collect()
}

fn agree(network: &LocalNetwork, of: &[usize]) {
    let to = height(network, of);
    let first = blocks(network, of[0], to);
    assert!(first.iter().all(Value::is_string));
    for index in &of[1..] {
        assert_eq!(blocks(network, *index, to), first, "domain {}", index + 1);
    }
}

#[test]
fn four_agree_go_on_without_one_and_stop_without_two() {
    let Some((mut network, _folder)) = network(4) else { return };
    goes_on(&network, &[0, 1, 2, 3]);
    agree(&network, &[0, 1, 2, 3]);

    network.kill(3);
    goes_on(&network, &[0, 1, 2]);
    agree(&network, &[0, 1, 2]);

    network.kill(2);
    let heights = || [network.height(0).unwrap(), network.height(1).unwrap()];
    until("two of four decide nothing", || {
        let before = heights();
        thread::sleep(8 * PERIOD);
        heights() == before && before[0] == before[1]
    });

    network.restart(2).unwrap();
    goes_on(&network, &[0, 1, 2]);
    network.restart(3).unwrap();
    goes_on(&network, &[0, 1, 2, 3]);
    agree(&network, &[0, 1, 2, 3]);

    // All at once, as when the power fails for all.
    (0..4).for_each(|index| network.kill(index));
    (0..4).for_each(|index| network.restart(index).unwrap());
    until("they are back", || (0..4).all(|index| network.height(index).is_some()));
    goes_on(&network, &[0, 1, 2, 3]);
    agree(&network, &[0, 1, 2, 3]);
}
