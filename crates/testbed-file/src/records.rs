//! Records of a testbed file, key by key. The JSON Schema, and so editors, show the documentation here.

mod distributions;
mod power;
mod state;
mod traffic;

use std::{net::Ipv4Addr, time::Duration};

use cotorra_graph::{
    AgentId, BackgroundScan, BitRate, Bound, ChannelWidth, Correlation, DataFormat, Dbm, Direction, DomainId,
    Emulation, EngineKind, FixedRate, GapPolicy, GuardInterval, InstructionLimit, IpNetwork,
    JitterDistribution, LinkId, LinuxCapability, ListenPort, NodeId, Phase, PluginId, Position, Probability,
    Protection, Pull, QueueLimit, Rate, RateControl, Requests, Reservations, Roaming, RobotModel, RosNetwork,
    SensorId, ServiceId, Tier, TrafficId, VnfId, Volume, WifiStandard,
};

pub(crate) use self::{distributions::*, power::*, state::*, traffic::*};
use crate::{
    image::{Device, Reference},
    walls::WallLoss,
    yaml::{
        Angle, Bytes, Decibels, DecisionTime, Drift, Frequency, Metres, Span, Speed,
        decode::{Amount, Either, Spanned, Table, choice, record, tagged},
    },
};

record! {
    /// A testbed: a hardware graph, the services on it, and what moves and decides in it.
    TestbedRecord {
        /// Name, also of a run's folder.
        name: Spanned<String>,
        /// One sentence on it.
        description: String = "",
        /// Currency of all prices, such as `EUR`. With it, the report has a bill: docs/use/bill.md.
        currency: Option<Spanned<String>>,
        /// Seed of everything random; a run with the same seed is the same run.
        seed: u64 = 1,
        /// Emulator of the links in real time.
        emulation: Emulation = "fabric",
        /// How wired links keep the reservations that `map` makes: docs/use/plugins.md.
        reservations: Reservations = "counted",
        /// Engine that runs container images on nodes without an `engine` of their own: docs/use/containers.md.
        engine: EngineKind = "podman",
        /// Administrative domains. Without them there is one, `local`.
        domains: Vec<Spanned<DomainId>> = [],
        /// The map that robots move on: path of a ROS map_server YAML file, from this file's folder. Without one
        /// there is open space.
        map: Option<Spanned<String>>,
        /// Wireless networks by SSID.
        wireless: Table<String, WirelessRecord> = {},
        /// Robots, radio units, switches and servers by name.
        nodes: Table<NodeId, NodeRecord>,
        /// Wired links.
        links: Vec<LinkRecord> = [],
        /// Services that robots use, by name.
        services: Table<ServiceId, ServiceRecord> = {},
        /// Walks of robots.
        walks: Table<NodeId, WalkRecord> = {},
        /// Sources of traffic that need no program, by name: docs/use/traffic.md.
        traffic: Table<TrafficId, TrafficRecord> = {},
        /// Plug-ins that run with the testbed: a bundled one's name, or a mapping.
        plugins: Vec<Spanned<Either<String, PluginRecord>>> = [],
        /// The core, which collects contexts and carries out instructions.
        core: CoreRecord = {},
        /// The WLAN Access Information Service (ETSI GS MEC 028).
        wais: WaisRecord = {},
        /// Replayed conditions of links, in place of those at the links.
        conditions: ReplayRecord = {},
        /// Changes of links over time, or where a robot is.
        schedule: Vec<ScheduledRecord> = [],
        /// Probing of links, or `none`.
        probes: Either<ProbesWord, ProbesRecord> = {},
        /// Settings of its history.
        history: HistoryRecord = {},
        /// Where this core meets the cores of other domains: docs/use/federation.md.
        border: Option<BorderRecord>,
    }
}

impl TestbedRecord {
    /// Places of the graph's links in the file, in the graph's order.
    pub(crate) fn link_places(&self) -> impl Iterator<Item = &Span> {
        self.link_entries().map(|(_, place)| place)
    }

    /// Returns, for each link of the graph in order, the index of its entry under `links` and its place in the file.
    pub(crate) fn link_entries(&self) -> impl Iterator<Item = (usize, &Span)> {
        self.links.iter().enumerate().flat_map(|(entry, link)| {
            let ends = link.ends.value.iter().map(|end| match end {
                Either::Short(_) => 1,
                Either::Long(several) => several.len(),
            });
            let span = link.id.as_ref().map_or(&link.ends.span, |id| &id.span);
            std::iter::repeat_n((entry, span), ends.fold(1, usize::saturating_mul))
        })
    }
}

record! {
    /// Replayed conditions of links.
    ReplayRecord {
        /// A recorded run whose conditions links of the same names get, over time: the folder of a run or of an export,
        /// from this file's folder.
        replay: Option<Spanned<String>>,
    }
}

record! {
    /// A change of links that happens by itself, `at` a time or `when` a robot is somewhere.
    ScheduledRecord {
        /// Time since the run began.
        at: Option<Spanned<Duration>>,
        /// Place of a robot.
        when: Option<Spanned<WhenRecord>>,
        /// The links, by name; that of a wireless one is `ROBOT~RADIO_UNIT`.
        links: Spanned<Either<Spanned<LinkId>, Vec<Spanned<LinkId>>>>,
        /// One direction. Without it: both.
        direction: Option<Direction>,
        /// New conditions; those left out stay as they are.
        set: Spanned<ConditionsRecord>,
    }
}

record! {
    /// Place of a robot. The change happens each time the robot enters it.
    WhenRecord {
        /// The robot.
        robot: Spanned<NodeId>,
        /// Corners of a polygon.
        within: Spanned<Vec<Position>>,
    }
}

/// No probes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ProbesWord {
    None,
}

record! {
    /// Probing by STAMP (RFC 8762) of wired links, and of each robot's present wireless link.
    ProbesRecord {
        /// Time from one probe of a link to the next; longer where probes would take more than 1 % of its rate.
        interval: Spanned<Duration> = "500 ms",
        /// Time over which delay, jitter and loss are averaged.
        window: Spanned<Duration> = "10 s",
    }
}

record! {
    /// Settings of a history.
    HistoryRecord {
        /// Retention of samples, by embedding. Without it: for ever.
        retention: RetentionsRecord = {},
    }
}

record! {
    /// Retention of samples of each embedding. All other events are kept for ever.
    RetentionsRecord {
        /// Contexts of robots: poses, velocities, signals.
        robots: Option<RetentionRecord>,
        /// Contexts of radio units: channel, load, stations.
        radio_units: Option<RetentionRecord>,
        /// Delay, throughput and conditions of links.
        links: Option<RetentionRecord>,
        /// Readings of robots' sensors.
        sensors: Option<RetentionRecord>,
        /// Contexts of machines: CPU, memory, interfaces.
        machines: Option<RetentionRecord>,
    }
}

record! {
    /// Retention of samples, and of the points that they are rolled up to.
    RetentionRecord {
        /// Time for which samples are kept as recorded.
        raw: Duration,
        /// Then the samples of so much time become one point: count, least, greatest, mean and last. It divides a minute.
        step: Spanned<Duration> = "1 s",
        /// Time for which these points are kept, counted from when they were samples. Without it: for ever.
        keep: Option<Duration>,
    }
}

