//! Takeovers of radios on which an owner's hostapd and wpa_supplicant run, with the real programs on emulated radios.
//!
//! Needs root of a kernel with three radios of mac80211_hwsim, which `COTORRA_RADIOS` promises. The tests share the radios: run
//! them with `--test-threads 1`.

#[allow(dead_code, reason = "other tests use the rest")]
mod fixture;

use std::{fs, path::Path, process::Command, time::Duration};

use cotorra_testing::radios::{HOSTAPD, SUPPLICANT, are_promised, sh};
use cotorra_wifi::{
    AccessPointSettings, Band, Bss, Channel, Client, Event, Events, FastTransition, InterfaceName,
    MacAddress, MobilityDomain, Network, Owner, Power, Protection, Radio, Security, StationSettings, Taken,
    TakeoverError, Width, hostapd, launch_here, wpa_supplicant,
};

use fixture::{wait, wait_until_it_serves};

const ROBOT: MacAddress = MacAddress([2, 0, 0, 0, 0, 0]);
/// Another network of the owner's station.
const OTHER: &str = "network={
 ssid=\"other\"
 key_mgmt=NONE
 disabled=1
}
";

/// An owner's program, which ends with this.
struct Owners(Box<dyn cotorra_engine::Process>, Events, Client);

impl Owners {
    fn start(program: &str, arguments: &str, configuration: &str, socket: &str) -> Self {
        let file = format!("/run/{program}.conf");
        fs::write(&file, configuration).expect("a file");
        let mut command = Command::new(program);
        command.args(arguments.split_whitespace()).arg(file).stdout(std::process::Stdio::null());
        let process = launch_here(command).expect("it is installed");
        // The program opens its socket when it is ready for it.
        let mut tries = std::iter::repeat_with(|| {
            std::thread::yield_now();
            sh("sleep 0.05");
            Client::connect(Path::new(socket), "/run".as_ref()).ok()
        });
        let client = tries.by_ref().take(200).flatten().next().expect("it answers");
        let events = client.events().expect("events");
        Self(process, events, client)
    }

    fn hostapd() -> Self {
        sh("ip link show br0 >/dev/null 2>&1 || ip link add br0 type bridge; ip link set br0 up");
        let mut hostapd = Self::start("hostapd", "", HOSTAPD, "/run/hostapd/wlan1");
        wait_until_it_serves(&mut hostapd.2, &mut hostapd.1);
        hostapd
    }

    fn supplicant() -> Self {
        Self::start(
            "wpa_supplicant",
            "-i wlan0 -D nl80211 -c",
            &format!("{SUPPLICANT}{OTHER}"),
            "/run/wpa_supplicant/wlan0",
        )
    }

    fn status(&mut self) -> hostapd::Status {
        self.2.request(&hostapd::status()).expect("a status")
    }

    fn station(&mut self) -> wpa_supplicant::Status {
        self.2.request(&wpa_supplicant::status()).expect("a status")
    }
}

impl Drop for Owners {
    fn drop(&mut self) {
        _ = self.2.request(&cotorra_wifi::terminate());
        while self.1.next(Duration::from_millis(10)).is_ok() {}
        self.0.kill();
    }
}

fn name(interface: &str) -> InterfaceName {
    interface.parse().expect("a name")
}

fn channel(number: u8) -> Channel {
    fixture::channel(Band::Ghz2, number, Width::Mhz20)
}

fn security() -> Security {
    let fast_transition = FastTransition {
        domain: MobilityDomain(0xc070),
        holder: "r1".parse().expect("a name"),
        over_ds: false,
    };
    Security::Wpa2 {
        passphrase: fixture::passphrase(),
        protection: Protection::Required,
        fast_transition: Some(fast_transition),
    }
}

fn settings() -> AccessPointSettings {
    AccessPointSettings {
        radio: Radio::new(channel(1)),
        bss: Bss::new(fixture::ssid("corridor"), security()),
        virtual_aps: Vec::new(),
        power: None,
        neighbours: Vec::new(),
    }
}

