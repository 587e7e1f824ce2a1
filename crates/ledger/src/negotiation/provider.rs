//! The provider's side: bid, deploy if chosen, confirm, take it down when it is over.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;

use super::{Calls, Heard, Seen};
use crate::{
    ledger::{Ledger, Notice},
    message::{Call, Event, Outcome, Terms},
    seal::{Attachment, Bid, SealError, Secret},
    values::{Account, ChainTime, Commitment, Price, PublicKey, ServiceId, Wei},
};

/// What a provider offers.
#[derive(Debug, Clone)]
pub struct Offer {
    /// What a second costs.
    pub price: Price,
    /// Where its orchestrator is reached.
    pub endpoint: String,
    /// The longest time from the choice to the confirmation on the chain, in seconds. It bids for nothing that is due
    /// earlier: whoever is late loses its bond.
    pub deploys_within: u32,
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
    /// Another was chosen. It may yet win, should that one fail.
    Lost,
    /// Another is chosen in its place: what was deployed is to be taken down.
    Replaced,
    /// The confirmation was handed to the ledger.
    Confirming,
    /// It is on the chain.
    Deployed,
    /// The creator accepted it: use is charged.
    InUse,
    /// The service that it won is over: what was deployed is to be taken down.
    Ended {
        /// How.
        outcome: Outcome,
        /// What the use is paid with. There is that to [`Call::Withdraw`], and the bond if it was not late.
        charge: Wei,
    },
    /// It was not chosen, and has its bond again: there is something to [`Call::Withdraw`].
    Reclaimed,
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

/// No bond is given away for longer, in seconds: a creator may never choose.
const LONGEST_BOUND: u32 = 3600;

/// How much longer than the chain's deadlines a provider waits by its own clock for a ledger that is silent.
const GRACE: Duration = Duration::from_secs(60);

/// One announced service, on a provider's side.
#[derive(Debug)]
pub struct Provider {
    account: Account,
    secret: Secret,
    key: PublicKey,
    terms: Terms,
    choose_by: ChainTime,
    bid: Call,
    heard: Heard,
    calls: Calls,
    want: Want,
    /// Whether it was told that it won.
    has_won: bool,
    /// When it is over by the provider's own clock, from the last step on.
    overdue: Option<Timestamp>,
    steps: VecDeque<ProviderStep>,
}

impl Provider {
    /// Bids for a service that was announced; `None` if the event is another, the announcement is the operator's own, or it
    /// is not worth its bond: there is too little time to deploy, the bond is bound for long, or it is above what all of the
    /// use would earn.
    ///
    /// # Errors
    /// [`SealError`] if the bid cannot be sealed to the announced key.
    pub fn new(
        account: Account,
        secret: Secret,
        announced: &Event,
        offer: Offer,
    ) -> Result<Option<Self>, SealError> {
        let Event::ServiceAnnounced { id, creator, key, terms, deadline, .. } = announced else {
            return Ok(None);
        };
        let bond = terms.bond();
        let is_fair = terms.deploy_within >= offer.deploys_within
            && terms.open_for <= LONGEST_BOUND
            && bond <= offer.price.times(terms.use_for);
        if *creator == account || (bond > Wei(0) && !is_fair) {
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
            choose_by: *deadline,
            bid: Call::Bid { id: *id, commitment, sealed, bond },
            heard,
            calls: Calls::default(),
            want: Want::Service,
            has_won: false,
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

    /// Whether there is nothing more to do: it is over, or another's, or nobody was chosen in time; and its bond is its own
    /// again.
    pub fn is_over(&self) -> bool {
        let is_over = match self.heard.seen() {
            Seen::Nothing | Seen::Ended(_) => true,
            Seen::Open { deadline } => deadline < self.heard.time,
            seen @ (Seen::Closed { .. } | Seen::Deployed { .. } | Seen::InUse { .. }) => {
                seen.winner() != Some(self.account) && (self.is_decided() || !self.stands())
            }
        };
        is_over && !self.has_bond()
    }

    /// Whether it is the winner, as far as is known.
    pub fn is_winner(&self) -> bool {
        self.heard.seen().winner() == Some(self.account)
    }

    /// Whether nobody else can be chosen any more.
    fn is_decided(&self) -> bool {
        matches!(self.heard.seen(), Seen::InUse { .. } | Seen::Ended(_)) || self.choose_by < self.heard.time
    }

    /// Whether its bid is on the chain, and can be chosen.
    fn stands(&self) -> bool {
        let is_spent = |event: &Event| matches!(event, Event::BondReclaimed { provider, .. } if *provider == self.account);
        self.has_bid() && self.heard.choice_of(self.account) == 0 && !self.heard.events.iter().any(is_spent)
    }

    /// Whether there is a bond to take back, sooner or later.
    fn has_bond(&self) -> bool {
        self.terms.bond > 0 && self.stands()
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
        if self.has_bond() && self.is_decided() {
            return Ok(Some(Call::Reclaim { id }));
        }
        if self.heard.seen().winner().is_some() && !self.is_winner() {
            return Ok(None);
        }
        Ok(match (self.heard.seen(), &self.want) {
            (Seen::Open { .. }, Want::Service)
                if !self.has_bid() && self.heard.choice_of(self.account) == 0 =>
            {
                Some(self.bid.clone())
            }
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
            Event::ProviderChosen { provider, .. } if *provider == self.account && self.is_winner() => {
                self.has_won = true;
                self.overdue = within(self.terms.deploy_within);
                self.steps.push_back(ProviderStep::Won);
            }
            Event::ProviderChosen { .. } | Event::ServiceReopened { .. } if self.is_winner() => {}
            // Also when the news of its own choice comes behind the news of the next.
            Event::ProviderChosen { .. } | Event::ServiceReopened { .. } if self.has_won => {
                self.has_won = false;
                self.overdue = None;
                self.want = Want::Over;
                self.steps.push_back(ProviderStep::Replaced);
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
            Event::BondReclaimed { provider, .. } if *provider == self.account => {
                self.steps.push_back(ProviderStep::Reclaimed);
            }
            Event::ServiceEnded { outcome, charge, .. } if std::mem::take(&mut self.has_won) => {
                self.overdue = None;
                self.steps.push_back(ProviderStep::Ended { outcome: *outcome, charge: *charge });
            }
            _ => {}
        }
    }
}