record! {
    /// Wireless network: the radio units of one SSID, and the robots that join it.
    WirelessRecord {
        /// Physical layer.
        standard: WifiStandard = "n",
        /// Width of its channels: 20 MHz, and 40 MHz from `n`, 80 MHz from `ac` on. A radio unit's `channel` is the primary one
        /// of 20 MHz.
        width: Spanned<ChannelWidth> = "20 MHz",
        /// Most spatial streams of a frame, 1 or 2 from `n` on. All its stations have as many antennas.
        streams: Spanned<u8> = 1,
        /// Guard interval between symbols: `400 ns` or `800 ns` for `n` and `ac`, `800 ns`, `1600 ns` or `3200 ns` for `ax`.
        guard_interval: Spanned<GuardInterval> = "800 ns",
        /// One-way delay of a small frame on an idle channel, its airtime included.
        delay: Duration = "1 ms",
        /// Highest rate of one station, whatever its signal. Without it, the signal alone decides.
        rate: Option<BitRate>,
        /// Frames that vanish though the air would deliver them: a share, or a mapping for losses in bursts.
        loss: Option<Either<Probability, LossRecord>>,
        /// Fast transition (IEEE 802.11r) in one mobility domain: a handover leaves the key handshakes out.
        fast_transition: bool = true,
        /// Mobility domain of its radio units.
        mobility_domain: u16 = 1,
        /// Path loss over distance.
        path_loss: PathLossRecord = { "model": "log_distance", "exponent": 3.0 },
        /// Attenuation by the walls of the map: the loss of each that the line between two antennas crosses, or a mapping.
        /// Without it, walls take nothing away: docs/reference/radio.md.
        walls: Option<Spanned<Either<WallLoss, WallsRecord>>>,
        /// Variation of the signal around the path loss.
        shadowing: ShadowingRecord = {},
        /// Fading of single frames by interference of paths: `rayleigh`, or a mapping. Without it, there is none:
        /// docs/reference/radio.md.
        fading: Option<Either<FadingWord, FadingRecord>>,
        /// Noise floor of a receiver: thermal noise over 20 MHz (-101 dBm) and a noise figure of 6 dB.
        noise_floor: Dbm = "-95 dBm",
        /// A robot that roams by signal changes when another radio unit is stronger by so much ...
        hysteresis: Decibels = "4 dB",
        /// ... for so long.
        time_to_trigger: Duration = "100 ms",
        /// Durations of a handover's phases.
        handover: HandoverRecord = {},
        /// Treatment of frames for a station that is off its channel.
        gap: GapPolicy = "hold",
        /// How senders share a channel: `edca`, a mapping with the settings of EDCA, or `turns`: docs/reference/radio.md.
        access: Spanned<Either<AccessWord, AccessRecord>> = "edca",
        /// What else sends on its channels, by name. Stations must contend.
        interference: Table<String, InterferenceRecord> = {},
        /// Software of its stations: the model, or hostapd and wpa_supplicant, on simulated radios of Linux or on hardware, which
        /// contend.
        wifi: Spanned<WifiWord> = "model",
        /// SSID of hostapd and wpa_supplicant, of 1 to 32 bytes. Without it: the network's name. The model has none.
        ssid: Option<Spanned<String>>,
        /// Security of hostapd and wpa_supplicant: `open`, `wpa2` or `wpa3`, or a mapping with a passphrase. The model has
        /// none.
        security: Either<SecurityWord, SecurityRecord> = "wpa2",
    }
}

/// Ways to share a channel whose settings are left as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum AccessWord {
    Turns,
    Edca,
}

/// The software of stations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WifiWord {
    Model,
    Hwsim,
    Hardware,
}

/// Security whose settings are left as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SecurityWord {
    Open,
    Wpa2,
    Wpa3,
}

/// The passphrase of networks whose file has none. Nobody else can hear them.
pub(crate) const USUAL_PASSPHRASE: &str = "an emulated network";

tagged! {
    /// Security of hostapd and wpa_supplicant.
    SecurityRecord by method {
        "wpa2" => Wpa2(Wpa2Record),
        "wpa3" => Wpa3(Wpa3Record),
    }
}

record! {
    /// WPA2-PSK.
    Wpa2Record {
        /// Protection of management frames (IEEE 802.11w).
        management_frames: Protection = "optional",
        ..secret: PassphraseRecord,
    }
}

record! {
    /// WPA3-SAE.
    Wpa3Record {
        ..secret: PassphraseRecord,
    }
}

record! {
    /// What stations have to know, and how they take it to the next radio unit.
    PassphraseRecord {
        /// Passphrase: 8 to 63 printable ASCII characters.
        passphrase: Spanned<String> = USUAL_PASSPHRASE,
        /// Whether a robot asks for fast transition by way of its present radio unit, instead of over the air.
        over_ds: bool = false,
    }
}

record! {
    /// Settings of EDCA (IEEE 802.11-2020, 10.23.2).
    AccessRecord {
        /// How stations choose their rates.
        rate_control: Either<RateControl, FixedRateRecord> = "minstrel",
        /// Whether frames for one receiver are sent together (A-MPDU). Without it: where the standard can, `n`, `ac`
        /// and `ax`.
        aggregation: Option<Spanned<bool>>,
        /// How stations sleep between beacons. Without it, they never do.
        power_save: Option<PowerSaveRecord>,
        /// Limit of the queue of each sender for one receiver and category, which drops at its tail, or a mapping with
        /// `drop_tail` or `fq_codel`. Without it: FQ-CoDel and shares of airtime as in Linux.
        queue: Option<Spanned<Either<QueueLimit, QueueRecord>>>,
    }
}

record! {
    /// A network without a rate control.
    FixedRateRecord {
        /// Rate of all data frames: `MCS 7` of `n`, `ac` and `ax`, or `24 Mbit/s` of `a` and `g`. An MCS of `n` includes the
        /// streams, eight for each; one of `ac` and `ax` goes with all streams of the network.
        fixed: Spanned<FixedRate>,
    }
}

record! {
    /// Sleep of stations between beacons, as Linux does it.
    PowerSaveRecord {
        /// Time without frames after which a station sleeps.
        idle: Spanned<Duration> = "100 ms",
        /// Beacons from one to the next after which group frames go to stations that sleep.
        dtim_period: Spanned<u8> = 2,
    }
}

tagged! {
    /// Something else that sends on a channel.
    InterferenceRecord by kind {
        "network" => Network(OtherNetworkRecord),
        "device" => Device(DeviceRecord),
    }
}

record! {
    /// Another Wi-Fi network, which contends for the channel with frames that come at random.
    OtherNetworkRecord {
        /// Share of the time that its frames would take on a channel of their own.
        load: Spanned<Probability>,
        /// Time of one frame with its acknowledgement.
        airtime: Spanned<Duration> = "2 ms",
        ..emitter: EmitterRecord,
    }
}

record! {
    /// A device that sends in a fixed cycle without listening, such as a microwave oven.
    DeviceRecord {
        /// Time for which it sends.
        on: Spanned<Duration>,
        /// Time until it sends again.
        off: Spanned<Duration>,
        ..emitter: EmitterRecord,
    }
}

record! {
    /// Where and when something else sends.
    EmitterRecord {
        /// Channel number: that of a radio unit of the network.
        channel: Spanned<u8>,
        /// Position of its antenna.
        position: Position,
        /// Transmission power.
        tx_power: Dbm = "15 dBm",
        /// When it is there. Without it: always.
        presence: Option<PresenceRecord>,
    }
}

record! {
    /// Mean times for which it is there and away, exponentially distributed.
    PresenceRecord {
        /// Mean time for which it is there.
        on: Spanned<Duration>,
        /// Mean time for which it is away.
        off: Spanned<Duration>,
    }
}

tagged! {
    /// Path loss over distance.
    PathLossRecord by model {
        "free_space" => FreeSpace(FreeSpaceRecord),
        "log_distance" => LogDistance(LogDistanceRecord),
        "itu_indoor" => ItuIndoor(ItuIndoorRecord),
    }
}

record! {
    /// Free space (ITU-R P.525).
    FreeSpaceRecord {}
}

record! {
    /// Log-distance: free space up to 1 m, then 10 n log d more.
    LogDistanceRecord {
        /// n: 2 in free space, 1.6 to 1.8 along a corridor, 2.7 to 3.5 among offices.
        exponent: Amount = 3.0,
    }
}

record! {
    /// ITU-R P.1238 indoor: 20 log f + N log d + L_f - 28 dB.
    ItuIndoorRecord {
        /// N: 28 for dwellings, 30 for offices, 22 for shops, at 2.4 GHz.
        coefficient: Amount = 30.0,
        /// L_f: loss through floors between.
        floor_loss: Decibels = "0 dB",
    }
}

record! {
    /// Attenuation by walls, with a bound.
    WallsRecord {
        /// Loss of each wall that the line between two antennas crosses.
        each: Spanned<WallLoss>,
        /// Loss of all of them together, at most.
        at_most: Option<Spanned<Decibels>>,
    }
}

record! {
    /// Log-normal shadowing, correlated in space.
    ShadowingRecord {
        /// Standard deviation; 0 dB switches it off.
        deviation: Decibels = "3 dB",
        /// Distance over which the correlation falls to 1/e.
        correlation: Spanned<Metres> = "5 m",
    }
}

record! {
    /// Fading with a line of sight, or among moving people.
    FadingRecord {
        /// Power of the line of sight over that of all other paths (Rician fading). Without it there is no line of sight
        /// (Rayleigh fading).
        k_factor: Option<Decibels>,
        /// Speed of people and things around; at 0 m/s only the robot's own movement changes the signal.
        motion: Speed = "0 m/s",
    }
}

/// Fading in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FadingWord {
    Rayleigh,
}

record! {
    /// Durations of a handover's phases.
    HandoverRecord {
        /// Scanning all channels, off one's own. A time, or a mapping.
        scan: Either<Duration, ScanRecord> = "100 ms",
        /// Whether a station scans before it follows an instruction to attach to another radio unit, unless it has scanned within
        /// 5 s.
        scan_first: bool = false,
        /// From one scan to the next that an attached station begins by itself, only to look. Not with `roaming: supplicant`.
        scan_every: Option<Spanned<Duration>>,
        /// Authentication.
        authenticate: Duration = "15 ms",
        /// Reassociation.
        reassociate: Duration = "20 ms",
        /// The key handshakes (802.1X, four-way) that fast transition leaves out.
        handshake: Duration = "60 ms",
        /// Each phase varies by up to this share, uniformly.
        variation: Probability = "30 %",
        /// What a handover takes: the `times` above, or that of its `frames` on the air. A mapping sets the kernel's timers,
        /// too. Frames need EDCA: docs/reference/radio.md.
        exchange: Spanned<Either<ExchangeWord, ExchangeRecord>> = "times",
    }
}

