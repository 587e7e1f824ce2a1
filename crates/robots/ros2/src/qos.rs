//! How a topic is to be delivered: the profiles that ROS 2 nodes expect of each other.
//!
//! Source: ROS 2 documentation, "Quality of Service settings"; `rmw/qos_profiles.h`.

use rustdds::{Duration, QosPolicies, QosPolicyBuilder, policy};

/// How many samples may be on their way to a subscriber that has not acknowledged them, or wait to be taken from
/// RustDDS, whatever the depth.
const IN_FLIGHT: i32 = 32;

/// How a topic is delivered. A publisher that offers less than a subscriber asks for is not heard by it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Whether what is lost is sent again.
    pub reliable: bool,
    /// Whether who subscribes later gets the last messages at once, for maps, say: ROS 2's "transient local".
    pub latched: bool,
    /// How many messages wait for who takes them too slowly; then the oldest are dropped. At least one.
    pub depth: usize,
}

impl Qos {
    /// For what is new all the time, scans and odometry: best effort, the last 5.
    pub const SENSORS: Self = Self { reliable: false, latched: false, depth: 5 };
    /// For what is to arrive, commands and nearly all else: reliable, the last 10. ROS 2's default.
    pub const COMMANDS: Self = Self { reliable: true, latched: false, depth: 10 };
    /// For what is said once, `/map` and `/tf_static`: reliable, and latched.
    pub const LATCHED: Self = Self { reliable: true, latched: true, depth: 1 };

    /// The depth, at least one.
    pub(crate) fn depth(self) -> usize {
        self.depth.max(1)
    }

    /// RustDDS's; if `bounded`, no more than the depth and some are on their way.
    pub(crate) fn policies(self, bounded: bool) -> QosPolicies {
        let depth = i32::try_from(self.depth()).unwrap_or(i32::MAX);
        let max_samples = depth.saturating_add(IN_FLIGHT);
        let limits =
            policy::ResourceLimits { max_samples, max_instances: 1, max_samples_per_instance: max_samples };
        let builder = QosPolicyBuilder::new().history(policy::History::KeepLast { depth });
        let builder = if bounded { builder.resource_limits(limits) } else { builder };
        let builder = builder.durability(if self.latched {
            policy::Durability::TransientLocal
        } else {
            policy::Durability::Volatile
        });
        // Without waiting: what does not go at once is queued by the publisher.
        let max_blocking_time = Duration::ZERO;
        builder
            .reliability(if self.reliable {
                policy::Reliability::Reliable { max_blocking_time }
            } else {
                policy::Reliability::BestEffort
            })
            .build()
    }
}
