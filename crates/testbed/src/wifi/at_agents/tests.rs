use std::path::Path;

use cotorra_wifi::DomainKey;

use super::*;

const TESTBED: &str = "
name: corridor
wireless:
  lab: { access: edca, wifi: hardware, security: { method: wpa2, passphrase: correct horse } }
nodes:
  A: { kind: radio_unit, position: [0, 0], channel: 1, tx_power: 10 dBm, agent: ap1, interface: wlan1 }
  B: { kind: radio_unit, position: [9, 0], channel: 6, agent: ap2, interface: wlan2, bridge: br0 }
  r1: { kind: robot, position: [4, 0], tx_power: 15 dBm, agent: turtle1, interface: wlan0 }
links:
  - { ends: [A, B] }
";

const NODES: [(&str, &str, &str, u8); 3] =
    [("r1", "turtle1", "wlan0", 0), ("A", "ap1", "wlan1", 1), ("B", "ap2", "wlan2", 2)];

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn mac(number: u8) -> MacAddress {
    MacAddress([2, 0, 0, 0, number, 0])
}

fn at(ms: u64) -> Timestamp {
    Timestamp::ZERO + Duration::from_millis(ms)
}

fn place(node: &str) -> Place {
    let (_, agent, interface, _) = NODES.into_iter().find(|(name, ..)| *name == node).unwrap();
    Place { agent: agent.parse().unwrap(), interface: interface.parse().unwrap() }
}

fn bssid(node: &str) -> MacAddress {
    mac(NODES.into_iter().find(|(name, ..)| *name == node).unwrap().3)
}

/// The output, in order.
#[derive(Debug, Clone, PartialEq)]
enum Out {
    Wish(Place, Wish),
    Change(Change),
    Notice(String),
    Vnf(NodeId, cotorra_graph::VnfState),
    Answered(NodeId, u8),
}

struct World {
    radios: AtAgents,
    now: Arc<Mutex<Timestamp>>,
    out: Arc<Mutex<Vec<Out>>>,
}

impl World {
    fn new() -> Self {
        let testbed = cotorra_testbed_file::parse("test", TESTBED, Path::new(""));
        let graph = testbed.unwrap_or_else(|error| panic!("{error:?}")).graph;
        let addresses: BTreeMap<_, _> = NODES.into_iter().map(|(node, ..)| (id(node), bssid(node))).collect();
        let plan = Plan::of_hardware(&graph, &addresses, &DomainKey::new([1; 32])).unwrap().unwrap();
        let now = Arc::new(Mutex::new(Timestamp::ZERO));
        let out: Arc<Mutex<Vec<Out>>> = Arc::default();
        let [wishes, changes, reports] = [0; 3].map(|_| Arc::clone(&out));
        let clock = Arc::clone(&now);
        let outlets = Outlets {
            now: Arc::new(move || *clock.lock()),
            wishes: Box::new(move |place, wish| wishes.lock().push(Out::Wish(place.clone(), wish))),
            change: Box::new(move |change| {
                changes.lock().push(Out::Change(change));
                Ok(())
            }),
            report: Box::new(move |event| {
                reports.lock().push(match event {
                    Event::Notice { message } => Out::Notice(message),
                    Event::Vnf(event) => Out::Vnf(event.node, event.state),
                    Event::SuggestionAnswered { robot, status, .. } => Out::Answered(robot, status),
                    other => panic!("{other:?}"),
                });
            }),
        };
        let manager = Arc::new(Mutex::new(Manager::new(Timestamp::ZERO, plan.clone())));
        let places = places(&graph).unwrap();
        let programs = programs(&graph, &places);
        let radios = AtAgents::new(manager, plan, outlets, Arc::new(Figures::new(addresses)), programs);
        let mut world = Self { radios, now, out };
        assert_eq!(world.radios.send_robots_ahead(), [place("r1")].into());
        let out = world.act();
        let order: Vec<_> = used(&out).into_iter().map(|(place, _)| place.clone()).collect();
        assert_eq!(order, ["r1", "A", "B"].map(place));
        world
    }

