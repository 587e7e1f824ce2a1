//! The thread of agents: the router, and the state of the protocol.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    path::PathBuf,
    sync::{Arc, mpsc},
    time::Duration,
};

use cotorra_agent_protocol::{
    Controller, ControllerEvent, LinkState, MachineReading, RadioEvent, RadioState, RequestError, RobotState,
    Run, Shipped, WantedRequest, WantedRobot,
};
use cotorra_agent_transport::{Credentials, FromAgent, Granted, Receiver, Router};
use cotorra_engine::EngineEvent;
use cotorra_enrolment::Authority;
use cotorra_graph::{AgentId, Event, NodeId, Stamped, Timestamp};
use parking_lot::Mutex;

use super::{command::Command, error::AgentsError, links::LinkReports, robot::Robots, today};
use crate::{
    clock::Clock,
    core::message::Message,
    wifi::{AtAgentsMessage, News, Place, Reading, Wish},
};

/// Interval of looking for enrolled, renewed and revoked agents.
const LOOK: Duration = Duration::from_secs(1);

/// Longest time at the end of a run for agents that report that something still ends, as a container of a busy engine may.
const LONGEST_END: Duration = Duration::from_secs(30);

/// State of the thread.
pub(super) struct Parts {
    pub(super) run: Run,
    pub(super) lease: Duration,
    pub(super) listen: SocketAddr,
    pub(super) authority: Authority,
    /// The node of each agent.
    pub(super) nodes: BTreeMap<AgentId, NodeId>,
    pub(super) wanted_robots: Vec<(AgentId, WantedRobot)>,
    pub(super) robots: Robots,
    pub(super) links: LinkReports,
    /// Receiver of news of Wi-Fi interfaces.
    pub(super) radios: mpsc::Sender<AtAgentsMessage>,
    pub(super) files: Vec<Shipped>,
    /// Paths of the files by their SHA-256.
    pub(super) paths: BTreeMap<String, PathBuf>,
    pub(super) now: Clock,
    pub(super) commands: mpsc::Sender<Command>,
    pub(super) events: mpsc::Sender<EngineEvent>,
    pub(super) messages: mpsc::Sender<Message>,
}

pub(super) struct Link {
    parts: Parts,
    controller: Arc<Mutex<Controller>>,
    /// Requests that are under way, by the controller's numbers, with those of the wishes.
    requests: BTreeMap<u64, u64>,
    /// Whether everything is being stopped.
    is_ending: bool,
    granted: Vec<Granted>,
    /// `None` if it could not be opened.
    router: Option<Router>,
}

impl Link {
    /// Listens for agents.
    pub(super) fn open(parts: Parts) -> Result<Self, AgentsError> {
        let granted = granted(&parts)?;
        let agents = parts.nodes.keys().cloned();
        let mut controller = Controller::new(parts.run, parts.lease, parts.files.clone(), agents);
        for (agent, robot) in &parts.wanted_robots {
            controller.drive(agent, robot.clone());
        }
        let controller = Arc::new(Mutex::new(controller));
        let router = Some(open(&parts, &granted, &controller)?);
        Ok(Self { parts, controller, requests: BTreeMap::new(), is_ending: false, granted, router })
    }

    /// Runs until it has to end, and all that it runs has been stopped.
    pub(super) fn run(mut self, inbox: &mpsc::Receiver<Command>) {
        let mut next_look = (self.parts.now)() + LOOK;
        let mut ends_at = None;
        for (agent, links) in self.parts.links.by_agent() {
            let names: Vec<_> = links.iter().map(|link| format!("`{link}`")).collect();
            let (noun, verb) = if names.len() == 1 { ("link", "waits") } else { ("links", "wait") };
            let message = format!("{noun} {} {verb} for agent `{agent}`", names.join(", "));
            self.tell((self.parts.now)(), Event::Notice { message });
        }
        loop {
            let now = (self.parts.now)();
            self.controller.lock().advance(now);
            self.send(now);
            self.report(now);
            if now >= next_look {
                next_look = now + LOOK;
                self.look();
            }
            if ends_at.is_some_and(|ends_at| now >= ends_at || self.controller.lock().is_settled()) {
                return;
            }
            let deadline =
                self.controller.lock().next_deadline().min(next_look).min(ends_at.unwrap_or(Timestamp::MAX));
            match inbox.recv_timeout(deadline.since((self.parts.now)())) {
                Ok(Command::End) | Err(mpsc::RecvTimeoutError::Disconnected) => {
                    self.controller.lock().stop_all();
                    self.is_ending = true;
                    ends_at = Some((self.parts.now)() + LONGEST_END);
                }
                Ok(command) => self.take(command),
                Err(mpsc::RecvTimeoutError::Timeout) => {}
            }
        }
    }

