//! The real hostapd and wpa_supplicant, without a radio. `radios.rs` meets them on emulated radios.

use std::{
    env, fs, io,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Duration,
};

use cotorra_wifi::{
    AccessPoint, AccessPointDriver, Bss, ControlError, Daemon, Event, Security, StartError, Station,
    StationDriver, hostapd, launch_here, ping, wpa_supplicant,
};

use crate::fixture;

/// Whether all programs are there. In continuous integration they must be.
fn installed() -> bool {
    let is_there = |program: &&str| {
        let path = env::var("PATH").unwrap_or_default() + ":/usr/sbin:/sbin";
        env::split_paths(&path).any(|folder| folder.join(program).is_file())
    };
    let missing = ["hostapd", "wpa_supplicant", "unshare"].into_iter().find(|program| !is_there(program));
    let Some(program) = missing else { return true };
    assert!(env::var_os("CI").is_none(), "{program} is not installed: see scripts/test");
    eprintln!("skipped: {program} is not installed");
    false
}

/// Starts a program in a network namespace of its own, where it is root.
fn launch_inside(command: Command) -> io::Result<Box<dyn cotorra_engine::Process>> {
    let mut inside = Command::new("unshare");
    inside.args(["--user", "--map-root-user", "--net"]).arg(command.get_program()).args(command.get_args());
    inside.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    launch_here(inside)
}

struct Fixture {
    folder: tempfile::TempDir,
}

impl Fixture {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a folder") }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("unit")
    }

    fn hostapd(&self, access_point: &AccessPoint) -> Result<Daemon, StartError> {
        Daemon::hostapd(access_point, &self.path(), &mut launch_here)
    }

    fn wpa_supplicant(&self, station: &Station) -> Daemon {
        Daemon::wpa_supplicant(station, &self.path(), &mut launch_inside).expect("wpa_supplicant starts")
    }
}

fn count(folder: &Path) -> usize {
    folder.read_dir().expect("the folder is there").count()
}

#[test]
fn hostapd_takes_each_security() {
    if !installed() {
        return;
    }
    for (name, security) in fixture::securities() {
        let fixture = Fixture::new();
        let daemon = fixture.hostapd(&fixture::access_point("wlan0", security)).expect("hostapd starts");
        let mut client = daemon.client().expect("a client");
        assert_eq!(
            client.request(&hostapd::status()).expect("a status").state,
            hostapd::State::Enabled,
            "{name}"
        );
        let configuration = client.request(&hostapd::configuration()).expect("a configuration");
        assert_eq!(configuration.ssid, Some(fixture::ssid("corridor")));
        let methods = match name {
            "open" => None,
            "wpa2" => Some("WPA-PSK"),
            "ft-psk" => Some("WPA-PSK FT-PSK"),
            "wpa3" => Some("SAE"),
            _ => Some("FT-SAE SAE"),
        };
        assert_eq!(configuration.key_management.as_deref(), methods, "{name}");
    }
}

#[test]
fn hostapd_takes_wide_channels_and_virtual_access_points() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let daemon = fixture.hostapd(&fixture::wide_access_point("wlan0")).expect("hostapd starts");
    let status = daemon.client().expect("a client").request(&hostapd::status()).expect("a status");
    // It does not learn the regulatory domain.
    assert_eq!(status.state, hostapd::State::CountryUpdate);
    assert_eq!(status.beacon_interval.map(|interval| interval.time_units()), Some(50));
    let names: Vec<_> = status.bss.iter().map(|bss| bss.interface.as_str()).collect();
    assert_eq!(names, ["wlan0", "wlan0-1"]);
    assert_eq!(status.bss[1].ssid, Some(fixture::ssid("gäste")));
}

#[test]
fn hostapd_stops_and_starts_serving() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let daemon = fixture.hostapd(&fixture::access_point("wlan0", Security::Open)).expect("hostapd starts");
    let mut client = daemon.client().expect("a client");
    let mut events = client.events().expect("events");
    let mut next = || events.next(Duration::from_secs(10)).expect("it runs").map(|message| message.event);
    client.request(&hostapd::disable()).expect("it stops");
    assert_eq!(next(), Some(Event::AccessPointDisabled));
    client.request(&hostapd::enable()).expect("it starts");
    assert_eq!(next(), Some(Event::AccessPointEnabled));
    assert_eq!(client.stations().expect("stations"), []);
    let nobody = "02:00:00:00:00:09".parse().expect("an address");
    assert_eq!(client.request(&hostapd::station(nobody)).expect("an answer"), None);
}

