//! The creator's role: announce, collect bids, choose, attach after the deployment, accept, release.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;

use super::{Calls, Phase, Record, ServiceLog, Standing};
use crate::{
    ledger::{Ledger, Notice},
    message::{Call, Event, Outcome, Requirements, Terms},
    seal::{Attachment, Bid, Secret},
    values::{Account, Commitment, Price, PublicKey, Salt, ServiceId},
};

/// A request for a service.
#[derive(Debug, Clone)]
pub struct Request {
    pub requirements: Requirements,
    /// Longest duration of each step on the chain.
    pub terms: Terms,
    /// Choice of a bid, and patience.
    pub policy: Policy,
    /// Record of those who may bid.
    pub record: Record,
}

/// Rules for choosing a bid. Among affordable bids, those of providers that served before come first, then those of
/// unknown ones, then those of providers that failed. Within a group the cheapest wins. If its provider fails, the
/// next one is chosen by the same rules.
#[derive(Debug, Clone, Copy)]
pub struct Policy {
    /// Highest acceptable price.
    pub highest: Price,
    /// Duration from the announcement during which bids are collected.
    pub collect: Duration,
    /// Number of eligible bids, of providers that never failed, that ends the collection early.
    pub enough: usize,
    /// Time from the start after which the negotiation is given up without an attachment.
    pub patience: Duration,
}

/// A step of the negotiation. A step that the chain retracted is reported again when reached again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CreatorStep {
    /// The announcement was handed to the ledger.
    Announcing,
    /// The announcement is on the chain.
    Announced,
    /// An eligible bid arrived.
    BidReceived {
        provider: Account,
        price: Price,
        /// Address of the provider's orchestrator.
        endpoint: String,
    },
    /// An ineligible bid arrived.
    BidRejected { provider: Account, reason: String },
    /// The choice was made and handed to the ledger.
    Choosing { provider: Account, price: Price },
    /// The choice is on the chain.
    Chosen,
    /// The winner confirmed the deployment, with the data needed to attach. Answer by [`Creator::attached`] or
    /// [`Creator::unusable`].
    Deployed(Attachment),
    /// The acceptance is on the chain: use is charged.
    InUse,
    /// The service has ended.
    Ended(Outcome),
    /// The negotiation failed. The service on the chain is being ended.
    Failed(Failure),
}

/// Reason for which a negotiation failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// There were no bids.
    #[error("nobody bid")]
    NoBid,
    /// No bid was eligible.
    #[error("no bid could be chosen: all were too dear, or could not be opened")]
    NoGoodBid,
    /// The winner did not deploy or declined; of several winners, the last.
    #[error("the chosen provider did not deploy")]
    NotDeployed,
    /// The attachment cannot be opened, or the robot could not attach.
    #[error("the provider said that it deployed, but its access point cannot be used")]
    Unusable,
    /// The ledger did not answer in time.
    #[error("the ledger did not answer in time, or refused what was asked")]
    Ledger,
    /// The caller cancelled it.
    #[error("it was cancelled")]
    Cancelled,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Goal {
    /// A provider, and its attachment.
    Service,
    /// Use of the attached service.
    Use,
    /// The end of the service.
    End,
}

/// An eligible bid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct EligibleBid {
    provider: Account,
    price: Price,
    salt: Salt,
}

/// One service on its creator's side, from its announcement to its end.
#[derive(Debug)]
pub struct Creator {
    secret: Secret,
    salt: Salt,
    key: PublicKey,
    pub(super) request: Request,
    started: Timestamp,
    /// Time when the announcement was first received.
    announced: Option<Timestamp>,
    /// Whether the ledger is away, or has not yet reported what happened meanwhile. There may be unknown bids.
    is_behind: bool,
    pub(super) log: ServiceLog,
    calls: Calls,
    goal: Goal,
    bids: Vec<EligibleBid>,
    choice: Option<EligibleBid>,
    steps: VecDeque<CreatorStep>,
}

impl Creator {
    /// Requests a service, as `account`'s announcement with a salt from [`Secret::announcement_salt`]. To resume
    /// after a restart, pass the same salt, and then all events of the service.
    pub fn new(now: Timestamp, account: Account, secret: Secret, salt: Salt, request: Request) -> Self {
        Self {
            key: secret.public_key(salt),
            log: ServiceLog::new(ServiceId::of(secret.deployment(), account, salt)),
            secret,
            salt,
            request,
            started: now,
            announced: None,
            is_behind: false,
            calls: Calls::default(),
            goal: Goal::Service,
            bids: Vec::new(),
            choice: None,
            steps: VecDeque::new(),
        }
    }

    /// Returns the ID of the service.
    pub fn id(&self) -> ServiceId {
        self.log.id
    }

    /// Returns the next step that was reached, oldest first.
    pub fn poll_step(&mut self) -> Option<CreatorStep> {
        self.steps.pop_front()
    }

    /// Whether nothing remains to be done: the service ended on the chain, or will never be there.
    pub fn is_over(&self) -> bool {
        match self.log.phase() {
            Phase::Ended(_) => true,
            Phase::Nothing => self.goal == Goal::End && self.calls.in_flight.is_empty(),
            _ => false,
        }
    }

