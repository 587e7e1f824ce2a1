//! The COTORRA letter's first validation (arXiv 2101.07676). A robot walks the corridor and back twice. With the state of
//! the art, navigation stays in the cloud and the robot roams by periodic probing; the second walk is orchestrated by OKpi.
//! Both are compared by the service times of the first service, which is navigation.

use std::{collections::BTreeMap, fmt::Write as _, path::Path, time::Duration};

use cotorra_figure::{Figure, Format, Panel, Sample, Series, SeriesKind};
use cotorra_graph::{
    HardwareGraph, Instruction, NodeId, Position, Program, Service, ServiceId, ServiceTime, Testbed, millis,
};
use cotorra_testbed::{DataTable, FolderError, Quantiles, Report, panels, service_time_ms, write_file};
use serde::Serialize;

/// One of the compared approaches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Contender {
    /// Name in the figure and the table.
    pub name: &'static str,
    /// The deciding plug-in.
    pub plugin: &'static str,
}

/// The state of the art, then OKpi.
pub const CONTENDERS: [Contender; 2] =
    [Contender { name: "SoA", plugin: "probing" }, Contender { name: "OKpi", plugin: "okpi" }];

/// Files that [`Comparison::write`] makes.
pub const FILES: [&str; 6] =
    ["comparison.svg", "comparison.md", "comparison.json", "samples.csv", "comparison.tex", "medians.csv"];

/// A part of the walk, and its published medians, ms.
struct Published {
    name: &'static str,
    segment: Segment,
    leg: Leg,
    theory: f64,
    okpi: f64,
    soa: f64,
}

const PUBLISHED: [Published; 5] = {
    use {Leg::*, Segment::*};
    [
        Published { name: "R1/R3 out", segment: A, leg: Out, theory: 11.0, okpi: 11.34, soa: 11.80 },
        Published { name: "R2/R4 out", segment: B, leg: Out, theory: 10.0, okpi: 10.39, soa: 20.35 },
        Published { name: "R5/R6", segment: C, leg: Out, theory: 11.0, okpi: 10.77, soa: 28.91 },
        Published { name: "R2/R4 back", segment: B, leg: Back, theory: 10.0, okpi: 10.27, soa: 20.32 },
        Published { name: "R1/R3 back", segment: A, leg: Back, theory: 11.0, okpi: 11.37, soa: 11.46 },
    ]
};

/// A published change of radio unit and server. `metres` is the coordinate along `axis` at which it happened.
struct PublishedChange {
    leg: Leg,
    axis: Axis,
    metres: f64,
    radio_unit: &'static str,
    server: &'static str,
}

const PUBLISHED_CHANGES: [PublishedChange; 6] = {
    use {Axis::*, Leg::*};
    [
        PublishedChange { leg: Out, axis: Y, metres: -24.6, radio_unit: "R3", server: "cloud" },
        PublishedChange { leg: Out, axis: Y, metres: -10.9, radio_unit: "R2", server: "edge" },
        PublishedChange { leg: Out, axis: X, metres: 15.8, radio_unit: "R5", server: "fog" },
        PublishedChange { leg: Back, axis: X, metres: 17.8, radio_unit: "R2", server: "edge" },
        PublishedChange { leg: Back, axis: Y, metres: -12.5, radio_unit: "R3", server: "cloud" },
        PublishedChange { leg: Back, axis: Y, metres: -26.1, radio_unit: "R1", server: "cloud" },
    ]
};

/// A sample within this time of a completed handover belongs to the handover, seconds.
const AROUND_HANDOVER_S: f64 = 1.0;
/// Instructions within this time are one decision, seconds: locations are not more frequent.
const ONE_DECISION_S: f64 = 0.2;
/// Interval between points of OKpi-t in the figure, seconds.
const POINT_EVERY_S: f64 = 2.0;

/// The corridor's segments, each with its radio units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Segment {
    A,
    B,
    C,
}

