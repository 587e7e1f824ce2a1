//! Checks which promises of [SECURITY.md] hold on this machine, as this user.
//!
//! [SECURITY.md]: ../../../../SECURITY.md

use std::{
    env, fs, io,
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
};

use cotorra_datapath::{Capability, CapabilityState};
use cotorra_enrolment::{Authority, EnrolmentError};
use cotorra_plugin::runs::Runs;

use crate::running::token_text;

/// Mode bits that let others than the owner write.
const WRITABLE: u32 = 0o022;
/// Mode bit of folders in which only owners remove their files.
const STICKY: u32 = 0o1000;

/// Tests what the promises of SECURITY.md depend on. Call it before the process enters a user namespace, in which its user has
/// another number.
pub fn probe(here: &Path) -> Vec<Capability> {
    let capability = |name, purpose, result, remedy| Capability {
        name,
        purpose,
        state: match result {
            Ok(detail) => CapabilityState::Available(detail),
            Err(error) => CapabilityState::Missing { reason: io::Error::to_string(&error), remedy },
        },
    };
    vec![
        capability(
            "socket of runs",
            "only you steer your runs",
            socket(),
            "remove that folder, or let XDG_RUNTIME_DIR name a folder of yours; until then your tools do not find your runs",
        ),
        capability(
            "folder",
            "nobody exchanges the files of your runs",
            owned(here, rustix::process::geteuid().as_raw()),
            "run cotorra in a folder that only you can write to, or give it one by --out",
        ),
        capability(
            "token",
            "programs on other machines show that they are yours",
            token(),
            "use 16 characters or more: COTORRA_TOKEN=$(openssl rand -hex 16)",
        ),
        capability(
            "authority",
            "clients on other machines know your runs, and agents know their core",
            authority(),
            "let only you use the folder `cotorra/agents` in XDG_CONFIG_HOME or ~/.config, or remove it and enrol all agents anew",
        ),
        capability(
            "trust",
            "testbed files from elsewhere run no commands before you agree",
            trust(),
            "unset COTORRA_TRUST where you use files of others",
        ),
        capability(
            "links in folders of all",
            "nobody leads what you write in /tmp to another file",
            protected(&["protected_symlinks", "protected_hardlinks", "protected_regular"]),
            "as root: `sysctl -w fs.protected_symlinks=1 fs.protected_hardlinks=1 fs.protected_regular=2`",
        ),
        capability(
            "core dumps",
            "memory with secrets gets into no file of others",
            setuid_dumps(),
            "as root: `sysctl -w fs.suid_dumpable=0`",
        ),
    ]
}

/// Tests the folder in which runs put their sockets.
fn socket() -> io::Result<String> {
    let folders = Runs::of_user().folders().to_vec();
    let first = folders.first().ok_or(io::ErrorKind::NotFound)?;
    let (_, refused) = Runs::of_user().leftovers();
    match refused.first() {
        Some(error) => Err(io::Error::other(error.to_string())),
        None => Ok(first.display().to_string()),
    }
}

/// Tests whether others can exchange names on the way to a folder.
fn owned(folder: &Path, user: u32) -> io::Result<String> {
    let folder = folder.canonicalize()?;
    for path in folder.ancestors() {
        let found = fs::metadata(path)?;
        let is_others = found.uid() != user && found.uid() != 0;
        let is_writable = found.mode() & WRITABLE != 0 && (path == folder || found.mode() & STICKY == 0);
        if is_others || is_writable {
            let why = if is_others { "belongs to another user" } else { "can be written by others" };
            return Err(io::Error::other(format!("{} {why}", path.display())));
        }
    }
    Ok(folder.display().to_string())
}

fn token() -> io::Result<String> {
    match token_text() {
        None => Ok("none; you use the socket".to_owned()),
        Some(text) if text.len() >= 16 => Ok("in COTORRA_TOKEN".to_owned()),
        Some(_) => Err(io::Error::other("COTORRA_TOKEN is too short to be a secret")),
    }
}

fn authority() -> io::Result<String> {
    let folder = Authority::default_folder()
        .ok_or_else(|| io::Error::other("neither XDG_CONFIG_HOME nor HOME names a folder for it"))?;
    match Authority::open(&folder) {
        Ok(authority) => Ok(authority.folder().display().to_string()),
        Err(EnrolmentError::NoAuthority { .. }) => Ok("none; made when it is needed".to_owned()),
        Err(error) => Err(io::Error::other(error.to_string())),
    }
}

fn trust() -> io::Result<String> {
    match env::var_os(crate::approval::TRUST_VARIABLE) {
        None => Ok(String::new()),
        Some(_) => Err(io::Error::other("COTORRA_TRUST is set: every testbed file is trusted")),
    }
}

/// Tests settings of the kernel that must not be 0.
fn protected(names: &[&str]) -> io::Result<String> {
    for name in names {
        if setting(name)? == 0 {
            return Err(io::Error::other(format!("fs.{name} is 0")));
        }
    }
    Ok(String::new())
}

fn setuid_dumps() -> io::Result<String> {
    match setting("suid_dumpable")? {
        1 => Err(io::Error::other("fs.suid_dumpable is 1")),
        _ => Ok(String::new()),
    }
}

/// Reads a setting of the kernel.
fn setting(name: &str) -> io::Result<u32> {
    let path = PathBuf::from("/proc/sys/fs").join(name);
    let text = fs::read_to_string(&path)
        .map_err(|error| io::Error::other(format!("cannot read {}: {error}", path.display())))?;
    text.trim().parse().map_err(|_| io::Error::other(format!("{} is not a number", path.display())))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn a_folder_that_others_can_exchange_is_named() {
        let place = tempfile::tempdir().unwrap();
        let user = rustix::process::geteuid().as_raw();
        let folder = place.path().join("below/runs");
        fs::create_dir_all(&folder).unwrap();
        owned(&folder, user).unwrap();
        let below = place.path().join("below");
        fs::set_permissions(&below, fs::Permissions::from_mode(0o777)).unwrap();
        let error = owned(&folder, user).unwrap_err().to_string();
        assert!(error.contains("below can be written by others"), "{error}");
        // As in /tmp: users can add files, but not exchange those of others.
        fs::set_permissions(&below, fs::Permissions::from_mode(0o1777)).unwrap();
        owned(&folder, user).unwrap();
        assert!(owned(&below, user).is_err());
        if user != 0 {
            // Files of root are a risk of all users alike.
            let error = owned(&folder, user + 1).unwrap_err().to_string();
            assert!(error.contains("belongs to another user"), "{error}");
        }
    }
}
