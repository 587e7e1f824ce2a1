use std::{path::Path, time::Duration};

use cotorra_graph::{self as graph, RadioKind, Security, VnfEvent, VnfState, WifiSoftware};
use cotorra_wifi::{DisabledReason, DomainKey, Event as WifiEvent};

use super::*;

mod suggesting;

const TESTBED: &str = "
name: corridor
wireless:
  lab: { mobility_domain: 7, access: edca }
  other: { access: edca }
nodes:
  A: { kind: radio_unit, position: [0, 0], channel: 1, network: lab }
  B: { kind: radio_unit, position: [9, 0], channel: 6, network: lab }
  C: { kind: radio_unit, position: [9, 9], channel: 11, network: lab, serving: false }
  X: { kind: radio_unit, position: [9, 5], channel: 11, network: other }
  r1: { kind: robot, position: [0, 1], network: lab }
  r2: { kind: robot, position: [0, 2], network: lab, roaming: signal }
links:
  - { ends: [A, [B, C, X]] }
";

/// A manager and its clock.
struct World {
    manager: Manager,
    now: Timestamp,
    plan: Plan,
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn hostapd(unit: &str) -> Program {
    Program::Hostapd(id(unit))
}

fn supplicant(robot: &str) -> Program {
    Program::Supplicant(id(robot))
}

impl World {
    fn new() -> Self {
        Self::with(|_| {})
    }

    fn with(change: impl FnOnce(&mut graph::HardwareGraph)) -> Self {
        let testbed = cotorra_testbed_file::parse("test", TESTBED, Path::new(""));
        let mut graph = testbed.unwrap_or_else(|error| panic!("{error:?}")).graph;
        for network in graph.wireless.values_mut() {
            let passphrase = "correct horse".to_owned();
            let management_frames = graph::Protection::Optional;
            let security = Security::Wpa2 { passphrase, management_frames, over_ds: false };
            network.access.contention_mut().unwrap().software =
                Some(WifiSoftware { radios: RadioKind::Hwsim, ssid: None, security });
        }
        change(&mut graph);
        let plan = Plan::new(&graph, &DomainKey::new([1; 32])).unwrap().unwrap();
        let now = Timestamp::ZERO;
        Self { manager: Manager::new(now, plan.clone()), now, plan }
    }

    /// A world in which everything has begun: `r1` at A, and `r2` at B.
    fn up() -> Self {
        let mut world = Self::new();
        world.serve_all();
        world.run("r1");
        world.run("r2");
        world.join("r1", "A");
        world.join("r2", "B");
        world.actions();
        assert!(world.manager.is_up());
        world
    }

    fn serve_all(&mut self) {
        for unit in ["A", "B", "X"] {
            self.handle(Input::Started(hostapd(unit)));
            self.unit_event(unit, WifiEvent::AccessPointEnabled);
        }
    }

    fn run(&mut self, robot: &str) {
        self.handle(Input::Started(supplicant(robot)));
    }

    fn join(&mut self, robot: &str, unit: &str) {
        let bssid = self.bssid(unit);
        self.event(robot, WifiEvent::Authenticating { bssid });
        self.event(robot, WifiEvent::Connected { bssid });
        self.has_keys(robot, unit);
    }

    /// Lets a radio unit have keys for a robot.
    fn has_keys(&mut self, robot: &str, unit: &str) {
        let station = self.plan.robots[&id(robot)].address;
        self.unit_event(unit, WifiEvent::StationConnected { station });
    }

    fn pass(&mut self, ms: u64) {
        self.now = self.now + Duration::from_millis(ms);
        self.manager.advance(self.now);
    }

    fn handle(&mut self, input: Input) {
        self.manager.handle(self.now, input);
    }

    fn event(&mut self, robot: &str, event: WifiEvent) {
        self.handle(Input::Event { program: supplicant(robot), event });
    }

    fn unit_event(&mut self, unit: &str, event: WifiEvent) {
        self.handle(Input::Event { program: hostapd(unit), event });
    }

    fn refuse(&mut self, robot: &str, request: Request, reason: Refused) {
        self.handle(Input::Refused { program: supplicant(robot), request, reason });
    }

    fn attach(&mut self, robot: &str, unit: &str) -> Result<(), String> {
        self.manager.attach(self.now, &id(robot), &id(unit)).map_err(|reason| reason.to_string())
    }

