//! The testbed files that ship with the project say what is published about them.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use cotorra_graph::{
    BackgroundScan, Dbm, Fading, LinkId, NodeId, Position, Program, Rate, Roaming, Testbed, WallLoss,
};

fn shipped(name: &str) -> Testbed {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testbeds").join(name);
    cotorra_testbed_file::load(path).unwrap_or_else(|wrong| panic!("{wrong}"))
}

fn id(name: &str) -> NodeId {
    NodeId::new(name).expect("a name")
}

#[test]
fn corridor_has_the_published_round_trips_and_rates() {
    let corridor = shipped("corridor.yaml");
    let published = [
        ("R1", [(9, 10), (4, 8), (3, 6)]),
        ("R3", [(9, 10), (4, 8), (3, 6)]),
        ("R2", [(18, 27), (8, 12), (9, 11)]),
        ("R4", [(18, 27), (8, 11), (9, 10)]),
        ("R5", [(27, 30), (12, 15), (9, 12)]),
        ("R6", [(27, 30), (12, 15), (9, 12)]),
    ];
    for (unit, figures) in published {
        for (server, (round_trip_ms, mbps)) in ["cloud", "edge", "fog"].into_iter().zip(figures) {
            let link = corridor.graph.link(&LinkId::new(&format!("{unit}-{server}")).unwrap()).unwrap();
            assert_eq!(
                link.forward.delay + link.backward.delay,
                Duration::from_millis(round_trip_ms),
                "{unit} {server}"
            );
            for direction in [&link.forward, &link.backward] {
                let Rate::Fixed { bits_per_second } = &direction.rate else { panic!("a fixed rate") };
                assert_eq!(bits_per_second.mbps(), f64::from(mbps), "{unit} {server}");
            }
        }
    }
}

#[test]
fn corridor_service_and_walk() {
    let corridor = shipped("corridor.yaml");
    let service = &corridor.services[0];
    assert_eq!(service.kpis.service_time, Duration::from_millis(15));
    assert_eq!(
        service.vnfs.iter().map(|v| &v.program).collect::<Vec<_>>(),
        [&Program::RobotDriver, &Program::Navigation]
    );
    assert_eq!(service.vnfs[1].node.only().unwrap(), "cloud");
    let localization = &corridor.services[1].vnfs[1];
    assert_eq!((&localization.program, localization.node.first().as_str()), (&Program::Localization, "edge"));
    // It fits beside navigation wherever that goes.
    for server in ["fog", "edge", "cloud"] {
        let capacity = corridor.graph.node(&id(server)).unwrap().capacity().unwrap();
        assert!(capacity.cpus >= localization.cpus + service.vnfs[1].cpus);
    }
    let walk = corridor.walk(&id("robot")).unwrap();
    assert_eq!(walk.waypoints.len(), 35);
    assert_eq!(walk.waypoints.first(), walk.waypoints.last());
    let length: f64 = walk.waypoints.windows(2).map(|w| w[0].distance(w[1])).sum();
    assert!((105.0..110.0).contains(&length), "{length}");
    // Two metres to either side are free.
    let map = corridor.map.as_ref().unwrap();
    for at in &walk.waypoints {
        assert_eq!(map.at(*at), cotorra_graph::Cell::Free);
    }
}

/// Without shadowing and with equal powers, the strongest radio unit is the nearest.
#[test]
fn strongest_radio_units_follow_the_published_regions() {
    let corridor = shipped("corridor.yaml");
    let walk = &corridor.walks[0];
    let strongest = |at: Position| {
        let distance = |p: Option<Position>| p.unwrap().distance(at);
        let units = corridor.graph.radio_units();
        units
            .map(|(n, _)| n)
            .min_by(|a, b| distance(a.position).total_cmp(&distance(b.position)))
            .unwrap()
            .id
            .clone()
    };
    let mut passed: Vec<NodeId> = Vec::new();
    for ends in walk.waypoints.windows(2) {
        for step in 0..10 {
            let along = f64::from(step) / 10.0;
            let [from, to] = [ends[0], ends[1]];
            let at = Position::new(from.x + (to.x - from.x) * along, from.y + (to.y - from.y) * along);
            let unit = strongest(at);
            if passed.last() != Some(&unit) {
                passed.push(unit);
            }
        }
    }
    assert_eq!(passed, ["R1", "R3", "R2", "R4", "R5", "R4", "R2", "R3", "R1"]);
}

