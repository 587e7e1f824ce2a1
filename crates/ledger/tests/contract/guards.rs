//! Tests who may do what, and when.

use cotorra_ledger::{
    Account, Call, Commitment, ContractError, Event, Outcome, Price, PublicKey, Salt, ServiceId, State,
    Terms, Wei,
};

use crate::both::{
    Both, CREATOR, OTHER, PRICE, PROVIDER, TERMS, announce, bid, choose, deploy, requirements, salt_of,
    stranger,
};

const SALT: Salt = Salt([5; 32]);

#[test]
fn services_are_paid_by_the_second() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.in_use(SALT);
    both.wait(98);
    // Calls are a second apart: accepted one second after the deployment, released 99 later.
    let ended = both.does(CREATOR, Call::Release { id });
    let charge = PRICE.times(100);
    assert_eq!(ended, Event::ServiceEnded { id, provider: PROVIDER, outcome: Outcome::Released, charge });
    let amount = Wei(charge.0 + TERMS.bond().0);
    assert_eq!(
        both.does(PROVIDER, Call::Withdraw { to: OTHER }),
        Event::Withdrawn { operator: PROVIDER, to: OTHER, amount }
    );
    assert_eq!(both.balance(CREATOR), Wei(PRICE.times(TERMS.use_for).0 - charge.0));
    both.does(CREATOR, Call::Withdraw { to: CREATOR });
    assert_eq!(both.chain.wealth(both.chain.contract()), 0);
    both.refuses(ContractError::NothingToWithdraw, CREATOR, Call::Withdraw { to: CREATOR });
}

#[test]
fn operators_have_a_name_and_register_once() {
    let Some(mut both) = Both::new() else { return };
    both.refuses(ContractError::NotRegistered, CREATOR, announce(SALT));
    both.refuses(ContractError::BadName, CREATOR, Call::Register { name: String::new() });
    both.refuses(ContractError::BadName, CREATOR, Call::Register { name: "x".repeat(65) });
    both.does(CREATOR, Call::Register { name: "x".repeat(64) });
    both.refuses(ContractError::AlreadyRegistered, CREATOR, Call::Register { name: "another".to_owned() });
}

#[test]
fn announcements_are_complete_and_unique() {
    let Some(mut both) = Both::with_operators() else { return };
    let with = |change: &dyn Fn(&mut Call)| {
        let mut call = announce(SALT);
        change(&mut call);
        call
    };
    let required = |change: fn(&mut cotorra_ledger::Requirements)| {
        let mut requirements = requirements();
        change(&mut requirements);
        Call::Announce { salt: SALT, key: PublicKey([9; 32]), requirements, terms: TERMS }
    };
    for call in [
        required(|r| r.vnf.clear()),
        required(|r| r.map.clear()),
        required(|r| r.vnf = "v".repeat(65)),
        required(|r| r.map = "m".repeat(65)),
        required(|r| r.ssid = "s".repeat(33)),
    ] {
        both.refuses(ContractError::BadRequirements, CREATOR, call);
    }
    for wrong in [
        Terms { open_for: 0, ..TERMS },
        Terms { deploy_within: 0, ..TERMS },
        Terms { accept_within: 0, ..TERMS },
        Terms { use_for: 0, ..TERMS },
    ] {
        let call = with(&|call| {
            if let Call::Announce { terms, .. } = call {
                *terms = wrong;
            }
        });
        both.refuses(ContractError::BadTerms, CREATOR, call);
    }
    let keyless = with(&|call| {
        if let Call::Announce { key, .. } = call {
            *key = PublicKey::default();
        }
    });
    both.refuses(ContractError::BadKey, CREATOR, keyless);
    both.does(CREATOR, announce(SALT));
    both.refuses(ContractError::AlreadyAnnounced, CREATOR, announce(SALT));
    // Another creator's ID with the same salt is different.
    both.does(OTHER, announce(SALT));
}

