//! Tests negotiations over the modelled ledger in virtual time: without faults, with single faults, and with random
//! ones.

use std::{collections::VecDeque, ops::Range, time::Duration};

use cotorra_graph::Timestamp;
use proptest::prelude::*;

use super::*;
use crate::{
    ChainTime, Commitment, ContractError, Deployment, ModelledChain, ModelledLedger, Price, PublicKey,
    Requirements, Salt, State, Terms, Wei,
    seal::{Attachment, Bid, Secret},
};

const PERIOD: Duration = Duration::from_secs(5);
const TERMS: Terms = Terms { open_for: 60, deploy_within: 30, accept_within: 30, use_for: 120, bond: 500 };
const POLICY: Policy = Policy {
    highest: Price::new(100).unwrap(),
    collect: Duration::from_secs(20),
    enough: 2,
    patience: Duration::from_secs(90),
};

fn seconds(seconds: f64) -> Timestamp {
    Timestamp::from_secs_f64(seconds)
}

fn account(number: u8) -> Account {
    Account([number; 20])
}

fn secret(number: u8) -> Secret {
    Secret::new([number; 32], Deployment::default())
}

fn request() -> Request {
    let requirements = Requirements {
        vnf: "vAP".to_owned(),
        map: "corridor".to_owned(),
        x_mm: 1,
        y_mm: 2,
        radius_mm: 3,
        ssid: "robots".to_owned(),
        mobility_domain: 7,
        frequency_mhz: 0,
        width_mhz: 20,
        signal_dbm: -70,
    };
    Request { requirements, terms: TERMS, policy: POLICY, record: Record::new(account(0)) }
}

fn attachment() -> Attachment {
    Attachment {
        radio_unit: "R4".to_owned(),
        ssid: "robots".to_owned(),
        bssid: [2, 0, 0, 0, 0, 4],
        frequency_mhz: 5180,
        pmk_r1: [8; 32],
        core: None,
    }
}

/// Behaviour of a provider.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Manner {
    Honest,
    NeverBids,
    NeverDeploys,
    FailsToDeploy,
    /// Confirms the deployment, but no robot can attach.
    Lies,
}

/// Faults of messages between operators and the ledger: for each notice how often it is repeated, and how much later.
#[derive(Debug, Clone, Default)]
struct Faults {
    /// Applied in turn, cyclically; empty for none.
    by_notice: Vec<Fault>,
    next: usize,
}

#[derive(Debug, Clone, Copy)]
enum Fault {
    None,
    Twice,
    Late(u32),
    /// Reported, retracted, and reported again.
    TakenBack,
    /// The ledger's node rejects a call although it is in a block.
    Rejected,
}

/// A ledger that reports its notices with faults.
struct Faulty {
    ledger: ModelledLedger,
    faults: Faults,
    waiting: VecDeque<(Timestamp, Notice)>,
}

impl Faulty {
    /// Makes the chain unreachable for some time.
    fn cut_off(&mut self, chain: &ModelledChain, outage: Range<Timestamp>) {
        let another = chain.ledger(self.ledger.account());
        self.ledger = std::mem::replace(&mut self.ledger, another).with_outage(outage);
    }

    /// Starts a new process, which receives all events.
    fn restart(&mut self, chain: &ModelledChain) {
        self.ledger = chain.ledger(self.ledger.account());
        self.waiting.clear();
    }

    fn take_in(&mut self, now: Timestamp) {
        while let Some(notice) = self.ledger.poll(now) {
            let fault = match self.faults.by_notice.len() {
                0 => Fault::None,
                count => self.faults.by_notice[self.faults.next % count],
            };
            self.faults.next += 1;
            match (fault, &notice) {
                (Fault::Twice, Notice::Event(_)) => {
                    self.waiting.extend([(now, notice.clone()), (now, notice)]);
                }
                (Fault::TakenBack, Notice::Event(event)) => {
                    let back = Notice::Retracted(event.clone());
                    self.waiting.extend([(now, notice.clone()), (now, back), (now, notice)]);
                }
                (Fault::Rejected, Notice::Included(ticket)) => {
                    let rejected = Notice::Refused(*ticket, ContractError::OnlyCreator.into());
                    self.waiting.push_back((now, rejected));
                }
                (Fault::Late(by), _) => {
                    self.waiting.push_back((now + Duration::from_secs(by.into()), notice));
                }
                _ => self.waiting.push_back((now, notice)),
            }
        }
    }
}

impl Ledger for Faulty {
    fn account(&self) -> Account {
        self.ledger.account()
    }

    fn submit(&mut self, now: Timestamp, call: Call) -> Ticket {
        self.ledger.submit(now, call)
    }

    fn poll(&mut self, now: Timestamp) -> Option<Notice> {
        self.take_in(now);
        let at = self.waiting.iter().position(|(due, _)| *due <= now)?;
        self.waiting.remove(at).map(|(_, notice)| notice)
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        let waiting = self.waiting.iter().map(|(due, _)| *due);
        waiting.chain(self.ledger.next_deadline()).min()
    }
}