impl Segment {
    fn of(radio_unit: &NodeId) -> Option<Self> {
        match radio_unit.as_str() {
            "R1" | "R3" => Some(Self::A),
            "R2" | "R4" => Some(Self::B),
            "R5" | "R6" => Some(Self::C),
            _ => None,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Leg {
    Out,
    Back,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Axis {
    X,
    Y,
}

impl Axis {
    fn of(self, position: Position) -> f64 {
        match self {
            Self::X => position.x,
            Self::Y => position.y,
        }
    }
}

/// A comparison of the two walks with each other and with the published ones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Medians of each part of the walk.
    pub parts: Vec<Part>,
    /// OKpi's changes of radio unit and server.
    pub changes: Vec<Change>,
    /// Shares of samples above the target. Samples without an answer count as above it.
    pub above_target: Vec<AboveTarget>,
    pub target_ms: Option<f64>,
}

/// A part of the walk: median service times, ms. `None` without samples.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Part {
    /// The letter's name of the region.
    pub name: &'static str,
    /// The sum of the known link delays for OKpi's decisions.
    pub theory_ms: Option<f64>,
    pub published_theory_ms: f64,
    /// The measured median with OKpi.
    pub okpi_ms: Option<f64>,
    pub published_okpi_ms: f64,
    /// The measured median with the state of the art.
    pub soa_ms: Option<f64>,
    pub published_soa_ms: f64,
}

/// A decision for another radio unit or server.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// Time of the decision, seconds.
    pub at_s: f64,
    /// The robot's position; `None` if it was not known yet.
    pub position: Option<Position>,
    /// The radio unit after the change.
    pub radio_unit: NodeId,
    /// The server after the change.
    pub server: NodeId,
    /// Distance from the published place, metres; `None` if no such change was published.
    pub off_published_m: Option<f64>,
}

/// Shares of one contender's samples above the target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AboveTarget {
    pub contender: &'static str,
    /// The share of all samples.
    pub of_all: f64,
    /// The share of samples that are not near a handover.
    pub away_from_handovers: f64,
    /// Number of samples.
    pub samples: usize,
}

impl Comparison {
    /// Compares two walks on a testbed.
    pub fn of(testbed: &Testbed, soa: &Report, okpi: &Report) -> Self {
        let decided = Decided::by(testbed, okpi);
        let theory = decided.theory(testbed);
        let at_samples: Vec<_> = samples(testbed, okpi)
            .map(|sample| {
                let state = decided.at(sample.emitted.as_secs_f64());
                (sample, state.and_then(|state| theory.get(state).copied()))
            })
            .collect();
        let [soa_legs, okpi_legs] = [soa, okpi].map(|report| Legs::of(testbed, report));
        let median = |values: Vec<f64>| Quantiles::of(values).map(|quantiles| quantiles.p50);
        let parts = PUBLISHED.iter().map(|published| {
            let measured = |report: &Report, legs: &Legs| {
                let inside = samples(testbed, report).filter(|sample| legs.is_in(sample, published));
                median(inside.filter_map(|sample| service_time_ms(&sample)).collect())
            };
            let inside = at_samples.iter().filter(|(sample, _)| okpi_legs.is_in(sample, published));
            Part {
                name: published.name,
                theory_ms: median(inside.filter_map(|(_, theory)| *theory).collect()),
                published_theory_ms: published.theory,
                okpi_ms: measured(okpi, &okpi_legs),
                published_okpi_ms: published.okpi,
                soa_ms: measured(soa, &soa_legs),
                published_soa_ms: published.soa,
            }
        });
        let target_ms = compared(testbed).map(|service| millis::of(service.kpis.service_time));
        let above =
            |name, report: &Report| target_ms.and_then(|target| above_target(name, testbed, report, target));
        let [first, second] = CONTENDERS.map(|contender| contender.name);
        Self {
            parts: parts.collect(),
            changes: decided.changes(&okpi_legs),
            above_target: [above(first, soa), above(second, okpi)].into_iter().flatten().collect(),
            target_ms,
        }
    }

    /// Returns the tables of medians, changes and shares, in Markdown. `how` says how the walks were run.
    pub fn to_markdown(&self, how: &str) -> String {
        let tables = self.tables().map(|table| table.to_markdown()).join("\n");
        format!("Median service time, ms ({how}; published figures: arXiv 2101.07676)\n\n{tables}")
    }