record! {
    /// Handovers as frames on the air.
    ExchangeRecord {
        /// Interval of the timers of Linux: 4 ms on Debian, 10 ms on OpenWrt.
        tick: Duration = "4 ms",
    }
}

/// A handover's exchange in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ExchangeWord {
    Times,
    Frames,
}

record! {
    /// A scan of one channel after another, as Linux's software scan: an attached station is back on its channel in between.
    ScanRecord {
        /// Number of channels that it probes.
        channels: Spanned<u8>,
        /// Time on each channel.
        dwell: Spanned<Duration> = "60 ms",
        /// Number of further channels, which it only listens on.
        passive: u8 = 0,
        /// Time on each of these.
        listen: Spanned<Duration> = "111 ms",
        /// Longest time away from its channel, if no frame waits to be sent. If one does, it comes back from each channel.
        away: Spanned<Duration> = "125 ms",
        /// Time back on its channel.
        back: Duration = "200 ms",
    }
}

tagged! {
    /// A node of the hardware graph.
    NodeRecord by kind {
        "robot" => Robot(RobotRecord),
        "radio_unit" => RadioUnit(RadioUnitRecord),
        "switch" => Switch(SwitchRecord),
        "server" => Server(ServerRecord),
        "gateway" => Gateway(GatewayRecord),
        "machine" => Machine(MachineRecord),
    }
}

impl NodeRecord {
    /// Its engine and its image, if it can have them.
    pub fn whole(&self) -> Option<&WholeRecord> {
        match self {
            Self::Robot(r) => Some(&r.whole),
            Self::RadioUnit(r) => Some(&r.whole),
            Self::Server(s) => Some(&s.whole),
            Self::Switch(_) | Self::Gateway(_) | Self::Machine(_) => None,
        }
    }

    /// The domain that it names.
    pub fn domain(&self) -> Option<&Spanned<DomainId>> {
        match self {
            Self::Robot(r) => r.domain.as_ref(),
            Self::RadioUnit(r) => r.domain.as_ref(),
            Self::Switch(s) => s.domain.as_ref(),
            Self::Server(s) => s.domain.as_ref(),
            Self::Gateway(g) => g.domain.as_ref(),
            Self::Machine(m) => m.domain.as_ref(),
        }
    }
}

record! {
    /// What nodes that run programs have in common: port security, an engine, and an image if it is a container as a whole.
    WholeRecord {
        /// Whether the emulated network drops frames of the node that name another sender (MAC, ARP, IPv4, IPv6). Without it,
        /// the node can have further addresses, and can answer as others.
        port_security: Spanned<bool> = true,
        /// Engine that runs container images on this node. Without it: the testbed's.
        engine: Option<Spanned<EngineKind>>,
        ..container: ContainerRecord,
    }
}

record! {
    /// What runs in the node's network: a command, or containers of an image.
    ContainerRecord {
        /// Reference of a container image, such as `ros:jazzy`: docs/use/containers.md.
        image: Option<Spanned<Reference>>,
        /// A program and its arguments. With `image`, they are those of its containers; without them, the image's own run.
        command: Option<Spanned<Vec<String>>>,
        /// Variables that it gets beside the usual ones: `NAME` with its value in cotorra's own environment, or `NAME=VALUE`.
        env: Vec<Spanned<String>> = [],
        /// Capabilities of Linux over its node's network and its own threads.
        capabilities: Spanned<Vec<LinuxCapability>> = [],
        /// Files and folders that a container sees, such as `data:/data`: from this file's folder, and absolute in the
        /// container. Read-only, unless `:rw` follows.
        volumes: Option<Spanned<Vec<Spanned<Volume>>>>,
        /// Devices of this machine that a container may use, such as `/dev/ttyUSB0`.
        devices: Option<Spanned<Vec<Device>>>,
        /// Ports at which a container serves. It is ready once it listens at all of them.
        ports: Option<Spanned<Vec<ListenPort>>>,
        /// When the engine pulls the image. Without it: `missing`.
        pull: Option<Spanned<Pull>>,
    }
}

record! {
    /// A robot: moves, senses, and is attached to a radio unit.
    RobotRecord {
        /// Domain that runs it. Without one: the first.
        domain: Option<Spanned<DomainId>>,
        /// Position at the start. Without it: the first waypoint of its walk.
        position: Option<Spanned<Position>>,
        /// Heading at the start, counter-clockwise from the x axis. Without it: to its second waypoint.
        heading: Option<Angle>,
        /// Model of its base and lidar.
        model: RobotModel = "turtlebot2",
        /// SSID of the wireless network that it joins. Without it: the only one.
        network: Option<Spanned<String>>,
        /// Transmission power of its radio.
        tx_power: Dbm = "15 dBm",
        /// Roaming policy: the component that decides when it changes its radio unit. A word, or a mapping.
        roaming: Either<Roaming, RoamingRecord> = "instructed",
        /// Driver: the simulation, a robot that is reached over ROS, or a TurtleBot 2 at serial ports. A word, or a mapping.
        driver: Spanned<Either<DriverWord, DriverRecord>> = "simulated",
        /// The agent on whose machine the serial ports of its driver and its radio are. Without one: the ports are this machine's.
        /// Virtual time simulates a robot with an agent.
        agent: Option<Spanned<AgentId>>,
        /// Its Wi-Fi interface on the agent's machine, in a network with `wifi: hardware`.
        interface: Option<Spanned<String>>,
        /// ROS interface of a simulated robot. A word, or a mapping.
        offer: Option<Spanned<Either<OfferWord, OfferRecord>>>,
        /// Sensors by name, beside those of its contexts.
        sensors: Table<SensorId, SensorRecord> = {},
        /// When its sensors and position packets are due.
        clock: ClockRecord = {},
        /// CPUs for VNFs.
        cpus: Amount = 2,
        /// Memory for VNFs.
        memory: Bytes = "8 GB",
        /// Accelerators for VNFs, in virtual time: docs/use/inference.md.
        accelerators: Option<Spanned<AcceleratorsRecord>>,
        /// Its electric power. With it, the report has its energy: docs/use/energy.md.
        power: Option<RobotPowerRecord>,
        ..whole: WholeRecord,
    }
}

tagged! {
    /// A roaming policy with parameters.
    RoamingRecord by policy {
        "supplicant" => Supplicant(SupplicantRecord),
    }
}

record! {
    /// Background scans of wpa_supplicant, as its `bgscan="simple:30:-65:300"` sets them.
    SupplicantRecord {
        /// Signal of the robot's radio unit below which it scans at the short interval.
        threshold: Dbm = "-65 dBm",
        /// From scan to scan below the threshold.
        short_interval: Spanned<Duration> = "30 s",
        /// From scan to scan otherwise.
        long_interval: Spanned<Duration> = "300 s",
    }
}

record! {
    /// When a robot's sensors and position packets are due.
    ClockRecord {
        /// When their intervals begin.
        phase: Phase = "random",
        /// Largest error of the rate of each.
        drift: Drift = "156 ppm",
    }
}

tagged! {
    /// A sensor of a robot.
    SensorRecord by kind {
        "odometry" => Odometry(OdometryRecord),
        "battery" => Battery(BatteryRecord),
        "imu" => Imu(ImuRecord),
        "lidar" => Lidar(LidarRecord),
        "camera" => Camera(CameraRecord),
        "vector" => Vector(VectorRecord),
    }
}

record! {
    /// Pose and velocity by its wheels, or what takes their place.
    OdometryRecord {
        /// Rate of readings.
        rate: Spanned<Frequency> = "10 Hz",
    }
}

record! {
    /// Charge and voltage of the battery of a simulated TurtleBot 2, or of a robot in ROS.
    BatteryRecord {
        /// Rate of readings.
        rate: Spanned<Frequency> = "1 Hz",
        /// A simulated one's charge when the run begins. Without it: 100 %.
        charge: Option<Spanned<Probability>>,
        /// Topic of its `sensor_msgs/BatteryState`, for a robot in ROS. Without it: `battery_state`.
        topic: Option<Spanned<String>>,
    }
}

record! {
    /// Angular velocity and acceleration.
    ImuRecord {
        /// Rate of readings.
        rate: Spanned<Frequency> = "50 Hz",
        /// Topic of its `sensor_msgs/Imu`, for a robot in ROS. Without it: `imu`.
        topic: Option<Spanned<String>>,
    }
}

