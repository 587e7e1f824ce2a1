//! CPU and memory limits of VNFs through cgroups, version 2 or 1, where this process may make them.
//!
//! A run's groups are `cotorra-<pid>/<instance>`: what a killed run left behind is known by a process that is gone.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use super::engine::InstanceId;

const ROOT: &str = "/sys/fs/cgroup";
const PREFIX: &str = "cotorra-";
const CPU_PERIOD_US: f64 = 100_000.0;
/// What real-time threads of a run's VNFs get in a second at most, µs: the kernel has 950,000 for all groups together,
/// and other runs may want their part.
const REAL_TIME_US: u64 = 100_000;
/// What those of one VNF get in a second, µs: too little to stop anyone else, and many times what answering takes - a
/// group that used it up stands still for the rest of its second.
const VNF_REAL_TIME_US: u64 = 20_000;

/// Why limits cannot be set.
#[derive(Debug, thiserror::Error)]
#[error("{what} {}: {source}", path.display())]
pub struct CgroupError {
    what: &'static str,
    path: PathBuf,
    source: io::Error,
}

fn at(what: &'static str, path: &Path) -> impl FnOnce(io::Error) -> CgroupError {
    let path = path.to_owned();
    move |source| CgroupError { what, path, source }
}

/// How this machine mounts the controllers.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Hierarchy {
    /// One tree with both controllers.
    V2(PathBuf),
    /// A tree each.
    V1 { cpu: PathBuf, memory: PathBuf },
}

impl Hierarchy {
    fn find(root: &Path) -> Option<Self> {
        let controllers = fs::read_to_string(root.join("cgroup.subtree_control")).unwrap_or_default();
        if ["cpu", "memory"].iter().all(|c| controllers.split_whitespace().any(|has| has == *c)) {
            return Some(Self::V2(root.to_owned()));
        }
        let (cpu, memory) = (root.join("cpu"), root.join("memory"));
        let both = cpu.join("cpu.cfs_quota_us").exists() || cpu.join("cgroup.procs").exists();
        (both && memory.join("cgroup.procs").exists()).then_some(Self::V1 { cpu, memory })
    }

    fn trees(&self) -> Vec<&Path> {
        match self {
            Self::V2(root) => vec![root],
            Self::V1 { cpu, memory } => vec![cpu, memory],
        }
    }
}

/// The groups of one run.
#[derive(Debug)]
pub struct Cgroups {
    hierarchy: Hierarchy,
    name: String,
}

impl Cgroups {
    /// Makes this process's groups.
    ///
    /// # Errors
    /// Where there are no controllers, or this user may not make groups.
    pub fn new() -> Result<Self, CgroupError> {
        Self::under(Path::new(ROOT))
    }

    fn under(root: &Path) -> Result<Self, CgroupError> {
        let missing = || io::Error::new(io::ErrorKind::NotFound, "no cpu and memory controllers");
        let hierarchy =
            Hierarchy::find(root).ok_or_else(missing).map_err(at("look for controllers in", root))?;
        let groups = Self { hierarchy, name: format!("{PREFIX}{}", std::process::id()) };
        for path in groups.paths() {
            fs::create_dir_all(&path).map_err(at("make the cgroup", &path))?;
            if matches!(groups.hierarchy, Hierarchy::V2(_)) {
                let control = path.join("cgroup.subtree_control");
                fs::write(&control, "+cpu +memory").map_err(at("pass controllers on in", &control))?;
            }
        }
        if let Hierarchy::V1 { cpu, .. } = &groups.hierarchy {
            allow_real_time(&cpu.join(&groups.name), REAL_TIME_US);
        }
        Ok(groups)
    }

    fn paths(&self) -> Vec<PathBuf> {
        self.hierarchy.trees().into_iter().map(|tree| tree.join(&self.name)).collect()
    }

    /// Makes an instance's group with its limits, and says which `cgroup.procs` files its process is to be written to.
    ///
    /// # Errors
    /// Where the kernel refuses.
    pub fn limit(
        &self,
        instance: InstanceId,
        cpus: f64,
        memory_bytes: u64,
    ) -> Result<Vec<PathBuf>, CgroupError> {
        let mut procs = Vec::new();
        for path in self.paths().into_iter().map(|p| p.join(instance.0.to_string())) {
            fs::create_dir_all(&path).map_err(at("make the cgroup", &path))?;
            procs.push(path.join("cgroup.procs"));
        }
        let quota = (cpus * CPU_PERIOD_US).max(1000.0) as u64;
        let set =
            |path: PathBuf, value: String| fs::write(&path, value).map_err(at("set the limit in", &path));
        match &self.hierarchy {
            Hierarchy::V2(root) => {
                let group = root.join(&self.name).join(instance.0.to_string());
                set(group.join("cpu.max"), format!("{quota} {CPU_PERIOD_US}"))?;
                set(group.join("memory.max"), memory_bytes.to_string())?;
            }
            Hierarchy::V1 { cpu, memory } => {
                let group = |tree: &Path| tree.join(&self.name).join(instance.0.to_string());
                set(group(cpu).join("cpu.cfs_period_us"), format!("{CPU_PERIOD_US}"))?;
                set(group(cpu).join("cpu.cfs_quota_us"), quota.to_string())?;
                allow_real_time(&group(cpu), VNF_REAL_TIME_US);
                set(group(memory).join("memory.limit_in_bytes"), memory_bytes.to_string())?;
            }
        }
        Ok(procs)
    }

