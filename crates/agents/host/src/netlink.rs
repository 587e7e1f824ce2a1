//! Netlink: a socket that sends requests to the kernel, and the decoding of its answers.

use std::io;

use netlink_packet_core::{
    DecodeError, DefaultNla, Emitable, NLA_HEADER_SIZE, NLM_F_DUMP_INTR, NLM_F_REQUEST, NLMSG_DONE,
    NLMSG_ERROR, NLMSG_NOOP, NetlinkBuffer, NlasIterator, parse_i32,
};
use netlink_sys::Socket;

/// Length of a message's header.
const HEADER: usize = 16;
/// The most that the kernel puts into one datagram of a dump.
const DATAGRAM: usize = 32 << 10;
/// Attempts at a dump that changes interrupt. The last one counts all the same.
const ATTEMPTS: u32 = 3;

/// A netlink socket in the calling thread's network namespace. It is opened by the first request, and again after it
/// failed.
pub(crate) struct Netlink {
    protocol: isize,
    socket: Option<Socket>,
    sequence: u32,
}

impl Netlink {
    pub(crate) const fn new(protocol: isize) -> Self {
        Self { protocol, socket: None, sequence: 0 }
    }

    /// Sends a request, and returns what `decode` makes of the answers.
    ///
    /// # Errors
    /// The kernel's error code, or a failure of the socket.
    pub(crate) fn request<T>(
        &mut self,
        kind: u16,
        flags: u16,
        body: &[u8],
        decode: impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Vec<T>> {
        for _ in 1..ATTEMPTS {
            let answers = self.attempt(kind, flags, body, &decode)?;
            if !answers.interrupted {
                return Ok(answers.found);
            }
        }
        Ok(self.attempt(kind, flags, body, &decode)?.found)
    }

    fn attempt<T>(
        &mut self,
        kind: u16,
        flags: u16,
        body: &[u8],
        decode: &impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Answers<T>> {
        // It comes back only if it can be used again: answers that nobody read would be in the way of the next ones.
        let socket = self.socket.take().map_or_else(|| open(self.protocol), Ok)?;
        self.sequence = self.sequence.wrapping_add(1);
        socket.send(&message(kind, flags | NLM_F_REQUEST, self.sequence, body), 0)?;
        let mut answers = Answers::new(self.sequence);
        let mut datagram = Vec::with_capacity(DATAGRAM);
        loop {
            datagram.clear();
            socket.recv(&mut datagram, 0)?;
            let state = answers.take(&datagram, decode).map_err(invalid)?;
            if let State::Incomplete = state {
                continue;
            }
            self.socket = Some(socket);
            return match state {
                State::Rejected(error) => Err(error),
                _ => Ok(answers),
            };
        }
    }
}

/// Opens a socket that never blocks: the kernel has answered before `send` returns.
fn open(protocol: isize) -> io::Result<Socket> {
    let mut socket = Socket::new(protocol)?;
    socket.bind_auto()?;
    socket.set_non_blocking(true)?;
    Ok(socket)
}

fn invalid(error: DecodeError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}

/// Encodes a message. The kernel takes port 0 as that of the sender.
pub(crate) fn message(kind: u16, flags: u16, sequence: u32, body: &[u8]) -> Vec<u8> {
    let length = HEADER + body.len();
    let mut bytes = vec![0; length.next_multiple_of(4)];
    let mut message = NetlinkBuffer::new(&mut bytes);
    message.set_length(u32::try_from(length).expect("no request is that long"));
    message.set_message_type(kind);
    message.set_flags(flags);
    message.set_sequence_number(sequence);
    message.set_port_number(0);
    bytes[HEADER..length].copy_from_slice(body);
    bytes
}

/// Answers to one request, collected from datagrams.
pub(crate) struct Answers<T> {
    sequence: u32,
    pub(crate) found: Vec<T>,
    /// Whether a change interrupted the dump, so that something may be missing.
    interrupted: bool,
}

/// State of the answers to a request.
pub(crate) enum State {
    Incomplete,
    Complete,
    /// The kernel's error.
    Rejected(io::Error),
}

impl<T> Answers<T> {
    pub(crate) const fn new(sequence: u32) -> Self {
        Self { sequence, found: Vec::new(), interrupted: false }
    }

    /// Takes the messages of a datagram, except answers to other requests.
    pub(crate) fn take(
        &mut self,
        datagram: &[u8],
        decode: &impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> Result<State, DecodeError> {
        let mut rest = datagram;
        while !rest.is_empty() {
            let message = NetlinkBuffer::new_checked(rest)?;
            rest = rest.get((message.length() as usize).next_multiple_of(4)..).unwrap_or_default();
            if message.sequence_number() != self.sequence {
                continue;
            }
            self.interrupted |= message.flags() & NLM_F_DUMP_INTR != 0;
            match message.message_type() {
                NLMSG_NOOP => {}
                // Both begin with a negative error code; that of an acknowledgement is 0.
                NLMSG_DONE | NLMSG_ERROR => {
                    let code = message.payload().get(..4).map_or(Ok(0), parse_i32)?;
                    return Ok(match code {
                        0 => State::Complete,
                        code => State::Rejected(io::Error::from_raw_os_error(code.wrapping_neg())),
                    });
                }
                _ => self.found.extend(decode(message.payload())?),
            }
        }
        Ok(State::Incomplete)
    }
}

/// Encodes an attribute, padded to four bytes.
pub(crate) fn attribute(kind: u16, value: &[u8]) -> Vec<u8> {
    let attribute = DefaultNla::new(kind, value.to_vec());
    let mut bytes = vec![0; attribute.buffer_len()];
    attribute.emit(&mut bytes);
    bytes
}

/// Reads attributes, each as kind and value.
pub(crate) fn attributes(bytes: &[u8]) -> impl Iterator<Item = Result<(u16, &[u8]), DecodeError>> {
    NlasIterator::new(bytes).map(|attribute| {
        let attribute = attribute?;
        let (kind, length) = (attribute.kind(), usize::from(attribute.length()));
        Ok((kind, &attribute.into_inner()[NLA_HEADER_SIZE..length]))
    })
}

/// Reads text up to its terminating zero.
pub(crate) fn text(value: &[u8]) -> String {
    let end = value.iter().position(|byte| *byte == 0).unwrap_or(value.len());
    String::from_utf8_lossy(&value[..end]).into_owned()
}

#[cfg(test)]
mod tests {
    use netlink_packet_core::NLM_F_MULTIPART;
    use proptest::prelude::*;

    use super::*;

    fn bytes(body: &[u8]) -> Result<Option<Vec<u8>>, DecodeError> {
        Ok(Some(body.to_vec()))
    }

    fn dumped(sequence: u32, flags: u16) -> Vec<u8> {
        message(16, NLM_F_MULTIPART | flags, sequence, b"answer")
    }

    fn done(code: i32) -> Vec<u8> {
        message(NLMSG_DONE, NLM_F_MULTIPART, 7, &code.to_ne_bytes())
    }

    #[test]
    fn answers_to_other_requests_are_skipped() {
        let mut answers = Answers::new(7);
        let datagram = [dumped(6, 0), dumped(7, 0), dumped(8, 0)].concat();
        assert!(matches!(answers.take(&datagram, &bytes), Ok(State::Incomplete)));
        assert!(matches!(answers.take(&done(0), &bytes), Ok(State::Complete)));
        assert_eq!(answers.found, [b"answer"]);
        assert!(!answers.interrupted);
    }

    #[test]
    fn interrupted_dumps_are_noticed() {
        let mut answers = Answers::new(7);
        assert!(matches!(answers.take(&dumped(7, NLM_F_DUMP_INTR), &bytes), Ok(State::Incomplete)));
        assert!(answers.interrupted);
    }

    #[test]
    fn error_codes_end_a_dump_or_a_request() {
        const EOPNOTSUPP: i32 = 95;
        let error = message(NLMSG_ERROR, 0, 7, &(-EOPNOTSUPP).to_ne_bytes());
        for datagram in [done(-EOPNOTSUPP), error] {
            match Answers::new(7).take(&datagram, &bytes) {
                Ok(State::Rejected(error)) => assert_eq!(error.raw_os_error(), Some(EOPNOTSUPP)),
                _ => panic!("the error was overlooked"),
            }
        }
        let acknowledged = message(NLMSG_ERROR, 0, 7, &0_i32.to_ne_bytes());
        assert!(matches!(Answers::new(7).take(&acknowledged, &bytes), Ok(State::Complete)));
    }

    #[test]
    fn truncated_datagrams_are_errors() {
        let datagram = dumped(7, 0);
        assert!(Answers::new(7).take(&datagram[..datagram.len() - 4], &bytes).is_err());
        assert!(Answers::new(7).take(&datagram[..8], &bytes).is_err());
    }

    proptest! {
        #[test]
        fn written_attributes_are_read_back(
            list in prop::collection::vec((0..0x3fff_u16, prop::collection::vec(any::<u8>(), 0..40)), 0..8)
        ) {
            let written: Vec<u8> = list.iter().flat_map(|(kind, value)| attribute(*kind, value)).collect();
            let read: Result<Vec<_>, _> =
                attributes(&written).map(|read| read.map(|(kind, value)| (kind, value.to_vec()))).collect();
            prop_assert_eq!(read.unwrap(), list);
        }
    }
}
