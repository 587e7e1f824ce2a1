//! Tests failures between two domains on a real ledger. Each ends in order, and nobody pays for a service that it did
//! not get. All scenarios run at once, each with its own operators.
//!
//! Each has its own anvil node, whose blocks the test makes. `COTORRA_TEST_LEDGER` names another ledger for all of
//! them; each operator then uses another of its nodes.

use std::{env, panic, thread};

use cotorra_ledger::{
    Account, Call, CallError, ContractError, Event, Ledger, Notice, Outcome, Price, Terms, Wei,
    negotiation::{CreatorStep, Failure, ProviderStep},
};

use crate::{
    node::{Node, key},
    operator::{
        Behaviour, CreatorSide, Operator, ProviderSide, attachment, one_bid, policy, request, until_all,
    },
    proxy::Proxy,
};

/// First of each scenario's four keys.
const KEYS: u8 = 120;

type Scenario = (&'static str, fn(&Stage<'_>));

const SCENARIOS: [Scenario; 9] = [
    ("nobody bids", nobody_bids),
    ("all bids are too dear", all_bids_are_too_dear),
    ("the winner is silent", the_winner_is_silent),
    ("the deployment fails", the_deployment_fails),
    ("the provider lies", the_provider_lies),
    ("the creator's node is away", the_creators_node_is_away),
    ("the winner is cut off", the_winner_is_cut_off),
    ("both are started again", both_are_started_again),
    ("the announcement is replayed", the_announcement_is_replayed),
];

#[test]
fn failures_end_in_order() {
    let existing = env::var("COTORRA_TEST_LEDGER").ok().map(|urls| {
        let node = Node::existing(&urls.split(',').collect::<Vec<_>>());
        node.share((0..4 * SCENARIOS.len() as u8).map(|index| KEYS + index));
        node
    });
    thread::scope(|scope| {
        let threads = SCENARIOS.iter().enumerate().map(|(index, (name, scenario))| {
            let existing = existing.as_ref();
            let play = move || {
                let first = KEYS + 4 * index as u8;
                if let Some(node) = existing {
                    return scenario(&Stage { node, first });
                }
                let Some(node) = Node::start() else { return };
                (0..4).for_each(|index| node.enrich(first + index));
                scenario(&Stage { node: &node, first });
            };
            thread::Builder::new().name((*name).to_owned()).spawn_scoped(scope, play).unwrap()
        });
        for thread in threads.collect::<Vec<_>>() {
            thread.join().unwrap_or_else(|reason| panic::resume_unwind(reason));
        }
    });
}

/// A ledger and a scenario's keys: the creator's, then the providers'.
struct Stage<'a> {
    node: &'a Node,
    first: u8,
}

impl Stage<'_> {
    fn operators(&self, count: u8) -> Vec<Operator> {
        self.registered((0..count).map(|index| self.node.reconnect(self.first + index)).collect())
    }

    fn registered(&self, mut operators: Vec<Operator>) -> Vec<Operator> {
        self.node.register(&mut operators);
        operators
    }

    /// A provider for this scenario's creator.
    fn provider(&self, operator: Operator, wei: u128) -> ProviderSide {
        ProviderSide::new(operator, price(wei)).serving(key(self.first).account())
    }

    /// A creator, and a provider with this behaviour.
    fn pair(&self, behaviour: Behaviour, terms: Terms) -> (CreatorSide, [ProviderSide; 1]) {
        let mut operators = self.operators(2);
        let provider = self.provider(operators.remove(1), 9).behaving(behaviour);
        (CreatorSide::asking(operators.remove(0), terms, one_bid()), [provider])
    }
}

fn price(wei: u128) -> Price {
    Price::new(wei).unwrap()
}

fn long() -> Terms {
    request(policy(), Account::default()).terms
}

/// A winner that does not deploy within some seconds of the chain is given up.
fn short() -> Terms {
    Terms { deploy_within: 8, ..long() }
}

fn failed(creator: &CreatorSide, with: Failure) {
    let failures: Vec<_> = creator.steps.iter().filter(|s| matches!(s, CreatorStep::Failed(_))).collect();
    assert_eq!(failures, [&CreatorStep::Failed(with)], "{:?}", creator.steps);
    assert!(!creator.has(|step| *step == CreatorStep::InUse), "{:?}", creator.steps);
}

/// Amount paid out to an operator.
fn withdrawn(node: &Node, operator: &mut Operator) -> Wei {
    let account = operator.key.account();
    operator.ledger.submit(operator.now(), Call::Withdraw { to: account });
    let amount = |notices: &[Notice], of: Account| {
        notices.iter().find_map(|notice| match notice {
            Notice::Event(Event::Withdrawn { operator, amount, .. }) if *operator == of => Some(*amount),
            _ => None,
        })
    };
    node.until(operator, "the payment", |notices| amount(notices, account).is_some());
    amount(&operator.notices, account).unwrap()
}

