//! Radios of this kernel on the fabric's air. Needs root, mac80211_hwsim (`modprobe mac80211_hwsim radios=0`), `iw` and `ip`, and
//! for roaming hostapd and wpa_supplicant; does nothing elsewhere.
#![allow(clippy::unwrap_used, reason = "tests may panic")]
#![allow(clippy::disallowed_types, reason = "the kernel's radios run by the machine's clock")]

mod pair;
mod rig;
mod roaming;
mod tries;
