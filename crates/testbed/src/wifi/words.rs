//! Meaning of status and reason codes (IEEE 802.11-2020, tables 9-50 and 9-49). Only those that occur with the networks of
//! testbeds; others are shown by their number.

/// Returns the meaning of a status code, behind a comma; nothing for others.
pub(super) fn status(code: u16) -> &'static str {
    match code {
        1 => ", unspecified failure",
        12 => ", denied",
        13 => ", unsupported authentication",
        15 => ", wrong challenge: another passphrase",
        16 => ", no answer in time",
        17 => ", too many stations",
        28 => ", unreachable key holder",
        30 => ", refused for a while",
        31 => ", management frames are not protected as it wants",
        40 => ", invalid element",
        43 => ", invalid key management",
        52 => ", invalid count of fast transition elements",
        53 => ", invalid key identifier",
        54 => ", another mobility domain",
        55 => ", invalid fast transition element",
        77 => ", unsupported group of SAE",
        _ => "",
    }
}

/// Returns the meaning of a reason code, behind a comma; nothing for others.
pub(super) fn reason(code: u16) -> &'static str {
    match code {
        1 => ", unspecified",
        2 => ", its authentication is no longer valid",
        3 => ", the sender leaves",
        4 => ", inactivity",
        5 => ", too many stations",
        6 | 7 => ", it sent before it was associated",
        8 => ", the sender leaves",
        14 => ", wrong message integrity code",
        15 => ", no end of the key handshake",
        16 => ", no end of the group key handshake",
        _ => "",
    }
}