#[test]
fn the_gateway_has_a_port_and_is_no_host() {
    let graph = shipped("gateway.yaml").graph;
    let (node, gateway) = graph.gateways().next().unwrap();
    assert!(node.has_port() && !node.is_host() && node.capacity().is_none());
    assert_eq!((gateway.interface.as_str(), gateway.netns.as_deref()), ("cotorra0", None));
    assert_eq!(gateway.machines[&id("plc")].to_string(), "192.168.77.2");
    assert_eq!(graph.address(&node.id), None);
}

#[test]
fn real_servers_are_servers_with_the_addresses_of_machines() {
    let graph = shipped("real-servers.yaml").graph;
    let servers: Vec<_> =
        graph.real_servers().map(|(node, real)| (node.id.as_str(), real.agent.as_str())).collect();
    assert_eq!(servers, [("fog", "fog1"), ("edge", "edge1"), ("cloud", "cloud1")]);
    let edge = graph.node(&id("edge")).unwrap();
    assert!(edge.is_host() && edge.has_port() && edge.capacity().unwrap().cpus == 4.0);
    assert_eq!(
        (graph.address(&edge.id), graph.ipv4(&edge.id).unwrap().to_string()),
        (None, "192.168.77.3".to_owned())
    );
    let at_r1 = graph.route(&id("R1"), &id("cloud"), |_| None).unwrap();
    assert_eq!(at_r1.links, ["lan-R1", "lan-cloud"]);
    assert_eq!(at_r1.delay, Duration::from_millis(10));
}

#[test]
fn two_hosts_loads() {
    let testbed = shipped("two-hosts.yaml");
    assert_eq!(testbed.graph.hosts().count(), 2);
    let route = testbed.graph.route(&id("left"), &id("right"), |_| None).unwrap();
    assert_eq!(route.links, ["left-lan", "lan-right"]);
    assert_eq!(route.delay, Duration::from_millis(2));
}

#[test]
fn routes_cross_only_what_forwards() {
    let corridor = shipped("corridor.yaml");
    let r2 = id("R2");
    let attached = |_: &NodeId| Some(&r2);
    let route = |from, to| corridor.graph.route(&id(from), &id(to), attached);
    let to_cloud = route("robot", "cloud").unwrap();
    assert_eq!(to_cloud.links, ["robot~R2", "R2-cloud"]);
    assert_eq!(to_cloud.delay, Duration::from_millis(10));
    assert_eq!(route("fog", "cloud").unwrap().links, ["lan-fog", "lan-cloud"]);
    // Servers forward nothing, and the robot is attached to R2 only.
    assert_eq!(route("R1", "R2"), None);
    assert_eq!(route("R1", "robot"), None);
    assert_eq!(route("robot", "robot").unwrap().links, [] as [LinkId; 0]);
}

#[test]
fn graphs_survive_json() {
    let graph = shipped("corridor.yaml").graph;
    let json = serde_json::to_string(&graph).unwrap();
    assert_eq!(serde_json::from_str::<cotorra_graph::HardwareGraph>(&json).unwrap(), graph);
}

