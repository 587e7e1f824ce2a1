//! How far a plug-in is from the core.

use std::{fmt, time::Duration};

use serde::{Deserialize, Serialize};

use crate::{id::NodeId, units::millis};

/// The distance of a plug-in from the core, and the time of its decisions. By default, it is beside the core, and decides at
/// once.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PluginDistance {
    /// The way of contexts to the plug-in, and of its instructions back.
    #[serde(default)]
    pub way: Way,
    /// Time of a decision, i.e. of a call with instructions, in virtual time. Contexts wait meanwhile.
    #[serde(rename = "decides_in_ms", with = "millis", default, skip_serializing_if = "Duration::is_zero")]
    #[schema(value_type = f64)]
    pub decides_in: Duration,
}

/// The way between the core and a plug-in.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// None: the plug-in is beside the core.
    #[default]
    None,
    /// Each message arrives so much later.
    Delay {
        /// Time of one way.
        #[serde(rename = "control_delay_ms", with = "millis")]
        #[schema(value_type = f64)]
        control_delay: Duration,
    },
    /// Messages cross the emulated network.
    Nodes {
        /// Node of the core.
        core: NodeId,
        /// Node of the plug-in, another one.
        plugin: NodeId,
    },
}

impl PluginDistance {
    /// Whether the plug-in is beside the core, and decides at once.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl fmt::Display for PluginDistance {
    /// Writes the keys of the testbed file that make it: `control_delay 100 ms, decides_in 5 ms`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |duration: Duration| format!("{} ms", millis::of(duration));
        let way = match &self.way {
            Way::None => None,
            Way::Delay { control_delay } => Some(format!("control_delay {}", ms(*control_delay))),
            Way::Nodes { core, plugin } => Some(format!("node {plugin}, core {core}")),
        };
        let decides_in = (!self.decides_in.is_zero()).then(|| format!("decides_in {}", ms(self.decides_in)));
        match [way, decides_in].into_iter().flatten().collect::<Vec<_>>().join(", ") {
            none if none.is_empty() => f.write_str("none"),
            keys => f.write_str(&keys),
        }
    }
}
