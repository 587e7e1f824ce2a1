//! Calls, events and errors in the contract's binary interface, generated from the contract's source.

use alloy::{
    primitives::{B256, Bytes, U256, aliases::U96, hex},
    sol_types::{SolCall, SolEventInterface, SolInterface},
};

use crate::{
    message::{self, Call, ContractError, Event},
    values::{Account, ChainTime, Commitment, Price, PublicKey, ServiceId, Wei},
};

mod generated {
    alloy::sol!("../../contracts/Federation.sol");
}
use generated::Federation::{self, FederationErrors, FederationEvents};

/// Data that the contract cannot have produced.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("not an answer of the federation contract: {0}")]
pub struct DecodeError(String);

/// Returns the bytecode that deploys the contract, from `contracts/Federation.json`, which `contracts/compile.mjs`
/// makes.
pub fn bytecode() -> Vec<u8> {
    #[derive(serde::Deserialize)]
    struct Artefact<'a> {
        bytecode: &'a str,
    }
    let artefact: Artefact<'_> = serde_json::from_str(include_str!("../../../../contracts/Federation.json"))
        .expect("it is checked in");
    hex::decode(artefact.bytecode).expect("solc writes hexadecimal")
}

/// Encodes a call as a transaction's input.
pub fn encode(call: &Call) -> Vec<u8> {
    let id = |id: &ServiceId| B256::from(id.0);
    match call {
        Call::Register { name } => Federation::registerCall { name: name.clone() }.abi_encode(),
        Call::Announce { salt, key, requirements, terms } => Federation::announceCall {
            salt: salt.0.into(),
            key: key.0.into(),
            requirements: Federation::Requirements {
                vnf: requirements.vnf.clone(),
                map: requirements.map.clone(),
                xMm: requirements.x_mm,
                yMm: requirements.y_mm,
                radiusMm: requirements.radius_mm,
                ssid: requirements.ssid.clone(),
                mobilityDomain: requirements.mobility_domain,
                frequencyMhz: requirements.frequency_mhz,
                widthMhz: requirements.width_mhz,
                signalDbm: requirements.signal_dbm,
            },
            terms: Federation::Terms {
                openFor: terms.open_for,
                deployWithin: terms.deploy_within,
                acceptWithin: terms.accept_within,
                useFor: terms.use_for,
                bond: terms.bond,
            },
        }
        .abi_encode(),
        Call::Bid { id, commitment, sealed, bond: _ } => Federation::bidCall {
            id: id.0.into(),
            commitment: commitment.0.into(),
            sealedBid: Bytes::copy_from_slice(sealed),
        }
        .abi_encode(),
        Call::Choose { id, provider, price, salt, deposit: _ } => Federation::chooseCall {
            id: id.0.into(),
            provider: provider.0.into(),
            price: U96::from(price.get()),
            salt: salt.0.into(),
        }
        .abi_encode(),
        Call::Deploy { id, sealed } => {
            Federation::deployCall { id: id.0.into(), sealedAttachment: Bytes::copy_from_slice(sealed) }
                .abi_encode()
        }
        Call::Accept { id: of } => Federation::acceptCall { id: id(of) }.abi_encode(),
        Call::Cancel { id: of } => Federation::cancelCall { id: id(of) }.abi_encode(),
        Call::Decline { id: of } => Federation::declineCall { id: id(of) }.abi_encode(),
        Call::Release { id: of } => Federation::releaseCall { id: id(of) }.abi_encode(),
        Call::Expire { id: of } => Federation::expireCall { id: id(of) }.abi_encode(),
        Call::Reclaim { id: of } => Federation::reclaimCall { id: id(of) }.abi_encode(),
        Call::Withdraw { to } => Federation::withdrawCall { to: to.0.into() }.abi_encode(),
    }
}

