//! Output of a run at its end: its summary, formatted for people.

use std::cmp::Reverse;

use console::style;
use cotorra_graph::{Natural, NodeId};
use cotorra_measurements::Location;
use cotorra_numbers::median;
use cotorra_recording::RecordingSummary;
use cotorra_testbed::{
    EnergySummary, FEW_ROBOTS, Finished, GatewaySummary, LocalizationSummary, Quantiles, RobotSummary,
    StalenessRegret, Summary, WORST_ROBOTS, robots_by_name,
};

use crate::{
    regret_table,
    service_table::service_table,
    table::{Table, columns, wrap},
    verdict::{by_name, verdicts},
    words::{clock, count, in_ms},
};

/// Fewest samples of a region in the table. Two decisions at the same moment have a region with fewer between them.
const FEWEST_SAMPLES: usize = 2;

/// Number of starved VNFs that are listed.
const WORST_VNFS: usize = 5;
/// Most migrations with a row of their own.
const MOST_MIGRATIONS: usize = 10;

/// Describes the results of a run, and lists its files.
pub fn describe(finished: &Finished, elsewhere: Option<&Location>) -> String {
    let Finished { summary, folder, .. } = finished;
    let unanswered = match summary.unanswered {
        0 => String::new(),
        n => format!(" ({n} without an answer)"),
    };
    let mut text = format!(
        "{}: {}{unanswered} in {}; {}\n",
        style(&summary.name).bold(),
        count(summary.samples, "sample"),
        clock(summary.duration_ms / 1e3),
        summary.ended,
    );
    for reason in summary.void.reasons() {
        text += &wrap(&format!("{}: {reason}", style("NOT VALID").red().bold()), "  ", columns());
    }
    if let Some(stand) = &summary.no_progress {
        text += &wrap(&format!("{}: {stand}", style("NO PROGRESS").red().bold()), "  ", columns());
    }
    let verdicts = verdicts(&summary.services, &summary.time_parts);
    if !verdicts.is_empty() {
        text += "\n";
        verdicts.iter().for_each(|verdict| text += &wrap(verdict, "  ", columns()));
    }
    if !summary.regions.is_empty() {
        text += "\n";
        text += &regions(summary);
    }
    let several = summary.services.iter().filter(|its| its.samples > 0).nth(1).is_some();
    if several {
        text += "\n";
        let shown = by_name(&summary.services);
        let is_shown = |service: &str| shown.iter().any(|its| its.service == *service);
        text += &service_table(&summary.by_service(), is_shown);
    }
    text += "\n";
    text += &figures(summary, several).render("  ");
    text += &old_context(summary);
    for notice in &summary.notices {
        text += &format!("  {} {notice}\n", style("!").yellow());
    }
    for forged in &summary.forged_sources {
        text += &format!("  {} {}\n", style("!").yellow(), forged.sentence());
    }
    for empty in summary.energy.iter().flat_map(EnergySummary::empty_batteries) {
        text += &format!("  {} {empty}\n", style("!").yellow());
    }
    for fault in &summary.plugin_faults {
        text += &format!("  {} plug-in cut off: {fault}\n", style("!").red());
    }
    if summary.history_dropped > 0 {
        text += &format!("  {} the history lacks {} events\n", style("!").red(), summary.history_dropped);
    }
    for what in &finished.unrecorded {
        text += &format!("  {} not recorded: {what}\n", style("!").red());
    }
    if let Some(recording) = &finished.recording {
        text += &gaps(recording);
    }
    let own = if elsewhere.is_some() { "history.json" } else { "history.sqlite" };
    let tables = ["summary.json", "services.csv", "services.tex", "service_time.csv"];
    let figures = ["service_time.svg", "service_time.pdf", "service_time.png"];
    let files = tables.into_iter().chain(figures).chain([own, "testbed.yaml"]);
    let there = files.filter(|file| folder.join(file).exists());
    let there: Vec<_> = there.chain(["logs/"]).collect();
    text += &format!("\n{}/\n{}", folder.display(), wrap(&there.join(" "), "  ", columns()));
    if let Some(RecordingSummary { file: Some(file), messages, .. }) = &finished.recording {
        text += &format!("{}: {}\n", file.display(), count(*messages as usize, "message"));
    }
    if let Some(history) = elsewhere {
        text += &format!("Its history is run {} in {history}\n", finished.run);
    }
    text
}

