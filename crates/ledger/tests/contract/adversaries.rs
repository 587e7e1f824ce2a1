//! Tests attackers, some of them contracts themselves.

use alloy::{primitives::Bytes, sol_types::SolCall};
use cotorra_ledger::{Account, Call, Commitment, ContractError, Event, Salt, Wei, ethereum};

use crate::{
    both::{Both, CREATOR, OTHER, PRICE, PROVIDER, TERMS, announce, bid, choose, deploy, salt_of},
    chain::{START, account, attacker},
};

mod generated {
    alloy::sol!("../../contracts/Attackers.sol");
}
use generated::{Reentrant, Wallet};

const SALT: Salt = Salt([6; 32]);
const MALLORY: Account = Account([66; 20]);

/// Makes `call` through a contract of Mallory's.
fn execute(both: &mut Both, wallet: Account, call: &Call) -> Result<Vec<Event>, ContractError> {
    both.wait(1);
    let input = Wallet::executeCall {
        target: both.chain.contract().0.into(),
        input: Bytes::from(ethereum::encode(call)),
    };
    let chain = &both.chain;
    chain
        .transact(both.now, MALLORY, wallet, &input.abi_encode(), call.value().0)
        .map(|receipt| receipt.events)
}

/// Makes a service that Mallory's contract announced and used, so that the contract has a balance. The creator also
/// has a deposit, which is not Mallory's.
fn with_balance(both: &mut Both, wallet: Account) {
    let create = |both: &mut Both, call: Call| execute(both, wallet, &call).unwrap();
    create(both, Call::Register { name: "mallory".to_owned() });
    create(both, announce(SALT));
    let id = both.id(wallet, SALT);
    let chain = &both.chain;
    chain.call(both.now.after(1), PROVIDER, &bid(id, PROVIDER)).unwrap();
    both.wait(1);
    create(both, choose(id, PROVIDER));
    create(both, Call::Cancel { id });
}

fn view(both: &Both, call: &impl SolCall, of: Account) -> Vec<u8> {
    both.chain.view(of, &call.abi_encode())
}

#[test]
fn reentrant_payees_get_nothing_more() {
    let Some(mut both) = Both::with_operators() else { return };
    let victim = both.closed(Salt([7; 32]));
    let wallet = both.chain.create(MALLORY, &attacker("Reentrant"));
    with_balance(&mut both, wallet);
    let again =
        Reentrant::setAgainCall { input: Bytes::from(ethereum::encode(&Call::Withdraw { to: wallet })) };
    both.wait(1);
    both.chain.transact(both.now, MALLORY, wallet, &again.abi_encode(), 0).unwrap();
    let amount = PRICE.times(TERMS.use_for);
    let paid = execute(&mut both, wallet, &Call::Withdraw { to: wallet }).unwrap();
    assert_eq!(paid, [Event::Withdrawn { operator: wallet, to: wallet, amount }]);
    assert_eq!(both.chain.wealth(wallet), amount.0, "paid once");
    assert_eq!(view(&both, &Reentrant::gainsCall {}, wallet), [0; 32], "the reentrant call was rejected");
    let left = amount.0 + 2 * TERMS.bond().0;
    assert_eq!(
        both.chain.wealth(both.chain.contract()),
        left,
        "the victim's deposit is still there, and all bonds"
    );
    both.chain.call(both.now.after(1), CREATOR, &Call::Cancel { id: victim }).unwrap();
}

#[test]
fn payees_that_reject_money_block_nobody() {
    let Some(mut both) = Both::with_operators() else { return };
    let wallet = both.chain.create(MALLORY, &attacker("Unpayable"));
    // Its service ends although it cannot be paid back. Only its own withdrawal fails, each time.
    with_balance(&mut both, wallet);
    for _ in 0..2 {
        assert_eq!(
            execute(&mut both, wallet, &Call::Withdraw { to: wallet }),
            Err(ContractError::TransferFailed)
        );
    }
    let bond = TERMS.bond().0;
    assert_eq!(both.chain.wealth(both.chain.contract()), PRICE.times(TERMS.use_for).0 + bond);
    // Unpaid money is not lost. It goes only to the receiver named by its owner.
    both.wait(1);
    let anybody = both.chain.call(both.now, MALLORY, &Call::Withdraw { to: MALLORY });
    assert_eq!(anybody.err(), Some(ContractError::NothingToWithdraw));
    let to = Account([67; 20]);
    execute(&mut both, wallet, &Call::Withdraw { to }).unwrap();
    assert_eq!(both.chain.wealth(to), PRICE.times(TERMS.use_for).0);
    assert_eq!(both.chain.wealth(both.chain.contract()), bond);
}

