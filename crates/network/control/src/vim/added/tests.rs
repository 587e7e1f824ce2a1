use cotorra_engine::InMemoryEngine;
use cotorra_graph::{
    Capacity, Granted, Image, LinuxCapability, ListenPort, Node, NodeId, NodeKind, Nodes, Server, Transport,
    Volume,
};
use cotorra_graph_testing as base;
use proptest::prelude::*;

use super::{
    super::{Managed, Stage},
    *,
};

fn server(id: &str, cpus: f64) -> Node {
    let capacity = Capacity { cpus, memory_bytes: 8 << 30, accelerators: None };
    base::node(id, NodeKind::Server(Server { capacity, ..base::server() }))
}

fn vnf(id: &str, nodes: &str) -> Vnf {
    Vnf {
        id: VnfId::new(id).unwrap(),
        program: Program::Command(vec!["serve".to_owned()]),
        cpus: 2.0,
        memory_bytes: 1 << 30,
        node: on(nodes),
        env: vec!["LEVEL=3".to_owned()],
        ..base::vnf("vnf", "server")
    }
}

fn on(nodes: &str) -> Nodes {
    Nodes::new(nodes.split(',').map(|name| NodeId::new(name).unwrap()).collect()).unwrap()
}

fn id(name: &str) -> VnfId {
    VnfId::new(name).unwrap()
}

/// Two servers with room for two VNFs each, and `fixed` of the testbed file on the first.
fn vim() -> Vim<InMemoryEngine> {
    let graph = base::graph(vec![server("a", 4.0), server("b", 4.0)], Vec::new());
    let mut vim = Vim::new(graph, &[vnf("fixed", "a")], InMemoryEngine::default());
    vim.start(Timestamp::ZERO);
    vim.poll(Timestamp::ZERO);
    vim
}

fn order(events: &[Event]) -> Vec<String> {
    let name = |event: &Event| match event {
        Event::Vnf(v) => format!("{:?} {} {}", v.state, v.vnf, v.node),
        Event::Placement(p) => format!("placed {} on {}", p.vnf, p.node),
        other => panic!("{other:?}"),
    };
    events.iter().map(name).collect()
}

fn running(vim: &Vim<InMemoryEngine>) -> Vec<String> {
    vim.engine.running().map(|(_, vnf, node)| format!("{vnf} {node}")).collect()
}

#[test]
fn an_added_vnf_serves_once_it_is_ready_and_is_removed_after_it_drained() {
    let mut vim = vim();
    let now = Timestamp::from_secs_f64(5.0);
    assert_eq!(order(&vim.add(now, &vnf("new", "a,b")).unwrap()), Vec::<String>::new());
    assert!(vim.all_ready(), "robots do not wait for it");
    let ready = ["Started new a", "placed new on a", "Started new b", "placed new on a, b"];
    assert_eq!(order(&vim.poll(now)), ready);
    assert_eq!(vim.added().map(|vnf| vnf.id.as_str()).collect::<Vec<_>>(), ["new"]);
    assert_eq!(vim.nodes_of_added(&id("new")).unwrap().count(), 2);

    assert_eq!(order(&vim.remove(now, &id("new")).unwrap()), Vec::<String>::new());
    assert_eq!(vim.placements().len(), 1, "packets go to it no more");
    assert_eq!(running(&vim).len(), 3, "it answers packets in flight to it");
    let end = vim.next_deadline().unwrap();
    assert_eq!(end, now + LAST_PACKETS);
    assert_eq!(order(&vim.poll(end)), ["Stopped new a", "Stopped new b"]);
    assert_eq!((running(&vim), vim.next_deadline()), (vec!["fixed a".to_owned()], None));
}

#[test]
fn a_vnf_that_does_not_serve_is_removed_at_once() {
    let mut vim = vim();
    vim.engine.stall_on(NodeId::new("b").unwrap());
    vim.add(Timestamp::ZERO, &vnf("new", "b")).unwrap();
    assert_eq!(order(&vim.remove(Timestamp::ZERO, &id("new")).unwrap()), ["Stopped new b"]);
    assert_eq!((running(&vim).len(), vim.next_deadline()), (1, None));
    // Its name is free at once.
    vim.engine.fail_on(NodeId::new("a").unwrap());
    vim.add(Timestamp::ZERO, &vnf("new", "a")).unwrap();
    assert!(vim.next_deadline().is_some(), "its start is retried");
    assert_eq!(order(&vim.remove(Timestamp::ZERO, &id("new")).unwrap()), ["Stopped new a"]);
    assert_eq!(vim.next_deadline(), None);
}

