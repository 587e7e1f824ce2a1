//! A server's CPUs, which its instances share.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use cotorra_graph::Timestamp;

use crate::{
    instance::{Instance, Limits, Load, POINT, Request, fixed},
    share::share,
};

/// Number of an instance, which its starter chooses.
pub type Key = u64;

/// A request that is finished.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finished<T> {
    /// Time at which it was finished.
    pub at: Timestamp,
    /// The instance that served it.
    pub instance: Key,
    /// Time of its arrival.
    pub arrived: Timestamp,
    /// Time that it took on a CPU of its own.
    pub computing: Duration,
    /// Token of its arrival.
    pub token: T,
}

impl<T> Finished<T> {
    /// Returns for how long it waited: for a worker, and while others used the CPU.
    pub fn waiting(&self) -> Duration {
        self.at.since(self.arrived).saturating_sub(self.computing)
    }
}

/// Reason for which a request is not served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refused {
    /// The backlog is full.
    Full,
    /// There is no such instance.
    NoInstance,
}

/// A server's CPUs. Call [`Server::poll`] at each [`Server::deadline`]. Time may not go back.
#[derive(Debug, Clone)]
pub struct Server<T> {
    cpus: u64,
    speed: u64,
    now: Timestamp,
    instances: BTreeMap<Key, Instance<T>>,
    finished: VecDeque<Finished<T>>,
    /// When the next request is finished.
    next: Option<Timestamp>,
    wants: Vec<u64>,
    shares: Vec<u64>,
}

impl<T> Server<T> {
    /// Creates an idle server with CPUs of a speed, both above 0, at time zero.
    pub fn new(cpus: f64, speed: f64) -> Self {
        Self {
            cpus: fixed(cpus),
            speed: fixed(speed).max(1),
            now: Timestamp::ZERO,
            instances: BTreeMap::new(),
            finished: VecDeque::new(),
            next: None,
            wants: Vec::new(),
            shares: Vec::new(),
        }
    }

    /// Starts an instance. One that has the key is replaced, and loses its requests.
    pub fn start(&mut self, now: Timestamp, instance: Key, limits: Limits) {
        self.advance(now);
        self.instances.insert(instance, Instance::new(limits));
        self.divide();
    }

    /// Stops an instance. Returns what it did, and the tokens of its unfinished requests, which are lost; `None` if there is no
    /// such instance.
    pub fn stop(&mut self, now: Timestamp, instance: Key) -> Option<(Load, Vec<T>)> {
        self.advance(now);
        let stopped = self.instances.remove(&instance)?;
        self.divide();
        let load = stopped.load();
        Some((load, stopped.into_requests().into_iter().map(|request| request.token).collect()))
    }

    /// Takes a request with that demand, on a CPU of speed 1. The token comes back when it is finished.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn arrive(
        &mut self,
        now: Timestamp,
        instance: Key,
        demand: Duration,
        token: T,
    ) -> Result<(), Refused> {
        self.advance(now);
        let here = self.instances.get_mut(&instance).ok_or(Refused::NoInstance)?;
        here.arrive(Request { token, arrived: now, demand }).map_err(|_| Refused::Full)?;
        self.divide();
        Ok(())
    }

    /// Goes on to this time. Returns the first request that was finished by then and was not returned yet.
    pub fn poll(&mut self, now: Timestamp) -> Option<Finished<T>> {
        self.advance(now);
        self.finished.pop_front()
    }

    /// Returns when [`Self::poll`] has a request; `None` if it serves none.
    pub fn deadline(&self) -> Option<Timestamp> {
        self.finished.front().map(|finished| finished.at).or(self.next)
    }

    /// Returns what an instance did up to the last call.
    pub fn load(&self, instance: Key) -> Option<Load> {
        self.instances.get(&instance).map(Instance::load)
    }

    /// Returns the keys of its instances, in order.
    pub fn instances(&self) -> impl Iterator<Item = Key> {
        self.instances.keys().copied()
    }

    fn advance(&mut self, now: Timestamp) {
        while let Some(next) = self.next.filter(|next| *next <= now) {
            self.work(next);
            self.finish();
            self.divide();
        }
        self.work(now);
    }

    fn work(&mut self, until: Timestamp) {
        let ns = until.since(self.now).as_nanos() as u64;
        if ns > 0 {
            self.instances.values_mut().for_each(|instance| instance.work(ns));
            self.now = until;
        }
    }

    /// Takes finished requests, those of the first instances first.
    fn finish(&mut self) {
        for (key, instance) in &mut self.instances {
            while let Some(Request { token, arrived, demand }) = instance.finish() {
                let work = (demand.as_nanos() << POINT).div_ceil(u128::from(self.speed));
                let computing = Duration::from_nanos(u64::try_from(work).unwrap_or(u64::MAX));
                let finished = Finished { at: self.now, instance: *key, arrived, computing, token };
                self.finished.push_back(finished);
            }
        }
    }

    /// Divides the CPUs anew.
    fn divide(&mut self) {
        self.wants.clear();
        self.wants.extend(self.instances.values().map(Instance::wanted));
        share(self.cpus, &self.wants, &mut self.shares);
        let shares = self.instances.values_mut().zip(&self.shares);
        shares.for_each(|(instance, share)| instance.give(*share, self.speed));
        let next = self.instances.values().filter_map(Instance::next).min();
        self.next = next
            .map(|after| Timestamp::from_nanos(self.now.as_nanos().saturating_add(after.as_nanos() as u64)));
    }
}
