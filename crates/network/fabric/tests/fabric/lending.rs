//! Packets of robots whose antennas are lent.

use cotorra_fabric::{Fabric, FabricError, PortId};
use cotorra_graph::{Conditions, Edca, RateControl};

use crate::common::{Network, frame, ms, number, run};

const B: PortId = PortId(0);
const R1: PortId = PortId(1);
const R2: PortId = PortId(2);
const P: PortId = PortId(3);

/// The server b, and the radio units R1 and R2 behind a switch, with the robot p; all antennas are lent.
fn lent() -> Fabric {
    let network = Network::new().server("b").switches(&["s"]).radio_unit("R1", 0.0).radio_unit("R2", 9.0);
    let network = ["R1", "R2", "b"]
        .iter()
        .fold(network.robot("p", 2.0), |network, end| network.link(end, "s", Conditions::default()));
    let mut graph = network.graph();
    graph.wireless.get_mut("air").unwrap().access =
        Some(Edca { aggregation: false, rate_control: RateControl::Ideal, power_save: None });
    let mut fabric = Fabric::new(&graph, 1).unwrap();
    for node in ["R1", "R2", "p"] {
        fabric.lend_antenna(ms(0.0), &node.parse().unwrap()).unwrap();
    }
    fabric
}

/// Returns which ports get a frame from b to p.
fn reached(fabric: &mut Fabric, now: f64) -> Vec<PortId> {
    fabric.push(ms(now), B, frame(B, P, 1, 100));
    let mut ports: Vec<_> = run(fabric, ms(now), ms(now + 50.0)).into_iter().map(|d| d.port).collect();
    ports.sort_unstable();
    ports
}

#[test]
fn packets_to_a_robot_go_where_its_packets_came_from_last() {
    let mut fabric = lent();
    assert_eq!(reached(&mut fabric, 0.0), [R1, R2], "nobody knows where it is");
    for (at, unit) in [(100.0, R1), (200.0, R2)] {
        // A bridge brings its packet from the radio.
        fabric.push(ms(at), unit, frame(P, B, 7, 100));
        let out = run(&mut fabric, ms(at), ms(at + 50.0));
        assert_eq!(out.iter().map(|d| (d.port, number(&d.frame))).collect::<Vec<_>>(), [(B, 7)]);
        assert_eq!(reached(&mut fabric, at + 50.0), [unit]);
    }
}

#[test]
fn the_fabrics_own_radios_there_are_silent() {
    let mut fabric = lent();
    fabric.push(ms(0.0), P, frame(P, B, 1, 100));
    fabric.push(ms(0.0), R1, frame(R1, B, 2, 100));
    let out = run(&mut fabric, ms(0.0), ms(5000.0));
    assert_eq!(out.iter().map(|d| (d.port, number(&d.frame))).collect::<Vec<_>>(), [(B, 2)]);
    let p = "p".parse().unwrap();
    assert_eq!(fabric.lend_antenna(ms(5000.0), &p), Err(FabricError::Lent(p)));
    assert_eq!(fabric.next_report(), None);
}