/// Decodes an event from a log of the contract.
///
/// # Errors
/// [`DecodeError`] if the contract cannot have written it.
pub fn decode_event(topics: &[[u8; 32]], data: &[u8]) -> Result<Event, DecodeError> {
    let topics: Vec<B256> = topics.iter().map(B256::from).collect();
    let event = FederationEvents::decode_raw_log(&topics, data).map_err(|e| DecodeError(e.to_string()))?;
    Ok(match event {
        FederationEvents::OperatorRegistered(e) => {
            Event::OperatorRegistered { operator: Account(e.operator.into()), name: e.name }
        }
        FederationEvents::ServiceAnnounced(e) => Event::ServiceAnnounced {
            id: ServiceId(e.id.0),
            creator: Account(e.creator.into()),
            key: PublicKey(e.key.0),
            requirements: message::Requirements {
                vnf: e.requirements.vnf,
                map: e.requirements.map,
                x_mm: e.requirements.xMm,
                y_mm: e.requirements.yMm,
                radius_mm: e.requirements.radiusMm,
                ssid: e.requirements.ssid,
                mobility_domain: e.requirements.mobilityDomain,
                frequency_mhz: e.requirements.frequencyMhz,
                width_mhz: e.requirements.widthMhz,
                signal_dbm: e.requirements.signalDbm,
            },
            terms: message::Terms {
                open_for: e.terms.openFor,
                deploy_within: e.terms.deployWithin,
                accept_within: e.terms.acceptWithin,
                use_for: e.terms.useFor,
                bond: e.terms.bond,
            },
            deadline: ChainTime(e.deadline.to()),
        },
        FederationEvents::BidPlaced(e) => Event::BidPlaced {
            id: ServiceId(e.id.0),
            provider: Account(e.provider.into()),
            commitment: Commitment(e.commitment.0),
            sealed: e.sealedBid.into(),
        },
        FederationEvents::ProviderChosen(e) => Event::ProviderChosen {
            id: ServiceId(e.id.0),
            provider: Account(e.provider.into()),
            price: Price::new(e.price.to()).expect("96 bits"),
            choice: e.choice,
            deadline: ChainTime(e.deadline.to()),
        },
        FederationEvents::ServiceDeployed(e) => Event::ServiceDeployed {
            id: ServiceId(e.id.0),
            provider: Account(e.provider.into()),
            sealed: e.sealedAttachment.into(),
            deadline: ChainTime(e.deadline.to()),
        },
        FederationEvents::ServiceAccepted(e) => Event::ServiceAccepted {
            id: ServiceId(e.id.0),
            provider: Account(e.provider.into()),
            deadline: ChainTime(e.deadline.to()),
        },
        FederationEvents::ServiceReopened(e) => Event::ServiceReopened {
            id: ServiceId(e.id.0),
            provider: Account(e.provider.into()),
            deadline: ChainTime(e.deadline.to()),
        },
        FederationEvents::BondReclaimed(e) => Event::BondReclaimed {
            id: ServiceId(e.id.0),
            provider: Account(e.provider.into()),
            bond: Wei(e.bond.into()),
        },
        FederationEvents::ServiceEnded(e) => Event::ServiceEnded {
            id: ServiceId(e.id.0),
            provider: Account(e.provider.into()),
            outcome: outcome(e.outcome)?,
            charge: wei(e.charge)?,
        },
        FederationEvents::Withdrawn(e) => {
            let (operator, to) = (Account(e.operator.into()), Account(e.to.into()));
            Event::Withdrawn { operator, to, amount: wei(e.amount)? }
        }
    })
}

/// Decodes the reason for which a call was reverted.
///
/// # Errors
/// [`DecodeError`] if the contract has no such error.
pub fn decode_error(data: &[u8]) -> Result<ContractError, DecodeError> {
    let error = FederationErrors::abi_decode(data).map_err(|e| DecodeError(e.to_string()))?;
    Ok(match error {
        FederationErrors::NotRegistered(_) => ContractError::NotRegistered,
        FederationErrors::AlreadyRegistered(_) => ContractError::AlreadyRegistered,
        FederationErrors::BadName(_) => ContractError::BadName,
        FederationErrors::BadRequirements(_) => ContractError::BadRequirements,
        FederationErrors::BadTerms(_) => ContractError::BadTerms,
        FederationErrors::BadKey(_) => ContractError::BadKey,
        FederationErrors::BadSealed(_) => ContractError::BadSealed,
        FederationErrors::BadCommitment(_) => ContractError::BadCommitment,
        FederationErrors::BadDeposit(e) => ContractError::BadDeposit(wei(e.due)?),
        FederationErrors::AlreadyAnnounced(_) => ContractError::AlreadyAnnounced,
        FederationErrors::AlreadyBid(_) => ContractError::AlreadyBid,
        FederationErrors::NoSuchBid(_) => ContractError::NoSuchBid,
        FederationErrors::CommitmentDiffers(_) => ContractError::CommitmentDiffers,
        FederationErrors::PriceIsZero(_) => ContractError::PriceIsZero,
        FederationErrors::OwnService(_) => ContractError::OwnService,
        FederationErrors::OnlyCreator(_) => ContractError::OnlyCreator,
        FederationErrors::OnlyProvider(_) => ContractError::OnlyProvider,
        FederationErrors::OnlyParties(_) => ContractError::OnlyParties,
        FederationErrors::WrongState(e) => ContractError::WrongState(state(e.state)?),
        FederationErrors::TooLate(e) => ContractError::TooLate(ChainTime(e.deadline.to())),
        FederationErrors::TooEarly(e) => ContractError::TooEarly(ChainTime(e.deadline.to())),
        FederationErrors::BondBound(_) => ContractError::BondBound,
        FederationErrors::BadReceiver(_) => ContractError::BadReceiver,
        FederationErrors::NothingToWithdraw(_) => ContractError::NothingToWithdraw,
        FederationErrors::TransferFailed(_) => ContractError::TransferFailed,
    })
}

