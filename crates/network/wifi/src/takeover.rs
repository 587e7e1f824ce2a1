//! Wi-Fi interfaces of a machine's owner, taken over for a while.
//!
//! hostapd does not reveal its passphrases, so settings that are changed could not be put back. A takeover therefore
//! leaves the owner's hostapd as it is, and disables it: a hostapd of its own serves meanwhile. wpa_supplicant gets one
//! network more, and gets the order to join that.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{
    access_point::{AccessPoint, AccessPointDriver, Bss, Radio},
    channel::Channel,
    client::{Client, ControlError},
    control::{
        hostapd::{self, Neighbour, State},
        wpa_supplicant,
    },
    daemon::{Daemon, launch_here},
    names::InterfaceName,
    owner::{MARK, Owner, OwnersProgram, TakeoverError, own_folder},
    power::Power,
    station::{Network, Station, StationDriver},
};

/// Beacons that announce another channel.
const ANNOUNCEMENTS: u8 = 5;

/// Settings of an access point, for any interface.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccessPointSettings {
    /// The settings of its radio.
    pub radio: Radio,
    /// The BSS of its interface. Without a bridge, it joins that in which the interface was found.
    pub bss: Bss,
    /// Virtual access points, each on an interface that hostapd makes.
    pub virtual_aps: Vec<(InterfaceName, Bss)>,
    /// The most power; `None` leaves it as it was found.
    pub power: Option<Power>,
    /// Access points that are announced to stations (802.11k).
    pub neighbours: Vec<Neighbour>,
}

/// Settings of a station, for any interface.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StationSettings {
    /// The network that it joins, and no other.
    pub network: Network,
    /// The most power; `None` leaves it as it was found.
    pub power: Option<Power>,
}

/// A Wi-Fi interface that is taken over. It is put back when this is dropped.
#[derive(Debug)]
pub struct Taken {
    owner: Owner,
    folder: PathBuf,
    /// `None` while nothing is on the air.
    on_air: Option<OnAir>,
    /// Number of times that a program was begun, or told to join another network.
    programs: u64,
}

/// Role of a taken interface.
#[derive(Debug)]
enum OnAir {
    AccessPoint { daemon: Daemon, settings: Box<AccessPointSettings> },
    OwnStation { daemon: Daemon, network: Box<Network> },
    AddedNetwork { socket: PathBuf, number: u32, network: Box<Network> },
}

impl Taken {
    /// Prepares to take an interface over. Files of the takeover are in the private folder `folder`. Save the [`Owner`] before
    /// anything else.
    pub fn new(owner: Owner, folder: &Path) -> Self {
        Self { owner, folder: folder.to_owned(), on_air: None, programs: 0 }
    }

    /// Sets an owner's access point aside.
    fn set_aside(&self) -> Result<(), TakeoverError> {
        if let Some(OwnersProgram::Hostapd { socket, .. }) = &self.owner.program {
            let mut client = Client::connect(socket, &self.folder)?;
            if client.request(&hostapd::status())?.state != State::Disabled {
                client.request(&hostapd::disable())?;
            }
        }
        Ok(())
    }

    /// Serves an access point like this from now on. A change of the channel alone is announced to stations, and one of virtual
    /// access points, neighbours or power alone leaves others in peace. After any other, stations have to come again.
    ///
    /// # Errors
    /// [`TakeoverError`]. It may not serve then.
    pub fn serve(&mut self, wanted: &AccessPointSettings) -> Result<(), TakeoverError> {
        if let Some(OwnersProgram::Supplicant { .. }) = &self.owner.program {
            return Err(self.other_use("wpa_supplicant"));
        }
        self.set_aside()?;
        let is_same_bss = |its: &AccessPointSettings| {
            its.bss == wanted.bss
                && Radio { channel: wanted.radio.channel, ..its.radio.clone() } == wanted.radio
        };
        match self.on_air.take() {
            Some(OnAir::AccessPoint { daemon, settings }) if is_same_bss(&settings) => {
                change(&daemon, &settings, wanted, |bss| self.with_bridge(bss))?;
                self.on_air = Some(OnAir::AccessPoint { daemon, settings: Box::new(wanted.clone()) });
            }
            before => {
                drop(before);
                let daemon = self.start_hostapd(wanted)?;
                let settings = Box::new(wanted.clone());
                self.programs += 1;
                self.on_air = Some(OnAir::AccessPoint { daemon, settings });
            }
        }
        self.limit_power(wanted.power)
    }

