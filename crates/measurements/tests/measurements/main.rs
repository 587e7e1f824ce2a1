//! Histories that outlive full disks and killed processes, and keep what was recorded once.

mod disk;
mod kill;
mod retention;
mod signals;