#[test]
fn virtual_access_point_comes_and_goes() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let daemon = fixture.hostapd(&fixture::access_point("wlan0", Security::Open)).expect("hostapd starts");
    let mut virtual_ap = fixture::access_point("wlan0-1", Security::Open);
    virtual_ap.bss = Bss::new(fixture::ssid("other"), Security::Open);
    let name = virtual_ap.interface.clone();
    daemon.add_bss(&virtual_ap).expect("it is added");
    let mut client = daemon.client_of(&name).expect("a client");
    let configuration = client.request(&hostapd::configuration()).expect("a configuration");
    assert_eq!(configuration.ssid, Some(fixture::ssid("other")));
    daemon
        .global_client()
        .expect("a client")
        .request(&hostapd::remove_interface(&name))
        .expect("it is removed");
    assert!(matches!(client.request(&ping()), Err(ControlError::Gone { .. })));
    daemon.client().expect("a client").request(&ping()).expect("the first one stays");
}

#[test]
fn nothing_is_left_of_a_stopped_program() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let daemon = fixture.hostapd(&fixture::access_point("wlan0", Security::Open)).expect("hostapd starts");
    let mut client = daemon.client().expect("a client");
    daemon.stop();
    assert!(matches!(client.request(&ping()), Err(ControlError::Gone { .. })));
    drop(client);
    assert_eq!(count(fixture.folder.path()), 0);
}

#[test]
fn a_killed_program_is_noticed() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let pid = fixture.folder.path().join("pid");
    let mut launch = |command: Command| {
        let mut shell = Command::new("sh");
        shell.args(["-c", "echo $$ >\"$0\"; exec \"$@\""]).arg(&pid);
        shell.arg(command.get_program()).args(command.get_args()).stdout(Stdio::null()).stderr(Stdio::null());
        launch_here(shell)
    };
    let access_point = fixture::access_point("wlan0", Security::Open);
    let mut daemon = Daemon::hostapd(&access_point, &fixture.path(), &mut launch).expect("hostapd starts");
    assert!(daemon.ended().expect("it is watched").is_none());
    let mut events = daemon.client().and_then(|client| client.events()).expect("events");
    let pid = fs::read_to_string(&pid).expect("it has a number");
    assert!(Command::new("kill").args(["-9", pid.trim()]).status().is_ok_and(|status| status.success()));
    while events.next(Duration::from_millis(1)).is_ok() {}
    assert!(matches!(events.next(Duration::ZERO), Err(ControlError::Gone { .. })));
    let ended = std::iter::repeat_with(|| daemon.ended().expect("it is watched")).flatten().next();
    assert!(ended.is_some_and(|status| !status.success()));
}

#[test]
fn what_a_killed_process_left_is_ended_first() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let access_point = fixture::access_point("wlan0", Security::Open);
    let first = fixture.hostapd(&access_point).expect("hostapd starts");
    let mut events = first.client().and_then(|client| client.events()).expect("events");
    // As if this process had been killed.
    std::mem::forget(first);
    let second = fixture.hostapd(&access_point).expect("hostapd starts again");
    while events.next(Duration::from_millis(1)).is_ok() {}
    second.client().expect("a client").request(&ping()).expect("the second one runs");
    let foreign = fixture.folder.path().join("foreign");
    fs::create_dir(&foreign).expect("a folder");
    let refused = Daemon::hostapd(&access_point, &foreign, &mut launch_here);
    assert!(matches!(refused, Err(StartError::Folder(_))));
    let refused = Daemon::hostapd(&access_point, &fixture.folder.path().join("a b"), &mut launch_here);
    assert!(matches!(refused, Err(StartError::Path(_))));
}

