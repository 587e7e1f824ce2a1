//! The kernel's messages, for tests: captured ones, and encoders of others.
//!
//! `captured` has the answers of Linux 6.1 on a machine with `mac80211_hwsim`, whole: all network interfaces, all Wi-Fi
//! interfaces, the two stations of an access point, the survey of one of them after a scan of three channels, that of the
//! access point, which never scanned, and what the kernel knows of nl80211.

use cotorra_netlink::{Answers, DecodeError, NESTED, State, Writer};

pub(crate) const LINKS: &[u8] = include_bytes!("captured/links.bin");
pub(crate) const INTERFACES: &[u8] = include_bytes!("captured/interfaces.bin");
pub(crate) const STATIONS: &[u8] = include_bytes!("captured/stations.bin");
pub(crate) const SURVEY: &[u8] = include_bytes!("captured/survey.bin");
pub(crate) const NO_SURVEY: &[u8] = include_bytes!("captured/no_survey.bin");
pub(crate) const FAMILY: &[u8] = include_bytes!("captured/family.bin");

/// Sequence number of all captured answers.
pub(crate) const SEQUENCE: u32 = 1;

/// Decodes whole answers.
pub(crate) fn answers<T>(
    captured: &[u8],
    decode: impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
) -> Vec<T> {
    let mut answers = Answers::new(SEQUENCE);
    assert!(matches!(answers.take(captured, &decode), Ok(State::Complete(0))), "the answers are whole");
    answers.found
}

/// Encodes an attribute, padded to four bytes.
pub(crate) fn attribute(kind: u16, value: &[u8]) -> Vec<u8> {
    let mut writer = Writer::default();
    writer.bytes(kind, value);
    writer.finish()
}

/// Encodes an attribute that holds others.
pub(crate) fn nested(kind: u16, attributes: &[Vec<u8>]) -> Vec<u8> {
    attribute(kind | NESTED, &attributes.concat())
}

/// Encodes the body of an answer in generic netlink.
pub(crate) fn generic(attributes: &[Vec<u8>]) -> Vec<u8> {
    [vec![0, 1, 0, 0], attributes.concat()].concat()
}
