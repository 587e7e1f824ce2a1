//! Measures the gas of each call, and compares it with the table in the documentation.

use std::{fs, path::Path};

use cotorra_ledger::{Call, Salt, ServiceId};

use crate::both::{Both, CREATOR, OTHER, PROVIDER, announce, bid, choose, deploy};

/// Returns the table, from a series of calls as in a negotiation.
fn table(both: &mut Both) -> String {
    let mut rows = vec![
        "| call | by | gas |".to_owned(),
        "|---|---|---:|".to_owned(),
        format!("| (deployment of the contract) | anyone | {} |", both.chain.deployment_gas),
    ];
    let mut row = |both: &mut Both, name: &str, by: &str, caller, call| {
        both.does(caller, call);
        rows.push(format!("| `{name}` | {by} | {} |", both.gas));
    };
    let deployment = both.chain.deployment();
    let id = |number| ServiceId::of(deployment, CREATOR, Salt([number; 32]));
    for operator in [PROVIDER, OTHER] {
        both.does(operator, Call::Register { name: "domain 2".to_owned() });
    }
    row(both, "register", "operator", CREATOR, Call::Register { name: "domain 1".to_owned() });
    row(both, "announce", "creator", CREATOR, announce(Salt([1; 32])));
    row(both, "bid", "provider", PROVIDER, bid(id(1), PROVIDER));
    both.does(OTHER, bid(id(1), OTHER));
    row(both, "choose", "creator", CREATOR, choose(id(1), PROVIDER));
    row(both, "deploy", "provider", PROVIDER, deploy(id(1)));
    row(both, "accept", "creator", CREATOR, Call::Accept { id: id(1) });
    both.wait(60);
    row(both, "release", "either", CREATOR, Call::Release { id: id(1) });
    row(both, "reclaim", "loser", OTHER, Call::Reclaim { id: id(1) });
    row(both, "withdraw", "operator", PROVIDER, Call::Withdraw { to: PROVIDER });
    let closed = both.closed(Salt([2; 32]));
    row(both, "cancel", "creator", CREATOR, Call::Cancel { id: closed });
    let closed = both.closed(Salt([3; 32]));
    row(both, "decline", "provider", PROVIDER, Call::Decline { id: closed });
    let closed = both.closed(Salt([4; 32]));
    both.wait(60);
    row(both, "expire", "anyone", OTHER, Call::Expire { id: closed });
    rows.join("\n")
}

#[test]
fn gas_matches_the_documentation() {
    let Some(mut both) = Both::new() else { return };
    let table = table(&mut both);
    println!("{table}");
    let document = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/use/federation-contract.md");
    assert!(
        fs::read_to_string(document).unwrap().contains(&table),
        "docs/use/federation-contract.md has another table than\n{table}"
    );
}
