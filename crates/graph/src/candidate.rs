//! Radio units that a robot can use, with the delay over the air to each: d(r,R).

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{
    context::{Attachment, LinkContext, RobotContext},
    hardware::{Direction, HardwareGraph, NodeKind},
    id::{LinkId, NodeId},
    link_figures::{DelayFigure, FigureSource},
};

/// A radio unit of a robot's network, with the delay over the air between them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Candidate {
    /// φ(r,R).
    #[serde(flatten)]
    pub attachment: Attachment,
    /// d(r,R).
    pub uplink: DelayFigure,
    /// d(R,r).
    pub downlink: DelayFigure,
}

/// Returns the candidates of a robot.
///
/// - A delay of the own link is `probed` or `carried`: while the robot is attached, and at least the configured one.
/// - The delay to any other radio unit is `estimated`: the mean of what its stations measure now, and at least the configured one.
///   Stations of one radio unit share its channel, and so its waiting times.
/// - Without such stations it is `configured`.
///
/// `stations` are all robots of the network with their radio units; `link` returns the last context of a link with its age.
pub fn candidates<'a>(
    context: &RobotContext,
    graph: &HardwareGraph,
    stations: &[(&NodeId, &NodeId)],
    link: impl Fn(&LinkId, Direction) -> Option<(&'a LinkContext, Duration)>,
) -> Vec<Candidate> {
    let network = graph.node(&context.robot).and_then(|node| match &node.kind {
        NodeKind::Robot(robot) => graph.wireless.get(&robot.network),
        _ => None,
    });
    let configured = network.map_or(Duration::ZERO, |network| network.delay);
    let measured = |robot: &NodeId, unit: &NodeId, direction| {
        let (context, age) = link(&LinkId::wireless(robot, unit), direction)?;
        let mut measured = context.measured_delay(LinkContext::FRESH)?;
        measured.age += age;
        (measured.age <= LinkContext::FRESH).then_some(measured)
    };
    let delay = |attachment: &Attachment, direction| {
        let unit = &attachment.radio_unit;
        let own = link(&LinkId::wireless(&context.robot, unit), direction);
        let least = DelayFigure::configured(own.map_or(configured, |(own, _)| own.effective.delay));
        let known = if attachment.attached {
            measured(&context.robot, unit, direction)
        } else {
            let of_unit = stations.iter().filter(|(robot, at)| *at == unit && **robot != context.robot);
            mean(of_unit.filter_map(|(robot, _)| measured(robot, unit, direction)))
        };
        known.map_or(least, |known| DelayFigure { delay: known.delay.max(least.delay), ..known })
    };
    let candidate = |attachment: &Attachment| Candidate {
        uplink: delay(attachment, Direction::Forward),
        downlink: delay(attachment, Direction::Backward),
        attachment: attachment.clone(),
    };
    context.attachments.iter().map(candidate).collect()
}

/// Returns the mean of delays, as old as the oldest; `None` without any.
fn mean(delays: impl Iterator<Item = DelayFigure>) -> Option<DelayFigure> {
    let (mut sum, mut age, mut count) = (Duration::ZERO, Duration::ZERO, 0);
    for figure in delays {
        (sum, age, count) = (sum + figure.delay, age.max(figure.age), count + 1);
    }
    (count > 0).then(|| DelayFigure { delay: sum / count, age, source: FigureSource::Estimated })
}
