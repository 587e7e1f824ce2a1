//! The COTORRA letter's first validation (arXiv 2101.07676). A robot walks the corridor and back twice. With the state of
//! the art, navigation stays in the cloud and the robot roams by periodic probing; the second walk is orchestrated by OKpi.
//! Both are compared by the service times of the first service, which is navigation, and with a walk that was measured. [`fit`] fits a
//! contender's testbed to a half of that walk; the comparison has the test on the other half.

mod bootstrap;
mod decided;
mod distribution;
mod drawn;
mod figures;
mod fitted;
#[cfg(test)]
mod fitted_tests;
mod measured;
mod needs;
mod published;
mod spent;
#[cfg(test)]
mod tests;
mod times;

use std::{fmt::Write as _, path::Path};

pub use cotorra_calibrate::WalkFit;
use cotorra_figure::Format;
use cotorra_graph::{NodeId, Position, Service, ServiceTime, Testbed, millis};
use cotorra_testbed::{DataTable, FolderError, Quantiles, Report, Summary, service_time_ms, write_file};
use serde::Serialize;

use self::{
    decided::{Decided, Legs},
    published::PUBLISHED,
};
pub use self::{
    distribution::{Sampling, Span, WalkDistribution},
    figures::{Distribution, Intervals},
    fitted::{FittedWalk, Prediction, Predictor, WalkTest, fit},
    measured::{MAX_ROWS, Measured, MeasuredError},
    needs::{Unfit, check},
    spent::SpentByWalk,
};

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
pub const FILES: [&str; 7] = [
    "comparison.svg",
    "comparison.md",
    "comparison.json",
    "samples.csv",
    "comparison.tex",
    "medians.csv",
    "distributions.csv",
];

/// The walks of a comparison.
#[derive(Debug, Clone, Copy)]
pub struct Walks<'a> {
    pub testbed: &'a Testbed,
    /// The walk with the state of the art.
    pub soa: &'a Report,
    /// The walk with OKpi.
    pub okpi: &'a Report,
    /// A measured walk to compare both with.
    pub measured: Option<&'a Measured>,
    /// Walks on testbeds that were fitted to the measured walk.
    pub fitted: &'a [FittedWalk<'a>],
    /// Seed of the fits to a measured walk, and of the intervals around its figures.
    pub seed: u64,
}

impl Walks<'_> {
    /// Returns a contender's walk.
    fn of(&self, contender: &Contender) -> &Report {
        if *contender == CONTENDERS[0] { self.soa } else { self.okpi }
    }
}

/// A sample within this time of a completed handover belongs to the handover, seconds.
const AROUND_HANDOVER_S: f64 = 1.0;

/// A comparison of the two walks with each other and with the published ones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Medians of each part of the walk.
    pub parts: Vec<Part>,
    /// OKpi's changes of radio unit and server.
    pub changes: Vec<Change>,
    /// Shares of samples above the target. Samples without an answer count as above it.
    pub above_target: Vec<AboveTarget>,
    /// Distributions of service times, of both samplings, and of the measured walk and its halves if there is one.
    pub distributions: Vec<WalkDistribution>,
    /// Fits to the first half of the measured walk, and their tests on the second.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tests: Vec<WalkTest>,
    /// What each contender's walk spent, if the testbed has prices or powers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub spent: Vec<SpentByWalk>,
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
    /// Compares the walks.
    pub fn of(walks: &Walks<'_>) -> Self {
        let Walks { testbed, soa, okpi, .. } = *walks;
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
            distributions: distribution::all(walks),
            tests: fitted::tests(walks),
            spent: Vec::new(),
            target_ms,
        }
    }

    /// Adds what the walks spent: the one with the state of the art, and the one with OKpi.
    #[must_use]
    pub fn with_spent(self, walks: [&Summary; 2]) -> Self {
        Self { spent: spent::by_contender(walks), ..self }
    }

    /// Returns the tables of medians, changes, shares, distributions and predictions, in Markdown. `how` says how the walks were
    /// run.
    pub fn to_markdown(&self, how: &str) -> String {
        let tables = self.tables().iter().map(DataTable::to_markdown).collect::<Vec<_>>().join("\n");
        let remarks = fitted::remarks(&self.tests);
        format!("Median service time, ms ({how}; published figures: arXiv 2101.07676)\n\n{tables}{remarks}")
    }

    /// Returns the tables of medians, changes, shares, distributions and predictions, rounded for readers.
    fn tables(&self) -> Vec<DataTable> {
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
        let others = distribution::tables(&self.distributions).into_iter().chain(fitted::tables(&self.tests));
        let spent = spent::table(&self.spent);
        [medians, changes, shares].into_iter().chain(spent).chain(others).collect()
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

    /// Writes [`FILES`]: the figure, the tables, and the samples behind both.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write(&self, folder: &Path, how: &str, walks: &Walks<'_>) -> Result<(), FolderError> {
        let Walks { testbed, soa, okpi, .. } = *walks;
        let decided = Decided::by(testbed, okpi);
        let theory = decided.theory(testbed);
        let at = |seconds: f64| decided.at(seconds).and_then(|state| theory.get(state).copied());
        let [_, tables, data, samples, for_papers, medians, distributions] = FILES;
        self.write_figure(folder, walks, Format::Svg)?;
        write_file(folder, tables, self.to_markdown(how))?;
        write_file(
            folder,
            for_papers,
            self.tables().iter().map(DataTable::to_latex).collect::<Vec<_>>().join("\n"),
        )?;
        write_file(folder, medians, self.medians().to_csv())?;
        write_file(folder, distributions, distribution::data(&self.distributions, &self.tests).to_csv())?;
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
    /// Writes the figure, `comparison`, in a format: the published layout, and the distributions below.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn write_figure(&self, folder: &Path, walks: &Walks<'_>, format: Format) -> Result<(), FolderError> {
        let figure = drawn::figure(walks);
        write_file(folder, &format!("comparison.{format}"), figure.draw().render(format))
    }
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
