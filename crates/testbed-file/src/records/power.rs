//! Records of electric power.

use crate::yaml::{
    WattHours, Watts,
    decode::{Amount, Spanned, record},
};

record! {
    /// Power of a server, linear in the busy share of its CPUs.
    ServerPowerRecord {
        /// While no CPU is busy.
        idle: Watts,
        /// While all CPUs are busy.
        full: Spanned<Watts>,
        /// Price of a kWh, in the file's `currency`.
        cost: Amount = 0,
    }
}

record! {
    /// Power of a robot.
    RobotPowerRecord {
        /// While it stands.
        idle: Watts,
        /// While it moves or turns.
        driving: Spanned<Watts>,
        /// Beside these, while all of its CPUs are busy: linear in their busy share.
        computing: Watts = "0 W",
        /// Its radio, beside these. Without it, the radio counts in the others.
        radio: Option<RadioPowerRecord>,
        /// Energy of its battery when a run begins.
        battery: Option<Spanned<WattHours>>,
        /// Price of a kWh, in the file's `currency`.
        cost: Amount = 0,
    }
}

record! {
    /// Power of a radio.
    RadioPowerRecord {
        /// While it listens.
        idle: Watts,
        /// While it sends.
        sending: Watts,
        /// While it receives frames that are for it.
        receiving: Watts,
    }
}
