//! `cotorra history diff`: two runs side by side.

use std::collections::BTreeMap;

use cotorra_measurements::{
    Difference, Values,
    difference::{Entry, Links, Services},
};

use super::{Error, Source, first_of, plot::figure};
use crate::{cli::DiffArgs, output, run::clock, table::Table};

/// No more rows of each table are shown.
const ROWS: usize = 30;
const ALL: &str = "--json shows all";

/// Compares two runs.
pub fn diff(args: &DiffArgs) -> miette::Result<()> {
    let [a, b] = &args.pair[..] else { unreachable!("the parser takes two runs") };
    let difference = compare(&Source::find(a, &args.place)?, &Source::find(b, &args.place)?)?;
    if args.json {
        let json = serde_json::to_string_pretty(&difference).expect("a difference holds only what JSON can");
        return output::print(&(json + "\n"));
    }
    output::print(&describe(&difference))
}

/// The runs may be in two histories: so each is set beside itself first, and then the one beside the other.
fn compare(a: &Source, b: &Source) -> Result<Difference, Error> {
    let alone = |source: &Source| source.history.difference(source.run.id, source.run.id);
    let (a, b) = (alone(a)?, alone(b)?);
    let ([run_a, _], [run_b, _]) = (a.runs, b.runs);
    let ([doubts_a, _], [doubts_b, _]) = (a.doubts, b.doubts);
    Ok(Difference {
        runs: [run_a, run_b],
        services: join(a.services, b.services),
        regions: join(a.regions, b.regions),
        links: join(a.links, b.links),
        handovers: join(a.handovers, b.handovers),
        placements: join(a.placements, b.placements),
        decisions: join(a.decisions, b.decisions),
        vnfs: join(a.vnfs, b.vnfs),
        doubts: [doubts_a, doubts_b],
    })
}

fn join<K: Ord, V>(a: Vec<Entry<K, V>>, b: Vec<Entry<K, V>>) -> Vec<Entry<K, V>> {
    let mut joined: BTreeMap<K, [Option<V>; 2]> = BTreeMap::new();
    for (place, entries) in [a, b].into_iter().enumerate() {
        for Entry { of, runs: [value, _] } in entries {
            joined.entry(of).or_insert([None, None])[place] = value;
        }
    }
    joined.into_iter().map(|(of, runs)| Entry { of, runs }).collect()
}

fn describe(difference: &Difference) -> String {
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
    runs.row(both("events lost", &|i| difference.doubts[i].lost_events.to_string()));
    runs.row(both("lateness p99", &|i| {
        difference.doubts[i].lateness_p99_us.map_or("-".to_owned(), |us| format!("{us:.1} µs"))
    }));
    section("Runs", runs, 1);

    let services = difference
        .services
        .iter()
        .map(|entry| (format!("{} of {}", entry.of.service, entry.of.robot), samples(&entry.runs)));
    section("Service time, ms", figures("service", services.take(ROWS)), difference.services.len());

    let regions = difference.regions.iter().map(|entry| {
        let attachment = entry.of.attachment.as_ref().map_or("none", |id| id.as_str());
        (format!("{} by {attachment}, {}", entry.of.robot, entry.of.server), samples(&entry.runs))
    });
    section("Service time by region, ms", figures("region", regions.take(ROWS)), difference.regions.len());

    // What nothing crossed says nothing.
    let used: Vec<_> =
        difference.links.iter().filter(|entry| delays(&entry.runs).iter().any(Option::is_some)).collect();
    let links = used.iter().map(|entry| {
        let direction = format!("{:?}", entry.of.direction).to_lowercase();
        (format!("{} {direction}", entry.of.link), delays(&entry.runs))
    });
    section("Delay of links, ms", figures("link", links.take(ROWS)), used.len());

    let handovers = difference.handovers.iter().map(|entry| {
        let from = entry.of.from.as_ref().map_or("none", |id| id.as_str());
        let gaps = entry.runs.each_ref().map(|gaps| gaps.as_ref().and_then(|h| h.gap_ms.as_ref()));
        (format!("{} from {from} to {}", entry.of.robot, entry.of.to), gaps)
    });
    section("Handovers, gap in ms", figures("handover", handovers.take(ROWS)), difference.handovers.len());

    let mut placements = Table::new("<>>");
    placements.row(["VNF on node", "s, first", "s, second"]);
    for Entry { of, runs } in difference.placements.iter().take(ROWS) {
        let [a, b] =
            runs.each_ref().map(|on| on.as_ref().map_or("-".to_owned(), |on| format!("{:.1}", on.seconds)));
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
    text
}

fn delays(runs: &[Option<Links>; 2]) -> [Option<&Values>; 2] {
    runs.each_ref().map(|links| links.as_ref().and_then(|links| links.delay_ms.as_ref()))
}

fn samples(runs: &[Option<Services>; 2]) -> [Option<&Values>; 2] {
    runs.each_ref().map(|services| services.as_ref().and_then(|s| s.took_ms.as_ref()))
}

/// Count, median and 99th percentile in both runs, and by how much the median differs.
fn figures<'a>(what: &str, rows: impl Iterator<Item = (String, [Option<&'a Values>; 2])>) -> Table {
    let mut table = Table::new("<>>>>>>>");
    table.row([what, "samples", "", "median", "", "p99", "", "median differs"]);
    for (name, [a, b]) in rows {
        let show =
            |values: Option<&Values>, of: &dyn Fn(&Values) -> String| values.map_or("-".to_owned(), of);
        let quantile = |place: usize| move |values: &Values| figure(values.quantiles[place]);
        let count = |values: &Values| values.count.to_string();
        let differs = match (a, b) {
            (Some(a), Some(b)) => format!("{:+.3}", b.quantiles[0] - a.quantiles[0]),
            _ => String::new(),
        };
        table.row([
            name,
            show(a, &count),
            show(b, &count),
            show(a, &quantile(0)),
            show(b, &quantile(0)),
            show(a, &quantile(2)),
            show(b, &quantile(2)),
            differs,
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_only_one_run_has_is_told_of_that_one() {
        let entry = |of: u8| Entry { of, runs: [Some(of * 10), Some(of * 10)] };
        let joined = join(vec![entry(1), entry(2)], vec![entry(2), entry(3)]);
        let told: Vec<_> = joined.into_iter().map(|entry| (entry.of, entry.runs)).collect();
        assert_eq!(told, [(1, [Some(10), None]), (2, [Some(20), Some(20)]), (3, [None, Some(30)])]);
    }
}
