//! Who may do what, and when.

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
fn a_service_is_negotiated_used_and_paid_by_the_second() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.in_use(SALT);
    both.wait(98);
    // Two calls are a second apart each: accepted one second behind the deployment, released 99 later.
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
fn an_announcement_is_complete_and_unique() {
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
    // Another's id with the same salt is another.
    both.does(OTHER, announce(SALT));
}

#[test]
fn bids_are_of_other_operators_once_and_in_time() {
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
fn the_creator_alone_chooses_among_the_bids_at_their_price() {
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
    // A bid for nothing can be made, for nobody sees its price; it cannot win.
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
fn the_winner_alone_deploys_and_the_creator_alone_accepts() {
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
fn until_both_said_that_it_works_either_may_go_and_nothing_is_owed() {
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
    assert_eq!(both.balance(PROVIDER), Wei(4 * TERMS.bond().0), "its bond is its own again");
    assert_eq!(both.balance(CREATOR), Wei(4 * PRICE.times(TERMS.use_for).0));
    both.does(CREATOR, Call::Withdraw { to: CREATOR });
}

#[test]
fn whoever_is_late_loses_the_service_and_anyone_may_say_so() {
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
        // The last second that is in time.
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
            // While another can be chosen, nobody takes that from the creator. Behind that, it is over.
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
fn a_late_release_is_charged_for_what_was_paid_and_no_more() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.in_use(SALT);
    both.wait(10 * TERMS.use_for);
    let ended = both.does(CREATOR, Call::Release { id });
    let charge = PRICE.times(TERMS.use_for);
    assert_eq!(ended, Event::ServiceEnded { id, provider: PROVIDER, outcome: Outcome::Completed, charge });
}

#[test]
fn the_highest_price_for_the_longest_time_overflows_nothing() {
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

/// The provider's bond and one more bid, of another.
fn two_bids(both: &mut Both) -> ServiceId {
    let id = both.bid_for(SALT);
    both.does(OTHER, bid(id, OTHER));
    id
}

#[test]
fn a_bid_is_bound_by_its_bond_and_no_more() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.id(CREATOR, SALT);
    both.does(CREATOR, announce(SALT));
    for wrong in [0, TERMS.bond().0 - 1, TERMS.bond().0 + 1] {
        let Call::Bid { id, commitment, sealed, .. } = bid(id, PROVIDER) else { panic!() };
        let call = Call::Bid { id, commitment, sealed, bond: Wei(wrong) };
        both.refuses(ContractError::BadDeposit(TERMS.bond()), PROVIDER, call);
    }
    // What stands for a bid that was chosen is no commitment: its bond would be nobody's.
    let mut spent = [0; 32];
    spent[31] = 1;
    let call = Call::Bid { id, commitment: Commitment(spent), sealed: vec![1], bond: TERMS.bond() };
    both.refuses(ContractError::BadCommitment, PROVIDER, call);
}

#[test]
fn who_wins_and_does_not_deploy_in_time_loses_its_bond_to_the_creator_and_another_is_chosen() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = two_bids(&mut both);
    both.does(CREATOR, choose(id, PROVIDER));
    both.refuses(ContractError::WrongState(State::Closed), CREATOR, choose(id, OTHER));
    both.wait(TERMS.deploy_within);
    both.does(CREATOR, choose(id, OTHER));
    let deposit = PRICE.times(TERMS.use_for);
    assert_eq!(both.balance(CREATOR), Wei(deposit.0 + TERMS.bond().0));
    assert_eq!(both.balance(PROVIDER), Wei(0));
    // It is out: it neither deploys, nor declines, nor bids, nor is chosen again, and it has no bond to take back.
    both.refuses(ContractError::OnlyProvider, PROVIDER, deploy(id));
    both.refuses(ContractError::OnlyProvider, PROVIDER, Call::Decline { id });
    both.refuses(ContractError::NoSuchBid, PROVIDER, Call::Reclaim { id });
    both.does(OTHER, Call::Decline { id });
    assert_eq!(both.balance(OTHER), TERMS.bond(), "it said so in time");
    both.refuses(ContractError::AlreadyBid, PROVIDER, bid(id, PROVIDER));
    for again in [PROVIDER, OTHER] {
        both.refuses(ContractError::NoSuchBid, CREATOR, choose(id, again));
    }
}

#[test]
fn a_late_winner_does_not_save_its_bond_by_declining_and_does_not_end_the_service() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = two_bids(&mut both);
    both.does(CREATOR, choose(id, PROVIDER));
    both.wait(TERMS.deploy_within);
    both.does(PROVIDER, Call::Decline { id });
    assert_eq!((both.balance(PROVIDER), both.state(id)), (Wei(0), State::Open));
    both.does(CREATOR, choose(id, OTHER));
    // Nor by a creator that gives up behind the time, or before it.
    both.wait(TERMS.deploy_within);
    let ended = both.does(CREATOR, Call::Cancel { id });
    assert!(matches!(ended, Event::ServiceEnded { outcome: Outcome::NotDeployed, .. }), "{ended:?}");
    assert_eq!(both.balance(OTHER), Wei(0));
}

#[test]
fn a_creator_that_gives_up_in_time_takes_no_bond() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.closed(SALT);
    both.does(CREATOR, Call::Cancel { id });
    assert_eq!(both.balance(PROVIDER), TERMS.bond());
    // Nor one that chooses another in place of what was deployed.
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
fn who_was_not_chosen_has_its_bond_again_once_nobody_can_be_chosen() {
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
    // Also of a creator that never says anything.
    both.does(CREATOR, announce(Salt([6; 32])));
    let id = both.id(CREATOR, Salt([6; 32]));
    both.does(OTHER, bid(id, OTHER));
    both.wait(TERMS.open_for);
    both.does(OTHER, Call::Reclaim { id });
    both.refuses(ContractError::NoSuchBid, OTHER, Call::Reclaim { id });
}

#[test]
fn nothing_is_paid_to_nobody() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.closed(SALT);
    both.does(CREATOR, Call::Cancel { id });
    for to in [Account::default(), both.chain.contract()] {
        both.refuses(ContractError::BadReceiver, CREATOR, Call::Withdraw { to });
    }
    both.does(CREATOR, Call::Withdraw { to: CREATOR });
}