/// Describes what old context cost. Without twins, says that only the ages of contexts are known.
fn old_context(summary: &Summary) -> String {
    let regrets = &summary.staleness_regret;
    if regrets.is_empty() && summary.plugins.iter().any(|plugin| !plugin.staleness.is_empty()) {
        return "  ages of contexts are above; what they cost needs the twin: `cotorra run --simulate --twin`\n"
            .to_owned();
    }
    let of = |its: &StalenessRegret| {
        format!("\n{}", regret_table::describe(&format!("{}: {}", its.plugin, its.distance), &its.services))
    };
    let text = regrets.iter().map(of).collect::<String>();
    if text.is_empty() { text } else { text + &regret_table::explain() + "\n" }
}

/// Describes the gaps of a recording.
fn gaps(recording: &RecordingSummary) -> String {
    let mark = style("!").red();
    let mut text = String::new();
    if recording.dropped > 0 {
        text += &format!("  {mark} the recording lacks {} events and scans\n", recording.dropped);
    }
    if let Some(reason) = &recording.failed {
        text += &format!("  {mark} the recording is not complete: {reason}\n");
    }
    text
}

fn regions(summary: &Summary) -> String {
    let robots = summary.regions.iter().any(|region| region.robot != summary.regions[0].robot);
    let services = summary.regions.iter().any(|region| region.service != summary.regions[0].service);
    let aligned = ["<"].repeat(usize::from(robots) + usize::from(services)).concat() + "<<>>>>";
    let mut table = Table::new(&aligned);
    let robot = |name: &str| robots.then(|| name.to_owned());
    let service = |name: &str| services.then(|| name.to_owned());
    let server = if services { "server" } else { "navigation on" };
    let heads = ["attached to", server, "from", "to", "samples", "median"].map(str::to_owned);
    table.row(robot("robot").into_iter().chain(service("service")).chain(heads));
    let named = robots_by_name(&summary.robots);
    // Robots that are in no testbed file have regions, too.
    let is_shown =
        |robot: &NodeId| summary.robots.len() <= FEW_ROBOTS || named.iter().any(|its| its.robot == *robot);
    let shown = summary.regions.iter().filter(|region| is_shown(&region.robot));
    for region in shown.filter(|region| region.samples >= FEWEST_SAMPLES) {
        let cells = [
            region.attachment.as_ref().map_or("none".to_owned(), |id| id.to_string()),
            region.server.to_string(),
            clock(region.from.as_secs_f64()),
            clock(region.until.as_secs_f64()),
            region.samples.to_string(),
            region.service_time_p50_ms.map_or("no answer".to_owned(), |ms| format!("{ms:.2} ms")),
        ];
        let (robot, service) = (robot(region.robot.as_str()), service(region.service.as_str()));
        table.row(robot.into_iter().chain(service).chain(cells));
    }
    let of = match summary.robots.len() {
        ..=FEW_ROBOTS => String::new(),
        all => format!("  Regions of the worst {} of {all} robots; summary.json has all:\n", named.len()),
    };
    of + &table.render("  ")
}

