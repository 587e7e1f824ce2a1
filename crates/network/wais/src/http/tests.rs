//! Tests the service over real sockets: answers to requests, and notifications to consumers. The tests set the time.

use std::{
    collections::BTreeSet,
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc,
    },
    time::Duration,
};

use cotorra_graph::Timestamp;
use cotorra_mec::{Allowed, Delivery, Epoch, Testbed, deliver};
use parking_lot::Mutex;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite;

use super::*;
use crate::{
    survey::{Scope, Site, Survey},
    testing,
};

/// A testbed whose state never changes, at a time set by the test or advancing at each look.
struct Still {
    now: AtomicU64,
    step: AtomicU64,
    told: Mutex<mpsc::Sender<String>>,
}

impl Testbed<Wais> for Still {
    fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.now.fetch_add(self.step.load(Ordering::SeqCst), Ordering::SeqCst))
    }

    fn survey(&self, site: &Arc<Site>) -> Survey {
        testing::survey(site, 0.0, &[("r1", Some("west"), 65.0), ("r2", Some("west"), 6.5)])
    }

    fn freshness(&self) -> Duration {
        Duration::ZERO
    }

    fn tell(&self, message: String) {
        let _ = self.told.lock().send(message);
    }
}

struct Served {
    address: SocketAddr,
    testbed: Arc<Still>,
    told: mpsc::Receiver<String>,
    _delivery: Delivery,
}

fn serve() -> Served {
    let (tell, told) = mpsc::channel();
    let testbed = Arc::new(Still { now: AtomicU64::new(0), step: AtomicU64::new(0), told: Mutex::new(tell) });
    let known = testing::testbed();
    let site = Site::new(&known.graph, &known.wais, &Scope::Testbed);
    let as_dyn: Arc<dyn Testbed<Wais>> = testbed.clone();
    let wais = Wais::new(Arc::new(site), Epoch::default());
    let service = Service::new(as_dyn, wais, Allowed::new([]).and_loopback(), "/wai/v2".to_owned());
    let app = Router::new().nest("/wai/v2", router(&service));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            axum::serve(tokio::net::TcpListener::from_std(listener).unwrap(), app).await.unwrap();
        });
    });
    Served { address, testbed, told, _delivery: Delivery::start([deliver(service)]).unwrap() }
}

/// Status, head in lower case, and body of an answer.
type Answered = (u16, String, Value);

