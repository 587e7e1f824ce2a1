//! KPI-driven orchestration: at each new location of a robot, the radio unit and the servers that carry its service
//! at the least cost, with every KPI kept (OKpi: Martín-Pérez, Malandrino, Chiasserini, Bernardos, INFOCOM 2020 and
//! IEEE/ACM Transactions on Networking 30(2), 2022).
//!
//! [`place`] is the decision by itself, a pure function; [`Okpi`] is the plug-in that asks it.
#![forbid(unsafe_code)]

mod coverage;
mod exploration;
mod model;
mod network_view;
mod paths;
mod placement;
mod search;
mod settings;

use std::{collections::BTreeMap, time::Duration};

use cotorra_graph::{
    Event, Instruction, LinkId, NodeId, NodeKind, Placement, Position, Roaming, RobotContext, Service,
    Testbed, Timestamp, VirtualLink,
};
use cotorra_plugin::{
    Actions, Plugin,
    links::{LinkHistory, Memory},
    settings::InvalidSettings,
};

pub use crate::{
    model::{Infrastructure, Link, Node, Queue, Service as Chain, Vnf},
    placement::place,
    search::{Infeasible, Placed, Search, Slack},
};
use crate::{
    network_view::{Air, Concerned, NetworkView},
    settings::{Delays, Settings},
};

/// A location is new so far from the last, metres: as often as localization publishes one.
const NEW_LOCATION_M: f64 = 0.25;
/// Shortest time between two decisions at the same location.
const PAUSE: Duration = Duration::from_secs(1);

/// Orchestrates every service by its KPIs.
#[derive(Debug)]
pub struct Okpi {
    settings: Settings,
    now: Option<NetworkView>,
    history: Option<Box<dyn LinkHistory>>,
    /// Decisions for the services, in the testbed's order.
    decisions: Vec<Decision>,
}

/// Decision for a service.
#[derive(Debug, Default)]
struct Decision {
    /// Location of the robot at the decision; `None` asks for a new decision wherever the robot is.
    at: Option<Position>,
    /// The radio unit.
    attachment: Option<NodeId>,
    /// Whether the warning that KPIs cannot be kept was given.
    warned: bool,
    /// Time of the last check whether a decision is due.
    checked: Timestamp,
    /// Whether a sample missed its KPI, or a measurement changed, since then.
    in_question: bool,
    /// Whether something measured counted in the decision.
    is_by_measurement: bool,
    /// Links that the service left.
    memory: Memory,
}

impl Decision {
    /// Whether measurements are to be checked where the last decision was made.
    fn is_due(&self, now: Timestamp, settings: &Settings) -> bool {
        let wait = if self.in_question { PAUSE } else { settings.measurements.every };
        settings.delays != Delays::Asked && now.since(self.checked) >= wait
    }
}

impl Okpi {
    /// Reads the settings of a testbed file:
    ///
    /// - `gamma`: γ, levels that each KPI's budget is counted in, rounded up at each hop; by default `4`, with which
    ///   the published decisions come out;
    /// - `k_paths`: paths that are tried between two hosts, from `1` to `3`, by default `3`: the fastest, the most
    ///   reliable, the fastest with room beside what the service sends already;
    /// - `relax`: where no placement keeps the KPIs, `true` takes the one that exceeds them least and says so, `false`,
    ///   the default, leaves all as it is;
    /// - `floor` and `margin`: a radio unit covers a location where its mean signal is above the floor, by default
    ///   `-80 dBm`, and not weaker than the strongest by more than the margin, by default `7.5 dB`;
    /// - `coverage`: areas from a survey in place of that, as `R1: [[x, y], [x, y], [x, y]]` in metres; a radio unit
    ///   that is not named is not offered. With a `hysteresis`, by default `0 m`, a radio unit is taken up so deep in
    ///   its area, and kept so far beyond it;
    /// - `processing`: VNFs that take time, as `navigation: { service_rate: 500 /s, arrival_rate: 20 /s }`: the μ
    ///   and λ of an M/M/1 queue with processor sharing; by default none does;
    /// - `delays`: `measured`, the default, counts links with their measured delays, loads and losses, and at least as
    ///   configured; `history` reads the same from the history, as the letter's did, with [`Okpi::reading`]; `asked` counts
    ///   them as they are configured;
    /// - `measurements`: use of these. A delay beyond the configured one counts from a `tolerance` on, by default `1 ms`; the
    ///   highest of a `window` counts, by default `10 s`. Decisions are checked `every` `5 s` by default. A link that a
    ///   service left counts as it was for a `hold`, by default `60 s`, doubled with each return;
    /// - `services`: those that are orchestrated, as `[navigation]`; by default all are.
    ///
    /// [`Okpi::for_testbed`] checks the names in them.
    ///
    /// # Errors
    /// [`InvalidSettings`] for a setting that does not exist, or that has no such value.
    pub fn from_settings(
        settings: &serde_json::Map<String, serde_json::Value>,
    ) -> Result<Self, InvalidSettings> {
        Ok(Self { settings: Settings::decode(settings)?, now: None, history: None, decisions: Vec::new() })
    }