#[test]
fn robots_roam_by_the_policy_of_the_file() {
    let roaming = |policy: &str| {
        let setting = format!("nodes.robot.roaming={policy}").parse().unwrap();
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
        let testbed =
            cotorra_testbed_file::load_with(path, &[setting]).unwrap_or_else(|wrong| panic!("{wrong}"));
        let roaming = testbed.graph.robots().next().unwrap().1.roaming;
        let json = serde_json::to_value(roaming).unwrap();
        assert_eq!(serde_json::from_value::<Roaming>(json.clone()).unwrap(), roaming);
        (roaming, json)
    };
    assert_eq!(roaming("signal"), (Roaming::Signal, serde_json::json!("signal")));
    assert_eq!(roaming("instructed"), (Roaming::Instructed, serde_json::json!("instructed")));
    let supplicant = Roaming::Supplicant(BackgroundScan::default());
    assert_eq!(roaming("supplicant").0, supplicant);
    assert_eq!(roaming("{ policy: supplicant }").0, supplicant);
    let changed =
        roaming("{ policy: supplicant, threshold: -70 dBm, short_interval: 10 s, long_interval: 1 min }");
    let (short_interval, long_interval) = (Duration::from_secs(10), Duration::from_secs(60));
    let expected = BackgroundScan { threshold: Dbm(-70.0), short_interval, long_interval };
    assert_eq!(changed.0, Roaming::Supplicant(expected));
    let json = serde_json::json!({ "supplicant": {
        "threshold_dbm": -70.0, "short_interval_ms": 10_000.0, "long_interval_ms": 60_000.0,
    } });
    assert_eq!(changed.1, json);
}

#[test]
fn the_corridor_with_real_wifi_differs_from_the_corridor_by_its_radio_alone() {
    let plain = shipped("corridor.yaml");
    for name in ["corridor-wifi.yaml", "university.yaml"] {
        let mut real = shipped(name);
        let network = &real.graph.wireless["corridor"];
        assert!(network.fading.is_some() && !network.access.interference().is_empty());
        real.graph.wireless.clone_from(&plain.graph.wireless);
        assert_eq!(real.graph, plain.graph);
        assert_eq!(
            (real.services, real.walks, &real.map),
            (plain.services.clone(), plain.walks.clone(), &plain.map)
        );
    }
}

#[test]
fn walls_attenuate_on_the_map_of_the_testbed() {
    let settings = ["wireless.corridor.walls.each=brick", "wireless.corridor.walls.at_most=9 dB"]
        .map(|setting| setting.parse().unwrap());
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let walled = cotorra_testbed_file::load_with(path, &settings).unwrap_or_else(|wrong| panic!("{wrong}"));
    let (open, map) = (shipped("corridor.yaml"), walled.map.as_ref().unwrap());
    let network = &walled.graph.wireless["corridor"];
    let walls = network.walls.as_ref().unwrap();
    assert_eq!((walls.loss, &*walls.map), (WallLoss { loss_db: 3.7, at_most_db: Some(9.0) }, map));
    let mut most = 0;
    for ((unit, _), at) in walled
        .graph
        .radio_units()
        .flat_map(|unit| walled.walks[0].waypoints.iter().map(move |at| (unit, *at)))
    {
        let [with, without] = [&walled, &open].map(|testbed| testbed.graph.mean_signal(unit, at).unwrap().0);
        let crossed = map.walls_between(unit.position.unwrap(), at);
        most = most.max(crossed);
        assert!((without - with - f64::min(crossed as f64 * 3.7, 9.0)).abs() < 1e-9, "{} at {at}", unit.id);
    }
    assert!(most > 1, "the corridor has corners");
    // Without settings there is none, and JSON has no key for it.
    assert_eq!(open.graph.wireless["corridor"].walls, None);
    assert!(!serde_json::to_string(&open.graph).unwrap().contains("walls"));
    let json = serde_json::to_value(&walled.graph).unwrap();
    assert_eq!(
        json["wireless"]["corridor"]["walls"],
        serde_json::json!({ "wall_loss_db": 3.7, "at_most_db": 9.0 })
    );
    let read = serde_json::from_value::<cotorra_graph::HardwareGraph>(json).unwrap_err().to_string();
    assert_eq!(read, "walls need their map, which is no part of the graph in JSON");
}

