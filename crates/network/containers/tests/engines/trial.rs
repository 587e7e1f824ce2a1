//! Trials of engines that run containers.

use cotorra_containers::{Address, try_out};
use cotorra_graph::EngineKind;
use cotorra_testing::containers::{BUSYBOX, Containers};

#[test]
fn an_engine_that_runs_a_container_passes_and_keeps_nothing_of_it() {
    for kind in [EngineKind::Podman, EngineKind::Docker] {
        let Some(containers) = Containers::start(kind) else { continue };
        assert_eq!(try_out(kind, &Address::Socket(containers.socket())), Ok(()), "{kind:?}");
        assert!(containers.names().is_empty(), "{kind:?}");
        let images = ["images", "--all", "--format", "{{.Repository}}:{{.Tag}}"];
        let images = containers.client().args(images).output().unwrap();
        assert_eq!(String::from_utf8(images.stdout).unwrap().trim(), BUSYBOX, "{kind:?}");
    }
}
