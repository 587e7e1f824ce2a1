//! Configurations, the client, and the real programs without a radio.

#[path = "../fixture/mod.rs"]
mod fixture;

mod client;
mod configurations;
mod programs;