/// Returns the figures of the whole run. Service times of several services have a table of their own.
fn figures(summary: &Summary, several: bool) -> Table {
    let mut table = Table::new("<<");
    if let (false, Some(Quantiles { p50, p95, p99, max })) = (several, summary.service_time_ms) {
        let text = format!("median {p50:.2} ms, p95 {p95:.2} ms, p99 {p99:.2} ms, max {max:.2} ms");
        table.row(["service time".to_owned(), text]);
    }
    localization(&summary.localization).into_iter().for_each(|row| table.row(row));
    for gateway in &summary.gateways {
        let GatewaySummary { received_frames, sent_frames, rejected_frames, .. } = gateway;
        let (received, sent) = (gateway.received_lateness_us, gateway.sent_lateness_us);
        let text = format!(
            "{} in, p50 {:.0} µs, p99 {:.0} µs; {} out, p50 {:.0} µs, p99 {:.0} µs; {rejected_frames} rejected",
            count(*received_frames as usize, "frame"),
            received.p50,
            received.p99,
            count(*sent_frames as usize, "frame"),
            sent.p50,
            sent.p99,
        );
        table.row([format!("gateway {}", gateway.gateway), text]);
    }
    let by_robot = handovers_by_robot(&summary.robots);
    let gaps = Quantiles::of(summary.handovers.iter().map(|handover| handover.gap_ms).collect());
    let gaps = gaps.map(|gaps| format!(", gap median {}, max {}", in_ms(gaps.p50), in_ms(gaps.max)));
    let handovers = format!("{}{by_robot}{}", summary.handovers.len(), gaps.unwrap_or_default());
    table.row(["handovers".to_owned(), handovers]);
    let mut detached: Vec<_> = summary.robots.iter().filter(|robot| robot.detached_ms > 0.0).collect();
    detached.sort_by(|a, b| b.detached_ms.total_cmp(&a.detached_ms));
    for robot in detached.iter().take(WORST_ROBOTS) {
        let text = format!("without a radio unit for {:.1} s, in no gap", robot.detached_ms / 1e3);
        table.row([robot.robot.to_string(), text]);
    }
    for traffic in &summary.traffic {
        table.row([format!("traffic {}", traffic.source), traffic.sentence()]);
    }
    if let Some(bill) = &summary.bill {
        table.row(["bill".to_owned(), bill.sentence()]);
    }
    if let Some(energy) = &summary.energy {
        table.row(["energy".to_owned(), energy.sentence()]);
    }
    let vnfs = || summary.computing.iter().flat_map(|computing| &computing.vnfs);
    let mut busiest: Vec<_> = vnfs().filter(|vnf| vnf.requests > 0).collect();
    busiest.sort_by(|a, b| b.busy.total_cmp(&a.busy));
    for vnf in busiest.iter().take(WORST_VNFS) {
        table.row([format!("VNF {}", vnf.vnf), vnf.sentence()]);
    }
    if let Some(more @ 1..) = busiest.len().checked_sub(WORST_VNFS) {
        table.row([format!("{} more", count(more, "VNF")), "less busy".to_owned()]);
    }
    let nodes = summary.computing.iter().flat_map(|computing| &computing.nodes);
    for node in nodes.filter(|node| node.cpu_time_ms > 0.0) {
        table.row([format!("node {}", node.node), node.sentence()]);
    }
    if let Some(inference) = &summary.inference {
        for model in &inference.models {
            table.row([format!("model {}", model.vnf), model.sentence()]);
        }
        for policy in &inference.policies {
            table.row([format!("robot {}", policy.robot), policy.sentence()]);
        }
        for node in inference.nodes.iter().filter(|node| node.busy > 0.0) {
            table.row([format!("node {}", node.node), node.sentence()]);
        }
    }
    for migration in summary.migrations.iter().take(MOST_MIGRATIONS) {
        table.row([format!("VNF {}", migration.vnf), migration.sentence()]);
    }
    if let Some(more @ 1..) = summary.migrations.len().checked_sub(MOST_MIGRATIONS) {
        table.row([format!("{} more", count(more, "migration")), "in summary.json".to_owned()]);
    }
    for plugin in &summary.plugins {
        table.row([format!("plug-in {}", plugin.plugin), plugin.sentence()]);
    }
    let mut starved: Vec<_> = summary.fidelity.vnf_waits.iter().filter(|vnf| vnf.is_starved).collect();
    starved.sort_by(|a, b| b.wait_ms.unwrap_or_default().total_cmp(&a.wait_ms.unwrap_or_default()));
    for vnf in starved.iter().take(WORST_VNFS) {
        table.row([format!("VNF {}", vnf.vnf), vnf.sentence()]);
    }
    if let Some(more @ 1..) = starved.len().checked_sub(WORST_VNFS) {
        table.row([format!("{} more", count(more, "VNF")), "waited for a processor, too".to_owned()]);
    }
    let word = style(summary.fidelity.word());
    let verdict = if summary.fidelity.valid { word.green() } else { word.red().bold() };
    table.row([
        "fidelity".to_owned(),
        format!("{verdict}: {} (docs/reference/trust.md)", summary.fidelity.reason),
    ]);
    table.row(["seed".to_owned(), summary.seed.to_string()]);
    table
}

