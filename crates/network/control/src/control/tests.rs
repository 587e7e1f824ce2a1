use std::path::Path as FilePath;

use cotorra_graph::{BitRate, ConditionChange, Image, Loss, Probability, Program, Vnf};
use cotorra_graph_testing as base;

use super::*;
use cotorra_engine::InMemoryEngine;

use crate::testing::Here;

/// Two robots with a service each, and two switches between their radio unit and the servers. The path over `fast` is
/// shorter; the one over `wide` has more capacity.
const TESTBED: &str = "
name: two
wireless: { lab: { rate: 10 Mbit/s } }
nodes:
  r: { kind: robot, position: [1, 0] }
  q: { kind: robot, position: [2, 0] }
  U: { kind: radio_unit, position: [0, 0], channel: 1 }
  S: { kind: radio_unit, position: [9, 0], channel: 6 }
  fast: { kind: switch }
  wide: { kind: switch }
  one: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
  two: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [U, fast], delay: 1 ms, rate: 3 Mbit/s }
  - { ends: [fast, [one, two]], delay: 1 ms }
  - { ends: [U, wide], delay: 5 ms, rate: 5 Mbit/s }
  - { ends: [wide, [one, two, S]], delay: 5 ms }
services:
  of-r:
    robot: r
    kpis: { service_time: 500 ms }
    vnfs:
      r-driver: { program: robot_driver, pinned_to: r }
      r-brain: { program: navigation, node: one }
    virtual_links: [{ from: r-driver, to: r-brain, rate: 3 Mbit/s }]
  of-q:
    robot: q
    kpis: { service_time: 500 ms }
    vnfs:
      q-driver: { program: robot_driver, pinned_to: q }
      q-brain: { program: navigation, node: one }
    virtual_links: [{ from: q-driver, to: q-brain, rate: 3 Mbit/s }]
walks:
  r: { waypoints: [[1, 0], [2, 0]] }
  q: { waypoints: [[2, 0], [1, 0]] }
";

struct Lab(NetworkControl<Here, InMemoryEngine>);

impl Lab {
    fn new() -> Self {
        Self::with(Reservations::Counted)
    }

    fn with(reservations: Reservations) -> Self {
        let testbed =
            cotorra_testbed_file::parse("x", TESTBED, FilePath::new("")).unwrap_or_else(|e| panic!("{e}"));
        let testbed = Testbed { reservations, ..testbed };
        let network = Here::new(&testbed.graph);
        let mut lab = Self(NetworkControl::new(&testbed, network, InMemoryEngine::default()));
        lab.0.start(Timestamp::ZERO);
        lab.0.poll(Timestamp::ZERO).unwrap();
        lab.0.observe().unwrap();
        lab
    }

    fn instruct(&mut self, instruction: &Instruction) -> Result<Reported, String> {
        let events = self.0.instruct(Timestamp::ZERO, instruction).map_err(|rejected| rejected.0)?;
        Ok(reported(events))
    }

    /// Maps a path. `links` are separated by spaces.
    fn map(&mut self, from: &str, to: &str, links: &str) -> Result<Reported, String> {
        self.reserve(from, to, links, None)
    }

    /// Maps a path with a reservation of its own.
    fn reserve(
        &mut self,
        from: &str,
        to: &str,
        links: &str,
        reservation: Option<MapReservation>,
    ) -> Result<Reported, String> {
        let links = links.split_whitespace().map(|link| link.parse().unwrap()).collect();
        self.instruct(&Instruction::Map { from: node(from), to: node(to), links, reservation })
    }

    fn change(&mut self, link: &str, change: ConditionChange) -> Reported {
        let condition = Instruction::Condition { link: link.parse().unwrap(), direction: None, change };
        self.instruct(&condition).unwrap()
    }

    fn lose(&mut self, link: &str, share: f64) -> Reported {
        let loss = Some(Loss::Independent { rate: Probability::new(share).unwrap() });
        self.change(link, ConditionChange { loss, ..ConditionChange::default() })
    }

    /// Moves a brain, until packets go there.
    fn place(&mut self, vnf: &str, on: &str) -> Reported {
        let place = Instruction::Place { vnf: vnf.parse().unwrap(), node: node(on).into() };
        let mut events = self.0.instruct(Timestamp::ZERO, &place).unwrap();
        events.extend(self.0.poll(Timestamp::ZERO).unwrap());
        events.extend(self.0.remap().unwrap());
        reported(events)
    }

    fn route(&self, from: &str, to: &str) -> String {
        let links = self.0.network.0.borrow().route(&node(from), &node(to)).unwrap();
        links.iter().map(LinkId::as_str).collect::<Vec<_>>().join(" ")
    }

