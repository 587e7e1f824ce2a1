//! The service time over time in the layout of the published figure: the target dashed, the attachment shaded and named.
//! Each robot has its own panel, and each service of a robot. Of many robots, the worst have panels, below distributions over
//! all of them.

use std::collections::BTreeMap;

use cotorra_figure::{Axis, Band, Figure, Level, Panel, Sample, Series, SeriesKind, shares_up_to};
use cotorra_graph::{Natural, NodeId, ServiceId};
use cotorra_numbers::{Quantiles, quantile};

use super::{
    fleet::{FEW_ROBOTS, robots_by_name},
    summary::{RegionSummary, Report, RobotSummary, ServiceSummary, service_time_ms},
};

/// Number of columns of a panel; more points cannot be told apart.
const COLUMNS: f64 = 500.0;
/// The vertical axis shows samples up to so many times the target, or the 99th percentile if that is higher.
const TARGETS: f64 = 2.0;
/// Room above the 99th percentile, as a factor.
const ROOM: f64 = 1.25;
/// Start of the axis of distributions, as a share of the shortest service time.
const BEFORE: f64 = 0.9;

/// The samples of a robot and a service.
#[derive(Debug)]
struct Its {
    robot: NodeId,
    service: ServiceId,
    samples: Samples,
}

/// Seconds and milliseconds; `None` without an answer.
type Samples = Vec<(f64, Option<f64>)>;

/// Draws a run: a panel for each robot and service that has samples. Of more robots than [`FEW_ROBOTS`], it draws the
/// distributions of their service times, and panels for the worst.
pub fn draw(title: &str, report: &Report, robots: &[RobotSummary]) -> Figure {
    let of_many = if robots.len() > FEW_ROBOTS { of_many(report, robots) } else { Vec::new() };
    let panels = if of_many.is_empty() { panels(report, |_| true) } else { of_many };
    Figure { title: title.to_owned(), panels, data: "service_time.csv".to_owned() }
}

/// Returns a panel for each robot and service that has samples, of these services, with the same time axis. Robots are in the
/// order of their names, and services in the file's order. The title says what differs.
pub fn panels(report: &Report, of: impl Fn(&ServiceId) -> bool) -> Vec<Panel> {
    let mut panels = over_time(report, gather(report, of));
    if panels.is_empty() {
        let x = Axis::around("time (s)", 0.0, 1.0);
        panels.push(Panel { x, y: Axis::around("service time (ms)", 0.0, 1.0), ..Panel::default() });
    }
    panels
}

/// Returns the samples of these services, by robot and service.
fn gather(report: &Report, of: impl Fn(&ServiceId) -> bool) -> Vec<Its> {
    let mut all: BTreeMap<(NodeId, ServiceId), Samples> = BTreeMap::new();
    for sample in report.samples().iter().filter(|sample| of(&sample.service)) {
        let point = (sample.emitted.as_secs_f64(), service_time_ms(&sample));
        all.entry((sample.robot, sample.service)).or_default().push(point);
    }
    let services = report.services();
    let places: BTreeMap<_, _> = services.iter().zip(0..).map(|(its, place)| (&its.service, place)).collect();
    let its = |((robot, service), samples)| Its { robot, service, samples };
    let mut all: Vec<_> = all.into_iter().map(its).collect();
    all.sort_by_cached_key(|its| {
        let [robot, service] = [its.robot.as_str(), its.service.as_str()].map(Natural::of);
        (robot, places.get(&its.service).copied(), service)
    });
    all
}

/// Returns a panel for each, with the same time axis.
fn over_time(report: &Report, all: Vec<Its>) -> Vec<Panel> {
    let end = all.iter().flat_map(|its| &its.samples).map(|(at, _)| *at).fold(0.0, f64::max);
    let several = |differs: fn(&Its, &Its) -> bool| all.windows(2).any(|pair| differs(&pair[0], &pair[1]));
    let robots = several(|a, b| a.robot != b.robot);
    let several_services = several(|a, b| a.service != b.service);
    let (services, regions) = (report.services(), report.regions());
    let panel = |its: &Its| {
        let title = match (robots, several_services) {
            (true, true) => format!("{}: {}", its.robot, its.service),
            (true, false) => its.robot.to_string(),
            (false, true) => its.service.to_string(),
            (false, false) => String::new(),
        };
        panel(title, its, &services, &regions, end)
    };
    all.iter().map(panel).collect()
}

