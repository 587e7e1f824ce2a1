//! Pinned frames follow their path, in that direction alone, and are never lost because of it.

use cotorra_fabric::{Fabric, NoPath, PinnedPath, PortId};
use cotorra_graph::{ConditionChange, Conditions, Direction, LinkId, Loss, NodeId, Probability, Timestamp};

use crate::common::{A, B, Network, context, delay, frame, ms, number, rate, run};

/// Two paths from the server a to the server b: over s, which is faster, and over t. The server c and the radio unit R1,
/// with the robot p, are connected to both s and t; the radio unit R2 to s.
fn square() -> Fabric {
    let network = Network::new().servers(&["a", "b", "c"]).switches(&["s", "t"]);
    let network = network.radio_unit("R1", 0.0).radio_unit("R2", 100.0).robot("p", 2.0);
    network
        .link("a", "s", delay(1))
        .link("s", "b", delay(1))
        .link("a", "t", delay(5))
        .link("t", "b", Conditions { rate: rate(8.0), ..delay(5) })
        .link("c", "s", delay(1))
        .link("c", "t", delay(1))
        .link("s", "R1", delay(3))
        .link("t", "R1", delay(4))
        .link("s", "R2", delay(3))
        .fabric(1)
}

const P: PortId = PortId(5);

fn names(links: &[&str]) -> Vec<LinkId> {
    links.iter().map(|link| link.parse().unwrap()).collect()
}

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

fn pin(fabric: &mut Fabric, from: &str, to: &str, links: &[&str]) {
    try_to_pin(fabric, from, to, links).unwrap();
}

fn try_to_pin(fabric: &mut Fabric, from: &str, to: &str, links: &[&str]) -> Result<(), NoPath> {
    let path = PinnedPath { from: node(from), to: node(to), links: names(links), reservation: None };
    fabric.pin(Timestamp::ZERO, &[path])
}

#[test]
fn pinned_frames_follow_their_path_in_one_direction() {
    let mut fabric = square();
    pin(&mut fabric, "a", "b", &["a-t", "t-b"]);
    for (from, to) in [(A, B), (B, A)] {
        fabric.push(Timestamp::ZERO, from, frame(from, to, 1, 60));
    }
    run(&mut fabric, Timestamp::ZERO, ms(100.0));
    let carried = |link: &str, fabric: &mut Fabric| {
        let contexts = fabric.link_contexts(ms(100.0));
        let of_link = contexts.iter().filter(|context| context.link == link);
        of_link.map(|context| context.counters.packets).collect::<Vec<_>>()
    };
    let all = ["a-s", "s-b", "a-t", "t-b"].map(|link| carried(link, &mut fabric));
    assert_eq!(all, [[0, 1], [0, 1], [1, 0], [1, 0]]);
    let route = |fabric: &Fabric, from, to| fabric.route(&node(from), &node(to)).unwrap();
    assert_eq!(
        (route(&fabric, "a", "b"), route(&fabric, "b", "a")),
        (names(&["a-t", "t-b"]), names(&["s-b", "a-s"]))
    );

    fabric.pin(Timestamp::ZERO, &[]).unwrap();
    assert_eq!(route(&fabric, "a", "b"), ["a-s", "s-b"]);
}

#[test]
fn frames_in_flight_stay_on_their_path() {
    let mut fabric = square();
    pin(&mut fabric, "a", "b", &["a-t", "t-b"]);
    fabric.push(ms(0.0), A, frame(A, B, 1, 60));
    run(&mut fabric, ms(0.0), ms(1.0));
    fabric.pin(Timestamp::ZERO, &[]).unwrap();
    run(&mut fabric, ms(1.0), ms(100.0));
    assert_eq!(context(&mut fabric, ms(100.0), "t-b").counters.packets, 1);
}

#[test]
fn a_path_to_a_robot_follows_its_attachment_without_loops() {
    let mut fabric = square();
    pin(&mut fabric, "a", "p", &["a-s", "s-R1", "p~R1"]);
    let (p, a) = (node("p"), node("a"));
    assert_eq!(fabric.route(&a, &p).unwrap(), ["a-s", "s-R1", "p~R1"]);
    fabric.move_robot(ms(0.0), &p, cotorra_graph::Position::new(50.0, 0.0)).unwrap();
    fabric.attach(ms(0.0), &p, &node("R2")).unwrap();
    let mut out = Vec::new();
    for i in 0..100 {
        let now = ms(f64::from(i));
        fabric.push(now, A, frame(A, P, i, 60));
        out.extend(run(&mut fabric, now, now + std::time::Duration::from_nanos(999_999)));
    }
    // Frames on their path to R1 turn back over their last link when the robot is attached to R2.
    out.extend(run(&mut fabric, ms(100.0), ms(1000.0)));
    let mut numbers: Vec<_> = out.iter().map(|d| number(&d.frame)).collect();
    numbers.sort_unstable();
    assert_eq!(numbers, (0..100).collect::<Vec<_>>());
    let contexts = fabric.link_contexts(ms(1000.0));
    let back = |c: &&cotorra_graph::LinkContext| c.link == "s-R1" && c.direction == Direction::Backward;
    assert!(contexts.iter().find(back).unwrap().counters.packets > 0);
    assert_eq!(fabric.in_flight(), 0);
    assert_eq!(fabric.route(&a, &p).unwrap(), ["a-s", "s-R2", "p~R2"]);
}