    fn start_hostapd(&self, wanted: &AccessPointSettings) -> Result<Daemon, TakeoverError> {
        let virtual_ap = |(interface, bss): &(InterfaceName, Bss)| (interface.clone(), self.with_bridge(bss));
        let access_point = AccessPoint {
            interface: self.owner.interface.clone(),
            driver: AccessPointDriver::Nl80211,
            radio: wanted.radio.clone(),
            bss: self.with_bridge(&wanted.bss),
            virtual_aps: wanted.virtual_aps.iter().map(virtual_ap).collect(),
        };
        let daemon = Daemon::hostapd(&access_point, &own_folder(&self.folder), &mut launch_here)?;
        let mut client = daemon.client()?;
        for neighbour in &wanted.neighbours {
            client.request(&hostapd::set_neighbour(neighbour))?;
        }
        Ok(daemon)
    }

    /// Returns a BSS in the bridge in which its interface was found, unless it has one.
    fn with_bridge(&self, bss: &Bss) -> Bss {
        let bridge = bss.bridge.clone().or_else(|| self.owner.bridge.clone());
        Bss { bridge, ..bss.clone() }
    }

    fn limit_power(&self, power: Option<Power>) -> Result<(), TakeoverError> {
        match power {
            Some(power) => self.owner.limit_power(power, &self.folder),
            None => self.owner.put_back_power(&self.folder),
        }
    }

    /// Joins a network from now on, and no other. The kernel keeps its neighbours' addresses at roams. A change of the power alone
    /// leaves the station where it is.
    ///
    /// # Errors
    /// [`TakeoverError`].
    pub fn join(&mut self, wanted: &StationSettings) -> Result<(), TakeoverError> {
        self.join_network(&wanted.network)?;
        self.limit_power(wanted.power)
    }

    fn join_network(&mut self, wanted: &Network) -> Result<(), TakeoverError> {
        let is_joined = match &self.on_air {
            Some(OnAir::OwnStation { network, .. } | OnAir::AddedNetwork { network, .. }) => {
                **network == *wanted
            }
            _ => false,
        };
        if is_joined {
            return Ok(());
        }
        if let Some(OwnersProgram::Hostapd { .. }) = &self.owner.program {
            return Err(self.other_use("hostapd"));
        }
        self.leave()?;
        self.owner.forget_neighbours(false)?;
        let network = Box::new(wanted.clone());
        self.programs += 1;
        self.on_air = Some(match &self.owner.program {
            Some(OwnersProgram::Supplicant { socket, .. }) => {
                let mut client = Client::connect(socket, &self.folder)?;
                let number = client.request(&wpa_supplicant::add_network())?;
                // First, so that it is found even if this process is killed before it is done.
                client.request(&wpa_supplicant::mark(number, MARK))?;
                for request in wpa_supplicant::describe(number, wanted) {
                    client.request(&request)?;
                }
                // An access point that was taken over, too, may have been heard on its owner's channel. wpa_supplicant looks for
                // it there when it roams over the distribution system.
                client.request(&wpa_supplicant::forget_heard())?;
                _ = client.request(&wpa_supplicant::ignore_none());
                client.request(&wpa_supplicant::select_network(number))?;
                OnAir::AddedNetwork { socket: socket.clone(), number, network }
            }
            _ => {
                let station = Station {
                    interface: self.owner.interface.clone(),
                    driver: StationDriver::Nl80211,
                    country: None,
                    networks: vec![wanted.clone()],
                };
                let folder = own_folder(&self.folder);
                OnAir::OwnStation {
                    daemon: Daemon::wpa_supplicant(&station, &folder, &mut launch_here)?,
                    network,
                }
            }
        });
        Ok(())
    }

