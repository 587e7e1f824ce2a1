//! The thread of a Wi-Fi interface.

use std::{
    io,
    sync::{
        Arc, Weak,
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::Duration,
};

use cotorra_agent_protocol::{MOST_HEARD, RadioState, RequestError, WantedRadio, WifiRequest};
use cotorra_wifi::{
    AnswerError, Client, ControlError, Event, Events, InterfaceName, Owner, Request, Taken, hostapd,
    wpa_supplicant,
};

use super::{Reported, notes::Notes};
use crate::wake::Wake;

/// Interval of attempts after a failure.
const AGAIN: Duration = Duration::from_secs(1);
/// Interval of looking whether a program still runs.
const LOOK: Duration = Duration::from_secs(1);
/// Time that a program has for an answer.
const ANSWER: Duration = Duration::from_secs(3);

/// A message to the thread.
pub(super) enum Command {
    /// Be like this, or the owner's again. Each has another number, which its reports have, too.
    Want(u64, Option<WantedRadio>),
    Request(u64, WifiRequest),
    /// A program reports an event. The reader is that of this number.
    Event(u64, Event),
    /// The program has ended.
    Gone(u64),
    /// Put the interface back, and end.
    End,
}

/// A Wi-Fi interface with a thread. It is put back when this is dropped.
pub(super) struct Interface {
    commands: mpsc::Sender<Command>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Interface {
    pub(super) fn begin(
        interface: InterfaceName,
        notes: Notes,
        report: mpsc::Sender<Reported>,
        wake: Wake,
    ) -> io::Result<Self> {
        let (commands, inbox) = mpsc::channel();
        let worker = Worker {
            interface,
            notes,
            report,
            wake,
            commands: commands.clone(),
            wanted: (0, None),
            taken: None,
            listened: None,
            has_failed: false,
        };
        let thread = thread::Builder::new().name("radio".to_owned()).spawn(move || worker.run(&inbox))?;
        Ok(Self { commands, thread: Some(thread) })
    }

    /// Sends a message. One to a thread that panicked is lost.
    pub(super) fn send(&self, command: Command) {
        let _ = self.commands.send(command);
    }
}

impl Drop for Interface {
    fn drop(&mut self) {
        self.send(Command::End);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Worker {
    interface: InterfaceName,
    notes: Notes,
    report: mpsc::Sender<Reported>,
    wake: Wake,
    /// To itself, for the threads that read events.
    commands: mpsc::Sender<Command>,
    wanted: (u64, Option<WantedRadio>),
    taken: Option<Taken>,
    listened: Option<Listened>,
    /// Whether it is tried again.
    has_failed: bool,
}

/// A program whose events are read.
struct Listened {
    /// Its number among the programs of the takeover.
    number: u64,
    client: Client,
    /// The reader ends when this is dropped.
    _reader: Arc<()>,
}

impl Worker {
    fn run(mut self, inbox: &mpsc::Receiver<Command>) {
        loop {
            let command = if self.has_failed {
                inbox.recv_timeout(AGAIN)
            } else {
                inbox.recv().map_err(|_| RecvTimeoutError::Disconnected)
            };
            let listens_to = |number| self.listened.as_ref().is_some_and(|its| its.number == number);
            match command {
                Ok(Command::Want(number, wanted)) => {
                    self.wanted = (number, wanted);
                    self.apply();
                }
                Ok(Command::Request(number, request)) => {
                    let answer = self.request(&request);
                    self.tell(Reported::Answered(number, answer));
                }
                Ok(Command::Event(number, event)) if listens_to(number) => self.happened(event),
                Ok(Command::Gone(number)) if listens_to(number) => self.gone(),
                Ok(Command::Event(..) | Command::Gone(_)) => {}
                Err(RecvTimeoutError::Timeout) => self.apply(),
                Ok(Command::End) | Err(RecvTimeoutError::Disconnected) => {
                    if let Err(reason) = self.put_back() {
                        tracing::error!(
                            "cannot put {} back, which the next start of the agent tries again: {reason}",
                            self.interface
                        );
                    }
                    return;
                }
            }
        }
    }

    /// Makes the interface as wanted.
    fn apply(&mut self) {
        let done = match self.wanted.1.clone() {
            None => self.put_back().map(|()| None),
            Some(wanted) => self.make(&wanted).map(|()| Some(RadioState::Ready)),
        };
        match done {
            Ok(state) => {
                self.has_failed = false;
                self.tell_state(state);
            }
            Err(reason) => self.fail(reason),
        }
    }

    fn make(&mut self, wanted: &WantedRadio) -> Result<(), String> {
        let taken = match self.taken.take() {
            Some(taken) => taken,
            None => self.take_over()?,
        };
        let taken = self.taken.insert(taken);
        let done = match wanted {
            WantedRadio::AccessPoint(settings) => taken.serve(settings),
            WantedRadio::Station(settings) => taken.join(settings),
            WantedRadio::Silent => taken.leave(),
        };
        done.map_err(|error| error.to_string())?;
        self.listen(wanted).map_err(|error| error.to_string())
    }

    /// Takes the interface over, with a note on the disk.
    fn take_over(&self) -> Result<Taken, String> {
        // A note is here if the interface could not be put back.
        self.notes.put_back(&self.interface)?;
        let folder = self.notes.folder(&self.interface).map_err(|error| error.to_string())?;
        let owner = Owner::find(&self.interface, &folder).map_err(|error| error.to_string())?;
        self.notes.save(&owner).map_err(|error| format!("cannot note what is there now: {error}"))?;
        tracing::info!("took {} over", self.interface);
        Ok(Taken::new(owner, &folder))
    }

    fn put_back(&mut self) -> Result<(), String> {
        self.listened = None;
        if let Some(taken) = self.taken.take()
            && taken.give_back().is_ok()
        {
            self.notes.remove(&self.interface);
            tracing::info!("put {} back", self.interface);
            return Ok(());
        }
        self.notes.put_back(&self.interface)
    }

    /// Reads the events of the present program, if that is another one.
    fn listen(&mut self, wanted: &WantedRadio) -> Result<(), ControlError> {
        let Some(taken) = &self.taken else { return Ok(()) };
        let number = taken.programs();
        if self.listened.as_ref().is_some_and(|its| its.number == number) {
            return Ok(());
        }
        self.listened = None;
        let Some(client) = taken.client()? else { return Ok(()) };
        let mut client = client.with_timeout(ANSWER);
        let events = client.events()?;
        // An event from before its events could be read.
        let before = match wanted {
            WantedRadio::AccessPoint(_) => {
                let state = client.request(&hostapd::status())?.state;
                (state == hostapd::State::Enabled).then_some(Event::AccessPointEnabled)
            }
            WantedRadio::Station(_) => {
                let status = client.request(&wpa_supplicant::status())?;
                let is_there = status.state == wpa_supplicant::State::Completed;
                status.bssid.filter(|_| is_there).map(|bssid| Event::Connected { bssid })
            }
            WantedRadio::Silent => None,
        };
        let reader = Arc::new(());
        let (listens, commands) = (Arc::downgrade(&reader), self.commands.clone());
        let read = move || read_events(number, events, &listens, &commands);
        let thread = thread::Builder::new().name("radio-events".to_owned()).spawn(read);
        thread.map_err(|source| ControlError::System { path: self.interface.as_str().into(), source })?;
        self.listened = Some(Listened { number, client, _reader: reader });
        if let Some(event) = before {
            self.happened(event);
        }
        Ok(())
    }

    fn request(&mut self, request: &WifiRequest) -> Result<(), RequestError> {
        let network = self.taken.as_ref().and_then(Taken::network);
        let Some(Listened { client, .. }) = &mut self.listened else {
            return Err(RequestError::Refused(format!("no program runs on `{}` now", self.interface)));
        };
        let no_station = || RequestError::Refused(format!("`{}` is no station now", self.interface));
        let network = || network.ok_or_else(no_station);
        let request: Request<()> = match request {
            WifiRequest::Scan { channels, stays: true } => wpa_supplicant::scan_only(channels),
            WifiRequest::Scan { channels, stays: false } => wpa_supplicant::scan(channels),
            WifiRequest::Roam { to, over_ds: false } => wpa_supplicant::roam(*to),
            WifiRequest::Roam { to, over_ds: true } => wpa_supplicant::roam_over_ds(*to),
            WifiRequest::Pin { to } => wpa_supplicant::pin(network()?, *to),
            WifiRequest::SetPassphrase { ssid, passphrase } => {
                wpa_supplicant::set_passphrase(network()?, ssid, passphrase)
            }
            WifiRequest::Rejoin => {
                client.request(&wpa_supplicant::disconnect()).map_err(refused)?;
                wpa_supplicant::reconnect()
            }
            WifiRequest::AskToMove { station, to, urgency } => hostapd::ask_to_move(*station, to, *urgency),
            WifiRequest::Disconnect { station, reason } => hostapd::deauthenticate(*station, *reason),
        };
        client.request(&request).map_err(refused)
    }

    fn happened(&mut self, event: Event) {
        tracing::debug!("{}: {event:?}", self.interface);
        if event == Event::ScanResults
            && let Some(Listened { client, .. }) = &mut self.listened
            && let Ok(mut heard) = client.request(&wpa_supplicant::scan_results())
        {
            heard.sort_by_key(|heard| std::cmp::Reverse(heard.signal_dbm));
            heard.truncate(MOST_HEARD);
            self.tell(Reported::Heard(self.interface.clone(), heard));
        }
        // Events for people alone stay here.
        if !matches!(event, Event::Other(_)) {
            self.tell(Reported::Happened(self.interface.clone(), event));
        }
    }

    /// Takes the end of the program, which is started again.
    fn gone(&mut self) {
        self.listened = None;
        let left = self.taken.as_mut().map_or(Ok(()), Taken::leave);
        let reason = left.err().map(|error| format!(": {error}")).unwrap_or_default();
        self.fail(format!("its program has ended{reason}"));
    }

    fn fail(&mut self, reason: String) {
        if !self.has_failed {
            tracing::warn!("{}: {reason}; trying again", self.interface);
        }
        self.has_failed = true;
        self.tell_state(Some(RadioState::Failed(reason)));
    }

    fn tell_state(&self, state: Option<RadioState>) {
        self.tell(Reported::State(self.interface.clone(), self.wanted.0, state));
    }

    fn tell(&self, reported: Reported) {
        // Fails only if the agent ends.
        let _ = self.report.send(reported);
        (self.wake)();
    }
}

fn refused(error: ControlError) -> RequestError {
    match error {
        ControlError::Answer { error: AnswerError::Busy, .. } => RequestError::Busy,
        error => RequestError::Refused(error.to_string()),
    }
}

/// Passes events on, as long as somebody listens and the program runs.
fn read_events(number: u64, mut events: Events, listens: &Weak<()>, commands: &mpsc::Sender<Command>) {
    while listens.strong_count() > 0 {
        let command = match events.next(LOOK) {
            Ok(Some(message)) => Command::Event(number, message.event),
            Ok(None) => continue,
            Err(_) => {
                let _ = commands.send(Command::Gone(number));
                return;
            }
        };
        if commands.send(command).is_err() {
            return;
        }
    }
}
