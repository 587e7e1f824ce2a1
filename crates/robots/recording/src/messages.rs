//! `cotorra_msgs`: the embeddings and events of a testbed. Units stand in the names of fields.

use cotorra_ros_messages::{Header, message};

message! {
    /// φ(r,R), and what a robot knows of that radio unit.
    #[derive(Default)]
    pub struct Attachment = "cotorra_msgs" / "Attachment" {
        /// R.
        radio_unit: String,
        /// φ(r,R) = 1.
        attached: bool,
        /// Received signal, dBm; NaN before the first scan.
        signal_dbm: f64,
    }
}

message! {
    /// κ(r): the attachments of a robot, and what of its sensors no standard message tells.
    #[derive(Default)]
    pub struct RobotContext = "cotorra_msgs" / "RobotContext" {
        /// When; the robot's base.
        header: Header,
        /// r.
        robot: String,
        /// The radio unit that it is attached to; empty if there is none.
        attached_to: String,
        /// One for each radio unit of its network.
        attachments: Vec<Attachment>,
        /// The next waypoint of its walk, from 0.
        waypoint: u32,
        /// Whether it touches something.
        bumper: bool,
        /// Nearest thing that its lidar sees, metres; NaN if nothing is in range.
        nearest_obstacle_m: f64,
        /// What is wrong with it, for people; empty if nothing is.
        health: Vec<String>,
        /// The speed, m/s, that an instruction limits it to; NaN if none does.
        speed_limit_mps: f64,
    }
}

message! {
    /// From the emission of a position packet to the reception of the navigation packet that answers it.
    #[derive(Default)]
    pub struct ServiceTime = "cotorra_msgs" / "ServiceTime" {
        /// When the position packet was emitted; the robot's base.
        header: Header,
        /// The service.
        service: String,
        /// The robot.
        robot: String,
        /// Number of the position packet.
        sequence: u32,
        /// Milliseconds; NaN if no answer came in time.
        service_time_ms: f64,
        /// The radio unit that the robot was attached to; empty if there was none.
        attached_to: String,
        /// The node that ran the navigation VNF.
        server: String,
    }
}

message! {
    /// A finished change of attachment.
    #[derive(Default)]
    pub struct Handover = "cotorra_msgs" / "Handover" {
        /// When; the robot's base.
        header: Header,
        /// The robot.
        robot: String,
        /// The radio unit before; empty if there was none.
        from_radio_unit: String,
        /// The radio unit after.
        to_radio_unit: String,
        /// Whether fast transition was used.
        fast: bool,
        /// How long no frame could pass, milliseconds.
        gap_ms: f64,
    }
}

message! {
    /// What a radio unit knows of one station.
    #[derive(Default)]
    pub struct Station = "cotorra_msgs" / "Station" {
        /// The robot.
        robot: String,
        /// Signal received from it, dBm.
        signal_dbm: f64,
        /// PHY rate to it, Mbit/s.
        downlink_bps: f64,
        /// PHY rate from it, Mbit/s.
        uplink_bps: f64,
    }
}

message! {
    /// ι(R): what a radio unit knows.
    #[derive(Default)]
    pub struct RadioContext = "cotorra_msgs" / "RadioContext" {
        /// When.
        header: Header,
        /// R.
        radio_unit: String,
        /// Channel number.
        channel: u8,
        /// Share of the last second in which the channel was busy, 0 to 1.
        load: f64,
        /// Its stations.
        stations: Vec<Station>,
    }
}

message! {
    /// d, λ and conditions of one direction of a link.
    #[derive(Default)]
    pub struct LinkContext = "cotorra_msgs" / "LinkContext" {
        /// When.
        header: Header,
        /// Which link.
        link: String,
        /// `forward`, which on a wireless link is from the robot up to the radio unit, or `backward`.
        direction: String,
        /// d: mean time that packets took over the last second, queueing included; NaN if none crossed.
        delay_ms: f64,
        /// λ: what crossed over the last second, bit/s.
        throughput_bps: f64,
        /// Mean delay of its probes; NaN if none came back, as the jitter and its age.
        probed_delay_ms: f64,
        /// Mean difference of the delays of two probes in a row.
        probed_jitter_ms: f64,
        /// How long before this was told the latest probe came back.
        probed_delay_age_ms: f64,
        /// Share of its probes that got lost, 0 to 1; NaN if it is not known, as its age.
        probed_loss: f64,
        /// How long before this was told the latest probe was sent of which it is known.
        probed_loss_age_ms: f64,
        /// λ as its last test told; NaN before the first, as the two below.
        tested_throughput_bps: f64,
        /// At which rate the test sent.
        tested_offered_bps: f64,
        /// How long before this was told the test ended.
        tested_age_ms: f64,
        /// ψ; 1 leaves it alone.
        delay_scale: f64,
        /// δ; 1 leaves it alone.
        drop_scale: f64,
        /// The delay that it was asked for.
        asked_delay_ms: f64,
        /// The delay that it has: what was asked, scaled.
        effective_delay_ms: f64,
        /// Packets delivered since the run began, as all below.
        packets: u64,
        /// Bytes delivered.
        bytes: u64,
        /// Packets lost by the loss model, or by the radio after its last retry.
        lost: u64,
        /// Packets dropped at the tail of the queue.
        overflowed: u64,
        /// Packets that arrived twice.
        duplicated: u64,
        /// Packets with a flipped bit.
        corrupted: u64,
    }
}

message! {
    /// a(n): a VNF runs on this node from now on, and on these others if it has several instances.
    #[derive(Default)]
    pub struct Placement = "cotorra_msgs" / "Placement" {
        /// When.
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
        /// When.
        header: Header,
        /// From this VNF …
        from_vnf: String,
        /// … to this one …
        to_vnf: String,
        /// … over these links.
        links: Vec<String>,
        /// Why these: `shortest`, `mapped` or `fallback`.
        path: String,
    }
}

message! {
    /// What a plug-in asked for, why, and what came of it.
    #[derive(Default)]
    pub struct Decision = "cotorra_msgs" / "Decision" {
        /// When.
        header: Header,
        /// Which plug-in.
        plugin: String,
        /// What it asked for: JSON, as in the HTTP API.
        instruction: String,
        /// Why, in its words; may be empty.
        reason: String,
        /// Why it was refused; empty if it was done.
        refused: String,
    }
}

message! {
    /// How late the emulator delivered frames against what it was asked, since the run began.
    #[derive(Default)]
    pub struct Lateness = "cotorra_msgs" / "Lateness" {
        /// When.
        header: Header,
        /// Frames delivered.
        frames: u64,
        /// Median, µs.
        p50_us: f64,
        /// 99th percentile, µs.
        p99_us: f64,
        /// Worst, µs.
        max_us: f64,
    }
}
