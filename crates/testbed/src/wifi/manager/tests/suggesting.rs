use super::*;
use crate::wifi::manager::suggesting::KEYS;

impl World {
    fn suggest(&mut self, robot: &str, unit: &str) -> Result<(), String> {
        self.manager.suggest(self.now, &id(robot), &id(unit)).map_err(|reason| reason.to_string())
    }

    /// Returns the request to `A` that suggests `B` to `r1`.
    fn suggestion(&self) -> Request {
        let (station, unit) = (self.plan.robots[&id("r1")].address, &self.plan.units[&id("B")]);
        Request::Suggest { station, to: Box::new(unit.as_neighbour()) }
    }

    fn answer(&mut self, by: &str, status: u8) {
        let station = self.plan.robots[&id("r1")].address;
        let target = (status == 0).then(|| self.bssid("B"));
        self.unit_event(by, WifiEvent::MoveAnswered { station, status, target });
    }
}

fn answered(status: u8) -> Action {
    Action::Report(Event::SuggestionAnswered { robot: id("r1"), radio_unit: id("B"), status })
}

#[test]
fn a_radio_unit_asks_its_robot_whose_answer_is_reported() {
    let mut world = World::up();
    world.suggest("r1", "B").unwrap();
    let request = world.suggestion();
    assert_eq!(world.actions(), [Action::Request { program: hostapd("A"), request }]);
    assert!(world.suggest("r1", "B").unwrap_err().contains("is scanning or changing"));
    // Others do not answer for it.
    world.answer("B", 0);
    assert_eq!(world.actions(), []);
    world.answer("A", 0);
    assert_eq!(world.actions(), [answered(0)]);
    world.join("r1", "B");
    assert!(matches!(world.changes()[..], [Change::Associate { .. }]));
    world.suggest("r1", "B").unwrap();
    assert_eq!((world.actions(), world.manager.deadline()), (vec![], None), "it is there");
}

/// Returns a world in which `r1` has come back to `A`, which has no keys for it yet.
fn without_keys() -> World {
    let mut world = World::up();
    world.join("r1", "B");
    world.pass(100);
    let bssid = world.bssid("A");
    world.event("r1", WifiEvent::Authenticating { bssid });
    world.event("r1", WifiEvent::Connected { bssid });
    world.actions();
    world
}

#[test]
fn a_radio_unit_asks_once_it_has_keys_for_the_robot() {
    let mut world = without_keys();
    world.suggest("r1", "B").unwrap();
    world.has_keys("r2", "A");
    world.has_keys("r1", "B");
    assert_eq!(world.actions(), []);
    world.pass(3);
    world.has_keys("r1", "A");
    assert_eq!(world.requests(), [world.suggestion()]);
    // hostapd may report it twice.
    world.has_keys("r1", "A");
    world.pass(1000);
    assert_eq!(world.actions(), []);
    world.answer("A", 0);
    assert_eq!(world.actions(), [answered(0)]);
}

#[test]
fn a_radio_unit_that_reports_no_keys_asks_after_a_second() {
    let mut world = without_keys();
    world.suggest("r1", "B").unwrap();
    assert_eq!(world.manager.deadline(), Some(world.now + KEYS));
    world.pass(999);
    assert_eq!(world.actions(), []);
    world.pass(1);
    assert_eq!(world.requests(), [world.suggestion()]);
    world.pass(9000);
    assert_eq!(world.notices(), ["`r1` did not answer within 10 s that `A` suggests `B`"]);
}

#[test]
fn reports_of_keys_and_of_the_robot_may_come_in_either_order() {
    let mut world = World::up();
    world.join("r1", "B");
    world.pass(100);
    let (began, bssid) = (world.now, world.bssid("A"));
    world.pass(10);
    world.has_keys("r1", "A");
    for event in [WifiEvent::Authenticating { bssid }, WifiEvent::Connected { bssid }] {
        world.manager.handle(began, Input::Event { program: supplicant("r1"), event });
    }
    world.actions();
    world.suggest("r1", "B").unwrap();
    assert_eq!(world.requests(), [world.suggestion()]);
}

#[test]
fn a_rejected_suggestion_is_reported_and_another_may_follow() {
    let mut world = World::up();
    world.suggest("r1", "B").unwrap();
    world.answer("A", 7);
    assert_eq!(world.actions()[1..], [answered(7)]);
    // An unexpected answer belongs to no suggestion.
    world.answer("A", 0);
    assert_eq!(world.actions(), []);
    world.suggest("r1", "B").unwrap();
}

#[test]
fn a_suggestion_without_an_answer_is_reported() {
    let mut world = World::up();
    world.suggest("r1", "B").unwrap();
    assert_eq!(world.manager.deadline(), Some(world.now + PATIENCE));
    world.pass(10_000);
    assert_eq!(world.notices(), ["`r1` did not answer within 10 s that `A` suggests `B`"]);
    assert_eq!(world.manager.deadline(), None);
    world.suggest("r1", "B").unwrap();
    let request = world.suggestion();
    let reason = Refused::Other("the program failed".to_owned());
    world.handle(Input::Refused { program: hostapd("A"), request, reason });
    assert_eq!(world.notices(), ["`A` did not suggest `B` to `r1`: the program failed"]);
}

#[test]
fn only_radio_units_that_would_take_the_robot_are_suggested() {
    let mut world = World::up();
    for (unit, reason) in [("X", "another network"), ("C", "is off"), ("Z", "no radio unit `Z`")] {
        let rejected = world.suggest("r1", unit).unwrap_err();
        assert!(rejected.contains(reason), "{rejected}");
    }
    world.manager.provision(&id("r1"), &id("C"), with_key(1)).unwrap();
    world.manager.switch_on(&id("C"), with_key(1)).unwrap();
    world.handle(Input::Started(hostapd("C")));
    world.unit_event("C", WifiEvent::AccessPointEnabled);
    let rejected = world.suggest("r1", "C").unwrap_err();
    assert!(rejected.contains("takes another key"), "{rejected}");
    let bssid = world.bssid("A");
    world.event("r1", WifiEvent::Disconnected { bssid, reason: 3, locally: true });
    assert!(world.suggest("r1", "B").unwrap_err().contains("is at no radio unit"));
}
