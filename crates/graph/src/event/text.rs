//! Events with many details, in words.

use std::{fmt::Write as _, time::Duration};

use crate::{
    active::Probed,
    conditions::{Conditions, Loss, Rate, TraceName},
    context::{
        AnswersRejected, Handover, InstancePath, LinkContext, RadioContext, RobotContext, ServiceTime,
        VirtualLinkMapping,
    },
    decision::Decision,
    goal::GoalEvent,
    id::NodeId,
    instruction::over,
    machine_context::{CpuContext, MachineContext},
    queue::QueueLimit,
    sensor::{LargeData, SensorReading},
    staleness::Staleness,
    vnf_event::VnfEvent,
};

fn or_none(node: Option<&NodeId>) -> &str {
    node.map_or("none", NodeId::as_str)
}

fn count(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

pub(super) fn robot(context: &RobotContext) -> String {
    let pose = &context.sensors.pose;
    let attached = or_none(context.attached_to());
    let height = if pose.z == 0.0 { String::new() } else { format!(", {:.2}", pose.z) };
    format!("{} at ({:.2}, {:.2}{height}), attached to {attached}", context.robot, pose.x, pose.y)
}

pub(super) fn radio(context: &RadioContext) -> String {
    let load = context.load.map(|load| format!(": {:.1} % busy", load * 100.0)).unwrap_or_default();
    format!("{} on channel {}{load}", context.radio_unit, context.channel)
}

pub(super) fn link(context: &LinkContext) -> String {
    let delay = context.delay.map_or("no packet".to_owned(), |d| format!("{:.3} ms", d.as_secs_f64() * 1e3));
    let direction = context.direction.as_str();
    let probed = context.probed.as_ref().map(|p| format!("; probes: {}", p.text())).unwrap_or_default();
    let does = context.effective.text();
    format!(
        "{} {direction}: {delay}, {:.3} Mbit/s{probed}; does {does}",
        context.link,
        context.throughput_bps / 1e6
    )
}

pub(super) fn virtual_link(mapping: &VirtualLinkMapping) -> String {
    let VirtualLinkMapping { from, to, links, path, others } = mapping;
    let mut text = format!("{from} to {to} over {}, {}", over(links), path.as_str());
    for InstancePath { from, to, links, path } in others {
        let _ = write!(text, "; {from} to {to} over {}, {}", over(links), path.as_str());
    }
    text
}

pub(super) fn service_time(sample: &ServiceTime) -> String {
    let took = sample.took.map_or("no answer".to_owned(), |t| format!("{:.3} ms", t.as_secs_f64() * 1e3));
    let attached = or_none(sample.attachment.as_ref());
    format!(
        "{} of {} #{}: {took} by {attached}, {}",
        sample.service, sample.robot, sample.sequence, sample.server
    )
}

pub(super) fn handover(handover: &Handover) -> String {
    format!(
        "{} from {} to {}: {:.1} ms{}",
        handover.robot,
        or_none(handover.from.as_ref()),
        handover.to,
        handover.gap.as_secs_f64() * 1e3,
        if handover.fast { ", fast" } else { "" }
    )
}

pub(super) fn answers_rejected(counts: &AnswersRejected) -> String {
    let AnswersRejected { robot, late, forged, repeated, redundant, unknown, invalid } = counts;
    format!(
        "{robot} rejected {late} late, {forged} forged, {repeated} repeated, {redundant} redundant, {unknown} unknown and \
         {invalid} invalid answers so far"
    )
}

pub(super) fn goal(GoalEvent { robot, goal, state, remaining_m, reason }: &GoalEvent) -> String {
    let mut text = format!("{robot} to {goal}: {}", state.as_str());
    if let Some(metres) = remaining_m {
        let _ = write!(text, ", {metres:.1} m left");
    }
    if let Some(reason) = reason {
        let _ = write!(text, ", {reason}");
    }
    text
}

pub(super) fn sensor(reading: &SensorReading) -> String {
    let values = reading.values.iter().map(|(name, value)| format!("{name} {value}"));
    let values: Vec<_> = values.chain(reading.data.as_ref().map(LargeData::text)).collect();
    format!("{} {}: {}", reading.robot, reading.sensor, values.join(", "))
}

impl LargeData {
    /// Describes a large reading without its bytes.
    pub fn text(&self) -> String {
        let Self { sequence, format, width, height, bytes } = self;
        format!("{} {sequence} of {width} x {height}, {bytes} bytes", format.as_str())
    }
}

pub(super) fn vnf(VnfEvent { vnf, node, state, detail }: &VnfEvent) -> String {
    let detail = detail.as_ref().map(|detail| format!(": {detail}")).unwrap_or_default();
    format!("{vnf} on {node} {}{detail}", state.as_str())
}

pub(super) fn decision(Decision { plugin, instruction, reason, refused }: &Decision) -> String {
    let reason = reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
    let refused = refused.as_ref().map(|why| format!("; refused: {why}")).unwrap_or_default();
    format!("{plugin}: {}{reason}{refused}", instruction.text())
}

pub(super) fn machine(context: &MachineContext) -> String {
    let mut parts = Vec::new();
    if let Some(CpuContext { cpus, busy }) = context.cpu {
        let cpus = count(cpus as usize, "CPU");
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
            .map(|wifi| format!("{} with {}", wifi.interface, count(wifi.stations.len(), "station"))),
    );
    parts.extend(context.reading.map(|reading| {
        let error = reading.error.as_secs_f64() * 1e3;
        format!("read at {:.3} s ± {error:.3} ms", reading.measured.as_secs_f64())
    }));
    format!("{}: {}", context.node, parts.join(", "))
}

pub(super) fn staleness(staleness: &Staleness) -> String {
    let Staleness { plugin, kind, contexts, youngest, oldest } = staleness;
    let contexts = count(*contexts as usize, &format!("{kind} context"));
    format!("{plugin} decided on {contexts}, {} to {} ms old", millis(*youngest), millis(*oldest))
}

/// Formats a duration in milliseconds, without the unit.
fn millis(duration: Duration) -> String {
    format!("{:.3}", duration.as_secs_f64() * 1e3)
}

/// `1.5 s ago`.
fn ago(age: Duration) -> String {
    format!("{:.1} s ago", age.as_secs_f64())
}

impl Probed {
    /// Describes the delay, jitter and loss that probes measured.
    pub fn text(&self) -> String {
        let delay = self.delay.map(|delay| {
            let jitter = self.jitter.map(|jitter| format!(" ± {}", millis(jitter))).unwrap_or_default();
            let age = self.delay_age.map(|age| format!(" ({})", ago(age))).unwrap_or_default();
            format!("{}{jitter} ms{age}", millis(delay))
        });
        let loss = self.loss.map(|loss| format!("{:.1} % lost ({})", loss * 100.0, ago(self.loss_age)));
        [delay, loss].into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

/// Describes a trace by its mean rate.
fn traced(trace: &TraceName) -> String {
    format!("a trace of {:.3} Mbit/s", trace.mean_bits_per_second() / 1e6)
}

impl Conditions {
    /// Describes what a link does to packets.
    pub fn text(&self) -> String {
        let percent = |share: f64| format!("{:.3} %", share * 100.0);
        let mut parts = vec![format!("{} ms", millis(self.delay))];
        if let Some(jitter) = self.jitter {
            parts[0] = format!("{} ± {} ms", millis(self.delay), millis(jitter.deviation));
            if !jitter.correlation.is_none() {
                parts.push(format!("correlation {}", jitter.correlation));
            }
            if let Some(over) = jitter.over {
                parts.push(format!("jitter over {} ms", millis(over.get())));
            }
        }
        parts.push(match &self.rate {
            Rate::Unlimited => "unlimited".to_owned(),
            Rate::Fixed { bits_per_second } => bits_per_second.to_string(),
            Rate::Trace { trace } => traced(trace.name()),
            Rate::NamedTrace(name) => traced(name),
        });
        match self.loss {
            Loss::None => {}
            Loss::Independent { rate } => parts.push(format!("loss {}", percent(rate.get()))),
            Loss::Bursty { rate, mean_burst } => {
                parts.push(format!("loss {} in bursts of {mean_burst}", percent(rate.get())));
            }
        }
        let shares = [
            ("duplication", self.duplication),
            ("corruption", self.corruption),
            ("reordering", self.reordering),
        ];
        parts.extend(
            shares
                .iter()
                .filter(|(_, p)| p.get() > 0.0)
                .map(|(name, p)| format!("{name} {}", percent(p.get()))),
        );
        match self.queue {
            QueueLimit::Packets(1000) => {}
            QueueLimit::Packets(packets) => parts.push(format!("queue {packets} packets")),
            QueueLimit::Bytes(bytes) => parts.push(format!("queue {bytes} B")),
        }
        if !self.queue_discipline.is_drop_tail() {
            parts.push(self.queue_discipline.name().to_owned());
        }
        parts.join(", ")
    }
}