/// Describes the localization errors of each robot. Of many robots, it describes the range of their medians, and the worst.
fn localization(all: &[LocalizationSummary]) -> Vec<[String; 2]> {
    let mut rows = Vec::new();
    let mut shown: Vec<_> = all.iter().collect();
    if shown.len() > FEW_ROBOTS {
        let medians = || all.iter().map(|its| its.error_m.p50);
        let (least, most) = (medians().fold(f64::INFINITY, f64::min), medians().fold(0.0, f64::max));
        let text = format!("off by a median of {least:.2} to {most:.2} m, {} robots", all.len());
        rows.push(["localization".to_owned(), text]);
        shown.sort_by_cached_key(|its| Natural::of(its.robot.as_str()));
        shown.sort_by(|a, b| b.error_m.p95.total_cmp(&a.error_m.p95));
        shown.truncate(WORST_ROBOTS);
    }
    rows.extend(shown.into_iter().map(|its| {
        let Quantiles { p50, p95, max, .. } = its.error_m;
        let robot = if all.len() > 1 { format!(" of {}", its.robot) } else { String::new() };
        let text = format!("off by a median of {p50:.2} m, p95 {p95:.2} m, max {max:.2} m");
        [format!("localization{robot}"), text]
    }));
    rows
}

/// Returns the handovers of each of several robots, in brackets. Of many robots, it returns the range and the median, and
/// those with the most.
fn handovers_by_robot(robots: &[RobotSummary]) -> String {
    let list = |robots: &[&RobotSummary]| {
        let of_robot = |its: &&RobotSummary| format!("{} {}", its.robot, its.handovers);
        robots.iter().map(of_robot).collect::<Vec<_>>().join(", ")
    };
    let mut shown: Vec<_> = robots.iter().collect();
    if shown.len() <= FEW_ROBOTS {
        return if shown.len() > 1 { format!(" ({})", list(&shown)) } else { String::new() };
    }
    shown.sort_by_cached_key(|its| (Reverse(its.handovers), Natural::of(its.robot.as_str())));
    let (most, least) = (shown[0].handovers, shown[shown.len() - 1].handovers);
    let median = median(shown.iter().map(|its| its.handovers as f64).collect()).unwrap_or_default();
    shown.truncate(WORST_ROBOTS);
    let of = robots.len();
    format!(" ({least} to {most} of each of {of} robots, median {median}; most: {})", list(&shown))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn localization_of_many_robots_is_a_range_and_the_worst_by_name() {
        let of = |count: u32| -> Vec<[String; 2]> {
            let robot = |i: u32| LocalizationSummary {
                robot: format!("R{i}").parse().unwrap(),
                samples: 9,
                error_m: Quantiles {
                    p50: f64::from(i) / 10.0,
                    p95: if i == 7 { 5.0 } else { 2.0 },
                    p99: 5.0,
                    max: 6.0,
                },
                nees: 3.0,
            };
            localization(&(1..=count).map(robot).collect::<Vec<_>>())
        };
        let names = |rows: &[[String; 2]]| rows.iter().map(|[name, _]| name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&of(1)), ["localization"]);
        assert_eq!(names(&of(2)), ["localization of R1", "localization of R2"]);
        let many = of(12);
        assert_eq!(many[0][1], "off by a median of 0.10 to 1.20 m, 12 robots");
        assert_eq!(
            names(&many[1..]),
            ["R7", "R1", "R2", "R3", "R4"].map(|robot| format!("localization of {robot}"))
        );
    }

    #[test]
    fn handovers_of_many_robots_are_a_distribution_and_the_most_by_name() {
        let robots = |handovers: &[usize]| -> Vec<RobotSummary> {
            let robot = |(i, handovers): (usize, &usize)| RobotSummary {
                robot: format!("R{}", i + 1).parse().unwrap(),
                samples: 0,
                unanswered: 0,
                above_target: None,
                verdict: None,
                handovers: *handovers,
                handover_gap_ms: None,
                detached_ms: 0.0,
            };
            handovers.iter().enumerate().map(robot).collect()
        };
        assert_eq!(handovers_by_robot(&robots(&[3])), "");
        assert_eq!(handovers_by_robot(&robots(&[3, 0])), " (R1 3, R2 0)");
        assert_eq!(
            handovers_by_robot(&robots(&[4, 4, 4, 4, 4, 4, 4, 2, 4, 4, 4, 9])),
            " (2 to 9 of each of 12 robots, median 4; most: R12 9, R1 4, R2 4, R3 4, R4 4)"
        );
    }
}
