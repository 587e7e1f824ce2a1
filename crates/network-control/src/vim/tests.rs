use std::collections::BTreeMap;

use cotorra_graph::{Capacity, DomainId, Node, NodeKind, Server, ServiceId, Tier};

use super::*;

fn server(id: &str, cpus: f64) -> Node {
    Node {
        id: NodeId::new(id).unwrap(),
        domain: DomainId::new("d").unwrap(),
        position: None,
        kind: NodeKind::Server(Server {
            tier: Tier::Edge,
            capacity: Capacity { cpus, memory_bytes: 8 << 30 },
            cost: 1.0,
            reliability: 1.0,
        }),
    }
}

fn vnf(id: &str, node: &str, pinned: bool) -> Vnf {
    let node = NodeId::new(node).unwrap();
    Vnf {
        id: VnfId::new(id).unwrap(),
        program: Program::Navigation,
        cpus: 4.0,
        memory_bytes: 1 << 30,
        pinned_to: pinned.then(|| node.clone()),
        node,
        env: Vec::new(),
        rights: Default::default(),
    }
}

/// Three servers, of which the last is small; `moving` runs on `a`, `fixed` on `b`.
fn vim() -> Vim<InMemoryEngine> {
    let nodes = vec![server("a", 4.0), server("b", 8.0), server("c", 2.0)];
    vim_of(nodes, vec![vnf("moving", "a", false), vnf("fixed", "b", true)])
}

/// These VNFs, ready on these servers.
fn vim_of(nodes: Vec<Node>, vnfs: Vec<Vnf>) -> Vim<InMemoryEngine> {
    let graph = HardwareGraph {
        domains: vec![DomainId::new("d").unwrap()],
        nodes,
        links: Vec::new(),
        wireless: BTreeMap::new(),
    };
    let service = Service {
        id: ServiceId::new("s").unwrap(),
        robot: NodeId::new("robot").unwrap(),
        vnfs,
        virtual_links: Vec::new(),
        kpis: cotorra_graph::Kpis {
            service_time: Duration::from_millis(15),
            reliability: None,
            area: None,
            radio: None,
            flow: None,
        },
    };
    let mut vim = Vim::new(graph, &[service], InMemoryEngine::default());
    vim.start(Timestamp::ZERO);
    vim.poll(Timestamp::ZERO);
    vim
}

fn names<E: Engine>(vim: &Vim<E>) -> Vec<(String, String)> {
    vim.placements().into_iter().map(|p| (p.vnf.to_string(), p.node.to_string())).collect()
}

fn id<T: std::str::FromStr>(name: &str) -> T {
    name.parse().ok().unwrap()
}

/// How many instances of `moving` run.
fn instances(vim: &Vim<InMemoryEngine>) -> usize {
    vim.engine.running().filter(|(_, vnf, _)| vnf.as_str() == "moving").count()
}

fn order(events: &[Event]) -> Vec<String> {
    let name = |event: &Event| match event {
        Event::Vnf(v) => format!("{:?} {}", v.state, v.node),
        Event::Placement(p) => format!("placed {}", p.node),
        other => panic!("{other:?}"),
    };
    events.iter().map(name).collect()
}

#[test]
fn a_move_starts_the_new_instance_before_it_stops_the_old_one() {
    let mut vim = vim();
    assert!(vim.all_ready());
    vim.place(Timestamp::ZERO, &id("moving"), &id("b")).unwrap();
    // Both run until the new one is ready; packets still go to the old one.
    assert_eq!(instances(&vim), 2);
    assert_eq!(names(&vim)[1], ("moving".into(), "a".into()));
    let ready = Timestamp::from_secs_f64(0.7);
    assert_eq!(order(&vim.poll(ready)), ["Started b", "placed b"]);
    assert_eq!(names(&vim)[1], ("moving".into(), "b".into()));
    // The old one still answers what was under way to it.
    assert_eq!(instances(&vim), 2);
    let end = vim.next_deadline().unwrap();
    assert_eq!(end, ready + LAST_PACKETS);
    assert_eq!(order(&vim.poll(end)), ["Stopped a"]);
    assert_eq!((instances(&vim), vim.next_deadline()), (1, None));
}

#[test]
fn an_instance_that_is_about_to_stop_serves_again_at_once() {
    let mut vim = vim();
    vim.place(Timestamp::ZERO, &id("moving"), &id("b")).unwrap();
    vim.poll(Timestamp::ZERO);
    let back = Timestamp::from_secs_f64(0.5);
    assert_eq!(order(&vim.place(back, &id("moving"), &id("a")).unwrap()), ["placed a"]);
    assert_eq!((names(&vim)[1].1.as_str(), instances(&vim), vim.all_ready()), ("a", 2, true));
    assert_eq!(order(&vim.poll(back + LAST_PACKETS)), ["Stopped b"]);
    assert_eq!(instances(&vim), 1);
}

