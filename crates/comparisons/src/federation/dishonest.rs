//! Measures how many robots dishonest providers halt, and their cost. Only the negotiation is simulated, on the modelled
//! ledger, in virtual time. A robot repeatedly needs another domain. Some of the domains near it underbid all others, win,
//! and do not serve it.

use std::{collections::BTreeSet, fmt::Write as _, time::Duration};

use cotorra_experiments::sweep::Interval;
use cotorra_graph::Timestamp;
use cotorra_ledger::{
    Account, Attachment, Call, Event, Ledger, ModelledChain, ModelledLedger, Notice, Price, Requirements,
    Secret, ServiceId, Terms,
    negotiation::{Creator, CreatorStep, Offer, Policy, Provider, ProviderStep, Record, Request},
};

/// Shares of dishonest providers, percent.
const SHARES: [u64; 7] = [0, 1, 5, 10, 20, 30, 50];
/// Times between the announcement of a service and the end of coverage.
const LEADS: [Duration; 2] = [Duration::from_secs(30), Duration::from_secs(60)];
/// The robot is halted this long before the end of coverage.
const STOP: Duration = Duration::from_secs(2);
/// Time for which a halted robot tries to attach.
const ATTACH: Duration = Duration::from_secs(5);
const PERIOD: Duration = Duration::from_secs(5);
const PROVIDERS: usize = 20;
/// Number of providers that could serve the robot at each place.
const NEAR: usize = 5;
/// Number of times that the robot needs another domain.
const CROSSINGS: u64 = 10;
const HIGHEST: Price = Price::new(150).unwrap();
const USE: u32 = 600;
/// A tenth of the longest use at the highest price.
const BOND: u64 = 150 * 600 / 10;
/// Price of dishonest providers, below all others.
const DUMPING: Price = Price::new(15).unwrap();
const CONSUMER: Account = Account([0xc0; 20]);

/// Behaviour of dishonest providers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Attack {
    /// They win, and do not deploy.
    Idle,
    /// As `Idle`, each time with a new account.
    IdleAnew,
    /// They claim a deployment that does not exist, each time with a new account.
    LyingAnew,
}

/// Whether the creator uses bonds, next bids and a memory of providers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Defence {
    None,
    All,
}

/// The result for one robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Outcome {
    /// Number of halts.
    halted: u64,
    /// Wei that the dishonest providers lost.
    lost: u128,
    /// Number of their transactions on the chain.
    transactions: u64,
}

struct Operator {
    ledger: ModelledLedger,
    secret: Secret,
    price: Price,
    /// Behaviour, if it is dishonest.
    attack: Option<Attack>,
    service: Option<Provider>,
    /// Whether it won once and did not serve.
    is_known: bool,
}

/// Providers on one chain.
struct World {
    chain: ModelledChain,
    random: Random,
    accounts: u64,
    operators: Vec<Operator>,
    dishonest: BTreeSet<Account>,
}

/// Splitmix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014).
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % limit
    }
}

impl World {
    /// Creates a world in which each provider is dishonest with this probability.
    fn new(percent: u64, attack: Attack, seed: u64) -> Self {
        let mut world = Self {
            chain: ModelledChain::new(PERIOD),
            random: Random(seed),
            accounts: 0,
            operators: Vec::new(),
            dishonest: BTreeSet::new(),
        };
        for _ in 0..PROVIDERS {
            let attack = (world.random.below(100) < percent).then_some(attack);
            let operator = world.operator(attack);
            world.operators.push(operator);
        }
        world
    }

    /// Creates an operator with a new account.
    fn operator(&mut self, attack: Option<Attack>) -> Operator {
        self.accounts += 1;
        let mut secret = [0; 32];
        secret[..8].copy_from_slice(&self.accounts.to_be_bytes());
        let mut account = Account::default();
        account.0.copy_from_slice(&secret[..20]);
        let mut ledger = self.chain.ledger(account);
        ledger.submit(Timestamp::ZERO, Call::Register { name: "provider".to_owned() });
        if attack.is_some() {
            self.dishonest.insert(account);
        }
        let price = match attack {
            Some(_) => DUMPING,
            None => Price::new(80 + u128::from(self.random.below(61))).expect("a low price is valid"),
        };
        let secret = Secret::new(secret, self.chain.deployment());
        Operator { ledger, secret, price, attack, service: None, is_known: false }
    }

