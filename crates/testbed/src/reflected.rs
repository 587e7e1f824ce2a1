//! Measures, before a run begins, what the medium of a link over a real interface takes by itself: by STAMP (RFC 8762), and
//! before anything is emulated there, so that no scale ever meets what emulation added.

use std::{
    io::{self, ErrorKind},
    net::{IpAddr, SocketAddr, UdpSocket},
    time::Duration,
};

use cotorra_graph::{HardwareGraph, LinkId};
use cotorra_stamp::{PORT, Session, SessionConfig, Utc};

use crate::real_links::RealLinkError;

/// So many packets, so far apart: a second in all.
const PACKETS: u32 = 20;
const INTERVAL: Duration = Duration::from_millis(50);

/// Measures the media of all real links that have a reflector, and notes them in the graph.
///
/// # Errors
/// [`RealLinkError::NoReflector`], [`RealLinkError::Socket`].
pub(crate) fn measure_media(graph: &mut HardwareGraph) -> Result<(), RealLinkError> {
    let reflectors = graph.real_links().filter(|real| real.reached.reflector).filter_map(|real| {
        let address = real.reached.address?.address();
        Some((real.link.id.clone(), address))
    });
    for (link, address) in reflectors.collect::<Vec<_>>() {
        let delay = one_way(&link, address)?;
        tracing::info!(
            "the medium of `{link}` takes {:.3} ms, half of a round trip",
            delay.as_secs_f64() * 1e3
        );
        graph.links.iter_mut().filter(|l| l.id == link).for_each(|l| l.medium_delay = delay);
    }
    Ok(())
}

/// Half of the median round trip, the reflector's rest left out: two machines' clocks do not tell one way from the other.
fn one_way(link: &LinkId, address: IpAddr) -> Result<Duration, RealLinkError> {
    let none = || RealLinkError::NoReflector { link: link.clone(), address };
    let measured = session(address).map_err(|source| RealLinkError::Socket { link: link.clone(), source })?;
    Ok(measured.ok_or_else(none)? / 2)
}

#[allow(clippy::disallowed_types, reason = "another machine answers on the wall clock")]
fn session(address: IpAddr) -> io::Result<Option<Duration>> {
    let any: SocketAddr = if address.is_ipv4() { ([0; 4], 0).into() } else { ([0_u16; 8], 0).into() };
    let socket = UdpSocket::bind(any)?;
    socket.connect((address, PORT))?;
    let began = std::time::Instant::now();
    // Only differences matter.
    let now = || Utc::UNIX_EPOCH + began.elapsed();
    let mut session = Session::new(SessionConfig { interval: INTERVAL, ..SessionConfig::default() }, now());
    let mut buffer = [0; 2048];
    loop {
        if session.sent() == PACKETS {
            session.stop();
        }
        if let Some(probe) = session.poll(now()) {
            match socket.send(&probe) {
                // What an earlier packet met: nobody listens there. It counts as lost.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                sent => drop(sent?),
            }
        }
        let Some(deadline) = session.deadline() else { break };
        socket.set_read_timeout(Some(deadline.since(now()).max(Duration::from_micros(1))))?;
        match socket.recv(&mut buffer) {
            // Whatever else comes to this port is nobody's reply.
            Ok(length) => drop(session.receive(&buffer[..length], now())),
            Err(error) => match error.kind() {
                ErrorKind::WouldBlock
                | ErrorKind::TimedOut
                | ErrorKind::Interrupted
                | ErrorKind::ConnectionRefused => {}
                _ => return Err(error),
            },
        }
    }
    Ok(session.measurement(now()).and_then(|measured| measured.round_trip).map(|delays| delays.p50))
}