#[test]
fn other_operators_bid_once_and_in_time() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.id(CREATOR, SALT);
    both.refuses(ContractError::WrongState(State::None), PROVIDER, bid(id, PROVIDER));
    let Event::ServiceAnnounced { deadline, .. } = both.does(CREATOR, announce(SALT)) else { panic!() };
    both.refuses(ContractError::NotRegistered, stranger(), bid(id, stranger()));
    both.refuses(ContractError::OwnService, CREATOR, bid(id, CREATOR));
    let commitment = Commitment([1; 32]);
    let sealed = vec![1];
    both.refuses(
        ContractError::BadCommitment,
        PROVIDER,
        Call::Bid { id, commitment: Commitment::default(), sealed: sealed.clone(), bond: TERMS.bond() },
    );
    for sealed in [vec![], vec![1; 1025]] {
        both.refuses(
            ContractError::BadSealed,
            PROVIDER,
            Call::Bid { id, commitment, sealed, bond: TERMS.bond() },
        );
    }
    both.does(PROVIDER, Call::Bid { id, commitment, sealed: vec![1; 1024], bond: TERMS.bond() });
    both.refuses(ContractError::AlreadyBid, PROVIDER, bid(id, PROVIDER));
    both.now.0 = deadline.0 - 1;
    both.does(OTHER, bid(id, OTHER));
    both.refuses(ContractError::TooLate(deadline), OTHER, bid(id, OTHER));
}

#[test]
fn only_the_creator_chooses_bids_at_their_price() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.bid_for(SALT);
    both.refuses(ContractError::OnlyCreator, PROVIDER, choose(id, PROVIDER));
    both.refuses(ContractError::OnlyCreator, stranger(), choose(id, PROVIDER));
    for nobody in [OTHER, Account::default(), CREATOR] {
        both.refuses(ContractError::NoSuchBid, CREATOR, choose(id, nobody));
    }
    let chosen = |price: u128, salt, deposit| {
        let price = Price::new(price).unwrap();
        Call::Choose { id, provider: PROVIDER, price, salt, deposit: Wei(deposit) }
    };
    let due = PRICE.times(TERMS.use_for);
    both.refuses(
        ContractError::CommitmentDiffers,
        CREATOR,
        chosen(PRICE.get() - 1, salt_of(PROVIDER), due.0 - u128::from(TERMS.use_for)),
    );
    both.refuses(ContractError::CommitmentDiffers, CREATOR, chosen(PRICE.get(), Salt([0; 32]), due.0));
    for wrong in [0, due.0 - 1, due.0 + 1] {
        both.refuses(ContractError::BadDeposit(due), CREATOR, chosen(PRICE.get(), salt_of(PROVIDER), wrong));
    }
    // A bid of zero can be placed, because its price is hidden, but it cannot win.
    let free = Price::new(0).unwrap();
    let commitment = Commitment::to(id, OTHER, free, salt_of(OTHER));
    both.does(OTHER, Call::Bid { id, commitment, sealed: vec![1], bond: TERMS.bond() });
    let call = Call::Choose { id, provider: OTHER, price: free, salt: salt_of(OTHER), deposit: Wei(0) };
    both.refuses(ContractError::PriceIsZero, CREATOR, call);
    both.does(CREATOR, choose(id, PROVIDER));
    both.refuses(ContractError::WrongState(State::Closed), CREATOR, choose(id, PROVIDER));
    both.refuses(ContractError::WrongState(State::Closed), OTHER, bid(id, OTHER));
}

