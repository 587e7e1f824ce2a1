//! Tests operators on a real ledger, with failures of its node and of their transactions.
#![allow(clippy::unwrap_used, reason = "tests may panic")]
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "waits for real processes")]

mod failures;
mod load;
mod node;
mod operator;
mod proxy;

use std::{
    env,
    time::{Duration, Instant},
};

use cotorra_ledger::{
    Call, CallError, ContractError, Event, Ledger, Notice, Outcome, Price, Wei,
    negotiation::{CreatorStep, Failure, ProviderStep},
};
use node::Node;
use operator::{CreatorSide, ProviderSide, announcements, attachment, one_bid, policy, until_all};

#[test]
fn services_are_negotiated_used_and_paid() {
    let Some(node) = Node::start() else { return };
    negotiate(&node);
}

/// Uses the network whose nodes `COTORRA_TEST_LEDGER` names, such as `ws://127.0.0.1:8546,ws://127.0.0.1:8646`. Each
/// operator uses another node. The network's genesis must give money to the operators of tests: the keys 0101…01,
/// 0202…02, 0303…03 and 6363…63.
#[test]
fn services_are_negotiated_on_an_existing_network() {
    match env::var("COTORRA_TEST_LEDGER") {
        Ok(urls) => negotiate(&Node::existing(&urls.split(',').collect::<Vec<_>>())),
        Err(_) => eprintln!("skipped: COTORRA_TEST_LEDGER names no network"),
    }
}

fn negotiate(node: &Node) {
    let began = Instant::now();
    // The collection waits for both bids while the operator's clock stands still.
    let mut creator = CreatorSide::new(node.operator(1), policy());
    let mut providers = [
        ProviderSide::new(node.operator(2), Price::new(9).unwrap()),
        ProviderSide::new(node.operator(3), Price::new(7).unwrap()),
    ];
    until_all(node, &mut creator, &mut providers, |creator, _| {
        creator.has(|step| *step == CreatorStep::InUse)
    });
    println!("from the registrations to the use: {:?}", began.elapsed());
    creator.negotiation.release();
    until_all(node, &mut creator, &mut providers, |creator, _| creator.negotiation.is_over());
    assert!(creator.has(|step| *step == CreatorStep::Deployed(attachment())));
    assert!(creator.has(|step| *step == CreatorStep::Ended(Outcome::Released)));
    assert!(!creator.has(|step| matches!(step, CreatorStep::Failed(_))), "{:?}", creator.steps);
    let [loser, winner] = &providers;
    assert!(loser.steps.contains(&ProviderStep::Lost));
    assert!(winner.steps.contains(&ProviderStep::InUse));
}

#[test]
fn rejections_have_a_reason_and_cost_nothing() {
    let Some(node) = Node::start() else { return };
    let mut operator = node.operator(1);
    let ticket = operator.ledger.submit(operator.now(), Call::Withdraw { to: operator.key.account() });
    let refused = Notice::Refused(ticket, CallError::Contract(ContractError::NothingToWithdraw));
    node.until(&mut operator, "the refusal", |notices| notices.contains(&refused));
    assert_eq!(node.transactions(&operator), 1, "the registration");
}

#[test]
fn nodes_of_another_chain_are_rejected() {
    let Some(node) = Node::start() else { return };
    let mut ledger = node.stray(1);
    let Notice::Down(reason) = ledger.wait() else { panic!("it is up") };
    assert!(reason.contains("is on chain 31337, not 31338"), "{reason}");
}

#[test]
fn calls_without_money_for_the_fee_are_rejected() {
    let Some(node) = Node::start() else { return };
    let mut operator = node.poor_operator(9);
    let ticket = operator.ledger.submit(operator.now(), Call::Register { name: "poor".to_owned() });
    node.until(&mut operator, "the refusal", |notices| {
        notices
            .iter()
            .any(|notice| matches!(notice, Notice::Refused(of, CallError::Node(_)) if *of == ticket))
    });
}

#[test]
fn dropped_transactions_are_resent_unchanged() {
    let Some(node) = Node::start() else { return };
    let mut operator = node.operator(1);
    let announced = operator.announce();
    while node.waiting() == 0 {}
    let pool = node.rpc("txpool_content", "[]");
    let hash = pool.pointer(&format!("/pending/{}/1/hash", operator.key.account())).unwrap();
    node.rpc("anvil_dropAllTransactions", "[]");
    assert_eq!(node.waiting(), 0);
    node.until(&mut operator, "it is included", |notices| {
        notices.contains(&Notice::Included(announced)) && announcements(notices) == 1
    });
    assert!(node.rpc("eth_getTransactionReceipt", &format!("[{hash}]")).is_object(), "it is another one");
}

