//! Configurations, the client, and the real programs without a radio.

#[allow(dead_code, reason = "other tests use the rest")]
#[path = "../fixture/mod.rs"]
mod fixture;

mod client;
mod configurations;
mod programs;
