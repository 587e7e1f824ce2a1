//! Programs that somebody else has started and configured, as on real hardware.

use std::path::Path;

use crate::{
    channel::Channel,
    client::{Client, ControlError},
    control::{
        Request,
        hostapd::{self, State},
        wpa_supplicant::{self, Variable},
    },
    names::InterfaceName,
};

/// A hostapd of somebody else's. What is changed through it is put back when it is dropped, last change first.
#[derive(Debug)]
pub struct BorrowedAccessPoint {
    client: Client,
    undo: Vec<Request<()>>,
}

impl BorrowedAccessPoint {
    /// Borrows the access point behind a client.
    pub fn new(client: Client) -> Self {
        Self { client, undo: Vec::new() }
    }

    /// Returns the client, for requests that change nothing.
    pub fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// Changes settings, and puts them in force. Stations are disconnected.
    ///
    /// # Errors
    /// [`BorrowError`]. Nothing was changed if hostapd does not report a setting.
    pub fn set(&mut self, settings: &[hostapd::Setting]) -> Result<(), BorrowError> {
        let status = self.client.request(&hostapd::status())?;
        let configuration = self.client.request(&hostapd::configuration())?;
        let before = |setting: &hostapd::Setting| match setting {
            hostapd::Setting::Ssid(_) => configuration.ssid.clone().map(hostapd::Setting::Ssid),
            hostapd::Setting::BeaconInterval(_) => {
                status.beacon_interval.map(hostapd::Setting::BeaconInterval)
            }
            hostapd::Setting::DtimPeriod(_) => status
                .dtim_period
                .and_then(|beacons| beacons.try_into().ok())
                .map(hostapd::Setting::DtimPeriod),
        };
        let before: Option<Vec<_>> = settings.iter().map(before).collect();
        let before = before.ok_or(BorrowError::Unreadable)?;
        // Noted before the values, i.e. carried out after them.
        self.undo.push(hostapd::reload());
        self.undo.extend(before.iter().map(hostapd::set));
        for setting in settings {
            self.client.request(&hostapd::set(setting))?;
        }
        Ok(self.client.request(&hostapd::reload())?)
    }

    /// Moves to another channel, announced in this many beacons.
    ///
    /// # Errors
    /// [`BorrowError::Unreadable`] if the present channel is none that this crate knows.
    pub fn switch_channel(&mut self, channel: Channel, beacons: u8) -> Result<(), BorrowError> {
        let before = self.client.request(&hostapd::status())?.channel.ok_or(BorrowError::Unreadable)?;
        self.client.request(&hostapd::switch_channel(channel, beacons))?;
        self.undo.push(hostapd::switch_channel(before, beacons));
        Ok(())
    }

    /// Starts or stops serving.
    ///
    /// # Errors
    /// As [`Client::request`].
    pub fn serve(&mut self, on: bool) -> Result<(), BorrowError> {
        let serves = self.client.request(&hostapd::status())?.state == State::Enabled;
        if serves != on {
            let (wanted, before) = if on {
                (hostapd::enable(), hostapd::disable())
            } else {
                (hostapd::disable(), hostapd::enable())
            };
            self.client.request(&wanted)?;
            self.undo.push(before);
        }
        Ok(())
    }

    /// Puts everything back, even if something fails.
    ///
    /// # Errors
    /// The first error.
    pub fn give_back(mut self) -> Result<(), ControlError> {
        put_back(&mut self.client, &mut self.undo)
    }
}

impl Drop for BorrowedAccessPoint {
    fn drop(&mut self) {
        _ = put_back(&mut self.client, &mut self.undo);
    }
}

/// A virtual access point on a hostapd of somebody else's. It is removed when this is dropped.
#[derive(Debug)]
pub struct AddedBss {
    global: Client,
    remove: Request<()>,
}

impl AddedBss {
    /// Adds a BSS from a configuration file to a radio, through hostapd's global socket; see [`hostapd::add_bss`]. `interface`
    /// is the file's.
    ///
    /// # Errors
    /// As [`Client::request`].
    pub fn add(
        mut global: Client,
        radio: &str,
        configuration: &Path,
        interface: &InterfaceName,
    ) -> Result<Self, ControlError> {
        global.request(&hostapd::add_bss(radio, configuration))?;
        Ok(Self { global, remove: hostapd::remove_interface(interface) })
    }
}

impl Drop for AddedBss {
    fn drop(&mut self) {
        _ = self.global.request(&self.remove);
    }
}

/// A wpa_supplicant of somebody else's. What is changed through it is put back when it is dropped, last change first.
#[derive(Debug)]
pub struct BorrowedStation {
    client: Client,
    undo: Vec<Request<()>>,
    changed: Vec<(u32, Variable)>,
}

impl BorrowedStation {
    /// Borrows the station behind a client.
    pub fn new(client: Client) -> Self {
        Self { client, undo: Vec::new(), changed: Vec::new() }
    }

    /// Returns the client, for requests that change nothing.
    pub fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// Changes a setting of a network.
    ///
    /// # Errors
    /// As [`Client::request`].
    pub fn set(&mut self, network: u32, setting: &wpa_supplicant::Setting) -> Result<(), BorrowError> {
        let variable = setting.variable();
        if !self.changed.contains(&(network, variable)) {
            let before = self.client.request(&wpa_supplicant::get(network, variable))?;
            self.undo.push(wpa_supplicant::put_back(network, variable, before.as_deref()));
            self.changed.push((network, variable));
        }
        Ok(self.client.request(&wpa_supplicant::set(network, setting))?)
    }

    /// Puts everything back, even if something fails.
    ///
    /// # Errors
    /// The first error.
    pub fn give_back(mut self) -> Result<(), ControlError> {
        put_back(&mut self.client, &mut self.undo)
    }
}

impl Drop for BorrowedStation {
    fn drop(&mut self) {
        _ = put_back(&mut self.client, &mut self.undo);
    }
}

/// Carries the notes out, last first.
fn put_back(client: &mut Client, undo: &mut Vec<Request<()>>) -> Result<(), ControlError> {
    let mut result = Ok(());
    while let Some(request) = undo.pop() {
        result = result.and(client.request(&request));
    }
    result
}

/// A change of somebody else's program that failed.
#[derive(Debug, thiserror::Error)]
pub enum BorrowError {
    /// What was there before cannot be read, so it could not be put back.
    #[error(
        "hostapd does not report what it has now, so that it could not be put back: use a virtual access point"
    )]
    Unreadable,
    /// The request failed.
    #[error(transparent)]
    Control(#[from] ControlError),
}
