//! Compares the CPUs that a testbed promises to programs of others with those of this machine.

use cotorra_graph::{Node, Program, Testbed, Vnf};

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

/// Returns warnings of demands that are not computed as the testbed file describes, and of states that are not copied. `have` is
/// the number of CPUs that this process may use.
pub(super) fn unmet(testbed: &Testbed, have: usize) -> Vec<String> {
    let unmet = [demands_of_images(testbed), demands_above(testbed, have), unused_states(testbed)];
    unmet.into_iter().flatten().collect()
}

/// Programs of others know of no demand.
fn demands_of_images(testbed: &Testbed) -> Option<String> {
    let have =
        those_with(testbed, "an image and a demand", |vnf| vnf.computing.is_some() && vnf.image.is_some())?;
    Some(format!("{have}, which only programs of cotorra compute: others take the time that they take"))
}

/// No engine copies a state.
fn unused_states(testbed: &Testbed) -> Option<String> {
    let have = those_with(testbed, "a state", |vnf| vnf.state.is_some())?;
    Some(format!(
        "{have}, which holds in virtual time only: with real packets, a move starts another instance, and copies nothing"
    ))
}

/// Says which VNFs have this.
fn those_with(testbed: &Testbed, what: &str, has: impl Fn(&Vnf) -> bool) -> Option<String> {
    let names: Vec<_> = testbed.vnfs().filter(|vnf| has(vnf)).map(|vnf| format!("`{}`", vnf.id)).collect();
    let (s, have) = if names.len() == 1 { ("", "has") } else { ("s", "have") };
    (!names.is_empty()).then(|| format!("VNF{s} {} {have} {what}", names.join(", ")))
}

/// Emulated servers have the CPUs of this machine.
fn demands_above(testbed: &Testbed, have: usize) -> Option<String> {
    let on = |node: &Node| {
        let here = testbed.vnfs().filter(|vnf| vnf.computing.is_some() && vnf.image.is_none());
        let limits: f64 = here.filter(|vnf| vnf.node.all().contains(&node.id)).map(Vnf::most_cpus).sum();
        node.capacity().map_or(0.0, |capacity| capacity.cpus).min(limits)
    };
    let emulated = testbed.graph.nodes.iter().filter(|node| node.real_server().is_none());
    let used: f64 = emulated.map(on).sum();
    (used > have as f64).then(|| {
        format!(
            "VNFs with a demand may use {used} CPUs together, and this machine has {have}: when they are busy, they wait for \
             longer than on the nodes described"
        )
    })
}

#[cfg(test)]
mod tests {
    use std::{path::Path, time::Duration};

    use cotorra_graph::{Computing, Demand, Scheduling, StateTransfer, TransferMethod};

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

    /// Returns the testbed with a demand of each VNF.
    fn with_demands(vnfs: &str) -> Testbed {
        let mut testbed = testbed(vnfs);
        for vnf in &mut testbed.services[0].vnfs {
            vnf.computing = Some(Box::new(Computing {
                demand: Demand::Constant { time: Duration::from_millis(1) },
                per_kb: Duration::ZERO,
                scheduling: Scheduling::Shared,
                backlog: Computing::BACKLOG,
                warm_up: None,
            }));
        }
        testbed
    }

    #[test]
    fn demands_of_images_get_a_warning() {
        assert_eq!(demands_of_images(&with_demands("n: { command: [sleep], node: a }")), None);
        let image = "n: { image: brain, node: a }";
        assert_eq!(demands_of_images(&testbed(image)), None);
        let warning = demands_of_images(&with_demands(image)).unwrap();
        assert!(warning.starts_with("VNF `n` has an image and a demand, which"), "{warning}");
    }

    #[test]
    fn demands_on_more_cpus_than_the_machine_has_get_a_warning() {
        let vnf = |name: &str, node: &str, cpus: f64| {
            format!("{name}: {{ command: [sleep], node: {node}, cpus: 1, cpu_limit: {cpus} }}")
        };
        let two = [vnf("n", "a", 6.0), vnf("m", "b", 3.5)].join(", ");
        assert_eq!(demands_above(&testbed(&two), 1), None);
        let warning = demands_above(&with_demands(&two), 9).unwrap();
        assert!(warning.contains("9.5 CPUs together, and this machine has 9"), "{warning}");
        assert_eq!(demands_above(&with_demands(&two), 10), None);
        let one_node = with_demands(&[vnf("n", "a", 6.0), vnf("m", "a", 6.0)].join(", "));
        assert_eq!(demands_above(&one_node, 8), None, "the node has 8");
        assert!(demands_above(&one_node, 7).is_some());
    }

    #[test]
    fn states_get_a_warning_because_they_are_copied_in_virtual_time_only() {
        let mut testbed = testbed("n: { command: [sleep], node: a }, m: { command: [sleep], node: a }");
        assert_eq!(unused_states(&testbed), None);
        for vnf in &mut testbed.services[0].vnfs {
            vnf.state = Some(Box::new(StateTransfer { bytes: 1, method: TransferMethod::StopAndCopy }));
        }
        assert!(unused_states(&testbed).unwrap().starts_with("VNFs `n`, `m` have a state, which"));
    }
}
