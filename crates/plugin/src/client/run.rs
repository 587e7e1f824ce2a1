//! Drives a plug-in over the API: events in from the stream, instructions out one by one. This is the shell that owns
//! the plug-in's clock when it runs apart.

use std::{
    sync::mpsc::{Receiver, RecvTimeoutError, sync_channel},
    thread,
    time::Duration,
};

use cotorra_graph::{Stamped, Testbed, Timestamp};

use super::{Client, ClientError, events::StreamMessage};
use crate::{Actions, Plugin};

/// Events that wait for the plug-in; beyond these the testbed drops the oldest.
const WAITING: usize = 1024;

/// Messages of the stream, as they arrive.
type Inbox = Receiver<Result<StreamMessage, ClientError>>;

impl Client {
    /// Runs a plug-in until the testbed's run ends. Its time is the testbed's: in real time it starts with the first
    /// event, in virtual time at the beginning, and time stands still while the plug-in thinks.
    ///
    /// # Errors
    /// [`ClientError`], but never [`ClientError::Refused`].
    pub fn run(&self, plugin: &mut dyn Plugin) -> Result<(), ClientError> {
        // The stream first: nothing that happens while the testbed is read is lost.
        let mut events = self.events(&[])?;
        let testbed = self.testbed()?;
        let (sender, inbox) = sync_channel(WAITING);
        // Ends with the stream, or with the first event that is not taken any more.
        thread::spawn(move || while events.next_message().is_some_and(|told| sender.send(told).is_ok()) {});
        let ran = match inbox.recv() {
            Ok(Ok(StreamMessage::Event(first))) => self.run_in_real_time(plugin, &testbed, first, &inbox),
            Ok(Ok(StreamMessage::Mark { number, now })) => {
                self.run_in_virtual_time(plugin, &testbed, (number, now), &inbox)
            }
            Ok(Err(error)) => Err(error),
            Err(_) => Ok(()),
        };
        ran.or_else(|error| if error.is_end() { Ok(()) } else { Err(error) })
    }

    fn run_in_real_time(
        &self,
        plugin: &mut dyn Plugin,
        testbed: &Testbed,
        first: Box<Stamped>,
        inbox: &Inbox,
    ) -> Result<(), ClientError> {
        let mut actions = Actions::default();
        let mut clock = Clock::starting(first.at);
        plugin.start(first.at, testbed, &mut actions);
        let mut next = Next::Event(first);
        loop {
            match next {
                Next::Event(event) => plugin.handle(clock.at_least(event.at), &event.event, &mut actions),
                Next::Deadline => plugin.expire(clock.now(), &mut actions),
                Next::End => return Ok(()),
            }
            self.give(&mut actions)?;
            next = wait(inbox, plugin.next_deadline(), &clock)?;
        }
    }

    /// Calls the plug-in as the simulation would call it in process: at each mark, first for a deadline that has come,
    /// then for all that happened, with one time for all of it.
    fn run_in_virtual_time(
        &self,
        plugin: &mut dyn Plugin,
        testbed: &Testbed,
        (first, now): (u64, Timestamp),
        inbox: &Inbox,
    ) -> Result<(), ClientError> {
        let mut actions = Actions::default();
        plugin.start(now, testbed, &mut actions);
        self.give(&mut actions)?;
        self.done(first, plugin.next_deadline())?;
        let mut happened = Vec::new();
        for told in inbox {
            let (mark, now) = match told? {
                StreamMessage::Event(event) => {
                    happened.push(event);
                    continue;
                }
                StreamMessage::Mark { number, now } => (number, now),
            };
            if plugin.next_deadline().is_some_and(|deadline| deadline <= now) {
                plugin.expire(now, &mut actions);
                self.give(&mut actions)?;
            }
            for event in happened.drain(..) {
                plugin.handle(now, &event.event, &mut actions);
                self.give(&mut actions)?;
            }
            self.done(mark, plugin.next_deadline())?;
        }
        Ok(())
    }

    /// Gives the instructions that the plug-in left.
    fn give(&self, actions: &mut Actions) -> Result<(), ClientError> {
        for (instruction, reason) in actions.drain() {
            match self.instruct(&instruction, reason.as_deref()) {
                Ok(()) | Err(ClientError::Refused(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// Next call of the plug-in.
enum Next {
    Event(Box<Stamped>),
    Deadline,
    End,
}

fn wait(inbox: &Inbox, deadline: Option<Timestamp>, clock: &Clock) -> Result<Next, ClientError> {
    loop {
        let received = match deadline.map(|deadline| deadline.since(clock.now())) {
            None => inbox.recv().map_err(|_| RecvTimeoutError::Disconnected),
            // However many events wait, a deadline that has passed comes first.
            Some(Duration::ZERO) => Err(RecvTimeoutError::Timeout),
            Some(left) => inbox.recv_timeout(left),
        };
        return match received {
            Ok(Ok(StreamMessage::Event(event))) => Ok(Next::Event(event)),
            // Real time never waits, and has none.
            Ok(Ok(StreamMessage::Mark { .. })) => continue,
            Ok(Err(error)) => Err(error),
            Err(RecvTimeoutError::Timeout) => Ok(Next::Deadline),
            Err(RecvTimeoutError::Disconnected) => Ok(Next::End),
        };
    }
}

/// The testbed's time as its events give it, and this machine's clock between them.
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
