//! An operator's memory of how others served it, by what the chain says of its own services. So it has the same memory
//! again after a restart, and nobody else can write in it.

use std::collections::VecDeque;

use super::Heard;
use crate::{
    ledger::Notice,
    message::{Event, Outcome},
    values::Account,
};

/// How many services are remembered, the last ones. Others cannot fill the memory: only the operator itself announces in
/// its name.
const SERVICES: usize = 1000;

/// How a provider served an operator before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Standing {
    /// It did, and never failed. Its bids come first: nobody gets there but by serving.
    Proven,
    /// It was never chosen, or is not to blame for what became of it.
    Unknown,
    /// It won, and did not deploy what it won, or nobody could use it. Its bids come last.
    Failed,
}

/// What an operator remembers of others.
#[derive(Debug, Clone)]
pub struct Record {
    account: Account,
    /// Its own, oldest first.
    services: VecDeque<Heard>,
}

impl Record {
    /// The memory of an operator that has not heard anything.
    pub fn new(account: Account) -> Self {
        Self { account, services: VecDeque::new() }
    }

    /// The ledger said something.
    pub fn handle(&mut self, notice: &Notice) {
        let (Notice::Event(event) | Notice::Retracted(event)) = notice else { return };
        let Some(id) = event.service() else { return };
        let known = self.services.iter_mut().rev().find(|heard| heard.id == id);
        match (event, known) {
            (Event::ServiceAnnounced { creator, .. }, None) if *creator == self.account => {
                if self.services.len() == SERVICES {
                    self.services.pop_front();
                }
                self.services.push_back(Heard::new(id));
            }
            // They say nothing of how anybody served, and are long.
            (Event::ServiceAnnounced { .. } | Event::BidPlaced { .. } | Event::BondReclaimed { .. }, _) => {}
            (_, Some(heard)) => _ = heard.take(notice),
            (_, None) => {}
        }
    }

    /// How a provider served before.
    pub fn standing(&self, provider: Account) -> Standing {
        let standings: Vec<_> = self.services.iter().map(|heard| heard.standing(provider)).collect();
        let worst_first = [Standing::Failed, Standing::Proven];
        worst_first.into_iter().find(|standing| standings.contains(standing)).unwrap_or(Standing::Unknown)
    }
}

impl Heard {
    /// How a provider served in this one.
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
                // What was deployed could not be used.
                Outcome::Cancelled => has_deployed,
                _ => false,
            },
            _ => false,
        });
        if has_failed { Standing::Failed } else { Standing::Unknown }
    }
}
