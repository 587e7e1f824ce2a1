//! Families of generic netlink, whose numbers the kernel gives out at run time (linux/genetlink.h).

use std::io;

use crate::{
    attributes::{DecodeError, Writer, attributes, parse_u16},
    message::{ACK, DUMP},
    socket::Netlink,
};

/// `GENL_ID_CTRL`: the family that knows all others.
const CONTROLLER: u16 = 0x10;
/// `CTRL_CMD_GETFAMILY`.
const GET_FAMILY: u8 = 3;
/// `CTRL_ATTR_FAMILY_ID`.
const FAMILY_ID: u16 = 1;
/// `CTRL_ATTR_FAMILY_NAME`.
const FAMILY_NAME: u16 = 2;
/// Length of `struct genlmsghdr`: command, version and two reserved bytes.
const HEADER: usize = 4;
const VERSION: u8 = 1;

const ENOENT: i32 = 2;

/// A family, which some kernels lack and others load later.
#[derive(Debug)]
pub struct Family {
    name: &'static str,
    number: Number,
}

#[derive(Debug)]
enum Number {
    /// The kernel was not asked yet.
    Unknown,
    /// The kernel has no such family.
    Absent,
    Known(u16),
}

impl Family {
    /// Returns the family of this name. Asks the kernel nothing yet.
    pub const fn new(name: &'static str) -> Self {
        Self { name, number: Number::Unknown }
    }

    /// Lets the next request ask the kernel again for a family that it did not have. The kernel then looks for a module,
    /// so do this only with a reason.
    pub fn look_again(&mut self) {
        if let Number::Absent = self.number {
            self.number = Number::Unknown;
        }
    }

    /// Dumps what a command gives.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] if the kernel lacks the family; otherwise, those of [`Netlink::request`].
    pub fn dump<T>(
        &mut self,
        socket: &mut Netlink,
        command: u8,
        attributes: &[u8],
        decode: impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Vec<T>> {
        let number = self.number(socket)?;
        let result = socket.request(number, DUMP, &request(command, attributes), decode);
        self.forget_if_gone(result)
    }

    /// Reads what a command gives of one thing.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] if the kernel lacks the family; otherwise, those of [`Netlink::request`].
    pub fn get<T>(
        &mut self,
        socket: &mut Netlink,
        command: u8,
        attributes: &[u8],
        decode: impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Option<T>> {
        let number = self.number(socket)?;
        let result = socket.request(number, ACK, &request(command, attributes), decode);
        Ok(self.forget_if_gone(result)?.into_iter().next())
    }

    /// Carries out a command, and returns the number that the kernel acknowledges it with.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] if the kernel lacks the family; otherwise, those of [`Netlink::execute`].
    pub fn execute(&mut self, socket: &mut Netlink, command: u8, attributes: &[u8]) -> io::Result<u32> {
        let number = self.number(socket)?;
        let result = socket.execute(number, 0, &request(command, attributes));
        self.forget_if_gone(result)
    }

    /// Returns the family's number.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] if the kernel lacks the family; otherwise, those of [`Netlink::request`].
    pub fn number(&mut self, socket: &mut Netlink) -> io::Result<u16> {
        if let Number::Unknown = self.number {
            let mut name = Writer::default();
            name.text(FAMILY_NAME, self.name);
            let found = socket.request(CONTROLLER, ACK, &request(GET_FAMILY, &name.finish()), decode_family);
            self.number = match found {
                Ok(found) => found.first().map_or(Number::Absent, |number| Number::Known(*number)),
                Err(error) if error.raw_os_error() == Some(ENOENT) => Number::Absent,
                Err(error) => return Err(error),
            };
        }
        match self.number {
            Number::Known(number) => Ok(number),
            _ => Err(io::Error::new(io::ErrorKind::NotFound, format!("the kernel has no {}", self.name))),
        }
    }

    fn forget_if_gone<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        if result.as_ref().is_err_and(|error| error.raw_os_error() == Some(ENOENT)) {
            // The module was unloaded, and may have another number when it comes back.
            self.number = Number::Unknown;
        }
        result
    }
}

fn request(command: u8, attributes: &[u8]) -> Vec<u8> {
    [&[command, VERSION, 0, 0], attributes].concat()
}

/// Reads the attributes of an answer in generic netlink.
pub fn answer(body: &[u8]) -> impl Iterator<Item = Result<(u16, &[u8]), DecodeError>> {
    attributes(body.get(HEADER..).unwrap_or_default())
}

/// Reads the number of a family from the controller's answer.
///
/// # Errors
/// [`DecodeError`] for a malformed answer.
pub fn decode_family(body: &[u8]) -> Result<Option<u16>, DecodeError> {
    for attribute in answer(body) {
        if let (FAMILY_ID, value) = attribute? {
            return parse_u16(value).map(Some);
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_family_has_the_number_that_the_controller_names() {
        let mut attributes = Writer::default();
        attributes.text(FAMILY_NAME, "nl80211").bytes(FAMILY_ID, &32_u16.to_ne_bytes());
        let body = request(1, &attributes.finish());
        assert_eq!(decode_family(&body), Ok(Some(32)));
        assert_eq!(decode_family(&[]), Ok(None));
        assert!(decode_family(&body[..body.len() - 4]).is_err());
    }
}
