//! Thirty robots in the corridor of the letter, whose brains share one server or have a server each.

use std::{fmt::Write as _, path::Path};

use cotorra_testing::project_file;

use super::computing::run_with;
use crate::{Summary, virtual_time::*};

const ROBOTS: usize = 30;
const SECONDS: u64 = 30;

/// The corridor with these servers and links. The brain of robot `n` is on `place(n)`. The positions of each robot are a Poisson
/// process, and a request takes an exponential time of 1 ms on average.
fn corridor(servers: &str, place: impl Fn(usize) -> String) -> Testbed {
    let map = project_file("testbeds/maps/corridor.yaml");
    let mut text = format!("name: fleet\nmap: {}\n", map.display());
    text += "wireless: { corridor: { access: turns, delay: 1 ms, rate: 54 Mbit/s } }
nodes:
  unit: { kind: radio_unit, position: [20.460, -24.764], channel: 1 }
  lan: { kind: switch }
";
    let mut each = |head: &str, line: &dyn Fn(usize) -> String| {
        text += head;
        (1..=ROBOTS).for_each(|n| writeln!(text, "  {}", line(n)).unwrap());
    };
    each("", &|n| format!("r{n}: {{ kind: robot }}"));
    each(&format!("{servers}services:\n"), &|n| {
        let node = place(n);
        format!(
            "s{n}: {{ robot: r{n}, kpis: {{ service_time: 15 ms }}, vnfs: {{ \
             d{n}: {{ program: robot_driver, pinned_to: r{n}, cpus: 0 }}, \
             b{n}: {{ program: navigation, node: {node}, cpus: 0.03, cpu_limit: 1, demand: {{ exponential: 1 ms }} }} }} }}"
        )
    });
    each("walks:\n", &|n| {
        format!(
            "r{n}: {{ waypoints: [[25.5, -27.8], [25.5, -24.6], [25.8, -21.8], [26.4, -18.7]], speed_limit: 0.2 m/s, \
             position_interval: {{ exponential: 50 ms }} }}"
        )
    });
    cotorra_testbed_file::parse("fleet.yaml", &text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// Mean time that a request is with a brain, ms.
fn mean_present_ms(summary: &Summary) -> f64 {
    let vnfs = &summary.computing.as_ref().unwrap().vnfs;
    assert_eq!(vnfs.len(), ROBOTS);
    assert!(vnfs.iter().all(|its| its.requests_dropped + its.requests_lost == 0));
    let present: f64 = vnfs.iter().map(|its| its.requests_present_mean).sum();
    let served: u64 = vnfs.iter().map(|its| its.requests_served).sum();
    present * SECONDS as f64 * 1e3 / served as f64
}

/// Mean of the robots' medians, ms.
fn p50_ms(summary: &Summary) -> f64 {
    let medians = summary.services.iter().map(|its| its.service_time_ms.unwrap().p50);
    medians.sum::<f64>() / ROBOTS as f64
}

/// If demands and gaps are exponential, each request is with an M/M/1 server for `1 / (1 - load)` of its own time on average,
/// whoever is served first: 2.5 ms on one server with a load of 60 %, and 1.02 ms on one of thirty with 2 %.
#[test]
fn thirty_robots_wait_on_one_server_and_not_on_thirty() {
    let one = "  edge: { kind: server, tier: edge, cpus: 1, memory: 8 GB }
links: [{ ends: [unit, lan], delay: 1 ms }, { ends: [lan, edge], delay: 1 ms }]
";
    let names = |n: usize| format!("edge{n}");
    let mut thirty = String::new();
    for n in 1..=ROBOTS {
        writeln!(thirty, "  {}: {{ kind: server, tier: edge, cpus: 1, memory: 8 GB }}", names(n)).unwrap();
    }
    let all: Vec<_> = (1..=ROBOTS).map(names).collect();
    writeln!(
        thirty,
        "links: [{{ ends: [unit, lan], delay: 1 ms }}, {{ ends: [lan, [{}]], delay: 1 ms }}]",
        all.join(", ")
    )
    .unwrap();
    let mut found = Vec::new();
    for (what, testbed, known) in [
        ("one server", corridor(one, |_| "edge".to_owned()), 2.5),
        ("thirty servers", corridor(&thirty, names), 1.0 / 0.98),
    ] {
        let (summary, _) = run_with(testbed, SECONDS, |_| {});
        let (mean, median) = (mean_present_ms(&summary), p50_ms(&summary));
        println!("{what}: {mean:.3} ms with a brain for {known:.3}; median service time {median:.2} ms");
        assert!((mean / known - 1.0).abs() < 0.1, "{what}: {mean} for {known}");
        found.push(median);
    }
    assert!(found[0] > found[1] + 0.5, "{found:?}");
}
