//! The bundled VNFs, navigation and localization, as programs. Engines start them with the variables [`TESTBED`], [`ROBOT`] and
//! [`PORT`]. One with a demand uses that much CPU time before it sends an answer.
#![forbid(unsafe_code)]

mod computer;
mod localization;
mod programs;
mod requests;

pub use computer::{NoDistribution, SEED};
pub use localization::{LocalizationVnf, NotLocalized, PacketError};
pub use programs::{Assignment, FILES, PORT, ROBOT, TESTBED, VnfError, assignment, localization, navigation};
