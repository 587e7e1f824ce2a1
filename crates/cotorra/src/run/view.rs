//! Progress of a run: a live view on a terminal, or else a plain line at intervals.

use std::{net::SocketAddr, path::Path, time::Duration};

use cotorra_graph::{NodeId, Nodes, Program, RobotContext, Service, Testbed, Vnf, Walk, millis};
use cotorra_testbed::{NetworkApi, Snapshot};
use indicatif::MultiProgress;

use super::{lines::Lines, tally::Tally};
use crate::{
    testbed_file::length,
    words::{clock, count, in_ms, percent},
};

/// Maximum number of robots that are shown. Further ones are only counted.
const ROBOTS_SHOWN: usize = 8;
/// Run time between two plain lines in seconds.
const LINE_EVERY_S: f64 = 10.0;
/// Refreshes for each drawing of the live view, at a rate that people can read.
const REFRESHES_PER_FRAME: u32 = 6;

/// Addresses and folder of a run.
#[derive(Debug)]
pub struct Places<'a> {
    pub api: SocketAddr,
    /// Address of the API for other machines.
    pub network: Option<&'a NetworkApi>,
    pub foxglove: Option<SocketAddr>,
    pub folder: &'a Path,
    /// Serving radio units of real Wi-Fi software, and joined robots.
    pub wifi: Option<String>,
}

/// View of a run's progress.
pub struct View<'a> {
    testbed: &'a Testbed,
    until: Option<Duration>,
    tally: Tally,
    shape: Shape,
}

enum Shape {
    Live {
        lines: Lines,
        /// Robots and the numbers of their lines. Below them are the other lines.
        robots: Vec<(NodeId, usize)>,
        so_far: usize,
        places: usize,
        /// Refreshes until the next drawing.
        refreshes: u32,
    },
    Plain {
        next_s: f64,
    },
}

impl<'a> View<'a> {
    /// Creates a live view on `terminal`, or plain lines if the terminal is hidden.
    pub fn new(
        testbed: &'a Testbed,
        until: Option<Duration>,
        places: &Places<'_>,
        terminal: &MultiProgress,
    ) -> Self {
        let shape =
            if terminal.is_hidden() { Self::plain(places) } else { Self::live(testbed, places, terminal) };
        Self { testbed, until, tally: Tally::default(), shape }
    }

    fn plain(places: &Places<'_>) -> Shape {
        if let Some(foxglove) = places.foxglove {
            note!("Foxglove on ws://{foxglove}");
        }
        if let Some(wifi) = &places.wifi {
            note!("Wi-Fi: {wifi}");
        }
        if let Some(network) = places.network {
            note!("Network on {network}");
        }
        note!("Dashboard on http://{}/", places.api);
        note!("API on http://{}, run in {}", places.api, places.folder.display());
        Shape::Plain { next_s: LINE_EVERY_S }
    }

    fn live(testbed: &Testbed, places: &Places<'_>, terminal: &MultiProgress) -> Shape {
        let robots: Vec<_> = testbed.graph.robots().map(|(node, _)| node.id.clone()).collect();
        let labels = ["so far", "API", "Dashboard", "Foxglove", "Network", &testbed.name]
            .into_iter()
            .chain(robots.iter().map(NodeId::as_str));
        let width = labels.map(str::len).max().unwrap_or(0);
        let mut lines = Lines::new(terminal, &testbed.name, width);
        let more = robots.len().saturating_sub(ROBOTS_SHOWN);
        let robots = robots
            .into_iter()
            .take(ROBOTS_SHOWN)
            .map(|id| (id.clone(), lines.add(id.as_str(), "")))
            .collect();
        if more > 0 {
            lines.add("", &format!("and {more} more robots"));
        }
        if let Some(foxglove) = places.foxglove {
            lines.add("Foxglove", &format!("ws://{foxglove}"));
        }
        if let Some(wifi) = &places.wifi {
            lines.add("Wi-Fi", &format!("at the start: {wifi}"));
        }
        if let Some(network) = places.network {
            lines.add("Network", &network.to_string());
        }
        lines.add("Dashboard", &format!("http://{}/", places.api));
        let so_far = lines.add("so far", "");
        let places = lines.add("API", &format!("http://{}, run in {}", places.api, places.folder.display()));
        Shape::Live { lines, robots, so_far, places, refreshes: 0 }
    }

    /// Counts new service times, and shows the state if it is due.
    pub fn show(&mut self, now: &Snapshot) {
        for service in &self.testbed.services {
            if let Some(sample) = now.service_times.get(&service.id) {
                let in_total = self.testbed.services_in_total().any(|other| other.id == service.id);
                self.tally.count(sample, target_ms(service), in_total);
            }
        }
        match &mut self.shape {
            Shape::Live { refreshes, .. } if *refreshes > 0 => *refreshes -= 1,
            Shape::Live { lines, robots, so_far, refreshes, .. } => {
                *refreshes = REFRESHES_PER_FRAME - 1;
                lines.fit();
                let (share, text) = progress(self.testbed, self.until, now);
                lines.progress(share, text);
                for (id, line) in robots {
                    lines.set(*line, robot(self.testbed, &self.tally, now, id));
                }
                lines.set(*so_far, summary(self.testbed, &self.tally));
            }
            Shape::Plain { next_s } => {
                let at_s = now.at.as_secs_f64();
                if at_s >= *next_s {
                    *next_s = (at_s / LINE_EVERY_S).floor() * LINE_EVERY_S + LINE_EVERY_S;
                    let robots = self.testbed.graph.robots().take(ROBOTS_SHOWN);
                    let robots: Vec<_> = robots
                        .map(|(r, _)| format!("{} {}", r.id, robot(self.testbed, &self.tally, now, &r.id)))
                        .collect();
                    note!(
                        "{at_s:5.0} s  {}; so far {}",
                        robots.join("; "),
                        summary(self.testbed, &self.tally)
                    );
                }
            }
        }
    }

