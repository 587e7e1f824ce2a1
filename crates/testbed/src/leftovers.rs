//! Leftovers of runs whose process was killed: control groups, and conditions of interfaces.

use std::path::PathBuf;

use cotorra_engine::Cgroups;

/// Leftovers of runs whose process was killed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Leftovers {
    /// Control groups.
    pub control_groups: Vec<PathBuf>,
    /// Names of interfaces of this machine that still had conditions.
    pub interfaces: Vec<String>,
    /// Leftovers that could not be removed, each with the error.
    pub kept: Vec<String>,
}

/// Returns the leftovers that [`clean`] would remove.
pub fn leftovers() -> Leftovers {
    let interfaces = cotorra_netem::leftovers().into_iter().map(|interface| interface.name).collect();
    Leftovers { control_groups: Cgroups::leftovers(), interfaces, kept: Vec::new() }
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
    cleaned
}