/// Asserts that the creator has its whole deposit back, and the winner's bond.
fn bond_was_lost(node: &Node, creator: &mut CreatorSide) {
    let deposit = price(9).times(long().use_for);
    assert_eq!(withdrawn(node, &mut creator.operator), Wei(deposit.0 + long().bond().0));
}

/// Asserts that the creator has its whole deposit back.
fn nothing_was_paid(node: &Node, creator: &mut CreatorSide) {
    assert_eq!(withdrawn(node, &mut creator.operator), price(9).times(long().use_for));
}

/// Asserts that the service is nevertheless used and paid.
fn used_and_paid(node: &Node, creator: &mut CreatorSide, providers: &mut [ProviderSide; 1]) {
    until_all(node, creator, providers, |creator, _| creator.has(|step| *step == CreatorStep::InUse));
    creator.negotiation.release();
    until_all(node, creator, providers, |creator, providers| {
        creator.negotiation.is_over() && providers[0].ended().is_some()
    });
    assert!(creator.has(|step| *step == CreatorStep::Deployed(attachment())));
    assert!(creator.has(|step| *step == CreatorStep::Ended(Outcome::Released)));
    assert!(!creator.has(|step| matches!(step, CreatorStep::Failed(_))), "{:?}", creator.steps);
    let charge = providers[0].ended().unwrap();
    assert!(charge > Wei(0));
    let bond = long().bond().0;
    assert_eq!(withdrawn(node, &mut providers[0].operator), Wei(charge.0 + bond));
    let Wei(rest) = withdrawn(node, &mut creator.operator);
    assert_eq!(Wei(rest + charge.0), price(9).times(long().use_for));
}

fn nobody_bids(stage: &Stage<'_>) {
    let mut creator = CreatorSide::asking(stage.operators(1).remove(0), long(), one_bid());
    until_all(stage.node, &mut creator, &mut [], |creator, _| creator.has(|s| *s == CreatorStep::Announced));
    creator.operator.pass(one_bid().collect);
    until_all(stage.node, &mut creator, &mut [], |creator, _| creator.negotiation.is_over());
    failed(&creator, Failure::NoBid);
    assert!(creator.has(|step| *step == CreatorStep::Ended(Outcome::Cancelled)));
}

fn all_bids_are_too_dear(stage: &Stage<'_>) {
    let mut operators = stage.operators(3);
    let mut providers = [500, 101].map(|wei| stage.provider(operators.pop().unwrap(), wei));
    let mut creator = CreatorSide::asking(operators.remove(0), long(), one_bid());
    let rejected = |creator: &CreatorSide| {
        creator.steps.iter().filter(|step| matches!(step, CreatorStep::BidRejected { .. })).count()
    };
    until_all(stage.node, &mut creator, &mut providers, |creator, _| rejected(creator) == 2);
    creator.operator.pass(one_bid().collect);
    until_all(stage.node, &mut creator, &mut providers, |creator, _| creator.negotiation.is_over());
    failed(&creator, Failure::NoGoodBid);
    assert_eq!(rejected(&creator), 2, "{:?}", creator.steps);
    assert!(creator.has(|step| *step == CreatorStep::Ended(Outcome::Cancelled)));
}

fn the_winner_is_silent(stage: &Stage<'_>) {
    let (mut creator, mut providers) = stage.pair(Behaviour::Silent, short());
    until_all(stage.node, &mut creator, &mut providers, |creator, _| creator.negotiation.is_over());
    failed(&creator, Failure::NotDeployed);
    bond_was_lost(stage.node, &mut creator);
}

fn the_deployment_fails(stage: &Stage<'_>) {
    let (mut creator, mut providers) = stage.pair(Behaviour::Fails, long());
    until_all(stage.node, &mut creator, &mut providers, |creator, _| creator.negotiation.is_over());
    failed(&creator, Failure::NotDeployed);
    assert!(creator.has(|step| *step == CreatorStep::Ended(Outcome::Cancelled)));
    nothing_was_paid(stage.node, &mut creator);
}

fn the_provider_lies(stage: &Stage<'_>) {
    let (mut creator, mut providers) = stage.pair(Behaviour::Honest, long());
    // No access point answers there.
    creator.finds_nobody();
    until_all(stage.node, &mut creator, &mut providers, |creator, providers| {
        creator.negotiation.is_over() && providers[0].ended().is_some()
    });
    failed(&creator, Failure::Unusable);
    assert_eq!(providers[0].ended(), Some(Wei(0)));
    nothing_was_paid(stage.node, &mut creator);
}

