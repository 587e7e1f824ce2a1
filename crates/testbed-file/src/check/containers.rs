//! Images run on nodes that have an engine for them.

use cotorra_graph::{Containers, EngineKind, Node, NodeKind, Testbed, Vnf};

use crate::{
    records::TestbedRecord,
    yaml::{Sink, Span, decode::words},
};

/// Nodes that are containers have an engine.
pub(super) fn hosts(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    for (id, node) in &record.nodes.0 {
        let Some(image) = node.whole().and_then(|whole| whole.container.image.as_ref()) else { continue };
        if testbed.containers.engine(&id.value) == EngineKind::Process {
            sink.error(&image.span, format!("`{}` runs no images: its engine is `process`", id.value))
                .help(AN_ENGINE);
        }
    }
}

const AN_ENGINE: &str = "write `engine: podman` or `engine: docker` at the node";

/// Whether a node runs images. Agents do not.
pub(super) fn runs_images(containers: &Containers, node: &Node) -> bool {
    containers.engine(&node.id) != EngineKind::Process && !is_real(node)
}

fn is_real(node: &Node) -> bool {
    matches!(&node.kind, NodeKind::Server(server) if server.real.is_some())
}

/// Reports an image on a node that runs none.
pub(super) fn no_image(place: &Span, vnf: &Vnf, node: &Node, able: &[&str], sink: &mut Sink) {
    let (what, others) = if is_real(node) {
        ("it is a real server, whose agent runs programs of its machine", "")
    } else {
        ("its engine is `process`", AN_ENGINE)
    };
    let place_it = format!("place `{}` on one of {}", vnf.id, words(able));
    let help = match (able, others) {
        ([], "") => "add an emulated server for it".to_owned(),
        ([], others) => others.to_owned(),
        (_, "") => place_it,
        (_, others) => format!("{place_it}, or {others}"),
    };
    sink.error(place, format!("`{}` runs no images: {what}", node.id)).help(help);
}
