//! Domains on an anvil node that is started for them.
#![allow(
    clippy::disallowed_types,
    clippy::disallowed_methods,
    reason = "a real node makes blocks on the wall clock"
)]

use std::{
    thread,
    time::{Duration, Instant},
};

use cotorra_federation::{LedgerChoice, Ledgers};
use cotorra_graph::Timestamp;
use cotorra_ledger::{Call, Event, Notice};

#[test]
fn domains_on_one_node_hear_each_other() {
    let Some(program) = cotorra_testing::anvil() else { return };
    let mut ledgers = Ledgers::default();
    let choice = LedgerChoice::Anvil { block_period: Duration::from_millis(500), program: Some(program) };
    let mut open = |name: &str| ledgers.open(&choice, &name.parse().unwrap(), 1).unwrap().0;
    let (mut one, mut two) = (open("one"), open("two"));
    assert_ne!(one.account(), two.account());
    let began = Instant::now();
    let now = || Timestamp::ZERO + began.elapsed();
    one.submit(now(), Call::Register { name: "one".to_owned() });
    loop {
        let heard: Vec<_> = std::iter::from_fn(|| two.poll(now())).collect();
        let registered = |notice: &Notice| matches!(notice, Notice::Event(Event::OperatorRegistered { name, .. }) if name == "one");
        if heard.iter().any(registered) {
            break;
        }
        // A limit only against hanging for ever.
        assert!(began.elapsed() < Duration::from_secs(60), "two has heard nothing of one: {heard:?}");
        thread::sleep(Duration::from_millis(5));
    }
}
