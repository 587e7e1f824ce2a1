//! Benchmarks of planning and control: `cargo bench -p cotorra-brain`.

use cotorra_brain::{Brain, NavigationVnf};
use cotorra_graph::{PoseSource, Position, Timestamp};
use cotorra_plugin::{Actions, Plugin, convert::to_pose, wire::PositionPacket};
use cotorra_testing::{
    corridor,
    robot::{context, pose, robot, testbed},
};
use divan::Bencher;

fn main() {
    divan::main();
}

/// The costmap of the corridor, and a plan for each of its 34 legs.
#[divan::bench]
fn start_on_the_corridor(bencher: Bencher) {
    let testbed = corridor();
    bencher.bench_local(|| started(&testbed));
}

/// The same, for one leg from one end of the corridor to the other: the whole map, around two corners.
#[divan::bench]
fn start_with_one_far_goal(bencher: Bencher) {
    let testbed = testbed(corridor().map, vec![Position::new(25.5, -27.8), Position::new(-2.1, 0.4)]);
    bencher.bench_local(|| started(&testbed));
}

/// One answer on the way.
#[divan::bench]
fn control_step(bencher: Bencher) {
    let (mut brain, mut actions) = (started(&corridor()), Actions::default());
    let event = context(pose(25.6, -22.0, 1.4), 3);
    bencher.bench_local(|| {
        brain.handle(Timestamp::ZERO, &event, &mut actions);
        actions.drain().count()
    });
}

/// One answer off the way, from another cell each time: with a plan of its own, 3 m around the corner.
#[divan::bench]
fn control_step_with_a_new_plan(bencher: Bencher) {
    let (mut brain, mut actions) = (started(&corridor()), Actions::default());
    let events = [24.6, 24.7].map(|x| context(pose(x, -2.2, 1.4), 7));
    let mut n = 0;
    bencher.bench_local(|| {
        n += 1;
        brain.handle(Timestamp::ZERO, &events[n % 2], &mut actions);
        actions.drain().count()
    });
}

/// One answer as the navigation VNF gives it: from datagram to datagram.
#[divan::bench]
fn packet_to_packet(bencher: Bencher) {
    let mut vnf = NavigationVnf::new(&corridor(), &robot()).expect("the robot has a walk");
    let at = Timestamp::from_nanos(1);
    let mut pose = pose(25.6, -22.0, 1.4);
    pose.source = PoseSource::Localization;
    let pose = to_pose(&pose);
    let (mut datagram, mut answer) = (Vec::new(), Vec::new());
    PositionPacket { sequence: 0, emitted: at, nonce: 5, waypoint: 3, goal: None, robot: robot(), pose }
        .encode(&mut datagram);
    bencher.bench_local(|| vnf.answer(&datagram, &mut answer).is_ok());
}

fn started(testbed: &cotorra_graph::Testbed) -> Brain {
    let mut brain = Brain::new();
    brain.start(Timestamp::ZERO, testbed, &mut Actions::default());
    brain
}
