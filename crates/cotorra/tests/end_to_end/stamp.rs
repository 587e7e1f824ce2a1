//! `cotorra stamp` against Scapy, an independent implementation of STAMP's packets.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
};

use serde_json::Value;

use crate::harness::{cotorra, output, project_file, stderr, stdout};

/// A process that is killed on drop.
struct KilledOnDrop(Child);

impl KilledOnDrop {
    /// Returns the address in the first line that it prints.
    fn address(&mut self) -> String {
        let mut line = String::new();
        BufReader::new(self.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
        line.split([' ', ';']).find(|word| word.contains("127.0.0.1:")).unwrap().trim().to_owned()
    }
}

impl Drop for KilledOnDrop {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns a command for the peer, if it is installed.
fn scapy(arguments: &[&str]) -> Option<Command> {
    let python = cotorra_testing::peers("Scapy")?;
    let mut command = Command::new(python);
    command.arg("-u").arg(project_file("crates/cotorra/tests/end_to_end/stamp_peer.py")).args(arguments);
    Some(command)
}

fn reflector() -> (KilledOnDrop, String) {
    let mut command = cotorra(["stamp", "reflect", "--listen", "127.0.0.1:0", "--synchronized"]);
    let mut reflector = KilledOnDrop(command.stdout(Stdio::piped()).spawn().unwrap());
    let address = reflector.address();
    (reflector, address)
}

#[test]
fn both_sides_measure_each_other() {
    let (_reflector, address) = reflector();
    let arguments = ["stamp", "send", &address, "--count", "20", "--interval", "2ms", "--synchronized"];
    let measured = output(arguments.into_iter().chain(["--json"]));
    let measured: Value = serde_json::from_str(&stdout(&measured)).unwrap();
    assert_eq!((&measured["sent"], &measured["lost"]), (&20.into(), &0.into()));
    let least = |name: &str| measured[name]["min"].as_f64().unwrap();
    assert!(least("forward_ms") + least("backward_ms") <= least("round_trip_ms") + 1e-6, "{measured}");
    let text = stdout(&output(arguments));
    for part in ["20 packets", "round trip", "there", "back", "jitter", "0 packets, 0.00 %; there 0.00 %"] {
        assert!(text.contains(part), "no `{part}` in\n{text}");
    }
}

#[test]
fn another_reflector_is_measured() {
    // The peer loses every fifth packet on its way there, and answers the others after 20 ms.
    let Some(mut command) = scapy(&["reflect"]) else { return };
    let mut peer = KilledOnDrop(command.stdout(Stdio::piped()).spawn().unwrap());
    let address = peer.address();
    let arguments =
        ["stamp", "send", &address, "--count", "21", "--interval", "30ms", "--length", "100", "--json"];
    let measured = output(arguments);
    let measured: Value =
        serde_json::from_str(&stdout(&measured)).unwrap_or_else(|_| panic!("{}", stderr(&measured)));
    assert_eq!((&measured["sent"], &measured["lost"]), (&21.into(), &4.into()), "{measured}");
    assert_eq!((&measured["forward_loss"], &measured["backward_loss"]), (&0.2.into(), &0.0.into()));
    assert!(measured["round_trip_ms"]["min"].as_f64().unwrap() < 20.0, "its rest counted: {measured}");
    assert_eq!(measured["forward_ms"], Value::Null, "its clock is not synchronised");
}

#[test]
fn another_sender_is_answered() {
    let Some(mut command) = scapy(&["send"]) else { return };
    let (_reflector, address) = reflector();
    let done = command.arg(&address).output().unwrap();
    assert!(done.status.success(), "{}", stderr(&done));
    assert_eq!(stdout(&done), "answered as RFC 8762 and RFC 8972 say\n");
}

#[test]
fn silence_is_an_error_that_says_what_to_do() {
    // The socket is bound, but nothing answers.
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    let done = output(["stamp", "send", &address, "--count", "2", "--interval", "1ms", "--patience", "10ms"]);
    assert_eq!(done.status.code(), Some(1));
    assert!(stderr(&done).contains(&format!("no answer from {address}")), "{}", stderr(&done));
    assert_eq!(output(["stamp", "send", &address, "--length", "43"]).status.code(), Some(2));
}
