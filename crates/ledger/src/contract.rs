//! The contract's rules as a state machine without a ledger: what the modelled ledger runs in virtual time, and what
//! the compiled contract is compared with, call by call, in the tests.

use std::collections::HashMap;

use crate::{
    message::{Call, Event, MAX_NAME, MAX_SEALED, MAX_SSID, Outcome, Refusal, Requirements, State, Terms},
    values::{Account, ChainTime, Commitment, Deployment, Price, PublicKey, Salt, ServiceId, Wei},
};

/// `contracts/Federation.sol`, rule by rule.
#[derive(Debug, Clone)]
pub struct Contract {
    deployment: Deployment,
    names: HashMap<Account, String>,
    balances: HashMap<Account, Wei>,
    services: HashMap<ServiceId, Service>,
    commitments: HashMap<(ServiceId, Account), Commitment>,
}

#[derive(Debug, Clone)]
struct Service {
    creator: Account,
    terms: Terms,
    stage: Stage,
}

/// The state of a service, with what it has in it.
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

/// A bid, as its creator opens it.
struct Opened {
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
    /// A new one, there.
    pub fn new(deployment: Deployment) -> Self {
        Self {
            deployment,
            names: HashMap::new(),
            balances: HashMap::new(),
            services: HashMap::new(),
            commitments: HashMap::new(),
        }
    }

    /// Where it is.
    pub fn deployment(&self) -> Deployment {
        self.deployment
    }

    /// A call by `caller` in a block of time `now`.
    ///
    /// # Errors
    /// The refusal that the contract would revert with; nothing has changed then.
    pub fn apply(&mut self, now: ChainTime, caller: Account, call: &Call) -> Result<Event, Refusal> {
        match call {
            Call::Register { name } => self.register(caller, name),
            Call::Announce { salt, key, requirements, terms } => {
                self.announce(now, caller, *salt, *key, requirements, *terms)
            }
            Call::Bid { id, commitment, sealed } => self.bid(now, caller, *id, *commitment, sealed),
            Call::Choose { id, provider, price, salt, deposit } => {
                let bid = Opened { provider: *provider, price: *price, salt: *salt };
                self.choose(now, caller, *id, bid, *deposit)
            }
            Call::Deploy { id, sealed } => self.deploy(now, caller, *id, sealed),
            Call::Accept { id } => self.accept(now, caller, *id),
            Call::Cancel { id } => self.cancel(caller, *id),
            Call::Decline { id } => self.decline(caller, *id),
            Call::Release { id } => self.release(now, caller, *id),
            Call::Expire { id } => self.expire(now, *id),
            Call::Withdraw => self.withdraw(caller),
        }
    }

    /// Where a service stands.
    pub fn state(&self, id: ServiceId) -> State {
        self.services.get(&id).map_or(State::None, |service| service.stage.state())
    }

    /// What an operator may withdraw.
    pub fn balance(&self, operator: Account) -> Wei {
        self.balances.get(&operator).copied().unwrap_or_default()
    }

    /// All the money that the contract holds: deposits of services that have not ended, and balances.
    pub fn holds(&self) -> Wei {
        let deposits = self.services.values().map(Service::deposit);
        Wei(deposits.chain(self.balances.values().copied()).map(|wei| wei.0).sum())
    }

    fn register(&mut self, caller: Account, name: &str) -> Result<Event, Refusal> {
        require(!self.names.contains_key(&caller), Refusal::AlreadyRegistered)?;
        require(is_name(name), Refusal::BadName)?;
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
    ) -> Result<Event, Refusal> {
        let id = ServiceId::of(self.deployment, creator, salt);
        self.require_registered(creator)?;
        require(!self.services.contains_key(&id), Refusal::AlreadyAnnounced)?;
        require(key != PublicKey::default(), Refusal::BadKey)?;
        let Requirements { vnf, map, ssid, .. } = requirements;
        require(is_name(vnf) && is_name(map) && ssid.len() <= MAX_SSID, Refusal::BadRequirements)?;
        let Terms { open_for, deploy_within, accept_within, use_for } = terms;
        require(![open_for, deploy_within, accept_within, use_for].contains(&0), Refusal::BadTerms)?;
        let deadline = now.after(open_for);
        self.services.insert(id, Service { creator, terms, stage: Stage::Open { deadline } });
        Ok(Event::ServiceAnnounced { id, creator, key, requirements: requirements.clone(), terms, deadline })
    }

