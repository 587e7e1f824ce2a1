//! Settings from outside a testbed file, and the errors of wrong ones.

use std::{path::Path, time::Duration};

use cotorra_graph::{
    BitRate, FixedRate, FqCodel, PassiveVisits, Phase, Protection, QueueDiscipline, QueueLimit, RadioKind,
    RateControl, RobotClock, ScanVisits, Security, Testbed, WifiSoftware,
};
use cotorra_testbed_file::Setting;

const FILE: &str = "\
name: rooms
wireless: { lab: {} }
nodes:
  robot: { kind: robot }
  R1: { kind: radio_unit, position: [0, 0], channel: 1 }
  R2: { kind: radio_unit, position: [9, 0], channel: 6 }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [lan, [R1, R2]], delay: 1 ms }
  - { id: core, ends: [lan, edge], delay: 2 ms }
walks:
  robot: { waypoints: [[0, 1], [9, 1]] }
plugins:
  - probing
  - { id: mine, command: [python3, mine.py], enabled: false }
";

fn with(settings: &[&str]) -> Result<Testbed, String> {
    let settings: Vec<Setting> = settings.iter().map(|s| s.parse().expect("it is a setting")).collect();
    cotorra_testbed_file::parse_with("rooms.yaml", FILE, Path::new(""), &settings)
        .map_err(|wrong| wrong.to_string())
}

fn delays(testbed: &Testbed) -> Vec<(String, u128, f64)> {
    let links = testbed.graph.links.iter();
    links.map(|l| (l.id.to_string(), l.forward.delay.as_millis(), l.scales[1].delay_scale)).collect()
}

#[test]
fn without_settings_the_file_is_as_it_is() {
    let testbed = with(&[]).unwrap();
    assert_eq!(testbed, cotorra_testbed_file::parse("rooms.yaml", FILE, Path::new("")).unwrap());
    let ids: Vec<_> = testbed.plugins.iter().map(|p| p.id.as_str()).collect();
    assert_eq!(ids, ["probing"], "what is not enabled does not run");
}

#[test]
fn links_are_set_by_name_or_pattern() {
    let expected = |r1, r2, core, scale| {
        vec![("lan-R1".to_owned(), r1, 1.0), ("lan-R2".to_owned(), r2, 1.0), ("core".to_owned(), core, scale)]
    };
    assert_eq!(delays(&with(&["links.*.delay=7 ms"]).unwrap()), expected(7, 7, 7, 1.0));
    assert_eq!(delays(&with(&["links.lan-R2.delay=7 ms"]).unwrap()), expected(1, 7, 2, 1.0));
    assert_eq!(delays(&with(&["links.lan-*.delay=7 ms"]).unwrap()), expected(7, 7, 2, 1.0));
    assert_eq!(delays(&with(&["links.core.delay_scale=2.5"]).unwrap()), expected(1, 1, 2, 2.5));
}

#[test]
fn keys_that_the_file_leaves_out_can_be_set() {
    let testbed =
        with(&["wireless.lab.handover.scan=250 ms", "walks.robot.and_back=true", "seed=9"]).unwrap();
    let handover = testbed.graph.wireless["lab"].handover;
    assert_eq!((handover.scan.as_millis(), handover.visits), (250, None));
    assert_eq!((testbed.walks[0].waypoints.len(), testbed.seed), (3, 9));
}

#[test]
fn a_scan_can_have_visits() {
    let handover = |scan: &str| {
        let setting = format!("wireless.lab.handover.scan={scan}");
        with(&[&setting]).unwrap().graph.wireless["lab"].handover
    };
    let ms = Duration::from_millis;
    let linux = handover("{ channels: 13 }");
    let visits = ScanVisits { dwell: ms(60), passive: None, away: ms(125), back: ms(200) };
    assert_eq!((linux.scan, linux.visits), (ms(780), Some(visits)));
    let other = handover("{ channels: 5, dwell: 111 ms, away: 111 ms, back: 100 ms }");
    let visits = ScanVisits { dwell: ms(111), passive: None, away: ms(111), back: ms(100) };
    assert_eq!((other.scan, other.visits), (ms(555), Some(visits)));
    let both_bands = handover("{ channels: 17, passive: 15 }");
    let passive = Some(PassiveVisits { channels: 15, dwell: ms(111) });
    assert_eq!(both_bands.scan, ms(17 * 60 + 15 * 111));
    assert_eq!(both_bands.visits, Some(ScanVisits { passive, ..linux.visits.unwrap() }));
    let setting = ["wireless.lab.handover.scan_first=true"];
    assert!(with(&setting).unwrap().graph.wireless["lab"].handover.scan_first);
    let setting = ["wireless.lab.handover.scan_every=120 s"];
    assert_eq!(with(&setting).unwrap().graph.wireless["lab"].handover.scan_every, Some(ms(120_000)));
    // Without visits and intervals, JSON is as it was.
    let json = serde_json::to_string(&handover("100 ms")).unwrap();
    assert!(!json.contains("visits") && !json.contains("scan_every"), "{json}");
}

