//! The service time over time in the layout of the published figure: the target dashed, the attachment shaded and named.
//! Each robot has its own panel, and each service of a robot.

use std::collections::BTreeMap;

use cotorra_figure::{Axis, Band, Figure, Level, Panel, Sample, Series, SeriesKind};
use cotorra_graph::{NodeId, ServiceId, ServiceTime};
use cotorra_numbers::quantile;

use super::summary::{RegionSummary, Report, ServiceSummary, service_time_ms};

/// Number of columns of a panel; more points cannot be told apart.
const COLUMNS: f64 = 500.0;
/// The vertical axis shows samples up to so many times the target, or the 99th percentile if that is higher.
const TARGETS: f64 = 2.0;
/// Room above the 99th percentile, as a factor.
const ROOM: f64 = 1.25;

/// The samples of a robot and a service.
#[derive(Debug)]
struct Its {
    robot: NodeId,
    service: ServiceId,
    /// Seconds and milliseconds; `None` without an answer.
    samples: Vec<(f64, Option<f64>)>,
}

/// Draws a run: a panel for each robot and service that has samples.
pub fn draw(title: &str, report: &Report) -> Figure {
    let panels = panels(report, |_| true);
    Figure { title: title.to_owned(), panels, data: "service_time.csv".to_owned() }
}

/// Returns a panel for each robot and service that has samples, of these services, with the same time axis. Services are in
/// the file's order. The title says what differs.
pub fn panels(report: &Report, of: impl Fn(&ServiceId) -> bool) -> Vec<Panel> {
    let mut all: Vec<Its> = Vec::new();
    let mut end = 0.0_f64;
    for sample in report.samples().iter().filter(|sample| of(&sample.service)) {
        end = end.max(sample.emitted.as_secs_f64());
        let point = (sample.emitted.as_secs_f64(), service_time_ms(&sample));
        let ServiceTime { robot, service, .. } = sample;
        match all.iter_mut().find(|its| its.robot == robot && its.service == service) {
            Some(its) => its.samples.push(point),
            None => all.push(Its { robot, service, samples: vec![point] }),
        }
    }
    let services = report.services();
    let places: BTreeMap<_, _> = services.iter().zip(0..).map(|(its, place)| (&its.service, place)).collect();
    let rank = |its: &Its| (its.robot.clone(), places.get(&its.service).copied(), its.service.clone());
    all.sort_by_cached_key(rank);
    let several = |differs: fn(&Its, &Its) -> bool| all.windows(2).any(|pair| differs(&pair[0], &pair[1]));
    let robots = several(|a, b| a.robot != b.robot);
    let several_services = several(|a, b| a.service != b.service);
    let regions = report.regions();
    let panel = |its: &Its| {
        let title = match (robots, several_services) {
            (true, true) => format!("{}: {}", its.robot, its.service),
            (true, false) => its.robot.to_string(),
            (false, true) => its.service.to_string(),
            (false, false) => String::new(),
        };
        panel(title, its, &services, &regions, end)
    };
    let mut panels: Vec<Panel> = all.iter().map(panel).collect();
    if panels.is_empty() {
        let x = Axis::around("time (s)", 0.0, 1.0);
        panels.push(Panel { x, y: Axis::around("service time (ms)", 0.0, 1.0), ..Panel::default() });
    }
    panels
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

    use cotorra_graph::{Event, Stamped, Timestamp};

    use super::*;

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
                emitted,
                took: (second % 7 > 0).then(|| Duration::from_millis(10 + u64::from(second % 3))),
                attachment: Some(unit.parse().unwrap()),
                server: "cloud".parse().unwrap(),
                parts: None,
                lost_at: None,
            });
            report.absorb(&Stamped { at: emitted, event });
        }
        report
    }

    #[test]
    fn each_robot_and_each_service_has_its_own_panel() {
        let titles = |of: &[(&str, &str)]| -> Vec<String> {
            let report = report(of);
            let figure = draw("test", &report);
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
    fn a_run_without_samples_has_an_empty_panel() {
        let text = "name: test\nnodes: { a: { kind: switch } }\n";
        let testbed = cotorra_testbed_file::parse("test.yaml", text, Path::new("")).unwrap();
        let figure = draw("test", &Report::new(&testbed, 1));
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