    /// Does what is due now. Returns what came out since the last call.
    fn act(&mut self) -> Vec<Out> {
        let now = *self.now.lock();
        self.radios.manager.lock().advance(now);
        self.radios.act(now);
        std::mem::take(&mut self.out.lock())
    }

    fn pass_until(&mut self, ms: u64) -> Vec<Out> {
        *self.now.lock() = at(ms);
        self.act()
    }

    fn take(&mut self, news: News) -> Vec<Out> {
        self.radios.take(news);
        self.act()
    }

    fn ready(&mut self, node: &str) -> Vec<Out> {
        self.take(News::State(place(node), RadioState::Ready))
    }

    /// Lets an agent report an event of this time.
    fn event(&mut self, node: &str, ms: u64, event: WifiEvent) -> Vec<Out> {
        self.take(News::Event(place(node), at(ms), event))
    }

    /// Lets all radio units serve, and the robot be at `A`.
    fn up() -> Self {
        let mut world = Self::new();
        for unit in ["A", "B"] {
            world.event(unit, 0, WifiEvent::AccessPointEnabled);
            world.ready(unit);
        }
        world.ready("r1");
        world.event("r1", 0, WifiEvent::Connected { bssid: bssid("A") });
        world.event("A", 0, WifiEvent::StationConnected { station: bssid("r1") });
        assert_eq!(world.radios.manager.lock().standing(), "radio units A, B serve; r1 is at A");
        world
    }
}

fn used(out: &[Out]) -> Vec<(&Place, &WantedRadio)> {
    out.iter()
        .filter_map(|out| match out {
            Out::Wish(place, Wish::Use(wanted)) => Some((place, wanted)),
            _ => None,
        })
        .collect()
}

fn requests(out: &[Out]) -> Vec<(u64, &WifiRequest)> {
    out.iter()
        .filter_map(|out| match out {
            Out::Wish(_, Wish::Request(number, request)) => Some((*number, request)),
            _ => None,
        })
        .collect()
}

fn failed() -> Result<(), RequestError> {
    Err(RequestError::Refused("ROAM at /run: the program failed".to_owned()))
}

#[test]
fn robots_are_told_before_radio_units_serve_which_bring_their_settings() {
    let mut world = World::new();
    let programs: BTreeMap<_, _> = world
        .radios
        .programs
        .iter()
        .map(|(program, remote)| (program.clone(), remote.told.clone()))
        .collect();
    let wanted = |program: &Program| programs[program].clone();
    let access_point = |unit| match wanted(&Program::Hostapd(id(unit))) {
        Some(WantedRadio::AccessPoint(settings)) => settings,
        other => panic!("{other:?}"),
    };
    let (a, b) = (access_point("A"), access_point("B"));
    assert_eq!(b.bss.bridge, "br0".parse().ok());
    assert_eq!(a.power, Some(Power::AtMost(1000)));
    assert_eq!(a.neighbours.iter().map(|its| its.bssid).collect::<Vec<_>>(), [bssid("B")]);
    assert_eq!((a.bss.bridge.clone(), a.bss.bssid), (None, None), "its owner's bridge and address");
    world.ready("r1");
    world.ready("A");
    world.event("A", 0, WifiEvent::AccessPointEnabled);
    // The event comes before the state.
    let out = world.event("B", 0, WifiEvent::AccessPointEnabled);
    assert!(used(&out).is_empty(), "its agent knows: {out:?}");
    let Some(WantedRadio::Station(station)) = wanted(&Program::Supplicant(id("r1"))) else {
        panic!("it is a station")
    };
    assert_eq!(station.power, Some(Power::AtMost(1500)));
    world.event("r1", 0, WifiEvent::Connected { bssid: bssid("B") });
    assert_eq!(world.radios.manager.lock().standing(), "radio units A, B serve; r1 is at B");
}