impl Served {
    fn ask(&self, method: &str, path: &str, head: &[&str], body: &str) -> Answered {
        let mut stream = TcpStream::connect(self.address).unwrap();
        let mut request =
            format!("{method} /wai/v2{path} HTTP/1.1\r\nHost: wais.lab\r\nConnection: close\r\n");
        head.iter().for_each(|line| request += &format!("{line}\r\n"));
        request += &format!("Content-Length: {}\r\n\r\n{body}", body.len());
        // An answer may arrive before the whole body is sent.
        let _ = stream.write_all(request.as_bytes());
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let answer = String::from_utf8(answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let body = if body.is_empty() { Value::Null } else { serde_json::from_str(body).unwrap() };
        (status, head.to_ascii_lowercase(), body)
    }

    fn post(&self, path: &str, body: &Value) -> Answered {
        self.ask("POST", path, &["Content-Type: application/json"], &body.to_string())
    }

    fn go_on(&self, seconds: f64) {
        self.testbed.now.store((seconds * 1e9) as u64, Ordering::SeqCst);
    }
}

fn subscription(change: &Value) -> Value {
    let mut body = json!({
        "subscriptionType": "AssocStaSubscription",
        "apId": { "bssid": "02:77:00:00:00:04" },
        "notificationPeriod": 1,
    });
    body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
    body
}

fn websocket() -> Value {
    subscription(&json!({ "websockNotifConfig": { "requestWebsocketUri": true } }))
}

fn etag(head: &str) -> String {
    head.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap().to_owned()
}

#[test]
fn every_error_is_a_problem_of_the_standard() {
    let served = serve();
    let json_head = ["Content-Type: application/json"];
    let long = format!("/subscriptions?x={}", "y".repeat(9000));
    let large = "x".repeat(70_000);
    let elsewhere = subscription(&json!({ "callbackReference": "http://192.0.2.1/" })).to_string();
    let statistics = json!({
        "measurementId": "x", "staId": [{ "macId": "02:77:00:00:00:01" }],
        "measurementInfo": { "staStatisticsConf": { "groupIdentity": 0, "triggeredReport": false } },
    })
    .to_string();
    for (method, path, head, body, expected, part) in [
        ("GET", "/queries/ap/ap_information?filter=(eq,x,1)", &[][..], "", 400, "no attribute `x`"),
        ("GET", "/queries/ap/ap_information?filters=x", &[], "", 400, "no parameter `filters`"),
        ("GET", "/queries/ap/ap_information?fields=a&fields=b", &[], "", 400, "given twice"),
        ("GET", "/queries/sta/sta_information?exclude_fields=staId", &[], "", 400, "cannot be left out"),
        ("GET", "/subscriptions?subscription_type=x", &[], "", 400, "assoc_sta"),
        ("GET", "/subscriptions/%ff", &[], "", 400, "UTF-8"),
        ("POST", "/subscriptions", &json_head, "{", 400, "EOF"),
        ("POST", "/subscriptions", &json_head, &elsewhere, 403, "192.0.2.1 are not allowed"),
        ("GET", "/subscriptions/7", &[], "", 404, "no subscription `7`"),
        ("GET", "/subscriptions/x/websocket", &[], "", 404, "no WebSocket of a subscription `x`"),
        ("PUT", "/measurements/7", &json_head, "{}", 404, "no measurement configuration `7`"),
        ("GET", "/nothing", &[], "", 404, "no such path"),
        ("PATCH", "/subscriptions", &[], "", 405, "`Allow`"),
        ("GET", "/subscriptions", &["Accept: text/html"], "", 406, "application/json"),
        ("POST", "/subscriptions", &json_head, &large, 413, "65536 bytes"),
        ("GET", &long, &[], "", 414, "8000 bytes"),
        (
            "POST",
            "/subscriptions",
            &["Content-Type: text/plain"],
            "{}",
            415,
            "Content-Type: application/json",
        ),
        ("POST", "/measurements", &json_head, &statistics, 422, "does not have the IEEE 802.11 counters"),
    ] {
        let (status, head, problem) = served.ask(method, path, head, body);
        assert_eq!(status, expected, "{method} {path}: {problem}");
        assert!(head.contains("content-type: application/problem+json"), "{head}");
        assert_eq!((&problem["status"], &problem["type"]), (&json!(expected), &json!("about:blank")));
        assert!(problem["detail"].as_str().unwrap().contains(part), "{method} {path}: {problem}");
        assert_eq!(status == 405, head.contains("allow: "), "{head}");
    }
    // Too many changes must wait.
    let (limited, head, _) = (0..600)
        .map(|_| served.ask("DELETE", "/subscriptions/7", &[], ""))
        .find(|(status, ..)| *status != 404)
        .expect("there is a limit");
    assert_eq!(limited, 429);
    assert!(head.contains("retry-after: 1"), "{head}");
}

#[test]
fn entity_tags_save_answers_and_guard_changes() {
    let served = serve();
    let query = "/queries/sta/sta_information?filter=(gt,rssi/rssi,10)";
    let (status, head, body) = served.ask("GET", query, &[], "");
    assert_eq!((status, body.as_array().unwrap().len()), (200, 2));
    let known = format!("If-None-Match: {}", etag(&head));
    assert_eq!(served.ask("GET", query, &[&known], "").0, 304);

    let (status, head, made) = served.post("/subscriptions", &websocket());
    assert_eq!(status, 201, "{made}");
    assert!(head.contains("location: http://wais.lab/wai/v2/subscriptions/1"), "{head}");
    let (first, body) = (etag(&head), websocket().to_string());
    let known = format!("If-None-Match: {first}");
    assert_eq!(served.ask("GET", "/subscriptions/1", &[&known], "").0, 304);
    let guarded = format!("If-Match: {first}");
    let put =
        |head: &str| served.ask("PUT", "/subscriptions/1", &["Content-Type: application/json", head], &body);
    assert_eq!(put(&guarded).0, 200);
    assert_eq!(put(&guarded).0, 412, "it was changed by that");
    assert_eq!(served.ask("DELETE", "/subscriptions/1", &[&guarded], "").0, 412);
    let (_, _, list) = served.ask("GET", "/subscriptions?subscription_type=assoc_sta", &[], "");
    assert_eq!(list["subscription"][0]["href"], "http://wais.lab/wai/v2/subscriptions/1");
    assert_eq!(served.ask("DELETE", "/subscriptions/1", &[], "").0, 204);
    assert_eq!(served.ask("GET", "/subscriptions/1", &[], "").0, 404);
}

/// Receives one notification as a consumer's server, and answers.
fn take(listener: &TcpListener, answer: &str) -> (String, Value) {
    let (stream, _) = listener.accept().unwrap();
    let mut reader = BufReader::new(stream);
    let (mut head, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        if let Some(n) = line.to_ascii_lowercase().strip_prefix("content-length: ") {
            length = n.trim().parse().unwrap();
        }
        if line == "\r\n" {
            break;
        }
        head += &line;
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).unwrap();
    reader
        .into_inner()
        .write_all(format!("HTTP/1.1 {answer}\r\nContent-Length: 0\r\n\r\n").as_bytes())
        .unwrap();
    (head, serde_json::from_slice(&body).unwrap())
}

#[test]
fn callbacks_are_posted_retried_and_never_redirected() {
    let served = serve();
    let consumer = TcpListener::bind("127.0.0.1:0").unwrap();
    let uri = format!("http://{}/told?by=wais", consumer.local_addr().unwrap());
    let body = subscription(&json!({ "callbackReference": uri, "requestTestNotification": true }));
    assert_eq!(served.post("/subscriptions", &body).0, 201);
    let (head, test) = take(&consumer, "503 Service Unavailable");
    assert!(head.starts_with("POST /told?by=wais HTTP/1.1\r\n"), "{head}");
    assert!(head.to_ascii_lowercase().contains("content-type: application/json"), "{head}");
    assert_eq!(test["notificationType"], "TestNotification");
    assert_eq!(test["_links"]["subscription"]["href"], "http://wais.lab/wai/v2/subscriptions/1");
    served.testbed.step.store(20_000_000, Ordering::SeqCst);
    let (_, again) = take(&consumer, "204 No Content");
    assert_eq!(again, test);
    let (_, first) = take(&consumer, "302 Found\r\nLocation: http://127.0.0.1:1/");
    assert_eq!(first["staId"].as_array().unwrap().len(), 2, "{first}");
    let complaint = served.told.recv().unwrap();
    assert!(complaint.contains("answered 302"), "{complaint}");
    let (_, second) = take(&consumer, "204 No Content");
    assert_eq!(second["notificationType"], "AssocStaNotification");
}

#[test]
fn hanging_consumers_delay_nobody_else() {
    let served = serve();
    let hanging = TcpListener::bind("127.0.0.1:0").unwrap();
    let consumer = TcpListener::bind("127.0.0.1:0").unwrap();
    for listener in [&hanging, &consumer] {
        let uri = format!("http://{}/", listener.local_addr().unwrap());
        served.post("/subscriptions", &subscription(&json!({ "callbackReference": uri })));
    }
    for second in 1..=5 {
        served.go_on(f64::from(second));
        let (_, told) = take(&consumer, "204 No Content");
        assert_eq!(told["notificationType"], "AssocStaNotification");
        assert_eq!(served.ask("GET", "/subscriptions", &[], "").0, 200);
    }
    // It was called once, and never answered.
    drop(hanging.accept().unwrap());
}

#[test]
fn websockets_deliver_notifications_and_close_with_their_subscription() {
    let served = serve();
    let (_, _, made) = served.post("/subscriptions", &websocket());
    let uri = made["websockNotifConfig"]["websocketUri"].as_str().unwrap();
    let uri = uri.replace("wais.lab", &served.address.to_string());
    let (status, _, problem) = served.ask("GET", "/subscriptions/1/websocket", &[], "");
    assert_eq!(status, 400, "{problem}");
    let open = || tungstenite::client(&uri, TcpStream::connect(served.address).unwrap()).unwrap().0;
    let mut older = open();
    let mut socket = open();
    while !matches!(older.read(), Ok(tungstenite::Message::Close(_)) | Err(_)) {}
    for second in 1..=3 {
        served.go_on(f64::from(second));
        let told: Value = serde_json::from_str(socket.read().unwrap().to_text().unwrap()).unwrap();
        assert_eq!(
            (&told["notificationType"], &told["apId"]["bssid"]),
            (&json!("AssocStaNotification"), &json!("02:77:00:00:00:04"))
        );
    }
    assert_eq!(served.ask("DELETE", "/subscriptions/1", &[], "").0, 204);
    while !matches!(socket.read(), Ok(tungstenite::Message::Close(_)) | Err(_)) {}
    assert_eq!(served.ask("GET", "/subscriptions/1/websocket", &[], "").0, 404);
}

#[test]
fn openapi_document_has_every_resource() {
    let document: Value = serde_json::from_str(&openapi()).unwrap();
    let paths: Vec<_> = document["paths"].as_object().unwrap().keys().map(String::as_str).collect();
    let own = BTreeSet::from(resources().map(|(path, _)| path));
    let beside = BTreeSet::from_iter(paths.clone()).difference(&own).copied().collect::<Vec<_>>();
    assert_eq!(beside, ["/subscriptions/{subscriptionId}"]);
    assert_eq!(
        paths,
        [
            "/measurements",
            "/measurements/{measurementConfigId}",
            "/queries/ap/ap_information",
            "/queries/sta/sta_information",
            "/subscriptions",
            "/subscriptions/{subscriptionId}",
        ]
    );
}
