//! Applications at a port of an emulated node.

use std::thread::JoinHandle;

use cotorra_graph::{Decision, Event, Instruction, NodeId, Placement, Stamped, Timestamp, VnfId};

use super::*;

const SERVICES: &str = "
core: { node: left }
services:
  watch:
    robot: robot
    kpis: { service_time: 1 s }
    vnfs:
      planner: { command: [sleep, '1'], node: left, cpus: 0.1, memory: 1 MB }
      watcher: { command: [sleep, '1'], node: right, cpus: 0.1, memory: 1 MB }
";

struct Applied {
    served: Domains,
    planner: String,
    watcher: String,
}

fn serve() -> Applied {
    let mut served = Domains::prepare_of(&format!("{DOMAINS}{SERVICES}"), None);
    served.server.open();
    let [planner, watcher] = [("planner", "left"), ("watcher", "right")].map(|(vnf, node)| {
        let (vnf, node) = (VnfId::new(vnf).unwrap(), NodeId::new(node).unwrap());
        let event = Event::Placement(Placement { vnf: vnf.clone(), node: node.clone().into() });
        served.live.absorb(&Stamped { at: Timestamp::ZERO, event });
        let [_, (_, token)] = served.applications.environment(&vnf, &node).unwrap().try_into().unwrap();
        token
    });
    Applied { served, planner, watcher }
}

impl Applied {
    fn status(&self, token: &str, head: &str, body: &str) -> u16 {
        Domains::ask_at(self.served.on_node, token, head, body).0
    }

    /// Returns the status and the JSON of an answer at the node's port.
    fn ask(&self, token: &str, head: &str, body: &str) -> (u16, Value) {
        let (status, mut answer) = Domains::ask_at(self.served.on_node, token, head, body);
        let mut text = String::new();
        answer.read_to_string(&mut text).unwrap();
        (status, serde_json::from_str(&text).unwrap_or_default())
    }

    /// Runs a core that carries everything out, and returns what it heard: who gave it, what and why.
    fn core(&mut self) -> JoinHandle<Vec<String>> {
        let core = std::mem::replace(&mut self.served.core, mpsc::channel().1);
        let live = self.served.live.clone();
        std::thread::spawn(move || {
            let mut heard = Vec::new();
            while let Ok(Message::Instruct { given, reply }) = core.recv() {
                let Given { plugin, instruction, reason } = given;
                let why = reason.clone().unwrap_or_default();
                heard.push(format!("{plugin}: {} ({why})", instruction.text()));
                let decision = Decision { plugin, instruction, reason, refused: None };
                live.absorb(&Stamped { at: Timestamp::ZERO, event: Event::Decision(decision) });
                (reply.expect("the API waits for an answer"))(Ok(()));
            }
            heard
        })
    }
}

#[test]
fn an_applications_token_opens_its_own_part_of_its_domain() {
    let applied = serve();
    let ready = r#"{ "indication": "READY" }"#;
    let confirm = |domain: &str, of: &str| {
        format!("POST /domains/{domain}/mec_app_support/v1/applications/{of}/confirm_ready")
    };
    let own = &*applied.planner;
    for (head, body, expected) in [
        (confirm("one", "planner"), ready, 204),
        (confirm("one", "watcher"), ready, 403),
        // The same name, written otherwise.
        (confirm("one", "%77atcher"), ready, 403),
        (confirm("two", "planner"), ready, 403),
        ("GET /domains/one/location/v2/queries/zones".to_owned(), "", 200),
        ("GET /domains/two/location/v2/queries/zones".to_owned(), "", 403),
        ("GET /domains/one/mec_service_mgmt/v1/services".to_owned(), "", 200),
        ("GET /domains/one/amsi/v1/subscriptions".to_owned(), "", 200),
        // All of the testbed, and life cycles, are the operator's.
        ("GET /location/v2/queries/zones".to_owned(), "", 403),
        ("GET /wai/v2/queries/ap/ap_information".to_owned(), "", 403),
        ("GET /app_lcm/v1/app_instances".to_owned(), "", 403),
        ("GET /api/v1/testbed".to_owned(), "", 404),
        ("POST /api/v1/instructions".to_owned(), "{}", 404),
        ("GET /fog05".to_owned(), "", 404),
        ("GET /".to_owned(), "", 404),
    ] {
        assert_eq!(applied.status(own, &head, body), expected, "{head}");
    }
}

