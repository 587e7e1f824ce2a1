//! Quality of service of topics: the profiles that ROS 2 nodes expect of each other.
//!
//! Source: ROS 2 documentation, "Quality of Service settings"; `rmw/qos_profiles.h`.

use rustdds::{Duration, QosPolicies, QosPolicyBuilder, policy};

/// Samples beyond the depth that may be unacknowledged by a subscriber, or wait in RustDDS.
const IN_FLIGHT: i32 = 32;

/// Quality of service of a topic. A subscriber is not connected to a publisher that offers less than it requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Whether lost messages are sent again.
    pub reliable: bool,
    /// Whether new subscribers get the last messages at once, such as a map: ROS 2's "transient local".
    pub latched: bool,
    /// Messages that are queued for a slow receiver, at least one. If there are more, the oldest are dropped.
    pub depth: usize,
}

impl Qos {
    /// For frequent data such as scans and odometry: best effort, the last 5.
    pub const SENSORS: Self = Self { reliable: false, latched: false, depth: 5 };
    /// For commands and most other data: reliable, the last 10. ROS 2's default.
    pub const COMMANDS: Self = Self { reliable: true, latched: false, depth: 10 };
    /// For data that is published once, such as `/map` and `/tf_static`: reliable, and latched.
    pub const LATCHED: Self = Self { reliable: true, latched: true, depth: 1 };

    /// Returns the depth, at least one.
    pub(crate) fn depth(self) -> usize {
        self.depth.max(1)
    }

    /// Returns the policies of RustDDS. `bounded` limits unacknowledged samples to the depth and [`IN_FLIGHT`].
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
        // Without blocking: the publisher queues what cannot be sent at once.
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
