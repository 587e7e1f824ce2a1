//! Messages of random contents, of damaged bytes, and of a real kernel.

use proptest::{option, prelude::*};

use super::*;
use crate::header::Header;

fn address() -> impl Strategy<Value = MacAddress> {
    any::<[u8; 6]>().prop_map(MacAddress)
}

fn bytes() -> impl Strategy<Value = Arc<[u8]>> {
    prop::collection::vec(any::<u8>(), 0..100).prop_map(Arc::from)
}

fn rates() -> impl Strategy<Value = Rates> {
    let tries = (0..128_u8, any::<u8>(), any::<u16>());
    let tries = tries.prop_map(|(index, count, flags)| Tries { index, count, flags });
    prop::collection::vec(tries, 0..=MOST_RATES).prop_map(Rates::new)
}

fn radio() -> impl Strategy<Value = Radio> {
    let words = || (option::of(any::<u32>()), option::of(any::<u32>()));
    let name = option::of("[a-z0-9 é]{0,20}");
    let flags = any::<[bool; 6]>();
    let ciphers = option::of(prop::collection::vec(any::<u32>(), 0..5));
    (words(), words(), name, option::of(address()), option::of(any::<[u8; 2]>()), flags, ciphers)
        .prop_map(
            |(
                (id, channels),
                (custom_regulation, interface_types),
                name,
                permanent_address,
                country,
                flags,
                ciphers,
            )| {
                let [
                    channel_contexts,
                    no_interface,
                    ends_with_socket,
                    p2p_device,
                    strict_regulation,
                    multi_link,
                ] = flags;
                Radio {
                    id,
                    name,
                    permanent_address,
                    channels,
                    channel_contexts,
                    no_interface,
                    ends_with_socket,
                    p2p_device,
                    country,
                    custom_regulation,
                    strict_regulation,
                    interface_types,
                    ciphers,
                    multi_link,
                }
            },
        )
}

fn message() -> impl Strategy<Value = Message> {
    let sent = (address(), bytes(), option::of(any::<u32>()), any::<[bool; 3]>(), rates(), any::<u64>())
        .prop_map(|(radio, frame, frequency_mhz, [wants_status, no_ack, aggregates], rates, cookie)| {
            Message::Frame(Frame {
                radio,
                frame,
                frequency_mhz,
                wants_status,
                no_ack,
                aggregates,
                rates,
                cookie,
            })
        });
    let received = (address(), bytes(), any::<u32>(), any::<i32>(), option::of(any::<u32>())).prop_map(
        |(radio, frame, rate, signal_dbm, frequency_mhz)| {
            Message::Delivery(Delivery { radio, frame, rate, signal_dbm, frequency_mhz })
        },
    );
    let status = (address(), any::<u64>(), any::<[bool; 2]>(), rates(), any::<i32>()).prop_map(
        |(radio, cookie, [acknowledged, no_ack], rates, signal_dbm)| {
            Message::Status(Status { radio, cookie, acknowledged, no_ack, rates, signal_dbm })
        },
    );
    let alias = || (address(), address()).prop_map(|(radio, address)| Alias { radio, address });
    prop_oneof![
        Just(Message::Register),
        sent,
        received,
        status,
        radio().prop_map(Message::NewRadio),
        radio().prop_map(Message::DeleteRadio),
        radio().prop_map(Message::GetRadio),
        alias().prop_map(Message::AddAddress),
        alias().prop_map(Message::RemoveAddress),
    ]
}

