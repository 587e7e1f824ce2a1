//! The MAC header of a frame, as far as a medium needs it (IEEE 802.11-2020, 9.2 and 9.3).

use crate::address::MacAddress;

/// Length of the header of data and management frames, bytes (9.3.2.1, 9.3.3.1).
const THREE_ADDRESSES: usize = 24;
/// Bytes of the fourth address.
const FOURTH_ADDRESS: usize = 6;
/// Bytes of the QoS control field (9.2.4.5).
const QOS_CONTROL: usize = 2;
/// Bytes of the CCMP header and of its integrity code (12.5.3.2).
const CCMP: usize = 8 + 8;
/// Bytes before a packet that with its type, by LLC (IEEE 802.2) and SNAP (RFC 1042). Ethernet has the type in its header.
const LLC_AND_SNAP: usize = 8;
/// Bytes of the header of an Ethernet frame.
const ETHERNET_HEADER: usize = 14;
/// Length of the shortest control frames, such as an acknowledgement, bytes (9.3.1).
const SHORTEST: usize = 10;

/// Type of a frame (table 9-1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FrameType {
    /// Beacons, authentication, association and the like.
    Management,
    /// Acknowledgements, RTS, CTS, PS-Poll and the like.
    Control,
    /// Data, also without any.
    Data,
    /// Frames of DMG and S1G networks.
    Extension,
}

/// Fields of a frame's MAC header that a medium needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Header {
    /// Its type.
    pub kind: FrameType,
    /// Its subtype, 0 to 15.
    pub subtype: u8,
    /// Whether it goes to the distribution system.
    pub to_ds: bool,
    /// Whether it comes from the distribution system.
    pub from_ds: bool,
    /// Whether its sender sends it again.
    pub retry: bool,
    /// Whether its sender sleeps after it.
    pub power_management: bool,
    /// Whether its body is encrypted.
    pub protected: bool,
    /// Its receiver (address 1).
    pub receiver: MacAddress,
    /// Its sender (address 2); `None` in frames that answer another, such as acknowledgements.
    pub transmitter: Option<MacAddress>,
    /// Its sequence number, 0 to 4095; `None` in control and extension frames.
    pub sequence: Option<u16>,
    /// Its traffic identifier, 0 to 15, if it is QoS data (9.2.4.5.2).
    pub tid: Option<u8>,
}

impl Header {
    /// Reads the header of a frame without its check sequence; `None` if it is too short.
    pub fn parse(frame: &[u8]) -> Option<Self> {
        let control = frame.get(..SHORTEST)?;
        let (first, flags) = (control[0], control[1]);
        let kind = match first >> 2 & 3 {
            0 => FrameType::Management,
            1 => FrameType::Control,
            2 => FrameType::Data,
            _ => FrameType::Extension,
        };
        let (to_ds, from_ds) = (flags & 1 != 0, flags & 2 != 0);
        let subtype = first >> 4;
        let address = |at: usize| frame.get(at..)?.first_chunk().copied().map(MacAddress);
        let word = |at: usize| frame.get(at..)?.first_chunk().copied().map(u16::from_le_bytes);
        let whole = matches!(kind, FrameType::Management | FrameType::Data);
        let sequence = if whole { Some(word(THREE_ADDRESSES - 2)? >> 4) } else { None };
        let is_qos = kind == FrameType::Data && subtype & 8 != 0;
        let fourth = if to_ds && from_ds { FOURTH_ADDRESS } else { 0 };
        let tid = if is_qos { Some((word(THREE_ADDRESSES + fourth)? & 15) as u8) } else { None };
        // CTS and acknowledgements have one address (9.3.1.3, 9.3.1.4).
        let answers = kind == FrameType::Control && matches!(subtype, 12 | 13);
        Some(Self {
            kind,
            subtype,
            to_ds,
            from_ds,
            retry: flags & 1 << 3 != 0,
            power_management: flags & 1 << 4 != 0,
            protected: flags & 1 << 6 != 0,
            receiver: address(4)?,
            transmitter: if answers { None } else { address(10) },
            sequence,
            tid,
        })
    }

    /// Returns the length that the packet in a frame of this length, without check sequence, has as an Ethernet frame; `None` if
    /// there is none. An encrypted one is taken as encrypted by CCMP.
    pub fn packet_bytes(&self, frame_bytes: usize) -> Option<usize> {
        const NO_DATA: u8 = 4;
        if self.kind != FrameType::Data || self.subtype & NO_DATA != 0 {
            return None;
        }
        let fourth = if self.to_ds && self.from_ds { FOURTH_ADDRESS } else { 0 };
        let qos = if self.tid.is_some() { QOS_CONTROL } else { 0 };
        let encryption = if self.protected { CCMP } else { 0 };
        let payload = frame_bytes.checked_sub(THREE_ADDRESSES + fourth + qos + encryption + LLC_AND_SNAP)?;
        Some(ETHERNET_HEADER + payload)
    }

