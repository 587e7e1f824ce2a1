//! What speaks to the execution client, in a thread of its own, for it takes its time.
#![allow(clippy::disallowed_methods, reason = "waits for the execution client")]

use std::{
    sync::{
        Arc, Mutex,
        mpsc::{Receiver, Sender},
    },
    thread,
};

use crate::{
    block::{Block, Position},
    consensus::Order,
    engine::{Engine, EngineError, Verdict},
    node::{Event, NodeError, RETRY, lock},
    store::Blocks,
};

/// What the execution client is to do.
pub(crate) enum Job {
    Judge(Block),
    Build(Order),
    Finalize(Position),
}

/// What speaks to the execution client, one thing after the other.
pub(crate) struct Worker {
    pub(crate) engine: Engine,
    pub(crate) blocks: Arc<Mutex<Blocks>>,
    pub(crate) events: Sender<Event>,
}

impl Worker {
    pub(crate) fn run(&self, jobs: &Receiver<Job>) {
        while let Ok(job) = jobs.recv() {
            let mut was_away = false;
            let event = loop {
                match self.perform(&job) {
                    Ok(event) => break event,
                    // A block that it cannot make is another validator's to make.
                    Err(error) if matches!(job, Job::Build(_)) => {
                        tracing::warn!(%error, "no block is made");
                        break None;
                    }
                    Err(NodeError::Engine(error)) => {
                        if !was_away {
                            tracing::warn!(%error, "the execution client is tried again");
                        }
                        was_away = true;
                        thread::sleep(RETRY);
                    }
                    Err(error) => break Some(Event::Failed(error)),
                }
            };
            if event.is_some_and(|event| self.events.send(event).is_err()) {
                return;
            }
        }
    }

    fn perform(&self, job: &Job) -> Result<Option<Event>, NodeError> {
        match job {
            Job::Judge(block) => {
                let mut verdict = self.engine.judge(block)?;
                if verdict == Verdict::Unknown {
                    self.catch_up(block.position().number - 1)?;
                    verdict = self.engine.judge(block)?;
                }
                match verdict {
                    Verdict::Valid => Ok(Some(Event::Judged(block.id(), true))),
                    Verdict::Invalid => Ok(Some(Event::Judged(block.id(), false))),
                    Verdict::Unknown => Err(unknown(block.position().number).into()),
                }
            }
            Job::Build(order) => {
                let mut block = self.engine.build(order)?;
                if block.is_none() {
                    self.catch_up(order.parent.number)?;
                    block = self.engine.build(order)?;
                }
                Ok(block.map(|block| Event::Built(*order, block)))
            }
            Job::Finalize(block) => {
                // Its own block it has made, but not yet executed.
                self.catch_up(block.number)?;
                match self.engine.finalize(block)? {
                    Verdict::Valid => Ok(None),
                    Verdict::Invalid | Verdict::Unknown => Err(unknown(block.number).into()),
                }
            }
        }
    }

    /// Has the execution client execute the blocks up to that one that it has not.
    fn catch_up(&self, number: u64) -> Result<(), NodeError> {
        let mut next = number;
        while next > 0 && self.execute(next)? == Verdict::Unknown {
            next -= 1;
        }
        for number in next + 1..=number {
            if self.execute(number)? != Verdict::Valid {
                return Err(unknown(number).into());
            }
        }
        Ok(())
    }

    fn execute(&self, number: u64) -> Result<Verdict, NodeError> {
        let Some(decided) = lock(&self.blocks).read(number)? else { return Ok(Verdict::Unknown) };
        Ok(self.engine.judge(&decided.block)?)
    }
}

fn unknown(number: u64) -> EngineError {
    let reason = format!("block {number} is final, and it does not take it");
    EngineError::Refused { method: "engine_newPayloadV2", reason }
}
