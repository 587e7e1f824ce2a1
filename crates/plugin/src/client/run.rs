//! Drives a plug-in over the API: events in from the stream, instructions out one by one. This is the shell that owns
//! the plug-in's clock when it runs apart.

use std::{
    sync::mpsc::{Receiver, RecvTimeoutError, sync_channel},
    thread,
    time::Duration,
};

use cotorra_graph::{Stamped, Timestamp};

use super::{Client, ClientError};
use crate::{Actions, Plugin};

/// Events that wait for the plug-in; beyond these the testbed drops the oldest.
const WAITING: usize = 1024;
/// Status of a testbed whose run has ended.
const ENDED: u16 = 503;

impl Client {
    /// Runs a plug-in until the testbed's run ends. Its time is the testbed's; it starts with the first event.
    ///
    /// # Errors
    /// [`ClientError`], but never [`ClientError::Refused`].
    pub fn run(&self, plugin: &mut dyn Plugin) -> Result<(), ClientError> {
        // The stream first: nothing that happens while the testbed is read is lost.
        let events = self.events(&[])?;
        let testbed = self.testbed()?;
        let (sender, inbox) = sync_channel(WAITING);
        // Ends with the stream, or with the first event that nobody takes any more.
        thread::spawn(move || {
            for event in events {
                if sender.send(event.map(Box::new)).is_err() {
                    break;
                }
            }
        });
        let mut actions = Actions::default();
        let Ok(first) = inbox.recv() else { return Ok(()) };
        let first = first?;
        let mut clock = Clock::starting(first.at);
        plugin.start(first.at, &testbed, &mut actions);
        let mut next = Next::Event(first);
        loop {
            match next {
                Next::Event(event) => plugin.handle(clock.at_least(event.at), &event.event, &mut actions),
                Next::Deadline => plugin.expire(clock.now(), &mut actions),
                Next::End => return Ok(()),
            }
            for (instruction, reason) in actions.drain() {
                match self.instruct(&instruction, reason.as_deref()) {
                    Ok(()) | Err(ClientError::Refused(_)) => {}
                    Err(ClientError::Failed { status: ENDED, .. }) => return Ok(()),
                    Err(error) => return Err(error),
                }
            }
            next = wait(&inbox, plugin.next_deadline(), &clock)?;
        }
    }
}

/// What the plug-in is called for next.
enum Next {
    Event(Box<Stamped>),
    Deadline,
    End,
}

fn wait(
    inbox: &Receiver<Result<Box<Stamped>, ClientError>>,
    deadline: Option<Timestamp>,
    clock: &Clock,
) -> Result<Next, ClientError> {
    let received = match deadline.map(|deadline| deadline.since(clock.now())) {
        None => inbox.recv().map_err(|_| RecvTimeoutError::Disconnected),
        // However many events wait, a deadline that has passed comes first.
        Some(Duration::ZERO) => Err(RecvTimeoutError::Timeout),
        Some(left) => inbox.recv_timeout(left),
    };
    match received {
        Ok(event) => event.map(Next::Event),
        Err(RecvTimeoutError::Timeout) => Ok(Next::Deadline),
        Err(RecvTimeoutError::Disconnected) => Ok(Next::End),
    }
}

/// The testbed's time as its events tell it, and this machine's clock between them.
struct Clock {
    #[allow(clippy::disallowed_types, reason = "the shell of a plug-in that runs apart owns its clock")]
    read: std::time::Instant,
    then: Timestamp,
}

#[allow(clippy::disallowed_types, reason = "the shell of a plug-in that runs apart owns its clock")]
impl Clock {
    fn starting(now: Timestamp) -> Self {
        Self { read: std::time::Instant::now(), then: now }
    }

    fn now(&self) -> Timestamp {
        self.then + self.read.elapsed()
    }

    /// The time now, when something came that happened at `at`: not before that.
    fn at_least(&mut self, at: Timestamp) -> Timestamp {
        if at > self.now() {
            *self = Self::starting(at);
        }
        self.now()
    }
}
