//! Drives the robot that the core wants, on a thread of its own.

use std::{collections::VecDeque, sync::Arc, thread, time::Duration};

use cotorra_agent_protocol::{DrivenRobot, RobotCommand, RobotSession, RobotState, Run, WantedRobot};
use cotorra_agent_transport::RobotSender;
use cotorra_graph::Timestamp;
use cotorra_turtlebot::{Clock, Turtlebot};
use parking_lot::{Condvar, Mutex};

use crate::guard::Guard;

/// Commands that wait for the thread. The oldest are dropped.
const MOST_WAITING: usize = 64;
/// Interval of attempts to open ports.
const AGAIN: Duration = Duration::from_secs(1);

/// Input of a robot's thread.
#[derive(Default)]
pub(crate) struct Inbox {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    commands: VecDeque<RobotCommand>,
    sender: Option<RobotSender>,
    has_ended: bool,
}

impl Inbox {
    /// Takes a command of the core.
    pub(crate) fn push(&self, command: RobotCommand) {
        let commands = &mut self.state.lock().commands;
        if commands.len() == MOST_WAITING {
            commands.pop_front();
        }
        commands.push_back(command);
        self.changed.notify_all();
    }
}

/// A robot at open ports.
struct Driven {
    thread: thread::JoinHandle<()>,
    guard: Guard,
}

impl Driven {
    fn has_ended(&mut self) -> bool {
        self.thread.is_finished() || self.guard.has_ended()
    }
}

/// Opens and closes the ports of the wanted robot. When it is dropped, the robot is left at rest.
pub(crate) struct Robot {
    clock: Clock,
    boot: u64,
    /// Number of times that ports were opened.
    openings: u64,
    inbox: Arc<Inbox>,
    /// The robot that is wanted, and what became of it.
    wanted: Option<(Run, WantedRobot)>,
    driven: Result<Driven, String>,
    /// Time of the next attempt to open its ports.
    again: Timestamp,
}

impl Robot {
    pub(crate) fn new(clock: Clock, boot: u64) -> Self {
        let driven = Err("its ports were never opened".to_owned());
        let inbox = Arc::default();
        Self { clock, boot, openings: 0, inbox, wanted: None, driven, again: Timestamp::ZERO }
    }

    /// Returns where commands of the core arrive.
    pub(crate) fn inbox(&self) -> Arc<Inbox> {
        Arc::clone(&self.inbox)
    }

    /// Sends readings by this connection from now on.
    pub(crate) fn send_by(&self, sender: RobotSender) {
        self.inbox.state.lock().sender = Some(sender);
    }

    /// Drives this robot and no other. Returns its state.
    pub(crate) fn want(&mut self, now: Timestamp, wanted: Option<(Run, &WantedRobot)>) -> Option<RobotState> {
        let is_same = match (&self.wanted, wanted) {
            (Some((run, robot)), Some((its_run, its))) => *run == its_run && robot == its,
            (None, None) => true,
            _ => false,
        };
        if !is_same {
            self.close();
            self.wanted = wanted.map(|(run, robot)| (run, robot.clone()));
            self.again = now;
        }
        let (run, robot) = self.wanted.clone()?;
        if self.driven.as_mut().is_ok_and(Driven::has_ended) {
            self.close();
        }
        if self.driven.is_err() && now >= self.again {
            self.again = now + AGAIN;
            let opened = self.open(run, &robot);
            let before = std::mem::replace(&mut self.driven, opened);
            match &self.driven {
                Err(reason) if before.as_ref().err() != Some(reason) => {
                    tracing::warn!("robot `{}`: {reason}; trying again", robot.node);
                }
                Err(_) => {}
                Ok(_) => tracing::info!("driving robot `{}`", robot.node),
            }
        }
        Some(match &self.driven {
            Ok(_) => RobotState::Driven,
            Err(reason) => RobotState::Failed(reason.clone()),
        })
    }

    fn open(&mut self, run: Run, robot: &WantedRobot) -> Result<Driven, String> {
        // It is there before the robot can move.
        let guard = Guard::start(&robot.kobuki).map_err(|e| format!("its guard cannot be started: {e}"))?;
        let turtlebot =
            Turtlebot::open(robot.node.as_str(), &robot.kobuki, &self.clock).map_err(|e| e.to_string())?;
        self.openings += 1;
        let session = RobotSession { run, boot: self.boot, opening: self.openings };
        let (clock, inbox) = (Clock::clone(&self.clock), Arc::clone(&self.inbox));
        let driven = DrivenRobot::new(clock(), session, turtlebot);
        let drive = move || drive(driven, &clock, &inbox);
        let thread = thread::Builder::new().name("robot".to_owned()).spawn(drive);
        Ok(Driven { thread: thread.map_err(|e| format!("its thread cannot be started: {e}"))?, guard })
    }

    /// Leaves the robot at rest, and closes its ports.
    fn close(&mut self) {
        self.inbox.state.lock().has_ended = true;
        self.inbox.changed.notify_all();
        let closed = Err("its ports are closed".to_owned());
        if let Ok(Driven { thread, guard }) = std::mem::replace(&mut self.driven, closed) {
            // One that panicked left the robot at rest, too.
            let _ = thread.join();
            drop(guard);
        }
        let mut state = self.inbox.state.lock();
        state.has_ended = false;
        state.commands.clear();
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.close();
    }
}

/// Drives a robot until it receives the order to end.
fn drive(mut robot: DrivenRobot, clock: &Clock, inbox: &Inbox) {
    loop {
        let mut state = inbox.state.lock();
        while !state.has_ended && state.commands.is_empty() && clock() < robot.next_deadline() {
            let wait = robot.next_deadline().since(clock());
            inbox.changed.wait_for(&mut state, wait);
        }
        if state.has_ended {
            return;
        }
        let (commands, sender) = (std::mem::take(&mut state.commands), state.sender.clone());
        drop(state);
        for command in &commands {
            robot.receive(clock(), command);
        }
        if let (Some((reading, turn)), Some(sender)) = (robot.poll(clock()), sender) {
            sender.reading(&reading);
            turn.iter().for_each(|turn| sender.turn(turn));
        }
    }
}
