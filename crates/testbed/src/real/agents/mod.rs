//! Agents of a run: VNFs on real servers run there, robots have their ports there, links are emulated on interfaces there, and
//! real machines report their contexts, and serve and join wireless networks.
//!
//! A thread of its own owns the router and the protocol's state. It talks to the core by messages.

mod command;
#[cfg(test)]
mod contract_tests;
pub(crate) mod error;
mod link;
mod links;
mod robot;
mod shipped;

use std::{
    collections::BTreeMap,
    sync::{Arc, mpsc},
    thread,
};

use cotorra_agent_protocol::{LEASE, Run, WantedInstance, WantedRobot};
use cotorra_engine::{Engine, EngineEvent, InstanceId};
use cotorra_enrolment::Authority;
use cotorra_graph::{AgentId, LinkContext, Node, NodeId, Testbed, Vnf};
use cotorra_plugin::wire;

pub use self::error::AgentsError;
use self::{
    command::Command,
    link::Link,
    links::{LinkReports, LinksAtAgents},
    robot::Robots,
};
use crate::{
    clock::Clock,
    core::message::Message,
    options::AgentOptions,
    real::{network::AgentLinks, robots::AtAgents},
    report::RunFolder,
    wifi::{AtAgentsMessage, Place, Wish, Wishes},
};

/// Opens the authority of a testbed's agents, before a run has a folder; `None` if nothing needs one.
///
/// # Errors
/// [`AgentsError`], if a VNF starts on a real server whose agent may not connect, or a robot or link is at such an agent.
pub(crate) fn authority(testbed: &Testbed, options: &AgentOptions) -> Result<Option<Authority>, AgentsError> {
    if testbed.graph.agents().next().is_none() {
        return Ok(None);
    }
    let mut needed = testbed.agents_at_start().map(|(_, agent)| agent).peekable();
    let opened = options.authority.clone().or_else(Authority::default_folder);
    let opened = opened.ok_or(AgentsError::NoAuthority).and_then(|folder| Ok(Authority::open(folder)?));
    let authority = match opened {
        Err(error) if needed.peek().is_none() => {
            tracing::warn!("agents cannot connect: {error}");
            return Ok(None);
        }
        opened => opened?,
    };
    let granted = authority.granted(today())?;
    let is_granted = |agent: &AgentId| granted.iter().any(|granted| granted.name == *agent);
    for (node, agent) in testbed.graph.agents().filter(|(_, agent)| !is_granted(agent)) {
        tracing::warn!("agent `{agent}` of `{}` is not enrolled, and cannot connect", node.id);
    }
    match needed.find(|agent| !is_granted(agent)) {
        Some(agent) => Err(AgentsError::NotEnrolled(agent.clone())),
        None => Ok(Some(authority)),
    }
}

/// Returns the time of the calendar, at which certificates end.
#[allow(clippy::disallowed_methods, reason = "certificates end at a time of the calendar")]
fn today() -> chrono::DateTime<chrono::Utc> {
    chrono::Utc::now()
}

/// The engine of VNFs on real servers. Dropping it ends them.
pub(crate) struct AgentEngine {
    testbed: Arc<Testbed>,
    commands: mpsc::Sender<Command>,
    robots: Robots,
    links: LinkReports,
    events: mpsc::Receiver<EngineEvent>,
    /// Channel of news of real radios, until it is taken.
    radios: Option<(mpsc::Sender<AtAgentsMessage>, mpsc::Receiver<AtAgentsMessage>)>,
    thread: Option<thread::JoinHandle<()>>,
}