/// Returns the distributions of all robots' service times, and a panel over time for each service in the total of the worst.
fn of_many(report: &Report, robots: &[RobotSummary]) -> Vec<Panel> {
    let services: BTreeMap<_, _> =
        report.services().into_iter().map(|its| (its.service.clone(), its)).collect();
    let all = gather(report, |service| services.get(service).is_some_and(|its| its.in_total));
    if all.is_empty() {
        return Vec::new();
    }
    let silent = robots.iter().filter(|its| its.samples == 0).count();
    let silent = if silent > 0 { format!(", {silent} without samples") } else { String::new() };
    let named: Vec<_> = robots_by_name(robots).into_iter().filter(|its| its.samples > 0).collect();
    let title = format!("{} robots{silent}; the worst {} are below", robots.len(), named.len());
    let target = |its: &Its| services[&its.service].service_time_target_ms;
    let mut panels = vec![Panel { title, ..distributions(&all, target) }];
    let worst = all
        .into_iter()
        .filter_map(|its| Some((named.iter().position(|robot| robot.robot == its.robot)?, its)));
    let mut worst: Vec<_> = worst.collect();
    worst.sort_by_key(|(place, _)| *place);
    let worst: Vec<_> = worst.into_iter().map(|(_, its)| its).collect();
    let above: Vec<_> = worst.iter().map(|its| services[&its.service].above_target).collect();
    let mut over_time = over_time(report, worst);
    for (panel, above) in over_time.iter_mut().zip(above) {
        panel.title +=
            &above.map(|above| format!(", {:.1} % above target", above * 100.0)).unwrap_or_default();
    }
    panels.extend(over_time);
    panels
}

/// Returns the distributions over services: the share of them with a median up to each service time, and with a 95th and a 99th
/// percentile. A sample without an answer is longer than any. If targets differ, service times are in per cent of them, and
/// services without a target are left out.
fn distributions(all: &[Its], target: impl Fn(&Its) -> f64) -> Panel {
    let first = target(&all[0]);
    let have_one_target = all.iter().all(|its| target(its) == first);
    let shown: Vec<_> = all.iter().filter(|its| have_one_target || target(its).is_finite()).collect();
    let quantiles = |its: &&Its| {
        let factor = if have_one_target { 1.0 } else { 100.0 / target(its) };
        Quantiles::of(its.samples.iter().map(|(_, ms)| ms.unwrap_or(f64::INFINITY) * factor).collect())
    };
    let quantiles: Vec<_> = shown.iter().filter_map(quantiles).collect();
    let (label, level) = match have_one_target {
        true => ("service time (ms)", Level { at: first, name: format!("target {first} ms") }),
        false => ("service time (% of the target)", Level { at: 100.0, name: "target".to_owned() }),
    };
    let ends = || {
        let ends = quantiles.iter().flat_map(|its| [its.p50, its.p95, its.p99]).chain([level.at]);
        ends.filter(|end| end.is_finite() && *end > 0.0)
    };
    let (low, high) = (ends().fold(f64::INFINITY, f64::min), ends().fold(0.0, f64::max));
    let mut robots: Vec<_> = shown.iter().map(|its| &its.robot).collect();
    robots.dedup();
    let what = if robots.len() == shown.len() { "robots" } else { "services" };
    let series = |name: &str, read: fn(&Quantiles) -> f64| Series {
        name: name.to_owned(),
        kind: SeriesKind::Line,
        look: None,
        parts: vec![shares_up_to(quantiles.iter().map(read).collect())],
    };
    let series =
        [series("median", |its| its.p50), series("p95", |its| its.p95), series("p99", |its| its.p99)];
    Panel {
        x: Axis::logarithmic(label, low * BEFORE, high),
        y: Axis::around(&format!("{what} up to (%)"), 0.0, 100.0),
        upright: level.at.is_finite().then_some(level),
        series: series.into(),
        ..Panel::default()
    }
}

