//! Random valid testbeds, as text of a testbed file: they pass the same checks as a user's.

use std::fmt::Write;

use super::draw::Draw;

/// A testbed file, and the map that it names, if any.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Generated {
    pub(crate) text: String,
    pub(crate) map: Option<Map>,
}

/// A ROS map_server map: a room with walls around it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Map {
    pub(crate) yaml: String,
    pub(crate) pgm: Vec<u8>,
}

/// File names of the map.
pub(crate) const MAP_YAML: &str = "room.yaml";
pub(crate) const MAP_PGM: &str = "room.pgm";

/// Least distance between a waypoint and a wall, metres.
const CLEARANCE: f64 = 1.0;
/// Size of a pixel, metres.
const RESOLUTION: f64 = 0.1;

/// Returns the testbed of a seed: one to four robots, one to four radio units, one or two switches, and two to four
/// servers. One server has hardly more room than one VNF needs.
pub(crate) fn testbed(seed: u64) -> Generated {
    let mut draw = Draw::new(seed, "testbed");
    let (robots, units) = (draw.whole(1..=4), draw.whole(1..=4));
    let (switches, servers) = (draw.whole(1..=2), draw.whole(2..=4));
    let has_map = draw.chance(0.1);
    let (width, height) = if has_map { (12.0, 8.0) } else { (30.0, 20.0) };
    // At most one robot: localization takes most of a run's time.
    let localized = has_map && draw.chance(0.7);
    // Other domains that offer virtual access points over a ledger.
    let partners = if !has_map && draw.chance(0.15) { draw.whole(1..=3) } else { 0 };

    let mut text = format!("name: faults-{seed}\nseed: {seed}\n");
    let mut line = |words: std::fmt::Arguments<'_>| writeln!(text, "{words}").expect("text grows");
    if has_map {
        line(format_args!("map: {MAP_YAML}"));
    }
    if partners > 0 {
        let all: Vec<_> = (1..=partners).map(|partner| format!("partner-{partner}")).collect();
        line(format_args!("domains: [home, {}]", all.join(", ")));
    }
    line(format_args!("wireless:"));
    let (fast, gap) = (draw.chance(0.5), *draw.one(&["hold", "drop"]));
    let exponent = draw.number(2.5, 3.5);
    line(format_args!(
        "  lab: {{ standard: n, fast_transition: {fast}, gap: {gap}, delay: {} ms, path_loss: {{ model: log_distance, \
         exponent: {exponent} }} }}",
        draw.number(0.0, 2.0)
    ));

    line(format_args!("nodes:"));
    for robot in 1..=robots {
        let roaming = draw.one(&["instructed", "signal"]);
        line(format_args!("  robot-{robot}: {{ kind: robot, roaming: {roaming} }}"));
    }
    for unit in 1..=units {
        let (x, y) = (draw.number(0.0, width), draw.number(0.0, height));
        let channel = draw.one(&[1, 6, 11]);
        // Robots attach to the first at the start. If it is off, some find none.
        let off = draw.chance(if unit == 1 { 0.1 } else { 0.3 });
        let off = if off { ", serving: false, deployment: 300 ms" } else { "" };
        line(format_args!(
            "  unit-{unit}: {{ kind: radio_unit, position: [{x}, {y}], channel: {channel}{off} }}"
        ));
    }
    for partner in 1..=partners {
        // Placed in the middle, within range of most walks.
        let (x, y) = (draw.number(10.0, 20.0), draw.number(6.0, 14.0));
        line(format_args!(
            "  partner-unit-{partner}: {{ kind: radio_unit, domain: partner-{partner}, position: [{x}, {y}], \
             channel: {}, serving: false }}",
            draw.one(&[1, 6, 11])
        ));
    }
    (1..=switches).for_each(|switch| line(format_args!("  switch-{switch}: {{ kind: switch }}")));
    // CPUs of each robot's navigation. The first server has room for all, the second for one.
    let cpus: Vec<f64> = (0..robots).map(|_| draw.number(0.5, 2.0)).collect();
    let most = cpus.iter().copied().fold(0.0, f64::max);
    for server in 1..=servers {
        let tier = draw.one(&["fog", "edge", "cloud"]);
        let room = match server {
            1 => cpus.iter().sum::<f64>() + 1.5,
            2 => most + 0.2,
            _ => draw.number(0.5, 8.0),
        };
        let memory = if server == 1 { 8 } else { draw.whole(1..=2) };
        line(format_args!(
            "  server-{server}: {{ kind: server, tier: {tier}, cpus: {room:.3}, memory: {memory} GB, cost: {} }}",
            draw.whole(1..=4)
        ));
    }

    line(format_args!("links:"));
    for unit in 1..=units {
        let switch = draw.whole(1..=switches);
        line(format_args!("  - {{ ends: [switch-{switch}, unit-{unit}]{} }}", conditions(&mut draw)));
    }
    for partner in 1..=partners {
        line(format_args!("  - {{ ends: [switch-1, partner-unit-{partner}]{} }}", conditions(&mut draw)));
    }
    for server in 1..=servers {
        let switch = draw.whole(1..=switches);
        line(format_args!("  - {{ ends: [switch-{switch}, server-{server}]{} }}", conditions(&mut draw)));
    }
    if switches == 2 {
        line(format_args!("  - {{ ends: [switch-1, switch-2]{} }}", conditions(&mut draw)));
    }

    // Each rate is below the narrowest link's; several together are above it.
    let mut rates = Draw::new(seed, "rates");
    let mut requests = Draw::new(seed, "requests");
    line(format_args!("services:"));
    for (robot, cpus) in (1..=robots).zip(&cpus) {
        line(format_args!("  navigation-{robot}:"));
        line(format_args!("    robot: robot-{robot}"));
        line(format_args!("    kpis: {{ service_time: 500 ms }}"));
        line(format_args!("    requests: {}", requests.one(&["one", "nearest", "all"])));
        line(format_args!("    vnfs:"));
        line(format_args!(
            "      driver-{robot}: {{ program: robot_driver, pinned_to: robot-{robot}, cpus: 0.5 }}"
        ));
        line(format_args!(
            "      brain-{robot}: {{ program: navigation, node: server-1, cpus: {cpus}, memory: {} MB }}",
            draw.whole(100..=900)
        ));
        line(format_args!("    virtual_links:"));
        line(format_args!(
            "      - {{ from: driver-{robot}, to: brain-{robot}, rate: {} Mbit/s }}",
            rates.number(0.1, 0.9)
        ));
    }
    if localized {
        line(format_args!(
            "  localization:\n    robot: robot-1\n    kpis: {{ service_time: 900 ms }}\n    vnfs:\n      \
             lidar: {{ program: robot_driver, pinned_to: robot-1, cpus: 0 }}\n      \
             localization: {{ program: localization, node: server-1, cpus: 1 }}\n    virtual_links:\n      \
             - {{ from: lidar, to: localization, rate: 0.1 Mbit/s }}"
        ));
    }

    line(format_args!("walks:"));
    for robot in 1..=robots {
        let place = |draw: &mut Draw| {
            let (x, y) =
                (draw.number(CLEARANCE, width - CLEARANCE), draw.number(CLEARANCE, height - CLEARANCE));
            format!("[{x}, {y}]")
        };
        let waypoints: Vec<_> = (0..draw.whole(2..=4)).map(|_| place(&mut draw)).collect();
        line(format_args!(
            "  robot-{robot}: {{ waypoints: [{}], speed_limit: {} m/s, position_interval: {} ms }}",
            waypoints.join(", "),
            draw.number(0.2, 0.7),
            draw.whole(50..=200)
        ));
    }

    // Orchestrators attach robots themselves.
    let probing = partners == 0 && draw.chance(0.4);
    let okpi = partners == 0 && draw.chance(0.3);
    if partners > 0 || probing || okpi {
        line(format_args!("plugins:"));
    }
    if probing {
        let interval = draw.whole(1..=4);
        line(format_args!("  - {{ bundled: probing, settings: {{ interval: {interval} s }} }}"));
    }
    if okpi {
        line(format_args!("  - {{ bundled: okpi, settings: {{ relax: true }} }}"));
    }
    if partners > 0 {
        let period = draw.whole(500..=1500);
        let mut orchestrator = |domain: &str, settings: &str, draw: &mut Draw| {
            let began = draw.number(0.0, 10.0);
            let ended = began + draw.number(0.5, 5.0);
            let outage =
                if draw.chance(0.2) { format!(", outage: [{began} s, {ended:.3} s]") } else { String::new() };
            line(format_args!(
                "  - {{ id: {domain}-orchestrator, bundled: federation, domain: {domain}, settings: {{ ledger: \
                 {{ kind: modelled, block_period: {period} ms{outage} }}, {settings} }} }}"
            ));
        };
        let edge = draw.number(-65.0, -45.0);
        orchestrator("home", &format!("highest_price: 150, edge: {edge} dBm, patience: 10 s"), &mut draw);
        for partner in 1..=partners {
            let price = draw.whole(50..=200);
            let behaviour = draw.one(&["honest", "honest", "honest", "silent", "idle", "lying"]);
            let settings = format!("price: {price}, behaviour: {behaviour}");
            orchestrator(&format!("partner-{partner}"), &settings, &mut draw);
        }
    }
    Generated { text, map: has_map.then(|| room(width, height)) }
}

