//! The mean signal of radio units, on graphs of testbed files.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::path::Path;

use cotorra_graph::{HardwareGraph, NodeId, Position};

const TESTBED: &str = "
name: hall
wireless: { hall: { path_loss: { model: free_space } } }
nodes:
  high: { kind: radio_unit, position: [0, 4, 11], channel: 1, tx_power: 20 dBm }
  robot: { kind: robot, position: [3, 0] }
";

fn graph() -> HardwareGraph {
    cotorra_testbed_file::parse("hall", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e:?}")).graph
}

#[test]
fn mean_signal_is_the_power_less_the_path_loss() {
    let graph = graph();
    let high = graph.node(&NodeId::new("high").unwrap()).unwrap();
    // Free space at 2412 MHz: 40.1 dB at 1 m, and 20 dB a decade. The height of 10 m counts.
    for (place, metres) in [
        (Position::new(0.0, 4.0).at_height(1.0), 10.0),
        (Position::new(3.0, 0.0).at_height(1.0), 125.0_f64.sqrt()),
    ] {
        let signal = graph.mean_signal(high, place).unwrap();
        assert!((signal.0 - (20.0 - 40.10 - 20.0 * metres.log10())).abs() < 0.01, "{signal} at {metres} m");
    }
}

#[test]
fn only_radio_units_have_a_mean_signal() {
    let mut graph = graph();
    let of = |graph: &HardwareGraph, id: &str| {
        graph.mean_signal(graph.node(&NodeId::new(id).unwrap()).unwrap(), Position::default())
    };
    assert_eq!(of(&graph, "robot"), None);
    assert!(of(&graph, "high").is_some());
    graph.nodes.iter_mut().for_each(|node| node.position = None);
    assert_eq!(of(&graph, "high"), None);
}
