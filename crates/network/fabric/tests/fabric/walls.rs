//! Walls of the map between robots and radio units.

use std::sync::Arc;

use cotorra_fabric::Fabric;
use cotorra_graph::{
    Cell, Dbm, HardwareGraph, NodeId, NodeKind, OccupancyGrid, Position, Roaming, Shadowing, Timestamp,
    WallLoss, Walls,
};
use proptest::prelude::*;

use crate::common::{Network, ms, run};

/// A map of 40 m by 10 m with walls of half a metre at 10 m and at 20 m, the latter with a door from 4 m to 5 m.
fn map() -> Arc<OccupancyGrid> {
    let cell = |i: usize| match (i % 80, i / 80) {
        (20, _) | (40, 0..8 | 10..) => Cell::Occupied,
        _ => Cell::Free,
    };
    let cells = (0..80 * 20).map(cell).collect();
    Arc::new(OccupancyGrid::new(80, 20, 0.5, Position::default(), cells).unwrap())
}

/// The robot p, and the radio units R1 in the first room and R2 in the third, 1 m from the lower end of the map.
fn floor(walls: Option<Walls>, shadowing_db: f64) -> HardwareGraph {
    let network = Network::new().radio_unit("R1", 5.0).radio_unit("R2", 35.0).robot("p", 6.0);
    let mut graph = network.graph();
    graph.nodes.iter_mut().for_each(|node| node.position.as_mut().unwrap().y = 1.0);
    let air = graph.wireless.get_mut("air").unwrap();
    air.walls = walls;
    air.shadowing = Shadowing { deviation_db: shadowing_db, correlation_m: 5.0 };
    graph
}

fn walls(at_most_db: Option<f64>) -> Option<Walls> {
    Some(Walls { loss: WallLoss { loss_db: 3.4, at_most_db }, map: map() })
}

fn id(name: &str) -> NodeId {
    name.parse().unwrap()
}

/// Returns the signal of a radio unit at a robot that is moved to a place.
fn signal(fabric: &mut Fabric, unit: &str, place: Position) -> Option<Dbm> {
    fabric.move_robot(Timestamp::ZERO, &id("p"), place).unwrap();
    fabric.reach(&id("p"), &id(unit)).unwrap()
}

#[test]
fn a_robot_behind_walls_hears_a_unit_weaker_by_exactly_their_loss() {
    for shadowing_db in [0.0, 4.0] {
        let mut open = Fabric::new(&floor(None, shadowing_db), 1).unwrap();
        let mut walled = Fabric::new(&floor(walls(None), shadowing_db), 1).unwrap();
        let mut bounded = Fabric::new(&floor(walls(Some(5.0)), shadowing_db), 1).unwrap();
        // In the room, behind one wall, behind two, and behind the second wall's door.
        for (x, y, loss) in [(8.0, 2.0, 0.0), (15.0, 2.0, 3.4), (25.0, 2.0, 6.8), (25.0, 5.5, 3.4)] {
            let place = Position::new(x, y);
            let heard = signal(&mut open, "R1", place).unwrap().0;
            assert!((heard - signal(&mut walled, "R1", place).unwrap().0 - loss).abs() < 1e-9, "{place}");
            let most = f64::min(loss, 5.0);
            assert!((heard - signal(&mut bounded, "R1", place).unwrap().0 - most).abs() < 1e-9, "{place}");
        }
    }
}

#[test]
fn radio_units_hear_robots_weaker_by_the_same_loss() {
    let heard = |walls| {
        let mut graph = floor(walls, 0.0);
        graph.nodes.retain(|node| node.id != id("R2"));
        let mut fabric = Fabric::new(&graph, 1).unwrap();
        fabric.move_robot(Timestamp::ZERO, &id("p"), Position::new(25.0, 2.0)).unwrap();
        fabric.radio_contexts(Timestamp::ZERO)[0].stations[0].signal.0
    };
    assert!((heard(None) - heard(walls(None)) - 6.8).abs() < 1e-9);
}

#[test]
fn without_walls_signals_are_those_of_the_path_loss_alone() {
    for without in [None, Some(Walls { loss: WallLoss { loss_db: 0.0, at_most_db: None }, map: map() })] {
        let graph = floor(without, 0.0);
        let unit = graph.node(&id("R1")).unwrap();
        let NodeKind::RadioUnit(radio) = &unit.kind else { panic!("a radio unit") };
        let mut fabric = Fabric::new(&graph, 1).unwrap();
        for x in [6.0, 12.0, 25.0] {
            let place = Position::new(x, 2.0);
            let alone = graph.wireless["air"].mean_signal(radio, unit.position.unwrap().distance(place));
            assert_eq!(signal(&mut fabric, "R1", place), Some(alone));
        }
    }
}

#[test]
fn a_robot_that_roams_by_signal_changes_earlier_behind_a_wall() {
    let changes_at = |walls| {
        let mut graph = floor(walls, 0.0);
        for node in &mut graph.nodes {
            let NodeKind::Robot(robot) = &mut node.kind else { continue };
            robot.roaming = Roaming::Signal;
        }
        let mut fabric = Fabric::new(&graph, 1).unwrap();
        // From R1 towards R2, through the second wall's door, at 0.5 m/s.
        let places = (0..290).map(|i| (ms(f64::from(i) * 200.0), 6.0 + f64::from(i) * 0.1));
        for (now, x) in places {
            fabric.move_robot(now, &id("p"), Position::new(x, 4.5)).unwrap();
            run(&mut fabric, now, now + std::time::Duration::from_millis(199));
            if fabric.attached_to(&id("p")) == Some(&id("R2")) {
                return x;
            }
        }
        panic!("it stays with R1")
    };
    let strong = Some(Walls { loss: WallLoss { loss_db: 15.0, at_most_db: None }, map: map() });
    let (open, walled) = (changes_at(None), changes_at(strong));
    // Past the wall at 10 m, R2 is the stronger one as soon as the line to it is through the door.
    assert!((20.0..25.0).contains(&open), "{open}");
    assert!((15.0..20.0).contains(&walled), "{walled}");
}

proptest! {
    #[test]
    fn signals_of_the_radio_are_the_mean_signals_of_the_graph(
        [x, y] in [-5.0..45.0_f64, -5.0..15.0_f64], bound in prop::option::of(3.4..9.0_f64)
    ) {
        let graph = floor(walls(bound), 0.0);
        let mut fabric = Fabric::new(&graph, 1).unwrap();
        for unit in ["R1", "R2"] {
            let mean = graph.mean_signal(graph.node(&id(unit)).unwrap(), Position::new(x, y)).unwrap();
            let heard = signal(&mut fabric, unit, Position::new(x, y)).unwrap();
            prop_assert!((heard.0 - mean.0).abs() < 1e-9, "{heard}, not {mean}");
        }
    }
}