/// Returns random conditions of a link.
fn conditions(draw: &mut Draw) -> String {
    let mut all = format!(", delay: {} ms", draw.number(0.0, 20.0));
    let mut sometimes = |probability: f64, draw: &mut Draw, words: &dyn Fn(&mut Draw) -> String| {
        if draw.chance(probability) {
            all += ", ";
            all += &words(draw);
        }
    };
    sometimes(0.3, draw, &|draw| format!("jitter: {} ms", draw.number(0.0, 5.0)));
    sometimes(0.3, draw, &|draw| format!("loss: {} %", draw.number(0.0, 10.0)));
    sometimes(0.1, draw, &|draw| format!("duplication: {} %", draw.number(0.0, 10.0)));
    sometimes(0.1, draw, &|draw| format!("corruption: {} %", draw.number(0.0, 10.0)));
    sometimes(0.1, draw, &|draw| format!("reordering: {} %", draw.number(0.0, 10.0)));
    sometimes(0.5, draw, &|draw| format!("rate: {} Mbit/s", draw.number(1.0, 100.0)));
    sometimes(0.2, draw, &|draw| format!("queue: {} packets", draw.whole(1..=20)));
    all
}

/// Returns an empty room with walls; the origin is one corner.
fn room(width: f64, height: f64) -> Map {
    let pixels = |metres: f64| (metres / RESOLUTION).round() as usize;
    let (columns, rows) = (pixels(width), pixels(height));
    let mut pgm = format!("P5\n{columns} {rows}\n255\n").into_bytes();
    for row in 0..rows {
        let is_wall = |column| row == 0 || row + 1 == rows || column == 0 || column + 1 == columns;
        pgm.extend((0..columns).map(|column| if is_wall(column) { 0 } else { 254 }));
    }
    let yaml = format!(
        "image: {MAP_PGM}\nresolution: {RESOLUTION}\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n\
         free_thresh: 0.196\n"
    );
    Map { yaml, pgm }
}
