//! The contract's rules as a state machine without a ledger. The modelled ledger runs it in virtual time, and the
//! tests compare it with the compiled contract, call by call.

use std::collections::HashMap;

use crate::{
    message::{
        Call, ContractError, Event, MAX_NAME, MAX_SEALED, MAX_SSID, Outcome, Requirements, State, Terms,
    },
    values::{Account, ChainTime, Commitment, Deployment, Price, PublicKey, Salt, ServiceId, Wei},
};

/// The rules of `contracts/Federation.sol`.
#[derive(Debug, Clone)]
pub struct Contract {
    deployment: Deployment,
    names: HashMap<Account, String>,
    balances: HashMap<Account, Wei>,
    services: HashMap<ServiceId, Service>,
    bids: HashMap<(ServiceId, Account), Bid>,
}

#[derive(Debug, Clone)]
struct Service {
    creator: Account,
    terms: Terms,
    /// Deadline for choosing a provider.
    choose_by: ChainTime,
    /// Number of choices so far.
    choices: u32,
    stage: Stage,
}

/// A provider bids at most once for a service, and the bid is chosen at most once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bid {
    Standing(Commitment),
    /// The bid was chosen, or its bond reclaimed.
    Spent,
}

/// The state of a service with its data.
#[derive(Debug, Clone, Copy)]
enum Stage {
    Open { deadline: ChainTime },
    Closed { winner: Winner, deadline: ChainTime },
    Deployed { winner: Winner, at: ChainTime, deadline: ChainTime },
    InUse { winner: Winner, from: ChainTime, deadline: ChainTime },
    Ended { winner: Option<Winner> },
}

#[derive(Debug, Clone, Copy)]
struct Winner {
    provider: Account,
    price: Price,
}

/// A bid opened by its creator.
struct OpenedBid {
    provider: Account,
    price: Price,
    salt: Salt,
}

impl Stage {
    fn state(&self) -> State {
        match self {
            Self::Open { .. } => State::Open,
            Self::Closed { .. } => State::Closed,
            Self::Deployed { .. } => State::Deployed,
            Self::InUse { .. } => State::InUse,
            Self::Ended { .. } => State::Ended,
        }
    }

    fn winner(&self) -> Option<Winner> {
        match *self {
            Self::Open { .. } => None,
            Self::Closed { winner, .. } | Self::Deployed { winner, .. } | Self::InUse { winner, .. } => {
                Some(winner)
            }
            Self::Ended { winner } => winner,
        }
    }

    fn is_won_by(&self, operator: Account) -> bool {
        self.winner().is_some_and(|winner| winner.provider == operator)
    }
}

impl Contract {
    /// Makes a contract without any services.
    pub fn new(deployment: Deployment) -> Self {
        Self {
            deployment,
            names: HashMap::new(),
            balances: HashMap::new(),
            services: HashMap::new(),
            bids: HashMap::new(),
        }
    }

    pub fn deployment(&self) -> Deployment {
        self.deployment
    }

    /// Applies a call by `caller` in a block of time `now`.
    ///
    /// # Errors
    /// The error that the contract would revert with; then nothing has changed.
    pub fn apply(&mut self, now: ChainTime, caller: Account, call: &Call) -> Result<Event, ContractError> {
        match call {
            Call::Register { name } => self.register(caller, name),
            Call::Announce { salt, key, requirements, terms } => {
                self.announce(now, caller, *salt, *key, requirements, *terms)
            }
            Call::Bid { id, commitment, sealed, bond } => {
                self.bid(now, caller, *id, *commitment, sealed, *bond)
            }
            Call::Choose { id, provider, price, salt, deposit } => {
                let bid = OpenedBid { provider: *provider, price: *price, salt: *salt };
                self.choose(now, caller, *id, bid, *deposit)
            }
            Call::Deploy { id, sealed } => self.deploy(now, caller, *id, sealed),
            Call::Accept { id } => self.accept(now, caller, *id),
            Call::Cancel { id } => self.cancel(now, caller, *id),
            Call::Decline { id } => self.decline(now, caller, *id),
            Call::Release { id } => self.release(now, caller, *id),
            Call::Expire { id } => self.expire(now, *id),
            Call::Reclaim { id } => self.reclaim(now, caller, *id),
            Call::Withdraw { to } => self.withdraw(caller, *to),
        }
    }

    /// Returns the state of a service.
    pub fn state(&self, id: ServiceId) -> State {
        self.services.get(&id).map_or(State::None, |service| service.stage.state())
    }

    /// Returns the amount that an operator may withdraw.
    pub fn balance(&self, operator: Account) -> Wei {
        self.balances.get(&operator).copied().unwrap_or_default()
    }