struct Domain {
    ledger: Faulty,
    manner: Manner,
    price: u128,
    bids: Vec<Provider>,
    steps: Vec<(Timestamp, ProviderStep)>,
}

/// A creator and providers on one chain.
struct World {
    chain: ModelledChain,
    ledger: Faulty,
    creator: Creator,
    providers: Vec<Domain>,
    steps: Vec<(Timestamp, CreatorStep)>,
    /// Durations until the robot attaches, and of its use of the service.
    attach: Duration,
    using: Duration,
    attach_at: Option<Timestamp>,
    release_at: Option<Timestamp>,
    now: Timestamp,
}

impl World {
    fn new(providers: &[(Manner, u128)], faults: Faults) -> Self {
        let chain = ModelledChain::new(PERIOD);
        let ledger = |number| Faulty {
            ledger: chain.ledger(account(number)),
            faults: faults.clone(),
            waiting: VecDeque::new(),
        };
        let mut world = Self {
            ledger: ledger(0),
            creator: Creator::new(seconds(6.0), account(0), secret(0), Salt([1; 32]), request()),
            providers: (1..)
                .zip(providers)
                .map(|(number, (manner, price))| Domain {
                    ledger: ledger(number),
                    manner: *manner,
                    price: *price,
                    bids: Vec::new(),
                    steps: Vec::new(),
                })
                .collect(),
            steps: Vec::new(),
            attach: Duration::from_millis(500),
            using: Duration::from_secs(20),
            attach_at: None,
            release_at: None,
            now: Timestamp::ZERO,
            chain,
        };
        world.ledger.submit(Timestamp::ZERO, Call::Register { name: "domain 1".to_owned() });
        for domain in &mut world.providers {
            domain.ledger.submit(Timestamp::ZERO, Call::Register { name: "another".to_owned() });
        }
        world
    }

    /// Advances from deadline to deadline until a time.
    fn run(&mut self, until: Timestamp) {
        while self.now <= until {
            if self.now >= seconds(6.0) {
                self.creator();
            }
            for domain in &mut self.providers {
                domain.go_on(self.now);
            }
            let own =
                [self.ledger.next_deadline(), self.creator.next_deadline(), self.attach_at, self.release_at];
            let others = self.providers.iter().flat_map(|domain| {
                domain.bids.iter().map(Provider::next_deadline).chain([domain.ledger.next_deadline()])
            });
            let next = own.into_iter().chain(others).flatten().min().unwrap_or(Timestamp::MAX);
            self.now = next.max(self.now + Duration::from_millis(1));
        }
    }

    fn creator(&mut self) {
        let now = self.now;
        while let Some(notice) = self.ledger.poll(now) {
            self.creator.handle(now, &notice);
            self.creator.submit(now, &mut self.ledger);
        }
        self.creator.expire(now);
        if self.attach_at.is_some_and(|at| now >= at) {
            self.attach_at = None;
            self.creator.attached();
        }
        if self.release_at.is_some_and(|at| now >= at) {
            self.release_at = None;
            self.creator.release();
        }
        self.creator.submit(now, &mut self.ledger);
        while let Some(step) = self.creator.poll_step() {
            match &step {
                CreatorStep::Deployed(there) if *there == attachment() => {
                    self.attach_at = Some(now + self.attach);
                }
                CreatorStep::Deployed(_) => self.creator.unusable(),
                CreatorStep::InUse => self.release_at = Some(now + self.using),
                _ => {}
            }
            self.steps.push((now, step));
        }
        self.creator.submit(now, &mut self.ledger);
    }

    /// Makes the ledger unreachable for the creator for some time.
    fn cut_off_creator(&mut self, outage: Range<Timestamp>) {
        self.ledger.cut_off(&self.chain, outage);
    }

    /// Asserts that the service is used and paid.
    fn assert_used_and_paid(&self, what: &str) {
        self.assert_over();
        assert_eq!(self.failure(), None, "{what}: {:?}", self.steps);
        assert_eq!(self.outcome(), Some(Outcome::Released), "{what}");
        let contract = self.chain.contract();
        let paid: u128 = (1..=self.providers.len() as u8).map(|of| contract.balance(account(of)).0).sum();
        assert!(paid > 0, "{what}");
        assert_eq!(Wei(contract.balance(account(0)).0 + paid), contract.holds(), "{what}");
    }

    /// Returns the events of the chain.
    fn events(&self) -> Vec<Event> {
        let mut ledger = self.chain.ledger(account(99));
        let notices = std::iter::from_fn(|| ledger.poll(self.now));
        notices
            .filter_map(|notice| if let Notice::Event(event) = notice { Some(event) } else { None })
            .collect()
    }

    /// Returns deposits and bonds.
    fn paid_in(&self) -> Wei {
        let wei = self.events().into_iter().map(|event| match event {
            Event::BidPlaced { .. } => TERMS.bond().0,
            Event::ProviderChosen { price, .. } => price.times(TERMS.use_for).0,
            _ => 0,
        });
        Wei(wei.sum())
    }

