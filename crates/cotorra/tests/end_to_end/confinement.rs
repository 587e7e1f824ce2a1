//! Other people's programs in a run: VNFs with a `command` and plug-ins that are programs.

use std::{fs, path::Path};

use tempfile::TempDir;

use crate::{
    harness::{Run, wait_until},
    one_robot::testbed,
};

const ROBOT: &str = "{ kind: robot }";

/// One robot, with a VNF `other` on the server that has these keys.
fn with_vnf(keys: &str, rest: &str, folder: &Path) -> std::path::PathBuf {
    let services = format!(
        "
services:
  navigation:
    robot: tb
    kpis: {{ service_time: 50 ms }}
    vnfs:
      robot-driver: {{ program: robot_driver, pinned_to: tb }}
      navigation: {{ program: navigation, node: cloud }}
      other: {{ node: cloud, {keys} }}
walks:
  tb: {{ waypoints: [[2, 3], [500, 3]], speed_limit: 0.5 m/s }}
{rest}"
    );
    testbed(folder, "confined", ROBOT, &services)
}

#[test]
fn programs_of_others_get_no_secret_of_the_run() {
    let place = TempDir::new().unwrap();
    let print = "command: [sh, -c, 'env; echo done; sleep 1000'], env: [NAMED]";
    let file = with_vnf(print, &format!("plugins:\n  - {{ id: mine, {print} }}\n"), place.path());
    let secrets = [
        ("COTORRA_DOMAIN_TOKENS", "local=tokens-of-sixteen-characters"),
        ("COTORRA_LEDGER_PASSWORD", "secret"),
        ("COTORRA_HISTORY_PASSWORD", "secret"),
        ("AWS_SECRET_ACCESS_KEY", "secret"),
    ];
    let run = Run::start_with(&file, &["--until", "5min"], |command| {
        command.envs(secrets).env("COTORRA_TOKEN", "operator-of-sixteen-characters");
        command.env("NAMED", "by the file").env("ROS_DOMAIN_ID", "7").env("TZ", "UTC");
    });
    let log = |name: &str| fs::read_to_string(run.folder.join("logs").join(name)).unwrap_or_default();
    for (name, token) in [("other.log", false), ("plugin-mine.log", true)] {
        wait_until(|| log(name).contains("\ndone\n"));
        let told = log(name);
        for (secret, _) in secrets {
            assert!(!told.contains(secret), "{name} has {secret}:\n{told}");
        }
        // A plug-in instructs the testbed, and the API asks it for a token.
        assert_eq!(told.contains("COTORRA_TOKEN="), token, "{name}:\n{told}");
        for usual in ["PATH=", "ROS_DOMAIN_ID=7", "TZ=UTC", "NAMED=by the file"] {
            assert!(told.contains(usual), "{name} lacks {usual}:\n{told}");
        }
    }
}
