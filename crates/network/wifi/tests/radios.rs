//! The real hostapd and wpa_supplicant on emulated radios: two units and a robot, each with a radio of mac80211_hwsim in a
//! network namespace of its own. The units reach each other over bridges.
//!
//! Needs root of a kernel with three such radios, which `COTORRA_RADIOS` promises. The tests share the radios: run them with
//! `--test-threads 1`.

#[allow(dead_code, reason = "other tests use the rest")]
mod fixture;

use std::{io, os::fd::AsFd, process::Command, sync::OnceLock, thread, time::Duration};

use cotorra_engine::Process;
use cotorra_testing::radios::{are_promised, sh};
use cotorra_wifi::{
    AccessPoint, AccessPointDriver, Band, Bss, Channel, Client, Credentials, Daemon, DisabledReason,
    DomainKey, Event, Events, FastTransition, Generation, KeyExchange, MacAddress, MobilityDomain, Network,
    Passphrase, Power, Protection, Radio, Security, Station, StationDriver, TransmitPower, Units, Width,
    hostapd, launch_here, wpa_supplicant,
};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};

const ROBOT: MacAddress = MacAddress([2, 0, 0, 0, 0, 0]);

/// Whether there are radios. They are in their namespaces then.
fn radios() -> bool {
    static READY: OnceLock<bool> = OnceLock::new();
    *READY.get_or_init(|| {
        if !are_promised() {
            return false;
        }
        sh("for n in 0 1 2; do
                ip netns add u$n
                iw phy phy$n set netns name u$n
                ip -n u$n link set lo up
            done
            ip link add br0 type bridge
            ip link set br0 up
            for n in 1 2; do
                ip link add up$n type veth peer name eth0 netns u$n
                ip link set up$n master br0 up
                ip -n u$n link add br0 type bridge
                ip -n u$n link set br0 up
                ip -n u$n link set eth0 master br0 up
            done");
        true
    })
}

/// File of the output of a radio's program.
fn log(radio: u8) -> String {
    format!("/run/u{radio}.log")
}

/// Starts programs in the namespace of a radio.
fn inside(radio: u8) -> impl FnMut(Command) -> io::Result<Box<dyn Process>> {
    move |command| {
        let mut inside = Command::new("ip");
        inside
            .args(["netns", "exec", &format!("u{radio}")])
            .arg(command.get_program())
            .args(command.get_args());
        let log = std::fs::File::create(log(radio))?;
        inside.stdout(log.try_clone()?).stderr(log);
        launch_here(inside)
    }
}

/// A program with its client and its events.
struct Running {
    daemon: Daemon,
    client: Client,
    events: Events,
}

impl Running {
    fn new(daemon: Daemon) -> Self {
        let client = daemon.client().expect("a client");
        let events = client.events().expect("events");
        Self { daemon, client, events }
    }

    /// Waits for an event. Returns those before it, too.
    fn wait(&mut self, wanted: impl Fn(&Event) -> bool) -> Vec<Event> {
        fixture::wait(&mut self.events, wanted)
    }
}

fn bssid(unit: u8) -> MacAddress {
    MacAddress([2, 0, 0, 0, unit, 0])
}

/// Starts a unit's access point: unit 1 on channel 1, unit 2 on channel 6.
fn unit(number: u8, security: Security) -> Running {
    unit_of(access_point(number, security))
}

fn unit_of(access_point: AccessPoint) -> Running {
    let number = access_point.interface.as_str().as_bytes()[4] - b'0';
    let folder = format!("/run/unit{number}");
    let daemon =
        Daemon::hostapd(&access_point, folder.as_ref(), &mut inside(number)).expect("hostapd starts");
    let mut running = Running::new(daemon);
    fixture::wait_until_it_serves(&mut running.client, &mut running.events);
    running
}

fn access_point(number: u8, security: Security) -> AccessPoint {
    let mut access_point = fixture::access_point(&format!("wlan{number}"), security);
    access_point.driver = AccessPointDriver::Nl80211;
    access_point.radio.channel = fixture::channel(Band::Ghz2, if number == 1 { 1 } else { 6 }, Width::Mhz20);
    access_point.bss.bridge = Some("br0".parse().expect("a name"));
    access_point
}

/// Starts the robot's station.
fn robot(credentials: Credentials) -> Running {
    robot_on(&[1, 6].map(|number| fixture::channel(Band::Ghz2, number, Width::Mhz20)), credentials)
}

fn robot_on(channels: &[Channel], credentials: Credentials) -> Running {
    let network =
        Network { channels: channels.to_vec(), ..Network::new(fixture::ssid("corridor"), credentials) };
    let station = Station {
        interface: "wlan0".parse().expect("a name"),
        driver: StationDriver::Nl80211,
        country: None,
        networks: vec![network],
    };
    let daemon = Daemon::wpa_supplicant(&station, "/run/robot".as_ref(), &mut inside(0));
    Running::new(daemon.expect("wpa_supplicant starts"))
}

fn connected(event: &Event) -> bool {
    matches!(event, Event::Connected { .. })
}

fn connected_to(unit: u8) -> impl Fn(&Event) -> bool {
    move |event| *event == Event::Connected { bssid: bssid(unit) }
}

fn wpa2(passphrase: Passphrase, fast: Option<u8>) -> Security {
    Security::Wpa2 {
        passphrase,
        protection: Protection::Required,
        fast_transition: fast.map(fast_transition),
    }
}

fn fast_transition(unit: u8) -> FastTransition {
    let holder = format!("unit{unit}").parse().expect("a key holder");
    FastTransition { domain: MobilityDomain(0xc070), holder, over_ds: true }
}

fn ft_sae(unit: u8, units: Units) -> Security {
    let exchange = KeyExchange { key: DomainKey::new([9; 32]), units };
    Security::Wpa3 {
        passphrase: fixture::passphrase(),
        fast_transition: Some((fast_transition(unit), exchange)),
    }
}

/// Makes the robot know both units.
fn scan(robot: &mut Running) -> Vec<wpa_supplicant::Heard> {
    robot.client.request(&wpa_supplicant::scan(&[])).expect("it scans");
    robot.wait(|event| *event == Event::ScanResults);
    robot.client.request(&wpa_supplicant::scan_results()).expect("results")
}

/// Starts a unit with WPA2 and the robot, which joins it.
fn joined() -> (Running, Running) {
    let security = wpa2(fixture::passphrase(), None);
    let unit = unit(1, security.clone());
    let mut robot = robot(security.credentials());
    robot.wait(connected);
    (unit, robot)
}

/// Starts both units and the robot, which joins one of them and knows both.
fn between_units(security: impl Fn(u8) -> Security) -> ([Running; 2], Running) {
    let units = [1, 2].map(|number| unit(number, security(number)));
    let mut robot = robot(security(1).credentials());
    robot.wait(connected);
    scan(&mut robot);
    (units, robot)
}

/// Radio units with and without the robot.
fn place(robot: &mut Running) -> (u8, u8) {
    let status = robot.client.request(&wpa_supplicant::status()).expect("a status");
    assert_eq!(status.state, wpa_supplicant::State::Completed);
    let here = status.bssid.expect("it is somewhere").0[4];
    (here, 3 - here)
}

#[test]
fn each_security_lets_the_robot_join() {
    if !radios() {
        return;
    }
    for (name, security) in fixture::securities() {
        let credentials = security.credentials();
        let mut unit = unit(1, security);
        let mut robot = robot(credentials);
        robot.wait(connected);
        unit.wait(|event| *event == Event::StationConnected { station: ROBOT });
        let stations = unit.client.stations().expect("stations");
        assert_eq!(stations.len(), 1);
        let station = &stations[0];
        assert!(station.address == ROBOT && station.authorized, "{station:?}");
        assert_eq!(station.has_fast_transition(), name.starts_with("ft-"), "{name}: {station:?}");
        assert_eq!(station.protected, name != "open", "{name}");
        let status = robot.client.request(&wpa_supplicant::status()).expect("a status");
        assert_eq!((status.state, status.bssid), (wpa_supplicant::State::Completed, Some(bssid(1))));
        let methods = [("open", "NONE"), ("wpa2", "WPA2-PSK"), ("wpa3", "SAE"), ("ft-psk", "FT-PSK")];
        let method = methods.iter().find(|(of, _)| *of == name).map_or("FT-SAE", |(_, method)| method);
        assert_eq!(status.key_management.as_deref(), Some(method), "{name}");
        let signal = robot.client.request(&wpa_supplicant::signal()).expect("a signal");
        assert!(signal.frequency_mhz == 2412 && signal.signal_dbm < 0, "{signal:?}");
        assert_eq!(
            unit.client.request(&hostapd::status()).expect("a status").channel.map(|c| c.number()),
            Some(1)
        );
    }
}

#[test]
fn wrong_keys_are_refused_and_reported() {
    if !radios() {
        return;
    }
    let right: Passphrase = "the right one".parse().expect("a passphrase");
    let wrong: Passphrase = "the wrong one".parse().expect("a passphrase");
    let mut unit = unit(1, wpa2(right.clone(), None));
    let mut station = robot(wpa2(wrong.clone(), None).credentials());
    let seen = station.wait(|event| matches!(event, Event::NetworkDisabled { .. }));
    let reason = DisabledReason::WrongKey;
    assert!(
        matches!(seen.last(), Some(Event::NetworkDisabled { network: 0, reason: r, .. }) if *r == reason)
    );
    unit.wait(|event| *event == Event::PossibleWrongKey { station: ROBOT });
    drop((unit, station));
    let _unit = self::unit(1, Security::Wpa3 { passphrase: right, fast_transition: None });
    let mut station = robot(Credentials::Wpa3 { passphrase: wrong, fast_transition: false });
    let seen = station.wait(|event| matches!(event, Event::NetworkDisabled { .. }));
    assert!(!seen.iter().any(connected), "{seen:?}");
    assert!(seen.iter().any(|event| matches!(event, Event::AuthenticationRejected { .. })), "{seen:?}");
}

/// Roams there and back by fast transition: over the air, and over the distribution system.
fn roam_fast(mut robot: Running, method: &str) {
    for over_ds in [false, true] {
        for _ in 0..2 {
            let (_, there) = place(&mut robot);
            let request = if over_ds {
                wpa_supplicant::roam_over_ds(bssid(there))
            } else {
                wpa_supplicant::roam(bssid(there))
            };
            robot.client.request(&request).expect("it roams");
            let seen = robot.wait(connected);
            assert_eq!(place(&mut robot).0, there);
            assert!(!seen.iter().any(|event| matches!(event, Event::Disconnected { .. })), "{seen:?}");
            // Over the DS, the present access point carries the authentication.
            assert_eq!(seen.contains(&Event::Authenticating { bssid: bssid(there) }), !over_ds, "{seen:?}");
            let status = robot.client.request(&wpa_supplicant::status()).expect("a status");
            assert_eq!(status.key_management.as_deref(), Some(method));
        }
    }
    // hostapd logs each exchange of keys. Only the first association had one.
    let logs = [1, 2].map(|unit| std::fs::read_to_string(log(unit)).expect("a log"));
    assert_eq!(logs.concat().matches("pairwise key handshake completed").count(), 1, "{logs:?}");
}

#[test]
fn robot_roams_by_ft_psk() {
    if !radios() {
        return;
    }
    let security = |unit| wpa2(fixture::passphrase(), Some(unit));
    let (_units, robot) = between_units(security);
    roam_fast(robot, "FT-PSK");
}

#[test]
fn robot_roams_by_ft_sae_between_listed_units() {
    if !radios() {
        return;
    }
    let holder = |unit: u8| (bssid(unit), format!("unit{unit}").parse().expect("a key holder"));
    let security = |unit| ft_sae(unit, Units::These([1, 2].map(holder).to_vec()));
    let (_units, robot) = between_units(security);
    roam_fast(robot, "FT-SAE");
}

#[test]
fn robot_roams_by_ft_sae_between_units_that_find_each_other() {
    if !radios() {
        return;
    }
    let security = |unit| ft_sae(unit, Units::Any);
    let (_units, robot) = between_units(security);
    roam_fast(robot, "FT-SAE");
}

#[test]
fn another_mobility_domain_refuses_the_robot_and_reports_it() {
    if !radios() {
        return;
    }
    let security = |unit: u8| {
        let domain = MobilityDomain(unit.into());
        Security::Wpa2 {
            passphrase: fixture::passphrase(),
            protection: Protection::Required,
            fast_transition: Some(FastTransition { domain, ..fast_transition(unit) }),
        }
    };
    let (_units, mut robot) = between_units(security);
    let (here, there) = place(&mut robot);
    robot.client.request(&wpa_supplicant::roam(bssid(there))).expect("it tries");
    // The status is: invalid PMKID.
    robot.wait(|event| *event == Event::AuthenticationRejected { bssid: bssid(there), status: 53 });
    robot.wait(connected_to(here));
}

#[test]
fn a_disconnected_robot_comes_back() {
    if !radios() {
        return;
    }
    let (mut unit, mut robot) = joined();
    unit.wait(|event| *event == Event::StationConnected { station: ROBOT });
    // The reason is: unspecified.
    unit.client.request(&hostapd::deauthenticate(ROBOT, 1)).expect("it is disconnected");
    unit.wait(|event| *event == Event::StationDisconnected { station: ROBOT });
    let left = Event::Disconnected { bssid: bssid(1), reason: 1, locally: false };
    robot.wait(|event| *event == left);
    robot.wait(connected);
}

#[test]
fn robot_follows_a_suggestion_to_move() {
    if !radios() {
        return;
    }
    let security = |unit| wpa2(fixture::passphrase(), Some(unit));
    let (mut units, mut robot) = between_units(security);
    let (here, there) = place(&mut robot);
    let access_point = access_point(there, security(there));
    let neighbour = hostapd::Neighbour::new(bssid(there), &access_point.bss, &access_point.radio);
    let unit = &mut units[usize::from(here - 1)];
    unit.client.request(&hostapd::set_neighbour(&neighbour)).expect("it is added");
    let ask =
        hostapd::ask_to_move(ROBOT, std::slice::from_ref(&neighbour), hostapd::Urgency::DisconnectAfter(50));
    unit.client.request(&ask).expect("it is asked");
    unit.wait(|event| {
        *event == Event::MoveAnswered { station: ROBOT, status: 0, target: Some(bssid(there)) }
    });
    robot.wait(connected_to(there));
    unit.client
        .request(&hostapd::remove_neighbour(bssid(there), &access_point.bss.ssid))
        .expect("it is removed");
}

#[test]
fn robot_follows_its_unit_to_another_channel() {
    if !radios() {
        return;
    }
    let (mut unit, mut robot) = joined();
    let channel = fixture::channel(Band::Ghz2, 11, Width::Mhz20);
    unit.client.request(&hostapd::switch_channel(channel, 5)).expect("it switches");
    unit.wait(|event| *event == Event::ChannelSwitched { frequency_mhz: 2462 });
    let seen = robot.wait(|event| *event == Event::ChannelSwitched { frequency_mhz: 2462 });
    assert!(!seen.iter().any(|event| matches!(event, Event::Disconnected { .. })), "{seen:?}");
    assert_eq!(unit.client.request(&hostapd::status()).expect("a status").channel, Some(channel));
    assert_eq!(robot.client.request(&wpa_supplicant::signal()).expect("a signal").frequency_mhz, 2462);
}

/// Runs a closure in the namespace of a radio, on a thread of its own.
fn within<T: Send>(radio: u8, inside: impl FnOnce() -> T + Send) -> T {
    let namespace = std::fs::File::open(format!("/run/netns/u{radio}")).expect("a namespace");
    let enter = || {
        let kind = Some(LinkNameSpaceType::Network);
        move_into_link_name_space(namespace.as_fd(), kind).expect("root may enter it");
        inside()
    };
    thread::scope(|scope| scope.spawn(enter).join()).expect("it does not panic")
}

/// Returns what `iw` says about a radio's interface.
fn iw_info(radio: u8) -> String {
    let interface = format!("wlan{radio}");
    let output = within(radio, || Command::new("iw").args(["dev", &interface, "info"]).output());
    String::from_utf8(output.expect("there is iw").stdout).expect("text")
}

#[test]
fn power_is_changed_and_put_back() {
    if !radios() {
        return;
    }
    let _joined = joined();
    let open = || within(0, || TransmitPower::of(&"wlan0".parse().expect("a name")).expect("a radio"));
    let before = open().read().expect("a power").expect("it is up");
    let mut power = open();
    power.set(Power::Fixed(500)).expect("it is set");
    power.set(Power::AtMost(700)).expect("it is set again");
    assert_eq!(power.read().expect("a power"), Some(700));
    assert!(iw_info(0).contains("txpower 7.00 dBm"), "{}", iw_info(0));
    power.give_back().expect("it is put back");
    assert!(before > 700);
    assert_eq!(open().read().expect("a power"), Some(before));
}

#[test]
fn robot_joins_a_wide_channel_at_5_ghz() {
    if !radios() {
        return;
    }
    let security = wpa2(fixture::passphrase(), None);
    let mut access_point = access_point(1, security.clone());
    let channel = fixture::channel(Band::Ghz5, 44, Width::Mhz80);
    let generation = Generation::Wifi6;
    access_point.radio = Radio { country: "DE".parse().ok(), generation, ..Radio::new(channel) };
    let mut unit = unit_of(access_point);
    let mut robot = robot_on(&[channel], security.credentials());
    robot.wait(connected_to(1));
    assert_eq!(unit.client.request(&hostapd::status()).expect("a status").channel, Some(channel));
    let info = iw_info(0);
    assert!(info.contains("channel 44 (5220 MHz), width: 80 MHz, center1: 5210 MHz"), "{info}");
}

#[test]
fn robot_joins_a_virtual_access_point_of_a_running_unit() {
    if !radios() {
        return;
    }
    let mut other = access_point(1, wpa2(fixture::passphrase(), None));
    other.bss.ssid = fixture::ssid("other");
    let unit = unit_of(other.clone());
    let security = wpa2("another one".parse().expect("a passphrase"), None);
    let bss = Bss {
        bssid: Some(MacAddress([2, 0, 0, 0, 1, 1])),
        ..Bss::new(fixture::ssid("corridor"), security.clone())
    };
    let virtual_ap = AccessPoint { interface: "wlan1-1".parse().expect("a name"), bss, ..other };
    unit.daemon.add_bss(&virtual_ap).expect("it is added");
    let mut robot = robot(security.credentials());
    robot.wait(|event| *event == Event::Connected { bssid: MacAddress([2, 0, 0, 0, 1, 1]) });
    let mut client = unit.daemon.client_of(&virtual_ap.interface).expect("a client");
    assert_eq!(client.stations().expect("stations").len(), 1);
    let mut global = unit.daemon.global_client().expect("a client");
    global.request(&hostapd::remove_interface(&virtual_ap.interface)).expect("it is removed");
    robot.wait(|event| matches!(event, Event::Disconnected { .. }));
}

#[test]
fn robot_comes_back_to_a_unit_that_was_killed() {
    if !radios() {
        return;
    }
    let (mut unit, mut robot) = joined();
    unit.wait(|event| *event == Event::StationConnected { station: ROBOT });
    sh("kill -9 $(ip netns pids u1)");
    while unit.events.next(Duration::from_millis(10)).is_ok() {}
    let ended = std::iter::repeat_with(|| unit.daemon.ended().expect("it is watched")).flatten().next();
    assert!(ended.is_some_and(|status| !status.success()));
    drop(unit);
    let _unit = self::unit(1, wpa2(fixture::passphrase(), None));
    robot.wait(connected);
}

#[test]
fn robot_hears_everybody_who_uses_its_network() {
    if !radios() {
        return;
    }
    let security = wpa2(fixture::passphrase(), None);
    let _unit = unit(1, security.clone());
    let _rogue = unit(2, Security::Open);
    let mut robot = robot(security.credentials());
    robot.wait(connected_to(1));
    let heard = scan(&mut robot);
    let same: Vec<_> = heard.iter().filter(|heard| heard.ssid == Some(fixture::ssid("corridor"))).collect();
    assert_eq!(same.len(), 2, "{heard:?}");
    let flags = |unit| same.iter().find(|heard| heard.bssid == bssid(unit)).map(|heard| heard.flags.as_str());
    assert!(flags(1).is_some_and(|flags| flags.contains("PSK")), "{same:?}");
    assert_eq!(flags(2), Some("[ESS]"));
}
