//! Sockets to hostapd and wpa_supplicant.

use std::{
    fs, io,
    os::{
        fd::{AsFd, BorrowedFd},
        unix::{fs::MetadataExt, net::UnixDatagram},
    },
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use crate::control::{AnswerError, Message, Request, attach, hostapd, wpa_supplicant};

/// Longest datagram that is read, in bytes. Both programs answer with 8192 at most.
const LONGEST: usize = 16 * 1024;
/// Most stations of an access point: association identifiers go up to 2007 (IEEE 802.11-2020, 9.4.1.8).
const MOST_STATIONS: usize = 2007;
/// Most networks that are read of a station's configuration.
const MOST_NETWORKS: usize = 10_000;

/// A request that failed.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// No program listens at the socket: it ended, or was never started.
    #[error("nobody listens at {path}: the program has ended or was not started")]
    Gone {
        /// The program's socket.
        path: PathBuf,
    },
    /// The program did not answer in time.
    #[error("no answer to {command} from {path} within {} ms", .timeout.as_millis())]
    Timeout {
        /// The command.
        command: String,
        /// The program's socket.
        path: PathBuf,
        /// The time.
        timeout: Duration,
    },
    /// The program refused, or its answer is not understood.
    #[error("{command} at {path}: {error}")]
    Answer {
        /// The command.
        command: String,
        /// The program's socket.
        path: PathBuf,
        /// The reason.
        error: AnswerError,
    },
    /// The system refused.
    #[error("cannot talk to {path}: {source}")]
    System {
        /// The program's socket.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
}

/// Sends requests to a program, one after the other.
#[derive(Debug)]
pub struct Client {
    socket: Socket,
    timeout: Duration,
}

impl Client {
    /// Time that a program has for an answer. Some take long: hostapd answers `ENABLE` after it has set the interface up.
    pub const TIMEOUT: Duration = Duration::from_secs(10);

    /// Connects to a program's socket, such as `/run/hostapd/wlan0`. The own socket is a file in the folder `own`, which the
    /// program's user must be able to enter. Only the program can write to it. It is removed with the client.
    ///
    /// # Errors
    /// [`ControlError::Gone`] if no program listens there; [`ControlError::System`], e.g. without the right to write to
    /// the socket.
    pub fn connect(program: &Path, own: &Path) -> Result<Self, ControlError> {
        Ok(Self { socket: Socket::connect(program, own)?, timeout: Self::TIMEOUT })
    }

    /// Gives the program this time for each answer.
    #[must_use]
    pub fn with_timeout(self, timeout: Duration) -> Self {
        Self { timeout, ..self }
    }

    /// Sends a request and waits for its answer.
    ///
    /// # Errors
    /// [`ControlError`].
    pub fn request<A>(&mut self, request: &Request<A>) -> Result<A, ControlError> {
        let answer = match self.socket.send(request.text(), self.timeout)? {
            true => self.socket.receive(self.timeout)?,
            false => None,
        };
        let Some(answer) = answer else {
            // An answer that comes late must not be taken for that to the next request.
            self.socket = Socket::connect(&self.socket.program, &self.socket.folder())?;
            return Err(ControlError::Timeout {
                command: request.command().to_owned(),
                path: self.socket.program.clone(),
                timeout: self.timeout,
            });
        };
        request.read(&answer).map_err(|error| ControlError::Answer {
            command: request.command().to_owned(),
            path: self.socket.program.clone(),
            error,
        })
    }

    /// Returns the stations of an access point. One that leaves meanwhile hides those after it.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub fn stations(&mut self) -> Result<Vec<hostapd::Station>, ControlError> {
        let mut stations = Vec::new();
        let mut next = self.request(&hostapd::first_station())?;
        while let Some(station) = next {
            let address = station.address;
            stations.push(station);
            if stations.len() == MOST_STATIONS {
                break;
            }
            next = match self.request(&hostapd::next_station(address)) {
                Err(ControlError::Answer { error: AnswerError::Failed, .. }) => None,
                answer => answer?,
            };
        }
        Ok(stations)
    }

    /// Returns the networks of a station's configuration, at most 10 000.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub fn networks(&mut self) -> Result<Vec<wpa_supplicant::Listed>, ControlError> {
        let mut networks = Vec::new();
        loop {
            let last = networks.last().map(|listed: &wpa_supplicant::Listed| listed.network);
            let more = self.request(&wpa_supplicant::networks(last))?;
            // They come in the order of their numbers.
            let new = more.into_iter().filter(|listed| last.is_none_or(|last| listed.network > last));
            let before = networks.len();
            networks.extend(new);
            if networks.len() == before || networks.len() >= MOST_NETWORKS {
                return Ok(networks);
            }
        }
    }

    /// Opens another socket to the program, for events.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub fn events(&self) -> Result<Events, ControlError> {
        let own = self.socket.folder();
        let mut client = Self::connect(&self.socket.program, &own)?.with_timeout(self.timeout);
        client.request(&attach())?;
        Ok(Events { socket: client.socket })
    }
}

