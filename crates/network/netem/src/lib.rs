#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod conditions;
mod device;
mod distribution;
mod filter;
mod handle;
mod hold;
mod kernel;
mod loss;
mod netem;
mod probability;
mod record;
mod request;
mod route;
mod rule;
mod sharing;
mod structure;
mod tree;

pub use conditions::ConditionsError;
pub use cotorra_graph::{BitRate, Probability};
pub use cotorra_netlink::DecodeError;
#[doc(hidden)]
pub use device::read_anything;
pub use device::{Device, Interface, Plan};
pub use distribution::Distribution;
pub use handle::Handle;
pub use hold::{Confirmed, Hold, HoldError, leftovers, put_back};
pub use kernel::{Error, Kernel};
pub use loss::Loss;
pub use netem::{Jitter, Netem};
pub use record::{Owner, Record};
pub use rule::{Counters, DisciplineError, Replaced, Rule, Side};
pub use sharing::{Share, Sharing};
