//! Answers of the kernel to one request.

use std::io;

use crate::{
    attributes::{DecodeError, parse_i32},
    message::{ERROR, messages},
};

/// `NLMSG_NOOP`.
const NOOP: u16 = 1;
/// `NLMSG_DONE`: the end of a list.
const DONE: u16 = 3;
/// `NLM_F_DUMP_INTR`.
const INTERRUPTED: u16 = 0x10;

/// Answers to one request, collected from datagrams.
#[derive(Debug)]
pub struct Answers<T> {
    sequence: u32,
    /// Values decoded so far.
    pub found: Vec<T>,
    /// Whether a change interrupted the dump, so that something may be missing.
    pub interrupted: bool,
}

/// State of the answers to a request.
#[derive(Debug)]
pub enum State {
    /// More are to come.
    Incomplete,
    /// The kernel is done, and returned this number. Most requests have none, i.e. 0.
    Complete(u32),
    /// The kernel's error.
    Rejected(io::Error),
}

impl<T> Answers<T> {
    /// Begins to collect the answers to the request with this number.
    pub const fn new(sequence: u32) -> Self {
        Self { sequence, found: Vec::new(), interrupted: false }
    }

    /// Takes the messages of a datagram, except answers to other requests.
    ///
    /// # Errors
    /// [`DecodeError`] for a malformed message, or that of `decode`.
    pub fn take(
        &mut self,
        datagram: &[u8],
        decode: &impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> Result<State, DecodeError> {
        for message in messages(datagram) {
            let message = message?;
            if message.sequence != self.sequence {
                continue;
            }
            self.interrupted |= message.flags & INTERRUPTED != 0;
            match message.kind {
                NOOP => {}
                // Both begin with a negative error code, or with a result.
                DONE | ERROR => {
                    let code = message.body.get(..4).map_or(Ok(0), parse_i32)?;
                    return Ok(match u32::try_from(code) {
                        Ok(result) => State::Complete(result),
                        Err(_) => State::Rejected(io::Error::from_raw_os_error(code.wrapping_neg())),
                    });
                }
                _ => self.found.extend(decode(message.body)?),
            }
        }
        Ok(State::Incomplete)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::message;

    /// `NLM_F_MULTI`.
    const MULTIPART: u16 = 2;

    fn bytes(body: &[u8]) -> Result<Option<Vec<u8>>, DecodeError> {
        Ok(Some(body.to_vec()))
    }

    fn dumped(sequence: u32, flags: u16) -> Vec<u8> {
        message(16, MULTIPART | flags, sequence, b"answer")
    }

    fn done(code: i32) -> Vec<u8> {
        message(DONE, MULTIPART, 7, &code.to_ne_bytes())
    }

    fn acknowledged(code: i32) -> Vec<u8> {
        message(ERROR, 0, 7, &code.to_ne_bytes())
    }

    #[test]
    fn answers_to_other_requests_are_skipped() {
        let mut answers = Answers::new(7);
        let datagram = [dumped(6, 0), dumped(7, 0), dumped(8, 0)].concat();
        assert!(matches!(answers.take(&datagram, &bytes), Ok(State::Incomplete)));
        assert!(matches!(answers.take(&done(0), &bytes), Ok(State::Complete(0))));
        assert_eq!(answers.found, [b"answer"]);
        assert!(!answers.interrupted);
    }

    #[test]
    fn interrupted_dumps_are_noticed() {
        let mut answers = Answers::new(7);
        assert!(matches!(answers.take(&dumped(7, INTERRUPTED), &bytes), Ok(State::Incomplete)));
        assert!(answers.interrupted);
    }

    #[test]
    fn error_codes_end_a_dump_or_a_request() {
        const EOPNOTSUPP: i32 = 95;
        for datagram in [done(-EOPNOTSUPP), acknowledged(-EOPNOTSUPP)] {
            match Answers::new(7).take(&datagram, &bytes) {
                Ok(State::Rejected(error)) => assert_eq!(error.raw_os_error(), Some(EOPNOTSUPP)),
                _ => panic!("the error was overlooked"),
            }
        }
        match Answers::new(7).take(&acknowledged(-1), &bytes) {
            Ok(State::Rejected(error)) => assert_eq!(error.kind(), io::ErrorKind::PermissionDenied),
            _ => panic!("the error was overlooked"),
        }
        assert!(matches!(Answers::new(7).take(&acknowledged(0), &bytes), Ok(State::Complete(0))));
        assert!(matches!(Answers::new(7).take(&acknowledged(4), &bytes), Ok(State::Complete(4))), "a result");
        let worst = Answers::new(7).take(&acknowledged(i32::MIN), &bytes);
        assert!(matches!(worst, Ok(State::Rejected(_))));
    }
}
