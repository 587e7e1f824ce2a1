use cotorra_graph::{Kpis, Program, Requests, Rights};
use proptest::prelude::*;

use super::*;
use crate::fog05;

const NOW: Timestamp = Timestamp::ZERO;

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

fn nodes(names: &[&str]) -> Nodes {
    Nodes::new(names.iter().map(|name| node(name)).collect()).unwrap()
}

fn nav() -> VnfId {
    "nav".parse().unwrap()
}

fn place(names: &[&str]) -> Instruction {
    Instruction::Place { vnf: nav(), node: nodes(names) }
}

/// The navigation of a service, which starts on these nodes.
fn service(names: &[&str], owner: Option<DomainId>) -> Applications {
    let vnf = Vnf {
        id: nav(),
        program: Program::Navigation,
        cpus: 4.0,
        memory_bytes: 1_000_000_000,
        pinned_to: None,
        node: nodes(names),
        env: Vec::new(),
        rights: Rights::default(),
        keep: false,
        image: None,
        cpu_limit: None,
        start: Default::default(),
        computing: None,
        state: None,
    };
    let kpis = Kpis {
        service_time: std::time::Duration::from_millis(15),
        kept: None,
        reliability: None,
        area: None,
        radio: None,
        flow: None,
        require: Vec::new(),
    };
    let service = Service {
        id: "walk".parse().unwrap(),
        robot: node("tb"),
        vnfs: vec![vnf.clone()],
        virtual_links: Vec::new(),
        policy: None,
        kpis,
        requests: Requests::default(),
    };
    let mut all = Applications::default();
    all.add_service_vnf(owner, &service, &vnf);
    all
}

/// Returns the node and the state of each instance, by identifier.
fn shown(all: &Applications) -> Vec<(String, String, &'static str)> {
    let node = |one: &Application| one.node.as_ref().map(NodeId::to_string).unwrap_or_default();
    all.instances(None).map(|one| (one.id.clone(), node(one), fog05::status(one))).collect()
}

/// Returns the identifier of the instance on a node.
fn on(all: &Applications, name: &str) -> String {
    let found = all.instances(None).find(|one| one.node.as_ref().is_some_and(|node| *node == *name));
    found.unwrap().id.clone()
}

#[test]
fn the_vnf_of_a_service_is_a_descriptor_with_an_instance_that_serves_once_it_is_placed() {
    let mut all = service(&["cloud"], None);
    let (id, descriptor) = all.descriptor(None, "nav").unwrap();
    assert_eq!((id, descriptor.needs()), ("nav", (4.0, 1_000_000_000)));
    let document = fog05::descriptor(id, descriptor);
    assert_eq!(document["description"], "the bundled navigation of the service walk");
    assert_eq!(
        all.offload(None, "nav").unwrap_err().to_string(),
        "the descriptor `nav` is of a VNF of the testbed file, and stays"
    );
    let wanted = nodes(&["cloud"]);
    all.observe_nodes(&nav(), &[], &wanted, NOW);
    let [(id, at, "CONFIGURE")] = &shown(&all)[..] else { panic!("{:?}", shown(&all)) };
    assert_eq!((id.as_str(), at.as_str()), ("c0704a00-0000-4000-8001-000000000001", "cloud"));
    all.observe_nodes(&nav(), wanted.all(), &wanted, NOW);
    assert_eq!(shown(&all)[0].2, "RUN");
}

#[test]
fn a_move_places_the_vnf_and_the_instance_follows_once_it_serves_there() {
    let mut all = service(&["cloud"], None);
    let (cloud, fog) = (nodes(&["cloud"]), nodes(&["fog"]));
    all.observe_nodes(&nav(), cloud.all(), &cloud, NOW);
    let id = on(&all, "cloud");
    assert_eq!(all.begin_move(None, &id, node("fog")).unwrap(), place(&["fog"]));
    assert!(all.begin_move(None, &id, node("edge")).unwrap_err().to_string().contains("under way"));
    all.end_move(&id);
    all.observe_nodes(&nav(), cloud.all(), &fog, NOW);
    assert_eq!(on(&all, "cloud"), id, "it still serves there");
    // The next move is from where it is going.
    assert_eq!(all.begin_move(None, &id, node("edge")).unwrap(), place(&["edge"]));
    all.end_move(&id);
    all.observe_nodes(&nav(), fog.all(), &fog, NOW);
    assert_eq!((on(&all, "fog"), all.instances(None).count()), (id, 1));
}

