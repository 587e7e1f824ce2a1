//! Builds a testbed from its records: names become references, figures become conditions. Mistakes within one record
//! are reported here, those between records in [`super::check`].

mod access;
mod border;
mod builder;
mod compose;
mod computing;
mod containers;
mod distributions;
mod flows;
mod inference;
mod kobuki;
mod links;
mod nodes;
mod plugins;
mod power;
mod queues;
mod recordings;
mod ros;
mod script;
mod sensors;
mod services;
mod state;
mod traffic;
mod wifi_software;

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::Path,
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    DomainId, GeoOrigin, HardwareGraph, NodeId, OccupancyGrid, Probing, Retention, Retentions, ServiceId,
    Testbed, WaisSettings, Walk,
};

pub(super) use self::builder::is_variable;
use self::builder::{Builder, each};
pub use self::plugins::{COMMAND_LINE, SCHEDULE};
use crate::{
    map_server,
    records::{
        ProbesRecord, ProbesWord, RetentionRecord, RetentionsRecord, TestbedRecord, WaisRecord, WalkRecord,
    },
    yaml::{
        Diagnostic, Sink,
        decode::{Either, Name as _, Spanned},
    },
};

/// Builds and checks the testbed; `None` when it cannot be, which the sink then knows.
pub(super) fn build(record: &TestbedRecord, base_dir: &Path, sink: &mut Sink) -> Option<Testbed> {
    // The testbed's name becomes part of the name of a run's folder, and keeps the rules of all names.
    ServiceId::read_or_report(&record.name.value, &record.name.span, sink);
    let mut builder = Builder {
        domains: domains(&record.domains, sink),
        nodes: record.nodes.0.iter().map(|(id, node)| (id.value.as_str(), node)).collect(),
        networks: record.wireless.0.iter().map(|(ssid, _)| ssid.value.as_str()).collect(),
        record,
        base_dir,
        traces: HashMap::new(),
        composed: HashSet::new(),
        sink,
    };
    let map = builder.map();
    let has_walls = record.wireless.0.iter().any(|(_, network)| network.walls.is_some());
    let floor = if has_walls { map.clone().flatten().map(Arc::new) } else { None };
    let wireless: Option<BTreeMap<_, _>> = each(&record.wireless.0, |(ssid, network)| {
        Some((ssid.value.clone(), builder.wireless(ssid, network, floor.as_ref())?))
    });
    let nodes = builder.nodes();
    if let (Some(wireless), Some(nodes)) = (&wireless, &nodes) {
        builder.check_shared_channels(wireless, nodes);
    }
    let links = builder.links();
    let mut services: Option<Vec<_>> = each(&record.services.0, |(id, service)| builder.service(id, service));
    if let (Some(nodes), Some(services)) = (&nodes, &mut services) {
        flows::of_brains(nodes, services);
    }
    let containers = builder.containers();
    let walks: Option<Vec<_>> = each(&record.walks.0, |(robot, walk)| builder.walk(robot, walk));
    let traffic = builder.all_traffic(links.as_deref());
    let core = builder.core();
    let currency = builder.currency();
    let plugins = builder.plugins(core.as_ref().and_then(Option::as_ref));
    let wais = builder.wais(&record.wais);
    let script = script::script(&mut builder, links.as_deref());
    let border = builder.border();
    let without_port_security = builder.without_port_security();
    let domains = builder.domains;
    let probes = probes(&record.probes, sink);
    let retention = retentions(&record.history.retention, sink);
    Some(Testbed {
        graph: HardwareGraph { domains, nodes: nodes?, links: links?, wireless: wireless? },
        services: services?,
        map: map?,
        walks: walks?,
        plugins: plugins?,
        wais: wais?,
        core: core?,
        seed: record.seed,
        emulation: record.emulation,
        script: script?,
        probes,
        retention,
        border: border?,
        without_port_security: without_port_security?,
        traffic: traffic?,
        reservations: record.reservations,
        containers: containers?,
        description: record.description.clone(),
        currency: currency?,
        // Only a working folder that does not exist any more has no absolute path.
        folder: std::path::absolute(base_dir.join(".")).unwrap_or_default(),
        name: record.name.value.clone(),
    })
}

fn probes(record: &Either<ProbesWord, ProbesRecord>, sink: &mut Sink) -> Option<Probing> {
    let Either::Long(ProbesRecord { interval, window }) = record else { return None };
    let probing = Probing { interval: interval.value, window: window.value };
    if probing.interval < Probing::SHORTEST {
        sink.error(&interval.span, "probes less than a millisecond apart")
            .help("write `500 ms`, or any time from 1 ms on; `probes: none` switches them off");
    } else if probing.window < probing.interval * 2 {
        sink.error(&window.span, "this window has not even two probes")
            .help(format!("write {:?} or more, or a shorter `interval`", probing.interval * 2));
    } else if probing.window > probing.interval * Probing::MOST {
        sink.error(&window.span, format!("this window has more than {} probes", Probing::MOST))
            .help("write a shorter window, or a longer `interval`");
    }
    Some(probing)
}

