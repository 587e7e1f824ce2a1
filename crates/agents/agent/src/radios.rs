//! Gives Wi-Fi interfaces of this machine the access points and stations that the core wants, and puts them back.
//!
//! Each interface has a thread of its own, because hostapd and wpa_supplicant take their time. Before a thread changes anything,
//! it saves a note of what is there. The next start of the agent puts back what a killed one left.

mod interface;
mod notes;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::mpsc,
};

use cotorra_agent_protocol::{MOST_RADIOS, RadioState, RequestError, WantedRadio, WantedRequest};
use cotorra_wifi::{Event, InterfaceName, MacAddress, interface_address, wpa_supplicant::Heard};

use self::{
    interface::{Command, Interface},
    notes::Notes,
};
use crate::wake::Wake;

/// Something that the thread of an interface reports.
pub(crate) enum Reported {
    /// An interface has another state, on what was wanted last with this number; `None` if it is its owner's again.
    State(InterfaceName, u64, Option<RadioState>),
    /// A request was taken, or refused with this reason.
    Answered(u64, Result<(), RequestError>),
    Happened(InterfaceName, Event),
    /// A station heard these.
    Heard(InterfaceName, Vec<Heard>),
}

/// The Wi-Fi interfaces that the machine's owner lends. Dropping it puts all of them back.
pub(crate) struct Radios {
    lent: BTreeSet<InterfaceName>,
    notes: Notes,
    interfaces: BTreeMap<InterfaceName, Interface>,
    states: BTreeMap<InterfaceName, RadioState>,
    heard: BTreeMap<InterfaceName, Vec<Heard>>,
    reports: mpsc::Receiver<Reported>,
    report: mpsc::Sender<Reported>,
    wake: Wake,
    /// Number of times that something was wanted.
    number: u64,
}

/// Something that the core is to learn.
pub(crate) enum News {
    Answered(u64, Result<(), RequestError>),
    Happened(InterfaceName, Event),
}

impl Radios {
    /// Puts back what a killed agent left. Notes are in a folder of the agent's state. `wake` wakes the agent's loop.
    pub(crate) fn new(lent: BTreeSet<InterfaceName>, state: &Path, wake: Wake) -> Self {
        let notes = Notes::new(state);
        notes.put_back_all();
        let (report, reports) = mpsc::channel();
        let (interfaces, states, heard) = Default::default();
        Self { lent, notes, interfaces, states, heard, reports, report, wake, number: 0 }
    }

    /// Makes these interfaces so, and puts all others back.
    pub(crate) fn want(&mut self, mut wanted: BTreeMap<InterfaceName, WantedRadio>) {
        self.number += 1;
        // Others were never begun.
        self.states.retain(|interface, _| self.interfaces.contains_key(interface));
        for (interface, thread) in &self.interfaces {
            let radio = wanted.remove(interface);
            if radio.is_some() || self.states.contains_key(interface) {
                self.states.insert(interface.clone(), RadioState::Changing);
                thread.send(Command::Want(self.number, radio));
            }
        }
        for (interface, radio) in wanted {
            let state = match self.begin(&interface, radio) {
                Ok(()) => RadioState::Changing,
                Err(reason) => {
                    tracing::warn!("{interface}: {reason}");
                    RadioState::Failed(reason)
                }
            };
            self.states.insert(interface, state);
        }
    }

    fn begin(&mut self, interface: &InterfaceName, radio: WantedRadio) -> Result<(), String> {
        if !self.lent.contains(interface) {
            return Err(format!(
                "the owner of this machine does not lend `{interface}`: its agent needs `--wifi {interface}`"
            ));
        }
        let (notes, report, wake) = (self.notes.clone(), self.report.clone(), self.wake.clone());
        let thread = Interface::begin(interface.clone(), notes, report, wake)
            .map_err(|error| format!("its thread cannot be started: {error}"))?;
        thread.send(Command::Want(self.number, Some(radio)));
        self.interfaces.insert(interface.clone(), thread);
        Ok(())
    }

    /// Hands a request to the program of its interface. What becomes of it is news.
    ///
    /// # Errors
    /// The reason, for people, if the interface has no program.
    pub(crate) fn request(&self, number: u64, wanted: WantedRequest) -> Result<(), String> {
        let WantedRequest { interface, request } = wanted;
        let thread = self.interfaces.get(&interface);
        let thread = thread.ok_or_else(|| format!("`{interface}` is its owner's"))?;
        thread.send(Command::Request(number, request));
        Ok(())
    }

    /// Returns what the core is to learn, oldest first.
    pub(crate) fn poll(&mut self) -> Option<News> {
        while let Ok(reported) = self.reports.try_recv() {
            match reported {
                // Something else is wanted since.
                Reported::State(_, number, _) if number != self.number => {}
                Reported::State(interface, _, Some(state)) => drop(self.states.insert(interface, state)),
                Reported::State(interface, _, None) => {
                    self.states.remove(&interface);
                    self.heard.remove(&interface);
                }
                Reported::Heard(interface, heard) => drop(self.heard.insert(interface, heard)),
                Reported::Answered(number, answer) => return Some(News::Answered(number, answer)),
                Reported::Happened(interface, event) => return Some(News::Happened(interface, event)),
            }
        }
        None
    }

    /// Returns the state of each interface that is wanted, or is being put back.
    pub(crate) fn states(&self) -> BTreeMap<InterfaceName, RadioState> {
        self.states.clone()
    }

    /// Returns the addresses of the interfaces that the owner lends.
    pub(crate) fn addresses(&self) -> BTreeMap<InterfaceName, MacAddress> {
        let address = |interface: &InterfaceName| Some((interface.clone(), interface_address(interface)?));
        self.lent.iter().filter_map(address).take(MOST_RADIOS).collect()
    }

    /// Returns what stations heard last.
    pub(crate) fn heard(&self) -> BTreeMap<InterfaceName, Vec<Heard>> {
        self.heard.clone()
    }
}

impl Drop for Radios {
    fn drop(&mut self) {
        // All at once: each may take some time.
        self.interfaces.values().for_each(|interface| interface.send(Command::End));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn interfaces_that_the_owner_does_not_lend_are_refused() {
        let state = tempfile::tempdir().unwrap();
        let mut radios = Radios::new(BTreeSet::new(), state.path(), Arc::new(|| {}));
        let interface: InterfaceName = "wlan0".parse().unwrap();
        radios.want(BTreeMap::from([(interface.clone(), WantedRadio::Silent)]));
        let RadioState::Failed(reason) = &radios.states()[&interface] else { panic!("it is refused") };
        assert!(reason.contains("--wifi wlan0"), "{reason}");
        radios.want(BTreeMap::new());
        assert!(radios.states().is_empty());
    }

    #[test]
    fn an_interface_without_a_radio_is_reported_and_leaves_no_note() {
        let state = tempfile::tempdir().unwrap();
        let interface: InterfaceName = "lo".parse().unwrap();
        let (woken, wakes) = mpsc::channel();
        let woken = parking_lot::Mutex::new(woken);
        let wake = Arc::new(move || {
            let _ = woken.lock().send(());
        });
        let mut radios = Radios::new(BTreeSet::from([interface.clone()]), state.path(), wake);
        radios.want(BTreeMap::from([(interface.clone(), WantedRadio::Silent)]));
        wakes.recv().unwrap();
        assert!(radios.poll().is_none());
        let RadioState::Failed(reason) = &radios.states()[&interface] else { panic!("it has no radio") };
        assert!(reason.contains("no Wi-Fi interface"), "{reason}");
        drop(radios);
        assert_eq!(Notes::new(state.path()).all(), []);
    }
}