#[test]
fn only_tokens_of_applications_open_a_nodes_port_and_nothing_else() {
    let applied = serve();
    let zones = "GET /domains/one/location/v2/queries/zones";
    for other in ["", OPERATOR, ONE, TWO] {
        assert_eq!(applied.status(other, zones, ""), 401, "{other}");
    }
    let served = &applied.served;
    for path in ["/domains/one/location/v2/queries/zones", "/api/v1/testbed"] {
        assert_eq!(served.get(&applied.planner, path).0, 401, "{path}");
        assert_eq!(served.get(ONE, path).0, 200, "{path}");
    }
    // The orchestrator of the domain acts for its applications, and sees which of them are ready.
    let ready = "POST /domains/one/mec_app_support/v1/applications/watcher/confirm_ready";
    assert_eq!(served.ask(ONE, ready, r#"{ "indication": "READY" }"#).0, 204);
    let applications = "/api/v1/network/applications";
    let of_one = json!([
        { "application": "planner", "domain": "one", "ready_at_ns": null },
        { "application": "watcher", "domain": "one", "ready_at_ns": 1_000_000_000 },
    ]);
    for (token, expected) in [(OPERATOR, of_one.clone()), (ONE, of_one), (TWO, json!([]))] {
        assert_eq!(served.get(token, applications), (200, expected));
    }
}

/// An allocation to an application for the packets from its node to the robot.
fn allocation(of: &str, from: &str, rate: &str) -> String {
    json!({ "appInsId": of, "requestType": 1, "fixedAllocation": rate, "allocationDirection": "00",
        "sessionFilter": [{ "sourceIp": from, "dstAddress": "10.77.0.1" }] })
    .to_string()
}

#[test]
fn an_application_allocates_bandwidth_to_its_own_packets() {
    let mut applied = serve();
    let heard = applied.core();
    let robot = NodeId::new("robot").unwrap();
    let context = cotorra_graph_testing::robot_context("robot", cotorra_graph_testing::pose(0.0, 0.0, 0.0));
    let attachments = vec![cotorra_graph_testing::attachment("A", true, None)];
    let context = cotorra_graph::RobotContext { robot, attachments, ..context };
    applied.served.live.absorb(&Stamped { at: Timestamp::ZERO, event: Event::Robot(context) });
    let (planner, watcher) = (applied.planner.clone(), applied.watcher.clone());
    let all = "/domains/one/bwm/v1/bw_allocations";
    let post = format!("POST {all}");
    let (left, right) = ("10.77.0.3", "10.77.0.5");

    let (status, made) = applied.ask(&planner, &post, &allocation("planner", left, "1000000"));
    assert_eq!((status, &made["allocationId"]), (201, &json!("1")), "{made}");
    let own = format!("{all}/1");
    let more = r#"{ "appInsId": "planner", "requestType": 1, "fixedAllocation": "2000000" }"#;
    for (token, head, body, expected) in [
        // Its own packets are taken already, and no others are its own.
        (&planner, post.clone(), allocation("planner", left, "1"), 403),
        (&planner, post.clone(), allocation("watcher", left, "1"), 403),
        (&planner, post.clone(), allocation("planner", right, "1"), 400),
        // The watcher is on a node of the other domain.
        (&watcher, post.clone(), allocation("watcher", right, "1"), 403),
        (&watcher, format!("GET {own}"), String::new(), 404),
        (&watcher, format!("PATCH {own}"), more.replace("planner", "watcher"), 404),
        (&watcher, format!("DELETE {own}"), String::new(), 404),
        (&planner, format!("GET {own}"), String::new(), 200),
        (&planner, format!("PATCH {own}"), more.to_owned(), 200),
        // All of the testbed is the operator's, and other domains are others'.
        (&planner, "GET /bwm/v1/bw_allocations".to_owned(), String::new(), 403),
        (&planner, "GET /domains/two/bwm/v1/bw_allocations".to_owned(), String::new(), 403),
    ] {
        let (status, answer) = applied.ask(token, &head, &body);
        assert_eq!(status, expected, "{head} {body}: {answer}");
    }
    let seen = |answer: (u16, Value)| (answer.0, answer.1.as_array().map(Vec::len));
    assert_eq!(seen(applied.ask(&planner, &format!("GET {all}"), "")), (200, Some(1)));
    assert_eq!(seen(applied.ask(&watcher, &format!("GET {all}"), "")), (200, Some(0)));
    assert_eq!(seen(applied.served.get(ONE, all)), (200, Some(1)));
    assert_eq!(seen(applied.served.get(TWO, "/domains/two/bwm/v1/bw_allocations")), (200, Some(0)));
    assert_eq!(seen(applied.served.get(OPERATOR, "/bwm/v1/bw_allocations")), (200, Some(1)));

    // The application ends, and its allocation with it.
    let gone = VnfId::new("planner").unwrap();
    let decision = Decision {
        plugin: "api".parse().unwrap(),
        instruction: Instruction::RemoveVnf { vnf: gone },
        reason: None,
        refused: None,
    };
    applied.served.live.absorb(&Stamped { at: Timestamp::ZERO, event: Event::Decision(decision) });
    assert_eq!(seen(applied.served.get(OPERATOR, "/bwm/v1/bw_allocations")), (200, Some(0)));
    drop(applied);
    let path = "left to robot over A-left, robot~A, guaranteed at";
    assert_eq!(
        heard.join().unwrap(),
        [
            format!("one: map {path} 1 Mbit/s (MEC 015: by `planner`)"),
            format!("one: map {path} 2 Mbit/s (MEC 015: by `planner`)"),
            "api: unmap left to robot (MEC 015: `planner` has ended)".to_owned(),
        ]
    );
}