#[test]
fn an_added_vnf_moves_and_restarts_like_others() {
    let mut vim = vim();
    vim.add(Timestamp::ZERO, &vnf("new", "a")).unwrap();
    vim.poll(Timestamp::ZERO);
    vim.place(Timestamp::ZERO, &id("new"), &on("b")).unwrap();
    assert_eq!(order(&vim.poll(Timestamp::ZERO)), ["Started new b", "placed new on b"]);
    let (instance, ..) = vim.engine.running().find(|(_, vnf, node)| *vnf == "new" && *node == "b").unwrap();
    vim.engine.kill(instance, "killed by the test");
    assert_eq!(order(&vim.poll(Timestamp::ZERO)), ["Died new b"]);
    // Removed while it waits for its restart, and its former instance drains.
    assert_eq!(order(&vim.remove(Timestamp::ZERO, &id("new")).unwrap()), ["Stopped new b"]);
    assert_eq!(order(&vim.poll(Timestamp::ZERO + LAST_PACKETS)), ["Stopped new a"]);
}

#[test]
fn an_instance_that_dies_while_it_drains_frees_the_name() {
    let mut vim = vim();
    vim.add(Timestamp::ZERO, &vnf("new", "b")).unwrap();
    vim.poll(Timestamp::ZERO);
    vim.remove(Timestamp::ZERO, &id("new")).unwrap();
    let (instance, ..) = vim.engine.running().find(|(_, vnf, _)| *vnf == "new").unwrap();
    vim.engine.kill(instance, "killed by the test");
    vim.poll(Timestamp::ZERO);
    assert_eq!(vim.managed().count(), 1);
    vim.add(Timestamp::ZERO, &vnf("new", "b")).unwrap();
}

#[test]
fn impossible_additions_and_removals_are_rejected_and_change_nothing() {
    let mut vim = vim();
    vim.add(Timestamp::ZERO, &vnf("old", "b")).unwrap();
    vim.poll(Timestamp::ZERO);
    vim.remove(Timestamp::ZERO, &id("old")).unwrap();
    let before = running(&vim);
    for (vnf, reason) in [
        (vnf("fixed", "b"), "there is a VNF `fixed` already"),
        (vnf("Fixed", "b"), "there is a VNF `Fixed` already"),
        (vnf("new", "nowhere"), "there is no node `nowhere`"),
        (vnf("old", "b"), "VNF `old` was removed, and its last instances still stop: try again in a second"),
        (Vnf { cpus: 3.0, ..vnf("new", "b,a") }, "VNF `new` needs 3 CPUs of `a`, which has 2 left"),
        (
            Vnf { program: Program::Navigation, ..vnf("new", "a") },
            "VNF `new` cannot be added: its program is not a command: only commands and images can be added, \
             because all others belong to a service",
        ),
    ] {
        assert_eq!(vim.add(Timestamp::ZERO, &vnf).unwrap_err().to_string(), reason);
    }
    for (name, reason) in [
        ("nobody", "there is no VNF `nobody`"),
        ("old", "there is no VNF `old`"),
        ("fixed", "VNF `fixed` is of the testbed file: only VNFs that were added can be removed"),
    ] {
        assert_eq!(vim.remove(Timestamp::ZERO, &id(name)).unwrap_err().to_string(), reason);
    }
    assert_eq!(running(&vim), before);
}

#[test]
fn a_vnf_can_be_added_only_with_the_rights_of_a_confined_command() {
    let image = |image: Image| Some(Box::new(Image { reference: "ros:jazzy".to_owned(), ..image }));
    let confined = |granted: Granted| Rights::Confined(granted);
    let readable = Granted { readable: vec!["/etc".into()], ..Granted::default() };
    let capable = Granted { capabilities: vec![LinuxCapability::NetRaw], ..Granted::default() };
    let volume = Volume { source: "/etc".into(), target: "/etc".into(), writable: false };
    let base = || vnf("new", "a");
    for (vnf, named) in [
        (Vnf { rights: Rights::Trusted, ..base() }, "trusted"),
        (Vnf { rights: confined(readable), ..base() }, "readable"),
        (Vnf { rights: confined(capable), ..base() }, "capabilities"),
        (Vnf { image: image(Image { volumes: vec![volume], ..Image::default() }), ..base() }, "volumes"),
        (
            Vnf { image: image(Image { devices: vec!["/dev/kvm".into()], ..Image::default() }), ..base() },
            "devices",
        ),
    ] {
        assert_eq!(check_added(&vnf), Err(AddedVnfError::Rights(named)));
    }
    assert_eq!(check_added(&Vnf { keep: true, ..base() }), Err(AddedVnfError::Keep));
    // A variable without a value would be taken from cotorra's own environment, which may hold tokens.
    for bare in ["COTORRA_TOKEN", "=x", "1A=x", "A B=x"] {
        let vnf = Vnf { env: vec!["A=".to_owned(), bare.to_owned()], ..base() };
        assert_eq!(check_added(&vnf), Err(AddedVnfError::Variable(bare.to_owned())));
    }
}