/// Events of a program. The program drops them if too many wait, and after some time forgets who does not read them: read them
/// on a thread of their own.
#[derive(Debug)]
pub struct Events {
    socket: Socket,
}

impl Events {
    /// Waits for the next event; `None` if there is none within this time. Only then it looks whether the program still runs.
    ///
    /// # Errors
    /// [`ControlError::Gone`] if there is none because the program has ended, however it ended.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Message>, ControlError> {
        // Answers to the PINGs below are no events.
        while let Some(datagram) = self.socket.receive(timeout)? {
            if let Some(message) = Message::parse(&datagram) {
                return Ok(Some(message));
            }
        }
        // The kernel reports the end of a program only to senders.
        self.socket.send("PING", Duration::ZERO)?;
        Ok(None)
    }
}

impl AsFd for Events {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.socket.as_fd()
    }
}

/// A socket that is connected to a program's. The kernel lets only the program write to it.
#[derive(Debug)]
struct Socket {
    socket: UnixDatagram,
    own: PathBuf,
    program: PathBuf,
}

impl Socket {
    fn connect(program: &Path, folder: &Path) -> Result<Self, ControlError> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let own = folder.join(format!("client-{}-{number}", std::process::id()));
        let failed = |source| failure(program, source);
        // It may be a leftover of a process that had this number.
        _ = fs::remove_file(&own);
        let bind = |own: &PathBuf| {
            UnixDatagram::bind(own).map_err(|source| ControlError::System { path: own.clone(), source })
        };
        let socket = Self { socket: bind(&own)?, own, program: program.to_owned() };
        socket.socket.connect(program).map_err(failed)?;
        // A program of another user must be able to write to it.
        let owner = fs::metadata(program).map_err(failed)?;
        if fs::metadata(&socket.own).map_err(failed)?.uid() != owner.uid() {
            std::os::unix::fs::chown(&socket.own, Some(owner.uid()), None).map_err(failed)?;
        }
        Ok(socket)
    }

    fn folder(&self) -> PathBuf {
        self.own.parent().map(Path::to_owned).unwrap_or_default()
    }

    /// Sends a datagram; `false` if the program has no room for it within the time.
    fn send(&self, text: &str, timeout: Duration) -> Result<bool, ControlError> {
        self.wait_for(timeout).map_err(|source| failure(&self.program, source))?;
        match self.socket.send(text.as_bytes()) {
            Ok(_) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(failure(&self.program, error)),
        }
    }

    /// Waits for a datagram; `None` if there is none within the time.
    fn receive(&self, timeout: Duration) -> Result<Option<Vec<u8>>, ControlError> {
        self.wait_for(timeout).map_err(|source| failure(&self.program, source))?;
        let mut datagram = vec![0; LONGEST];
        loop {
            match self.socket.recv(&mut datagram) {
                Ok(length) => {
                    datagram.truncate(length);
                    return Ok(Some(datagram));
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(failure(&self.program, error)),
            }
        }
    }

    /// Sets the time that the next call may wait.
    fn wait_for(&self, timeout: Duration) -> io::Result<()> {
        // To the kernel, no time at all means all the time there is.
        self.socket.set_nonblocking(timeout.is_zero())?;
        if !timeout.is_zero() {
            self.socket.set_read_timeout(Some(timeout))?;
            self.socket.set_write_timeout(Some(timeout))?;
        }
        Ok(())
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        _ = fs::remove_file(&self.own);
    }
}

/// Returns the error for one of the system's.
fn failure(program: &Path, source: io::Error) -> ControlError {
    use io::ErrorKind::{ConnectionRefused, ConnectionReset, NotConnected, NotFound};
    let path = program.to_owned();
    match source.kind() {
        NotFound | ConnectionRefused | ConnectionReset | NotConnected => ControlError::Gone { path },
        _ => ControlError::System { path, source },
    }
}