record! {
    /// Scans of the robot's lidar, which can be read then.
    LidarRecord {
        /// Rate of readings.
        rate: Spanned<Frequency> = "10 Hz",
        /// Size of the readings that a run keeps; the oldest go first.
        keep: Bytes = "64 MB",
    }
}

record! {
    /// Images of a camera that looks ahead.
    CameraRecord {
        /// Rate of images.
        rate: Spanned<Frequency> = "15 Hz",
        /// Columns of an image. Without it: 320. A robot in ROS says this and the next three by its messages.
        width: Option<Spanned<u16>>,
        /// Rows of an image. Without it: 240.
        height: Option<Spanned<u16>>,
        /// Pixel format. Without it: `mono8`.
        format: Option<Spanned<DataFormat>>,
        /// Angle from the left column to the right one. Without it: `60 deg`.
        field_of_view: Option<Spanned<Angle>>,
        /// The VNF to which a simulated robot's images go, over the network. Without it, they stay on the robot.
        to: Option<Spanned<VnfId>>,
        /// Topic of its images, for a robot in ROS: `sensor_msgs/CompressedImage` if the name ends in `/compressed`,
        /// else `sensor_msgs/Image`. Without it: `camera/image_raw`.
        topic: Option<Spanned<String>>,
        /// Size of the images that a run keeps; the oldest go first.
        keep: Bytes = "64 MB",
    }
}

record! {
    /// Numbers that plug-ins or programs report by the instruction `report`, or a robot in ROS on a topic.
    VectorRecord {
        /// Number of components.
        size: Spanned<u8>,
        /// Highest rate of readings. Of several reports in between, the last counts.
        rate: Spanned<Frequency> = "10 Hz",
        /// Their unit, as you call it.
        unit: Spanned<String> = "",
        /// Topic of `std_msgs/Float64MultiArray`, for a robot in ROS. Without it, values come from reports alone.
        topic: Option<Spanned<String>>,
    }
}

/// Drivers whose settings are left as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum DriverWord {
    Simulated,
    Ros1,
    Ros2,
    Kobuki,
}

tagged! {
    /// Driver of a robot.
    DriverRecord by kind {
        "simulated" => Simulated(SimulatedRecord),
        "ros1" => Ros1(Ros1Record),
        "ros2" => Ros2(Ros2Record),
        "kobuki" => Kobuki(KobukiRecord),
    }
}

record! {
    /// A TurtleBot 2 at serial ports of this machine, or of its agent's.
    #[derive(Default)]
    KobukiRecord {
        /// Device file of its Kobuki base. Without it: `/dev/kobuki`.
        port: Option<Spanned<String>>,
        /// Its RPLIDAR A2, or `none`. Without it: one at `/dev/rplidar`.
        lidar: Option<Either<LidarWord, RplidarRecord>>,
    }
}

/// No lidar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LidarWord {
    None,
}

record! {
    /// An RPLIDAR A2 at a serial port.
    #[derive(Default)]
    RplidarRecord {
        /// Device file. Without it: `/dev/rplidar`.
        port: Option<Spanned<String>>,
        /// Bits per second: 115200 for an A2M8, 256000 for an A2M7 or A2M12. Without it: 115200.
        baud: Option<Spanned<u32>>,
        /// Drive of its motor, 1 to 1023. Without it: 660, about ten turns a second.
        motor_pwm: Option<Spanned<u16>>,
        /// Position on the robot, metres from the middle between the wheels: forward, and to the left. Without it: there.
        position: Option<Spanned<Position>>,
        /// Direction of its front, counter-clockwise from the robot's. Without it: the same.
        heading: Option<Angle>,
    }
}

record! {
    /// A simulated robot.
    SimulatedRecord {}
}

/// Ways of offering a robot whose settings are left as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OfferWord {
    Ros1,
    Ros2,
}

tagged! {
    /// ROS interface of a simulated robot.
    OfferRecord by kind {
        "ros1" => Ros1(Ros1Record),
        "ros2" => Ros2(Ros2Record),
    }
}

record! {
    /// A robot in ROS 1.
    #[derive(Default)]
    Ros1Record {
        /// Address of the master, such as `http://192.168.0.10:11311`, or a node in which cotorra runs one. Without it:
        /// that of `ROS_MASTER_URI` in the machine's network, the robot's own node in the testbed's.
        master: Option<Spanned<String>>,
        /// Network in which the robot speaks ROS. Without it: the machine's for a driver, the testbed's for an offer.
        network: Option<Spanned<RosNetwork>>,
        /// The namespace in which its topics are, such as `/tb2`. Without it: the root.
        namespace: Option<Spanned<String>>,
        /// Whether an offered robot tells the testbed's time on `/clock`, and stamps what it says with that. Without it:
        /// stamps are the time of day.
        clock: Option<Spanned<bool>>,
        /// Names of topics that are others than a TurtleBot's.
        topics: RosTopicsRecord = {},
    }
}

record! {
    /// A robot in ROS 2.
    #[derive(Default)]
    Ros2Record {
        /// Middleware. Without it: DDS, which all of ROS 2's middlewares but `rmw_zenoh` speak.
        rmw: Option<Spanned<RmwWord>>,
        /// Zenoh's endpoint of the router, with `rmw: zenoh`. Without it: `tcp/localhost:7447`.
        router: Option<Spanned<String>>,
        /// ROS domain, 0 to 232. Without it: that of `ROS_DOMAIN_ID`, or 0.
        domain: Option<Spanned<u64>>,
        /// The address of the one network interface to use, such as `192.168.0.10`. Without it: all of them.
        interface: Option<Spanned<String>>,
        /// Network in which the robot speaks ROS. Without it: the machine's for a driver, the testbed's for an offer.
        network: Option<Spanned<RosNetwork>>,
        /// The namespace in which its topics are, such as `/tb2`. Without it: the root.
        namespace: Option<Spanned<String>>,
        /// Whether an offered robot tells the testbed's time on `/clock`, and stamps what it says with that. Without it:
        /// stamps are the time of day.
        clock: Option<Spanned<bool>>,
        /// Names of topics that are others than a TurtleBot's.
        topics: RosTopicsRecord = {},
    }
}

/// ROS 2 middleware.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RmwWord {
    Dds,
    Zenoh,
}

record! {
    /// Names of a robot's topics: global ones begin with `/`, others are in its namespace.
    #[derive(Default)]
    RosTopicsRecord {
        /// Turns of its lidar.
        scan: Option<Spanned<String>>,
        /// Topic of its odometry.
        odom: Option<Spanned<String>>,
        /// Velocities for it.
        cmd_vel: Option<Spanned<String>>,
        /// Topic of its coordinate frames.
        tf: Option<Spanned<String>>,
        /// Topic of its pose on the map.
        amcl_pose: Option<Spanned<String>>,
        /// The map.
        map: Option<Spanned<String>>,
    }
}

record! {
    /// A radio unit (Wi-Fi access point).
    RadioUnitRecord {
        /// Domain that runs it. Without one: the first.
        domain: Option<Spanned<DomainId>>,
        /// Position.
        position: Position,
        /// SSID that it serves. Without it: the only one.
        network: Option<Spanned<String>>,
        /// Channel number; radio units on one channel share its airtime.
        channel: Spanned<u8>,
        /// Transmission power.
        tx_power: Dbm = "15 dBm",
        /// Whether it serves its network from the start. One that does not is off until a vAP is deployed on it.
        serving: bool = true,
        /// Deployment time of a vAP, from the start to its first beacon.
        deployment: Duration = "400 ms",
        /// The agent of a real access point, which reports its context as that of this node.
        agent: Option<Spanned<AgentId>>,
        /// Its Wi-Fi interface on the agent's machine, in a network with `wifi: hardware`.
        interface: Option<Spanned<String>>,
        /// The bridge that its access point joins there. Without it: the one in which the interface is found.
        bridge: Option<Spanned<String>>,
        /// CPUs for VNFs.
        cpus: Amount = 1,
        /// Memory for VNFs.
        memory: Bytes = "1 GB",
        ..whole: WholeRecord,
    }
}

record! {
    /// A switch: forwards frames.
    SwitchRecord {
        /// Domain that runs it. Without one: the first.
        domain: Option<Spanned<DomainId>>,
        /// Position, for pictures.
        position: Option<Position>,
    }
}

