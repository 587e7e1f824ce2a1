//! An owner's use of a Wi-Fi interface, noted so that it can be put back.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use crate::{
    client::{Client, ControlError},
    control::{
        hostapd::{self, State},
        wpa_supplicant::{self, Listed},
    },
    daemon::{self, StartError},
    interface,
    names::InterfaceName,
    power::{Power, TransmitPower},
};

/// Folders in which programs have folders with control sockets, each with the name of an interface.
const FOLDERS: [&str; 2] = ["/run", "/var/run"];
/// Name that a network has which was added to somebody else's wpa_supplicant.
pub(crate) const MARK: &str = "cotorra";
/// Name of the file in a takeover's folder that says that the power is limited.
const LIMITED: &str = "limited";

/// A note of how a Wi-Fi interface was found.
///
/// Save it before the interface is changed. Then [`Owner::put_back`] works in any later process, however this one ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Owner {
    pub(crate) interface: InterfaceName,
    /// The program that controls it; `None` if none does.
    pub(crate) program: Option<OwnersProgram>,
    /// The bridge that it is a port of.
    pub(crate) bridge: Option<InterfaceName>,
    /// Whether it is set up.
    is_up: bool,
    /// Its power, in hundredths of dBm; `None` if it is down, or its driver does not report it.
    power: Option<i32>,
    /// Whether the kernel forgets its neighbours' addresses at a roam; `None` for a kernel that always does.
    forgets_neighbours: Option<bool>,
}

/// A program of the owner's.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum OwnersProgram {
    Hostapd {
        socket: PathBuf,
        /// Whether it serves.
        serves: bool,
    },
    Supplicant {
        socket: PathBuf,
        /// The networks that it may join.
        enabled: Vec<u32>,
    },
}

/// A Wi-Fi interface that cannot be used, or not be put back.
#[derive(Debug, thiserror::Error)]
pub enum TakeoverError {
    /// There is none.
    #[error("`{0}` is no Wi-Fi interface of this network namespace: `iw dev` lists them")]
    NoRadio(InterfaceName),
    /// Something uses it that cannot be asked to let it go.
    #[error(
        "`{0}` is in use, and neither a hostapd nor a wpa_supplicant with a control socket answers for it: give its program \
         `ctrl_interface=/run/hostapd` or `ctrl_interface=/run/wpa_supplicant`, or stop it"
    )]
    Unknown(InterfaceName),
    /// The owner's program is of the other kind.
    #[error("{program} of this machine uses `{interface}`: stop it, or name another interface")]
    OtherUse {
        /// The interface.
        interface: InterfaceName,
        /// The program.
        program: &'static str,
    },
    /// A program refused.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The own program did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The system refused.
    #[error("cannot {action} `{interface}`: {source}")]
    System {
        /// The attempt.
        action: &'static str,
        /// The interface.
        interface: InterfaceName,
        /// The reason.
        source: io::Error,
    },
}

impl Owner {
    /// Looks at an interface, and asks its program. The sockets of this process are files in the folder `own`.
    ///
    /// # Errors
    /// [`TakeoverError`].
    pub fn find(interface: &InterfaceName, own: &Path) -> Result<Self, TakeoverError> {
        if !interface::has_radio(interface) {
            return Err(TakeoverError::NoRadio(interface.clone()));
        }
        let mut program = None;
        for socket in sockets(interface, "hostapd") {
            if let Some(mut client) = connect(&socket, own)? {
                let serves = client.request(&hostapd::status())?.state != State::Disabled;
                program = Some(OwnersProgram::Hostapd { socket, serves });
                break;
            }
        }
        for socket in sockets(interface, "wpa_supplicant").into_iter().filter(|_| program.is_none()) {
            if let Some(mut client) = connect(&socket, own)? {
                let enabled = client.networks()?.into_iter().filter(|listed| listed.is_enabled);
                let enabled = enabled.map(|listed| listed.network).collect();
                program = Some(OwnersProgram::Supplicant { socket, enabled });
                break;
            }
        }
        if program.is_none() && interface::has_carrier(interface) {
            return Err(TakeoverError::Unknown(interface.clone()));
        }
        let is_up = interface::is_up(interface);
        let read_power = || TransmitPower::of(interface).and_then(|mut power| power.read()).ok().flatten();
        let power = is_up.then(read_power).flatten();
        let forgets = fs::read_to_string(interface::forgets_neighbours(interface)).ok();
        Ok(Self {
            interface: interface.clone(),
            program,
            bridge: interface::bridge(interface),
            is_up,
            power,
            forgets_neighbours: forgets.map(|forgets| forgets.trim() != "0"),
        })
    }