    fn bssid(&self, unit: &str) -> MacAddress {
        self.plan.units[&id(unit)].bssid
    }

    fn actions(&mut self) -> Vec<Action> {
        std::iter::from_fn(|| self.manager.poll_action()).collect()
    }

    fn changes(&mut self) -> Vec<Change> {
        let change = |action| if let Action::Change(change) = action { Some(change) } else { None };
        self.actions().into_iter().filter_map(change).collect()
    }

    fn requests(&mut self) -> Vec<Request> {
        let request =
            |action| if let Action::Request { request, .. } = action { Some(request) } else { None };
        self.actions().into_iter().filter_map(request).collect()
    }

    fn notices(&mut self) -> Vec<String> {
        let notice = |action| match action {
            Action::Report(Event::Notice { message }) => Some(message),
            _ => None,
        };
        self.actions().into_iter().filter_map(notice).collect()
    }

    fn started(&mut self) -> Vec<Program> {
        let start = |action| if let Action::Start { program, .. } = action { Some(program) } else { None };
        self.actions().into_iter().filter_map(start).collect()
    }

    fn roam_to(&self, unit: &str) -> Request {
        Request::Roam { to: self.bssid(unit), over_ds: false }
    }
}

fn died(unit: &str, detail: &str) -> Action {
    life(unit, VnfState::Died, Some(detail.to_owned()))
}

fn life(unit: &str, state: VnfState, detail: Option<String>) -> Action {
    let vnf = graph::AccessPoint::vnf(&id(unit));
    Action::Report(Event::Vnf(VnfEvent { vnf, node: id(unit), state, detail }))
}

fn lab(mobility_domain: u16) -> graph::AccessPoint {
    graph::AccessPoint { ssid: "lab".into(), mobility_domain, key: None, core: None }
}

#[test]
fn robots_start_once_all_radio_units_serve() {
    let mut world = World::new();
    assert_eq!(world.started(), [hostapd("A"), hostapd("B"), hostapd("X")]);
    for unit in ["A", "B"] {
        world.handle(Input::Started(hostapd(unit)));
        world.unit_event(unit, WifiEvent::AccessPointEnabled);
    }
    world.handle(Input::Started(hostapd("X")));
    assert_eq!(world.started(), []);
    assert_eq!(world.manager.awaited()[0], "hostapd of `X`");
    world.unit_event("X", WifiEvent::AccessPointEnabled);
    let actions = world.actions();
    assert!(actions.contains(&Action::Change(Change::SwitchOn {
        radio_unit: id("X"),
        access_point: graph::AccessPoint { ssid: "other".into(), ..lab(1) },
    })));
    let start = |robot: &str| {
        let configuration = Configuration::Station(Box::new(world.plan.robots[&id(robot)].station.clone()));
        Action::Start { program: supplicant(robot), configuration }
    };
    assert_eq!(actions[actions.len() - 2..], [start("r1"), start("r2")]);
}

#[test]
fn stations_are_told_about_neighbours_of_their_network() {
    let mut world = World::new();
    world.actions();
    world.handle(Input::Started(hostapd("A")));
    let neighbours = |request| match request {
        Request::SetNeighbour(neighbour) => neighbour.bssid,
        other => panic!("{other:?}"),
    };
    let told: Vec<_> = world.requests().into_iter().map(neighbours).collect();
    assert_eq!(told, [world.bssid("B"), world.bssid("C")]);
}

#[test]
fn a_robot_out_of_reach_holds_the_start_up_for_a_time() {
    let mut world = World::new();
    world.serve_all();
    world.run("r1");
    world.run("r2");
    world.join("r1", "A");
    assert!(!world.manager.is_up());
    assert_eq!(world.manager.awaited(), ["wpa_supplicant of `r2`"]);
    assert_eq!(world.manager.standing(), "radio units A, B, X serve; r1 is at A, r2 is at no radio unit");
    assert_eq!(world.manager.deadline(), Some(Timestamp::ZERO + JOINING));
    world.pass(4999);
    assert!(!world.manager.is_up());
    world.pass(1);
    assert!(world.manager.is_up());
    assert_eq!(world.manager.deadline(), None);
}

#[test]
fn the_start_fails_with_the_first_program_that_cannot_be_started() {
    let mut world = World::new();
    let reason = "its radio is gone".to_owned();
    world.handle(Input::Ended { program: hostapd("B"), reason });
    assert_eq!(world.manager.failure(), Some("hostapd of `B` cannot be started: its radio is gone"));
    let mut world = World::up();
    world.handle(Input::Ended { program: hostapd("B"), reason: "it was killed".to_owned() });
    assert_eq!(world.manager.failure(), None);
}

#[test]
fn a_roam_without_a_key_handshake_is_fast_and_begins_with_its_authentication() {
    let mut world = World::up();
    let bssid = world.bssid("B");
    world.pass(100);
    let began = world.now;
    world.event("r1", WifiEvent::Authenticating { bssid });
    world.pass(10);
    world.event("r1", WifiEvent::Associating { bssid });
    world.event("r1", WifiEvent::Associated { bssid });
    world.pass(20);
    world.event("r1", WifiEvent::Connected { bssid });
    let associate = |fast, began| Change::Associate { robot: id("r1"), radio_unit: id("B"), began, fast };
    assert_eq!(world.changes(), [associate(true, began)]);
    world.event("r1", WifiEvent::AssociationHandled);
    // A renewed key is no roam.
    world.event("r1", WifiEvent::Connected { bssid });
    assert_eq!(world.changes(), []);
    world.event("r1", WifiEvent::Disconnected { bssid, reason: 3, locally: true });
    assert_eq!(world.changes(), [Change::Disassociate { robot: id("r1") }]);
    // Over the distribution system, nothing is known before the association.
    world.pass(100);
    let began = world.now;
    world.event("r1", WifiEvent::Associating { bssid });
    world.pass(10);
    world.event("r1", WifiEvent::AssociationHandled);
    world.event("r1", WifiEvent::Connected { bssid });
    assert_eq!(world.changes(), [associate(false, began)]);
}

#[test]
fn another_try_begins_anew() {
    let mut world = World::up();
    let [b, a] = ["B", "A"].map(|unit| world.bssid(unit));
    world.event("r1", WifiEvent::Authenticating { bssid: b });
    world.event("r1", WifiEvent::AssociationHandled);
    world.pass(1000);
    world.event("r1", WifiEvent::Authenticating { bssid: b });
    world.event("r1", WifiEvent::Connected { bssid: b });
    let [Change::Associate { began, fast: true, .. }] = world.changes()[..] else { panic!() };
    assert_eq!(began, world.now);
    // It tries another one, and stays.
    world.event("r1", WifiEvent::Authenticating { bssid: a });
    world.event("r1", WifiEvent::AuthenticationRejected { bssid: a, status: 54 });
    world.event("r1", WifiEvent::Connected { bssid: b });
    let actions = world.actions();
    let message = "`A` refused `r1` with status 54, another mobility domain".to_owned();
    assert_eq!(actions, [Action::Report(Event::Notice { message })]);
}

#[test]
fn only_the_present_radio_unit_can_be_lost() {
    let mut world = World::up();
    let [a, b] = ["A", "B"].map(|unit| world.bssid(unit));
    world.event("r1", WifiEvent::Disconnected { bssid: b, reason: 3, locally: true });
    assert_eq!(world.changes(), []);
    world.event("r1", WifiEvent::Disconnected { bssid: a, reason: 7, locally: false });
    let message = "`A` disconnected `r1` for reason 7, it sent before it was associated".to_owned();
    let lost = Action::Change(Change::Disassociate { robot: id("r1") });
    assert_eq!(world.actions(), [lost, Action::Report(Event::Notice { message })]);
    world.event("r1", WifiEvent::Disconnected { bssid: a, reason: 3, locally: true });
    assert_eq!(world.changes(), []);
}

#[test]
fn an_instructed_robot_roams_at_once_if_it_knows_the_radio_unit() {
    let mut world = World::up();
    world.attach("r1", "B").unwrap();
    assert_eq!(world.requests(), [world.roam_to("B")]);
    assert_eq!(world.manager.deadline(), Some(world.now + PATIENCE));
    assert!(world.attach("r1", "B").unwrap_err().contains("`r1` is scanning or changing its radio unit"));
    world.join("r1", "B");
    assert_eq!(world.manager.deadline(), None);
    assert_eq!(world.notices(), [""; 0]);
    world.attach("r1", "B").unwrap();
    assert_eq!(world.actions(), []);
}

#[test]
fn an_instructed_robot_scans_for_a_radio_unit_that_it_does_not_know() {
    let mut world = World::up();
    let failed = || Refused::Other("the program refused".to_owned());
    let scan = |world: &World| {
        let channels = vec![world.plan.units[&id("B")].channel()];
        Request::Scan { channels, stays: true }
    };
    world.attach("r1", "B").unwrap();
    world.actions();
    world.refuse("r1", world.roam_to("B"), failed());
    assert_eq!(world.requests(), [scan(&world)]);
    world.event("r1", WifiEvent::ScanStarted);
    world.event("r1", WifiEvent::ScanResults);
    let scanned = Action::Change(Change::Scanned { robot: id("r1") });
    let to_robot = |request| Action::Request { program: supplicant("r1"), request };
    let roam = to_robot(world.roam_to("B"));
    assert_eq!(world.actions(), [scanned, to_robot(Request::ReadHeard), roam]);
    world.refuse("r1", world.roam_to("B"), failed());
    assert_eq!(world.notices(), ["`r1` was not attached to `B`: it does not hear it"]);
    // A scan that is under way will do as well.
    world.pass(20_000);
    world.attach("r1", "B").unwrap();
    world.refuse("r1", world.roam_to("B"), failed());
    world.refuse("r1", scan(&world), Refused::Busy);
    world.actions();
    world.event("r1", WifiEvent::ScanResults);
    assert!(world.requests().contains(&world.roam_to("B")));
    world.join("r1", "B");
    assert_eq!(world.notices(), [""; 0]);
}

#[test]
fn a_robot_without_a_radio_unit_looks_for_the_instructed_one_only() {
    let mut world = World::up();
    let [a, b] = ["A", "B"].map(|unit| world.bssid(unit));
    let lose = |world: &mut World, bssid| {
        world.event("r1", WifiEvent::Disconnected { bssid, reason: 3, locally: true });
        // It looks around by itself.
        world.event("r1", WifiEvent::ScanStarted);
        world.actions();
    };
    lose(&mut world, a);
    world.attach("r1", "B").unwrap();
    let scan = Request::Scan { channels: vec![world.plan.units[&id("B")].channel()], stays: false };
    assert_eq!(world.requests(), [Request::Pin { to: Some(b) }, scan.clone()]);
    assert!(world.attach("r1", "A").unwrap_err().contains("`r1` is scanning or changing its radio unit"));
    // Its own scan will do as well.
    world.refuse("r1", scan.clone(), Refused::Busy);
    world.event("r1", WifiEvent::ScanResults);
    world.actions();
    world.join("r1", "B");
    assert_eq!(world.requests(), [Request::Pin { to: None }]);
    assert_eq!(world.manager.deadline(), None);
    // It does not come there, and may go anywhere again.
    lose(&mut world, b);
    world.attach("r1", "A").unwrap();
    world.actions();
    world.pass(10_000);
    let message = "`r1` was not attached to `A`: it did not come there within 10 s".to_owned();
    let any = Action::Request { program: supplicant("r1"), request: Request::Pin { to: None } };
    assert_eq!(world.actions(), [any.clone(), Action::Report(Event::Notice { message })]);
    // It cannot even look.
    world.attach("r1", "B").unwrap();
    world.actions();
    world.refuse("r1", scan, Refused::Other("no memory".to_owned()));
    let message = "`r1` was not attached to `B`: it cannot scan: no memory".to_owned();
    assert_eq!(world.actions(), [any, Action::Report(Event::Notice { message })]);
}

#[test]
fn failed_attachments_are_reported() {
    let mut world = World::up();
    world.attach("r1", "B").unwrap();
    world.pass(9999);
    assert_eq!(world.notices(), [""; 0]);
    world.pass(1);
    assert_eq!(world.notices(), ["`r1` was not attached to `B`: it did not come there within 10 s"]);
    world.attach("r2", "A").unwrap();
    let a = world.bssid("A");
    world.event("r2", WifiEvent::AssociationRejected { bssid: Some(a), status: 17 });
    world.join("r2", "B");
    let expected = [
        "`A` refused `r2` with status 17, too many stations",
        "`r2` was not attached to `A`: it joined `B` instead",
    ];
    assert_eq!(world.notices(), expected);
}

#[test]
fn impossible_attachments_are_rejected() {
    let mut world = World::up();
    assert_eq!(world.attach("r3", "A"), Err("there is no robot `r3`".to_owned()));
    assert_eq!(world.attach("r1", "D"), Err("there is no radio unit `D`".to_owned()));
    assert!(world.attach("r1", "X").unwrap_err().contains("serves another network"));
    assert!(world.attach("r1", "C").unwrap_err().contains("`C` is off"));
    world.handle(Input::Ended { program: supplicant("r2"), reason: "it was killed".to_owned() });
    assert!(world.attach("r2", "A").unwrap_err().contains("wpa_supplicant of `r2` does not run now"));
    world.actions();
    world.pass(0);
    assert_eq!(world.actions(), []);
}

#[test]
fn fast_transitions_over_the_distribution_system_stay_in_a_mobility_domain() {
    let over_ds = |graph: &mut graph::HardwareGraph| {
        for network in graph.wireless.values_mut() {
            let security = Security::Wpa3 { passphrase: "correct horse".to_owned(), over_ds: true };
            network.access.contention_mut().unwrap().software =
                Some(WifiSoftware { radios: RadioKind::Hwsim, ssid: None, security });
        }
    };
    let mut world = World::with(over_ds);
    world.serve_all();
    world.run("r1");
    world.join("r1", "A");
    world.manager.switch_on(&id("C"), lab(9)).unwrap();
    world.handle(Input::Started(hostapd("C")));
    world.unit_event("C", WifiEvent::AccessPointEnabled);
    world.actions();
    world.attach("r1", "B").unwrap();
    assert_eq!(world.requests(), [Request::Roam { to: world.bssid("B"), over_ds: true }]);
    world.join("r1", "B");
    world.attach("r1", "C").unwrap();
    assert_eq!(world.requests(), [Request::Roam { to: world.bssid("C"), over_ds: false }]);
}

#[test]
fn only_robots_that_decide_themselves_may_roam_after_a_scan() {
    let mut world = World::up();
    for (robot, stays) in [("r1", true), ("r2", false)] {
        world.manager.scan(world.now, &id(robot)).unwrap();
        let channels = world.plan.robots[&id(robot)].network().channels.clone();
        assert_eq!(world.requests(), [Request::Scan { channels, stays }]);
    }
    world.event("r1", WifiEvent::ScanStarted);
    assert!(world.manager.scan(world.now, &id("r1")).is_err());
    world.event("r1", WifiEvent::ScanFailed);
    world.manager.scan(world.now, &id("r1")).unwrap();
    let channels = world.plan.robots[&id("r1")].network().channels.clone();
    world.actions();
    world.refuse("r1", Request::Scan { channels, stays: true }, Refused::Other("no".to_owned()));
    assert_eq!(world.notices(), ["`r1` cannot scan: no"]);
}

#[test]
fn an_access_point_that_never_answers_does_not_keep_a_robot_busy() {
    let mut world = World::up();
    let bssid = world.bssid("B");
    world.event("r1", WifiEvent::Authenticating { bssid });
    assert!(world.attach("r1", "B").is_err());
    world.pass(10_000);
    world.attach("r1", "B").unwrap();
}

#[test]
fn a_radio_unit_whose_hostapd_died_is_off_until_it_serves_again() {
    let mut world = World::up();
    world.pass(500);
    world.handle(Input::Ended { program: hostapd("A"), reason: "it ended with signal: 9".to_owned() });
    let off = Action::Change(Change::SwitchOff { radio_unit: id("A") });
    let why = "it ended with signal: 9; it is started again in 100 ms";
    assert_eq!(world.actions(), [off, died("A", why)]);
    assert!(world.attach("r2", "A").unwrap_err().contains("`A` is off"));
    // The robot learns of it by itself, and comes back.
    let a = world.bssid("A");
    world.event("r1", WifiEvent::Disconnected { bssid: a, reason: 4, locally: true });
    assert_eq!(world.changes(), []);
    world.pass(99);
    assert_eq!(world.started(), []);
    world.pass(1);
    assert_eq!(world.started(), [hostapd("A")]);
    world.handle(Input::Started(hostapd("A")));
    world.actions();
    world.unit_event("A", WifiEvent::AccessPointEnabled);
    let on = Action::Change(Change::SwitchOn { radio_unit: id("A"), access_point: lab(7) });
    assert_eq!(world.actions(), [on, life("A", VnfState::Started, None)]);
    world.join("r1", "A");
    assert!(matches!(world.changes()[..], [Change::Associate { .. }]));
}

#[test]
fn a_robot_whose_supplicant_died_is_nowhere() {
    let mut world = World::up();
    world.attach("r1", "B").unwrap();
    world.actions();
    world.handle(Input::Ended {
        program: supplicant("r1"),
        reason: "it ended with exit status: 1".to_owned(),
    });
    let actions = world.actions();
    assert_eq!(actions[0], Action::Change(Change::Disassociate { robot: id("r1") }));
    let notice = |message: &str| Action::Report(Event::Notice { message: message.to_owned() });
    let expected = [
        notice("`r1` was not attached to `B`: its wpa_supplicant ended"),
        notice("wpa_supplicant of `r1`: it ended with exit status: 1; it is started again in 100 ms"),
    ];
    assert_eq!(actions[1..], expected);
    world.pass(100);
    assert_eq!(world.started(), [supplicant("r1")]);
    // Reports of an earlier process do not count.
    world.join("r1", "A");
    assert_eq!(world.changes(), []);
}

#[test]
fn vaps_are_deployed_and_removed() {
    let mut world = World::up();
    let check = |world: &World, unit: &str, access_point: &graph::AccessPoint| {
        world.manager.check_switch_on(&id(unit), access_point).map_err(|reason| reason.to_string())
    };
    assert!(check(&world, "A", &lab(7)).unwrap_err().contains("deployed on `A` already"));
    assert!(check(&world, "D", &lab(7)).unwrap_err().contains("no radio unit `D`"));
    let other = graph::AccessPoint { ssid: "other".into(), ..lab(7) };
    assert!(check(&world, "C", &other).unwrap_err().contains("made for the network `lab`"));
    assert!(world.manager.switch_off(&id("C")).unwrap_err().to_string().contains("`C` is off"));
    world.manager.switch_on(&id("C"), lab(9)).unwrap();
    let [Action::Start { program, configuration: Configuration::AccessPoint(access_point) }] =
        &world.actions()[..]
    else {
        panic!()
    };
    assert_eq!(*program, hostapd("C"));
    assert_eq!(access_point.bss.security.fast_transition().unwrap().domain.0, 9);
    world.handle(Input::Started(hostapd("C")));
    world.actions();
    world.unit_event("C", WifiEvent::AccessPointEnabled);
    let on = Action::Change(Change::SwitchOn { radio_unit: id("C"), access_point: lab(9) });
    assert_eq!(world.actions(), [on, life("C", VnfState::Started, None)]);
    world.manager.switch_off(&id("C")).unwrap();
    let off = Action::Change(Change::SwitchOff { radio_unit: id("C") });
    assert_eq!(world.actions(), [Action::Stop(hostapd("C")), off]);
    world.unit_event("C", WifiEvent::AccessPointEnabled);
    assert_eq!(world.actions(), []);
}

#[test]
fn programs_stop_with_those_of_robots_first() {
    let mut world = World::up();
    world.handle(Input::Ended { program: hostapd("B"), reason: "it was killed".to_owned() });
    world.manager.stop();
    let expected = ["r1", "r2"].map(supplicant).into_iter().chain(["A", "X"].map(hostapd));
    assert_eq!(world.actions(), expected.map(Action::Stop).collect::<Vec<_>>());
    world.pass(1000);
    world.join("r1", "B");
    assert_eq!(world.actions(), []);
}

#[test]
fn wrong_passphrases_are_reported_and_not_again_and_again() {
    let mut world = World::up();
    let disabled = |reason| WifiEvent::NetworkDisabled {
        network: 0,
        failures: 1,
        duration: Duration::from_secs(10),
        reason,
    };
    let message = "`r1` has a wrong passphrase for `lab`: it tries again after 10 s";
    world.event("r1", disabled(DisabledReason::WrongKey));
    assert_eq!(world.notices(), [message]);
    world.event("r1", disabled(DisabledReason::WrongKey));
    assert_eq!(world.notices(), [""; 0]);
    world.pass(10_000);
    world.event("r1", disabled(DisabledReason::WrongKey));
    assert_eq!(world.notices(), [message]);
    world.event("r1", disabled(DisabledReason::ConnectionFailed));
    assert_eq!(world.notices(), ["`r1` cannot join `lab`: it tries again after 10 s"]);
    // The robot has reported it itself.
    let station = world.plan.robots[&id("r1")].address;
    world.unit_event("A", WifiEvent::PossibleWrongKey { station });
    assert_eq!(world.notices(), [""; 0]);
    let station = MacAddress([2, 9, 9, 9, 9, 9]);
    world.unit_event("A", WifiEvent::PossibleWrongKey { station });
    assert_eq!(
        world.notices(),
        ["a station that is no robot, 02:09:09:09:09:09, has a wrong passphrase for `A`"]
    );
}

#[test]
fn a_flood_of_notices_is_cut_off() {
    let mut world = World::up();
    for last in 0..=u8::MAX {
        let station = MacAddress([2, 9, 9, 9, 9, last]);
        world.unit_event("A", WifiEvent::PossibleWrongKey { station });
    }
    assert_eq!(world.notices().len(), MOST_NOTICES);
    world.pass(10_000);
    let station = MacAddress([2, 9, 9, 9, 9, 0]);
    world.unit_event("A", WifiEvent::PossibleWrongKey { station });
    assert_eq!(world.notices().len(), 1);
}

#[test]
fn strange_access_points_with_the_networks_name_are_reported_once() {
    let mut world = World::up();
    let heard = |bssid: MacAddress, ssid: &str| Heard {
        bssid,
        frequency_mhz: 2437,
        signal_dbm: -40,
        flags: "[ESS]".to_owned(),
        ssid: ssid.parse().ok(),
    };
    let stranger = MacAddress([2, 9, 9, 9, 9, 9]);
    let heard = vec![
        heard(world.bssid("A"), "lab"),
        heard(stranger, "lab"),
        heard(MacAddress([2, 9, 9, 9, 9, 8]), "neighbours"),
    ];
    world.handle(Input::Heard { robot: id("r1"), heard: heard.clone() });
    let message = "`r1` hears an access point that calls itself `lab` and is none of its network: 02:09:09:09:09:09 at \
                   2437 MHz with -40 dBm";
    assert_eq!(world.notices(), [message]);
    world.pass(60_000);
    world.handle(Input::Heard { robot: id("r2"), heard });
    assert_eq!(world.notices(), [""; 0]);
    world.event("r1", WifiEvent::Connected { bssid: stranger });
    let actions = world.actions();
    assert_eq!(actions[0], Action::Change(Change::Disassociate { robot: id("r1") }));
    let message = "`r1` joined an access point that is none of its network: 02:09:09:09:09:09".to_owned();
    assert_eq!(actions[1], Action::Report(Event::Notice { message }));
}

#[test]
fn an_access_point_of_another_network_with_the_same_ssid_is_a_stranger() {
    let mut world = World::with(|graph| {
        graph
            .wireless
            .get_mut("other")
            .unwrap()
            .access
            .contention_mut()
            .unwrap()
            .software
            .as_mut()
            .unwrap()
            .ssid = Some("lab".to_owned());
    });
    world.serve_all();
    world.run("r1");
    world.run("r2");
    world.join("r1", "A");
    world.actions();
    let rogue = world.bssid("X");
    let ssid = "lab".parse().ok();
    let heard = Heard { bssid: rogue, frequency_mhz: 2462, signal_dbm: -40, flags: "[ESS]".to_owned(), ssid };
    world.handle(Input::Heard { robot: id("r1"), heard: vec![heard] });
    let who = format!("`X` of network `other`, {rogue}");
    let message = format!(
        "`r1` hears an access point that calls itself `lab` and is none of its network: {who} at 2462 MHz with -40 dBm"
    );
    assert_eq!(world.notices(), [message]);
    assert!(world.attach("r1", "X").unwrap_err().contains("serves another network"));
    world.join("r1", "X");
    let message = format!("`r1` joined an access point that is none of its network: {who}");
    let lost = Action::Change(Change::Disassociate { robot: id("r1") });
    assert_eq!(world.actions(), [lost, Action::Report(Event::Notice { message })]);
    // Its own network's radio units are not told about it, though its channel is scanned.
    let neighbours = world.plan.neighbours(&id("A"));
    assert!(neighbours.iter().all(|neighbour| neighbour.bssid != rogue));
    let channels = &world.plan.robots[&id("r1")].network().channels;
    assert_eq!(channels.iter().map(|channel| channel.number()).collect::<Vec<_>>(), [1, 6, 11]);
}

fn with_key(byte: u8) -> graph::AccessPoint {
    graph::AccessPoint { key: Some(graph::FtKey([byte; 32])), ..lab(7) }
}

#[test]
fn an_access_point_with_a_key_takes_only_robots_that_have_it() {
    let mut world = World::up();
    world.manager.switch_on(&id("C"), with_key(1)).unwrap();
    world.handle(Input::Started(hostapd("C")));
    world.unit_event("C", WifiEvent::AccessPointEnabled);
    assert!(world.attach("r1", "C").unwrap_err().contains("does not admit `r1`"));
    world.manager.provision(&id("r1"), &id("C"), with_key(2)).unwrap();
    assert!(world.attach("r1", "C").unwrap_err().contains("does not admit `r1`"));
    world.manager.provision(&id("r1"), &id("C"), with_key(1)).unwrap();
    world.actions();
    let ssid = world.plan.robots[&id("r1")].network().ssid.clone();
    let [a, c] = ["A", "C"].map(|unit| world.bssid(unit));
    let set = |passphrase| Request::SetPassphrase { ssid: ssid.clone(), passphrase };
    let [key, usual] = [Passphrase::of_key(&[1; 32]), "correct horse".parse().unwrap()].map(set);
    let pin = |to| Request::Pin { to };
    // It looks for it, leaves its radio unit, and joins no other one.
    let leave = |world: &mut World, from: &str, to: &str| {
        world.attach("r1", to).unwrap();
        let channels = vec![world.plan.units[&id(to)].channel()];
        assert_eq!(world.requests(), [Request::Scan { channels, stays: true }]);
        world.event("r1", WifiEvent::ScanResults);
        let requests = world.requests();
        let bssid = world.bssid(from);
        world.event("r1", WifiEvent::Disconnected { bssid, reason: 3, locally: true });
        assert_eq!(world.actions(), []);
        requests
    };
    let began = world.now;
    let expected = [Request::ReadHeard, key.clone(), pin(Some(c)), Request::Rejoin];
    assert_eq!(leave(&mut world, "A", "C"), expected);
    world.pass(30);
    world.event("r1", WifiEvent::Authenticating { bssid: c });
    world.event("r1", WifiEvent::AssociationHandled);
    world.event("r1", WifiEvent::Connected { bssid: c });
    let (robot, radio_unit) = (id("r1"), id("C"));
    let associate = Action::Change(Change::Associate { robot, radio_unit, began, fast: false });
    let request = |request| Action::Request { program: supplicant("r1"), request };
    assert_eq!(world.actions(), [associate, request(pin(None))]);
    let expected = [Request::ReadHeard, usual.clone(), pin(Some(a)), Request::Rejoin];
    assert_eq!(leave(&mut world, "C", "A"), expected);
    world.join("r1", "A");
    assert_eq!(world.requests(), [pin(None)]);
    // It does not come there: it is nowhere, and may join any that takes its network's passphrase.
    leave(&mut world, "A", "C");
    world.pass(10_000);
    let lost = Action::Change(Change::Disassociate { robot: id("r1") });
    assert_eq!(world.actions()[..3], [lost, request(pin(None)), request(usual.clone())]);
    // From nowhere, it looks for it at once.
    world.attach("r1", "C").unwrap();
    let channels = vec![world.plan.units[&id("C")].channel()];
    assert_eq!(world.requests(), [key, pin(Some(c)), Request::Scan { channels, stays: false }]);
    world.join("r1", "C");
    world.actions();
    // It loses the radio unit.
    world.manager.switch_off(&id("C")).unwrap();
    assert_eq!(world.requests(), [usual]);
    world.join("r1", "A");
    // The key is taken back.
    world.manager.provision(&id("r1"), &id("C"), lab(7)).unwrap();
    world.manager.switch_on(&id("C"), with_key(1)).unwrap();
    world.handle(Input::Started(hostapd("C")));
    world.unit_event("C", WifiEvent::AccessPointEnabled);
    assert!(world.attach("r1", "C").unwrap_err().contains("does not admit `r1`"));
}

#[test]
fn keys_need_the_passphrase_of_wpa2() {
    let open = |graph: &mut graph::HardwareGraph| {
        let software = WifiSoftware { radios: RadioKind::Hwsim, ssid: None, security: Security::Open };
        graph
            .wireless
            .values_mut()
            .for_each(|network| network.access.contention_mut().unwrap().software = Some(software.clone()));
    };
    let world = World::with(open);
    let rejected = world.manager.check_switch_on(&id("C"), &with_key(1)).unwrap_err();
    assert!(rejected.to_string().contains("`security: wpa2` only"));
}
