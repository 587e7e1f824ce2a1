//! Wi-Fi programs at agents, which drive real radios.
//!
//! A thread carries out the [`Manager`]'s actions, as [`Programs`](super::programs::Programs) does in nodes of this machine.
//! Agents start their programs anew by themselves, and report what these do with times of their own.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, mpsc},
    time::Duration,
};

use cotorra_agent_protocol::{RadioState, RequestError, WantedRadio, WifiRequest};
use cotorra_graph::{AgentId, Event, HardwareGraph, NodeId, NodeKind, RadioKind, Timestamp, WifiContext};
use cotorra_wifi::{
    AccessPointSettings, Event as WifiEvent, InterfaceName, MacAddress, Power, StationSettings,
    hostapd::Urgency, wpa_supplicant::Heard,
};
use parking_lot::Mutex;

use super::{
    Begun,
    figures::{Figures, Read},
    manager::{Action, Change, Configuration, Input, Manager, Program, Refused, Request},
    next_message,
    plan::{Plan, PlanError, interface_of},
};
use crate::clock::Clock;

/// A Wi-Fi interface of an agent's machine.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Place {
    pub(crate) agent: AgentId,
    pub(crate) interface: InterfaceName,
}

/// Something that an agent is to do.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Wish {
    /// Make the interface so.
    Use(WantedRadio),
    /// Leave the interface to its owner.
    Release,
    /// Send its program a request. [`News::Answered`] has the number.
    Request(u64, WifiRequest),
}

/// Hands a wish to an agent.
pub(crate) type Wishes = Box<dyn FnMut(&Place, Wish) + Send>;

/// Something that agents say of radios.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum News {
    /// Readings of an agent's machine.
    Read(AgentId, Reading),
    /// A wanted interface has another state.
    State(Place, RadioState),
    /// A program reported an event, at this time.
    Event(Place, Timestamp, WifiEvent),
    /// Outcome of a request.
    Answered(u64, Result<(), RequestError>),
    /// A process of an agent reports, for the first time or again.
    Joined { agent: AgentId, boot: u64 },
    /// An agent is lost, with the reason.
    Left(AgentId, String),
}

/// Readings of a machine's Wi-Fi interfaces.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Reading {
    /// Addresses of those that its owner lends.
    pub(crate) addresses: BTreeMap<InterfaceName, MacAddress>,
    /// Access points that stations heard lately.
    pub(crate) heard: BTreeMap<InterfaceName, Vec<Heard>>,
    /// Its kernel's reports.
    pub(crate) wifi: Vec<WifiContext>,
}

/// A message to the thread that carries out actions.
pub(crate) enum Message {
    /// There may be actions.
    Wake,
    /// Leave all radios to their owners.
    Stop,
    News(News),
}

/// Receivers of what the programs do.
pub(crate) struct Outlets {
    /// The run's clock.
    pub(crate) now: Clock,
    /// Hands wishes to agents.
    pub(crate) wishes: Wishes,
    /// Changes the emulated network; returns the reason if it refuses.
    pub(crate) change: Box<dyn FnMut(Change) -> Result<(), String> + Send>,
    /// Reports an event to the core.
    pub(crate) report: Box<dyn FnMut(Event) + Send>,
}

/// Returns the real radios of a graph, by their nodes.
///
/// # Errors
/// [`PlanError::Interface`].
pub(super) fn places(graph: &HardwareGraph) -> Result<BTreeMap<NodeId, Place>, PlanError> {
    let radios = graph.nodes_with(RadioKind::Hardware).filter_map(|node| Some((node, node.radio()?)));
    let place = |(node, radio): (&cotorra_graph::Node, &cotorra_graph::RealRadio)| {
        let interface = interface_of(node)?;
        Ok((node.id.clone(), Place { agent: radio.agent.clone(), interface }))
    };
    radios.map(place).collect()
}

/// Returns the programs of a graph's real radios.
pub(super) fn programs(graph: &HardwareGraph, places: &BTreeMap<NodeId, Place>) -> BTreeMap<Program, Place> {
    let nodes = graph.nodes.iter().filter_map(|node| Some((node, places.get(&node.id)?)));
    let program = |(node, place): (&cotorra_graph::Node, &Place)| {
        let id = node.id.clone();
        let is_robot = matches!(node.kind, NodeKind::Robot(_));
        (if is_robot { Program::Supplicant(id) } else { Program::Hostapd(id) }, place.clone())
    };
    nodes.map(program).collect()
}

