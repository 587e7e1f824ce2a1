//! The creator's side: announce, collect bids, choose, attach once it is deployed, accept, release.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;

use super::{Calls, Heard, Record, Seen, Standing};
use crate::{
    ledger::{Ledger, Notice},
    message::{Call, Event, Outcome, Requirements, Terms},
    seal::{Attachment, Bid, Secret},
    values::{Account, Commitment, Price, PublicKey, Salt, ServiceId},
};

/// What is asked for.
#[derive(Debug, Clone)]
pub struct Request {
    /// What is needed.
    pub requirements: Requirements,
    /// How long each step may take on the chain.
    pub terms: Terms,
    /// How a bid is chosen, and how long all of it may take.
    pub policy: Policy,
    /// What is remembered of those who may bid.
    pub record: Record,
}

/// How a bid is chosen: the cheapest that is not too dear, of those who served before; else of those who never failed; else
/// of the others. When its provider fails, the next one is chosen in the same way.
#[derive(Debug, Clone, Copy)]
pub struct Policy {
    /// More is not paid.
    pub highest: Price,
    /// Whoever bids while this has not passed since the announcement was heard is considered.
    pub collect: Duration,
    /// With so many bids that can be chosen, of providers that never failed, there is no more waiting.
    pub enough: usize,
    /// So long after the start the attachment must be known; otherwise the negotiation is given up.
    pub patience: Duration,
}

/// A step that was reached. One that the chain took back is told again when it is reached again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CreatorStep {
    /// The announcement was handed to the ledger.
    Announcing,
    /// It is on the chain.
    Announced,
    /// There is a bid that can be chosen.
    BidReceived {
        /// Whose.
        provider: Account,
        /// For how much.
        price: Price,
        /// Where the provider is reached.
        endpoint: String,
    },
    /// There is a bid that cannot be chosen.
    BidRejected {
        /// Whose.
        provider: Account,
        /// Why not.
        reason: String,
    },
    /// The choice was made, and handed to the ledger.
    Choosing {
        /// Whose bid.
        provider: Account,
        /// For how much.
        price: Price,
    },
    /// It is on the chain.
    Chosen,
    /// The winner says that it deployed, and this is how to attach. Answer by [`Creator::attached`] or
    /// [`Creator::unusable`].
    Deployed(Attachment),
    /// The acceptance is on the chain: use is charged.
    InUse,
    /// The service is over.
    Ended(Outcome),
    /// It came to nothing. What is on the chain is being ended.
    Failed(Failure),
}

/// Why a negotiation came to nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// Nobody bid.
    #[error("nobody bid")]
    NoBid,
    /// There were bids, none of which can be chosen.
    #[error("no bid could be chosen: all were too dear, or could not be opened")]
    NoGoodBid,
    /// The winner did not deploy, or gave the service back; of several, the last.
    #[error("the chosen provider did not deploy")]
    NotDeployed,
    /// What the winner said cannot be opened, or nobody could attach.
    #[error("the provider said that it deployed, but its access point cannot be used")]
    Unusable,
    /// The ledger did not take part in time.
    #[error("the ledger did not answer in time, or refused what was asked")]
    Ledger,
    /// The caller no longer wanted it.
    #[error("it was cancelled")]
    Cancelled,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Want {
    /// A provider, and to attach.
    Service,
    /// To use what it attached to.
    Use,
    /// That it be over.
    Over,
}

/// A bid that can be chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Good {
    provider: Account,
    price: Price,
    salt: Salt,
}

/// One service, from its announcement to its end, on its creator's side.
#[derive(Debug)]
pub struct Creator {
    secret: Secret,
    salt: Salt,
    key: PublicKey,
    pub(super) request: Request,
    started: Timestamp,
    /// When the announcement was heard first.
    announced: Option<Timestamp>,
    /// The ledger is away, or was and has not told yet what happened meanwhile: bids may be there that were not heard.
    is_behind: bool,
    pub(super) heard: Heard,
    calls: Calls,
    want: Want,
    bids: Vec<Good>,
    choice: Option<Good>,
    steps: VecDeque<CreatorStep>,
}

impl Creator {
    /// Asks for a service, as `account`'s announcement with a salt that [`Secret::announcement_salt`] made. To resume
    /// after a restart, it is given the same salt, and then all that the chain said of the service.
    pub fn new(now: Timestamp, account: Account, secret: Secret, salt: Salt, request: Request) -> Self {
        Self {
            key: secret.public_key(salt),
            heard: Heard::new(ServiceId::of(secret.deployment(), account, salt)),
            secret,
            salt,
            request,
            started: now,
            announced: None,
            is_behind: false,
            calls: Calls::default(),
            want: Want::Service,
            bids: Vec::new(),
            choice: None,
            steps: VecDeque::new(),
        }
    }