    /// Returns the reservations, Mbit/s.
    fn reserved(&self) -> Vec<String> {
        let all = self.0.reserved().filter(|(.., bps)| *bps > 0.0);
        all.map(|(link, way, bps)| format!("{link} {way:?} {}", bps / 1e6)).collect()
    }
}

/// Reports about mappings: virtual links, and notices.
type Reported = (Vec<String>, Vec<String>);

fn reported(events: Vec<Event>) -> Reported {
    let (mut mapped, mut notices) = (Vec::new(), Vec::new());
    for event in events {
        match event {
            Event::VirtualLink(VirtualLinkMapping { from, to, path, .. }) => {
                mapped.push(format!("{from} {to} {}", path.as_str()));
            }
            Event::Notice { message } => notices.push(message),
            _ => {}
        }
    }
    (mapped, notices)
}

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

const FAST: &str = "r~U U-fast fast-one";
const WIDE: &str = "r~U U-wide wide-one";

#[test]
fn a_mapping_reserves_its_rate_in_one_direction() {
    let mut lab = Lab::new();
    assert_eq!(lab.route("r", "one"), FAST);
    let (mapped, notices) = lab.map("r", "one", WIDE).unwrap();
    assert_eq!((mapped, notices.len()), (vec!["r-driver r-brain mapped".to_owned()], 0));
    assert_eq!(
        (lab.route("r", "one"), lab.route("one", "r")),
        (WIDE.to_owned(), "fast-one U-fast r~U".to_owned())
    );
    assert_eq!(lab.reserved(), ["U-wide Forward 3", "r~U Forward 3", "wide-one Forward 3"]);
    assert_eq!(lab.route("q", "one"), "q~U U-fast fast-one");

    let (mapped, _) = lab.map("r", "one", "").unwrap();
    assert_eq!(mapped, ["r-driver r-brain shortest"]);
    assert_eq!((lab.route("r", "one"), lab.reserved().len()), (FAST.to_owned(), 0));
    let (mapped, _) = lab.map("one", "r", "wide-one U-wide r~U").unwrap();
    assert_eq!(mapped, ["r-brain r-driver mapped"]);
    assert_eq!(lab.reserved(), ["U-wide Backward 3", "r~U Backward 3", "wide-one Backward 3"]);
}

/// Returns the reservations in the fabric: both ends, the rate in Mbit/s, and whether that is the most.
fn kept(lab: &Lab) -> Vec<(String, f64, bool)> {
    let kept = lab.0.pinned.iter().filter_map(|path| {
        let reservation = path.reservation?;
        Some((format!("{} {}", path.from, path.to), reservation.rate.mbps(), reservation.is_limited))
    });
    kept.collect()
}

#[test]
fn links_keep_the_reservations_that_the_testbed_wants_kept() {
    for (reservations, is_limited) in [
        (Reservations::Counted, None),
        (Reservations::Guaranteed, Some(false)),
        (Reservations::Limited, Some(true)),
    ] {
        let mut lab = Lab::with(reservations);
        lab.map("r", "one", WIDE).unwrap();
        let expected: Vec<_> =
            is_limited.map(|is_limited| ("r one".to_owned(), 3.0, is_limited)).into_iter().collect();
        assert_eq!(kept(&lab), expected);
        // A cut path has none, and gets it back.
        lab.lose("U-wide", 1.0);
        assert_eq!(kept(&lab), []);
        lab.lose("U-wide", 0.0);
        assert_eq!(kept(&lab), expected);
        // Nothing is reserved for nodes without a virtual link.
        lab.place("r-brain", "two");
        assert_eq!(kept(&lab), []);
    }
}

#[test]
fn a_mapping_decides_on_its_own_reservation() {
    let own = |kept, mbps: Option<f64>| {
        Some(MapReservation { kept, rate: mbps.map(|mbps| BitRate::from_mbps(mbps).unwrap()) })
    };
    for testbed in [Reservations::Counted, Reservations::Guaranteed] {
        let mut lab = Lab::with(testbed);
        lab.reserve("r", "one", WIDE, own(Reservations::Limited, None)).unwrap();
        assert_eq!(kept(&lab), [("r one".to_owned(), 3.0, true)]);
        lab.reserve("r", "one", WIDE, own(Reservations::Guaranteed, Some(1.0))).unwrap();
        assert_eq!(kept(&lab), [("r one".to_owned(), 1.0, false)]);
        lab.reserve("r", "one", WIDE, own(Reservations::Counted, Some(4.0))).unwrap();
        assert_eq!(kept(&lab), []);
        assert_eq!(lab.reserved()[0], "U-wide Forward 4");
        // A rate of its own needs no virtual link, but room.
        lab.map("r", "one", "").unwrap();
        lab.reserve("r", "two", "r~U U-fast fast-two", own(Reservations::Limited, Some(2.0))).unwrap();
        assert_eq!(kept(&lab), [("r two".to_owned(), 2.0, true)]);
        let refused = lab.reserve("r", "one", WIDE, own(Reservations::Limited, Some(6.0))).unwrap_err();
        assert!(refused.contains("6 Mbit/s are needed"), "{refused}");
    }
}

