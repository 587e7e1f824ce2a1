//! `cotorra history series`: plots a figure over time, or writes it as a table.

use std::{fs, io, path::PathBuf};

use cotorra_figure::Format;
use cotorra_graph::Timestamp;
use cotorra_measurements::{Curve, CurveRequest, Figure, InvalidFigure, Values};
use cotorra_testbed::DataTable;

use super::{
    args::SeriesArgs,
    drawn, plot,
    services::{has_services_apart, only_service, services},
    source::{Error, Source},
};
use crate::{
    output,
    table::{Table, columns, wrap},
};

/// Subject of figures of a run as a whole.
const SERVICE: &str = "service";
/// Default number of points of a table.
const TABLE_POINTS: usize = 1000;
const QUANTILES: [f64; 3] = [0.5, 0.95, 0.99];

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum SeriesError {
    #[error(transparent)]
    #[diagnostic(help("`cotorra history series --help` lists all figures"))]
    Figure(InvalidFigure),
    #[error("run {run} has no samples of {figure} in that time")]
    #[diagnostic(help("{help}"))]
    Nothing { run: String, figure: Figure, help: String },
    #[error("run {run} has no link, robot, radio unit or machine `{of}`")]
    #[diagnostic(help("{help}; or `service`"))]
    Unknown { run: String, of: String, help: String },
    #[error("cannot write {}: {source}", out.display())]
    #[diagnostic(help("choose a file in a folder that exists and that you can write to"))]
    Write { out: PathBuf, source: io::Error },
}

/// Plots a figure, or writes it as a table.
pub fn series(args: &SeriesArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let figure = figure(&args.of, args.figure.as_deref(), &source)?;
    let columns = console::Term::stdout().size_checked().map_or(80, |(_, columns)| columns.into());
    let default = match &args.out {
        Some(_) => drawn::POINTS,
        None if args.csv => TABLE_POINTS,
        None => plot::points(columns),
    };
    let points = args.points.map_or(default, |points| points.get());
    let request = CurveRequest { points, quantiles: QUANTILES.to_vec() };
    let curve =
        source.history.curve(source.run.id, &figure, args.span.range(), &request).map_err(Error::from)?;
    if curve.points.is_empty() {
        let run = source.run.info.name.clone();
        return Err(SeriesError::Nothing { run, figure, help: names(&source) }.into());
    }
    if let Some((out, format)) = args.out.as_deref().and_then(|out| Some((out, Format::of(out)?))) {
        let scene = drawn::draw(&source.run.info.name, &curve).draw();
        let written = fs::write(out, scene.render(format));
        written.map_err(|source| SeriesError::Write { out: out.to_owned(), source })?;
        return output::print(&format!("{}\n", out.display()));
    }
    if args.csv {
        return output::print_exact(&csv(&curve));
    }
    // A plot has at most one point for each column of dots.
    let drawn = CurveRequest { points: points.min(plot::points(columns)), ..request.clone() };
    let whole = CurveRequest { points: 1, ..request };
    let ask = |request| source.history.curve(source.run.id, &figure, args.span.range(), request);
    let drawn = if drawn.points == points { curve } else { ask(&drawn).map_err(Error::from)? };
    let whole = ask(&whole).map_err(Error::from)?;
    let mut text = describe(&drawn, &whole);
    if matches!(figure, Figure::ServiceTime { service: None, .. }) && has_services_apart(&source) {
        text += "  all services, also those that localize, which the summary of a run leaves out\n";
    }
    if args.of == SERVICE && matches!(figure, Figure::ServiceTime { .. }) {
        text += &format!("\n{}", services(&source, args.span.range())?);
    }
    output::print(&text)
}

/// Parses the figure: `delay:R1-cloud`, or `R1-cloud` with --figure, or `R1-cloud` alone for its default figure.
fn figure(of: &str, name: Option<&str>, source: &Source) -> Result<Figure, SeriesError> {
    let (node, part) = of.split_once(':').map_or((of, None), |(node, part)| (node, Some(part)));
    let parse = |text: &str| text.parse().map_err(SeriesError::Figure);
    match name {
        Some(name) if of == SERVICE => parse(name),
        Some("service_time") if is_robot(of, source) => {
            let service = only_service(source, Some(of)).map(|service| service.to_string());
            parse(&format!("service_time:{}:{of}", service.unwrap_or_default()))
        }
        Some(name) => parse(&format!("{name}:{of}")),
        None if of == SERVICE => Ok(Figure::ServiceTime { service: only_service(source, None), robot: None }),
        None => {
            let default = |state: &cotorra_measurements::GraphState| {
                let is = |id: &str| id == node;
                let has_unit = |id: &str| state.radio_units.iter().any(|s| s.value.radio_unit.as_str() == id);
                let of_robot = if part.is_some_and(has_unit) { "signal" } else { "linear" };
                let robot = state.robots.iter().any(|s| is(s.value.robot.as_str())).then_some(of_robot);
                let unit =
                    state.radio_units.iter().any(|s| is(s.value.radio_unit.as_str())).then_some("load");
                let link = state.links.iter().any(|s| is(s.value.link.as_str())).then_some("delay");
                let machine = state.machines.iter().any(|s| is(s.value.node.as_str())).then_some("cpu");
                robot.or(unit).or(link).or(machine)
            };
            let state = source.history.state_at(source.run.id, Timestamp::MAX).ok();
            match state.as_ref().and_then(default) {
                Some(name) => parse(&format!("{name}:{of}")),
                // The full name of a figure, as other parts of cotorra write it.
                None => of.parse().map_err(|_| SeriesError::Unknown {
                    run: source.run.info.name.clone(),
                    of: of.to_owned(),
                    help: names(source),
                }),
            }
        }
    }
}

