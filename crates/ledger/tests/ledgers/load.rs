//! Runs many providers and services at once on one ledger. Each step of each service is reached, and no money is
//! lost.
//!
//! `COTORRA_TEST_LOAD=50,200,5` has 50 providers, 200 announcements at once, and five bids for each, as in
//! `scripts/test --full`. `COTORRA_TEST_LEDGER` names another ledger instead of an anvil node whose blocks the test
//! makes.

use std::{collections::BTreeMap, env, time::Instant};

use cotorra_ledger::{
    Account, Call, Event, Ledger, Notice, Outcome, Price, ServiceId, Wei,
    negotiation::{Creator, CreatorStep, Offer, Policy, Provider, ProviderStep},
};

use crate::{
    node::{BLOCKS, Node},
    operator::{Operator, attachment, policy, request},
};

/// Operators that announce, each a share of the services.
const CREATORS: usize = 20;
/// First keys of creators and providers. The deployer's key is between them.
const KEYS: (u8, u8) = (10, 110);

/// An operator and all services that it takes part in.
struct Side<T> {
    operator: Operator,
    services: BTreeMap<ServiceId, (T, Vec<String>)>,
    heard: usize,
}

impl<T> Side<T> {
    fn new(operator: Operator) -> Self {
        Self { operator, services: BTreeMap::new(), heard: 0 }
    }

    /// Returns the new notices.
    fn news(&mut self) -> Vec<Notice> {
        self.operator.listen();
        let news = self.operator.notices[self.heard..].to_vec();
        self.heard = self.operator.notices.len();
        news
    }

    /// The services that a notice concerns.
    fn concerned(&mut self, notice: &Notice) -> impl Iterator<Item = &mut (T, Vec<String>)> {
        let of = match notice {
            Notice::Event(event) | Notice::Retracted(event) => Some(event.service()),
            _ => None,
        };
        self.services
            .iter_mut()
            .filter(move |(id, _)| of.is_none_or(|of| of == Some(**id)))
            .map(|(_, side)| side)
    }
}

impl Side<Creator> {
    fn go_on(&mut self) {
        let now = self.operator.now();
        for notice in self.news() {
            self.concerned(&notice).for_each(|(creator, _)| creator.handle(now, &notice));
        }
        for (creator, steps) in self.services.values_mut() {
            creator.expire(now);
            creator.submit(now, &mut self.operator.ledger);
            while let Some(step) = creator.poll_step() {
                match &step {
                    CreatorStep::Deployed(told) if *told == attachment() => creator.attached(),
                    CreatorStep::InUse => creator.release(),
                    CreatorStep::Failed(reason) => panic!("{reason}: {steps:?}"),
                    CreatorStep::Ended(outcome) => assert_eq!(*outcome, Outcome::Released),
                    _ => {}
                }
                let name = format!("{step:?}");
                steps.push(name.split([' ', '(']).next().unwrap_or_default().to_owned());
            }
            creator.submit(now, &mut self.operator.ledger);
        }
    }
}

impl Side<Provider> {
    fn go_on(&mut self, bids_for: impl Fn(ServiceId) -> bool, price: Price) {
        let now = self.operator.now();
        for notice in self.news() {
            if let Notice::Event(event @ Event::ServiceAnnounced { id, .. }) = &notice
                && bids_for(*id)
                && !self.services.contains_key(id)
            {
                let (account, endpoint) = (self.operator.key.account(), "http://domain:7700".to_owned());
                let offer = Offer { price, endpoint, deploys_within: 10, accepted_within: 7200 };
                let secret = self.operator.secret();
                if let Some(provider) = Provider::new(account, secret, event, offer).unwrap() {
                    self.services.insert(*id, (provider, Vec::new()));
                }
            }
            self.concerned(&notice).for_each(|(provider, _)| provider.handle(now, &notice));
        }
        for (provider, steps) in self.services.values_mut() {
            provider.submit(now, &mut self.operator.ledger).unwrap();
            while let Some(step) = provider.poll_step() {
                if step == ProviderStep::Won {
                    provider.deployed(attachment());
                }
                steps.push(format!("{step:?}").split(' ').next().unwrap_or_default().to_owned());
            }
            provider.submit(now, &mut self.operator.ledger).unwrap();
        }
    }
}

fn numbers() -> [usize; 3] {
    let usual = if env::var_os("COTORRA_FULL").is_some() { "50,200,5" } else { "8,24,3" };
    let text = env::var("COTORRA_TEST_LOAD").unwrap_or_else(|_| usual.to_owned());
    let numbers: Vec<usize> = text.split(',').map(|number| number.parse().unwrap()).collect();
    let numbers: [usize; 3] = numbers.try_into().expect("providers, announcements, bids for each");
    assert!(numbers[0] <= 100 && numbers[1] > 0 && (1..=numbers[0]).contains(&numbers[2]), "{numbers:?}");
    numbers
}

