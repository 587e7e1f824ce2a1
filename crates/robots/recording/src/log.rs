//! Events for people in ROS's standard messages: the log, and diagnostics.

use cotorra_graph::{
    AnswersRejected, CpuContext, Event, GoalEvent, GoalState, Lateness, MachineContext, MemoryContext,
    Probability, RadioContext, Timestamp, VnfEvent, VnfState,
};
use cotorra_plugin::convert::{to_header, to_time};
use cotorra_ros_messages::{Byte, DiagnosticArray, DiagnosticStatus, KeyValue, Log};

/// `rcl_interfaces/Log`'s levels.
const INFO: u8 = 20;
const WARN: u8 = 30;
const ERROR: u8 = 40;

/// `diagnostic_msgs/DiagnosticStatus`'s levels.
const OK: Byte = Byte(0);
const BAD: Byte = Byte(2);

/// Returns the line of the log for an event. Most events have none.
pub(crate) fn line(at: Timestamp, event: &Event) -> Option<Log> {
    let (level, name, msg) = match event {
        Event::Notice { message } => (INFO, "cotorra", message.clone()),
        Event::Handover(handover) => {
            let from = handover.from.as_ref().map_or("none", |from| from.as_str());
            let gap_ms = handover.gap.as_secs_f64() * 1e3;
            (INFO, handover.robot.as_str(), format!("from {from} to {}, gap {gap_ms:.1} ms", handover.to))
        }
        Event::Detached { robot, from } => (WARN, robot.as_str(), format!("lost {from}")),
        Event::AnswersRejected(counts) => {
            let AnswersRejected { robot, late, forged, repeated, redundant, unknown, invalid } = counts;
            let level = if *forged > 0 { WARN } else { INFO };
            let counts = format!(
                "rejected {late} late, {forged} forged, {repeated} repeated, {redundant} redundant, {unknown} unknown and {invalid} \
                 invalid answers"
            );
            (level, robot.as_str(), counts)
        }
        Event::WalkFinished { robot } => (INFO, robot.as_str(), "is at the end of its walk".to_owned()),
        Event::FederationRequested { robot } => {
            (INFO, robot.as_str(), "needs a federation, says its brain".to_owned())
        }
        Event::Goal(GoalEvent { robot, goal, state, reason, .. }) => {
            let (level, said) = match state {
                GoalState::Progress => return None,
                GoalState::Set => (INFO, "leaves its walk for"),
                GoalState::Reached => (INFO, "is at its goal"),
                GoalState::Replaced => (INFO, "has another goal in place of"),
                GoalState::Canceled => (INFO, "goes no more to"),
                GoalState::Failed => (WARN, "finds no way to"),
            };
            let reason = reason.iter().map(|reason| format!(": {reason}")).collect::<String>();
            (level, robot.as_str(), format!("{said} {goal}{reason}"))
        }
        Event::Placement(placement) => (INFO, placement.vnf.as_str(), format!("runs on {}", placement.node)),
        Event::Vnf(event) => {
            let level = if is_well(event) { INFO } else { ERROR };
            (level, event.vnf.as_str(), format!("on {}: {}", event.node, state(event)))
        }
        Event::Decision(decision) => {
            let refused = decision.refused.as_ref()?;
            (WARN, decision.plugin.as_str(), format!("was refused: {refused}"))
        }
        Event::PluginFault { plugin, reason } => (ERROR, plugin.as_str(), format!("cut off: {reason}")),
        _ => return None,
    };
    Some(Log { stamp: to_time(at), level, name: name.to_owned(), msg, ..Log::default() })
}

/// Returns the diagnostics that an event changes.
pub(crate) fn diagnostics(at: Timestamp, event: &Event) -> Option<DiagnosticArray> {
    let status = match event {
        Event::Radio(context) => radio(context),
        Event::Machine(context) => machine(context),
        Event::Vnf(event) => vnf(event),
        Event::Lateness(lateness) => emulation(lateness),
        Event::PluginFault { plugin, reason } => DiagnosticStatus {
            level: BAD,
            name: format!("plug-in {plugin}"),
            message: format!("cut off: {reason}"),
            ..DiagnosticStatus::default()
        },
        _ => return None,
    };
    Some(DiagnosticArray { header: to_header(at, ""), status: vec![status] })
}

