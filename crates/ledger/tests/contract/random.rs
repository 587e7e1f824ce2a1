//! Makes random calls in random order. The compiled contract must follow its rules in Rust, and hold exactly the
//! deposits of current services and the balances.

use std::{cell::RefCell, collections::BTreeMap};

use cotorra_ledger::{
    Account, Call, Commitment, ContractError, Deployment, Event, Price, PublicKey, Salt, ServiceId, State,
    Terms, Wei,
};
use proptest::{
    prelude::*,
    test_runner::{RngAlgorithm, TestRng, TestRunner},
};

use crate::both::{Both, CREATOR, OTHER, PROVIDER, requirements, salt_of};

/// Few of everything, so that calls interact.
const CALLERS: [Account; 4] = [CREATOR, PROVIDER, OTHER, Account([77; 20])];
const TERMS: Terms = Terms { open_for: 60, deploy_within: 40, accept_within: 30, use_for: 50, bond: 5 };
const BID: Price = Price::new(3).unwrap();

/// The service that calls are about. When it has ended, the next takes its place.
#[derive(Debug, Clone, Copy)]
struct Service {
    deployment: Deployment,
    creator: Account,
    salt: Salt,
}

impl Service {
    fn id(self) -> ServiceId {
        ServiceId::of(self.deployment, self.creator, self.salt)
    }

    fn announce(self, key: PublicKey) -> Call {
        Call::Announce { salt: self.salt, key, requirements: requirements(), terms: TERMS }
    }

    fn bid(self, provider: Account, price: Price) -> Call {
        let commitment = Commitment::to(self.id(), provider, price, salt_of(provider));
        Call::Bid { id: self.id(), commitment, sealed: vec![1], bond: TERMS.bond() }
    }

    fn choose(self, provider: Account, price: Price, too_much: u128) -> Call {
        let deposit = Wei(price.times(TERMS.use_for).0 + too_much);
        Call::Choose { id: self.id(), provider, price, salt: salt_of(provider), deposit }
    }

    /// The regular next call.
    fn next(self, state: State, provider: Account) -> (Account, Call) {
        let id = self.id();
        match state {
            State::None => (self.creator, self.announce(PublicKey([9; 32]))),
            State::Open if provider == OTHER => (self.creator, self.choose(PROVIDER, BID, 0)),
            State::Open => (provider, self.bid(provider, BID)),
            State::Closed => (PROVIDER, Call::Deploy { id, sealed: vec![2] }),
            State::Deployed => (self.creator, Call::Accept { id }),
            State::InUse | State::Ended => (provider, Call::Release { id }),
        }
    }

    /// Any call, by number.
    fn any(self, number: u8, provider: Account) -> Call {
        let id = self.id();
        match number {
            0 => Call::Register { name: "again".to_owned() },
            1 => self.announce(PublicKey([9; 32])),
            2 => self.announce(PublicKey::default()),
            3 => self.bid(provider, BID),
            4 => self.bid(provider, Price::new(0).unwrap()),
            5 => self.choose(provider, BID, 0),
            6 => self.choose(provider, BID, 1),
            7 => self.choose(provider, Price::new(0).unwrap(), 0),
            8 => Call::Deploy { id, sealed: vec![2] },
            9 => Call::Accept { id },
            10 => Call::Cancel { id },
            11 => Call::Decline { id },
            12 => Call::Release { id },
            13 => Call::Expire { id },
            14 => Call::Reclaim { id },
            _ => Call::Withdraw { to: provider },
        }
    }
}

/// A step: service, caller, provider, an irregular call if any, and the time before it.
fn step() -> impl Strategy<Value = (usize, Account, Account, Option<u8>, u32)> {
    let caller = || prop::sample::select(&CALLERS[..]);
    let wait = prop_oneof![12 => 0..2u32, 1 => 20..70u32];
    (0..3usize, caller(), caller(), prop::option::weighted(0.35, 0..16u8), wait)
}

#[test]
fn random_calls_follow_the_rules() {
    let Some(both) = Both::new() else { return };
    let both = RefCell::new((both, BTreeMap::new()));
    let config = ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() };
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
        .run(&prop::collection::vec(step(), 100..150), |steps| {
            let (both, seen) = &mut *both.borrow_mut();
            both.renew();
            for operator in [CREATOR, PROVIDER, OTHER] {
                both.does(operator, Call::Register { name: "operator".to_owned() });
            }
            let deployment = both.chain.deployment();
            let mut salts = (0..=u8::MAX).map(|number| Salt([number; 32]));
            let mut announced = |creator| Service { deployment, creator, salt: salts.next().unwrap() };
            let mut services = [announced(CREATOR), announced(CREATOR), announced(OTHER)];
            let mut is_late = [false; 3];
            for (number, caller, provider, any, wait) in steps {
                both.wait(wait);
                let service = services[number];
                let (caller, call) = match any {
                    None if is_late[number] => (caller, Call::Expire { id: service.id() }),
                    Some(any) => (caller, service.any(any, provider)),
                    None => service.next(both.state(service.id()), provider),
                };
                let result = both.call(caller, call);
                is_late[number] = matches!(result, Err(ContractError::TooLate(_)));
                let happened = match result {
                    Ok(Event::ServiceEnded { outcome, .. }) => format!("{outcome:?}"),
                    Ok(event) => kind(&event),
                    Err(refusal) => kind(&refusal),
                };
                *seen.entry(happened).or_insert(0) += 1;
                if both.state(service.id()) == State::Ended && wait % 2 == 0 {
                    services[number] = announced(service.creator);
                }
            }
            Ok(())
        })
        .unwrap();
    // The comparison is only worth as much as the cases that it covers.
    let seen = both.into_inner().1;
    for outcome in
        ["Cancelled", "NoWinner", "NotDeployed", "Released", "Completed", "ServiceReopened", "BondReclaimed"]
    {
        assert!(seen.contains_key(outcome), "no {outcome} in {seen:?}");
    }
    assert!(seen.len() > 25, "{} in {seen:?}", seen.len());
}

/// Name of an event or error, without its data.
fn kind(of: &impl std::fmt::Debug) -> String {
    format!("{of:?}").split([' ', '(']).next().unwrap().to_owned()
}
