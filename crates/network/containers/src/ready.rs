//! Readiness: whether a namespace has listeners at ports.

use std::{fs, path::Path};

use cotorra_graph::{ListenPort, Transport};

/// State of a listening TCP socket, in `/proc/net/tcp`.
const LISTEN: &str = "0A";
/// State of a UDP socket without a peer, in `/proc/net/udp`.
const UNCONNECTED: &str = "07";

/// Returns whether there is a listener at each of these ports in the network namespace of a process.
pub(crate) fn are_served(process: u32, ports: &[ListenPort]) -> bool {
    let folder = Path::new("/proc").join(process.to_string()).join("net");
    ports.iter().all(|port| {
        let tables = match port.transport {
            Transport::Tcp => ["tcp", "tcp6"],
            Transport::Udp => ["udp", "udp6"],
        };
        tables
            .iter()
            .any(|table| fs::read_to_string(folder.join(table)).is_ok_and(|text| has_listener(&text, *port)))
    })
}

/// Whether a table of the kernel's sockets has a listener at a port.
fn has_listener(table: &str, port: ListenPort) -> bool {
    let state = match port.transport {
        Transport::Tcp => LISTEN,
        Transport::Udp => UNCONNECTED,
    };
    table.lines().skip(1).any(|line| {
        let mut words = line.split_ascii_whitespace().skip(1);
        let local = words.next().and_then(|local| local.rsplit_once(':')).map(|(_, port)| port);
        let is_there = local.and_then(|hex| u16::from_str_radix(hex, 16).ok()) == Some(port.port);
        is_there && words.nth(1) == Some(state)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TCP: &str = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid
   0: 00000000:1F90 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 1 1 0 100 0 0 10 0
   1: 0100007F:1F91 0100007F:0050 01 00000000:00000000 00:00000000 00000000     0        0 1 1 0 100 0 0 10 0\n";
    const UDP6: &str = "  sl  local_address                         remote_address                        st
   0: 00000000000000000000000000000000:0035 00000000000000000000000000000000:0000 07 00000000:00000000\n";

    #[test]
    fn only_listeners_serve_a_port() {
        let tcp = |port| has_listener(TCP, ListenPort { port, transport: Transport::Tcp });
        assert!(tcp(8080));
        assert!(!tcp(8081), "a connection is no listener");
        assert!(!tcp(80), "the peer's port is not ours");
        assert!(has_listener(UDP6, ListenPort { port: 53, transport: Transport::Udp }));
        assert!(!has_listener("", ListenPort { port: 53, transport: Transport::Udp }));
    }

    #[test]
    fn listeners_of_this_process_are_found() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = ListenPort { port: listener.local_addr().unwrap().port(), transport: Transport::Tcp };
        assert!(are_served(std::process::id(), &[port]));
        drop(listener);
        assert!(!are_served(std::process::id(), &[port]));
    }
}
