use proptest::{collection::vec, prelude::*, sample::Index};

use crate::{
    Counts, Frame, Meter, Protocol,
    testing::{FIN, RST, SYN, Talk, frame, ms, samples, tcp},
};

mod http2;

const CLIENT: (u8, u16) = (1, 40_000);
const SERVER: (u8, u16) = (2, 8080);

fn bursts() -> Meter {
    Meter::new(Protocol::Tcp { port: SERVER.1 }, ms(1000))
}

fn http(path: Option<&str>) -> Meter {
    Meter::new(Protocol::Http { port: SERVER.1, path: path.map(str::to_owned) }, ms(1000))
}

#[test]
fn a_burst_is_measured_up_to_the_first_byte_of_its_answer() {
    let mut meter = bursts();
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    // A greeting answers nothing.
    talk.hear(&mut meter, 1, b"220 ready");
    talk.say(&mut meter, 10, b"first");
    talk.say(&mut meter, 14, b"more of it");
    talk.hear(&mut meter, 30, b"answer");
    talk.hear(&mut meter, 40, b"more of it");
    talk.say(&mut meter, 50, b"second");
    talk.hear(&mut meter, 55, b"answer");
    assert_eq!(samples(&mut meter), [(0, 10, Some(20)), (1, 50, Some(5))]);
    assert_eq!(meter.counts(), Counts { requests: 2, ..Counts::default() });
}

#[test]
fn retransmissions_neither_begin_nor_end_requests() {
    let mut meter = bursts();
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    let opened = tcp(CLIENT, SERVER, talk.next[0].wrapping_sub(1), 0, SYN, b"");
    let asked = talk.client_sends(0, b"ask");
    meter.entered(ms(10), &frame(&asked), 0);
    meter.entered(ms(20), &frame(&opened), 0);
    meter.entered(ms(210), &frame(&asked), 0);
    let answered = talk.server_sends(0, b"answer");
    meter.delivered(ms(230), &frame(&answered));
    meter.entered(ms(240), &frame(&asked), 0);
    talk.say(&mut meter, 300, b"next");
    meter.delivered(ms(310), &frame(&answered));
    assert_eq!(samples(&mut meter), [(0, 10, Some(220))]);
    talk.hear(&mut meter, 320, b"answer");
    assert_eq!(samples(&mut meter), [(1, 300, Some(20))]);
}

#[test]
fn an_answer_begins_with_its_first_bytes_even_if_overtaken() {
    let mut meter = bursts();
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    talk.say(&mut meter, 10, b"ask");
    let first = talk.server_sends(0, b"one");
    talk.hear(&mut meter, 20, b"two");
    assert_eq!(samples(&mut meter), []);
    meter.delivered(ms(30), &frame(&first));
    assert_eq!(samples(&mut meter), [(0, 10, Some(20))]);
    // Everything is in order again.
    talk.say(&mut meter, 40, b"ask");
    talk.hear(&mut meter, 45, b"three");
    assert_eq!(samples(&mut meter), [(1, 40, Some(5))]);
}

#[test]
fn requests_without_an_answer_are_lost_also_after_their_connection() {
    let mut meter = bursts();
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    talk.say(&mut meter, 10, b"ask");
    let reset = talk.server_sends(RST, b"");
    meter.delivered(ms(20), &frame(&reset));
    // The next connection has the same ports.
    let mut talk = Talk::begin(&mut meter, 30, CLIENT, SERVER);
    talk.say(&mut meter, 40, b"ask");
    talk.hear(&mut meter, 50, b"answer");
    meter.expire(ms(1010));
    assert_eq!(samples(&mut meter), [(1, 40, Some(10)), (0, 10, None)]);
}

#[test]
fn existing_connections_are_joined() {
    let mut meter = bursts();
    // The answer to an unseen request.
    meter.delivered(ms(1), &frame(&tcp(SERVER, CLIENT, 500, 100, 0, b"answer")));
    meter.entered(ms(10), &frame(&tcp(CLIENT, SERVER, 100, 506, 0, b"ask")), 0);
    meter.delivered(ms(15), &frame(&tcp(SERVER, CLIENT, 506, 103, 0, b"answer")));
    assert_eq!(samples(&mut meter), [(0, 10, Some(5))]);
}

