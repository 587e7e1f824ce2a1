//! `cotorra history state`: shows the state of the whole graph at a time.

use cotorra_graph::{
    LargeData, LinkContext, MachineContext, Probed, RobotContext, Timestamp, VirtualLinkMapping,
};
use cotorra_measurements::{GraphState, Retained, Sample};

use super::{
    answer::{first_of, seconds},
    args::StateArgs,
    source::{Error, Source},
};
use crate::{output, table::Table, words::over};

/// Maximum number of rows of each table.
const ROWS: usize = 40;

/// Shows the state.
pub fn state(args: &StateArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let at = args.at.map_or(Timestamp::MAX, |at| Timestamp::ZERO + at);
    let state = source.history.state_at(source.run.id, at).map_err(Error::from)?;
    if args.json {
        let json = serde_json::to_string_pretty(&state).expect("a state holds only what JSON can");
        return output::print_exact(&(json + "\n"));
    }
    let retained = source.history.retained(source.run.id).map_err(Error::from)?;
    output::print(&(describe(&state) + &rolled_up(&retained, at)))
}

/// Lists the kinds whose samples were rolled up at that time, so that their state is the last sample of a step.
fn rolled_up(retained: &[Retained], at: Timestamp) -> String {
    let lines = retained.iter().filter(|its| at < its.rolled_up_to).map(|its| {
        let step = its.step;
        let (kind, to) = (its.kind.as_str(), seconds(its.rolled_up_to));
        format!("samples of {kind} before {to} s were rolled up: there is one each {step:?}\n")
    });
    lines.collect()
}

fn describe(state: &GraphState) -> String {
    let mut text = String::new();
    let mut section = |title: &str, table: Table, rows: usize| {
        if rows > 0 {
            text += &format!("{}{title}\n{}", if text.is_empty() { "" } else { "\n" }, table.render("  "));
            first_of(&mut text, ROWS, rows, "--json shows all");
        }
    };
    let mut robots = Table::new("<>>>>><>");
    robots.row(["robot", "at, s", "x, m", "y, m", "heading, rad", "m/s", "attached to", "signal"]);
    state.robots.iter().take(ROWS).for_each(|sample| robots.row(robot(sample)));
    section("Robots", robots, state.robots.len());

    let mut units = Table::new("<>>>>");
    units.row(["radio unit", "at, s", "channel", "load", "stations"]);
    for Sample { at, value } in state.radio_units.iter().take(ROWS) {
        let stations = value.stations.len().to_string();
        let load = value.load.map_or("-".to_owned(), |load| format!("{:.1} %", load * 100.0));
        units.row([value.radio_unit.to_string(), seconds(*at), value.channel.to_string(), load, stations]);
    }
    section("Radio units", units, state.radio_units.len());

    let mut links = Table::new("<<>>>><>>><");
    links.row([
        "link",
        "direction",
        "at, s",
        "d, ms",
        "Mbit/s",
        "queued",
        "probes",
        "ψ",
        "δ",
        "lost",
        "does",
    ]);
    state.links.iter().take(ROWS).for_each(|sample| links.row(link(sample)));
    section("Links", links, state.links.len());

    let mut placements = Table::new("<<>");
    placements.row(["VNF", "on", "since, s"]);
    for Sample { at, value } in state.placements.iter().take(ROWS) {
        placements.row([value.vnf.to_string(), value.node.to_string(), seconds(*at)]);
    }
    section("Placements", placements, state.placements.len());

    let mut virtual_links = Table::new("<<<<>");
    virtual_links.row(["from", "to", "over", "path", "since, s"]);
    for Sample { at, value: VirtualLinkMapping { from, to, links, path, .. } } in
        state.virtual_links.iter().take(ROWS)
    {
        let path = path.as_str().to_owned();
        virtual_links.row([from.to_string(), to.to_string(), over(links), path, seconds(*at)]);
    }
    section("Virtual links", virtual_links, state.virtual_links.len());

    let mut sensors = Table::new("<<><");
    sensors.row(["robot", "sensor", "at, s", "values"]);
    for Sample { at, value } in state.sensors.iter().take(ROWS) {
        let values = value.values.iter().map(|(name, value)| format!("{name} {value:.4}"));
        let values: Vec<_> = values.chain(value.data.as_ref().map(LargeData::text)).collect();
        sensors.row([value.robot.to_string(), value.sensor.to_string(), seconds(*at), values.join(", ")]);
    }
    section("Sensors", sensors, state.sensors.len());
    let mut machines = Table::new("<>>>>>>>>");
    let columns =
        ["machine", "at, s", "CPUs", "busy", "load", "memory, GB", "available", "interfaces", "stations"];
    machines.row(columns);
    state.machines.iter().take(ROWS).for_each(|sample| machines.row(machine(sample)));
    section("Machines", machines, state.machines.len());
    if text.is_empty() { "nothing was known yet\n".to_owned() } else { text }
}

fn robot(Sample { at, value }: &Sample<RobotContext>) -> [String; 8] {
    let sensors = &value.sensors;
    let attached = value.attachments.iter().find(|a| a.attached);
    [
        value.robot.to_string(),
        seconds(*at),
        format!("{:.2}", sensors.pose.x),
        format!("{:.2}", sensors.pose.y),
        format!("{:.2}", sensors.pose.heading),
        format!("{:.2}", sensors.velocity.linear),
        attached.map_or("none".to_owned(), |a| a.radio_unit.to_string()),
        attached.and_then(|a| a.signal).map_or(String::new(), |signal| format!("{:.1} dBm", signal.0)),
    ]
}

fn machine(Sample { at, value }: &Sample<MachineContext>) -> [String; 9] {
    let unknown = || "-".to_owned();
    let gigabytes = |bytes: u64| format!("{:.2}", bytes as f64 / 1e9);
    let stations: usize = value.wifi.iter().map(|wifi| wifi.stations.len()).sum();
    [
        value.node.to_string(),
        seconds(*at),
        value.cpu.map_or_else(unknown, |cpu| cpu.cpus.to_string()),
        value
            .cpu
            .and_then(|cpu| cpu.busy)
            .map_or_else(unknown, |busy| format!("{:.1} %", busy.get() * 100.0)),
        value.load_average.map_or_else(unknown, |load| format!("{:.2}", load.one_minute)),
        value.memory.map_or_else(unknown, |memory| gigabytes(memory.memory_bytes)),
        value.memory.map_or_else(unknown, |memory| gigabytes(memory.available_bytes)),
        value.interfaces.len().to_string(),
        stations.to_string(),
    ]
}

fn link(Sample { at, value }: &Sample<LinkContext>) -> [String; 11] {
    let direction = format!("{:?}", value.direction).to_lowercase();
    [
        value.link.to_string(),
        direction,
        seconds(*at),
        value.delay.map_or("-".to_owned(), |delay| format!("{:.3}", delay.as_secs_f64() * 1e3)),
        format!("{:.3}", value.throughput_bps / 1e6),
        value.queued_packets.map_or("-".to_owned(), |packets| packets.to_string()),
        value.probed.as_ref().map(Probed::text).unwrap_or_default(),
        value.scale.delay_scale.to_string(),
        value.scale.drop_scale.to_string(),
        (value.counters.lost + value.counters.overflowed).to_string(),
        value.effective.text(),
    ]
}
