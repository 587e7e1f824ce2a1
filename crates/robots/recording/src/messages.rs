//! `cotorra_msgs`: messages for embeddings and events of a testbed that ROS has none for. Field names include units.

use cotorra_ros_messages::{Header, message};

message! {
    /// φ(r,R), and the signal of that radio unit.
    #[derive(Default)]
    pub struct Attachment = "cotorra_msgs" / "Attachment" {
        /// The radio unit, R.
        radio_unit: String,
        /// Whether φ(r,R) = 1.
        attached: bool,
        /// Received signal, dBm; NaN before the first scan.
        signal_dbm: f64,
    }
}

message! {
    /// κ(r): the attachments of a robot, and sensor values without a standard message.
    #[derive(Default)]
    pub struct RobotContext = "cotorra_msgs" / "RobotContext" {
        /// Time; the frame of the robot's base.
        header: Header,
        /// The robot, r.
        robot: String,
        /// The radio unit that it is attached to; empty if none.
        attached_to: String,
        /// One for each radio unit of its network.
        attachments: Vec<Attachment>,
        /// The next waypoint of its walk, from 0.
        waypoint: u32,
        /// Whether it touches something.
        bumper: bool,
        /// Distance of the nearest obstacle in the lidar's view, metres; NaN if none is in range.
        nearest_obstacle_m: f64,
        /// Problems, for people; empty if there are none.
        health: Vec<String>,
        /// Speed limit by an instruction, m/s; NaN if there is none.
        speed_limit_mps: f64,
        /// Distance between the pose of localization and the true one, metres; NaN where nobody localizes it or nobody knows
        /// the truth.
        localization_error_m: f64,
    }
}

message! {
    /// Time from the emission of a position packet to the reception of the navigation packet that answers it.
    #[derive(Default)]
    pub struct ServiceTime = "cotorra_msgs" / "ServiceTime" {
        /// Time of the emission; the frame of the robot's base.
        header: Header,
        /// The service.
        service: String,
        /// The robot.
        robot: String,
        /// Number of the position packet.
        sequence: u32,
        /// Milliseconds; NaN if no answer came in time.
        service_time_ms: f64,
        /// The radio unit that the robot was attached to; empty if none.
        attached_to: String,
        /// The node that ran the navigation VNF.
        server: String,
    }
}

message! {
    /// A finished change of attachment.
    #[derive(Default)]
    pub struct Handover = "cotorra_msgs" / "Handover" {
        /// Time; the frame of the robot's base.
        header: Header,
        /// The robot.
        robot: String,
        /// The previous radio unit; empty if none.
        from_radio_unit: String,
        /// The new radio unit.
        to_radio_unit: String,
        /// Whether fast transition was used.
        fast: bool,
        /// Time without frames, milliseconds.
        gap_ms: f64,
    }
}

message! {
    /// A station of a radio unit.
    #[derive(Default)]
    pub struct Station = "cotorra_msgs" / "Station" {
        /// The robot.
        robot: String,
        /// Signal received from it, dBm.
        signal_dbm: f64,
        /// PHY rate to it, bit/s.
        downlink_bps: f64,
        /// PHY rate from it, bit/s.
        uplink_bps: f64,
    }
}

message! {
    /// ι(R): the state of a radio unit.
    #[derive(Default)]
    pub struct RadioContext = "cotorra_msgs" / "RadioContext" {
        /// Time of the message.
        header: Header,
        /// The radio unit, R.
        radio_unit: String,
        /// Channel number.
        channel: u8,
        /// Share of the last second in which the channel was busy, 0 to 1; NaN if a real radio's driver does not report it.
        load: f64,
        /// Its stations.
        stations: Vec<Station>,
    }
}

message! {
    /// d, λ and conditions of one direction of a link.
    #[derive(Default)]
    pub struct LinkContext = "cotorra_msgs" / "LinkContext" {
        /// Time of the message.
        header: Header,
        /// The link.
        link: String,
        /// `forward`, which on a wireless link is from the robot up to the radio unit, or `backward`.
        direction: String,
        /// d: mean delay of packets over the last second, with queueing; NaN if none crossed.
        delay_ms: f64,
        /// λ: throughput of the last second, bit/s.
        throughput_bps: f64,
        /// The most packets that waited in its queue at a time over the last second; NaN where the queue cannot be seen.
        queued_packets: f64,
        /// Mean delay of its probes. Like jitter and age, NaN if none returned.
        probed_delay_ms: f64,
        /// Mean difference between the delays of consecutive probes.
        probed_jitter_ms: f64,
        /// Age of the last returned probe.
        probed_delay_age_ms: f64,
        /// Share of lost probes, 0 to 1. Like its age, NaN if it is unknown.
        probed_loss: f64,
        /// Age of the last probe, by emission, whose fate is known.
        probed_loss_age_ms: f64,
        /// λ by the last test. Like the two below, NaN before the first.
        tested_throughput_bps: f64,
        /// Offered rate of the test.
        tested_offered_bps: f64,
        /// Age of the test, since its end.
        tested_age_ms: f64,
        /// ψ; 1 leaves it alone.
        delay_scale: f64,
        /// δ; 1 leaves it alone.
        drop_scale: f64,
        /// The requested delay.
        asked_delay_ms: f64,
        /// The effective delay: the requested one, scaled.
        effective_delay_ms: f64,
        /// Delivered packets. Like all below, since the run began.
        packets: u64,
        /// Delivered bytes.
        bytes: u64,
        /// Packets lost by the loss model, or by the radio after its last retry.
        lost: u64,
        /// Packets dropped by the queue: because it was full, or by its discipline.
        overflowed: u64,
        /// Packets that arrived twice.
        duplicated: u64,
        /// Packets with a flipped bit.
        corrupted: u64,
    }
}

message! {
    /// a(n): the node of a VNF from now on, and those of its further instances.
    #[derive(Default)]
    pub struct Placement = "cotorra_msgs" / "Placement" {
        /// Time of the message.
        header: Header,
        /// The VNF.
        vnf: String,
        /// The node.
        node: String,
        /// Nodes of further instances.
        others: Vec<String>,
    }
}

message! {
    /// a(n1,n2): these hardware links carry one direction of a virtual link from now on.
    #[derive(Default)]
    pub struct VirtualLink = "cotorra_msgs" / "VirtualLink" {
        /// Time of the message.
        header: Header,
        /// The sending VNF.
        from_vnf: String,
        /// The receiving VNF.
        to_vnf: String,
        /// The links, in order.
        links: Vec<String>,
        /// Reason of the path: `shortest`, `mapped` or `fallback`.
        path: String,
    }
}

message! {
    /// An instruction of a plug-in, its reason and its result.
    #[derive(Default)]
    pub struct Decision = "cotorra_msgs" / "Decision" {
        /// Time of the message.
        header: Header,
        /// The plug-in.
        plugin: String,
        /// The instruction: JSON, as in the HTTP API.
        instruction: String,
        /// The plug-in's reason; may be empty.
        reason: String,
        /// Reason of the rejection; empty if it was carried out.
        refused: String,
    }
}

message! {
    /// Lateness of delivered frames against their due times, since the run began.
    #[derive(Default)]
    pub struct Lateness = "cotorra_msgs" / "Lateness" {
        /// Time of the message.
        header: Header,
        /// Delivered frames.
        frames: u64,
        /// Median, µs.
        p50_us: f64,
        /// 99th percentile, µs.
        p99_us: f64,
        /// Worst, µs.
        max_us: f64,
    }
}
