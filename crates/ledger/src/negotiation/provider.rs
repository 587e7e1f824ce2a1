//! The provider's role: bid, deploy if chosen, confirm, take down at the end.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::Timestamp;

use super::{Calls, Phase, ServiceLog};
use crate::{
    ledger::{Ledger, Notice},
    message::{Call, Event, Outcome, Terms},
    seal::{Attachment, Bid, SealError, Secret},
    values::{Account, ChainTime, Commitment, Price, PublicKey, ServiceId, Wei},
};

/// A provider's offer.
#[derive(Debug, Clone)]
pub struct Offer {
    /// Price per second.
    pub price: Price,
    /// Address of its orchestrator.
    pub endpoint: String,
    /// The longest time from the choice to the confirmation on the chain, seconds. It does not bid for services due
    /// earlier, because being late costs the bond.
    pub deploys_within: u32,
    /// The longest time from the confirmation to the creator's acceptance, seconds. A creator that never accepts owes nothing
    /// for it, so it does not bid for services that may be accepted later.
    pub accepted_within: u32,
}

impl Offer {
    /// Returns the price of a service per second; `None` if it is beyond all prices. The whole use pays for the wait for the
    /// acceptance, too, as far as the wait is longer than its free share.
    fn price_of(&self, terms: &Terms) -> Option<Price> {
        let wait = terms.accept_within.saturating_sub(terms.use_for / FREE_WAIT);
        if wait == 0 {
            return Some(self.price);
        }
        let paid = u128::from(terms.use_for) + u128::from(wait);
        Price::new((self.price.get() * paid).div_ceil(terms.use_for.max(1).into()))
    }

    /// Whether no duration of a service is longer than it may be, whoever chose them.
    fn allows(&self, terms: &Terms) -> bool {
        let Terms { open_for, deploy_within, accept_within, use_for, bond: _ } = *terms;
        open_for <= LONGEST_BOUND
            && deploy_within <= LONGEST_DEPLOYMENT
            && accept_within <= self.accepted_within
            && (1..=LONGEST_USE).contains(&use_for)
    }
}

/// A step of the negotiation. A step that the chain retracted is reported again when reached again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProviderStep {
    /// The bid was handed to the ledger.
    Bidding,
    /// The bid is on the chain.
    BidPlaced,
    /// The bid was chosen. Answer by [`Provider::deployed`] or [`Provider::give_back`].
    Won,
    /// Another bid was chosen. This one may still win if that provider fails.
    Lost,
    /// Another provider is chosen instead: take the deployment down.
    Replaced,
    /// The confirmation was handed to the ledger.
    Confirming,
    /// The confirmation is on the chain.
    Deployed,
    /// The creator accepted: use is charged.
    InUse,
    /// The won service has ended: take the deployment down.
    Ended {
        outcome: Outcome,
        /// Payment for the use. It can be withdrawn by [`Call::Withdraw`], together with the bond if the provider was
        /// not late.
        charge: Wei,
    },
    /// The bid was not chosen, and its bond is available to [`Call::Withdraw`].
    Reclaimed,
    /// The requested time has passed without news from the ledger: take the deployment down.
    Overdue,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Goal {
    /// To be chosen, and then to know the deployment.
    Service,
    /// To confirm this deployment.
    Confirm(Attachment),
    /// The end of the service.
    End,
}

/// Longest time for which a bid stands, seconds. A creator may never choose.
const LONGEST_BOUND: u32 = 3600;
/// Longest time to deploy, seconds, for which an isolated winner keeps what it deployed.
const LONGEST_DEPLOYMENT: u32 = 86_400;
/// Longest use, seconds, for which a provider that the ledger leaves in the dark keeps what it deployed.
const LONGEST_USE: u32 = 86_400;
/// Share of the use for which the creator may wait with its acceptance at no extra price: one in so many.
const FREE_WAIT: u32 = 4;

/// Time beyond the chain's deadlines for which a provider waits, by its own clock, for a silent ledger.
const GRACE: Duration = Duration::from_secs(60);

/// One announced service on a provider's side.
#[derive(Debug)]
pub struct Provider {
    account: Account,
    secret: Secret,
    key: PublicKey,
    terms: Terms,
    choose_by: ChainTime,
    bid: Call,
    log: ServiceLog,
    calls: Calls,
    goal: Goal,
    /// Whether [`ProviderStep::Won`] was reported.
    has_won: bool,
    /// Deadline by the provider's own clock, counted from the last step.
    overdue: Option<Timestamp>,
    steps: VecDeque<ProviderStep>,
}