#[test]
fn fading_is_rayleigh_rician_or_none() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testbeds/corridor.yaml");
    let fading = |settings: &[&str]| {
        let settings: Vec<_> = settings
            .iter()
            .map(|setting| format!("wireless.corridor.fading{setting}").parse().unwrap())
            .collect();
        let testbed =
            cotorra_testbed_file::load_with(&path, &settings).unwrap_or_else(|wrong| panic!("{wrong}"));
        testbed.graph.wireless["corridor"].fading
    };
    let of = |k_factor_db, motion_mps| Some(Fading { k_factor_db, motion_mps });
    assert_eq!(fading(&[]), None);
    assert_eq!(fading(&["=rayleigh"]), of(None, 0.0));
    assert_eq!(fading(&[".motion=0.3 m/s"]), of(None, 0.3));
    assert_eq!(fading(&[".k_factor=6 dB", ".motion=0.3 m/s"]), of(Some(6.0), 0.3));
    // Without settings, JSON has no key for it.
    let json = |fading| serde_json::to_value(fading).unwrap();
    assert!(!serde_json::to_string(&shipped("corridor.yaml").graph).unwrap().contains("fading"));
    assert_eq!(json(of(None, 0.0)), serde_json::json!({ "motion_mps": 0.0 }));
    assert_eq!(json(of(Some(6.0), 0.3)), serde_json::json!({ "k_factor_db": 6.0, "motion_mps": 0.3 }));
}

/// Returns the warnings of links and a schedule.
fn warnings(links: &str) -> Vec<String> {
    let text = format!(
        "name: x\nnodes:\n  a: {{ kind: server, tier: fog, cpus: 4, memory: 8 GB }}\n  lan: {{ kind: switch }}\n{links}"
    );
    let (_, warnings) = cotorra_testbed_file::parse_with_warnings("x.yaml", &text, Path::new(""), &[])
        .unwrap_or_else(|wrong| panic!("{wrong}"));
    let list = warnings.map(|warnings| warnings.list).unwrap_or_default();
    list.into_iter().map(|warning| format!("{}: {}", warning.line, warning.message)).collect()
}

#[test]
fn jitter_that_raises_the_mean_delay_is_warned_of() {
    let jitter = |keys: &str| warnings(&format!("links:\n  - {{ ends: [a, lan], {keys} }}\n"));
    let of = |distribution: &str, ms: u32| {
        jitter(&format!("delay: 10 ms, jitter: {{ deviation: {ms} ms, distribution: {distribution} }}"))
    };
    for (distribution, largest, mean) in
        [("uniform", 10, "15.625ms"), ("normal", 5, "21.454ms"), ("pareto", 17, "14.019ms")]
    {
        assert_eq!(of(distribution, largest), [""; 0], "{distribution}");
        let expected = format!("6: with this jitter, the mean delay is {mean}, not 10ms");
        assert_eq!(of(distribution, 40), [expected], "{distribution}");
    }
    assert_eq!(jitter("jitter: 1 ms"), ["6: with this jitter, the mean delay is 399µs, not 0ns"]);
    assert_eq!(jitter("delay: 10 ms, jitter: 2 ms, backward: { delay: 1 ms }").len(), 1);
}

#[test]
fn scheduled_jitter_that_raises_the_mean_delay_is_warned_of() {
    let scheduled = |set: &str| {
        warnings(&format!(
            "links:\n  - {{ ends: [a, lan], delay: 10 ms, jitter: 2 ms }}\n\
             schedule:\n  - {{ at: 5 s, links: a-lan, set: {{ {set} }} }}\n"
        ))
    };
    assert_eq!(scheduled("delay: 4 ms"), [""; 0]);
    for set in ["delay: 1 ms", "jitter: 20 ms", "delay: 40 ms, jitter: 80 ms"] {
        let [warning] = &scheduled(set)[..] else { panic!("{set}: {:?}", scheduled(set)) };
        assert!(warning.starts_with("8: with this jitter"), "{set}: {warning}");
    }
}
