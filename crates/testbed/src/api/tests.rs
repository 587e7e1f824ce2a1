//! The API over a socket, as a caller uses it: its answers equal the history's, and slow readers harm no others.

mod applications;
mod bounds;
mod links;
mod machines;
mod nodes;
mod tls;

use std::{
    collections::{BTreeMap, BTreeSet},
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::Path,
    sync::mpsc,
};

use cotorra_fabric::{Fabric, Frame, PortId};
use cotorra_graph::{
    DataFormat, Event, HostAddress, LargeData, NodeId, PluginId, SensorId, SensorReading, Stamped, Timestamp,
};
use cotorra_measurements::{CurveRequest, History, RunId, RunInfo};
use cotorra_robot_middleware::{Content, SensedData};
use serde_json::{Value, json};

use super::*;
use crate::{
    core::message::Message,
    events::{live::Live, stream::EventStream},
    given::Given,
    history::keeping::Keeper,
};

/// A served history without a running testbed.
struct Served {
    server: Server,
    history: Arc<History>,
    events: EventStream,
    runs: [RunId; 2],
    live: Live,
    keeper: Keeper,
    fabric: Arc<parking_lot::Mutex<Fabric>>,
    _folder: tempfile::TempDir,
}

fn notice(at: u64) -> Stamped {
    Stamped { at: Timestamp::from_nanos(at), event: Event::Notice { message: format!("{at:>250}") } }
}

/// A service time with as many milliseconds as its second of the run.
fn sample(second: u64) -> Stamped {
    let at = second * 1_000_000_000;
    let event = json!({
        "at_ns": at, "event": "service_time", "service": "walk", "robot": "robot", "sequence": second,
        "emitted_ns": at, "service_time_ms": second as f64, "attachment": "R1", "server": "left",
    });
    serde_json::from_value(event).unwrap()
}

fn serve(replay: bool) -> Served {
    serve_within(replay, Limits { strangers: 64, callers: 64 }, Patience::default())
}

fn serve_within(replay: bool, limits: Limits, patience: Patience) -> Served {
    serve_to(Operator::Everyone, None, replay, limits, patience)
}

/// Serves the API as a run does by default.
fn serve_to_user(runs: &Runs, strangers: usize, callers: usize) -> Served {
    serve_to(Operator::User, Some(runs), false, Limits { strangers, callers }, Patience::default())
}

fn serve_to(
    operator: Operator,
    found_in: Option<&Runs>,
    replay: bool,
    limits: Limits,
    patience: Patience,
) -> Served {
    let text = "
name: served
wireless: { lab: {} }
nodes:
  left: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  ap: { kind: radio_unit, position: [0, 3], channel: 1 }
  robot:
    kind: robot
    position: [0, 0]
    sensors: { pack: { kind: battery }, gripper: { kind: vector, size: 2, unit: N }, front: { kind: lidar } }
links: [{ ends: [left, ap] }]
";
    let testbed = cotorra_testbed_file::parse("served.yaml", text, Path::new("")).unwrap();
    let history = Arc::new(History::in_memory().unwrap());
    let begin = |seed| {
        let info =
            RunInfo { name: "served".to_owned(), seed, started_at_unix_ns: 0, testbed: text.to_owned() };
        history.begin_run(&info).unwrap()
    };
    let runs = [begin(1), begin(2)];
    for (run, seconds) in runs.into_iter().zip([10, 20]) {
        let recorder = history.paced_recorder(run).unwrap();
        (0..seconds).for_each(|second| recorder.record(sample(second)));
        // An event that the history cannot hold leaves a gap.
        recorder.record(Stamped { at: Timestamp::from_nanos(u64::MAX), ..notice(0) });
        recorder.flush().unwrap();
    }
    let events = EventStream::default();
    let live = Live::default();
    let folder = tempfile::tempdir().unwrap();
    let keeper = Keeper::of_folder(folder.path(), cotorra_recording::Pace::Live);
    let fabric = Arc::new(parking_lot::Mutex::new(Fabric::new(&testbed.graph, 1).unwrap()));
    let tapped = Arc::clone(&fabric);
    let context = Context {
        testbed: Arc::new(testbed),
        live: live.clone(),
        history: Arc::clone(&history),
        run: runs[1],
        events: events.clone(),
        core: mpsc::channel().0,
        namespaces: Arc::default(),
        hosted: Arc::default(),
        lockstep: None,
        distant: Arc::default(),
        replay,
        paced: false,
        verdict: None,
        kpis: Vec::new(),
        keeper: Some(keeper.clone()),
        wais: WaisOptions::default(),
        logs: None,
        wiretap: Some(Arc::new(move |name, reader| Ok(tapped.lock().tap(name, reader)?))),
    };
    let tokens = Tokens::new(operator, BTreeMap::new()).unwrap();
    let listener = Listener::bind(([127, 0, 0, 1], 0).into(), false, &tokens, &Encryption::Off).unwrap();
    let listener = listener.announced(found_in, "served", "/runs/served");
    let mut server = Server::start_within(listener, context, tokens, limits, patience).unwrap();
    server.open();
    Served { server, history, events, runs, live, keeper, fabric, _folder: folder }
}

/// Reads the head of an answer.
fn answer(stream: TcpStream) -> (u16, BufReader<TcpStream>) {
    let mut stream = BufReader::new(stream);
    let mut line = String::new();
    stream.read_line(&mut line).unwrap();
    let status = line.split(' ').nth(1).unwrap().parse().unwrap();
    while line != "\r\n" {
        line.clear();
        stream.read_line(&mut line).unwrap();
    }
    (status, stream)
}

