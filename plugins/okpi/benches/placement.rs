//! What decisions cost, and how that grows: `cargo bench -p cotorra-okpi`.

#[path = "../tests/common/mod.rs"]
mod common;

use std::num::NonZeroUsize;

use common::{context, corridor, generated, survey};
use cotorra_graph::Timestamp;
use cotorra_okpi::{Okpi, Search, place};
use cotorra_plugin::{Actions, Plugin};
use divan::Bencher;

fn main() {
    divan::main();
}

/// One location of the corridor, from event to instructions.
#[divan::bench]
fn corridor_decision(bencher: Bencher) {
    let (mut okpi, mut actions) =
        (Okpi::from_settings(&survey()).expect("the settings are right"), Actions::default());
    okpi.start(Timestamp::ZERO, &corridor(), &mut actions);
    let events = [context((27.2, -9.4), "R3"), context((26.4, -18.7), "R2")];
    let mut n = 0;
    bencher.bench_local(|| {
        n += 1;
        okpi.handle(Timestamp::ZERO, &events[n % 2], &mut actions);
        actions.drain().count()
    });
}

fn decision(bencher: Bencher, nodes: usize, vnfs: usize, gamma: u16, reliability: Option<f64>) {
    let (service, infrastructure) = generated(nodes, vnfs, reliability, 1);
    let search = Search { gamma, k_paths: NonZeroUsize::MIN, relax: false };
    place(&service, &infrastructure, search).expect("the generated service can be placed");
    bencher.bench_local(|| place(&service, &infrastructure, search));
}

/// |N| grows: 5 VNFs, γ = 10, one node in five a server.
#[divan::bench(args = [100, 300, 1000, 3000], sample_count = 20)]
fn nodes(bencher: Bencher, nodes: usize) {
    decision(bencher, nodes, 5, 10, None);
}

/// γ grows: 1000 nodes, 5 VNFs.
#[divan::bench(args = [3, 10, 30, 100], sample_count = 20)]
fn gamma(bencher: Bencher, gamma: u16) {
    decision(bencher, 1000, 5, gamma, None);
}

/// |V| grows: 1000 nodes, γ = 10.
#[divan::bench(args = [2, 3, 5, 8], sample_count = 20)]
fn vnfs(bencher: Bencher, vnfs: usize) {
    decision(bencher, 1000, vnfs, 10, None);
}

/// Service time and reliability, both: 5 VNFs, γ = 10.
#[divan::bench(args = [100, 300, 1000], sample_count = 20)]
fn nodes_with_two_kpis(bencher: Bencher, nodes: usize) {
    decision(bencher, nodes, 5, 10, Some(0.9));
}