proptest! {
    #[test]
    fn written_messages_are_read_back(message in message()) {
        prop_assert_eq!(Message::decode(&message.encode()), Ok(Some(message)));
    }

    #[test]
    fn no_bytes_make_the_decoder_panic(command in 0..10_u8, rest in prop::collection::vec(any::<u8>(), 0..120)) {
        let bytes = [&[command, 1, 0, 0][..], &rest].concat();
        if let Ok(Some(message)) = Message::decode(&bytes) {
            prop_assert_eq!(Message::decode(&message.encode()), Ok(Some(message)));
        }
    }

    #[test]
    fn no_damaged_message_makes_the_decoder_panic(
        message in message(), damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = message.encode();
        for (place, byte) in damage {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        _ = Message::decode(&bytes);
    }
}

#[test]
fn messages_have_the_layout_of_the_kernels_header() {
    let word = |kind: u16, length: u16| [length.to_ne_bytes(), kind.to_ne_bytes()].concat();
    let status = Message::Status(Status {
        radio: MacAddress([2, 0, 0, 0, 1, 0]),
        cookie: 7,
        acknowledged: true,
        no_ack: false,
        rates: Rates::new([Tries { index: 3, count: 2, flags: 1 << 3 }]),
        signal_dbm: -50,
    });
    let expected = [
        vec![3, 1, 0, 0],
        word(2, 10),
        vec![2, 0, 0, 0, 1, 0, 0, 0],
        word(4, 8),
        4_u32.to_ne_bytes().to_vec(),
        word(8, 12),
        7_u64.to_ne_bytes().to_vec(),
        word(6, 8),
        (-50_i32).to_ne_bytes().to_vec(),
        word(7, 12),
        vec![3, 2, 0xff, 0, 0xff, 0, 0xff, 0],
        word(21, 16),
        [&[3][..], &8_u16.to_ne_bytes(), &[0xff, 0, 0, 0xff, 0, 0, 0xff, 0, 0]].concat(),
    ];
    assert_eq!(status.encode(), expected.concat());
}

/// The body of a datagram that Linux 6.1 sent a medium.
fn captured(datagram: &[u8]) -> Message {
    let message = cotorra_netlink::messages(datagram).next().unwrap().unwrap();
    Message::decode(message.body).unwrap().unwrap()
}

#[test]
fn captured_frames_of_the_kernel_are_decoded() {
    let tries = |list: &[(u8, u8, u16)]| {
        Rates::new(list.iter().map(|&(index, count, flags)| Tries { index, count, flags }))
    };
    let Message::Frame(beacon) = captured(include_bytes!("../captured/beacon.bin")) else {
        panic!("a frame")
    };
    assert_eq!((beacon.radio, beacon.frequency_mhz), (MacAddress([2, 0, 0, 0xc0, 0, 1]), Some(2412)));
    assert_eq!((beacon.wants_status, beacon.no_ack, beacon.cookie), (false, true, 1));
    assert_eq!((beacon.rates, beacon.frame.len()), (tries(&[(0, 1, 0)]), 73));
    assert!(Header::parse(&beacon.frame).unwrap().is_beacon());

    let Message::Frame(data) = captured(include_bytes!("../captured/data.bin")) else { panic!("a frame") };
    assert_eq!((data.wants_status, data.no_ack, data.cookie), (false, false, 0x13));
    // All but the first with RTS.
    assert_eq!(data.rates, tries(&[(8, 1, 0), (0, 2, 1), (0, 2, 1), (1, 2, 1)]));
    let header = Header::parse(&data.frame).unwrap();
    assert_eq!((header.tid, header.is_acknowledged()), (Some(0), true));

    let address = MacAddress([2, 0, 0, 0xc0, 0, 1]);
    let added = captured(include_bytes!("../captured/address.bin"));
    assert_eq!(added, Message::AddAddress(Alias { radio: address, address }));
}

#[test]
fn a_negative_index_ends_the_rates() {
    let info = [3, 1, 0xff, 9, 5, 1, 5, 1];
    let rates = Rates::decode(&info, None).unwrap();
    assert_eq!(rates.iter().collect::<Vec<_>>(), [Tries { index: 3, count: 1, flags: 0 }]);
    assert!(Rates::decode(&info[..7], None).is_err());
    assert!(Rates::decode(&info, Some(&[0; 11])).is_err());
}

#[test]
fn a_frame_without_its_attributes_is_malformed() {
    assert!(Message::decode(&[2, 1, 0, 0]).is_err());
    assert!(Message::decode(&[]).is_err());
    // HWSIM_CMD_START_PMSR of Linux 6.4.
    assert_eq!(Message::decode(&[9, 1, 0, 0]), Ok(None));
}