    fn bid(
        &mut self,
        now: ChainTime,
        provider: Account,
        id: ServiceId,
        commitment: Commitment,
        sealed: &[u8],
    ) -> Result<Event, Refusal> {
        self.require_registered(provider)?;
        let service = self.open(now, id)?;
        require(service.creator != provider, Refusal::OwnService)?;
        require(!self.commitments.contains_key(&(id, provider)), Refusal::AlreadyBid)?;
        require(commitment != Commitment::default(), Refusal::BadCommitment)?;
        require(is_sealed(sealed), Refusal::BadSealed)?;
        self.commitments.insert((id, provider), commitment);
        Ok(Event::BidPlaced { id, provider, commitment, sealed: sealed.to_owned() })
    }

    fn choose(
        &mut self,
        now: ChainTime,
        caller: Account,
        id: ServiceId,
        Opened { provider, price, salt }: Opened,
        deposit: Wei,
    ) -> Result<Event, Refusal> {
        let commitment = self.commitments.get(&(id, provider)).copied();
        let service = self.open(now, id)?;
        require(service.creator == caller, Refusal::OnlyCreator)?;
        let commitment = commitment.ok_or(Refusal::NoSuchBid)?;
        require(commitment == Commitment::to(id, provider, price, salt), Refusal::CommitmentDiffers)?;
        require(price.get() != 0, Refusal::PriceIsZero)?;
        let due = price.times(service.terms.use_for);
        require(deposit == due, Refusal::BadDeposit(due))?;
        let deadline = now.after(service.terms.deploy_within);
        service.stage = Stage::Closed { winner: Winner { provider, price }, deadline };
        Ok(Event::ProviderChosen { id, provider, price, deadline })
    }

    fn deploy(
        &mut self,
        now: ChainTime,
        caller: Account,
        id: ServiceId,
        sealed: &[u8],
    ) -> Result<Event, Refusal> {
        let service = self.service(id)?;
        let Stage::Closed { winner, deadline } = service.stage else {
            return Err(Refusal::WrongState(service.stage.state()));
        };
        require(now <= deadline, Refusal::TooLate(deadline))?;
        require(winner.provider == caller, Refusal::OnlyProvider)?;
        require(is_sealed(sealed), Refusal::BadSealed)?;
        let deadline = now.after(service.terms.accept_within);
        service.stage = Stage::Deployed { winner, at: now, deadline };
        Ok(Event::ServiceDeployed { id, provider: caller, sealed: sealed.to_owned(), deadline })
    }

    fn accept(&mut self, now: ChainTime, caller: Account, id: ServiceId) -> Result<Event, Refusal> {
        let service = self.service(id)?;
        let Stage::Deployed { winner, at, deadline } = service.stage else {
            return Err(Refusal::WrongState(service.stage.state()));
        };
        require(now <= deadline, Refusal::TooLate(deadline))?;
        require(service.creator == caller, Refusal::OnlyCreator)?;
        let deadline = at.after(service.terms.use_for);
        service.stage = Stage::InUse { winner, from: at, deadline };
        Ok(Event::ServiceAccepted { id, provider: winner.provider, deadline })
    }

    fn cancel(&mut self, caller: Account, id: ServiceId) -> Result<Event, Refusal> {
        let service = self.services.get(&id).ok_or(Refusal::OnlyCreator)?;
        require(service.creator == caller, Refusal::OnlyCreator)?;
        require_unaccepted(&service.stage)?;
        Ok(self.end(id, Outcome::Cancelled, Wei(0)))
    }

    fn decline(&mut self, caller: Account, id: ServiceId) -> Result<Event, Refusal> {
        let service = self.services.get(&id).ok_or(Refusal::OnlyProvider)?;
        require(service.stage.is_won_by(caller), Refusal::OnlyProvider)?;
        require_unaccepted(&service.stage)?;
        Ok(self.end(id, Outcome::Declined, Wei(0)))
    }

