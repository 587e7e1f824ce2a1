//! External programs in a run: VNFs with a `command`, and plug-ins that are programs.

use std::{
    fs,
    os::unix::fs::{MetadataExt, PermissionsExt},
    path::{Path, PathBuf},
};

use tempfile::TempDir;

use crate::{
    harness::{Run, cotorra, stderr, wait_until},
    one_robot::{navigated, testbed},
};

const ROBOT: &str = "{ kind: robot }";

/// Writes a testbed of one robot, with further VNFs on the server.
fn with_vnfs(vnfs: &[(&str, &str)], rest: &str, folder: &Path) -> PathBuf {
    let vnfs: String = vnfs
        .iter()
        .map(|(name, keys)| format!("      {name}: {{ node: cloud, cpus: 0.5, {keys} }}\n"))
        .collect();
    testbed(folder, "confined", ROBOT, &navigated(&vnfs, rest))
}

#[test]
fn external_programs_get_no_secrets_of_the_run() {
    let place = TempDir::new().unwrap();
    let print = "command: [sh, -c, 'env; echo done; sleep 1000'], env: [NAMED]";
    // A VNF with the name of another log writes its own.
    let names = ["other", "cotorra", "plugin-mine"];
    let file = with_vnfs(
        &names.map(|name| (name, print)),
        &format!("plugins:\n  - {{ id: mine, {print} }}\n"),
        place.path(),
    );
    let secrets = [
        ("COTORRA_DOMAIN_TOKENS", "local=tokens-of-sixteen-characters"),
        ("COTORRA_LEDGER_PASSWORD", "secret"),
        ("COTORRA_HISTORY_PASSWORD", "secret"),
        ("AWS_SECRET_ACCESS_KEY", "secret"),
    ];
    let run = Run::start_beside_with(&file, &["--until", "5min"], |command| {
        command.envs(secrets).env("COTORRA_TOKEN", "operator-of-sixteen-characters");
        command.env("NAMED", "by the file").env("ROS_DOMAIN_ID", "7").env("TZ", "UTC");
    });
    let log = |name: &str| fs::read_to_string(run.folder.join("logs").join(name)).unwrap_or_default();
    let vnfs = names.map(|name| (format!("vnfs/{name}.log"), false));
    for (name, token) in
        vnfs.iter().map(|(name, token)| (&**name, *token)).chain([("plugins/mine.log", true)])
    {
        wait_until(|| log(name).contains("\ndone\n"));
        let told = log(name);
        for (secret, _) in secrets {
            assert!(!told.contains(secret), "{name} has {secret}:\n{told}");
        }
        // A plug-in instructs the testbed, for which the API needs a token.
        assert_eq!(told.contains("COTORRA_TOKEN="), token, "{name}:\n{told}");
        for usual in ["PATH=", "ROS_DOMAIN_ID=7", "TZ=UTC", "NAMED=by the file"] {
            assert!(told.contains(usual), "{name} lacks {usual}:\n{told}");
        }
    }
    assert!(!log("cotorra.log").contains("PATH="), "{}", log("cotorra.log"));
}

/// Tries to escape, and prints the result of each attempt. Waits for the file with the API's address.
const SPY: &str = r#"
tried() { if "$@" >/dev/null 2>&1; then echo "$what: ESCAPED"; else echo "$what: held"; fi; }
run=$(dirname "$(dirname "$HOME")")
what='read the history' tried cat "$run/history.sqlite"
what='write the history' tried sh -c "test -s '$run/history.sqlite' && echo forged >>'$run/history.sqlite'"
what='read the log of another' tried cat "$run/logs/cotorra.log"
what='write into the testbed file'"'"'s folder' tried touch forged
touch "$HOME/../forged" "$run/forged"
what='find the socket of the run' tried sh -c 'find "$PWD" -name "*.sock" | grep .'
what='enter the network of the host' tried nsenter --net=/proc/1/ns/net true
what='kill all that it sees' tried sh -c 'kill -0 1'
echo kept >"$HOME/kept" && cat "$HOME/kept"
while [ ! -e told/api ]; do sleep 0.05; done
what='use the API with its token' tried python3 -c 'import sys, urllib.request as u
u.build_opener(u.ProxyHandler({})).open(u.Request(sys.argv[1], headers={"Authorization": "Bearer " + sys.argv[2]}))' $(cat told/api)
what='take 1 GB of memory' tried python3 -c 'bytearray(b"x" * (1 << 30))'
what='start 3000 processes' tried sh -c 'for i in $(seq 3000); do sleep 1000 & done'
echo done
exec sleep 1000
"#;