#[test]
fn a_program_of_another_user_answers() {
    if !installed() || !rustix::process::geteuid().is_root() {
        return;
    }
    let fixture = Fixture::new();
    let (folder, file) = (fixture.folder.path(), fixture.folder.path().join("hostapd.conf"));
    fs::set_permissions(folder, fs::Permissions::from_mode(0o777)).expect("it is ours");
    let control = folder.join("control");
    let access_point = fixture::access_point("wlan0", Security::Open);
    fs::write(&file, access_point.configuration(&control)).expect("it is written");
    let mut command = Command::new("setpriv");
    command
        .args(["--reuid", "nobody", "--regid", "nogroup", "--clear-groups", "/usr/sbin/hostapd"])
        .arg(file);
    let mut process = launch_here(command).expect("there is setpriv");
    let mut connect = || {
        assert!(process.try_wait().expect("it is watched").is_none(), "hostapd runs");
        cotorra_wifi::Client::connect(&control.join("wlan0"), folder).ok()
    };
    let mut client = std::iter::repeat_with(&mut connect).flatten().next().expect("it never ends");
    let answer = client.request(&ping());
    process.kill();
    answer.expect("an answer");
}

#[test]
fn a_program_that_does_not_start_says_why() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let access_point = AccessPoint {
        driver: AccessPointDriver::Nl80211,
        ..fixture::access_point("missing0", Security::Open)
    };
    let error = fixture.hostapd(&access_point).expect_err("there is no radio");
    assert!(matches!(&error, StartError::Ended { .. }) && error.to_string().contains("nl80211"), "{error}");
    assert_eq!(count(fixture.folder.path()), 0);
    let mut nowhere = |_| Err(io::Error::from(io::ErrorKind::NotFound));
    let error =
        Daemon::hostapd(&access_point, &fixture.path(), &mut nowhere).expect_err("there is no program");
    assert!(error.to_string().starts_with("cannot start hostapd"), "{error}");
}

#[test]
fn wpa_supplicant_takes_each_network() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let station = fixture::station("lo");
    let daemon = fixture.wpa_supplicant(&station);
    let mut client = daemon.client().expect("a client");
    let status = client.request(&wpa_supplicant::status()).expect("a status");
    assert_eq!((status.network, status.ssid), (None, None));
    assert_eq!(client.request(&wpa_supplicant::scan_results()).expect("results"), []);
    assert!(client.request(&wpa_supplicant::signal()).is_err());
    let listed = wpa_cli(&fixture, &["list_networks"]);
    for network in 0..station.networks.len() {
        assert!(listed.lines().any(|line| line.starts_with(&format!("{network}\t"))), "{listed}");
    }
    daemon.stop();
    assert_eq!(count(fixture.folder.path()), 0);
}

#[test]
fn wired_station_reports_its_state() {
    if !installed() {
        return;
    }
    let fixture = Fixture::new();
    let mut station = fixture::station("lo");
    station.driver = StationDriver::Wired;
    station.country = None;
    let daemon = fixture.wpa_supplicant(&station);
    let mut client = daemon.client().expect("a client");
    client.request(&wpa_supplicant::disconnect()).expect("it leaves");
    let status = client.request(&wpa_supplicant::status()).expect("a status");
    assert_eq!(status.state, wpa_supplicant::State::Disconnected);
}

#[test]
fn pre_shared_keys_are_those_of_wpa_passphrase() {
    if !installed() {
        return;
    }
    let output = Command::new("/usr/bin/wpa_passphrase").arg("wpa2").arg(r##"a"b#c\d'e|mac=$% "##).output();
    let output = String::from_utf8(output.expect("it is part of wpasupplicant").stdout).expect("text");
    let theirs = output.lines().find(|line| line.starts_with("\tpsk=")).expect("a key");
    let ours = fixture::station("lo").configuration("/run".as_ref());
    assert!(ours.lines().any(|line| line == theirs), "{theirs}");
}

/// Returns what wpa_supplicant's own client reads.
fn wpa_cli(fixture: &Fixture, words: &[&str]) -> String {
    let control = fixture.path().join("control");
    let output =
        Command::new("/usr/sbin/wpa_cli").arg("-p").arg(control).args(["-i", "lo"]).args(words).output();
    let output = output.expect("it is part of wpasupplicant").stdout;
    String::from_utf8(output).expect("text").trim_end().to_owned()
}