#[test]
fn ids_cannot_be_taken_by_front_running() {
    let Some(mut both) = Both::with_operators() else { return };
    // Mallory sees the creator's announcement before it is in a block, and sends the same at a higher fee.
    both.does(OTHER, announce(SALT));
    let announced = both.does(CREATOR, announce(SALT));
    assert_eq!(announced.service(), Some(both.id(CREATOR, SALT)));
}

#[test]
fn replayed_announcements_open_nothing_again() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.deployed(SALT);
    both.refuses(ContractError::AlreadyAnnounced, CREATOR, announce(SALT));
    both.does(CREATOR, Call::Cancel { id });
    both.refuses(ContractError::AlreadyAnnounced, CREATOR, announce(SALT));
}

#[test]
fn copied_bids_cannot_be_opened() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.bid_for(SALT);
    // The exact bytes of the provider's bid, by another.
    both.does(OTHER, bid(id, PROVIDER));
    let deposit = PRICE.times(TERMS.use_for);
    let copied = Call::Choose { id, provider: OTHER, price: PRICE, salt: salt_of(PROVIDER), deposit };
    both.refuses(ContractError::CommitmentDiffers, CREATOR, copied);
    // A bid for one service is not valid for another.
    let second = both.id(CREATOR, Salt([8; 32]));
    both.does(CREATOR, announce(Salt([8; 32])));
    let commitment = Commitment::to(id, PROVIDER, PRICE, salt_of(PROVIDER));
    both.does(PROVIDER, Call::Bid { id: second, commitment, sealed: vec![1], bond: TERMS.bond() });
    both.refuses(ContractError::CommitmentDiffers, CREATOR, choose(second, PROVIDER));
}

#[test]
fn lying_providers_are_paid_nothing() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.deployed(SALT);
    both.refuses(ContractError::OnlyCreator, PROVIDER, Call::Accept { id });
    both.wait(TERMS.accept_within);
    let left = both.does(PROVIDER, Call::Expire { id });
    assert!(matches!(left, Event::ServiceReopened { provider: PROVIDER, .. }), "{left:?}");
    assert_eq!(both.balance(PROVIDER), TERMS.bond(), "only its bond");
    both.does(CREATOR, Call::Withdraw { to: CREATOR });
}

#[test]
fn creators_cannot_withdraw_the_deposit_of_a_used_service() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.in_use(SALT);
    both.wait(TERMS.use_for / 2);
    // Each call, accepted or rejected, takes a second.
    both.refuses(ContractError::NothingToWithdraw, CREATOR, Call::Withdraw { to: CREATOR });
    both.does(PROVIDER, Call::Release { id });
    let used = PRICE.times(TERMS.use_for / 2 + 3);
    assert_eq!(both.balance(PROVIDER), Wei(used.0 + TERMS.bond().0));
}

#[test]
fn only_the_winner_of_a_service_can_deploy_it() {
    let Some(mut both) = Both::with_operators() else { return };
    let id = both.bid_for(SALT);
    both.does(OTHER, bid(id, OTHER));
    both.does(CREATOR, choose(id, PROVIDER));
    both.refuses(ContractError::OnlyProvider, OTHER, deploy(id));
    let second = Salt([8; 32]);
    both.does(CREATOR, announce(second));
    let second = both.id(CREATOR, second);
    both.does(OTHER, bid(second, OTHER));
    both.does(CREATOR, choose(second, OTHER));
    both.refuses(ContractError::OnlyProvider, OTHER, deploy(id));
    both.refuses(ContractError::OnlyProvider, PROVIDER, deploy(second));
}

#[test]
fn money_without_a_paying_call_is_rejected() {
    let Some(both) = Both::new() else { return };
    let contract = both.chain.contract();
    let register = ethereum::encode(&Call::Register { name: "rich".to_owned() });
    for (input, value) in [(&[][..], 1), (&[0xde, 0xad, 0xbe, 0xef], 0), (&register, 1)] {
        assert!(both.chain.is_reverted(START.after(10), account(4), contract, input, value), "{input:?}");
    }
    assert_eq!(both.chain.wealth(contract), 0);
}
