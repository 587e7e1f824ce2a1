//! Moves of VNFs with their state, by a plug-in.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{fs, path::Path};

use serde_json::Value;

use crate::harness::{corridor, cotorra, stderr, stdout};

/// Lets OKpi move navigation from the fog to cheaper servers, over links of 100 Mbit/s. Returns the summary and the output.
pub(crate) fn moved(out: &Path, state: &str) -> (Value, String) {
    let run = cotorra(["run", "--headless", "--simulate", "--until", "20s", "--set", "plugin=okpi"])
        .args(["--set", "services.navigation.vnfs.navigation.node=fog"])
        .args(["--set", "links.lan-fog.rate=100 Mbit/s", "--set"])
        .arg(format!("services.navigation.vnfs.navigation.state={state}"))
        .arg("--out")
        .arg(out)
        .arg(corridor())
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let folder = fs::read_dir(out).unwrap().next().unwrap().unwrap().path();
    let summary = fs::read_to_string(folder.join("summary.json")).unwrap();
    (serde_json::from_str(&summary).unwrap(), stdout(&run))
}

#[test]
fn the_summary_and_the_terminal_tell_what_moves_cost() {
    let out = tempfile::tempdir().unwrap();
    let pre_copy = "{ size: 10 MB, migration: pre_copy, dirty_rate: 20 Mbit/s, downtime: 50 ms }";
    for (name, state, down_ms) in
        [("stopped", "{ size: 10 MB }", 800.0..950.0), ("pre_copy", pre_copy, 0.0..50.0)]
    {
        let (summary, shown) = moved(&out.path().join(name), state);
        let its = &summary["migrations"][0];
        assert_eq!((its["vnf"].as_str(), its["outcome"].as_str()), (Some("navigation"), Some("done")));
        assert!(down_ms.contains(&its["downtime_ms"].as_f64().unwrap()), "{its}");
        assert!(its["bytes"].as_u64().unwrap() >= 10_000_000, "{its}");
        let sentence = format!("moved from fog to {}: ", its["to"].as_str().unwrap());
        assert!(shown.contains(&sentence) && shown.contains(" ms down"), "{shown}");
    }
}
