//! Output of a run at its end: its summary, formatted for people.

use console::style;
use cotorra_measurements::Location;
use cotorra_recording::RecordingSummary;
use cotorra_testbed::{Finished, GatewaySummary, Quantiles, RobotSummary, Summary};

use crate::{
    service_table::service_table,
    table::{Table, columns, wrap},
    verdict::verdicts,
    words::{clock, count, in_ms},
};

/// Fewest samples of a region in the table. Two decisions at the same moment have a region with fewer between them.
const FEWEST_SAMPLES: usize = 2;

/// Most robots or VNFs that are listed for one reason.
const MOST_LISTED: usize = 5;

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
    for reason in &summary.void {
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
        text += &service_table(&summary.by_service());
    }
    text += "\n";
    text += &figures(summary, several).render("  ");
    for notice in &summary.notices {
        text += &format!("  {} {notice}\n", style("!").yellow());
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
    for region in summary.regions.iter().filter(|region| region.samples >= FEWEST_SAMPLES) {
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
    table.render("  ")
}

/// Returns the figures of the whole run. Service times of several services have a table of their own.
fn figures(summary: &Summary, several: bool) -> Table {
    let mut table = Table::new("<<");
    if let (false, Some(Quantiles { p50, p95, p99, max })) = (several, summary.service_time_ms) {
        let text = format!("median {p50:.2} ms, p95 {p95:.2} ms, p99 {p99:.2} ms, max {max:.2} ms");
        table.row(["service time".to_owned(), text]);
    }
    for localization in &summary.localization {
        let Quantiles { p50, p95, max, .. } = localization.error_m;
        let robot = if summary.localization.len() > 1 {
            format!(" of {}", localization.robot)
        } else {
            String::new()
        };
        let text = format!("off by a median of {p50:.2} m, p95 {p95:.2} m, max {max:.2} m");
        table.row([format!("localization{robot}"), text]);
    }
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
    let of_robot = |robot: &RobotSummary| format!("{} {}", robot.robot, robot.handovers);
    let by_robot = match &summary.robots[..] {
        robots @ [_, _, ..] => format!(" ({})", robots.iter().map(of_robot).collect::<Vec<_>>().join(", ")),
        _ => String::new(),
    };
    let gaps = Quantiles::of(summary.handovers.iter().map(|handover| handover.gap_ms).collect());
    let gaps = gaps.map(|gaps| format!(", gap median {}, max {}", in_ms(gaps.p50), in_ms(gaps.max)));
    let handovers = format!("{}{by_robot}{}", summary.handovers.len(), gaps.unwrap_or_default());
    table.row(["handovers".to_owned(), handovers]);
    for robot in summary.robots.iter().filter(|robot| robot.detached_ms > 0.0).take(MOST_LISTED) {
        let text = format!("without a radio unit for {:.1} s, in no gap", robot.detached_ms / 1e3);
        table.row([robot.robot.to_string(), text]);
    }
    for plugin in &summary.plugins {
        table.row([format!("plug-in {}", plugin.plugin), plugin.sentence()]);
    }
    let mut starved: Vec<_> = summary.fidelity.vnf_waits.iter().filter(|vnf| vnf.is_starved).collect();
    starved.sort_by(|a, b| b.wait_ms.unwrap_or_default().total_cmp(&a.wait_ms.unwrap_or_default()));
    for vnf in starved.iter().take(MOST_LISTED) {
        table.row([format!("VNF {}", vnf.vnf), vnf.sentence()]);
    }
    if let Some(more @ 1..) = starved.len().checked_sub(MOST_LISTED) {
        table.row([format!("{} more", count(more, "VNF")), "waited for a processor, too".to_owned()]);
    }
    let word = style(summary.fidelity.word());
    let verdict = if summary.fidelity.valid { word.green() } else { word.red().bold() };
    table.row(["fidelity".to_owned(), format!("{verdict}: {} (docs/trust.md)", summary.fidelity.reason)]);
    table.row(["seed".to_owned(), summary.seed.to_string()]);
    table
}