#[test]
fn a_gap_is_that_of_the_frames_however_late_an_agent_reports() {
    let mut world = World::up();
    world.pass_until(1000);
    world.radios.manager.lock().attach(at(1000), &id("r1"), &id("B")).unwrap();
    let out = world.act();
    let roam = WifiRequest::Roam { to: bssid("B"), over_ds: false };
    assert_eq!(requests(&out), [(1, &roam)]);
    world.take(News::Answered(1, Ok(())));
    *world.now.lock() = at(1200);
    world.event("r1", 1010, WifiEvent::Authenticating { bssid: bssid("B") });
    *world.now.lock() = at(1300);
    let out = world.event("r1", 1025, WifiEvent::Connected { bssid: bssid("B") });
    // 15 ms before the emulated network takes it.
    let (robot, radio_unit, began) = (id("r1"), id("B"), at(1285));
    assert_eq!(out, [Out::Change(Change::Associate { robot, radio_unit, began, fast: true })]);
}

#[test]
fn a_refused_roam_is_tried_again_after_a_scan_and_then_reported() {
    let mut world = World::up();
    world.radios.manager.lock().attach(at(0), &id("r1"), &id("B")).unwrap();
    world.act();
    let out = world.take(News::Answered(1, failed()));
    assert!(matches!(requests(&out)[..], [(2, WifiRequest::Scan { stays: true, .. })]), "{out:?}");
    world.take(News::Answered(2, Ok(())));
    let out = world.event("r1", 0, WifiEvent::ScanResults);
    assert!(out.contains(&Out::Change(Change::Scanned { robot: id("r1") })));
    assert!(matches!(requests(&out)[..], [(3, WifiRequest::Roam { .. })]), "{out:?}");
    let out = world.take(News::Answered(3, failed()));
    assert_eq!(out, [Out::Notice("`r1` was not attached to `B`: it does not hear it".to_owned())]);
}

#[test]
fn a_scan_that_is_under_way_will_do_for_a_robot_that_is_sent_elsewhere() {
    let mut world = World::up();
    world.radios.manager.lock().attach(at(0), &id("r1"), &id("B")).unwrap();
    world.act();
    world.take(News::Answered(1, failed()));
    assert_eq!(world.take(News::Answered(2, Err(RequestError::Busy))), []);
    let out = world.event("r1", 0, WifiEvent::ScanResults);
    assert!(matches!(requests(&out)[..], [(3, WifiRequest::Roam { .. })]), "{out:?}");
}

#[test]
fn the_agent_of_the_radio_unit_suggests_another_one() {
    let mut world = World::up();
    world.radios.manager.lock().suggest(at(0), &id("r1"), &id("B")).unwrap();
    let out = world.act();
    let [Out::Wish(asked, Wish::Request(1, WifiRequest::AskToMove { station, to, urgency }))] = &out[..]
    else {
        panic!("{out:?}")
    };
    assert_eq!((asked, *station, to[0].bssid), (&place("A"), bssid("r1"), bssid("B")));
    assert_eq!((to.len(), *urgency), (1, Urgency::Suggestion));
    assert_eq!(world.take(News::Answered(1, Ok(()))), []);
    let event = WifiEvent::MoveAnswered { station: bssid("r1"), status: 1, target: None };
    assert_eq!(world.event("A", 3, event), [Out::Answered(id("r1"), 1)]);
}

#[test]
fn a_radio_unit_is_off_while_its_agent_is_lost() {
    let mut world = World::up();
    let out = world.take(News::Left("ap1".parse().unwrap(), "its connection ended".to_owned()));
    assert!(out.contains(&Out::Change(Change::SwitchOff { radio_unit: id("A") })), "{out:?}");
    assert!(out.contains(&Out::Vnf(id("A"), cotorra_graph::VnfState::Died)));
    // It is wanted again, and comes back with its agent, which knows.
    assert_eq!(world.pass_until(100), []);
    world.take(News::Joined { agent: "ap1".parse().unwrap(), boot: 2 });
    assert!(world.take(News::State(place("A"), RadioState::Changing)).is_empty());
    let out = world.event("A", 100, WifiEvent::AccessPointEnabled);
    assert!(matches!(&out[0], Out::Change(Change::SwitchOn { radio_unit, .. }) if *radio_unit == id("A")));
    world.ready("A");
    assert_eq!(world.radios.manager.lock().standing(), "radio units A, B serve; r1 is at no radio unit");
}

