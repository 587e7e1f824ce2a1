//! Netlink messages: a header and a body (linux/netlink.h).

use crate::attributes::DecodeError;

/// `NLM_F_REQUEST`: marks a message to the kernel.
pub const REQUEST: u16 = 1;
/// `NLM_F_ACK`: asks for an acknowledgement.
pub const ACK: u16 = 4;
/// `NLM_F_DUMP`: asks for a list.
pub const DUMP: u16 = 0x300;
/// `NLM_F_REPLACE`: replaces what is there.
pub const REPLACE: u16 = 0x100;
/// `NLM_F_EXCL`: is rejected if it is there.
pub const EXCLUSIVE: u16 = 0x200;
/// `NLM_F_CREATE`: makes what is not there.
pub const CREATE: u16 = 0x400;

/// `NLMSG_ERROR`: the kind of an error, which is also an acknowledgement. Its body begins with a negative error code, or 0.
pub const ERROR: u16 = 2;

/// Length of a message's header.
const HEADER: usize = 16;

/// A message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message<'a> {
    /// Its type: below 16 the same in all protocols, otherwise by protocol. In generic netlink, the family's number.
    pub kind: u16,
    /// `NLM_F_*`.
    pub flags: u16,
    /// The number of the request that it is, or answers. Unsolicited messages have 0.
    pub sequence: u32,
    /// Bytes behind the header.
    pub body: &'a [u8],
}

/// Encodes a message. The kernel takes port 0 as that of the sender.
///
/// # Panics
/// If the body has more than 4 GiB.
pub fn message(kind: u16, flags: u16, sequence: u32, body: &[u8]) -> Vec<u8> {
    let length = u32::try_from(HEADER + body.len()).expect("no message is that long");
    let mut bytes = Vec::with_capacity(HEADER + body.len().next_multiple_of(4));
    bytes.extend(length.to_ne_bytes());
    bytes.extend(kind.to_ne_bytes());
    bytes.extend(flags.to_ne_bytes());
    bytes.extend(sequence.to_ne_bytes());
    bytes.extend([0; 4]);
    bytes.extend(body);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// Reads the messages of a datagram, up to the first that is malformed.
pub fn messages(datagram: &[u8]) -> impl Iterator<Item = Result<Message<'_>, DecodeError>> {
    let mut rest = datagram;
    std::iter::from_fn(move || {
        let message = (!rest.is_empty()).then(|| split(rest))?;
        rest = message.map_or(&[], |(_, behind)| behind);
        Some(message.map(|(message, _)| message))
    })
}

fn split(bytes: &[u8]) -> Result<(Message<'_>, &[u8]), DecodeError> {
    let header: &[u8; HEADER] = bytes.first_chunk().ok_or(DecodeError("a message has no header"))?;
    let half = |at: usize| u16::from_ne_bytes([header[at], header[at + 1]]);
    let word = |at: usize| u32::from_ne_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let length = word(0) as usize;
    let body = bytes.get(HEADER..length).ok_or(DecodeError("a message is truncated"))?;
    let behind = bytes.get(length.next_multiple_of(4)..).unwrap_or_default();
    Ok((Message { kind: half(4), flags: half(6), sequence: word(8), body }, behind))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn written_messages_are_read_back(
            list in prop::collection::vec(
                (any::<u16>(), any::<u16>(), any::<u32>(), prop::collection::vec(any::<u8>(), 0..40)),
                0..5,
            )
        ) {
            let datagram: Vec<u8> =
                list.iter().flat_map(|(kind, flags, number, body)| message(*kind, *flags, *number, body)).collect();
            let read: Vec<_> = messages(&datagram)
                .map(|message| message.map(|m| (m.kind, m.flags, m.sequence, m.body.to_vec())))
                .collect::<Result<_, _>>()
                .unwrap();
            prop_assert_eq!(read, list);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            _ = messages(&bytes).count();
        }
    }

    #[test]
    fn truncated_messages_are_errors() {
        let datagram = message(16, 0, 1, b"body");
        assert!(messages(&datagram[..datagram.len() - 4]).next().unwrap().is_err());
        assert!(messages(&datagram[..8]).next().unwrap().is_err());
        // A length below that of the header cannot make the reader stand still.
        assert_eq!(messages(&[0; 40]).count(), 1);
    }
}