    /// The same, if all that its settings name exists in the testbed that it is to orchestrate.
    ///
    /// # Errors
    /// [`InvalidSettings`] for the first name that the testbed does not have.
    pub fn for_testbed(self, testbed: &Testbed) -> Result<Self, InvalidSettings> {
        if self.settings.delays == Delays::History && self.history.is_none() {
            let reason =
                "`history` needs a history, which is not kept here; write `measured` for the same figures";
            return Err(InvalidSettings::new("delays", reason));
        }
        self.settings.check(testbed).map(|()| self)
    }

    /// The same, with a history to read where its settings say so.
    pub fn reading(self, history: impl LinkHistory + 'static) -> Self {
        Self { history: Some(Box::new(history)), ..self }
    }

    /// Decides for all services of a robot that is at a new location.
    fn locate(&mut self, at: Timestamp, context: &RobotContext, actions: &mut Actions) {
        let Some(now) = &mut self.now else { return };
        // It is decided from where a handover leads to, not from where it began.
        if now.hands_over(&context.robot) {
            return;
        }
        let location = context.sensors.pose.position();
        // A robot has one radio unit: its first service chooses.
        let mut chosen = None;
        for (service, decision) in now.services().iter().zip(&mut self.decisions) {
            let is_other = service.robot != context.robot || !self.settings.orchestrates(&service.id);
            // One whose programs are others' has nothing to place.
            if is_other || service.vnfs.is_empty() {
                continue;
            }
            let is_near = |place: &Position| place.distance(location) < NEW_LOCATION_M;
            let last = decision.at.filter(is_near);
            // Beyond its area a service promises nothing.
            let within = || service.kpis.area.as_ref().is_none_or(|area| location.is_within(area));
            if last.is_none() || decision.is_due(at, &self.settings) {
                decision.checked = at;
                decision.in_question = false;
                if let Some(history) =
                    self.history.as_mut().filter(|_| self.settings.delays == Delays::History)
                {
                    match history.latest(at) {
                        Ok(links) => links.iter().for_each(|(at, link)| _ = now.learn_link(*at, link)),
                        Err(error) => tracing::warn!("links are as they were: {error}"),
                    }
                }
                let is_by_measurement = now.any_beyond() || decision.memory.is_held(at);
                let was_by_measurement =
                    std::mem::replace(&mut decision.is_by_measurement, is_by_measurement);
                // Where a robot stays, only measurements change a decision.
                let is_new = last.is_none() || is_by_measurement || was_by_measurement;
                let location = *decision.at.insert(last.unwrap_or(location));
                if is_new && within() {
                    let place = Place { context, location };
                    decide(&self.settings, now, service, decision, chosen.as_ref(), place, actions);
                }
            }
            chosen = chosen.or_else(|| decision.attachment.clone());
        }
    }
}

/// A robot, and the location to decide for.
#[derive(Clone, Copy)]
struct Place<'a> {
    context: &'a RobotContext,
    location: Position,
}

fn decide(
    settings: &Settings,
    now: &mut NetworkView,
    service: &Service,
    decision: &mut Decision,
    chosen: Option<&NodeId>,
    Place { context, location }: Place<'_>,
    actions: &mut Actions,
) {
    let Some(NodeKind::Robot(robot)) = now.graph.node(&service.robot).map(|node| &node.kind) else { return };
    let roaming = robot.roaming;
    let attached = context.attached_to();
    let present = decision.attachment.as_ref().or(attached);
    let units = match (roaming, chosen) {
        (Roaming::Instructed, None) => settings.coverage.at(&now.graph, &robot.network, location, present),
        (Roaming::Instructed, Some(chosen)) => vec![chosen.clone()],
        (Roaming::Signal | Roaming::Supplicant(_), _) => attached.into_iter().cloned().collect(),
    };
    let chain = now.service(service, &settings.processing);
    let place_with =
        |air| place(&chain, &now.infrastructure(service, &units, &decision.memory, air), settings.search);
    let mut placed = place_with(Air::Measured);
    // The air is the same for all servers. If it leaves none, the best of them is wanted all the same.
    let air_breaks = placed.is_err() && now.is_air_beyond(&service.robot, &units, &decision.memory);
    if air_breaks {
        placed = place_with(Air::Configured);
    }
    let placed = match placed {
        Ok(placed) => placed,
        Err(infeasible) => {
            if !std::mem::replace(&mut decision.warned, true) {
                tracing::warn!("`{}` at {location}: {infeasible}; its placement stays", service.id);
            }
            return;
        }
    };
    decision.warned = false;
    let left = now.leave(service, &placed.paths, &mut decision.memory, settings.measurements.hold);
    let mut reason = reason(service, &placed, location, left);
    if air_breaks {
        reason += "; with the air as configured, because no placement keeps the KPIs with the measured one";
    }
    let paths = paths(service, &placed);
    for Placement { vnf, node } in placed.placement {
        if now.wants_place(&vnf, node.first()) {
            actions.instruct_because(Instruction::Place { vnf, node }, &reason);
        }
    }
    for (from, to, links) in now.wants_paths(service, paths) {
        actions.instruct_because(Instruction::Map { from, to, links, reservation: None }, &reason);
    }
    // A robot that lost its radio unit, or took another by itself, gets its order again.
    if let Some(unit) = &placed.attachment
        && roaming == Roaming::Instructed
        && now.wants_attachment(&service.robot, attached, unit)
    {
        let (robot, radio_unit) = (service.robot.clone(), unit.clone());
        actions.instruct_because(Instruction::Attach { robot, radio_unit }, &reason);
    }
    decision.attachment = placed.attachment;
}

