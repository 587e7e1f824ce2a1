use proptest::{collection::vec, prelude::*};

use crate::{
    Counts, Frame, Id, Meter, Protocol,
    testing::{frame, ms, samples, udp, udp_fragments},
};

const CLIENT: (u8, u16) = (1, 40_000);
const SERVER: (u8, u16) = (2, 9000);

fn meter(id: Option<Id>) -> Meter {
    Meter::new(Protocol::Udp { port: SERVER.1, id }, ms(100))
}

fn ask(meter: &mut Meter, at: u64, payload: &[u8]) {
    meter.entered(ms(at), &frame(&udp(CLIENT, SERVER, payload)), 7);
}

fn answer(meter: &mut Meter, at: u64, payload: &[u8]) {
    meter.delivered(ms(at), &frame(&udp(SERVER, CLIENT, payload)));
}

#[test]
fn consecutive_requests_are_measured_and_late_answers_ignored() {
    let mut meter = meter(None);
    ask(&mut meter, 1, b"a");
    answer(&mut meter, 13, b"b");
    ask(&mut meter, 20, b"c");
    assert_eq!(meter.deadline(), Some(ms(120)));
    meter.expire(ms(119));
    assert_eq!(samples(&mut meter), [(0, 1, Some(12))]);
    meter.expire(ms(120));
    assert_eq!(samples(&mut meter), [(1, 20, None)]);
    answer(&mut meter, 121, b"late");
    assert_eq!((samples(&mut meter), meter.deadline()), (vec![], None));
    // An answer at the very end of the timeout is too late.
    ask(&mut meter, 200, b"d");
    answer(&mut meter, 300, b"e");
    assert_eq!(samples(&mut meter), [(2, 200, None)]);
    assert_eq!(meter.counts(), Counts { requests: 3, ..Counts::default() });
}

#[test]
fn ambiguous_answers_are_in_no_sample() {
    let mut meter = meter(None);
    ask(&mut meter, 0, b"a");
    ask(&mut meter, 30, b"b");
    answer(&mut meter, 40, b"to which?");
    // Until the other requests expire, an answer may belong to any of them.
    ask(&mut meter, 60, b"c");
    answer(&mut meter, 70, b"");
    // Other sockets are not affected.
    meter.entered(ms(70), &frame(&udp((1, 40_001), SERVER, b"")), 0);
    meter.delivered(ms(75), &frame(&udp(SERVER, (1, 40_001), b"")));
    assert_eq!(samples(&mut meter), [(3, 70, Some(5))]);
    meter.expire(ms(160));
    ask(&mut meter, 200, b"d");
    answer(&mut meter, 201, b"");
    assert_eq!(samples(&mut meter), [(4, 200, Some(1))]);
    assert_eq!(meter.counts(), Counts { requests: 5, unclear: 3, ..Counts::default() });
}

#[test]
fn a_request_stays_unclear_when_the_others_expire() {
    let mut meter = meter(None);
    ask(&mut meter, 0, b"a");
    ask(&mut meter, 30, b"b");
    answer(&mut meter, 40, b"to which?");
    meter.expire(ms(100));
    answer(&mut meter, 110, b"perhaps the other");
    meter.expire(ms(130));
    assert_eq!(samples(&mut meter), []);
    assert_eq!(meter.counts(), Counts { requests: 2, unclear: 2, ..Counts::default() });
}

#[test]
fn requests_and_fragments_are_bounded_and_the_oldest_are_forgotten() {
    let mut meter = meter(Some(Id { offset: 0, length: 2 }));
    for number in 0..1025_u16 {
        ask(&mut meter, 1, &number.to_be_bytes());
    }
    assert_eq!(meter.counts(), Counts { requests: 1025, forgotten: 1, ..Counts::default() });
    answer(&mut meter, 2, &0_u16.to_be_bytes());
    let long: Vec<u8> = [&1_u16.to_be_bytes()[..], &[0; 2000]].concat();
    let [first, second] = udp_fragments(SERVER, CLIENT, &long, 1480).try_into().unwrap();
    meter.delivered(ms(3), &frame(&first));
    for other in 10..74 {
        meter.delivered(ms(3), &frame(&udp_fragments((other, SERVER.1), CLIENT, &long, 1480)[0]));
    }
    meter.delivered(ms(4), &frame(&second));
    assert_eq!(samples(&mut meter), []);
    meter.delivered(ms(5), &frame(&first));
    assert_eq!(samples(&mut meter), [(1, 1, Some(4))]);
}

