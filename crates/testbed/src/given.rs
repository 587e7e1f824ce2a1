//! Instructions with their givers.

use cotorra_graph::{Decision, Event, Instruction, PluginId};

/// An instruction as a plug-in, or a caller of the API, gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct Given {
    /// The giver.
    pub plugin: PluginId,
    /// The instruction.
    pub instruction: Instruction,
    /// Reason, which the decision records.
    pub reason: Option<String>,
}

impl Given {
    /// Creates an instruction without a reason.
    pub const fn new(plugin: PluginId, instruction: Instruction) -> Self {
        Self { plugin, instruction, reason: None }
    }

    /// Returns it as a program would send it.
    pub(crate) fn json(&self) -> Vec<u8> {
        let Self { instruction, reason, .. } = self;
        let json = serde_json::to_vec(&serde_json::json!({ "instruction": instruction, "reason": reason }));
        json.expect("instructions and texts are JSON")
    }

    /// Returns the decision about it; `refused` is the reason of a rejection.
    pub(crate) fn decided(self, refused: Option<String>) -> Event {
        let Self { plugin, instruction, reason } = self;
        Event::Decision(Decision { plugin, instruction, reason, refused })
    }
}
