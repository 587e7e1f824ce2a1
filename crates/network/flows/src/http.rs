//! Requests and responses of HTTP on one connection: HTTP/1, or HTTP/2 if the client begins so.

use std::time::Duration;

mod http1;
mod http2;

/// Most requests of a connection that wait for their responses.
const MOST: usize = 128;

/// What a client of HTTP/2 sends first (RFC 9113, 3.4).
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// The bytes are not HTTP, or exceed a bound.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct NotHttp;

/// The protocol of the connection's next bytes.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Next {
    /// HTTP.
    Http,
    /// Another protocol that both ends agreed on.
    Other,
}

/// Time and mark of bytes that passed.
type Passed = (Duration, u64);

/// The state of both directions of a connection. Measured requests are numbered in the order in which they begin.
#[derive(Debug)]
pub(crate) struct Exchange {
    path: Option<String>,
    version: Version,
}

#[derive(Debug)]
enum Version {
    /// The client sent so many bytes of HTTP/2's preface, the first one at that time.
    Unknown(usize, Option<Passed>),
    One(http1::Exchange),
    Two(Box<http2::Exchange>),
}

impl Exchange {
    /// Creates the exchange of a new connection, which measures requests of one path, or all.
    pub fn new(path: Option<String>) -> Self {
        Self { path, version: Version::Unknown(0, None) }
    }

    /// Takes the client's next bytes. Passes each measured request to `begin`, with the time of its first byte.
    pub fn client(
        &mut self,
        now: Passed,
        mut bytes: &[u8],
        mut begin: impl FnMut(u64, Passed),
    ) -> Result<(), NotHttp> {
        if let Version::Unknown(matched, began) = &mut self.version {
            let began = *began.get_or_insert(now);
            let expected = &PREFACE[*matched..];
            let same = expected.iter().zip(bytes).take_while(|(expected, byte)| expected == byte).count();
            if same == expected.len() {
                bytes = &bytes[same..];
                self.version = self.two(PREFACE.len());
            } else if same == bytes.len() {
                *matched += same;
                return Ok(());
            } else {
                let mut one = http1::Exchange::new(self.path.clone());
                one.client(began, &PREFACE[..*matched], &mut begin)?;
                self.version = Version::One(one);
            }
        }
        match &mut self.version {
            Version::One(one) => one.client(now, bytes, begin),
            Version::Two(two) => two.client(now, bytes, begin),
            Version::Unknown(..) => Ok(()),
        }
    }

    /// Takes the server's next bytes. Passes each measured request whose response ends in them to `answer`.
    pub fn server(&mut self, bytes: &[u8], answer: impl FnMut(u64)) -> Result<Next, NotHttp> {
        // Only a server of HTTP/2 may speak first.
        if let Version::Unknown(matched, _) = self.version {
            self.version = self.two(matched);
        }
        match &mut self.version {
            Version::One(one) => one.server(bytes, answer),
            Version::Two(two) => two.server(bytes, answer).map(|()| Next::Http),
            Version::Unknown(..) => Ok(Next::Http),
        }
    }

    /// The state of HTTP/2, after so many bytes of the preface.
    fn two(&self, matched: usize) -> Version {
        Version::Two(Box::new(http2::Exchange::new(&PREFACE[matched..], self.path.clone())))
    }

    /// Ends the server's direction. Returns the measured request whose response ends with it.
    pub fn close(&mut self) -> Option<u64> {
        match &mut self.version {
            Version::One(one) => one.close(),
            Version::Two(_) | Version::Unknown(..) => None,
        }
    }
}