    /// Returns all the money that the contract holds: deposits and bonds of services that have not ended, bonds of
    /// standing bids, and balances.
    pub fn holds(&self) -> Wei {
        let deposits = self.services.values().flat_map(|service| [service.deposit(), service.winners_bond()]);
        let bonds = self.bids.iter().map(|((id, _), bid)| match bid {
            Bid::Standing(_) => self.services[id].terms.bond(),
            Bid::Spent => Wei(0),
        });
        Wei(deposits.chain(bonds).chain(self.balances.values().copied()).map(|wei| wei.0).sum())
    }

    fn register(&mut self, caller: Account, name: &str) -> Result<Event, ContractError> {
        require(!self.names.contains_key(&caller), ContractError::AlreadyRegistered)?;
        require(is_name(name), ContractError::BadName)?;
        self.names.insert(caller, name.to_owned());
        Ok(Event::OperatorRegistered { operator: caller, name: name.to_owned() })
    }

    fn announce(
        &mut self,
        now: ChainTime,
        creator: Account,
        salt: Salt,
        key: PublicKey,
        requirements: &Requirements,
        terms: Terms,
    ) -> Result<Event, ContractError> {
        let id = ServiceId::of(self.deployment, creator, salt);
        self.require_registered(creator)?;
        require(!self.services.contains_key(&id), ContractError::AlreadyAnnounced)?;
        require(key != PublicKey::default(), ContractError::BadKey)?;
        let Requirements { vnf, map, ssid, .. } = requirements;
        require(is_name(vnf) && is_name(map) && ssid.len() <= MAX_SSID, ContractError::BadRequirements)?;
        let Terms { open_for, deploy_within, accept_within, use_for, bond: _ } = terms;
        require(![open_for, deploy_within, accept_within, use_for].contains(&0), ContractError::BadTerms)?;
        let deadline = now.after(open_for);
        let stage = Stage::Open { deadline };
        self.services.insert(id, Service { creator, terms, choose_by: deadline, choices: 0, stage });
        Ok(Event::ServiceAnnounced { id, creator, key, requirements: requirements.clone(), terms, deadline })
    }

    fn bid(
        &mut self,
        now: ChainTime,
        provider: Account,
        id: ServiceId,
        commitment: Commitment,
        sealed: &[u8],
        bond: Wei,
    ) -> Result<Event, ContractError> {
        self.require_registered(provider)?;
        let service = self.open(now, id)?;
        let due = service.terms.bond();
        require(service.creator != provider, ContractError::OwnService)?;
        require(!self.bids.contains_key(&(id, provider)), ContractError::AlreadyBid)?;
        require(commitment != Commitment::default() && commitment != SPENT, ContractError::BadCommitment)?;
        require(is_sealed(sealed), ContractError::BadSealed)?;
        require(bond == due, ContractError::BadDeposit(due))?;
        self.bids.insert((id, provider), Bid::Standing(commitment));
        Ok(Event::BidPlaced { id, provider, commitment, sealed: sealed.to_owned() })
    }

    fn choose(
        &mut self,
        now: ChainTime,
        caller: Account,
        id: ServiceId,
        OpenedBid { provider, price, salt }: OpenedBid,
        deposit: Wei,
    ) -> Result<Event, ContractError> {
        let bid = self.bids.get(&(id, provider)).copied();
        let service = self.service(id)?;
        let can_choose = match service.stage {
            Stage::Open { .. } | Stage::Deployed { .. } => true,
            Stage::Closed { deadline, .. } => now > deadline,
            Stage::InUse { .. } | Stage::Ended { .. } => false,
        };
        require(can_choose, ContractError::WrongState(service.stage.state()))?;
        require(now <= service.choose_by, ContractError::TooLate(service.choose_by))?;
        require(service.creator == caller, ContractError::OnlyCreator)?;
        let Some(Bid::Standing(commitment)) = bid else { return Err(ContractError::NoSuchBid) };
        require(commitment == Commitment::to(id, provider, price, salt), ContractError::CommitmentDiffers)?;
        require(price.get() != 0, ContractError::PriceIsZero)?;
        let due = price.times(service.terms.use_for);
        require(deposit == due, ContractError::BadDeposit(due))?;
        self.settle(now, id, Wei(0));
        self.bids.insert((id, provider), Bid::Spent);
        let service = self.service(id)?;
        let deadline = now.after(service.terms.deploy_within);
        service.stage = Stage::Closed { winner: Winner { provider, price }, deadline };
        service.choices += 1;
        Ok(Event::ProviderChosen { id, provider, price, choice: service.choices, deadline })
    }