#[test]
fn one_plugin_is_chosen_declared_or_bundled_and_has_its_settings() {
    let chosen = |settings: &[&str]| {
        let testbed = with(settings).unwrap();
        let [plugin] = &testbed.plugins[..] else { panic!("{:?}", testbed.plugins) };
        (plugin.id.to_string(), serde_json::Value::Object(plugin.settings.clone()).to_string())
    };
    assert_eq!(chosen(&["plugin=mine"]), ("mine".into(), "{}".into()));
    assert_eq!(chosen(&["plugin=okpi"]), ("okpi".into(), "{}".into()));
    let gamma = ["plugin=okpi", "plugins.okpi.settings.gamma=8"];
    assert_eq!(chosen(&gamma), ("okpi".into(), r#"{"gamma":8}"#.into()));
    assert_eq!(chosen(&["plugins.probing.settings.period=9 s"]).1, r#"{"period":"9 s"}"#);
}

#[test]
fn wrong_settings_are_shown_in_place() {
    for (setting, expected) in [
        ("links.*.delay=5", "17:8: `5` has no unit"),
        ("links.lan-R3.delay=5 ms", "`lan-R3` in `links` matches nothing"),
        ("links.lan-R3.delay=5 ms", "did you mean `lan-R1`?"),
        ("node.R1.channel=3", "`node`"),
        ("nodes.R1.channel.width=3", "`nodes.R1.channel` is `1`, which has no keys"),
        ("links.core.drop_scale=0", "cannot be divided by 0"),
        ("plugin=okpy", "`okpy`"),
        ("seed=[", "this value is no YAML"),
    ] {
        let told = with(&[setting]).unwrap_err();
        assert!(told.contains(expected), "{setting}: {told}");
        assert!(told.contains(&format!("# set: {setting}")) && told.contains("help: "), "{setting}: {told}");
    }
}

#[test]
fn settings_that_a_file_notes_at_its_end_apply_before_others() {
    let settings: Vec<Setting> =
        ["seed=9", "plugin=mine", "links.core.delay=7 ms"].map(|s| s.parse().unwrap()).into();
    let noted = cotorra_testbed_file::annotated(FILE, &settings);
    let read = |text: &str, more: &[Setting]| {
        cotorra_testbed_file::parse_with("rooms.yaml", text, Path::new(""), more).unwrap()
    };
    assert_eq!(read(&noted, &[]), read(FILE, &settings));
    let more: Vec<Setting> = ["seed=3", "plugin=probing"].map(|s| s.parse().unwrap()).into();
    let both = read(&noted, &more);
    assert_eq!((both.seed, both.plugins[0].id.as_str(), both.plugins.len()), (3, "probing", 1));
    // Elsewhere, and in other words, they are comments.
    for text in [format!("# set: seed=9\n{FILE}"), format!("{FILE}# set: seed=9\n# end\n")] {
        assert_eq!(read(&text, &[]), read(FILE, &[]));
    }
}

#[test]
fn a_robot_on_its_way_starts_at_its_position() {
    let on = with(&["nodes.robot.position=[4, 1]", "walks.robot.next=1"]).unwrap();
    assert_eq!((on.walks[0].next, on.graph.robots().next().unwrap().0.position.unwrap().x), (Some(1), 4.0));
    let told = with(&["walks.robot.next=3"]).unwrap_err();
    assert!(told.contains("the walk has no waypoint 3"), "{told}");
}

#[test]
fn real_wifi_software_takes_the_place_of_the_model_and_gives_it_back() {
    let hwsim = |settings: &[&str]| {
        let settings = [&["wireless.lab.access=edca"], settings].concat();
        with(&settings).unwrap().graph.wireless["lab"].access.software().cloned()
    };
    assert_eq!(hwsim(&[]), None);
    let usual = Security::Wpa2 {
        passphrase: "an emulated network".to_owned(),
        management_frames: Protection::Optional,
        over_ds: false,
    };
    let wanted = |security| Some(WifiSoftware { radios: RadioKind::Hwsim, ssid: None, security });
    assert_eq!(hwsim(&["wireless.lab.wifi=hwsim"]), wanted(usual));
    let wpa3 = "wireless.lab.security={ method: wpa3, passphrase: correct horse, over_ds: true }";
    let security = Security::Wpa3 { passphrase: "correct horse".to_owned(), over_ds: true };
    assert_eq!(hwsim(&["wireless.lab.wifi=hwsim", wpa3]), wanted(security));
    let ssid = hwsim(&["wireless.lab.wifi=hwsim", "wireless.lab.ssid=campus"]).unwrap().ssid;
    assert_eq!(ssid.as_deref(), Some("campus"));
    let open = "wireless.lab.security=open";
    assert_eq!(hwsim(&["wireless.lab.wifi=hwsim", open]), wanted(Security::Open));
    assert_eq!(hwsim(&["wireless.lab.wifi=hwsim", open, "wireless.lab.wifi=model"]), None);
    let nodes = with(&["wireless.lab.access=edca", "wireless.lab.wifi=hwsim"]).unwrap().graph;
    let names: Vec<_> = nodes.nodes_with(RadioKind::Hwsim).map(|node| node.id.as_str()).collect();
    assert_eq!(names, ["robot", "R1", "R2"]);
}

#[test]
fn radios_have_the_queues_of_linux_unless_the_file_says_otherwise() {
    let queue = |settings: &str| {
        let edca = with(&[settings]).unwrap().graph.wireless["lab"].access.edca().copied().unwrap();
        (edca.queue, edca.queue_discipline)
    };
    let linux = (QueueLimit::Packets(1820), QueueDiscipline::FqCodel(FqCodel::MAC80211));
    assert_eq!(queue("wireless.lab.access=edca"), linux);
    assert_eq!(queue("wireless.lab.access={ rate_control: ideal }"), linux);
    let short = (QueueLimit::Packets(50), QueueDiscipline::DropTail);
    assert_eq!(queue("wireless.lab.access={ queue: 50 packets }"), short);
    let usual = (QueueLimit::default(), QueueDiscipline::FqCodel(FqCodel::default()));
    assert_eq!(queue("wireless.lab.access={ queue: { discipline: fq_codel } }"), usual);
}

#[test]
fn rates_of_stations_can_be_fixed() {
    let control = |settings: &[&str]| {
        with(settings).unwrap().graph.wireless["lab"].access.edca().map(|edca| edca.rate_control)
    };
    assert_eq!(control(&["wireless.lab.access={ queue: 50 packets }"]), Some(RateControl::Minstrel));
    let fixed = |rate: &str| format!("wireless.lab.access={{ rate_control: {{ fixed: {rate} }} }}");
    let mcs = |mcs| Some(RateControl::Fixed(FixedRate::Mcs(mcs)));
    assert_eq!(control(&["wireless.lab.standard=n", &fixed("MCS 7")]), mcs(7));
    assert_eq!(control(&["wireless.lab.standard=n", "wireless.lab.streams=2", &fixed("MCS 15")]), mcs(15));
    let rate = FixedRate::BitsPerSecond(BitRate::from_mbps(24.0).unwrap());
    assert_eq!(control(&["wireless.lab.standard=g", &fixed("24 Mbit/s")]), Some(RateControl::Fixed(rate)));
}

#[test]
fn robots_have_clocks_of_their_own_unless_the_file_aligns_them() {
    let clock = |settings: &[&str]| with(settings).unwrap().graph.robots().next().unwrap().1.clock;
    assert_eq!(clock(&[]), RobotClock { phase: Phase::Random, drift_ppm: 156.0 });
    let aligned = ["nodes.robot.clock={ phase: aligned, drift: 0 ppm }"];
    assert_eq!(clock(&aligned), RobotClock { phase: Phase::Aligned, drift_ppm: 0.0 });
    assert_eq!(clock(&["nodes.robot.clock.drift=2 %"]).drift_ppm, 20_000.0);
    assert!(with(&["nodes.robot.clock.drift=11 %"]).is_err(), "no clock is so wrong");
}

#[test]
fn jitter_changes_over_time_or_by_packet() {
    let jitter = |settings| with(&[settings]).unwrap().graph.links.last().unwrap().forward.jitter.unwrap();
    assert_eq!(jitter("links.core.jitter=1 ms").over, None);
    let over = jitter("links.core.jitter={ deviation: 1 ms, over: 50 ms }").over.unwrap();
    assert_eq!(over.get(), Duration::from_millis(50));
}

#[test]
fn radios_of_real_machines_have_an_agent_and_an_interface_which_the_model_ignores() {
    let on_hardware = [
        "wireless.lab.access=edca",
        "wireless.lab.wifi=hardware",
        "nodes.robot.agent=turtle1",
        "nodes.robot.interface=wlan0",
        "nodes.R1.agent=ap1",
        "nodes.R1.interface=wlan0",
        "nodes.R2.agent=ap2",
        "nodes.R2.interface=wlan1",
        "nodes.R2.bridge=br0",
    ];
    let testbed = with(&on_hardware).unwrap();
    let radios: Vec<_> = testbed
        .graph
        .nodes_with(RadioKind::Hardware)
        .map(|node| (node.id.as_str(), node.radio().unwrap()))
        .map(|(node, radio)| (node, radio.agent.as_str(), radio.interface.as_str()))
        .collect();
    assert_eq!(radios, [("robot", "turtle1", "wlan0"), ("R1", "ap1", "wlan0"), ("R2", "ap2", "wlan1")]);
    let bridges = testbed.graph.radio_units().map(|(_, unit)| unit.radio.as_ref()?.bridge.as_deref());
    assert_eq!(bridges.collect::<Vec<_>>(), [None, Some("br0")]);
    assert_eq!(testbed.graph.nodes_with(RadioKind::Hwsim).count(), 0);
    let at_start: Vec<_> = testbed.agents_at_start().map(|(_, agent)| agent.as_str()).collect();
    assert_eq!(at_start, ["turtle1", "ap1", "ap2"]);
    let model = with(&[&on_hardware[..], &["wireless.lab.wifi=model"]].concat()).unwrap();
    assert!(model.graph.nodes.iter().all(|node| node.radio().is_none()));
    assert_eq!(model.agents_at_start().count(), 0);
}