    /// Returns the bonds that a provider paid, and whether it is due them: it deployed in time, or was not chosen.
    fn bonds_of(&self, provider: Account) -> (u128, bool) {
        let said = self.events();
        let is_its = |event: &Event| match event {
            Event::BidPlaced { provider: of, .. } | Event::ProviderChosen { provider: of, .. } => {
                *of == provider
            }
            _ => false,
        };
        let bids =
            said.iter().filter(|event| matches!(event, Event::BidPlaced { .. }) && is_its(event)).count();
        let was_late = |event: &Event| match event {
            Event::ProviderChosen { provider: of, .. } if *of == provider => !said
                .iter()
                .any(|event| matches!(event, Event::ServiceDeployed { provider: of, .. } if *of == provider)),
            _ => false,
        };
        (bids as u128 * TERMS.bond().0, !said.iter().any(was_late))
    }

    fn failure(&self) -> Option<Failure> {
        self.steps.iter().find_map(|(_, step)| match step {
            CreatorStep::Failed(failure) => Some(*failure),
            _ => None,
        })
    }

    fn outcome(&self) -> Option<Outcome> {
        self.steps.iter().find_map(|(_, step)| match step {
            CreatorStep::Ended(outcome) => Some(*outcome),
            _ => None,
        })
    }

    /// Returns when the creator first reached a step.
    fn at(&self, wanted: impl Fn(&CreatorStep) -> bool) -> f64 {
        self.steps.iter().find(|(_, step)| wanted(step)).expect("it came to that").0.as_secs_f64()
    }

    /// Asserts the invariants after every negotiation: nothing is left on the chain, and both sides know.
    fn assert_over(&self) {
        let state = self.chain.contract().state(self.creator.id());
        assert!(matches!(state, State::None | State::Ended), "{state:?} {:?}", self.steps);
        assert!(self.creator.is_over(), "{:?}", self.creator);
        for domain in &self.providers {
            assert!(domain.bids.iter().all(Provider::is_over), "{:?}", domain.bids);
            let deployed = domain.steps.iter().any(|(_, step)| matches!(step, ProviderStep::Won));
            let told = |(_, step): &(_, ProviderStep)| {
                matches!(step, ProviderStep::Ended { .. } | ProviderStep::Overdue | ProviderStep::Replaced)
            };
            assert!(!deployed || domain.steps.iter().any(told), "taken down: {:?}", domain.steps);
        }
    }
}

impl Domain {
    fn go_on(&mut self, now: Timestamp) {
        let own = self.ledger.account();
        while let Some(notice) = self.ledger.poll(now) {
            if let Notice::Event(event) = &notice
                && self.manner != Manner::NeverBids
                && !self.bids.iter().any(|bid| Some(bid.id()) == event.service())
            {
                let offer = Offer {
                    price: Price::new(self.price).unwrap(),
                    endpoint: "http://there".to_owned(),
                    deploys_within: 20,
                    accepted_within: 30,
                };
                self.bids.extend(Provider::new(own, secret(own.0[0]), event, offer).unwrap());
            }
            for bid in &mut self.bids {
                bid.handle(now, &notice);
            }
        }
        for bid in &mut self.bids {
            bid.expire(now);
            bid.submit(now, &mut self.ledger).unwrap();
            while let Some(step) = bid.poll_step() {
                if step == ProviderStep::Won {
                    match self.manner {
                        Manner::Honest => bid.deployed(attachment()),
                        Manner::Lies => {
                            bid.deployed(Attachment { ssid: "nothing".to_owned(), ..attachment() })
                        }
                        Manner::FailsToDeploy => bid.give_back(),
                        Manner::NeverBids | Manner::NeverDeploys => {}
                    }
                }
                self.steps.push((now, step));
            }
            bid.submit(now, &mut self.ledger).unwrap();
        }
    }
}

#[test]
fn negotiations_take_only_the_necessary_blocks() {
    let mut world =
        World::new(&[(Manner::Honest, 9), (Manner::Honest, 7), (Manner::NeverBids, 1)], Faults::default());
    world.run(seconds(200.0));
    world.assert_over();
    assert_eq!(world.failure(), None);
    assert_eq!(world.outcome(), Some(Outcome::Released));
    // Started at 6 s: announced in the block at 10 s, bids at 15 s, choice at 20 s, confirmation at 25 s.
    assert_eq!(world.at(|step| *step == CreatorStep::Announced), 10.0);
    assert_eq!(world.at(|step| matches!(step, CreatorStep::BidReceived { .. })), 15.0);
    let cheapest = account(2);
    assert_eq!(
        world.at(|step| matches!(step, CreatorStep::Choosing { provider, .. } if *provider == cheapest)),
        15.0
    );
    assert_eq!(world.at(|step| *step == CreatorStep::Chosen), 20.0);
    assert_eq!(world.at(|step| matches!(step, CreatorStep::Deployed(_))), 25.0);
    assert_eq!(world.at(|step| *step == CreatorStep::InUse), 30.0);
    // In use from 30 s, released 20 s later, in the block at 55 s; charged from the deployment in the block at 25 s.
    assert_eq!(world.chain.contract().balance(cheapest), Wei(7 * 30 + TERMS.bond().0));
    assert_eq!(world.chain.contract().balance(account(0)), Wei(7 * 90));
}

