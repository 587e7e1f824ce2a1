//! Instructions of plug-ins. Each is declared once, in `instructions!`.

use std::time::Duration;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::{
    access::AccessPoint,
    active::ThroughputTest,
    bounds::{self, Bounded, Meter, TooLong},
    conditions::ConditionChange,
    context::Velocity,
    hardware::Direction,
    id::{LinkId, NodeId, SensorId, VnfId},
    nodes::Nodes,
    part::Part,
    record::{Unreadable, slots as slot},
    reservation::MapReservation,
    service::Vnf,
    units::{Position, millis},
};

/// Declares [`Instruction`]. Each has
///
/// - its documentation and fields, which are its JSON and its OpenAPI. Behind each field is the slot that keeps it in the
///   history's table `decision`. Its type is [`Bounded`], which limits the memory that it takes;
/// - its name in JSON, which is also that in the history;
/// - the parts of the testbed that it changes. Only a domain that has all of them may give it;
/// - its text.
macro_rules! instructions {
    ($(
        $(#[doc = $doc:literal])*
        $variant:ident { $(
            $(#[$meta:meta])*
            $field:ident: $type:ty => $slot:ident,
        )* } = $name:literal, changes [$($part:ident($changed:expr)),*], text $text:expr;
    )*) => {
        /// Instruction that a plug-in can give. Its texts and lists are bounded, each and all together.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
        #[serde(remote = "Self", rename_all = "snake_case", tag = "instruction", deny_unknown_fields)]
        pub enum Instruction { $(
            $(#[doc = $doc])*
            $variant { $($(#[$meta])* $field: $type,)* },
        )* }

        #[expect(unused_variables, reason = "no instruction needs all its fields everywhere")]
        impl Instruction {
            /// Returns the name in JSON.
            pub const fn name(&self) -> &'static str {
                match self { $(Self::$variant { .. } => $name,)* }
            }

            /// Calls `each` with the parts of the testbed that it changes, until the first error.
            ///
            /// # Errors
            /// The error of `each`.
            pub fn changes<E>(&self, mut each: impl FnMut(Part<'_>) -> Result<(), E>) -> Result<(), E> {
                match self { $(
                    Self::$variant { $($field),* } => { $(each(Part::$part($changed))?;)* }
                )* }
                Ok(())
            }

            /// Returns the instruction in words.
            pub fn text(&self) -> String {
                match self { $(Self::$variant { $($field),* } => $text,)* }
            }

            /// Whether a history can hold it: figures that are not finite do not survive JSON.
            pub fn survives_json(&self) -> bool {
                match self { $(Self::$variant { $($field),* } => true $(&& $field.survives_json())*,)* }
            }

            /// Returns the bytes of all its texts and lists.
            ///
            /// # Errors
            /// [`TooLong`] if one of them is beyond its bound, or all together are.
            pub fn measure(&self) -> Result<usize, TooLong> {
                let mut meter = Meter::default();
                match self { $(
                    Self::$variant { $($field),* } => { $($field.count(stringify!($field), &mut meter)?;)* }
                )* }
                bounds::check("instruction", meter.bytes, "bytes", Self::LONGEST)?;
                Ok(meter.bytes)
            }

            /// Puts it into the columns of the history.
            pub(crate) fn put<'a>(&'a self, slots: &mut slot::Slots<'a>) {
                match self { $(
                    Self::$variant { $($field),* } => {
                        $(<slot::$slot as slot::Slot<$type>>::put($field, slots);)*
                    }
                )* }
            }

            /// Reads the instruction of a name from the columns of the history.
            pub(crate) fn take(name: &str, slots: &slot::Slots<'_>) -> Result<Self, Unreadable> {
                Ok(match name {
                    $($name => Self::$variant {
                        $($field: <slot::$slot as slot::Slot<$type>>::take(slots)?,)*
                    },)*
                    other => {
                        return Err(Unreadable::new(format_args!("`{other}` is not an instruction")));
                    }
                })
            }
        }
    };
}

instructions! {
    /// Move a robot at this velocity, until another comes or its command timeout ends it.
    Move {
        /// The robot.
        robot: NodeId => Subject,
        /// The velocity.
        velocity: Velocity => Motion,
        /// The next waypoint of its walk, for whoever navigates it next.
        waypoint: u32 => Waypoint,
    } = "move", changes [Node(robot)], text format!("move {robot} at {:.2} m/s, {:.2} rad/s", velocity.linear, velocity.angular);
    /// Limit a robot's speed, whoever moves it. From its next velocity on, faster ones are slowed along the same curve.
    LimitSpeed {
        /// The robot.
        robot: NodeId => Subject,
        /// The limit, m/s; 0 stops the robot at once, null removes the limit.
        speed_limit_mps: Option<f64> => Linear,
    } = "limit_speed", changes [Node(robot)], text match speed_limit_mps {
        Some(limit) => format!("limit {robot} to {limit:.2} m/s"),
        None => format!("limit {robot} no more"),
    };
    /// Send a robot from its walk to a goal, where it stops. The event `goal` reports its progress.
    NavigateTo {
        /// The robot.
        robot: NodeId => Subject,
        /// The goal, which replaces an earlier one; null sends the robot back to its walk.
        goal: Option<Position> => OptionalJson,
    } = "navigate_to", changes [Node(robot)], text match goal {
        Some(goal) => format!("send {robot} to {goal}"),
        None => format!("send {robot} back to its walk"),
    };
    /// Report the values of a sensor of kind `vector`. The sensor's next reading has those of the last report.
    Report {
        /// The robot.
        robot: NodeId => Subject,
        /// Its sensor.
        sensor: SensorId => Object,
        /// As many finite numbers as the sensor has components.
        values: Vec<f64> => Json,
    } = "report", changes [Node(robot)], text format!("report {values:?} as {sensor} of {robot}");
    /// Scan all channels with a robot's radio, which leaves its own meanwhile.
    Scan {
        /// The robot.
        robot: NodeId => Subject,
    } = "scan", changes [Node(robot)], text format!("scan with {robot}");
    /// Attach a robot to a radio unit: φ(r,R) = 1. Does nothing where it is attached already.
    Attach {
        /// The robot.
        robot: NodeId => Subject,
        /// The radio unit.
        radio_unit: NodeId => Object,
    } = "attach", changes [Node(robot)], text format!("attach {robot} to {radio_unit}");
    /// Let a robot's radio unit suggest that it moves to another radio unit (802.11v), which the robot decides.
    /// The event `suggestion_answered` reports its answer. Does nothing where it is attached there already.
    Suggest {
        /// The robot.
        robot: NodeId => Subject,
        /// The other radio unit.
        radio_unit: NodeId => Object,
    } = "suggest", changes [Node(robot)], text format!("suggest {radio_unit} to {robot}");
    /// Run a VNF on a node, or an instance of it on each of several. New instances start first, then packets go to them, then
    /// old instances stop. Instances that run there already stay.
    Place {
        /// The VNF.
        vnf: VnfId => Subject,
        /// The node, or one for each instance.
        node: Nodes => Instances,
    } = "place", changes [Vnf(vnf), Nodes(node.all())], text format!("place {vnf} on {node}");
    /// Add a VNF that belongs to no service, and start its instances. It is a command or an image with the rights of a
    /// confined command, and ends with the run.
    AddVnf {
        /// The VNF. Its name is new in the testbed.
        vnf: Box<Vnf> => Added,
    } = "add_vnf", changes [Nodes(vnf.node.all())], text format!("add {} on {}", vnf.id, vnf.node);
    /// Remove a VNF that was added. Its instances stop once packets in flight to them have arrived.
    RemoveVnf {
        /// The VNF.
        vnf: VnfId => Subject,
    } = "remove_vnf", changes [Vnf(vnf)], text format!("remove {vnf}");
    /// Map the virtual links between two nodes, a(n1,n2). Packets from one node to the other take this path, and the rate of
    /// these virtual links is reserved on it in that direction. The mapping stays, whatever runs on the nodes.
    Map {
        /// The node at which the path begins.
        from: NodeId => Subject,
        /// The node at which it ends.
        to: NodeId => Object,
        /// The path's links, in order; an empty list removes the mapping.
        links: Vec<LinkId> => Path,
        /// A reservation of its own. By default the path has that of its virtual links, as the testbed file wants it kept.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reservation: Option<MapReservation> => PathReservation,
    } = "map", changes [Node(from), Node(to), Links(links)], text match (&links[..], reservation) {
        ([], _) => format!("unmap {from} to {to}"),
        (_, None) => format!("map {from} to {to} over {}", over(links)),
        (_, Some(own)) => format!("map {from} to {to} over {}, {own}", over(links)),
    };
    /// Change the conditions of a link.
    Condition {
        /// The link.
        link: LinkId => Subject,
        /// One direction, or both.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        direction: Option<Direction> => AnyDirection,
        /// The change.
        change: ConditionChange => Json,
    } = "condition", changes [Link(link)], text match direction {
        Some(direction) => format!("change {link} {}", direction.as_str()),
        None => format!("change {link}"),
    };
    /// Deploy the VNF `vAP` on a radio unit that is off, a(R) = {vAP}. The event `vnf` reports when it serves.
    Deploy {
        /// The radio unit.
        radio_unit: NodeId => Subject,
        /// Settings of the access point.
        access_point: AccessPoint => PublicJson,
    } = "deploy", changes [Node(radio_unit)], text format!("deploy a vAP on {radio_unit} for {}", access_point.ssid);
    /// Remove the VNF `vAP` from a radio unit, a(R) = {}. The radio unit is off, and its stations lose it.
    Remove {
        /// The radio unit.
        radio_unit: NodeId => Subject,
    } = "remove", changes [Node(radio_unit)], text format!("remove the vAP of {radio_unit}");
    /// Give a robot the settings and the key with which it attaches to a radio unit of another domain. Without a key, take
    /// them back.
    Provision {
        /// The robot.
        robot: NodeId => Subject,
        /// The radio unit.
        radio_unit: NodeId => Object,
        /// Settings with which it was deployed.
        access_point: AccessPoint => PublicJson,
    } = "provision", changes [Node(robot)], text format!("provision {robot} for {radio_unit}");
    /// Stop a robot until [`Instruction::Go`], whatever its navigation answers.
    Halt {
        /// The robot.
        robot: NodeId => Subject,
    } = "halt", changes [Node(robot)], text format!("halt {robot}");
    /// Let a halted robot follow its navigation again.
    Go {
        /// The robot.
        robot: NodeId => Subject,
    } = "go", changes [Node(robot)], text format!("let {robot} go");
    /// Record a step of a process that the plug-in conducts. Changes nothing else.
    Note {
        /// Name of the process that the note is about, of at most 128 characters.
        process: String => Subject,
        /// The step: a name of at most 128 characters.
        step: String => Object,
        /// Time since the step was reached, where that was earlier: a run that goes on after another repeats the
        /// other's notes.
        #[serde(
            rename = "ago_ms",
            default,
            skip_serializing_if = "Option::is_none",
            with = "millis::option"
        )]
        #[schema(value_type = Option<f64>)]
        ago: Option<Duration> => Milliseconds,
    } = "note", changes [], text match ago {
        Some(ago) => format!("note {step} of {process}, {:.3} s before", ago.as_secs_f64()),
        None => format!("note {step} of {process}"),
    };
    /// Test the throughput of one direction of a wired link. The link's context has the result when the test is over.
    TestThroughput {
        /// The link.
        link: LinkId => Subject,
        /// The direction.
        direction: Direction => OneDirection,
        /// Its duration and rate.
        test: ThroughputTest => Json,
    } = "test_throughput", changes [Link(link)], text {
        let direction = direction.as_str();
        format!("test the throughput of {link} {direction} for {:?}", test.duration)
    };
}

impl Serialize for Instruction {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for Instruction {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let read = Self::deserialize(deserializer)?;
        read.measure().map_err(de::Error::custom)?;
        Ok(read)
    }
}

impl Instruction {
    /// The most bytes of all texts and lists of an instruction together.
    pub const LONGEST: usize = bounds::LONGEST;
    /// The most bytes of the reason that is given with an instruction.
    pub const LONGEST_REASON: usize = 1024;
    /// The most characters of a name in a note.
    pub const LONGEST_NAME: usize = bounds::LONGEST_NAME;
    /// The most bytes of a path.
    pub const LONGEST_PATH: usize = bounds::LONGEST_PATH;
    /// The most links of a mapping.
    pub const MOST_LINKS: usize = bounds::MOST_LINKS;
    /// The most delivery opportunities of a trace.
    pub const MOST_OPPORTUNITIES: usize = bounds::MOST_OPPORTUNITIES;
    /// The most words of a command, variables, paths and ports of a VNF that is added, of each.
    pub const MOST_WORDS: usize = bounds::MOST_WORDS;

    /// The same without secrets, as all may know it.
    #[must_use]
    pub fn public(&self) -> Self {
        match self.clone() {
            Self::Deploy { radio_unit, access_point } => {
                Self::Deploy { radio_unit, access_point: access_point.public() }
            }
            Self::Provision { robot, radio_unit, access_point } => {
                Self::Provision { robot, radio_unit, access_point: access_point.public() }
            }
            other => other,
        }
    }
}

/// Returns links with commas between.
pub(crate) fn over(links: &[LinkId]) -> String {
    links.iter().map(LinkId::as_str).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instruction_beyond_a_bound_cannot_be_read() {
        let deploy = |bytes: usize| {
            let json = serde_json::json!({
                "instruction": "deploy", "radio_unit": "R",
                "access_point": { "ssid": "s".repeat(bytes), "mobility_domain": 1 },
            });
            serde_json::from_value::<Instruction>(json).map_err(|error| error.to_string())
        };
        assert!(deploy(32).is_ok());
        assert_eq!(deploy(33).unwrap_err(), "its `ssid` has 33 bytes: at most 32 are taken");
    }

    #[test]
    fn all_texts_of_an_instruction_together_have_a_bound() {
        let links = vec![LinkId::new(&"l".repeat(LinkId::LONGEST)).unwrap(); Instruction::MOST_LINKS];
        let node = || NodeId::new(&"n".repeat(NodeId::LONGEST)).unwrap();
        let longest = Instruction::Map { from: node(), to: node(), links, reservation: None };
        let bytes = longest.measure().unwrap();
        assert!(bytes > 256 * LinkId::LONGEST && bytes < Instruction::LONGEST, "{bytes}");
        let words = |words: usize| {
            let mut json = serde_json::json!({
                "instruction": "add_vnf", "vnf": {
                    "id": "v", "program": { "command": [] }, "cpus": 1.0, "memory_bytes": 1, "node": "n"
                },
            });
            json["vnf"]["program"]["command"] = vec!["w".repeat(1000); words].into();
            serde_json::from_value::<Instruction>(json).map_err(|error| error.to_string())
        };
        assert!(words(70).is_ok());
        let refused = words(90).unwrap_err();
        assert!(refused.contains("its `instruction` has 92"), "{refused}");
    }
}
