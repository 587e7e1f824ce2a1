//! The core's end: what is wanted of each agent, and what became of it.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use cotorra_engine::{EngineEvent, InstanceId, Outcome};
use cotorra_graph::{AgentId, LinkId, ReadingTime, Timestamp};
use cotorra_wifi::InterfaceName;

use crate::{
    clock::AgentClock,
    controller_event::ControllerEvent,
    link::{LinkState, WantedLink},
    message::{Beat, InstanceState, Report, Wanted, WantedInstance},
    robot::{RobotState, WantedRobot},
    run::Run,
    shipped::Shipped,
    wifi::{Origin, RemoteWifi, WantedRadio, WantedRequest},
};

/// Beats in each lease, so that some can be lost.
const BEATS_A_LEASE: u32 = 4;
/// Least time between two copies of one wanted state.
const AGAIN_AFTER: Duration = Duration::from_millis(100);

/// A message to send.
#[derive(Debug, Clone, PartialEq)]
pub enum Transmit {
    Wanted(AgentId, Box<Wanted>),
    Beat(AgentId, Beat),
}

/// Known state of a wanted instance.
#[derive(Debug)]
struct Known {
    wanted: WantedInstance,
    /// The generation that it came with.
    since: u64,
    is_ready: bool,
}

/// Known state of a wanted link.
#[derive(Debug)]
struct KnownLink {
    wanted: WantedLink,
    /// The generation that it came with.
    since: u64,
    /// The state that was reported last, since the agent's process is there.
    state: Option<LinkState>,
}

/// Known state of an agent.
#[derive(Debug, Default)]
struct Remote {
    instances: BTreeMap<u64, Known>,
    links: BTreeMap<LinkId, KnownLink>,
    wifi: RemoteWifi,
    robot: Option<WantedRobot>,
    /// State of the robot in its last report.
    robot_state: Option<RobotState>,
    generation: u64,
    /// The last generation that it reported for this run.
    reported: u64,
    /// Numbers of instances and links in its last report.
    running: usize,
    stopping: usize,
    emulated: usize,
    /// Time of its last report, while it is not lost.
    seen: Option<Timestamp>,
    boot: Option<u64>,
    clock: AgentClock,
    next_beat: Timestamp,
    /// The generation that was sent last, and when.
    sent: Option<(u64, Timestamp)>,
    must_send: bool,
}

impl Remote {
    fn change(&mut self) {
        self.generation += 1;
        self.must_send = true;
    }
}

/// Keeps what is wanted of each agent of a run, and follows their reports.
#[derive(Debug)]
pub struct Controller {
    run: Run,
    lease: Duration,
    files: Vec<Shipped>,
    agents: BTreeMap<AgentId, Remote>,
    events: VecDeque<ControllerEvent>,
    /// Number of the last request to a Wi-Fi program.
    last_request: u64,
}

impl Controller {
    /// Follows these agents in a run whose instances read these files.
    pub fn new(
        run: Run,
        lease: Duration,
        files: Vec<Shipped>,
        agents: impl IntoIterator<Item = AgentId>,
    ) -> Self {
        // Each agent has a wanted state from the start: nothing. It ends what an earlier run left there.
        let remote = || Remote { generation: 1, must_send: true, ..Remote::default() };
        let agents = agents.into_iter().map(|agent| (agent, remote())).collect();
        Self { run, lease, files, agents, events: VecDeque::new(), last_request: 0 }
    }

    /// Wants an instance to run. It starts when its agent reports.
    ///
    /// # Errors
    /// The reason, for people, if there is no such agent.
    pub fn start(
        &mut self,
        agent: &AgentId,
        instance: InstanceId,
        wanted: WantedInstance,
    ) -> Result<(), String> {
        let remote = self.agents.get_mut(agent).ok_or_else(|| format!("there is no agent `{agent}`"))?;
        remote.change();
        let since = remote.generation;
        remote.instances.insert(instance.0, Known { wanted, since, is_ready: false });
        Ok(())
    }

