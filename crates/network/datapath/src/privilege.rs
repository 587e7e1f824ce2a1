//! The rights that emulation needs, also for ordinary users. Inside a user namespace of their own they are root over
//! the network namespaces that they make, and over nothing else.

use std::{fs, io};

use crate::{
    error::{Action, Error},
    sys,
};

/// Source of the process's rights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Privilege {
    /// The process already had them.
    Root,
    /// The process is root in a user namespace that it entered.
    UserNamespace,
}

/// Obtains the right to make network namespaces. Does nothing with `CAP_NET_ADMIN` and `CAP_SYS_ADMIN`, as root has
/// them. An ordinary user enters a user namespace that maps it to root.
///
/// Call it first thing in `main`.
///
/// # Errors
/// [`Error::SeveralThreads`], [`Error::RightsWithheld`], or [`Error::Kernel`] where user namespaces are forbidden.
pub fn enter_user_namespace_if_needed() -> Result<Privilege, Error> {
    if have_rights() {
        return Ok(Privilege::Root);
    }
    let (user, group) = sys::effective_ids();
    sys::unshare(libc::CLONE_NEWUSER).map_err(several_threads)?;
    // A user may map its group only after giving up setgroups (user_namespaces(7)).
    fs::write("/proc/self/setgroups", "deny").action("give up setgroups in the user namespace")?;
    fs::write("/proc/self/uid_map", format!("0 {user} 1")).action("map the user to root")?;
    fs::write("/proc/self/gid_map", format!("0 {group} 1")).action("map the group to root")?;
    // Ubuntu's AppArmor allows the unshare, then removes the capabilities.
    if have_rights() { Ok(Privilege::UserNamespace) } else { Err(Error::RightsWithheld) }
}

/// Hides this process's memory from other programs of the same user, if it runs as root: `cotorra exec`, as root, still
/// has access. An ordinary user's processes may inspect each other; those in nodes do not see them.
///
/// # Errors
/// [`Error::Kernel`]; no known kernel returns it.
pub fn hide_memory() -> Result<(), Error> {
    const SYS_PTRACE: u64 = 1 << 19;
    let is_seen = effective_capabilities().is_some_and(|have| have & SYS_PTRACE != 0);
    if is_seen && is_root() { sys::set_not_dumpable().action("hide its memory") } else { Ok(()) }
}

/// Whether this process is root of the whole machine, or of its container.
pub(crate) fn is_root() -> bool {
    sys::effective_ids().0 == 0
        && fs::read_to_string("/proc/self/uid_map").is_ok_and(|map| map.contains("4294967295"))
}

/// Whether the process has `CAP_NET_ADMIN` and `CAP_SYS_ADMIN` in its namespace.
pub(crate) fn have_rights() -> bool {
    const NET_ADMIN: u64 = 1 << 12;
    const SYS_ADMIN: u64 = 1 << 21;
    let needed = NET_ADMIN | SYS_ADMIN;
    effective_capabilities().is_some_and(|have| have & needed == needed)
}

/// Returns the effective capabilities, one bit each (capabilities(7)).
fn effective_capabilities() -> Option<u64> {
    let status = fs::read_to_string("/proc/thread-self/status").ok()?;
    let set = status.lines().find_map(|line| line.strip_prefix("CapEff:"))?;
    u64::from_str_radix(set.trim(), 16).ok()
}

/// Distinguishes a process with several threads from one without the right.
pub(crate) fn several_threads(error: io::Error) -> Error {
    match error.raw_os_error() {
        Some(libc::EINVAL) => Error::SeveralThreads,
        _ => Error::Kernel { action: "enter a user namespace", source: error },
    }
}
