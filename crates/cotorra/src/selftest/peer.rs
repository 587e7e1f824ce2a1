//! A program of the scene `mesh`: asks all other hosts, each once, and answers them.
//!
//! Hosts ask after all listen, because a lost request is not repeated: hosts say hello to the first one until it has heard them
//! all.

use std::{
    collections::BTreeSet,
    io::{self, Write as _},
    net::{IpAddr, SocketAddr, ToSocketAddrs as _, UdpSocket},
    time::Duration,
};

/// Port of all peers.
pub const PORT: u16 = 4470;
/// Time between two requests, or two hellos.
const PACE: Duration = Duration::from_millis(50);

const HELLO: u8 = b'h';
const GO: u8 = b'g';
const REQUEST: u8 = b'r';
const ANSWER: u8 = b'a';

/// Talks to these hosts, of which `own` is this one, until somebody ends this process. Prints the number of hosts that answered
/// each time it grows.
#[allow(clippy::disallowed_types, reason = "real packets take real time")]
pub fn peer(own: &str, hosts: &[String]) -> io::Result<()> {
    let socket = UdpSocket::bind(("0.0.0.0", PORT))?;
    let address = |host: &String| {
        let addresses = (host.as_str(), PORT).to_socket_addrs()?;
        addresses
            .into_iter()
            .find(SocketAddr::is_ipv4)
            .ok_or_else(|| io::Error::other("a host has no address"))
    };
    let first = address(&hosts[0])?;
    let others = hosts.iter().filter(|host| *host != own).map(address).collect::<io::Result<Vec<_>>>()?;
    let mut heard = BTreeSet::<IpAddr>::new();
    let mut answered = BTreeSet::<IpAddr>::new();
    let mut all_listen = false;
    let mut unasked = others.iter().enumerate();
    let mut next = std::time::Instant::now();
    loop {
        let wait = next.saturating_duration_since(std::time::Instant::now());
        if wait.is_zero() {
            next += PACE;
            if !all_listen {
                socket.send_to(&[HELLO; 5], first)?;
            } else if let Some((number, other)) = unasked.next() {
                let [a, b, c, d] = (number as u32).to_be_bytes();
                socket.send_to(&[a, b, c, d, REQUEST], other)?;
            }
            continue;
        }
        socket.set_read_timeout(Some(wait))?;
        let mut datagram = [0; 5];
        let from = match socket.recv_from(&mut datagram) {
            Ok((5, from)) => from,
            _ => continue,
        };
        let reply = match datagram[4] {
            HELLO => {
                heard.insert(from.ip());
                if heard.len() < hosts.len() {
                    continue;
                }
                GO
            }
            REQUEST => ANSWER,
            GO => {
                all_listen = true;
                continue;
            }
            ANSWER => {
                if answered.insert(from.ip()) {
                    writeln!(io::stdout(), "{}", answered.len())?;
                }
                continue;
            }
            _ => continue,
        };
        datagram[4] = reply;
        socket.send_to(&datagram, from)?;
    }
}
