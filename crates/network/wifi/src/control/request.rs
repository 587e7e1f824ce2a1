//! Requests, and those that both programs know.

use std::fmt;

use crate::{
    control::answer::{AnswerError, done, verdict},
    names::InterfaceName,
};

/// Format of an answer.
type Reader<A> = fn(Result<&str, AnswerError>) -> Result<A, AnswerError>;

/// A request, and how its answer is read. `Debug` only shows its command, because the rest may be secret.
#[derive(Clone)]
pub struct Request<A> {
    text: String,
    read: Reader<A>,
}

impl<A> Request<A> {
    pub(crate) fn new(text: impl Into<String>, read: Reader<A>) -> Self {
        Self { text: text.into(), read }
    }

    /// Returns the datagram to send.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns the command, i.e. the first word.
    pub fn command(&self) -> &str {
        let words = self.text.split(' ');
        words.into_iter().find(|word| !word.starts_with("IFNAME=")).unwrap_or_default()
    }

    /// Sends it to one of the interfaces behind a program's global socket.
    #[must_use]
    pub fn of_interface(self, interface: &InterfaceName) -> Self {
        Self { text: format!("IFNAME={interface} {}", self.text), ..self }
    }

    /// Reads the answer's datagram.
    ///
    /// # Errors
    /// [`AnswerError`] if the program refused the request, or if the answer is not understood.
    pub fn read(&self, answer: &[u8]) -> Result<A, AnswerError> {
        (self.read)(verdict(&String::from_utf8_lossy(answer)))
    }
}

impl<A> fmt::Debug for Request<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Request").field(&self.command()).finish()
    }
}

/// Returns the request that does nothing.
pub fn ping() -> Request<()> {
    let pong = |answer: Result<&str, _>| match answer? {
        "PONG" => Ok(()),
        _ => Err(AnswerError::Unexpected("PONG")),
    };
    Request::new("PING", pong)
}

/// Returns the request for events at this socket.
pub fn attach() -> Request<()> {
    Request::new("ATTACH", done)
}

/// Returns the request for no more events at this socket.
pub fn detach() -> Request<()> {
    Request::new("DETACH", done)
}

/// Returns the request to end the program.
pub fn terminate() -> Request<()> {
    Request::new("TERMINATE", done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn debug_output_shows_only_the_command() {
        let request = Request::new("SET_NETWORK 0 psk \"correct horse\"", done)
            .of_interface(&"wlan0".parse().expect("a name"));
        assert_eq!(format!("{request:?}"), "Request(\"SET_NETWORK\")");
        assert_eq!(request.text(), "IFNAME=wlan0 SET_NETWORK 0 psk \"correct horse\"");
    }

    #[test]
    fn refusals_are_told_apart() {
        assert_eq!(ping().read(b"PONG\n"), Ok(()));
        assert_eq!(ping().read(b"OK\n"), Err(AnswerError::Unexpected("PONG")));
        assert_eq!(attach().read(b"OK\n"), Ok(()));
        assert_eq!(attach().read(b"FAIL\n"), Err(AnswerError::Failed));
        assert_eq!(attach().read(b"FAIL-BUSY\n"), Err(AnswerError::Busy));
        assert_eq!(attach().read(b"UNKNOWN COMMAND\n"), Err(AnswerError::UnknownCommand));
        assert_eq!(attach().read(b""), Err(AnswerError::Unexpected("OK")));
        assert_eq!(attach().read(b"\xff\xfe"), Err(AnswerError::Unexpected("OK")));
    }
}