    /// Does not want an instance any more. Ignores unknown ones.
    pub fn stop(&mut self, instance: InstanceId) {
        for remote in self.agents.values_mut() {
            if remote.instances.remove(&instance.0).is_some() {
                remote.change();
            }
        }
    }

    /// Wants an agent to drive a robot. Ignores an unknown agent.
    pub fn drive(&mut self, agent: &AgentId, robot: WantedRobot) {
        if let Some(remote) = self.agents.get_mut(agent) {
            remote.robot = Some(robot);
            remote.change();
        }
    }

    /// Wants a link over an interface of an agent's machine to have these conditions. Ignores an unknown agent.
    pub fn emulate(&mut self, agent: &AgentId, link: LinkId, wanted: WantedLink) {
        let Some(remote) = self.agents.get_mut(agent) else { return };
        remote.change();
        let state = remote.links.remove(&link).and_then(|before| before.state);
        remote.links.insert(link, KnownLink { wanted, since: remote.generation, state });
    }

    /// Wants a Wi-Fi interface of an agent's machine to be like this. Ignores an unknown agent.
    pub fn use_radio(&mut self, agent: &AgentId, interface: InterfaceName, wanted: WantedRadio) {
        if let Some(remote) = self.agents.get_mut(agent) {
            remote.change();
            remote.wifi.want(interface, wanted, remote.generation);
        }
    }

    /// Leaves a Wi-Fi interface of an agent's machine to its owner again.
    pub fn release_radio(&mut self, agent: &AgentId, interface: &InterfaceName) {
        if let Some(remote) = self.agents.get_mut(agent)
            && remote.wifi.release(interface)
        {
            remote.change();
        }
    }

    /// Wants the program of a Wi-Fi interface to carry out a request once. Returns the number with which
    /// [`ControllerEvent::Request`] reports the outcome.
    ///
    /// # Errors
    /// The reason, for people, if the agent is not there, or has too much to do.
    pub fn request(&mut self, agent: &AgentId, wanted: WantedRequest) -> Result<u64, String> {
        let present = self.agents.get_mut(agent).filter(|remote| remote.seen.is_some());
        let remote = present.ok_or_else(|| format!("agent `{agent}` is not connected"))?;
        self.last_request += 1;
        remote.wifi.request(self.last_request, wanted, remote.generation + 1)?;
        remote.change();
        Ok(self.last_request)
    }

    /// Does not want anything any more.
    pub fn stop_all(&mut self) {
        for remote in self.agents.values_mut() {
            let had_robot = remote.robot.take().is_some();
            let had_links = !std::mem::take(&mut remote.links).is_empty();
            let had_wifi = remote.wifi.stop();
            if !std::mem::take(&mut remote.instances).is_empty() || had_robot || had_links || had_wifi {
                remote.change();
            }
        }
    }

    /// Whether every agent that reports has saved what is wanted, and does nothing else.
    pub fn is_settled(&self) -> bool {
        self.agents.values().filter(|remote| remote.seen.is_some()).all(|remote| {
            remote.reported == remote.generation
                && remote.running == remote.instances.len()
                && remote.stopping == 0
                && remote.emulated == remote.links.len()
                && remote.wifi.is_settled()
                && remote.robot_state.is_some() == remote.robot.is_some()
        })
    }

    /// Whether an agent reports.
    pub fn is_present(&self, agent: &AgentId) -> bool {
        self.agents.get(agent).is_some_and(|remote| remote.seen.is_some())
    }

    /// Returns the process of an agent that reported last, and its clock.
    pub fn process(&self, agent: &AgentId) -> Option<(u64, &AgentClock)> {
        let remote = self.agents.get(agent)?;
        Some((remote.boot?, &remote.clock))
    }

    /// Converts a time on the clock of an agent's process to the core's; `None` before that process answered a beat.
    pub fn core_time(&self, agent: &AgentId, boot: u64, agent_ns: u64) -> Option<ReadingTime> {
        let remote = self.agents.get(agent).filter(|remote| remote.boot == Some(boot))?;
        remote.clock.to_core(agent_ns)
    }

