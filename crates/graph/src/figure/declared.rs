//! The registry of figures: each is declared here once, with its unit and its name in files.

use super::{statistic::Statistic, unit::Unit};

/// The declaration of a figure.
#[derive(Debug, PartialEq, Eq)]
pub struct Declared {
    /// Its name.
    pub name: &'static str,
    /// Its subject, in capital letters with colons between, such as `LINK:DIRECTION`; empty for the run.
    pub of: &'static str,
    /// Its unit.
    pub unit: Unit,
    /// Whether it has one number in a run or many.
    pub kind: FigureKind,
    /// The better side of its values.
    pub better: Better,
    /// Its name in tables and JSON, with the unit.
    pub field: &'static str,
    /// Its meaning.
    pub about: &'static str,
}

/// Whether a figure has one number in a run or many.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureKind {
    /// Many numbers over time, of which there are statistics.
    Samples,
    /// One number.
    Total,
}

/// The better side of a figure's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// Small ones.
    Lower,
    /// Great ones.
    Higher,
    /// That depends.
    Neither,
}

macro_rules! figures {
    ($($(#[$doc:meta])* $group:ident, $kind:ident {
        $($quantity:ident = $name:literal of $of:literal, $unit:ident, $better:ident, $field:literal, $about:literal;)*
    })*) => {
        $(
            $(#[$doc])*
            #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
            pub enum $group { $(#[doc = $about] $quantity,)* }

            impl $group {
                /// All of them.
                pub const ALL: &[Self] = &[$(Self::$quantity),*];

                /// Returns its declaration.
                pub const fn declared(self) -> &'static Declared {
                    match self {
                        $(Self::$quantity => &Declared {
                            name: $name,
                            of: $of,
                            unit: Unit::$unit,
                            kind: FigureKind::$kind,
                            better: Better::$better,
                            field: $field,
                            about: $about,
                        },)*
                    }
                }

                /// Returns its name.
                pub const fn as_str(self) -> &'static str {
                    self.declared().name
                }

                pub(super) fn named(name: &str) -> Option<Self> {
                    Self::ALL.iter().copied().find(|quantity| quantity.as_str() == name)
                }
            }
        )*

        /// All figures.
        pub static FIGURES: &[&Declared] = &[$($($group::$quantity.declared(),)*)*];
    };
}

figures! {
    /// Figures of one direction of a link.
    LinkQuantity, Samples {
        Delay = "delay" of "LINK:DIRECTION", Millis, Lower, "delay_ms", "d of a link.";
        Throughput = "throughput" of "LINK:DIRECTION", BitRate, Neither, "throughput_bps", "λ of a link.";
        Queue = "queue" of "LINK:DIRECTION", Packets, Lower, "queued_packets",
            "The most packets that waited at a time over the last second.";
        DelayScale = "delay_scale" of "LINK:DIRECTION", Number, Neither, "delay_scale", "ψ of a link.";
        DropScale = "drop_scale" of "LINK:DIRECTION", Number, Neither, "drop_scale", "δ of a link.";
        ProbedDelay = "probed_delay" of "LINK:DIRECTION", Millis, Lower, "probed_delay_ms", "Delay by probes.";
        ProbedJitter = "probed_jitter" of "LINK:DIRECTION", Millis, Lower, "probed_jitter_ms", "Jitter by probes.";
        ProbedLoss = "probed_loss" of "LINK:DIRECTION", Share, Lower, "probed_loss", "Loss by probes.";
    }

    /// Figures of a robot.
    RobotQuantity, Samples {
        X = "x" of "ROBOT", Metres, Neither, "x", "Position to the east.";
        Y = "y" of "ROBOT", Metres, Neither, "y", "Position to the north.";
        Z = "z" of "ROBOT", Metres, Neither, "z", "Height above the floor.";
        Heading = "heading" of "ROBOT", Radians, Neither, "heading", "Heading.";
        Linear = "linear" of "ROBOT", Speed, Neither, "linear", "Speed ahead.";
        Vertical = "vertical" of "ROBOT", Speed, Neither, "vertical", "Speed upwards.";
        Angular = "angular" of "ROBOT", TurningRate, Neither, "angular", "Turning rate.";
        NearestObstacle = "nearest_obstacle" of "ROBOT", Metres, Higher, "nearest_obstacle_m",
            "Distance of the nearest obstacle.";
        LocalizationError = "localization_error" of "ROBOT", Metres, Lower, "localization_error_m",
            "Distance between the pose of localization and the true one.";
    }

    /// Figures of a machine.
    MachineQuantity, Samples {
        Cpu = "cpu" of "NODE", Share, Lower, "cpu_busy", "Share of time in which the CPUs of a machine were busy.";
        LoadAverage = "load_average" of "NODE", Number, Lower, "one_minute",
            "Mean number of tasks that ran or waited, over one minute.";
        AvailableMemory = "available_memory" of "NODE", Bytes, Higher, "available_bytes",
            "Memory that new programs could use.";
    }

    /// Figures of the emulator's lateness since the run began.
    LatenessQuantity, Samples {
        P50 = "lateness_p50" of "", Micros, Lower, "p50_us", "Median lateness of the emulator since the run began.";
        P99 = "lateness_p99" of "", Micros, Lower, "p99_us", "99th percentile of that lateness.";
        Max = "lateness_max" of "", Micros, Lower, "max_us", "Maximum of that lateness.";
    }

    /// Figures over time of other subjects.
    OtherQuantity, Samples {
        Signal = "signal" of "ROBOT:RADIO_UNIT", Power, Higher, "signal_dbm",
            "Signal at which a robot hears a radio unit.";
        Load = "load" of "RADIO_UNIT", Share, Lower, "load", "Share of time in which a radio unit's channel is busy.";
        ServiceTime = "service_time" of "SERVICE:ROBOT", Millis, Lower, "service_time_ms",
            "Service times that were answered.";
        TimePart = "time_part" of "PART:SERVICE:ROBOT", Millis, Lower, "total_ms",
            "Time of answered samples on a link, or in one of the parts `sender`, `vnf`, `receiver` and `unknown`.";
        HandoverGap = "handover_gap" of "ROBOT", Millis, Lower, "gap_ms", "Time that handovers cut robots off.";
        Sensor = "sensor" of "ROBOT:SENSOR:COMPONENT", Number, Neither, "value",
            "One of the numbers that a sensor of a robot reads, in the sensor's unit.";
    }

    /// Figures of which a run has one number.
    Total, Total {
        Answered = "answered" of "SERVICE", Share, Higher, "answered", "Share of samples with an answer in time.";
        Kept = "kept" of "SERVICE", Share, Higher, "kept", "Share of samples within the target of the service.";
        Samples = "samples" of "SERVICE", Number, Higher, "samples", "Number of samples, unanswered ones included.";
        Unanswered = "unanswered" of "SERVICE", Number, Lower, "unanswered", "Number of samples without an answer.";
        Reliability = "reliability" of "SERVICE", Share, Higher, "reliability",
            "Probability that all servers and links work that a sample used; the least of all samples.";
        Cost = "cost" of "SERVICE", Number, Lower, "cost",
            "Price of the CPUs that the VNFs of a service take of servers; the highest of all samples.";
        Bill = "bill" of "SERVICE", Number, Lower, "bill",
            "Price of the CPUs, the memory and the migrations of the VNFs of a service, over the run.";
        Energy = "energy" of "SERVICE", Energy, Lower, "energy_wh",
            "Energy of the CPU time of a service's VNFs on servers and robots, over the run.";
        ActionAge = "action_age" of "SERVICE", Millis, Lower, "action_age_ms",
            "95th percentile of the age of the actions that the robot of a service followed.";
        Starved = "starved" of "SERVICE", Share, Lower, "starved",
            "Share of control steps at which the robot of a service had no action to follow.";
        Handovers = "handovers" of "ROBOT", Number, Lower, "handovers", "Number of changes of attachment.";
        Detached = "detached" of "ROBOT", Millis, Lower, "detached_ms",
            "Time without a radio unit after the robot had lost one.";
        Driven = "driven" of "ROBOT", Metres, Neither, "driven_m", "Distance that the robot drove.";
        Blind = "blind" of "ROBOT", Metres, Lower, "blind_m", "Distance that it drove blind.";
        LongestBlind = "longest_blind" of "ROBOT", Metres, Lower, "longest_blind_m", "Its longest blind stretch.";
        RobotEnergy = "robot_energy" of "ROBOT", Energy, Lower, "robot_energy_wh",
            "Energy of the robot's base, computer and radio, over the run.";
        BatteryLeft = "battery_left" of "ROBOT", Share, Higher, "battery_left",
            "Share of the energy of the robot's battery that is left at the end of the run.";
        TotalBill = "total_bill" of "", Number, Lower, "total_bill",
            "Price of everything that the run took of servers and links.";
        TotalEnergy = "total_energy" of "", Energy, Lower, "total_energy_wh",
            "Energy of all servers and robots of which the testbed file says the power, over the run.";
        Duration = "duration" of "", Millis, Lower, "duration_ms", "Duration of the run.";
        Migrations = "migrations" of "", Number, Lower, "migrations",
            "Number of changes of VNFs' nodes after the start.";
        PluginFaults = "plugin_faults" of "", Number, Lower, "plugin_faults", "Number of plug-ins that were cut off.";
        Applied = "applied" of "", Number, Neither, "applied", "Number of applied instructions of plug-ins.";
        Refused = "refused" of "", Number, Lower, "refused", "Number of rejected instructions of plug-ins.";
    }
}

impl Declared {
    /// Returns the figure of that name.
    pub fn named(name: &str) -> Option<&'static Self> {
        FIGURES.iter().copied().find(|figure| figure.name == name)
    }

    /// Returns the name of a column with a statistic of it, such as `service_time_p95_ms`.
    pub fn column(&self, statistic: Option<Statistic>) -> String {
        let statistic = statistic.map(|statistic| format!("_{}", statistic.as_str())).unwrap_or_default();
        let unit = match self.unit {
            Unit::Millis => "_ms",
            Unit::Micros => "_us",
            Unit::Metres => "_m",
            Unit::BitRate => "_bps",
            Unit::Power => "_dbm",
            Unit::Speed => "_mps",
            Unit::Energy => "_wh",
            Unit::Radians | Unit::TurningRate | Unit::Packets | Unit::Bytes | Unit::Share | Unit::Number => {
                ""
            }
        };
        format!("{}{statistic}{unit}", self.name)
    }
}
