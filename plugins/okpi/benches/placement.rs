//! Time of decisions, over the size of the graph: `cargo bench -p cotorra-okpi`.

use std::time::Duration;

use cotorra_graph::Timestamp;
use cotorra_okpi::{Chain, Infrastructure, Okpi, Search, place};
use cotorra_plugin::{Actions, Plugin};
use cotorra_testing::{
    corridor,
    placement::{contested, context, generated, survey},
};
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
    let search = Search::at(gamma);
    place(&service, &infrastructure, search).expect("the generated service can be placed");
    bencher.bench_local(|| place(&service, &infrastructure, search));
}

/// |N| grows: 5 VNFs, γ = 10, one node in five a server; service time and reliability.
#[divan::bench(args = [10, 30, 100, 300, 1000], sample_count = 20)]
fn nodes(bencher: Bencher, nodes: usize) {
    decision(bencher, nodes, 5, 10, Some(0.9));
}

/// γ grows: 1000 nodes, 5 VNFs, service time and reliability.
#[divan::bench(args = [4, 10, 30, 100], sample_count = 20)]
fn gamma(bencher: Bencher, gamma: u16) {
    decision(bencher, 1000, 5, gamma, Some(0.9));
}

/// |V| grows: 1000 nodes, γ = 10, service time and reliability.
#[divan::bench(args = [1, 2, 3, 5, 8], sample_count = 20)]
fn vnfs(bencher: Bencher, vnfs: usize) {
    decision(bencher, 1000, vnfs, 10, Some(0.9));
}

/// Service time alone: 1000 nodes, 5 VNFs, γ = 10.
#[divan::bench(sample_count = 20)]
fn service_time_alone(bencher: Bencher) {
    decision(bencher, 1000, 5, 10, None);
}

/// The hardest that can be kept: the least service time for which there is a placement, to a tenth of a millisecond.
#[divan::bench(args = [100, 300, 1000], sample_count = 20)]
fn nodes_at_the_edge(bencher: Bencher, nodes: usize) {
    let (service, infrastructure) = at_the_edge(nodes, 0);
    bencher.bench_local(|| place(&service, &infrastructure, Search::at(10)).expect("it is just feasible"));
}

/// A tenth of a millisecond less, which nothing keeps: what is closest is sought, too.
#[divan::bench(args = [100, 300, 1000], sample_count = 20)]
fn nodes_beyond_the_edge(bencher: Bencher, nodes: usize) {
    let (service, infrastructure) = at_the_edge(nodes, 1);
    bencher.bench_local(|| place(&service, &infrastructure, Search::at(10)).expect_err("it is infeasible"));
}

/// Links so narrow that a service's own traffic fills them: other paths are sought, too.
#[divan::bench(args = [30, 100, 300, 1000], sample_count = 20)]
fn nodes_contested(bencher: Bencher, nodes: usize) {
    let (service, infrastructure) = contested(nodes, 1);
    bencher.bench_local(|| place(&service, &infrastructure, Search::at(10)));
}

fn at_the_edge(nodes: usize, beyond: u64) -> (Chain, Infrastructure) {
    let (service, infrastructure) = generated(nodes, 5, Some(0.9), 1);
    let within = |tenths| Chain { service_time: Duration::from_micros(100 * tenths), ..service.clone() };
    let keeps = |tenths: &u64| place(&within(*tenths), &infrastructure, Search::at(10)).is_ok();
    let least = (1..).find(keeps).expect("the generated service can be placed");
    (within(least - beyond), infrastructure)
}
