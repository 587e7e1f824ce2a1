//! Moves of VNFs with their state, in a run's summary.

use cotorra_graph::{NodeId, Timestamp, VnfId, millis};
use serde::Serialize;

use crate::virtual_time::{Migrated, MigrationOutcome};

/// A move of a VNF with its state.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MigrationSummary {
    /// Time of its begin.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    pub vnf: VnfId,
    pub from: NodeId,
    pub to: NodeId,
    /// `done`; `abandoned` because an instance ended, or because the VNF was to move elsewhere; or `running` at the run's end.
    pub outcome: &'static str,
    /// Bytes of the state that arrived, in all copies.
    pub bytes: u64,
    /// Rounds of copies while the former instance served.
    pub rounds: u32,
    /// Time until the new instance served.
    pub duration_ms: f64,
    /// Time of it in which neither instance served.
    pub downtime_ms: f64,
}

impl From<Migrated> for MigrationSummary {
    fn from(migrated: Migrated) -> Self {
        let Migrated { vnf, from, to, at, outcome, bytes, rounds, duration, downtime } = migrated;
        let outcome = match outcome {
            MigrationOutcome::Done => "done",
            MigrationOutcome::Abandoned => "abandoned",
            MigrationOutcome::Running => "running",
        };
        let (duration_ms, downtime_ms) = (millis::of(duration), millis::of(downtime));
        Self { at, vnf, from, to, outcome, bytes, rounds, duration_ms, downtime_ms }
    }
}

impl MigrationSummary {
    /// Describes it in one line, such as `moved from edge to cloud: 10.0 MB in 0.87 s, 31 ms down after 2 rounds`.
    pub fn sentence(&self) -> String {
        let Self { at: _, vnf: _, from, to, outcome, bytes, rounds, duration_ms, downtime_ms } = self;
        let what = match *outcome {
            "done" => "moved",
            "abandoned" => "gave up its move",
            _ => "is moving",
        };
        let rounds = match rounds {
            0 => String::new(),
            1 => " after 1 round".to_owned(),
            several => format!(" after {several} rounds"),
        };
        let (seconds, megabytes) = (duration_ms / 1e3, *bytes as f64 / 1e6);
        format!(
            "{what} from {from} to {to}: {megabytes:.1} MB in {seconds:.2} s, {downtime_ms:.0} ms down{rounds}"
        )
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_migration_is_a_sentence() {
        let migrated = Migrated {
            vnf: "brain".parse().unwrap(),
            from: "edge".parse().unwrap(),
            to: "cloud".parse().unwrap(),
            at: Timestamp::ZERO,
            outcome: MigrationOutcome::Done,
            bytes: 10_000_000,
            rounds: 2,
            duration: Duration::from_millis(870),
            downtime: Duration::from_millis(31),
        };
        let sentence = |outcome, rounds| {
            MigrationSummary::from(Migrated { outcome, rounds, ..migrated.clone() }).sentence()
        };
        assert_eq!(
            sentence(MigrationOutcome::Done, 2),
            "moved from edge to cloud: 10.0 MB in 0.87 s, 31 ms down after 2 rounds"
        );
        assert_eq!(
            sentence(MigrationOutcome::Abandoned, 0),
            "gave up its move from edge to cloud: 10.0 MB in 0.87 s, 31 ms down"
        );
        assert!(sentence(MigrationOutcome::Running, 1).ends_with("after 1 round"));
    }
}