    /// Returns when to call [`Creator::expire`].
    pub fn next_deadline(&self) -> Option<Timestamp> {
        if self.goal != Goal::Service {
            return None;
        }
        let patience = self.started + self.request.policy.patience;
        Some(self.choice_due().map_or(patience, |due| due.min(patience)))
    }

    /// Handles a deadline.
    pub fn expire(&mut self, now: Timestamp) {
        if self.goal != Goal::Service {
            return;
        }
        if self.choice_due().is_some_and(|due| now >= due) {
            self.choose();
        }
        if now >= self.started + self.request.policy.patience {
            let failure = match self.log.phase() {
                Phase::Closed { .. } => Failure::NotDeployed,
                Phase::Deployed { .. } => Failure::Unusable,
                _ => Failure::Ledger,
            };
            self.fail(failure);
        }
    }

    /// Records that the robot attached. The service is accepted.
    pub fn attached(&mut self) {
        if self.goal == Goal::Service {
            self.goal = Goal::Use;
        }
    }

    /// Records that the robot could not attach. The service is not accepted, nothing is paid, and the next bid is
    /// chosen if there is one.
    pub fn unusable(&mut self) {
        self.next_best(Failure::Unusable);
    }

    /// Ends the service when it is no longer needed: cancels it, or releases and pays it if it was accepted.
    pub fn release(&mut self) {
        self.fail(Failure::Cancelled);
        self.goal = Goal::End;
    }

    /// Handles a notice from the ledger.
    pub fn handle(&mut self, now: Timestamp, notice: &Notice) {
        self.calls.take(notice);
        match notice {
            Notice::Down(_) => self.is_behind = true,
            Notice::Head { .. } => self.is_behind = false,
            _ => {}
        }
        if let Some(event) = self.log.take(notice) {
            self.on_event(now, event);
        }
        if let Notice::Retracted(Event::BidPlaced { id, provider, .. }) = notice
            && *id == self.id()
        {
            self.bids.retain(|bid| bid.provider != *provider);
        }
        // Do not wait for what the contract no longer allows.
        let late = match self.log.phase() {
            Phase::Open { deadline } => (deadline < self.log.time).then_some(Failure::Ledger),
            // The next block is past the deadline.
            Phase::Closed { deadline, .. } => (deadline <= self.log.time).then_some(Failure::NotDeployed),
            Phase::Deployed { deadline, .. } => (deadline < self.log.time).then_some(Failure::Unusable),
            Phase::InUse { deadline, .. } if deadline < self.log.time => {
                self.goal = Goal::End;
                None
            }
            _ => None,
        };
        if let Some(failure) = late {
            match (self.goal, self.log.phase().winner()) {
                (Goal::Service, Some(winner)) => {
                    if self.choice.is_none_or(|choice| choice.provider == winner) {
                        self.next_best(failure);
                    }
                }
                _ => {
                    self.fail(failure);
                    self.goal = Goal::End;
                }
            }
        }
    }

    /// Submits the call that leads from the service's state to the goal.
    pub fn submit(&mut self, now: Timestamp, ledger: &mut dyn Ledger) {
        let Some(call) = self.next_call() else { return };
        let step = match &call {
            Call::Announce { .. } => Some(CreatorStep::Announcing),
            Call::Choose { provider, price, .. } => {
                Some(CreatorStep::Choosing { provider: *provider, price: *price })
            }
            _ => None,
        };
        if self.calls.submit(now, ledger, call) {
            self.steps.extend(step);
        }
    }

    fn next_call(&self) -> Option<Call> {
        let id = self.id();
        let choose = |EligibleBid { provider, price, salt }| {
            let deposit = price.times(self.request.terms.use_for);
            Call::Choose { id, provider, price, salt, deposit }
        };
        match (self.log.phase(), self.goal) {
            // Also after the chain retracted the events of a service in use.
            (Phase::Nothing, Goal::Service | Goal::Use) => Some(Call::Announce {
                salt: self.salt,
                key: self.key,
                requirements: self.request.requirements.clone(),
                terms: self.request.terms,
            }),
            (Phase::Open { .. }, Goal::Service | Goal::Use) => self.choice.map(choose),
            // The winner has failed, and another must be chosen.
            (Phase::Closed { provider, .. } | Phase::Deployed { provider, .. }, Goal::Service)
                if self.choice.is_some_and(|choice| choice.provider != provider) =>
            {
                self.choice.map(choose)
            }
            (Phase::Deployed { .. }, Goal::Use) => Some(Call::Accept { id }),
            (Phase::Open { .. } | Phase::Closed { .. } | Phase::Deployed { .. }, Goal::End) => {
                Some(Call::Cancel { id })
            }
            (Phase::InUse { .. }, Goal::End) => Some(Call::Release { id }),
            (Phase::Closed { .. }, Goal::Service | Goal::Use)
            | (Phase::Deployed { .. }, Goal::Service)
            | (Phase::InUse { .. }, Goal::Service | Goal::Use)
            | (Phase::Nothing, Goal::End)
            | (Phase::Ended(_), _) => None,
        }
    }

