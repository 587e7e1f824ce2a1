//! Counts the instructions of each plug-in. One whose instructions are all rejected shows what happens without it.

use cotorra_graph::{Decision, PluginId, Testbed};
use serde::Serialize;

/// The instructions of a plug-in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PluginSummary {
    pub plugin: PluginId,
    /// Number of instructions that were applied.
    pub applied: usize,
    /// Number of instructions that were rejected.
    pub refused: usize,
    /// Reason for the last rejection.
    pub last_refusal: Option<String>,
}

impl PluginSummary {
    fn new(plugin: PluginId) -> Self {
        Self { plugin, applied: 0, refused: 0, last_refusal: None }
    }

    /// Describes the instructions, for people.
    pub fn sentence(&self) -> String {
        let Self { applied, refused, last_refusal, .. } = self;
        let all = applied + refused;
        let instructions = if all == 1 { "instruction" } else { "instructions" };
        let last = last_refusal.as_deref().unwrap_or_default();
        match (applied, refused) {
            (_, 0) => format!("{all} {instructions}"),
            (0, _) => format!("{all} {instructions}, all rejected, the last because {last}"),
            _ => format!("{all} {instructions}, {refused} of them rejected, the last because {last}"),
        }
    }
}

/// The instructions of all plug-ins.
#[derive(Debug)]
pub(super) struct Instructed(Vec<PluginSummary>);

impl Instructed {
    /// Starts with the plug-ins of the testbed file, in its order.
    pub(super) fn new(testbed: &Testbed) -> Self {
        Self(testbed.plugins.iter().map(|plugin| PluginSummary::new(plugin.id.clone())).collect())
    }

    pub(super) fn absorb(&mut self, decision: &Decision) {
        let place = self.0.iter().position(|its| its.plugin == decision.plugin).unwrap_or_else(|| {
            self.0.push(PluginSummary::new(decision.plugin.clone()));
            self.0.len() - 1
        });
        let its = &mut self.0[place];
        match &decision.refused {
            None => its.applied += 1,
            Some(reason) => {
                its.refused += 1;
                its.last_refusal = Some(reason.clone());
            }
        }
    }

    pub(super) fn summary(&self) -> Vec<PluginSummary> {
        self.0.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plugin_whose_instructions_are_rejected_says_why() {
        let mut instructed = Instructed(Vec::new());
        let mut gives = |plugin: &str, refused: Option<&str>| {
            instructed.absorb(&Decision {
                plugin: plugin.parse().unwrap(),
                instruction: cotorra_graph::Instruction::Scan { robot: "robot".parse().unwrap() },
                reason: None,
                refused: refused.map(str::to_owned),
            });
        };
        gives("a", Some("there is no robot `robot`"));
        gives("b", None);
        gives("c", None);
        gives("c", Some("it is away"));
        gives("c", None);
        let sentences: Vec<_> = instructed.summary().iter().map(PluginSummary::sentence).collect();
        assert_eq!(
            sentences,
            [
                "1 instruction, all rejected, the last because there is no robot `robot`",
                "1 instruction",
                "3 instructions, 1 of them rejected, the last because it is away"
            ]
        );
    }
}
