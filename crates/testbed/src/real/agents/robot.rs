//! Robots whose ports are at agents, as drivers of the core's thread use them.

use std::{
    collections::BTreeMap,
    sync::{Arc, mpsc},
};

use cotorra_agent_protocol::{AgentClock, RemoteRobot, RobotCommand, Run};
use cotorra_agent_transport::FromAgent;
use cotorra_graph::{AgentId, HardwareGraph, RobotFault, Timestamp, Velocity};
use cotorra_turtlebot::{Body, Readings, rplidar::Turn};
use parking_lot::Mutex;

use super::command::Command;
use crate::real::robots::AtAgents;

/// The robots of a run at agents. Drivers, the agents' thread and the router's share them. Nothing waits: each robot keeps
/// its newest reading, turn and command.
#[derive(Clone, Default)]
pub(super) struct Robots(Arc<BTreeMap<AgentId, Mutex<RemoteRobot>>>);

impl Robots {
    /// Returns the robots of a graph.
    pub(super) fn new(graph: &HardwareGraph, run: Run) -> Self {
        let robot = |agent: &AgentId| (agent.clone(), Mutex::new(RemoteRobot::new(run)));
        Self(Arc::new(graph.robots_at_agents().map(|(_, _, agent)| robot(agent)).collect()))
    }

    /// Returns what drives each robot. `commands` leads to the agents' thread.
    pub(super) fn bodies(&self, graph: &HardwareGraph, commands: &mpsc::Sender<Command>) -> AtAgents {
        let body = |agent: &AgentId| -> Box<dyn Body> {
            Box::new(AgentBody { robots: self.clone(), agent: agent.clone(), commands: commands.clone() })
        };
        graph.robots_at_agents().map(|(node, _, agent)| (node.id.clone(), body(agent))).collect()
    }

    /// Takes what an agent's robot says. Returns everything else, and whether there is a command to send.
    pub(super) fn take(
        &self,
        now: Timestamp,
        agent: &AgentId,
        arrived: FromAgent,
    ) -> (Option<FromAgent>, bool) {
        let Some(robot) = self.0.get(agent) else { return (Some(arrived), false) };
        let mut robot = robot.lock();
        match arrived {
            FromAgent::Reading(reading) => {
                let waits = robot.has_command();
                robot.receive(now, *reading);
                (None, !waits && robot.has_command())
            }
            FromAgent::Turn(turn) => {
                robot.receive_turn(now, turn);
                (None, false)
            }
            arrived => (Some(arrived), false),
        }
    }

    /// Takes the process of an agent that reports, and its clock.
    pub(super) fn follow(&self, agent: &AgentId, boot: u64, clock: &AgentClock) {
        if let Some(robot) = self.0.get(agent) {
            robot.lock().follow(boot, clock.clone());
        }
    }

    /// Returns the commands to send.
    pub(super) fn poll_commands(&self) -> impl Iterator<Item = (&AgentId, RobotCommand)> {
        self.0.iter().filter_map(|(agent, robot)| Some((agent, robot.lock().poll_command()?)))
    }
}

/// A robot at an agent, for its driver.
struct AgentBody {
    robots: Robots,
    agent: AgentId,
    commands: mpsc::Sender<Command>,
}

impl AgentBody {
    fn with<R>(&self, call: impl FnOnce(&mut RemoteRobot) -> R) -> R {
        let mut robot = self.robots.0[&self.agent].lock();
        let waits = robot.has_command();
        let result = call(&mut robot);
        if !waits && robot.has_command() {
            // Fails only while the run ends, and the agent stops the robot then.
            let _ = self.commands.send(Command::Wake);
        }
        result
    }
}

impl Body for AgentBody {
    fn read(&mut self, now: Timestamp) -> Readings {
        self.with(|robot| robot.read(now))
    }

    fn turn(&self, known: Option<Timestamp>) -> Option<Turn> {
        self.with(|robot| robot.turn(known))
    }

    fn drive(&mut self, now: Timestamp, velocity: Velocity) -> Result<(), RobotFault> {
        self.with(|robot| robot.drive(now, velocity))
    }

    fn stop(&mut self, now: Timestamp) {
        self.with(|robot| robot.stop(now));
    }
}
