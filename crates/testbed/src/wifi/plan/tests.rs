use std::path::Path;

use cotorra_graph::{RadioKind, Testbed, WifiSoftware};

use super::*;

const TESTBED: &str = "
name: corridor
wireless:
  lab: { mobility_domain: 7, access: edca }
  guests: { standard: ac, access: edca, fast_transition: false }
nodes:
  A: { kind: radio_unit, position: [0, 0], channel: 1, network: lab }
  B: { kind: radio_unit, position: [9, 0], channel: 6, network: lab, serving: false }
  C: { kind: radio_unit, position: [9, 9], channel: 36, network: guests }
  instructed: { kind: robot, position: [0, 1], network: lab }
  by_signal: { kind: robot, position: [0, 2], network: lab, roaming: signal }
  guest: { kind: robot, position: [0, 3], network: guests, roaming: supplicant }
links:
  - { ends: [A, [B, C]] }
";

fn testbed() -> Testbed {
    cotorra_testbed_file::parse("test", TESTBED, Path::new("")).unwrap_or_else(|error| panic!("{error:?}"))
}

fn wpa2(passphrase: &str) -> graph::Security {
    let management_frames = graph::Protection::Required;
    graph::Security::Wpa2 { passphrase: passphrase.to_owned(), management_frames, over_ds: true }
}

fn plan(network: &str, security: graph::Security) -> Result<Option<Plan>, PlanError> {
    let mut graph = testbed().graph;
    graph.wireless.get_mut(network).unwrap().access.contention_mut().unwrap().software =
        Some(WifiSoftware { radios: RadioKind::Hwsim, ssid: None, security });
    Plan::new(&graph, &DomainKey::new([1; 32]))
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

#[test]
fn networks_of_the_model_need_no_plan() {
    assert!(Plan::new(&testbed().graph, &DomainKey::new([1; 32])).unwrap().is_none());
}

#[test]
fn radio_units_of_a_network_are_one_mobility_domain() {
    let plan = plan("lab", wpa2("correct horse")).unwrap().unwrap();
    assert_eq!(plan.units.keys().collect::<Vec<_>>(), [&id("A"), &id("B")]);
    let [a, b] = [&plan.units[&id("A")], &plan.units[&id("B")]];
    assert!(a.serves && !b.serves);
    assert_eq!((a.channel().number(), b.channel().number()), (1, 6));
    assert_eq!(a.bssid.0, testbed().graph.address(&id("A")).unwrap().mac);
    let [in_a, in_b] = [a, b].map(|unit| unit.fast_transition().unwrap());
    assert_eq!((in_a.domain, in_b.domain), (MobilityDomain(7), MobilityDomain(7)));
    assert_ne!(in_a.holder, in_b.holder);
    assert_eq!(plan.unit_with(b.bssid), Some(&id("B")));
    let neighbours: Vec<_> = plan.neighbours(&id("A")).into_iter().map(|unit| unit.bssid).collect();
    assert_eq!(neighbours, [b.bssid]);
    let text = a.access_point.configuration(Path::new("/run/x"));
    for line in ["bridge=br0", "mobility_domain=0007", "ft_over_ds=1", "ieee80211w=2", "channel=1"] {
        assert!(text.lines().any(|of_text| of_text == line), "{line} is not in\n{text}");
    }
}

#[test]
fn a_virtual_access_point_can_be_in_another_mobility_domain() {
    let plan = plan("lab", wpa2("correct horse")).unwrap().unwrap();
    let settings =
        |mobility_domain, key| graph::AccessPoint { ssid: "lab".into(), mobility_domain, key, core: None };
    let elsewhere = plan.access_point(&id("B"), &settings(0xabc, None)).unwrap();
    assert_eq!(elsewhere.bss.security.fast_transition().unwrap().domain, MobilityDomain(0xabc));
    let usual = settings(7, None);
    assert_eq!(plan.access_point(&id("B"), &usual).unwrap(), plan.units[&id("B")].access_point);
    assert!(plan.access_point(&id("C"), &usual).is_none());
    let with_key = plan.access_point(&id("B"), &settings(7, Some(graph::FtKey([0xab; 32])))).unwrap();
    let Security::Wpa2 { passphrase, fast_transition: None, .. } = with_key.bss.security else { panic!() };
    assert_eq!(passphrase, Passphrase::of_key(&[0xab; 32]));
}

#[test]
fn units_of_wpa3_share_a_key() {
    let security = graph::Security::Wpa3 { passphrase: "correct horse".to_owned(), over_ds: false };
    let plan = plan("lab", security).unwrap().unwrap();
    for unit in plan.units.values() {
        let Security::Wpa3 { fast_transition: Some((fast, exchange)), .. } = &unit.access_point.bss.security
        else {
            panic!("{unit:?}")
        };
        assert!(!fast.over_ds);
        let Units::These(members) = &exchange.units else { panic!("{exchange:?}") };
        assert_eq!(members.len(), 2);
        assert!(members.contains(&(unit.bssid, fast.holder.clone())));
    }
}

#[test]
fn robots_scan_the_channels_of_their_network_as_their_policy_says() {
    let lab = plan("lab", wpa2("correct horse")).unwrap().unwrap();
    let network = |name: &str| lab.robots[&id(name)].network();
    let channels: Vec<_> = network("instructed").channels.iter().map(|channel| channel.number()).collect();
    assert_eq!(channels, [1, 6]);
    assert_eq!(network("instructed").background_scan, None);
    assert!(lab.robots[&id("instructed")].is_instructed && !lab.robots[&id("by_signal")].is_instructed);
    let scan = network("by_signal").background_scan.unwrap();
    assert_eq!(scan.to_string(), "simple:30:-65:300");
    let guests = plan("guests", graph::Security::Open).unwrap().unwrap();
    let guest = guests.robots[&id("guest")].network();
    assert_eq!((guest.channels[0].band(), guest.channels[0].number()), (Band::Ghz5, 36));
    assert!(guest.background_scan.is_some());
    assert!(guests.units[&id("C")].fast_transition().is_none());
}

#[test]
fn impossible_networks_are_rejected() {
    let short = plan("lab", wpa2("short")).unwrap_err();
    assert_eq!(
        short.to_string(),
        "the passphrase of wireless network `lab` is none: a passphrase has 8 to 63 characters, not 5"
    );
    let mut graph = testbed().graph;
    graph.wireless.get_mut("guests").unwrap().access.contention_mut().unwrap().software =
        Some(WifiSoftware { radios: RadioKind::Hwsim, ssid: None, security: graph::Security::Open });
    for node in &mut graph.nodes {
        if let graph::NodeKind::RadioUnit(unit) = &mut node.kind {
            unit.channel = 14;
        }
    }
    let channel = Plan::new(&graph, &DomainKey::new([1; 32])).unwrap_err();
    assert!(matches!(channel, PlanError::Channel { unit, .. } if unit == id("C")));
}
