//! The power of a radio, which hostapd leaves to the kernel: nl80211, a family of generic netlink (linux/nl80211.h).

use std::io;

use netlink_packet_core::{
    DefaultNla, Emitable, NLM_F_ACK, NLM_F_REQUEST, NLMSG_ERROR, NetlinkBuffer, NlasIterator, parse_i32,
    parse_u16,
};
use netlink_sys::{Socket, protocols::NETLINK_GENERIC};
use rustix::net::{AddressFamily, SocketType, netdevice};

use serde::{Deserialize, Serialize};

use crate::names::InterfaceName;

/// `GENL_ID_CTRL`, the family that knows the numbers of others, with its `CTRL_CMD_GETFAMILY`.
const CONTROLLER: (u16, u8) = (0x10, 3);
/// `CTRL_ATTR_FAMILY_ID`.
const FAMILY_NUMBER: u16 = 1;
/// `CTRL_ATTR_FAMILY_NAME`.
const FAMILY_NAME: u16 = 2;
/// `NL80211_CMD_SET_WIPHY`.
const SET_RADIO: u8 = 2;
/// `NL80211_CMD_GET_INTERFACE`.
const GET_INTERFACE: u8 = 5;
/// `NL80211_ATTR_IFINDEX`.
const INTERFACE: u16 = 3;
/// `NL80211_ATTR_WIPHY_TX_POWER_SETTING`.
const POWER_KIND: u16 = 97;
/// `NL80211_ATTR_WIPHY_TX_POWER_LEVEL`, in mBm, i.e. hundredths of dBm.
const POWER_LEVEL: u16 = 98;
/// Lengths of `struct nlmsghdr` and `struct genlmsghdr`.
const HEADERS: (usize, usize) = (16, 4);
/// Longest answer, in bytes.
const LONGEST: usize = 16 * 1024;

/// A transmit power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Power {
    /// What the driver and the regulatory domain choose.
    Automatic,
    /// At most this much, in hundredths of dBm.
    AtMost(i32),
    /// This much, in hundredths of dBm.
    Fixed(i32),
}

impl Power {
    /// Returns the kind (`enum nl80211_tx_power_setting`) and the level.
    fn parts(self) -> (u32, Option<i32>) {
        match self {
            Self::Automatic => (0, None),
            Self::AtMost(level) => (1, Some(level)),
            Self::Fixed(level) => (2, Some(level)),
        }
    }
}

/// The power of an interface's radio. A change of it is put back when this is dropped: as a limit, because the kernel does not
/// tell whether it was automatic.
#[derive(Debug)]
pub struct TransmitPower {
    nl80211: Nl80211,
    interface: u32,
    before: Option<Power>,
}

impl TransmitPower {
    /// Borrows the power of an interface in the calling thread's network namespace.
    ///
    /// # Errors
    /// The error of the system, e.g. if there is no such interface, or no nl80211.
    pub fn of(interface: &InterfaceName) -> io::Result<Self> {
        let socket = rustix::net::socket(AddressFamily::INET, SocketType::DGRAM, None)?;
        let interface = netdevice::name_to_index(socket, interface.as_str())?;
        Ok(Self { nl80211: Nl80211::open()?, interface, before: None })
    }

    /// Returns the present power, in hundredths of dBm; `None` if the interface is down or its driver does not report it.
    ///
    /// # Errors
    /// The error of the kernel, e.g. if this is no Wi-Fi interface.
    pub fn read(&mut self) -> io::Result<Option<i32>> {
        let answer = self.nl80211.request(GET_INTERFACE, &[(INTERFACE, self.interface)])?;
        Ok(attribute(&answer, POWER_LEVEL, parse_i32))
    }

    /// Changes the power.
    ///
    /// # Errors
    /// The error of the kernel, e.g. without the right to do so, or if the driver cannot.
    pub fn set(&mut self, power: Power) -> io::Result<()> {
        if self.before.is_none() {
            self.before = Some(self.read()?.map_or(Power::Automatic, Power::AtMost));
        }
        self.change(power)
    }

    /// Changes the power for good: it is not put back.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn change(&mut self, power: Power) -> io::Result<()> {
        let (kind, level) = power.parts();
        let mut attributes = vec![(INTERFACE, self.interface), (POWER_KIND, kind)];
        attributes.extend(level.map(|level| (POWER_LEVEL, level.cast_unsigned())));
        self.nl80211.request(SET_RADIO, &attributes).map(drop)
    }

    /// Puts the power back.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn give_back(mut self) -> io::Result<()> {
        self.before.take().map_or(Ok(()), |power| self.change(power))
    }
}

impl Drop for TransmitPower {
    fn drop(&mut self) {
        if let Some(power) = self.before.take() {
            _ = self.change(power);
        }
    }
}

/// A socket to nl80211. It never blocks: the kernel has answered before a request is sent.
struct Nl80211 {
    socket: Socket,
    family: u16,
    sequence: u32,
}

impl std::fmt::Debug for Nl80211 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Nl80211").finish_non_exhaustive()
    }
}

