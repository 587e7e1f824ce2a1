//! The processes and sockets of Wi-Fi programs. One thread carries out the [`Manager`]'s actions. Each program has a further
//! thread, which starts it and passes its events on.

use std::{
    collections::BTreeMap,
    io,
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, mpsc},
    thread,
    time::Duration,
};

use cotorra_engine::Process;
use cotorra_graph::{Event, NodeId};
use cotorra_wifi::{
    AnswerError, Client, ControlError, Daemon, Event as WifiEvent, Events, StartError, hostapd,
    wpa_supplicant,
};
use parking_lot::Mutex;

use super::{
    Begun,
    manager::{Action, Change, Configuration, Input, Manager, Program, Refused, Request},
    next_message,
};
use crate::clock::Clock;

/// Time that a program has for an answer. Others wait meanwhile.
const ANSWER: Duration = Duration::from_secs(2);
/// Interval of checks whether a program runs that reports nothing.
const CHECK: Duration = Duration::from_millis(250);

/// Number of the one network in a robot's configuration.
const NETWORK: u32 = 0;

/// Starts a program in a node, and returns its process.
pub(crate) type Launch = Arc<dyn Fn(&NodeId, Command) -> io::Result<Box<dyn Process>> + Send + Sync>;

/// Parts of a run that the programs need.
pub(crate) struct Surroundings {
    /// The run's clock.
    pub(crate) now: Clock,
    /// Starts a program.
    pub(crate) launch: Launch,
    /// Folder of the programs' logs.
    pub(crate) logs: PathBuf,
    /// Changes the emulated network; returns the reason if it refuses.
    pub(crate) change: Box<dyn FnMut(Change) -> Result<(), String> + Send>,
    /// Reports an event to the core.
    pub(crate) report: Box<dyn FnMut(Event) + Send>,
}

/// A message to the thread that carries out actions.
pub(super) enum Message {
    /// There may be actions.
    Wake,
    /// Stop all programs.
    Stop,
    /// A program answers.
    Started(Start, Box<Started>),
    /// A program cannot be started.
    Failed(Start, StartError),
    /// A program reports an event.
    Event(Start, WifiEvent),
    /// A program has ended.
    Gone(Start),
}

/// A start of a program. Each has another number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Start {
    program: Program,
    number: u64,
}

/// A program that answers.
pub(super) struct Started {
    daemon: Daemon,
    client: Client,
    /// Its deeds before its events could be read.
    before: Option<WifiEvent>,
}

/// A program that is being started, or answers.
struct Slot {
    number: u64,
    running: Option<(Daemon, Client)>,
}

/// The thread that carries out actions.
pub(super) struct Programs {
    manager: Arc<Mutex<Manager>>,
    surroundings: Surroundings,
    folder: PathBuf,
    inbox: mpsc::Sender<Message>,
    messages: mpsc::Receiver<Message>,
    slots: BTreeMap<Program, Slot>,
    starts: u64,
    threads: Vec<thread::JoinHandle<()>>,
}

impl Programs {
    pub(super) fn new(
        manager: Arc<Mutex<Manager>>,
        surroundings: Surroundings,
        folder: PathBuf,
        (inbox, messages): (mpsc::Sender<Message>, mpsc::Receiver<Message>),
    ) -> Self {
        Self {
            manager,
            surroundings,
            folder,
            inbox,
            messages,
            slots: BTreeMap::new(),
            starts: 0,
            threads: Vec::new(),
        }
    }