#[test]
fn impossible_mappings_are_rejected_and_change_nothing() {
    let mut lab = Lab::new();
    lab.map("r", "one", WIDE).unwrap();
    let full = "the link `U-wide` has 2 Mbit/s left forward, and 3 Mbit/s are needed";
    for (from, to, links, reason) in [
        ("q", "one", "q~U U-wide wide-one", full),
        ("q", "one", "q~U wide-one", "the link `wide-one` does not go on from `U`"),
        ("q", "two", "q~U U-fast fast-two", "no virtual link is between VNFs on `q` and `two`"),
        ("q", "one", "", "nothing is mapped from `q` to `one`"),
        ("r", "one", "r~U U-fast", "the path ends at `fast`, not at `one`"),
    ] {
        assert_eq!(lab.map(from, to, links).unwrap_err(), reason);
    }
    assert_eq!(
        (lab.route("q", "one"), lab.route("r", "one")),
        ("q~U U-fast fast-one".to_owned(), WIDE.to_owned())
    );
    // There is capacity in the other direction, on the other path, and beside the first mapping.
    lab.map("one", "q", "wide-one U-wide q~U").unwrap();
    lab.map("q", "one", "q~U U-fast fast-one").unwrap();
    assert!(lab.map("r", "one", FAST).unwrap_err().contains("`U-fast` has 0 Mbit/s left"));
    lab.map("q", "one", "").unwrap();
    lab.map("r", "one", FAST).unwrap();
    lab.map("q", "one", "q~U U-wide wide-one").unwrap();
}

#[test]
fn a_cut_path_falls_back_and_is_used_again_after_its_repair() {
    let mut lab = Lab::new();
    lab.map("r", "one", WIDE).unwrap();
    assert_eq!(lab.lose("U-wide", 0.9), Reported::default());
    let (mapped, notices) = lab.lose("U-wide", 1.0);
    assert_eq!(mapped, ["r-driver r-brain fallback"]);
    let cut =
        "the path from `r` to `one` over r~U, U-wide, wide-one is cut at `U-wide`: packets take the shortest";
    assert_eq!(notices, [cut]);
    assert_eq!(lab.route("r", "one"), FAST);
    // No other mapping gets its capacity.
    assert!(lab.map("q", "one", "q~U U-wide wide-one").unwrap_err().contains("2 Mbit/s left"));
    let (mapped, notices) = lab.lose("U-wide", 0.0);
    assert_eq!(mapped, ["r-driver r-brain mapped"]);
    assert!(notices.len() == 1 && notices[0].ends_with("can be used again"), "{notices:?}");
    assert_eq!(lab.route("r", "one"), WIDE);
}

#[test]
fn a_mapping_loses_its_reservation_on_a_link_that_becomes_too_slow() {
    let mut lab = Lab::new();
    lab.map("r", "one", WIDE).unwrap();
    let scale = |by| ConditionChange { drop_scale: Some(by), ..ConditionChange::default() };
    let (mapped, notices) = lab.change("U-wide", scale(2.0));
    assert_eq!((mapped, lab.reserved().len()), (vec!["r-driver r-brain fallback".to_owned()], 0));
    assert!(
        notices[0].contains("`U-wide` has 2.5 Mbit/s left forward, and 3 Mbit/s are needed"),
        "{notices:?}"
    );
    assert_eq!(lab.change("U-wide", scale(1.0)).0, ["r-driver r-brain mapped"]);
}

#[test]
fn mappings_stay_with_their_nodes_when_a_vnf_moves() {
    let mut lab = Lab::new();
    lab.map("r", "one", WIDE).unwrap();
    assert_eq!(lab.place("r-brain", "two").0, ["r-brain r-driver shortest", "r-driver r-brain shortest"]);
    assert_eq!(
        (lab.route("r", "one"), lab.route("r", "two")),
        (WIDE.to_owned(), "r~U U-fast fast-two".to_owned())
    );
    assert_eq!(lab.reserved().len(), 0, "there is no virtual link between them");
    // A mapping made before a VNF arrives holds once it is there.
    lab.0
        .instruct(
            Timestamp::ZERO,
            &Instruction::Place { vnf: "q-brain".parse().unwrap(), node: node("two").into() },
        )
        .unwrap();
    assert_eq!(lab.map("q", "two", "q~U U-wide wide-two").unwrap(), Reported::default());
    assert_eq!(lab.place("q-brain", "two").0, ["q-brain q-driver shortest", "q-driver q-brain mapped"]);
    // The VNF returns, and the capacity is too small for both mappings: the later one loses its reservation.
    let (mapped, notices) = lab.place("r-brain", "one");
    assert!(mapped.contains(&"r-driver r-brain mapped".to_owned()), "{mapped:?}");
    assert!(notices.len() == 1 && notices[0].contains("from `q` to `two`"), "{notices:?}");
    assert_eq!(lab.route("q", "two"), "q~U U-fast fast-two");
}