impl Served {
    /// Sends a request, and reads the answer's head.
    fn open(&self, path: &str) -> (u16, BufReader<TcpStream>) {
        let mut stream = TcpStream::connect(self.server.dashboard().address()).unwrap();
        write!(stream, "GET /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
            .unwrap();
        answer(stream)
    }

    fn get(&self, path: &str) -> (u16, Value) {
        let (status, mut body) = self.open(path);
        let mut text = String::new();
        body.read_to_string(&mut text).unwrap();
        (status, serde_json::from_str(&text).unwrap_or_else(|e| panic!("{path}: {e}: {text}")))
    }

    fn answer(&self, path: &str) -> Value {
        let (status, body) = self.get(path);
        assert_eq!(status, 200, "{path}: {body}");
        body
    }
}

#[test]
fn curves_gaps_runs_and_differences_are_what_the_history_answers() {
    let served = serve(false);
    let [first, this] = served.runs;
    let curve = served
        .answer("measurements/series?figure=service_time:walk&points=4&quantiles=0.5,1&from_ns=4000000000");
    let request = CurveRequest { points: 4, quantiles: vec![0.5, 1.0] };
    let figure = "service_time:walk".parse().unwrap();
    let range = Timestamp::from_secs_f64(4.0)..;
    let expected = served.history.curve(this, &figure, range, &request).unwrap();
    assert_eq!(curve, serde_json::to_value(&expected).unwrap());
    assert_eq!((curve["unit"].as_str(), curve["points"].as_array().unwrap().len()), (Some("ms"), 4));

    let gaps = served.answer("measurements/gaps");
    let expected = served.history.gaps(this, .., cotorra_measurements::PageRequest::default()).unwrap();
    assert_eq!(gaps["items"], serde_json::to_value(&expected.items).unwrap());
    let runs = served.answer("measurements/runs");
    assert_eq!(
        (&runs[0]["seed"], &runs[0]["this"], &runs[1]["this"]),
        (&json!(1), &json!(false), &json!(true))
    );
    assert_eq!(served.answer(&format!("measurements/runs?after={first}")).as_array().unwrap().len(), 1);

    let difference = served.answer(&format!("measurements/difference?a={first}"));
    assert_eq!(
        difference,
        serde_json::to_value(served.history.difference(first, this, Default::default()).unwrap()).unwrap()
    );
    let others = served.answer(&format!("measurements/service-times?run={first}"));
    assert_eq!(others["items"].as_array().unwrap().len(), 10);
}

#[test]
fn invalid_requests_name_the_reason() {
    let served = serve(false);
    for (path, expected, part) in [
        ("measurements/series", 400, "figure"),
        ("measurements/series?figure=mood:robot", 400, "`mood:robot` is not a figure"),
        ("measurements/series?figure=service_time&quantiles=0.5,2", 400, "from 0 to 1"),
        ("measurements/state?run=99", 404, "there is no run 99"),
        ("measurements/difference?a=99", 404, "there is no run 99"),
        ("measurements/gaps?form_s=3", 400, "form_s"),
    ] {
        let (status, body) = served.get(path);
        assert_eq!(status, expected, "{path}: {body}");
        assert!(body["error"].as_str().unwrap().contains(part), "{path}: {body}");
    }
}

#[test]
fn large_data_is_served_unchanged_and_lost_data_is_gone() {
    let served = serve(false);
    let path = |reading: &str| format!("robots/robot/sensors/front/{reading}");
    let status = |path: &str| served.get(path).0;
    assert_eq!([status(&path("latest")), status(&path("0"))], [404, 404], "there is no reading yet");
    let measured = Timestamp::from_nanos(17);
    for (sequence, format) in [(3, DataFormat::Scan), (5, DataFormat::Png)] {
        let data = LargeData { sequence, format, width: 40, height: 30, bytes: 4 };
        let (robot, sensor) = (NodeId::new("robot").unwrap(), SensorId::new("front").unwrap());
        let content = Content::Bytes(Arc::from([b'a', 0, 255, sequence as u8]));
        let sensed = SensedData {
            robot: robot.clone(),
            sensor: sensor.clone(),
            measured,
            at: measured,
            data,
            content,
        };
        served.keeper.keep(sensed);
        let reading = SensorReading { robot, sensor, measured, values: BTreeMap::new(), data: Some(data) };
        served.live.absorb(&Stamped { at: measured, event: Event::Sensor(reading) });
    }
    for (reading, kind, format, sequence) in [
        ("3", "application/octet-stream", "scan", 3),
        ("5", "image/png", "png", 5),
        ("latest", "image/png", "png", 5),
    ] {
        let mut stream = TcpStream::connect(served.server.dashboard().address()).unwrap();
        let path = path(reading);
        write!(stream, "GET /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
            .unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let (head, body) = answer.split_at(answer.len() - 4);
        assert_eq!(body, [b'a', 0, 255, sequence]);
        let head = std::str::from_utf8(head).unwrap();
        for line in [
            "HTTP/1.1 200 OK",
            "content-length: 4",
            "x-cotorra-width: 40",
            "x-cotorra-height: 30",
            "x-cotorra-measured-ns: 17",
            &format!("content-type: {kind}"),
            &format!("x-cotorra-format: {format}"),
            &format!("x-cotorra-sequence: {sequence}"),
        ] {
            assert!(head.lines().any(|told| told == line), "{reading}: {line}: {head}");
        }
    }
    for (path, expected, part) in [
        (path("4"), 410, "not kept any more"),
        (path("6"), 404, "no such reading yet"),
        (path("newest"), 400, "neither `latest` nor a number"),
        ("robots/robot/sensors/rear/latest".into(), 404, "no sensor `rear`"),
        ("robots/robot/sensors/pack/latest".into(), 404, "nothing is kept of sensor `pack`"),
        ("robots/nobody/sensors/front/latest".into(), 404, "no robot `nobody`"),
    ] {
        let (status, body) = served.get(&path);
        assert_eq!(status, expected, "{path}: {body}");
        assert!(body["error"].as_str().unwrap().contains(part), "{path}: {body}");
    }
}

#[test]
fn a_replay_reveals_nothing_of_the_future() {
    let served = serve(true);
    let [first, this] = served.runs;
    served.live.absorb(&sample(5));
    let count = |path: &str| served.answer(path)["items"].as_array().unwrap().len();
    assert_eq!(count("measurements/service-times"), 6, "seconds 0 to 5");
    assert_eq!(count("measurements/events?until_ns=3000000000"), 3);
    assert_eq!(count("measurements/gaps"), 0);
    let curve = served.answer("measurements/series?figure=service_time&points=1");
    assert_eq!(curve["points"][0]["count"], 6);
    assert_eq!(served.answer("measurements/state?at_ns=100000000000")["at_ns"], 5_000_000_000_u64);
    assert_eq!(served.get(&format!("measurements/difference?a={this}&b={first}")).0, 409);
    // Other runs are entirely in the past.
    assert_eq!(count(&format!("measurements/service-times?run={first}")), 10);
}

#[test]
fn a_stalled_reader_loses_the_oldest_learns_the_number_and_slows_nobody() {
    // More bytes than the kernel buffers for a socket.
    const EVENTS: u64 = 100_000;
    let served = serve(false);
    let (_, mut stalled) = served.open("events");
    let (_, mut picky) = served.open("events?kinds=handover,notice");
    let mut all = served.events.subscribe();
    for at in 0..EVENTS {
        // Does not wait for readers: if it waited for the stalled one, this would never end.
        served.events.send(Arc::new(notice(at)));
        if at % 1000 == 999 {
            // Meanwhile other readers receive every event, and requests are answered.
            (0..1000).for_each(|_| drop(all.waiting().expect("a reader in time misses nothing")));
        }
    }
    assert_eq!(served.answer("measurements/runs").as_array().unwrap().len(), 2);
    for reader in [&mut stalled, &mut picky] {
        let (mut told, mut missed, mut last, mut losses) = (0_u64, 0_u64, None, 0);
        let (mut line, mut is_loss) = (String::new(), false);
        while told + missed < EVENTS {
            line.clear();
            assert!(reader.read_line(&mut line).unwrap() > 0, "{told} told, {missed} missed");
            match line.trim_end().split_once(": ") {
                Some(("event", name)) => is_loss = name == "missed",
                Some(("data", number)) if is_loss => {
                    missed += number.parse::<u64>().unwrap();
                    (is_loss, losses) = (false, losses + 1);
                }
                Some(("data", event)) => {
                    let event: Stamped = serde_json::from_str(event).unwrap();
                    assert!(last < Some(event.at), "in order: {last:?}, {event:?}");
                    (last, told) = (Some(event.at), told + 1);
                }
                _ => {}
            }
        }
        assert_eq!(told + missed, EVENTS, "each is received or counted as missed");
        assert_eq!(last, Some(Timestamp::from_nanos(EVENTS - 1)), "the newest is not what is lost");
        assert!(missed > 0 && losses > 0);
    }
}

#[test]
fn sensors_show_their_last_reading_and_are_followed_by_name() {
    let served = serve(false);
    let reading = |at: u64, sensor: &str, values: Value| -> Stamped {
        let event = json!({
            "at_ns": at, "event": "sensor", "robot": "robot", "sensor": sensor, "measured_ns": at - 1, "values": values,
        });
        serde_json::from_value(event).unwrap()
    };
    let gripper = json!({
        "declared": { "sensor": "gripper", "interval_ms": 100.0, "kind": "vector", "size": 2, "unit": "N" },
        "components": [{ "component": "0", "unit": "N" }, { "component": "1", "unit": "N" }],
        "last": null,
    });
    let told = served.answer("robots/robot/sensors");
    assert_eq!((told[1].clone(), told[0]["last"].clone()), (gripper, Value::Null));
    assert_eq!(told[0]["components"][1], json!({ "component": "voltage_v", "unit": "V" }));
    assert_eq!(served.get("robots/left/sensors").0, 404);

    let (_, mut followed) = served.open("events?kinds=sensor,notice&sensors=pack,other");
    let all = [
        reading(5, "gripper", json!({ "0": 1.0, "1": 2.0 })),
        reading(6, "pack", json!({ "charge": 0.5, "voltage_v": 14.9 })),
        notice(7),
    ];
    for event in &all {
        served.live.absorb(event);
        served.events.send(Arc::new(event.clone()));
    }
    let mut next = || loop {
        let mut line = String::new();
        assert!(followed.read_line(&mut line).unwrap() > 0);
        if let Some(data) = line.trim_end().strip_prefix("data: ") {
            break serde_json::from_str::<Stamped>(data).unwrap();
        }
    };
    assert_eq!([next(), next()], [all[1].clone(), all[2].clone()]);
    let last = served.answer("robots/robot/sensors")[0]["last"].clone();
    assert_eq!((&last["at_ns"], &last["values"]["charge"]), (&json!(6), &json!(0.5)));
    assert_eq!(served.get("events?sensors=a,%20,b").0, 400);
}

const DOMAINS: &str = "
name: served
domains: [one, two]
wireless: { lab: {} }
nodes:
  robot: { kind: robot, position: [0, 0] }
  A: { kind: radio_unit, position: [0, 1], channel: 1 }
  left: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  B: { kind: radio_unit, domain: two, position: [9, 1], channel: 1 }
  right: { kind: server, domain: two, tier: fog, cpus: 1, memory: 1 GB }
links:
  - { ends: [A, left] }
  - { ends: [A, B] }
  - { ends: [B, right] }
plugins:
  - { bundled: probing, domain: one }
  - { id: watcher, command: [\"true\"] }
";

/// A testbed of two domains with a token each; the first has a robot.
struct Domains {
    server: Server,
    applications: Applications,
    on_node: SocketAddr,
    events: EventStream,
    core: mpsc::Receiver<Message>,
    live: Live,
    logs: tempfile::TempDir,
}

const OPERATOR: &str = "operator-operator";
const ONE: &str = "one-one-one-one-one";
const TWO: &str = "two-two-two-two-two";

impl Domains {
    fn serve() -> Self {
        Self::serve_found_in(None)
    }

    fn serve_found_in(found_in: Option<&Runs>) -> Self {
        let mut served = Self::prepare(found_in);
        served.server.open();
        served
    }

    fn prepare(found_in: Option<&Runs>) -> Self {
        Self::prepare_of(DOMAINS, found_in)
    }

    /// Prepares the API of a testbed file. Applications reach it at a port of loopback in place of an emulated node's.
    fn prepare_of(text: &str, found_in: Option<&Runs>) -> Self {
        let testbed = cotorra_testbed_file::parse("served.yaml", text, Path::new(""))
            .unwrap_or_else(|e| panic!("{e:?}"));
        let history = Arc::new(History::in_memory().unwrap());
        let info =
            RunInfo { name: "served".to_owned(), seed: 1, started_at_unix_ns: 0, testbed: text.to_owned() };
        let run = history.begin_run(&info).unwrap();
        let recorder = history.paced_recorder(run).unwrap();
        (0..3).for_each(|second| recorder.record(sample(second)));
        recorder.flush().unwrap();
        let (live, logs) = (Live::default(), tempfile::tempdir().unwrap());
        live.absorb(&machines::machine("left", 1));
        let events = EventStream::default();
        let (core, inbox) = mpsc::channel();
        let testbed = Arc::new(testbed);
        let context = Context {
            testbed: Arc::clone(&testbed),
            live: live.clone(),
            history,
            run,
            events: events.clone(),
            core,
            namespaces: Arc::default(),
            hosted: Arc::new(testbed.plugins.iter().map(|spec| spec.id.clone()).collect()),
            lockstep: None,
            distant: Arc::default(),
            replay: false,
            paced: false,
            verdict: None,
            kpis: Vec::new(),
            keeper: None,
            wais: WaisOptions::default(),
            logs: Some(logs.path().to_owned()),
            wiretap: None,
        };
        let token = |text: &str| Token::new(text).unwrap();
        let of = |name: &str, text: &str| (name.parse().unwrap(), token(text));
        let tokens =
            Tokens::new(Operator::Token(token(OPERATOR)), BTreeMap::from([of("one", ONE), of("two", TWO)]))
                .unwrap();
        let listener = Listener::bind(([127, 0, 0, 1], 0).into(), false, &tokens, &Encryption::Off).unwrap();
        let listener = listener.announced(found_in, "served", "/runs/served");
        let (applications, node) =
            (Applications::new(&testbed), std::net::TcpListener::bind("127.0.0.1:0").unwrap());
        let on_node = node.local_addr().unwrap();
        let listener = listener.on_node(Some(node), applications.clone());
        let server = Server::start(listener, context, tokens).unwrap();
        Self { server, applications, on_node, events, core: inbox, live, logs }
    }

    fn ask(&self, token: &str, head: &str, body: &str) -> (u16, BufReader<TcpStream>) {
        Self::ask_at(self.server.dashboard().address(), token, head, body)
    }

    fn ask_at(address: SocketAddr, token: &str, head: &str, body: &str) -> (u16, BufReader<TcpStream>) {
        let mut stream = TcpStream::connect(address).unwrap();
        let length = body.len();
        write!(
            stream,
            "{head} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\nContent-Type: \
             application/json\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        )
        .unwrap();
        answer(stream)
    }

    fn get(&self, token: &str, path: &str) -> (u16, Value) {
        let (status, mut body) = self.ask(token, &format!("GET {path}"), "");
        let mut text = String::new();
        body.read_to_string(&mut text).unwrap();
        (status, serde_json::from_str(&text).unwrap_or_else(|e| panic!("{path}: {e}: {text}")))
    }
}

#[test]
fn a_domains_token_opens_its_own_nodes_and_nothing_else() {
    let served = Domains::serve();
    let nodes = |token| {
        let (_, testbed) = served.get(token, "/api/v1/testbed");
        let nodes = testbed["graph"]["nodes"].as_array().unwrap();
        nodes.iter().map(|node| node["id"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(nodes(OPERATOR), ["robot", "A", "left", "B", "right"]);
    assert_eq!(
        (nodes(ONE), nodes(TWO)),
        (vec!["robot".into(), "A".into(), "left".into()], vec!["B".into(), "right".into()])
    );
    for (own, other, path) in [
        (ONE, TWO, "network/nodes/A"),
        (ONE, TWO, "measurements/robots/robot"),
        (ONE, TWO, "measurements/machines/left"),
        (ONE, TWO, "network/nodes/left/machine"),
        (ONE, TWO, "robots/robot/sensors"),
        (ONE, TWO, "measurements/links/A-left"),
        (OPERATOR, ONE, "measurements/state?run=1"),
        (ONE, TWO, "measurements/series?figure=service_time::robot"),
        (ONE, TWO, "measurements/series?figure=x:robot"),
        (ONE, TWO, "measurements/series?figure=delay:A-left:forward"),
        (OPERATOR, ONE, "measurements/series?figure=service_time"),
        (OPERATOR, TWO, "measurements/runs"),
        (OPERATOR, TWO, "measurements/service-times?run=1"),
    ] {
        let path = format!("/api/v1/{path}");
        assert_eq!(served.get(own, &path).0, 200, "{path}");
        let (status, body) = served.get(other, &path);
        assert!(
            status == 403 && body["error"].as_str().unwrap().contains("domain `"),
            "{path}: {status} {body}"
        );
    }
    for unknown in ["sensors/front/latest", "candidates"] {
        let path = format!("/api/v1/robots/robot/{unknown}");
        assert_eq!([ONE, TWO].map(|token| served.get(token, &path).0), [404, 403], "{unknown}");
    }
    for path in ["service-times", "events"] {
        let items = |token| {
            let (status, body) = served.get(token, &format!("/api/v1/measurements/{path}"));
            assert_eq!(status, 200, "{body}");
            body["items"].as_array().unwrap().len()
        };
        assert_eq!((items(OPERATOR), items(ONE), items(TWO)), (3, 3, 0), "{path}");
    }
    for (path, allowed) in [
        ("/wai/v2/queries/ap/ap_information", [200, 403, 403]),
        ("/domains/one/wai/v2/queries/ap/ap_information", [200, 200, 403]),
        ("/domains/two/wai/v2/queries/ap/ap_information", [200, 403, 200]),
        ("/location/v2/queries/zones", [200, 403, 403]),
        ("/domains/one/location/v2/queries/users", [200, 200, 403]),
        ("/domains/two/location/v2/queries/zones", [200, 403, 200]),
        ("/bwm/v1/bw_allocations", [200, 403, 403]),
    ] {
        assert_eq!(
            [OPERATOR, ONE, TWO].map(|token| served.ask(token, &format!("GET {path}"), "").0),
            allowed,
            "{path}"
        );
    }
    let (status, refused) = served.get("nobody-nobody-nobody", "/api/v1/robots");
    assert_eq!(status, 401);
    assert!(refused["error"].as_str().unwrap().contains("COTORRA_TOKEN"), "{refused}");
}

#[test]
fn a_domain_gives_instructions_to_its_own_nodes_and_under_its_own_name() {
    let mut served = Domains::serve();
    let scan = json!({ "instruction": { "instruction": "scan", "robot": "robot" } }).to_string();
    assert_eq!(served.ask(TWO, "POST /api/v1/instructions", &scan).0, 403);
    let named = "POST /api/v1/instructions HTTP/1.1\r\nX-Cotorra-Plugin: operator\r\nX-Rest:";
    assert_eq!(served.ask(ONE, named, &scan).0, 403, "nobody goes by another's name");
    assert!(served.core.try_recv().is_err(), "the core heard of neither");
    let core = std::mem::replace(&mut served.core, mpsc::channel().1);
    let answers = std::thread::spawn(move || {
        let Ok(Message::Instruct { given: Given { plugin, .. }, reply }) = core.recv() else {
            panic!("no instruction")
        };
        (reply.expect("the API waits for an answer"))(Ok(()));
        plugin
    });
    assert_eq!(served.ask(ONE, "POST /api/v1/instructions", &scan).0, 200);
    assert_eq!(answers.join().unwrap().as_str(), "one");
}

#[test]
fn real_time_cannot_be_controlled() {
    let served = Domains::serve();
    let (status, clock) = served.get(ONE, "/api/v1/clock");
    assert_eq!(
        (status, &clock["controllable"], &clock["speed"]),
        (200, &false.into(), &1.0.into()),
        "{clock}"
    );
    let change = |token, body| served.ask(token, "POST /api/v1/clock", body).0;
    assert_eq!(change(OPERATOR, r#"{"paused": true}"#), 409);
    assert_eq!(change(ONE, r#"{"paused": true}"#), 403, "time is everyone's");
    for invalid in [
        r#"{"speed": 0}"#,
        r#"{"speed": -1}"#,
        r#"{"speed": 1e9}"#,
        r#"{"step_ms": -1}"#,
        r#"{"step_ms": 1e12}"#,
        r#"{"step_ms": 1, "paused": false}"#,
    ] {
        assert_eq!(change(OPERATOR, invalid), 400, "{invalid}");
    }
    for unreadable in [r#"{"speed": "fast"}"#, r#"{"stop": true}"#] {
        assert_eq!(change(OPERATOR, unreadable), 422, "{unreadable}");
    }
}

#[test]
fn coverage_is_in_circles_and_of_the_callers_own_radio_units() {
    let served = Domains::serve();
    let coverage = |token| {
        let (status, body) = served.get(token, "/api/v1/network/coverage");
        assert_eq!(status, 200, "{body}");
        body.as_array().unwrap().clone()
    };
    let units = |of: &[Value]| of.iter().map(|unit| unit["radio_unit"].clone()).collect::<Vec<_>>();
    let all = coverage(OPERATOR);
    assert_eq!((units(&all), units(&coverage(ONE))), (vec!["A".into(), "B".into()], vec!["A".into()]));
    let circles = all[0]["circles"].as_array().unwrap();
    let of = |name: &str| circles.iter().map(|circle| circle[name].as_f64().unwrap()).collect::<Vec<_>>();
    let (signals, radii) = (of("signal_dbm"), of("radius_m"));
    assert!(radii.len() > 3 && radii.is_sorted() && radii[0] > 0.0, "{radii:?}");
    assert!(signals.iter().rev().is_sorted(), "{signals:?}");
    // From high above, the strongest signals are not on the floor.
    let (_, above) = served.get(OPERATOR, "/api/v1/network/coverage?z=-100");
    assert!(above[0]["circles"].as_array().unwrap().len() < circles.len(), "{above}");
    assert_eq!(served.get(OPERATOR, "/api/v1/network/coverage?z=inf").0, 400);
}

#[test]
fn vnfs_are_added_listed_and_removed() {
    let mut served = Domains::serve();
    let core = std::mem::replace(&mut served.core, mpsc::channel().1);
    let live = served.live.clone();
    // A core that applies everything.
    let obedient = std::thread::spawn(move || {
        let mut heard = Vec::new();
        while let Ok(Message::Instruct { given: Given { plugin, instruction, .. }, reply }) = core.recv() {
            heard.push(format!("{plugin} {}", instruction.name()));
            let decision = cotorra_graph::Decision { plugin, instruction, reason: None, refused: None };
            live.absorb(&Stamped { at: Timestamp::ZERO, event: Event::Decision(decision) });
            (reply.expect("the API waits for an answer"))(Ok(()));
        }
        heard
    });
    let body = |node: &str| {
        json!({ "reason": "more sight", "vnf": {
            "id": format!("detect-{node}"), "program": { "command": ["serve", "--fast"] }, "cpus": 0.5,
            "memory_bytes": 1_000_000, "node": node, "env": ["LEVEL=3"],
            "image": { "reference": "ros:jazzy", "ports": [{ "port": 8080, "transport": "tcp" }] },
        } })
        .to_string()
    };
    assert_eq!(served.ask(ONE, "POST /api/v1/vnfs", &body("left")).0, 200);
    assert_eq!(served.ask(ONE, "POST /api/v1/vnfs", &body("right")).0, 403, "it is another domain's node");
    assert_eq!(served.ask(OPERATOR, "POST /api/v1/vnfs", &body("right")).0, 200);
    assert_eq!(served.ask(OPERATOR, "POST /api/v1/vnfs", "{\"vnf\":{},\"trusted\":true}").0, 422);
    let names = |token| {
        let (status, body) = served.get(token, "/api/v1/vnfs");
        assert_eq!(status, 200, "{body}");
        let names = body.as_array().unwrap().iter().map(|one| one["vnf"]["id"].as_str().unwrap().to_owned());
        names.collect::<Vec<_>>()
    };
    assert_eq!(names(OPERATOR), ["detect-left", "detect-right"]);
    assert_eq!((names(ONE), names(TWO)), (vec!["detect-left".into()], vec!["detect-right".into()]));
    assert_eq!(served.get(ONE, "/api/v1/vnfs").1[0]["node"], "left");
    assert_eq!(served.ask(TWO, "DELETE /api/v1/vnfs/detect-left", "").0, 403);
    assert_eq!(served.ask(TWO, "DELETE /api/v1/vnfs/detect-right", "").0, 200);
    assert_eq!(names(OPERATOR), ["detect-left"]);
    drop(served);
    let heard = ["one add_vnf", "api add_vnf", "two remove_vnf"];
    assert_eq!(obedient.join().unwrap(), heard);
}

#[test]
fn a_domain_has_notifications_posted_to_no_loopback_address() {
    let served = Domains::serve();
    let subscription = json!({
        "subscriptionType": "AssocStaSubscription",
        "apId": { "bssid": "02:77:00:00:00:00" },
        "notificationPeriod": 1,
        "callbackReference": "http://127.0.0.1:9/",
    });
    let subscribe = |token: &str, service: &str| {
        let (_, mut rest) =
            served.ask(token, &format!("POST {service}/subscriptions"), &subscription.to_string());
        let mut body = String::new();
        rest.read_to_string(&mut body).unwrap();
        body
    };
    let refused = "callbacks to 127.0.0.1 are not allowed";
    let said = subscribe(ONE, "/domains/one/wai/v2");
    assert!(said.contains(refused), "{said}");
    let said = subscribe(OPERATOR, "/wai/v2");
    assert!(!said.contains(refused), "{said}");
}

#[test]
fn the_location_api_answers_and_rejects_as_its_standard_says() {
    let served = Domains::serve();
    let subscription = json!({ "userLocationPeriodicSubscription": {
        "subscriptionType": "UserLocationPeriodicSubscription", "address": "acr:robot",
        "periodicEventInfo": { "reportingAmount": 2, "reportingInterval": 1 },
        "websockNotifConfig": { "requestWebsocketUri": true },
    } })
    .to_string();
    for (request, body, expected, part) in [
        ("GET /queries/zones", "", 200, "zoneList"),
        ("GET /queries/users?address=acr:robot&address=acr:none", "", 200, "userList"),
        ("GET /queries/users?name=robot", "", 400, "there are zoneId, accessPointId, address"),
        ("GET /queries/zones/none?x=1", "", 400, "there are none"),
        ("GET /queries/zones/none/accessPoints", "", 404, "no zone `none`"),
        ("GET /queries/distance?address=acr:robot", "", 400, "two addresses"),
        ("GET /queries/distance?address=acr:robot&latitude=91&longitude=2", "", 400, "from -90 to 90"),
        ("GET /queries/distance?address=acr:none&address=acr:robot", "", 404, "acr:none"),
        ("GET /subscriptions/zones?subscription_type=periodic", "", 400, "event or status"),
        ("GET /subscriptions/area", "", 200, "notificationSubscriptionList"),
        ("GET /subscriptions/area?address=acr:robot", "", 400, "no parameter `address`"),
        ("POST /subscriptions/zones", &*subscription, 400, "belongs to subscriptions/users"),
        ("POST /subscriptions/users", &subscription, 201, "/location/v2/subscriptions/users/1/websocket"),
        ("GET /subscriptions/users?subscription_type=periodic", "", 200, "/subscriptions/users/1"),
        ("GET /subscriptions/zones/1", "", 404, "no subscription `1`"),
        ("PUT /subscriptions/users/1", &subscription, 200, "UserLocationPeriodicSubscription"),
        ("DELETE /subscriptions/users/1", "", 204, ""),
        ("GET /subscriptions/users/1", "", 404, "no subscription `1`"),
    ] {
        let (status, mut rest) = served.ask(OPERATOR, &request.replacen(' ', " /location/v2", 1), body);
        let mut answer = String::new();
        rest.read_to_string(&mut answer).unwrap();
        assert_eq!(status, expected, "{request}: {answer}");
        assert!(answer.contains(part), "{request}: {answer}");
    }
}

#[test]
fn bandwidth_management_rejects_as_its_standard_says() {
    let served = Domains::serve();
    let info = json!({ "appInsId": "nobody", "requestType": 0, "fixedAllocation": "1", "allocationDirection": "00" });
    let with_priority = json!({ "fixedBWPriority": "SEE_DESCRIPTION", "appInsId": "nobody", "requestType": 0,
        "fixedAllocation": "1", "allocationDirection": "00" });
    for (request, body, expected, part) in [
        ("GET /bw_allocations", "", 200, "[]"),
        ("GET /bw_allocations?name=x", "", 400, "there are app_instance_id, app_name, session_id"),
        ("GET /bw_allocations/1", "", 404, "no allocation `1`"),
        ("DELETE /bw_allocations/1", "", 404, "no allocation `1`"),
        ("POST /bw_allocations", "{}", 400, "appInsId"),
        ("POST /bw_allocations", &info.to_string(), 400, "no application `nobody`"),
        ("POST /bw_allocations", &with_priority.to_string(), 422, "not priorities"),
        ("PUT /bw_allocations/1", &info.to_string(), 404, "no allocation `1`"),
        ("PATCH /bw_allocations/1", &info.to_string(), 404, "no allocation `1`"),
        ("GET /allocations", "", 404, "no such path"),
    ] {
        let (status, mut rest) = served.ask(OPERATOR, &request.replacen(' ', " /bwm/v1", 1), body);
        let mut answer = String::new();
        rest.read_to_string(&mut answer).unwrap();
        assert_eq!(status, expected, "{request}: {answer}");
        assert!(answer.contains(part), "{request}: {answer}");
    }
}

#[test]
fn no_caller_can_pose_as_a_plugin_of_the_run() {
    let mut served = Domains::serve();
    let scan = json!({ "instruction": { "instruction": "scan", "robot": "robot" } }).to_string();
    let instruct = |served: &Domains, token: &str, name: &str| {
        let head = format!("POST /api/v1/instructions HTTP/1.1\r\nX-Cotorra-Plugin: {name}\r\nX-Rest:");
        served.ask(token, &head, &scan).0
    };
    let watcher: PluginId = "watcher".parse().unwrap();
    let secret = served.server.plugins().of(&watcher).unwrap().secret().to_owned();
    assert!(served.server.plugins().of(&"probing".parse().unwrap()).is_none(), "it is in process");
    for (token, name) in [
        (OPERATOR, "probing"),
        (OPERATOR, "watcher"),
        (ONE, "probing"),
        (&secret, "probing"),
        (&secret, "operator"),
    ] {
        assert_eq!(instruct(&served, token, name), 403, "{name}");
    }
    assert_eq!(served.get("X-no-secret-of-a-plugin", "/api/v1/robots").0, 401);
    assert!(served.core.try_recv().is_err(), "the core heard of none");

    let core = std::mem::replace(&mut served.core, mpsc::channel().1);
    let names = std::thread::spawn(move || {
        let answer = |message| {
            let Message::Instruct { given: Given { plugin, .. }, reply } = message else {
                panic!("no instruction")
            };
            (reply.expect("the API waits for an answer"))(Ok(()));
            plugin.to_string()
        };
        core.iter().take(3).map(answer).collect::<Vec<_>>()
    });
    assert_eq!(served.ask(&secret, "POST /api/v1/instructions", &scan).0, 200);
    assert_eq!(instruct(&served, &secret, "watcher"), 200);
    assert_eq!(instruct(&served, OPERATOR, "mine"), 200);
    assert_eq!(names.join().unwrap(), ["watcher", "watcher", "mine"]);
}

#[test]
fn a_domains_stream_has_no_events_of_others() {
    let served = Domains::serve();
    let (status, mut one) = served.ask(ONE, "GET /api/v1/events", "");
    let (_, mut two) = served.ask(TWO, "GET /api/v1/events", "");
    assert_eq!(status, 200);
    let lateness = || Stamped { at: Timestamp::from_nanos(9), event: Event::Lateness(Default::default()) };
    for event in [sample(1), notice(2), lateness()] {
        served.events.send(Arc::new(event));
    }
    let first = |stream: &mut BufReader<TcpStream>| {
        let mut line = String::new();
        while !line.starts_with("data:") {
            line.clear();
            stream.read_line(&mut line).unwrap();
        }
        serde_json::from_str::<Value>(&line["data:".len()..]).unwrap()["event"].clone()
    };
    assert_eq!((first(&mut one), first(&mut one)), (json!("service_time"), json!("lateness")));
    assert_eq!(first(&mut two), "lateness");
}

const FEW: Limits = Limits { strangers: 16, callers: 8 };

/// Opens a connection that sends this text and no more.
fn say(server: &Server, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(server.dashboard().address()).unwrap();
    stream.write_all(text.as_bytes()).unwrap();
    stream
}

/// Reads until the connection is closed, in whatever way.
fn until_closed(mut stream: TcpStream) -> String {
    let mut said = Vec::new();
    let _ = stream.read_to_end(&mut said);
    String::from_utf8(said).unwrap()
}

#[test]
fn requests_wait_until_the_api_is_open() {
    let early =
        |served: &Domains| say(&served.server, "GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n");
    let never_open = Domains::prepare(None);
    let request = early(&never_open);
    drop(never_open);
    assert_eq!(until_closed(request), "");
    let mut served = Domains::prepare(None);
    let request = early(&served);
    served.server.open();
    assert_eq!(answer(request).0, 200);
}

#[test]
fn unfinished_requests_keep_nobody_from_being_answered() {
    let served = serve_within(false, FEW, Patience::default());
    let mut open = Vec::new();
    for part in
        ["", "GET /api/v1/robots HTTP/1.1\r\n", "GET /api/v1/robots HTTP/1.1\r\nHost: localhost\r\nX: "]
    {
        open.extend((0..150).map(|_| say(&served.server, part)));
        assert_eq!(served.answer("robots"), json!([]));
    }
    // Only as many as are allowed for one address.
    open.truncate(450 - FEW.strangers / 2);
    for stream in open {
        assert_eq!(until_closed(stream), "");
    }
}

#[test]
fn callers_without_a_token_keep_nobody_from_being_answered() {
    let served = Domains::serve();
    let request = "GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let refused: Vec<_> = (0..300).map(|_| say(&served.server, request)).collect();
    assert_eq!(served.get(OPERATOR, "/api/v1/robots").0, 200);
    for stream in refused {
        let said = until_closed(stream);
        assert!(said.is_empty() || said.starts_with("HTTP/1.1 401 "), "{said}");
    }
}

#[test]
fn a_stalled_request_is_given_up() {
    let at_once = std::time::Duration::from_millis(1);
    let patience = Patience { head: at_once, ..Patience::default() };
    let served = serve_within(false, FEW, patience);
    assert_eq!(until_closed(say(&served.server, "GET / HTTP/1.1\r\nHost: ")), "");
    assert_eq!(until_closed(say(&served.server, "")), "");

    let patience = Patience { body: at_once, ..Patience::default() };
    let served = serve_within(false, FEW, patience);
    let post = "POST /api/v1/instructions HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{";
    let (status, _) = answer(say(&served.server, post));
    assert_eq!(status, 408);
}

#[test]
fn requests_are_bounded_in_length() {
    let served = serve(false);
    let long = "x".repeat(64 << 10);
    let head = format!("GET / HTTP/1.1\r\nHost: localhost\r\nX: {long}\r\n\r\n");
    let said = until_closed(say(&served.server, &head));
    assert!(said.is_empty() || said.starts_with("HTTP/1.1 431 "), "{said}");
    let post = "POST /api/v1/instructions HTTP/1.1\r\nHost: localhost\r\nContent-Length: 300000\r\n\r\n{";
    let (status, _) = answer(say(&served.server, post));
    assert_eq!(status, 413);
    let post = "POST /api/v1/instructions HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n";
    let mut stream = say(&served.server, post);
    for _ in 0..4 {
        write!(stream, "{:x}\r\n{long}\r\n", long.len()).unwrap();
    }
    // One byte more than the limit.
    stream.write_all(b"1\r\nx\r\n").unwrap();
    assert_eq!(answer(stream).0, 413);
}

#[test]
fn a_reader_that_takes_nothing_is_cut_off() {
    let at_once = std::time::Duration::from_millis(1);
    let served = serve_within(false, FEW, Patience { answer: at_once, ..Patience::default() });
    let (status, stalled) = served.open("events");
    assert_eq!(status, 200);
    // The kernel's buffers fill up at some time; then the reader has a millisecond.
    for at in 0.. {
        served.events.send(Arc::new(notice(at)));
        // Those that are left follow applications and allocations.
        if served.events.readers() == 2 {
            break;
        }
    }
    drop(stalled);
}

#[test]
fn streams_leave_places_for_requests() {
    let served = serve_within(false, FEW, Patience::default());
    let streams: Vec<_> = (0..10).map(|_| served.open("events")).collect();
    let of = |status| streams.iter().filter(|(this, _)| *this == status).count();
    assert_eq!((of(200), of(429)), (4, 6));
    // Requests take each other's places.
    let idle: Vec<_> = (0..20)
        .map(|_| answer(say(&served.server, "GET /api/v1/robots HTTP/1.1\r\nHost: localhost\r\n\r\n")))
        .collect();
    assert!(idle.iter().all(|(status, _)| *status == 200));
    assert_eq!(served.answer("robots"), json!([]));
    // Two more receivers follow applications and allocations.
    assert_eq!(served.events.readers(), 4 + 2, "no stream was closed for them");
}

#[test]
fn the_document_has_every_path() {
    let document: Value = serde_json::from_str(&openapi()).unwrap();
    let documented: BTreeSet<_> = document["paths"].as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(documented, paths().iter().map(|(path, _)| *path).collect());
}

#[test]
fn tools_of_the_user_find_a_run_where_nobody_else_can_listen() {
    let folder = tempfile::tempdir().unwrap();
    let runs = Runs::in_folder(folder.path().join("cotorra"));
    let served = serve_to_user(&runs, 64, 64);
    let run = runs.find(Some(&served.server.dashboard().address().to_string())).unwrap();
    assert_eq!((run.api, &*run.what), (served.server.dashboard().address(), "/runs/served"));
    let client = cotorra_plugin::client::Client::of(&run).unwrap();
    assert_eq!(client.testbed().unwrap().name, "served");
    assert_eq!(client.service_times(&Default::default()).unwrap().items.len(), 20);
    let refused = client.node(&"nobody".parse().unwrap()).unwrap_err();
    assert!(refused.to_string().contains("there is no node `nobody`"), "{refused}");
    drop(served);
    assert!(runs.find(None).is_err());
}

#[test]
fn by_default_only_the_user_is_the_operator() {
    let folder = tempfile::tempdir().unwrap();
    let runs = Runs::in_folder(folder.path().join("cotorra"));
    let served = serve_to_user(&runs, 64, 64);
    let port = |method: &str, path: &str, token: &str, body: &str| {
        let mut stream = TcpStream::connect(served.server.dashboard().address()).unwrap();
        let length = body.len();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\nContent-Type: \
             application/json\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        )
        .unwrap();
        let (status, mut answer) = answer(stream);
        let mut text = String::new();
        answer.read_to_string(&mut text).unwrap();
        (status, serde_json::from_str::<Value>(&text).unwrap_or_default())
    };
    // Another user of this machine, on the port.
    let add = r#"{"vnf": {"id": "spy", "command": ["cat", "/etc/shadow"]}}"#;
    for token in ["", "0123456789abcdef0123456789abcdef"] {
        assert_eq!(port("POST", "/api/v1/vnfs", token, add).0, 401, "{token}");
        assert_eq!(port("GET", "/api/v1/testbed", token, "").0, 401, "{token}");
        assert_eq!(port("POST", "/api/v1/sign-in/pages", token, "").0, 401, "{token}");
    }
    assert_eq!(port("GET", "/wai/v2/queries/ap/ap_information", "", "").0, 401);
    assert_eq!(port("GET", "/fog05/node", "", "").0, 401);
    // The user signs a page in, without that anybody types anything.
    let client = cotorra_plugin::client::Client::of(&runs.find(None).unwrap()).unwrap();
    let page = client.sign_in().unwrap();
    let code = page.address.split_once('#').unwrap().1;
    assert!(std::fs::read_to_string(&page.file).unwrap().contains(code));
    let redeem = || port("POST", "/api/v1/sign-in", "", &json!({ "code": code }).to_string());
    let (status, body) = redeem();
    let token = body["token"].as_str().unwrap();
    assert_eq!((status, port("GET", "/api/v1/testbed", token, "").0), (200, 200));
    assert_eq!(port("GET", "/api/v1/testbed", code, "").0, 401, "the code is no token");
    assert_eq!(redeem().0, 401, "the code works once");
}

#[test]
fn the_users_socket_needs_the_token_too() {
    let folder = tempfile::tempdir().unwrap();
    let runs = Runs::in_folder(folder.path().join("cotorra"));
    let served = Domains::serve_found_in(Some(&runs));
    let client = || cotorra_plugin::client::Client::of(&runs.find(None).unwrap()).unwrap();
    let nodes = |token: &str| client().with_token(token).testbed().map(|testbed| testbed.graph.nodes.len());
    assert_eq!((nodes(OPERATOR).unwrap(), nodes(ONE).unwrap()), (5, 3));
    assert!(client().testbed().is_err() && nodes("wrong-wrong-wrong").is_err());
    drop(served);
}

#[test]
fn strangers_on_the_port_take_no_place_from_the_users_tools() {
    let folder = tempfile::tempdir().unwrap();
    let runs = Runs::in_folder(folder.path().join("cotorra"));
    let served = serve_to_user(&runs, 16, 16);
    // Both connected first, and send nothing yet.
    let mut early = TcpStream::connect(served.server.dashboard().address()).unwrap();
    let mut tool = runs.find(None).unwrap().connect().unwrap();
    let flood: Vec<_> =
        (0..64).map(|_| TcpStream::connect(served.server.dashboard().address()).unwrap()).collect();
    // Closed: the flood was accepted before anything else was sent.
    let mut end = Vec::new();
    let _ = early.read_to_end(&mut end);
    assert!(end.is_empty());
    tool.write_all(b"GET /api/v1/testbed HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    tool.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
    drop(flood);
}

#[test]
fn a_taken_port_says_what_to_do() {
    let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap();
    let Err(error) = Listener::bind(address, false, &Tokens::default(), &Encryption::Off) else {
        panic!("two programs have {address}")
    };
    let error = error.to_string();
    assert!(error.contains(&address.to_string()) && error.contains("name another port"), "{error}");
}

#[test]
fn captures_stream_the_packets_of_a_link() {
    let served = serve(false);
    let (status, mut stream) = served.open("network/captures/left-ap?filter=arp&snap_bytes=40");
    assert_eq!(status, 200);
    // The length of a chunk, and the first block.
    let mut line = String::new();
    stream.read_line(&mut line).unwrap();
    let mut first = vec![0; usize::from_str_radix(line.trim(), 16).unwrap() + 2];
    stream.read_exact(&mut first).unwrap();
    assert_eq!(first[..4], [0x0a, 0x0d, 0x0d, 0x0a]);
    let mut fabric = served.fabric.lock();
    let own = HostAddress::of(0);
    let mut other = vec![0; 60];
    other[..6].copy_from_slice(&HostAddress::of(1).mac);
    other[6..12].copy_from_slice(&own.mac);
    let mut arp = other.clone();
    arp[12..22].copy_from_slice(&[8, 6, 0, 1, 8, 0, 6, 4, 0, 1]);
    arp[22..28].copy_from_slice(&own.mac);
    arp[28..32].copy_from_slice(&own.ipv4.octets());
    let second = Timestamp::from_secs_f64(1.0);
    fabric.push(second, PortId(0), Frame::new(other));
    fabric.push(second, PortId(0), Frame::new(arp.clone()));
    fabric.poll(Timestamp::from_secs_f64(2.0), &mut |_, _| {});
    drop(fabric);
    line.clear();
    stream.read_line(&mut line).unwrap();
    let mut blocks = vec![0; usize::from_str_radix(line.trim(), 16).unwrap() + 2];
    stream.read_exact(&mut blocks).unwrap();
    let packets = blocks.windows(40).filter(|part| *part == &arp[..40]).count();
    assert_eq!((packets, blocks.windows(41).any(|part| part == &arp[..41])), (1, false));
    let comment = b"entered 1.000000000 s, due 1.";
    assert!(blocks.windows(comment.len()).any(|part| part == comment));
}

#[test]
fn captures_that_cannot_be_are_rejected() {
    let served = serve(false);
    let (status, body) = served.get("network/captures/nothing");
    assert_eq!((status, body["error"].as_str()), (404, Some("there is no link or node `nothing`")));
    let (status, body) = served.get("network/captures/left?filter=host%20nobody");
    assert_eq!(status, 400);
    assert!(body["error"].as_str().unwrap().contains("there is no host `nobody`"), "{body}");
    let open: Vec<_> = (0..16).map(|_| served.open("network/captures/left")).collect();
    assert!(open.iter().all(|(status, _)| *status == 200));
    let (status, body) = served.get("network/captures/left");
    assert_eq!(status, 429);
    assert!(body["error"].as_str().unwrap().starts_with("16 captures are under way"), "{body}");
    let served = serve_within(false, Limits { strangers: 64, callers: 4 }, Patience::default());
    let open: Vec<_> = (0..3).map(|_| served.open("network/captures/left")).collect();
    assert_eq!(open.iter().map(|(status, _)| *status).collect::<Vec<_>>(), [200, 200, 429]);
    // Without packets, and for a domain, whose links carry those of others, too.
    let served = Domains::serve();
    let path = "/api/v1/network/captures/left";
    assert_eq!(served.get(OPERATOR, path).0, 409);
    assert_eq!(served.get(ONE, path).0, 403);
}