    /// Removes an instance's group; one that still has processes is left for [`Cgroups::clean`].
    pub fn release(&self, instance: InstanceId) {
        for path in self.paths() {
            let _ = fs::remove_dir(path.join(instance.0.to_string()));
        }
    }

    /// Removes what runs left behind whose process is gone; gives the groups that it removed.
    pub fn clean() -> Vec<PathBuf> {
        Self::leftovers().into_iter().filter(|group| remove_group(group)).collect()
    }

    /// What [`Self::clean`] would remove.
    pub fn leftovers() -> Vec<PathBuf> {
        Self::leftovers_under(Path::new(ROOT), |pid| Path::new("/proc").join(pid.to_string()).exists())
    }

    fn leftovers_under(root: &Path, lives: impl Fn(u32) -> bool) -> Vec<PathBuf> {
        let Some(hierarchy) = Hierarchy::find(root) else { return Vec::new() };
        let groups = hierarchy.trees().into_iter().flat_map(fs::read_dir).flatten().flatten();
        let is_left = |group: &fs::DirEntry| {
            let name = group.file_name();
            let pid =
                name.to_str().and_then(|name| name.strip_prefix(PREFIX)).and_then(|pid| pid.parse().ok());
            pid.is_some_and(|pid| !lives(pid))
        };
        groups.filter(is_left).map(|group| group.path()).collect()
    }
}

/// Lets threads of a group be real-time, which version 1 forbids by default where the kernel counts their time. Where
/// it does not count, or refuses, a VNF that asks for it is scheduled like any other.
fn allow_real_time(group: &Path, runtime_us: u64) {
    let runtime = group.join("cpu.rt_runtime_us");
    if !runtime.exists() {
        return;
    }
    if let Err(error) = fs::write(&runtime, runtime_us.to_string()) {
        tracing::debug!("no real-time threads in {}: {error}", group.display());
    }
}

fn remove_group(group: &Path) -> bool {
    for child in fs::read_dir(group).into_iter().flatten().flatten() {
        if child.file_type().is_ok_and(|t| t.is_dir()) {
            let _ = fs::remove_dir(child.path());
        }
    }
    fs::remove_dir(group).is_ok()
}

impl Drop for Cgroups {
    fn drop(&mut self) {
        for path in self.paths() {
            remove_group(&path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder that looks like a v1 hierarchy.
    fn v1() -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for tree in ["cpu", "memory"] {
            fs::create_dir(root.path().join(tree)).unwrap();
            fs::write(root.path().join(tree).join("cgroup.procs"), "").unwrap();
        }
        root
    }

    #[test]
    fn limits_are_written_where_version_1_reads_them() {
        let root = v1();
        let groups = Cgroups::under(root.path()).unwrap();
        let procs = groups.limit(InstanceId(7), 1.5, 1 << 20).unwrap();
        assert_eq!(procs.len(), 2);
        let read = |file: &str| {
            let group = format!("{PREFIX}{}/7", std::process::id());
            let (tree, file) = file.split_once('/').unwrap();
            fs::read_to_string(root.path().join(tree).join(group).join(file)).unwrap()
        };
        assert_eq!(read("cpu/cpu.cfs_quota_us"), "150000");
        assert_eq!(read("memory/memory.limit_in_bytes"), "1048576");
    }

    #[test]
    fn only_groups_of_processes_that_are_gone_are_cleaned() {
        let root = v1();
        for pid in [11, 12] {
            fs::create_dir_all(root.path().join(format!("cpu/{PREFIX}{pid}/1"))).unwrap();
        }
        fs::create_dir(root.path().join("cpu/somebody-elses")).unwrap();
        let left = Cgroups::leftovers_under(root.path(), |pid| pid == 12);
        assert_eq!(left, [root.path().join(format!("cpu/{PREFIX}11"))]);
        assert!(remove_group(&left[0]));
        assert!(root.path().join(format!("cpu/{PREFIX}12/1")).exists());
        assert!(root.path().join("cpu/somebody-elses").exists());
    }

    #[test]
    fn a_machine_without_controllers_says_so() {
        let root = tempfile::tempdir().unwrap();
        let error = Cgroups::under(root.path()).unwrap_err().to_string();
        assert!(error.contains("no cpu and memory controllers"), "{error}");
    }
}