    fn take(&mut self, command: Command) {
        let now = (self.parts.now)();
        match command {
            Command::Start(agent, instance, wanted) => {
                // The engine starts instances on agents of this testbed only.
                if let Err(reason) = self.controller.lock().start(&agent, instance, *wanted) {
                    tracing::error!("{reason}");
                }
            }
            Command::Stop(instance) => self.controller.lock().stop(instance),
            Command::Emulate(agent, link, wanted) => self.controller.lock().emulate(&agent, link, *wanted),
            Command::Radio(place, wish) => self.wish(place, wish),
            Command::Arrived(agent, arrived, _waiting) => match arrived {
                FromAgent::Connection { boot, is_there } => {
                    self.controller.lock().connection(now, &agent, boot, is_there);
                }
                FromAgent::Report(report) => {
                    self.controller.lock().receive(now, &agent, report);
                    if let Some((boot, clock)) = self.controller.lock().process(&agent) {
                        self.parts.robots.follow(&agent, boot, clock);
                    }
                }
                // The router's thread took them. Only an agent with a robot has something to say of one.
                FromAgent::Context(_) | FromAgent::Reading(_) | FromAgent::Turn(_) => {}
                FromAgent::Rejected(reason) => tracing::warn!("agent `{agent}`: rejected {reason}"),
            },
            Command::Wake | Command::End => {}
        }
    }

    /// Hands a wish to an agent. In the end, all radios are their owners'.
    fn wish(&mut self, Place { agent, interface }: Place, wish: Wish) {
        if self.is_ending {
            return;
        }
        let mut controller = self.controller.lock();
        match wish {
            Wish::Use(wanted) => controller.use_radio(&agent, interface, wanted),
            Wish::Release => controller.release_radio(&agent, &interface),
            Wish::Request(number, request) => {
                match controller.request(&agent, WantedRequest { interface, request }) {
                    Ok(its) => drop(self.requests.insert(its, number)),
                    Err(reason) => {
                        drop(controller);
                        self.tell_radios(News::Answered(number, Err(RequestError::Refused(reason))));
                    }
                }
            }
        }
    }

    fn tell_radios(&self, news: News) {
        // There is no receiver in a testbed without real radios, or any more.
        _ = self.parts.radios.send(AtAgentsMessage::News(news));
    }

    fn send(&mut self, now: Timestamp) {
        loop {
            let Some(transmit) = self.controller.lock().poll_transmit(now) else { break };
            if let Some(router) = &self.router {
                router.send(&transmit);
            }
        }
        for (agent, command) in self.parts.robots.poll_commands() {
            if let Some(router) = &self.router {
                router.command(agent, &command);
            }
        }
    }

    fn report(&mut self, now: Timestamp) {
        loop {
            let Some(event) = self.controller.lock().poll_event() else { break };
            match event {
                ControllerEvent::Instance(event) => {
                    // The core may have ended.
                    let _ = self.parts.events.send(event);
                    let _ = self.parts.messages.send(Message::Wake);
                }
                ControllerEvent::Robot(agent, state) => {
                    let node = self.parts.nodes.get(&agent).map_or("", NodeId::as_str);
                    let message = match state {
                        RobotState::Driven => format!("robot {node}: agent `{agent}` has opened its ports"),
                        RobotState::Failed(reason) => format!("robot {node}: agent `{agent}`: {reason}"),
                    };
                    self.tell(now, Event::Notice { message });
                }
                ControllerEvent::Link(agent, link, state) => {
                    let message = match state {
                        LinkState::Applied => {
                            format!("link `{link}`: agent `{agent}` has applied its conditions")
                        }
                        LinkState::Failed(reason) => {
                            format!("link `{link}`: agent `{agent}` cannot apply its conditions: {reason}")
                        }
                    };
                    self.tell(now, Event::Notice { message });
                }
                ControllerEvent::Radio(agent, interface, state) => {
                    let message = match &state {
                        RadioState::Changing => None,
                        RadioState::Ready => Some(format!("`{interface}` at agent `{agent}` is as wanted")),
                        RadioState::Failed(reason) => {
                            Some(format!("`{interface}` at agent `{agent}` is not as wanted: {reason}"))
                        }
                    };
                    if let Some(message) = message {
                        self.tell(now, Event::Notice { message });
                    }
                    self.tell_radios(News::State(Place { agent, interface }, state));
                }
                ControllerEvent::Request(agent, number, answer) => {
                    tracing::debug!("agent `{agent}`: Wi-Fi request {number}: {answer:?}");
                    if let Some(number) = self.requests.remove(&number) {
                        self.tell_radios(News::Answered(number, answer));
                    }
                }
                ControllerEvent::Wifi(agent, RadioEvent { at_ns, interface, event, .. }) => {
                    let at = {
                        let controller = self.controller.lock();
                        let process = controller.process(&agent).map(|(boot, _)| boot);
                        process.and_then(|boot| controller.core_time(&agent, boot, at_ns))
                    };
                    let at = at.map_or(now, |at| at.measured.min(now));
                    self.tell_radios(News::Event(Place { agent, interface }, at, event));
                }
                ControllerEvent::Joined(agent) => {
                    self.parts.links.set_present(&agent, true);
                    self.tell(now, Event::Notice { message: format!("agent `{agent}` is connected") });
                    let boot = self.controller.lock().process(&agent).map(|(boot, _)| boot);
                    if let Some(boot) = boot {
                        self.tell_radios(News::Joined { agent, boot });
                    }
                }
                ControllerEvent::Left(agent, reason) => {
                    self.parts.links.set_present(&agent, false);
                    self.tell(now, Event::Notice { message: format!("agent `{agent}` is lost: {reason}") });
                    self.tell_radios(News::Left(agent, reason));
                }
            }
        }
    }

