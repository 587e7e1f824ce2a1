//! Conversion of events to rows and back, for every engine. Both directions go through the columns in the order of
//! [`table`] and [`CONDITIONS`].

pub(crate) mod binary;
mod decode;
mod encode;
mod heard;
mod read_error;
pub(crate) mod time_parts;

use std::borrow::Cow;

use cotorra_graph::{
    ConditionChange, Conditions, Decision, Direction, Event, Instruction, Loss, Position, Stamped,
};

pub(crate) use self::{
    decode::{Source, decode, decode_conditions},
    encode::{Fields, encode, encode_conditions},
    heard::Heard,
    read_error::ReadError,
};
use crate::kind::Kind;

/// A table of events. Its key is (run, at_ns, seq), as in all of them.
pub(crate) struct Table {
    /// Columns after the key, in order.
    pub columns: &'static [&'static str],
    /// Columns that name the series, which are the first of `columns`; none for kinds without series.
    pub series: &'static [&'static str],
    /// Table and columns of the child rows. Their key is the row's, followed by `place`, from 0.
    pub children: Option<(&'static str, &'static [&'static str])>,
}

const fn plain(columns: &'static [&'static str]) -> Table {
    Table { columns, series: &[], children: None }
}

/// Returns the table of a kind.
#[rustfmt::skip]
pub(crate) const fn table(kind: Kind) -> Table {
    match kind {
        Kind::Robot => Table {
            columns: &[
                "robot", "waypoint",
                "x", "y", "heading",
                "cov_xx", "cov_xy", "cov_xh", "cov_yx", "cov_yy", "cov_yh", "cov_hx", "cov_hy", "cov_hh",
                "source",
                "odometry_x", "odometry_y", "odometry_heading",
                "odometry_cov_xx", "odometry_cov_xy", "odometry_cov_xh", "odometry_cov_yx", "odometry_cov_yy", "odometry_cov_yh",
                "odometry_cov_hx", "odometry_cov_hy", "odometry_cov_hh",
                "odometry_source",
                "linear", "angular", "bumper", "nearest_obstacle_m", "health",
                "z", "roll", "pitch", "odometry_z", "odometry_roll", "odometry_pitch", "vertical",
                "speed_limit_mps", "localization_error_m", "heard",
            ],
            series: &["robot"],
            children: Some(("attachment", &["radio_unit", "attached", "signal_dbm", "signal_age_ms"])),
        },
        Kind::Radio => Table {
            columns: &["radio_unit", "channel", "load"],
            series: &["radio_unit"],
            children: Some(("station", &[
                "robot", "signal_dbm", "downlink_bps", "uplink_bps",
                "retransmissions", "transmissions_failed", "transmit_airtime_ms", "receive_airtime_ms",
            ])),
        },
        Kind::Link => Table {
            columns: &[
                "link", "direction", "delay_ms", "throughput_bps", "delay_scale", "drop_scale",
                "asked", "effective",
                "packets", "bytes", "lost", "overflowed", "duplicated", "corrupted",
                "probed_delay_ms", "probed_jitter_ms", "probed_delay_age_ms", "probed_loss", "probed_loss_age_ms",
                "tested_throughput_bps", "tested_offered_bps", "tested_age_ms",
                "queued_packets",
            ],
            series: &["link", "direction"],
            children: None,
        },
        Kind::Placement => Table {
            columns: &["vnf", "node"],
            series: &["vnf"],
            children: Some(("replica_node", &["node"])),
        },
        Kind::VirtualLink => Table {
            columns: &["from_vnf", "to_vnf", "path", "others"],
            series: &["from_vnf", "to_vnf"],
            children: Some(("hop", &["link"])),
        },
        Kind::ServiceTime => Table {
            columns: &[
                "service", "robot", "sequence", "emitted_ns", "service_time_ms", "attachment", "server", "lost_at",
            ],
            series: &[],
            children: Some(("time_part", &["part", "direction", "total_ms", "queueing_ms", "retries_ms"])),
        },
        Kind::Handover => plain(&["robot", "from_radio_unit", "to_radio_unit", "fast", "gap_ms"]),
        Kind::Detached => plain(&["robot", "from_radio_unit"]),
        Kind::Scanned | Kind::WalkFinished => plain(&["robot"]),
        Kind::SuggestionAnswered => plain(&["robot", "radio_unit", "status"]),
        Kind::Vnf => plain(&["vnf", "node", "state", "detail"]),
        Kind::Decision => plain(&[
            "plugin", "instruction", "subject", "object", "linear", "angular", "waypoint",
            "direction", "change", "reason", "refused", "vertical",
        ]),
        Kind::PluginFault => plain(&["plugin", "reason"]),
        Kind::Lateness => plain(&["frames", "p50_us", "p99_us", "max_us"]),
        Kind::Notice => plain(&["message"]),
        Kind::AnswersRejected => {
            plain(&["robot", "late", "forged", "repeated", "unknown", "invalid", "redundant"])
        }
        Kind::Sensor => Table {
            columns: &["robot", "sensor", "measured_ns", "sequence", "format", "width", "height", "bytes"],
            series: &["robot", "sensor"],
            children: Some(("sensor_value", &["component", "value"])),
        },
        Kind::Machine => Table {
            columns: &[
                "node", "cpus", "cpu_busy", "one_minute", "five_minutes", "fifteen_minutes", "memory_bytes", "available_bytes",
                "interfaces_left_out", "wifi_left_out", "wifi", "measured_ns", "time_error_ms",
            ],
            series: &["node"],
            children: Some(("machine_interface", &[
                "interface", "up", "carrier", "speed_bps", "mtu_bytes",
                "received_packets", "received_bytes", "received_errors", "received_dropped", "received_throughput_bps",
                "sent_packets", "sent_bytes", "sent_errors", "sent_dropped", "sent_throughput_bps",
            ])),
        },
        Kind::Goal => plain(&["robot", "x", "y", "z", "state", "remaining_m", "reason"]),
    }
}