    /// Takes a report. Ignores that of an unknown agent.
    pub fn receive(&mut self, now: Timestamp, agent: &AgentId, report: Report) {
        let Some(remote) = self.agents.get_mut(agent) else { return };
        let is_new = remote.boot.replace(report.boot) != Some(report.boot);
        if is_new {
            remote.clock.reset();
            let was_ready = |known: &Known| known.is_ready;
            end(remote, &mut self.events, was_ready, "its agent was restarted");
            forget_links(remote);
            if remote.wifi.lose(agent, "its agent was restarted", &mut self.events) {
                remote.change();
            }
        }
        if remote.seen.replace(now).is_none() {
            self.events.push_back(ControllerEvent::Joined(agent.clone()));
        }
        if report.run != self.run {
            (remote.reported, remote.must_send) = (0, true);
            return;
        }
        if let Some(echo) = report.echo {
            remote.clock.receive(now, echo);
        }
        (remote.reported, remote.running, remote.stopping) =
            (report.generation, report.instances.len(), report.stopping);
        remote.emulated = report.links.len();
        for (link, known) in &mut remote.links {
            // Before that, the report is on other conditions.
            if report.generation < known.since {
                continue;
            }
            let state = report.links.get(link).cloned();
            if known.state != state {
                known.state.clone_from(&state);
                let event = state.map(|state| ControllerEvent::Link(agent.clone(), link.clone(), state));
                self.events.extend(event);
            }
        }
        if remote.robot_state != report.robot {
            remote.robot_state = report.robot;
            let state = remote.robot_state.clone().filter(|_| remote.robot.is_some());
            self.events.extend(state.map(|state| ControllerEvent::Robot(agent.clone(), state)));
        }
        let answered = report.echo.map(|echo| Timestamp::from_nanos(echo.sent_ns));
        let origin = Origin { boot: report.boot, generation: report.generation, answered };
        let mut has_ended = remote.wifi.receive(now, agent, origin, report.wifi, &mut self.events);
        let events = &mut self.events;
        remote.instances.retain(|id, known| {
            let mut tell = |outcome| {
                let event = EngineEvent { instance: InstanceId(*id), outcome };
                events.push_back(ControllerEvent::Instance(event));
            };
            let ended = match report.instances.get(id) {
                Some(InstanceState::Starting) => None,
                Some(InstanceState::Ready) => {
                    if !std::mem::replace(&mut known.is_ready, true) {
                        tell(Outcome::Ready);
                    }
                    None
                }
                Some(InstanceState::Died(reason) | InstanceState::Failed(reason)) => Some(reason.clone()),
                None if report.generation >= known.since => Some("its agent does not know it".to_owned()),
                None => None,
            };
            let Some(reason) = ended else { return true };
            tell(if known.is_ready { Outcome::Died(reason) } else { Outcome::Failed(reason) });
            has_ended = true;
            false
        });
        if has_ended {
            remote.change();
        }
        if remote.reported < remote.generation {
            remote.must_send = true;
        }
    }

    /// Takes the notice that the connection of an agent's process began or ended. Those of earlier processes can end late.
    pub fn connection(&mut self, now: Timestamp, agent: &AgentId, boot: u64, is_there: bool) {
        let Some(remote) = self.agents.get_mut(agent) else { return };
        if is_there {
            (remote.must_send, remote.sent, remote.next_beat) = (true, None, now);
        } else if remote.boot == Some(boot) {
            self.lose(agent, "its connection ended");
        }
    }

    /// Does what is due.
    pub fn advance(&mut self, now: Timestamp) {
        let is_late = |remote: &Remote| remote.seen.is_some_and(|seen| now >= seen + self.lease);
        let late: Vec<_> =
            self.agents.iter().filter(|(_, its)| is_late(its)).map(|(agent, _)| agent.clone()).collect();
        for agent in late {
            self.lose(&agent, &format!("it did not report for {:?}", self.lease));
        }
    }