record! {
    /// A server: runs VNFs. With `agent`, `interface` and `address` it is a real machine, which virtual time emulates.
    ServerRecord {
        /// Domain that runs it. Without one: the first.
        domain: Option<Spanned<DomainId>>,
        /// Position, for pictures.
        position: Option<Position>,
        /// Distance from the robots.
        tier: Tier,
        /// CPUs for VNFs.
        cpus: Amount,
        /// Memory for VNFs.
        memory: Bytes,
        /// Accelerators for VNFs, in virtual time: docs/use/inference.md.
        accelerators: Option<Spanned<AcceleratorsRecord>>,
        /// Price of a CPU for an hour, in the file's `currency`.
        cost: Amount = 1,
        /// Price of an hour of CPU time that VNFs use, in the file's `currency`: docs/use/bill.md.
        used_cost: Amount = 0,
        /// Price of a GB of memory for an hour, in the file's `currency`.
        memory_cost: Amount = 0,
        /// Price of each instance of a VNF that comes to it after the start, in the file's `currency`.
        migration_cost: Amount = 0,
        /// Probability that it works at any time.
        reliability: Spanned<Probability> = "100 %",
        /// Speed of its CPUs, as a multiple of that on which demands were measured: docs/use/load.md.
        speed: Spanned<Amount> = 1,
        /// Its electric power. With it, the report has its energy: docs/use/energy.md.
        power: Option<ServerPowerRecord>,
        /// The agent that starts VNFs on the real machine.
        agent: Option<Spanned<AgentId>>,
        /// The interface of this machine through which the real machine is reached, as `ip link` names it. Several real
        /// servers can share one.
        interface: Option<Spanned<String>>,
        /// Network namespace of the interface: a name as in `ip netns`, or an absolute path. Without one: this machine's.
        netns: Option<Spanned<String>>,
        /// IPv4 address of the real machine.
        address: Option<Spanned<Ipv4Addr>>,
        ..whole: WholeRecord,
    }
}

record! {
    /// A gateway: joins an interface of this machine to the emulated network, so that packets pass between its hosts and
    /// the real machines behind the interface.
    GatewayRecord {
        /// Domain that runs it. Without one: the first.
        domain: Option<Spanned<DomainId>>,
        /// Position, for pictures.
        position: Option<Position>,
        /// The interface, as `ip link` names it.
        interface: Spanned<String>,
        /// Network namespace of the interface: a name as in `ip netns`, or an absolute path. Without one: this machine's.
        netns: Option<Spanned<String>>,
        /// IPv4 addresses of the real machines behind the interface, by name. Packets of others do not pass.
        machines: Spanned<Table<NodeId, Spanned<Ipv4Addr>>>,
    }
}

record! {
    /// A real machine: this one, that of an agent, or one that is reached through an interface of such a machine. Only the
    /// link to it is emulated, by the kernel's NetEm on that interface.
    MachineRecord {
        /// Domain that runs it. Without one: the first.
        domain: Option<Spanned<DomainId>>,
        /// Position, for pictures.
        position: Option<Position>,
        /// The interface through which it is reached, as `ip link` names it. Without one: it is this machine, or one that
        /// others name in `via`.
        interface: Option<Spanned<String>>,
        /// The machine that has the interface: a node with `kind: machine` and an `agent`. Without one: this machine.
        via: Option<Spanned<NodeId>>,
        /// Address or network, such as `192.168.1.7`. Without one: everything reached through the interface that is no
        /// other node's.
        address: Option<Spanned<IpNetwork>>,
        /// Whether a reflector of STAMP (RFC 8762, port 862) is at its address, such as `cotorra stamp reflect`: a run then
        /// measures the delay of the medium before it begins, and probes the link as long as it goes on. With `via`, the
        /// agent probes the link, and the delay of the medium is not measured.
        reflector: Spanned<bool> = false,
        /// The agent that reports its context.
        agent: Option<Spanned<AgentId>>,
    }
}

record! {
    /// A wired link, or several alike: an end may be a list, and then each there is linked to each at the other end.
    LinkRecord {
        /// The two ends, `[A, B]`; forward is from A to B. `[A, [B, C]]` are two links.
        ends: Spanned<Vec<Either<Spanned<NodeId>, Vec<Spanned<NodeId>>>>>,
        /// Name. Without one: `A-B`.
        id: Option<Spanned<LinkId>>,
        /// Rate of the medium itself.
        medium: BitRate = "10 Gbit/s",
        /// Between real machines: how long the medium itself takes, one way, before anything is emulated on it. Without it:
        /// what a run measures, if there is a `reflector`, or none.
        medium_delay: Option<Spanned<Duration>>,
        /// Price of a GB that crosses it, in either direction, in the file's `currency`.
        cost: Amount = 0,
        /// Probability that it works at any time.
        reliability: Spanned<Probability> = "100 %",
        /// Differing conditions from the first end to the second.
        forward: Option<ConditionsRecord>,
        /// Differing conditions from the second end to the first.
        backward: Option<ConditionsRecord>,
        ..conditions: ConditionsRecord,
    }
}

record! {
    /// Conditions of a link.
    ConditionsRecord {
        /// Time from the last bit sent to the last bit received, one way. Without it: none.
        delay: Option<Duration>,
        /// Random part of the delay; keeps order. A deviation, or a mapping.
        jitter: Option<Spanned<Either<Duration, JitterRecord>>>,
        /// Packets that vanish: a share of all, or a mapping for losses in bursts.
        loss: Option<Either<Probability, LossRecord>>,
        /// Share of packets that arrive twice.
        duplication: Option<Probability>,
        /// Share of packets in which one bit is flipped.
        corruption: Option<Probability>,
        /// Share of packets that skip the delay, and so overtake those before them.
        reordering: Option<Spanned<Probability>>,
        /// Serialisation rate, Ethernet header included. Without it: the medium's rate.
        rate: Option<Spanned<Rate>>,
        /// Path of a packet-delivery trace in Mahimahi's format, from this file's folder. Takes the place of a rate.
        trace: Option<Spanned<String>>,
        /// Limit of the queue, in packets or bytes, or a mapping with its discipline too. Without it: 1000 packets that
        /// leave in their order, while those that find the queue full are dropped.
        queue: Option<Either<QueueLimit, QueueRecord>>,
        /// ψ: emulation multiplies the delay by it. Without it: 1. It is no part of what the link itself gives.
        delay_scale: Option<Amount>,
        /// δ: emulation divides the throughput by it. Without it: 1. It is no part of what the link itself gives.
        drop_scale: Option<Spanned<Amount>>,
    }
}

tagged! {
    /// A queue and its discipline: docs/reference/queues.md.
    QueueRecord by discipline {
        "drop_tail" => DropTail(DropTailRecord),
        "codel" => Codel(CodelRecord),
        "fq_codel" => FqCodel(FqCodelRecord),
        "pie" => Pie(PieRecord),
        "red" => Red(RedRecord),
    }
}

record! {
    /// First in, first out. Packets that find the queue full are dropped.
    DropTailRecord {
        /// Limit of the queue. Without it: 1000 packets.
        limit: Option<QueueLimit>,
    }
}

record! {
    /// CoDel (RFC 8289): drops by the time that packets waited.
    CodelRecord {
        /// Limit of the queue. Without it: 1000 packets.
        limit: Option<QueueLimit>,
        ..control: CodelControlRecord,
    }
}

record! {
    /// CoDel's control law.
    CodelControlRecord {
        /// Acceptable time in the queue.
        target: Spanned<Duration> = "5 ms",
        /// Time above the target before the first drop: the longest usual round-trip time.
        interval: Spanned<Duration> = "100 ms",
        /// Mark ECN-capable packets instead of dropping them.
        ecn: bool = false,
    }
}

record! {
    /// FQ-CoDel (RFC 8290): a queue with CoDel for each flow, in turns.
    FqCodelRecord {
        /// Limit of all queues together. Without it: 1000 packets.
        limit: Option<QueueLimit>,
        /// Queues that flows are hashed to.
        flows: Spanned<u32> = 1024,
        /// Bytes that a flow may send before the next one's turn.
        quantum: Spanned<Bytes> = "1514 B",
        ..control: CodelControlRecord,
    }
}

record! {
    /// PIE (RFC 8033): drops with a probability that rises with the delay of the queue.
    PieRecord {
        /// Limit of the queue. Without it: 1000 packets.
        limit: Option<QueueLimit>,
        /// Time in the queue that it aims at.
        target: Spanned<Duration> = "15 ms",
        /// Time from one update of the drop probability to the next.
        update: Spanned<Duration> = "15 ms",
        /// Length of a burst that passes without drops.
        burst: Spanned<Duration> = "150 ms",
        /// Mark ECN-capable packets instead of dropping them, while the drop probability is below 10 %.
        ecn: bool = false,
    }
}

record! {
    /// RED (Floyd and Jacobson, 1993) in its gentle mode: drops with a probability that rises with the average queue.
    RedRecord {
        /// Limit of the queue. Without it: 1000 packets.
        limit: Option<QueueLimit>,
        /// Average queue up to which nothing is dropped.
        min: Spanned<QueueLimit> = "5 packets",
        /// Average queue at which packets are dropped with `probability`. At twice as much, all are.
        max: Spanned<QueueLimit> = "15 packets",
        /// Probability at `max`.
        probability: Spanned<Probability> = "2 %",
        /// Weight of the newest length in the average.
        weight: Spanned<Probability> = "0.2 %",
        /// Mark ECN-capable packets instead of dropping them, while the average is below `max`.
        ecn: bool = false,
    }
}