    /// Shows that the run is ending.
    pub fn ending(&mut self) {
        const ENDING: &str = "ending in order; Ctrl-C again ends it at once";
        match &mut self.shape {
            Shape::Live { lines, places, .. } => lines.set(*places, ENDING.to_owned()),
            Shape::Plain { .. } => note!("{ENDING}"),
        }
    }

    /// Removes the live view.
    pub fn close(self) {
        if let Shape::Live { lines, .. } = self.shape {
            lines.close();
        }
    }
}

/// Returns the progress from 0 to 1, and in words.
fn progress(testbed: &Testbed, until: Option<Duration>, now: &Snapshot) -> (f64, String) {
    let time_s = now.at.as_secs_f64();
    let of_time = until.map_or(0.0, |until| time_s / until.as_secs_f64());
    let total: f64 = testbed.walks.iter().map(|walk| length(&walk.waypoints)).sum();
    let walked: f64 = testbed
        .walks
        .iter()
        .filter_map(|walk| now.robots.get(&walk.robot).map(|context| walked(walk, context)))
        .sum();
    let of_walk = if total > 0.0 { walked / total } else { 0.0 };
    let mut text = clock(time_s);
    if let Some(until) = until {
        text += &format!(" of {}", clock(until.as_secs_f64()));
    }
    if total > 0.0 {
        text += &format!(", {walked:.0} of {total:.0} m");
    }
    (of_time.max(of_walk).min(1.0), text)
}

/// Returns how far a robot is along its walk, in metres.
fn walked(walk: &Walk, context: &RobotContext) -> f64 {
    let next = context.waypoint as usize;
    match walk.waypoints.get(next) {
        None => length(&walk.waypoints),
        Some(_) if next == 0 => 0.0,
        Some(goal) => {
            let behind = length(&walk.waypoints[..next]);
            let leg = walk.waypoints[next - 1].distance(*goal);
            behind + (leg - context.sensors.pose.position().distance(*goal)).max(0.0)
        }
    }
}

/// Describes what robots wait for before they start: that every VNF serves.
fn awaited(testbed: &Testbed, now: &Snapshot) -> String {
    let mut absent = testbed.vnfs().filter(|vnf| !now.placements.contains_key(&vnf.id));
    match absent.next() {
        None => "nothing known yet".to_owned(),
        Some(Vnf { id, node, .. }) => match absent.count() {
            0 => format!("waits for `{id}` on {node}"),
            others => format!("waits for `{id}` on {node} and {others} other VNFs"),
        },
    }
}

/// Describes a robot: its position, attachment and server, and the last time of each service. With several services, also
/// the share of each in time.
fn robot(testbed: &Testbed, tally: &Tally, now: &Snapshot, id: &NodeId) -> String {
    let Some(context) = now.robots.get(id) else { return awaited(testbed, now) };
    let mut parts = vec![format!("at {}", context.sensors.pose.position())];
    parts.push(match context.attachments.iter().find(|a| a.attached) {
        Some(attachment) => {
            let signal = attachment.signal.map(|dbm| format!(" ({:.0} dBm)", dbm.0)).unwrap_or_default();
            format!("{}{signal}", attachment.radio_unit)
        }
        None => "no radio unit".to_owned(),
    });
    if let Some(server) = server(testbed, now, id) {
        parts.push(format!("navigation on {server}"));
    }
    let services = || testbed.services.iter().filter(|service| service.robot == *id);
    let samples: Vec<_> = services().filter_map(|service| now.service_times.get(&service.id)).collect();
    for sample in &samples {
        let mut time = sample.took.map_or("no answer".to_owned(), |took| in_ms(millis::of(took)));
        if now.service_times.len() > 1
            && let Some((kept, samples)) = tally.kept(&sample.service)
        {
            time += &format!(" ({} of {samples} in time)", percent(kept));
        }
        parts.push(if services().nth(1).is_some() { format!("{} {time}", sample.service) } else { time });
    }
    if samples.is_empty() {
        parts.push("no answer yet".to_owned());
    }
    if now.finished.contains(id) {
        parts.push("at the end of its walk".to_owned());
    }
    parts.join(", ")
}

/// Returns the nodes that run a robot's navigation.
fn server<'a>(testbed: &Testbed, now: &'a Snapshot, robot: &NodeId) -> Option<&'a Nodes> {
    let of_robot = testbed.services.iter().filter(|service| service.robot == *robot);
    let vnf = of_robot.flat_map(|service| &service.vnfs).find(|vnf| vnf.program == Program::Navigation)?;
    now.placements.get(&vnf.id).map(|placement| &placement.node)
}

fn summary(testbed: &Testbed, tally: &Tally) -> String {
    let Some((above, samples)) = tally.above() else { return "no service time yet".to_owned() };
    let Some(median) = tally.median_ms() else {
        return format!("no answer to any of {}", count(samples, "sample"));
    };
    let mut text = format!("median {}", in_ms(median));
    let above = format!("{} of {}", percent(above), count(samples, "sample"));
    match &testbed.services_in_total().collect::<Vec<_>>()[..] {
        [] => {}
        [first, rest @ ..] if rest.iter().all(|other| other.kpis.service_time == first.kpis.service_time) => {
            text += &format!(", {above} over the target of {} ms", target_ms(first));
        }
        _ => text += &format!(", {above} over their service's target"),
    }
    text
}

fn target_ms(service: &Service) -> f64 {
    millis::of(service.kpis.service_time)
}
