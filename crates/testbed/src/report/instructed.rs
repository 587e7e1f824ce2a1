//! Counts the instructions of each plug-in. One whose instructions are all rejected shows what happens without it.

use std::collections::BTreeMap;

use cotorra_graph::{ContextKind, Decision, PluginId, Staleness, Testbed, millis};
use cotorra_numbers::{Gathered, Quantiles};
use serde::Serialize;

/// The instructions of a plug-in.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PluginSummary {
    pub plugin: PluginId,
    /// Number of instructions that were applied.
    pub applied: usize,
    /// Number of instructions that were rejected.
    pub refused: usize,
    /// Reason for the last rejection.
    pub last_refusal: Option<String>,
    /// Ages of the contexts of its decisions, by kind, if it was away from the core.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub staleness: Vec<StalenessSummary>,
}

/// Ages of the contexts of one kind, over all decisions of a plug-in that knew one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StalenessSummary {
    /// Kind of the contexts.
    pub kind: ContextKind,
    /// Age of the youngest, milliseconds.
    pub youngest_ms: Option<Quantiles>,
    /// Age of the oldest, milliseconds.
    pub oldest_ms: Option<Quantiles>,
}

impl PluginSummary {
    fn new(plugin: PluginId) -> Self {
        Self { plugin, applied: 0, refused: 0, last_refusal: None, staleness: Vec::new() }
    }

    /// Describes the instructions, for people.
    pub fn sentence(&self) -> String {
        let median = |ages: Option<Quantiles>| ages.map_or(f64::NAN, |ages| ages.p50);
        let old = |its: &StalenessSummary| {
            let (youngest, oldest) = (median(its.youngest_ms), median(its.oldest_ms));
            format!("; {} contexts {youngest:.1} to {oldest:.1} ms old (medians)", its.kind)
        };
        self.instructions() + &self.staleness.iter().map(old).collect::<String>()
    }

    fn instructions(&self) -> String {
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
pub(super) struct Instructed {
    plugins: Vec<PluginSummary>,
    staleness: BTreeMap<(PluginId, ContextKind), Ages>,
}

/// Ages of the youngest and of the oldest context, milliseconds.
#[derive(Debug, Default)]
struct Ages {
    youngest: Gathered,
    oldest: Gathered,
}

impl Instructed {
    /// Starts with the plug-ins of the testbed file, in its order.
    pub(super) fn new(testbed: &Testbed) -> Self {
        let plugins = testbed.plugins.iter().map(|plugin| PluginSummary::new(plugin.id.clone())).collect();
        Self { plugins, staleness: BTreeMap::new() }
    }

    pub(super) fn absorb(&mut self, decision: &Decision) {
        let place = self.plugins.iter().position(|its| its.plugin == decision.plugin).unwrap_or_else(|| {
            self.plugins.push(PluginSummary::new(decision.plugin.clone()));
            self.plugins.len() - 1
        });
        let its = &mut self.plugins[place];
        match &decision.refused {
            None => its.applied += 1,
            Some(reason) => {
                its.refused += 1;
                its.last_refusal = Some(reason.clone());
            }
        }
    }

    pub(super) fn absorb_staleness(&mut self, staleness: &Staleness) {
        let Staleness { plugin, kind, youngest, oldest, .. } = staleness;
        let ages = self.staleness.entry((plugin.clone(), *kind)).or_default();
        ages.youngest.add(millis::of(*youngest));
        ages.oldest.add(millis::of(*oldest));
    }

    pub(super) fn summary(&self) -> Vec<PluginSummary> {
        let mut plugins = self.plugins.clone();
        for ((plugin, kind), Ages { youngest, oldest }) in &self.staleness {
            let its = plugins.iter_mut().find(|its| its.plugin == *plugin);
            let (youngest_ms, oldest_ms) = (Quantiles::gathered(youngest), Quantiles::gathered(oldest));
            let summary = StalenessSummary { kind: *kind, youngest_ms, oldest_ms };
            its.into_iter().for_each(|its| its.staleness.push(summary.clone()));
        }
        plugins
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_plugin_whose_instructions_are_rejected_says_why() {
        let mut instructed = Instructed { plugins: Vec::new(), staleness: BTreeMap::new() };
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

    #[test]
    fn a_plugin_that_is_away_says_how_old_its_contexts_were() {
        let plugin: PluginId = "far".parse().unwrap();
        let plugins = vec![PluginSummary::new(plugin.clone())];
        let mut instructed = Instructed { plugins, staleness: BTreeMap::new() };
        for ms in [100, 300, 200] {
            let (youngest, oldest) = (Duration::from_millis(ms), Duration::from_millis(2 * ms));
            let (plugin, kind) = (plugin.clone(), ContextKind::Robot);
            instructed.absorb_staleness(&Staleness { plugin, kind, contexts: 2, youngest, oldest });
        }
        let [summary] = &instructed.summary()[..] else { panic!("one plug-in") };
        let [its] = &summary.staleness[..] else { panic!("{summary:?}") };
        assert_eq!((its.youngest_ms.unwrap().max, its.oldest_ms.unwrap().p50), (300.0, 400.0));
        assert!(
            summary.sentence().ends_with("; robot contexts 200.0 to 400.0 ms old (medians)"),
            "{}",
            summary.sentence()
        );
    }
}
