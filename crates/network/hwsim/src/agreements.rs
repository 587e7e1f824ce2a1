//! Block acknowledgement agreements (IEEE 802.11-2020, 10.25.2): whose frames may go in A-MPDUs. They show in action frames.

use std::collections::BTreeSet;

use crate::{
    address::MacAddress,
    header::{FrameType, Header},
};

/// Subtypes of management frames that end an association or begin one (table 9-1), and with it all agreements.
const ASSOCIATION: [u8; 7] = [0, 1, 2, 3, 10, 11, 12];
/// Subtype of action frames.
const ACTION: u8 = 13;
/// Category of block acknowledgements (table 9-51), and their actions (table 9-391).
const BLOCK_ACK: u8 = 3;
const ADDBA_RESPONSE: u8 = 1;
const DELBA: u8 = 2;
/// Agreements at most.
const MOST: usize = 4096;

/// Agreements between senders and receivers. Those that are made in encrypted frames stay unknown.
#[derive(Debug, Default)]
pub(crate) struct Agreements(BTreeSet<Agreement>);

/// An agreement about one traffic identifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Agreement {
    sender: MacAddress,
    receiver: MacAddress,
    tid: u8,
}

impl Agreements {
    /// Looks at a frame that is sent.
    pub(crate) fn see(&mut self, header: &Header, frame: &[u8]) {
        let (FrameType::Management, Some(from)) = (header.kind, header.transmitter) else { return };
        let to = header.receiver;
        if ASSOCIATION.contains(&header.subtype) {
            let both = |agreement: &Agreement| {
                [[from, to], [to, from]].contains(&[agreement.sender, agreement.receiver])
            };
            self.0.retain(|agreement| !both(agreement));
        }
        if header.subtype != ACTION || header.protected {
            return;
        }
        match frame.get(24..) {
            // Category, action, token, status and parameters, whose third to sixth bits are the traffic identifier.
            Some([BLOCK_ACK, ADDBA_RESPONSE, _, 0, 0, parameters, ..]) if self.0.len() < MOST => {
                let tid = parameters >> 2 & 15;
                self.0.insert(Agreement { sender: to, receiver: from, tid });
            }
            // Parameters: the twelfth bit says whether the sender of the data ends it, and the others behind are the identifier.
            Some([BLOCK_ACK, DELBA, _, parameters, ..]) => {
                let (by_sender, tid) = (parameters & 1 << 3 != 0, parameters >> 4);
                let [sender, receiver] = if by_sender { [from, to] } else { [to, from] };
                self.0.remove(&Agreement { sender, receiver, tid });
            }
            _ => {}
        }
    }

    /// Whether a frame may go in an A-MPDU.
    pub(crate) fn cover(&self, header: &Header) -> bool {
        let Header { transmitter: Some(sender), receiver, tid: Some(tid), .. } = *header else {
            return false;
        };
        header.kind == FrameType::Data && self.0.contains(&Agreement { sender, receiver, tid })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: MacAddress = MacAddress([2, 0, 0, 0, 0, 1]);
    const B: MacAddress = MacAddress([2, 0, 0, 0, 0, 2]);

    fn frame(first: u8, flags: u8, from: MacAddress, to: MacAddress, body: &[u8]) -> Vec<u8> {
        [&[first, flags, 0, 0][..], &to.0, &from.0, &to.0, &[0, 0], body].concat()
    }

    fn see(agreements: &mut Agreements, frame: &[u8]) {
        agreements.see(&Header::parse(frame).unwrap(), frame);
    }

    fn covers(agreements: &Agreements, from: MacAddress, to: MacAddress, tid: u8) -> bool {
        agreements.cover(&Header::parse(&frame(0x88, 1, from, to, &[tid, 0])).unwrap())
    }

    /// B agrees to frames of identifier 5 from A, with a window of 64.
    fn response(status: u8, flags: u8) -> Vec<u8> {
        frame(0xd0, flags, B, A, &[3, 1, 7, status, 0, 5 << 2 | 2, 0x10, 0, 0])
    }

    #[test]
    fn an_agreement_is_of_one_sender_receiver_and_identifier() {
        let mut agreements = Agreements::default();
        assert!(!covers(&agreements, A, B, 5));
        see(&mut agreements, &response(37, 0));
        see(&mut agreements, &response(0, 0x40));
        assert!(!covers(&agreements, A, B, 5), "it is refused, or encrypted");
        see(&mut agreements, &response(0, 0));
        assert!(covers(&agreements, A, B, 5));
        assert!(!covers(&agreements, A, B, 6) && !covers(&agreements, B, A, 5));
    }

    #[test]
    fn either_end_ends_it_and_so_does_an_association() {
        // Ended by B, by A, by B's deauthentication, and by A's reassociation.
        let ends = [
            frame(0xd0, 0, B, A, &[3, 2, 0, 5 << 4, 1, 0]),
            frame(0xd0, 0, A, B, &[3, 2, 0, 5 << 4 | 1 << 3, 1, 0]),
            frame(0xc0, 0, B, A, &[3, 0]),
            frame(0x20, 0, A, B, &[0; 10]),
        ];
        for end in ends {
            let mut agreements = Agreements::default();
            see(&mut agreements, &response(0, 0));
            see(&mut agreements, &end);
            assert!(!covers(&agreements, A, B, 5), "{end:02x?}");
        }
    }
}