fn corridor() -> StationSettings {
    let network = Network::new(fixture::ssid("corridor"), security().credentials());
    let network = Network { channels: [1, 6, 11].map(channel).to_vec(), ..network };
    StationSettings { network, power: Some(Power::AtMost(900)) }
}

/// Makes a folder for the takeover of an interface, and looks at the interface.
fn find(interface: &str) -> (String, Owner) {
    let folder = format!("/run/taken-{interface}");
    fs::create_dir_all(&folder).expect("a folder");
    let owner = Owner::find(&name(interface), folder.as_ref()).expect("it is a radio");
    (folder, owner)
}

fn take(interface: &str) -> Taken {
    let (folder, owner) = find(interface);
    Taken::new(owner, folder.as_ref())
}

/// The events of a taken interface.
fn events(taken: &Taken) -> Events {
    taken.client().expect("a client").expect("it is on the air").events().expect("events")
}

fn serving(taken: &Taken) -> Events {
    let mut events = events(taken);
    let mut client = taken.client().expect("a client").expect("it is on the air");
    wait_until_it_serves(&mut client, &mut events);
    events
}

fn connected(events: &mut Events) {
    wait(events, |event| matches!(event, Event::Connected { .. }));
}

fn iw(interface: &str) -> String {
    sh(&format!("iw dev {interface} info"))
}

fn is_home(owner: &mut Owners) {
    wait_until_it_serves(&mut owner.2, &mut owner.1);
    let info = iw("wlan1");
    assert!(info.contains("ssid home") && info.contains("channel 11"), "{info}");
    assert!(info.contains("txpower 20.00 dBm"), "{info}");
    assert!(Path::new("/sys/class/net/br0/brif/wlan1").exists());
    assert!(!Path::new("/run/taken-wlan1/own").exists());
}

#[test]
fn an_owners_access_point_is_back_after_a_takeover() {
    if !are_promised() {
        return;
    }
    let mut owner = Owners::hostapd();
    let mut unit = take("wlan1");
    let mut wanted = AccessPointSettings { power: Some(Power::AtMost(700)), ..settings() };
    unit.serve(&wanted).expect("it serves");
    assert_eq!(owner.status().state, hostapd::State::Disabled);
    let mut unit_events = serving(&unit);
    let info = iw("wlan1");
    assert!(info.contains("ssid corridor") && info.contains("channel 1 "), "{info}");
    assert!(info.contains("txpower 7.00 dBm"), "{info}");
    assert!(Path::new("/sys/class/net/br0/brif/wlan1").exists(), "it joins the owner's bridge");

    let mut robot = take("wlan0");
    robot.join(&corridor()).expect("it joins");
    let mut robot_events = events(&robot);
    wait(&mut unit_events, |event| *event == Event::StationConnected { station: ROBOT });

    // Neither of these makes the robot come again.
    wanted.virtual_aps.push((name("wlan1-1"), Bss::new(fixture::ssid("guests"), Security::Open)));
    unit.serve(&wanted).expect("it serves");
    assert!(iw("wlan1-1").contains("ssid guests"));
    wanted.virtual_aps.clear();
    wanted.radio.channel = channel(6);
    unit.serve(&wanted).expect("it serves");
    let seen = wait(&mut robot_events, |event| *event == Event::ChannelSwitched { frequency_mhz: 2437 });
    assert!(!seen.iter().any(|event| matches!(event, Event::Disconnected { .. })), "{seen:?}");
    assert!(!Path::new("/sys/class/net/wlan1-1").exists());

    unit.give_back().expect("it is put back");
    is_home(&mut owner);
}

