//! The engine of containers with the real podman and Docker.

mod contract;
mod daemon;
mod lab;
