//! Autonomous navigation: the plug-in that walks robots from waypoint to waypoint.
//!
//! It plans over an inflated costmap with A*, follows by regulated pure pursuit, and answers each context of a robot
//! with a velocity and the next waypoint. The answer depends on that context alone: an instance that starts on
//! another server in the middle of a walk goes on as if it had been there all the time. [`Brain`] is the plug-in;
//! [`serve()`] runs it as the navigation VNF, where contexts and instructions cross the network as packets. [`Pilot`] does
//! the same for a robot that says nothing but its pose, as robots in ROS do. [`Floor`] tells where a robot can go on a map,
//! for those who choose its walk.
#![forbid(unsafe_code)]

mod costmap;
mod departing;
mod floor;
mod navigation;
mod path;
mod pilot;
mod planner;
mod pursuit;
mod serve;
#[cfg(test)]
mod testing;

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::{
    Event, Instruction, NodeId, Pose, Position, RobotContext, RobotModel, Testbed, Timestamp, Velocity,
};
use cotorra_plugin::{Actions, Plugin, wire::Headway};

use crate::{costmap::Costmap, navigation::Navigation};
pub use crate::{
    floor::Floor,
    navigation::Step,
    pilot::Pilot,
    planner::Unreachable,
    serve::{NavigationVnf, NoWalk, PacketError, serve},
};

/// Navigates robots along their walks: answers each κ(r) with [`Instruction::Move`].
///
/// At the end of a walk, and where no way leads on, the velocity is zero; the latter with the reason.
#[derive(Debug, Clone, Default)]
pub struct Brain {
    only: Option<NodeId>,
    navigations: BTreeMap<NodeId, Navigation>,
}

impl Brain {
    /// Makes a brain for every robot that has a walk.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes a brain for one robot, as a navigation VNF serves it.
    pub fn for_robot(robot: NodeId) -> Self {
        Self { only: Some(robot), ..Self::default() }
    }

    /// Returns a robot's velocity towards a goal and its progress; `None` for a robot without a walk.
    pub(crate) fn approach(
        &mut self,
        robot: &NodeId,
        pose: &Pose,
        goal: Position,
    ) -> Option<(Velocity, Headway)> {
        Some(match self.navigations.get_mut(robot)?.approach(pose, goal) {
            Ok(Some((velocity, left))) => (velocity, Headway::Left(left)),
            Ok(None) => (Velocity::default(), Headway::Arrived),
            Err(unreachable) => (Velocity::default(), Headway::Blocked(unreachable.to_string())),
        })
    }

    /// Returns the robot's navigation, once the brain has started; `None` for a robot without a walk.
    fn into_navigation(mut self, robot: &NodeId) -> Option<Navigation> {
        self.navigations.remove(robot)
    }

    /// A brain for each of its robots.
    fn split(self) -> impl Iterator<Item = (NodeId, Self)> {
        self.navigations.into_iter().map(|(robot, navigation)| {
            let navigations = BTreeMap::from([(robot.clone(), navigation)]);
            (robot.clone(), Self { only: Some(robot), navigations })
        })
    }
}

impl Plugin for Brain {
    /// Plans all walks, so that no answer waits for a plan later.
    fn start(&mut self, _now: Timestamp, testbed: &Testbed, _actions: &mut Actions) {
        let mut maps: Vec<(RobotModel, Arc<Costmap>)> = Vec::new();
        let mut map_for = |model: RobotModel| {
            let grid = testbed.map.as_ref()?;
            let known = maps.iter().find(|(known, _)| *known == model).map(|(_, map)| map.clone());
            Some(known.unwrap_or_else(|| {
                let map = Arc::new(Costmap::new(grid, model.radius()));
                maps.push((model, map.clone()));
                map
            }))
        };
        let wanted = |robot: &NodeId| self.only.as_ref().is_none_or(|only| only == robot);
        self.navigations = testbed
            .graph
            .robots()
            .filter(|(node, _)| wanted(&node.id))
            .filter_map(|(node, robot)| {
                let walk = testbed.walk(&node.id)?.clone();
                Some((node.id.clone(), Navigation::new(map_for(robot.model), walk)))
            })
            .collect();
    }

    fn handle(&mut self, _now: Timestamp, event: &Event, actions: &mut Actions) {
        let Event::Robot(RobotContext { robot, sensors, waypoint, .. }) = event else { return };
        let Some(navigation) = self.navigations.get_mut(robot) else { return };
        let step = navigation.step(&sensors.pose, *waypoint);
        let instruction =
            Instruction::Move { robot: robot.clone(), velocity: step.velocity, waypoint: step.waypoint };
        match step.blocked {
            None => actions.instruct(instruction),
            Some(reason) => actions.instruct_because(instruction, reason.to_string()),
        }
    }
}