    fn deploy(
        &mut self,
        now: ChainTime,
        caller: Account,
        id: ServiceId,
        sealed: &[u8],
    ) -> Result<Event, ContractError> {
        let service = self.service(id)?;
        let Stage::Closed { winner, deadline } = service.stage else {
            return Err(ContractError::WrongState(service.stage.state()));
        };
        require(now <= deadline, ContractError::TooLate(deadline))?;
        require(winner.provider == caller, ContractError::OnlyProvider)?;
        require(is_sealed(sealed), ContractError::BadSealed)?;
        let deadline = now.after(service.terms.accept_within);
        let bond = service.terms.bond();
        service.stage = Stage::Deployed { winner, at: now, deadline };
        self.credit(caller, bond);
        Ok(Event::ServiceDeployed { id, provider: caller, sealed: sealed.to_owned(), deadline })
    }

    fn accept(&mut self, now: ChainTime, caller: Account, id: ServiceId) -> Result<Event, ContractError> {
        let service = self.service(id)?;
        let Stage::Deployed { winner, at, deadline } = service.stage else {
            return Err(ContractError::WrongState(service.stage.state()));
        };
        require(now <= deadline, ContractError::TooLate(deadline))?;
        require(service.creator == caller, ContractError::OnlyCreator)?;
        let deadline = at.after(service.terms.use_for);
        service.stage = Stage::InUse { winner, from: at, deadline };
        Ok(Event::ServiceAccepted { id, provider: winner.provider, deadline })
    }

    fn cancel(&mut self, now: ChainTime, caller: Account, id: ServiceId) -> Result<Event, ContractError> {
        let service = self.services.get(&id).ok_or(ContractError::OnlyCreator)?;
        require(service.creator == caller, ContractError::OnlyCreator)?;
        require_unaccepted(&service.stage)?;
        let is_failed = matches!(service.stage, Stage::Closed { deadline, .. } if now > deadline);
        let outcome = if is_failed { Outcome::NotDeployed } else { Outcome::Cancelled };
        Ok(self.end(now, id, outcome, Wei(0)))
    }

    fn decline(&mut self, now: ChainTime, caller: Account, id: ServiceId) -> Result<Event, ContractError> {
        let service = self.services.get(&id).ok_or(ContractError::OnlyProvider)?;
        require(service.stage.is_won_by(caller), ContractError::OnlyProvider)?;
        require_unaccepted(&service.stage)?;
        Ok(self.leave(now, id, Outcome::Declined))
    }

    fn release(&mut self, now: ChainTime, caller: Account, id: ServiceId) -> Result<Event, ContractError> {
        let service = self.services.get(&id).ok_or(ContractError::OnlyParties)?;
        require(service.creator == caller || service.stage.is_won_by(caller), ContractError::OnlyParties)?;
        let Stage::InUse { winner, from, deadline } = service.stage else {
            return Err(ContractError::WrongState(service.stage.state()));
        };
        let used = u32::try_from(now.min(deadline).0 - from.0).expect("the deadline is u32 seconds behind");
        let outcome = if now > deadline { Outcome::Completed } else { Outcome::Released };
        Ok(self.end(now, id, outcome, winner.price.times(used)))
    }

    fn expire(&mut self, now: ChainTime, id: ServiceId) -> Result<Event, ContractError> {
        let service = self.services.get(&id).ok_or(ContractError::WrongState(State::None))?;
        let (outcome, deadline) = match service.stage {
            Stage::Open { deadline } => (Outcome::NoWinner, deadline),
            Stage::Closed { deadline, .. } => (Outcome::NotDeployed, deadline),
            Stage::Deployed { deadline, .. } => (Outcome::NotAccepted, deadline),
            Stage::InUse { deadline, .. } => (Outcome::Completed, deadline),
            Stage::Ended { .. } => return Err(ContractError::WrongState(State::Ended)),
        };
        require(now > deadline, ContractError::TooEarly(deadline))?;
        Ok(match outcome {
            Outcome::NotDeployed | Outcome::NotAccepted => self.leave(now, id, outcome),
            Outcome::Completed => self.end(now, id, outcome, service.deposit()),
            _ => self.end(now, id, outcome, Wei(0)),
        })
    }

    fn reclaim(&mut self, now: ChainTime, provider: Account, id: ServiceId) -> Result<Event, ContractError> {
        let Some(Bid::Standing(_)) = self.bids.get(&(id, provider)) else {
            return Err(ContractError::NoSuchBid);
        };
        let service = self.service(id)?;
        let is_decided = matches!(service.stage, Stage::InUse { .. } | Stage::Ended { .. });
        require(is_decided || now > service.choose_by, ContractError::BondBound)?;
        let bond = service.terms.bond();
        self.bids.insert((id, provider), Bid::Spent);
        self.credit(provider, bond);
        Ok(Event::BondReclaimed { id, provider, bond })
    }

