//! The figure: service times of both walks over time in the published layout, and their distributions below.

use cotorra_figure::{Axis, Figure, Level, Panel, Sample, Series, SeriesKind};
use cotorra_graph::{ServiceId, ServiceTime, millis};
use cotorra_numbers::quantile;
use cotorra_testbed::{Report, panels};

use super::{
    CONTENDERS, FILES, Walks, compared,
    decided::{Decided, Legs},
    published::{PUBLISHED, Published},
    samples,
    times::{self, Timed, one_a_second},
};

/// Interval between points of OKpi-t, seconds.
const POINT_EVERY_S: f64 = 2.0;
/// Looks of the same thing in all panels.
const LOOKS: [usize; 2] = [0, 1];
const THEORY_LOOK: usize = 2;
const PUBLISHED_LOOK: usize = 3;
const MEASURED_LOOK: usize = 4;
/// Name of the published medians in the legend, with their source.
const PUBLISHED_NAME: &str = "published medians (arXiv 2101.07676)";
/// The published median of a part of each walk.
const MEDIANS: [fn(&Published) -> f64; 2] = [|of| of.soa, |of| of.okpi];
/// Titles of both walks over time.
const TITLES: [&str; 2] = ["SoA: cloud, probing", "OKpi"];
/// Lowest share that the distributions show, in per cent, where there are enough samples for it.
const LOWEST_PERCENT: f64 = 0.01;
/// Steps of a distribution that are nearer to each other than this ratio, in time and in share, are one.
const RATIO: f64 = 1.01;
/// Beginning of the axis of the distributions, as a share of the shortest service time.
const BEFORE: f64 = 0.9;
/// Quantile of a measured walk that the axis of time panels reaches, with room above.
const SHOWN_QUANTILE: f64 = 0.95;
const ROOM: f64 = 1.25;

/// Draws all samples pale, one a second as published over them, the published medians of each part of the walk, a measured
/// walk, and the sum of the known link delays for OKpi's decisions (OKpi-t). The last panel has the share of samples above each service time.
pub(super) fn figure(walks: &Walks<'_>) -> Figure {
    let simulated = times::of(walks);
    let mut drawn: Vec<Panel> = Vec::new();
    for (i, report) in [walks.soa, walks.okpi].into_iter().enumerate() {
        let is_compared = |id: &ServiceId| compared(walks.testbed).is_some_and(|service| service.id == *id);
        let mut of_walk = panels(report, is_compared);
        for panel in &mut of_walk {
            let subject = std::mem::take(&mut panel.title);
            panel.title =
                if subject.is_empty() { TITLES[i].to_owned() } else { format!("{}, {subject}", TITLES[i]) };
            for series in &mut panel.series {
                (series.name, series.kind) = ("all samples".to_owned(), SeriesKind::Faint);
                series.look = Some(LOOKS[i]);
            }
        }
        if let Some(first) = of_walk.first_mut() {
            first.series.push(over_time("one a second", LOOKS[i], &one_a_second(&simulated[i])));
            if i == 1 {
                first.series.push(theory(walks, &simulated[i]));
            }
            first.series.extend(published(walks, report, MEDIANS[i]));
            if let Some(measured) = walks.measured.filter(|its| its.is_beside(&CONTENDERS[i])) {
                first.series.push(over_time("measured", MEASURED_LOOK, measured.samples()));
                (first.x, first.y) = reaching(first, measured.samples());
            }
        }
        drawn.append(&mut of_walk);
    }
    // All panels over time have the same scales, so that they can be compared.
    let whole = drawn.iter().cloned().reduce(|a, b| Panel { x: a.x.joined(&b.x), y: a.y.joined(&b.y), ..a });
    if let Some(Panel { x, y, .. }) = whole {
        for panel in &mut drawn {
            (panel.x, panel.y) = (x.clone(), y.clone());
        }
    }
    drawn.extend(distributions(walks, &simulated));
    Figure { panels: drawn, data: FILES[3].to_owned(), ..Figure::default() }
}

