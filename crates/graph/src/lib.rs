//! The hardware graph G, its embeddings, services and KPIs, the events that tell what happens to them, and the
//! testbed file that describes it all. Pure data: no clock, no sockets, nothing asynchronous.
#![forbid(unsafe_code)]

pub mod access;
pub mod active;
pub mod conditions;
pub mod context;
pub mod driver;
pub mod event;
pub mod exposure;
mod file;
pub mod flow;
pub mod goal;
pub mod hardware;
pub mod id;
pub mod map;
pub mod map_server;
pub mod medium;
mod nodes;
#[cfg(feature = "openapi")]
pub mod openapi;
mod propagation;
mod routing;
pub mod schedule;
pub mod seed;
pub mod sensor;
pub mod service;
pub mod testbed;
pub mod testbed_file;
pub mod units;
mod yaml;

pub use access::{AccessPoint, FtKey, InvalidFtKey};
pub use active::{Probed, Probing, Tested, ThroughputTest};
pub use conditions::{
    ConditionChange, Conditions, Jitter, JitterDistribution, Loss, QueueLimit, Rate, Scale, Trace,
};
pub use context::{
    AnswersRejected, Attachment, Handover, InstancePath, Lateness, LinkContext, LinkCounters, PathKind,
    Placement, Pose, PoseSource, RadioContext, RobotContext, RobotFault, SensorData, ServiceTime,
    StationContext, Velocity, VirtualLinkMapping,
};
pub use driver::{
    Driver, Offer, Rmw, Ros, Ros1, Ros2, RosMaster, RosNetwork, RosTopics, SensorMessage, SensorTopic,
    ros1_environment,
};
pub use event::{Decision, Event, Instruction, Stamped, VnfEvent, VnfState};
pub use exposure::{GeoOrigin, InvalidIpNetwork, IpNetwork, WaisSettings};
pub use flow::{Flow, FlowId, FlowProtocol};
pub use goal::{GoalEvent, GoalState};
pub use hardware::{
    Capacity, Direction, GapPolicy, HandoverTimes, HardwareGraph, HostAddress, Link, Machine, Node, NodeKind,
    PathLoss, RadioUnit, Reached, RealLink, Roaming, Robot, RobotModel, Server, Shadowing, Tier,
    WifiStandard, WirelessNetwork,
};
pub use id::{ComponentId, DomainId, LinkId, NodeId, PluginId, SensorId, ServiceId, VnfId};
pub use map::{Cell, OccupancyGrid};
pub use medium::{Medium, NotOffered};
pub use nodes::{InvalidNodes, Nodes};
pub use routing::Route;
pub use schedule::{Scheduled, Script, When};
pub use sensor::{Camera, DataFormat, LargeData, Sensor, SensorKind, SensorReading};
pub use service::{Granted, Kpis, LinuxCapability, Program, Requests, Rights, Service, VirtualLink, Vnf};
pub use testbed::{
    BUNDLED_PLUGINS, Emulation, PluginProgram, PluginSpec, Retention, Retentions, Testbed, Walk,
};
pub use units::{BitRate, Dbm, Position, Probability, Timestamp, millis};
pub use yaml::{Diagnostic, Diagnostics};
