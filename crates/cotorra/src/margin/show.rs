//! Plans and results of searches, for people.

use std::{cmp::Ordering, path::Path};

use cotorra_experiments::margin::{Estimate, FILES, Finding, Margin, Margins, ServiceKept};
use cotorra_graph::Natural;

use super::MarginArgs;
use crate::{
    table::{Table, wrap},
    words::{self, count, of_them},
};

/// Maximum number of searches that the terminal lists.
const LISTED: usize = 40;
/// Columns of the sentences.
const WIDTH: usize = 100;

/// Describes what would be searched.
pub fn plan(margin: &Margin, args: &MarginArgs, jobs: std::num::NonZero<usize>) -> String {
    let Estimate { least, most } = margin.estimate();
    let services: Vec<_> = margin.services().iter().map(ToString::to_string).collect();
    let mut names: Vec<_> = margin.dimensions().iter().map(|dimension| dimension.on().to_owned()).collect();
    names.extend(margin.units().iter().map(ToString::to_string));
    names.sort_by_cached_key(|name| Natural::of(name));
    names.dedup();
    format!(
        "{}: {least} to {most} runs in virtual time, {jobs} at a time\n\n{}{}",
        args.file.display(),
        wrap(
            &format!("targets: {}; {} % of samples must keep theirs", services.join(", "), args.keep * 100.0),
            "  ",
            WIDTH
        ),
        wrap(&format!("changes on: {}", names.join(", ")), "  ", WIDTH),
    )
}

/// Describes the result of a search.
pub fn describe(margins: &Margins, folder: &Path) -> String {
    let Margins { keep, seeds, unchanged, findings, complete, runs, resumed, again, void } = margins;
    let mut text = format!(
        "{}{}; {} % of samples must keep their target, over {}\n{again}\n",
        count(*runs, "run"),
        of_them(*resumed, *void),
        keep * 100.0,
        count(*seeds as usize, "seed")
    );
    for ServiceKept { service, service_time_target_ms, samples, kept, .. } in unchanged {
        let kept = kept.unwrap_or(0.0) * 100.0;
        text += &format!(
            "  unchanged: {service} keeps {service_time_target_ms} ms in {kept:.2} % of {samples} samples\n"
        );
    }
    let mut sorted: Vec<_> = findings.iter().collect();
    sorted.sort_by(|a, b| a.change.cmp(b.change).then(by_breaks(a, b)));
    if !sorted.is_empty() {
        let mut table = Table::new("<<<>><");
        table.row(["change", "on", "down", "survives", "breaks at", "kept there"].map(str::to_owned));
        for finding in sorted.iter().take(LISTED) {
            table.row(row(finding));
        }
        text += &format!("\n{}", table.render("  "));
    }
    if sorted.len() > LISTED {
        text += &format!("  and {} more in {}\n", sorted.len() - LISTED, FILES[0]);
    }
    let sentences: Vec<_> = ["delay", "loss", "answers"]
        .iter()
        .filter_map(|change| of_change(change, &sorted))
        .chain(of_units(&sorted))
        .collect();
    if !sentences.is_empty() {
        text += "\n";
        sentences.iter().for_each(|sentence| text += &wrap(sentence, "  ", WIDTH));
    }
    if *void > 0 {
        text += &format!("\n  {}\n", words::logs());
    }
    if !complete {
        text += "\nThe search was stopped; the same command resumes it.\n";
    }
    text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  "))
}

fn by_breaks(a: &Finding, b: &Finding) -> Ordering {
    let at = |finding: &Finding| finding.breaks_ms.or(finding.breaks_loss).unwrap_or(f64::INFINITY);
    b.breaks.cmp(&a.breaks).then(at(a).total_cmp(&at(b)))
}

fn row(finding: &Finding) -> [String; 6] {
    let Finding { change, on, down, breaks, service, kept, failed, complete, void, .. } = finding;
    let name = |name: &Option<String>| name.clone().unwrap_or_default();
    let [survives, at] = match (on, breaks) {
        _ if void.is_some() => [void.iter().map(ToString::to_string).collect(), String::new()],
        (None, true) => ["no", ""].map(str::to_owned),
        (None, false) => [if *complete { "yes" } else { "" }, ""].map(str::to_owned),
        (Some(_), _) => [survives(finding), breaks_at(finding).unwrap_or_default()],
    };
    let kept = match (service, kept, failed) {
        (Some(service), _, Some(kpi)) => format!("{service} fails {kpi}"),
        (Some(service), Some(kept), None) => format!("{service} {:.2} %", kept * 100.0),
        (Some(service), None, None) => format!("{service}: no samples"),
        (None, ..) if *breaks => "a walk does not end".to_owned(),
        (None, ..) => String::new(),
    };
    [(*change).to_owned(), name(on), name(&down.as_ref().map(ToString::to_string)), survives, at, kept]
}

/// `+3.1 ms`, `+0.5 %`.
fn amount(ms: Option<f64>, share: Option<f64>) -> Option<String> {
    let rounded = |figure: f64| (figure * 1e6).round() / 1e6;
    let of_share = || Some(format!("+{} %", rounded(share? * 100.0)));
    ms.map(|ms| format!("+{} ms", rounded(ms))).or_else(of_share)
}