impl AgentEngine {
    /// Listens for the agents of a testbed. Reports their coming and going, and their contexts, as messages to the core.
    pub(crate) fn start(
        testbed: &Arc<Testbed>,
        options: &AgentOptions,
        authority: Authority,
        run: Run,
        folder: &RunFolder,
        now: &Clock,
        messages: &mpsc::Sender<Message>,
    ) -> Result<Self, AgentsError> {
        let (files, paths) = shipped::list(folder.path())?;
        let (commands, inbox) = mpsc::channel();
        let (report, events) = mpsc::channel();
        let radios = mpsc::channel();
        let robots = Robots::new(&testbed.graph, run);
        let links = LinkReports::new(&testbed.graph);
        let wanted_robots = testbed.graph.robots_at_agents().map(|(node, kobuki, agent)| {
            (agent.clone(), WantedRobot { node: node.id.clone(), kobuki: kobuki.clone() })
        });
        let link = Link::open(link::Parts {
            run,
            lease: LEASE,
            listen: options.listen,
            authority,
            nodes: testbed.graph.agents().map(|(node, agent)| (agent.clone(), node.id.clone())).collect(),
            wanted_robots: wanted_robots.collect(),
            robots: robots.clone(),
            links: links.clone(),
            radios: radios.0.clone(),
            files,
            paths,
            now: Arc::clone(now),
            commands: commands.clone(),
            events: report,
            messages: messages.clone(),
        })?;
        let thread = thread::Builder::new()
            .name("agents".to_owned())
            .spawn(move || link.run(&inbox))
            .map_err(AgentsError::Thread)?;
        let (testbed, radios) = (Arc::clone(testbed), Some(radios));
        Ok(Self { testbed, commands, robots, links, events, radios, thread: Some(thread) })
    }

    /// Takes where news of real radios go and arrive; `None` if somebody has them.
    pub(crate) fn take_radios(
        &mut self,
    ) -> Option<(mpsc::Sender<AtAgentsMessage>, mpsc::Receiver<AtAgentsMessage>)> {
        self.radios.take()
    }

    /// Returns what hands agents the wishes of the core for their radios.
    pub(crate) fn wishes(&self) -> Wishes {
        let commands = self.commands.clone();
        Box::new(move |place: &Place, wish: Wish| {
            // Fails only if the thread has ended, and has left all radios to their owners.
            _ = commands.send(Command::Radio(place.clone(), wish));
        })
    }

    /// Returns what drives each robot at an agent.
    pub(crate) fn robots(&self) -> AtAgents {
        self.robots.bodies(&self.testbed.graph, &self.commands)
    }

    /// Wants agents to emulate the links over their interfaces, which are in these states.
    pub(crate) fn links(&self, contexts: &[LinkContext]) -> Box<dyn AgentLinks> {
        let Testbed { graph, probes, .. } = &*self.testbed;
        let (reports, commands) = (self.links.clone(), self.commands.clone());
        Box::new(LinksAtAgents::begin(graph, contexts, *probes, reports, commands))
    }

    /// Returns the variables of a VNF's program.
    fn environment(&self, vnf: &Vnf, node: &NodeId) -> BTreeMap<String, String> {
        let of_vnf = |service: &&cotorra_graph::Service| service.vnfs.iter().any(|its| its.id == vnf.id);
        let robot = self.testbed.services.iter().find(of_vnf).map(|service| service.robot.to_string());
        let port = wire::port(&self.testbed, &vnf.id).map(|port| port.to_string());
        let ours = [(cotorra_vnfs::ROBOT, robot), (cotorra_vnfs::PORT, port)];
        let ours = ours.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?)));
        let ros = self.testbed.graph.ros1_environment(node);
        ros.into_iter().map(|(name, value)| (name.to_string(), value)).chain(ours).collect()
    }
}

impl Engine for AgentEngine {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, replica: u32, node: &NodeId) -> Result<(), String> {
        let real = self.testbed.graph.node(node).and_then(Node::real_server);
        let agent = &real.ok_or_else(|| format!("`{node}` has no agent"))?.agent;
        let wanted = WantedInstance {
            vnf: vnf.clone(),
            replica,
            node: node.clone(),
            environment: self.environment(vnf, node),
            keep: vnf.keep,
        };
        let command = Command::Start(agent.clone(), instance, Box::new(wanted));
        self.commands.send(command).map_err(|_| "the agents' thread has ended".to_owned())
    }

    fn stop(&mut self, instance: InstanceId) {
        // Fails only if the thread has ended, and all instances with it.
        let _ = self.commands.send(Command::Stop(instance));
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.events.try_recv().ok()
    }

    fn shut_down(&mut self) {
        let _ = self.commands.send(Command::End);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for AgentEngine {
    fn drop(&mut self) {
        self.shut_down();
    }
}
