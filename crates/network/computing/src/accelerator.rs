//! An accelerator, on which models serve their requests in batches.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use cotorra_graph::{BatchTimes, Batching, Timestamp};

use crate::server::{Key, Refused};

/// A request whose batch is finished.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inferred<T> {
    /// Time at which its batch was finished.
    pub at: Timestamp,
    /// The model that served it.
    pub model: Key,
    /// Time of its arrival.
    pub arrived: Timestamp,
    /// Time at which its batch began.
    pub began: Timestamp,
    /// Token of its arrival.
    pub token: T,
}

/// What a model did so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BatchLoad {
    /// Requests that arrived.
    pub arrived: u64,
    /// Requests whose batch was finished.
    pub served: u64,
    /// Requests that were dropped, because the backlog was full.
    pub dropped: u64,
    /// Batches that began.
    pub batches: u64,
    /// Requests of these batches.
    pub batched: u64,
    /// Time of the accelerator that finished batches took.
    pub used: Duration,
}

impl BatchLoad {
    /// Adds what another one did.
    pub fn add(&mut self, other: &Self) {
        let Self { arrived, served, dropped, batches, batched, used } = other;
        self.arrived += arrived;
        self.served += served;
        self.dropped += dropped;
        self.batches += batches;
        self.batched += batched;
        self.used += *used;
    }
}

#[derive(Debug, Clone)]
struct Request<T> {
    token: T,
    arrived: Timestamp,
}

#[derive(Debug, Clone)]
struct Model<T> {
    batching: Batching,
    times: BatchTimes,
    /// The oldest first.
    waiting: VecDeque<Request<T>>,
    load: BatchLoad,
}

impl<T> Model<T> {
    fn most(&self) -> usize {
        self.batching.max_batch.max(1) as usize
    }

    /// Returns when its next batch can begin, if the accelerator is free: it is full, or its oldest request waited long enough.
    fn due(&self) -> Option<Timestamp> {
        let waited = self.waiting.front()?.arrived + self.batching.max_wait;
        let full = self.waiting.get(self.most() - 1).map(|last| last.arrived);
        Some(full.map_or(waited, |full| full.min(waited)))
    }
}

#[derive(Debug, Clone)]
struct Batch<T> {
    model: Key,
    began: Timestamp,
    ends: Timestamp,
    requests: Vec<Request<T>>,
}

/// An accelerator. Call [`Accelerator::poll`] at each [`Accelerator::deadline`]. Time may not go back.
///
/// It serves one batch at a time to its end. A batch can begin once it is full, or once its oldest request has waited for the
/// model's longest wait. Of several models, the one whose batch could begin first is next.
#[derive(Debug, Clone)]
pub struct Accelerator<T> {
    speed: f64,
    now: Timestamp,
    models: BTreeMap<Key, Model<T>>,
    batch: Option<Batch<T>>,
    finished: VecDeque<Inferred<T>>,
}

impl<T> Accelerator<T> {
    /// Creates an idle accelerator of a speed, above 0, at time zero.
    pub fn new(speed: f64) -> Self {
        Self { speed, now: Timestamp::ZERO, models: BTreeMap::new(), batch: None, finished: VecDeque::new() }
    }

    /// Starts a model. One that has the key is replaced, and loses its requests.
    pub fn start(&mut self, now: Timestamp, model: Key, batching: Batching, times: BatchTimes) {
        self.stop(now, model);
        let load = BatchLoad::default();
        self.models.insert(model, Model { batching, times, waiting: VecDeque::new(), load });
    }

    /// Stops a model and its batch. Returns what it did, and the tokens of its unfinished requests, which are lost; `None` if
    /// there is no such model.
    pub fn stop(&mut self, now: Timestamp, model: Key) -> Option<(BatchLoad, Vec<T>)> {
        self.advance(now);
        let Model { waiting, load, .. } = self.models.remove(&model)?;
        let batch = self.batch.take_if(|batch| batch.model == model);
        let lost = batch.into_iter().flat_map(|batch| batch.requests).chain(waiting);
        let lost = lost.map(|request| request.token).collect();
        self.begin();
        Some((load, lost))
    }

    /// Takes a request. The token comes back when its batch is finished.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn arrive(&mut self, now: Timestamp, model: Key, token: T) -> Result<(), Refused> {
        self.advance(now);
        let here = self.models.get_mut(&model).ok_or(Refused::NoInstance)?;
        here.load.arrived += 1;
        if here.waiting.len() >= here.batching.backlog as usize {
            here.load.dropped += 1;
            return Err(Refused::Full);
        }
        here.waiting.push_back(Request { token, arrived: now });
        self.begin();
        Ok(())
    }

    /// Goes on to this time. Returns the first request whose batch was finished by then and that was not returned yet.
    pub fn poll(&mut self, now: Timestamp) -> Option<Inferred<T>> {
        self.advance(now);
        self.finished.pop_front()
    }

    /// Returns when it is to be polled next; `None` without requests.
    pub fn deadline(&self) -> Option<Timestamp> {
        self.finished.front().map(|finished| finished.at).or_else(|| self.next())
    }

    /// Returns what a model did up to the last call.
    pub fn load(&self, model: Key) -> Option<BatchLoad> {
        self.models.get(&model).map(|model| model.load)
    }

    /// Returns when the present batch ends or, without one, the next one begins.
    fn next(&self) -> Option<Timestamp> {
        let begins = || self.models.values().filter_map(Model::due).min();
        self.batch.as_ref().map(|batch| batch.ends).or_else(begins)
    }

    fn advance(&mut self, now: Timestamp) {
        while let Some(next) = self.next().filter(|next| *next <= now) {
            self.now = self.now.max(next);
            self.finish();
            self.begin();
        }
        self.now = self.now.max(now);
    }

    fn finish(&mut self) {
        let Some(Batch { model, began, ends, requests }) = self.batch.take_if(|batch| batch.ends <= self.now)
        else {
            return;
        };
        if let Some(Model { load, .. }) = self.models.get_mut(&model) {
            load.served += requests.len() as u64;
            load.used += ends.since(began);
        }
        let finished = |Request { token, arrived }| Inferred { at: ends, model, arrived, began, token };
        self.finished.extend(requests.into_iter().map(finished));
    }

    /// Begins the next batch, if the accelerator is free and one can begin.
    fn begin(&mut self) {
        if self.batch.is_some() {
            return;
        }
        let due = self.models.iter().filter_map(|(key, model)| Some((model.due()?, *key)));
        let Some((_, key)) = due.filter(|(due, _)| *due <= self.now).min() else { return };
        let Some(model) = self.models.get_mut(&key) else { return };
        let requests: Vec<_> = model.waiting.drain(..model.most().min(model.waiting.len())).collect();
        let first = if model.load.batches == 0 { model.times.first_batch } else { Duration::ZERO };
        let took = (model.times.of(requests.len() as u32) + first).as_secs_f64() / self.speed;
        model.load.batches += 1;
        model.load.batched += requests.len() as u64;
        let ends = self.now + Duration::from_nanos((took * 1e9).round() as u64);
        self.batch = Some(Batch { model: key, began: self.now, ends, requests });
    }
}