fn survives(finding: &Finding) -> String {
    amount(finding.survives_ms, finding.survives_loss).unwrap_or_default()
}

fn breaks_at(finding: &Finding) -> Option<String> {
    amount(finding.breaks_ms, finding.breaks_loss)
}

/// Returns the sentence on a kind of change that has amounts.
fn of_change(change: &str, sorted: &[&Finding]) -> Option<String> {
    let its = || sorted.iter().filter(move |finding| finding.change == change && finding.complete);
    let first = its().next()?;
    let what = if change == "answers" { "later answers" } else { change };
    let with = first.down.as_ref().map(|down| format!(" with {down} down")).unwrap_or_default();
    let place = format!("{}{with}", first.on.as_deref().unwrap_or_default());
    let survived: Vec<_> = its().filter(|finding| !finding.breaks).collect();
    Some(match (breaks_at(first), survived.first()) {
        (None, _) => format!("{what}: survives {} everywhere.", survives(first)),
        (Some(at), None) => format!("{what}: fails first at {at} on {place}."),
        (Some(at), Some(largest)) => {
            let (largest, of, all) = (survives(largest), survived.len(), its().count());
            format!("{what}: fails first at {at} on {place}; survives {largest} in {of} of {all} cases.")
        }
    })
}

/// Returns the sentence on radio units alone.
fn of_units(sorted: &[&Finding]) -> Option<String> {
    let units: Vec<_> = sorted.iter().filter(|finding| finding.on.is_none() && finding.complete).collect();
    let names = |broken: bool| {
        let of = units.iter().filter(|finding| finding.breaks == broken);
        of.filter_map(|finding| Some(finding.down.as_ref()?.to_string())).collect::<Vec<_>>().join(", ")
    };
    match (names(true), names(false)) {
        _ if units.is_empty() => None,
        (broken, _) if broken.is_empty() => Some("radio units: survives any single one down.".to_owned()),
        (broken, survived) if survived.is_empty() => {
            Some(format!("radio units: fails with any one of {broken} down."))
        }
        (broken, survived) => Some(format!("radio units: fails with {broken} down, survives {survived}.")),
    }
}

#[cfg(test)]
mod tests {
    use cotorra_experiments::Again;

    use super::*;

    fn finding(change: &'static str, on: Option<&str>, down: Option<&str>, breaks: Option<f64>) -> Finding {
        Finding {
            change,
            on: on.map(str::to_owned),
            down: down.map(|down| down.parse().unwrap()),
            breaks: breaks.is_some(),
            survives_ms: on.map(|_| breaks.map_or(100.0, |breaks| breaks - 0.1)),
            breaks_ms: on.and(breaks),
            survives_loss: None,
            breaks_loss: None,
            service: breaks.map(|_| "navigation".parse().unwrap()),
            kept: breaks.map(|_| 0.982),
            failed: None,
            complete: true,
            void: None,
        }
    }

    #[test]
    fn sentences_name_the_smallest_margin_and_the_radio_units() {
        let margins = Margins {
            keep: 0.99,
            seeds: 2,
            unchanged: Vec::new(),
            findings: vec![
                finding("delay", Some("lan-edge"), None, Some(5.0)),
                finding("delay", Some("lan-fog"), None, None),
                finding("delay", Some("lan-edge"), Some("R2"), Some(3.1)),
                finding("answers", Some("edge"), None, None),
                finding("down", None, Some("R2"), None),
                finding("down", None, Some("R3"), Some(1.0)),
            ],
            complete: false,
            runs: 7,
            resumed: 3,
            again: Again::default(),
            void: 0,
        };
        let text = describe(&margins, Path::new("here"));
        for expected in [
            "7 runs, 3 of them from before; 99 % of samples must keep their target, over 2 seeds\n",
            "delay: fails first at +3.1 ms on lan-edge with R2 down; survives +100 ms in 1 of 3 cases.",
            "later answers: survives +100 ms everywhere.",
            "radio units: fails with R3 down, survives R2.",
            "delay    lan-edge  R2       +3 ms    +3.1 ms  navigation 98.20 %\n",
            "the same command resumes it",
        ] {
            assert!(text.contains(expected), "{expected}\n{text}");
        }
        let void = serde_json::from_str(r#""plug-in x: ended""#).unwrap();
        let void = Finding { complete: false, void: Some(void), ..finding("delay", Some("w"), None, None) };
        let text = describe(&Margins { findings: vec![void], void: 1, ..margins.clone() }, Path::new("here"));
        for expected in
            ["7 runs, 3 of them from before, 1 of them void; ", "delay   w         void: plug-in x: ended"]
        {
            assert!(text.contains(expected), "{expected}\n{text}");
        }
        assert!(!text.contains("survives +"), "{text}");
        let survived = Margins { findings: vec![finding("down", None, Some("R2"), None)], ..margins };
        assert!(describe(&survived, Path::new("here")).contains("survives any single one down"));
    }
}
