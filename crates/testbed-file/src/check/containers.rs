//! Images run on nodes that have an engine for them.

use cotorra_graph::{Containers, EngineKind, Node, Testbed, Vnf};

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

/// Whether a node runs images. The agent of a real server says what it runs.
pub(super) fn runs_images(containers: &Containers, node: &Node) -> bool {
    node.real_server().is_some() || containers.engine(&node.id) != EngineKind::Process
}

/// Reports an image on a node that runs none.
pub(super) fn no_image(place: &Span, vnf: &Vnf, node: &Node, able: &[&str], sink: &mut Sink) {
    let help = match able {
        [] => AN_ENGINE.to_owned(),
        able => format!("place `{}` on one of {}, or {AN_ENGINE}", vnf.id, words(able)),
    };
    sink.error(place, format!("`{}` runs no images: its engine is `process`", node.id)).help(help);
}
