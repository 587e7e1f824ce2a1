//! Messages about interfaces (rtnetlink(7), linux/rtnetlink.h).

use crate::attributes::{DecodeError, Writer, parse_u32};

/// `RTM_NEWLINK`.
pub const NEW_LINK: u16 = 16;
/// `RTM_SETLINK`.
pub const SET_LINK: u16 = 19;

/// `IFF_UP`.
const UP: u32 = 1;

/// Begins a message about an interface, with `struct ifinfomsg`. Attributes follow.
pub fn link(index: u32) -> Writer {
    header(index, 0)
}

/// Begins a message that sets an interface up. Attributes follow.
pub fn link_up(index: u32) -> Writer {
    header(index, UP)
}

/// `change` has the flags that are set.
fn header(index: u32, change: u32) -> Writer {
    let mut writer = Writer::default();
    writer.raw(&[0, index, change, change].map(u32::to_ne_bytes).concat());
    writer
}

/// Reads which interface a message is about, and whether it was set up just now.
///
/// # Errors
/// [`DecodeError`], if the message is too short.
pub fn set_up(body: &[u8]) -> Result<(u32, bool), DecodeError> {
    let word = |place: usize| {
        parse_u32(
            body.get(4 * place..4 * place + 4).ok_or(DecodeError("a message about a link is too short"))?,
        )
    };
    Ok((word(1)?, word(2)? & word(3)? & UP != 0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interface_is_set_up_where_flag_and_change_say_so() {
        assert_eq!(set_up(&link_up(7).finish()), Ok((7, true)));
        assert_eq!(set_up(&link(7).finish()), Ok((7, false)));
        assert!(set_up(&link_up(7).finish()[..12]).is_err());
    }
}