fn wei(amount: U256) -> Result<Wei, DecodeError> {
    u128::try_from(amount)
        .map(Wei)
        .map_err(|_| DecodeError(format!("{amount} wei exceed the possible amount")))
}

fn state(state: Federation::State) -> Result<message::State, DecodeError> {
    use Federation::State as S;
    Ok(match state {
        S::None => message::State::None,
        S::Open => message::State::Open,
        S::Closed => message::State::Closed,
        S::Deployed => message::State::Deployed,
        S::InUse => message::State::InUse,
        S::Ended => message::State::Ended,
        S::__Invalid => return Err(DecodeError("a state that does not exist".to_owned())),
    })
}

fn outcome(outcome: Federation::Outcome) -> Result<message::Outcome, DecodeError> {
    use Federation::Outcome as O;
    Ok(match outcome {
        O::Cancelled => message::Outcome::Cancelled,
        O::Declined => message::Outcome::Declined,
        O::NoWinner => message::Outcome::NoWinner,
        O::NotDeployed => message::Outcome::NotDeployed,
        O::NotAccepted => message::Outcome::NotAccepted,
        O::Released => message::Outcome::Released,
        O::Completed => message::Outcome::Completed,
        O::__Invalid => return Err(DecodeError("an outcome that does not exist".to_owned())),
    })
}

#[cfg(test)]
mod tests {
    use alloy::sol_types::{SolError, SolEvent};
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn arbitrary_node_answers_never_panic(
            kind in 0..11usize,
            mut topics in prop::collection::vec(any::<[u8; 32]>(), 0..4),
            mut data in prop::collection::vec(any::<u8>(), 0..600),
        ) {
            // Of the contract's own kinds, as far as their names go.
            let kinds = [
                Federation::OperatorRegistered::SIGNATURE_HASH,
                Federation::ServiceAnnounced::SIGNATURE_HASH,
                Federation::BidPlaced::SIGNATURE_HASH,
                Federation::ProviderChosen::SIGNATURE_HASH,
                Federation::ServiceDeployed::SIGNATURE_HASH,
                Federation::ServiceAccepted::SIGNATURE_HASH,
                Federation::ServiceEnded::SIGNATURE_HASH,
                Federation::ServiceReopened::SIGNATURE_HASH,
                Federation::BondReclaimed::SIGNATURE_HASH,
                Federation::Withdrawn::SIGNATURE_HASH,
            ];
            if let (Some(first), Some(kind)) = (topics.first_mut(), kinds.get(kind)) {
                *first = kind.0;
            }
            let _ = decode_event(&topics, &data);
            if let Some(head) = data.get_mut(..4) {
                head.copy_from_slice(&Federation::WrongState::SELECTOR);
            }
            let _ = decode_error(&data);
        }
    }

    #[test]
    fn impossible_amounts_and_states_are_rejected() {
        let due = Federation::BadDeposit { due: U256::MAX }.abi_encode();
        assert!(decode_error(&due).unwrap_err().to_string().contains("exceed the possible amount"));
        let mut state = Federation::WrongState { state: Federation::State::Ended }.abi_encode();
        assert_eq!(decode_error(&state), Ok(ContractError::WrongState(message::State::Ended)));
        *state.last_mut().unwrap() = 77;
        assert!(decode_error(&state).is_err());
    }
}
