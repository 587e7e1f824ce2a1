//! Plug-ins that misbehave.

use std::{
    panic::resume_unwind,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};

use cotorra_graph::{Event, Instruction, Timestamp, Velocity};
use cotorra_plugin::{Actions, Plugin};

use super::plan::{Sabotage, Saboteur};

/// Time between moving a robot and misbehaving. The robot must stop afterwards.
const LEAD: Duration = Duration::from_millis(200);
/// Number of instructions in a flood.
const FLOOD: usize = 1500;

/// The deeds of a misbehaving plug-in, shared with the run.
#[derive(Clone, Default)]
pub(crate) struct Deeds {
    /// Number of instructions that it gave.
    given: Arc<AtomicUsize>,
    /// Whether the call that just returned simulates one that never returns.
    hangs: Arc<AtomicBool>,
}

impl Deeds {
    pub(crate) fn given(&self) -> usize {
        self.given.load(Ordering::Relaxed)
    }

    pub(crate) fn take_hang(&self) -> bool {
        self.hangs.swap(false, Ordering::Relaxed)
    }
}

/// A plug-in that moves a robot, and then misbehaves.
pub(crate) struct Misbehaving {
    saboteur: Saboteur,
    at: Timestamp,
    next: Option<Timestamp>,
    deeds: Deeds,
}

impl Misbehaving {
    pub(crate) fn new(saboteur: Saboteur, at: Timestamp, deeds: Deeds) -> Self {
        let first = Timestamp::ZERO + at.since(Timestamp::ZERO + LEAD);
        Self { saboteur, at, next: Some(first), deeds }
    }

    /// Gives an instruction; its reason is its number.
    fn ask(&self, instruction: Instruction, actions: &mut Actions) {
        let number = self.deeds.given.fetch_add(1, Ordering::Relaxed);
        actions.instruct_because(instruction, number.to_string());
    }
}

impl Plugin for Misbehaving {
    fn handle(&mut self, _now: Timestamp, _event: &Event, _actions: &mut Actions) {}

    fn next_deadline(&self) -> Option<Timestamp> {
        self.next
    }

    fn expire(&mut self, now: Timestamp, actions: &mut Actions) {
        if now < self.at {
            self.next = Some(self.at);
            let velocity = Velocity::planar(0.3, 0.2);
            let robot = self.saboteur.robot.clone();
            return self.ask(Instruction::Move { robot, velocity, waypoint: 0 }, actions);
        }
        self.next = None;
        match self.saboteur.how {
            // Avoids the message that `panic!` prints.
            Sabotage::Panic => resume_unwind(Box::new("by design")),
            Sabotage::Hang => self.deeds.hangs.store(true, Ordering::Relaxed),
            Sabotage::Flood => {
                for _ in 0..FLOOD {
                    let (process, step) = ("flood".to_owned(), "drop".to_owned());
                    self.ask(Instruction::Note { process, step, ago: None }, actions);
                }
            }
        }
    }
}