#[test]
fn many_services_at_once_lose_no_step_and_no_money() {
    let [providers, announcements, bids] = numbers();
    let node = match env::var("COTORRA_TEST_LEDGER") {
        Ok(urls) => Node::existing(&urls.split(',').collect::<Vec<_>>()),
        Err(_) => match Node::start() {
            Some(node) => node,
            None => return,
        },
    };
    let creator_keys = || (0..CREATORS.min(announcements)).map(|index| KEYS.0 + index as u8);
    let provider_keys = || (0..providers).map(|index| KEYS.1 + index as u8);
    node.share(creator_keys().chain(provider_keys()));
    let operators = |keys: &mut dyn Iterator<Item = u8>| -> Vec<Operator> {
        let mut operators: Vec<_> = keys.map(|number| node.reconnect(number)).collect();
        node.register(&mut operators);
        operators
    };
    let mut creators: Vec<Side<Creator>> =
        operators(&mut creator_keys()).into_iter().map(Side::new).collect();
    let mut sides: Vec<Side<Provider>> = operators(&mut provider_keys()).into_iter().map(Side::new).collect();

    // The collection waits for all bids while the operator's clock stands still.
    let policy = Policy { highest: Price::new(1000).unwrap(), enough: bids, ..policy() };
    let mut numbers_of: BTreeMap<ServiceId, usize> = BTreeMap::new();
    for number in 0..announcements {
        let index = number % creators.len();
        let side = &mut creators[index];
        let (account, secret) = (side.operator.key.account(), side.operator.secret());
        let request = request(policy, account);
        let creator = Creator::new(
            side.operator.now(),
            account,
            secret.clone(),
            secret.announcement_salt(number as u64),
            request,
        );
        numbers_of.insert(creator.id(), number);
        side.services.insert(creator.id(), (creator, Vec::new()));
    }
    let began = Instant::now();
    let bids_for = |provider: usize, id: ServiceId| {
        numbers_of
            .get(&id)
            .is_some_and(|number| (provider + providers - number * bids % providers) % providers < bids)
    };
    let is_over = |creators: &[Side<Creator>], providers: &[Side<Provider>]| {
        creators.iter().flat_map(|side| side.services.values()).all(|(creator, _)| creator.is_over())
            && providers
                .iter()
                .flat_map(|side| side.services.values())
                .all(|(provider, _)| provider.is_over())
    };
    let mut blocks = 0;
    while !is_over(&creators, &sides) {
        creators.iter_mut().for_each(Side::<Creator>::go_on);
        for (index, side) in sides.iter_mut().enumerate() {
            let price = Price::new(10 + index as u128).unwrap();
            side.go_on(|id| bids_for(index, id), price);
        }
        assert!(blocks < BLOCKS, "not all is over within {BLOCKS} blocks");
        blocks += 1;
        let creators = creators.iter_mut().map(|side| &mut side.operator);
        node.next_block(creators.chain(sides.iter_mut().map(|side| &mut side.operator)));
    }
    let took = began.elapsed();

    // Each service has had all its steps, and each bid an answer.
    for (_, steps) in creators.iter().flat_map(|side| side.services.values()) {
        let mut wanted = vec!["Announcing", "Announced"];
        wanted.extend(vec!["BidReceived"; bids]);
        wanted.extend(["Choosing", "Chosen", "Deployed", "InUse", "Ended"]);
        assert_eq!(*steps, wanted);
    }
    let answers: Vec<&Vec<String>> =
        sides.iter().flat_map(|side| side.services.values()).map(|(_, steps)| steps).collect();
    assert_eq!(answers.len(), announcements * bids);
    let won = ["Bidding", "BidPlaced", "Won", "Confirming", "Deployed", "InUse", "Ended"];
    let lost = ["Bidding", "BidPlaced", "Lost"];
    // Losers may or may not know the outcome.
    let is_lost = |steps: &[String]| steps.len() <= 5 && steps[..3] == lost;
    let other = answers.iter().find(|steps| ***steps != won && !is_lost(steps));
    let counts = [
        answers.iter().filter(|steps| ***steps == won).count(),
        answers.iter().filter(|s| is_lost(s)).count(),
    ];
    assert_eq!(counts, [announcements, announcements * (bids - 1)], "{other:?}");

    let mut operators: Vec<Operator> = creators.into_iter().map(|side| side.operator).collect();
    operators.extend(sides.into_iter().map(|side| side.operator));
    for operator in &mut operators {
        let to = operator.key.account();
        operator.ledger.submit(operator.now(), Call::Withdraw { to });
    }
    let heard = &mut operators[0];
    let paid = |notices: &[Notice], of: &dyn Fn(&Event) -> u128| -> u128 {
        notices.iter().map(|notice| if let Notice::Event(event) = notice { of(event) } else { 0 }).sum()
    };
    let deposit = |event: &Event| match event {
        Event::ProviderChosen { price, .. } => price.times(28_800).0,
        Event::BidPlaced { .. } => request(policy, Account::default()).terms.bond().0,
        _ => 0,
    };
    let withdrawn = |event: &Event| match event {
        Event::Withdrawn { amount, .. } => amount.0,
        _ => 0,
    };
    node.until(heard, "all is paid out", |notices| paid(notices, &deposit) == paid(notices, &withdrawn));
    let charged = |event: &Event| match event {
        Event::ServiceEnded { charge: Wei(charge), .. } => *charge,
        _ => 0,
    };
    assert!(paid(&heard.notices, &charged) > 0);
    let blocks = heard.notices.iter().filter(|notice| matches!(notice, Notice::Head { .. })).count();
    println!(
        "{providers} providers, {announcements} announcements at once, {bids} bids for each: all over after {took:.1?}; \
         {} transactions; {blocks} blocks with registrations and withdrawals",
        announcements * (4 + 2 * bids),
    );
}
