use cotorra_engine::InMemoryEngine;
use cotorra_graph::{Capacity, Node, NodeKind, Server, StateTransfer, TransferMethod};
use cotorra_graph_testing as base;

use super::*;

fn server(id: &str, cpus: f64) -> Node {
    let capacity = Capacity { cpus, memory_bytes: 8 << 30, accelerators: None };
    base::node(id, NodeKind::Server(Server { capacity, ..base::server() }))
}

fn vnf(id: &str, node: &str, pinned: bool) -> Vnf {
    let node = NodeId::new(node).unwrap();
    Vnf {
        id: VnfId::new(id).unwrap(),
        cpus: 4.0,
        memory_bytes: 1 << 30,
        pinned_to: pinned.then(|| node.clone()),
        node: node.into(),
        ..base::vnf("vnf", "server")
    }
}

/// Three servers, of which the last is small; `moving` runs on `a`, `fixed` on `b`.
fn vim() -> Vim<InMemoryEngine> {
    let nodes = vec![server("a", 4.0), server("b", 8.0), server("c", 2.0)];
    vim_of(nodes, vec![vnf("moving", "a", false), vnf("fixed", "b", true)])
}

/// Returns a manager of these servers with these VNFs, all ready.
fn vim_of(nodes: Vec<Node>, vnfs: Vec<Vnf>) -> Vim<InMemoryEngine> {
    let graph = base::graph(nodes, Vec::new());
    let mut vim = Vim::new(graph, &vnfs, InMemoryEngine::default());
    vim.start(Timestamp::ZERO);
    vim.poll(Timestamp::ZERO);
    vim
}

fn names<E: Engine>(vim: &Vim<E>) -> Vec<(String, String)> {
    vim.placements().into_iter().map(|p| (p.vnf.to_string(), p.node.to_string())).collect()
}

/// Returns nodes by their names, separated by commas.
fn on(nodes: &str) -> Nodes {
    Nodes::new(nodes.split(',').map(id).collect()).unwrap()
}

fn id<T: std::str::FromStr>(name: &str) -> T {
    name.parse().ok().unwrap()
}

/// Returns the number of running instances of `moving`.
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
    vim.place(Timestamp::ZERO, &id("moving"), &on("b")).unwrap();
    // Both run until the new one is ready. Packets still go to the old one.
    assert_eq!(instances(&vim), 2);
    assert_eq!(names(&vim)[1], ("moving".into(), "a".into()));
    let ready = Timestamp::from_secs_f64(0.7);
    assert_eq!(order(&vim.poll(ready)), ["Started b", "placed b"]);
    assert_eq!(names(&vim)[1], ("moving".into(), "b".into()));
    // The old one still answers packets in flight to it.
    assert_eq!(instances(&vim), 2);
    let end = vim.next_deadline().unwrap();
    assert_eq!(end, ready + LAST_PACKETS);
    assert_eq!(order(&vim.poll(end)), ["Stopped a"]);
    assert_eq!((instances(&vim), vim.next_deadline()), (1, None));
}

#[test]
fn a_draining_instance_serves_again_at_once() {
    let mut vim = vim();
    vim.place(Timestamp::ZERO, &id("moving"), &on("b")).unwrap();
    vim.poll(Timestamp::ZERO);
    let back = Timestamp::from_secs_f64(0.5);
    assert_eq!(order(&vim.place(back, &id("moving"), &on("a")).unwrap()), ["placed a"]);
    assert_eq!((names(&vim)[1].1.as_str(), instances(&vim), vim.all_ready()), ("a", 2, true));
    assert_eq!(order(&vim.poll(back + LAST_PACKETS)), ["Stopped b"]);
    assert_eq!(instances(&vim), 1);
}