fn is_robot(name: &str, source: &Source) -> bool {
    let state = source.history.state_at(source.run.id, Timestamp::MAX);
    state.is_ok_and(|state| state.robots.iter().any(|sample| sample.value.robot.as_str() == name))
}

/// Lists the links, robots, radio units, sensors and machines of the run.
fn names(source: &Source) -> String {
    let state = source.history.state_at(source.run.id, Timestamp::MAX).unwrap_or_default();
    let list = |mut names: Vec<&str>| {
        names.dedup();
        let shown = names.iter().take(20).copied().collect::<Vec<_>>().join(", ");
        if names.len() > 20 { shown + ", ..." } else { shown }
    };
    let machines = match &*state.machines {
        [] => String::new(),
        some => format!("; machines: {}", list(some.iter().map(|s| s.value.node.as_str()).collect())),
    };
    format!(
        "links: {}; robots: {}; radio units: {}; sensors: {}{machines}",
        list(state.links.iter().map(|s| s.value.link.as_str()).collect()),
        list(state.robots.iter().map(|s| s.value.robot.as_str()).collect()),
        list(state.radio_units.iter().map(|s| s.value.radio_unit.as_str()).collect()),
        list(state.sensors.iter().map(|s| s.value.sensor.as_str()).collect()),
    )
}

fn csv(curve: &Curve) -> String {
    let mut table = DataTable::new([
        "from_ns",
        "until_ns",
        "count",
        "min",
        "mean",
        "p50",
        "p95",
        "p99",
        "max",
        "last",
        "gap",
        "rolled_up",
        "p50_low",
        "p50_high",
        "p95_low",
        "p95_high",
        "p99_low",
        "p99_high",
    ]);
    for point in &curve.points {
        let values = point.values.as_ref();
        let count = values.map_or(0, |values| values.count);
        let [min, mean, max, last] = match values {
            Some(Values { min, mean, max, last, .. }) => [min, mean, max, last].map(f64::to_string),
            None => [const { String::new() }; 4],
        };
        let figure = |figure: Option<f64>| figure.map(|figure| figure.to_string()).unwrap_or_default();
        let quantile = |place: usize| figure(values.and_then(|values| values.quantiles.get(place).copied()));
        // Exact quantiles have no bounds.
        let within = values.map_or(&[][..], |values| values.quantiles_within.as_slice());
        let ends = (0..QUANTILES.len()).flat_map(|place| [0, 1].map(|end| Some(within.get(place)?[end])));
        let begin =
            [point.from.as_nanos().to_string(), point.until.as_nanos().to_string(), count.to_string()];
        let rolled_up = values.map_or(0, |values| values.rolled_up);
        let row = begin.into_iter().chain([min, mean]).chain((0..QUANTILES.len()).map(quantile));
        let row = row.chain([max, last, u8::from(point.gap).to_string(), rolled_up.to_string()]);
        table.row(row.chain(ends.map(figure)));
    }
    table.to_csv()
}

fn describe(curve: &Curve, whole: &Curve) -> String {
    let unit = if curve.unit.is_empty() { String::new() } else { format!(", {}", curve.unit) };
    let mut text = format!("{}{unit}\n{}", curve.figure, plot::draw(curve));
    if let Some(values) = whole.points.first().and_then(|point| point.values.as_ref()) {
        let mut table = Table::new(">>>>>>>>");
        table.row(["samples", "min", "mean", "median", "p95", "p99", "max", "last"]);
        let ends = |ends: [f64; 2]| ends.map(plot::figure);
        let [min, mean, max, last] = [values.min, values.mean, values.max, values.last].map(plot::figure);
        let quantiles = (0..values.quantiles.len()).map(|place| plot::quantile(values, place));
        table.row([values.count.to_string(), min, mean].into_iter().chain(quantiles).chain([max, last]));
        text += &format!("\n{}", table.render("  "));
        if let [p50, p95, p99] = values.quantiles_within[..] {
            let [[a, b], [c, d], [e, f]] = [p50, p95, p99].map(ends);
            let why = match values.rolled_up {
                0 => format!("{} samples are too many to keep", values.count),
                rolled_up => format!("{rolled_up} of {} samples were rolled up", values.count),
            };
            let bounds = format!("the median is from {a} to {b}, p95 from {c} to {d}, p99 from {e} to {f}");
            text += &wrap(&format!("{}: {why}. For certain, {bounds}.", plot::ABOUT), "  ", columns());
        }
    }
    text
}
