//! Plug-ins.

use std::collections::HashSet;

use cotorra_graph::{BUNDLED_PLUGINS, InstructionLimit, PluginId, PluginProgram, PluginSpec};

use super::builder::{Builder, each};
use crate::{
    records::PluginRecord,
    yaml::{
        Span,
        decode::{Either, Spanned},
    },
};

/// The name under which scheduled changes are instructions.
pub const SCHEDULE: &str = "schedule";
/// The name under which the command line instructs a run.
pub const COMMAND_LINE: &str = "command-line";

impl Builder<'_> {
    pub(super) fn plugins(&mut self) -> Option<Vec<PluginSpec>> {
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
                        env: Vec::new(),
                        settings: serde_json::Map::new(),
                    }
                }
                Either::Long(record) => self.plugin(&entry.span, record)?,
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

    fn plugin(&mut self, span: &Span, record: &PluginRecord) -> Option<PluginSpec> {
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
        Some(PluginSpec {
            id: id?,
            program: program?,
            domain: domain?,
            optional: record.optional,
            instructions_per_second: record.instructions_per_second,
            env: env?,
            settings: record.settings.clone(),
        })
    }

    fn bundled(&mut self, name: &Spanned<String>) -> Option<PluginProgram> {
        if BUNDLED_PLUGINS.contains(&name.value.as_str()) {
            return Some(PluginProgram::Bundled(name.value.clone()));
        }
        self.sink.unknown_name(&name.span, "bundled plug-in", &name.value, BUNDLED_PLUGINS.iter().copied());
        None
    }
}