#[test]
fn only_the_winner_deploys_and_only_the_creator_accepts() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.bid_for(SALT);
    both.refuses(ContractError::WrongState(State::Open), PROVIDER, deploy(id));
    both.does(CREATOR, choose(id, PROVIDER));
    for other in [CREATOR, OTHER, stranger()] {
        both.refuses(ContractError::OnlyProvider, other, deploy(id));
        both.refuses(ContractError::OnlyProvider, other, Call::Decline { id });
    }
    both.refuses(ContractError::BadSealed, PROVIDER, Call::Deploy { id, sealed: vec![] });
    both.refuses(ContractError::BadSealed, PROVIDER, Call::Deploy { id, sealed: vec![1; 1025] });
    both.refuses(ContractError::WrongState(State::Closed), CREATOR, Call::Accept { id });
    both.does(PROVIDER, deploy(id));
    both.refuses(ContractError::WrongState(State::Deployed), PROVIDER, deploy(id));
    for other in [PROVIDER, OTHER, stranger()] {
        both.refuses(ContractError::OnlyCreator, other, Call::Accept { id });
        both.refuses(ContractError::OnlyCreator, other, Call::Cancel { id });
    }
    both.refuses(ContractError::WrongState(State::Deployed), CREATOR, Call::Release { id });
    both.does(CREATOR, Call::Accept { id });
    for (party, call) in [(CREATOR, Call::Cancel { id }), (PROVIDER, Call::Decline { id })] {
        both.refuses(ContractError::WrongState(State::InUse), party, call);
    }
    for other in [OTHER, stranger()] {
        both.refuses(ContractError::OnlyParties, other, Call::Release { id });
    }
    both.does(PROVIDER, Call::Release { id });
    for call in [Call::Release { id }, Call::Expire { id }, Call::Accept { id }, Call::Cancel { id }] {
        both.refuses(ContractError::WrongState(State::Ended), CREATOR, call);
    }
}

#[test]
fn either_party_may_leave_before_the_acceptance() {
    let Some(mut both) = Both::with_operators() else { return };
    let ended = |id, provider, outcome| Event::ServiceEnded { id, provider, outcome, charge: Wei(0) };
    let id = both.bid_for(Salt([10; 32]));
    assert_eq!(both.does(CREATOR, Call::Cancel { id }), ended(id, Account::default(), Outcome::Cancelled));
    let makes: [fn(&mut Both, Salt) -> ServiceId; 2] = [Both::closed, Both::deployed];
    for (number, make) in (0..).zip(makes) {
        let id = make(&mut both, Salt([20 + number; 32]));
        assert_eq!(both.does(CREATOR, Call::Cancel { id }), ended(id, PROVIDER, Outcome::Cancelled));
        let id = make(&mut both, Salt([30 + number; 32]));
        let declined = both.does(PROVIDER, Call::Decline { id });
        assert!(matches!(declined, Event::ServiceReopened { provider: PROVIDER, .. }), "{declined:?}");
        both.refuses(ContractError::OnlyProvider, PROVIDER, Call::Decline { id });
    }
    assert_eq!(both.balance(PROVIDER), Wei(4 * TERMS.bond().0), "its bond is back");
    assert_eq!(both.balance(CREATOR), Wei(4 * PRICE.times(TERMS.use_for).0));
    both.does(CREATOR, Call::Withdraw { to: CREATOR });
}

#[test]
fn late_services_can_be_expired_by_anyone() {
    let Some(mut both) = Both::with_operators() else { return };
    type Make = fn(&mut Both, Salt) -> ServiceId;
    let makes = [
        (Both::bid_for as Make, TERMS.open_for - 1, Outcome::NoWinner),
        (Both::closed, TERMS.deploy_within, Outcome::NotDeployed),
        (Both::deployed, TERMS.accept_within, Outcome::NotAccepted),
        (Both::in_use, TERMS.use_for - 1, Outcome::Completed),
    ];
    for (number, (make, time, wanted)) in (40..).zip(makes) {
        let id = make(&mut both, Salt([number; 32]));
        both.wait(time - 1);
        // The last second in time.
        let deadline = both.now.after(1);
        both.refuses(ContractError::TooEarly(deadline), stranger(), Call::Expire { id });
        let late = match wanted {
            Outcome::NoWinner => Some((CREATOR, choose(id, PROVIDER))),
            Outcome::NotDeployed => Some((PROVIDER, deploy(id))),
            Outcome::NotAccepted => Some((CREATOR, Call::Accept { id })),
            _ => None,
        };
        if let Some((party, call)) = late {
            both.refuses(ContractError::TooLate(deadline), party, call);
        }
        let mut happened = both.does(stranger(), Call::Expire { id });
        if matches!(wanted, Outcome::NotDeployed | Outcome::NotAccepted) {
            // While another can be chosen, the creator keeps that right. Afterwards it is over.
            let Event::ServiceReopened { provider: PROVIDER, deadline, .. } = happened else { panic!() };
            both.refuses(ContractError::TooEarly(deadline), stranger(), Call::Expire { id });
            both.now = deadline;
            happened = both.does(stranger(), Call::Expire { id });
        }
        let Event::ServiceEnded { outcome, charge, .. } = happened else { panic!() };
        let wanted = match wanted {
            Outcome::NotDeployed | Outcome::NotAccepted => Outcome::NoWinner,
            other => other,
        };
        assert_eq!(outcome, wanted);
        let all = PRICE.times(TERMS.use_for);
        assert_eq!(charge, if wanted == Outcome::Completed { all } else { Wei(0) });
        both.refuses(ContractError::WrongState(State::Ended), stranger(), Call::Expire { id });
    }
    let id = ServiceId([1; 32]);
    both.refuses(ContractError::WrongState(State::None), stranger(), Call::Expire { id });
}