    fn withdraw(&mut self, operator: Account, to: Account) -> Result<Event, ContractError> {
        require(to != Account::default() && to != self.deployment.contract, ContractError::BadReceiver)?;
        let amount = self.balance(operator);
        require(amount != Wei(0), ContractError::NothingToWithdraw)?;
        self.balances.remove(&operator);
        Ok(Event::Withdrawn { operator, to, amount })
    }

    fn end(&mut self, now: ChainTime, id: ServiceId, outcome: Outcome, charge: Wei) -> Event {
        let winner = self.settle(now, id, charge);
        let service = self.services.get_mut(&id).expect("it was settled");
        service.stage = Stage::Ended { winner };
        let provider = winner.map(|winner| winner.provider).unwrap_or_default();
        Event::ServiceEnded { id, provider, outcome, charge }
    }

    /// Drops the winner. Another can be chosen unless the deadline for that has passed.
    fn leave(&mut self, now: ChainTime, id: ServiceId, outcome: Outcome) -> Event {
        if now > self.services[&id].choose_by {
            return self.end(now, id, outcome, Wei(0));
        }
        let winner = self.settle(now, id, Wei(0)).expect("there is one to leave");
        let service = self.services.get_mut(&id).expect("it was settled");
        let deadline = service.choose_by;
        service.stage = Stage::Open { deadline };
        Event::ServiceReopened { id, provider: winner.provider, deadline }
    }

    /// Credits deposit and bond to the parties. Returns the winner, if there is one. The caller changes the stage.
    fn settle(&mut self, now: ChainTime, id: ServiceId, charge: Wei) -> Option<Winner> {
        let service = &self.services[&id];
        let winner = service.stage.winner()?;
        let (creator, rest) = (service.creator, Wei(service.deposit().0 - charge.0));
        let is_late = matches!(service.stage, Stage::Closed { deadline, .. } if now > deadline);
        let bond = (if is_late { creator } else { winner.provider }, service.winners_bond());
        for (operator, wei) in [(winner.provider, charge), (creator, rest), bond] {
            self.credit(operator, wei);
        }
        Some(winner)
    }

    fn credit(&mut self, operator: Account, wei: Wei) {
        if wei != Wei(0) {
            let balance = self.balances.entry(operator).or_default();
            balance.0 = balance.0.checked_add(wei.0).expect("there are fewer than 2^128 wei");
        }
    }

    fn require_registered(&self, operator: Account) -> Result<(), ContractError> {
        require(self.names.contains_key(&operator), ContractError::NotRegistered)
    }

    fn service(&mut self, id: ServiceId) -> Result<&mut Service, ContractError> {
        self.services.get_mut(&id).ok_or(ContractError::WrongState(State::None))
    }

    /// Returns a service that currently accepts bids and the choice.
    fn open(&mut self, now: ChainTime, id: ServiceId) -> Result<&mut Service, ContractError> {
        let service = self.service(id)?;
        let Stage::Open { deadline } = service.stage else {
            return Err(ContractError::WrongState(service.stage.state()));
        };
        require(now <= deadline, ContractError::TooLate(deadline))?;
        Ok(service)
    }
}

impl Service {
    /// Returns the winner's bond while it is held.
    fn winners_bond(&self) -> Wei {
        match self.stage {
            Stage::Closed { .. } => self.terms.bond(),
            _ => Wei(0),
        }
    }

    /// Returns the deposit that the contract currently holds for the service.
    fn deposit(&self) -> Wei {
        match self.stage {
            Stage::Open { .. } | Stage::Ended { .. } => Wei(0),
            Stage::Closed { winner, .. } | Stage::Deployed { winner, .. } | Stage::InUse { winner, .. } => {
                winner.price.times(self.terms.use_for)
            }
        }
    }
}

/// The commitment that marks a bid as chosen; not accepted from bidders.
const SPENT: Commitment = {
    let mut one = [0; 32];
    one[31] = 1;
    Commitment(one)
};

fn require(holds: bool, otherwise: ContractError) -> Result<(), ContractError> {
    if holds { Ok(()) } else { Err(otherwise) }
}

fn require_unaccepted(stage: &Stage) -> Result<(), ContractError> {
    match stage {
        Stage::Open { .. } | Stage::Closed { .. } | Stage::Deployed { .. } => Ok(()),
        Stage::InUse { .. } | Stage::Ended { .. } => Err(ContractError::WrongState(stage.state())),
    }
}

fn is_name(name: &str) -> bool {
    (1..=MAX_NAME).contains(&name.len())
}

fn is_sealed(message: &[u8]) -> bool {
    (1..=MAX_SEALED).contains(&message.len())
}