#[test]
fn what_cannot_be_is_refused_with_a_reason_and_changes_nothing() {
    let mut vim = vim();
    let before = names(&vim);
    for (vnf, node, reason) in [
        ("nobody", "a", "there is no VNF `nobody`"),
        ("moving", "nowhere", "there is no node `nowhere`"),
        ("fixed", "a", "VNF `fixed` is pinned to `b`"),
        ("moving", "c", "VNF `moving` needs 4 CPUs of `c`, which has 2 left"),
    ] {
        let error = vim.place(Timestamp::ZERO, &id(vnf), &id(node)).unwrap_err();
        assert_eq!(error.to_string(), reason);
    }
    assert_eq!(names(&vim), before);
    assert_eq!(vim.engine.running().count(), 2);
}

#[test]
fn a_move_that_fails_leaves_the_old_instance_in_service() {
    let mut vim = vim();
    vim.engine.fail_on(id("b"));
    let events = vim.place(Timestamp::ZERO, &id("moving"), &id("b")).unwrap();
    assert!(matches!(&events[..], [Event::Vnf(VnfEvent { state: VnfState::Failed, .. })]), "{events:?}");
    assert_eq!(names(&vim)[1], ("moving".into(), "a".into()));
    assert!(vim.all_ready());
    assert_eq!(vim.next_deadline(), None);
}

#[test]
fn two_vnfs_that_move_at_once_do_not_overfill_a_node() {
    let nodes = vec![server("a", 8.0), server("b", 4.0)];
    let mut vim = vim_of(nodes, vec![vnf("one", "a", false), vnf("two", "a", false)]);
    vim.place(Timestamp::ZERO, &id("one"), &id("b")).unwrap();
    // The first is not there yet.
    let refused = vim.place(Timestamp::ZERO, &id("two"), &id("b")).unwrap_err();
    assert_eq!(refused.to_string(), "VNF `two` needs 4 CPUs of `b`, which has 0 left");
    // Once it stays where it is, there is.
    vim.place(Timestamp::ZERO, &id("one"), &id("a")).unwrap();
    vim.place(Timestamp::ZERO, &id("two"), &id("b")).unwrap();
}

/// Kills what serves as the VNF that can move.
fn kill_moving(vim: &mut Vim<InMemoryEngine>) -> Vec<Event> {
    let (instance, ..) = vim.engine.running().find(|(_, vnf, _)| vnf.as_str() == "moving").unwrap();
    vim.engine.kill(instance, "killed by the test");
    vim.poll(Timestamp::ZERO)
}

#[test]
fn a_vnf_that_died_while_it_moved_is_started_where_it_is_to_stay() {
    let mut vim = vim();
    vim.engine.stall_on(id("b"));
    vim.place(Timestamp::ZERO, &id("moving"), &id("b")).unwrap();
    kill_moving(&mut vim);
    assert!(!vim.all_ready());
    // What was to take over is given up.
    vim.place(Timestamp::ZERO, &id("moving"), &id("a")).unwrap();
    assert_eq!(order(&vim.poll(Timestamp::ZERO)), ["Started a", "placed a"]);
    assert!(vim.all_ready());
    assert_eq!(instances(&vim), 1);
}

#[test]
fn a_vnf_that_died_and_is_moved_is_started_once() {
    let mut vim = vim();
    kill_moving(&mut vim);
    let due = vim.next_deadline().unwrap();
    vim.engine.stall_on(id("b"));
    vim.place(Timestamp::ZERO, &id("moving"), &id("b")).unwrap();
    assert_eq!(vim.next_deadline(), None, "it is under way");
    vim.poll(due);
    assert_eq!(instances(&vim), 1);
}

#[test]
fn a_vnf_that_dies_is_started_again_each_time_later() {
    let mut vim = vim();
    let mut now = Timestamp::ZERO;
    let mut waits = Vec::new();
    for _ in 0..8 {
        let (instance, ..) = vim.engine.running().find(|(_, vnf, _)| vnf.as_str() == "moving").unwrap();
        vim.engine.kill(instance, "killed by the test");
        let events = vim.poll(now);
        assert!(matches!(&events[..], [Event::Vnf(VnfEvent { state: VnfState::Died, .. })]), "{events:?}");
        let due = vim.next_deadline().unwrap();
        waits.push(due.since(now).as_millis());
        now = due;
        vim.poll(now);
        vim.poll(now);
        assert!(vim.all_ready());
    }
    assert_eq!(waits, [100, 200, 400, 800, 1600, 3200, 5000, 5000]);
    // Long health is rewarded.
    now = now + HEALTHY_AFTER;
    let (instance, ..) = vim.engine.running().find(|(_, vnf, _)| vnf.as_str() == "moving").unwrap();
    vim.engine.kill(instance, "killed by the test");
    vim.poll(now);
    assert_eq!(vim.next_deadline().unwrap().since(now), FIRST_BACKOFF);
}