#[test]
fn late_releases_are_charged_at_most_the_deposit() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.in_use(SALT);
    both.wait(10 * TERMS.use_for);
    let ended = both.does(CREATOR, Call::Release { id });
    let charge = PRICE.times(TERMS.use_for);
    assert_eq!(ended, Event::ServiceEnded { id, provider: PROVIDER, outcome: Outcome::Completed, charge });
}

#[test]
fn highest_price_and_longest_use_do_not_overflow() {
    let Some(mut both) = Both::with_operators() else { return };
    let terms = Terms { use_for: u32::MAX, ..TERMS };
    let id = both.id(CREATOR, SALT);
    both.does(
        CREATOR,
        Call::Announce { salt: SALT, key: PublicKey([9; 32]), requirements: requirements(), terms },
    );
    let price = Price::MAX;
    let salt = salt_of(PROVIDER);
    let commitment = Commitment::to(id, PROVIDER, price, salt);
    both.does(PROVIDER, Call::Bid { id, commitment, sealed: vec![1], bond: TERMS.bond() });
    let deposit = price.times(u32::MAX);
    both.does(CREATOR, Call::Choose { id, provider: PROVIDER, price, salt, deposit });
    both.does(PROVIDER, deploy(id));
    both.does(CREATOR, Call::Accept { id });
    both.does(CREATOR, Call::Release { id });
    both.does(PROVIDER, Call::Withdraw { to: PROVIDER });
    both.does(CREATOR, Call::Withdraw { to: CREATOR });
}

/// The provider's bond, and another's bid.
fn two_bids(both: &mut Both) -> ServiceId {
    let id = both.bid_for(SALT);
    both.does(OTHER, bid(id, OTHER));
    id
}

#[test]
fn bids_need_exactly_their_bond() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.id(CREATOR, SALT);
    both.does(CREATOR, announce(SALT));
    for wrong in [0, TERMS.bond().0 - 1, TERMS.bond().0 + 1] {
        let Call::Bid { id, commitment, sealed, .. } = bid(id, PROVIDER) else { panic!() };
        let call = Call::Bid { id, commitment, sealed, bond: Wei(wrong) };
        both.refuses(ContractError::BadDeposit(TERMS.bond()), PROVIDER, call);
    }
    // The mark of a chosen bid is not a valid commitment: its bond would have no owner.
    let mut spent = [0; 32];
    spent[31] = 1;
    let call = Call::Bid { id, commitment: Commitment(spent), sealed: vec![1], bond: TERMS.bond() };
    both.refuses(ContractError::BadCommitment, PROVIDER, call);
}