#[test]
fn transactions_with_low_fees_are_resent_with_higher_ones() {
    let Some(node) = Node::start() else { return };
    let mut operator = node.operator(1);
    let announced = operator.announce();
    while node.waiting() == 0 {}
    // Some blocks are too expensive for it.
    for _ in 0..8 {
        node.rpc("anvil_setNextBlockBaseFeePerGas", "[\"0x2540be400000\"]");
        node.next_block([&mut operator]);
    }
    node.until(&mut operator, "it is included", |notices| {
        notices.contains(&Notice::Included(announced)) && announcements(notices) == 1
    });
}

#[test]
fn reorganised_calls_are_retracted_and_resent() {
    let Some(node) = Node::start_automatic() else { return };
    let mut operator = node.operator(1);
    let announced = operator.announce();
    node.until(&mut operator, "it is announced", |notices| {
        notices.contains(&Notice::Included(announced)) && announcements(notices) == 1
    });
    // The last block is replaced by an empty one.
    node.rpc("anvil_reorg", "[1, []]");
    operator.wait_for(|notice| matches!(notice, Notice::Retracted(_)));
    node.until(&mut operator, "it is told again", |notices| {
        let told = |notice: &&Notice| matches!(notice, Notice::Event(Event::ServiceAnnounced { .. }));
        notices.iter().filter(told).count() == 2
    });
    assert_eq!(announcements(&operator.notices), 1);
}

/// Asserts that a service comes into use although the node was away after a step.
fn goes_on_with_the_node_away_after(step: impl Fn(&CreatorStep) -> bool) {
    let Some(mut node) = Node::start() else { return };
    let mut creator = CreatorSide::new(node.operator(1), one_bid());
    let mut providers = [ProviderSide::new(node.operator(2), Price::new(9).unwrap())];
    until_all(&node, &mut creator, &mut providers, |creator, _| creator.has(&step));
    node.stop();
    creator.operator.wait_for(|notice| matches!(notice, Notice::Down(_)));
    node.restart();
    // No other block shows that nothing was missed.
    creator.operator.wait_for(|notice| matches!(notice, Notice::Head { .. }));
    until_all(&node, &mut creator, &mut providers, |creator, _| {
        creator.has(|step| *step == CreatorStep::InUse)
    });
}

#[test]
fn calls_during_an_outage_happen_afterwards() {
    goes_on_with_the_node_away_after(|step| *step == CreatorStep::Announced);
}

#[test]
fn returning_nodes_without_news_are_noticed() {
    goes_on_with_the_node_away_after(|step| matches!(step, CreatorStep::BidReceived { .. }));
}

#[test]
fn restarted_operators_receive_past_events() {
    let Some(node) = Node::start() else { return };
    let mut creator = CreatorSide::new(node.operator(1), one_bid());
    let mut providers = [ProviderSide::new(node.operator(2), Price::new(9).unwrap())];
    until_all(&node, &mut creator, &mut providers, |creator, _| {
        creator.has(|step| *step == CreatorStep::Chosen)
    });
    // The creator's process ends, and a new one has its key and salt.
    let mut again = CreatorSide::new(node.reconnect(1), one_bid());
    drop(creator);
    until_all(&node, &mut again, &mut providers, |creator, _| {
        creator.has(|step| *step == CreatorStep::InUse)
    });
    again.negotiation.release();
    until_all(&node, &mut again, &mut providers, |creator, _| creator.negotiation.is_over());
}

#[test]
fn creators_notice_in_time_that_nobody_bids() {
    let Some(node) = Node::start() else { return };
    let mut creator = CreatorSide::new(node.operator(1), policy());
    until_all(&node, &mut creator, &mut [], |creator, _| creator.has(|s| *s == CreatorStep::Announced));
    creator.operator.pass(policy().collect);
    until_all(&node, &mut creator, &mut [], |creator, _| creator.negotiation.is_over());
    assert!(creator.has(|step| *step == CreatorStep::Failed(Failure::NoBid)));
    assert!(creator.has(|step| *step == CreatorStep::Ended(Outcome::Cancelled)));
}

/// Prints the time of a transaction from the call to the news of its inclusion.
#[test]
fn transactions_are_timed() {
    let Some(node) = Node::start_automatic() else { return };
    let mut operator = node.operator(1);
    let mut times: Vec<Duration> = (0..50)
        .map(|_| {
            let began = Instant::now();
            let ticket = operator.announce();
            operator.wait_for(|notice| *notice == Notice::Included(ticket));
            began.elapsed()
        })
        .collect();
    times.sort();
    println!(
        "a transaction on anvil, from the call to its inclusion: median {:?}, 95 % {:?}",
        times[25], times[47]
    );
    while announcements(&operator.notices) < 50 {
        operator.wait();
    }
    assert_eq!(node.transactions(&operator), 51);
    assert!(node.holds() == Wei(0));
}