    fn release(&mut self, now: ChainTime, caller: Account, id: ServiceId) -> Result<Event, Refusal> {
        let service = self.services.get(&id).ok_or(Refusal::OnlyParties)?;
        require(service.creator == caller || service.stage.is_won_by(caller), Refusal::OnlyParties)?;
        let Stage::InUse { winner, from, deadline } = service.stage else {
            return Err(Refusal::WrongState(service.stage.state()));
        };
        let used = u32::try_from(now.min(deadline).0 - from.0).expect("the deadline is u32 seconds behind");
        let outcome = if now > deadline { Outcome::Completed } else { Outcome::Released };
        Ok(self.end(id, outcome, winner.price.times(used)))
    }

    fn expire(&mut self, now: ChainTime, id: ServiceId) -> Result<Event, Refusal> {
        let service = self.services.get(&id).ok_or(Refusal::WrongState(State::None))?;
        let (outcome, deadline) = match service.stage {
            Stage::Open { deadline } => (Outcome::NoWinner, deadline),
            Stage::Closed { deadline, .. } => (Outcome::NotDeployed, deadline),
            Stage::Deployed { deadline, .. } => (Outcome::NotAccepted, deadline),
            Stage::InUse { deadline, .. } => (Outcome::Completed, deadline),
            Stage::Ended { .. } => return Err(Refusal::WrongState(State::Ended)),
        };
        require(now > deadline, Refusal::TooEarly(deadline))?;
        let charge = if outcome == Outcome::Completed { service.deposit() } else { Wei(0) };
        Ok(self.end(id, outcome, charge))
    }

    fn withdraw(&mut self, operator: Account) -> Result<Event, Refusal> {
        let amount = self.balance(operator);
        require(amount != Wei(0), Refusal::NothingToWithdraw)?;
        self.balances.remove(&operator);
        Ok(Event::Withdrawn { operator, amount })
    }

    /// The deposit becomes the parties' balances.
    fn end(&mut self, id: ServiceId, outcome: Outcome, charge: Wei) -> Event {
        let service = self.services.get_mut(&id).expect("the caller has looked at it");
        let (creator, deposit, winner) = (service.creator, service.deposit(), service.stage.winner());
        service.stage = Stage::Ended { winner };
        let provider = winner.map(|winner| winner.provider).unwrap_or_default();
        for (operator, wei) in [(provider, charge.0), (creator, deposit.0 - charge.0)] {
            if wei != 0 {
                self.balances.entry(operator).or_default().0 += wei;
            }
        }
        Event::ServiceEnded { id, provider, outcome, charge }
    }

    fn require_registered(&self, operator: Account) -> Result<(), Refusal> {
        require(self.names.contains_key(&operator), Refusal::NotRegistered)
    }

    fn service(&mut self, id: ServiceId) -> Result<&mut Service, Refusal> {
        self.services.get_mut(&id).ok_or(Refusal::WrongState(State::None))
    }

    /// A service that takes bids and the choice now.
    fn open(&mut self, now: ChainTime, id: ServiceId) -> Result<&mut Service, Refusal> {
        let service = self.service(id)?;
        let Stage::Open { deadline } = service.stage else {
            return Err(Refusal::WrongState(service.stage.state()));
        };
        require(now <= deadline, Refusal::TooLate(deadline))?;
        Ok(service)
    }
}

impl Service {
    /// What the contract holds for it now.
    fn deposit(&self) -> Wei {
        match self.stage {
            Stage::Open { .. } | Stage::Ended { .. } => Wei(0),
            Stage::Closed { winner, .. } | Stage::Deployed { winner, .. } | Stage::InUse { winner, .. } => {
                winner.price.times(self.terms.use_for)
            }
        }
    }
}

fn require(holds: bool, otherwise: Refusal) -> Result<(), Refusal> {
    if holds { Ok(()) } else { Err(otherwise) }
}

fn require_unaccepted(stage: &Stage) -> Result<(), Refusal> {
    match stage {
        Stage::Open { .. } | Stage::Closed { .. } | Stage::Deployed { .. } => Ok(()),
        Stage::InUse { .. } | Stage::Ended { .. } => Err(Refusal::WrongState(stage.state())),
    }
}

fn is_name(name: &str) -> bool {
    (1..=MAX_NAME).contains(&name.len())
}

fn is_sealed(message: &[u8]) -> bool {
    (1..=MAX_SEALED).contains(&message.len())
}
