//! Compares the CPUs that a testbed promises to programs of others with those of this machine.

use cotorra_graph::{Program, Testbed};

/// Returns a warning if programs of others start on this machine with more CPUs together than it has. They are slower then than
/// the nodes that the testbed describes. Bundled VNFs take much less than they are promised.
///
/// `have` is the number of CPUs that this process may use.
pub fn missing_cpus(testbed: &Testbed, have: usize) -> Option<String> {
    let others =
        testbed.vnfs().filter(|vnf| vnf.image.is_some() || matches!(vnf.program, Program::Command(_)));
    let is_here = |node| testbed.graph.node(node).is_some_and(|node| node.real_server().is_none());
    let promised: f64 =
        others.flat_map(|vnf| vnf.node.all().iter().filter(|node| is_here(node)).map(|_| vnf.cpus)).sum();
    (promised > have as f64).then(|| {
        format!(
            "VNFs that are programs of yours are promised {promised} CPUs together, and this machine has {have}: when they \
             are busy, they are slower than on the nodes described, and so are their service times"
        )
    })
}

/// Returns a warning if VNFs have demands, which no real VNF knows of.
pub(super) fn unused_demands(testbed: &Testbed) -> Option<String> {
    let names: Vec<_> =
        testbed.vnfs().filter(|vnf| vnf.computing.is_some()).map(|vnf| format!("`{}`", vnf.id)).collect();
    let (s, have) = if names.len() == 1 { ("", "has") } else { ("s", "have") };
    (!names.is_empty()).then(|| {
        format!(
            "VNF{s} {} {have} a demand, which holds in virtual time only: with real packets, they take the time that they take",
            names.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use std::{path::Path, time::Duration};

    use cotorra_graph::{Computing, Demand, Scheduling};

    use super::*;

    fn testbed(vnfs: &str) -> Testbed {
        let text = format!(
            "name: x
wireless: {{ w: {{}} }}
nodes:
  r: {{ kind: robot, position: [0, 0] }}
  R1: {{ kind: radio_unit, position: [0, 2], channel: 1 }}
  a: {{ kind: server, tier: fog, cpus: 8, memory: 8 GB }}
  b: {{ kind: server, tier: fog, cpus: 8, memory: 8 GB }}
links: [{{ ends: [R1, [a, b]] }}]
services:
  s: {{ robot: r, kpis: {{ service_time: 100 ms }}, vnfs: {{ {vnfs} }} }}
"
        );
        cotorra_testbed_file::parse("x.yaml", &text, Path::new(".")).unwrap_or_else(|wrong| panic!("{wrong}"))
    }

    #[test]
    fn programs_that_are_promised_more_than_the_machine_has_get_a_warning() {
        let two = testbed(
            "one: { command: [sleep], node: a, cpus: 1.5 }, two: { command: [sleep], node: [a, b], cpus: 2 }",
        );
        let warning = missing_cpus(&two, 5).unwrap();
        assert!(warning.contains("5.5 CPUs") && warning.contains("has 5"), "{warning}");
        assert_eq!(missing_cpus(&two, 6), None);
    }

    #[test]
    fn demands_get_a_warning_because_they_hold_in_virtual_time_only() {
        let mut testbed = testbed("n: { command: [sleep], node: a }");
        assert_eq!(unused_demands(&testbed), None);
        testbed.services[0].vnfs[0].computing = Some(Box::new(Computing {
            demand: Demand::Constant { time: Duration::from_millis(1) },
            per_kb: Duration::ZERO,
            scheduling: Scheduling::Shared,
            backlog: Computing::BACKLOG,
            warm_up: None,
        }));
        assert!(unused_demands(&testbed).unwrap().starts_with("VNF `n` has a demand, which"));
    }
}
