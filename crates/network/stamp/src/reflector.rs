//! The Session-Reflector (RFC 8762, section 4.3). It is stateful: it counts the replies of each session, so that senders
//! can assign losses to a direction.

use std::{collections::HashMap, hash::Hash, time::Duration};

use crate::{
    extension,
    packet::{BASE_LENGTH, Malformed, Reply, Test},
    utc::{ErrorEstimate, Utc},
};

/// Time after which a silent session is forgotten: REFWAIT of RFC 5357, section 4.2.
const FORGET_AFTER: Duration = Duration::from_secs(900);

/// Most sessions. Beyond that, the one that was silent for longest is forgotten.
const MOST_SESSIONS: usize = 1024;

/// Value for an unknown TTL.
const UNKNOWN_TTL: u8 = 255;

/// Answers test packets. `P` identifies senders, for example by socket address.
#[derive(Debug)]
pub struct Reflector<P> {
    error: ErrorEstimate,
    sessions: HashMap<(P, u16), Counted>,
}

#[derive(Debug, Clone, Copy)]
struct Counted {
    next: u32,
    heard_at: Utc,
}

/// An answer without its time of sending.
#[derive(Debug, Clone)]
#[must_use]
pub struct Reflection {
    reply: Reply,
    bytes: Vec<u8>,
}

impl Reflection {
    /// Returns the packet to send back, with `now` as its time of sending.
    pub fn sent_at(mut self, now: Utc) -> Vec<u8> {
        self.reply.sent_at = now.to_wire(self.reply.error.format);
        let base = self.reply.encode(BASE_LENGTH);
        self.bytes[..BASE_LENGTH].copy_from_slice(&base);
        self.bytes
    }
}

impl<P: Eq + Hash + Clone> Reflector<P> {
    /// Creates a reflector with the error estimate of its clock.
    pub fn new(error: ErrorEstimate) -> Self {
        Self { error, sessions: HashMap::new() }
    }

    /// Answers a packet. `ttl` is the received TTL, if known. The answer is as long as the packet, at least 44 octets.
    ///
    /// # Errors
    /// [`Malformed`] for bytes that are no test packet. They get no answer.
    pub fn reflect(
        &mut self,
        from: P,
        bytes: &[u8],
        received_at: Utc,
        ttl: Option<u8>,
    ) -> Result<Reflection, Malformed> {
        let test = Test::decode(bytes)?;
        let sequence = self.count(from, &test, received_at);
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().max(BASE_LENGTH), 0);
        extension::reflect(&mut bytes[BASE_LENGTH..]);
        let reply = Reply {
            sequence,
            sent_at: [0; 8],
            error: self.error,
            received_at: received_at.to_wire(self.error.format),
            test,
            test_ttl: ttl.unwrap_or(UNKNOWN_TTL),
        };
        Ok(Reflection { reply, bytes })
    }

    /// Returns the number of an answer in its session. A sender that restarts begins a new session.
    fn count(&mut self, from: P, test: &Test, now: Utc) -> u32 {
        let key = (from, test.session);
        if !self.sessions.contains_key(&key) && self.sessions.len() >= MOST_SESSIONS {
            self.sessions.retain(|_, session| now.since(session.heard_at) < FORGET_AFTER);
            let oldest = || self.sessions.iter().min_by_key(|(_, session)| session.heard_at);
            if self.sessions.len() >= MOST_SESSIONS
                && let Some((oldest, _)) = oldest()
            {
                let oldest = oldest.clone();
                self.sessions.remove(&oldest);
            }
        }
        let session = self.sessions.entry(key).or_insert(Counted { next: test.sequence, heard_at: now });
        if test.sequence == 0 || now.since(session.heard_at) >= FORGET_AFTER {
            session.next = test.sequence;
        }
        session.heard_at = now;
        let number = session.next;
        session.next = number.wrapping_add(1);
        number
    }
}

/// A reflector with an unsynchronised clock.
impl<P: Eq + Hash + Clone> Default for Reflector<P> {
    fn default() -> Self {
        Self::new(ErrorEstimate::default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Utc = Utc::UNIX_EPOCH;

    fn probe(sequence: u32, session: u16) -> Vec<u8> {
        Test { sequence, sent_at: [1; 8], error: ErrorEstimate::default(), session }.encode(0)
    }

    #[test]
    fn replies_are_counted_by_sender_and_session() {
        let mut reflector = Reflector::default();
        let mut number = |from, sequence, session| {
            let reflection = reflector.reflect(from, &probe(sequence, session), NOW, Some(64)).unwrap();
            let reply = Reply::decode(&reflection.sent_at(NOW)).unwrap();
            assert_eq!((reply.test.sequence, reply.test_ttl), (sequence, 64));
            reply.sequence
        };
        // The third packet of the first sender was lost.
        assert_eq!([0, 1, 3].map(|sequence| number("a", sequence, 1)), [0, 1, 2]);
        assert_eq!([0, 1].map(|sequence| number("a", sequence, 2)), [0, 1]);
        assert_eq!([7, 8].map(|sequence| number("b", sequence, 1)), [7, 8]);
        // The sender restarted.
        assert_eq!(number("a", 0, 1), 0);
    }

    #[test]
    fn short_packets_of_twamp_light_are_answered_and_malformed_ones_not() {
        let mut reflector = Reflector::default();
        let answer = reflector.reflect(1, &probe(3, 0)[..14], NOW, None).unwrap().sent_at(NOW);
        let reply = Reply::decode(&answer).unwrap();
        assert_eq!((answer.len(), reply.test.sequence, reply.test_ttl), (BASE_LENGTH, 3, UNKNOWN_TTL));
        assert_eq!(
            reflector.reflect(1, &[0; 13], NOW, None).unwrap_err(),
            Malformed::Short { found: 13, least: 14 }
        );
        assert_eq!(reflector.reflect(1, &[0; 44], NOW, None).unwrap_err(), Malformed::Corrupt);
    }

    #[test]
    fn memory_is_bounded_for_any_number_of_senders() {
        let mut reflector = Reflector::default();
        for sender in 0..3 * MOST_SESSIONS {
            let _ = reflector.reflect(sender, &probe(5, 0), NOW + Duration::from_secs(sender as u64), None);
            assert!(reflector.sessions.len() <= MOST_SESSIONS);
        }
    }
}
