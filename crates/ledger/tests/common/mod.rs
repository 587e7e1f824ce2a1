//! What tests on real ledgers share.

use std::{
    env,
    path::{Path, PathBuf},
};

use cotorra_ledger::ethereum::anvil;

/// The node's program; `None`, and a message, where it is not installed.
pub fn program() -> Option<PathBuf> {
    let installed = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../contracts/node_modules/@foundry-rs/anvil-linux-amd64/bin/anvil");
    let program = env::var_os(anvil::PROGRAM).map_or(installed, PathBuf::from);
    if program.exists() {
        return Some(program);
    }
    assert!(env::var_os("CI").is_none(), "anvil is missing: npm install --prefix contracts --no-save");
    eprintln!("skipped: anvil is not installed (npm install --prefix contracts --no-save)");
    None
}
