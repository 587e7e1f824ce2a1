//! The thread that configures hosts' interfaces again when programs have set them down and up.

use std::{
    os::fd::AsFd,
    sync::Arc,
    thread::{self, JoinHandle},
};

use crate::{
    error::{Action, Error},
    hosts::Watched,
    neighbours::Neighbours,
    sys::{Epoll, Waker},
};

/// Keeps hosts' interfaces configured until it is dropped.
pub(crate) struct Watch {
    stop: Arc<Waker>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    pub(crate) fn start(watched: Vec<Watched>, neighbours: Neighbours) -> Result<Self, Error> {
        let stop = Arc::new(Waker::new().action("make an eventfd")?);
        let mut epoll = Epoll::new().action("wait for changes of interfaces")?;
        for (place, interface) in watched.iter().enumerate() {
            epoll.add(interface.as_fd(), place).action("wait for changes of interfaces")?;
        }
        epoll.add(stop.as_fd(), watched.len()).action("wait for changes of interfaces")?;
        let watch = move || {
            while let Ok(ready) = epoll.wait(None) {
                for ready in ready {
                    let Some(interface) = watched.get(ready.token) else { return };
                    interface.restore(&neighbours);
                }
            }
        };
        let thread = thread::Builder::new().name("interfaces".into()).spawn(watch);
        Ok(Self { stop, thread: Some(thread.action("start the thread that watches interfaces")?) })
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.stop.wake();
        // It has no panic to pass on.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