fn the_creators_node_is_away(stage: &Stage<'_>) {
    let proxy = Proxy::before(&stage.node.url(stage.first));
    let operators =
        vec![stage.node.reconnect_at(stage.first, proxy.url()), stage.node.reconnect(stage.first + 1)];
    let mut operators = stage.registered(operators);
    let mut providers = [stage.provider(operators.remove(1), 9)];
    let mut creator = CreatorSide::asking(operators.remove(0), long(), one_bid());
    until_all(stage.node, &mut creator, &mut providers, |creator, _| {
        creator.has(|step| *step == CreatorStep::Announcing)
    });
    proxy.cut();
    creator.operator.wait_for(|notice| matches!(notice, Notice::Down(_)));
    proxy.mend();
    creator.operator.wait_for(|notice| *notice == Notice::Up);
    used_and_paid(stage.node, &mut creator, &mut providers);
}

fn the_winner_is_cut_off(stage: &Stage<'_>) {
    let proxy = Proxy::before(&stage.node.url(stage.first + 1));
    let operators =
        vec![stage.node.reconnect(stage.first), stage.node.reconnect_at(stage.first + 1, proxy.url())];
    let mut operators = stage.registered(operators);
    let mut providers = [stage.provider(operators.remove(1), 9).behaving(Behaviour::Silent)];
    let mut creator = CreatorSide::asking(operators.remove(0), short(), one_bid());
    let has_won = |provider: &ProviderSide| provider.steps.contains(&ProviderStep::Won);
    until_all(stage.node, &mut creator, &mut providers, |_, providers| has_won(&providers[0]));
    proxy.cut();
    let operator = &mut providers[0].operator;
    operator.wait_for(|notice| matches!(notice, Notice::Down(_)));
    operator.is_cut_off = true;
    // It deploys, but cannot confirm.
    providers[0].deploy();
    until_all(stage.node, &mut creator, &mut providers, |creator, _| creator.negotiation.is_over());
    failed(&creator, Failure::NotDeployed);
    bond_was_lost(stage.node, &mut creator);
    proxy.mend();
    let operator = &mut providers[0].operator;
    operator.wait_for(|notice| *notice == Notice::Up);
    operator.is_cut_off = false;
    // It receives the end, and takes its deployment down.
    until_all(stage.node, &mut creator, &mut providers, |_, providers| providers[0].ended().is_some());
    assert_eq!(providers[0].ended(), Some(Wei(0)));
}

fn both_are_started_again(stage: &Stage<'_>) {
    let (mut creator, mut providers) = stage.pair(Behaviour::Silent, long());
    until_all(stage.node, &mut creator, &mut providers, |creator, _| {
        creator.has(|step| *step == CreatorStep::Chosen)
    });
    drop((creator, providers));
    // New processes with the same keys. Everything else comes from the chain.
    let mut creator = CreatorSide::asking(stage.node.reconnect(stage.first), long(), one_bid());
    let mut providers = [stage.provider(stage.node.reconnect(stage.first + 1), 9)];
    used_and_paid(stage.node, &mut creator, &mut providers);
    let announced = creator.operator.notices.iter().filter(
        |notice| matches!(notice, Notice::Event(Event::ServiceAnnounced { creator: of, .. }) if *of == creator.operator.key.account()),
    );
    assert_eq!(announced.count(), 1, "it is the same service");
}

fn the_announcement_is_replayed(stage: &Stage<'_>) {
    let mut operators = stage.operators(3);
    let mut mallory = operators.pop().unwrap();
    let mut providers = [stage.provider(operators.pop().unwrap(), 9)];
    let mut creator = CreatorSide::asking(operators.remove(0), long(), one_bid());
    until_all(stage.node, &mut creator, &mut providers, |creator, _| {
        creator.has(|step| *step == CreatorStep::Announced)
    });
    // Word for word, by the creator and by somebody else.
    let secret = creator.operator.secret();
    let salt = secret.announcement_salt(1);
    let again = || {
        let requirements = request(policy(), Account::default()).requirements;
        Call::Announce { salt, key: secret.public_key(salt), requirements, terms: long() }
    };
    let refused = creator.operator.ledger.submit(creator.operator.now(), again());
    let copied = mallory.ledger.submit(mallory.now(), again());
    stage.node.until(&mut mallory, "the copy", |notices| notices.contains(&Notice::Included(copied)));
    let told = Notice::Refused(refused, CallError::Contract(ContractError::AlreadyAnnounced));
    used_and_paid(stage.node, &mut creator, &mut providers);
    assert!(creator.operator.notices.contains(&told), "{:?}", creator.operator.notices);
}