#[test]
fn impossible_paths_are_rejected_with_a_reason() {
    let mut fabric = square();
    let rejected = |from: &str, to: &str, links: &[&str]| {
        fabric.check_path(&node(from), &node(to), &names(links)).unwrap_err().to_string()
    };
    assert_eq!(rejected("a", "b", &["a-b"]), "there is no link `a-b`");
    assert_eq!(rejected("a", "b", &["a-s", "t-b"]), "the link `t-b` does not go on from `s`");
    assert_eq!(rejected("a", "b", &["p~R1"]), "the link `p~R1` does not go on from `a`");
    assert_eq!(
        rejected("a", "b", &["a-s", "c-s", "c-t", "t-b"]),
        "the path leads through `c`, which forwards nothing"
    );
    let circle = ["a-s", "s-R1", "t-R1", "a-t", "a-s", "s-b"];
    assert_eq!(rejected("a", "b", &circle), "the path comes to `a` twice");
    assert_eq!(rejected("a", "a", &["a-s", "a-s"]), "the path comes to `a` twice");
    assert_eq!(rejected("a", "b", &["a-s"]), "the path ends at `s`, not at `b`");
    assert_eq!(rejected("a", "s", &["a-s"]), "`s` is no host of the emulated network");
    assert_eq!(rejected("a", "x", &["a-s"]), "`x` is no host of the emulated network");
    // The robot need not be attached to the path's radio unit.
    let hops = fabric.check_path(&node("p"), &node("b"), &names(&["p~R2", "s-R2", "s-b"])).unwrap();
    let directions: Vec<_> = hops.iter().map(|(_, direction)| *direction).collect();
    assert_eq!(directions, [Direction::Forward, Direction::Backward, Direction::Forward]);

    pin(&mut fabric, "a", "b", &["a-t", "t-b"]);
    assert!(try_to_pin(&mut fabric, "a", "b", &["a-b"]).is_err());
    assert_eq!(fabric.route(&node("a"), &node("b")).unwrap(), ["a-t", "t-b"]);
}

#[test]
fn links_report_what_they_can_carry() {
    let mut fabric = square();
    let carries = |fabric: &Fabric, link: &str| {
        let carries = fabric.carries(&link.parse().unwrap(), Direction::Forward)?;
        Some((carries.rate_bps, carries.is_cut, carries.is_there))
    };
    let all = Loss::Independent { rate: Probability::ONE };
    let change =
        |loss| ConditionChange { loss: Some(loss), drop_scale: Some(2.0), ..ConditionChange::default() };
    assert_eq!(carries(&fabric, "t-b"), Some((8e6, false, true)));
    fabric.change(ms(0.0), &"t-b".parse().unwrap(), None, &change(all)).unwrap();
    assert_eq!(carries(&fabric, "t-b"), Some((4e6, true, true)));
    assert_eq!(carries(&fabric, "a-s"), Some((1e11, false, true)), "it has no rate but its medium's");
    assert_eq!(carries(&fabric, "a-b"), None);
    let (_, _, is_there) = carries(&fabric, "p~R2").unwrap();
    assert!(!is_there && carries(&fabric, "p~R1").unwrap().2);
    fabric.change(ms(0.0), &"p~R2".parse().unwrap(), None, &change(all)).unwrap();
    assert!(carries(&fabric, "p~R2").unwrap().1);
}

#[test]
fn a_round_trip_sums_the_present_delays_of_both_directions() {
    let mut fabric = square();
    let trip = |fabric: &Fabric, to: &str| {
        let trip = fabric.round_trip(&node("a"), &node(to));
        trip.map(|(delay, links)| (delay.as_millis(), links))
    };
    assert_eq!([trip(&fabric, "b"), trip(&fabric, "a")], [Some((4, 4)), Some((0, 0))]);
    assert_eq!(trip(&fabric, "p"), Some((8, 6)), "the air adds nothing");
    pin(&mut fabric, "a", "b", &["a-t", "t-b"]);
    assert_eq!(trip(&fabric, "b"), Some((12, 4)));
    let link: LinkId = "a-t".parse().unwrap();
    let slow = ConditionChange { delay_ms: Some(9.0), ..ConditionChange::default() };
    fabric.change(Timestamp::ZERO, &link, None, &slow).unwrap();
    assert_eq!(trip(&fabric, "b"), Some((16, 4)));
    let cut = Loss::Independent { rate: Probability::ONE };
    let cut = ConditionChange { loss: Some(cut), ..ConditionChange::default() };
    fabric.change(Timestamp::ZERO, &link, Some(Direction::Backward), &cut).unwrap();
    assert_eq!(trip(&fabric, "b"), Some((16, 4)), "the way back leads elsewhere");
    fabric.change(Timestamp::ZERO, &link, Some(Direction::Forward), &cut).unwrap();
    assert_eq!(trip(&fabric, "b"), None);
}