    fn on_event(&mut self, now: Timestamp, event: &Event) {
        match event {
            Event::ServiceAnnounced { .. } => {
                self.announced.get_or_insert(now);
                self.steps.push_back(CreatorStep::Announced);
            }
            Event::BidPlaced { provider, commitment, sealed, .. } => {
                self.on_bid(*provider, *commitment, sealed)
            }
            Event::ProviderChosen { .. } => self.steps.push_back(CreatorStep::Chosen),
            Event::ServiceDeployed { provider, sealed, .. }
                if self.goal == Goal::Service && self.is_current(*provider) =>
            {
                match self.secret.open(self.salt, self.id(), *provider, sealed) {
                    Ok(attachment) => self.steps.push_back(CreatorStep::Deployed(attachment)),
                    Err(_) => self.next_best(Failure::Unusable),
                }
            }
            Event::ServiceAccepted { .. } => {
                // Also after a restart, which does not know that the robot attached.
                if self.goal == Goal::Service {
                    self.goal = Goal::Use;
                }
                self.steps.push_back(CreatorStep::InUse);
            }
            Event::ServiceReopened { provider, .. } if self.is_current(*provider) => {
                self.next_best(Failure::NotDeployed);
            }
            Event::ServiceEnded { outcome, .. } => {
                if self.goal == Goal::Service {
                    self.fail(Failure::NotDeployed);
                }
                self.goal = Goal::End;
                self.steps.push_back(CreatorStep::Ended(*outcome));
            }
            _ => {}
        }
    }

    fn on_bid(&mut self, provider: Account, commitment: Commitment, sealed: &[u8]) {
        match self.judge(provider, commitment, sealed) {
            Ok((bid, endpoint)) => {
                self.bids.push(bid);
                let EligibleBid { provider, price, .. } = bid;
                self.steps.push_back(CreatorStep::BidReceived { provider, price, endpoint });
                let record = &self.request.record;
                let sound = self.bids.iter().filter(|bid| record.standing(bid.provider) != Standing::Failed);
                if sound.count() >= self.request.policy.enough && self.goal == Goal::Service {
                    self.choose();
                }
            }
            Err(reason) => self.steps.push_back(CreatorStep::BidRejected { provider, reason }),
        }
    }

    fn judge(
        &self,
        provider: Account,
        commitment: Commitment,
        sealed: &[u8],
    ) -> Result<(EligibleBid, String), String> {
        let bid: Bid =
            self.secret.open(self.salt, self.id(), provider, sealed).map_err(|reason| reason.to_string())?;
        let price = bid.price().ok_or("no price is so high")?;
        if price.get() == 0 {
            return Err("its price is zero".to_owned());
        }
        if price > self.request.policy.highest {
            return Err(format!("{price} are more than {}", self.request.policy.highest));
        }
        // The contract would reject the choice.
        if commitment != Commitment::to(self.id(), provider, price, bid.salt()) {
            return Err("it commits to another price than it names".to_owned());
        }
        Ok((EligibleBid { provider, price, salt: bid.salt() }, bid.endpoint))
    }

    /// Returns when the choice is due, if it is still to be made.
    fn choice_due(&self) -> Option<Timestamp> {
        let since = self.announced.filter(|_| self.choice.is_none() && !self.is_behind)?;
        matches!(self.log.phase(), Phase::Open { .. }).then(|| since + self.request.policy.collect)
    }

    /// Whether a provider is the last chosen one, as far as known.
    fn is_current(&self, provider: Account) -> bool {
        self.choice.is_none_or(|choice| choice.provider == provider)
    }

    /// Chooses the next bid after the winner failed. Fails if there is none.
    fn next_best(&mut self, failure: Failure) {
        if self.goal != Goal::Service {
            return;
        }
        match self.best() {
            Some(bid) => self.choice = Some(bid),
            None => self.fail(failure),
        }
    }

    /// Returns the best bid that was not chosen yet; of equal ones, the first.
    fn best(&self) -> Option<EligibleBid> {
        let is_new = |bid: &&EligibleBid| {
            self.log.choice_of(bid.provider) == 0
                && self.choice.is_none_or(|choice| choice.provider != bid.provider)
        };
        let by = |bid: &&EligibleBid| (self.request.record.standing(bid.provider), bid.price);
        self.bids.iter().filter(is_new).min_by_key(by).copied()
    }

    fn choose(&mut self) {
        if self.choice.is_some() {
            return;
        }
        self.choice = self.best();
        if self.choice.is_none() {
            let bids =
                self.log.events.iter().filter(|event| matches!(event, Event::BidPlaced { .. })).count();
            self.fail(if bids == 0 { Failure::NoBid } else { Failure::NoGoodBid });
        }
    }

    fn fail(&mut self, failure: Failure) {
        if self.goal == Goal::Service {
            self.goal = Goal::End;
            self.steps.push_back(CreatorStep::Failed(failure));
        }
    }
}