    /// The service.
    pub fn id(&self) -> ServiceId {
        self.heard.id
    }

    /// A step that was reached, oldest first.
    pub fn poll_step(&mut self) -> Option<CreatorStep> {
        self.steps.pop_front()
    }

    /// Whether there is nothing more to do: it is over on the chain, or will never be there.
    pub fn is_over(&self) -> bool {
        match self.heard.seen() {
            Seen::Ended(_) => true,
            Seen::Nothing => self.want == Want::Over && self.calls.in_flight.is_empty(),
            _ => false,
        }
    }

    /// When [`Creator::expire`] wants to be called.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        if self.want != Want::Service {
            return None;
        }
        let patience = self.started + self.request.policy.patience;
        Some(self.choice_due().map_or(patience, |due| due.min(patience)))
    }

    /// The deadline has come.
    pub fn expire(&mut self, now: Timestamp) {
        if self.want != Want::Service {
            return;
        }
        if self.choice_due().is_some_and(|due| now >= due) {
            self.choose();
        }
        if now >= self.started + self.request.policy.patience {
            let failure = match self.heard.seen() {
                Seen::Closed { .. } => Failure::NotDeployed,
                Seen::Deployed { .. } => Failure::Unusable,
                _ => Failure::Ledger,
            };
            self.fail(failure);
        }
    }

    /// The robot attached: the service is accepted.
    pub fn attached(&mut self) {
        if self.want == Want::Service {
            self.want = Want::Use;
        }
    }

    /// The robot could not attach: the service is not accepted, nothing is paid, and the next bid is chosen if there is one.
    pub fn unusable(&mut self) {
        self.next_best(Failure::Unusable);
    }

    /// The service is no longer needed: it is cancelled, or, once it was accepted, released and paid.
    pub fn release(&mut self) {
        self.fail(Failure::Cancelled);
        self.want = Want::Over;
    }

    /// The ledger said something.
    pub fn handle(&mut self, now: Timestamp, notice: &Notice) {
        self.calls.take(notice);
        match notice {
            Notice::Down(_) => self.is_behind = true,
            Notice::Head { .. } => self.is_behind = false,
            _ => {}
        }
        if let Some(event) = self.heard.take(notice) {
            self.on_event(now, event);
        }
        if let Notice::Retracted(Event::BidPlaced { id, provider, .. }) = notice
            && *id == self.id()
        {
            self.bids.retain(|bid| bid.provider != *provider);
        }
        // What the contract no longer allows is not waited for.
        let late = match self.heard.seen() {
            Seen::Open { deadline } => (deadline < self.heard.time).then_some(Failure::Ledger),
            // The next block is behind it.
            Seen::Closed { deadline, .. } => (deadline <= self.heard.time).then_some(Failure::NotDeployed),
            Seen::Deployed { deadline, .. } => (deadline < self.heard.time).then_some(Failure::Unusable),
            Seen::InUse { deadline, .. } if deadline < self.heard.time => {
                self.want = Want::Over;
                None
            }
            _ => None,
        };
        if let Some(failure) = late {
            match (self.want, self.heard.seen().winner()) {
                (Want::Service, Some(winner)) => {
                    if self.choice.is_none_or(|choice| choice.provider == winner) {
                        self.next_best(failure);
                    }
                }
                _ => {
                    self.fail(failure);
                    self.want = Want::Over;
                }
            }
        }
    }

    /// Submits the call that leads from where the service stands to what is wanted.
    pub fn submit(&mut self, now: Timestamp, ledger: &mut dyn Ledger) {
        let Some(call) = self.wanted() else { return };
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

    fn wanted(&self) -> Option<Call> {
        let id = self.id();
        let choose = |Good { provider, price, salt }| {
            let deposit = price.times(self.request.terms.use_for);
            Call::Choose { id, provider, price, salt, deposit }
        };
        match (self.heard.seen(), self.want) {
            // Also after the chain took back what it had said of a service that is used already.
            (Seen::Nothing, Want::Service | Want::Use) => Some(Call::Announce {
                salt: self.salt,
                key: self.key,
                requirements: self.request.requirements.clone(),
                terms: self.request.terms,
            }),
            (Seen::Open { .. }, Want::Service | Want::Use) => self.choice.map(choose),
            // The winner has failed, and another is to be chosen in its place.
            (Seen::Closed { provider, .. } | Seen::Deployed { provider, .. }, Want::Service)
                if self.choice.is_some_and(|choice| choice.provider != provider) =>
            {
                self.choice.map(choose)
            }
            (Seen::Deployed { .. }, Want::Use) => Some(Call::Accept { id }),
            (Seen::Open { .. } | Seen::Closed { .. } | Seen::Deployed { .. }, Want::Over) => {
                Some(Call::Cancel { id })
            }
            (Seen::InUse { .. }, Want::Over) => Some(Call::Release { id }),
            (Seen::Closed { .. }, Want::Service | Want::Use)
            | (Seen::Deployed { .. }, Want::Service)
            | (Seen::InUse { .. }, Want::Service | Want::Use)
            | (Seen::Nothing, Want::Over)
            | (Seen::Ended(_), _) => None,
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
                if self.want == Want::Service && self.is_current(*provider) =>
            {
                match self.secret.open(self.salt, self.id(), *provider, sealed) {
                    Ok(attachment) => self.steps.push_back(CreatorStep::Deployed(attachment)),
                    Err(_) => self.next_best(Failure::Unusable),
                }
            }
            Event::ServiceAccepted { .. } => {
                // Also after a restart, which does not know that the robot attached.
                if self.want == Want::Service {
                    self.want = Want::Use;
                }
                self.steps.push_back(CreatorStep::InUse);
            }
            Event::ServiceReopened { provider, .. } if self.is_current(*provider) => {
                self.next_best(Failure::NotDeployed);
            }
            Event::ServiceEnded { outcome, .. } => {
                if self.want == Want::Service {
                    self.fail(Failure::NotDeployed);
                }
                self.want = Want::Over;
                self.steps.push_back(CreatorStep::Ended(*outcome));
            }
            _ => {}
        }
    }

    fn on_bid(&mut self, provider: Account, commitment: Commitment, sealed: &[u8]) {
        match self.judge(provider, commitment, sealed) {
            Ok((bid, endpoint)) => {
                self.bids.push(bid);
                let Good { provider, price, .. } = bid;
                self.steps.push_back(CreatorStep::BidReceived { provider, price, endpoint });
                let record = &self.request.record;
                let sound = self.bids.iter().filter(|bid| record.standing(bid.provider) != Standing::Failed);
                if sound.count() >= self.request.policy.enough && self.want == Want::Service {
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
    ) -> Result<(Good, String), String> {
        let bid: Bid =
            self.secret.open(self.salt, self.id(), provider, sealed).map_err(|reason| reason.to_string())?;
        let price = bid.price().ok_or("no price is so high")?;
        if price.get() == 0 {
            return Err("its price is zero".to_owned());
        }
        if price > self.request.policy.highest {
            return Err(format!("{price} are more than {}", self.request.policy.highest));
        }
        // The contract would refuse the choice.
        if commitment != Commitment::to(self.id(), provider, price, bid.salt()) {
            return Err("it commits to another price than it names".to_owned());
        }
        Ok((Good { provider, price, salt: bid.salt() }, bid.endpoint))
    }

    /// When the choice is to be made, if it is to be made.
    fn choice_due(&self) -> Option<Timestamp> {
        let since = self.announced.filter(|_| self.choice.is_none() && !self.is_behind)?;
        matches!(self.heard.seen(), Seen::Open { .. }).then(|| since + self.request.policy.collect)
    }

    /// Whether a provider is the one that was chosen last, as far as that is known.
    fn is_current(&self, provider: Account) -> bool {
        self.choice.is_none_or(|choice| choice.provider == provider)
    }

    /// The winner has failed: the next bid is chosen, and the negotiation has failed if there is none.
    fn next_best(&mut self, failure: Failure) {
        if self.want != Want::Service {
            return;
        }
        match self.best() {
            Some(bid) => self.choice = Some(bid),
            None => self.fail(failure),
        }
    }

    /// The best bid that was not chosen yet; of equals, the one that came first.
    fn best(&self) -> Option<Good> {
        let is_new = |bid: &&Good| {
            self.heard.choice_of(bid.provider) == 0
                && self.choice.is_none_or(|choice| choice.provider != bid.provider)
        };
        let by = |bid: &&Good| (self.request.record.standing(bid.provider), bid.price);
        self.bids.iter().filter(is_new).min_by_key(by).copied()
    }

    fn choose(&mut self) {
        if self.choice.is_some() {
            return;
        }
        self.choice = self.best();
        if self.choice.is_none() {
            let bids =
                self.heard.events.iter().filter(|event| matches!(event, Event::BidPlaced { .. })).count();
            self.fail(if bids == 0 { Failure::NoBid } else { Failure::NoGoodBid });
        }
    }

    fn fail(&mut self, failure: Failure) {
        if self.want == Want::Service {
            self.want = Want::Over;
            self.steps.push_back(CreatorStep::Failed(failure));
        }
    }
}
