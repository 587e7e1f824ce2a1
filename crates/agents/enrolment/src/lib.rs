//! Credentials of agents: who may connect to the core, and how an agent knows that it is the core.
//!
//! An [`Authority`] is a folder of the user with a certificate authority, the certificates of the core and of its HTTP API,
//! and a registry of agents. Enrolling an agent yields a [`Bundle`], the one file that the agent needs. The crate opens no
//! connection and reads no clock. A transport takes [`Authority::core`] and [`Authority::granted`] at the core, and
//! [`Bundle::parse`] at the agent. The HTTP API takes [`Authority::api`], and its clients [`Authority::publish`].
//!
//! Each certificate of an agent names the agent and a generation: `robot.2`. A renewal makes the next generation, and the
//! one before ends after an overlap. The transport grants exact common names, so that both can be told apart. Agents'
//! certificates are for clients only, and the core's is for servers only, so that no agent can pass for the core.
//!
//! An agent trusts this authority alone. It verifies the host's name, which the core's certificate has, and accepts messages
//! only of [`CORE_COMMON_NAME`].
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod authority;
mod bundle;
mod certificates;
mod endpoint;
mod error;
mod files;
mod registry;
mod time_text;

pub use authority::{Authority, Renewal, ServerCredentials};
pub use bundle::{Bundle, BundleError};
pub use certificates::{AgentCertificate, CORE_COMMON_NAME};
pub use endpoint::{CoreEndpoint, InvalidEndpoint};
pub use error::EnrolmentError;
pub use registry::{AgentState, Enrolled, Granted};