/// Returns the axes of a panel with room for a measured walk.
fn reaching(panel: &Panel, measured: &[Timed]) -> (Axis, Axis) {
    let end = measured.last().map_or(0.0, |timed| timed.at_s);
    let mut ms: Vec<f64> = measured.iter().filter_map(|timed| timed.ms).collect();
    ms.sort_by(f64::total_cmp);
    let usual = quantile(&ms, SHOWN_QUANTILE).map_or(0.0, |ms| ms * ROOM);
    let (x, y) = (Axis::around("", 0.0, end), Axis::around("", 0.0, usual));
    (panel.x.clone().joined(&x), panel.y.clone().joined(&y))
}

fn over_time(name: &str, look: usize, samples: &[Timed]) -> Series {
    let answered = samples.split(|timed| timed.ms.is_none()).filter(|part| !part.is_empty());
    let sample = |timed: &Timed| timed.ms.map(|y| Sample { x: timed.at_s, y, range: None });
    let parts = answered.map(|part| part.iter().filter_map(sample).collect()).collect();
    Series { name: name.to_owned(), kind: SeriesKind::Dense, look: Some(look), parts }
}

/// Returns the sum of the known link delays for OKpi's decisions.
fn theory(walks: &Walks<'_>, okpi: &[Timed]) -> Series {
    let decided = Decided::by(walks.testbed, walks.okpi);
    let theory = decided.theory(walks.testbed);
    let at = |seconds: f64| decided.at(seconds).and_then(|state| theory.get(state).copied());
    let end = okpi.last().map_or(0.0, |timed| timed.at_s);
    let seconds = (0..).map(|i| f64::from(i) * POINT_EVERY_S).take_while(|seconds| *seconds <= end);
    let points = seconds.filter_map(|x| Some(Sample { x, y: at(x)?, range: None })).collect();
    Series { name: "OKpi-t".to_owned(), kind: SeriesKind::Line, look: Some(THEORY_LOOK), parts: vec![points] }
}

/// Returns the published medians, each over the time that the walk spends in its part; `None` if it is in none of them.
fn published(walks: &Walks<'_>, report: &Report, median: fn(&Published) -> f64) -> Option<Series> {
    let legs = Legs::of(walks.testbed, report);
    let part = |sample: &ServiceTime| PUBLISHED.iter().position(|part| legs.is_in(sample, part));
    let mut seconds: Vec<_> =
        samples(walks.testbed, report).map(|sample| (sample.emitted.as_secs_f64(), part(&sample))).collect();
    seconds.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let stretch = |of: &[(f64, Option<usize>)]| {
        let (from, part) = of.first()?;
        let (until, _) = of.last()?;
        let y = median(&PUBLISHED[(*part)?]);
        Some([from, until].map(|x| Sample { x: *x, y, range: None }).to_vec())
    };
    let parts: Vec<_> = seconds.chunk_by(|(_, a), (_, b)| a == b).filter_map(stretch).collect();
    let name = PUBLISHED_NAME.to_owned();
    (!parts.is_empty()).then_some(Series { name, kind: SeriesKind::Line, look: Some(PUBLISHED_LOOK), parts })
}