    fn tell(&self, at: Timestamp, event: Event) {
        let _ = self.parts.messages.send(Message::Network(Stamped { at, event }));
    }

    /// Opens the router anew if agents were enrolled, renewed or revoked. The others connect again within the lease.
    fn look(&mut self) {
        match granted(&self.parts) {
            Ok(granted) if granted != self.granted || self.router.is_none() => {
                // The address must be free.
                self.router = None;
                match open(&self.parts, &granted, &self.controller) {
                    Ok(router) => (self.router, self.granted) = (Some(router), granted),
                    Err(error) => tracing::error!("agents cannot connect: {error}"),
                }
            }
            Ok(_) => {}
            Err(error) => tracing::warn!("{error}"),
        }
    }
}

/// Returns which certificates may speak for agents of the testbed now.
fn granted(parts: &Parts) -> Result<Vec<Granted>, AgentsError> {
    let all = parts.authority.granted(today())?;
    let ours = all.into_iter().filter(|granted| parts.nodes.contains_key(&granted.name));
    Ok(ours.map(|granted| Granted { agent: granted.name, common_name: granted.common_name }).collect())
}

/// Opens the router. Contexts are taken on its thread, because a hop to another thread costs as much as the rest of their
/// way.
fn open(
    parts: &Parts,
    granted: &[Granted],
    controller: &Arc<Mutex<Controller>>,
) -> Result<Router, AgentsError> {
    let core = parts.authority.core(today())?;
    let credentials = Credentials {
        authority: &core.authority_pem,
        certificate: &core.certificate_pem,
        key: &core.key_pem,
    };
    let (commands, robots, now) = (parts.commands.clone(), parts.robots.clone(), Arc::clone(&parts.now));
    let contexts = Contexts {
        nodes: parts.nodes.clone(),
        links: parts.links.clone(),
        radios: parts.radios.clone(),
        controller: Arc::clone(controller),
        messages: parts.messages.clone(),
    };
    let receiver: Receiver = Arc::new(move |agent, arrived, waiting| {
        if let FromAgent::Context(bytes) = arrived {
            return contexts.take(now(), &agent, &bytes, waiting);
        }
        let (arrived, is_to_send) = robots.take(now(), &agent, arrived);
        // Fails only while the run ends.
        if let Some(arrived) = arrived {
            let _ = commands.send(Command::Arrived(agent, arrived, waiting));
        } else if is_to_send {
            let _ = commands.send(Command::Wake);
        }
    });
    Ok(Router::open(parts.listen, credentials, granted, parts.paths.clone(), &receiver)?)
}

/// Takes the contexts of agents' machines.
struct Contexts {
    nodes: BTreeMap<AgentId, NodeId>,
    links: LinkReports,
    radios: mpsc::Sender<AtAgentsMessage>,
    controller: Arc<Mutex<Controller>>,
    messages: mpsc::Sender<Message>,
}

impl Contexts {
    /// Reports the context of an agent's machine as that of its node.
    fn take(&self, now: Timestamp, agent: &AgentId, bytes: &[u8], waiting: Arc<()>) {
        let Some(node) = self.nodes.get(agent) else { return };
        match MachineReading::decode(bytes) {
            Ok(reading) if !reading.context.is_valid() => {
                tracing::warn!("agent `{agent}`: rejected a context beyond the bounds");
            }
            Ok(reading) => {
                let controller = self.controller.lock();
                if controller.process(agent).is_some_and(|(boot, _)| boot == reading.boot) {
                    self.links.read(agent, &reading);
                }
                let MachineReading { boot, read_ns, mut context, heard, addresses, .. } = reading;
                let reading = Reading { addresses, heard, wifi: context.wifi.clone() };
                _ = self.radios.send(AtAgentsMessage::News(News::Read(agent.clone(), reading)));
                context.node = node.clone();
                context.reading = controller.core_time(agent, boot, read_ns);
                drop(controller);
                let context = Stamped { at: now, event: Event::Machine(context) };
                // Fails only while the run ends.
                let _ = self.messages.send(Message::Machine { context, _waiting: waiting });
            }
            Err(error) => tracing::warn!("agent `{agent}`: rejected a context: {error}"),
        }
    }
}
