//! Creates and deletes radios.

use cotorra_netlink::{Family, NETLINK_GENERIC, Netlink};

use crate::{
    error::Error,
    message::{Message, Radio},
};

/// Name of the family.
pub(crate) const FAMILY: &str = "MAC80211_HWSIM";
/// Length of the header of generic netlink.
const HEADER: usize = 4;

/// The simulated radios of the calling thread's network namespace.
///
/// Radios that [end with the socket](Radio::ends_with_socket) disappear when this is dropped, or the process dies.
#[derive(Debug)]
pub struct Radios {
    socket: Netlink,
    family: Family,
}

impl Default for Radios {
    fn default() -> Self {
        Self::new()
    }
}

impl Radios {
    /// Returns a client. Opens nothing yet.
    pub const fn new() -> Self {
        // The kernel ends radios with any socket that has the number of the one that created them.
        Self { socket: Netlink::alone(NETLINK_GENERIC), family: Family::new(FAMILY) }
    }

    /// Creates a radio, and returns its number. Its permanent address must be unique: the kernel does not compare it with
    /// those of other radios.
    ///
    /// # Errors
    /// [`Error::Missing`], [`Error::NoRights`], [`Error::NameTaken`] or [`Error::Refused`].
    pub fn create(&mut self, radio: &Radio) -> Result<u32, Error> {
        let id = self.execute("create a radio", &Message::NewRadio(radio.clone()))?;
        if let Some(name) = &radio.name
            && !self.list()?.iter().any(|other| other.id == Some(id) && other.name.as_ref() == Some(name))
        {
            // The kernel has chosen another name.
            self.delete(id)?;
            return Err(Error::NameTaken(name.clone()));
        }
        Ok(id)
    }

    /// Deletes a radio by its number. Its phy must be in this network namespace.
    ///
    /// # Errors
    /// [`Error::Missing`], [`Error::NoRights`] or [`Error::Refused`].
    pub fn delete(&mut self, id: u32) -> Result<(), Error> {
        let radio = Radio { id: Some(id), ..Radio::default() };
        self.execute("delete a radio", &Message::DeleteRadio(radio)).map(drop)
    }

    /// Returns the name of the phy of a radio in this network namespace.
    ///
    /// # Errors
    /// [`Error::Missing`], [`Error::NoRadio`] or [`Error::Refused`].
    pub fn name(&mut self, id: u32) -> Result<String, Error> {
        let found = self.list()?.into_iter().find(|radio| radio.id == Some(id));
        found.and_then(|radio| radio.name).ok_or(Error::NoRadio(id))
    }

    /// Returns the radios whose phys are in this network namespace.
    ///
    /// # Errors
    /// [`Error::Missing`] or [`Error::Refused`].
    pub fn list(&mut self) -> Result<Vec<Radio>, Error> {
        let message = Message::GetRadio(Radio::default()).encode();
        let decode = |body: &[u8]| {
            Ok(Message::decode(body)?.and_then(|message| match message {
                Message::GetRadio(radio) => Some(radio),
                _ => None,
            }))
        };
        let listed = self.family.dump(&mut self.socket, message[0], &message[HEADER..], decode);
        listed.map_err(Error::of("list radios"))
    }

    fn execute(&mut self, what: &'static str, message: &Message) -> Result<u32, Error> {
        let message = message.encode();
        let done = self.family.execute(&mut self.socket, message[0], &message[HEADER..]);
        done.map_err(Error::of(what))
    }
}