fn panel(
    title: String,
    its: &Its,
    services: &[ServiceSummary],
    regions: &[RegionSummary],
    end: f64,
) -> Panel {
    let target = services.iter().find(|s| s.service == its.service).map(|s| s.service_time_target_ms);
    let target = target.filter(|target| target.is_finite());
    let mut answered: Vec<f64> = its.samples.iter().filter_map(|(_, ms)| *ms).collect();
    answered.sort_by(f64::total_cmp);
    let highest = answered.last().copied().unwrap_or_default();
    let usual = quantile(&answered, 0.99).unwrap_or_default();
    let top =
        target.map_or(highest, |target| highest.min((ROOM * usual).max(TARGETS * target)).max(1.2 * target));
    let regions: Vec<_> =
        regions.iter().filter(|region| region.robot == its.robot && region.service == its.service).collect();
    // The shading has no gaps: a region ends where the next one begins.
    let ends = regions.iter().skip(1).map(|next| next.from).chain(regions.last().map(|last| last.until));
    let bands = regions.iter().zip(ends).map(|(region, to)| Band {
        from: region.from.as_secs_f64(),
        to: to.as_secs_f64(),
        name: region.attachment.as_ref().map(ToString::to_string).unwrap_or_default(),
    });
    let missing = its.samples.iter().filter(|(_, ms)| ms.is_none()).map(|(at, _)| *at);
    Panel {
        title,
        x: Axis::around("time (s)", 0.0, end),
        y: Axis::around("service time (ms)", 0.0, top),
        bands: bands.collect(),
        level: target.map(|at| Level { at, name: format!("target {at} ms") }),
        upright: None,
        series: vec![Series {
            name: String::new(),
            kind: SeriesKind::Dense,
            look: None,
            parts: parts(&its.samples, end),
        }],
        missing: ("no answer".to_owned(), missing.collect()),
    }
}

/// Returns the lines between samples without an answer, with what is visible of them.
fn parts(samples: &[(f64, Option<f64>)], end: f64) -> Vec<Vec<Sample>> {
    let answered = samples.split(|(_, ms)| ms.is_none()).filter(|part| !part.is_empty());
    let thinned = answered.map(|part| thin(part.iter().filter_map(|(at, ms)| Some((*at, (*ms)?))), end));
    thinned.map(|part| part.into_iter().map(|(x, y)| Sample { x, y, range: None }).collect()).collect()
}

/// Returns the lowest and the highest point of each column of the figure, in order: everything that is visible.
fn thin(points: impl Iterator<Item = (f64, f64)>, end: f64) -> Vec<(f64, f64)> {
    let mut thinned = Vec::new();
    // The column, and the first of its lowest and of its highest points.
    let mut open: Option<(u32, [(f64, f64); 2])> = None;
    let mut close = |open: Option<(u32, [(f64, f64); 2])>| {
        if let Some((_, [low, high])) = open {
            let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
            thinned.push(first);
            if second != first {
                thinned.push(second);
            }
        }
    };
    for point in points {
        let column = (point.0 / end * COLUMNS) as u32;
        match &mut open {
            Some((of, [low, high])) if *of == column => {
                if point.1 < low.1 {
                    *low = point;
                }
                if point.1 > high.1 {
                    *high = point;
                }
            }
            _ => close(open.replace((column, [point; 2]))),
        }
    }
    close(open);
    thinned
}

#[cfg(test)]
mod tests {
    use std::{path::Path, time::Duration};

    use cotorra_graph::{Event, ServiceTime, Stamped, Timestamp};
    use cotorra_graph_testing as base;

    use super::*;
    use crate::report::Losses;

    /// Returns the report of samples of these robots and services, one each second in turn.
    fn report(of: &[(&str, &str)]) -> Report {
        let text = "name: test\nnodes: { a: { kind: switch } }\n";
        let testbed = cotorra_testbed_file::parse("test.yaml", text, Path::new("")).unwrap();
        let mut report = Report::new(&testbed, 1);
        for second in 0..60_u32 {
            let (robot, service) = of[second as usize % of.len()];
            let emitted = Timestamp::from_secs_f64(f64::from(second));
            let unit = if second < 30 { "a-radio-unit-with-a-name" } else { "R2" };
            let event = Event::ServiceTime(ServiceTime {
                service: service.parse().unwrap(),
                robot: robot.parse().unwrap(),
                sequence: second,
                attachment: Some(unit.parse().unwrap()),
                ..base::service_time(
                    "cloud",
                    emitted,
                    (second % 7 > 0).then(|| Duration::from_millis(10 + u64::from(second % 3))),
                )
            });
            report.absorb(&Stamped { at: emitted, event });
        }
        report
    }

