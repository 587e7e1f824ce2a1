//! An engine of podman or Docker, with two nodes.

use std::{
    fs,
    os::unix::fs::symlink,
    sync::{Arc, mpsc},
};

use cotorra_containers::{Address, ContainerEngine, Network, Settings, Surroundings};
use cotorra_datapath::Namespace;
use cotorra_engine::contract::Subject;
use cotorra_graph::{EngineKind, Image, NodeId, Pull};
use cotorra_testing::containers::{BUSYBOX, Containers};
use parking_lot::Mutex;
use tempfile::TempDir;

/// Two nodes with a network namespace each.
struct Nodes {
    namespaces: [(NodeId, Namespace); 2],
    wake: mpsc::Sender<()>,
}

impl Surroundings for Nodes {
    fn network(&self, node: &NodeId) -> Result<Network, String> {
        let found = self.namespaces.iter().find(|(id, _)| id == node).ok_or("no such node")?;
        Ok(Network::Namespace(found.1.path()))
    }

    fn wake(&self) {
        // The test may have ended.
        let _ = self.wake.send(());
    }
}

pub(crate) struct Lab {
    pub(crate) containers: Containers,
    kind: EngineKind,
    nodes: Arc<Nodes>,
    woken: Mutex<mpsc::Receiver<()>>,
    folder: TempDir,
}

impl Lab {
    pub(crate) fn of(kind: EngineKind) -> Option<Self> {
        let containers = Containers::start(kind)?;
        let (wake, woken) = mpsc::channel();
        let node = |name: &str| (NodeId::new(name).unwrap(), Namespace::new().unwrap());
        let nodes = Arc::new(Nodes { namespaces: [node("one"), node("two")], wake });
        let (woken, folder) = (Mutex::new(woken), tempfile::tempdir().unwrap());
        Some(Self { containers, kind, nodes, woken, folder })
    }
}

impl Subject for Lab {
    type Engine = ContainerEngine;

    fn engine(&self) -> ContainerEngine {
        let settings = Settings {
            kind: self.kind,
            address: Address::Socket(self.containers.socket()),
            folder: self.folder.path().to_owned(),
            logs: self.folder.path().to_owned(),
            guard: None,
        };
        let nodes: Arc<dyn Surroundings> = Arc::<Nodes>::clone(&self.nodes);
        ContainerEngine::new(settings, nodes).unwrap()
    }

    fn wait(&self) {
        self.woken.lock().recv().unwrap();
    }

    fn nodes(&self) -> [NodeId; 2] {
        [self.nodes.namespaces[0].0.clone(), self.nodes.namespaces[1].0.clone()]
    }

    fn image(&self) -> Option<Image> {
        Some(Image { reference: BUSYBOX.to_owned(), pull: Pull::Never, ..Image::default() })
    }

    fn log(&self, name: &str) -> String {
        fs::read_to_string(self.folder.path().join(format!("{name}.log"))).unwrap_or_default()
    }

    fn fill_disk(&self, log: &str) -> bool {
        symlink("/dev/full", self.folder.path().join(format!("{log}.log"))).is_ok()
    }
}
