//! Leftovers of runs whose process was killed: control groups, conditions of interfaces, and containers.

use std::path::PathBuf;

use cotorra_engine::Cgroups;

/// Leftovers of runs whose process was killed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Leftovers {
    /// Control groups.
    pub control_groups: Vec<PathBuf>,
    /// Names of interfaces of this machine that still had conditions.
    pub interfaces: Vec<String>,
    /// Containers, by the name of their run.
    pub containers: Vec<String>,
    /// Leftovers that could not be removed, each with the error.
    pub kept: Vec<String>,
}

/// Returns the leftovers that [`clean`] would remove.
pub fn leftovers() -> Leftovers {
    let interfaces = cotorra_netem::leftovers().into_iter().map(|interface| interface.name).collect();
    let containers = cotorra_containers::leftovers();
    Leftovers { control_groups: Cgroups::leftovers(), interfaces, containers, kept: Vec::new() }
}

/// Removes the leftovers of runs whose process was killed. Returns those that it removed, and those that it could not.
pub fn clean() -> Leftovers {
    let (control_groups, kept) = Cgroups::clean();
    let kept = kept.iter().map(ToString::to_string).collect();
    let mut cleaned = Leftovers { control_groups, kept, ..Leftovers::default() };
    for (interface, done) in cotorra_netem::put_back() {
        match done {
            Ok(()) => cleaned.interfaces.push(interface.name),
            Err(error) => cleaned.kept.push(format!("{} cannot be put back: {error}", interface.name)),
        }
    }
    let containers = cotorra_containers::clean();
    cleaned.containers.extend(containers.runs.into_iter().map(|(run, _)| run));
    cleaned.kept.extend(containers.kept);
    cleaned
}