    /// Returns the providers that could serve the robot at its place.
    fn near(&mut self) -> BTreeSet<usize> {
        let mut near = BTreeSet::new();
        while near.len() < NEAR {
            near.insert(self.random.below(PROVIDERS as u64) as usize);
        }
        near
    }

    /// Replaces known dishonest operators by ones with a new account, if their attack uses new accounts.
    fn renew(&mut self) {
        for index in 0..self.operators.len() {
            let Operator { attack, is_known, .. } = self.operators[index];
            if is_known && attack != Some(Attack::Idle) {
                self.operators[index] = self.operator(attack);
            }
        }
    }

    /// Returns the result of the attack.
    fn outcome(&self, halted: u64, events: &[Event], bond: u64) -> Outcome {
        let by_dishonest = events.iter().filter(|event| match event {
            Event::OperatorRegistered { operator: by, .. }
            | Event::BidPlaced { provider: by, .. }
            | Event::ServiceDeployed { provider: by, .. }
            | Event::BondReclaimed { provider: by, .. } => self.dishonest.contains(by),
            _ => false,
        });
        let bids = by_dishonest.clone().filter(|event| matches!(event, Event::BidPlaced { .. })).count();
        let contract = self.chain.contract();
        let kept: u128 = self.dishonest.iter().map(|account| contract.balance(*account).0).sum();
        let lost = u128::from(bond) * bids as u128 - kept;
        Outcome { halted, lost, transactions: by_dishonest.count() as u64 }
    }
}

impl Operator {
    fn go_on(&mut self, now: Timestamp, wanted: ServiceId, is_near: bool) {
        let account = self.ledger.account();
        while let Some(notice) = self.ledger.poll(now) {
            if let Notice::Event(event @ Event::ServiceAnnounced { id, .. }) = &notice
                && is_near
                && *id == wanted
            {
                let offer = Offer {
                    price: self.price,
                    endpoint: String::new(),
                    deploys_within: 10,
                    accepted_within: 120,
                };
                self.service =
                    Provider::new(account, self.secret.clone(), event, offer).expect("the key is valid");
            }
            if let Some(service) = &mut self.service {
                service.handle(now, &notice);
            }
        }
        let Some(service) = &mut self.service else { return };
        service.submit(now, &mut self.ledger).expect("the key is valid");
        while let Some(step) = service.poll_step() {
            if step != ProviderStep::Won {
                continue;
            }
            self.is_known |= self.attack.is_some();
            let radio_unit = match self.attack {
                None => "R1",
                Some(Attack::LyingAnew) => "",
                Some(Attack::Idle | Attack::IdleAnew) => continue,
            };
            service.deployed(Attachment {
                radio_unit: radio_unit.to_owned(),
                ssid: "robots".to_owned(),
                bssid: [2, 0, 0, 0, 0, 1],
                frequency_mhz: 5180,
                pmk_r1: self.secret.ft_key(service.id()),
                core: None,
            });
        }
        service.submit(now, &mut self.ledger).expect("the key is valid");
    }

    fn is_done(&self) -> bool {
        self.service.as_ref().is_none_or(Provider::is_over)
    }
}