    /// Returns the interface.
    pub fn interface(&self) -> &InterfaceName {
        &self.interface
    }

    /// Puts everything back as it was found, even if something fails: ends the program that a takeover in the folder `folder` has
    /// left, and lets the owner's program have the interface again. A program that has ended since is left alone. Doing it
    /// again is harmless.
    ///
    /// # Errors
    /// The first error.
    pub fn put_back(&self, folder: &Path) -> Result<(), TakeoverError> {
        let own = own_folder(folder);
        // A process that was killed early leaves it empty.
        _ = fs::remove_dir(&own);
        let ended = if own.exists() { daemon::clear(&own).map_err(TakeoverError::from) } else { Ok(()) };
        ended
            .and(self.put_back_power(folder))
            .and(self.put_back_neighbours())
            .and(self.put_back_program(folder))
            .and(self.put_back_flags())
    }

    fn put_back_program(&self, folder: &Path) -> Result<(), TakeoverError> {
        match &self.program {
            None => Ok(()),
            Some(OwnersProgram::Hostapd { socket, serves }) => {
                let Some(mut client) = connect(socket, folder)? else { return Ok(()) };
                let is_disabled = client.request(&hostapd::status())?.state == State::Disabled;
                if *serves && is_disabled {
                    client.request(&hostapd::enable())?;
                }
                Ok(())
            }
            Some(OwnersProgram::Supplicant { socket, enabled }) => {
                let Some(mut client) = connect(socket, folder)? else { return Ok(()) };
                let present = client.networks()?;
                remove_ours(&mut client, &present)?;
                // The owner's access point may have the address of one that has just ended.
                _ = client.request(&wpa_supplicant::ignore_none());
                for Listed { network, is_enabled } in present {
                    if enabled.contains(&network) && !is_enabled {
                        client.request(&wpa_supplicant::enable_network(network))?;
                    }
                }
                Ok(())
            }
        }
    }

    /// Limits the power in a takeover in the folder `folder`, where a file says so until it is put back.
    pub(crate) fn limit_power(&self, power: Power, folder: &Path) -> Result<(), TakeoverError> {
        let limit = || {
            // First, so that it is put back even if this process is killed before it is done.
            fs::write(folder.join(LIMITED), "")?;
            TransmitPower::of(&self.interface)?.change(power)
        };
        limit().map_err(self.system("limit the power of"))
    }

    /// Puts the power back if it was limited in this folder.
    pub(crate) fn put_back_power(&self, folder: &Path) -> Result<(), TakeoverError> {
        let limited = folder.join(LIMITED);
        if !limited.exists() {
            return Ok(());
        }
        // Whatever the kernel reports: a station that has no access point may have a limit that does not show. It does not tell
        // either whether the power was automatic.
        let before = self.power.map_or(Power::Automatic, Power::AtMost);
        let put_back = || {
            TransmitPower::of(&self.interface)?.change(before)?;
            fs::remove_file(limited)
        };
        put_back().map_err(self.system("put back the power of"))
    }

    fn put_back_neighbours(&self) -> Result<(), TakeoverError> {
        self.forgets_neighbours.map_or(Ok(()), |forgets| self.forget_neighbours(forgets))
    }

