//! UDP sockets of a run, and threads that receive from them.

use std::{
    io::{self, ErrorKind},
    net::{SocketAddr, UdpSocket},
    sync::{Arc, mpsc::Sender},
    thread,
    time::Duration,
};

use crate::{
    core::message::Message,
    error::{RunError, system},
};

/// Interval at which threads check whether the run goes on.
const CHECK: Duration = Duration::from_secs(1);
/// Longest wait for room in a socket; a datagram that finds none is lost.
const ROOM: Duration = Duration::from_millis(1);
/// Room for a datagram. A longer one is cut off.
pub(crate) const LARGEST: usize = 2048;

/// Opens a socket for [`spawn`].
pub(crate) fn open(bind: impl FnOnce() -> io::Result<UdpSocket>) -> io::Result<UdpSocket> {
    let socket = bind()?;
    socket.set_read_timeout(Some(CHECK))?;
    socket.set_write_timeout(Some(ROOM))?;
    Ok(socket)
}

/// Starts a thread that handles each datagram of a socket until the run ends.
pub(crate) fn spawn(
    name: String,
    socket: Arc<UdpSocket>,
    core: Sender<Message>,
    mut each: impl FnMut(&[u8], SocketAddr) + Send + 'static,
) -> Result<(), RunError> {
    let failed = system(format!("start the thread `{name}`"));
    let receive = move || {
        cotorra_datapath::be_timely();
        let mut buffer = vec![0; LARGEST];
        loop {
            match socket.recv_from(&mut buffer) {
                Ok((length, from)) => each(&buffer[..length], from),
                Err(error) => match error.kind() {
                    // The read timeout, by which the thread notices the end of the core.
                    ErrorKind::WouldBlock | ErrorKind::TimedOut => {
                        if core.send(Message::Wake).is_err() {
                            return;
                        }
                    }
                    // The other end, or the network to it, is not there (any more).
                    ErrorKind::Interrupted
                    | ErrorKind::ConnectionRefused
                    | ErrorKind::HostUnreachable
                    | ErrorKind::NetworkUnreachable
                    | ErrorKind::NetworkDown => {}
                    _ => {
                        let this = thread::current();
                        let name = this.name().unwrap_or_default();
                        return tracing::error!("the thread `{name}` receives nothing any more: {error}");
                    }
                },
            }
        }
    };
    thread::Builder::new().name(name).spawn(receive).map(drop).map_err(failed)
}
