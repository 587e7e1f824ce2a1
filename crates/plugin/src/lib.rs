//! Plug-ins of cotorra: contexts in, instructions out.
//!
//! A [`Plugin`] is a state machine without a clock. Every call carries the time, [`Plugin::next_deadline`] returns when to
//! call again, and instructions go into [`Actions`]. The same plug-in therefore runs in real and in virtual time, in process
//! or behind the HTTP API. To make a plug-in a program of its own, call [`client::run`]. Name the program as a command in a
//! testbed file, or start it with the testbed's address in `COTORRA_API`.
//!
//! This plug-in keeps robots off a radio unit as long as they hear another:
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
//!             actions.instruct_because(Instruction::Attach { robot, radio_unit }, "the radio unit is to be avoided");
//!         }
//!     }
//! }
//!
//! client::run(&mut Avoid(NodeId::new("R4")?))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`links`] has figures of links for plug-ins that compare them. [`vnf`], [`wire`] and [`convert`] are for VNFs, which talk to
//! robots over the network under test. [`coverage`] and [`departure`] are for those that foresee where a walk leaves the
//! coverage of a domain.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod client;
pub mod convert;
pub mod coverage;
pub mod departure;
pub mod links;
pub mod runs;
pub mod settings;
pub mod vnf;
pub mod wire;

use cotorra_graph::{Event, Instruction, Testbed, Timestamp};

/// A plug-in: receives events, answers with instructions.
///
/// Calls come one at a time, with `now` never falling. A call that panics, that takes longer than the host's limit,
/// or that leaves more instructions than the host's limit gets the plug-in cut off; its robots stop.
pub trait Plugin: Send {
    /// Called once before [`Plugin::start`] if the run goes on after another, with the plug-in's notes in that run
    /// ([`Instruction::Note`]). The new run's history has these notes already. Not called for programs of their own.
    fn resume(&mut self, _noted: Vec<Noted>) {}

    /// Called once, before anything else but [`Plugin::resume`].
    fn start(&mut self, _now: Timestamp, _testbed: &Testbed, _actions: &mut Actions) {}

    /// Handles an event.
    fn handle(&mut self, now: Timestamp, event: &Event, actions: &mut Actions);

    /// Returns when [`Plugin::expire`] is due; asked after each call. `None` waits for events only.
    fn next_deadline(&self) -> Option<Timestamp> {
        None
    }

    /// Handles the deadline of [`Plugin::next_deadline`].
    fn expire(&mut self, _now: Timestamp, _actions: &mut Actions) {}
}

/// Step that a plug-in noted in an earlier run.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Noted {
    /// Process that the step is of.
    pub process: String,
    /// The step.
    pub step: String,
    /// Reason or detail.
    pub reason: Option<String>,
}

/// Instructions of a plug-in, in order.
#[derive(Debug, Clone, Default)]
pub struct Actions {
    wanted: Vec<(Instruction, Option<String>)>,
}

impl Actions {
    /// Adds an instruction.
    pub fn instruct(&mut self, instruction: Instruction) {
        self.wanted.push((instruction, None));
    }

    /// Adds an instruction with its reason, which the decision records.
    pub fn instruct_because(&mut self, instruction: Instruction, reason: impl Into<String>) {
        self.wanted.push((instruction, Some(reason.into())));
    }

    /// Number of instructions.
    pub fn len(&self) -> usize {
        self.wanted.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.wanted.is_empty()
    }

    /// Removes and returns all instructions, oldest first.
    pub fn drain(&mut self) -> impl Iterator<Item = (Instruction, Option<String>)> {
        self.wanted.drain(..)
    }
}