/// Returns the panel of the distributions; `None` without answered samples.
fn distributions(walks: &Walks<'_>, simulated: &[Vec<Timed>; 2]) -> Option<Panel> {
    let published = simulated.each_ref().map(|samples| one_a_second(samples));
    let measured = walks.measured.map(|its| its.samples());
    let shown = || simulated.iter().map(Vec::as_slice).chain(measured);
    let times = || shown().flatten().filter_map(|timed| timed.ms);
    let (shortest, longest) = (times().fold(f64::INFINITY, f64::min), times().fold(0.0, f64::max));
    if longest == 0.0 {
        return None;
    }
    let most = shown().map(<[_]>::len).max().unwrap_or_default();
    let lowest = (100.0 / most as f64).max(LOWEST_PERCENT);
    let mut series = Vec::new();
    for i in [0, 1] {
        let curve = |name: &str, kind, samples| Series {
            name: format!("{}, {name}", CONTENDERS[i].name),
            kind,
            look: Some(LOOKS[i]),
            parts: vec![shares_above(samples)],
        };
        series.push(curve("all", SeriesKind::Faint, &simulated[i]));
        series.push(curve("one a second", SeriesKind::Line, &published[i]));
    }
    series.extend(measured.map(|samples| Series {
        name: "measured".to_owned(),
        kind: SeriesKind::Line,
        look: Some(MEASURED_LOOK),
        parts: vec![shares_above(samples)],
    }));
    let target = compared(walks.testbed).map(|service| millis::of(service.kpis.service_time));
    let (nearest, farthest) = target.map_or((shortest, longest), |ms| (shortest.min(ms), longest.max(ms)));
    Some(Panel {
        title: "Distribution".to_owned(),
        x: Axis::logarithmic("service time (ms)", nearest * BEFORE, farthest),
        y: Axis::logarithmic("samples above (%)", lowest, 100.0),
        upright: target.map(|at| Level { at, name: format!("target {at} ms") }),
        series,
        ..Panel::default()
    })
}

/// Returns the steps of the share of samples above each service time, in per cent: the complement of the empirical
/// distribution function. Samples without an answer are above any.
fn shares_above(samples: &[Timed]) -> Vec<Sample> {
    let mut answered: Vec<f64> = samples.iter().filter_map(|timed| timed.ms).collect();
    answered.sort_by(f64::total_cmp);
    let Some(shortest) = answered.first() else { return Vec::new() };
    let mut steps = vec![Sample { x: shortest / 10.0, y: 100.0, range: None }];
    let mut above = samples.len();
    for equal in answered.chunk_by(|a, b| a == b) {
        above -= equal.len();
        let (x, y) = (equal[0], above as f64 / samples.len() as f64 * 100.0);
        let last = steps[steps.len() - 1];
        if x < last.x * RATIO && y * RATIO > last.y {
            continue;
        }
        steps.extend([Sample { x, y: last.y, range: None }, Sample { x, y, range: None }]);
    }
    // The last steps lack this point.
    let (x, y) = (answered[answered.len() - 1], above as f64 / samples.len() as f64 * 100.0);
    let last = steps[steps.len() - 1];
    steps.extend([Sample { x, y: last.y, range: None }, Sample { x, y, range: None }]);
    steps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shares(ms: &[Option<f64>]) -> Vec<(f64, f64)> {
        let timed: Vec<_> = ms.iter().map(|ms| Timed { at_s: 0.0, ms: *ms }).collect();
        shares_above(&timed).iter().map(|sample| (sample.x, sample.y)).collect()
    }

    #[test]
    fn shares_fall_at_each_service_time_and_end_at_the_unanswered() {
        let steps = shares(&[Some(10.0), Some(20.0), Some(10.0), None]);
        let fall = [(1.0, 100.0), (10.0, 100.0), (10.0, 50.0), (20.0, 50.0), (20.0, 25.0)];
        assert_eq!(steps[..5], fall);
        assert!(steps[5..].iter().all(|step| *step == (20.0, 25.0)), "{steps:?}");
        assert_eq!(shares(&[None]), []);
    }

    #[test]
    fn many_samples_make_few_steps_that_are_off_by_less_than_a_line() {
        let many: Vec<_> = (0..20_000).map(|i| Some(10.0 + f64::from(i) / 1000.0)).collect();
        let steps = shares(&many);
        assert!(steps.len() < 1500, "{}", steps.len());
        for (x, y) in &steps[1..steps.len() - 3] {
            let exact = 100.0 - (x - 10.0) * 5.0;
            assert!(
                (y / exact).ln().abs() < 0.05 || (x / (10.0 + (100.0 - y) / 5.0)).ln().abs() < 0.011,
                "{x} {y}"
            );
        }
        assert_eq!(steps.last(), Some(&(29.999, 0.0)));
    }
}
