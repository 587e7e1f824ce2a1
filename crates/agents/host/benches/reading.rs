//! Time of one reading of this machine's context, which is CPU time: a reading never waits. Run with
//! `cargo bench -p cotorra-host`.

use std::time::Duration;

use cotorra_host::{Host, NodeId, Reading, Timestamp};
use divan::{AllocProfiler, Bencher};

#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

fn main() {
    divan::main();
}

#[divan::bench]
fn reading(bencher: Bencher) {
    let node: NodeId = "machine".parse().expect("letters make a name");
    let (mut host, mut now) = (Host::new(node), Timestamp::ZERO);
    bencher.bench_local(|| -> Reading {
        now = now + Duration::from_secs(1);
        host.read(now)
    });
}
