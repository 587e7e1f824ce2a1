//! Applications over the routes of fog05 and of MEC 010-2, against a core that applies everything.

use std::{net::TcpListener, thread::JoinHandle};

use super::*;

/// A served testbed, and what its core hears.
struct Applications {
    served: Domains,
    heard: JoinHandle<Vec<String>>,
}

impl Applications {
    fn serve() -> Self {
        let mut served = Domains::serve();
        let core = std::mem::replace(&mut served.core, mpsc::channel().1);
        let live = served.live.clone();
        let heard = std::thread::spawn(move || {
            let mut heard = Vec::new();
            while let Ok(Message::Instruct { given: Given { instruction, .. }, reply }) = core.recv() {
                let refused = match &instruction {
                    cotorra_graph::Instruction::AddVnf { vnf } if vnf.env.iter().any(|v| v == "REFUSE=1") => {
                        Some("the node is full".to_owned())
                    }
                    _ => None,
                };
                let about = match &instruction {
                    cotorra_graph::Instruction::AddVnf { vnf } => {
                        format!("add {} {}", vnf.node, vnf.env.join(" "))
                    }
                    cotorra_graph::Instruction::Place { node, .. } => format!("place {node}"),
                    other => other.name().to_owned(),
                };
                heard.push(about);
                let placed = match &instruction {
                    cotorra_graph::Instruction::Place { vnf, node } if refused.is_none() => {
                        Some(cotorra_graph::Placement { vnf: vnf.clone(), node: node.clone() })
                    }
                    _ => None,
                };
                let plugin = "api".parse().unwrap();
                let event =
                    cotorra_graph::Decision { plugin, instruction, reason: None, refused: refused.clone() };
                live.absorb(&Stamped { at: Timestamp::ZERO, event: Event::Decision(event) });
                // Its instance is there at once.
                if let Some(placed) = placed {
                    live.absorb(&Stamped { at: Timestamp::ZERO, event: Event::Placement(placed) });
                }
                let done =
                    refused.map_or(Ok(()), |reason| Err(cotorra_network_control::InstructionError(reason)));
                (reply.expect("the API waits for an answer"))(done);
            }
            heard
        });
        Self { served, heard }
    }

    fn ask(&self, token: &str, head: &str, body: &str) -> (u16, Value) {
        let (status, mut answer) = self.served.ask(token, head, body);
        let mut text = String::new();
        answer.read_to_string(&mut text).unwrap();
        let text = if text.is_empty() { "null" } else { &text };
        (status, serde_json::from_str(text).unwrap_or_else(|e| panic!("{head}: {e}: {text}")))
    }

    fn ok(&self, head: &str, body: &str) -> Value {
        let (status, answer) = self.ask(OPERATOR, head, body);
        assert!((200..300).contains(&status), "{head}: {status} {answer}");
        answer
    }

    /// Lets the VNF of an instance serve, or fail.
    fn vnf(&self, vnf: &Value, state: cotorra_graph::VnfState) {
        let event = cotorra_graph::VnfEvent {
            vnf: vnf.as_str().unwrap().parse().unwrap(),
            node: "left".parse().unwrap(),
            state,
            detail: Some("why".to_owned()),
        };
        let event = Stamped { at: Timestamp::ZERO, event: Event::Vnf(event) };
        self.served.live.absorb(&event);
        self.served.events.send(Arc::new(event));
    }

    /// The VNF of an instance.
    fn vnf_of(&self, instance: &str) -> Value {
        self.ok(&format!("GET /fog05/fdu/instances/{instance}/info"), "")["hypervisor_info"]["vnf"].clone()
    }

    fn heard(self) -> Vec<String> {
        drop(self.served);
        self.heard.join().unwrap()
    }
}

fn fdu() -> String {
    json!({
        "id": "detector", "name": "detector", "hypervisor": "DOCKER", "migration_kind": "COLD",
        "computation_requirements": { "cpu_min_count": 1, "ram_size_mb": 64.0 }, "image": { "uri": "a:1" },
        "storage": [], "interfaces": [], "io_ports": [], "connection_points": [], "depends_on": [],
    })
    .to_string()
}

fn net() -> String {
    json!({ "uuid": "n1", "name": "net", "net_type": "ELAN", "is_mgmt": false }).to_string()
}