#[test]
fn a_draining_instance_whose_state_has_moved_on_starts_anew() {
    let state = StateTransfer { bytes: 1, method: TransferMethod::StopAndCopy };
    let moving = Vnf { state: Some(Box::new(state)), ..vnf("moving", "a", false) };
    let mut vim = vim_of(vec![server("a", 4.0), server("b", 4.0)], vec![moving]);
    vim.place(Timestamp::ZERO, &id("moving"), &on("b")).unwrap();
    vim.poll(Timestamp::ZERO);
    assert_eq!(order(&vim.place(Timestamp::ZERO, &id("moving"), &on("a")).unwrap()), ["Stopped a"]);
    assert_eq!(order(&vim.poll(Timestamp::ZERO)), ["Started a", "placed a"]);
}

#[test]
fn impossible_placements_are_rejected_and_change_nothing() {
    let mut vim = vim();
    let before = names(&vim);
    for (vnf, node, reason) in [
        ("nobody", "a", "there is no VNF `nobody`"),
        ("moving", "nowhere", "there is no node `nowhere`"),
        ("fixed", "a", "VNF `fixed` is pinned to `b`"),
        ("moving", "c", "VNF `moving` needs 4 CPUs of `c`, which has 2 left"),
    ] {
        let error = vim.place(Timestamp::ZERO, &id(vnf), &on(node)).unwrap_err();
        assert_eq!(error.to_string(), reason);
    }
    assert_eq!(names(&vim), before);
    assert_eq!(vim.engine.running().count(), 2);
}

#[test]
fn a_failed_move_leaves_the_old_instance_in_service() {
    let mut vim = vim();
    vim.engine.fail_on(id("b"));
    let events = vim.place(Timestamp::ZERO, &id("moving"), &on("b")).unwrap();
    assert!(matches!(&events[..], [Event::Vnf(VnfEvent { state: VnfState::Failed, .. })]), "{events:?}");
    assert_eq!(names(&vim)[1], ("moving".into(), "a".into()));
    assert!(vim.all_ready());
    assert_eq!(vim.next_deadline(), None);
}

#[test]
fn simultaneous_moves_do_not_overfill_a_node() {
    let nodes = vec![server("a", 8.0), server("b", 4.0)];
    let mut vim = vim_of(nodes, vec![vnf("one", "a", false), vnf("two", "a", false)]);
    vim.place(Timestamp::ZERO, &id("one"), &on("b")).unwrap();
    // The first VNF is not there yet.
    let rejected = vim.place(Timestamp::ZERO, &id("two"), &on("b")).unwrap_err();
    assert_eq!(rejected.to_string(), "VNF `two` needs 4 CPUs of `b`, which has 0 left");
    // Once the first stays on its node, there is room.
    vim.place(Timestamp::ZERO, &id("one"), &on("a")).unwrap();
    vim.place(Timestamp::ZERO, &id("two"), &on("b")).unwrap();
}

/// Kills the serving instance of `moving`.
fn kill_moving(vim: &mut Vim<InMemoryEngine>) -> Vec<Event> {
    let (instance, ..) = vim.engine.running().find(|(_, vnf, _)| vnf.as_str() == "moving").unwrap();
    vim.engine.kill(instance, "killed by the test");
    vim.poll(Timestamp::ZERO)
}

#[test]
fn a_vnf_that_died_during_a_cancelled_move_restarts_on_its_node() {
    let mut vim = vim();
    vim.engine.stall_on(id("b"));
    vim.place(Timestamp::ZERO, &id("moving"), &on("b")).unwrap();
    kill_moving(&mut vim);
    assert!(!vim.all_ready());
    // The new instance is cancelled.
    vim.place(Timestamp::ZERO, &id("moving"), &on("a")).unwrap();
    assert_eq!(order(&vim.poll(Timestamp::ZERO)), ["Started a", "placed a"]);
    assert!(vim.all_ready());
    assert_eq!(instances(&vim), 1);
}

#[test]
fn a_dead_vnf_that_is_moved_starts_once() {
    let mut vim = vim();
    kill_moving(&mut vim);
    let due = vim.next_deadline().unwrap();
    vim.engine.stall_on(id("b"));
    vim.place(Timestamp::ZERO, &id("moving"), &on("b")).unwrap();
    assert_eq!(vim.next_deadline(), None, "it is under way");
    vim.poll(due);
    assert_eq!(instances(&vim), 1);
}

