//! Events of a run, each reported once and declared once, in `events!`. The terminal, the recorder, the API's stream
//! and the report read events and nothing else. Plug-ins receive them as their contexts, and answer with instructions.

mod figures;
mod text;

use std::str::FromStr;

use serde::{Deserialize, Serialize};

#[cfg(doc)]
use crate::instruction::Instruction;
use crate::{
    context::{
        AnswersRejected, Handover, Lateness, LinkContext, Placement, RadioContext, RobotContext, ServiceTime,
        VirtualLinkMapping,
    },
    decision::Decision,
    goal::GoalEvent,
    id::{NodeId, PluginId},
    machine_context::MachineContext,
    part::Part,
    record::{Columns, Fields, Reader, Record, SeriesPart, Source, Table, Unreadable},
    sensor::SensorReading,
    staleness::{ContextKind, Staleness},
    units::Timestamp,
    vnf_event::VnfEvent,
};

/// An event and when it happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Stamped {
    /// Nanoseconds since the run began.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// The event.
    #[serde(flatten)]
    pub event: Event,
}

impl Stamped {
    /// Puts the event into a row of its kind's table, and into child rows.
    pub fn put<'a>(&'a self, row: &mut Fields<'a>, children: &mut Fields<'a>) {
        self.event.put(self.at, row, children);
    }

    /// Reads an event of a kind that happened at a time.
    ///
    /// # Errors
    /// [`Unreadable`], or an error of the source.
    pub fn take<E: From<Unreadable>>(
        kind: EventKind,
        at: Timestamp,
        source: &mut dyn Source<E>,
    ) -> Result<Self, E> {
        Ok(Self { at, event: Event::take(kind, at, source)? })
    }

    /// Whether a history can hold the event and return it unchanged.
    pub fn is_storable(&self) -> bool {
        i64::try_from(self.at.as_nanos()).is_ok()
            && match &self.event {
                Event::Decision(decision) => decision.instruction.survives_json(),
                Event::Machine(context) => context.is_valid(),
                _ => true,
            }
    }
}

