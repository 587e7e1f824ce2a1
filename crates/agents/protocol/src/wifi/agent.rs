//! The agent's part: what its shell is to do with Wi-Fi interfaces, and what the core does not know yet.

use std::collections::{BTreeMap, VecDeque};

use cotorra_graph::Timestamp;
use cotorra_wifi::{Event, InterfaceName};

use super::{
    MOST_EVENTS, RadioEvent, RadioState, RequestError, RequestState, WantedRadio, WantedRequest, WantedWifi,
    WifiReport,
};
use crate::{action::Action, message::short};

/// The Wi-Fi interfaces of an agent's machine.
#[derive(Debug, Default)]
pub(crate) struct AgentWifi {
    /// The last orders to the shell.
    told: BTreeMap<InterfaceName, WantedRadio>,
    states: BTreeMap<InterfaceName, RadioState>,
    /// States of the wanted requests, and those that the shell has not been told.
    requests: BTreeMap<u64, RequestState>,
    due: VecDeque<(u64, WantedRequest)>,
    /// Events that the core has not acknowledged.
    events: VecDeque<RadioEvent>,
    last_event: u64,
}

impl AgentWifi {
    /// Requests that an earlier process had are not carried out: it is unknown whether it did so.
    pub(crate) fn after_a_restart(saved: &WantedWifi) -> Self {
        let refused = RequestState::Refused("its agent was restarted".to_owned());
        let requests = saved.requests.keys().map(|number| (*number, refused.clone())).collect();
        Self { requests, ..Self::default() }
    }

    /// Takes what the core wants.
    pub(crate) fn want(&mut self, wanted: &WantedWifi) {
        self.requests.retain(|number, _| wanted.requests.contains_key(number));
        self.due.retain(|(number, _)| wanted.requests.contains_key(number));
        for (number, request) in &wanted.requests {
            if !self.requests.contains_key(number) {
                self.requests.insert(*number, RequestState::UnderWay);
                self.due.push_back((*number, request.clone()));
            }
        }
    }

    /// Forgets requests and events of a run that is over.
    pub(crate) fn forget(&mut self) {
        self.requests.clear();
        self.due.clear();
        self.events.clear();
    }

    /// Refuses requests that are under way.
    pub(crate) fn refuse(&mut self, reason: &str) {
        self.due.clear();
        for state in self.requests.values_mut().filter(|state| **state == RequestState::UnderWay) {
            *state = RequestState::Refused(reason.to_owned());
        }
    }

    /// Returns what is to be done; `None` for `wanted` puts all interfaces back.
    pub(crate) fn poll(&mut self, wanted: Option<&WantedWifi>) -> Option<Action> {
        let nothing = BTreeMap::new();
        let radios = wanted.map_or(&nothing, |wanted| &wanted.radios);
        if self.told != *radios {
            self.told.clone_from(radios);
            return Some(Action::UseRadios(radios.clone()));
        }
        wanted?;
        let (number, request) = self.due.pop_front()?;
        Some(Action::Request(number, request))
    }

    /// Takes the state of each interface that is not its owner's. Returns whether there is news.
    pub(crate) fn set_states(&mut self, states: BTreeMap<InterfaceName, RadioState>) -> bool {
        let cut = |state| match state {
            RadioState::Failed(reason) => RadioState::Failed(short(&reason)),
            state => state,
        };
        let states = states.into_iter().map(|(interface, state)| (interface, cut(state))).collect();
        let is_news = self.states != states;
        self.states = states;
        is_news
    }

    /// Takes what became of a request.
    pub(crate) fn answered(&mut self, number: u64, answer: Result<(), RequestError>) {
        if let Some(state @ RequestState::UnderWay) = self.requests.get_mut(&number) {
            *state = match answer {
                Ok(()) => RequestState::Done,
                Err(RequestError::Busy) => RequestState::Busy,
                Err(RequestError::Refused(reason)) => RequestState::Refused(short(&reason)),
            };
        }
    }

    /// Takes an event.
    pub(crate) fn happened(&mut self, now: Timestamp, interface: InterfaceName, event: Event) {
        self.last_event += 1;
        if self.events.len() == MOST_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(RadioEvent {
            number: self.last_event,
            at_ns: now.as_nanos(),
            interface,
            event,
        });
    }

    /// Forgets events that the core has.
    pub(crate) fn acknowledge(&mut self, last: u64) {
        self.events.retain(|event| event.number > last);
    }

    /// Returns what to report; `is_of_run` if the run of the report is that of the wanted state.
    pub(crate) fn report(&self, is_of_run: bool) -> WifiReport {
        if !is_of_run {
            return WifiReport { radios: self.states.clone(), ..WifiReport::default() };
        }
        WifiReport {
            radios: self.states.clone(),
            requests: self.requests.clone(),
            events: self.events.iter().cloned().collect(),
        }
    }
}