#[test]
fn a_vnf_that_dies_restarts_with_growing_delays() {
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
    // A long run resets the delay.
    now = now + Backoff::HEALTHY_AFTER;
    let (instance, ..) = vim.engine.running().find(|(_, vnf, _)| vnf.as_str() == "moving").unwrap();
    vim.engine.kill(instance, "killed by the test");
    vim.poll(now);
    assert_eq!(vim.next_deadline().unwrap().since(now), Backoff::FIRST);
}

/// Four servers with room for one instance each, and a VNF on `nodes`.
fn replicated(nodes: &str) -> Vim<InMemoryEngine> {
    let servers = ["a", "b", "c", "d"].map(|name| server(name, 4.0));
    let vnf = Vnf { node: on(nodes), ..vnf("moving", "a", false) };
    vim_of(servers.to_vec(), vec![vnf])
}

fn place(vim: &mut Vim<InMemoryEngine>, nodes: &str) -> Vec<String> {
    let mut events = vim.place(Timestamp::ZERO, &id("moving"), &on(nodes)).unwrap();
    events.extend(vim.poll(Timestamp::ZERO));
    order(&events)
}

fn kill_on(vim: &mut Vim<InMemoryEngine>, on: &str) -> Vec<String> {
    let (instance, ..) = vim.engine.running().find(|(.., node)| *node == on).unwrap();
    vim.engine.kill(instance, "killed by the test");
    order(&vim.poll(Timestamp::ZERO))
}

/// Returns the nodes of serving instances, preferred ones first.
fn serving(vim: &Vim<InMemoryEngine>) -> String {
    vim.serving(&id("moving")).into_iter().map(NodeId::as_str).collect()
}

/// Returns the numbers of running instances, by node.
fn numbers(vim: &Vim<InMemoryEngine>) -> Vec<(String, u32)> {
    let group = vim.group(&id("moving")).unwrap();
    let mut numbers: Vec<_> = group
        .slots
        .iter()
        .filter_map(|slot| slot.current.as_ref())
        .map(|i| (i.node.to_string(), i.replica))
        .collect();
    numbers.sort();
    numbers
}

#[test]
fn a_vnf_has_one_instance_per_node_which_restarts_there() {
    let mut vim = replicated("b,a");
    assert_eq!((serving(&vim).as_str(), names(&vim)[0].1.as_str(), vim.all_ready()), ("ba", "b, a", true));
    assert_eq!(numbers(&vim), [("a".to_owned(), 1), ("b".to_owned(), 0)]);
    assert_eq!(kill_on(&mut vim, "b"), ["Died b"]);
    assert_eq!((serving(&vim).as_str(), vim.all_ready()), ("a", false));
    let due = vim.next_deadline().unwrap();
    assert_eq!(due, Timestamp::ZERO + Backoff::FIRST);
    vim.poll(due);
    assert_eq!(order(&vim.poll(due)), ["Started b", "placed b, a"]);
    assert_eq!(serving(&vim), "ba");
}

#[test]
fn place_changes_the_number_of_instances_and_keeps_those_that_stay() {
    let mut vim = replicated("a");
    let first = vim.engine.running().next().unwrap().0;
    assert_eq!(place(&mut vim, "a,b,c"), ["Started b", "placed a, b", "Started c", "placed a, b, c"]);
    assert_eq!((serving(&vim).as_str(), instances(&vim)), ("abc", 3));
    // Fewer nodes in another order start nothing.
    assert_eq!(place(&mut vim, "c,a"), ["placed c, a"]);
    assert_eq!(serving(&vim), "ca");
    let end = vim.next_deadline().unwrap();
    assert_eq!((instances(&vim), end), (3, Timestamp::ZERO + LAST_PACKETS), "b answers what is under way");
    assert_eq!(order(&vim.poll(end)), ["Stopped b"]);
    assert_eq!((instances(&vim), vim.next_deadline()), (2, None));
    assert!(vim.engine.running().any(|(instance, ..)| instance == first));
}

