//! One robot's walk: which waypoint is next, which way leads there, and how to move now; or the same to a goal.
//!
//! Its answers depend on the robot's pose and next waypoint alone, never on what it saw before: so that an
//! instance on another server goes on where this one stopped. What it keeps between calls is only computed ahead. To a goal
//! it keeps to the way that it planned; an instance on another server plans one from where the robot is then.

use std::sync::Arc;

use cotorra_graph::{Pose, Position, Velocity, Walk};

use crate::{
    costmap::Costmap,
    path::{Path, Projection},
    planner::{Planner, Unreachable},
    pursuit,
};

/// A waypoint counts as reached within this distance, metres …
const REACHED: f64 = 0.35;
/// … and the last one within this.
const ARRIVED: f64 = 0.15;
/// Further than this from its path, a robot gets a new one from where it is; metres.
const OFF_PATH: f64 = 0.5;

/// Detours begin at heights that are so far apart, metres.
const HEIGHT_STEP: f64 = 0.25;

/// Motion of a robot for now.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Its velocity.
    pub velocity: Velocity,
    /// The next waypoint; the walk's length at its end.
    pub waypoint: u32,
    /// Reason why the robot stands still in the middle of its walk.
    pub blocked: Option<Unreachable>,
}

/// The navigation of one robot along its walk.
#[derive(Debug, Clone)]
pub struct Navigation {
    map: Option<Arc<Costmap>>,
    walk: Walk,
    /// Planner of detours. It allocates memory on the first.
    planner: Planner,
    /// The way to each waypoint from the one before it; to the first there is none.
    legs: Vec<Option<Result<Path, Unreachable>>>,
    detour: Option<Detour>,
    /// The last goal, and the way there from where the robot was.
    errand: Option<(Position, Path)>,
}

/// The way to a waypoint from a place off its leg.
#[derive(Debug, Clone)]
struct Detour {
    waypoint: usize,
    from: Position,
    path: Result<Path, Unreachable>,
}

impl Navigation {
    /// The navigation along `walk` on `map`, or in open space. Plans the whole walk.
    pub fn new(map: Option<Arc<Costmap>>, walk: Walk) -> Self {
        let mut planner = Planner::default();
        let mut leg = |pair: &[Position]| Some(way(map.as_deref(), &mut planner, pair[0], pair[1]));
        let first = walk.waypoints.first().map(|_| None);
        let legs = first.into_iter().chain(walk.waypoints.windows(2).map(&mut leg)).collect();
        Self { map, walk, planner: Planner::default(), legs, detour: None, errand: None }
    }

    /// Whether the walk has this waypoint. Its length, which means its end, is one, too.
    pub fn has_waypoint(&self, waypoint: u32) -> bool {
        waypoint as usize <= self.walk.waypoints.len()
    }

    /// Returns the motion from `pose`, with `waypoint` as the next waypoint.
    pub fn step(&mut self, pose: &Pose, waypoint: u32) -> Step {
        if !pose.is_finite() {
            return Step { velocity: Velocity::default(), waypoint, blocked: Some(Unreachable::NoPose) };
        }
        let next = self.next_waypoint(pose.position(), waypoint as usize);
        let answer = |velocity, blocked| Step { velocity, waypoint: next as u32, blocked };
        if next == self.walk.waypoints.len() {
            return answer(Velocity::default(), None);
        }
        match self.drive(pose, next) {
            Ok(velocity) => answer(velocity, None),
            Err(reason) => answer(Velocity::default(), Some(reason)),
        }
    }

    /// Returns the velocity from `pose` to a goal and the metres that are left; `None` at the goal.
    ///
    /// # Errors
    ///
    /// [`Unreachable`] if no way leads there.
    pub fn approach(&mut self, pose: &Pose, goal: Position) -> Result<Option<(Velocity, f64)>, Unreachable> {
        if !pose.is_finite() {
            return Err(Unreachable::NoPose);
        }
        let (map, here) = (self.map.as_deref(), pose.position());
        if here.distance(goal) <= ARRIVED {
            return Ok(None);
        }
        let known = self.errand.take().filter(|(to, path)| *to == goal && near(map, path, here).is_some());
        let (_, path) = match known {
            Some(known) => self.errand.insert(known),
            None => self.errand.insert((goal, way(map, &mut self.planner, here, goal)?)),
        };
        let on = path.project(here);
        let velocity = pursuit::follow(map, path, &on, pose, self.walk.speed_limit);
        Ok(Some((velocity, on.distance + path.remaining(&on))))
    }

    /// Returns the end of the first leg that passes near a place; the first waypoint if none does.
    pub fn resume(&self, here: Position) -> u32 {
        let passes = |leg: &Option<Result<Path, Unreachable>>| {
            let Some(Ok(path)) = leg else { return false };
            near(self.map.as_deref(), path, here).is_some()
        };
        self.legs.iter().position(passes).unwrap_or(0) as u32
    }

    /// The first waypoint from `waypoint` on that is not reached yet.
    fn next_waypoint(&self, here: Position, waypoint: usize) -> usize {
        let waypoints = &self.walk.waypoints;
        let last = waypoints.len().saturating_sub(1);
        let reached = |i: usize| waypoints[i].distance(here) <= if i == last { ARRIVED } else { REACHED };
        (waypoint..waypoints.len()).find(|&i| !reached(i)).unwrap_or(waypoints.len())
    }

    fn drive(&mut self, pose: &Pose, next: usize) -> Result<Velocity, Unreachable> {
        let (map, limit) = (self.map.as_deref(), self.walk.speed_limit);
        let here = pose.position();
        if let Some(Ok(leg)) = &self.legs[next]
            && let Some(on) = near(map, leg, here)
        {
            return Ok(pursuit::follow(map, leg, &on, pose, limit));
        }
        // The same place gives the same detour, whoever plans it and whatever was planned before.
        let from = map.and_then(|map| map.cell_at(here).map(|cell| map.centre(cell))).unwrap_or(here);
        let from = from.at_height((here.z / HEIGHT_STEP).round() * HEIGHT_STEP);
        let known = self.detour.take().filter(|detour| detour.waypoint == next && detour.from == from);
        let detour = self.detour.insert(known.unwrap_or_else(|| Detour {
            waypoint: next,
            from,
            path: way(map, &mut self.planner, from, self.walk.waypoints[next]),
        }));
        let path = detour.path.as_ref().map_err(|&reason| reason)?;
        Ok(pursuit::follow(map, path, &path.project(here), pose, limit))
    }
}

/// The place on a path where a robot is, if it is near the path and sees it.
fn near(map: Option<&Costmap>, path: &Path, here: Position) -> Option<Projection> {
    let on = path.project(here);
    let in_sight = || map.is_none_or(|map| map.sees(here, on.place));
    (on.distance <= OFF_PATH && in_sight()).then_some(on)
}

fn way(
    map: Option<&Costmap>,
    planner: &mut Planner,
    from: Position,
    to: Position,
) -> Result<Path, Unreachable> {
    match map {
        Some(map) => Ok(planner.plan(map, from.on_floor(), to.on_floor())?.rising(from.z, to.z)),
        None => Ok(Path::straight(from, to)),
    }
}