/// Simulates a robot among providers.
fn simulate_robot(percent: u64, attack: Attack, defence: Defence, lead: Duration, seed: u64) -> Outcome {
    let mut world = World::new(percent, attack, seed);
    let mut ledger = world.chain.ledger(CONSUMER);
    ledger.submit(Timestamp::ZERO, Call::Register { name: "consumer".to_owned() });
    let secret = Secret::new([0xc0; 32], world.chain.deployment());
    let mut record = Record::new(CONSUMER);
    let (mut events, mut halted) = (Vec::new(), 0);
    let bond = if defence == Defence::All { BOND } else { 0 };
    let mut now = Timestamp::ZERO;
    for crossing in 0..CROSSINGS {
        // By then all are registered. A crossing begins at a random time within a block.
        now = now + 2 * PERIOD + Duration::from_millis(world.random.below(PERIOD.as_millis() as u64));
        let near = world.near();
        let remembered = if defence == Defence::All { record.clone() } else { Record::new(CONSUMER) };
        let salt = secret.announcement_salt(crossing);
        let request = request(defence, lead, bond, remembered);
        let mut creator = Creator::new(now, CONSUMER, secret.clone(), salt, request);
        let halt = now + lead - STOP;
        let (mut is_served, mut unusable_at) = (false, None);
        while !(creator.is_over() && world.operators.iter().all(Operator::is_done)) {
            while let Some(notice) = ledger.poll(now) {
                record.handle(&notice);
                creator.handle(now, &notice);
                if let Notice::Event(event) = notice {
                    events.push(event);
                }
            }
            if unusable_at.is_some_and(|at| at <= now) {
                unusable_at = None;
                creator.unusable();
            }
            creator.expire(now);
            creator.submit(now, &mut ledger);
            while let Some(step) = creator.poll_step() {
                match step {
                    // A robot tries until it has to stop.
                    CreatorStep::Deployed(there) if there.radio_unit.is_empty() => {
                        unusable_at = Some(halt.max(now) + ATTACH);
                    }
                    CreatorStep::Deployed(_) => {
                        is_served |= now <= halt;
                        creator.attached();
                    }
                    CreatorStep::InUse => creator.release(),
                    _ => {}
                }
            }
            creator.submit(now, &mut ledger);
            for (index, operator) in world.operators.iter_mut().enumerate() {
                operator.go_on(now, creator.id(), near.contains(&index));
            }
            let next = [ledger.next_deadline(), creator.next_deadline(), unusable_at];
            let next = next.into_iter().flatten().filter(|at| *at > now).min();
            now = next.expect("there is always another block");
        }
        halted += u64::from(!is_served);
        world.operators.iter_mut().for_each(|operator| operator.service = None);
        world.renew();
    }
    world.outcome(halted, &events, bond)
}

fn request(defence: Defence, lead: Duration, bond: u64, record: Record) -> Request {
    let requirements = Requirements {
        vnf: "vAP".to_owned(),
        map: "anywhere".to_owned(),
        x_mm: 0,
        y_mm: 0,
        radius_mm: 1000,
        ssid: "robots".to_owned(),
        mobility_domain: 1,
        frequency_mhz: 0,
        width_mhz: 20,
        signal_dbm: -70,
    };
    let patience = 2 * lead;
    let long = patience.as_secs() as u32;
    // Without defence a winner may take all the time there is, which leaves none for another one.
    let deploy_within = if defence == Defence::All { 2 * PERIOD.as_secs() as u32 } else { long };
    let terms = Terms { open_for: long, deploy_within, accept_within: long, use_for: USE, bond };
    let policy = Policy { highest: HIGHEST, collect: PERIOD + PERIOD / 4, enough: NEAR, patience };
    Request { requirements, terms, policy, record }
}

/// Returns the tables for each lead and share of dishonest providers: the share of crossings on which the robot was halted,
/// without defence and under each attack, and the attacker's cost of a halt. Each figure is over `robots` robots.
pub fn table(robots: u32) -> String {
    let mut text = format!(
        "{robots} robots for each figure, {CROSSINGS} crossings each; {NEAR} of {PROVIDERS} providers are near each time; \
         a block each {} s; bond {BOND} wei\n",
        PERIOD.as_secs()
    );
    for lead in LEADS {
        let rows = SHARES.map(|percent| row(percent, lead, robots)).join("\n");
        write!(
            text,
            "\nHalted, of all crossings, announced {} s ahead; and what a halt costs the attacker\n\n\
             | dishonest | idle, before | idle | idle, new accounts | lying, new accounts \
             | idle | idle, new accounts | lying, new accounts |\n\
             |---:|---:|---:|---:|---:|---:|---:|---:|\n{rows}\n",
            lead.as_secs()
        )
        .expect("writing into a string cannot fail");
    }
    text
}

