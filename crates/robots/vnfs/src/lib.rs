//! The bundled VNFs, navigation and localization, as programs. Engines start them with the variables [`TESTBED`], [`ROBOT`] and
//! [`PORT`].
#![forbid(unsafe_code)]

mod belief;
mod localization;
mod programs;

pub use belief::{believed, parameters, planar, to_pose};
pub use localization::{LocalizationVnf, NotLocalized, PacketError};
pub use programs::{FILES, PORT, ROBOT, TESTBED, VnfError, localization, navigation};
