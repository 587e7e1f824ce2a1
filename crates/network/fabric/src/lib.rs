#![doc = include_str!("../README.md")]
//!
//! # Model
//!
//! - **Time.** Every call takes the time. It never falls: a call with an earlier time counts as one with the latest so
//!   far. A frame moves on at its due time, however late the poll that notices, so that lateness does not add up over
//!   hops. [`Fabric::lateness`] reports it.
//! - **Forwarding.** Unicast frames take the path of least delay to the host that has the address, or one that they are
//!   [pinned](Fabric::pin) to. Paths are worked out anew when delays or attachments change. Hosts have the addresses of
//!   [`HostAddress`](cotorra_graph::HostAddress), and send from these only, unless they have no
//!   [port security](Fabric::disable_port_security). The fabric learns other addresses from the frames that come from them.
//!   Broadcast, multicast and frames to unknown addresses reach every other host once, along a spanning tree. Robots and
//!   servers never forward.
//! - **Wired links.** Each direction is a queue (drop tail, CoDel, FQ-CoDel, PIE or RED), a transmitter (fixed rate or
//!   Mahimahi trace) and a line.
//!   Packets that leave the transmitter meet loss, corruption, duplication, and delay with jitter that keeps order.
//!   Links [change](Fabric::change) in place. A [reservation](Reservation) of a pinned path has a queue of its own there.
//! - **The air.** A robot's frames cross the air to and from the radio unit that it is attached to. Airtime, retries and
//!   a handover's gap delay them. Robots [move](Fabric::move_robot), [scan](Fabric::scan) and
//!   [attach](Fabric::attach) to other radio units.
//! - **Other cores.** A robot may [depart](Fabric::depart) to a radio unit that another core emulates. Its packets then
//!   leave this fabric, and those to it leave at a border. The other core returns them [here](Fabric::arrive).
//! - **Other radios.** Radios that are not the fabric's, such as those of a kernel, use [antennas](Fabric::lend_antenna)
//!   of robots and radio units. Their [frames](Fabric::transmit) contend, fade and collide as all others.
//! - **Measurement.** The packets of [probes](Fabric::probe_links) and [throughput tests](Fabric::test_throughput) cross
//!   links as others do. They reach no host and are in no counter. The [service times of flows](Fabric::measure_flows)
//!   are measured where frames enter and leave. [Followed](Fabric::follow) frames carry the time on each link;
//!   others carry no trace.
//! - **Taps.** [Readers](Fabric::tap) see the packets that cross the links they name. Without any, this costs nothing.
//! - **Offloads.** A super-packet stays whole where no link on its way needs single packets; all counters count its
//!   packets. Random impairments, rates below 1 Gbit/s, traces, queues that are not drop tail, reservations, and the air cut it. A
//!   checksum left to do stays so, unless the packet is corrupted.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod balance;
mod error;
mod fabric;
mod flows;
mod following;
mod frame;
mod impairment;
mod lateness;
mod link_tests;
mod meter;
mod pipe;
mod pool;
mod port;
mod port_security;
mod queue;
mod radio;
mod routes;
mod settings;
mod tap;
mod timers;
mod trace;
mod transmitter;

pub use balance::Balance;
pub use error::{GraphError, NoPath};
pub use fabric::{Departure, Drops, Fabric, ForgedSources, PinnedPath, Reservation};
pub use following::{Datagrams, Followed, FollowedReader, Progress, RoundTrip, Trip};
pub use frame::{Checksum, Frame, Malformed, Offload, Segmentation, SegmentationKind};
pub use lateness::Histogram;
pub use link_tests::{Crossing, MEASURING_ETHERTYPE, ThroughputTests, WireProbes};
pub use port::PortId;
pub use port_security::ForgedFrames;
pub use radio::{
    Airtime, Antenna, Association, Category, ChannelWidth, PhyRate, RateTries, Receiver, Report,
    Transmission, sensitivity,
};
pub use settings::{Carries, FabricError};
pub use tap::{Passage, TapError, TapReader};
