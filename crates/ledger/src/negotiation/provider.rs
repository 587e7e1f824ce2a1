//! The provider's side: bid, deploy if chosen, confirm, take it down when it is over.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;

use super::{Calls, Heard, Seen};
use crate::{
    ledger::{Ledger, Notice},
    message::{Call, Event, Outcome, Terms},
    seal::{Attachment, Bid, SealError, Secret},
    values::{Account, Commitment, Price, PublicKey, ServiceId, Wei},
};

/// What a provider offers.
#[derive(Debug, Clone)]
pub struct Offer {
    /// What a second costs.
    pub price: Price,
    /// Where its orchestrator is reached.
    pub endpoint: String,
}

/// A step that was reached. One that the chain took back is told again when it is reached again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProviderStep {
    /// The bid was handed to the ledger.
    Bidding,
    /// It is on the chain.
    BidPlaced,
    /// It was chosen. Answer by [`Provider::deployed`] or [`Provider::give_back`].
    Won,
    /// Another was chosen.
    Lost,
    /// The confirmation was handed to the ledger.
    Confirming,
    /// It is on the chain.
    Deployed,
    /// The creator accepted it: use is charged.
    InUse,
    /// The service is over: what was deployed is to be taken down.
    Ended {
        /// How.
        outcome: Outcome,
        /// What there is to [`Call::Withdraw`].
        charge: Wei,
    },
    /// The time for which it was wanted has passed, and the ledger did not say what became of it: what was deployed is to
    /// be taken down.
    Overdue,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Want {
    /// To be chosen, and then to know what was deployed.
    Service,
    /// To confirm this.
    Confirm(Attachment),
    /// That it be over.
    Over,
}

/// How much longer than the chain's deadlines a provider waits by its own clock for a ledger that is silent.
const GRACE: Duration = Duration::from_secs(60);

/// One announced service, on a provider's side.
#[derive(Debug)]
pub struct Provider {
    account: Account,
    secret: Secret,
    key: PublicKey,
    terms: Terms,
    bid: Call,
    heard: Heard,
    calls: Calls,
    want: Want,
    /// When it is over by the provider's own clock, from the last step on.
    overdue: Option<Timestamp>,
    steps: VecDeque<ProviderStep>,
}

impl Provider {
    /// Bids for a service that was announced; `None` if the event is another, or the announcement the operator's own.
    ///
    /// # Errors
    /// [`SealError`] if the bid cannot be sealed to the announced key.
    pub fn new(
        account: Account,
        secret: Secret,
        announced: &Event,
        offer: Offer,
    ) -> Result<Option<Self>, SealError> {
        let Event::ServiceAnnounced { id, creator, key, terms, .. } = announced else { return Ok(None) };
        if *creator == account {
            return Ok(None);
        }
        let salt = secret.bid_salt(*id);
        let sealed = secret.seal(*key, *id, account, &Bid::new(offer.price, salt, offer.endpoint))?;
        let commitment = Commitment::to(*id, account, offer.price, salt);
        let mut heard = Heard::new(*id);
        heard.events.push(announced.clone());
        Ok(Some(Self {
            account,
            secret,
            key: *key,
            terms: *terms,
            bid: Call::Bid { id: *id, commitment, sealed },
            heard,
            calls: Calls::default(),
            want: Want::Service,
            overdue: None,
            steps: VecDeque::new(),
        }))
    }

    /// The service.
    pub fn id(&self) -> ServiceId {
        self.heard.id
    }

    /// A step that was reached, oldest first.
    pub fn poll_step(&mut self) -> Option<ProviderStep> {
        self.steps.pop_front()
    }

    /// Whether there is nothing more to do: it is over, or another's, or nobody was chosen in time.
    pub fn is_over(&self) -> bool {
        match self.heard.seen() {
            Seen::Nothing | Seen::Ended(_) => true,
            Seen::Open { deadline } => deadline < self.heard.time,
            Seen::Closed { provider, .. }
            | Seen::Deployed { provider, .. }
            | Seen::InUse { provider, .. } => provider != self.account,
        }
    }