#[test]
fn http_is_measured_up_to_the_end_of_each_response() {
    let mut meter = http(None);
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    // A body with a length, in two parts, and a head in two parts.
    talk.say(&mut meter, 10, b"POST /detect HTTP/1.1\r\nContent-Le");
    talk.say(&mut meter, 12, b"ngth: 4\r\nExpect: 100-continue\r\n\r\n");
    talk.hear(&mut meter, 14, b"HTTP/1.1 100 Continue\r\n\r\n");
    talk.say(&mut meter, 16, b"jpeg");
    talk.hear(&mut meter, 20, b"HTTP/1.1 200 OK\r\ncontent-length: 10\r\n\r\n12345");
    assert_eq!(samples(&mut meter), []);
    talk.hear(&mut meter, 30, b"67890");
    assert_eq!(samples(&mut meter), [(0, 10, Some(20))]);
    // A chunked body, with an extension and a trailer.
    talk.say(
        &mut meter,
        40,
        b"POST /detect HTTP/1.1\r\nTransfer-Encoding: gzip, chunked\r\n\r\n2\r\nab\r\n0\r\n\r\n",
    );
    talk.hear(
        &mut meter,
        50,
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\na;x=y\r\n0123456789\r\n",
    );
    talk.hear(&mut meter, 55, b"1\r\n.\r\n0\r\nTrailer: yes\r\n");
    assert_eq!(samples(&mut meter), []);
    talk.hear(&mut meter, 60, b"\r\n");
    assert_eq!(samples(&mut meter), [(1, 40, Some(20))]);
    // Responses without a body.
    talk.say(&mut meter, 70, b"HEAD / HTTP/1.1\r\n\r\n");
    talk.hear(&mut meter, 71, b"HTTP/1.1 200 OK\r\nContent-Length: 900\r\n\r\n");
    talk.say(&mut meter, 80, b"GET / HTTP/1.1\r\n\r\n");
    talk.hear(&mut meter, 82, b"HTTP/1.1 304 Not Modified\r\nContent-Length: 900\r\n\r\n");
    assert_eq!(samples(&mut meter), [(2, 70, Some(1)), (3, 80, Some(2))]);
    // A body up to the end of the connection.
    talk.say(&mut meter, 90, b"GET / HTTP/1.0\r\n\r\n");
    talk.hear(&mut meter, 95, b"HTTP/1.0 200 OK\r\n\r\nsome");
    assert_eq!(samples(&mut meter), []);
    let last = talk.server_sends(FIN, b"thing");
    meter.delivered(ms(99), &frame(&last));
    assert_eq!(samples(&mut meter), [(4, 90, Some(9))]);
    assert_eq!(meter.counts(), Counts { requests: 5, ..Counts::default() });
}

#[test]
fn the_timeout_counts_from_a_requests_first_byte() {
    let mut meter = http(None);
    let mut slow = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    let mut other = Talk::begin(&mut meter, 0, (1, 40_001), SERVER);
    slow.say(&mut meter, 10, b"GET / ");
    other.say(&mut meter, 20, b"GET / HTTP/1.1\r\n\r\n");
    slow.say(&mut meter, 30, b"HTTP/1.1\r\n\r\n");
    assert_eq!(meter.deadline(), Some(ms(1010)));
    meter.expire(ms(1010));
    assert_eq!(samples(&mut meter), [(1, 10, None)]);
    meter.expire(ms(1020));
    assert_eq!(samples(&mut meter), [(0, 20, None)]);
}

#[test]
fn endless_heads_and_contradicting_lengths_are_not_followed() {
    let mut meter = http(None);
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    for _ in 0..33 {
        talk.say(&mut meter, 1, &[b'x'; 1024]);
    }
    assert_eq!(meter.counts().given_up, 1);
    let mut talk = Talk::begin(&mut meter, 0, (1, 40_001), SERVER);
    talk.say(&mut meter, 1, b"POST / HTTP/1.1\r\nContent-Length: 3\r\nContent-Length: 4\r\n\r\n");
    assert_eq!(meter.counts(), Counts { given_up: 2, ..Counts::default() });
}

#[test]
fn only_requests_of_the_path_count_and_responses_are_in_order() {
    let mut meter = http(Some("/detect"));
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    let request = |path| format!("GET {path} HTTP/1.1\r\nHost: edge\r\n\r\n");
    let many =
        ["/detect?n=1", "/detector", "/", "http://edge:8080/detect", "http://edge"].map(request).concat();
    talk.say(&mut meter, 10, many.as_bytes());
    for at in 1..=5 {
        talk.hear(&mut meter, 10 + at, b"HTTP/1.1 204 No Content\r\n\r\n");
    }
    assert_eq!(samples(&mut meter), [(0, 10, Some(1)), (1, 10, Some(4))]);
    assert_eq!(meter.counts(), Counts { requests: 2, ..Counts::default() });
}

#[test]
fn other_protocols_are_counted_and_not_followed() {
    let mut meter = http(None);
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    talk.say(&mut meter, 1, b"\x16\x03\x01\x02\x00 TLS\r\n\r\n");
    talk.hear(&mut meter, 2, &[0; 40]);
    let mut other = Talk::begin(&mut meter, 3, (1, 40_001), SERVER);
    // A change that both ends agree on is no failure. Its response ends with its head.
    other.say(&mut meter, 4, b"GET /ws HTTP/1.1\r\nUpgrade: websocket\r\n\r\n");
    other.hear(&mut meter, 6, b"HTTP/1.1 101 Switching Protocols\r\n\r\n\x81\x05");
    other.say(&mut meter, 7, &[0x81; 90]);
    assert_eq!(samples(&mut meter), [(0, 4, Some(2))]);
    assert_eq!(meter.counts(), Counts { requests: 1, given_up: 1, ..Counts::default() });
}

