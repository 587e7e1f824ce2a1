//! `cotorra history diff`: compares two runs.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_graph::{Declared, Figure, LatenessQuantity, LinkQuantity, ServiceId, Total};
use cotorra_measurements::{
    Difference, Values,
    difference::{Entry, Links, Services},
};
use cotorra_testbed::{Fidelity, Judged, Kept};

use super::{
    answer::first_of,
    args::DiffArgs,
    plot,
    services::testbed,
    source::{Error, Source},
};
use crate::{
    output,
    table::Table,
    words::{clock, percent, percent_apart},
};

/// Maximum number of rows of each table.
const ROWS: usize = 30;
const ALL: &str = "--json shows all";

/// Compares two runs.
pub fn diff(args: &DiffArgs) -> miette::Result<()> {
    let [a, b] = &args.pair[..] else { unreachable!("the parser takes two runs") };
    // The runs may be in two histories.
    let (a, b) = (Source::find(a, &args.place)?, Source::find(b, &args.place)?);
    // Without its testbed file, the share within the target is unknown.
    let services = |source: &Source| testbed(source).map_or_else(|_| Vec::new(), |testbed| testbed.services);
    let services = [&a, &b].map(services);
    let targets = services.each_ref().map(|services| {
        services.iter().map(|service| (service.id.clone(), service.kpis.service_time)).collect()
    });
    let difference =
        a.history.difference_with(a.run.id, &b.history, b.run.id, targets).map_err(Error::from)?;
    if args.json {
        let json = serde_json::to_string_pretty(&difference).expect("a difference holds only what JSON can");
        return output::print_exact(&(json + "\n"));
    }
    let keep = services.each_ref().map(|services| {
        services.iter().filter_map(|service| Some((service.id.clone(), service.kpis.kept?.get()))).collect()
    });
    let kpis = [&a, &b].map(Source::kpis);
    let verdicts = [&a, &b].map(|source| source.verdict().map_or("unknown".to_owned(), verdict));
    output::print(&(describe(&difference, &verdicts, &keep) + &describe_kpis(&kpis)))
}

/// Describes the KPIs of two runs beside their targets; empty without any.
fn describe_kpis(kpis: &[BTreeMap<ServiceId, Vec<Judged>>; 2]) -> String {
    let named = |of: &BTreeMap<ServiceId, Vec<Judged>>| -> Vec<_> {
        of.iter()
            .flat_map(|(service, kpis)| kpis.iter().map(move |its| (service.clone(), its.kpi.clone())))
            .collect()
    };
    let names: BTreeSet<_> = kpis.iter().flat_map(named).collect();
    let mut table = Table::new("<<>>");
    table.row(["service", "KPI", "first", "second"]);
    for (service, kpi) in &names {
        let judged = |of: &BTreeMap<ServiceId, Vec<Judged>>| {
            let Some(its) = of.get(service).and_then(|kpis| kpis.iter().find(|its| its.kpi == *kpi)) else {
                return "-".to_owned();
            };
            let measured = its.measured.as_deref().unwrap_or("not measured");
            its.verdict.map_or("not judged".to_owned(), |verdict| format!("{measured} {verdict}"))
        };
        let [first, second] = kpis.each_ref().map(judged);
        table.row([service.to_string(), kpi.clone(), first, second]);
    }
    if names.is_empty() { String::new() } else { format!("\nKPIs\n{}", table.render("  ")) }
}

/// Returns the word of a verdict, with the reason if the run is not valid.
fn verdict(its: Fidelity) -> String {
    if its.valid { its.word().to_owned() } else { format!("{}: {}", its.word(), its.reason) }
}

