//! Applications at a port of an emulated node.

use cotorra_graph::{Event, NodeId, Placement, Stamped, Timestamp, VnfId};

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
}

fn serve() -> Applied {
    let mut served = Domains::prepare_of(&format!("{DOMAINS}{SERVICES}"), None);
    served.server.open();
    let [planner, _] = [("planner", "left"), ("watcher", "right")].map(|(vnf, node)| {
        let (vnf, node) = (VnfId::new(vnf).unwrap(), NodeId::new(node).unwrap());
        let event = Event::Placement(Placement { vnf: vnf.clone(), node: node.clone().into() });
        served.live.absorb(&Stamped { at: Timestamp::ZERO, event });
        let [_, (_, token)] = served.applications.environment(&vnf, &node).unwrap().try_into().unwrap();
        token
    });
    Applied { served, planner }
}

impl Applied {
    fn status(&self, token: &str, head: &str, body: &str) -> u16 {
        Domains::ask_at(self.served.on_node, token, head, body).0
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
    // The orchestrator of the domain acts for its applications.
    let ready = "POST /domains/one/mec_app_support/v1/applications/watcher/confirm_ready";
    assert_eq!(served.ask(ONE, ready, r#"{ "indication": "READY" }"#).0, 204);
}