fn row(percent: u64, lead: Duration, robots: u32) -> String {
    let column = |attack, defence| -> Vec<Outcome> {
        (1..=u64::from(robots)).map(|seed| simulate_robot(percent, attack, defence, lead, seed)).collect()
    };
    let before = column(Attack::Idle, Defence::None);
    let now = [Attack::Idle, Attack::IdleAnew, Attack::LyingAnew].map(|attack| column(attack, Defence::All));
    let shares: Vec<String> = [&before].into_iter().chain(&now).map(|outcome| share(outcome)).collect();
    let costs = now.map(|outcome| cost(&outcome));
    format!("| {percent} % | {} | {} |", shares.join(" | "), costs.join(" | "))
}

/// Returns the share of halted crossings with its interval over robots, because the crossings of one robot are correlated.
fn share(outcome: &[Outcome]) -> String {
    let shares: Vec<f64> = outcome.iter().map(|outcome| outcome.halted as f64 / CROSSINGS as f64).collect();
    let samples = shares.len() * CROSSINGS as usize;
    let Some(Interval { mean, low, high, .. }) = Interval::of_shares(&shares, samples) else {
        return String::new();
    };
    let ends = low.zip(high).map(|(low, high)| format!(" ({:.1} to {:.1})", low * 100.0, high * 100.0));
    format!("{:.1} %{}", mean * 100.0, ends.unwrap_or_default())
}

/// Returns the attacker's cost of a halt, in bonds and transactions.
fn cost(outcome: &[Outcome]) -> String {
    let halted: u64 = outcome.iter().map(|outcome| outcome.halted).sum();
    if halted == 0 {
        return "no halt".to_owned();
    }
    let bonds = outcome.iter().map(|outcome| outcome.lost).sum::<u128>() as f64 / BOND as f64;
    let transactions: u64 = outcome.iter().map(|outcome| outcome.transactions).sum();
    format!("{:.1} bonds, {:.0} tx", bonds / halted as f64, transactions as f64 / halted as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(percent: u64, attack: Attack, defence: Defence) -> Outcome {
        (1..=4).map(|seed| simulate_robot(percent, attack, defence, LEADS[1], seed)).fold(
            Outcome::default(),
            |Outcome { halted, lost, transactions }, outcome| Outcome {
                halted: halted + outcome.halted,
                lost: lost + outcome.lost,
                transactions: transactions + outcome.transactions,
            },
        )
    }

    #[test]
    fn honest_providers_halt_no_robot_and_lose_nothing() {
        for lead in LEADS {
            for (attack, defence) in [(Attack::Idle, Defence::None), (Attack::LyingAnew, Defence::All)] {
                assert_eq!(
                    simulate_robot(0, attack, defence, lead, 1),
                    Outcome::default(),
                    "{attack:?} {lead:?}"
                );
            }
        }
    }

    #[test]
    fn idle_providers_halt_few_robots_and_pay_for_it() {
        let before = all(20, Attack::Idle, Defence::None);
        let after = all(20, Attack::Idle, Defence::All);
        assert!(before.halted >= 20 && before.lost == 0, "{before:?}");
        assert!(10 * after.halted <= before.halted, "{after:?} {before:?}");
        assert!(after.lost > 0 && after.lost.is_multiple_of(BOND.into()), "{after:?}");
        assert_eq!(after, all(20, Attack::Idle, Defence::All), "the same each time");
    }

    #[test]
    fn liars_keep_their_bonds_and_halt_fewer_robots_than_before() {
        let before = all(20, Attack::LyingAnew, Defence::None);
        let after = all(20, Attack::LyingAnew, Defence::All);
        assert!(after.halted > 0 && after.lost == 0, "{after:?}");
        assert!(2 * after.halted < before.halted, "{after:?} {before:?}");
    }
}
