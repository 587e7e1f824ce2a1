//! The client, against a program of the test's own behind a socket.

use std::{
    os::unix::net::UnixDatagram,
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use cotorra_wifi::{AnswerError, Client, ControlError, Event, ping, wpa_supplicant};

/// A program that answers each request by a function, until it is asked to end. `None` is silence.
struct Program {
    folder: tempfile::TempDir,
    thread: Option<thread::JoinHandle<()>>,
}

impl Program {
    fn start(mut answer: impl FnMut(&str) -> Option<String> + Send + 'static) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let socket = UnixDatagram::bind(folder.path().join("program")).expect("a socket");
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
                if let Some(answer) = answer {
                    // A client that gave up is gone.
                    let _ = socket.send_to(answer.as_bytes(), from);
                }
            }
        });
        Self { folder, thread: Some(thread) }
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
        // The first address is closed by now.
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
