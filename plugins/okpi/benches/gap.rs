//! Gap between decisions and the exact optimum, over γ: `cargo bench -p cotorra-okpi --bench gap`. Graphs are
//! generated, with scarce CPUs, bandwidth, service time and reliability. The optimum comes from a mixed integer
//! program.

use std::time::Duration;

use cotorra_okpi::{Chain, Infrastructure, Placed, Search, place};
use cotorra_testing::placement::{contested, exact};

/// Graphs for which a placement exists.
const GRAPHS: usize = 300;
const NODES: usize = 25;
const GAMMAS: [u16; 11] = [1, 2, 3, 4, 6, 8, 10, 15, 20, 50, 100];

struct Instance {
    service: Chain,
    infrastructure: Infrastructure,
    optimum: f64,
}

fn main() {
    let all = (0..).map(|run| contested(NODES, run)).map(|(service, infrastructure)| {
        let optimum = exact::optimum(&service, &infrastructure);
        (service, infrastructure, optimum)
    });
    let mut drawn = 0;
    let instances: Vec<_> = all
        .inspect(|_| drawn += 1)
        .filter_map(|(service, infrastructure, optimum)| {
            Some(Instance { service, infrastructure, optimum: optimum? })
        })
        .take(GRAPHS)
        .collect();
    println!(
        "{GRAPHS} graphs with a placement, of {drawn} drawn; {NODES} nodes, 2 to 4 movable VNFs, both KPIs.\n"
    );
    println!("| γ | found | mean gap | 95th percentile | largest | median decision | slowest |");
    println!("|---|---|---|---|---|---|---|");
    for gamma in GAMMAS {
        row(gamma, &instances);
    }
}

fn row(gamma: u16, instances: &[Instance]) {
    let search = Search::at(gamma);
    let (mut gaps, mut times) = (Vec::new(), Vec::new());
    for instance in instances {
        let (placed, took) = timed(instance, search);
        times.push(took.as_secs_f64() * 1e6);
        gaps.extend(placed.map(|placed| (placed.cost / instance.optimum - 1.0) * 100.0));
    }
    let found = gaps.len() as f64 / instances.len() as f64 * 100.0;
    let mean = gaps.iter().fold(0.0, |sum, gap| sum + gap) / gaps.len().max(1) as f64;
    let [p95, largest] = [0.95, 1.0].map(|share| quantile(&mut gaps, share));
    let [median, slowest] = [0.5, 1.0].map(|share| quantile(&mut times, share));
    println!(
        "| {gamma} | {found:.1} % | {mean:.2} % | {p95:.1} % | {largest:.1} % | {median:.0} µs | {slowest:.0} µs |"
    );
}

#[allow(clippy::disallowed_types, reason = "a benchmark owns a clock")]
fn timed(instance: &Instance, search: Search) -> (Option<Placed>, Duration) {
    let start = std::time::Instant::now();
    let placed = place(&instance.service, &instance.infrastructure, search);
    (placed.ok(), start.elapsed())
}

/// The value that a share of the others does not exceed; 0 without any.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(((values.len() as f64 * share).ceil() as usize).saturating_sub(1)).copied().unwrap_or(0.0)
}
