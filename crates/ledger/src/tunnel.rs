//! A tunnel between two cores for one robot and one virtual access point: datagrams sealed with their fast-transition key,
//! which only the two domains have ([`crate::Attachment`]). It is a state machine without a clock or a socket.
//!
//! Each end contributes a share to the keys of a session, one key for each direction (ChaCha20-Poly1305, RFC 8439). The home
//! end says hello with its share until the visited end answers with another. A recorded hello opens nothing, because the
//! visited end never repeats its share, and rejects hellos that are older than its session. Within a session, each datagram
//! opens once. There is no forward secrecy: who learns the key reads recorded datagrams.

use std::{fmt, time::Duration};

use chacha20poly1305::{
    ChaCha20Poly1305, KeyInit,
    aead::{Aead, Payload},
};
use sha3::{Digest, Keccak256};

/// An end's part of the keys of a session. An end uses each share once; a later one is greater, in the order of its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Share([u8; 16]);

impl Share {
    /// Makes a share from the time of the calendar clock and random bytes.
    pub fn new(since_epoch: Duration, random: [u8; 8]) -> Self {
        let mut share = [0; 16];
        share[..8].copy_from_slice(&(since_epoch.as_nanos() as u64).to_be_bytes());
        share[8..].copy_from_slice(&random);
        Self(share)
    }
}

/// ID of a tunnel, which reveals nothing about its key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TunnelId([u8; 8]);

/// An end of a tunnel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The robot's core.
    Home,
    /// The core of the access point.
    Visited,
}

/// Kind of a datagram.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Received {
    /// A message of the other end.
    Message(Vec<u8>),
    /// A hello: send this answer.
    Hello(Vec<u8>),
    /// The answer to this end's hello: [`Tunnel::seal`] works from now on.
    Opened,
    /// Not of the other end, or received before.
    Rejected,
}

/// One end of a tunnel.
pub struct Tunnel {
    end: End,
    key: [u8; 32],
    id: TunnelId,
    /// This end's share, at home.
    share: Share,
    session: Option<Session>,
    /// At the visited end: the session of the last hello, until its first message.
    candidate: Option<Session>,
}

struct Session {
    /// The shares of the home and of the visited end.
    shares: [Share; 2],
    sealing: ChaCha20Poly1305,
    opening: ChaCha20Poly1305,
    sent: u64,
    window: Window,
}

/// The numbers that were received: the highest, and which of the 64 up to it.
#[derive(Debug, Default)]
struct Window {
    /// The number after the highest.
    next: u64,
    seen: u64,
}

const ID: usize = 8;
const HELLO: u8 = 0;
const MESSAGE: u8 = 1;
/// Bytes before a message: the tunnel's ID, the kind, and the number.
const HEAD: usize = ID + 1 + 8;
const SHARES: usize = ID + 1 + 32;
const TAG: usize = 16;

impl Tunnel {
    /// Bytes of a datagram around its message.
    pub const OVERHEAD: usize = HEAD + TAG;

    /// Makes an end.
    pub fn new(end: End, key: [u8; 32], share: Share) -> Self {
        let id = TunnelId(derive(&key, "id", &[])[..ID].try_into().expect("a hash is longer"));
        Self { end, key, id, share, session: None, candidate: None }
    }

    pub fn id(&self) -> TunnelId {
        self.id
    }

    pub fn end(&self) -> End {
        self.end
    }

    /// Returns the tunnel that a datagram claims to be of.
    pub fn id_of(datagram: &[u8]) -> Option<TunnelId> {
        datagram.first_chunk().copied().map(TunnelId)
    }

    /// Ends the session. The home end greets anew, as when the other end has lost its keys.
    pub fn restart(&mut self, share: Share) {
        (self.share, self.session, self.candidate) = (share, None, None);
    }

    /// Returns the hello that the home end sends until the tunnel is open.
    pub fn hello(&self) -> Vec<u8> {
        self.greeting(self.share, Share([0; 16]))
    }

    /// Seals a message; `None` until the tunnel is open.
    pub fn seal(&mut self, message: &[u8]) -> Option<Vec<u8>> {
        let session = self.session.as_mut()?;
        let number = session.sent;
        session.sent = number.checked_add(1)?;
        let mut datagram = [&self.id.0[..], &[MESSAGE], &number.to_be_bytes()].concat();
        let sealed = session
            .sealing
            .encrypt(&nonce(number).into(), Payload { msg: message, aad: &datagram })
            .expect("a message in memory is not too long");
        datagram.extend(sealed);
        Some(datagram)
    }

    /// Opens a datagram. `fresh` makes a share for a new session.
    pub fn receive(&mut self, datagram: &[u8], fresh: impl FnOnce() -> Share) -> Received {
        match datagram.get(ID) {
            _ if Self::id_of(datagram) != Some(self.id) => Received::Rejected,
            Some(&HELLO) => self.greeted(datagram, fresh),
            Some(&MESSAGE) => self.open(datagram).map_or(Received::Rejected, Received::Message),
            _ => Received::Rejected,
        }
    }

