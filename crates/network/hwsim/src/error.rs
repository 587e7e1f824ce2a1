//! Errors of the exchange with the kernel.

use std::io;

/// A failure in the exchange with the kernel.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The kernel lacks the module.
    #[error(
        "this kernel has no mac80211_hwsim: run `modprobe mac80211_hwsim radios=0`, or use a kernel that has the module"
    )]
    Missing,
    /// The process lacks CAP_NET_ADMIN in the network namespace.
    #[error("simulated radios need CAP_NET_ADMIN in their network namespace: run it as root")]
    NoRights,
    /// Another program is the medium.
    #[error(
        "another program, such as wmediumd, is the medium of this network namespace's radios: stop it first"
    )]
    Taken,
    /// A radio can use several channels at a time, which the kernel does not leave to a medium.
    #[error(
        "a simulated radio uses several channels at a time, and the kernel takes no medium then: load mac80211_hwsim with \
         channels=1"
    )]
    SeveralChannels,
    /// There is a phy of this name already.
    #[error("there is a phy `{0}` already: choose another name")]
    NameTaken(String),
    /// There is no radio of this number in the network namespace.
    #[error("there is no radio {0} in this network namespace")]
    NoRadio(u32),
    /// There is no phy of this name in the network namespace.
    #[error("there is no phy `{0}` in this network namespace")]
    NoPhy(String),
    /// The kernel rejected a request, or a socket failed.
    #[error("the kernel refuses to {what}: {source}")]
    Refused {
        /// The request.
        what: &'static str,
        /// The kernel's error.
        source: io::Error,
    },
}

const EPERM: i32 = 1;
const EBUSY: i32 = 16;
const EOPNOTSUPP: i32 = 95;

impl Error {
    /// Returns the error of a request.
    pub(crate) fn of(what: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| match source.raw_os_error() {
            Some(EPERM) => Self::NoRights,
            None if source.kind() == io::ErrorKind::NotFound => Self::Missing,
            _ => Self::Refused { what, source },
        }
    }

    /// Returns the error of a registration.
    pub(crate) fn of_registration(source: io::Error) -> Self {
        match source.raw_os_error() {
            Some(EBUSY) => Self::Taken,
            Some(EOPNOTSUPP) => Self::SeveralChannels,
            _ => Self::of("register a medium")(source),
        }
    }
}
