//! The negotiation of a service, as a state machine for each of its two roles, without a network and without a clock.
//!
//! What the chain says is the truth: a machine folds the events of its service into where the service stands, compares
//! that with what it wants, and submits the call that leads there, one at a time. So it does not matter how often a call
//! is sent, or whether an event comes twice, late or is taken back; and an operator that was restarted is where it was
//! once it has heard the events again. A machine that hears nothing gives up at a time of its own; what it has on the
//! chain by then is ended as soon as the chain is heard.

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

/// Where a service stands, by what was heard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Seen {
    Nothing,
    Open { deadline: ChainTime },
    Closed { provider: Account, deadline: ChainTime },
    Deployed { provider: Account, deadline: ChainTime },
    InUse { provider: Account, deadline: ChainTime },
    Ended(Outcome),
}

/// What was heard of one service.
#[derive(Debug, Clone)]
struct Heard {
    id: ServiceId,
    events: Vec<Event>,
    /// Of the last head.
    time: ChainTime,
}

impl Heard {
    fn new(id: ServiceId) -> Self {
        Self { id, events: Vec::new(), time: ChainTime::default() }
    }

    /// Takes in a notice. Returns its event, if that is news of the service.
    fn take<'a>(&mut self, notice: &'a Notice) -> Option<&'a Event> {
        match notice {
            // A service has each of its events once: one that is there already was only told again.
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

    /// Where the service stands. What comes later in its life counts, in whatever order it was heard.
    fn seen(&self) -> Seen {
        let rank = |event: &Event| match *event {
            Event::ServiceAnnounced { deadline, .. } => Some(((0, 1), Seen::Open { deadline })),
            Event::ProviderChosen { provider, deadline, choice, .. } => {
                Some(((choice, 2), Seen::Closed { provider, deadline }))
            }
            Event::ServiceDeployed { provider, deadline, .. } => {
                Some(((self.choice_of(provider), 3), Seen::Deployed { provider, deadline }))
            }
            Event::ServiceAccepted { provider, deadline, .. } => {
                Some(((self.choice_of(provider), 4), Seen::InUse { provider, deadline }))
            }
            Event::ServiceReopened { provider, deadline, .. } => {
                Some(((self.choice_of(provider), 5), Seen::Open { deadline }))
            }
            Event::ServiceEnded { outcome, .. } => Some(((u32::MAX, 6), Seen::Ended(outcome))),
            Event::BidPlaced { .. }
            | Event::BondReclaimed { .. }
            | Event::OperatorRegistered { .. }
            | Event::Withdrawn { .. } => None,
        };
        let last = self.events.iter().filter_map(rank).max_by_key(|(rank, _)| *rank);
        last.map_or(Seen::Nothing, |(_, seen)| seen)
    }

    /// Which of the choices a provider was, by what was heard: it is one at most. 0 if none.
    fn choice_of(&self, of: Account) -> u32 {
        let choice = |event: &Event| match *event {
            Event::ProviderChosen { provider, choice, .. } if provider == of => Some(choice),
            _ => None,
        };
        self.events.iter().find_map(choice).unwrap_or(0)
    }
}

impl Seen {
    /// The winner, while there is one.
    fn winner(self) -> Option<Account> {
        match self {
            Self::Closed { provider, .. }
            | Self::Deployed { provider, .. }
            | Self::InUse { provider, .. } => Some(provider),
            Self::Nothing | Self::Open { .. } | Self::Ended(_) => None,
        }
    }
}

/// The calls that a machine has with the ledger.
#[derive(Debug, Default)]
struct Calls {
    in_flight: Vec<(Ticket, Call)>,
    /// Not tried again before the next head: the same chain would say the same again. Other calls are, as no head may come before one.
    refused: Vec<Call>,
}

impl Calls {
    fn take(&mut self, notice: &Notice) {
        match notice {
            Notice::Refused(ticket, _) => {
                let refused = self.in_flight.extract_if(.., |(other, _)| other == ticket);
                self.refused.extend(refused.map(|(_, call)| call));
            }
            Notice::Head { .. } => self.refused.clear(),
            _ => {}
        }
    }

    /// Submits a call that is not with the ledger yet. Returns whether it did.
    fn submit(&mut self, now: Timestamp, ledger: &mut dyn Ledger, call: Call) -> bool {
        if self.refused.contains(&call) || self.in_flight.iter().any(|(_, other)| *other == call) {
            return false;
        }
        let ticket = ledger.submit(now, call.clone());
        self.in_flight.push((ticket, call));
        true
    }
}
