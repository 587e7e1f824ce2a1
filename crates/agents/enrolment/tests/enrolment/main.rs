//! Credentials, from the authority to a connection.

mod authority;
mod bundle;
mod handshake;
