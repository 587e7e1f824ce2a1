//! The socket of a medium.

use std::{
    fmt, io,
    os::fd::{AsFd, BorrowedFd},
};

use cotorra_netlink::{ACK, Family, Netlink, REQUEST, bind_alone, message, messages};
use netlink_sys::{Socket, protocols::NETLINK_GENERIC};

use crate::{error::Error, message::Message, radios::FAMILY};

/// Room for frames that wait for the medium, bytes. The kernel takes as much of it as `net.core.rmem_max` allows.
const RECEIVE_BUFFER: i32 = 8 << 20;
/// The most that the kernel puts into one datagram: a page, and the frame's attributes.
const DATAGRAM: usize = 16 << 10;
/// The most that is sent to it in one, bytes. Half as much as a socket may send by default.
const MOST_QUEUED: usize = 100 << 10;
/// `NLMSG_ERROR`.
const ERROR: u16 = 2;
const ENOBUFS: i32 = 105;

/// The registered medium of a network namespace's radios: of those that were created there, wherever their phys are now. The
/// kernel's own medium, which loses nothing, is back when this is dropped.
pub struct MediumSocket {
    socket: Socket,
    family: u16,
    buffer: Vec<u8>,
    /// Messages to be sent together, and their numbers.
    queued: Vec<u8>,
    numbers: Vec<u32>,
}

/// Messages from the kernel.
#[derive(Debug)]
pub enum Incoming {
    /// A message.
    Message(Message),
    /// The kernel refused the message that was [sent](MediumSocket::send) with this number.
    Refused {
        /// The number.
        number: u32,
        /// The kernel's error: `EINVAL` if a radio does not listen on the frame's channel.
        error: io::Error,
    },
    /// Something that this crate does not know or cannot decode.
    Unknown,
    /// Messages were lost, because too many waited. The kernel drops their frames without a status.
    Overrun,
}

impl MediumSocket {
    /// Becomes the medium of the calling thread's network namespace. Create radios and interfaces afterwards, so that their
    /// addresses are announced.
    ///
    /// # Errors
    /// [`Error::Missing`], [`Error::NoRights`], [`Error::Taken`], [`Error::SeveralChannels`] or [`Error::Refused`].
    pub fn register() -> Result<Self, Error> {
        let family = Family::new(FAMILY).number(&mut Netlink::new(NETLINK_GENERIC));
        let family = family.map_err(Error::of("name its medium"))?;
        let socket = open().map_err(Error::of("open a socket"))?;
        let buffer = Vec::with_capacity(DATAGRAM);
        let mut medium = Self { socket, family, buffer, queued: Vec::new(), numbers: Vec::new() };
        medium.write(ACK, 0, &Message::Register).map_err(Error::of_registration)?;
        // The kernel has answered before `write` returns, and frames come after the answer.
        match medium.read().map_err(Error::of_registration)? {
            Some(Answer::Code { code: 0, .. }) => Ok(medium),
            Some(Answer::Code { code, .. }) => {
                Err(Error::of_registration(io::Error::from_raw_os_error(code)))
            }
            _ => Err(Error::of_registration(io::ErrorKind::InvalidData.into())),
        }
    }

    /// Sends a message with a number.
    ///
    /// # Errors
    /// The failure of the socket. What the kernel refuses comes back by [`Self::receive`].
    pub fn send(&self, number: u32, message: &Message) -> io::Result<()> {
        self.write(0, number, message)
    }

    /// Queues a message with a number. Returns whether there was room.
    pub fn queue(&mut self, number: u32, queued: &Message) -> bool {
        let bytes = message(self.family, REQUEST, number, &queued.encode());
        let fits = self.queued.len() + bytes.len() <= MOST_QUEUED;
        if fits {
            self.queued.extend(bytes);
            self.numbers.push(number);
        }
        fits
    }

