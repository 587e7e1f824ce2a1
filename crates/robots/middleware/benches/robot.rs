//! Times of a simulated robot, and of encoding in a service time. `cargo bench -p cotorra-robot-middleware`

use std::{sync::Arc, time::Duration};

use cotorra_graph::{
    Camera, Cell, DataFormat, Node, NodeId, NodeKind, OccupancyGrid, Position, Sensor, SensorId, SensorKind,
    Timestamp, Velocity,
};
use cotorra_graph_testing as base;
use cotorra_plugin::{
    convert::{to_pose, to_twist},
    wire::{NavigationPacket, PositionPacket},
};
use cotorra_robot_middleware::{RobotDriver, SimulatedRobot, World};
use divan::{Bencher, black_box};

fn main() {
    divan::main();
}

/// A corridor 60 m long with walls 2 m to either side, in cells of 0.05 m, on a map of 60 m × 40 m.
fn corridor() -> OccupancyGrid {
    let (width, height) = (1200, 800);
    let wall = |row: usize, column: usize| {
        !(1..width - 1).contains(&column) || (row.abs_diff(400) > 40 && row.abs_diff(400) < 44)
    };
    let cells = (0..width * height)
        .map(|i| if wall(i / width, i % width) { Cell::Occupied } else { Cell::Free })
        .collect();
    OccupancyGrid::new(width, height, 0.05, Position::default(), cells).expect("the numbers agree")
}

/// A hall without walls in range, for the longest rays.
fn hall() -> OccupancyGrid {
    OccupancyGrid::new(1200, 800, 0.05, Position::default(), vec![Cell::Free; 1200 * 800])
        .expect("the numbers agree")
}

fn robot(world: Arc<World>) -> SimulatedRobot {
    let robot = NodeKind::Robot(base::robot("corridor"));
    let node = Node { position: Some(Position::new(10.0, 20.0)), ..base::node("robot1", robot) };
    SimulatedRobot::new(&node, None, world, 1).expect("a robot with a place")
}

#[divan::bench(args = ["corridor", "hall"])]
fn cast_360_rays(bencher: Bencher<'_, '_>, place: &str) {
    let world = World::new(&if place == "hall" { hall() } else { corridor() });
    let directions: Vec<(f64, f64)> = (0..360)
        .map(|ray| {
            let (sin, cos) = (f64::from(ray).to_radians() + 0.01).sin_cos();
            (cos, sin)
        })
        .collect();
    let from = Position::new(30.012, 20.034);
    bencher.bench_local(|| {
        directions.iter().filter(|direction| world.cast(black_box(from), **direction, 12.0).is_some()).count()
    });
}

/// 50 steps of physics and 10 turns of the lidar.
#[divan::bench]
fn one_robot_second(bencher: Bencher<'_, '_>) {
    let world = Arc::new(World::new(&corridor()));
    bencher.with_inputs(|| robot(Arc::clone(&world))).bench_local_values(|mut robot| {
        for ms in (0..1000).step_by(200) {
            let now = Timestamp::ZERO + Duration::from_millis(ms);
            let _ = robot.command(now, Velocity::planar(0.3, 0.05));
        }
        robot.advance(Timestamp::ZERO + Duration::from_secs(1));
        robot
    });
}

/// An image of 640 by 480 pixels of a camera that looks along the corridor.
#[divan::bench(args = [DataFormat::Mono8, DataFormat::Rgb8])]
fn draw_an_image(bencher: Bencher<'_, '_>, format: DataFormat) {
    let mut robot = robot(Arc::new(World::new(&corridor())));
    let camera = Camera {
        width: 640,
        height: 480,
        format,
        field_of_view: 60f64.to_radians(),
        to: None,
        keep_bytes: 0,
    };
    let sensor = Sensor {
        id: SensorId::new("front").expect("a name"),
        interval: Duration::from_millis(100),
        kind: SensorKind::Camera(camera),
    };
    let capture = || robot.capture(&sensor, None).expect("it has a camera");
    bencher.with_inputs(capture).bench_local_values(|view| view.content.bytes());
}

#[divan::bench]
fn prepare_a_million_cells(bencher: Bencher<'_, '_>) {
    let map = corridor();
    bencher.bench_local(|| World::new(black_box(&map)));
}

/// All encoding in a service time: both packets, encoded and decoded.
#[divan::bench]
fn encode_and_decode_position_and_navigation(bencher: Bencher<'_, '_>) {
    let now = Timestamp::from_nanos(1_400_000_123);
    let pose = robot(Arc::new(World::open())).pose();
    let position = PositionPacket {
        sequence: 7,
        emitted: now,
        nonce: 5,
        waypoint: 3,
        goal: None,
        robot: NodeId::new("robot1").expect("a name"),
        pose: to_pose(&pose),
    };
    let mut datagram = Vec::new();
    bencher.bench_local(|| {
        position.encode(&mut datagram);
        let received = PositionPacket::decode(black_box(&datagram)).expect("a position packet");
        let velocity = Velocity::planar(0.3, 0.05);
        NavigationPacket::answering(&received, 4, to_twist(velocity)).encode(&mut datagram);
        NavigationPacket::decode(black_box(&datagram)).expect("a navigation packet")
    });
}
