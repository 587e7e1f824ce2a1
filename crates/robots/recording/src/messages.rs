//! The messages of a recording that robots and VNFs do not exchange: standard ones of ROS 2 (Jazzy), and `cotorra_msgs`,
//! which say what ROS has no message for.

mod own;
mod standard;

pub use self::{own::*, standard::*};