    /// Sends the queued messages in one system call. Returns the numbers of those that could not be sent: none, or all of them.
    /// [`Self::receive`] returns the kernel's refusals.
    pub fn flush(&mut self) -> Vec<u32> {
        if self.queued.is_empty() {
            return Vec::new();
        }
        let sent = self.socket.send(&self.queued, 0);
        self.queued.clear();
        let numbers = std::mem::take(&mut self.numbers);
        if sent.is_ok() { Vec::new() } else { numbers }
    }

    /// Returns what came from the kernel; `None` if nothing did. Never waits: poll the socket for that.
    ///
    /// # Errors
    /// The failure of the socket.
    pub fn receive(&mut self) -> io::Result<Option<Incoming>> {
        Ok(match self.read()? {
            None => None,
            Some(Answer::Message(message)) => Some(Incoming::Message(message)),
            Some(Answer::Code { number, code }) => {
                Some(Incoming::Refused { number, error: io::Error::from_raw_os_error(code) })
            }
            Some(Answer::Unknown) => Some(Incoming::Unknown),
            Some(Answer::Overrun) => Some(Incoming::Overrun),
        })
    }

    fn write(&self, flags: u16, number: u32, sent: &Message) -> io::Result<()> {
        let bytes = message(self.family, REQUEST | flags, number, &sent.encode());
        self.socket.send(&bytes, 0).map(drop)
    }

    fn read(&mut self) -> io::Result<Option<Answer>> {
        self.buffer.clear();
        match self.socket.recv(&mut self.buffer, 0) {
            Ok(_) => Ok(Some(Answer::decode(&self.buffer, self.family))),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            Err(error) if error.raw_os_error() == Some(ENOBUFS) => Ok(Some(Answer::Overrun)),
            Err(error) => Err(error),
        }
    }
}

impl AsFd for MediumSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl fmt::Debug for MediumSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MediumSocket").field("family", &self.family).finish_non_exhaustive()
    }
}

/// Content of a datagram. The kernel sends a medium one message in each.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    Message(Message),
    /// The answer to a message: 0, or an error code.
    Code {
        number: u32,
        code: i32,
    },
    Unknown,
    Overrun,
}

impl Answer {
    pub(crate) fn decode(datagram: &[u8], family: u16) -> Self {
        let Some(Ok(message)) = messages(datagram).next() else { return Self::Unknown };
        if message.kind == ERROR {
            let code = message.body.first_chunk().map_or(0, |code| i32::from_ne_bytes(*code));
            return Self::Code { number: message.sequence, code: code.wrapping_neg() };
        }
        let decoded = (message.kind == family).then(|| Message::decode(message.body));
        match decoded {
            Some(Ok(Some(message))) => Self::Message(message),
            _ => Self::Unknown,
        }
    }
}

/// Opens a socket that never blocks.
fn open() -> io::Result<Socket> {
    let mut socket = Socket::new(NETLINK_GENERIC)?;
    // The kernel takes the end of any socket of the namespace with the medium's number for that of the medium.
    bind_alone(&mut socket)?;
    socket.set_non_blocking(true)?;
    // Errors come back without the frame that they are about.
    socket.set_cap_ack(true)?;
    socket.set_rx_buf_sz(RECEIVE_BUFFER)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagrams_are_messages_of_the_family_or_answers() {
        const FAMILY: u16 = 30;
        let register = message(FAMILY, 0, 0, &Message::Register.encode());
        assert_eq!(Answer::decode(&register, FAMILY), Answer::Message(Message::Register));
        assert_eq!(Answer::decode(&register, FAMILY + 1), Answer::Unknown);
        let refused = message(ERROR, 0, 7, &(-22_i32).to_ne_bytes());
        assert_eq!(Answer::decode(&refused, FAMILY), Answer::Code { number: 7, code: 22 });
        assert_eq!(Answer::decode(&refused[..12], FAMILY), Answer::Unknown);
    }
}