    /// Lets a roam clear the kernel's table of neighbours, or not. A kernel that always does is left alone.
    pub(crate) fn forget_neighbours(&self, forgets: bool) -> Result<(), TakeoverError> {
        if self.forgets_neighbours.is_none() {
            return Ok(());
        }
        let path = interface::forgets_neighbours(&self.interface);
        let text = if forgets { "1" } else { "0" };
        if fs::read_to_string(&path).is_ok_and(|present| present.trim() == text) {
            return Ok(());
        }
        fs::write(path, text).map_err(self.system("change `arp_evict_nocarrier` of"))
    }

    /// Sets the interface up if it was. A program that ends sets its interface down.
    fn put_back_flags(&self) -> Result<(), TakeoverError> {
        if !self.is_up || interface::is_up(&self.interface) || !interface::has_radio(&self.interface) {
            return Ok(());
        }
        interface::set_up(&self.interface).map_err(self.system("set up"))
    }

    pub(crate) fn system(&self, action: &'static str) -> impl FnOnce(io::Error) -> TakeoverError {
        let interface = self.interface.clone();
        move |source| TakeoverError::System { action, interface, source }
    }
}

/// Removes networks that a takeover added.
fn remove_ours(client: &mut Client, present: &[Listed]) -> Result<(), TakeoverError> {
    for listed in present {
        let mark = client.request(&wpa_supplicant::marked(listed.network))?;
        if mark.as_deref() == Some(&format!("\"{MARK}\"")) {
            client.request(&wpa_supplicant::remove_network(listed.network))?;
        }
    }
    Ok(())
}

/// Returns the folder of a takeover's own program.
pub(crate) fn own_folder(folder: &Path) -> PathBuf {
    folder.join("own")
}

/// Returns the sockets of a program for an interface.
fn sockets(interface: &InterfaceName, program: &str) -> Vec<PathBuf> {
    let paths = FOLDERS.map(|folder| Path::new(folder).join(program).join(interface.as_str()));
    paths.into_iter().filter(|path| path.exists()).collect()
}

/// Connects to a program; `None` if it has ended.
pub(crate) fn connect(socket: &Path, own: &Path) -> Result<Option<Client>, ControlError> {
    match Client::connect(socket, own) {
        Err(ControlError::Gone { .. }) => Ok(None),
        client => client.map(Some),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interface_without_a_radio_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = Owner::find(&"lo".parse().expect("a name"), folder.path()).expect_err("no radio");
        assert!(error.to_string().starts_with("`lo` is no Wi-Fi interface"), "{error}");
    }

    #[test]
    fn a_power_is_put_back_only_if_it_was_limited() {
        let folder = tempfile::tempdir().expect("a folder");
        let interface = "missing0".parse().expect("a name");
        let owner = Owner {
            interface,
            program: None,
            bridge: None,
            is_up: true,
            power: None,
            forgets_neighbours: None,
        };
        owner.put_back(folder.path()).expect("there is nothing to put back");
        owner.limit_power(Power::AtMost(900), folder.path()).expect_err("there is no such interface");
        let error = owner.put_back(folder.path()).expect_err("it may have been limited");
        assert!(error.to_string().starts_with("cannot put back the power of `missing0`"), "{error}");
    }

    #[test]
    fn a_note_survives_its_way_to_the_disk() {
        let program =
            OwnersProgram::Supplicant { socket: "/run/wpa_supplicant/wlan0".into(), enabled: vec![0, 2] };
        let owner = Owner {
            interface: "wlan0".parse().expect("a name"),
            program: Some(program),
            bridge: None,
            is_up: true,
            power: Some(2000),
            forgets_neighbours: Some(true),
        };
        let json = serde_json::to_string(&owner).expect("JSON");
        assert_eq!(serde_json::from_str::<Owner>(&json).expect("a note"), owner);
    }
}