    fn lose(&mut self, agent: &AgentId, reason: &str) {
        let Some(remote) = self.agents.get_mut(agent) else { return };
        if remote.seen.take().is_some() {
            remote.clock.reset();
            self.events.push_back(ControllerEvent::Left(agent.clone(), reason.to_owned()));
            let ends = |known: &Known| known.is_ready && !known.wanted.keep;
            let reason = format!("its agent `{agent}` is lost: {reason}");
            end(remote, &mut self.events, ends, &reason);
            forget_links(remote);
            if remote.wifi.lose(agent, &reason, &mut self.events) {
                remote.change();
            }
        }
    }

    /// Returns the next message to send.
    pub fn poll_transmit(&mut self, now: Timestamp) -> Option<Transmit> {
        let (run, lease) = (self.run, self.lease);
        for (agent, remote) in &mut self.agents {
            // A changed state is sent at once, and a copy not too often.
            let is_copy = |(generation, at)| generation == remote.generation && now < at + AGAIN_AFTER;
            if remote.must_send && !remote.sent.is_some_and(is_copy) {
                (remote.must_send, remote.sent) = (false, Some((remote.generation, now)));
                let instances = remote.instances.iter().map(|(id, known)| (*id, known.wanted.clone()));
                let wanted = Wanted {
                    run,
                    generation: remote.generation,
                    lease_ms: u32::try_from(lease.as_millis()).unwrap_or(u32::MAX),
                    files: self.files.clone(),
                    instances: instances.collect(),
                    robot: remote.robot.clone(),
                    links: remote
                        .links
                        .iter()
                        .map(|(id, known)| (id.clone(), known.wanted.clone()))
                        .collect(),
                    wifi: remote.wifi.wanted(),
                };
                return Some(Transmit::Wanted(agent.clone(), Box::new(wanted)));
            }
            if now >= remote.next_beat {
                remote.next_beat = now + lease / BEATS_A_LEASE;
                let last_event = remote.wifi.last_event();
                let beat = Beat { run, generation: remote.generation, sent_ns: now.as_nanos(), last_event };
                return Some(Transmit::Beat(agent.clone(), beat));
            }
        }
        None
    }

    /// Returns the next event, oldest first.
    pub fn poll_event(&mut self) -> Option<ControllerEvent> {
        self.events.pop_front()
    }

    /// Returns the time at which [`Self::advance`] or [`Self::poll_transmit`] has something to do.
    pub fn next_deadline(&self) -> Timestamp {
        let of = |remote: &Remote| {
            let lease = remote.seen.map_or(Timestamp::MAX, |seen| seen + self.lease);
            let send = match remote.sent {
                _ if !remote.must_send => Timestamp::MAX,
                Some((generation, at)) if generation == remote.generation => at + AGAIN_AFTER,
                _ => Timestamp::ZERO,
            };
            remote.next_beat.min(lease).min(send)
        };
        self.agents.values().map(of).min().unwrap_or(Timestamp::MAX)
    }
}

/// Forgets the states of an agent's links, which may have other conditions when it returns.
fn forget_links(remote: &mut Remote) {
    remote.links.values_mut().for_each(|known| known.state = None);
}

/// Ends the instances of an agent that `ends` chooses, and does not want them any more.
fn end(
    remote: &mut Remote,
    events: &mut VecDeque<ControllerEvent>,
    ends: impl Fn(&Known) -> bool,
    reason: &str,
) {
    let before = remote.instances.len();
    remote.instances.retain(|id, known| {
        let stays = !ends(known);
        if !stays {
            let outcome = Outcome::Died(reason.to_owned());
            events.push_back(ControllerEvent::Instance(EngineEvent { instance: InstanceId(*id), outcome }));
        }
        stays
    });
    if remote.instances.len() != before {
        remote.change();
    }
}
