use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpListener,
    sync::mpsc,
    thread,
};

use cotorra_graph::{Event, Position, Velocity};
use serde_json::{Value, json};

use super::*;
use crate::Actions;

/// Request that a server received.
#[derive(Debug)]
struct Request {
    /// Method and path with query.
    line: String,
    headers: Vec<String>,
    body: String,
}

/// A peer that answers the n-th connection with the n-th of these, closes it, and returns its request.
fn server<A: AsRef<[u8]> + Send + 'static>(answers: Vec<A>) -> (Client, mpsc::Receiver<Request>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let client = Client::new(&format!("http://{}/", listener.local_addr().unwrap())).unwrap();
    let (tell, asked) = mpsc::channel();
    thread::spawn(move || {
        for answer in answers {
            let (mut stream, _) = listener.accept().unwrap();
            let mut lines = BufReader::new(stream.try_clone().unwrap());
            let mut line = || {
                let mut line = String::new();
                lines.read_line(&mut line).unwrap();
                line.trim_end().to_owned()
            };
            let first = line().trim_end_matches(" HTTP/1.1").to_owned();
            let headers: Vec<_> =
                std::iter::from_fn(|| Some(line()).filter(|line| !line.is_empty())).collect();
            let length = headers.iter().find_map(|h| h.strip_prefix("content-length: ")?.parse().ok());
            let mut body = vec![0; length.unwrap_or(0)];
            lines.read_exact(&mut body).unwrap();
            let _ = tell.send(Request { line: first, headers, body: String::from_utf8(body).unwrap() });
            stream.write_all(answer.as_ref()).unwrap();
        }
    });
    (client, asked)
}

fn response(status: &str, body: &str) -> String {
    let length = body.len();
    format!("HTTP/1.1 {status}\r\ncontent-length: {length}\r\nconnection: close\r\n\r\n{body}")
}

fn ok(body: &Value) -> String {
    response("200 OK", &body.to_string())
}

