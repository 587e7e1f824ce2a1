use super::*;

const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const RST_STREAM: u8 = 3;
const SETTINGS: u8 = 4;
const PUSH_PROMISE: u8 = 5;
const CONTINUATION: u8 = 9;

const END_STREAM: u8 = 0x01;
const END_HEADERS: u8 = 0x04;
const PADDED: u8 = 0x08;
const PRIORITY: u8 = 0x20;

/// Requests of RFC 7541, C.4.1 to C.4.3: two of `/`, and one of `/index.html`.
const GET: [&[u8]; 3] = [
    b"\x82\x86\x84\x41\x8c\xf1\xe3\xc2\xe5\xf2\x3a\x6b\xa0\xab\x90\xf4\xff",
    b"\x82\x86\x84\xbe\x58\x86\xa8\xeb\x10\x64\x9c\xbf",
    b"\x82\x87\x85\xbf\x40\x88\x25\xa8\x49\xe9\x5b\xa9\x7d\x7f\x89\x25\xa8\x49\xe9\x5b\xb8\xe8\xb4\xbf",
];
/// `:status: 200`.
const OK: &[u8] = b"\x88";

/// A frame of HTTP/2.
fn h2(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    [&length[1..], &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

fn settings() -> Vec<u8> {
    h2(SETTINGS, 0, 0, b"")
}

/// Opens a connection.
fn begin(meter: &mut Meter) -> Talk {
    let mut talk = Talk::begin(meter, 0, CLIENT, SERVER);
    talk.say(meter, 1, &[PREFACE, &settings()].concat());
    talk.hear(meter, 2, &settings());
    talk
}

#[test]
fn requests_of_http2_are_streams_and_end_with_the_servers_half() {
    let mut meter = http(None);
    let mut talk = begin(&mut meter);
    // As gRPC does: the message in a frame of its own, and trailers behind the answer.
    talk.say(&mut meter, 10, &h2(HEADERS, END_HEADERS, 1, GET[0]));
    talk.say(&mut meter, 12, &h2(DATA, END_STREAM, 1, b"image"));
    talk.say(&mut meter, 15, &h2(HEADERS, END_HEADERS | END_STREAM, 3, GET[1]));
    talk.hear(&mut meter, 20, &h2(HEADERS, END_HEADERS, 1, OK));
    let answer = h2(DATA, 0, 1, b"actions");
    talk.hear(&mut meter, 22, &answer[..12]);
    // The answer to the second request overtakes.
    talk.hear(&mut meter, 24, &[&answer[12..], &h2(HEADERS, END_HEADERS, 3, OK)].concat());
    talk.hear(&mut meter, 25, &h2(DATA, END_STREAM, 3, b"x"));
    assert_eq!(samples(&mut meter), [(1, 15, Some(10))]);
    talk.hear(&mut meter, 30, &h2(HEADERS, END_STREAM, 1, b""));
    assert_eq!(samples(&mut meter), []);
    talk.hear(&mut meter, 31, &h2(CONTINUATION, END_HEADERS, 1, OK));
    assert_eq!(samples(&mut meter), [(0, 10, Some(21))]);
    // Trailers of a client are no request.
    talk.say(&mut meter, 40, &h2(HEADERS, END_HEADERS, 5, GET[2]));
    talk.say(&mut meter, 41, &h2(HEADERS, END_HEADERS | END_STREAM, 5, b""));
    talk.hear(&mut meter, 44, &h2(DATA, END_STREAM, 5, b""));
    assert_eq!(samples(&mut meter), [(2, 40, Some(4))]);
    assert_eq!(meter.counts(), Counts { requests: 3, ..Counts::default() });
}

#[test]
fn a_server_of_http2_may_speak_first() {
    let mut meter = http(None);
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    talk.say(&mut meter, 1, &PREFACE[..5]);
    talk.hear(&mut meter, 2, &settings());
    talk.say(&mut meter, 3, &[&PREFACE[5..], &h2(HEADERS, END_HEADERS | END_STREAM, 1, GET[0])].concat());
    talk.hear(&mut meter, 7, &h2(HEADERS, END_HEADERS | END_STREAM, 1, OK));
    assert_eq!(samples(&mut meter), [(0, 3, Some(4))]);
    // A server of HTTP/1 may not.
    let mut talk = Talk::begin(&mut meter, 8, (1, 40_001), SERVER);
    talk.hear(&mut meter, 9, b"220 ready\r\n");
    talk.say(&mut meter, 10, b"GET / HTTP/1.1\r\n\r\n");
    assert_eq!(meter.counts(), Counts { requests: 1, given_up: 1, ..Counts::default() });
}

#[test]
fn a_request_of_http1_that_begins_as_http2_does_began_with_its_first_byte() {
    let mut meter = http(None);
    let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
    talk.say(&mut meter, 5, b"P");
    talk.say(&mut meter, 6, b"OST / HTTP/1.1\r\nContent-Length: 0\r\n\r\n");
    talk.hear(&mut meter, 9, b"HTTP/1.1 204 No Content\r\n\r\n");
    assert_eq!(samples(&mut meter), [(0, 5, Some(4))]);
}

#[test]
fn streams_that_either_end_resets_are_lost_and_pushes_are_no_requests() {
    let mut meter = http(None);
    let mut talk = begin(&mut meter);
    for (at, stream) in [(10, 1), (11, 3), (12, 5)] {
        talk.say(&mut meter, at, &h2(HEADERS, END_HEADERS | END_STREAM, stream, GET[0]));
    }
    talk.hear(&mut meter, 13, &h2(PUSH_PROMISE, END_HEADERS, 5, b"\x00\x00\x00\x02\x82"));
    talk.hear(&mut meter, 14, &h2(HEADERS, END_HEADERS | END_STREAM, 2, OK));
    talk.say(&mut meter, 15, &h2(RST_STREAM, 0, 1, &[0, 0, 0, 8]));
    talk.hear(&mut meter, 16, &h2(RST_STREAM, 0, 3, &[0, 0, 0, 7]));
    for stream in [1, 3] {
        talk.hear(&mut meter, 17, &h2(DATA, END_STREAM, stream, b"late"));
    }
    assert_eq!(samples(&mut meter), []);
    talk.hear(&mut meter, 18, &h2(DATA, END_STREAM, 5, b""));
    assert_eq!(samples(&mut meter), [(2, 12, Some(6))]);
    meter.expire(ms(2000));
    assert_eq!(samples(&mut meter), [(0, 10, None), (1, 11, None)]);
}

#[test]
fn requests_of_http2_beyond_the_bounds_are_not_followed() {
    let many = |meter: &mut Meter, fields: &[u8]| {
        let mut talk = begin(meter);
        for stream in 0..129 {
            talk.say(meter, 10, &h2(HEADERS, END_HEADERS, 2 * stream + 1, fields));
        }
        meter.counts()
    };
    assert_eq!(many(&mut http(None), GET[0]), Counts { requests: 128, given_up: 1, ..Counts::default() });
    let is_wrong = |fields: &[u8]| {
        let mut meter = http(Some("/"));
        let mut talk = begin(&mut meter);
        talk.say(&mut meter, 10, &h2(HEADERS, 0, 1, fields));
        talk.say(&mut meter, 10, &h2(CONTINUATION, END_HEADERS, 1, fields));
        meter.counts().given_up == 1
    };
    let long = [GET[0], &[0x82; 5000]].concat();
    assert!(is_wrong(&long), "a field section of 10 kB");
    // An index beyond the tables, and a table of 16 MB.
    assert!(is_wrong(b"\xff\xff\x10"));
    assert!(is_wrong(b"\x3f\xe1\xff\xff\x07"));
    assert!(!is_wrong(GET[0]));
}

proptest! {
    /// Fields are found however they are cut, padded and spread over frames, also those that name earlier ones.
    #[test]
    fn requests_of_a_path_are_found_in_any_segmentation(
        size in 1..80_usize,
        cut in any::<Index>(),
        padding in 0..9_u8,
    ) {
        let mut said = [PREFACE, &settings()].concat();
        let mut starts = Vec::new();
        for (number, fields) in GET.into_iter().enumerate() {
            let stream = 2 * number as u32 + 1;
            let (first, second) = fields.split_at(cut.index(fields.len() + 1));
            let padded = [&[padding][..], &[0, 0, 0, 0, 9], first, &vec![0; usize::from(padding)]].concat();
            starts.push(said.len());
            said.extend(h2(HEADERS, PADDED | PRIORITY | END_STREAM, stream, &padded));
            said.extend(h2(CONTINUATION, END_HEADERS, stream, second));
        }
        let mut meter = http(Some("/"));
        let mut talk = Talk::begin(&mut meter, 0, CLIENT, SERVER);
        for (at, part) in said.chunks(size).enumerate() {
            talk.say(&mut meter, 1 + at as u64, part);
        }
        for stream in [1, 3, 5] {
            talk.hear(&mut meter, 900, &h2(HEADERS, END_HEADERS | END_STREAM, stream, OK));
        }
        let began = |number: usize| 1 + (starts[number] / size) as u64;
        let expected = [0, 1].map(|number| (number as u32, began(number), Some(900 - began(number))));
        prop_assert_eq!(samples(&mut meter), expected);
        prop_assert_eq!(meter.counts(), Counts { requests: 2, ..Counts::default() });
    }

    /// No frames make the meter panic, nor answer a request that was not asked.
    #[test]
    fn random_frames_of_http2_have_at_most_one_answer_each(
        frames in vec((any::<bool>(), 0..10_u8, any::<u8>(), 0..8_u32, vec(any::<u8>(), 0..20)), 0..60),
        of_path in any::<bool>(),
    ) {
        let mut meter = http(of_path.then_some("/"));
        let mut talk = begin(&mut meter);
        for (of_client, kind, flags, stream, payload) in frames {
            let sent = h2(kind, flags, stream, &payload);
            if of_client { talk.say(&mut meter, 5, &sent) } else { talk.hear(&mut meter, 6, &sent) }
        }
        let answered = samples(&mut meter);
        let mut numbers: Vec<_> = answered.iter().map(|(number, ..)| *number).collect();
        numbers.sort_unstable();
        numbers.dedup();
        prop_assert_eq!(numbers.len(), answered.len());
        prop_assert!(answered.len() as u64 <= meter.counts().requests);
    }
}
