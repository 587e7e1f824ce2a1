//! Families of generic netlink, whose numbers the kernel gives out at run time (linux/genetlink.h).

use std::io;

use netlink_packet_core::{DecodeError, NLM_F_ACK, NLM_F_DUMP, parse_u16};

use crate::netlink::{Netlink, attribute, attributes};

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
pub(crate) struct Family {
    name: &'static str,
    number: Number,
}

enum Number {
    /// Nobody asked the kernel yet.
    Unknown,
    /// The kernel has no such family.
    Absent,
    Known(u16),
}

impl Family {
    pub(crate) const fn new(name: &'static str) -> Self {
        Self { name, number: Number::Unknown }
    }

    /// Lets the next request ask the kernel again for a family that it did not have. The kernel then looks for a module,
    /// so do this only with a reason.
    pub(crate) fn look_again(&mut self) {
        if let Number::Absent = self.number {
            self.number = Number::Unknown;
        }
    }

    /// Dumps what a command gives.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] if the kernel lacks the family; otherwise, those of [`Netlink::request`].
    pub(crate) fn dump<T>(
        &mut self,
        socket: &mut Netlink,
        command: u8,
        attributes: &[u8],
        decode: impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> io::Result<Vec<T>> {
        let number = self.number(socket)?;
        let result = socket.request(number, NLM_F_DUMP, &request(command, attributes), decode);
        if result.as_ref().is_err_and(|error| error.raw_os_error() == Some(ENOENT)) {
            // The module was unloaded, and may have another number when it comes back.
            self.number = Number::Unknown;
        }
        result
    }

    fn number(&mut self, socket: &mut Netlink) -> io::Result<u16> {
        if let Number::Unknown = self.number {
            let name = attribute(FAMILY_NAME, format!("{}\0", self.name).as_bytes());
            let found = socket.request(CONTROLLER, NLM_F_ACK, &request(GET_FAMILY, &name), decode_id);
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
}

fn request(command: u8, attributes: &[u8]) -> Vec<u8> {
    [&[command, VERSION, 0, 0], attributes].concat()
}

/// Returns the attributes of an answer.
pub(crate) fn answer(body: &[u8]) -> impl Iterator<Item = Result<(u16, &[u8]), DecodeError>> {
    attributes(body.get(HEADER..).unwrap_or_default())
}

/// Reads the number of a family.
pub(crate) fn decode_id(body: &[u8]) -> Result<Option<u16>, DecodeError> {
    for attribute in answer(body) {
        if let (FAMILY_ID, value) = attribute? {
            return parse_u16(value).map(Some);
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use netlink_packet_core::NetlinkBuffer;

    use super::*;
    use crate::testing::FAMILY;

    #[test]
    fn captured_family_has_its_number() {
        let message = NetlinkBuffer::new_checked(FAMILY).unwrap();
        assert_eq!(decode_id(message.payload()).unwrap(), Some(32));
        assert_eq!(decode_id(&[]).unwrap(), None);
    }
}
