//! The emulated network: everything between the hosts of a [hardware graph](cotorra_graph::HardwareGraph), as a
//! state machine without a clock and without sockets.
//!
//! Hosts (robots, radio units, servers) are ports; switches, the forwarding of radio units, links and the air are
//! state inside. Whoever drives a [`Fabric`] does three things, in real or in virtual time:
//!
//! 1. [`push`](Fabric::push) each frame that a host sends, with the time,
//! 2. [`poll`](Fabric::poll) after the last of them and at the deadline that the last poll gave: it hands out what is
//!    due,
//! 3. [`next_event`](Fabric::next_event) until there is none.
//!
//! All else that happens to a network is a call, too: links [change](Fabric::change), robots
//! [move](Fabric::move_robot), [scan](Fabric::scan) and [attach](Fabric::attach) themselves elsewhere. Time is an
//! argument and never falls; a call with an earlier time counts as one with the latest so far. A frame goes on as of
//! the time that it was due, however late the poll that notices, so that lateness never adds up over hops, and
//! [`Fabric::lateness`] tells how much there was of it.
//!
//! ```
//! use cotorra_fabric::{Fabric, Frame};
//! use cotorra_graph::{ConditionChange, HostAddress, Timestamp, testbed_file};
//!
//! let testbed = testbed_file::parse("lab.yaml", "
//! name: lab
//! nodes:
//!   edge: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
//!   lan: { kind: switch }
//!   cloud: { kind: server, tier: cloud, cpus: 4, memory: 8 GB }
//! links:
//!   - { ends: [edge, lan], delay: 1 ms }
//!   - { ends: [lan, cloud], delay: 9 ms, rate: 10 Mbit/s }
//! ", ".".as_ref())?;
//! let mut fabric = Fabric::new(&testbed.graph, testbed.seed)?;
//! let [edge, cloud] = ["edge", "cloud"].map(|name| fabric.port(&name.parse().unwrap()).unwrap());
//!
//! // An Ethernet frame of 1250 bytes: 1 µs at the 10 Gbit/s that the first link has by default, 1 ms on the second.
//! let mut bytes = fabric.buffer(1250);
//! bytes.extend(HostAddress::of(cloud.0).mac);
//! bytes.extend(HostAddress::of(edge.0).mac);
//! bytes.resize(1250, 0);
//! let mut now = Timestamp::ZERO;
//! fabric.push(now, edge, Frame::new(bytes));
//!
//! // A link changes in place while the frame is on its way there.
//! let slower = ConditionChange { delay_ms: Some(29.0), ..ConditionChange::default() };
//! fabric.change(now, &"lan-cloud".parse()?, None, &slower)?;
//!
//! // Virtual time jumps from deadline to deadline; a data plane would wait for them.
//! let mut arrived = Vec::new();
//! while let Some(deadline) = fabric.poll(now, &mut |port, frame| arrived.push((now, port, frame))) {
//!     now = deadline;
//! }
//! let (at, port, frame) = arrived.pop().unwrap();
//! assert_eq!((at, port), (Timestamp::from_nanos(31_001_000), cloud));
//! fabric.recycle(frame);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
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
mod checksum;
mod error;
mod fabric;
mod flows;
mod frame;
mod impairment;
mod lateness;
mod meter;
mod pipe;
mod pool;
mod port;
mod probes;
mod radio;
mod random;
mod routes;
mod settings;
mod throughput_tests;
mod timers;
mod transmitter;
mod wire_probes;

pub use balance::Balance;
pub use error::GraphError;
pub use fabric::{Drops, Fabric, NoPath};
pub use frame::{Checksum, Frame, MEASURING_ETHERTYPE, Malformed, Offload, Segmentation, SegmentationKind};
pub use lateness::Histogram;
pub use port::PortId;
pub use probes::Crossing;
pub use settings::{Carries, FabricError};
pub use throughput_tests::ThroughputTests;
pub use wire_probes::WireProbes;
