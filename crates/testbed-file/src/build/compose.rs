//! Compose files of services.

use std::path::Path;

use cotorra_graph::{NodeId, Vnf, VnfId};

use super::builder::{Builder, find};
use crate::{
    compose, file,
    records::ComposeRecord,
    yaml::{Sink, decode::Spanned},
};

impl Builder<'_> {
    /// Reads a compose file, whose services are VNFs.
    pub(super) fn compose(&mut self, record: &ComposeRecord) -> Option<Vec<Vnf>> {
        let node = self.node(&record.node);
        let name = &record.file.value;
        let text = match file::read_text_of(&self.base_dir.join(name), compose::MAX_FILE) {
            Ok(text) => text,
            Err(error) => {
                self.sink
                    .error(&record.file.span, format!("the compose file cannot be read: {error}"))
                    .help("check its path, from this file's folder");
                return None;
            }
        };
        let folder = Path::new(name).parent().unwrap_or(Path::new(""));
        let (nodes, composed) = (&self.nodes, &mut self.composed);
        let listed = self.record.services.0.iter().flat_map(|(_, service)| &service.vnfs.0);
        let check = |id: &Spanned<VnfId>, node: Option<&Spanned<NodeId>>, sink: &mut Sink| {
            let is_listed = listed.clone().any(|(vnf, _)| vnf.value == id.value);
            if !composed.insert(id.value.clone()) || is_listed {
                sink.error(&id.span, format!("there is another VNF `{}` in the testbed", id.value))
                    .help("rename one of them: VNFs of all services have names of their own");
            }
            if let Some(node) = node {
                find(nodes, node, "node", |_| true, sink);
            }
        };
        match compose::parse_with(name, &text, folder, &record.node.value, check) {
            Ok(vnfs) => node.map(|_| vnfs),
            Err(found) => {
                for d in found.list {
                    let message = format!("{name}:{}:{}: {}", d.line, d.column, d.message);
                    self.sink.error(&record.file.span, message).help(d.help.unwrap_or_default());
                }
                None
            }
        }
    }
}
