//! Tests of the fabric's interface, in virtual time.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;
mod elsewhere;
mod fading;
mod following;
mod forwarding;
mod invariants;
mod lending;
mod links;
mod offloads;
mod paths;
mod port_security;
mod queues;
mod reservations;
mod taps;
mod walls;
mod wireless;