/// The paths of the virtual links between VNFs that follow each other, there and back.
fn paths(service: &Service, placed: &Placed) -> BTreeMap<(NodeId, NodeId), Vec<LinkId>> {
    let mut paths = BTreeMap::new();
    for (pair, links) in placed.placement.windows(2).zip(&placed.paths) {
        let [a, b] = [&pair[0], &pair[1]];
        let ends =
            |link: &&VirtualLink| [(&a.vnf, &b.vnf), (&b.vnf, &a.vnf)].contains(&(&link.from, &link.to));
        if links.is_empty() || service.virtual_links.iter().find(ends).is_none() {
            continue;
        }
        let (a, b) = (a.node.first(), b.node.first());
        paths.entry((a.clone(), b.clone())).or_insert_with(|| links.clone());
        let back = || links.iter().rev().cloned().collect();
        paths.entry((b.clone(), a.clone())).or_insert_with(back);
    }
    paths
}

/// Describes a placement's reason for people.
fn reason(
    service: &Service,
    placed: &Placed,
    location: Position,
    left: Option<(LinkId, Duration)>,
) -> String {
    let attachment = placed.attachment.iter();
    let moved = placed.placement.iter().zip(&service.vnfs).filter(|(_, vnf)| vnf.pinned_to.is_none());
    let names: Vec<_> =
        attachment.chain(moved.map(|(placement, _)| placement.node.first())).map(NodeId::as_str).collect();
    let (taken, slack) = (placed.service_time.as_secs_f64() * 1e3, placed.slack.service_time_ms);
    let spare = if slack < 0.0 { "too much" } else { "to spare" };
    let mut reason = format!(
        "{} at {location} for a cost of {}: {taken:.1} ms, {:.1} ms {spare}",
        names.join(" + "),
        placed.cost,
        slack.abs()
    );
    if let Some(slack) = placed.slack.reliability {
        let spare = if slack < 0.0 { "too little" } else { "to spare" };
        reason += &format!("; reliability {:.6}, {:.1e} {spare}", placed.reliability, slack.abs());
    }
    if let Some((link, beyond)) = left {
        reason += &format!("; `{link}` is {:.1} ms slower than configured", beyond.as_secs_f64() * 1e3);
    }
    reason
}

impl Plugin for Okpi {
    fn start(&mut self, _now: Timestamp, testbed: &Testbed, _actions: &mut Actions) {
        self.decisions = testbed.services.iter().map(|_| Decision::default()).collect();
        let measurements = self.settings.measurements;
        let measurements = (self.settings.delays != Delays::Asked).then_some(measurements);
        self.now = Some(NetworkView::new(testbed, measurements));
    }

    fn handle(&mut self, at: Timestamp, event: &Event, actions: &mut Actions) {
        let Some(now) = &mut self.now else { return };
        if self.settings.delays == Delays::History && matches!(event, Event::Link(_)) {
            return;
        }
        now.set_now(at);
        let concerned = now.learn(event);
        let services = now.services();
        for (service, decision) in services.iter().zip(&mut self.decisions) {
            if concerned.includes(service) {
                decision.at = None;
            }
            decision.in_question |= concerned == Concerned::Measured || misses(service, event);
        }
        if let Event::Robot(context) = event {
            self.locate(at, context, actions);
        }
    }
}

/// Whether an event is a sample of a service that misses its target.
fn misses(service: &Service, event: &Event) -> bool {
    match event {
        Event::ServiceTime(sample) if sample.service == service.id => {
            sample.took.is_none_or(|took| took > service.kpis.service_time)
        }
        _ => false,
    }
}
