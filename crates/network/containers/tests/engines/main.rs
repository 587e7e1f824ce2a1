//! The engine of containers with the real podman and Docker.
#![allow(clippy::unwrap_used, reason = "a fixture that fails, fails the test")]

mod contract;
mod daemon;
mod init;
mod lab;
mod trial;