    /// When [`Provider::expire`] wants to be called.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.overdue
    }

    /// The deadline has come.
    pub fn expire(&mut self, now: Timestamp) {
        if self.overdue.is_some_and(|at| now >= at) {
            self.overdue = None;
            self.want = Want::Over;
            self.steps.push_back(ProviderStep::Overdue);
        }
    }

    /// It runs: that is confirmed, with what is needed to attach.
    pub fn deployed(&mut self, attachment: Attachment) {
        if self.want == Want::Service {
            self.want = Want::Confirm(attachment);
        }
    }

    /// It could not be deployed, or is no longer offered: the service is given back, or released if it is in use.
    pub fn give_back(&mut self) {
        self.want = Want::Over;
    }

    /// The ledger said something.
    pub fn handle(&mut self, now: Timestamp, notice: &Notice) {
        self.calls.take(notice);
        if let Some(event) = self.heard.take(notice) {
            self.on_event(now, event);
        }
    }

    /// Submits the call that leads from where the service stands to what is wanted.
    ///
    /// # Errors
    /// [`SealError`] if what is needed to attach cannot be sealed; the service is given back then.
    pub fn submit(&mut self, now: Timestamp, ledger: &mut dyn Ledger) -> Result<(), SealError> {
        let wanted = self.wanted().inspect_err(|_| self.want = Want::Over)?;
        let Some(call) = wanted else { return Ok(()) };
        let step = match &call {
            Call::Bid { .. } => Some(ProviderStep::Bidding),
            Call::Deploy { .. } => Some(ProviderStep::Confirming),
            _ => None,
        };
        if self.calls.submit(now, ledger, call) {
            self.steps.extend(step);
        }
        Ok(())
    }

    fn wanted(&self) -> Result<Option<Call>, SealError> {
        if self.is_over() {
            return Ok(None);
        }
        let id = self.id();
        Ok(match (self.heard.seen(), &self.want) {
            (Seen::Open { .. }, Want::Service) if !self.has_bid() => Some(self.bid.clone()),
            // Late by the chain's clock: whoever says so ends it, and the books are settled.
            (
                Seen::Closed { deadline, .. }
                | Seen::Deployed { deadline, .. }
                | Seen::InUse { deadline, .. },
                _,
            ) if deadline < self.heard.time => Some(Call::Expire { id }),
            (Seen::Closed { .. }, Want::Confirm(attachment)) => {
                let sealed = self.secret.seal(self.key, id, self.account, attachment)?;
                Some(Call::Deploy { id, sealed })
            }
            (Seen::Closed { .. } | Seen::Deployed { .. }, Want::Over) => Some(Call::Decline { id }),
            (Seen::InUse { .. }, Want::Over) => Some(Call::Release { id }),
            _ => None,
        })
    }

    fn has_bid(&self) -> bool {
        let is_own =
            |event: &Event| matches!(event, Event::BidPlaced { provider, .. } if *provider == self.account);
        self.heard.events.iter().any(is_own)
    }

    fn on_event(&mut self, now: Timestamp, event: &Event) {
        let within = |seconds: u32| Some(now + Duration::from_secs(seconds.into()) + GRACE);
        match event {
            Event::BidPlaced { provider, .. } if *provider == self.account => {
                self.steps.push_back(ProviderStep::BidPlaced);
            }
            Event::ProviderChosen { provider, .. } if *provider == self.account => {
                self.overdue = within(self.terms.deploy_within);
                self.steps.push_back(ProviderStep::Won);
            }
            Event::ProviderChosen { .. } => self.steps.push_back(ProviderStep::Lost),
            Event::ServiceDeployed { provider, .. } if *provider == self.account => {
                self.overdue = within(self.terms.accept_within);
                self.steps.push_back(ProviderStep::Deployed);
            }
            Event::ServiceAccepted { provider, .. } if *provider == self.account => {
                self.overdue = within(self.terms.use_for);
                self.steps.push_back(ProviderStep::InUse);
            }
            Event::ServiceEnded { outcome, charge, .. } => {
                self.overdue = None;
                self.steps.push_back(ProviderStep::Ended { outcome: *outcome, charge: *charge });
            }
            _ => {}
        }
    }
}