record! {
    /// A random addition to the delay, with mean zero.
    JitterRecord {
        /// Half-width of a uniform, standard deviation of the other distributions.
        deviation: Duration,
        /// Shape of the distribution.
        distribution: JitterDistribution = "normal",
        /// Correlation with the jitter of the next packet, above -100 % and below 100 %.
        correlation: Spanned<Correlation> = "0 %",
        /// Time over which the jitter changes, whatever is sent. Without it, each packet has a jitter of its own.
        over: Option<Spanned<Duration>>,
    }
}

record! {
    /// Losses in bursts: Gilbert-Elliott in Gilbert's simple form.
    LossRecord {
        /// Long-run share that is lost.
        rate: Spanned<Probability>,
        /// Mean number of packets lost in a row.
        mean_burst: Spanned<Amount>,
    }
}

record! {
    /// A service that a robot uses.
    ServiceRecord {
        /// The robot that it serves.
        robot: Spanned<NodeId>,
        /// KPIs that it must keep.
        kpis: KpisRecord,
        /// A model whose actions the robot follows, in virtual time: docs/use/inference.md. The service's time is then that from
        /// an observation to its chunk of actions.
        policy: Option<Spanned<PolicyRecord>>,
        /// Destination of the robot's requests, if a bundled VNF has several instances. Without it: `one`.
        requests: Option<Spanned<Requests>>,
        /// VNFs by name, in the order in which packets visit them.
        vnfs: Table<VnfId, VnfRecord> = {},
        /// A compose file whose services are VNFs, too, after those under `vnfs`.
        compose: Option<ComposeRecord>,
        /// Links between its VNFs.
        virtual_links: Vec<VirtualLinkRecord> = [],
    }
}

record! {
    /// A compose file, and the node of its containers: docs/use/containers.md.
    ComposeRecord {
        /// Its path, from this file's folder.
        file: Spanned<String>,
        /// Node on which they start, unless `x-cotorra: { node: OTHER }` of a service names another.
        node: Spanned<NodeId>,
    }
}

record! {
    /// KPIs that a service must keep.
    KpisRecord {
        /// Target of the service time: from the emission of a position packet to the reception of the navigation
        /// packet that answers it. Of a service that localizes, from a scan to the pose; of one with a `flow`, from its
        /// requests to their answers.
        service_time: Spanned<Duration>,
        /// Share of samples that must be within the target. With it, each run has a verdict on the service: PASS or FAIL.
        kept: Option<Spanned<Probability>>,
        /// A flow of your own programs, whose time is the service's: docs/use/flows.md.
        flow: Option<Spanned<FlowRecord>>,
        /// Probability that all nodes and links in use work.
        reliability: Option<Spanned<Probability>>,
        /// Area of the service: corners of a polygon.
        area: Option<Spanned<Vec<Position>>>,
        /// The radio technology that it needs.
        radio: Option<Spanned<WifiStandard>>,
        /// Bounds on figures of a run, such as `service_time p95 <= 15 ms`. Each run then has a verdict on each of them.
        require: Vec<Spanned<Bound>> = [],
    }
}

tagged! {
    /// A flow of your own programs: requests of a client on one node to a server on any other, and their answers.
    FlowRecord by protocol {
        "udp" => Udp(FlowUdpRecord),
        "tcp" => Tcp(FlowTcpRecord),
        "http" => Http(FlowHttpRecord),
        "ros1" => Ros1(FlowRos1Record),
        "ros1_service" => Ros1Service(FlowRos1ServiceRecord),
        "ros2" => Ros2(FlowRos2Record),
        "ros2_service" => Ros2Service(FlowRos2ServiceRecord),
        "ros2_action" => Ros2Action(FlowRos2ActionRecord),
    }
}

