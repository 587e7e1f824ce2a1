//! `cotorra history events`: lists events, one on each line.

use std::fmt::Write as _;

use cotorra_graph::{
    CpuContext, Event, GoalEvent, Instruction, LargeData, MachineContext, Stamped, VirtualLinkMapping,
};
use cotorra_measurements::{Kind, PageRequest};

use super::{
    answer::{more, seconds},
    args::EventsArgs,
    source::{Error, Source},
};
use crate::{
    output,
    words::{self, over},
};

/// Lists events.
pub fn events(args: &EventsArgs) -> miette::Result<()> {
    let source = Source::find(&args.run, &args.place)?;
    let request = PageRequest { limit: args.page.limit.get(), after: args.page.after };
    let page =
        source.history.events(source.run.id, &args.kinds, args.span.range(), request).map_err(Error::from)?;
    let mut text = String::new();
    for event in &page.items {
        let line = if args.json {
            serde_json::to_string(event).expect("an event holds only what JSON can")
        } else {
            let at = seconds(event.at);
            format!("{at:>10} s  {:<14} {}", Kind::of(&event.event).as_str(), describe(event))
        };
        writeln!(text, "{line}").expect("writing into a string cannot fail");
    }
    output::print_either(args.json, &text)?;
    // On standard error, so that a program that reads standard output reads only events.
    if page.items.is_empty() {
        note!("no events in that time");
    }
    output::write_note(format_args!("{}", more(&page)));
    Ok(())
}

/// Describes a large reading without its bytes.
pub fn large_data(data: &LargeData) -> String {
    let LargeData { sequence, format, width, height, bytes } = data;
    format!("{} {sequence} of {width} x {height}, {bytes} bytes", format.as_str())
}

fn describe(Stamped { event, .. }: &Stamped) -> String {
    let or_none = |node: &Option<cotorra_graph::NodeId>| {
        node.as_ref().map_or("none".to_owned(), |node| node.to_string())
    };
    match event {
        Event::Robot(context) => {
            let pose = &context.sensors.pose;
            let attached = or_none(&context.attached_to().cloned());
            let height = if pose.z == 0.0 { String::new() } else { format!(", {:.2}", pose.z) };
            format!("{} at ({:.2}, {:.2}{height}), attached to {attached}", context.robot, pose.x, pose.y)
        }
        Event::Radio(context) => {
            let load = context.load.map(|load| format!(": {:.1} % busy", load * 100.0)).unwrap_or_default();
            format!("{} on channel {}{load}", context.radio_unit, context.channel)
        }
        Event::Link(context) => {
            let delay =
                context.delay.map_or("no packet".to_owned(), |d| format!("{:.3} ms", d.as_secs_f64() * 1e3));
            let direction = format!("{:?}", context.direction).to_lowercase();
            let probed = context
                .probed
                .as_ref()
                .map(|p| format!("; probes: {}", words::probed(p)))
                .unwrap_or_default();
            let does = words::conditions(&context.effective);
            format!(
                "{} {direction}: {delay}, {:.3} Mbit/s{probed}; does {does}",
                context.link,
                context.throughput_bps / 1e6
            )
        }
        Event::Placement(placement) => format!("{} on {}", placement.vnf, placement.node),
        Event::VirtualLink(mapping) => {
            let VirtualLinkMapping { from, to, links, path, others } = mapping;
            let mut text = format!("{from} to {to} over {}, {}", over(links), path.as_str());
            for other in others {
                let _ = write!(
                    text,
                    "; {} to {} over {}, {}",
                    other.from,
                    other.to,
                    over(&other.links),
                    other.path.as_str()
                );
            }
            text
        }
        Event::ServiceTime(sample) => {
            let took =
                sample.took.map_or("no answer".to_owned(), |t| format!("{:.3} ms", t.as_secs_f64() * 1e3));
            let attached = or_none(&sample.attachment);
            format!(
                "{} of {} #{}: {took} by {attached}, {}",
                sample.service, sample.robot, sample.sequence, sample.server
            )
        }
        Event::Handover(handover) => format!(
            "{} from {} to {}: {:.1} ms{}",
            handover.robot,
            or_none(&handover.from),
            handover.to,
            handover.gap.as_secs_f64() * 1e3,
            if handover.fast { ", fast" } else { "" }
        ),
        Event::AnswersRejected(counts) => format!(
            "{} rejected {} late, {} forged, {} repeated, {} redundant, {} unknown and {} invalid answers so far",
            counts.robot,
            counts.late,
            counts.forged,
            counts.repeated,
            counts.redundant,
            counts.unknown,
            counts.invalid
        ),
        Event::Detached { robot, from } => format!("{robot} lost {from}"),
        Event::Goal(GoalEvent { robot, goal, state, remaining_m, reason }) => {
            let mut text = format!("{robot} to {goal}: {}", state.as_str());
            if let Some(metres) = remaining_m {
                let _ = write!(text, ", {metres:.1} m left");
            }
            if let Some(reason) = reason {
                let _ = write!(text, ", {reason}");
            }
            text
        }
        Event::Sensor(reading) => {
            let values = reading.values.iter().map(|(name, value)| format!("{name} {value}"));
            let values: Vec<_> = values.chain(reading.data.as_ref().map(large_data)).collect();
            format!("{} {}: {}", reading.robot, reading.sensor, values.join(", "))
        }
        Event::Machine(context) => machine(context),
        Event::Scanned { robot } | Event::WalkFinished { robot } => robot.to_string(),
        Event::SuggestionAnswered { robot, radio_unit, status: 0 } => {
            format!("{robot} moves to {radio_unit}")
        }
        Event::SuggestionAnswered { robot, radio_unit, status } => {
            format!("{robot} does not move to {radio_unit}: status {status}")
        }
        Event::Vnf(event) => {
            let state = format!("{:?}", event.state).to_lowercase();
            let detail = event.detail.as_ref().map(|detail| format!(": {detail}")).unwrap_or_default();
            format!("{} on {} {state}{detail}", event.vnf, event.node)
        }
        Event::Decision(decision) => {
            let reason = decision.reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
            let refused =
                decision.refused.as_ref().map(|why| format!("; refused: {why}")).unwrap_or_default();
            format!("{}: {}{reason}{refused}", decision.plugin, instruction(&decision.instruction))
        }
        Event::PluginFault { plugin, reason } => format!("{plugin}: {reason}"),
        Event::Lateness(lateness) => format!(
            "median {:.1} µs, p99 {:.1} µs, max {:.1} µs of {} frames",
            lateness.p50_us, lateness.p99_us, lateness.max_us, lateness.frames
        ),
        Event::Notice { message } => message.clone(),
    }
}