#[test]
fn leaving_instances_serve_until_all_others_do() {
    let mut vim = replicated("a,b");
    vim.engine.stall_on(id("d"));
    assert_eq!(place(&mut vim, "c,d"), ["Started c", "placed c, b"]);
    // `b` is moving to `d`.
    assert_eq!(serving(&vim), "cb");
    // A leaving instance that dies is not restarted; a staying one is.
    let mut vim = replicated("a,b,c");
    vim.engine.stall_on(id("d"));
    assert_eq!(place(&mut vim, "d"), Vec::<String>::new());
    assert_eq!((serving(&vim).as_str(), instances(&vim)), ("abc", 4));
    assert_eq!(kill_on(&mut vim, "c"), ["Died c", "placed a, b"]);
    assert_eq!((serving(&vim).as_str(), vim.next_deadline()), ("ab", None));
    // The staying instance is back.
    let (waiting, ..) = vim.engine.running().find(|(.., node)| *node == "d").unwrap();
    vim.absorb(Timestamp::ZERO, EngineEvent { instance: waiting, outcome: Outcome::Ready }, &mut Vec::new());
    vim.groups[0].settle(Timestamp::ZERO, &mut Vec::new());
    assert_eq!(serving(&vim), "d");
}

#[test]
fn a_leaving_instance_serves_while_the_staying_one_is_down() {
    let mut vim = replicated("a,b");
    kill_on(&mut vim, "a");
    assert_eq!(place(&mut vim, "a"), Vec::<String>::new());
    assert_eq!(serving(&vim), "b");
    let due = vim.next_deadline().unwrap();
    vim.poll(due);
    assert_eq!(order(&vim.poll(due)), ["Started a", "placed a"]);
    assert_eq!(serving(&vim), "a");
    assert_eq!(order(&vim.poll(due + LAST_PACKETS)), ["Stopped b"]);
}

#[test]
fn instances_have_the_lowest_free_numbers() {
    let mut vim = replicated("a,b");
    place(&mut vim, "c,b");
    assert_eq!(numbers(&vim), [("b".to_owned(), 1), ("c".to_owned(), 0)]);
    // The instance on `a` drains as number 0.
    place(&mut vim, "c,b,a");
    assert_eq!(numbers(&vim), [("a".to_owned(), 2), ("b".to_owned(), 1), ("c".to_owned(), 0)]);
    place(&mut vim, "a,c");
    // It is still draining.
    assert_eq!(place(&mut vim, "b,c,a"), ["placed b, c, a"]);
    assert_eq!(numbers(&vim)[1], ("b".to_owned(), 1));
}

#[test]
fn room_is_checked_on_all_nodes_before_any_change() {
    let nodes = ["a", "b", "c", "d"].map(|name| server(name, 4.0));
    let vnfs = vec![vnf("moving", "a", false), vnf("fixed", "b", true), vnf("other", "d", false)];
    let mut vim = vim_of(nodes.to_vec(), vnfs);
    let rejected = |vim: &mut Vim<_>, vnf: &str, nodes: &str| {
        vim.place(Timestamp::ZERO, &id(vnf), &on(nodes)).unwrap_err().to_string()
    };
    let full = "VNF `moving` needs 4 CPUs of `b`, which has 0 left";
    assert_eq!(rejected(&mut vim, "moving", "c,b,a"), full);
    assert_eq!(rejected(&mut vim, "fixed", "b,c"), "VNF `fixed` is pinned to `b`");
    assert_eq!((instances(&vim), serving(&vim).as_str(), vim.engine.running().count()), (1, "a", 3));
    // Each instance takes room, also a starting one.
    vim.engine.stall_on(id("c"));
    vim.place(Timestamp::ZERO, &id("moving"), &on("a,c")).unwrap();
    assert_eq!(rejected(&mut vim, "other", "c"), "VNF `other` needs 4 CPUs of `c`, which has 0 left");
}