    /// Is on the air no more. An owner's access point is off, too; a station is back in its owner's networks.
    ///
    /// # Errors
    /// [`TakeoverError`].
    pub fn leave(&mut self) -> Result<(), TakeoverError> {
        match self.on_air.take() {
            // wpa_supplicant itself stays.
            Some(OnAir::AddedNetwork { .. }) => self.owner.put_back(&self.folder),
            _ => self.set_aside(),
        }
    }

    /// Connects to the program that does what is wanted; `None` while nothing is on the air.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub fn client(&self) -> Result<Option<Client>, ControlError> {
        Ok(match &self.on_air {
            None => None,
            Some(OnAir::AccessPoint { daemon, .. } | OnAir::OwnStation { daemon, .. }) => {
                Some(daemon.client()?)
            }
            Some(OnAir::AddedNetwork { socket, .. }) => Some(Client::connect(socket, &self.folder)?),
        })
    }

    /// Returns the number that wpa_supplicant has for the network that is joined; `None` for anything but a station.
    pub fn network(&self) -> Option<u32> {
        match &self.on_air {
            Some(OnAir::OwnStation { .. }) => Some(0),
            Some(OnAir::AddedNetwork { number, .. }) => Some(*number),
            _ => None,
        }
    }

    /// Returns the number of programs so far. As long as it stays, so does the program of [`Self::client`].
    pub fn programs(&self) -> u64 {
        self.programs
    }

    /// Puts everything back as it was found.
    ///
    /// # Errors
    /// [`TakeoverError`]. [`Owner::put_back`] can try again.
    pub fn give_back(mut self) -> Result<(), TakeoverError> {
        self.end()
    }

    fn end(&mut self) -> Result<(), TakeoverError> {
        drop(self.on_air.take());
        self.owner.put_back(&self.folder)
    }

    fn other_use(&self, program: &'static str) -> TakeoverError {
        TakeoverError::OtherUse { interface: self.owner.interface.clone(), program }
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        _ = self.end();
    }
}

/// Changes a running access point whose BSS stays.
fn change(
    daemon: &Daemon,
    before: &AccessPointSettings,
    wanted: &AccessPointSettings,
    with_bridge: impl Fn(&Bss) -> Bss,
) -> Result<(), TakeoverError> {
    let mut client = daemon.client()?;
    if before.radio.channel != wanted.radio.channel {
        switch(&mut client, wanted.radio.channel)?;
    }
    for (interface, bss) in &before.virtual_aps {
        if !wanted.virtual_aps.iter().any(|(its, wanted)| its == interface && wanted == bss) {
            daemon.global_client()?.request(&hostapd::remove_interface(interface))?;
        }
    }
    for virtual_ap @ (interface, bss) in &wanted.virtual_aps {
        if !before.virtual_aps.contains(virtual_ap) {
            daemon.add_bss(&AccessPoint {
                interface: interface.clone(),
                driver: AccessPointDriver::Nl80211,
                radio: wanted.radio.clone(),
                bss: with_bridge(bss),
                virtual_aps: Vec::new(),
            })?;
        }
    }
    for gone in before.neighbours.iter().filter(|gone| !wanted.neighbours.contains(gone)) {
        client.request(&hostapd::remove_neighbour(gone.bssid, &gone.ssid))?;
    }
    for neighbour in wanted.neighbours.iter().filter(|new| !before.neighbours.contains(new)) {
        client.request(&hostapd::set_neighbour(neighbour))?;
    }
    Ok(())
}

fn switch(client: &mut Client, channel: Channel) -> Result<(), ControlError> {
    client.request(&hostapd::switch_channel(channel, ANNOUNCEMENTS))
}