/// Waits until the address of each radio is known. Returns them, or the places that no agent reported in this time. What else
/// agents say meanwhile is about nothing that is wanted of them yet.
pub(super) fn await_addresses(
    places: &BTreeMap<NodeId, Place>,
    inbox: &mpsc::Receiver<Message>,
    now: &Clock,
    longest: Duration,
) -> Result<BTreeMap<NodeId, MacAddress>, Vec<(NodeId, Place)>> {
    let until = now() + longest;
    let mut addresses = BTreeMap::new();
    while addresses.len() < places.len() {
        let left = until.since(now());
        match inbox.recv_timeout(left) {
            Ok(Message::News(News::Read(agent, reading))) => {
                for (node, place) in places.iter().filter(|(_, place)| place.agent == agent) {
                    if let Some(address) = reading.addresses.get(&place.interface) {
                        addresses.insert(node.clone(), *address);
                    }
                }
            }
            Ok(_) => {}
            Err(_) => {
                let missing = places.iter().filter(|(node, _)| !addresses.contains_key(*node));
                return Err(missing.map(|(node, place)| (node.clone(), place.clone())).collect());
            }
        }
    }
    Ok(addresses)
}

/// Time that agents of robots have to answer, before radio units begin.
const AHEAD: Duration = Duration::from_secs(2);

/// State of a program at an agent.
#[derive(Debug, Default)]
struct Remote {
    /// Role that its agent was to give its interface; `None` leaves it to its owner.
    told: Option<WantedRadio>,
    /// Whether the manager wants it.
    is_wanted: bool,
    /// Whether the agent says that it is so.
    is_ready: bool,
    /// Whether the manager knows that.
    is_started: bool,
    /// The last event that says where it is: an access point serves, or a station is connected.
    standing: Option<WifiEvent>,
}

/// The programs of a run at agents.
pub(super) struct AtAgents {
    manager: Arc<Mutex<Manager>>,
    plan: Plan,
    outlets: Outlets,
    figures: Arc<Figures>,
    places: BTreeMap<Program, Place>,
    programs: BTreeMap<Program, Remote>,
    /// The last process of each agent.
    boots: BTreeMap<AgentId, u64>,
    requests: BTreeMap<u64, (Program, Request)>,
    last_request: u64,
}

impl AtAgents {
    pub(super) fn new(
        manager: Arc<Mutex<Manager>>,
        plan: Plan,
        outlets: Outlets,
        figures: Arc<Figures>,
        places: BTreeMap<Program, Place>,
    ) -> Self {
        let programs = places.keys().map(|program| (program.clone(), Remote::default())).collect();
        let (boots, requests) = (BTreeMap::new(), BTreeMap::new());
        Self { manager, plan, outlets, figures, places, programs, boots, requests, last_request: 0 }
    }

