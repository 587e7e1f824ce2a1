//! Test operators, and the two sides of a negotiation, block by block. An operator's own clock stands still until a
//! test advances it.

use std::time::Duration;

use cotorra_graph::Timestamp;
use cotorra_ledger::{
    Account, Attachment, Call, Deployment, Event, Ledger, Notice, Price, Requirements, Secret, Terms, Ticket,
    Wei,
    ethereum::{EthereumLedger, Key},
    negotiation::{Creator, CreatorStep, Offer, Policy, Provider, ProviderStep, Record, Request},
};

use crate::node::{BLOCKS, Node};

pub struct Operator {
    pub ledger: EthereumLedger,
    pub key: Key,
    /// The contract.
    pub deployment: Deployment,
    /// All notices so far.
    pub notices: Vec<Notice>,
    /// Whether the test keeps it from its node, so that it is not awaited.
    pub is_cut_off: bool,
    now: Timestamp,
    /// Last block that it received.
    head: u64,
    announced: u64,
}

impl Operator {
    /// An operator that has received the chain's head.
    pub fn new(ledger: EthereumLedger, key: Key, deployment: Deployment) -> Self {
        let (notices, now) = (Vec::new(), Timestamp::ZERO);
        let mut operator =
            Self { ledger, key, deployment, notices, is_cut_off: false, now, head: 0, announced: 0 };
        operator.wait_for(|notice| matches!(notice, Notice::Head { .. }));
        operator
    }

    /// Secret of its other keys.
    pub fn secret(&self) -> Secret {
        self.key.secret(self.deployment)
    }

    pub fn now(&self) -> Timestamp {
        self.now
    }

    /// Advances its own clock.
    pub fn pass(&mut self, time: Duration) {
        self.now = self.now + time;
    }

    pub fn begin_registration(&mut self) -> Ticket {
        let name = format!("operator {}", self.key.account());
        self.ledger.submit(self.now(), Call::Register { name })
    }

    /// Announces another service.
    pub fn announce(&mut self) -> Ticket {
        self.announced += 1;
        let salt = self.secret().announcement_salt(1000 + self.announced);
        let key = self.secret().public_key(salt);
        let Request { requirements, terms, .. } = request(policy(), self.key.account());
        self.ledger.submit(self.now(), Call::Announce { salt, key, requirements, terms })
    }

    /// Waits for a notice, whether there are blocks or not.
    pub fn wait_for(&mut self, is_it: impl Fn(&Notice) -> bool) {
        while !is_it(self.wait()) {}
    }

    /// Waits until it has received that block, if it can.
    pub fn hear_block(&mut self, number: u64) {
        self.listen();
        while !self.is_cut_off && self.head < number {
            self.wait();
        }
    }

    /// Waits until it has received another block, if it can.
    pub fn hear_another_block(&mut self) {
        self.hear_block(self.head + 1);
    }

    /// Waits for the next notice.
    pub fn wait(&mut self) -> &Notice {
        let notice = self.ledger.wait();
        self.take_in(notice);
        self.notices.last().unwrap()
    }

    pub fn listen(&mut self) {
        while let Some(notice) = self.ledger.poll(self.now) {
            self.take_in(notice);
        }
    }

    fn take_in(&mut self, notice: Notice) {
        if let Notice::Head { number, .. } = notice {
            self.head = number;
        }
        self.notices.push(notice);
    }
}

/// Number of announcements that were not retracted.
pub fn announcements(notices: &[Notice]) -> usize {
    let is = |notice: &&Notice, said: bool| match notice {
        Notice::Event(Event::ServiceAnnounced { .. }) => said,
        Notice::Retracted(Event::ServiceAnnounced { .. }) => !said,
        _ => false,
    };
    let count = |said| notices.iter().filter(|notice| is(notice, said)).count();
    count(true) - count(false)
}

pub fn policy() -> Policy {
    Policy {
        highest: Price::new(100).unwrap(),
        collect: Duration::from_secs(3),
        enough: 2,
        patience: Duration::from_secs(50),
    }
}

/// One bid is enough. It is waited for while the creator's clock stands still.
pub fn one_bid() -> Policy {
    Policy { enough: 1, ..policy() }
}

pub fn request(policy: Policy, account: Account) -> Request {
    let requirements = Requirements {
        vnf: "vAP".to_owned(),
        map: "corridor".to_owned(),
        x_mm: 25_500,
        y_mm: -24_300,
        radius_mm: 5_000,
        ssid: "robots".to_owned(),
        mobility_domain: 0xa1b2,
        frequency_mhz: 0,
        width_mhz: 20,
        signal_dbm: -70,
    };
    let terms = Terms { open_for: 3600, deploy_within: 7200, accept_within: 7200, use_for: 28_800, bond: 77 };
    Request { requirements, terms, policy, record: Record::new(account) }
}

pub fn attachment() -> Attachment {
    Attachment {
        radio_unit: "R4".to_owned(),
        ssid: "robots".to_owned(),
        bssid: [2, 0, 0, 0, 0, 4],
        frequency_mhz: 5180,
        pmk_r1: [8; 32],
        core: None,
    }
}

/// A robot's domain.
pub struct CreatorSide {
    pub operator: Operator,
    pub negotiation: Creator,
    pub steps: Vec<CreatorStep>,
    heard: usize,
    /// Whether the robot can attach to the deployment.
    attaches: bool,
}