/// Declares [`Event`] and [`EventKind`]. Each event has
///
/// - its documentation and details, which are its JSON and its OpenAPI: fields here, or a type of their own;
/// - its name in JSON, which is also that of its table in the history. The place in the list is its number there: a new
///   event is the last;
/// - the columns of its table: here for fields, and in the type's [`Record`] otherwise;
/// - the parts of the testbed that it is about: the domain of one of them sees the event;
/// - its text.
macro_rules! events {
    ($(
        $(#[doc = $doc:literal])*
        $variant:ident
            $(($details:ident: $type:ident))?
            $({ $($(#[doc = $of_field:literal])* $field:ident: $of:ident => $column:literal,)* })?
        = $name:literal, about [$($part:ident($($about:expr)?)),*], text $text:expr;
    )*) => {
        /// Anything that happens in a run.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
        #[serde(rename_all = "snake_case", tag = "event")]
        pub enum Event { $(
            $(#[doc = $doc])*
            $variant $(($type))? $({ $($(#[doc = $of_field])* $field: $of,)* })?,
        )* }

        /// Kinds of events, one for each variant of [`Event`].
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum EventKind { $(
            $(#[doc = $doc])*
            $variant,
        )* }

        impl EventKind {
            /// All kinds, each at the place of its number.
            pub const ALL: [Self; [$(Self::$variant),*].len()] = [$(Self::$variant),*];

            /// Returns the event's name in JSON, which is also its table in the history.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// Returns the kind of an event.
            pub const fn of(event: &Event) -> Self {
                match event { $(Event::$variant { .. } => Self::$variant,)* }
            }

            /// Returns the table of its events in the history.
            pub const fn table(self) -> &'static Table {
                match self { $(
                    Self::$variant => {
                        $(const TABLE: &Table = &<$type as Record>::TABLE;)?
                        $(const TABLE: &Table = &Table::plain(&[$($column),*]);)?
                        TABLE
                    }
                )* }
            }
        }

        #[expect(unused_variables, reason = "no event needs all its fields everywhere")]
        impl Event {
            /// Whether one of the parts of the testbed that it is about fulfils a condition.
            pub fn is_about(&self, is: impl Fn(Part<'_>) -> bool) -> bool {
                match self { $(
                    Self::$variant $(($details))? $({ $($field),* })? => false $(|| is(Part::$part$(($about))?))*,
                )* }
            }

            /// Returns the event in words.
            pub fn text(&self) -> String {
                match self { $(
                    Self::$variant $(($details))? $({ $($field),* })? => $text,
                )* }
            }

            /// Returns the bytes that it holds in memory: its own, and those of its texts and lists. Names count as
            /// nothing, because events share them.
            pub fn bytes(&self) -> usize {
                let beyond = match self { $(
                    Self::$variant $(($details))? $({ $($field),* })? => {
                        $(<$type as Record>::bytes($details))?
                        $([$(Columns::bytes($field)),*].into_iter().sum::<usize>())?
                    }
                )* };
                size_of::<Self>() + beyond
            }

            /// Returns the series that it belongs to, if it belongs to one.
            pub fn series(&self) -> Option<Series> {
                let parts = match self {
                $(
                    $(Self::$variant($details) => <$type as Record>::series($details),)?
                )*
                    _ => None,
                }?;
                Some(Series { kind: EventKind::of(self), parts })
            }

            fn put<'a>(&'a self, at: Timestamp, row: &mut Fields<'a>, children: &mut Fields<'a>) {
                match self { $(
                    Self::$variant $(($details))? $({ $($field),* })? => {
                        $(<$type as Record>::put($details, at, row, children);)?
                        $($($field.put(row);)*)?
                    }
                )* }
            }

            fn take<E: From<Unreadable>>(
                kind: EventKind,
                at: Timestamp,
                source: &mut dyn Source<E>,
            ) -> Result<Self, E> {
                Ok(match kind { $(
                    EventKind::$variant => {
                        $(Self::$variant(<$type as Record>::take(at, source)?))?
                        $(Self::$variant { $($field: Columns::take(&mut Reader(&mut *source))?),* })?
                    }
                )* })
            }
        }
    };
}

events! {
    /// κ(r), periodically.
    Robot(context: RobotContext) = "robot", about [Node(&context.robot)], text text::robot(context);
    /// ι(R), periodically.
    Radio(context: RadioContext) = "radio", about [Node(&context.radio_unit)], text text::radio(context);
    /// d, λ and conditions of a link, periodically and at every change.
    Link(context: LinkContext) = "link", about [Link(&context.link)], text text::link(context);
    /// A VNF runs on another node now, or on others; a(n) changed.
    Placement(placement: Placement) = "placement", about [Vnf(&placement.vnf)],
        text format!("{} on {}", placement.vnf, placement.node);
    /// One direction of a virtual link is carried by other links now; a(n1,n2) changed.
    VirtualLink(mapping: VirtualLinkMapping) = "virtual_link", about [Vnf(&mapping.from), Vnf(&mapping.to)],
        text text::virtual_link(mapping);
    /// A service time was measured.
    ServiceTime(sample: ServiceTime) = "service_time", about [Node(&sample.robot)], text text::service_time(sample);
    /// A robot changed its radio unit.
    Handover(handover: Handover) = "handover", about [Node(&handover.robot)], text text::handover(handover);
    /// A robot has no radio unit any more.
    Detached {
        /// The robot.
        robot: NodeId => "robot",
        /// The radio unit that it lost.
        from: NodeId => "from_radio_unit",
    } = "detached", about [Node(robot), Node(from)], text format!("{robot} lost {from}");
    /// A robot finished a scan: its attachments' signals are fresh.
    Scanned {
        /// The robot.
        robot: NodeId => "robot",
    } = "scanned", about [Node(robot)], text robot.to_string();
    /// A VNF's process began, ended or was begun again.
    Vnf(event: VnfEvent) = "vnf", about [Vnf(&event.vnf), Node(&event.node)], text text::vnf(event);
    /// A plug-in gave an instruction.
    Decision(decision: Decision) = "decision", about [Plugin(&decision.plugin)], text text::decision(decision);
    /// A plug-in was cut off.
    PluginFault {
        /// The plug-in.
        plugin: PluginId => "plugin",
        /// Reason why it was cut off.
        reason: String => "reason",
    } = "plugin_fault", about [Plugin(plugin)], text format!("{plugin}: {reason}");
    /// The emulator's lateness since the run began, periodically.
    Lateness(lateness: Lateness) = "lateness", about [Emulator()], text format!(
        "median {:.1} µs, p99 {:.1} µs, max {:.1} µs of {} frames",
        lateness.p50_us, lateness.p99_us, lateness.max_us, lateness.frames
    );
    /// A robot reached the end of its walk.
    WalkFinished {
        /// The robot.
        robot: NodeId => "robot",
    } = "walk_finished", about [Node(robot)], text robot.to_string();
    /// A message for the user that no other event carries.
    Notice {
        /// The message.
        message: String => "message",
    } = "notice", about [], text message.clone();
    /// A robot rejected answers since it was told last; once a second at most.
    AnswersRejected(counts: AnswersRejected) = "answers_rejected", about [Node(&counts.robot)],
        text text::answers_rejected(counts);
    /// The state of a robot's goal changed.
    Goal(goal: GoalEvent) = "goal", about [Node(&goal.robot)], text text::goal(goal);
    /// A sensor that a robot declares was read, at its rate.
    Sensor(reading: SensorReading) = "sensor", about [Node(&reading.robot)], text text::sensor(reading);
    /// CPU, memory and interfaces of a node's machine, periodically.
    Machine(context: MachineContext) = "machine", about [Node(&context.node)], text text::machine(context);
    /// A robot answered its radio unit's suggestion to move to another one ([`Instruction::Suggest`]).
    SuggestionAnswered {
        /// The robot.
        robot: NodeId => "robot",
        /// The radio unit that was suggested.
        radio_unit: NodeId => "radio_unit",
        /// Status of the BSS transition (IEEE 802.11-2020, table 9-428): 0 if the robot moves there; otherwise it stays, e.g. 7
        /// if it hears the radio unit too weakly.
        status: u8 => "status",
    } = "suggestion_answered", about [Node(robot)], text match status {
        0 => format!("{robot} moves to {radio_unit}"),
        _ => format!("{robot} does not move to {radio_unit}: status {status}"),
    };
    /// Age of contexts of one kind that the decision before it was taken on.
    Staleness(staleness: Staleness) = "staleness", about [Plugin(&staleness.plugin)],
        text text::staleness(staleness);
    /// A robot's brain requested a federation, because the robot's walk is about to leave the coverage of its domain.
    FederationRequested {
        /// The robot.
        robot: NodeId => "robot",
    } = "federation_requested", about [Node(robot)], text robot.to_string();
}

impl EventKind {
    /// Kinds whose old samples are rolled up: embeddings that are sampled all the time. Events of other kinds are all
    /// kept.
    pub const SAMPLED: [Self; 5] = [Self::Robot, Self::Radio, Self::Link, Self::Sensor, Self::Machine];

    /// Returns the kind of context, if samples of this kind are rolled up.
    pub fn context(self) -> Option<ContextKind> {
        ContextKind::ALL.into_iter().find(|kind| kind.as_str() == self.as_str())
    }
}

impl FromStr for EventKind {
    type Err = InvalidKind;
    fn from_str(name: &str) -> Result<Self, InvalidKind> {
        let found = Self::ALL.into_iter().find(|k| k.as_str() == name);
        found.ok_or_else(|| InvalidKind(name.chars().take(60).collect()))
    }
}

/// A text that names no kind.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a kind of event; one of {list}", list = EventKind::ALL.map(EventKind::as_str).join(", "))]
pub struct InvalidKind(String);

/// A part of the graph's embedding. Each of its events is its state until the next one.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Series {
    /// The kind of its events.
    pub kind: EventKind,
    /// The values of [`Table::series`], filled up with [`SeriesPart::None`].
    pub parts: [SeriesPart; 2],
}

impl Series {
    /// Returns the series of a kind with this name.
    pub fn new(kind: EventKind, first: impl Into<SeriesPart>, second: impl Into<SeriesPart>) -> Self {
        Self { kind, parts: [first.into(), second.into()] }
    }

    /// Returns the kinds whose events make series.
    pub fn kinds() -> impl Iterator<Item = EventKind> {
        EventKind::ALL.into_iter().filter(|kind| !kind.table().series.is_empty())
    }
}