record! {
    /// A datagram to the port, and the datagram from there that answers it.
    FlowUdpRecord {
        /// The server's port.
        port: Spanned<u16>,
        /// Bytes of the payload that an answer repeats of its request, at the same place. Without it, a socket may have one
        /// request under way at a time.
        id: Option<Spanned<FlowIdRecord>>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// A client's bytes on a connection until the server's next first byte.
    FlowTcpRecord {
        /// The server's port.
        port: Spanned<u16>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// A request of HTTP/1 or HTTP/2, and the last byte of the response.
    FlowHttpRecord {
        /// The server's port.
        port: Spanned<u16>,
        /// Path of the requests that count, whatever their query. Without it: all.
        path: Option<Spanned<String>>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// A message of one topic of ROS 1 that the node publishes, and one of another topic to which it subscribes.
    FlowRos1Record {
        /// The topic of requests, such as `/camera/image`.
        request: Spanned<String>,
        /// The topic of answers, such as `/cmd_vel`.
        answer: Spanned<String>,
        /// Bytes of a serialized message that an answer repeats of its request; `{ offset: 4, length: 8 }` is the stamp of a
        /// `Header`. Without it, one request may be under way at a time.
        id: Option<Spanned<FlowIdRecord>>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// A call of a service of ROS 1, and its result.
    FlowRos1ServiceRecord {
        /// The service, such as `/plan`.
        service: Spanned<String>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// A message of one topic of ROS 2 that the node publishes, and one of another topic to which it subscribes.
    FlowRos2Record {
        /// The topic of requests, such as `/camera/image`.
        request: Spanned<String>,
        /// The topic of answers, such as `/cmd_vel`.
        answer: Spanned<String>,
        /// Bytes of a serialized message that an answer repeats of its request; `{ offset: 0, length: 8 }` is the stamp of a
        /// `Header`. Without it, one request may be under way at a time.
        id: Option<Spanned<FlowIdRecord>>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// A call of a service of ROS 2, and its reply.
    FlowRos2ServiceRecord {
        /// The service, such as `/plan`.
        service: Spanned<String>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// A goal of an action of ROS 2, and its result.
    FlowRos2ActionRecord {
        /// The action, such as `/dock`.
        action: Spanned<String>,
        ..at: FlowWhereRecord,
    }
}

record! {
    /// Node at which a flow is measured, and limits.
    FlowWhereRecord {
        /// The node of the client. Without it: the service's robot.
        from: Option<Spanned<NodeId>>,
        /// Time after which a request without an answer is lost. Without it: 1 s, or twice the target if that is longer. For UDP
        /// and topics without `id`: twice the target.
        timeout: Option<Spanned<Duration>>,
    }
}

record! {
    /// Bytes of a datagram's payload, or of a message.
    FlowIdRecord {
        /// Index of the first byte, from 0.
        offset: u8,
        /// Number of bytes, 16 at most.
        length: u8,
    }
}

record! {
    /// A virtual network function. It runs a `program`, a `command` or an `image`, on the node that it is `pinned_to` or
    /// first on `node`, or an instance on each of several.
    VnfRecord {
        /// A bundled program. With `image`, the image's own command runs in its place in real time.
        program: Option<Spanned<ProgramWord>>,
        /// Files and folders that a command may read beside programs, libraries and this file's folder; from this folder.
        readable: Spanned<Vec<String>> = [],
        /// Whether a command may do on this machine what cotorra may.
        trusted: Spanned<bool> = false,
        /// Whether it goes on while the core is away, if an agent runs it.
        keep: bool = false,
        /// The one node that can carry it.
        pinned_to: Option<Spanned<NodeId>>,
        /// Node at the start, or a list of nodes with an instance on each.
        node: Option<Spanned<Either<Spanned<NodeId>, Vec<Spanned<NodeId>>>>>,
        /// Number of instances at the start, 1 to 16. Without it: as many as `node` names.
        replicas: Option<Spanned<u8>>,
        /// CPUs that it takes of its node, each instance.
        cpus: Amount = 1,
        /// Most CPUs that it uses, each instance. Without it: `cpus`.
        cpu_limit: Option<Spanned<Amount>>,
        /// Memory that it takes of its node, each instance.
        memory: Bytes = "256 MB",
        /// Time from a start until it serves, in virtual time. Without it: none.
        start_time: Option<Duration>,
        /// CPU time that each request takes of a bundled program, on a CPU of speed 1: a time, or a distribution
        /// (docs/use/load.md). Without it: none.
        demand: Option<Spanned<Either<Duration, DemandRecord>>>,
        /// The order in which it serves requests with a demand. Without it: `fifo`.
        scheduling: Option<Spanned<SchedulingWord>>,
        /// Number of requests that it serves at a time with `fifo`. Without it: 1.
        workers: Option<Spanned<u32>>,
        /// Most requests with a demand that are with it at a time, waiting or served. One more is dropped. Without it: 1000.
        backlog: Option<Spanned<u32>>,
        /// What the first requests after each start cost more.
        warm_up: Option<Spanned<WarmUpRecord>>,
        /// The model of a `policy_server`, in virtual time.
        inference: Option<Spanned<InferenceRecord>>,
        /// State that is copied when it moves in virtual time. Without it: another instance starts without.
        state: Option<Spanned<StateRecord>>,
        /// Time that a container takes from a request to its answer, in virtual time. Without it: none.
        processing_delay: Option<Spanned<Duration>>,
        ..container: ContainerRecord,
    }
}

record! {
    /// Accelerators of a node, such as GPUs, all alike.
    AcceleratorsRecord {
        /// Their number, 1 to 64.
        count: Spanned<u32> = 1,
        /// Memory of each.
        memory: Bytes,
        /// Speed, as a multiple of that on which times of inference were measured.
        speed: Spanned<Amount> = 1,
        /// Price of one for an hour, in the file's `currency`, by the share of its memory that models take: docs/use/bill.md.
        cost: Amount = 0,
    }
}

record! {
    /// How a robot follows the actions of a model.
    PolicyRecord {
        /// The VNF that answers: a `policy_server` of any service.
        server: Spanned<VnfId>,
        /// Size of an observation: images and state, as they are sent.
        observation: Spanned<Bytes> = "45 kB",
        /// Observes once no more actions than these are left. Fewer than a chunk has. Without it: 0, i.e. when none is left.
        request_ahead: Spanned<u32> = 0,
        /// Time after which an observation without an answer is given up, and another one is made.
        timeout: Spanned<Duration> = "1 s",
    }
}

record! {
    /// A model on an accelerator. With `model`, the other keys have that model's values unless they are given
    /// (docs/use/inference.md). Without it, `accelerator_memory`, `actions` and `interval` must be given, and a time.
    InferenceRecord {
        /// A public model with published figures.
        model: Option<ModelWord>,
        /// Memory that it takes of an accelerator, each instance.
        accelerator_memory: Option<Bytes>,
        /// Time of a batch, whatever its size, on an accelerator of speed 1.
        per_batch: Option<Duration>,
        /// Time for each request of a batch beside that.
        per_request: Option<Duration>,
        /// Tokens of an answer, one after the other. Those of a batch go on together.
        tokens: Option<u32>,
        /// Time for each token.
        per_token: Option<Duration>,
        /// What the first batch after each start takes longer. Without it: nothing.
        first_batch: Duration = "0 ms",
        /// Most requests of a batch.
        max_batch: Spanned<u32> = 1,
        /// Longest time for which a request waits for others, while the accelerator is free.
        max_wait: Duration = "0 ms",
        /// Most requests that wait. One more is dropped.
        backlog: Spanned<u32> = 1000,
        /// Number of actions of a chunk.
        actions: Option<Spanned<u32>>,
        /// Time from one action to the next.
        interval: Option<Spanned<Duration>>,
        /// Size of an answer.
        answer: Spanned<Bytes> = "6 kB",
    }
}

/// Public models with published times of inference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ModelWord {
    Act,
    Openvla,
    Pi0,
}

record! {
    /// Distribution of the CPU time of a request. It has exactly one of `constant`, `exponential`, `lognormal`, `uniform` and
    /// `samples`.
    DemandRecord {
        /// The same time for all requests.
        constant: Option<Duration>,
        /// Mean of an exponential distribution.
        exponential: Option<Spanned<Duration>>,
        /// A lognormal distribution.
        lognormal: Option<Spanned<LognormalRecord>>,
        /// Bounds of a uniform distribution.
        uniform: Option<Spanned<Vec<Duration>>>,
        /// File of measured times, of which each request draws one: from this file's folder, a line for each time, in
        /// milliseconds in the first column.
        samples: Option<Spanned<String>>,
        /// Time for each kilobyte (1000 B) of a request beside that.
        per_kb as "per_kB": Duration = "0 ms",
    }
}

record! {
    /// A lognormal distribution by two of its quantiles.
    LognormalRecord {
        /// Median.
        median: Spanned<Duration>,
        /// 95th percentile.
        p95: Duration,
    }
}

record! {
    /// What the first requests after a start of a VNF cost more.
    WarmUpRecord {
        /// Number of these requests.
        requests: u32,
        /// Factor of their demand.
        factor: Amount,
    }
}

/// Orders in which a VNF serves requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SchedulingWord {
    Fifo,
    Shared,
}

/// Programs that come with cotorra.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ProgramWord {
    RobotDriver,
    Navigation,
    Localization,
    RosNavigation,
    PolicyServer,
}

record! {
    /// A link between two VNFs of a service.
    VirtualLinkRecord {
        /// VNF at one end.
        from: Spanned<VnfId>,
        /// VNF at the other end.
        to: Spanned<VnfId>,
        /// Highest rate that it needs.
        rate: BitRate,
    }
}

record! {
    /// Walk of a robot.
    WalkRecord {
        /// The waypoints, in order. The robot starts at the first.
        waypoints: Spanned<Vec<Spanned<Position>>>,
        /// Whether it comes back the same way.
        and_back: bool = false,
        /// Index of the waypoint, from 0, that a robot on its way heads for first. It then starts at its `position`.
        next: Option<Spanned<u32>>,
        /// Speed that it does not exceed.
        speed_limit: Spanned<Speed> = "0.3 m/s",
        /// Interval of the robot's position packets, or a distribution of their intervals.
        position_interval: Times = "200 ms",
    }
}

record! {
    /// Place of the core in the emulated network.
    CoreRecord {
        /// Emulated server on which it stands. Plug-ins with a `node` are that far away (docs/use/old-context.md), and
        /// applications on nodes reach the services of ETSI MEC there (docs/use/mec.md). Without one, the core is beside
        /// its plug-ins, and applications do not reach it.
        node: Option<Spanned<NodeId>>,
    }
}

record! {
    /// A plug-in: a bundled one, or any program that uses the HTTP API.
    PluginRecord {
        /// Name in this testbed. Without one: the bundled plug-in's.
        id: Option<Spanned<PluginId>>,
        /// Name of a bundled plug-in, which runs in process.
        bundled: Option<Spanned<String>>,
        /// A program and its arguments; it finds the API at the URL in `COTORRA_API`.
        command: Option<Spanned<Vec<String>>>,
        /// The one domain that a bundled plug-in sees and changes. Without one it is the operator's, and sees all.
        domain: Option<Spanned<DomainId>>,
        /// Variables that a command gets beside the usual ones: `NAME` with its value in cotorra's own environment, or
        /// `NAME=VALUE`.
        env: Vec<Spanned<String>> = [],
        /// Whether it runs by itself. One that does not runs where the setting `plugin=…` chooses it.
        enabled: bool = true,
        /// Whether the run's figures stay valid if it is cut off, or ends before the run does.
        optional: bool = false,
        /// Instructions that it may give in a second, also all at once. One that gives more is cut off.
        instructions_per_second: InstructionLimit = 1000,
        /// Emulated server or robot on which it stands: contexts and instructions cross the emulated network between this
        /// node and that of `core`. Without one, it is beside the core.
        node: Option<Spanned<NodeId>>,
        /// Time of each context to it, and of each instruction back, in place of a `node`.
        control_delay: Option<Spanned<Duration>>,
        /// Time of a decision, in virtual time: a duration, or `cpu` for the CPU time that a program uses from the events that
        /// it gets to its instruction, times a factor as in `2.5x cpu`. In real time, a decision takes what the plug-in takes.
        decides_in: Spanned<DecisionTime> = "0 ms",
        /// Settings of the plug-in.
        settings: serde_json::Map<String, serde_json::Value> = {},
    }
}

record! {
    /// The WLAN Access Information Service: docs/reference/wais.md.
    WaisRecord {
        /// Networks that notifications may be sent to beside this machine's loopback addresses, such as `10.1.0.0/16`.
        callbacks: Vec<IpNetwork> = [],
        /// Place of the map's origin on Earth. Without it, no locations are exposed.
        origin: Option<OriginRecord>,
    }
}

record! {
    /// Where this core meets the cores of other domains.
    BorderRecord {
        /// Server at which packets of a robot enter and leave the wired network while the robot is with another core.
        node: Spanned<NodeId>,
        /// Address of this machine at which other cores reach this one, such as `192.168.77.1:7450`.
        address: Spanned<String>,
        /// Robots that stand for robots of other cores while these are attached to radio units here.
        visitors: Vec<Spanned<NodeId>> = [],
    }
}

record! {
    /// Place of the map's origin on Earth (WGS 84).
    OriginRecord {
        /// Degrees to the north.
        latitude: Spanned<f64>,
        /// Degrees to the east.
        longitude: Spanned<f64>,
        /// Direction of the map's y axis, clockwise from north.
        bearing: Angle = "0 deg",
        /// Altitude of the map's floor, metres above the ellipsoid. Without it, no altitude is reported.
        altitude: Option<Spanned<f64>>,
    }
}

choice!(WifiStandard, "Wi-Fi standard", {
    "g" => Self::G, "IEEE 802.11g, 2.4 GHz";
    "a" => Self::A, "IEEE 802.11a, 5 GHz";
    "n" => Self::N, "IEEE 802.11n, 2.4 or 5 GHz by the channels of its radio units";
    "ac" => Self::Ac, "IEEE 802.11ac, 5 GHz";
    "ax" => Self::Ax, "IEEE 802.11ax, 2.4 or 5 GHz by the channels of its radio units";
});
choice!(ChannelWidth, "channel width", {
    "20 MHz" => Self::Mhz20, "one channel";
    "40 MHz" => Self::Mhz40, "two channels, from `n` on";
    "80 MHz" => Self::Mhz80, "four channels at 5 GHz, from `ac` on";
});
choice!(GuardInterval, "guard interval", {
    "400 ns" => Self::Ns400, "the short one of `n` and `ac`";
    "800 ns" => Self::Ns800, "the usual one";
    "1600 ns" => Self::Ns1600, "the longer one of `ax`";
    "3200 ns" => Self::Ns3200, "the longest one of `ax`";
});
choice!(ExchangeWord, "kind of exchange", {
    "times" => Self::Times, "handovers take the times of their phases";
    "frames" => Self::Frames, "handovers take as long as their frames on the air, with the timers of a kernel of 250 Hz";
});
choice!(SchedulingWord, "kind of scheduling", {
    "fifo" => Self::Fifo, "in the order of arrival, as many at a time as there are `workers`";
    "shared" => Self::Shared, "all at once, which share the VNF's CPUs evenly";
});
choice!(FadingWord, "kind of fading", {
    "rayleigh" => Self::Rayleigh, "no line of sight, and still surroundings";
});
choice!(Emulation, "kind of emulation", {
    "fabric" => Self::Fabric, "cotorra itself, on every kernel";
    "netem" => Self::NetEm, "the kernel, with bridges and NetEm, where it has them and there is no radio; else the fabric";
});
choice!(Reservations, "way to keep reservations", {
    "counted" => Self::Counted, "they limit other mappings, and shape no traffic";
    "guaranteed" => Self::Guaranteed, "wired links keep the reserved rate for the packets of a mapping, which may borrow more";
    "limited" => Self::Limited, "wired links keep the reserved rate for the packets of a mapping, which get no more";
});

choice!(Direction, "direction", {
    "forward" => Self::Forward, "from the link's first end to its second";
    "backward" => Self::Backward, "from its second end to its first";
});
choice!(ProbesWord, "setting of probes", {
    "none" => Self::None, "no probes";
});
choice!(GapPolicy, "gap policy", {
    "hold" => Self::Hold, "both sides buffer, and send afterwards";
    "drop" => Self::Drop, "they are lost";
});
choice!(AccessWord, "way to share a channel", {
    "turns" => Self::Turns, "senders take turns, and nothing collides";
    "edca" => Self::Edca, "stations contend as real ones do";
});
choice!(WifiWord, "kind of Wi-Fi software", {
    "model" => Self::Model, "the model of this page's keys";
    "hwsim" => Self::Hwsim, "hostapd and wpa_supplicant, on radios of `mac80211_hwsim`";
    "hardware" => Self::Hardware, "hostapd and wpa_supplicant, on the radios of real machines with agents";
});
choice!(SecurityWord, "kind of security", {
    "open" => Self::Open, "everybody may join, and nothing is encrypted";
    "wpa2" => Self::Wpa2, "WPA2-PSK";
    "wpa3" => Self::Wpa3, "WPA3-SAE";
});
choice!(Protection, "protection of management frames", {
    "off" => Self::Off, "none: anybody can disconnect a robot by a forged frame";
    "optional" => Self::Optional, "for stations that can";
    "required" => Self::Required, "for all, and others are refused";
});
choice!(RateControl, "rate control", {
    "minstrel" => Self::Minstrel, "by acknowledgements, as Linux does (Minstrel-HT)";
    "ideal" => Self::Ideal, "by the present signal, as if the sender knew it";
});
choice!(RobotModel, "robot model", {
    "turtlebot2" => Self::Turtlebot2, "TurtleBot 2: Kobuki base with an RPLIDAR A2";
    "quadrotor" => Self::Quadrotor, "A quadrotor with the same lidar: its walk may rise and descend";
});
choice!(Roaming, "roaming policy", {
    "instructed" => Self::Instructed, "plug-ins decide; alone it only joins the strongest";
    "signal" => Self::Signal, "its station decides, by signal with hysteresis and time-to-trigger";
    "supplicant" => Self::Supplicant(BackgroundScan::default()), "its station decides as wpa_supplicant, by background scans";
});
choice!(DriverWord, "driver", {
    "simulated" => Self::Simulated, "cotorra simulates it";
    "ros1" => Self::Ros1, "a robot that speaks ROS 1";
    "ros2" => Self::Ros2, "a robot that speaks ROS 2";
    "kobuki" => Self::Kobuki, "a TurtleBot 2 at serial ports";
});
choice!(LidarWord, "setting of a lidar", {
    "none" => Self::None, "no lidar";
});
choice!(OfferWord, "kind of offer", {
    "ros1" => Self::Ros1, "as a robot that speaks ROS 1";
    "ros2" => Self::Ros2, "as a robot that speaks ROS 2";
});
choice!(RosNetwork, "network for ROS", {
    "machine" => Self::Machine, "the network of this machine";
    "testbed" => Self::Testbed, "the emulated network: the robot's ROS node is in its node";
});
choice!(RmwWord, "ROS 2 middleware", {
    "dds" => Self::Dds, "DDS: Fast DDS, Cyclone DDS, Connext";
    "zenoh" => Self::Zenoh, "Zenoh, for `rmw_zenoh`; in a cotorra that was built with `--features zenoh`";
});
choice!(Tier, "tier", {
    "fog" => Self::Fog, "on the premises";
    "edge" => Self::Edge, "at the operator's edge";
    "cloud" => Self::Cloud, "in a data centre";
});
choice!(JitterDistribution, "distribution", {
    "uniform" => Self::Uniform, "every value within the deviation is as likely";
    "normal" => Self::Normal, "Gaussian";
    "pareto" => Self::Pareto, "a long upper tail";
});
choice!(Phase, "phase", {
    "random" => Self::Random, "each by itself within its first interval, by the seed";
    "aligned" => Self::Aligned, "all when the run begins";
});
choice!(LinuxCapability, "capability", {
    "net_bind_service" => Self::NetBindService, "ports below 1024";
    "net_broadcast" => Self::NetBroadcast, "broadcasts, and multicast groups";
    "net_admin" => Self::NetAdmin, "interfaces, addresses, routes and filters of its node";
    "net_raw" => Self::NetRaw, "raw and packet sockets: ping, tcpdump";
    "ipc_lock" => Self::IpcLock, "memory that is never swapped out";
    "sys_nice" => Self::SysNice, "real-time priority";
});
choice!(EngineKind, "engine", {
    "process" => Self::Process, "none: only programs of this machine run";
    "podman" => Self::Podman, "podman";
    "docker" => Self::Docker, "Docker";
});
choice!(Pull, "rule for pulling", {
    "missing" => Self::Missing, "if the engine does not have the image";
    "always" => Self::Always, "before each start";
    "never" => Self::Never, "the engine must have it";
});
choice!(DataFormat, "format of images", {
    "mono8" => Self::Mono8, "brightness, a byte a pixel";
    "rgb8" => Self::Rgb8, "red, green and blue, three bytes a pixel";
});
choice!(Requests, "destination of requests", {
    "one" => Self::One, "to the first instance that serves";
    "nearest" => Self::Nearest, "to the instance that serves with the least delay from the robot";
    "all" => Self::All, "to all instances that serve; the first answer wins";
});
choice!(ModelWord, "model", {
    "act" => Self::Act, "ACT (Zhao et al. 2023): 100 actions at 50 Hz";
    "openvla" => Self::Openvla, "OpenVLA 7B (Kim et al. 2024): one action";
    "pi0" => Self::Pi0, "π0 (Black et al. 2024): 50 actions at 50 Hz";
});
choice!(ProgramWord, "bundled program", {
    "robot_driver" => Self::RobotDriver, "the robot's own driver: position packets out, navigation packets in";
    "navigation" => Self::Navigation, "the bundled brain";
    "localization" => Self::Localization, "Monte Carlo localization: scans in, poses with their covariance out";
    "ros_navigation" => Self::RosNavigation, "the bundled brain as a node of ROS 1 or 2: poses in, velocities out";
    "policy_server" => Self::PolicyServer, "a model on an accelerator: observations in, chunks of actions out";
});