    /// Carries out actions until [`Message::Stop`]. Reports once that all is up, or why not.
    pub(super) fn run(mut self, begun: &Begun) {
        let mut begun = Some(begun);
        loop {
            self.manager.lock().advance((self.surroundings.now)());
            self.act();
            match next_message(&self.manager, &self.surroundings.now, &self.messages, &mut begun) {
                Err(mpsc::RecvTimeoutError::Timeout) | Ok(Message::Wake) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) | Ok(Message::Stop) => break,
                Ok(message) => self.take(message),
            }
        }
        self.manager.lock().stop();
        self.act();
        // Programs that are still being started find no receiver, and stop.
        let Self { threads, messages, slots, .. } = self;
        drop((messages, slots));
        for thread in threads {
            _ = thread.join();
        }
    }

    /// Takes a message of a program's thread.
    fn take(&mut self, message: Message) {
        match message {
            Message::Wake | Message::Stop => {}
            Message::Started(start, started) => {
                let Some(slot) = self.slot(&start) else { return };
                let Started { daemon, client, before } = *started;
                slot.running = Some((daemon, client));
                self.handle(Input::Started(start.program.clone()));
                if let Some(event) = before {
                    self.handle(Input::Event { program: start.program, event });
                }
            }
            Message::Failed(start, error) => {
                if self.slot(&start).is_some() {
                    self.slots.remove(&start.program);
                    self.handle(Input::Ended { program: start.program, reason: error.to_string() });
                }
            }
            Message::Event(start, event) => {
                if self.slot(&start).is_some() {
                    tracing::debug!("{}: {event:?}", start.program);
                    self.handle(Input::Event { program: start.program, event });
                }
            }
            Message::Gone(start) => {
                if self.slot(&start).is_none() {
                    return;
                }
                let running = self.slots.remove(&start.program).and_then(|slot| slot.running);
                let status = running.and_then(|(mut daemon, _)| daemon.ended().ok().flatten());
                let reason = match status {
                    Some(status) => format!("it ended with {status}"),
                    None => "it does not answer any more".to_owned(),
                };
                self.handle(Input::Ended { program: start.program, reason });
            }
        }
    }

    /// Returns the slot of a start, unless it was stopped since.
    fn slot(&mut self, start: &Start) -> Option<&mut Slot> {
        self.slots.get_mut(&start.program).filter(|slot| slot.number == start.number)
    }

    fn handle(&mut self, input: Input) {
        self.manager.lock().handle((self.surroundings.now)(), input);
    }

    /// Carries out the manager's actions.
    fn act(&mut self) {
        loop {
            let Some(action) = self.manager.lock().poll_action() else { return };
            match action {
                Action::Start { program, configuration } => self.start(program, configuration),
                Action::Stop(program) => drop(self.slots.remove(&program)),
                Action::Request { program, request } => self.request(program, request),
                Action::Change(change) => {
                    if let Err(reason) = (self.surroundings.change)(change.clone()) {
                        tracing::debug!("the emulated network refused {change:?}: {reason}");
                    }
                }
                Action::Report(event) => (self.surroundings.report)(event),
            }
        }
    }

    fn start(&mut self, program: Program, configuration: Configuration) {
        self.starts += 1;
        let start = Start { program: program.clone(), number: self.starts };
        self.slots.insert(program.clone(), Slot { number: self.starts, running: None });
        // Not the node's name, which may be too long for the path of a socket.
        let folder = self.folder.join(self.starts.to_string());
        let log = self.surroundings.logs.join(program.log());
        let (launch, inbox) = (Arc::clone(&self.surroundings.launch), self.inbox.clone());
        let name = format!("wifi-{}", program.node());
        let of_start = start.clone();
        let thread = thread::Builder::new()
            .name(name)
            .spawn(move || run_program(&of_start, &configuration, (&folder, &log), &launch, &inbox));
        self.threads.retain(|thread| !thread.is_finished());
        match thread {
            Ok(thread) => self.threads.push(thread),
            Err(error) => {
                self.slots.remove(&program);
                self.handle(Input::Ended { program, reason: format!("it has no thread: {error}") });
            }
        }
    }

    fn request(&mut self, program: Program, request: Request) {
        let slot = self.slots.get_mut(&program).and_then(|slot| slot.running.as_mut());
        let Some((_, client)) = slot else { return };
        let answer = match &request {
            Request::Roam { to, over_ds: false } => client.request(&wpa_supplicant::roam(*to)),
            Request::Roam { to, over_ds: true } => client.request(&wpa_supplicant::roam_over_ds(*to)),
            Request::Scan { channels, stays: true } => client.request(&wpa_supplicant::scan_only(channels)),
            Request::Scan { channels, stays: false } => client.request(&wpa_supplicant::scan(channels)),
            Request::Pin { to } => client.request(&wpa_supplicant::pin(NETWORK, *to)),
            Request::SetPassphrase { ssid, passphrase } => {
                client.request(&wpa_supplicant::set_passphrase(NETWORK, ssid, passphrase))
            }
            Request::Rejoin => client
                .request(&wpa_supplicant::disconnect())
                .and_then(|()| client.request(&wpa_supplicant::reconnect())),
            Request::Suggest { station, to } => client.request(&hostapd::ask_to_move(
                *station,
                std::slice::from_ref(&**to),
                hostapd::Urgency::Suggestion,
            )),
            Request::SetNeighbour(neighbour) => client.request(&hostapd::set_neighbour(neighbour)),
            Request::ReadHeard => match client.request(&wpa_supplicant::scan_results()) {
                Ok(heard) => return self.handle(Input::Heard { robot: program.node().clone(), heard }),
                Err(error) => Err(error),
            },
        };
        let reason = match answer {
            Ok(()) => return,
            Err(ControlError::Answer { error: AnswerError::Busy, .. }) => Refused::Busy,
            Err(ControlError::Answer { error, .. }) => Refused::Other(error.to_string()),
            Err(error) => Refused::Other(error.to_string()),
        };
        self.handle(Input::Refused { program, request, reason });
    }
}

/// Starts a program, and passes its events on until it ends.
fn run_program(
    start: &Start,
    configuration: &Configuration,
    files: (&Path, &Path),
    launch: &Launch,
    inbox: &mpsc::Sender<Message>,
) {
    let node = start.program.node();
    match begin(configuration, files, &mut |command| launch(node, command)) {
        Err(error) => _ = inbox.send(Message::Failed(start.clone(), error)),
        Ok((started, mut events)) => {
            let mut tells = inbox.send(Message::Started(start.clone(), Box::new(started))).is_ok();
            while tells {
                tells = match events.next(CHECK) {
                    Ok(Some(message)) => inbox.send(Message::Event(start.clone(), message.event)).is_ok(),
                    Ok(None) => true,
                    Err(_) => break,
                };
            }
            _ = inbox.send(Message::Gone(start.clone()));
        }
    }
}

/// Starts a program, and reads what it did before its events can be read.
fn begin(
    configuration: &Configuration,
    (folder, log): (&Path, &Path),
    launch: &mut cotorra_wifi::Launcher<'_>,
) -> Result<(Started, Events), StartError> {
    let daemon = match configuration {
        Configuration::AccessPoint(access_point) => {
            Daemon::hostapd_with_log(access_point, folder, log, launch)?
        }
        Configuration::Station(station) => Daemon::wpa_supplicant_with_log(station, folder, log, launch)?,
    };
    let mut client = daemon.client()?.with_timeout(ANSWER);
    let events = client.events()?;
    let before = match configuration {
        Configuration::AccessPoint(_) => {
            let status = client.request(&hostapd::status())?;
            (status.state == hostapd::State::Enabled).then_some(WifiEvent::AccessPointEnabled)
        }
        Configuration::Station(_) => {
            let status = client.request(&wpa_supplicant::status())?;
            let bssid = status.bssid.filter(|_| status.state == wpa_supplicant::State::Completed);
            bssid.map(|bssid| WifiEvent::Connected { bssid })
        }
    };
    Ok((Started { daemon, client, before }, events))
}