    /// Whether it is a beacon.
    pub const fn is_beacon(&self) -> bool {
        matches!((self.kind, self.subtype), (FrameType::Management, 8))
    }

    /// Whether a receiver acknowledges it: it has one receiver, and is no answer itself.
    pub const fn is_acknowledged(&self) -> bool {
        !self.receiver.is_group() && self.transmitter.is_some()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A beacon's header, of which Linux sent the first bytes: type and subtype, duration, addresses, sequence control.
    const BEACON: [u8; 24] = [
        0x80, 0x00, 0x00, 0x00, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x02, 0, 0, 0, 1, 0, 0x02, 0, 0, 0, 1, 0,
        0x30, 0x12,
    ];

    #[test]
    fn a_beacon_goes_to_a_group() {
        let header = Header::parse(&BEACON).unwrap();
        assert!(header.is_beacon() && !header.is_acknowledged());
        assert_eq!(header.transmitter, Some(MacAddress([2, 0, 0, 0, 1, 0])));
        assert_eq!((header.sequence, header.tid), (Some(0x123), None));
    }

    #[test]
    fn qos_data_has_its_traffic_identifier_behind_all_addresses() {
        let mut frame = BEACON.to_vec();
        (frame[0], frame[1], frame[4]) = (0x88, 0x49, 0x02);
        frame.extend([0x06, 0]);
        let header = Header::parse(&frame).unwrap();
        assert_eq!((header.kind, header.subtype, header.tid), (FrameType::Data, 8, Some(6)));
        assert!(header.to_ds && !header.from_ds && header.retry && header.protected);
        assert!(header.is_acknowledged());
        frame[1] = 0x03;
        assert_eq!(Header::parse(&frame), None, "the fourth address is missing");
        frame.splice(24..24, [2, 0, 0, 0, 9, 9]);
        assert_eq!(Header::parse(&frame).unwrap().tid, Some(6));
    }

    #[test]
    fn control_frames_are_shorter() {
        // An acknowledgement, and a PS-Poll with an association identifier in place of the duration.
        let ack = [0xd4, 0, 0, 0, 2, 0, 0, 0, 1, 0];
        let header = Header::parse(&ack).unwrap();
        assert_eq!((header.kind, header.transmitter), (FrameType::Control, None));
        assert!(!header.is_acknowledged());
        let poll = [0xa4, 0x10, 1, 0xc0, 2, 0, 0, 0, 1, 0, 2, 0, 0, 0, 2, 0];
        let header = Header::parse(&poll).unwrap();
        assert_eq!(header.transmitter, Some(MacAddress([2, 0, 0, 0, 2, 0])));
        assert!(header.is_acknowledged() && header.power_management);
        assert_eq!(header.sequence, None);
        assert_eq!(Header::parse(&ack[..9]), None);
    }

    #[test]
    fn packets_are_as_long_as_on_ethernet() {
        let header = |first: u8, flags: u8| {
            let frame = [&[first, flags, 0, 0][..], &[2; 18], &[0; 10]].concat();
            Header::parse(&frame).unwrap()
        };
        const IP: usize = 128;
        for (first, flags, bytes, packet) in [
            (0x08, 0x01, 24 + 8 + IP, Some(14 + IP)),
            (0x88, 0x01, 26 + 8 + IP, Some(14 + IP)),
            (0x88, 0x41, 26 + 16 + 8 + IP, Some(14 + IP)),
            (0x88, 0x43, 32 + 16 + 8 + IP, Some(14 + IP)),
            // A null frame, one that is too short, and a beacon.
            (0xc8, 0x01, 26, None),
            (0x08, 0x01, 30, None),
            (0x80, 0x00, 200, None),
        ] {
            assert_eq!(header(first, flags).packet_bytes(bytes), packet, "{first:02x} {flags:02x}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_parser_panic(frame in prop::collection::vec(any::<u8>(), 0..60)) {
            if let Some(header) = Header::parse(&frame) {
                prop_assert!(header.subtype < 16 && header.tid.is_none_or(|tid| tid < 16));
                prop_assert!(header.sequence.is_none_or(|number| number < 4096));
            }
        }
    }
}
