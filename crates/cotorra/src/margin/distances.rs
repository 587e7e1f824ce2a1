//! What the distances of plug-ins cost, and what their twins beside the core decided, for people.

use cotorra_experiments::regret::{DistanceCost, Examined, FILES, ServiceCost, TwinDecision, TwinGave};
use cotorra_numbers::Mean;

use super::cells::{LISTED, heads, paired, shown_p};
use crate::{
    regret_table::{HEADS, OfService},
    table::{Table, wrap},
    words::{count, signed},
};

/// Columns of the sentences.
const WIDTH: usize = 100;

/// Describes what distances cost; empty without any.
pub fn describe(distances: &[DistanceCost], examined: &[Examined], seeds: u32) -> String {
    let mut text: String = distances.iter().map(cost).collect();
    if !text.is_empty() {
        text += &twins(examined, seeds);
    }
    text
}

/// Describes what one distance cost.
fn cost(DistanceCost { plugin, distance, pairs, void, services }: &DistanceCost) -> String {
    let mut table = Table::new("<<>>>>");
    table.row(HEADS.into_iter().chain(["regret", "p"]));
    for ServiceCost { service, robot, service_time_target_ms, with, without, regret } in services {
        let of = OfService { service, robot, target_ms: *service_time_target_ms, with, without };
        let regrets = [
            (regret.above_target, 100.0),
            (regret.service_time_p99_ms, 1.0),
            (regret.service_time_p50_ms, 1.0),
        ];
        for (row, (regret, factor)) in of.rows().into_iter().zip(regrets) {
            let p = regret.and_then(|regret| regret.p).map_or_else(|| "-".to_owned(), shown_p);
            table.row(row.into_iter().chain([paired(regret, factor), p]));
        }
    }
    let void =
        void.as_ref().map(|void| format!("A pair does not count: the twin is {void}.\n")).unwrap_or_default();
    let pairs = count(*pairs, "seed");
    format!(
        "\nWhat the distance of {plugin} cost ({distance}), over {pairs}:\n\n{}{void}",
        table.render("  ")
    )
}

/// Lists what plug-ins decided beside the core.
fn twins(examined: &[Examined], seeds: u32) -> String {
    let mut decisions: Vec<Vec<(&Examined, &TwinDecision)>> = Vec::new();
    for its in examined {
        let Some(twin) = &its.twin else { continue };
        match decisions.iter_mut().find(|others| others[0].0.decided.is_like(&its.decided)) {
            Some(others) => others.push((its, twin)),
            None => decisions.push(vec![(its, twin)]),
        }
    }
    let mut table = Table::new(">><<<<>");
    table.row(["decision", "at", "by", "of", "to", "beside the core", "earlier, ms"]);
    for its in decisions.iter().take(LISTED) {
        let earlier: Vec<_> = its.iter().filter_map(|(_, twin)| twin.earlier_ms).collect();
        let earlier = Mean::of(&earlier).map_or("-".to_owned(), |its| signed(its.mean));
        table.row(heads(&its[0].0.decided).into_iter().chain([gave(its, seeds), earlier]));
    }
    let more = decisions.len().saturating_sub(LISTED);
    let more = if more > 0 { format!("  and {more} more in {}\n", FILES[1]) } else { String::new() };
    let means = if seeds > 1 { " Earlier is the mean over the seeds in which it gave one." } else { "" };
    let sentence = format!(
        "Beside the core, the plug-in gave the same decision, another one about the same robot or VNF, or none that is nearer \
         to this decision than to others.{means}"
    );
    format!("\n{}{more}\n{}", table.render("  "), wrap(&sentence, "", WIDTH))
}

/// `same`, `other: R5`, `none`; over several seeds, how often.
fn gave(its: &[(&Examined, &TwinDecision)], seeds: u32) -> String {
    let of = |wanted: TwinGave| its.iter().filter(|(_, twin)| twin.gave == wanted).count();
    let all = [(TwinGave::Same, "same"), (TwinGave::Other, "other"), (TwinGave::None, "none")];
    if seeds > 1 {
        let counts = all.iter().filter(|(wanted, _)| of(*wanted) > 0);
        return counts.map(|(wanted, word)| format!("{word} {}", of(*wanted))).collect::<Vec<_>>().join(", ");
    }
    let twin = its[0].1;
    match (twin.gave, twin.chosen()) {
        (TwinGave::Other, Some(chosen)) => format!("other: {chosen}"),
        (wanted, _) => all.iter().find(|(of, _)| *of == wanted).map_or("", |(_, word)| *word).to_owned(),
    }
}
