//! Limits of an ordinary user's VNFs in a control group that was delegated to that user, as systemd does with `Delegate=yes`.
//!
//! Needs root and control groups of version 2, as in the kernel of `scripts/uml`, and does nothing elsewhere.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::{
    env, fs, io,
    os::unix::{
        fs::{PermissionsExt as _, chown},
        process::ExitStatusExt as _,
    },
    path::Path,
    process::Command,
};

use cotorra_engine::{Cgroups, InstanceId};
use cotorra_graph::NodeId;

/// Makes the process the ordinary user's run of a test.
const HELPER: &str = "COTORRA_TEST_DELEGATION";
const ROOT: &str = "/sys/fs/cgroup";
const NOBODY: u32 = 65534;
const LIMIT: u64 = 64_000_000;
/// Takes this many bytes of shared memory at once, which no resource limit of a process counts.
const SHARE: &str = "
import mmap, sys
MAP_POPULATE = 0x8000
mmap.mmap(-1, int(sys.argv[1]), flags=mmap.MAP_SHARED | MAP_POPULATE)
";

/// Runs a test again as an ordinary user, in a group of version 2 that is its own, where this machine can.
fn as_owner_of_a_group(test: &str, group: &str) -> io::Result<()> {
    let root = Path::new(ROOT);
    let in_kernel = env::var_os("COTORRA_KERNEL").is_some();
    if in_kernel && !root.join("cgroup.procs").exists() {
        let mounted = Command::new("mount").args(["-t", "cgroup2", "cgroup2", ROOT]).status()?;
        assert!(mounted.success());
    }
    let controllers = fs::read_to_string(root.join("cgroup.controllers")).unwrap_or_default();
    if !controllers.contains("memory") || !rustix::process::geteuid().is_root() {
        assert!(!in_kernel, "this kernel has no control groups of version 2");
        return Ok(());
    }
    fs::write(root.join("cgroup.subtree_control"), "+cpu +memory +pids")?;
    let group = root.join(group);
    fs::create_dir(&group)?;
    chown(&group, Some(NOBODY), Some(NOBODY))?;
    for file in ["cgroup.procs", "cgroup.threads", "cgroup.subtree_control"] {
        chown(group.join(file), Some(NOBODY), Some(NOBODY))?;
    }
    // An ordinary user may not read the folder of this program.
    let folder = tempfile::tempdir_in("/run")?;
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o755))?;
    let program = folder.path().join("delegation");
    fs::copy(env::current_exe()?, &program)?;
    let join = "echo $$ >$0/cgroup.procs && exec setpriv --reuid nobody --regid nogroup --clear-groups -- $@";
    let mut user = Command::new("sh");
    user.args(["-c", join]).arg(&group).arg(&program).args(["--exact", test, "--nocapture"]);
    assert!(user.env(HELPER, "1").current_dir("/").status()?.success());
    Ok(())
}

#[test]
fn a_delegated_group_limits_shared_memory() {
    if env::var_os(HELPER).is_none() {
        as_owner_of_a_group("a_delegated_group_limits_shared_memory", "delegated").unwrap();
        return;
    }
    let groups = Cgroups::new().unwrap();
    let node = NodeId::new("edge").unwrap();
    let share = |instance: u64, bytes: u64| {
        let procs = groups.limit(InstanceId(instance), &node, 1.0, LIMIT).unwrap();
        let [procs] = &*procs else { panic!("{procs:?}") };
        let mut vnf = Command::new("sh");
        vnf.args(["-c", "echo $$ >$0 && exec python3 -c \"$@\"", procs.to_str().unwrap(), SHARE]);
        let status = vnf.arg(bytes.to_string()).status().unwrap();
        groups.release(InstanceId(instance), &node);
        status
    };
    assert!(share(1, LIMIT / 2).success());
    assert_eq!(share(2, 2 * LIMIT).signal(), Some(9));
}

#[test]
fn a_group_with_other_programs_is_left_as_it_was() {
    if env::var_os(HELPER).is_none() {
        as_owner_of_a_group("a_group_with_other_programs_is_left_as_it_was", "shared").unwrap();
        return;
    }
    let own = Path::new(ROOT).join("shared");
    // Not a descendant of this process once its parent has ended.
    let other = Command::new("sh").args(["-c", "sleep 1000 >/dev/null 2>&1 & echo $!"]).output().unwrap();
    let other = String::from_utf8(other.stdout).unwrap();
    let error = Cgroups::new().unwrap_err().to_string();
    assert!(error.contains("pass controllers on"), "{error}");
    let processes = fs::read_to_string(own.join("cgroup.procs")).unwrap();
    assert!(processes.lines().any(|pid| pid == std::process::id().to_string()), "{processes}");
    let groups = fs::read_dir(own).unwrap().flatten().filter(|entry| entry.path().is_dir());
    assert_eq!(groups.count(), 0);
    assert!(Command::new("kill").arg(other.trim()).status().unwrap().success());
}
