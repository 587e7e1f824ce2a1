//! State of a build: the record, its names, and what was reported.

use std::{collections::HashMap, path::Path, sync::Arc};

use cotorra_graph::{DomainId, NodeId, Trace};

use crate::{
    records::{NodeRecord, TestbedRecord},
    yaml::{Sink, decode::Spanned},
};

/// Characters of the longest name of a variable.
const LONGEST_VARIABLE: usize = 255;

pub(super) struct Builder<'a> {
    pub(super) record: &'a TestbedRecord,
    pub(super) base_dir: &'a Path,
    pub(super) domains: Vec<DomainId>,
    pub(super) nodes: HashMap<&'a str, &'a NodeRecord>,
    pub(super) networks: Vec<&'a str>,
    /// By path, so that a trace is read once and shared; `None` when it cannot be read.
    pub(super) traces: HashMap<String, Option<Arc<Trace>>>,
    pub(super) sink: &'a mut Sink,
}

impl Builder<'_> {
    /// The node of that name, which must be there.
    pub(super) fn node(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        self.node_where(id, "node", |_| true)
    }

    /// The node of that name with a port to the emulated network, which must be there.
    pub(super) fn host(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        self.node_where(id, "robot, radio unit or server", |node| {
            matches!(node, NodeRecord::Robot(_) | NodeRecord::RadioUnit(_) | NodeRecord::Server(_))
        })
    }

    /// The robot of that name, which must be there.
    pub(super) fn robot(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        self.node_where(id, "robot", |node| matches!(node, NodeRecord::Robot(_)))
    }

    pub(super) fn node_where(
        &mut self,
        id: &Spanned<NodeId>,
        what: &str,
        fits: impl Fn(&NodeRecord) -> bool,
    ) -> Option<NodeId> {
        find(&self.nodes, id, what, fits, self.sink)
    }

    pub(super) fn command(&mut self, command: &Spanned<Vec<String>>) -> Option<Vec<String>> {
        if command.value.first().is_none_or(|program| program.trim().is_empty()) {
            self.sink
                .error(&command.span, "this command names no program")
                .help("write `[program, argument, …]`, such as `[python3, server.py]`");
            return None;
        }
        Some(command.value.clone())
    }

    /// The variables that a command is to get.
    pub(super) fn env(&mut self, names: &[Spanned<String>], is_command: bool) -> Option<Vec<String>> {
        each(names, |name| {
            let starts_well = name.value.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
            let all_well = name.value.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            if !is_command {
                self.sink
                    .error(&name.span, "only a `command` gets variables")
                    .help("leave out `env`: what is bundled gets what it needs");
                None
            } else if !starts_well || !all_well || name.value.len() > LONGEST_VARIABLE {
                self.sink
                    .error(&name.span, format!("`{}` is not the name of a variable", name.value))
                    .help("write names alone, such as `env: [DISPLAY, MY_TOKEN]`: their values come from cotorra's environment");
                None
            } else {
                Some(name.value.clone())
            }
        })
    }
}

/// The node of that name among those that fit; else that is reported.
pub(super) fn find(
    nodes: &HashMap<&str, &NodeRecord>,
    id: &Spanned<NodeId>,
    what: &str,
    fits: impl Fn(&NodeRecord) -> bool,
    sink: &mut Sink,
) -> Option<NodeId> {
    if nodes.get(id.value.as_str()).is_some_and(|node| fits(node)) {
        return Some(id.value.clone());
    }
    let there: Vec<_> = nodes.iter().filter(|(_, node)| fits(node)).map(|(name, _)| *name).collect();
    sink.unknown_name(&id.span, what, id.value.as_str(), there.into_iter());
    None
}

/// Applies `f` to all before any that failed ends it, so that each one's mistakes show.
pub(super) fn each<T, U, C: FromIterator<U>>(items: &[T], mut f: impl FnMut(&T) -> Option<U>) -> Option<C> {
    let built: Vec<_> = items.iter().map(&mut f).collect();
    built.into_iter().collect()
}