impl Provider {
    /// Bids for an announced service. Returns `None` if the event is no announcement, the announcement is the
    /// operator's own, one of its durations is too long, or it is not worth its bond. That is so if the time to deploy is
    /// too short, or the bond exceeds the earnings of the whole use.
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
        let Some(price) = offer.price_of(terms).filter(|_| offer.allows(terms)) else { return Ok(None) };
        let bond = terms.bond();
        let is_fair = terms.deploy_within >= offer.deploys_within && bond <= price.times(terms.use_for);
        if *creator == account || (bond > Wei(0) && !is_fair) {
            return Ok(None);
        }
        let salt = secret.bid_salt(*id);
        let sealed = secret.seal(*key, *id, account, &Bid::new(price, salt, offer.endpoint))?;
        let commitment = Commitment::to(*id, account, price, salt);
        let mut log = ServiceLog::new(*id);
        log.events.push(announced.clone());
        Ok(Some(Self {
            account,
            secret,
            key: *key,
            terms: *terms,
            choose_by: *deadline,
            bid: Call::Bid { id: *id, commitment, sealed, bond },
            log,
            calls: Calls::default(),
            goal: Goal::Service,
            has_won: false,
            overdue: None,
            steps: VecDeque::new(),
        }))
    }

    /// Returns the ID of the service.
    pub fn id(&self) -> ServiceId {
        self.log.id
    }

    /// Returns the next step that was reached, oldest first.
    pub fn poll_step(&mut self) -> Option<ProviderStep> {
        self.steps.pop_front()
    }

    /// Whether nothing remains to be done: the service ended, another won it, or no bidder was chosen in time; and the
    /// bond is back.
    pub fn is_over(&self) -> bool {
        let is_over = match self.log.phase() {
            Phase::Nothing | Phase::Ended(_) => true,
            Phase::Open { deadline } => deadline < self.log.time,
            phase @ (Phase::Closed { .. } | Phase::Deployed { .. } | Phase::InUse { .. }) => {
                phase.winner() != Some(self.account) && (self.is_decided() || !self.stands())
            }
        };
        is_over && !self.has_bond()
    }

    /// Whether this provider is the winner, as far as known.
    pub fn is_winner(&self) -> bool {
        self.log.phase().winner() == Some(self.account)
    }

    /// Whether the time to choose is over.
    fn is_decided(&self) -> bool {
        matches!(self.log.phase(), Phase::InUse { .. } | Phase::Ended(_)) || self.choose_by < self.log.time
    }

    /// Whether its bid is on the chain and can be chosen.
    fn stands(&self) -> bool {
        let is_spent = |event: &Event| matches!(event, Event::BondReclaimed { provider, .. } if *provider == self.account);
        self.has_bid() && self.log.choice_of(self.account) == 0 && !self.log.events.iter().any(is_spent)
    }

    /// Whether there is a bond to reclaim now or later.
    fn has_bond(&self) -> bool {
        self.terms.bond > 0 && self.stands()
    }

    /// Returns when to call [`Provider::expire`].
    pub fn next_deadline(&self) -> Option<Timestamp> {
        self.overdue
    }

    /// Handles a deadline.
    pub fn expire(&mut self, now: Timestamp) {
        if self.overdue.is_some_and(|at| now >= at) {
            self.overdue = None;
            self.goal = Goal::End;
            self.steps.push_back(ProviderStep::Overdue);
        }
    }

    /// Confirms the deployment, with the data needed to attach.
    pub fn deployed(&mut self, attachment: Attachment) {
        if self.goal == Goal::Service {
            self.goal = Goal::Confirm(attachment);
        }
    }

    /// Gives the service back because it cannot be deployed or is no longer offered. Releases it if it is in use.
    pub fn give_back(&mut self) {
        self.goal = Goal::End;
    }

    /// Handles a notice from the ledger.
    pub fn handle(&mut self, now: Timestamp, notice: &Notice) {
        self.calls.take(notice);
        if let Some(event) = self.log.take(notice) {
            self.on_event(now, event);
        }
    }

    /// Submits the call that leads from the service's state to the goal.
    ///
    /// # Errors
    /// [`SealError`] if the attachment cannot be sealed; the service is then given back.
    pub fn submit(&mut self, now: Timestamp, ledger: &mut dyn Ledger) -> Result<(), SealError> {
        let call = self.next_call().inspect_err(|_| self.goal = Goal::End)?;
        let Some(call) = call else { return Ok(()) };
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

    fn next_call(&self) -> Result<Option<Call>, SealError> {
        if self.is_over() {
            return Ok(None);
        }
        let id = self.id();
        if self.has_bond() && self.is_decided() {
            return Ok(Some(Call::Reclaim { id }));
        }
        if self.log.phase().winner().is_some() && !self.is_winner() {
            return Ok(None);
        }
        Ok(match (self.log.phase(), &self.goal) {
            (Phase::Open { .. }, Goal::Service)
                if !self.has_bid() && self.log.choice_of(self.account) == 0 =>
            {
                Some(self.bid.clone())
            }
            // Late by the chain's clock. Expiring it settles the accounts.
            (
                Phase::Closed { deadline, .. }
                | Phase::Deployed { deadline, .. }
                | Phase::InUse { deadline, .. },
                _,
            ) if deadline < self.log.time => Some(Call::Expire { id }),
            (Phase::Closed { .. }, Goal::Confirm(attachment)) => {
                let sealed = self.secret.seal(self.key, id, self.account, attachment)?;
                Some(Call::Deploy { id, sealed })
            }
            (Phase::Closed { .. } | Phase::Deployed { .. }, Goal::End) => Some(Call::Decline { id }),
            (Phase::InUse { .. }, Goal::End) => Some(Call::Release { id }),
            _ => None,
        })
    }

    fn has_bid(&self) -> bool {
        let is_own =
            |event: &Event| matches!(event, Event::BidPlaced { provider, .. } if *provider == self.account);
        self.log.events.iter().any(is_own)
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
            // Also if the news of its own choice arrives after that of the next.
            Event::ProviderChosen { .. } | Event::ServiceReopened { .. } if self.has_won => {
                self.has_won = false;
                self.overdue = None;
                self.goal = Goal::End;
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
