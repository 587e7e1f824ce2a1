//! Images of VNFs, and nodes that are containers as a whole.

use std::{collections::HashSet, time::Duration};

use cotorra_graph::{Containers, Granted, Image, NodeId, Nodes, Program, Pull, Rights, Vnf, VnfId};

use super::builder::{Builder, each};
use crate::{
    records::{ContainerRecord, NodeRecord, WholeRecord},
    yaml::{Span, decode::Spanned},
};

impl ContainerRecord {
    /// The keys that only an image has, and their places.
    fn keys_of_image(&self) -> impl Iterator<Item = (&'static str, &Span)> {
        [
            ("volumes", self.volumes.as_ref().map(|its| &its.span)),
            ("devices", self.devices.as_ref().map(|its| &its.span)),
            ("ports", self.ports.as_ref().map(|its| &its.span)),
            ("pull", self.pull.as_ref().map(|its| &its.span)),
        ]
        .into_iter()
        .filter_map(|(key, span)| Some((key, span?)))
    }

    /// The keys that a command may have as well, and their places.
    fn keys_of_command(&self) -> impl Iterator<Item = (&'static str, &Span)> {
        let capabilities = &self.capabilities;
        [
            ("command", self.command.as_ref().map(|its| &its.span)),
            ("env", self.env.first().map(|its| &its.span)),
            ("capabilities", (!capabilities.value.is_empty()).then_some(&capabilities.span)),
        ]
        .into_iter()
        .filter_map(|(key, span)| Some((key, span?)))
    }
}