#[test]
fn a_takeover_that_was_killed_is_put_back_by_its_note() {
    if !are_promised() {
        return;
    }
    let mut owner = Owners::hostapd();
    let (folder, note) = find("wlan1");
    let mut unit = Taken::new(note.clone(), folder.as_ref());
    unit.serve(&settings()).expect("it serves");
    serving(&unit);
    // Its hostapd goes on, as after `kill -9` of this process.
    std::mem::forget(unit);
    let note: Owner = serde_json::from_str(&serde_json::to_string(&note).expect("JSON")).expect("a note");
    for _ in 0..2 {
        note.put_back(folder.as_ref()).expect("it is put back");
        is_home(&mut owner);
    }
}

#[test]
fn an_owners_station_returns_to_its_network() {
    if !are_promised() {
        return;
    }
    let _home = Owners::hostapd();
    let mut unit = take("wlan2");
    unit.serve(&settings()).expect("it serves");
    serving(&unit);
    let mut owner = Owners::supplicant();
    while owner.station().state != wpa_supplicant::State::Completed {
        connected(&mut owner.1);
    }
    for is_killed in [false, true] {
        let (folder, note) = find("wlan0");
        let mut robot = Taken::new(note.clone(), folder.as_ref());
        robot.join(&corridor()).expect("it joins");
        connected(&mut owner.1);
        assert_eq!(owner.station().ssid, Some(fixture::ssid("corridor")));
        assert!(iw("wlan0").contains("txpower 9.00 dBm"), "{}", iw("wlan0"));
        let neighbours = "/proc/sys/net/ipv4/conf/wlan0/arp_evict_nocarrier";
        assert_eq!(fs::read_to_string(neighbours).expect("a number").trim(), "0");
        if is_killed {
            std::mem::forget(robot);
            note.put_back(folder.as_ref()).expect("it is put back");
        } else {
            robot.give_back().expect("it is put back");
        }
        connected(&mut owner.1);
        assert_eq!(owner.station().ssid, Some(fixture::ssid("home")));
        let networks = owner.2.networks().expect("networks");
        let enabled: Vec<_> = networks.iter().map(|its| (its.network, its.is_enabled)).collect();
        assert_eq!(enabled, [(0, true), (1, false)]);
        assert!(iw("wlan0").contains("txpower 20.00 dBm"), "{}", iw("wlan0"));
        assert_eq!(fs::read_to_string(neighbours).expect("a number").trim(), "1");
    }
}

#[test]
fn the_power_of_a_station_that_never_joined_is_put_back() {
    if !are_promised() {
        return;
    }
    let (folder, note) = find("wlan0");
    let mut robot = Taken::new(note.clone(), folder.as_ref());
    robot.join(&corridor()).expect("it looks for its network");
    std::mem::forget(robot);
    note.put_back(folder.as_ref()).expect("it is put back");
    // The kernel reports the power of a station that has joined.
    let _home = Owners::hostapd();
    let mut owner = Owners::supplicant();
    while owner.station().state != wpa_supplicant::State::Completed {
        connected(&mut owner.1);
    }
    assert!(iw("wlan0").contains("txpower 20.00 dBm"), "{}", iw("wlan0"));
}

#[test]
fn radios_in_other_use_are_refused() {
    if !are_promised() {
        return;
    }
    let mut home = Owners::hostapd();
    let mut unit = take("wlan1");
    let refused = unit.join(&corridor()).expect_err("it is an access point");
    assert!(matches!(refused, TakeoverError::OtherUse { program: "hostapd", .. }), "{refused}");
    assert_eq!(home.status().state, hostapd::State::Enabled);
    drop(unit);
    let _owner = Owners::supplicant();
    let mut robot = take("wlan0");
    let refused = robot.serve(&settings()).expect_err("it is a station");
    assert!(matches!(refused, TakeoverError::OtherUse { program: "wpa_supplicant", .. }), "{refused}");
    // Its owner hides it.
    fs::rename("/run/hostapd/wlan1", "/run/hidden").expect("it is hidden");
    let refused = Owner::find(&name("wlan1"), "/run".as_ref()).expect_err("somebody uses it");
    assert!(matches!(refused, TakeoverError::Unknown(_)), "{refused}");
    fs::rename("/run/hidden", "/run/hostapd/wlan1").expect("it is there again");
}