/// Columns of `conditions` after its id.
#[rustfmt::skip]
pub(crate) const CONDITIONS: &[&str] = &[
    "delay_ms", "jitter_deviation_ms", "jitter_distribution", "loss", "loss_share", "loss_mean_burst",
    "duplication", "corruption", "reordering", "rate_bps", "trace_ms", "queue_packets", "queue_bytes",
    "queue_discipline", "jitter_correlation", "trace_file",
];

/// Columns of `heard` after its id.
pub(crate) const HEARD: &[&str] = &["signals"];

/// A value on its way into a column.
#[derive(Debug, Clone)]
pub(crate) enum Value<'a> {
    Null,
    Integer(i64),
    /// NaN becomes NULL.
    Real(f64),
    Text(Cow<'a, str>),
    /// Becomes the id of the name's row.
    Name(&'a str),
    /// Becomes the id of the conditions' row.
    Conditions(Role, &'a Conditions),
    /// Becomes the id of the signals' row.
    Heard(Heard),
}

/// The role of conditions of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Role {
    Asked,
    Effective,
}

impl Role {
    pub const COUNT: usize = 2;
}

/// Returns a direction as it is stored.
pub(crate) const fn direction_code(direction: Direction) -> i64 {
    match direction {
        Direction::Forward => 0,
        Direction::Backward => 1,
    }
}

fn direction_of(code: i64) -> Option<Direction> {
    match code {
        0 => Some(Direction::Forward),
        1 => Some(Direction::Backward),
        _ => None,
    }
}

/// Whether a history can hold the event and return it unchanged.
pub(crate) fn storable(stamped: &Stamped) -> bool {
    let finite = |change: &ConditionChange| {
        let burst = match change.loss {
            Some(Loss::Bursty { mean_burst, .. }) => Some(mean_burst),
            _ => None,
        };
        [change.delay_ms, change.delay_scale, change.drop_scale, burst]
            .into_iter()
            .flatten()
            .all(f64::is_finite)
    };
    i64::try_from(stamped.at.as_nanos()).is_ok()
        && match &stamped.event {
            Event::Decision(Decision { instruction: Instruction::Condition { change, .. }, .. }) => {
                finite(change)
            }
            Event::Decision(Decision {
                instruction: Instruction::LimitSpeed { speed_limit_mps: Some(limit), .. },
                ..
            }) => limit.is_finite(),
            Event::Decision(Decision { instruction: Instruction::Report { values, .. }, .. }) => {
                values.iter().all(|value| value.is_finite())
            }
            Event::Decision(Decision {
                instruction: Instruction::NavigateTo { goal: Some(Position { x, y, z }), .. },
                ..
            }) => [x, y, z].into_iter().all(|metres| metres.is_finite()),
            Event::Machine(context) => context.is_valid(),
            _ => true,
        }
}