/// Describes the difference of two runs with these verdicts, of which each demands these shares of its services.
fn describe(difference: &Difference, verdicts: &[String; 2], keep: &[BTreeMap<ServiceId, f64>; 2]) -> String {
    let mut text = String::new();
    let mut section = |title: &str, table: Table, rows: usize| {
        if rows > 0 {
            text += &format!("{}{title}\n{}", if text.is_empty() { "" } else { "\n" }, table.render("  "));
            first_of(&mut text, ROWS, rows, ALL);
        }
    };
    let mut runs = Table::new("<<<");
    runs.row(["", "first", "second"]);
    let both = |what: &str, show: &dyn Fn(usize) -> String| [what.to_owned(), show(0), show(1)];
    runs.row(both("testbed", &|i| difference.runs[i].info.name.clone()));
    runs.row(both("seed", &|i| difference.runs[i].info.seed.to_string()));
    runs.row(both("lasted", &|i| {
        difference.runs[i].ended.map_or("no end".to_owned(), |ended| clock(ended.as_secs_f64()))
    }));
    runs.row(both("testbed file", &|i| match (
        i,
        difference.runs[0].info.testbed == difference.runs[1].info.testbed,
    ) {
        (1, true) => "the same".to_owned(),
        (1, false) => "another".to_owned(),
        _ => String::new(),
    }));
    runs.row(both("verdict", &|i| verdicts[i].clone()));
    runs.row(both("events lost", &|i| {
        let lost = difference.doubts[i].lost_events;
        // It is unknown what a run without an end lost after its last event.
        difference.runs[i].ended.map_or_else(|| format!("at least {lost}"), |_| lost.to_string())
    }));
    runs.row(both("lateness p99", &|i| {
        difference.doubts[i].lateness_p99_us.map_or("-".to_owned(), |us| {
            format!("{us:.1} {}", LatenessQuantity::P99.declared().unit.symbol())
        })
    }));
    section("Runs", runs, 1);

    let mut kept = Table::new("<>>>>>>");
    let [samples_of, unanswered, share_of] =
        [Total::Samples, Total::Unanswered, Total::Kept].map(Total::as_str);
    kept.row(["service", samples_of, "", unanswered, "", share_of, ""]);
    for Entry { of, runs } in difference.services.iter().take(ROWS) {
        let show = |of: &dyn Fn(usize, &Services) -> String| {
            [0, 1].map(|i| runs[i].as_ref().map_or("-".to_owned(), |its| of(i, its)))
        };
        let share = |i: usize, its: &Services| share(its, keep[i].get(&of.service).copied());
        let columns = [
            show(&|_, its| its.samples.to_string()),
            show(&|_, its| its.unanswered.to_string()),
            show(&share),
        ];
        let name = format!("{} of {}", of.service, of.robot);
        kept.row([name].into_iter().chain(columns.into_iter().flatten()));
    }
    section("Samples within the target", kept, difference.services.len());

    let of_service = Figure::ServiceTime { service: None, robot: None }.declared();
    let services = difference
        .services
        .iter()
        .map(|entry| (format!("{} of {}", entry.of.service, entry.of.robot), samples(&entry.runs)));
    section(
        &titled("of answered samples", of_service),
        figures("service", services.take(ROWS)),
        difference.services.len(),
    );

    let regions = difference.regions.iter().map(|entry| {
        let attachment = entry.of.attachment.as_ref().map_or("none", |id| id.as_str());
        let of = format!("{} of {}", entry.of.service, entry.of.robot);
        (format!("{of} by {attachment}, {}", entry.of.server), samples(&entry.runs))
    });
    section(
        &titled("of answered samples by region", of_service),
        figures("region", regions.take(ROWS)),
        difference.regions.len(),
    );

    // A link that no packet crossed has no delay.
    let used: Vec<_> =
        difference.links.iter().filter(|entry| delays(&entry.runs).iter().any(Option::is_some)).collect();
    let links = used.iter().map(|entry| {
        let direction = format!("{:?}", entry.of.direction).to_lowercase();
        (format!("{} {direction}", entry.of.link), delays(&entry.runs))
    });
    section(
        &titled("of links", LinkQuantity::Delay.declared()),
        figures("link", links.take(ROWS)),
        used.len(),
    );

    let handovers = difference.handovers.iter().map(|entry| {
        let from = entry.of.from.as_ref().map_or("none", |id| id.as_str());
        let gaps = entry.runs.each_ref();
        let gaps = gaps.map(|gaps| gaps.as_ref()?.gap_ms.as_ref().map(Samples::all_answered));
        (format!("{} from {from} to {}", entry.of.robot, entry.of.to), gaps)
    });
    let gap = Figure::HandoverGap { robot: None }.declared().unit.symbol();
    section(
        &format!("Handovers, gap in {gap}"),
        figures("handover", handovers.take(ROWS)),
        difference.handovers.len(),
    );

    let mut placements = Table::new("<>>");
    placements.row(["VNF on node", "s, first", "s, second"]);
    for Entry { of, runs } in difference.placements.iter().take(ROWS) {
        let [a, b] = runs
            .each_ref()
            .map(|on| on.as_ref().map_or("-".to_owned(), |on| format!("{:.1}", on.duration_ms / 1e3)));
        placements.row([format!("{} on {}", of.vnf, of.node), a, b]);
    }
    section("Placements", placements, difference.placements.len());

    let mut decisions = Table::new("<>>");
    decisions.row(["decision", "first", "second"]);
    for Entry { of, runs } in difference.decisions.iter().take(ROWS) {
        let [a, b] = runs.each_ref().map(|made| match made {
            Some(made) if made.refused > 0 => format!("{} ({} refused)", made.count, made.refused),
            Some(made) => made.count.to_string(),
            None => "-".to_owned(),
        });
        decisions.row([format!("{}: {}", of.plugin, of.instruction), a, b]);
    }
    section("Decisions", decisions, difference.decisions.len());
    if text.contains(plot::ABOUT) {
        text += &format!(
            "\n{}: some samples were rolled up, or are too many to keep; --json gives bounds.\n",
            plot::ABOUT
        );
    }
    text
}