    fn greeted(&mut self, datagram: &[u8], fresh: impl FnOnce() -> Share) -> Received {
        let shares = datagram.get(ID + 1..SHARES).filter(|_| datagram.len() == SHARES + TAG);
        let Some((Some(theirs), Some(ours))) = shares.map(|s| (s.first_chunk(), s.last_chunk())) else {
            return Received::Rejected;
        };
        let (theirs, ours) = (Share(*theirs), Share(*ours));
        let other = if self.end == End::Home { End::Visited } else { End::Home };
        let tag = Payload { msg: &datagram[SHARES..], aad: &datagram[..SHARES] };
        if self.greeter(other).decrypt(&greeting_nonce(&theirs, &ours).into(), tag).is_err() {
            return Received::Rejected;
        }
        match self.end {
            End::Home if ours == self.share && self.session.is_none() => {
                self.session = Some(self.session([ours, theirs]));
                Received::Opened
            }
            End::Home => Received::Rejected,
            End::Visited => {
                // The candidate is the newer one.
                let newest = self.candidate.as_ref().or(self.session.as_ref()).map(|session| session.shares);
                let ours = match newest {
                    Some([known, _]) if theirs < known => return Received::Rejected,
                    Some([known, ours]) if theirs == known => ours,
                    _ => {
                        let ours = fresh();
                        self.candidate = Some(self.session([theirs, ours]));
                        ours
                    }
                };
                Received::Hello(self.greeting(ours, theirs))
            }
        }
    }

    fn open(&mut self, datagram: &[u8]) -> Option<Vec<u8>> {
        if let Some(message) = self.session.as_mut().and_then(|session| session.open(datagram)) {
            return Some(message);
        }
        let message = self.candidate.as_mut()?.open(datagram)?;
        self.session = self.candidate.take();
        Some(message)
    }

    fn greeting(&self, ours: Share, theirs: Share) -> Vec<u8> {
        let mut datagram = [&self.id.0[..], &[HELLO], &ours.0, &theirs.0].concat();
        let tag = self
            .greeter(self.end)
            .encrypt(&greeting_nonce(&ours, &theirs).into(), Payload { msg: &[], aad: &datagram })
            .expect("a greeting is not too long");
        datagram.extend(tag);
        datagram
    }

    /// Returns the cipher of an end's greetings.
    fn greeter(&self, end: End) -> ChaCha20Poly1305 {
        ChaCha20Poly1305::new(&derive(&self.key, "hello", &[&[end as u8]]).into())
    }

    fn session(&self, shares: [Share; 2]) -> Session {
        let cipher = |from: End| {
            let key = derive(&self.key, "session", &[&[from as u8], &shares[0].0, &shares[1].0]);
            ChaCha20Poly1305::new(&key.into())
        };
        let (home, visited) = (cipher(End::Home), cipher(End::Visited));
        let (sealing, opening) = match self.end {
            End::Home => (home, visited),
            End::Visited => (visited, home),
        };
        Session { shares, sealing, opening, sent: 0, window: Window::default() }
    }
}

impl fmt::Debug for Tunnel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tunnel").field("end", &self.end).field("id", &self.id).finish_non_exhaustive()
    }
}

impl Session {
    fn open(&mut self, datagram: &[u8]) -> Option<Vec<u8>> {
        let (head, sealed) = datagram.split_at_checked(HEAD)?;
        let number = u64::from_be_bytes(*head.last_chunk()?);
        if !self.window.is_new(number) {
            return None;
        }
        let payload = Payload { msg: sealed, aad: head };
        let message = self.opening.decrypt(&nonce(number).into(), payload).ok()?;
        self.window.take(number);
        Some(message)
    }
}

impl Window {
    fn is_new(&self, number: u64) -> bool {
        if number >= self.next {
            return number < u64::MAX;
        }
        let age = self.next - 1 - number;
        age < 64 && self.seen & (1 << age) == 0
    }

    fn take(&mut self, number: u64) {
        if number >= self.next {
            let steps = number + 1 - self.next;
            self.seen = if steps < 64 { self.seen << steps } else { 0 } | 1;
            self.next = number + 1;
        } else {
            self.seen |= 1 << (self.next - 1 - number);
        }
    }
}

fn nonce(number: u64) -> [u8; 12] {
    let mut nonce = [0; 12];
    nonce[4..].copy_from_slice(&number.to_be_bytes());
    nonce
}

/// Returns a nonce of both shares, so that no nonce comes twice with other shares.
fn greeting_nonce(ours: &Share, theirs: &Share) -> [u8; 12] {
    let hash = Keccak256::new().chain_update(ours.0).chain_update(theirs.0).finalize();
    hash[..12].try_into().expect("a hash is longer")
}

/// Returns Keccak-256 of the key, a label and parts of fixed lengths.
fn derive(key: &[u8; 32], label: &str, parts: &[&[u8]]) -> [u8; 32] {
    let mut hash = Keccak256::new().chain_update(key).chain_update(b"cotorra tunnel ");
    hash.update([label.len() as u8]);
    hash.update(label);
    parts.iter().for_each(|part| hash.update(part));
    hash.finalize().into()
}

#[cfg(test)]
mod tests;
