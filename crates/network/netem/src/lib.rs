//! Link conditions by the kernel's own NetEm, on any interface of this machine, through netlink and without the `tc`
//! program. What is written and read is pure and tested as such; [`Kernel`] is the thin shell with the socket.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use std::time::Duration;
//! use cotorra_netem::{Kernel, Netem, Rule};
//!
//! let kernel = Kernel::open()?;
//! let netem = Netem { delay: Duration::from_millis(10), ..Netem::default() };
//! let plan = kernel.device("eth0")?.set(&Rule { netem, ..Rule::default() }, false)?;
//! print!("{plan}");
//! kernel.apply(&plan)?;
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod attributes;
mod conditions;
mod device;
mod distribution;
mod filter;
mod handle;
mod hold;
mod kernel;
mod loss;
mod netem;
mod record;
mod request;
mod route;
mod rule;
mod tree;

pub use attributes::Malformed;
pub use conditions::NotByNetem;
#[doc(hidden)]
pub use device::read_anything;
pub use device::{Device, Interface, Plan};
pub use distribution::Distribution;
pub use handle::{Handle, Network, NoNetwork};
pub use hold::{Confirmed, Hold, HoldError, leftovers, put_back};
pub use kernel::{Error, Kernel};
pub use loss::Loss;
pub use netem::{Jitter, Netem};
pub use record::{Owner, Record};
pub use rule::{Counters, DisciplineError, Replaced, Rule, Side};