    /// Returns the tables of medians, changes and shares, rounded for readers.
    fn tables(&self) -> [DataTable; 3] {
        let ms = |value: Option<f64>| value.map_or("-".to_owned(), |ms| format!("{ms:.2}"));
        let heads = ["part of the walk", "theory", "published", "OKpi", "published", "SoA", "published"];
        let mut medians = DataTable::new(heads).right_after(1);
        for part in &self.parts {
            medians.row([
                part.name.to_owned(),
                ms(part.theory_ms),
                part.published_theory_ms.to_string(),
                ms(part.okpi_ms),
                part.published_okpi_ms.to_string(),
                ms(part.soa_ms),
                ms(Some(part.published_soa_ms)),
            ]);
        }
        let heads = ["OKpi's decision", "at", "where", "off the published place"];
        let mut changes = DataTable::new(heads).right_after(1);
        for change in &self.changes {
            changes.row([
                format!("{} + {}", change.radio_unit, change.server),
                format!("{:.1} s", change.at_s),
                change.position.map_or("-".to_owned(), |at| at.to_string()),
                change.off_published_m.map_or("-".to_owned(), |off| format!("{off:.1} m")),
            ]);
        }
        let above = format!("samples above {} ms", self.target_ms.unwrap_or_default());
        let away = format!("more than {AROUND_HANDOVER_S} s from any handover");
        let mut shares = DataTable::new([above.as_str(), "of all", away.as_str(), "samples"]).right_after(1);
        let percent = |share: f64| format!("{:.2} %", share * 100.0);
        for above in &self.above_target {
            let AboveTarget { contender, of_all, away_from_handovers, samples } = *above;
            let shown = [percent(of_all), percent(away_from_handovers), samples.to_string()];
            shares.row([contender.to_owned()].into_iter().chain(shown));
        }
        [medians, changes, shares]
    }

    /// Returns the medians of each part with all digits.
    fn medians(&self) -> DataTable {
        let mut table = DataTable::new([
            "part",
            "theory_ms",
            "published_theory_ms",
            "okpi_ms",
            "published_okpi_ms",
            "soa_ms",
            "published_soa_ms",
        ]);
        for part in &self.parts {
            let figures = [
                part.theory_ms,
                Some(part.published_theory_ms),
                part.okpi_ms,
                Some(part.published_okpi_ms),
                part.soa_ms,
                Some(part.published_soa_ms),
            ];
            let figures = figures.map(|figure| figure.map(|ms| ms.to_string()).unwrap_or_default());
            table.row([part.name.to_owned()].into_iter().chain(figures));
        }
        table
    }

    /// Writes [`FILES`]: the figure in the published layout, the tables, and the samples behind both.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(
        &self,
        folder: &Path,
        how: &str,
        testbed: &Testbed,
        soa: &Report,
        okpi: &Report,
    ) -> Result<(), FolderError> {
        let decided = Decided::by(testbed, okpi);
        let theory = decided.theory(testbed);
        let at = |seconds: f64| decided.at(seconds).and_then(|state| theory.get(state).copied());
        let [_, tables, data, samples, for_papers, medians] = FILES;
        self.write_figure(folder, testbed, soa, okpi, Format::Svg)?;
        write_file(folder, tables, self.to_markdown(how))?;
        write_file(folder, for_papers, self.tables().map(|table| table.to_latex()).join("\n"))?;
        write_file(folder, medians, self.medians().to_csv())?;
        let json = serde_json::to_string_pretty(self).expect("a comparison is valid JSON");
        write_file(folder, data, &(json + "\n"))?;
        let mut csv = String::from("contender,emitted_ns,service_time_ms,theory_ms,attachment,server\n");
        for (contender, report) in CONTENDERS.iter().zip([soa, okpi]) {
            for sample in self::samples(testbed, report) {
                let emitted = sample.emitted.as_secs_f64();
                let number = |value: Option<f64>| value.map(|ms| format!("{ms:.6}")).unwrap_or_default();
                let theory = if contender.plugin == "okpi" { number(at(emitted)) } else { String::new() };
                let attachment = sample.attachment.as_ref().map_or("", NodeId::as_str);
                line(
                    &mut csv,
                    format_args!(
                        "{},{},{},{theory},{attachment},{}",
                        contender.name,
                        sample.emitted.as_nanos(),
                        number(service_time_ms(&sample)),
                        sample.server
                    ),
                );
            }
        }
        write_file(folder, samples, &csv)
    }
}

impl Comparison {
    /// Writes the figure in the published layout, `comparison`, in a format.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_figure(
        &self,
        folder: &Path,
        testbed: &Testbed,
        soa: &Report,
        okpi: &Report,
        format: Format,
    ) -> Result<(), FolderError> {
        let figure = figure(testbed, soa, okpi);
        write_file(folder, &format!("comparison.{format}"), figure.draw().render(format))
    }
}