#[test]
fn the_quietest_connection_makes_room_for_a_new_one() {
    let mut meter = bursts();
    let mut all: Vec<_> =
        (0..257).map(|i| Talk::begin(&mut meter, u64::from(i), (1, 20_000 + i), SERVER)).collect();
    assert_eq!(meter.counts().given_up, 1);
    all[256].say(&mut meter, 300, b"ask");
    all[256].hear(&mut meter, 301, b"answer");
    assert_eq!(samples(&mut meter), [(0, 300, Some(1))]);
}

#[test]
fn bytes_behind_a_gap_are_bounded() {
    let mut meter = bursts();
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    talk.say(&mut meter, 1, b"ask");
    let lost = talk.server_sends(0, b"lost");
    for _ in 0..9 << 20 >> 15 {
        let part = talk.server_sends(0, &[0; 1 << 15]);
        meter.delivered(ms(2), &Frame { checksum_left: true, ..frame(&part) });
    }
    assert_eq!(meter.counts().given_up, 1);
    meter.expire(ms(2000));
    assert_eq!(samples(&mut meter), [(0, 1, None)]);
    // Other connections are followed as before.
    let mut other = Talk::begin(&mut meter, 3000, (1, 40_001), SERVER);
    other.say(&mut meter, 3001, b"ask");
    let first = other.server_sends(0, b"one");
    for _ in 0..4 {
        other.hear(&mut meter, 3003, &[0; 1 << 14]);
    }
    meter.delivered(ms(3004), &frame(&first));
    assert_eq!(samples(&mut meter), [(1, 3001, Some(3))]);
    meter.delivered(ms(3005), &frame(&lost));
    assert_eq!(samples(&mut meter), []);
}

proptest! {
    /// Each response ends when its last byte and all before have come, however they are cut, repeated and reordered.
    #[test]
    fn http_responses_end_with_their_last_byte_in_any_order(
        bodies in vec((any::<bool>(), 0..300_usize), 1..6),
        cuts in vec(any::<Index>(), 0..12),
        order in vec(any::<Index>(), 0..30),
    ) {
        let mut meter = http(None);
        let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
        let asked = b"GET /x HTTP/1.1\r\n\r\n".repeat(bodies.len());
        for part in asked.chunks(7) {
            talk.say(&mut meter, 0, part);
        }
        let (mut said, mut ends) = (Vec::new(), Vec::new());
        for (is_chunked, length) in &bodies {
            let body = "x".repeat(*length);
            said.extend_from_slice(match (is_chunked, length) {
                (true, 0) => "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n".to_owned(),
                (true, _) => format!("HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n{length:x}\r\n{body}\r\n0\r\n\r\n"),
                (false, _) => format!("HTTP/1.1 200 OK\r\nContent-Length: {length}\r\n\r\n{body}"),
            }.as_bytes());
            ends.push(said.len());
        }
        let mut places: Vec<_> = cuts.iter().map(|cut| cut.index(said.len())).chain([0, said.len()]).collect();
        places.sort_unstable();
        places.dedup();
        let first = talk.next[1];
        let mut parts: Vec<_> = places.windows(2).map(|ends| (ends[0], ends[1])).collect();
        // Some segments are repeated and overlap those before.
        let again: Vec<_> = order.iter().map(|i| parts[i.index(parts.len())]).map(|(a, b)| (a.saturating_sub(3), b)).collect();
        parts.extend(again);
        for (i, other) in order.iter().enumerate() {
            let (i, other) = (i % parts.len(), other.index(parts.len()));
            parts.swap(i, other);
        }
        // Time at which each byte came first.
        let mut came = vec![u64::MAX; said.len()];
        for (i, (from, to)) in parts.iter().enumerate() {
            let at = 1 + i as u64;
            came[*from..*to].iter_mut().for_each(|came| *came = at.min(*came));
            let sequence = first.wrapping_add(*from as u32);
            let sent = tcp(SERVER, CLIENT, sequence, talk.next[0], 0, &said[*from..*to]);
            meter.delivered(ms(at), &frame(&sent));
        }
        let expected: Vec<_> = ends
            .iter()
            .enumerate()
            .map(|(i, end)| (i as u32, 0, came[..*end].iter().max().copied()))
            .collect();
        prop_assert_eq!(samples(&mut meter), expected);
        prop_assert_eq!(meter.counts().given_up, 0);
    }

    /// A client's super-packets and small packets make the same requests.
    #[test]
    fn requests_begin_with_their_first_byte_in_any_segmentation(
        count in 1..20_usize,
        size in 1..60_usize,
    ) {
        let mut meter = http(Some("/detect"));
        let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
        let asked = b"POST /detect HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc".repeat(count);
        let mut expected = Vec::new();
        for (i, part) in asked.chunks(size).enumerate() {
            let (begin, at) = (i * size, 1 + i as u64);
            let whole = asked.len() / count;
            let starts = (begin..begin + part.len()).filter(|place| place % whole == 0);
            expected.extend(starts.map(|place| ((place / whole) as u32, at, Some(900 - at))));
            talk.say(&mut meter, at, part);
        }
        talk.hear(&mut meter, 900, &b"HTTP/1.1 204 No Content\r\n\r\n".repeat(count));
        prop_assert_eq!(samples(&mut meter), expected);
    }
}
