//! Who is asked by one packet of a robot, and who answered. A packet can go to several instances of a VNF: to each with a
//! nonce of its own, so that nobody can answer for another.

use std::net::SocketAddrV4;

use crate::{answer_error::AnswerError, nonce::Nonces};

/// A packet, and where its copies go: each has its nonce in place of the packet's, which is the first's.
#[derive(Debug, Clone, PartialEq)]
pub struct Addressed<P> {
    /// The packet.
    pub packet: P,
    /// Where to, and with which nonce; none where nobody can answer.
    pub copies: Vec<(SocketAddrV4, u64)>,
}

/// Those that were asked.
#[derive(Debug, Clone)]
pub(crate) struct Asked(Vec<One>);

#[derive(Debug, Clone, Copy)]
struct One {
    address: Option<SocketAddrV4>,
    nonce: u64,
    has_answered: bool,
}

impl Asked {
    /// Those at these addresses; `None` for one who cannot be reached.
    pub fn of(addresses: impl Iterator<Item = Option<SocketAddrV4>>, nonces: &mut Nonces) -> Self {
        let one = |address| One { address, nonce: nonces.draw(), has_answered: false };
        Self(addresses.map(one).collect())
    }

    /// The first nonce.
    pub fn nonce(&self) -> u64 {
        self.0.first().map_or(0, |one| one.nonce)
    }

    /// Where copies go, and their nonces.
    pub fn copies(&self) -> Vec<(SocketAddrV4, u64)> {
        self.0.iter().filter_map(|one| Some((one.address?, one.nonce))).collect()
    }

    /// The place of the one whose answer has this nonce and comes from this address.
    pub fn answered_by(&self, from: SocketAddrV4, nonce: u64) -> Option<usize> {
        self.0.iter().position(|one| (one.address, one.nonce) == (Some(from), nonce))
    }

    /// Whether a copy had this nonce.
    pub fn has_nonce(&self, nonce: u64) -> bool {
        self.0.iter().any(|one| one.nonce == nonce)
    }

    /// The answer of the one at this place is taken.
    pub fn hear(&mut self, place: usize) {
        self.0[place].has_answered = true;
    }

    /// What an answer is that comes once one was taken.
    pub fn hear_again(&mut self, from: SocketAddrV4, nonce: u64) -> AnswerError {
        match self.answered_by(from, nonce).map(|place| &mut self.0[place]) {
            // From elsewhere, or it is known already.
            None | Some(One { has_answered: true, .. }) => AnswerError::Repeated,
            Some(one) => {
                one.has_answered = true;
                AnswerError::Redundant
            }
        }
    }
}
