//! The two packets of unauthenticated mode (RFC 8762, sections 4.2.1 and 4.3.1). Both have at least 44 octets; extensions
//! follow behind.

use crate::utc::ErrorEstimate;

/// The reflector's UDP port (RFC 8762, section 4.1).
pub const PORT: u16 = 862;

/// Octets of a packet without extensions.
pub const BASE_LENGTH: usize = 44;

/// Least octets of a test packet of TWAMP Light.
const SHORTEST_TEST: usize = 14;

/// Least octets of its reply.
const SHORTEST_REPLY: usize = 41;

/// An error in a received packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// Fewer octets than the shortest packet.
    #[error("{found} octets are too few: a packet has at least {least}")]
    Short {
        /// Received octets.
        found: usize,
        /// Required octets.
        least: usize,
    },
    /// An error estimate with a multiplier of zero (RFC 4656, section 4.1.2).
    #[error("its error estimate has a multiplier of zero, which marks it as corrupt")]
    Corrupt,
}

/// A test packet of a sender.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Test {
    pub(crate) sequence: u32,
    pub(crate) sent_at: [u8; 8],
    pub(crate) error: ErrorEstimate,
    /// Session identifier; zero for a sender without (RFC 8972, section 3).
    pub(crate) session: u16,
}

impl Test {
    /// Encodes the packet, at least [`BASE_LENGTH`] long.
    pub(crate) fn encode(&self, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; length.max(BASE_LENGTH)];
        bytes[0..4].copy_from_slice(&self.sequence.to_be_bytes());
        bytes[4..12].copy_from_slice(&self.sent_at);
        bytes[12..14].copy_from_slice(&self.error.to_wire());
        bytes[14..16].copy_from_slice(&self.session.to_be_bytes());
        bytes
    }

    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, Malformed> {
        at_least(SHORTEST_TEST, bytes)?;
        Ok(Self {
            sequence: u32::from_be_bytes(take(bytes, 0)),
            sent_at: take(bytes, 4),
            error: ErrorEstimate::from_wire(take(bytes, 12)).ok_or(Malformed::Corrupt)?,
            session: if bytes.len() < BASE_LENGTH { 0 } else { u16::from_be_bytes(take(bytes, 14)) },
        })
    }
}

/// A reflector's reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reply {
    /// The reflector's own count if it keeps one, or the sender's number.
    pub(crate) sequence: u32,
    pub(crate) sent_at: [u8; 8],
    pub(crate) error: ErrorEstimate,
    pub(crate) received_at: [u8; 8],
    pub(crate) test: Test,
    /// TTL of the received test packet; 255 if unknown.
    pub(crate) test_ttl: u8,
}

impl Reply {
    pub(crate) fn encode(&self, length: usize) -> Vec<u8> {
        let own = Test { sequence: self.sequence, sent_at: self.sent_at, error: self.error, ..self.test };
        let mut bytes = own.encode(length);
        bytes[16..24].copy_from_slice(&self.received_at);
        bytes[24..28].copy_from_slice(&self.test.sequence.to_be_bytes());
        bytes[28..36].copy_from_slice(&self.test.sent_at);
        bytes[36..38].copy_from_slice(&self.test.error.to_wire());
        bytes[40] = self.test_ttl;
        bytes
    }

    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, Malformed> {
        at_least(SHORTEST_REPLY, bytes)?;
        let own = Test::decode(bytes)?;
        Ok(Self {
            sequence: own.sequence,
            sent_at: own.sent_at,
            error: own.error,
            received_at: take(bytes, 16),
            test: Test {
                sequence: u32::from_be_bytes(take(bytes, 24)),
                sent_at: take(bytes, 28),
                error: ErrorEstimate::from_wire(take(bytes, 36)).ok_or(Malformed::Corrupt)?,
                session: own.session,
            },
            test_ttl: bytes[40],
        })
    }
}

fn at_least(least: usize, bytes: &[u8]) -> Result<(), Malformed> {
    if bytes.len() < least { Err(Malformed::Short { found: bytes.len(), least }) } else { Ok(()) }
}

fn take<const N: usize>(bytes: &[u8], from: usize) -> [u8; N] {
    bytes[from..from + N].try_into().expect("a slice has the length that it was cut to")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn test() -> Test {
        Test { sequence: 0x0102_0304, sent_at: [5; 8], error: ErrorEstimate::default(), session: 0x0607 }
    }

    #[test]
    fn fields_are_at_the_rfcs_offsets() {
        let error = ErrorEstimate::default().to_wire();
        let bytes = test().encode(0);
        assert_eq!(bytes.len(), BASE_LENGTH);
        assert_eq!(bytes[..16], [&[1, 2, 3, 4][..], &[5; 8], &error, &[6, 7]].concat());
        assert_eq!(bytes[16..], [0; 28]);
        let reply = Reply {
            sequence: 9,
            sent_at: [8; 8],
            error: ErrorEstimate::default(),
            received_at: [7; 8],
            test: test(),
            test_ttl: 64,
        };
        let expected = [
            &[0, 0, 0, 9][..],
            &[8; 8],
            &error,
            &[6, 7],
            &[7; 8],
            &[1, 2, 3, 4],
            &[5; 8],
            &error,
            &[0, 0, 64, 0, 0, 0],
        ];
        assert_eq!(reply.encode(0), expected.concat());
        assert_eq!(Reply::decode(&reply.encode(100)), Ok(reply));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_are_decoded_or_rejected(bytes in prop::collection::vec(any::<u8>(), 0..100)) {
            if let Ok(test) = Test::decode(&bytes) {
                prop_assert_eq!(Test::decode(&test.encode(bytes.len())), Ok(test));
            }
            if let Ok(reply) = Reply::decode(&bytes) {
                let again = Reply::decode(&reply.encode(bytes.len()));
                // A short reply has no room for a session.
                prop_assert_eq!(again.map(|again| (again.sequence, again.test.sequence, again.test_ttl)),
                    Ok((reply.sequence, reply.test.sequence, reply.test_ttl)));
            } else {
                prop_assert!(bytes.len() < SHORTEST_REPLY || bytes[13] == 0 || bytes[37] == 0);
            }
        }
    }
}
