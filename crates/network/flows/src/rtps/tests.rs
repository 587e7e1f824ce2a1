use proptest::{collection::vec, prelude::*};

use super::*;
use crate::testing::rtps::{CUSTOM_RELATED, Message, RELATED, guid};

/// A sample, with its payload.
type Sample = (Identity, Option<Identity>, Range<u64>, u64, Vec<u8>);

/// Returns the samples in a message.
fn samples(message: &[u8]) -> Vec<Sample> {
    let mut samples = Vec::new();
    read(message, |Data { identity, related, fragments, count, payload }| {
        samples.push((identity, related, fragments, count, payload.to_vec()));
    });
    samples
}

/// A message with everything that a flow reads, and more.
fn message(is_little: bool) -> Message {
    let request = Identity { writer: guid(9, 9), sequence: 1 << 33 };
    let message = Message::of(1, is_little);
    let others = message.parameter(0x0071, &[0; 4]);
    let [standard, custom] = [RELATED, CUSTOM_RELATED].map(|id| message.related(id, request));
    let source = [&[0; 8][..], &[2; 12]].concat();
    message
        .submessage(0x09, 0, &[0; 8])
        .data(guid(1, 1), 5, b"", b"plain")
        // A time stamp without a time, and an empty submessage.
        .submessage(0x09, 0x02, b"")
        .submessage(0x01, 0, b"")
        .data(guid(1, 2), 6, &[&others[..], &standard].concat(), b"standard")
        .data(guid(1, 2), 7, &custom, b"custom")
        .submessage(0x07, 0, &[0; 28])
        .fragment(guid(1, 3), 8, 1, 4, b"fragments")
        .submessage(0x0c, 0, &source)
        .data(guid(2, 4), 9, b"", b"from another")
}

#[test]
fn samples_are_read_in_either_byte_order() {
    let request = Some(Identity { writer: guid(9, 9), sequence: 1 << 33 });
    let of = |writer, sequence| Identity { writer, sequence };
    for is_little in [false, true] {
        let expected = vec![
            (of(guid(1, 1), 5), None, 0..1, 1, b"plain".to_vec()),
            (of(guid(1, 2), 6), request, 0..1, 1, b"standard".to_vec()),
            (of(guid(1, 2), 7), request, 0..1, 1, b"custom".to_vec()),
            (of(guid(1, 3), 8), None, 1..2, 3, b"ment".to_vec()),
            (of(guid(2, 4), 9), None, 0..1, 1, b"from another".to_vec()),
        ];
        let mut bytes = message(is_little).bytes;
        assert_eq!(samples(&bytes), expected);
        // The last submessage needs no length.
        let last = bytes.len() - b"from another".len() - 22;
        assert_eq!(bytes[last..last + 2].iter().map(|byte| u16::from(*byte)).max(), Some(32));
        bytes[last..last + 2].fill(0);
        assert_eq!(samples(&bytes), expected);
    }
}

#[test]
fn impossible_samples_are_ignored() {
    let fragment = |number, size, sample: &[u8]| {
        Message::of(1, true).fragment(guid(1, 1), 1, number, size, sample).bytes
    };
    let whole = fragment(1, 4, b"fragments");
    for (at, value) in [(24 + 20, 0), (24 + 20, 4), (24 + 24, 0), (24 + 24, 3), (24 + 26, 0), (24 + 28, 4)] {
        let mut bytes = whole.clone();
        bytes[at] = value;
        assert_eq!(samples(&bytes), [], "{value} at {at}");
    }
    // Keys in place of data.
    for (mut bytes, flags) in
        [(whole, 0x05), (Message::of(1, true).data(guid(1, 1), 1, b"", b"").bytes, 0x09)]
    {
        assert_eq!(samples(&bytes).len(), 1);
        bytes[21] = flags;
        assert_eq!(samples(&bytes), []);
    }
    assert_eq!(samples(&Message::of(1, true).data(guid(1, 1), 0, b"", b"").bytes), []);
    assert_eq!(samples(&Message::of(1, true).data(guid(1, 1), 1 << 63, b"", b"").bytes), []);
    assert_eq!(samples(b"RTPX"), []);
}

#[test]
fn announcements_name_writers_and_topics() {
    for is_little in [false, true] {
        let bytes = Message::of(3, is_little).announce(guid(3, 7), "rt/camera").bytes;
        let [(identity, _, _, _, payload)] = &samples(&bytes)[..] else { panic!("one sample") };
        assert!(identity.writer.ends_with(&PUBLICATIONS_WRITER));
        assert_eq!(announced(payload), Some((guid(3, 7), &b"rt/camera"[..])));
        // A fragment has the parameters without the end of the list.
        assert_eq!(announced(&payload[..payload.len() - 4]), Some((guid(3, 7), &b"rt/camera"[..])));
        assert_eq!(announced(&payload[..payload.len() - 5]), None);
    }
}

proptest! {
    /// A cut message has the samples before the cut, and at most one that is cut itself.
    #[test]
    fn only_samples_behind_a_cut_are_missing(is_little: bool, length in 0..400_usize) {
        let whole = message(is_little).bytes;
        let (all, some) = (samples(&whole), samples(&whole[..length.min(whole.len())]));
        prop_assert!(some.len() <= all.len());
        prop_assert_eq!(&some[..], &all[..some.len()]);
    }

    #[test]
    fn arbitrary_bytes_cause_no_panic(
        is_little: bool,
        changes in vec((0..400_usize, any::<u8>()), 1..20),
        random in vec(any::<u8>(), 0..200),
    ) {
        let mut bytes = message(is_little).announce(guid(1, 1), "rt/a").bytes;
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        for (_, _, _, _, payload) in samples(&bytes) {
            let _ = (announced(&payload), numbers(&payload));
        }
        let _ = (samples(&[b"RTPS", &random[..]].concat()), announced(&random), numbers(&random));
    }
}