fn radio(context: &RadioContext) -> DiagnosticStatus {
    let mut values = vec![value("channel", context.channel.to_string())];
    values.extend(context.load.map(|load| value("load", format!("{load:.3}"))));
    values.extend(context.stations.iter().map(|station| {
        let rates = (station.downlink_bps / 1e6, station.uplink_bps / 1e6);
        let text = format!("{:.0} dBm, {} Mbit/s down, {} Mbit/s up", station.signal.0, rates.0, rates.1);
        value(station.robot.as_str(), text)
    }));
    DiagnosticStatus {
        level: OK,
        name: format!("radio unit {}", context.radio_unit),
        message: format!("{} stations", context.stations.len()),
        hardware_id: context.radio_unit.to_string(),
        values,
    }
}

fn machine(context: &MachineContext) -> DiagnosticStatus {
    let share = |busy: Option<Probability>| busy.map(|busy| format!("{:.3}", busy.get()));
    let mut values = Vec::new();
    if let Some(CpuContext { cpus, busy }) = context.cpu {
        values.push(value("cpus", cpus.to_string()));
        values.extend(share(busy).map(|busy| value("cpu_busy", busy)));
    }
    if let Some(load) = context.load_average {
        values.push(value("load_average", format!("{:.2}", load.one_minute)));
    }
    if let Some(MemoryContext { memory_bytes, available_bytes }) = context.memory {
        values.push(value("memory_bytes", memory_bytes.to_string()));
        values.push(value("available_bytes", available_bytes.to_string()));
    }
    values.extend(context.interfaces.iter().map(|interface| {
        let rate = |bps: Option<f64>| bps.map_or("-".to_owned(), |bps| format!("{:.3}", bps / 1e6));
        let state = if interface.carrier { "" } else { "no carrier, " };
        let [received, sent] =
            [interface.received, interface.sent].map(|traffic| rate(traffic.throughput_bps));
        value(&interface.name, format!("{state}{received} Mbit/s received, {sent} Mbit/s sent"))
    }));
    if let Some(reading) = context.reading {
        values.push(value("measured_ns", reading.measured.as_nanos().to_string()));
        values.push(value("time_error_ms", format!("{:.6}", reading.error.as_secs_f64() * 1e3)));
    }
    DiagnosticStatus {
        level: OK,
        name: format!("machine {}", context.node),
        message: share(context.cpu.and_then(|cpu| cpu.busy))
            .map_or(String::new(), |busy| format!("{busy} of CPU time busy")),
        hardware_id: context.node.to_string(),
        values,
    }
}

fn vnf(event: &VnfEvent) -> DiagnosticStatus {
    DiagnosticStatus {
        level: if is_well(event) { OK } else { BAD },
        name: format!("VNF {}", event.vnf),
        message: state(event),
        hardware_id: event.node.to_string(),
        values: Vec::new(),
    }
}

fn emulation(lateness: &Lateness) -> DiagnosticStatus {
    DiagnosticStatus {
        level: OK,
        name: "emulation".to_owned(),
        message: format!("frames are {:.0} µs late (p99)", lateness.p99_us),
        hardware_id: String::new(),
        values: vec![
            value("frames", lateness.frames.to_string()),
            value("p50_us", format!("{:.1}", lateness.p50_us)),
            value("p99_us", format!("{:.1}", lateness.p99_us)),
            value("max_us", format!("{:.1}", lateness.max_us)),
        ],
    }
}

fn is_well(event: &VnfEvent) -> bool {
    matches!(event.state, VnfState::Started | VnfState::Stopped)
}

fn state(event: &VnfEvent) -> String {
    let state = event.state.as_str();
    event.detail.as_ref().map_or(state.to_owned(), |detail| format!("{state}: {detail}"))
}

fn value(key: &str, value: String) -> KeyValue {
    KeyValue { key: key.to_owned(), value }
}