/// Returns the figure: the measured service times of both walks, and the sum of the known link delays for OKpi's decisions.
fn figure(testbed: &Testbed, soa: &Report, okpi: &Report) -> Figure {
    let decided = Decided::by(testbed, okpi);
    let theory = decided.theory(testbed);
    let at = |seconds: f64| decided.at(seconds).and_then(|state| theory.get(state).copied());
    let end = samples(testbed, okpi).map(|sample| sample.emitted.as_secs_f64()).fold(0.0, f64::max);
    let seconds = (0..).map(|i| f64::from(i) * POINT_EVERY_S).take_while(|seconds| *seconds <= end);
    let points = seconds.filter_map(|x| Some(Sample { x, y: at(x)?, range: None })).collect();
    let names = ["State of the art: cloud, probing", "OKpi"];
    let mut all: Vec<Panel> = Vec::new();
    for ((title, report), line) in names.into_iter().zip([soa, okpi]).zip(["SoA", "OKpi-e"]) {
        let is_compared = |id: &ServiceId| compared(testbed).is_some_and(|service| service.id == *id);
        for mut panel in panels(report, is_compared) {
            let subject = std::mem::take(&mut panel.title);
            panel.title = if subject.is_empty() { title.to_owned() } else { format!("{title}, {subject}") };
            panel.series.iter_mut().for_each(|series| series.name = line.to_owned());
            all.push(panel);
        }
    }
    let theory = Series { name: "OKpi-t".to_owned(), kind: SeriesKind::Line, parts: vec![points] };
    if let Some(first) = all.iter_mut().find(|panel| panel.title.starts_with(names[1])) {
        first.series.push(theory);
    }
    // All panels have the same scales, so that they can be compared.
    let whole = all.iter().cloned().reduce(|a, b| Panel { x: a.x.joined(&b.x), y: a.y.joined(&b.y), ..a });
    if let Some(Panel { x, y, .. }) = whole {
        for panel in &mut all {
            (panel.x, panel.y) = (x.clone(), y.clone());
        }
    }
    Figure { panels: all, data: FILES[3].to_owned(), ..Figure::default() }
}

fn line(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    writeln!(text, "{arguments}").expect("writing into a string cannot fail");
}

/// Returns the service that is compared.
fn compared(testbed: &Testbed) -> Option<&Service> {
    testbed.services_in_total().next()
}

/// Returns the samples of the service that is compared.
fn samples<'a>(testbed: &'a Testbed, report: &'a Report) -> impl Iterator<Item = ServiceTime> + 'a {
    let compared = compared(testbed);
    report.samples().iter().filter(move |sample| compared.is_some_and(|its| its.id == sample.service))
}

fn above_target(
    contender: &'static str,
    testbed: &Testbed,
    report: &Report,
    target_ms: f64,
) -> Option<AboveTarget> {
    let handovers: Vec<_> = report
        .handovers()
        .iter()
        .map(|handover| (handover.at.as_secs_f64(), handover.gap_ms / 1e3))
        .collect();
    let near = |sample: &ServiceTime| {
        let at = sample.emitted.as_secs_f64();
        handovers
            .iter()
            .any(|(done, gap)| (done - gap - AROUND_HANDOVER_S..=done + AROUND_HANDOVER_S).contains(&at))
    };
    let above = |sample: &ServiceTime| service_time_ms(sample).is_none_or(|ms| ms > target_ms);
    let count = |wanted: &dyn Fn(&ServiceTime) -> bool| {
        samples(testbed, report).filter(|sample| wanted(sample)).count()
    };
    let all = count(&|_| true);
    let of = |wanted: &dyn Fn(&ServiceTime) -> bool| count(wanted) as f64 / all as f64;
    (all > 0).then(|| AboveTarget {
        contender,
        of_all: of(&above),
        away_from_handovers: of(&|sample| above(sample) && !near(sample)),
        samples: all,
    })
}

/// The time at which a walk turned: its first sample in segment C.
#[derive(Debug)]
struct Legs {
    turned_s: f64,
}