#[test]
fn late_winners_lose_their_bond_and_another_is_chosen() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = two_bids(&mut both);
    both.does(CREATOR, choose(id, PROVIDER));
    both.refuses(ContractError::WrongState(State::Closed), CREATOR, choose(id, OTHER));
    both.wait(TERMS.deploy_within);
    both.does(CREATOR, choose(id, OTHER));
    let deposit = PRICE.times(TERMS.use_for);
    assert_eq!(both.balance(CREATOR), Wei(deposit.0 + TERMS.bond().0));
    assert_eq!(both.balance(PROVIDER), Wei(0));
    // It is out: it can neither deploy, decline, bid nor be chosen again, and has no bond to reclaim.
    both.refuses(ContractError::OnlyProvider, PROVIDER, deploy(id));
    both.refuses(ContractError::OnlyProvider, PROVIDER, Call::Decline { id });
    both.refuses(ContractError::NoSuchBid, PROVIDER, Call::Reclaim { id });
    both.does(OTHER, Call::Decline { id });
    assert_eq!(both.balance(OTHER), TERMS.bond(), "it declined in time");
    both.refuses(ContractError::AlreadyBid, PROVIDER, bid(id, PROVIDER));
    for again in [PROVIDER, OTHER] {
        both.refuses(ContractError::NoSuchBid, CREATOR, choose(id, again));
    }
}

#[test]
fn declining_late_does_not_save_the_bond() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = two_bids(&mut both);
    both.does(CREATOR, choose(id, PROVIDER));
    both.wait(TERMS.deploy_within);
    both.does(PROVIDER, Call::Decline { id });
    assert_eq!((both.balance(PROVIDER), both.state(id)), (Wei(0), State::Open));
    both.does(CREATOR, choose(id, OTHER));
    // Nor does a creator that cancels after the deadline, or before it.
    both.wait(TERMS.deploy_within);
    let ended = both.does(CREATOR, Call::Cancel { id });
    assert!(matches!(ended, Event::ServiceEnded { outcome: Outcome::NotDeployed, .. }), "{ended:?}");
    assert_eq!(both.balance(OTHER), Wei(0));
}

#[test]
fn creators_that_cancel_in_time_take_no_bond() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.closed(SALT);
    both.does(CREATOR, Call::Cancel { id });
    assert_eq!(both.balance(PROVIDER), TERMS.bond());
    // Nor does one that chooses another instead of the deployed one.
    let id = both.id(CREATOR, Salt([6; 32]));
    both.does(CREATOR, announce(Salt([6; 32])));
    both.does(PROVIDER, bid(id, PROVIDER));
    both.does(OTHER, bid(id, OTHER));
    both.does(CREATOR, choose(id, PROVIDER));
    both.does(PROVIDER, deploy(id));
    both.does(CREATOR, choose(id, OTHER));
    assert_eq!(both.balance(PROVIDER), Wei(2 * TERMS.bond().0));
}

#[test]
fn losing_bidders_reclaim_their_bond_after_the_decision() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = two_bids(&mut both);
    both.refuses(ContractError::BondBound, OTHER, Call::Reclaim { id });
    both.does(CREATOR, choose(id, PROVIDER));
    both.does(PROVIDER, deploy(id));
    both.refuses(ContractError::BondBound, OTHER, Call::Reclaim { id });
    both.does(CREATOR, Call::Accept { id });
    for nobody in [PROVIDER, CREATOR, stranger()] {
        both.refuses(ContractError::NoSuchBid, nobody, Call::Reclaim { id });
    }
    let reclaimed = Event::BondReclaimed { id, provider: OTHER, bond: TERMS.bond() };
    assert_eq!(both.does(OTHER, Call::Reclaim { id }), reclaimed);
    both.refuses(ContractError::NoSuchBid, OTHER, Call::Reclaim { id });
    both.does(OTHER, Call::Withdraw { to: OTHER });
    // Also from a creator that stays silent.
    both.does(CREATOR, announce(Salt([6; 32])));
    let id = both.id(CREATOR, Salt([6; 32]));
    both.does(OTHER, bid(id, OTHER));
    both.wait(TERMS.open_for);
    both.does(OTHER, Call::Reclaim { id });
    both.refuses(ContractError::NoSuchBid, OTHER, Call::Reclaim { id });
}

#[test]
fn money_is_never_paid_to_nobody() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.closed(SALT);
    both.does(CREATOR, Call::Cancel { id });
    for to in [Account::default(), both.chain.contract()] {
        both.refuses(ContractError::BadReceiver, CREATOR, Call::Withdraw { to });
    }
    both.does(CREATOR, Call::Withdraw { to: CREATOR });
}