impl Nl80211 {
    fn open() -> io::Result<Self> {
        let mut socket = Socket::new(NETLINK_GENERIC)?;
        socket.bind_auto()?;
        socket.set_non_blocking(true)?;
        let (family, command) = CONTROLLER;
        let mut nl80211 = Self { socket, family, sequence: 0 };
        let answer = nl80211.exchange(command, &[DefaultNla::new(FAMILY_NAME, b"nl80211\0".to_vec())])?;
        let number = attribute(&answer, FAMILY_NUMBER, parse_u16);
        nl80211.family = number.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidData))?;
        Ok(nl80211)
    }

    /// Sends a request with these words.
    fn request(&mut self, command: u8, words: &[(u16, u32)]) -> io::Result<Vec<u8>> {
        let attribute = |&(kind, word): &(u16, u32)| DefaultNla::new(kind, word.to_ne_bytes().to_vec());
        let attributes: Vec<_> = words.iter().map(attribute).collect();
        self.exchange(command, &attributes)
    }

    /// Sends a request, and returns the attributes of the answer; none, if it is only acknowledged.
    fn exchange(&mut self, command: u8, attributes: &[DefaultNla]) -> io::Result<Vec<u8>> {
        self.sequence = self.sequence.wrapping_add(1);
        self.socket.send(&message(self.family, self.sequence, command, attributes), 0)?;
        let mut answer = Vec::new();
        loop {
            let mut datagram = Vec::with_capacity(LONGEST);
            self.socket.recv(&mut datagram, 0)?;
            match read(&datagram, self.sequence)? {
                Part::Answer(attributes) => answer = attributes,
                Part::Acknowledged => return Ok(answer),
                Part::Other => {}
            }
        }
    }
}

/// What a datagram is.
#[derive(Debug, PartialEq, Eq)]
enum Part {
    /// Attributes.
    Answer(Vec<u8>),
    /// The end of an answer.
    Acknowledged,
    /// Something else.
    Other,
}

/// Encodes a request.
fn message(family: u16, sequence: u32, command: u8, attributes: &[DefaultNla]) -> Vec<u8> {
    let (header, generic) = HEADERS;
    let start = header + generic;
    let mut bytes = vec![0; start + attributes.buffer_len()];
    let mut message = NetlinkBuffer::new(&mut bytes);
    message.set_length(u32::try_from(start + attributes.buffer_len()).expect("no request is that long"));
    message.set_message_type(family);
    message.set_flags(NLM_F_REQUEST | NLM_F_ACK);
    message.set_sequence_number(sequence);
    bytes[header] = command;
    attributes.emit(&mut bytes[start..]);
    bytes
}

/// Reads a datagram for the request with this number.
fn read(datagram: &[u8], sequence: u32) -> io::Result<Part> {
    let invalid = |error| io::Error::new(io::ErrorKind::InvalidData, error);
    let message = NetlinkBuffer::new_checked(datagram).map_err(invalid)?;
    if message.sequence_number() != sequence {
        return Ok(Part::Other);
    }
    let payload = message.payload();
    if message.message_type() != NLMSG_ERROR {
        return Ok(Part::Answer(payload.get(HEADERS.1..).unwrap_or_default().to_vec()));
    }
    let code = payload.get(..4).map(parse_i32).transpose().map_err(invalid)?;
    match code.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidData))? {
        0 => Ok(Part::Acknowledged),
        code => Err(io::Error::from_raw_os_error(code.saturating_neg())),
    }
}

/// Reads the value of an attribute; `None` if it is missing or cannot be read.
fn attribute<T>(
    attributes: &[u8],
    kind: u16,
    read: impl Fn(&[u8]) -> Result<T, netlink_packet_core::DecodeError>,
) -> Option<T> {
    let mut found = NlasIterator::new(attributes).flatten();
    found.find(|attribute| attribute.kind() == kind).and_then(|attribute| read(attribute.value()).ok())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn words(words: &[(u16, u32)]) -> Vec<DefaultNla> {
        words.iter().map(|&(kind, word)| DefaultNla::new(kind, word.to_ne_bytes().to_vec())).collect()
    }

    #[test]
    fn requests_and_answers_have_the_same_form() {
        let bytes = message(0x1c, 7, SET_RADIO, &words(&[(INTERFACE, 3), (POWER_LEVEL, 1500)]));
        assert_eq!(bytes.len(), 16 + 4 + 8 + 8);
        assert_eq!(bytes[16..20], [SET_RADIO, 0, 0, 0]);
        let Part::Answer(attributes) = read(&bytes, 7).expect("a message") else { panic!("no answer") };
        assert_eq!(attribute(&attributes, POWER_LEVEL, parse_i32), Some(1500));
        assert_eq!(attribute(&attributes, POWER_KIND, parse_i32), None);
        assert_eq!(read(&bytes, 8).expect("a message"), Part::Other);
    }

    #[test]
    fn refusals_are_errors_of_the_system() {
        let refusal = |code: i32| {
            let mut bytes = message(NLMSG_ERROR, 7, 0, &[]);
            bytes[16..20].copy_from_slice(&code.to_ne_bytes());
            read(&bytes, 7)
        };
        assert_eq!(refusal(0).expect("no error"), Part::Acknowledged);
        assert_eq!(refusal(-1).expect_err("an error").kind(), io::ErrorKind::PermissionDenied);
    }

    #[test]
    fn missing_interfaces_are_reported() {
        let error = TransmitPower::of(&"missing0".parse().expect("a name")).expect_err("there is none");
        assert_eq!(error.raw_os_error(), Some(rustix::io::Errno::NODEV.raw_os_error()));
    }

    proptest! {
        #[test]
        fn no_answer_makes_the_reader_panic(bytes: Vec<u8>, sequence: u32) {
            if let Ok(Part::Answer(attributes)) = read(&bytes, sequence) {
                _ = attribute(&attributes, POWER_LEVEL, parse_i32);
            }
            _ = attribute(&bytes, POWER_LEVEL, parse_i32);
        }
    }
}