impl CreatorSide {
    pub fn new(operator: Operator, policy: Policy) -> Self {
        let terms = request(policy, operator.key.account()).terms;
        Self::asking(operator, terms, policy)
    }

    /// A creator with its own terms.
    pub fn asking(operator: Operator, terms: Terms, policy: Policy) -> Self {
        let secret = operator.secret();
        let salt = secret.announcement_salt(1);
        let request = Request { terms, ..request(policy, operator.key.account()) };
        let negotiation = Creator::new(operator.now(), operator.key.account(), secret, salt, request);
        Self { operator, negotiation, steps: Vec::new(), heard: 0, attaches: true }
    }

    /// Makes attaching to the deployment fail.
    pub fn finds_nobody(&mut self) {
        self.attaches = false;
    }

    /// Whether it reached a step.
    pub fn has(&self, step: impl Fn(&CreatorStep) -> bool) -> bool {
        self.steps.iter().any(step)
    }

    fn go_on(&mut self) {
        self.operator.listen();
        let now = self.operator.now();
        for notice in &self.operator.notices[self.heard..] {
            self.negotiation.handle(now, notice);
        }
        self.heard = self.operator.notices.len();
        self.negotiation.expire(now);
        self.negotiation.submit(now, &mut self.operator.ledger);
        while let Some(step) = self.negotiation.poll_step() {
            match step {
                CreatorStep::Deployed(_) if self.attaches => self.negotiation.attached(),
                CreatorStep::Deployed(_) => self.negotiation.unusable(),
                _ => {}
            }
            self.steps.push(step);
        }
        self.negotiation.submit(now, &mut self.operator.ledger);
    }
}

/// Behaviour of a winning provider.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Behaviour {
    /// It deploys.
    Honest,
    /// It does nothing.
    Silent,
    /// It tries to deploy, and fails.
    Fails,
}

/// Another domain.
pub struct ProviderSide {
    pub operator: Operator,
    price: Price,
    negotiation: Option<Provider>,
    heard: usize,
    behaviour: Behaviour,
    /// Creator whose services it bids for; `None` for all.
    serves: Option<Account>,
    pub steps: Vec<ProviderStep>,
}

impl ProviderSide {
    pub fn new(operator: Operator, price: Price) -> Self {
        Self {
            operator,
            price,
            negotiation: None,
            heard: 0,
            behaviour: Behaviour::Honest,
            serves: None,
            steps: Vec::new(),
        }
    }

    /// Restricts bids to this creator's services.
    pub fn serving(self, creator: Account) -> Self {
        Self { serves: Some(creator), ..self }
    }

    pub fn behaving(self, behaviour: Behaviour) -> Self {
        Self { behaviour, ..self }
    }

    /// Deploys after all.
    pub fn deploy(&mut self) {
        self.negotiation.as_mut().unwrap().deployed(attachment());
    }

    /// Its payment, once the service has ended.
    pub fn ended(&self) -> Option<Wei> {
        self.steps.iter().find_map(|step| match step {
            ProviderStep::Ended { charge, .. } => Some(*charge),
            _ => None,
        })
    }

    fn go_on(&mut self) {
        self.operator.listen();
        let now = self.operator.now();
        for notice in &self.operator.notices[self.heard..] {
            if let (Notice::Event(event), None) = (notice, &self.negotiation)
                && self.serves.is_none_or(
                    |of| matches!(event, Event::ServiceAnnounced { creator, .. } if *creator == of),
                )
            {
                let offer = Offer {
                    price: self.price,
                    endpoint: "http://domain-2:7700".to_owned(),
                    deploys_within: 1,
                    accepted_within: 7200,
                };
                let account = self.operator.key.account();
                self.negotiation = Provider::new(account, self.operator.secret(), event, offer).unwrap();
            }
            if let Some(negotiation) = &mut self.negotiation {
                negotiation.handle(now, notice);
            }
        }
        self.heard = self.operator.notices.len();
        let Some(negotiation) = &mut self.negotiation else { return };
        negotiation.submit(now, &mut self.operator.ledger).unwrap();
        while let Some(step) = negotiation.poll_step() {
            match self.behaviour {
                Behaviour::Honest if step == ProviderStep::Won => negotiation.deployed(attachment()),
                Behaviour::Fails if step == ProviderStep::Won => negotiation.give_back(),
                _ => {}
            }
            self.steps.push(step);
        }
        negotiation.submit(now, &mut self.operator.ledger).unwrap();
    }
}

/// Advances all participants block by block until the condition holds.
pub fn until_all(
    node: &Node,
    creator: &mut CreatorSide,
    providers: &mut [ProviderSide],
    condition: impl Fn(&CreatorSide, &[ProviderSide]) -> bool,
) {
    for _ in 0..BLOCKS {
        creator.go_on();
        providers.iter_mut().for_each(ProviderSide::go_on);
        if condition(creator, providers) {
            return;
        }
        let others = providers.iter_mut().map(|provider| &mut provider.operator);
        node.next_block([&mut creator.operator].into_iter().chain(others));
    }
    panic!("not within {BLOCKS} blocks: {:?} {:?}", creator.steps, creator.negotiation);
}
