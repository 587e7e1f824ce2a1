//! State of a build: the record, its names, and what was reported.

use std::{
    collections::{HashMap, HashSet},
    path::Path,
    sync::Arc,
};

use cotorra_graph::{DomainId, NodeId, Trace, VnfId};

use crate::{
    records::{NodeRecord, TestbedRecord},
    yaml::{Sink, decode::Spanned, shorten},
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
    /// Names of VNFs in compose files so far.
    pub(super) composed: HashSet<VnfId>,
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

    /// The server of that name, which must be there and no real machine.
    pub(super) fn emulated_server(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        let is_emulated =
            |node: &NodeRecord| matches!(node, NodeRecord::Server(server) if server.agent.is_none());
        self.node_where(id, "emulated server", is_emulated)
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

    /// The variables that a command or an image's containers are to get.
    pub(super) fn env(&mut self, variables: &[Spanned<String>], runs_others: bool) -> Option<Vec<String>> {
        each(variables, |variable| {
            if !runs_others {
                self.sink
                    .error(&variable.span, "what is bundled gets no variables")
                    .help("leave out `env`: it has what it needs");
                return None;
            }
            is_variable(variable, self.sink).then(|| variable.value.clone())
        })
    }
}

/// Whether a text is `NAME` or `NAME=VALUE`; else that is reported.
pub(crate) fn is_variable(variable: &Spanned<String>, sink: &mut Sink) -> bool {
    let (name, value) = variable.value.split_once('=').unwrap_or((&variable.value, ""));
    let starts_well = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    let all_well = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !starts_well || !all_well || name.len() > LONGEST_VARIABLE {
        sink.error(&variable.span, format!("`{}` is not the name of a variable", shorten(name)))
            .help("write `NAME` for its value in cotorra's environment, or `NAME=VALUE`, such as `env: [DISPLAY, MODE=fast]`");
        return false;
    }
    if value.contains('\0') {
        sink.error(&variable.span, format!("the value of `{name}` has a null character"))
            .help("leave it out: no environment can hold it");
        return false;
    }
    true
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