impl Legs {
    fn of(testbed: &Testbed, report: &Report) -> Self {
        let in_c =
            |sample: &ServiceTime| sample.attachment.as_ref().and_then(Segment::of) == Some(Segment::C);
        let times = samples(testbed, report).filter(in_c).map(|sample| sample.emitted.as_secs_f64());
        Self { turned_s: times.fold(f64::INFINITY, f64::min) }
    }

    fn at(&self, seconds: f64) -> Leg {
        if seconds < self.turned_s { Leg::Out } else { Leg::Back }
    }

    fn is_in(&self, sample: &ServiceTime, part: &Published) -> bool {
        let segment = sample.attachment.as_ref().and_then(Segment::of);
        // Segment C is walked out and back in one part.
        let leg = part.segment == Segment::C || self.at(sample.emitted.as_secs_f64()) == part.leg;
        segment == Some(part.segment) && leg
    }
}

/// A radio unit and a server.
type State = (NodeId, NodeId);

/// The decisions for the robot, over time.
#[derive(Debug)]
struct Decided {
    robot: Option<NodeId>,
    /// The beginning of each state in seconds, the robot's position then, and the state.
    states: Vec<(f64, Option<Position>, State)>,
}

impl Decided {
    /// Follows the decisions for the compared service's robot, from its state at the first sample.
    fn by(testbed: &Testbed, report: &Report) -> Self {
        let service = compared(testbed);
        let navigation = service.and_then(|s| s.vnfs.iter().find(|vnf| vnf.program == Program::Navigation));
        let (Some(service), Some(navigation)) = (service, navigation) else {
            return Self { robot: None, states: Vec::new() };
        };
        let first = samples(testbed, report).find_map(|sample| sample.attachment.clone());
        let mut state = first.map(|unit| (unit, navigation.node.first().clone()));
        let mut states: Vec<_> = state.iter().map(|state| (0.0, None, state.clone())).collect();
        for decision in report.decisions() {
            let Some((unit, server)) = &mut state else { break };
            match &decision.instruction {
                Instruction::Attach { robot, radio_unit } if *robot == service.robot => {
                    *unit = radio_unit.clone()
                }
                Instruction::Place { vnf, node } if *vnf == navigation.id => *server = node.first().clone(),
                _ => continue,
            }
            let (at, state) = (decision.at.as_secs_f64(), (unit.clone(), server.clone()));
            match states.last_mut() {
                // One decision for a new radio unit and a new server has two instructions.
                Some(last) if at - last.0 <= ONE_DECISION_S => last.2 = state,
                Some(last) if last.2 == state => {}
                _ => states.push((at, decision.position, state)),
            }
        }
        Self { robot: Some(service.robot.clone()), states }
    }

    fn at(&self, seconds: f64) -> Option<&State> {
        let next = self.states.partition_point(|(from, ..)| *from <= seconds);
        self.states.get(next.checked_sub(1)?).map(|(.., state)| state)
    }

    /// Returns the sum of the known link delays in each state, there and back, ms.
    fn theory(&self, testbed: &Testbed) -> BTreeMap<State, f64> {
        let Some(robot) = &self.robot else { return BTreeMap::new() };
        let with_theory = |(.., state): &(f64, Option<Position>, State)| {
            let taken = round_trip(&testbed.graph, robot, state)?;
            Some((state.clone(), taken.as_secs_f64() * 1e3))
        };
        self.states.iter().filter_map(with_theory).collect()
    }

    fn changes(&self, legs: &Legs) -> Vec<Change> {
        let change = |(at_s, position, (unit, server)): &(f64, Option<Position>, State)| {
            let published = PUBLISHED_CHANGES.iter().find(|published| {
                published.radio_unit == unit.as_str()
                    && published.server == server.as_str()
                    && (published.leg == legs.at(*at_s) || published.radio_unit == "R5")
            });
            let off = published.zip(*position);
            Change {
                at_s: *at_s,
                position: *position,
                radio_unit: unit.clone(),
                server: server.clone(),
                off_published_m: off.map(|(published, at)| (published.axis.of(at) - published.metres).abs()),
            }
        };
        self.states.iter().skip(1).map(change).collect()
    }
}

fn round_trip(graph: &HardwareGraph, robot: &NodeId, (unit, server): &State) -> Option<Duration> {
    let attached = |of: &NodeId| (of == robot).then_some(unit);
    let there = graph.route(robot, server, attached)?;
    let back = graph.route(server, robot, attached)?;
    Some(there.delay + back.delay)
}
