//! The core's part: what is wanted of the Wi-Fi interfaces of an agent, and what became of it.

use std::collections::{BTreeMap, VecDeque};

use cotorra_graph::{AgentId, Timestamp};
use cotorra_wifi::InterfaceName;

use super::{
    LastEvent, MOST_REQUESTS, RadioEvent, RadioState, RequestError, RequestState, WantedRadio, WantedRequest,
    WantedWifi, WifiReport,
};
use crate::controller_event::ControllerEvent;

/// Most earlier processes that are remembered.
const MOST_EARLIER: usize = 16;

/// A wanted interface, or request.
#[derive(Debug)]
struct Known<W> {
    wanted: W,
    /// The generation that it came with.
    since: u64,
    /// The state that was reported last, since the agent's process is there.
    state: Option<RadioState>,
}

/// The source of a report.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Origin {
    /// The agent's process.
    pub boot: u64,
    /// The generation that it follows.
    pub generation: u64,
    /// Time at which the beat that it answers was sent; `None` if it answers none.
    pub answered: Option<Timestamp>,
}

/// The Wi-Fi interfaces of an agent.
#[derive(Debug, Default)]
pub(crate) struct RemoteWifi {
    radios: BTreeMap<InterfaceName, Known<WantedRadio>>,
    requests: BTreeMap<u64, Known<WantedRequest>>,
    /// Number of interfaces in the last report.
    reported: usize,
    /// The last event of the agent's process.
    last_event: Option<LastEvent>,
    /// Earlier processes of the agent, whose reports can still arrive: their last events, and since when another one reports.
    earlier: VecDeque<(LastEvent, Timestamp)>,
}

impl RemoteWifi {
    /// Wants an interface to be like this from this generation on.
    pub(crate) fn want(&mut self, interface: InterfaceName, wanted: WantedRadio, since: u64) {
        let state = self.radios.remove(&interface).and_then(|before| before.state);
        self.radios.insert(interface, Known { wanted, since, state });
    }

    /// Leaves an interface to its owner. Returns whether that is new.
    pub(crate) fn release(&mut self, interface: &InterfaceName) -> bool {
        self.radios.remove(interface).is_some()
    }

    /// Wants a request to be carried out.
    ///
    /// # Errors
    /// The reason, for people, if too many are under way.
    pub(crate) fn request(&mut self, number: u64, wanted: WantedRequest, since: u64) -> Result<(), String> {
        if self.requests.len() >= MOST_REQUESTS {
            return Err(format!("{MOST_REQUESTS} requests to Wi-Fi programs are under way"));
        }
        self.requests.insert(number, Known { wanted, since, state: None });
        Ok(())
    }

    /// Does not want anything any more. Returns whether that is new.
    pub(crate) fn stop(&mut self) -> bool {
        let had_radios = !std::mem::take(&mut self.radios).is_empty();
        let had_requests = !std::mem::take(&mut self.requests).is_empty();
        had_radios || had_requests
    }

    /// Whether the last report has as many interfaces as are wanted, each as wanted or failed.
    pub(crate) fn is_settled(&self) -> bool {
        self.reported == self.radios.len()
    }

    pub(crate) fn wanted(&self) -> WantedWifi {
        let radios = self.radios.iter().map(|(interface, known)| (interface.clone(), known.wanted.clone()));
        let requests = self.requests.iter().map(|(number, known)| (*number, known.wanted.clone()));
        WantedWifi { radios: radios.collect(), requests: requests.collect() }
    }

    /// Returns what a beat acknowledges.
    pub(crate) fn last_event(&self) -> Option<LastEvent> {
        self.last_event
    }

    /// Returns the events that are new in a report, which answers a beat that was sent at `answered`.
    fn new_events(
        &mut self,
        now: Timestamp,
        boot: u64,
        answered: Option<Timestamp>,
        events: Vec<RadioEvent>,
    ) -> Vec<RadioEvent> {
        let mut before = self.last_event.filter(|last| last.boot == boot);
        if let Some(place) = self.earlier.iter().position(|(last, _)| last.boot == boot) {
            // A process that is over answers no beat that was sent after another one reported. One that does is there, and the
            // report of the other came late.
            let (last, since) = self.earlier[place];
            if answered.is_none_or(|sent| sent <= since) {
                return Vec::new();
            }
            self.earlier.remove(place);
            before = Some(last);
        }
        if let Some(last) = self.last_event.filter(|last| last.boot != boot) {
            if self.earlier.len() == MOST_EARLIER {
                self.earlier.pop_front();
            }
            self.earlier.push_back((last, now));
        }
        let mut last = before.map_or(0, |before| before.number);
        let mut new = Vec::new();
        for event in events {
            if event.number > last {
                last = event.number;
                new.push(event);
            }
        }
        self.last_event = Some(LastEvent { boot, number: last });
        new
    }

    /// Takes the Wi-Fi of a report. Returns whether requests have ended.
    pub(crate) fn receive(
        &mut self,
        now: Timestamp,
        agent: &AgentId,
        Origin { boot, generation, answered }: Origin,
        report: WifiReport,
        events: &mut VecDeque<ControllerEvent>,
    ) -> bool {
        self.reported = report.radios.len();
        let new = self.new_events(now, boot, answered, report.events);
        events.extend(new.into_iter().map(|event| ControllerEvent::Wifi(agent.clone(), event)));
        // Before that generation, the report is on something else.
        for (interface, known) in self.radios.iter_mut().filter(|(_, known)| generation >= known.since) {
            let state = report.radios.get(interface).cloned();
            if known.state != state {
                known.state.clone_from(&state);
                let told = |state| ControllerEvent::Radio(agent.clone(), interface.clone(), state);
                events.extend(state.map(told));
            }
        }
        let before = self.requests.len();
        self.requests.retain(|number, known| {
            let answer = match report.requests.get(number) {
                Some(RequestState::UnderWay) => return true,
                Some(RequestState::Done) => Ok(()),
                Some(RequestState::Busy) => Err(RequestError::Busy),
                Some(RequestState::Refused(reason)) => Err(RequestError::Refused(reason.clone())),
                None if generation < known.since => return true,
                None => Err(RequestError::Refused("its agent does not know it".to_owned())),
            };
            events.push_back(ControllerEvent::Request(agent.clone(), *number, answer));
            false
        });
        self.requests.len() != before
    }

    /// Takes the loss of the agent, or of its process. Returns whether requests have ended.
    pub(crate) fn lose(
        &mut self,
        agent: &AgentId,
        reason: &str,
        events: &mut VecDeque<ControllerEvent>,
    ) -> bool {
        self.radios.values_mut().for_each(|known| known.state = None);
        let requests = std::mem::take(&mut self.requests);
        let has_ended = !requests.is_empty();
        for number in requests.into_keys() {
            let answer = Err(RequestError::Refused(reason.to_owned()));
            events.push_back(ControllerEvent::Request(agent.clone(), number, answer));
        }
        has_ended
    }
}
