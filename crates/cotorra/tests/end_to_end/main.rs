//! The real program, from outside: what it prints, what it leaves, and what it does not leave.

mod api;
mod command_line;
mod documents;
mod experiment;
mod harness;
mod interruption;
mod plugin;
mod run;
mod sweep;