    #[test]
    fn each_robot_and_each_service_has_its_own_panel() {
        let titles = |of: &[(&str, &str)]| -> Vec<String> {
            let report = report(of);
            let figure = draw("test", &report, &[]);
            assert_eq!(figure.draw().collisions(), Vec::<String>::new());
            for panel in &figure.panels {
                let samples: usize = panel.series[0].parts.iter().map(Vec::len).sum();
                assert_eq!(samples + panel.missing.1.len(), 60 / of.len(), "{}", panel.title);
                assert_eq!((panel.bands.len(), &panel.x), (2, &figure.panels[0].x));
            }
            figure.panels.into_iter().map(|panel| panel.title).collect()
        };
        assert_eq!(titles(&[("robot", "navigation")]), [""]);
        assert_eq!(titles(&[("b", "navigation"), ("a", "navigation"), ("c", "navigation")]), ["a", "b", "c"]);
        assert_eq!(titles(&[("robot", "navigation"), ("robot", "detect")]), ["detect", "navigation"]);
        let report = report(&[("robot", "navigation"), ("robot", "detect")]);
        let [only] = &panels(&report, |service| service.as_str() == "detect")[..] else { panic!() };
        assert_eq!((only.title.as_str(), only.missing.1.len()), ("", 4));
        let both = [("a", "navigation"), ("b", "navigation"), ("b", "detect")];
        assert_eq!(titles(&both), ["a: navigation", "b: detect", "b: navigation"]);
    }

    #[test]
    fn names_with_numbers_are_in_the_order_of_the_numbers() {
        let titles = |of: &[(&str, &str)]| -> Vec<_> {
            panels(&report(of), |_| true).into_iter().map(|panel| panel.title).collect()
        };
        let of = ["R1", "R10", "R2", "R100"].map(|robot| (robot, "navigation"));
        assert_eq!(titles(&of), ["R1", "R2", "R10", "R100"]);
        let regions: Vec<_> = report(&of).regions().iter().map(|region| region.robot.to_string()).collect();
        assert_eq!(regions, ["R1", "R1", "R2", "R2", "R10", "R10", "R100", "R100"]);
    }

    /// Returns the report of robots R1, R2 and so on. Of ten samples each, the first `above` of a robot have 20 ms, and others
    /// 10 ms. A robot with none in `above` has no samples.
    fn fleet(above: &[Option<u32>], target_ms: impl Fn(usize) -> u32) -> Report {
        let mut text = "name: test\nwireless: { lab: { delay: 1 ms } }\nnodes:\n".to_owned();
        text += "  unit: { kind: radio_unit, position: [0, 0], channel: 1 }\n";
        text += "  edge: { kind: server, tier: edge, cpus: 99, memory: 99 GB }\n";
        let numbers = 1..=above.len();
        numbers.clone().for_each(|i| text += &format!("  R{i}: {{ kind: robot }}\n"));
        text += "links: [{ ends: [unit, edge], delay: 1 ms }]\nservices:\n";
        for i in numbers.clone() {
            let kpis = format!("kpis: {{ service_time: {} ms }}", target_ms(i));
            text += &format!("  navigation-{i}:\n    robot: R{i}\n    {kpis}\n    vnfs:\n");
            text += &format!("      driver-{i}: {{ program: robot_driver, pinned_to: R{i} }}\n");
            text +=
                &format!("      navigation-{i}: {{ program: navigation, node: edge }}\n    virtual_links:\n");
            text += &format!("      - {{ from: driver-{i}, to: navigation-{i}, rate: 1 kbit/s }}\n");
        }
        text += "walks:\n";
        numbers.for_each(|i| text += &format!("  R{i}: {{ waypoints: [[0, 0], [1, 0]] }}\n"));
        let testbed = cotorra_testbed_file::parse("test.yaml", &text, Path::new("")).unwrap();
        let mut report = Report::new(&testbed, 1);
        for (i, above) in above.iter().enumerate().filter_map(|(i, above)| Some((i + 1, (*above)?))) {
            for second in 0..10_u32 {
                let emitted = Timestamp::from_secs_f64(f64::from(second));
                let event = Event::ServiceTime(ServiceTime {
                    service: format!("navigation-{i}").parse().unwrap(),
                    robot: format!("R{i}").parse().unwrap(),
                    sequence: second,
                    attachment: Some("unit".parse().unwrap()),
                    ..base::service_time(
                        "edge",
                        emitted,
                        Some(Duration::from_millis(if second < above { 20 } else { 10 })),
                    )
                });
                report.absorb(&Stamped { at: emitted, event });
            }
        }
        report
    }