#[test]
fn an_added_vnf_is_within_bounds() {
    let base = || vnf("new", "a");
    let command = |words: Vec<String>| Program::Command(words);
    let image = |image: Image| Vnf { image: Some(Box::new(image)), ..base() };
    let ports = |ports: Vec<u16>| Image {
        reference: "a".to_owned(),
        ports: ports.into_iter().map(|port| ListenPort { port, transport: Transport::Tcp }).collect(),
        ..Image::default()
    };
    for (vnf, error) in [
        (Vnf { program: command(Vec::new()), ..base() }, AddedVnfError::Empty),
        (Vnf { program: command(vec!["x".to_owned(); MOST_WORDS + 1]), ..base() }, AddedVnfError::TooLong),
        (Vnf { program: command(vec!["x".repeat(MOST_BYTES)]), ..base() }, AddedVnfError::TooLong),
        (Vnf { env: vec!["A=".to_owned(); MOST_VARIABLES + 1], ..base() }, AddedVnfError::TooLong),
        (Vnf { program: command(vec!["a\0".to_owned()]), ..base() }, AddedVnfError::ZeroByte),
        (Vnf { cpus: f64::NAN, ..base() }, AddedVnfError::Capacity),
        (Vnf { cpus: 0.0, ..base() }, AddedVnfError::Capacity),
        (Vnf { cpu_limit: Some(f64::NAN), ..base() }, AddedVnfError::Capacity),
        (Vnf { cpu_limit: Some(1.0), ..base() }, AddedVnfError::Capacity),
        (Vnf { memory_bytes: 0, ..base() }, AddedVnfError::Capacity),
        (Vnf { pinned_to: Some(NodeId::new("b").unwrap()), ..base() }, AddedVnfError::Pinned),
        (image(ports(vec![80, 80])), AddedVnfError::Ports),
        (image(ports(vec![0])), AddedVnfError::Ports),
        (image(ports((1..=MOST_PORTS as u16 + 1).collect())), AddedVnfError::Ports),
    ] {
        assert_eq!(check_added(&vnf), Err(error));
    }
    check_added(&image(ports(vec![80, 443]))).unwrap();
    check_added(&Vnf { program: command(Vec::new()), ..image(ports(Vec::new())) }).unwrap();
}

#[test]
fn an_image_is_named_by_a_reference_that_is_neither_an_option_nor_a_file() {
    for good in [
        "ros",
        "ros:jazzy",
        "library/ros:jazzy",
        "docker.io/library/ros@sha256:0123456789abcdef",
        "localhost:5000/a/b:1.0-rc_1",
        "ros:jazzy@sha256:ab",
    ] {
        assert!(is_reference(good), "{good}");
    }
    for bad in [
        "",
        "-v",
        "--privileged",
        "/etc/image.tar",
        "./image",
        "dir:/etc",
        "dir:etc",
        "docker-archive:image.tar",
        "oci:a/b",
        "a b",
        "a//b",
        "a/",
        "a:",
        "a:b:c",
        "host:port/a",
        "a/b:c/d",
        "a@sha256:xyz",
        "a@b",
        "ros\n",
    ] {
        assert!(!is_reference(bad), "{bad}");
    }
}

