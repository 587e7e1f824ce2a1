//! The negotiation of a service: a state machine for each of its two roles, without network or clock.
//!
//! The chain is authoritative. A machine derives the service's phase from its events, compares it with its goal, and
//! submits the call that leads there, one at a time. Repeated calls, and repeated, late or retracted events therefore
//! do no harm. A restarted operator is up to date once it has received the events again.
//!
//! A machine that receives nothing gives up at a deadline of its own. It then ends the service on the chain as soon
//! as the chain is reachable.

mod creator;
mod provider;
mod record;
#[cfg(test)]
mod tests;

use cotorra_graph::Timestamp;

use crate::{
    ledger::{Ledger, Notice, Ticket},
    message::{Call, Event, Outcome},
    values::{Account, ChainTime, ServiceId},
};

pub use creator::{Creator, CreatorStep, Failure, Policy, Request};
pub use provider::{Offer, Provider, ProviderStep};
pub use record::{Record, Standing};

/// Phase of a service according to the received events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Nothing,
    Open { deadline: ChainTime },
    Closed { provider: Account, deadline: ChainTime },
    Deployed { provider: Account, deadline: ChainTime },
    InUse { provider: Account, deadline: ChainTime },
    Ended(Outcome),
}

/// The received events of one service.
#[derive(Debug, Clone)]
struct ServiceLog {
    id: ServiceId,
    events: Vec<Event>,
    /// Time of the last head.
    time: ChainTime,
}

impl ServiceLog {
    fn new(id: ServiceId) -> Self {
        Self { id, events: Vec::new(), time: ChainTime::default() }
    }

    /// Records a notice. Returns its event if that is new for the service.
    fn take<'a>(&mut self, notice: &'a Notice) -> Option<&'a Event> {
        match notice {
            // A service has each event at most once. A known one is a repetition.
            Notice::Event(event) if event.service() == Some(self.id) && !self.events.contains(event) => {
                self.events.push(event.clone());
                return Some(event);
            }
            Notice::Retracted(event) => self.events.retain(|other| other != event),
            Notice::Head { time, .. } => self.time = *time,
            _ => {}
        }
        None
    }

    /// Returns the phase of the service. The latest event in a service's life decides, whatever the order of arrival.
    fn phase(&self) -> Phase {
        let rank = |event: &Event| match *event {
            Event::ServiceAnnounced { deadline, .. } => Some(((0, 1), Phase::Open { deadline })),
            Event::ProviderChosen { provider, deadline, choice, .. } => {
                Some(((choice, 2), Phase::Closed { provider, deadline }))
            }
            Event::ServiceDeployed { provider, deadline, .. } => {
                Some(((self.choice_of(provider), 3), Phase::Deployed { provider, deadline }))
            }
            Event::ServiceAccepted { provider, deadline, .. } => {
                Some(((self.choice_of(provider), 4), Phase::InUse { provider, deadline }))
            }
            Event::ServiceReopened { provider, deadline, .. } => {
                Some(((self.choice_of(provider), 5), Phase::Open { deadline }))
            }
            Event::ServiceEnded { outcome, .. } => Some(((u32::MAX, 6), Phase::Ended(outcome))),
            Event::BidPlaced { .. }
            | Event::BondReclaimed { .. }
            | Event::OperatorRegistered { .. }
            | Event::Withdrawn { .. } => None,
        };
        let last = self.events.iter().filter_map(rank).max_by_key(|(rank, _)| *rank);
        last.map_or(Phase::Nothing, |(_, phase)| phase)
    }

    /// Returns the number of the choice that chose a provider, 0 if none. Each provider is chosen at most once.
    fn choice_of(&self, of: Account) -> u32 {
        let choice = |event: &Event| match *event {
            Event::ProviderChosen { provider, choice, .. } if provider == of => Some(choice),
            _ => None,
        };
        self.events.iter().find_map(choice).unwrap_or(0)
    }
}

impl Phase {
    /// Returns the winner, while there is one.
    fn winner(self) -> Option<Account> {
        match self {
            Self::Closed { provider, .. }
            | Self::Deployed { provider, .. }
            | Self::InUse { provider, .. } => Some(provider),
            Self::Nothing | Self::Open { .. } | Self::Ended(_) => None,
        }
    }
}

/// The calls of a machine that the ledger has.
#[derive(Debug, Default)]
struct Calls {
    in_flight: Vec<(Ticket, Call)>,
    /// Rejected calls, not retried before the next head, because the chain would reject them again. Other calls are
    /// submitted, because there may be no head before them.
    rejected: Vec<Call>,
}

impl Calls {
    fn take(&mut self, notice: &Notice) {
        match notice {
            Notice::Refused(ticket, _) => {
                let rejected = self.in_flight.extract_if(.., |(other, _)| other == ticket);
                self.rejected.extend(rejected.map(|(_, call)| call));
            }
            Notice::Head { .. } => self.rejected.clear(),
            _ => {}
        }
    }

    /// Submits a call that is not with the ledger yet. Returns whether it did.
    fn submit(&mut self, now: Timestamp, ledger: &mut dyn Ledger, call: Call) -> bool {
        if self.rejected.contains(&call) || self.in_flight.iter().any(|(_, other)| *other == call) {
            return false;
        }
        let ticket = ledger.submit(now, call.clone());
        self.in_flight.push((ticket, call));
        true
    }
}