#[test]
fn instances_are_started_and_stopped_by_placing_the_vnf_on_more_or_fewer_nodes() {
    let mut all = service(&["cloud"], None);
    let cloud = nodes(&["cloud"]);
    all.observe_nodes(&nav(), cloud.all(), &cloud, NOW);
    let first = on(&all, "cloud");
    let second = all.define(None, "nav", Some(node("fog")), [None, None]).unwrap().id.clone();
    all.configure(None, &second, NOW).unwrap();
    assert!(all.begin_start(None, &second, "A=1").unwrap_err().to_string().contains("without any"));
    assert_eq!(all.begin_start(None, &second, "").unwrap(), place(&["cloud", "fog"]));
    all.end_start(&second, Some((nav(), 0)), NOW);
    let both = nodes(&["cloud", "fog"]);
    all.observe_nodes(&nav(), cloud.all(), &both, NOW);
    assert_eq!(fog05::status(all.instance(None, &second).unwrap()), "CONFIGURE", "it does not serve yet");
    all.observe_nodes(&nav(), both.all(), &both, NOW);
    assert_eq!(fog05::status(all.instance(None, &second).unwrap()), "RUN");
    assert!(all.output(None, &second).unwrap_err().to_string().contains("in the run's folder"));
    // One instance on each node at most.
    let twice = all.define(None, "nav", Some(node("fog")), [None, None]).unwrap().id.clone();
    all.configure(None, &twice, NOW).unwrap();
    assert!(all.begin_start(None, &twice, "").unwrap_err().to_string().contains("`fog` is here twice"));
    assert!(
        all.begin_move(None, &first, node("fog")).unwrap_err().to_string().contains("`fog` is here twice")
    );

    assert_eq!(all.begin_stop(None, &first).unwrap(), Some(place(&["fog"])));
    all.end_stop(&first, Some(0), NOW);
    let fog = nodes(&["fog"]);
    all.observe_nodes(&nav(), fog.all(), &fog, NOW);
    assert_eq!(fog05::status(all.instance(None, &first).unwrap()), "CONFIGURE");
    // The testbed says whether the last may be removed.
    let remove = Instruction::RemoveVnf { vnf: nav() };
    assert_eq!(all.begin_stop(None, &second).unwrap(), Some(remove));
    all.end_stop(&second, None, NOW);
    assert_eq!(fog05::status(all.instance(None, &second).unwrap()), "RUN");
}

#[test]
fn instances_that_others_start_move_and_stop_come_go_and_keep_their_identifiers() {
    let mut all = service(&["a", "b"], None);
    let observe = |all: &mut Applications, names: &[&str]| {
        all.observe_nodes(&nav(), nodes(names).all(), &nodes(names), NOW);
    };
    observe(&mut all, &["a", "b"]);
    let [a, b] = [on(&all, "a"), on(&all, "b")];
    observe(&mut all, &["c", "b"]);
    assert_eq!([on(&all, "c"), on(&all, "b")], [a.clone(), b.clone()]);
    observe(&mut all, &["b", "c", "d"]);
    let d = on(&all, "d");
    assert!(d != a && d != b);
    observe(&mut all, &["d"]);
    assert_eq!(shown(&all), [(d.clone(), "d".to_owned(), "RUN")]);
    // One that a caller has defined stays as one that is gone, until the caller stops it.
    let own = all.define(None, "nav", Some(node("e")), [None, None]).unwrap().id.clone();
    all.configure(None, &own, NOW).unwrap();
    all.begin_start(None, &own, "").unwrap();
    all.end_start(&own, Some((nav(), 0)), NOW);
    observe(&mut all, &["d", "e"]);
    observe(&mut all, &["d"]);
    assert_eq!(fog05::status(all.instance(None, &own).unwrap()), "ERROR");
    assert_eq!(all.begin_stop(None, &own).unwrap(), None, "there is nothing to stop");
}

#[test]
fn a_service_is_seen_by_its_domain_and_takes_no_room_of_it() {
    let [one, two]: [DomainId; 2] = ["one", "two"].map(|name| name.parse().unwrap());
    let mut all = service(&["a"], Some(one.clone()));
    assert_eq!((all.catalog(Some(&two)).count(), all.instances(Some(&two)).count()), (0, 0));
    assert_eq!((all.catalog(Some(&one)).count(), all.instances(Some(&one)).count()), (1, 1));
    let id = on(&all, "a");
    assert!(all.begin_move(Some(&two), &id, node("b")).is_err());
    let defined = (0..100).map_while(|_| all.define(Some(&one), "nav", None, [None, None]).ok().map(drop));
    assert_eq!(defined.count(), 64);
    // An instance that is stopped is the caller's, who has no room for it.
    assert!(all.begin_stop(Some(&one), &id).unwrap_err().to_string().contains("64 of your instances"));
    all.begin_move(Some(&one), &id, node("b")).unwrap();
}

proptest! {
    /// Whatever others do, each node of a(n) has one instance, and each operation names different nodes.
    #[test]
    fn each_node_of_a_vnf_has_one_instance(steps in prop::collection::vec((0_u8..4, any::<u8>(), 1_u8..64), 0..40)) {
        let mut all = service(&["n0"], None);
        let names = |bits: u8| (0..6).filter(|n| bits & (1 << n) != 0).map(|n| node(&format!("n{n}"))).collect::<Vec<_>>();
        let (mut placed, mut wanted) = (vec![node("n0")], nodes(&["n0"]));
        for (step, pick, bits) in steps {
            let ids: Vec<_> = all.instances(None).map(|one| one.id.clone()).collect();
            let id = &ids[usize::from(pick) % ids.len()];
            let to = names(bits)[0].clone();
            let instruction = match step {
                0 => {
                    wanted = Nodes::new(names(bits)).unwrap();
                    None
                }
                1 => {
                    let begun = all.begin_move(None, id, to);
                    if begun.is_ok() { all.end_move(id) }
                    begun.ok()
                }
                2 => {
                    let begun = all.begin_stop(None, id);
                    let is_removal = matches!(begun, Ok(Some(Instruction::RemoveVnf { .. })));
                    if begun.is_ok() { all.end_stop(id, (!is_removal).then_some(0), NOW) }
                    begun.ok().flatten()
                }
                _ => {
                    placed = wanted.all().to_vec();
                    None
                }
            };
            if let Some(Instruction::Place { node, .. }) = instruction {
                wanted = node;
            }
            all.observe_nodes(&nav(), &placed, &wanted, NOW);
            let mut served: Vec<_> = all.present(&nav()).filter_map(|one| one.node.clone()).collect();
            let mut expected = placed.clone();
            served.sort();
            expected.sort();
            prop_assert_eq!(served, expected);
        }
    }
}