fn machine(context: &MachineContext) -> String {
    let mut parts = Vec::new();
    if let Some(CpuContext { cpus, busy }) = context.cpu {
        let cpus = words::count(cpus as usize, "CPU");
        parts.push(busy.map_or(cpus.clone(), |busy| format!("{cpus} {:.1} % busy", busy.get() * 100.0)));
    }
    if let Some(load) = context.load_average {
        parts.push(format!("load {:.2}", load.one_minute));
    }
    if let Some(memory) = context.memory {
        let [available, all] = [memory.available_bytes, memory.memory_bytes].map(|bytes| bytes as f64 / 1e9);
        parts.push(format!("{available:.2} of {all:.2} GB available"));
    }
    let rate = |bps: Option<f64>| bps.map_or("-".to_owned(), |bps| format!("{:.3}", bps / 1e6));
    parts.extend(context.interfaces.iter().filter(|interface| interface.carrier).map(|interface| {
        let [received, sent] = [interface.received, interface.sent].map(|way| rate(way.throughput_bps));
        format!("{} {received} Mbit/s in, {sent} Mbit/s out", interface.name)
    }));
    parts.extend(
        context
            .wifi
            .iter()
            .map(|wifi| format!("{} with {}", wifi.interface, words::count(wifi.stations.len(), "station"))),
    );
    parts.extend(context.reading.map(|reading| {
        let error = reading.error.as_secs_f64() * 1e3;
        format!("read at {:.3} s ± {error:.3} ms", reading.measured.as_secs_f64())
    }));
    format!("{}: {}", context.node, parts.join(", "))
}

fn instruction(instruction: &Instruction) -> String {
    match instruction {
        Instruction::Move { robot, velocity, .. } => {
            format!("move {robot} at {:.2} m/s, {:.2} rad/s", velocity.linear, velocity.angular)
        }
        Instruction::LimitSpeed { robot, speed_limit_mps: Some(limit) } => {
            format!("limit {robot} to {limit:.2} m/s")
        }
        Instruction::NavigateTo { robot, goal: Some(goal) } => format!("send {robot} to {goal}"),
        Instruction::NavigateTo { robot, goal: None } => format!("send {robot} back to its walk"),
        Instruction::LimitSpeed { robot, speed_limit_mps: None } => format!("limit {robot} no more"),
        Instruction::Report { robot, sensor, values } => format!("report {values:?} as {sensor} of {robot}"),
        Instruction::Scan { robot } => format!("scan with {robot}"),
        Instruction::Attach { robot, radio_unit } => format!("attach {robot} to {radio_unit}"),
        Instruction::Suggest { robot, radio_unit } => format!("suggest {radio_unit} to {robot}"),
        Instruction::Place { vnf, node } => format!("place {vnf} on {node}"),
        Instruction::AddVnf { vnf } => format!("add {} on {}", vnf.id, vnf.node),
        Instruction::RemoveVnf { vnf } => format!("remove {vnf}"),
        Instruction::Map { from, to, links } if links.is_empty() => format!("unmap {from} to {to}"),
        Instruction::Map { from, to, links } => format!("map {from} to {to} over {}", over(links)),
        Instruction::Condition { link, direction, .. } => {
            let direction = direction.map(|d| format!(" {d:?}").to_lowercase()).unwrap_or_default();
            format!("change {link}{direction}")
        }
        Instruction::Deploy { radio_unit, access_point } => {
            format!("deploy a vAP on {radio_unit} for {}", access_point.ssid)
        }
        Instruction::Remove { radio_unit } => format!("remove the vAP of {radio_unit}"),
        Instruction::Provision { robot, radio_unit, .. } => {
            format!("provision {robot} for {radio_unit}")
        }
        Instruction::Halt { robot } => format!("halt {robot}"),
        Instruction::Go { robot } => format!("let {robot} go"),
        Instruction::Note { process, step, ago: None } => format!("note {step} of {process}"),
        Instruction::Note { process, step, ago: Some(ago) } => {
            format!("note {step} of {process}, {:.3} s before", ago.as_secs_f64())
        }
        Instruction::TestThroughput { link, direction, test } => {
            let direction = format!("{direction:?}").to_lowercase();
            format!("test the throughput of {link} {direction} for {:?}", test.duration)
        }
    }
}
