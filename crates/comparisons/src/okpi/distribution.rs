//! Distributions of service times: by contender and sampling, and of a measured walk beside them.

use cotorra_testbed::DataTable;
use serde::Serialize;

use super::{
    CONTENDERS, Walks,
    bootstrap::intervals,
    figures::{Distribution, Intervals, ms, percent, with_interval},
    fitted::WalkTest,
    times::{self, Timed, halves, one_a_second},
};

/// The samples of a walk that are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Sampling {
    /// All of them.
    All,
    /// The first of each second, as published.
    OneASecond,
}

impl Sampling {
    /// Returns its name in tables.
    fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::OneASecond => "one a second",
        }
    }
}

/// A walk, or one of its halves in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Span {
    Whole,
    FirstHalf,
    SecondHalf,
}

impl Span {
    fn name(self) -> &'static str {
        match self {
            Self::Whole => "whole walk",
            Self::FirstHalf => "first half",
            Self::SecondHalf => "second half",
        }
    }

    fn of(self, walk: &[Timed]) -> &[Timed] {
        let [first, second] = halves(walk);
        match self {
            Self::Whole => walk,
            Self::FirstHalf => first,
            Self::SecondHalf => second,
        }
    }
}

/// The distribution of one walk's samples.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WalkDistribution {
    pub span: Span,
    /// The contender, or `measured`.
    pub walk: &'static str,
    pub sampling: Sampling,
    #[serde(flatten)]
    pub distribution: Distribution,
    /// Only of a measured walk.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intervals: Option<Intervals>,
}

/// Name of a measured walk.
const MEASURED: &str = "measured";

/// Returns the distributions of both contenders and samplings. With a measured walk, also its own, and those of the halves of
/// all.
pub(super) fn all(walks: &Walks<'_>) -> Vec<WalkDistribution> {
    let simulated: Vec<_> = CONTENDERS.iter().zip(times::of(walks)).collect();
    let mut found = Vec::new();
    let mut push = |span: Span, walk, sampling, samples: &[Timed], intervals| {
        let of = Distribution::of(span.of(samples));
        found.extend(of.map(|distribution| WalkDistribution {
            span,
            walk,
            sampling,
            distribution,
            intervals,
        }));
    };
    for (contender, samples) in &simulated {
        push(Span::Whole, contender.name, Sampling::All, samples, None);
        push(Span::Whole, contender.name, Sampling::OneASecond, &one_a_second(samples), None);
    }
    let Some(measured) = walks.measured else { return found };
    for span in [Span::Whole, Span::FirstHalf, Span::SecondHalf] {
        let intervals = intervals(span.of(measured.samples()), walks.seed);
        push(span, MEASURED, Sampling::All, measured.samples(), intervals);
        for (contender, samples) in simulated.iter().filter(|_| span != Span::Whole) {
            push(span, contender.name, Sampling::OneASecond, &one_a_second(samples), None);
        }
    }
    found
}

/// Returns the tables for readers: the contenders, and the measured walk and its halves with the contenders beside.
pub(super) fn tables(all: &[WalkDistribution]) -> Vec<DataTable> {
    let mut simulated = DataTable::new([
        "service times",
        "sampling",
        "p50, ms",
        "p95, ms",
        "p99, ms",
        "above 15 ms",
        "above 40 ms",
        "samples",
    ])
    .right_after(2);
    for of in all.iter().filter(|of| of.span == Span::Whole && of.walk != MEASURED) {
        let Distribution { samples, p50_ms, p95_ms, p99_ms, above_15_ms, above_40_ms } = of.distribution;
        let figures = [ms(p50_ms), ms(p95_ms), ms(p99_ms), percent(above_15_ms), percent(above_40_ms)];
        let names = [of.walk.to_owned(), of.sampling.name().to_owned()];
        simulated.row(names.into_iter().chain(figures).chain([samples.to_string()]));
    }
    let mut tables = vec![simulated];
    if !all.iter().any(|of| of.walk == MEASURED) {
        return tables;
    }
    let heads = ["part", "walk", "p95, ms", "p99, ms", "above 15 ms", "above 40 ms", "samples"];
    let mut compared = DataTable::new(heads).right_after(2);
    for span in [Span::Whole, Span::FirstHalf, Span::SecondHalf] {
        let is_beside = |of: &&WalkDistribution| of.walk == MEASURED || of.sampling == Sampling::OneASecond;
        let of_span = || all.iter().filter(|of| of.span == span).filter(is_beside);
        // The measured walk first, then what is compared with it.
        let (measured, others): (Vec<_>, Vec<_>) = of_span().partition(|of| of.walk == MEASURED);
        for of in measured.into_iter().chain(others) {
            let Distribution { samples, p95_ms, p99_ms, above_15_ms, above_40_ms, .. } = of.distribution;
            let ends = of.intervals.as_ref();
            compared.row([
                span.name().to_owned(),
                of.walk.to_owned(),
                with_interval(&ms, p95_ms, ends.map(|its| its.p95_ms)),
                with_interval(&ms, p99_ms, ends.map(|its| its.p99_ms)),
                with_interval(&percent, above_15_ms, ends.map(|its| its.above_15_ms)),
                with_interval(&percent, above_40_ms, ends.map(|its| its.above_40_ms)),
                samples.to_string(),
            ]);
        }
    }
    tables.push(compared);
    tables
}

/// Returns all distributions with all digits, and those that predict the second half of a measured walk.
pub(super) fn data(all: &[WalkDistribution], tests: &[WalkTest]) -> DataTable {
    let figures = ["p95_ms", "p99_ms", "above_15_ms", "above_40_ms"];
    let ends = figures.iter().flat_map(|figure| [format!("{figure}_low"), format!("{figure}_high")]);
    let heads = ["part", "walk", "sampling", "samples", "p50_ms"].into_iter().chain(figures);
    let mut table = DataTable::new(heads.map(str::to_owned).chain(ends));
    let mut row = |names: [String; 3], of: &Distribution, intervals: Option<Intervals>| {
        let Distribution { samples, p50_ms, p95_ms, p99_ms, above_15_ms, above_40_ms } = *of;
        let figures = [p50_ms, p95_ms, p99_ms, above_15_ms, above_40_ms].map(|figure| figure.to_string());
        let ends = intervals.map(|its| [its.p95_ms, its.p99_ms, its.above_15_ms, its.above_40_ms]);
        let ends = match ends {
            Some(ends) => {
                ends.iter().flat_map(|end| [end.low, end.high]).map(|end| end.to_string()).collect()
            }
            None => vec![String::new(); 8],
        };
        table.row(names.into_iter().chain([samples.to_string()]).chain(figures).chain(ends));
    };
    for of in all {
        let names = [of.span.name(), of.walk, of.sampling.name()].map(str::to_owned);
        row(names, &of.distribution, of.intervals);
    }
    for test in tests {
        for prediction in &test.predictions {
            let walk = format!("{}: {}", test.contender, prediction.by.name());
            let names = [Span::SecondHalf.name().to_owned(), walk, Sampling::All.name().to_owned()];
            row(names, &prediction.figures, None);
        }
    }
    table
}