/// Returns the title of a section: the figure's name, whose samples they are, and the unit.
fn titled(whose: &str, figure: &Declared) -> String {
    let name = figure.name.replace('_', " ");
    let (first, rest) = name.split_at(1);
    format!("{}{rest} {whose}, {}", first.to_uppercase(), figure.unit.symbol())
}

/// Returns the share of samples within the target, and the verdict on it.
fn share(its: &Services, keep: Option<f64>) -> String {
    let Some(kept) = its.kept else { return "-".to_owned() };
    let verdict = Kept::beside(Some(1.0 - kept), its.samples as usize, keep).verdict;
    let share = keep.map_or_else(|| percent(kept), |keep| percent_apart(kept, keep));
    verdict.map_or(share.clone(), |verdict| format!("{share} {verdict}"))
}

/// Compared figures of a run. Requests without an answer count as samples, but have no time.
#[derive(Clone, Copy)]
struct Samples<'a> {
    unanswered: u64,
    values: Option<&'a Values>,
}

impl<'a> Samples<'a> {
    fn of(services: &'a Services) -> Self {
        Self { unanswered: services.unanswered, values: services.service_time_ms.as_ref() }
    }

    fn all_answered(values: &'a Values) -> Self {
        Self { unanswered: 0, values: Some(values) }
    }

    /// `1199`, `1199 (4 unanswered)`.
    fn count(self) -> String {
        let count = self.unanswered + self.values.map_or(0, |values| values.count);
        match self.unanswered {
            0 => count.to_string(),
            unanswered => format!("{count} ({unanswered} unanswered)"),
        }
    }

    fn quantile(self, place: usize) -> String {
        self.values.map_or("-".to_owned(), |values| plot::quantile(values, place))
    }
}

fn delays(runs: &[Option<Links>; 2]) -> [Option<Samples<'_>>; 2] {
    runs.each_ref().map(|links| links.as_ref()?.delay_ms.as_ref().map(Samples::all_answered))
}

fn samples(runs: &[Option<Services>; 2]) -> [Option<Samples<'_>>; 2] {
    runs.each_ref().map(|services| services.as_ref().map(Samples::of))
}

/// Returns a table of the count, median and 99th percentile in both runs, and the difference of the medians.
fn figures<'a>(what: &str, rows: impl Iterator<Item = (String, [Option<Samples<'a>>; 2])>) -> Table {
    let mut table = Table::new("<>>>>>>>");
    table.row([what, "samples", "", "median", "", "p99", "", "median differs"]);
    for (name, [a, b]) in rows {
        let count = |of: Option<Samples<'_>>| of.map_or("-".to_owned(), Samples::count);
        let quantile =
            |of: Option<Samples<'_>>, place| of.map_or("-".to_owned(), |samples| samples.quantile(place));
        let median = |of: Option<Samples<'_>>| Some(of?.values?.quantiles[0]);
        let differs = median(a).zip(median(b)).map(|(a, b)| format!("{:+.3}", b - a)).unwrap_or_default();
        let [p50, p99] = [0, 2].map(|place| [quantile(a, place), quantile(b, place)]);
        let cells =
            [[name].to_vec(), [count(a), count(b)].to_vec(), p50.to_vec(), p99.to_vec(), vec![differs]];
        table.row(cells.concat());
    }
    table
}