#[test]
fn ids_distinguish_answers_despite_loss_repetition_and_reordering() {
    let mut meter = meter(Some(Id { offset: 1, length: 2 }));
    ask(&mut meter, 0, b"?01");
    ask(&mut meter, 10, b"?02...");
    ask(&mut meter, 20, b"?03");
    // A retransmission.
    ask(&mut meter, 25, b"!03");
    // A datagram too short for an id.
    ask(&mut meter, 26, b"?0");
    answer(&mut meter, 30, b"=03 and more");
    answer(&mut meter, 31, b"=03 again");
    answer(&mut meter, 32, b"=01");
    answer(&mut meter, 33, b"=04");
    meter.expire(ms(110));
    assert_eq!(samples(&mut meter), [(2, 20, Some(10)), (0, 0, Some(32)), (1, 10, None)]);
    assert_eq!(meter.counts(), Counts { requests: 3, ..Counts::default() });
}

#[test]
fn other_frames_are_ignored() {
    let mut meter = meter(None);
    let entered = |meter: &mut Meter, from, to| meter.entered(ms(0), &frame(&udp(from, to, b"")), 0);
    entered(&mut meter, CLIENT, (2, 9001));
    // Answers of a server on the same node as the client of another one.
    entered(&mut meter, (1, 9000), (2, 40_000));
    let broadcast = {
        let mut bytes = udp(CLIENT, SERVER, b"");
        bytes[30..34].copy_from_slice(&[224, 0, 0, 1]);
        bytes
    };
    meter.entered(ms(0), &Frame { checksum_left: true, ..frame(&broadcast) }, 0);
    assert_eq!(meter.counts().requests, 0);
    ask(&mut meter, 1, b"");
    meter.delivered(ms(2), &frame(&udp((2, 9001), CLIENT, b"")));
    meter.delivered(ms(2), &frame(&udp((3, 9000), CLIENT, b"")));
    meter.delivered(ms(2), &frame(&udp(SERVER, (1, 40_001), b"")));
    assert_eq!(samples(&mut meter), []);
    answer(&mut meter, 3, b"");
    assert_eq!(samples(&mut meter), [(0, 1, Some(2))]);
}

#[test]
fn answers_with_a_flipped_bit_are_ignored() {
    let mut meter = meter(None);
    ask(&mut meter, 0, b"a");
    let good = udp(SERVER, CLIENT, b"odd");
    for bit in 14 * 8..good.len() * 8 {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        meter.delivered(ms(1), &frame(&bad));
        assert_eq!(samples(&mut meter), [], "bit {bit}");
    }
    // A checksum left to the network card is not verified.
    let mut left = good;
    let place = left.len() - 5;
    left[place] ^= 1;
    meter.delivered(ms(2), &Frame { checksum_left: true, ..frame(&left) });
    assert_eq!(samples(&mut meter), [(0, 0, Some(2))]);
}

#[test]
fn a_super_packet_counts_as_its_datagrams() {
    let mut meter = meter(Some(Id { offset: 0, length: 2 }));
    let both = udp(CLIENT, SERVER, b"01..02");
    meter.entered(ms(0), &Frame { segment: Some(4), ..frame(&both) }, 0);
    answer(&mut meter, 5, b"02");
    answer(&mut meter, 6, b"01");
    assert_eq!(samples(&mut meter), [(1, 0, Some(5)), (0, 0, Some(6))]);
}

proptest! {
    #[test]
    fn a_fragmented_answer_is_complete_with_its_last_fragment_in_any_order(
        length in 1..4000_usize,
        size in 2..180_usize,
        order in vec(any::<proptest::sample::Index>(), 600),
        repeat in any::<proptest::sample::Index>(),
    ) {
        let mut meter = meter(Some(Id { offset: 2, length: 3 }));
        let payload: Vec<u8> = (0..length + 5).map(|i| i as u8).collect();
        for fragment in udp_fragments(CLIENT, SERVER, &payload, 1480) {
            meter.entered(ms(1), &frame(&fragment), 0);
        }
        let mut fragments = udp_fragments(SERVER, CLIENT, &payload, size * 8);
        for (i, other) in order.iter().take(fragments.len()).enumerate() {
            let other = other.index(fragments.len());
            fragments.swap(i, other);
        }
        let again = fragments[repeat.index(fragments.len())].clone();
        let last = fragments.pop().unwrap();
        for fragment in &fragments {
            meter.delivered(ms(2), &frame(fragment));
        }
        if again != last {
            meter.delivered(ms(3), &frame(&again));
        }
        prop_assert_eq!(samples(&mut meter), []);
        meter.delivered(ms(4), &frame(&last));

        prop_assert_eq!(samples(&mut meter), [(0, 1, Some(3))]);
    }
}