/// A stream that breaks off, as when the testbed's process ends.
fn stream(events: &str) -> String {
    format!(
        "HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\ntransfer-encoding: chunked\r\n\r\n{:x}\r\n{events}\r\n",
        events.len()
    )
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

fn scan() -> Instruction {
    Instruction::Scan { robot: id("robot") }
}

fn testbed() -> Value {
    json!({
        "name": "lab", "services": [], "walks": [], "version": "0.1.0",
        "graph": { "domains": [], "nodes": [], "links": [], "wireless": {} },
    })
}

/// A testbed with walls of 3 dB in its network.
fn walled() -> Value {
    let mut testbed = testbed();
    testbed["graph"]["wireless"]["lab"] = json!({
        "standard": "n", "delay_ms": 1.0, "fast_transition": true, "path_loss": { "model": "free_space" },
        "walls": { "wall_loss_db": 3.0 }, "shadowing": { "deviation_db": 0.0, "correlation_m": 5.0 },
        "noise_floor_dbm": -95.0, "hysteresis_db": 4.0, "time_to_trigger_ms": 100.0, "gap": "hold",
        "handover": {
            "scan_ms": 1.0, "authenticate_ms": 1.0, "reassociate_ms": 1.0, "handshake_ms": 1.0, "variation": 0.0,
        },
    });
    testbed
}

fn picture(pixels: &[u8]) -> Vec<u8> {
    let body = [b"P5\n3 2\n255\n", pixels].concat();
    let head = format!("HTTP/1.1 200 OK\r\ncontent-length: {}\r\nconnection: close\r\n\r\n", body.len());
    [head.as_bytes(), &body].concat()
}

#[test]
fn walls_of_a_testbed_have_its_map() {
    let map = ok(&json!({ "width": 3, "height": 2, "resolution_m": 0.5, "origin": { "x": 1.0, "y": 2.0 } }));
    let answers = |pixels| vec![ok(&walled()).into_bytes(), map.clone().into_bytes(), picture(pixels)];
    let (client, asked) = server(answers(&[254, 0, 205, 254, 254, 0]));
    let graph = client.testbed().unwrap().graph;
    let lines: Vec<_> = asked.iter().take(3).map(|request| request.line).collect();
    assert_eq!(lines, ["GET /api/v1/testbed", "GET /api/v1/map", "GET /api/v1/map/image"]);
    use cotorra_graph::Cell::{Free, Occupied, Unknown};
    let lower_left = Position::new(1.0, 2.0);
    let cells = vec![Free, Free, Occupied, Free, Occupied, Unknown];
    let walls = graph.wireless["lab"].walls.as_ref().unwrap();
    assert_eq!(Some(&*walls.map), cotorra_graph::OccupancyGrid::new(3, 2, 0.5, lower_left, cells).as_ref());
    let [upper, lower] = [2.75, 2.25].map(|y| [1.25, 2.75].map(|x| Position::new(x, y)));
    assert_eq!([upper, lower].map(|[from, to]| graph.wireless["lab"].wall_loss_db(from, to)), [3.0, 3.0]);
    // A picture of another size.
    let (client, _asked) = server(answers(&[254, 0, 205]));
    let wrong = client.testbed().unwrap_err().to_string();
    assert!(wrong.contains("/map/image") && wrong.contains("not a PGM picture of 3 by 2 cells"), "{wrong}");
}

#[test]
fn instructions_carry_their_reason_and_author() {
    let (client, asked) = server(vec![ok(&json!({ "done": true }))]);
    let client = client.with_token("secret").named(PluginId::new("mine").unwrap());
    let instruction =
        Instruction::Move { robot: id("robot"), velocity: Velocity::planar(0.5, -0.25), waypoint: 3 };
    client.instruct(&instruction, Some("why not")).unwrap();
    let request = asked.recv().unwrap();
    assert_eq!(request.line, "POST /api/v1/instructions");
    assert!(request.headers.contains(&"authorization: Bearer secret".to_owned()), "{:?}", request.headers);
    assert!(request.headers.contains(&"x-cotorra-plugin: mine".to_owned()), "{:?}", request.headers);
    let expected = json!({
        "instruction": {
            "instruction": "move", "robot": "robot", "velocity": { "linear": 0.5, "angular": -0.25 }, "waypoint": 3,
        },
        "reason": "why not",
    });
    assert_eq!(serde_json::from_str::<Value>(&request.body).unwrap(), expected);
}

#[test]
fn rejections_and_failures_have_a_reason() {
    let (client, _asked) = server(vec![
        response("409 Conflict", r#"{"refused": "robot `robot` is out of reach"}"#),
        response("401 Unauthorized", r#"{"error": "this API needs its token"}"#),
        response("502 Bad Gateway", "<html>"),
        response("200 OK", "surprise"),
    ]);
    let said = || client.instruct(&scan(), None).unwrap_err();
    let refused = said();
    assert!(matches!(&refused, ClientError::Refused(reason) if reason == "robot `robot` is out of reach"));
    let (unauthorized, gateway, surprise) = (said().to_string(), said().to_string(), said().to_string());
    assert!(
        unauthorized.ends_with("/api/v1/instructions answers 401: this API needs its token"),
        "{unauthorized}"
    );
    assert!(gateway.ends_with("answers 502: Bad Gateway"), "{gateway}");
    assert!(surprise.contains("gives an answer that this client does not understand"), "{surprise}");
}

#[test]
fn unreachable_apis_are_named() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let error = Client::new(&format!("http://{free}")).unwrap().robots().unwrap_err().to_string();
    assert!(
        error.starts_with(&format!("the API at http://{free}/api/v1/robots cannot be reached")),
        "{error}"
    );
}

#[test]
fn invalid_addresses_are_rejected_at_once() {
    for wrong in ["", "127.0.0.1:7700", "http://", "https://", "http://host/path", "http://a b", "ftp://host"]
    {
        assert!(matches!(Client::new(wrong), Err(ClientError::Address(_))), "{wrong}");
    }
    let secure = |ca: Option<&str>| Client::at("https://127.0.0.1:7700", ca.map(Path::new)).unwrap_err();
    assert!(matches!(secure(None), ClientError::NoAuthority(_)) && secure(None).to_string().contains(HINT));
    for no_authority in ["/dev/null", "/does/not/exist"] {
        let error = secure(Some(no_authority)).to_string();
        assert!(error.starts_with(no_authority) && error.contains(HINT), "{error}");
    }
}

#[test]
fn histories_are_requested_by_time_and_page() {
    let sample = json!({ "at_ns": 7, "service": "s", "robot": "robot", "sequence": 1, "emitted_ns": 5, "service_time_ms": 11.5,
        "attachment": "R1", "server": "cloud" });
    let (client, asked) = server(vec![
        ok(&json!({ "items": [sample], "next": "7-1" })),
        ok(&json!({ "items": [], "next": null })),
    ]);
    let page = client.service_times(&Part::default()).unwrap();
    assert_eq!(page.items[0].at, Timestamp::from_nanos(7));
    assert_eq!(page.items[0].value.took, Some(Duration::from_micros(11_500)));
    assert_eq!(asked.recv().unwrap().line, "GET /api/v1/measurements/service-times?from_ns=0");
    let part = Part {
        from: Timestamp::from_secs_f64(1.5),
        to: Some(Timestamp::from_secs_f64(20.0)),
        limit: Some(10),
        after: page.next,
    };
    assert_eq!(client.robot_history(&id("robot"), &part).unwrap(), Page { items: Vec::new(), next: None });
    let line = asked.recv().unwrap().line;
    assert_eq!(
        line,
        "GET /api/v1/measurements/robots/robot?from_ns=1500000000&until_ns=20000000000&limit=10&after=7-1"
    );
}

#[test]
fn events_are_filtered_by_the_server() {
    let (client, asked) =
        server(vec![stream("data: {\"at_ns\": 5, \"event\": \"scanned\", \"robot\": \"robot\"}\n\n")]);
    let events: Vec<_> = client.events(&["robot", "scanned"]).unwrap().map(Result::unwrap).collect();
    assert_eq!(
        events,
        [cotorra_graph::Stamped {
            at: Timestamp::from_nanos(5),
            event: Event::Scanned { robot: id("robot") },
        }]
    );
    assert_eq!(asked.recv().unwrap().line, "GET /api/v1/events?kinds=robot%2Cscanned");
}

/// Scans when it starts, when its deadline comes, and after each scan.
#[derive(Default)]
struct Scanner {
    calls: Vec<(&'static str, Timestamp)>,
    deadline: Option<Timestamp>,
}

impl Plugin for Scanner {
    fn start(&mut self, now: Timestamp, testbed: &Testbed, actions: &mut Actions) {
        assert_eq!(testbed.name, "lab");
        self.calls.push(("start", now));
        self.deadline = Some(now);
        actions.instruct(scan());
    }

    fn handle(&mut self, now: Timestamp, event: &Event, actions: &mut Actions) {
        assert!(matches!(event, Event::Scanned { .. }));
        self.calls.push(("handle", now));
        actions.instruct_because(scan(), "once more");
    }

    fn next_deadline(&self) -> Option<Timestamp> {
        self.deadline
    }

    fn expire(&mut self, now: Timestamp, _actions: &mut Actions) {
        self.calls.push(("expire", now));
        self.deadline = None;
    }
}

#[test]
fn external_plugin_runs_until_the_run_ends() {
    let events = "data: {\"at_ns\": 5000000000, \"event\": \"scanned\", \"robot\": \"robot\"}\n\n\
                  data: {\"at_ns\": 900000000000, \"event\": \"scanned\", \"robot\": \"robot\"}\n\n";
    let (client, asked) = server(vec![
        stream(events),
        ok(&testbed()),
        ok(&json!({ "done": true })),
        response("409 Conflict", r#"{"refused": "no"}"#),
        ok(&json!({ "done": true })),
    ]);
    let mut plugin = Scanner::default();
    client.run(&mut plugin).unwrap();
    let names: Vec<_> = plugin.calls.iter().map(|call| call.0).collect();
    assert_eq!(names, ["start", "handle", "expire", "handle"], "the deadline is not starved by events");
    assert!(plugin.calls.is_sorted_by_key(|call| call.1), "time never falls: {:?}", plugin.calls);
    assert_eq!(plugin.calls[0].1, Timestamp::from_secs_f64(5.0));
    assert!(plugin.calls[3].1 >= Timestamp::from_secs_f64(900.0));
    let lines: Vec<_> = asked.try_iter().map(|request| request.line).collect();
    let post = "POST /api/v1/instructions";
    assert_eq!(lines, ["GET /api/v1/events", "GET /api/v1/testbed", post, post, post]);
}

#[test]
fn in_virtual_time_a_plugin_is_called_mark_by_mark() {
    let scanned =
        |at: u64| format!("data: {{\"at_ns\": {at}, \"event\": \"scanned\", \"robot\": \"robot\"}}\n\n");
    let mark = |number: u64, now: u64| format!("event: mark\nid: {number}\ndata: {now}\n\n");
    let events = [mark(7, 0), scanned(90), scanned(100), mark(8, 100), mark(12, 5_000)].concat();
    let done = || ok(&json!({ "done": true }));
    let (client, asked) = server(vec![
        stream(&events),
        ok(&testbed()),
        done(), // the scan at the start
        done(), // mark 7
        done(), // two scans, one for each event
        response("409 Conflict", r#"{"refused": "no"}"#),
        done(), // mark 8
        done(), // mark 12
    ]);
    let mut plugin = Scanner::default();
    client.run(&mut plugin).unwrap();
    let t = Timestamp::from_nanos;
    let calls = [("start", t(0)), ("expire", t(100)), ("handle", t(100)), ("handle", t(100))];
    assert_eq!(plugin.calls, calls, "one time for a whole mark, and a deadline that has come first");
    let lines: Vec<_> =
        asked.try_iter().map(|request| request.line).filter(|line| line.contains("marks")).collect();
    let said = ["POST /api/v1/marks/7?wake_at_ns=0", "POST /api/v1/marks/8", "POST /api/v1/marks/12"];
    assert_eq!(lines, said);
}

#[test]
fn marks_are_done_when_the_next_event_is_requested() {
    let events = "event: mark\nid: 1\ndata: 0\n\n\
                  data: {\"at_ns\": 5, \"event\": \"scanned\", \"robot\": \"robot\"}\n\n\
                  event: mark\nid: 2\ndata: 5\n\n";
    let done = || ok(&json!({ "done": true }));
    let (client, asked) = server(vec![stream(events), done(), done()]);
    let mut events = client.events(&[]).unwrap();
    assert_eq!(asked.recv().unwrap().line, "GET /api/v1/events");
    assert!(events.next().unwrap().is_ok());
    assert_eq!(asked.recv().unwrap().line, "POST /api/v1/marks/1");
    assert!(asked.try_recv().is_err(), "the event is still being taken in");
    assert!(events.next().is_none());
    assert_eq!(asked.recv().unwrap().line, "POST /api/v1/marks/2");
}

#[test]
fn plugin_ends_with_its_run() {
    let (client, _asked) = server(vec![stream(":\n\n"), ok(&testbed())]);
    client.run(&mut Scanner::default()).unwrap();
    let one = "data: {\"at_ns\": 5, \"event\": \"scanned\", \"robot\": \"robot\"}\n\n";
    let ended = response("503 Service Unavailable", r#"{"error": "the run has ended"}"#);
    let (client, _asked) = server(vec![stream(one), ok(&testbed()), ended]);
    client.run(&mut Scanner::default()).unwrap();
}
