//! An operator's record of how others served it, derived from the chain's events of its own services. It therefore
//! survives restarts, and only its owner can write to it.

use std::collections::VecDeque;

use super::ServiceLog;
use crate::{
    ledger::Notice,
    message::{Event, Outcome},
    values::Account,
};

/// Number of services remembered, the last ones. Others cannot fill the record, because only the operator announces
/// in its name.
const SERVICES: usize = 1000;

/// A provider's standing with an operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Standing {
    /// It served and never failed. Its bids come first; only serving leads here.
    Proven,
    /// It was never chosen, or is not to blame for the outcome.
    Unknown,
    /// It won and did not deploy, or its deployment could not be used. Its bids come last.
    Failed,
}

/// An operator's record of others.
#[derive(Debug, Clone)]
pub struct Record {
    account: Account,
    /// Its own services, oldest first.
    services: VecDeque<ServiceLog>,
}

impl Record {
    /// Makes an empty record.
    pub fn new(account: Account) -> Self {
        Self { account, services: VecDeque::new() }
    }

    /// Handles a notice from the ledger.
    pub fn handle(&mut self, notice: &Notice) {
        let (Notice::Event(event) | Notice::Retracted(event)) = notice else { return };
        let Some(id) = event.service() else { return };
        let known = self.services.iter_mut().rev().find(|log| log.id == id);
        match (event, known) {
            (Event::ServiceAnnounced { creator, .. }, None) if *creator == self.account => {
                if self.services.len() == SERVICES {
                    self.services.pop_front();
                }
                self.services.push_back(ServiceLog::new(id));
            }
            // These do not show how a provider served, and are long.
            (Event::ServiceAnnounced { .. } | Event::BidPlaced { .. } | Event::BondReclaimed { .. }, _) => {}
            (_, Some(log)) => _ = log.take(notice),
            (_, None) => {}
        }
    }

    /// Returns a provider's standing over all services.
    pub fn standing(&self, provider: Account) -> Standing {
        let standings: Vec<_> = self.services.iter().map(|log| log.standing(provider)).collect();
        let worst_first = [Standing::Failed, Standing::Proven];
        worst_first.into_iter().find(|standing| standings.contains(standing)).unwrap_or(Standing::Unknown)
    }
}

impl ServiceLog {
    /// Returns a provider's standing in this service.
    fn standing(&self, of: Account) -> Standing {
        let choice = self.choice_of(of);
        if choice == 0 {
            return Standing::Unknown;
        }
        let has = |is_it: &dyn Fn(&Event) -> bool| self.events.iter().any(is_it);
        if has(&|event| matches!(event, Event::ServiceAccepted { provider, .. } if *provider == of)) {
            return Standing::Proven;
        }
        let has_deployed =
            has(&|event| matches!(event, Event::ServiceDeployed { provider, .. } if *provider == of));
        let has_failed = has(&|event| match *event {
            Event::ServiceReopened { provider, .. } => provider == of,
            Event::ProviderChosen { choice: other, .. } => other > choice,
            Event::ServiceEnded { provider, outcome, .. } if provider == of => match outcome {
                Outcome::NotDeployed | Outcome::Declined => true,
                // The deployment could not be used.
                Outcome::Cancelled => has_deployed,
                _ => false,
            },
            _ => false,
        });
        if has_failed { Standing::Failed } else { Standing::Unknown }
    }
}
