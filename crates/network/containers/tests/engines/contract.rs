//! podman and Docker keep the contract of all engines.

use cotorra_engine::contract;
use cotorra_graph::EngineKind;

use crate::lab::Lab;

fn keeps_the_contract(kind: EngineKind) {
    let Some(lab) = Lab::of(kind) else { return };
    contract::check(&lab);
    assert_eq!(lab.containers.names(), Vec::<String>::new());
}

#[test]
fn podman_keeps_the_contract_of_engines() {
    keeps_the_contract(EngineKind::Podman);
}

#[test]
fn docker_keeps_the_contract_of_engines() {
    keeps_the_contract(EngineKind::Docker);
}