#[test]
fn external_vnfs_are_confined_unless_trusted() {
    const TOKEN: &str = "operator-of-sixteen-characters";
    let place = TempDir::new().unwrap();
    fs::write(place.path().join("spy.sh"), SPY).unwrap();
    // The testbed file's folder also has the runs, so that only what is there at the start is shown of it.
    let told = place.path().join("told");
    fs::create_dir(&told).unwrap();
    let spy = "command: [sh, spy.sh], memory: 512 MB";
    let trusted = "command: [sh, -c, 'touch trusted; grep ^CapBnd /proc/self/status; echo done; sleep 1000'], trusted: true";
    let ping = "command: [sh, -c, 'ping -c 1 -W 60 cloud; echo done; sleep 1000']";
    let may = format!("{ping}, capabilities: [net_raw]");
    let vnfs = [("spy", spy), ("trusted", trusted), ("pings", &may)];
    let file = with_vnfs(&vnfs, "", place.path());
    let runtime = place.path().join("runtime");
    fs::create_dir(&runtime).unwrap();
    let run = Run::start_beside_with(&file, &["--until", "5min"], |command| {
        command.env("COTORRA_TOKEN", TOKEN).env("XDG_RUNTIME_DIR", &runtime);
    });
    assert_eq!(fs::read_dir(runtime.join("cotorra")).unwrap().count(), 2, "its entry and its socket");
    let address = format!("{}/api/v1/robots {TOKEN}", run.api);
    fs::write(told.join("part"), address).unwrap();
    fs::rename(told.join("part"), told.join("api")).unwrap();
    assert_eq!(run.ask("/api/v1/robots", Some(TOKEN)).0, 200);

    let log =
        |name: &str| fs::read_to_string(run.folder.join(format!("logs/vnfs/{name}.log"))).unwrap_or_default();
    let done = |name: &str| log(name).lines().any(|line| line == "done");
    wait_until(|| vnfs.iter().all(|(name, _)| done(name)));
    let told = log("spy");
    assert_eq!(told.matches(": held").count(), 10, "{told}");
    assert!(!told.contains("ESCAPED") && told.contains("kept"), "{told}");
    let forged = ["forged", "vnfs/forged"].map(|name| run.folder.join(name));
    let forged: Vec<_> =
        forged.iter().chain([&place.path().join("forged")]).filter(|path| path.exists()).cloned().collect();
    assert_eq!(forged, Vec::<PathBuf>::new());
    assert_eq!(fs::read_to_string(run.folder.join("vnfs/spy/kept")).unwrap(), "kept\n");
    for closed in ["vnfs", "logs"] {
        assert_eq!(fs::metadata(run.folder.join(closed)).unwrap().mode() & 0o777, 0o700, "{closed}");
    }
    assert_eq!(fs::metadata(run.folder.join("history.sqlite")).unwrap().mode() & 0o777, 0o600);

    assert!(place.path().join("trusted").exists(), "{}", log("trusted"));
    assert!(!log("trusted").contains("CapBnd:\t0000000000000000"), "{}", log("trusted"));
    assert!(log("pings").contains(" 0% packet loss"), "{}", log("pings"));
}

#[test]
fn a_folder_shared_with_other_users_is_rejected_for_vnfs() {
    let place = TempDir::new().unwrap();
    let shared = place.path().join("shared");
    fs::create_dir(&shared).unwrap();
    fs::set_permissions(&shared, fs::Permissions::from_mode(0o777)).unwrap();
    let file = with_vnfs(&[("other", "command: [sleep, '1000']")], "", &shared);
    let mut command = cotorra(["run", "--headless", "--until", "1s", "--api", "127.0.0.1:0", "--out"]);
    let refused = command.arg(place.path().join("runs")).arg(&file).output().unwrap();
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("folder of its own"), "{}", stderr(&refused));
}
