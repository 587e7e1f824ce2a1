//! A confined VNF with `net_raw` sends frames in the name of another node.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::PathBuf};

use cotorra_graph::HostAddress;
use serde_json::Value;
use tempfile::TempDir;

use crate::{
    harness::{Run, wait_until},
    one_robot::{NAVIGATED, testbed},
};

/// Places of the nodes in the testbed file.
const CLOUD: usize = 1;
const ROBOT: usize = 2;
const EDGE: usize = 3;
const PORT: u16 = 5000;

/// Prints the sender of each datagram.
const LISTEN: &str = "
import socket
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind(('0.0.0.0', PORT))
while True:
    data, sender = s.recvfrom(2000)
    print(data.decode(), sender[0], flush=True)
    s.sendto(data, sender)
";

/// Poisons the robot's ARP, and sends it a datagram in the name of the cloud and one in its own, until this is answered. All of
/// its frames are in one order, so that the answer tells that those before it are through.
const FORGE: &str = "
import socket, struct
mac = lambda text: bytes.fromhex(text)
robot, cloud, own = (socket.inet_aton(a) for a in ('ROBOT_IP', 'CLOUD_IP', 'OWN_IP'))
raw = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
raw.bind(('eth0', 0))
def checksum(data):
    total = sum(struct.unpack('!%dH' % (len(data) // 2), data))
    while total >> 16: total = (total & 0xffff) + (total >> 16)
    return ~total & 0xffff
def datagram(sender, text):
    udp = struct.pack('!HHHH', 7000, PORT, 8 + len(text), 0) + text
    head = struct.pack('!BBHHHBBH4s4s', 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0, sender, robot)
    head = head[:10] + struct.pack('!H', checksum(head)) + head[12:]
    return mac('ROBOT_MAC') + mac('OWN_MAC') + b'\\x08\\x00' + head + udp
arp = mac('ROBOT_MAC') + mac('OWN_MAC') + bytes.fromhex('08060001080006040002') + mac('OWN_MAC') + cloud + mac('ROBOT_MAC') + robot
answers = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
answers.bind(('0.0.0.0', 7000))
answers.settimeout(1)
while True:
    for frame in (arp, datagram(cloud, b'forged'), datagram(own, b'honest')):
        raw.send(frame)
    try:
        answers.recv(2000)
        break
    except socket.timeout:
        pass
print('done', flush=True)
import time
time.sleep(1000)
";

/// Runs a robot whose node listens, and a VNF on another node that forges. Returns what the robot heard, the summary, and what
/// the run printed.
fn attacked(edge: &str) -> (String, Value, String) {
    let place = TempDir::new().unwrap();
    let hex = |place: usize| HostAddress::of(place).mac.map(|byte| format!("{byte:02x}")).concat();
    let ip = |place: usize| HostAddress::of(place).ipv4.to_string();
    let words = [
        ("ROBOT_MAC", hex(ROBOT)),
        ("OWN_MAC", hex(EDGE)),
        ("ROBOT_IP", ip(ROBOT)),
        ("CLOUD_IP", ip(CLOUD)),
        ("OWN_IP", ip(EDGE)),
        ("PORT", PORT.to_string()),
    ];
    for (name, script) in [("listen.py", LISTEN), ("forge.py", FORGE)] {
        let script = words.iter().fold(script.to_owned(), |text, (word, value)| text.replace(word, value));
        fs::write(place.path().join(name), script).unwrap();
    }
    let vnfs = "      listener: { node: tb, command: [python3, listen.py], cpus: 0.5 }
      forger: { node: edge, command: [python3, forge.py], cpus: 0.5, capabilities: [net_raw] }
walks:";
    let robot =
        format!("{{ kind: robot }}\n  edge: {{ kind: server, tier: edge, cpus: 2, memory: 4 GB{edge} }}");
    let file: PathBuf = testbed(place.path(), "forged", &robot, &NAVIGATED.replace("walks:", vnfs));
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, text.replace("links:\n", "links:\n  - { ends: [R1, edge], delay: 1 ms }\n")).unwrap();
    let mut run = Run::start_beside(&file, &["--until", "5min"]);
    let log =
        |name: &str| fs::read_to_string(run.folder.join(format!("logs/vnfs/{name}.log"))).unwrap_or_default();
    wait_until(|| log("forger").contains("done"));
    run.wait_for_service();
    let heard = log("listener");
    run.signal("INT");
    let (summary, printed) = run.report();
    (heard, summary, printed)
}

#[test]
fn a_vnf_with_raw_sockets_cannot_pass_for_another_node() {
    let (heard, summary, printed) = attacked("");
    assert!(heard.contains(&format!("honest {}", HostAddress::of(EDGE).ipv4)), "{heard}");
    assert!(!heard.contains("forged"), "{heard}");
    let [forged] = &summary["forged_sources"].as_array().unwrap()[..] else { panic!("{summary:#}") };
    assert_eq!((&forged["node"], &forged["allowed"]), (&"edge".into(), &false.into()), "{forged}");
    let count = |name: &str| forged[name].as_u64().unwrap();
    assert!(count("forged_arp") >= 1 && count("forged_ipv4") == count("forged_arp"), "{forged}");
    let others = ["forged_ethernet", "forged_neighbour_discovery", "forged_ipv6"].map(count);
    assert_eq!(others, [0; 3], "{forged}");
    assert!(printed.contains("node edge sent"), "{printed}");
}

#[test]
fn a_node_without_port_security_is_named_in_the_verdict() {
    let (heard, summary, _) = attacked(", port_security: false");
    assert!(heard.contains(&format!("forged {}", HostAddress::of(CLOUD).ipv4)), "{heard}");
    assert_eq!(summary["forged_sources"][0]["allowed"], true, "{summary:#}");
    let reason = summary["fidelity"]["reason"].as_str().unwrap();
    let is_told = reason.contains("answers may be forged: frames from `edge`");
    assert!(is_told || summary["fidelity"]["valid"] == false, "{reason}");
}
