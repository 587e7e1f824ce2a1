//! Plug-ins.

use std::collections::HashSet;

use cotorra_graph::{
    BUNDLED_PLUGINS, DecidesIn, InstructionLimit, NodeId, PluginDistance, PluginId, PluginProgram,
    PluginSpec, Way,
};

use super::builder::{Builder, each};
use crate::{
    records::{NodeRecord, PluginRecord},
    yaml::{
        Span,
        decode::{Either, Spanned},
    },
};

/// The name under which scheduled changes are instructions.
pub const SCHEDULE: &str = "schedule";
/// The name under which the command line instructs a run.
pub const COMMAND_LINE: &str = "command-line";

/// Most characters of a currency.
const LONGEST_CURRENCY: usize = 8;

impl Builder<'_> {
    /// The plug-ins. Those with a node need that of the core.
    pub(super) fn plugins(&mut self, core: Option<&NodeId>) -> Option<Vec<PluginSpec>> {
        let mut seen = HashSet::new();
        let plugins: Vec<Option<PluginSpec>> = each(&self.record.plugins, |entry| {
            let plugin = match &entry.value {
                Either::Short(name) => {
                    let program = self.bundled(&Spanned { value: name.clone(), span: entry.span.clone() })?;
                    let id = PluginId::new(name).expect("bundled plug-ins have names");
                    PluginSpec {
                        id,
                        program,
                        domain: None,
                        optional: false,
                        instructions_per_second: InstructionLimit::default(),
                        distance: PluginDistance::default(),
                        env: Vec::new(),
                        settings: serde_json::Map::new(),
                    }
                }
                Either::Long(record) => self.plugin(&entry.span, record, core)?,
            };
            if [SCHEDULE, COMMAND_LINE].contains(&plugin.id.as_str()) {
                self.sink
                    .error(&entry.span, format!("instructions of others have the name `{}`", plugin.id))
                    .help("give it another `id`, such as `id: my-plugin`");
            }
            if !seen.insert(plugin.id.clone()) {
                self.sink
                    .error(&entry.span, format!("the plug-in `{}` is here twice", plugin.id))
                    .help("remove one of them, or give it another `id`");
            }
            let enabled = !matches!(&entry.value, Either::Long(record) if !record.enabled);
            Some(enabled.then_some(plugin))
        })?;
        Some(plugins.into_iter().flatten().collect())
    }

    fn plugin(&mut self, span: &Span, record: &PluginRecord, core: Option<&NodeId>) -> Option<PluginSpec> {
        let program = match (&record.bundled, &record.command) {
            (Some(name), None) => self.bundled(name),
            (None, Some(command)) => self.command(command).map(PluginProgram::Command),
            _ => {
                self.sink
                    .error(span, "a plug-in runs either something bundled or a command")
                    .help("keep one of `bundled: probing` and `command: [program, argument]`");
                None
            }
        };
        let id = match (&record.id, &record.bundled) {
            (Some(id), _) => Some(id.value.clone()),
            (None, Some(bundled)) => PluginId::new(&bundled.value).ok(),
            (None, None) => {
                self.sink.error(span, "this plug-in has no name").help("add `id: my-plugin`");
                None
            }
        };
        let domain = match &record.domain {
            Some(domain) if matches!(program, Some(PluginProgram::Command(_))) => {
                self.sink
                    .error(&domain.span, "a program is bound to a domain by the token that it shows")
                    .help("leave out `domain`, and give the program that domain's token: docs/use/federation.md");
                None
            }
            Some(domain) => self.domain(Some(domain)).map(Some),
            None => Some(None),
        };
        let env = self.env(&record.env, !matches!(program, Some(PluginProgram::Bundled(_))));
        let way = self.way(record, core);
        let reads_history = record.settings.get("delays").is_some_and(|delays| delays == "history");
        if reads_history && way.as_ref().is_some_and(|way| *way != Way::None) {
            self.sink
                .error(span, "this plug-in reads the history, which has no distance from the core")
                .help("leave out `delays: history`, or `node` and `control_delay`");
        }
        let decides_in = record.decides_in.value.0;
        if decides_in.is_some_and(DecidesIn::is_measured)
            && matches!(program, Some(PluginProgram::Bundled(_)))
        {
            self.sink
                .error(&record.decides_in.span, "only of a program is the CPU time measured")
                .help(
                    "a bundled plug-in runs on the threads of virtual time, and its runs repeat to the byte: write a duration, \
                     such as `decides_in: 5 ms`",
                );
            return None;
        }
        Some(PluginSpec {
            id: id?,
            program: program?,
            domain: domain?,
            optional: record.optional,
            instructions_per_second: record.instructions_per_second,
            distance: PluginDistance { way: way?, decides_in },
            env: env?,
            settings: record.settings.clone(),
        })
    }

    /// The currency of all prices, if there is one.
    pub(super) fn currency(&mut self) -> Option<Option<String>> {
        let Some(currency) = &self.record.currency else { return Some(None) };
        let is_short = (1..=LONGEST_CURRENCY).contains(&currency.value.chars().count());
        if !is_short || currency.value.contains(|c: char| c.is_whitespace() || c.is_control() || c == ',') {
            self.sink.error(&currency.span, "this is no currency").help(format!(
                "write a word or a sign of at most {LONGEST_CURRENCY} characters, such as `EUR`"
            ));
            return None;
        }
        Some(Some(currency.value.clone()))
    }

    /// The core's node, or `None` if it has none; nothing if it is wrong.
    pub(super) fn core(&mut self) -> Option<Option<NodeId>> {
        match &self.record.core.node {
            Some(node) => self.emulated_server(node).map(Some),
            None => Some(None),
        }
    }

    fn way(&mut self, record: &PluginRecord, core: Option<&NodeId>) -> Option<Way> {
        match (&record.node, &record.control_delay) {
            (None, None) => Some(Way::None),
            (None, Some(delay)) if delay.value.is_zero() => Some(Way::None),
            (None, Some(delay)) => Some(Way::Delay { control_delay: delay.value }),
            (Some(_), Some(delay)) => {
                self.sink
                    .error(&delay.span, "the emulated network delays what goes between two nodes")
                    .help("leave out `control_delay`, or `node`");
                None
            }
            (Some(node), None) => {
                // Packets of a real server, and of a robot with a real radio, leave from a machine of their own.
                let is_emulated = |node: &NodeRecord| match node {
                    NodeRecord::Server(server) => server.agent.is_none(),
                    NodeRecord::Robot(robot) => robot.interface.is_none(),
                    _ => false,
                };
                let plugin = self.node_where(node, "emulated server or robot", is_emulated);
                let Some(core) = core else {
                    self.sink
                        .error(&node.span, "contexts come from the core, which has no node")
                        .help("add `core: { node: edge }`, with the emulated server that the core is on");
                    return None;
                };
                let plugin = plugin?;
                let is_beside = plugin == *core;
                Some(if is_beside { Way::None } else { Way::Nodes { core: core.clone(), plugin } })
            }
        }
    }

    fn bundled(&mut self, name: &Spanned<String>) -> Option<PluginProgram> {
        if BUNDLED_PLUGINS.contains(&name.value.as_str()) {
            return Some(PluginProgram::Bundled(name.value.clone()));
        }
        self.sink.unknown_name(&name.span, "bundled plug-in", &name.value, BUNDLED_PLUGINS.iter().copied());
        None
    }
}
