//! What a plug-in author imports: contexts in, instructions out.
//!
//! A [`Plugin`] is a state machine without a clock: it is told the time with every event, says when it wants to be
//! woken next, and leaves its instructions in [`Actions`]. The same plug-in so runs against real and virtual time,
//! in process or behind the HTTP API: a program that calls [`client::run`] is one, too, once a testbed file names it
//! as a command, or it is started with the testbed's address in `COTORRA_API`.
//!
//! This one keeps robots off a radio unit, as long as they hear another:
//!
//! ```no_run
//! use cotorra_graph::{Event, Instruction, NodeId, Timestamp};
//! use cotorra_plugin::{Actions, Plugin, client};
//!
//! struct Avoid(NodeId);
//!
//! impl Plugin for Avoid {
//!     fn handle(&mut self, _now: Timestamp, event: &Event, actions: &mut Actions) {
//!         let Event::Robot(context) = event else { return };
//!         if context.attached_to() != Some(&self.0) {
//!             return;
//!         }
//!         let others = context.attachments.iter().filter(|a| !a.attached && a.signal.is_some());
//!         if let Some(other) = others.max_by(|a, b| a.signal.partial_cmp(&b.signal).expect("signals are numbers")) {
//!             let (robot, radio_unit) = (context.robot.clone(), other.radio_unit.clone());
//!             actions.instruct_because(Instruction::Attach { robot, radio_unit }, "it is to be avoided");
//!         }
//!     }
//! }
//!
//! client::run(&mut Avoid(NodeId::new("R4")?))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`messages`], [`vnf`] and [`wire`] are for VNFs, which talk to robots over the network under test.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod client;
pub mod messages;
pub mod runs;
pub mod settings;
pub mod vnf;
pub mod wire;

use cotorra_graph::{Event, Instruction, Testbed, Timestamp};

/// A plug-in: receives what happens, answers with instructions.
///
/// Calls come one at a time, with `now` never falling. A call that panics, that takes longer than the host's limit,
/// or that leaves more instructions than the host's limit gets the plug-in cut off; its robots stop.
pub trait Plugin: Send {
    /// The run goes on after another, which noted this of the plug-in ([`Instruction::Note`]): called once, before
    /// [`Plugin::start`]. The new run's history has these notes already. Programs of their own are not told.
    fn resume(&mut self, _noted: Vec<Noted>) {}

    /// Called once, before anything else but [`Plugin::resume`].
    fn start(&mut self, _now: Timestamp, _testbed: &Testbed, _actions: &mut Actions) {}

    /// Something happened.
    fn handle(&mut self, now: Timestamp, event: &Event, actions: &mut Actions);

    /// When [`Plugin::expire`] wants to be called; asked after each call. `None`: only events matter.
    fn next_deadline(&self) -> Option<Timestamp> {
        None
    }

    /// The deadline has come.
    fn expire(&mut self, _now: Timestamp, _actions: &mut Actions) {}
}

/// What a plug-in noted in an earlier run.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Noted {
    /// Of what.
    pub process: String,
    /// The step.
    pub step: String,
    /// Why, or what about it.
    pub reason: Option<String>,
}

/// What a plug-in wants done, in order.
#[derive(Debug, Clone, Default)]
pub struct Actions {
    wanted: Vec<(Instruction, Option<String>)>,
}

impl Actions {
    /// Asks for something.
    pub fn instruct(&mut self, instruction: Instruction) {
        self.wanted.push((instruction, None));
    }

    /// Asks for something and says why; the reason is kept with the decision.
    pub fn instruct_because(&mut self, instruction: Instruction, reason: impl Into<String>) {
        self.wanted.push((instruction, Some(reason.into())));
    }

    /// How many instructions wait.
    pub fn len(&self) -> usize {
        self.wanted.len()
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.wanted.is_empty()
    }

    /// Takes what was asked for, oldest first.
    pub fn drain(&mut self) -> impl Iterator<Item = (Instruction, Option<String>)> {
        self.wanted.drain(..)
    }
}