#[test]
fn a_robot_that_was_out_of_reach_is_where_it_was() {
    let mut world = World::up();
    let agent: AgentId = "turtle1".parse().unwrap();
    world.take(News::Joined { agent: agent.clone(), boot: 1 });
    world.event("r1", 0, WifiEvent::Connected { bssid: bssid("A") });
    let out = world.take(News::Left(agent.clone(), "it did not report for 2s".to_owned()));
    assert!(out.contains(&Out::Change(Change::Disassociate { robot: id("r1") })), "{out:?}");
    world.pass_until(100);
    // Its process is the same, and reports nothing that it did before.
    world.take(News::Joined { agent: agent.clone(), boot: 1 });
    let out = world.ready("r1");
    assert!(
        matches!(&out[..], [Out::Change(Change::Associate { radio_unit, .. })] if *radio_unit == id("A"))
    );
    // A new process begins anew.
    world.take(News::Left(agent.clone(), "its connection ended".to_owned()));
    world.pass_until(1000);
    world.take(News::Joined { agent, boot: 2 });
    assert_eq!(world.ready("r1"), []);
}

#[test]
fn a_program_that_is_back_before_it_is_wanted_again_counts_then() {
    let mut world = World::up();
    world.take(News::State(place("A"), RadioState::Failed("its program has ended".to_owned())));
    // The agent is faster than the core.
    world.event("A", 10, WifiEvent::AccessPointEnabled);
    assert!(world.ready("A").is_empty());
    let out = world.pass_until(100);
    let on =
        |out: &Out| matches!(out, Out::Change(Change::SwitchOn { radio_unit, .. }) if *radio_unit == id("A"));
    assert!(out.iter().any(on), "{out:?}");
}

#[test]
fn an_interface_that_is_not_lent_ends_the_start() {
    let mut world = World::new();
    world.take(News::State(place("B"), RadioState::Failed("its agent needs `--wifi wlan2`".to_owned())));
    let manager = world.radios.manager.lock();
    assert_eq!(manager.failure(), Some("hostapd of `B` cannot be started: its agent needs `--wifi wlan2`"));
}

#[test]
fn all_radios_are_left_to_their_owners_in_the_end() {
    let mut world = World::up();
    world.radios.manager.lock().stop();
    let released: Vec<_> = ["r1", "A", "B"].map(|node| Out::Wish(place(node), Wish::Release)).into();
    assert_eq!(world.act(), released);
}

#[test]
fn addresses_are_awaited_and_missing_ones_are_named() {
    let testbed = cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap();
    let places = places(&testbed.graph).unwrap();
    let (sender, inbox) = mpsc::channel();
    let now: Clock = Arc::new(|| Timestamp::ZERO);
    for (_, agent, interface, number) in NODES {
        let addresses = BTreeMap::from([(interface.parse().unwrap(), mac(number))]);
        let reading = Reading { addresses, ..Reading::default() };
        sender.send(Message::News(News::Read(agent.parse().unwrap(), reading))).unwrap();
    }
    let expected: BTreeMap<_, _> = NODES.into_iter().map(|(node, ..)| (id(node), bssid(node))).collect();
    assert_eq!(await_addresses(&places, &inbox, &now, Duration::ZERO), Ok(expected));
    // Nothing more arrives.
    let missing = await_addresses(&places, &inbox, &now, Duration::ZERO).unwrap_err();
    assert_eq!(missing.len(), 3);
}
