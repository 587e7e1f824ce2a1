//! The hardware graph G, its embeddings, services and KPIs, the events that happen to them, and the
//! testbed file that describes it all. Pure data: no clock, no sockets, nothing asynchronous.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod accelerator;
mod access;
mod active;
mod axis;
mod border;
mod bounds;
mod candidate;
mod computing;
mod conditions;
mod container;
mod containers;
mod contention;
mod context;
mod decision;
mod distance;
mod driver;
mod event;
mod exposure;
mod figure;
mod fixed_rate;
mod flow;
mod goal;
mod hardware;
mod id;
mod instruction;
mod jitter;
mod link_figures;
mod lost_at;
mod machine_context;
mod map;
mod medium;
mod natural;
mod nodes;
mod part;
mod plugin_distance;
mod power;
mod propagation;
mod queue;
mod real;
mod real_machine;
pub mod record;
mod reservation;
mod ros1_environment;
mod routing;
mod schedule;
mod search;
mod sensor;
mod service;
mod staleness;
mod state_transfer;
mod testbed;
mod time_parts;
mod traffic;
mod units;
mod vnf_event;
mod walls;
mod wifi_software;

pub use accelerator::{Accelerators, BatchTimes, Batching, Chunk, Policy, PolicyServer};
pub use access::{AccessPoint, FtKey, InvalidFtKey};
pub use active::{Probed, Probing, Tested, ThroughputTest};
pub use axis::Axis;
pub use border::Border;
pub use bounds::TooLong;
pub use candidate::{Candidate, candidates};
pub use computing::{Computing, Demand, InvalidMeasuredTimes, MeasuredTimes, Scheduling, WarmUp};
pub use conditions::{ConditionChange, Conditions, InvalidTrace, Loss, Rate, Scale, Trace, TraceName};
pub use container::{EngineKind, Image, ListenPort, Pull, Transport, Volume};
pub use containers::Containers;
pub use contention::{
    Access, Contention, Edca, Interferer, InterfererKind, PowerSave, Presence, RateControl,
};
pub use context::{
    AnswersRejected, Attachment, Handover, InstancePath, Lateness, LinkContext, LinkCounters, PathKind,
    Placement, Pose, PoseSource, RadioContext, RobotContext, RobotFault, SensorData, ServiceTime,
    StationContext, StationCounts, Velocity, VirtualLinkMapping,
};
pub use decision::Decision;
pub use driver::{
    Driver, Kobuki, Offer, Rmw, Ros, Ros1, Ros2, RosMaster, RosNetwork, RosTopics, Rplidar, SensorMessage,
    SensorTopic, ros_node_name,
};
pub use event::{Event, EventKind, InvalidKind, Series, Stamped};
pub use exposure::{GeoOrigin, InvalidIpNetwork, IpNetwork, WaisSettings};
pub use figure::{
    Better, Bound, Declared, FIGURES, Figure, FigureKind, InvalidBound, InvalidFigure, LatenessQuantity,
    LinkQuantity, MachineQuantity, Measure, RobotQuantity, Statistic, Total, Unit,
};
pub use fixed_rate::FixedRate;
pub use flow::{Flow, FlowId, FlowProtocol};
pub use goal::{GoalEvent, GoalState};
pub use hardware::{
    BackgroundScan, Band, Capacity, ChannelWidth, Direction, Fading, Frames, GapPolicy, GuardInterval,
    HandoverTimes, HardwareGraph, HostAddress, Link, Node, NodeKind, PassiveVisits, PathLoss, Phase,
    RadioUnit, Roaming, Robot, RobotClock, RobotModel, ScanVisits, Server, Shadowing, Tier, WifiStandard,
    WirelessNetwork,
};
pub use id::{
    AgentId, ComponentId, DomainId, InvalidId, LinkId, NodeId, PluginId, SensorId, ServiceId, TrafficId,
    VnfId,
};
pub use instruction::Instruction;
pub use jitter::{Correlation, CorrelationTime, InvalidCorrelation, Jitter, JitterDistribution};
pub use link_figures::{
    DelayFigure, DelayFigures, FigureSource, LinkFigures, ThroughputFigure, ThroughputFigures, available_bps,
};
pub use lost_at::{LostAt, LostCause};
pub use machine_context::{
    CpuContext, InterfaceContext, InterfaceTraffic, LoadAverage, MachineContext, MemoryContext, ReadingTime,
    WifiChannel, WifiContext, WifiRole, WifiStation,
};
pub use map::{Cell, OccupancyGrid};
pub use medium::{Medium, NotOffered};
pub use natural::Natural;
pub use nodes::{InvalidNodes, Nodes};
pub use part::Part;
pub use plugin_distance::{CpuFactor, DecidesIn, PluginDistance, Way};
pub use power::{RadioPower, RobotPower, ServerPower};
pub use queue::{Codel, FqCodel, InvalidDiscipline, Pie, QueueDiscipline, QueueLimit, Red, RedThresholds};
pub use real::{RealLink, RealPort};
pub use real_machine::{Gateway, Machine, Reached, RealRadio, RealServer};
pub use reservation::{MapReservation, Reservations};
pub use routing::{Edge, Route, Topology};
pub use schedule::{Scheduled, Script, When};
pub use search::{Arrival, cheapest_paths, steps_back};
pub use sensor::{Camera, DataFormat, LargeData, Sensor, SensorKind, SensorReading};
pub use service::{Granted, Kpis, LinuxCapability, Program, Requests, Rights, Service, VirtualLink, Vnf};
pub use staleness::{ContextKind, Staleness};
pub use state_transfer::{PreCopy, StateTransfer, TransferMethod};
pub use testbed::{
    BUNDLED_PLUGINS, Emulation, InstructionLimit, PluginProgram, PluginSpec, Retention, Retentions, Testbed,
    Walk,
};
pub use time_parts::{LinkTime, TimeParts};
pub use traffic::{
    Arrivals, Begin, CongestionControl, DatagramSize, Load, OnOff, OverLink, RecordedDatagram, Replay, Sends,
    TrafficSource, Transfers, UdpRate,
};
pub use units::{BitRate, Dbm, Position, Probability, Timestamp, millis, wrapped_angle};
pub use vnf_event::{VnfEvent, VnfState};
pub use walls::{WallLoss, Walls};
pub use wifi_software::{Protection, RadioKind, Security, WifiSoftware};