pub(super) fn retentions(record: &RetentionsRecord, sink: &mut Sink) -> Retentions {
    let mut of = |record: &Option<RetentionRecord>| {
        let RetentionRecord { raw, step, keep } = record.as_ref()?;
        if !Retention::is_step(step.value) {
            sink.error(&step.span, "a minute is not a multiple of this step, or it is shorter than 10 ms")
                .help("write it like `1 s`, `5 s` or `1 min`");
        }
        Some(Retention { raw: *raw, step: step.value, keep: *keep })
    };
    Retentions {
        robots: of(&record.robots),
        radio_units: of(&record.radio_units),
        links: of(&record.links),
        sensors: of(&record.sensors),
        machines: of(&record.machines),
    }
}

/// Metres from the ellipsoid beyond which the map's floor is surely elsewhere.
const HIGHEST_M: f64 = 1e5;

fn domains(listed: &[Spanned<DomainId>], sink: &mut Sink) -> Vec<DomainId> {
    let mut seen = HashSet::new();
    for domain in listed {
        if !seen.insert(&domain.value) {
            sink.error(&domain.span, format!("the domain `{}` is here twice", domain.value))
                .help("remove one of them, or rename it");
        }
    }
    if listed.is_empty() {
        vec![DomainId::new("local").expect("it is a name")]
    } else {
        listed.iter().map(|d| d.value.clone()).collect()
    }
}

impl Builder<'_> {
    fn map(&mut self) -> Option<Option<OccupancyGrid>> {
        let Some(path) = &self.record.map else { return Some(None) };
        let place = |d: &Diagnostic| format!("{}:{}:{}: {}", path.value, d.line, d.column, d.message);
        match map_server::load_with_warnings(self.base_dir.join(&path.value)) {
            Ok((grid, warnings)) => {
                for d in warnings.into_iter().flat_map(|found| found.list) {
                    self.sink.warning(&path.span, place(&d)).help(d.help.unwrap_or_default());
                }
                Some(Some(grid))
            }
            Err(found) => {
                for d in found.list {
                    let message = if found.source_text.is_empty() { d.message.clone() } else { place(&d) };
                    self.sink.error(&path.span, message).help(d.help.unwrap_or_default());
                }
                None
            }
        }
    }

    fn walk(&mut self, robot: &Spanned<NodeId>, record: &WalkRecord) -> Option<Walk> {
        let robot = self.robot(robot);
        let mut waypoints: Vec<_> = record.waypoints.value.iter().map(|w| w.value).collect();
        if record.and_back {
            let back: Vec<_> = waypoints.iter().rev().skip(1).copied().collect();
            waypoints.extend(back);
        }
        if let Some(next) = record.next.as_ref().filter(|next| next.value as usize > waypoints.len()) {
            let most = waypoints.len();
            self.sink
                .error(&next.span, format!("the walk has no waypoint {}", next.value))
                .help(format!("write an index from 0; {most} is the end of this walk"));
        }
        let (position_interval, random_intervals) = match &record.position_interval.value {
            Either::Short(interval) => (*interval, None),
            Either::Long(_) => {
                let intervals = self.distribution(&record.position_interval, false)?;
                (Duration::from_secs_f64(intervals.mean()), Some(intervals))
            }
        };
        Some(Walk {
            robot: robot?,
            waypoints,
            next: record.next.as_ref().map(|next| next.value),
            speed_limit: record.speed_limit.value.0,
            position_interval,
            random_intervals,
        })
    }

    fn wais(&mut self, record: &WaisRecord) -> Option<WaisSettings> {
        let mut degrees = |figure: &Spanned<f64>, most: f64| {
            let well = figure.value.abs() <= most;
            if !well {
                self.sink
                    .error(&figure.span, format!("{} degrees are too many", figure.value))
                    .help(format!("write degrees from -{most} to {most}"));
            }
            well.then_some(figure.value)
        };
        let callbacks = record.callbacks.clone();
        let Some(origin) = &record.origin else { return Some(WaisSettings { callbacks, origin: None }) };
        let (latitude, longitude) = (degrees(&origin.latitude, 90.0), degrees(&origin.longitude, 180.0));
        let altitude = match &origin.altitude {
            Some(altitude) if altitude.value.abs() > HIGHEST_M => {
                self.sink
                    .error(&altitude.span, format!("{} m above the ellipsoid", altitude.value))
                    .help(format!("write metres from -{HIGHEST_M} to {HIGHEST_M}"));
                return None;
            }
            altitude => altitude.as_ref().map(|altitude| altitude.value),
        };
        let bearing = origin.bearing.0;
        let origin = GeoOrigin { latitude: latitude?, longitude: longitude?, bearing, altitude };
        Some(WaisSettings { callbacks, origin: Some(origin) })
    }
}