    /// Carries out actions until [`Message::Stop`]. Reports once that all is up, or why not.
    pub(super) fn run(mut self, inbox: &mpsc::Receiver<Message>, begun: &Begun) {
        let mut begun = Some(begun);
        let mut ahead = self.send_robots_ahead();
        let until = (self.outlets.now)() + AHEAD;
        while !ahead.is_empty() {
            match inbox.recv_timeout(until.since((self.outlets.now)())) {
                Ok(Message::News(news)) => {
                    if let News::State(place, _) = &news {
                        ahead.remove(place);
                    }
                    self.take(news);
                }
                Ok(Message::Wake) => {}
                Ok(Message::Stop) | Err(mpsc::RecvTimeoutError::Disconnected) => return,
                Err(mpsc::RecvTimeoutError::Timeout) => break,
            }
        }
        loop {
            let now = (self.outlets.now)();
            self.manager.lock().advance(now);
            self.act(now);
            match next_message(&self.manager, &self.outlets.now, inbox, &mut begun) {
                Err(mpsc::RecvTimeoutError::Timeout) | Ok(Message::Wake) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) | Ok(Message::Stop) => break,
                Ok(Message::News(news)) => self.take(news),
            }
        }
        self.manager.lock().stop();
        self.act((self.outlets.now)());
    }

    /// Tells agents of robots which network to join, before any serves: a robot may hear the core only by way of an access point
    /// of its owner's that is to serve the run. Returns where. Each answers with a state.
    fn send_robots_ahead(&mut self) -> BTreeSet<Place> {
        for (robot, planned) in self.plan.robots.clone() {
            let configuration = Configuration::Station(Box::new(planned.station));
            self.tell(&Program::Supplicant(robot), configuration);
        }
        let robots = self.places.iter().filter(|(program, _)| matches!(program, Program::Supplicant(_)));
        robots.map(|(_, place)| place.clone()).collect()
    }

    /// Takes what an agent says, and does what follows from it.
    fn take(&mut self, news: News) {
        let now = (self.outlets.now)();
        match news {
            News::Read(agent, reading) => self.read(now, &agent, &reading),
            News::State(place, state) => {
                for program in self.at(&place) {
                    match &state {
                        RadioState::Ready => self.begin(now, &program),
                        RadioState::Changing => self.lose(now, &program, "its agent begins it anew", false),
                        RadioState::Failed(reason) => self.lose(now, &program, reason, true),
                    }
                }
            }
            News::Event(place, at, event) => {
                for program in self.at(&place) {
                    tracing::debug!("{program}: {event:?}");
                    // An event comes before the state in the report that has both.
                    self.begin(at, &program);
                    let Some(remote) = self.programs.get_mut(&program) else { continue };
                    match event {
                        WifiEvent::AccessPointEnabled | WifiEvent::Connected { .. } => {
                            remote.standing = Some(event.clone());
                        }
                        WifiEvent::AccessPointDisabled | WifiEvent::Disconnected { .. } => {
                            remote.standing = None;
                        }
                        _ => {}
                    }
                    if remote.is_wanted {
                        self.handle(at, Input::Event { program, event: event.clone() });
                    }
                }
                self.act(at);
            }
            News::Answered(number, answer) => {
                let Some((program, request)) = self.requests.remove(&number) else { return };
                if let Err(error) = answer {
                    let reason = match error {
                        RequestError::Busy => Refused::Busy,
                        RequestError::Refused(reason) => Refused::Other(reason),
                    };
                    self.handle(now, Input::Refused { program, request, reason });
                }
            }
            // A process that was out of reach reports no event again.
            News::Joined { agent, boot } => {
                if self.boots.insert(agent.clone(), boot) != Some(boot) {
                    for program in self.of(&agent) {
                        self.programs.entry(program).or_default().standing = None;
                    }
                }
            }
            News::Left(agent, reason) => {
                for program in self.of(&agent) {
                    self.figures.forget(program.node());
                    let standing = self.programs.get(&program).and_then(|remote| remote.standing.clone());
                    self.lose(now, &program, &format!("its agent is lost: {reason}"), false);
                    self.programs.entry(program).or_default().standing = standing;
                }
            }
        }
    }

    /// Returns the programs of an agent.
    fn of(&self, agent: &AgentId) -> Vec<Program> {
        let its = self.places.iter().filter(|(_, place)| place.agent == *agent);
        its.map(|(program, _)| program.clone()).collect()
    }

    /// Returns the programs of an interface: one, or none.
    fn at(&self, place: &Place) -> Vec<Program> {
        let here = self.places.iter().filter(|(_, its)| *its == place);
        here.map(|(program, _)| program.clone()).collect()
    }

    fn handle(&self, at: Timestamp, input: Input) {
        self.manager.lock().handle(at, input);
    }

    fn read(&mut self, now: Timestamp, agent: &AgentId, reading: &Reading) {
        let its = self.places.iter().filter(|(_, place)| place.agent == *agent);
        for (program, Place { interface, .. }) in its {
            let wifi = reading.wifi.iter().find(|wifi| wifi.interface == interface.as_str()).cloned();
            let heard = reading.heard.get(interface).cloned().unwrap_or_default();
            let is_news = self.figures.read(now, program.node(), Read { wifi, heard: heard.clone() });
            if let (true, Program::Supplicant(robot)) = (is_news, program) {
                self.handle(now, Input::Heard { robot: robot.clone(), heard });
            }
        }
    }

    /// Records that a program answers.
    fn begin(&mut self, at: Timestamp, program: &Program) {
        let Some(remote) = self.programs.get_mut(program) else { return };
        remote.is_ready = true;
        if !remote.is_wanted || std::mem::replace(&mut remote.is_started, true) {
            return;
        }
        let standing = remote.standing.clone();
        self.handle(at, Input::Started(program.clone()));
        if let Some(event) = standing {
            self.handle(at, Input::Event { program: program.clone(), event });
        }
    }

    /// Records that a program does not answer. `has_failed` is whether it could not even be started.
    fn lose(&mut self, now: Timestamp, program: &Program, reason: &str, has_failed: bool) {
        let Some(remote) = self.programs.get_mut(program) else { return };
        let is_news = std::mem::take(&mut remote.is_started) || has_failed;
        (remote.is_ready, remote.standing) = (false, None);
        if is_news && remote.is_wanted {
            self.handle(now, Input::Ended { program: program.clone(), reason: reason.to_owned() });
        }
    }

    /// Carries out the manager's actions, which follow from something of this time.
    fn act(&mut self, at: Timestamp) {
        loop {
            let Some(action) = self.manager.lock().poll_action() else { return };
            match action {
                Action::Start { program, configuration } => self.start(at, &program, configuration),
                Action::Stop(program) => {
                    self.programs.insert(program.clone(), Remote::default());
                    self.wish(&program, Wish::Release);
                }
                Action::Request { program, request } => self.request(program, request),
                Action::Change(change) => {
                    // The emulated network takes the present for the end of a handover.
                    let late = (self.outlets.now)().since(at);
                    let change = match change {
                        Change::Associate { robot, radio_unit, began, fast } => {
                            Change::Associate { robot, radio_unit, began: began + late, fast }
                        }
                        change => change,
                    };
                    if let Err(reason) = (self.outlets.change)(change.clone()) {
                        tracing::debug!("the emulated network refused {change:?}: {reason}");
                    }
                }
                Action::Report(event) => (self.outlets.report)(event),
            }
        }
    }

    fn start(&mut self, at: Timestamp, program: &Program, configuration: Configuration) {
        self.tell(program, configuration);
        let Some(remote) = self.programs.get_mut(program) else { return };
        (remote.is_wanted, remote.is_started) = (true, false);
        if remote.is_ready {
            self.begin(at, program);
        }
    }

    /// Tells an agent what to make of an interface.
    fn tell(&mut self, program: &Program, configuration: Configuration) {
        let wanted = self.wanted(program, configuration);
        let Some(remote) = self.programs.get_mut(program) else { return };
        if remote.told.as_ref() != Some(&wanted) {
            (remote.is_ready, remote.standing) = (false, None);
            remote.told = Some(wanted.clone());
            self.wish(program, Wish::Use(wanted));
        }
    }

    fn wanted(&self, program: &Program, configuration: Configuration) -> WantedRadio {
        let power = |dbm: Option<f64>| dbm.map(|dbm| Power::AtMost((dbm * 100.0).round() as i32));
        match configuration {
            Configuration::AccessPoint(access_point) => {
                WantedRadio::AccessPoint(Box::new(AccessPointSettings {
                    radio: access_point.radio,
                    bss: access_point.bss,
                    virtual_aps: Vec::new(),
                    power: power(self.plan.units.get(program.node()).map(|unit| unit.power_dbm)),
                    neighbours: self.plan.neighbours(program.node()),
                }))
            }
            Configuration::Station(mut station) => WantedRadio::Station(Box::new(StationSettings {
                network: station.networks.swap_remove(0),
                power: power(self.plan.robots.get(program.node()).map(|robot| robot.power_dbm)),
            })),
        }
    }

    fn request(&mut self, program: Program, request: Request) {
        let wanted = match request.clone() {
            Request::Roam { to, over_ds } => WifiRequest::Roam { to, over_ds },
            Request::Scan { channels, stays } => WifiRequest::Scan { channels, stays },
            Request::Pin { to } => WifiRequest::Pin { to },
            Request::SetPassphrase { ssid, passphrase } => WifiRequest::SetPassphrase { ssid, passphrase },
            Request::Rejoin => WifiRequest::Rejoin,
            Request::Suggest { station, to } => {
                WifiRequest::AskToMove { station, to: vec![*to], urgency: Urgency::Suggestion }
            }
            // It comes with the next reading.
            Request::ReadHeard => return,
            // They are among its settings.
            Request::SetNeighbour(_) => return,
        };
        self.last_request += 1;
        let number = self.last_request;
        self.wish(&program, Wish::Request(number, wanted));
        self.requests.insert(number, (program, request));
    }

    fn wish(&mut self, program: &Program, wish: Wish) {
        if let Some(place) = self.places.get(program) {
            (self.outlets.wishes)(place, wish);
        }
    }
}

#[cfg(test)]
mod tests;
