//! The client, against a program of the test's own behind a socket.

use std::{
    os::unix::net::UnixDatagram,
    path::{Path, PathBuf},
    sync::mpsc,
    thread,
    time::Duration,
};

use cotorra_wifi::{
    AnswerError, BackgroundScan, BackgroundScanMethod, Band, BorrowedAccessPoint, BorrowedStation, Channel,
    Client, ControlError, Event, Width, hostapd, ping, wpa_supplicant,
};

/// A program that answers each request by a function, until it is asked to end. `None` is silence.
struct Program {
    folder: tempfile::TempDir,
    requests: mpsc::Receiver<String>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Program {
    fn start(mut answer: impl FnMut(&str) -> Option<String> + Send + 'static) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let socket = UnixDatagram::bind(folder.path().join("program")).expect("a socket");
        let (heard, requests) = mpsc::channel();
        let thread = thread::spawn(move || {
            let mut buffer = [0; 4096];
            loop {
                let (length, from) = socket.recv_from(&mut buffer).expect("a request");
                let request = String::from_utf8_lossy(&buffer[..length]).into_owned();
                if request == "END" {
                    return;
                }
                let from = from.as_pathname().expect("an address");
                let answer = answer(&request);
                // Before the answer, after which the test looks.
                let _ = heard.send(request);
                if let Some(answer) = answer {
                    // A client that gave up is gone.
                    let _ = socket.send_to(answer.as_bytes(), from);
                }
            }
        });
        Self { folder, requests, thread: Some(thread) }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("program")
    }

    fn client(&self) -> Client {
        Client::connect(&self.path(), self.folder.path()).expect("a client")
    }

    /// Ends as if killed: the socket's file stays.
    fn end(&mut self) {
        let socket = UnixDatagram::unbound().expect("a socket");
        socket.send_to(b"END", self.path()).expect("the program listens");
        self.thread.take().expect("it runs").join().expect("it does not panic");
    }

    fn requests(&self) -> Vec<String> {
        self.requests.try_iter().collect()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if self.thread.is_some() {
            self.end();
        }
    }
}

fn files(folder: &Path) -> usize {
    folder.read_dir().expect("the folder is there").count()
}

#[test]
fn refusals_name_the_command() {
    let program = Program::start(|_| Some("FAIL\n".to_owned()));
    let error =
        program.client().request(&wpa_supplicant::roam("02:00:00:00:00:01".parse().expect("an address")));
    let error = error.expect_err("it refuses");
    assert!(
        matches!(&error, ControlError::Answer { command, error: AnswerError::Failed, .. } if command == "ROAM")
    );
}

#[test]
fn a_late_answer_is_not_taken_for_the_next() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("program");
    let socket = UnixDatagram::bind(&path).expect("a socket");
    let mut client =
        Client::connect(&path, folder.path()).expect("a client").with_timeout(Duration::from_millis(1));
    let error = client.request(&wpa_supplicant::scan(&[])).expect_err("there is no answer");
    assert!(matches!(&error, ControlError::Timeout { command, .. } if command == "SCAN"));
    let thread = thread::spawn(move || {
        let mut buffer = [0; 64];
        let (_, first) = socket.recv_from(&mut buffer).expect("the first request");
        let (_, second) = socket.recv_from(&mut buffer).expect("the second request");
        // Nobody listens at the first address any more.
        assert!(socket.send_to(b"OK\n", first.as_pathname().expect("an address")).is_err());
        socket.send_to(b"PONG\n", second.as_pathname().expect("an address")).expect("it is read");
    });
    client.with_timeout(Client::TIMEOUT).request(&ping()).expect("an answer");
    thread.join().expect("it does not panic");
}

#[test]
fn own_sockets_are_removed() {
    let program = Program::start(|_| Some("OK\n".to_owned()));
    let client = program.client();
    let events = client.events().expect("events");
    assert_eq!(files(program.folder.path()), 3);
    drop((client, events));
    assert_eq!(files(program.folder.path()), 1);
}

#[test]
fn the_end_of_a_program_is_told_from_its_silence() {
    let mut program = Program::start(|request| match request {
        "ATTACH" => Some("OK\n".to_owned()),
        _ => Some("PONG\n".to_owned()),
    });
    let mut client = program.client();
    let mut events = client.events().expect("events");
    for _ in 0..3 {
        assert_eq!(events.next(Duration::from_millis(1)).expect("it runs"), None);
    }
    program.end();
    while events.next(Duration::from_millis(1)).is_ok() {}
    assert!(matches!(events.next(Duration::ZERO), Err(ControlError::Gone { .. })));
    assert!(matches!(client.request(&ping()), Err(ControlError::Gone { .. })));
    let nobody = Client::connect(&program.folder.path().join("nobody"), program.folder.path());
    assert!(matches!(nobody, Err(ControlError::Gone { .. })));
}

#[test]
fn events_come_in_order() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("program");
    let socket = UnixDatagram::bind(&path).expect("a socket");
    let thread = thread::spawn(move || {
        let mut buffer = [0; 64];
        let (_, from) = socket.recv_from(&mut buffer).expect("the request");
        for datagram in ["OK\n", "<3>AP-ENABLED ", "PONG\n", "<3>AP-DISABLED "] {
            socket.send_to(datagram.as_bytes(), from.as_pathname().expect("an address")).expect("it is read");
        }
        socket
    });
    let client = Client::connect(&path, folder.path()).expect("a client");
    let mut events = client.events().expect("events");
    let _socket = thread.join().expect("it does not panic");
    let mut next = || events.next(Duration::ZERO).expect("it runs").map(|message| message.event);
    assert_eq!(next(), Some(Event::AccessPointEnabled));
    assert_eq!(next(), Some(Event::AccessPointDisabled));
    assert_eq!(next(), None);
}

