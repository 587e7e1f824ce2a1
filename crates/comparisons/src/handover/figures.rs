//! Figures of each kind of radio, and whether those of the model lie in the intervals of the others'.

use cotorra_numbers::{Draws, Interval, Quantiles, bootstrap};
use cotorra_testbed::DataTable;
use serde::Serialize;

use super::{KINDS, Kind, NOT_MEASURED, Walk, Walked, measured::Roam, shown};

/// Figures of one kind of radio and one walk, over all seeds. `None` without samples.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    pub kind: String,
    pub walk: Walk,
    /// Number of handovers, and of fast transitions among them.
    pub roams: usize,
    pub fast: usize,
    /// Gaps by events.
    pub gap_p50_ms: Option<f64>,
    pub gap_p95_ms: Option<f64>,
    /// Gaps by packets.
    pub packet_gap_p50_ms: Option<f64>,
    pub packet_gap_p95_ms: Option<f64>,
    /// Number of scans.
    pub scans: usize,
    /// Times of scans, and the longest time without packets in each.
    pub scan_p50_ms: Option<f64>,
    pub scan_p95_ms: Option<f64>,
    pub scan_packet_gap_p50_ms: Option<f64>,
    /// Further tries of handovers, and radio units lost.
    pub retries: usize,
    pub losses: usize,
    /// Frames that the robot's radio sent again.
    pub frames_again: Option<u64>,
    /// Share of position packets without an answer.
    pub unanswered: Option<f64>,
}

/// Whether a figure of the model lies in the 95 % interval of another kind of radio.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// As in `gap p50`.
    pub figure: String,
    /// Whether of fast transitions, or of other handovers.
    pub fast: bool,
    /// Numbers of handovers: of the model, and of the other kind.
    pub roams: [usize; 2],
    pub model_ms: f64,
    /// Name of the other kind.
    pub kind: String,
    pub other_ms: f64,
    /// The other's interval.
    pub interval: Interval,
    pub is_inside: bool,
}

fn of<'a>(walks: &'a [Walked], kind: &'a str, walk: Walk) -> impl Iterator<Item = &'a Walked> + Clone {
    walks.iter().filter(move |walked| walked.kind == kind && walked.walk == walk)
}

/// Returns the names of the kinds that were measured, in the order of [`KINDS`].
pub(super) fn kinds(walks: &[Walked]) -> impl Iterator<Item = &'static str> {
    KINDS.iter().map(|kind| kind.name).filter(|name| walks.iter().any(|walked| walked.kind == *name))
}

fn quantiles(values: impl Iterator<Item = f64>) -> Option<Quantiles> {
    Quantiles::of(values.collect())
}

pub(super) fn rows(walks: &[Walked]) -> Vec<Row> {
    let mut rows = Vec::new();
    for walk in Walk::ALL {
        for kind in kinds(walks) {
            let of = of(walks, kind, walk);
            if of.clone().next().is_none() {
                continue;
            }
            let roams = || of.clone().flat_map(|walked| &walked.roams);
            let scans = || of.clone().flat_map(|walked| &walked.scans);
            let gaps = quantiles(roams().map(|roam| roam.gap_ms));
            let packets = quantiles(roams().filter_map(|roam| roam.packet_gap_ms));
            let took = quantiles(scans().map(|scan| scan.took_ms));
            let away = quantiles(scans().filter_map(|scan| scan.packet_gap_ms));
            let all: usize = of.clone().map(|walked| walked.packets).sum();
            let unanswered: usize = of.clone().map(|walked| walked.unanswered).sum();
            rows.push(Row {
                kind: kind.to_owned(),
                walk,
                roams: roams().count(),
                fast: roams().filter(|roam| roam.fast).count(),
                gap_p50_ms: gaps.map(|its| its.p50),
                gap_p95_ms: gaps.map(|its| its.p95),
                packet_gap_p50_ms: packets.map(|its| its.p50),
                packet_gap_p95_ms: packets.map(|its| its.p95),
                scans: scans().count(),
                scan_p50_ms: took.map(|its| its.p50),
                scan_p95_ms: took.map(|its| its.p95),
                scan_packet_gap_p50_ms: away.map(|its| its.p50),
                retries: of.clone().map(|walked| walked.retries).sum(),
                losses: of.clone().map(|walked| walked.losses).sum(),
                frames_again: of.clone().filter_map(|walked| walked.frames_again).reduce(|a, b| a + b),
                unanswered: (all > 0).then(|| unanswered as f64 / all as f64),
            });
        }
    }
    rows
}