    #[test]
    fn of_many_robots_the_worst_have_panels_below_the_distribution_of_all() {
        let titles = |above: &[Option<u32>]| -> Vec<String> {
            let report = fleet(above, |_| 15);
            let summary = report.summary(Timestamp::ZERO, "finished", Losses::default());
            let figure = draw("test", &report, &summary.robots);
            assert_eq!(figure.draw().collisions(), Vec::<String>::new());
            figure.panels.into_iter().map(|panel| panel.title).collect()
        };
        let mut above = [Some(0); 12];
        (above[1], above[9], above[11]) = (Some(2), Some(8), None);
        assert_eq!(titles(&above[..8]), [1, 2, 3, 4, 5, 6, 7, 8].map(|i| format!("R{i}: navigation-{i}")));
        assert_eq!(
            titles(&above),
            [
                "12 robots, 1 without samples; the worst 5 are below",
                "R10: navigation-10, 80.0 % above target",
                "R2: navigation-2, 20.0 % above target",
                "R1: navigation-1, 0.0 % above target",
                "R3: navigation-3, 0.0 % above target",
                "R4: navigation-4, 0.0 % above target",
            ]
        );
        let report = fleet(&above, |_| 15);
        let summary = report.summary(Timestamp::ZERO, "finished", Losses::default());
        let distribution = &draw("test", &report, &summary.robots).panels[0];
        let names: Vec<_> = distribution.series.iter().map(|series| series.name.as_str()).collect();
        assert_eq!(names, ["median", "p95", "p99"]);
        // One of eleven robots has a median above 10 ms.
        let share = |x: f64| {
            let steps = distribution.series[0].parts[0].iter();
            steps.filter(|step| step.x <= x).map(|step| step.y).fold(0.0, f64::max)
        };
        assert!((share(10.0) - 1000.0 / 11.0).abs() < 1e-9 && share(20.0) == 100.0);
    }

    #[test]
    fn service_times_with_different_targets_have_one_distribution_in_per_cent_of_them() {
        let report = fleet(&[Some(0); 12], |i| if i <= 3 { 20 } else { 40 });
        let summary = report.summary(Timestamp::ZERO, "finished", Losses::default());
        let figure = draw("test", &report, &summary.robots);
        assert_eq!((figure.panels.len(), figure.draw().collisions()), (6, Vec::new()));
        let distribution = &figure.panels[0];
        assert_eq!(distribution.upright.as_ref().map(|level| level.at), Some(100.0));
        let medians: Vec<_> = distribution.series[0].parts[0].iter().map(|step| step.x).collect();
        assert_eq!((medians[1], medians[18], medians[19], medians[24]), (25.0, 25.0, 50.0, 50.0));
    }

    #[test]
    fn a_run_without_samples_has_an_empty_panel() {
        let text = "name: test\nnodes: { a: { kind: switch } }\n";
        let testbed = cotorra_testbed_file::parse("test.yaml", text, Path::new("")).unwrap();
        let figure = draw("test", &Report::new(&testbed, 1), &[]);
        assert_eq!((figure.panels.len(), figure.draw().collisions()), (1, Vec::new()));
    }

    #[test]
    fn thinning_keeps_every_spike_and_the_order() {
        let at = |i: u32| f64::from(i) / 10_000.0 * 400.0;
        let spike = |i: u32| if i % 1000 == 500 { 35.0 } else { 11.0 };
        let thinned = thin((0..10_000).map(|i| (at(i), spike(i))), 400.0);
        assert!(thinned.len() <= 2 * COLUMNS as usize, "{}", thinned.len());
        assert!(thinned.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let spikes: Vec<_> = thinned.iter().filter(|point| point.1 == 35.0).map(|point| point.0).collect();
        assert_eq!(spikes, (0..10).map(|i| at(500 + 1000 * i)).collect::<Vec<_>>());
        assert_eq!(thin(std::iter::empty(), 1.0), []);
    }

    #[test]
    fn lines_break_where_answers_are_missing() {
        let samples = [(0.0, Some(1.0)), (1.0, Some(2.0)), (2.0, None), (3.0, None), (4.0, Some(3.0))];
        let lengths: Vec<_> = parts(&samples, 4.0).iter().map(Vec::len).collect();
        assert_eq!(lengths, [2, 1]);
    }
}