#[test]
fn the_losing_bidder_is_notified() {
    let mut world = World::new(&[(Manner::Honest, 7), (Manner::Honest, 9)], Faults::default());
    world.run(seconds(100.0));
    let lost = |domain: &Domain| domain.steps.iter().any(|(_, step)| *step == ProviderStep::Lost);
    assert!(!lost(&world.providers[0]) && lost(&world.providers[1]));
}

#[test]
fn failures_are_reported_and_leave_nothing_behind() {
    use Manner::*;
    type Case = (&'static [(Manner, u128)], Failure, Outcome);
    let cases: [Case; 6] = [
        (&[], Failure::NoBid, Outcome::Cancelled),
        (&[(NeverBids, 1)], Failure::NoBid, Outcome::Cancelled),
        (&[(Honest, 101), (Honest, 0)], Failure::NoGoodBid, Outcome::Cancelled),
        (&[(NeverDeploys, 5)], Failure::NotDeployed, Outcome::NotDeployed),
        (&[(FailsToDeploy, 5)], Failure::NotDeployed, Outcome::Cancelled),
        (&[(Lies, 5)], Failure::Unusable, Outcome::Cancelled),
    ];
    for (providers, failure, outcome) in cases {
        let mut world = World::new(providers, Faults::default());
        world.run(seconds(400.0));
        world.assert_over();
        assert_eq!(world.failure(), Some(failure), "{providers:?}");
        let ended = world.outcome();
        // Whoever first reports that the time has passed ends it.
        let late = outcome == Outcome::NotDeployed && ended == Some(Outcome::Cancelled);
        assert!(ended == Some(outcome) || late, "{providers:?}: {ended:?}");
        // Only a provider that did not deploy loses its bond.
        let bond = if providers == [(NeverDeploys, 5)] { Wei(0) } else { TERMS.bond() };
        for (number, (manner, price)) in (1..).zip(providers) {
            let balance = world.chain.contract().balance(account(number));
            let has_bid =
                *manner != NeverBids && TERMS.bond() <= Price::new(*price).unwrap().times(TERMS.use_for);
            assert_eq!(balance, if has_bid { bond } else { Wei(0) }, "{providers:?}");
        }
    }
}

#[test]
fn next_bid_is_chosen_when_a_winner_fails() {
    use Manner::*;
    for failing in [NeverDeploys, FailsToDeploy, Lies] {
        let mut world = World::new(&[(failing, 5), (Honest, 6)], Faults::default());
        world.run(seconds(400.0));
        world.assert_used_and_paid(&format!("{failing:?}"));
        let contract = world.chain.contract();
        let lost = if failing == NeverDeploys { TERMS.bond() } else { Wei(0) };
        assert_eq!(contract.balance(account(1)), Wei(TERMS.bond().0 - lost.0), "{failing:?}");
        // In a deployment of 120 s at 6 wei.
        let others = contract.balance(account(0)).0 + contract.balance(account(2)).0;
        assert_eq!(others, 5 * 120 + 6 * 120 + TERMS.bond().0 + lost.0, "{failing:?}");
    }
}

#[test]
fn providers_that_served_come_first_even_after_a_restart() {
    use Manner::*;
    for failing in [NeverDeploys, FailsToDeploy, Lies] {
        let mut world = World::new(&[(failing, 5), (Honest, 9), (Honest, 7)], Faults::default());
        // All bid; the cheapest fails, and the next serves.
        world.creator.request.policy.enough = 3;
        world.run(seconds(400.0));
        world.assert_used_and_paid(&format!("{failing:?}"));
        let mut record = Record::new(account(0));
        let mut again = world.chain.ledger(account(0));
        let heard: Vec<_> = std::iter::from_fn(|| again.poll(world.now)).collect();
        heard.iter().chain(&heard).for_each(|notice| record.handle(notice));
        let standings = [1, 2, 3, 4].map(|number| record.standing(account(number)));
        use Standing::*;
        assert_eq!(standings, [Failed, Unknown, Proven, Unknown], "{failing:?}");
        // Retracted events are not remembered.
        for notice in &heard {
            if let Notice::Event(event) = notice {
                record.handle(&Notice::Retracted(event.clone()));
            }
        }
        assert_eq!(record.standing(account(1)), Unknown);
        // Another creator remembers nothing of it.
        let mut other = Record::new(account(9));
        heard.iter().for_each(|notice| other.handle(notice));
        assert_eq!(other.standing(account(1)), Unknown);

        let mut next = World::new(&[(failing, 5), (Honest, 6), (Honest, 7)], Faults::default());
        let mut known = Record::new(account(0));
        heard.iter().for_each(|notice| known.handle(notice));
        next.creator.request.record = known;
        next.run(seconds(400.0));
        next.assert_used_and_paid("the next time");
        let chosen: Vec<_> = next
            .steps
            .iter()
            .filter_map(|(_, step)| match step {
                CreatorStep::Choosing { provider, .. } => Some(*provider),
                _ => None,
            })
            .collect();
        assert_eq!(chosen, [account(3)], "{failing:?}: {:?}", next.steps);
    }
}

#[test]
fn failures_are_remembered_for_a_thousand_own_services() {
    let mut record = Record::new(account(0));
    let announce = |record: &mut Record, creator, number: u16| {
        let mut id = ServiceId::default();
        id.0[0] = creator;
        id.0[1..3].copy_from_slice(&number.to_be_bytes());
        let Request { requirements, terms, .. } = request();
        let (creator, key, deadline) = (account(creator), PublicKey([1; 32]), ChainTime(60));
        let announced = Event::ServiceAnnounced { id, creator, key, requirements, terms, deadline };
        record.handle(&Notice::Event(announced));
        id
    };
    let id = announce(&mut record, 0, 0);
    let (provider, price, deadline) = (account(1), Price::MAX, ChainTime(90));
    let chosen = Event::ProviderChosen { id, provider, price, choice: 1, deadline };
    for event in [chosen, Event::ServiceReopened { id, provider, deadline }] {
        record.handle(&Notice::Event(event));
    }
    // Others cannot fill the record.
    (0..2000).for_each(|number| _ = announce(&mut record, 9, number));
    (1..1000).for_each(|number| _ = announce(&mut record, 0, number));
    assert_eq!(record.standing(provider), Standing::Failed);
    announce(&mut record, 0, 1000);
    assert_eq!(record.standing(provider), Standing::Unknown);
}

#[test]
fn failed_providers_are_chosen_if_nobody_else_bids() {
    use Manner::*;
    let mut first = World::new(&[(FailsToDeploy, 5)], Faults::default());
    first.run(seconds(400.0));
    assert_eq!(first.failure(), Some(Failure::NotDeployed));
    let mut record = Record::new(account(0));
    let mut again = first.chain.ledger(account(0));
    while let Some(notice) = again.poll(first.now) {
        record.handle(&notice);
    }
    assert_eq!(record.standing(account(1)), Standing::Failed);
    let mut next = World::new(&[(Honest, 5)], Faults::default());
    next.creator.request.record = record;
    next.run(seconds(400.0));
    next.assert_used_and_paid("it serves now");
}

#[test]
fn providers_risk_no_bond_on_late_or_unprofitable_services() {
    let announced = |terms| Event::ServiceAnnounced {
        id: ServiceId([1; 32]),
        creator: account(0),
        key: secret(0).public_key(Salt([1; 32])),
        requirements: request().requirements,
        terms,
        deadline: ChainTime(300),
    };
    let offer = Offer {
        price: Price::new(5).unwrap(),
        endpoint: String::new(),
        deploys_within: 20,
        accepted_within: 30,
    };
    let bids =
        |terms| Provider::new(account(1), secret(1), &announced(terms), offer.clone()).unwrap().is_some();
    assert!(bids(TERMS) && bids(Terms { deploy_within: 20, bond: 5 * 120, ..TERMS }));
    assert!(!bids(Terms { deploy_within: 19, ..TERMS }), "it would be late");
    assert!(!bids(Terms { bond: 5 * 120 + 1, ..TERMS }), "it risks more than it can earn");
    assert!(bids(Terms { open_for: 3600, ..TERMS }));
    assert!(!bids(Terms { open_for: 3601, ..TERMS }), "the creator may never choose");
    assert!(bids(Terms { deploy_within: 19, bond: 0, ..TERMS }), "it risks nothing");
}

#[test]
fn providers_bound_and_price_the_durations_that_creators_choose() {
    let bid_at = |price, terms, accepted_within| {
        let announced = Event::ServiceAnnounced {
            id: ServiceId([1; 32]),
            creator: account(0),
            key: secret(0).public_key(Salt([1; 32])),
            requirements: request().requirements,
            terms,
            deadline: ChainTime(300),
        };
        let offer = Offer { price, endpoint: String::new(), deploys_within: 20, accepted_within };
        let mut provider = Provider::new(account(1), secret(1), &announced, offer).unwrap()?;
        let mut ledger = Written(Vec::new());
        provider.submit(Timestamp::ZERO, &mut ledger).unwrap();
        let [Call::Bid { sealed, .. }] = &ledger.0[..] else { panic!("{:?}", ledger.0) };
        let bid: Bid = secret(0).open(Salt([1; 32]), ServiceId([1; 32]), account(1), sealed).unwrap();
        bid.price().map(Price::get)
    };
    let bid = |terms, accepted_within| bid_at(Price::new(5).unwrap(), terms, accepted_within);
    let free = Terms { bond: 0, ..TERMS };
    // With a bond and without one.
    for terms in [TERMS, free] {
        assert_eq!(bid(terms, 30), Some(5));
        assert_eq!(bid(Terms { accept_within: 31, ..terms }, 30), None, "use for nothing");
        assert_eq!(bid(Terms { accept_within: 3500, ..terms }, 120), None);
        assert_eq!(bid(Terms { open_for: 3601, ..terms }, 30), None);
        assert_eq!(bid(Terms { deploy_within: 86_401, ..terms }, 30), None);
        assert_eq!(bid(Terms { use_for: 86_401, ..terms }, 30), None);
        assert_eq!(bid(Terms { use_for: 0, ..terms }, 30), None);
        assert_eq!(
            bid(Terms { open_for: 3600, deploy_within: 86_400, use_for: 86_400, ..terms }, 30),
            Some(5)
        );
    }
    // A wait of a quarter of the use is in the price. The use pays for the rest.
    assert_eq!(bid(Terms { accept_within: 150, ..free }, 150), Some(10));
    assert_eq!(bid(Terms { accept_within: 31, ..free }, 150), Some(6), "rounded up");
    assert_eq!(bid(Terms { accept_within: 150, use_for: 1, ..free }, 150), Some(755));
    assert_eq!(bid_at(Price::MAX, Terms { accept_within: 150, ..free }, 150), None, "beyond all prices");
}

#[test]
fn silent_ledgers_are_given_up_and_services_ended_later() {
    let away = Faults { by_notice: vec![Fault::Late(150)], next: 0 };
    let mut world = World::new(&[], away);
    world.run(seconds(100.0));
    assert_eq!(world.failure(), Some(Failure::Ledger));
    assert!(!world.creator.is_over());
    world.run(seconds(500.0));
    world.assert_over();
}

#[test]
fn creators_resume_after_a_restart_at_any_time() {
    for restart in (0..60).step_by(2) {
        let mut world = World::new(&[(Manner::Honest, 5), (Manner::Honest, 6)], Faults::default());
        world.run(seconds(f64::from(restart)));
        let mut again = Creator::new(world.now, account(0), secret(0), Salt([1; 32]), request());
        // All events of the service so far. Calls that were with the ledger are lost, or repeated.
        for event in world.creator.log.events.clone() {
            again.handle(world.now, &Notice::Event(event));
        }
        world.creator = again;
        world.run(seconds(600.0));
        world.assert_over();
        assert_eq!(world.failure(), None, "restarted at {restart} s: {:?}", world.steps);
        assert_eq!(world.outcome(), Some(Outcome::Released), "restarted at {restart} s");
    }
}

#[test]
fn creators_continue_after_an_outage() {
    for from in (7..60).step_by(3) {
        let mut world = World::new(&[(Manner::Honest, 5), (Manner::Honest, 6)], Faults::default());
        world.cut_off_creator(seconds(f64::from(from))..seconds(f64::from(from + 12)));
        world.run(seconds(600.0));
        world.assert_used_and_paid(&format!("away from {from} s on"));
    }
}

#[test]
fn isolated_winners_take_their_deployment_down_later() {
    let mut world = World::new(&[(Manner::NeverDeploys, 5)], Faults::default());
    world.creator.request.policy.enough = 1;
    world.run(seconds(22.0));
    let winner = &mut world.providers[0];
    assert!(winner.steps.iter().any(|(_, step)| *step == ProviderStep::Won));
    winner.ledger.cut_off(&world.chain, world.now..seconds(80.0));
    // It deploys, but cannot confirm.
    winner.bids[0].deployed(attachment());
    world.run(seconds(600.0));
    world.assert_over();
    assert_eq!(world.failure(), Some(Failure::NotDeployed));
    let nothing = |(_, step): &(_, ProviderStep)| matches!(step, ProviderStep::Ended { charge: Wei(0), .. });
    assert!(world.providers[0].steps.iter().any(nothing), "{:?}", world.providers[0].steps);
    assert_eq!(world.chain.contract().balance(account(1)), Wei(0));
    assert_eq!(world.chain.contract().balance(account(0)), world.chain.contract().holds());
}

#[test]
fn both_roles_resume_after_a_restart_at_any_time() {
    for restart in (7..60).step_by(2) {
        let mut world = World::new(&[(Manner::Honest, 5)], Faults::default());
        world.run(seconds(f64::from(restart)));
        world.creator = Creator::new(world.now, account(0), secret(0), Salt([1; 32]), request());
        world.ledger.restart(&world.chain);
        (world.attach_at, world.release_at) = (None, None);
        let provider = &mut world.providers[0];
        provider.ledger.restart(&world.chain);
        provider.bids.clear();
        world.run(seconds(600.0));
        world.assert_used_and_paid(&format!("started again at {restart} s"));
    }
}

#[test]
fn replayed_announcements_change_nothing() {
    let mut world = World::new(&[(Manner::Honest, 5)], Faults::default());
    // Word for word, by the creator and by somebody else.
    let [mut again, mut mallory] = [0, 9].map(|number| world.chain.ledger(account(number)));
    mallory.submit(seconds(1.0), Call::Register { name: "mallory".to_owned() });
    world.run(seconds(12.0));
    let salt = Salt([1; 32]);
    let Request { requirements, terms, .. } = request();
    let announce = Call::Announce { salt, key: secret(0).public_key(salt), requirements, terms };
    let refused = again.submit(world.now, announce.clone());
    let copied = mallory.submit(world.now, announce);
    world.run(seconds(600.0));
    world.assert_used_and_paid("with a copy");
    let heard = |ledger: &mut ModelledLedger| -> Vec<Notice> {
        std::iter::from_fn(|| ledger.poll(world.now)).collect()
    };
    assert!(heard(&mut again).contains(&Notice::Refused(refused, ContractError::AlreadyAnnounced.into())));
    assert!(heard(&mut mallory).contains(&Notice::Included(copied)), "it is another service");
}

/// A ledger that only records submitted calls.
#[derive(Default)]
struct Written(Vec<Call>);

impl Ledger for Written {
    fn account(&self) -> Account {
        account(0)
    }

    fn submit(&mut self, _: Timestamp, call: Call) -> Ticket {
        self.0.push(call);
        Ticket(self.0.len() as u64)
    }

    fn poll(&mut self, _: Timestamp) -> Option<Notice> {
        None
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        None
    }
}

#[test]
fn nothing_is_chosen_while_the_ledger_is_away() {
    let mut creator = Creator::new(Timestamp::ZERO, account(0), secret(0), Salt([1; 32]), request());
    let id = creator.id();
    let announced = Event::ServiceAnnounced {
        id,
        creator: account(0),
        key: secret(0).public_key(Salt([1; 32])),
        requirements: request().requirements,
        terms: TERMS,
        deadline: ChainTime(300),
    };
    creator.handle(Timestamp::ZERO, &Notice::Event(announced));
    let due = creator.next_deadline().unwrap();
    assert_eq!(due, Timestamp::ZERO + POLICY.collect);
    creator.handle(Timestamp::ZERO, &Notice::Down("away".to_owned()));
    assert_eq!(creator.next_deadline(), Some(Timestamp::ZERO + POLICY.patience));
    creator.handle(due, &Notice::Up);
    creator.expire(due);
    assert!(std::iter::from_fn(|| creator.poll_step()).all(|step| !matches!(step, CreatorStep::Failed(_))));
    creator.handle(due, &Notice::Head { number: 1, time: ChainTime(1) });
    creator.expire(due);
    assert!(
        std::iter::from_fn(|| creator.poll_step()).any(|step| step == CreatorStep::Failed(Failure::NoBid))
    );
}

#[test]
fn rejected_calls_wait_for_the_next_head_and_delay_no_other() {
    let mut ledger = Written::default();
    let mut creator = Creator::new(Timestamp::ZERO, account(0), secret(0), Salt([1; 32]), request());
    // After a restart, it has not yet received the events on the chain.
    creator.submit(Timestamp::ZERO, &mut ledger);
    assert!(matches!(ledger.0[..], [Call::Announce { .. }]));
    creator.handle(Timestamp::ZERO, &Notice::Refused(Ticket(1), ContractError::AlreadyAnnounced.into()));
    creator.submit(Timestamp::ZERO, &mut ledger);
    assert_eq!(ledger.0.len(), 1, "the chain would reject it again");
    let id = creator.id();
    let (provider, sealed) = (account(1), Vec::new());
    let deployed = Event::ServiceDeployed { id, provider, sealed, deadline: ChainTime(60) };
    creator.handle(Timestamp::ZERO, &Notice::Event(deployed));
    creator.release();
    creator.submit(Timestamp::ZERO, &mut ledger);
    assert_eq!(ledger.0[1..], [Call::Cancel { id }]);
    creator.handle(Timestamp::ZERO, &Notice::Refused(Ticket(2), ContractError::OnlyCreator.into()));
    creator.handle(Timestamp::ZERO, &Notice::Head { number: 1, time: ChainTime(1) });
    creator.submit(Timestamp::ZERO, &mut ledger);
    assert_eq!(ledger.0[2..], [Call::Cancel { id }]);
}

fn fault() -> impl Strategy<Value = Fault> {
    prop_oneof![
        6 => Just(Fault::None),
        1 => Just(Fault::Twice),
        2 => (1..40u32).prop_map(Fault::Late),
        1 => Just(Fault::TakenBack),
        1 => Just(Fault::Rejected),
    ]
}

fn manner() -> impl Strategy<Value = Manner> {
    use Manner::*;
    prop_oneof![4 => Just(Honest), 1 => Just(NeverBids), 1 => Just(NeverDeploys), 1 => Just(FailsToDeploy), 1 => Just(Lies)]
}

/// Any event of the service, sensible or not.
fn any_event() -> impl Strategy<Value = Event> {
    let id = ServiceId::of(Deployment::default(), account(0), Salt([1; 32]));
    let deadline = || (0..400u64).prop_map(ChainTime);
    let provider = || (0..4u8).prop_map(account);
    prop_oneof![
        deadline().prop_map(move |deadline| Event::ServiceAnnounced {
            id,
            creator: account(0),
            key: PublicKey([1; 32]),
            requirements: request().requirements,
            terms: TERMS,
            deadline,
        }),
        provider().prop_map(move |provider| Event::BidPlaced {
            id,
            provider,
            commitment: Commitment([1; 32]),
            sealed: vec![1; 200],
        }),
        (provider(), deadline()).prop_map(move |(provider, deadline)| Event::ProviderChosen {
            id,
            provider,
            price: Price::MAX,
            choice: 1 + u32::from(provider.0[0]),
            deadline,
        }),
        (provider(), deadline()).prop_map(move |(provider, deadline)| Event::ServiceDeployed {
            id,
            provider,
            sealed: vec![2; 200],
            deadline,
        }),
        (provider(), deadline()).prop_map(move |(provider, deadline)| Event::ServiceAccepted {
            id,
            provider,
            deadline
        }),
        provider().prop_map(move |provider| Event::ServiceEnded {
            id,
            provider,
            outcome: Outcome::Released,
            charge: Wei(1),
        }),
    ]
}

fn any_notice() -> impl Strategy<Value = Notice> {
    prop_oneof![
        6 => any_event().prop_map(Notice::Event),
        2 => any_event().prop_map(Notice::Retracted),
        2 => (0..500u64).prop_map(|time| Notice::Head { number: time, time: ChainTime(time) }),
        1 => (1..6u64).prop_map(|ticket| Notice::Included(Ticket(ticket))),
        1 => (1..6u64).prop_map(|ticket| Notice::Refused(Ticket(ticket), ContractError::TooLate(ChainTime(0)).into())),
        1 => Just(Notice::Down("away".to_owned())),
        1 => Just(Notice::Up),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn negotiations_end_under_any_faults(
        providers in prop::collection::vec((manner(), 1..110u128), 0..4),
        faults in prop::collection::vec(fault(), 1..40),
        attach in 0..60_000u64,
        using in 0..200u64,
    ) {
        let mut world = World::new(&providers, Faults { by_notice: faults, next: 0 });
        (world.attach, world.using) = (Duration::from_millis(attach), Duration::from_secs(using));
        world.run(seconds(1500.0));
        world.assert_over();
        // Unused service is not charged, and no money or bond is lost.
        let contract = world.chain.contract();
        let balances: u128 = (0..5).map(|number| contract.balance(account(number)).0).sum();
        prop_assert_eq!(Wei(balances), contract.holds());
        prop_assert_eq!(Wei(balances), world.paid_in());
        // Only a winner that did not deploy in time loses its bond.
        for (number, domain) in (1..).zip(&world.providers) {
            let (bids, kept) = world.bonds_of(account(number));
            if kept {
                prop_assert!(contract.balance(account(number)).0 >= bids, "{:?}", domain.steps);
            }
        }
    }

    #[test]
    fn creators_answer_in_time_to_any_notices(
        notices in prop::collection::vec((any_notice(), 0..2_000u64), 0..60),
    ) {
        let chain = ModelledChain::new(PERIOD);
        let mut ledger = chain.ledger(account(0));
        let mut creator = Creator::new(Timestamp::ZERO, account(0), secret(0), Salt([1; 32]), request());
        let mut now = Timestamp::ZERO;
        for (notice, later) in notices {
            now = now + Duration::from_millis(later);
            creator.handle(now, &notice);
            creator.submit(now, &mut ledger);
        }
        creator.expire(now.max(Timestamp::ZERO + POLICY.patience));
        prop_assert_eq!(creator.next_deadline(), None, "it no longer waits");
        let used = matches!(creator.log.phase(), Phase::InUse { .. });
        let answered = std::iter::from_fn(|| creator.poll_step())
            .any(|step| matches!(step, CreatorStep::Failed(_) | CreatorStep::InUse));
        prop_assert!(answered || used);
    }

    #[test]
    fn providers_survive_any_notices(notices in prop::collection::vec((any_notice(), 0..2_000u64), 0..60)) {
        let chain = ModelledChain::new(PERIOD);
        let mut ledger = chain.ledger(account(1));
        let announced = Event::ServiceAnnounced {
            id: ServiceId::of(Deployment::default(), account(0), Salt([1; 32])),
            creator: account(0),
            key: secret(0).public_key(Salt([1; 32])),
            requirements: request().requirements,
            terms: TERMS,
            deadline: ChainTime(300),
        };
        let offer =
            Offer { price: Price::MAX, endpoint: String::new(), deploys_within: 20, accepted_within: 30 };
        let mut provider = Provider::new(account(1), secret(1), &announced, offer).unwrap().unwrap();
        let mut now = Timestamp::ZERO;
        for (notice, later) in notices {
            now = now + Duration::from_millis(later);
            provider.handle(now, &notice);
            provider.expire(now);
            prop_assert_eq!(provider.submit(now, &mut ledger), Ok(()));
            if provider.poll_step() == Some(ProviderStep::Won) {
                provider.deployed(attachment());
            }
        }
        // Long after every deadline, it has asked to take the deployment down, or is over.
        let end = now + Duration::from_secs(10_000);
        provider.expire(end);
        prop_assert_eq!(provider.next_deadline(), None);
    }
}