impl Builder<'_> {
    /// The image that a record names, if it names one; `None` for a mistake. `start` and `processing` are times of virtual
    /// time.
    pub(super) fn image(
        &mut self,
        record: &ContainerRecord,
        start: Duration,
        processing: Option<&Spanned<Duration>>,
    ) -> Option<Option<Image>> {
        let Some(reference) = &record.image else {
            let processing = processing.map(|time| ("processing_delay", &time.span));
            let given: Vec<_> = record.keys_of_image().chain(processing).collect();
            for (key, span) in &given {
                self.sink
                    .error(span, format!("only an `image` has `{key}`"))
                    .help(format!("add `image: NAME:TAG`, or leave out `{key}`"));
            }
            return given.is_empty().then_some(None);
        };
        let mut targets = HashSet::new();
        for volume in record.volumes.iter().flat_map(|volumes| &volumes.value) {
            if !targets.insert(&volume.value.target) {
                let target = volume.value.target.display();
                self.sink
                    .error(&volume.span, format!("two volumes at `{target}`"))
                    .help("give each a path of its own in the container");
            }
        }
        Some(Some(Image {
            reference: reference.value.0.clone(),
            pull: record.pull.as_ref().map_or(Pull::Missing, |pull| pull.value),
            volumes: record.volumes.iter().flat_map(|all| &all.value).map(|v| v.value.clone()).collect(),
            devices: record.devices.iter().flat_map(|all| &all.value).map(|d| d.0.clone()).collect(),
            ports: record.ports.iter().flat_map(|all| &all.value).copied().collect(),
            init: false,
            start,
            processing: processing.map_or(Duration::ZERO, |time| time.value),
        }))
    }

    /// The words of an image's command; none are the image's own.
    pub(super) fn words_in_image(&mut self, command: Option<&Spanned<Vec<String>>>) -> Option<Vec<String>> {
        let Some(command) = command else { return Some(Vec::new()) };
        if command.value.first().is_none_or(|program| program.trim().is_empty()) {
            self.sink
                .error(&command.span, "this command names no program")
                .help("leave out `command` for the image's own, or write `[program, argument, …]`");
            return None;
        }
        Some(command.value.clone())
    }

    /// The engines of nodes, and the nodes that are containers.
    pub(super) fn containers(&mut self) -> Option<Containers> {
        let nodes = &self.record.nodes.0;
        let engine = |whole: &WholeRecord| whole.engine.as_ref().map(|engine| engine.value);
        let engines = nodes.iter().filter_map(|(id, node)| Some((id.value.clone(), engine(node.whole()?)?)));
        let engines = engines.collect();
        let hosts: Vec<_> = each(nodes, |(id, node)| match node.whole() {
            Some(whole) => self.host_container(id, node, whole),
            None => Some(None),
        })?;
        Some(Containers { engine: self.record.engine, engines, hosts: hosts.into_iter().flatten().collect() })
    }

    /// The nodes without port security; `None` for a mistake.
    pub(super) fn without_port_security(&mut self) -> Option<Vec<NodeId>> {
        let nodes = &self.record.nodes.0;
        let without: Option<Vec<_>> = each(nodes, |(id, node)| {
            let Some(security) = node.whole().map(|whole| &whole.port_security) else { return Some(None) };
            if !security.value && matches!(node, NodeRecord::Server(server) if server.interface.is_some()) {
                self.sink
                    .error(
                        &security.span,
                        format!("`{}` is a real server, whose port is a gateway's", id.value),
                    )
                    .help("leave out `port_security`: only frames from its `address` pass a gateway");
                return None;
            }
            Some((!security.value).then(|| id.value.clone()))
        });
        Some(without?.into_iter().flatten().collect())
    }

    /// The container that a node is as a whole, if it is one; `None` for a mistake.
    fn host_container(
        &mut self,
        id: &Spanned<NodeId>,
        node: &NodeRecord,
        whole: &WholeRecord,
    ) -> Option<Option<Vnf>> {
        let record = &whole.container;
        let (cpus, memory, agent) = match node {
            NodeRecord::Robot(r) => (r.cpus, r.memory, r.agent.as_ref()),
            NodeRecord::RadioUnit(r) => (r.cpus, r.memory, None),
            NodeRecord::Server(s) => (s.cpus, s.memory, s.agent.as_ref()),
            NodeRecord::Switch(_) | NodeRecord::Gateway(_) | NodeRecord::Machine(_) => return Some(None),
        };
        if let (Some(engine), Some(agent), NodeRecord::Server(_)) = (&whole.engine, agent, node) {
            self.sink
                .error(
                    &engine.span,
                    format!("an engine of `{}`, which is at the agent `{}`", id.value, agent.value),
                )
                .help("leave out `engine`, and choose one there: `cotorra-agent run --images podman`");
        }
        let Some(image) = &record.image else {
            let given: Vec<_> = record.keys_of_command().chain(record.keys_of_image()).collect();
            for (key, span) in &given {
                self.sink.error(span, format!("only a node with an `image` has `{key}`")).help(
                    "add `image: NAME:TAG`; programs of your own on a node are VNFs, under `services:`",
                );
            }
            return given.is_empty().then_some(None);
        };
        if let Some(agent) = agent {
            let what = format!("`{}` is at the agent `{}`, and cannot be a container", id.value, agent.value);
            self.sink
                .error(&image.span, what)
                .help("leave out `image`, and place a VNF with an `image` there, or leave out the `agent`");
        }
        let image = self.image(record, Duration::ZERO, None);
        let words = self.words_in_image(record.command.as_ref());
        let env = self.env(&record.env, true);
        let granted = Granted { capabilities: record.capabilities.value.clone(), readable: Vec::new() };
        Some(Some(Vnf {
            id: VnfId::new(id.value.as_str()).expect("names of nodes and VNFs have the same rules"),
            program: Program::Host(words?),
            cpus: cpus.0,
            memory_bytes: memory.0,
            pinned_to: Some(id.value.clone()),
            node: Nodes::from(id.value.clone()),
            env: env?,
            rights: Rights::Confined(granted),
            keep: false,
            image: image?.map(Box::new),
            cpu_limit: None,
            start: Duration::ZERO,
            computing: None,
            state: None,
        }))
    }
}
