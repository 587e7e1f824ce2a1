#![doc = include_str!("../README.md")]
//!
//! # What frames meet
//!
//! - **Forwarding.** Unicast takes the path of least delay to the host that has the address, worked out anew when
//!   delays or attachments change. Hosts have the addresses of [`HostAddress`](cotorra_graph::HostAddress); others
//!   that they use are learnt from what they send. Broadcast, multicast and unknown addresses reach every other host
//!   once, along a spanning tree. Robots and servers never forward.
//! - **Wired links.** Each direction is a drop-tail queue, a transmitter (fixed rate or Mahimahi trace) and a line;
//!   behind the transmitter come loss, corruption, duplication, and delay with jitter that keeps order.
//! - **The air.** A robot's frames cross it to and from the radio unit that it is attached to, which takes airtime,
//!   retries, and a handover's gap.
//! - **Paths.** Frames take the path of least delay, or one that they are [pinned](Fabric::pin) to.
//! - **Measurements.** [Probes](Fabric::probe_links) and [tests](Fabric::test_throughput) of wired links are packets
//!   like others on the way, are for no host, and in no counter.
//! - **Flows.** The [service times of flows](Fabric::measure_flows) are measured where frames enter and leave.
//! - **Offloads.** A super-packet stays whole where nothing on its way needs packets, and counts as its packets
//!   everywhere; random impairments, rates below 1 Gbit/s, traces and the air cut it. A checksum that was left undone
//!   stays so, unless the packet is corrupted.
//!
//! All chance comes from one seed, split by link, robot and purpose: the same graph and seed, driven the same way,
//! give the same bytes.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod balance;
mod error;
mod fabric;
mod flows;
mod frame;
mod impairment;
mod lateness;
mod link_tests;
mod meter;
mod pipe;
mod pool;
mod port;
mod radio;
mod random;
mod routes;
mod settings;
mod timers;
mod transmitter;

pub use balance::Balance;
pub use error::{GraphError, NoPath};
pub use fabric::{Drops, Fabric};
pub use frame::{Checksum, Frame, Malformed, Offload, Segmentation, SegmentationKind};
pub use lateness::Histogram;
pub use link_tests::{Crossing, MEASURING_ETHERTYPE, ThroughputTests, WireProbes};
pub use port::PortId;
pub use settings::{Carries, FabricError};
