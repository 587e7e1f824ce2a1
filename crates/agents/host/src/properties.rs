//! Properties of all decoders.

use proptest::{prelude::*, sample::Index};

use cotorra_netlink::Answers;

use crate::{
    nl80211, read_anything,
    testing::{FAMILY, INTERFACES, LINKS, SEQUENCE, STATIONS, SURVEY},
};

/// Returns captured answers with some bytes replaced, cut somewhere.
fn damaged() -> impl Strategy<Value = Vec<u8>> {
    let captured = prop::sample::select(vec![FAMILY, INTERFACES, LINKS, STATIONS, SURVEY]);
    let damage = prop::collection::vec((any::<Index>(), any::<u8>()), 0..20);
    (captured, damage, any::<Index>()).prop_map(|(captured, damage, end)| {
        let mut bytes = captured[..=end.index(captured.len())].to_vec();
        for (place, byte) in damage {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        bytes
    })
}

proptest! {
    #[test]
    fn no_bytes_make_a_decoder_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        read_anything(&bytes);
    }

    #[test]
    fn no_damaged_answer_makes_a_decoder_panic(bytes in damaged(), start in any::<Index>()) {
        read_anything(&bytes[start.index(bytes.len())..]);
        read_anything(&bytes);
    }

    #[test]
    fn what_is_decoded_survives_json(bytes in damaged()) {
        let mut answers = Answers::new(SEQUENCE);
        _ = answers.take(&bytes, &nl80211::station);
        for station in answers.found {
            let json = serde_json::to_string(&station).unwrap();
            let read = serde_json::from_str::<cotorra_graph::WifiStation>(&json);
            prop_assert!(read.is_ok(), "{json}: {read:?}");
        }
    }
}
