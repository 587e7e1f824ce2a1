//! What robots followed of models.

use cotorra_graph::{NodeId, ServiceId};
use cotorra_robot_middleware::Followed;

/// What the robot of a service followed in a run.
#[derive(Debug, Clone)]
pub(crate) struct PolicyFollowed {
    pub(crate) service: ServiceId,
    pub(crate) robot: NodeId,
    pub(crate) followed: Followed,
}