#[test]
fn a_path_over_another_radio_unit_waits_for_the_robot() {
    let mut lab = Lab::new();
    lab.0
        .instruct(
            Timestamp::ZERO,
            &Instruction::Place { vnf: "r-brain".parse().unwrap(), node: node("two").into() },
        )
        .unwrap();
    let (mapped, notices) = lab.map("r", "one", "r~S wide-S wide-one").unwrap();
    assert_eq!((mapped, notices.len()), (vec!["r-driver r-brain fallback".to_owned()], 0));
    assert_eq!(lab.route("r", "one"), FAST);
    {
        let mut fabric = lab.0.network.0.borrow_mut();
        fabric.attach(Timestamp::ZERO, &node("r"), &node("S")).unwrap();
        fabric.poll(Timestamp::from_secs_f64(1.0), &mut |_, _| {});
        assert_eq!(fabric.attached_to(&node("r")), Some(&node("S")));
    }
    // The fabric switches to the path by itself.
    assert_eq!(lab.route("r", "one"), "r~S wide-S wide-one");
    assert_eq!(reported(lab.0.remap().unwrap()).0, ["r-brain r-driver shortest", "r-driver r-brain mapped"]);
}

fn suggest(unit: &str) -> Instruction {
    Instruction::Suggest { robot: node("r"), radio_unit: node(unit) }
}

fn answer(status: u8) -> Event {
    Event::SuggestionAnswered { robot: node("r"), radio_unit: node("S"), status }
}

#[test]
fn a_robot_follows_a_suggestion() {
    let mut lab = Lab::new();
    assert_eq!(lab.0.instruct(Timestamp::ZERO, &suggest("U")).unwrap(), [], "it is there");
    assert_eq!(lab.0.instruct(Timestamp::ZERO, &suggest("S")).unwrap(), [answer(0)]);
    {
        let mut fabric = lab.0.network.0.borrow_mut();
        fabric.poll(Timestamp::from_secs_f64(1.0), &mut |_, _| {});
        assert_eq!(fabric.attached_to(&node("r")), Some(&node("S")));
    }
    assert_eq!(lab.instruct(&suggest("one")).unwrap_err(), "there is no radio unit `one`");
}

#[test]
fn a_robot_rejects_a_radio_unit_out_of_reach() {
    let mut lab = Lab::new();
    let far = Position { x: -5000.0, y: 0.0, z: 0.0 };
    lab.0.network.0.borrow_mut().move_robot(Timestamp::ZERO, &node("r"), far).unwrap();
    assert_eq!(lab.0.instruct(Timestamp::ZERO, &suggest("S")).unwrap(), [answer(7)]);
    assert_eq!(lab.0.network.0.borrow().attached_to(&node("r")), Some(&node("U")));
    lab.0.network.0.borrow_mut().switch_off(Timestamp::ZERO, &node("U")).unwrap();
    let rejected = lab.instruct(&suggest("S")).unwrap_err();
    assert_eq!(rejected, "`r` is at no radio unit, which could suggest another one");
}

#[test]
fn a_node_that_is_a_container_is_managed_there_and_takes_no_room() {
    let mut testbed =
        cotorra_testbed_file::parse("x", TESTBED, FilePath::new("")).unwrap_or_else(|e| panic!("{e}"));
    testbed.containers.hosts.push(Vnf {
        program: Program::Host(Vec::new()),
        cpus: 4.0,
        memory_bytes: 8_000_000_000,
        pinned_to: Some(node("one")),
        image: Some(Box::new(Image { reference: "router:1".to_owned(), ..Image::default() })),
        ..base::vnf("one", "one")
    });
    let network = Here::new(&testbed.graph);
    let mut lab = Lab(NetworkControl::new(&testbed, network, InMemoryEngine::default()));
    lab.0.start(Timestamp::ZERO);
    assert!(!lab.0.all_ready());
    lab.0.poll(Timestamp::ZERO).unwrap();
    assert!(lab.0.all_ready());
    let host = VnfId::new("one").unwrap();
    assert_eq!(lab.0.serving(&host), [&node("one")]);
    let elsewhere = Instruction::Place { vnf: host, node: node("two").into() };
    assert_eq!(lab.instruct(&elsewhere).unwrap_err(), "VNF `one` is pinned to `one`");
    lab.place("q-brain", "two");
    lab.place("q-brain", "one");
}