#[test]
fn stations_are_read_one_after_the_other() {
    let program = Program::start(|request| {
        Some(match request {
            "STA-FIRST" => "02:00:00:00:00:01\nflags=[AUTHORIZED]\n".to_owned(),
            "STA-NEXT 02:00:00:00:00:01" => "02:00:00:00:00:02\nflags=\n".to_owned(),
            // It left meanwhile.
            _ => "FAIL\n".to_owned(),
        })
    });
    let stations = program.client().stations().expect("stations");
    let stations: Vec<_> =
        stations.iter().map(|station| (station.address.0[5], station.authorized)).collect();
    assert_eq!(stations, [(1, true), (2, false)]);
}

const STATUS: &str = "state=ENABLED\nfreq=2412\nsecondary_channel=0\nbeacon_int=100\ndtim_period=3\n";
const CONFIGURATION: &str = "bssid=02:00:00:00:00:01\nssid=theirs\n";

fn hostapd_of_others(request: &str) -> Option<String> {
    Some(match request {
        "STATUS" => STATUS.to_owned(),
        "GET_CONFIG" => CONFIGURATION.to_owned(),
        _ => "OK\n".to_owned(),
    })
}

#[test]
fn settings_of_others_are_put_back_last_first() {
    let program = Program::start(hostapd_of_others);
    let mut borrowed = BorrowedAccessPoint::new(program.client());
    let ours = [
        hostapd::Setting::Ssid("ours".parse().expect("an SSID")),
        hostapd::Setting::DtimPeriod(1.try_into().expect("not zero")),
    ];
    borrowed.set(&ours).expect("it is set");
    let channel = Channel::new(Band::Ghz2, 6, Width::Mhz20).expect("a channel");
    borrowed.switch_channel(channel, 3).expect("it is switched");
    borrowed.serve(false).expect("it stops");
    let changes = [
        "STATUS",
        "GET_CONFIG",
        "SET ssid2 6f757273",
        "SET dtim_period 1",
        "RELOAD",
        "STATUS",
        "CHAN_SWITCH 3 2437 bandwidth=20 ht",
        "STATUS",
        "DISABLE",
    ];
    assert_eq!(program.requests(), changes);
    borrowed.give_back().expect("it is put back");
    let back = [
        "ENABLE",
        "CHAN_SWITCH 3 2412 bandwidth=20 ht",
        "SET dtim_period 3",
        "SET ssid2 746865697273",
        "RELOAD",
    ];
    assert_eq!(program.requests(), back);
}

#[test]
fn what_cannot_be_read_is_not_changed() {
    let program = Program::start(|request| match request {
        "STATUS" => Some("state=ENABLED\nfreq=5955\n".to_owned()),
        other => hostapd_of_others(other),
    });
    let mut borrowed = BorrowedAccessPoint::new(program.client());
    let beacon_interval = hostapd::Setting::BeaconInterval(Default::default());
    assert!(borrowed.set(&[beacon_interval]).is_err());
    let channel = Channel::new(Band::Ghz2, 6, Width::Mhz20).expect("a channel");
    assert!(borrowed.switch_channel(channel, 3).is_err());
    drop(borrowed);
    assert_eq!(program.requests(), ["STATUS", "GET_CONFIG", "STATUS"]);
}

#[test]
fn everything_is_put_back_even_if_something_fails() {
    let program = Program::start(|request| match request {
        "CHAN_SWITCH 3 2412 bandwidth=20 ht" => Some("FAIL\n".to_owned()),
        other => hostapd_of_others(other),
    });
    let mut borrowed = BorrowedAccessPoint::new(program.client());
    borrowed.serve(false).expect("it stops");
    let channel = Channel::new(Band::Ghz2, 6, Width::Mhz20).expect("a channel");
    borrowed.switch_channel(channel, 3).expect("it is switched");
    program.requests();
    assert!(borrowed.give_back().is_err());
    assert_eq!(program.requests(), ["CHAN_SWITCH 3 2412 bandwidth=20 ht", "ENABLE"]);
}

#[test]
fn variables_of_others_are_put_back_once() {
    let program = Program::start(|request| match request {
        "GET_NETWORK 0 bgscan" => Some("\"simple:30:-65:300\"".to_owned()),
        get if get.starts_with("GET_NETWORK") => Some("FAIL\n".to_owned()),
        _ => Some("OK\n".to_owned()),
    });
    let mut borrowed = BorrowedStation::new(program.client());
    let scan = |short_s| {
        let method = BackgroundScanMethod::Simple;
        wpa_supplicant::Setting::BackgroundScan(Some(BackgroundScan {
            method,
            threshold_dbm: -60,
            short_s,
            long_s: 60,
        }))
    };
    borrowed.set(0, &scan(5)).expect("it is set");
    borrowed.set(0, &scan(6)).expect("it is set again");
    borrowed.set(1, &wpa_supplicant::Setting::Bssid("02:00:00:00:00:01".parse().ok())).expect("it is set");
    program.requests();
    drop(borrowed);
    assert_eq!(program.requests(), ["SET_NETWORK 1 bssid any", "SET_NETWORK 0 bgscan \"simple:30:-65:300\""]);
}