#[test]
fn networks_are_added_to_nodes_and_removed_over_the_routes_of_fog05() {
    let all = Applications::serve();
    let record = all.ok("PUT /fog05/networks/n1/info", &net());
    assert_eq!(record["ip_configuration"]["subnet"], "10.77.0.0/16");
    assert_eq!(all.ok("GET /fog05/network/list", ""), json!([record]));
    assert_eq!(all.ok("GET /fog05/networks/n1/info", ""), record);
    // By its descriptor, as the first of its kind, and by its identifier.
    let other = net().replace("n1", "n2");
    let at_left = all.ok("PUT /fog05/nodes/left/network/n2/info", &other);
    assert_eq!(at_left["properties"]["nodes"], json!(["left"]));
    let at_both = all.ok("PUT /fog05/nodes/right/network/n2/info", "");
    assert_eq!(at_both["properties"]["nodes"], json!(["left", "right"]));
    let at_right = all.ok("DELETE /fog05/nodes/left/network/n2/info", "");
    assert_eq!(at_right["properties"]["nodes"], json!(["right"]));
    assert_eq!(all.ask(OPERATOR, "DELETE /fog05/nodes/left/network/n2/info", "").0, 409);
    assert_eq!(all.ask(ONE, "GET /fog05/network/list", "").1, json!([]));
    assert_eq!(all.ask(ONE, "DELETE /fog05/networks/n2/info", "").0, 404);
    let connected = fdu().replace(
        r#""interfaces":[]"#,
        r#""interfaces":[{"name":"eth0","if_type":"INTERNAL","virtual_interface":{"intf_type":"VIRTIO"},"cp_id":"c"}]"#,
    );
    let connected =
        connected.replace(r#""connection_points":[]"#, r#""connection_points":[{"id":"c","vld_ref":"n2"}]"#);
    all.ok("PUT /fog05/fdu/one/info", &connected);
    let instance = all.ok("PUT /fog05/nodes/right/one/define", "")["uuid"].as_str().unwrap().to_owned();
    let (status, answer) = all.ask(OPERATOR, "DELETE /fog05/networks/n2/info", "");
    assert!(status == 409 && answer["error"].as_str().unwrap().contains(&instance), "{answer}");
    all.ok(&format!("DELETE /fog05/fdu/instances/{instance}/info"), "");
    all.ok("DELETE /fog05/networks/n2/info", "");
    assert_eq!(all.ok("GET /fog05/network/list", ""), json!([record]));
}

#[test]
fn the_log_is_the_end_of_what_the_instance_itself_wrote() {
    let all = Applications::serve();
    all.ok("PUT /fog05/fdu/one/info", &fdu());
    let instance = all.ok("PUT /fog05/nodes/left/one/define", "")["uuid"].as_str().unwrap().to_owned();
    let step = |name: &str| all.ok(&format!("POST /fog05/fdu/instances/{instance}/{name}"), "");
    let log = |token| all.ask(token, &format!("GET /fog05/fdu/instances/{instance}/log"), "");
    step("configure");
    assert_eq!(log(OPERATOR).0, 409, "it was not started");
    // A VNF of another had the name that this one will have.
    let folder = all.served.logs.path().to_owned();
    let write = |name: &str, text: &str| {
        let mut file = std::fs::OpenOptions::new();
        let mut file = file.create(true).append(true).open(folder.join(name)).unwrap();
        file.write_all(text.as_bytes()).unwrap();
    };
    write("detector-2.log", "of another\n");
    step("start");
    assert_eq!(all.vnf_of(&instance), "detector-2");
    assert_eq!(log(OPERATOR), (200, json!("")));
    write("detector-2.log", "first\n");
    write("detector-3.log", "of another\n");
    assert_eq!(log(OPERATOR), (200, json!("first\n")));
    assert_eq!(log(TWO).0, 404);
    write("detector-2.log", &"x".repeat(1 << 16));
    step("stop");
    // A VNF of another gets the name that this one had.
    write("detector-2.log", "of another\n");
    assert_eq!(log(OPERATOR), (200, json!("x".repeat(1 << 16))));
    step("start");
    write("detector-3.log", "second\n");
    assert_eq!(log(OPERATOR), (200, json!("second\n")));
}

#[test]
fn an_fdu_goes_through_its_life_over_the_routes_of_fog05() {
    let all = Applications::serve();
    assert_eq!(all.ok("GET /fog05/nodes/list", ""), json!(["left", "right"]));
    assert_eq!(all.ok("GET /fog05/nodes/left/info", "")["ram"]["size"], 1000.0);
    assert_eq!(all.ok("GET /fog05/node/left/status", "")["ram"]["free"], 1000.0);
    assert_eq!(all.ok("PUT /fog05/fdu/one-fdu/info", &fdu())["uuid"], "one-fdu");
    assert_eq!(all.ok("GET /fog05/fdu/list", ""), json!(["one-fdu"]));
    let record = all.ok("PUT /fog05/nodes/left/one-fdu/define", "");
    assert_eq!((&record["status"], &record["fdu_id"]), (&json!("DEFINE"), &json!("one-fdu")));
    let instance = format!("/fog05/fdu/instances/{}", record["uuid"].as_str().unwrap());
    let info = || all.ok(&format!("GET {instance}/info"), "");
    let step = |name: &str| all.ok(&format!("POST {instance}/{name}"), "");
    step("configure");
    let (status, refused) = all.ask(OPERATOR, &format!("POST {instance}/start"), "REFUSE=1");
    assert_eq!((status, &refused["error"]), (409, &json!("the node is full")));
    assert_eq!(info()["status"], "CONFIGURE");
    all.ok(&format!("POST {instance}/start"), "MYENV=Hello World!,B=2");
    assert_eq!(info()["status"], "CONFIGURE", "it does not serve yet");
    let vnf = info()["hypervisor_info"]["vnf"].clone();
    all.vnf(&vnf, cotorra_graph::VnfState::Failed);
    assert_eq!((&info()["status"], &info()["error_msg"]), (&json!("ERROR"), &json!("why")));
    all.vnf(&vnf, cotorra_graph::VnfState::Started);
    assert_eq!(info()["status"], "RUN");
    assert_eq!(all.ok("GET /fog05/node/left/status", "")["ram"]["free"], 936.0);
    step("migrate/right");
    let at_right = json!({ "right": [record["uuid"]] });
    assert_eq!(all.ok("GET /fog05/fdu/one-fdu/instances/list", ""), at_right);
    assert_eq!(all.ok("GET /fog05/nodes/right/fdu/list", ""), json!(["one-fdu"]));
    assert_eq!(all.ask(OPERATOR, "DELETE /fog05/fdu/one-fdu/info", "").0, 409);
    step("stop");
    step("clean");
    all.ok(&format!("DELETE {instance}/info"), "");
    all.ok("DELETE /fog05/fdu/one-fdu/info", "");
    assert_eq!(all.ok("GET /fog05/fdu/list", ""), json!([]));
    let heard = ["add left REFUSE=1", "add left MYENV=Hello World! B=2", "place right", "remove_vnf"];
    assert_eq!(all.heard(), heard);
}

#[test]
fn invalid_requests_of_fog05_say_what_is_wrong() {
    let all = Applications::serve();
    all.ok("PUT /fog05/fdu/one-fdu/info", &fdu());
    for (head, body, expected, part) in [
        ("PUT /fog05/fdu/other/info", fdu().replace("DOCKER", "LXD"), 400, "`LXD`: only BARE and DOCKER"),
        ("PUT /fog05/fdu/one-fdu/info", fdu(), 409, "already"),
        ("PUT /fog05/fdu/a%2Fb/info", fdu(), 400, "`uuid`"),
        ("PUT /fog05/nodes/nowhere/one-fdu/define", String::new(), 404, "`nowhere`"),
        ("PUT /fog05/nodes/left/nothing/define", String::new(), 404, "there is no descriptor `nothing`"),
        ("POST /fog05/fdu/instances/x/start", String::new(), 404, "there is no instance `x`"),
        ("POST /fog05/fdu/instances/x/pause", String::new(), 501, "cannot be paused or resumed"),
        ("GET /fog05/fdu/instances/x/log", String::new(), 404, "there is no instance `x`"),
        (
            "PUT /fog05/networks/x/info",
            net().replace("n1", "n2"),
            400,
            "`uuid` is `n2`, and the path's is `x`",
        ),
        ("PUT /fog05/networks/n1/info", net().replace("ELAN", "ELINE"), 400, "`net_type` is `ELINE`"),
        ("PUT /fog05/nodes/left/network/n1/info", String::new(), 404, "there is no network `n1`"),
        ("PUT /fog05/nodes/nowhere/network/n1/info", net(), 404, "`nowhere`"),
        ("PUT /fog05/nodes/left/routers/r1/info", String::new(), 404, "not served here"),
    ] {
        let (status, answer) = all.ask(OPERATOR, head, &body);
        assert_eq!(status, expected, "{head}: {answer}");
        assert!(answer["error"].as_str().unwrap().contains(part), "{head}: {answer}");
    }
    // A scheduled one gets a node with room.
    assert!(all.ok("PUT /fog05/fdu/one-fdu/schedule", "")["hypervisor_info"]["node"].is_string());
    let large = fdu().replace("64.0", "6400.0");
    all.ok("PUT /fog05/fdu/large/info", &large);
    assert_eq!(all.ask(OPERATOR, "PUT /fog05/fdu/large/schedule", "").0, 409);
    assert_eq!(all.heard(), Vec::<String>::new());
}

#[test]
fn a_domain_has_applications_of_its_own() {
    let all = Applications::serve();
    assert_eq!(all.ask(ONE, "GET /fog05/nodes/list", "").1, json!(["left"]));
    assert_eq!(all.ask(ONE, "PUT /fog05/fdu/a/info", &fdu()).0, 200);
    assert_eq!(all.ask(ONE, "PUT /fog05/nodes/right/a/define", "").0, 404);
    let (_, record) = all.ask(ONE, "PUT /fog05/nodes/left/a/define", "");
    let instance = format!("/fog05/fdu/instances/{}", record["uuid"].as_str().unwrap());
    assert_eq!(all.ask(TWO, &format!("GET {instance}/info"), "").0, 404);
    assert_eq!(all.ask(TWO, "GET /fog05/fdu/list", "").1, json!([]));
    assert_eq!(all.ask("nobody-nobody-nobody", "GET /fog05/fdu/list", "").0, 401);
    let (status, problem) = all.ask("nobody-nobody-nobody", "GET /app_lcm/v1/app_instances", "");
    assert_eq!((status, &problem["title"]), (401, &json!("Unauthorized")));
    assert_eq!(all.ask(TWO, "GET /app_lcm/v1/app_instances", "").1, json!([]));
    assert_eq!(all.ask(ONE, "GET /app_lcm/v1/app_instances", "").1.as_array().unwrap().len(), 1);
}

#[test]
fn an_application_goes_through_its_life_over_mec() {
    let all = Applications::serve();
    all.ok("PUT /fog05/fdu/one-fdu/info", &fdu());
    let instance = all.ok("POST /app_lcm/v1/app_instances", r#"{ "appDId": "detector" }"#);
    assert_eq!((&instance["appDId"], &instance["appName"]), (&json!("one-fdu"), &json!("detector")));
    let itself = instance["_links"]["self"]["href"].as_str().unwrap();
    let host = r#"{ "selectedMECHostInfo": [{ "hostName": "left", "hostId": {} }] }"#;
    let instantiate = instance["_links"]["instantiate"]["href"].as_str().unwrap();
    all.ok(&format!("POST {instantiate}"), host);
    let state = || {
        let now = all.ok(&format!("GET {itself}"), "");
        (now["instantiationState"].clone(), now["instantiatedAppState"]["operationalState"].clone())
    };
    assert_eq!(state(), (json!("INSTANTIATED"), json!("STOPPED")), "its VNF does not serve yet");
    all.vnf(&all.vnf_of(instance["id"].as_str().unwrap()), cotorra_graph::VnfState::Started);
    assert_eq!(state(), (json!("INSTANTIATED"), json!("STARTED")));
    let found = |filter: &str| {
        let found = all.ok(
            &format!("GET /app_lcm/v1/app_instances?filter={filter}&exclude_fields=instantiatedAppState"),
            "",
        );
        assert!(found.as_array().unwrap().iter().all(|one| one.get("instantiatedAppState").is_none()));
        found.as_array().unwrap().len()
    };
    assert_eq!(found("(eq,instantiatedAppState/operationalState,STARTED);(eq,appName,detector)"), 1);
    assert_eq!(found("(eq,instantiationState,NOT_INSTANTIATED)"), 0);
    let (status, problem) = all.ask(OPERATOR, &format!("POST {instantiate}"), host);
    assert_eq!((status, &problem["status"]), (409, &json!(409)));
    assert_eq!(all.ask(OPERATOR, &format!("DELETE {itself}"), "").0, 409);
    all.ok(&format!("POST {itself}/operate"), r#"{ "changeStateTo": "STOPPED" }"#);
    assert_eq!(state().1, "STOPPED");
    all.ok(&format!("POST {itself}/operate"), r#"{ "changeStateTo": "STARTED" }"#);
    all.ok(&format!("POST {itself}/terminate"), r#"{ "terminationType": "FORCEFUL" }"#);
    assert_eq!(state().0, "NOT_INSTANTIATED");
    let occurrences = all.ok("GET /app_lcm/v1/app_lcm_op_occs", "");
    let operations: Vec<_> = occurrences.as_array().unwrap().iter().map(|one| &one["lcmOperation"]).collect();
    assert_eq!(operations, ["INSTANTIATE", "OPERATE", "OPERATE", "TERMINATE"]);
    let filtered = all.ok("GET /app_lcm/v1/app_lcm_op_occs?filter=(eq,lcmOperation,OPERATE)", "");
    assert_eq!(filtered, json!([occurrences[1], occurrences[2]]));
    let first = occurrences[0]["_links"]["self"]["href"].as_str().unwrap();
    assert_eq!(all.ok(&format!("GET {first}"), ""), occurrences[0]);
    assert_eq!(all.ask(OPERATOR, &format!("DELETE {itself}"), "").0, 204);
    for (head, body, expected) in [
        ("POST /app_lcm/v1/app_instances", "{}", 400),
        ("POST /app_lcm/v1/app_instances", r#"{ "appDId": "nothing" }"#, 404),
        ("GET /app_lcm/v1/app_instances?filter=(eq,name,1)", "", 400),
        ("GET /app_lcm/v1/app_lcm_op_occs?fields=nothing", "", 400),
        ("GET /app_lcm/v1/subscriptions?subscriptionType=x", "", 400),
        ("GET /app_lcm/v1/subscriptions/1", "", 404),
        ("POST /app_lcm/v1/app_instances/1/pause", "{}", 404),
        ("GET /app_lcm/v1/app_lcm_op_occs/99", "", 404),
    ] {
        let (status, problem) = all.ask(OPERATOR, head, body);
        assert_eq!((status, &problem["status"]), (expected, &json!(expected)), "{head}: {problem}");
    }
    assert_eq!(all.heard(), ["add left ", "remove_vnf", "add left ", "remove_vnf"]);
}

/// Receives a notification as a subscriber's server.
fn receive(subscriber: &TcpListener) -> Value {
    let mut stream = BufReader::new(subscriber.accept().unwrap().0);
    let (mut line, mut length) = (String::new(), 0);
    while line != "\r\n" {
        line.clear();
        stream.read_line(&mut line).unwrap();
        if let Some(text) = line.to_ascii_lowercase().strip_prefix("content-length: ") {
            length = text.trim().parse().unwrap();
        }
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).unwrap();
    stream.into_inner().write_all(b"HTTP/1.1 204 No Content\r\n\r\n").unwrap();
    serde_json::from_slice(&body).unwrap()
}

#[test]
fn subscribers_hear_of_what_happens_in_the_testbed() {
    let all = Applications::serve();
    all.ok("PUT /fog05/fdu/one-fdu/info", &fdu());
    let instance = all.ok("POST /app_lcm/v1/app_instances", r#"{ "appDId": "detector" }"#);
    let id = instance["id"].as_str().unwrap();
    let listener = || TcpListener::bind("127.0.0.1:0").unwrap();
    let (instances, operations) = (listener(), listener());
    let subscribe = |listener: &TcpListener, kind: &str| {
        let uri = format!("http://{}/told", listener.local_addr().unwrap());
        let body = json!({ "subscriptionType": kind, "callbackUri": uri }).to_string();
        all.ask(OPERATOR, &format!("POST /app_lcm/v1/subscriptions?subscriptionType={kind}"), &body)
    };
    let (status, subscription) = subscribe(&instances, "AppInstanceStateChange");
    assert_eq!(status, 201, "{subscription}");
    assert_eq!(subscribe(&operations, "AppLcmOpOccStateChange").0, 201);
    let host = r#"{ "selectedMECHostInfo": [{ "hostName": "left", "hostId": {} }] }"#;
    all.ok(&format!("POST /app_lcm/v1/app_instances/{id}/instantiate"), host);
    let vnf = all.vnf_of(id);
    // It serves, dies and serves again before anybody looks.
    use cotorra_graph::VnfState::{Died, Started};
    [Started, Died, Started].into_iter().for_each(|state| all.vnf(&vnf, state));
    let told: Vec<_> = (0..4).map(|_| receive(&instances)).collect();
    let kinds: Vec<_> = told.iter().map(|one| one["notificationType"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["STOPPED", "STARTED", "STOPPED", "STARTED"]);
    let itself = subscription["_links"]["self"]["href"].as_str().unwrap();
    assert_eq!(told[0]["_links"]["subscription"]["href"], itself);
    assert_eq!((&told[0]["appInstanceId"], &told[0]["appDId"]), (&json!(id), &json!("one-fdu")));
    let operation = [receive(&operations), receive(&operations)].map(|one| one["notificationType"].clone());
    assert_eq!(operation, ["PROCESSING", "COMPLETED"]);
    let path = &itself[itself.find("/app_lcm").unwrap()..];
    assert_eq!(all.ok(&format!("GET {path}"), ""), subscription);
    let list = all.ok("GET /app_lcm/v1/subscriptions?subscriptionType=AppInstanceStateChange", "");
    assert_eq!(
        list["_links"]["subscriptions"],
        json!([{ "href": itself, "subscriptionType": "AppInstanceStateChange" }])
    );
    // A domain may not make the testbed post to this machine, and sees no subscriptions of others.
    let body = json!({ "subscriptionType": "AppInstanceStateChange", "callbackUri": "http://127.0.0.1:9/" });
    let (status, problem) = all.ask(ONE, "POST /app_lcm/v1/subscriptions", &body.to_string());
    assert!(status == 403 && problem["detail"].as_str().unwrap().contains("127.0.0.1"), "{problem}");
    assert_eq!(all.ask(ONE, &format!("DELETE {path}"), "").0, 404);
    assert_eq!(all.ask(OPERATOR, &format!("DELETE {path}"), "").0, 204);
    assert_eq!(all.ask(OPERATOR, &format!("GET {path}"), "").0, 404);
    all.ok(&format!("POST /app_lcm/v1/app_instances/{id}/terminate"), r#"{ "terminationType": "FORCEFUL" }"#);
    assert_eq!(receive(&operations)["notificationType"], "PROCESSING");
}

#[test]
fn the_document_of_application_life_cycle_has_every_path() {
    let document: Value = serde_json::from_str(&app_lcm_openapi()).unwrap();
    let served = Applications::serve();
    assert_eq!(served.ok("GET /app_lcm/v1/openapi.json", ""), document);
    for (path, methods) in document["paths"].as_object().unwrap() {
        for method in methods.as_object().unwrap().keys().filter(|key| *key != "parameters") {
            let head = format!("{} /app_lcm/v1{}", method.to_uppercase(), path.replace("{id}", "x"));
            let (status, _) = served.ask(OPERATOR, &head, "{}");
            assert_ne!(status, 405, "{head}");
            // The API's limit on requests holds for each of them.
            let limited = &methods[method]["responses"]["429"];
            assert!(limited["headers"]["Retry-After"].is_object(), "{head}: {limited}");
        }
    }
}

/// Whether an answer is a problem that says when to ask again.
fn is_limited(answer: &str) -> bool {
    answer.starts_with("HTTP/1.1 429 ")
        && answer.contains("\r\nretry-after: 1\r\n")
        && answer.contains("\r\ncontent-type: application/problem+json\r\n")
}

#[test]
fn limits_of_mec_say_when_to_ask_again() {
    let served = serve_within(false, FEW, Patience::default());
    let ask = |head: &str| {
        let request = format!("{head} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
        until_closed(say(&served.server, &request))
    };
    let unsubscribe = || ask("DELETE /app_lcm/v1/subscriptions/1");
    let limited = (0..600).map(|_| unsubscribe()).find(|answer| !answer.starts_with("HTTP/1.1 404 "));
    let limited = limited.expect("there is a limit");
    assert!(is_limited(&limited), "{limited}");
    let list = || ask("GET /app_lcm/v1/app_instances");
    assert!(list().starts_with("HTTP/1.1 200 "), "the limit is on changes");
    // A server asks for the body once it has admitted the request.
    let post = "POST /app_lcm/v1/app_instances HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\
                Expect: 100-continue\r\n\r\n";
    let stalled: Vec<_> = (0..FEW.callers).map(|_| answer(say(&served.server, post))).collect();
    assert!(stalled.iter().all(|(status, _)| *status == 100));
    assert!(is_limited(&list()), "{}", list());
}