pub(super) fn table(rows: &[Row]) -> DataTable {
    let mut table = DataTable::new([
        "walk",
        "radio",
        "handovers",
        "fast",
        "gap p50",
        "p95",
        "by packets p50",
        "p95",
        "scans",
        "scan p50",
        "p95",
        "without packets",
        "retries",
        "lost",
        "frames again",
        "unanswered, %",
    ])
    .right_after(2);
    for row in rows {
        let is_emulated = Kind::named(&row.kind).is_none_or(|kind| kind.is_emulated);
        let of_packets = |figure| if is_emulated { shown(figure) } else { NOT_MEASURED.to_owned() };
        table.row([
            row.walk.name().to_owned(),
            row.kind.clone(),
            row.roams.to_string(),
            row.fast.to_string(),
            shown(row.gap_p50_ms),
            shown(row.gap_p95_ms),
            of_packets(row.packet_gap_p50_ms),
            of_packets(row.packet_gap_p95_ms),
            row.scans.to_string(),
            shown(row.scan_p50_ms),
            shown(row.scan_p95_ms),
            of_packets(row.scan_packet_gap_p50_ms),
            row.retries.to_string(),
            row.losses.to_string(),
            row.frames_again.map_or_else(|| NOT_MEASURED.to_owned(), |frames| frames.to_string()),
            of_packets(row.unanswered.map(|share| share * 100.0)),
        ]);
    }
    table
}

/// Reads a figure of a handover.
type Figure = fn(&Roam) -> Option<f64>;

/// Compares the gaps of the first kind with those of each other kind, on walks on which robots are sent: they have many
/// handovers.
pub(super) fn verdicts(walks: &[Walked], seed: u64) -> Vec<Verdict> {
    let figures: [(&str, Figure); 2] =
        [("gap", |roam| Some(roam.gap_ms)), ("gap by packets", |roam| roam.packet_gap_ms)];
    let mut verdicts = Vec::new();
    let [first, others @ ..] = &KINDS;
    for kind in others {
        for fast in [true, false] {
            for (name, figure) in figures {
                let values = |kind| -> Vec<f64> {
                    let roams = of(walks, kind, Walk::Sent).flat_map(|walked| &walked.roams);
                    roams.filter(|roam| roam.fast == fast).filter_map(figure).collect()
                };
                let (model, other) = (values(first.name), values(kind.name));
                let both = Quantiles::of(model.clone()).zip(Quantiles::of(other.clone()));
                let Some((of_model, of_other)) = both else { continue };
                type Quantile = (&'static str, fn(Quantiles) -> f64);
                let quantiles: [Quantile; 2] = [("p50", |its| its.p50), ("p95", |its| its.p95)];
                for (quantile, read) in quantiles {
                    let label = format!("{name} {quantile}");
                    let draws = &mut Draws::new(seed, &format!("bootstrap {label}"));
                    let Some(interval) = bootstrap(&other, draws, |its| Quantiles::of(its).map(read)) else {
                        continue;
                    };
                    verdicts.push(Verdict {
                        figure: label,
                        fast,
                        roams: [model.len(), other.len()],
                        model_ms: read(of_model),
                        kind: kind.name.to_owned(),
                        other_ms: read(of_other),
                        is_inside: interval.holds(read(of_model)),
                        interval,
                    });
                }
            }
        }
    }
    verdicts
}

pub(super) fn verdict_table(verdicts: &[Verdict]) -> DataTable {
    let heads = ["figure", "handovers", "model", "radio", "its figure", "95 % interval", "model inside"];
    let mut table = DataTable::new(heads).right_after(2);
    for verdict in verdicts {
        let Interval { low, high } = verdict.interval;
        let [model, other] = verdict.roams;
        let which = if verdict.fast { "fast transitions" } else { "others" };
        table.row([
            verdict.figure.clone(),
            format!("{which}: {model}, {other}"),
            shown(Some(verdict.model_ms)),
            verdict.kind.clone(),
            shown(Some(verdict.other_ms)),
            format!("{low:.2} to {high:.2}"),
            if verdict.is_inside { "yes" } else { "NO" }.to_owned(),
        ]);
    }
    table
}
