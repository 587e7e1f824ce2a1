//! The state of a VNF that moves with it to another node.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::units::{BitRate, millis};

/// The state of a VNF that moves with it to another node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StateTransfer {
    /// Its size.
    pub bytes: u64,
    /// When the VNF serves while its state is copied.
    pub method: TransferMethod,
}

/// When a VNF serves while its state is copied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TransferMethod {
    /// It stops, and all of its state is copied.
    StopAndCopy,
    /// It serves while its state is copied in rounds, and stops for the last one.
    PreCopy(PreCopy),
}

/// Rounds of a pre-copy: the first copies the whole state, and each later one what changed during the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PreCopy {
    /// Rate at which the state changes while the VNF serves.
    #[serde(rename = "dirty_rate_bps")]
    pub dirty_rate: BitRate,
    /// The VNF stops once the rest takes no longer than this.
    #[serde(rename = "downtime_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub downtime: Duration,
    /// Most rounds while it serves, 1 or more. It stops after them, whatever the rest takes.
    pub rounds: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfers_survive_json() {
        let pre_copy = PreCopy {
            dirty_rate: BitRate::from_bits_per_second(40_000_000).unwrap(),
            downtime: Duration::from_millis(50),
            rounds: 5,
        };
        for (method, json) in [
            (TransferMethod::StopAndCopy, r#""stop_and_copy""#),
            (
                TransferMethod::PreCopy(pre_copy),
                r#"{"pre_copy":{"dirty_rate_bps":40000000,"downtime_ms":50.0,"rounds":5}}"#,
            ),
        ] {
            let transfer = StateTransfer { bytes: 200, method };
            let text = serde_json::to_string(&transfer).unwrap();
            assert_eq!(text, format!(r#"{{"bytes":200,"method":{json}}}"#));
            assert_eq!(serde_json::from_str::<StateTransfer>(&text).unwrap(), transfer);
        }
    }
}
