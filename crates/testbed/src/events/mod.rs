//! Events of a run, on their way from the core to whoever receives them.

pub(crate) mod distant;
pub(crate) mod fanout;
pub(crate) mod follower;
pub(crate) mod live;
pub(crate) mod stream;
