//! The bundled VNFs, navigation and localization, as programs. Engines start them with the variables [`TESTBED`], [`ROBOT`] and
//! [`PORT`].
#![forbid(unsafe_code)]

mod localization;
mod programs;

pub use localization::{LocalizationVnf, NotLocalized, PacketError};
pub use programs::{Assignment, FILES, PORT, ROBOT, TESTBED, VnfError, assignment, localization, navigation};