#[test]
fn the_number_of_added_vnfs_is_bounded() {
    let mut vim = vim();
    let small = |number: usize| Vnf { cpus: 0.001, memory_bytes: 1, ..vnf(&format!("n{number}"), "b") };
    for number in 0..MOST_ADDED {
        vim.add(Timestamp::ZERO, &small(number)).unwrap();
    }
    vim.poll(Timestamp::ZERO);
    let too_many = vim.add(Timestamp::ZERO, &small(MOST_ADDED)).unwrap_err();
    assert_eq!(too_many.to_string(), "no more than 256 VNFs can be added at a time: remove one");
    // A removed one counts until it has stopped.
    vim.remove(Timestamp::ZERO, &id("n0")).unwrap();
    vim.add(Timestamp::ZERO, &small(MOST_ADDED)).unwrap_err();
    vim.poll(Timestamp::ZERO + LAST_PACKETS);
    vim.add(Timestamp::ZERO + LAST_PACKETS, &small(MOST_ADDED)).unwrap();
}

/// A step of [`no_order_breaks_room_or_leaves_instances_behind`].
#[derive(Debug, Clone)]
enum Step {
    Add(u8, Vec<u8>, f64),
    Remove(u8),
    Place(u8, Vec<u8>),
    Kill(u8),
    Poll(u16),
}

fn nodes() -> impl Strategy<Value = Vec<u8>> {
    proptest::sample::subsequence(vec![0, 1], 1..=2)
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        4 => (0..4_u8, nodes(), 0.1..3.0).prop_map(|(vnf, nodes, cpus)| Step::Add(vnf, nodes, cpus)),
        3 => (0..4_u8).prop_map(Step::Remove),
        2 => (0..4_u8, nodes()).prop_map(|(vnf, nodes)| Step::Place(vnf, nodes)),
        1 => any::<u8>().prop_map(Step::Kill),
        3 => (0..1500_u16).prop_map(Step::Poll),
    ];
    proptest::collection::vec(step, 0..60)
}

/// Checks that no node is overfull, and that exactly the managed instances run.
fn check(vim: &Vim<InMemoryEngine>) {
    for (node, cpus) in [("a", 4.0), ("b", 4.0)] {
        let takes = |Managed { vnf, node: at, instances, .. }: Managed<'_>| {
            let starts = |(_, to, stage): &(_, &NodeId, _)| *stage == Stage::Starting && **to == *node;
            let is_there = at.is_some_and(|at| *at == node) || instances.iter().any(starts);
            if is_there { vnf.cpus } else { 0.0 }
        };
        let taken: f64 = vim.managed().map(takes).sum();
        assert!(taken <= cpus + 1e-6, "{node} carries {taken} CPUs");
    }
    let mut managed: Vec<_> =
        vim.managed().flat_map(|managed| managed.instances).map(|(instance, ..)| instance).collect();
    managed.sort_unstable();
    let running: Vec<_> = vim.engine.running().map(|(instance, ..)| instance).collect();
    assert_eq!(managed, running);
}

proptest! {
    #[test]
    fn no_order_breaks_room_or_leaves_instances_behind(steps in steps()) {
        let mut vim = vim();
        let mut now = Timestamp::ZERO;
        let place = |nodes: &[u8]| {
            Nodes::new(nodes.iter().map(|node| NodeId::new(["a", "b"][usize::from(*node)]).unwrap()).collect())
                .unwrap()
        };
        let name = |number: u8| id(&format!("n{number}"));
        for step in steps {
            let state = (vim.placements(), running(&vim), vim.next_deadline());
            let rejected = match step {
                Step::Add(number, nodes, cpus) => {
                    let vnf = Vnf { node: place(&nodes), cpus, ..vnf(name(number).as_str(), "a") };
                    vim.add(now, &vnf).is_err()
                }
                Step::Remove(number) => vim.remove(now, &name(number)).is_err(),
                Step::Place(number, nodes) => vim.place(now, &name(number), &place(&nodes)).is_err(),
                Step::Kill(nth) => {
                    let all: Vec<_> = vim.engine.running().map(|(instance, ..)| instance).collect();
                    if let Some(killed) = all.get(usize::from(nth) % all.len().max(1)) {
                        vim.engine.kill(*killed, "killed by the test");
                    }
                    vim.poll(now);
                    false
                }
                Step::Poll(ms) => {
                    now = now + std::time::Duration::from_millis(ms.into());
                    vim.poll(now);
                    false
                }
            };
            if rejected {
                assert_eq!((vim.placements(), running(&vim), vim.next_deadline()), state);
            }
            check(&vim);
        }
        for number in 0..4 {
            let _ = vim.remove(now, &name(number));
        }
        vim.poll(now + LAST_PACKETS);
        check(&vim);
        assert!(vim.managed().all(|managed| managed.vnf.id == "fixed"));
    }
}
